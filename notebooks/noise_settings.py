"""
Coverage of 95 % intervals: ten kinds of noise that logs have, and means over windows; sessions of
known truth.

`data/coverage/make_coverage.py` fits many sessions of each, notebook 01 shows what came of it.
"""

from collections.abc import Callable
from functools import partial

import numpy as np
import pandas as pd

import trustlab as tl
from trustlab.identification.log import read_runs
from trustlab.identification.problem import Problem
from trustlab.identification.tsc import TSC
from trustlab.sessions.metrics import window_mean

NOISE = 0.003
FINE = 0.01  # step [s] of the time axis that stamps jitter on
PHASES = (6000, 4000, 3000, 2000, 1500, 2000, 1000, 500)  # samples, manual and autonomous in turn


def clean(step: float = 0.1, late: float = 0.0) -> pd.DataFrame:
    """
    Return the pilot operator at the model's 10 Hz: mode (acting `late` [s] after its stamp), P_r
    and P_h.
    """
    mode = np.concatenate([np.full(size, float(i % 2 == 0)) for i, size in enumerate(PHASES)])
    shift = round(late / step)
    acting = np.roll(mode, shift)
    if shift:
        acting[slice(0, shift) if shift > 0 else slice(shift, None)] = mode[0 if shift > 0 else -1]
    frame = (
        tl.published_models()["pilot"]
        .simulate(acting, r0=0.3, p_r0=0.3)[["mode", "p_r", "p_h"]]
        .copy()
    )
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
    return frame.assign(
        **{name: frame[name] + ar1(rng, len(frame), 50.0, 0.5 * NOISE) for name in ("p_r", "p_h")}
    )


def process(rng):
    """
    Disturb the robot's performance at every step (its steady deviation is half the white noise) and
    the utilization.
    """
    model, frame = tl.published_models()["pilot"], clean()
    mode = frame["mode"].to_numpy()
    r = 0.3
    p_r = 0.3
    rows = []
    drive = rng.standard_normal((len(frame), 2)) * [
        2e-4,
        0.5 * NOISE * np.sqrt(1.0 - model.robot.a**2),
    ]
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
    """
    Log every tenth sample of a model that steps at 10 Hz, beginning anywhere within the second.
    """
    frame = white(rng).iloc[int(rng.integers(10)) :: 10]
    return frame.set_axis(pd.Index(np.arange(len(frame), dtype=float), name="t"))


def dropouts(rng):
    """Set 2 % of the samples of either performance to 0."""
    frame = white(rng)
    return frame.assign(
        **{name: frame[name].where(rng.random(len(frame)) > 0.02, 0.0) for name in ("p_r", "p_h")}
    )


def jitter(rng):
    """Sample within ± 40 ms of the nominal time, and log the nominal one."""
    frame = clean()
    at = frame.index + rng.uniform(-0.04, 0.04, len(frame))
    held = np.searchsorted(frame.index, at, side="right") - 1
    moved = {name: np.interp(at, frame.index, frame[name]) for name in ("p_r", "p_h")}
    frame = white(rng, frame.assign(mode=frame["mode"].to_numpy()[np.maximum(held, 0)], **moved))
    frame.attrs["sampled_at"] = at
    return frame


def logged_jitter(rng):
    """
    Sample within ± 40 ms of the nominal time and log when: reading such a log takes a rule for
    resampling.
    """
    frame = jitter(rng)
    frame = frame.set_axis(pd.Index(frame.attrs.pop("sampled_at"), name="t"))
    return tl.read_frame(frame, resample="nearest", sample_time=0.1).with_metadata(
        performance_window=0.0
    )


def closed_loop(rng, lower=0.05, upper=0.35, size=20_000):
    """
    Return mode, P_r and P_h of the pilot operator under (2.8), which acts on noisy performances.
    """
    model = tl.published_models()["pilot"]
    human, robot = model.human, model.robot
    r = 0.3
    p_r = 0.3
    mode = 1.0
    rows = []
    for noise in NOISE * rng.standard_normal((size, 2)):
        bell = (r / human.beta) ** human.beta * ((1 - r) / (1 - human.beta)) ** (1 - human.beta)
        p_h = (human.p_max - human.p_min) * bell + human.p_min
        tsc = model.a_T * (p_r + noise[0]) - model.b_T * (p_h + noise[1])
        mode = 0.0 if tsc >= upper else 1.0 if tsc <= lower else mode
        rows.append((mode, p_r, p_h))
        p_r = robot.a * p_r + (1 - robot.a) * robot.p_min + mode * robot.b * p_h
        r = human.a * r + (1 - human.a) * mode
    return np.array(rows).T


