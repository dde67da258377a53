"""Corrections over several consecutive tests, as in Fig. 2.18, on the model."""

from collections.abc import Callable
from dataclasses import dataclass
from string import ascii_lowercase
from typing import Any

import numpy as np
import pandas as pd

from trustlab.allocation.correction.corrector import ThresholdCorrector, threshold_pair
from trustlab.allocation.correction.incentive import within_range
from trustlab.allocation.correction.online import OnlineCorrection
from trustlab.models.axes import axes_or_new
from trustlab.models.checks import (
    between,
    not_negative,
    one_of,
    positive,
    warn_renamed,
    whole_number,
)
from trustlab.models.html import as_html
from trustlab.models.human import next_utilization, performance_at
from trustlab.models.robot import next_performance
from trustlab.models.tsc import TscConstants, TscModel, threshold_mode, tsc_at

# How operators respond to suggestions.
HABITS = ("following", "lagging", "ignoring")

# Columns of the thresholds, each with that of its corrections.
SIDES = (("lower", "c_l"), ("upper", "c_u"))


@dataclass(frozen=True, eq=False)
class CorrectionRun:
    """
    Consecutive tests during which the thresholds of the suggestions are corrected.

    Parameters
    ----------
    data : pandas.DataFrame
        One row per sample: test, t [s] from the start of its test, then r, p_r, p_h, tsc, mode,
        suggestion, lower, upper, c_l, c_u, cost, cost_lower_bound, status, latency [s].
    start, target : (float, float)
        TSC_l and TSC_u at the beginning, and their targets.
    operator : str
        How the operator responds to suggestions.
    source : str
        Where the data come from: simulated, and by which model or testbed.
    sessions : tuple of Session
        The sessions that the data were taken from, one per test; on a testbed only.
    """

    data: pd.DataFrame
    start: tuple[float, float]
    target: tuple[float, float]
    operator: str
    source: str
    sessions: tuple = ()

    def table(self) -> pd.DataFrame:
        """
        Return one row per test.

        Returns
        -------
        pandas.DataFrame
            Columns test, lower, upper (thresholds at its end), remaining (share of the distance to
            the target that is left, summed over both thresholds; NaN where they began there), p_r,
            r, manual_share (means), switches, held (samples without a plan), largest_gap (of all
            plans, relative), latency_median, latency_p99 [s].
        """
        data, tests = self.data, self.data.groupby("test", sort=True)
        table = pd.DataFrame(
            {side: (data[side] + data[c]).groupby(data["test"]).last() for side, c in SIDES}
        )
        way = abs(self.target[0] - self.start[0]) + abs(self.target[1] - self.start[1])
        left = abs(self.target[0] - table["lower"]) + abs(self.target[1] - table["upper"])
        table["remaining"] = left / way if way > 0.0 else np.nan
        table[["p_r", "r", "manual_share"]] = tests[["p_r", "r", "mode"]].mean()
        table["switches"] = tests["mode"].agg(lambda mode: np.count_nonzero(np.diff(mode)))
        table["held"] = tests["cost"].agg(lambda cost: cost.isna().sum())
        gap = (data["cost"] - data["cost_lower_bound"]) / data["cost"].where(
            data["cost"] > 0.0, 1.0
        )
        table["largest_gap"] = gap.groupby(data["test"]).max()
        table["latency_median"], table["latency_p99"] = (
            tests["latency"].median(),
            tests["latency"].quantile(0.99),
        )
        return table.reset_index()

    def plot(self, target: tuple[float, float] | None = None):
        """
        Plot TSC, thresholds and targets of every test, as Fig. 2.18 does.

        Parameters
        ----------
        target : (float, float), optional
            Targets to draw, if not those of this run.

        Returns
        -------
        numpy.ndarray of matplotlib.axes.Axes, shape (tests,)
        """
        tests = self.data["test"].unique()
        size = (min(3 * tests.size + 0.5, 10.0), 3.2)
        axes = axes_or_new(columns=tests.size, sharey=True, squeeze=False, figsize=size)
        for axis, test, letter in zip(axes[0], tests, ascii_lowercase * tests.size, strict=False):
            part = self.data[self.data["test"] == test]
            axis.plot(part["t"], part["tsc"], lw=0.8, color="C0", label="TSC")
            # One label for both thresholds, and one for both targets: the second line has none.
            for side, label in (("lower", "thresholds"), ("upper", None)):
                axis.plot(part["t"], part[side], "--", color="C3", label=label)
            for value, label in zip(target or self.target, ("target", None), strict=True):
                axis.axhline(value, ls="-.", lw=1, color="0.4", label=label)
            axis.set(xlabel="time [s]", title=f"({letter}) test {test}")
        axes[0, 0].set(ylabel="TSC")
        axes[0, 0].figure.legend(
            *axes[0, 0].get_legend_handles_labels(),
            title=f"operator {self.operator}; {self.source}",
            loc="outside upper center",
            ncols=3,
            fontsize="small",
            title_fontsize="small",
            frameon=False,
        )
        return axes[0]

    def _repr_html_(self) -> str:
        return as_html(
            f"operator {self.operator}; {self.source}", self.table(), title="Correction run"
        )

    def __repr__(self) -> str:
        tests = self.data["test"].nunique()
        return (
            f"CorrectionRun({tests} tests, {len(self.data)} samples, operator {self.operator}; "
            f"{self.source})"
        )


