"""
Coverage of 95 % intervals under the noise that logs have: ten settings, sessions of known truth.

Notebook 01 shows them for a part of the seeds, and a long test for all.
"""

from collections.abc import Callable, Iterator

import numpy as np
import pandas as pd

import trustlab as tl

NOISE = 0.003
FINE = 0.01  # step [s] of the time axis that stamps jitter on
PHASES = (6000, 4000, 3000, 2000, 1500, 2000, 1000, 500)  # samples, manual and autonomous in turn


def clean(step: float = 0.1, late: float = 0.0) -> pd.DataFrame:
    """Return the pilot operator at the model's 10 Hz: mode (acting `late` [s] after its stamp), P_r and P_h."""
    mode = np.concatenate([np.full(size, float(i % 2 == 0)) for i, size in enumerate(PHASES)])
    shift = round(late / step)
    acting = np.roll(mode, shift)
    if shift:
        acting[slice(0, shift) if shift > 0 else slice(shift, None)] = mode[0 if shift > 0 else -1]
    frame = tl.published_models()["pilot"].simulate(acting, r0=0.3, p_r0=0.3)[["mode", "p_r", "p_h"]].copy()
    return frame.assign(mode=mode).set_axis(pd.Index(step * np.arange(mode.size), name="t"))


def ar1(rng: np.random.Generator, size: int, seconds: float, deviation: float) -> np.ndarray:
    """Return noise that is correlated over some seconds, in steady state from the first sample."""
    from scipy.signal import lfilter

    kept = np.exp(-0.1 / seconds)
    drive = deviation * np.sqrt(1.0 - kept**2) * rng.standard_normal(size)
    drive[0] = deviation * rng.standard_normal()
    return lfilter([1.0], [1.0, -kept], drive)


def white(rng, frame=None, columns=("p_r", "p_h"), draw=None):
    """Return the pilot's session with white noise on both performances."""
    frame = clean() if frame is None else frame
    draw = rng.standard_normal if draw is None else draw
    return frame.assign(**{name: frame[name] + NOISE * draw(len(frame)) for name in columns})


def correlated(rng):
    """Add noise that is correlated over 50 s, half as large as the white noise."""
    frame = white(rng)
    return frame.assign(**{name: frame[name] + ar1(rng, len(frame), 50.0, 0.5 * NOISE) for name in ("p_r", "p_h")})


def process(rng):
    """Disturb the robot's performance at every step (its steady deviation is half the white noise) and the utilization."""
    model, frame = tl.published_models()["pilot"], clean()
    mode, r, p_r, rows = frame["mode"].to_numpy(), 0.3, 0.3, []
    drive = rng.standard_normal((len(frame), 2)) * [2e-4, 0.5 * NOISE * np.sqrt(1.0 - model.robot.a**2)]
    for k, manual in enumerate(mode):
        p_h = float(model.human.performance(r))
        rows.append((p_r, p_h))
        r = min(max(model.human.a * r + (1.0 - model.human.a) * manual + drive[k, 0], 0.0), 1.0)
        a, b = model.robot.a, model.robot.b
        p_r = a * p_r + (1.0 - a) * model.robot.p_min + manual * b * p_h + drive[k, 1]
    return white(rng, frame.assign(p_r=[row[0] for row in rows], p_h=[row[1] for row in rows]))


def quantised(rng):
    """Round both performances to 0.01."""
    frame = white(rng)
    return frame.assign(p_r=frame["p_r"].round(2), p_h=frame["p_h"].round(2))


def one_hertz(rng):
    """Log every tenth sample of a model that steps at 10 Hz, beginning anywhere within the second."""
    frame = white(rng).iloc[int(rng.integers(10)) :: 10]
    return frame.set_axis(pd.Index(np.arange(len(frame), dtype=float), name="t"))


def dropouts(rng):
    """Set 2 % of the samples of either performance to 0."""
    frame = white(rng)
    return frame.assign(**{name: frame[name].where(rng.random(len(frame)) > 0.02, 0.0) for name in ("p_r", "p_h")})