def windowed(rng, window, loop="open", where="before", noise=NOISE):
    """
    Return a session whose performances are means over a window [s], with white noise before
    averaging or on the means.
    """
    if loop == "closed":
        mode, p_r, p_h = closed_loop(rng)
    else:
        mode = np.repeat([1.0, 0.0] * 4, 2500)
        run = tl.published_models()["pilot"].simulate(mode, 0.3, 0.3)
        p_r, p_h = run["p_r"].to_numpy(), run["p_h"].to_numpy()
    columns = {"mode": mode}
    for name, values in (("p_r", p_r), ("p_h", p_h)):
        error = noise * rng.standard_normal(values.size)
        columns[name] = window_mean(values + error * (where == "before"), 0.1, window) + error * (
            where == "after"
        )
    frame = pd.DataFrame(columns, index=pd.Index(0.1 * np.arange(mode.size), name="t"))
    return tl.Session(frame, tl.Metadata(synthetic=True, more={"performance_window": window}))


SETTINGS: dict[str, tuple[Callable, dict]] = {
    "white": (white, {}),
    "correlated over 50 s": (correlated, {}),
    "process noise": (process, {}),
    "quantised at 0.01": (quantised, {}),
    "logged at 1 Hz": (one_hertz, {"mode_delay": True, "stamp_error": 0.29}),
    "mode stamped 1 s early": (lambda rng: white(rng, clean(late=1.0)), {"mode_delay": True}),
    "mode stamped 1 s late": (lambda rng: white(rng, clean(late=-1.0)), {"mode_delay": True}),
    "dropouts to 0": (dropouts, {}),
    "jitter of 40 ms": (logged_jitter, {}),
    "jitter that the log hides": (jitter, {"mode_delay": True, "stamp_error": 0.05}),
    "heavy tails": (
        lambda rng: white(rng, draw=lambda size: rng.standard_t(3.0, size) / np.sqrt(3.0)),
        {},
    ),
}
"""
How a session is made from a random generator, and the options that a fit of it takes in the column
"with options".
"""

WINDOWS = {
    f"{window:g} s, {loop} loop, noise {where} averaging": (window, loop, where)
    for where in ("before", "after")
    for loop in ("open", "closed")
    for window in (10.0, 30.0, 100.0)
}
"""Arguments of `windowed`; noise after averaging is noise on the means."""

WAYS = ("before", "default", "options")
TRUTH = (
    "human_a",
    "human_beta",
    "human_p_min",
    "human_p_max",
    "robot_a",
    "robot_p_min",
    "robot_p_max",
)


def truth() -> pd.Series:
    """Return the pilot's parameters by the names of `fit_tsc`."""
    model = tl.published_models()["pilot"]
    return pd.Series(
        {name: getattr(getattr(model, name.split("_")[0]), name.split("_", 1)[1]) for name in TRUTH}
    )


def session_and_options(setting: str, seed: np.random.SeedSequence) -> tuple[tl.Session, dict]:
    """Return a session of a setting, and what its fit "with options" is told."""
    rng = np.random.default_rng(seed)
    if setting in WINDOWS:
        return windowed(rng, *WINDOWS[setting]), {}
    make, options = SETTINGS[setting]
    made = make(rng)
    if not isinstance(made, tl.Session):
        # As a lab's log is read: no one says that it is simulated, so that its stamps are as exact
        # as its sample time.
        made = tl.Session(made, tl.Metadata(more={"performance_window": 0.0}))
    return made, options


def before(session: tl.Session) -> tuple[bool, pd.DataFrame]:
    """
    Fit without windows, outliers and diagnosis but of weak parameters, with errors that allow for
    autocorrelation.
    """
    fit = tl.fit_tsc(session, noise="hac", window=0.0, stamp_error=0.0, robust=False)
    table = fit.parameters
    determined = not table["status"].isin(["weak", "at bound"]).any()
    success = determined and "do not use the numbers" not in fit.message
    return success, table.assign(ci_high=table["value"] + 1.96 * table["stderr"])


def now(session: tl.Session, **options) -> tuple[bool, pd.DataFrame]:
    """Fit as the package does it."""
    fit = tl.fit_tsc(session, **options)
    return fit.success, fit.table()