def correct_pattern(
    tsc: TscModel,
    start: tuple[float, float],
    target: tuple[float, float],
    tests: int = 4,
    duration: float = 1800.0,
    c_b: float = 1e-5,
    horizon: int = 200,
    engine: str = "exact",
    habit: str = "following",
    lag: float = 5.0,
    noise: float = 0.0,
    seed: int | np.random.SeedSequence = 0,
    r0: float = 0.0,
    p_r0: float | None = None,
    sample_time: float = 0.1,
    incentive: Callable | None = None,
    **options: Any,
) -> CorrectionRun:
    """
    Correct thresholds with a receding horizon over several consecutive tests, on the model, Section
    2.5 and Fig. 2.18.

    Every test begins in the manual mode with a rested operator; thresholds carry over from test to
    test. Each plan starts from the true utilization and performance, but does not anticipate how
    the operator will respond to suggestions.

    Parameters
    ----------
    tsc : TscModel
        The model.
    start : (float, float)
        The operator's thresholds TSC_l and TSC_u.
    target : (float, float)
        TSC_ld and TSC_ud.
    tests : int
        How many tests.
    duration : float
        Length of each test [s]; Section 2.5 does not state its own.
    c_b : float
        Largest correction per step.
    horizon : int
        N of (2.43).
    engine : str
        As for `ThresholdCorrector`.
    habit : {"following", "lagging", "ignoring"}
        Follows suggestions at once; follows those that still stand after a lag; or switches by the
        thresholds of `start`.
    lag : float
        That lag [s].
    noise : float
        Standard deviation of a disturbance of robot performance at each step; performance stays
        within the model's range.
    seed : int or numpy.random.SeedSequence
        Of the disturbance.
    r0 : float
        Utilization at the beginning of each test.
    p_r0 : float, optional
        Robot performance there; the robot's P_min when not given.
    sample_time : float
        Time between samples [s]; it converts durations to samples.
    incentive : callable, optional
        As for `ThresholdCorrector`.
    **options : object
        Options of the engine.

    Returns
    -------
    CorrectionRun
        With `.data`, `.table()` and `.plot()`.

    Raises
    ------
    ValueError
        If an argument is of the wrong kind or out of range.

    Examples
    --------
    >>> import trustlab as tl
    >>> tsc = tl.published_models()["pilot"]
    >>> run = tl.correct_pattern(tsc, (0.02, 0.45), (0.15, 0.56), tests=1, duration=60.0, seed=0)
    >>> run.table().columns.tolist()[:5]
    ['test', 'lower', 'upper', 'remaining', 'p_r']
    """
    if "operator" in options:
        warn_renamed("correct_pattern(operator=…)", "correct_pattern(habit=…)")
        habit = options.pop("operator")
    corrector = ThresholdCorrector(tsc, target, c_b, horizon, engine, incentive, **options)
    start, tests = threshold_pair("start", start), whole_number("tests", tests, most=1000)
    one_of("habit", habit, HABITS)
    step = positive("sample_time", sample_time)
    samples = whole_number(
        "the number of samples, duration/sample_time,",
        round(min(positive("duration", duration) / step, 1e15)),
        most=10_000_000,
    )
    lag = not_negative("lag", lag)
    noise = not_negative("noise", noise)
    r0 = between("r0", r0, 0.0, 1.0)
    robot = tsc.robot
    p_r0 = robot.p_min if p_r0 is None else within_range("p_r0", p_r0, robot.p_min, robot.p_max)
    if not isinstance(seed, np.random.SeedSequence):
        seed = whole_number("seed", seed, least=0)
    disturbance = np.random.default_rng(seed).standard_normal((tests, samples)) * noise
    wait = round(min(lag / step, samples + 1))
    thresholds, parts = start, []
    for test in range(tests):
        online = OnlineCorrection(corrector, thresholds, 1, r0, outside="nearest")
        person = Habit(habit, start, wait)
        truth = _one_test(online, person, tsc.constants(), r0, p_r0, disturbance[test])
        thresholds = (online.lower, online.upper)
        parts.append(online.table().assign(test=test + 1, t=np.arange(samples) * step, **truth))
    columns = [
        "test",
        "t",
        "r",
        "p_r",
        "p_h",
        "tsc",
        "mode",
        "suggestion",
        "lower",
        "upper",
        "c_l",
        "c_u",
    ]
    data = pd.concat(parts, ignore_index=True)[
        [*columns, "cost", "cost_lower_bound", "status", "latency"]
    ]
    return CorrectionRun(data, start, corrector.target, habit, "simulated, model of (2.1)-(2.6)")