def jitter(rng):
    """Sample within ± 40 ms of the nominal time."""
    frame = clean()
    at = frame.index + rng.uniform(-0.04, 0.04, len(frame))
    held = np.searchsorted(frame.index, at, side="right") - 1
    moved = {name: np.interp(at, frame.index, frame[name]) for name in ("p_r", "p_h")}
    return white(rng, frame.assign(mode=frame["mode"].to_numpy()[np.maximum(held, 0)], **moved))


SETTINGS: dict[str, tuple[Callable, dict]] = {
    "white": (white, {}),
    "correlated over 50 s": (correlated, {}),
    "process noise": (process, {}),
    "quantised at 0.01": (quantised, {}),
    "logged at 1 Hz": (one_hertz, {"step": 0.1, "mode_delay": True, "stamp_error": 0.29}),
    "mode stamped 1 s early": (lambda rng: white(rng, clean(late=1.0)), {"mode_delay": True}),
    "mode stamped 1 s late": (lambda rng: white(rng, clean(late=-1.0)), {"mode_delay": True}),
    "dropouts to 0": (dropouts, {}),
    "jitter of 40 ms": (jitter, {"mode_delay": True, "stamp_error": 0.05}),
    "heavy tails": (lambda rng: white(rng, draw=lambda size: rng.standard_t(3.0, size) / np.sqrt(3.0)), {}),
}
"""How a session is made from a random generator, and the options that a fit of it takes in the column "with options"."""

WAYS = ("before", "default", "options")
TRUTH = ("human_a", "human_beta", "human_p_min", "human_p_max", "robot_a", "robot_p_min", "robot_p_max")


def truth() -> pd.Series:
    """Return the pilot's parameters by the names of `fit_tsc`."""
    model = tl.published_models()["pilot"]
    return pd.Series({name: getattr(getattr(model, name.split("_")[0]), name.split("_", 1)[1]) for name in TRUTH})


def fits(setting: str, seed: np.random.SeedSequence) -> Iterator[tuple[str, object]]:
    """Yield the fits of one session by their names: as before, as it is, with the options of the setting."""
    make, options = SETTINGS[setting]
    session = tl.Session(make(np.random.default_rng(seed)), tl.Metadata(synthetic=True))
    ways = {"before": {"noise": "hac", "robust": False}, "default": {}} | ({"options": options} if options else {})
    for name, own in ways.items():
        yield name, tl.fit_tsc(session, **own)


def covers(seed: np.random.SeedSequence, setting: str) -> dict[str, float]:
    """Return for each way of fitting whether it reports success, and which parameters its intervals cover; a task of a campaign."""
    row = {f"{way}_{what}": np.nan for way in WAYS for what in ("success", *TRUTH)}
    for way, fit in fits(setting, seed):
        table, expected = fit.table().loc[list(TRUTH)], truth()
        if way != "options":
            # Without a step of its own the rates belong to the log's.
            steps = round((fit.runs[0].t[1] - fit.runs[0].t[0]) / 0.1)
            expected[["human_a", "robot_a"]] **= steps
        known = table["status"].ne("weak").all() if way == "before" else fit.success
        inside = (table["ci_low"] <= expected) & (expected <= table["ci_high"])
        row |= {f"{way}_success": float(known)} | {f"{way}_{name}": float(inside[name]) for name in TRUTH}
    return row


def summary(rows: pd.DataFrame) -> pd.DataFrame:
    """Return per setting and way the share of successes, and the mean and least coverage of the parameters where there are any."""
    table = {}
    for setting, own in rows.groupby("setting", sort=False):
        for way in WAYS:
            good = own[own[f"{way}_success"] == 1.0][[f"{way}_{name}" for name in TRUTH]].mean()
            values = {
                "success": own[f"{way}_success"].mean(),
                "mean coverage": good.mean(),
                "least coverage": good.min(),
            }
            table[setting] = table.get(setting, {}) | {(way, name): value for name, value in values.items()}
    return pd.DataFrame.from_dict(table, orient="index").rename_axis("setting")