def covers(seed: np.random.SeedSequence, setting: str) -> dict[str, float]:
    """
    Return for each way of fitting its success, its intervals' half-width and the parameters'
    errors, in standard errors.

    A task of a campaign; NaN where a fit is refused, or the setting has no options.
    """
    session, options = session_and_options(setting, seed)
    ways = {"before": before, "default": now} | (
        {"options": partial(now, **options)} if options else {}
    )
    row = {f"{way} {what}": np.nan for way in WAYS for what in ("success", "half", *TRUTH)}
    for way, fit in ways.items():
        expected = truth()
        if setting == "logged at 1 Hz":
            # Rates belong to the log's sample time.
            expected[["human_a", "robot_a"]] **= 10
        row[f"{way} success"] = 0.0
        try:
            success, table = fit(session)
        except tl.IdentificationError:
            continue
        table = table.loc[list(TRUTH)]
        z = (table["value"] - expected) / table["stderr"]
        half = ((table["ci_high"] - table["value"]) / table["stderr"]).max()
        row |= {f"{way} success": float(success), f"{way} half": half} | {
            f"{way} {name}": z[name] for name in TRUTH
        }
    return row


def by_parameter(rows: pd.DataFrame) -> pd.DataFrame:
    """
    Return per setting, way and parameter: fits, successes, and of these the intervals' coverage and
    the bias in standard errors.
    """
    table = []
    for setting, fits in rows.groupby("setting", sort=False):
        for way in WAYS:
            good = fits[fits[f"{way} success"] == 1.0]
            z, counts = (
                good[[f"{way} {name}" for name in TRUTH]].set_axis(TRUTH, axis=1),
                fits[f"{way} success"].count(),
            )
            inside = z.abs().le(good[f"{way} half"], axis=0)
            columns = {
                "fits": counts,
                "successes": len(good),
                "coverage": inside.mean(),
                "bias": z.mean(),
            }
            table.append(pd.DataFrame({"setting": setting, "way": way} | columns, index=z.columns))
    whole = pd.concat(table).rename_axis("parameter").reset_index()
    return whole[whole["fits"] > 0]


def summary(rows: pd.DataFrame) -> pd.DataFrame:
    """
    Return per setting and way the share of successes, and of these the mean and least coverage and
    the greatest bias.
    """
    groups = by_parameter(rows).groupby(["setting", "way"], sort=False)
    columns = {
        "fits": groups["fits"].first(),
        "success": groups["successes"].first() / groups["fits"].first(),
        "mean coverage": groups["coverage"].mean(),
        "least coverage": groups["coverage"].min(),
        "greatest bias": groups["bias"].agg(lambda own: own.abs().max()),
    }
    return pd.DataFrame(columns)


def not_met(rows: pd.DataFrame) -> pd.DataFrame:
    """
    Return which parameters the default and optional fits that report success cover in fewer than
    90 %, or, of windows, are biased by 0.3 sd, where more than a tenth succeed; and if by chance.
    """
    table = by_parameter(rows)
    # A tenth of the fits is chance where the others say that their intervals cannot be trusted.
    table = table[(table["way"] != "before") & (table["successes"] > 0.1 * table["fits"])]
    short = 0.9 - table["coverage"]
    biased = table["setting"].isin(WINDOWS) * (table["bias"].abs() - 0.3)
    # Two standard deviations: of a share of 90 %, and of the mean of errors with variance one.
    chance = (short < 0.6 / np.sqrt(table["successes"])) & (
        biased < 2.0 / np.sqrt(table["successes"])
    )
    return table.assign(chance=chance)[(short > 1e-9) | (biased > 0.0)]


def least_half_width(setting: str) -> float:
    """
    Return the half-width of an interval of p_min at the Cramér–Rao bound for one session, as a
    share of p_max − p_min.
    """
    session, _ = session_and_options(setting, np.random.SeedSequence([11, 0]))
    runs, at = (
        read_runs(session, "mode", "p_h", "p_r"),
        truth().to_dict() | {"r0": 0.3, "p_r0": 0.3},
    )
    problem = Problem(TSC, runs, TSC.limits(), unwindow="before" in setting)
    equations = problem.equations(problem.full_vector(at))
    error = np.sqrt(np.linalg.inv(equations.matrix).diagonal()[TSC.names.index("human_p_min")])
    return 1.96 * error / (at["human_p_max"] - at["human_p_min"])