class Habit:
    """
    An operator's response to suggestions: follow them at once, after a lag of `wait` samples, or
    not at all.
    """

    def __init__(self, kind: str, own: tuple[float, float], wait: int):
        self.kind = kind
        self.own = own
        self.wait = wait
        self.mode = 1
        self._wanted = -1
        self._stood = 0

    def decide(self, tsc: float, online: OnlineCorrection) -> int:
        """Return the operator's mode at this sample."""
        if self.kind != "lagging":
            thresholds = self.own if self.kind == "ignoring" else (online.lower, online.upper)
            self.mode = threshold_mode.py_func(tsc, *thresholds, self.mode)
        elif self._wanted >= 0 and self._stood >= self.wait:
            self.mode, self._wanted = self._wanted, -1
        return self.mode

    def hear(self, suggestion: int) -> None:
        """
        Count for how long a suggestion has stood; the count restarts when it changes or agrees with
        the mode.
        """
        if suggestion == self.mode:
            self._wanted, self._stood = -1, 0
        elif suggestion < 0 or suggestion == self._wanted:
            self._stood += 1
        else:
            self._wanted, self._stood = suggestion, 1


def _one_test(
    online: OnlineCorrection,
    habit: Habit,
    c: TscConstants,
    r: float,
    p_r: float,
    disturbance: np.ndarray,
) -> dict[str, np.ndarray]:
    """Simulate one test in closed loop and return p_r, p_h and mode, sample by sample."""
    truth = {name: np.empty(disturbance.size) for name in ("p_r", "p_h", "mode")}
    for k, push in enumerate(disturbance):
        # Numbers one by one: a NamedTuple takes longer to hand over to compiled code than the
        # equation takes.
        p_h = performance_at(r, c.beta, c.p_h_min, c.p_h_max)
        mode = habit.decide(tsc_at.py_func(p_r, p_h, c), online)
        habit.hear(online.update(p_r, p_h, mode).suggestion)
        truth["p_r"][k] = p_r
        truth["p_h"][k] = p_h
        truth["mode"][k] = mode
        r = min(max(next_utilization(r, mode, c.a_r), 0.0), 1.0)
        p_r = next_performance(p_r, p_h, mode, c.a_pr, c.b_pr, c.p_r_min)
        if push:
            p_r = min(max(p_r + push, c.p_r_min), c.p_r_max)
    return truth
