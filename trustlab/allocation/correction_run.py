"""
Corrections of a person's thresholds while they drive: Algorithm 3 sample by sample, and consecutive
tests as in Fig. 2.18, on the model.
"""

import math
from dataclasses import dataclass
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from trustlab.allocation.correction import ROUNDING, ThresholdCorrector, suggestion_now
from trustlab.allocation.limits import threshold_pair
from trustlab.allocation.rules import run_model
from trustlab.models.checks import (
    between,
    finite_number,
    not_negative,
    of_class,
    one_of,
    positive,
    whole_number,
)
from trustlab.models.display import Result
from trustlab.models.tsc import next_utilization, threshold_mode, tsc_at

# Why thresholds are held, and what a plan takes for a measurement out of range.
MISSING = (
    "A measurement is missing (NaN), so the thresholds are held and nothing is suggested. Check "
    "the sensor; the correction resumes when data return."
)
OUTSIDE = (
    "A measurement lies outside the model's range by more than rounding, so the thresholds are "
    "held. Identify the model anew from this operator's sessions, or pass outside='nearest'."
)
NEAREST = (
    "A measurement lies outside the model's range; the plan uses the nearest value in the range, "
    "as requested. Identify the model anew if this happens often."
)


# --- sample by sample -----------------------------------------------------------------------------


class OnlineStep(NamedTuple):
    """
    The outcome of one sample.

    Parameters
    ----------
    suggestion : int
        0 autonomous, 1 manual, −1 nothing.
    tsc : float
        TSC from measured performance (2.1); NaN where a measurement is missing.
    lower, upper : float
        TSC_l and TSC_u on which the suggestion is based.
    r : float
        Utilization from the modes so far, by (2.5).
    c_l, c_u : float
        The corrections added to the thresholds for the next sample (2.40); 0 where they are held.
    cost, cost_lower_bound : float
        Of the plan; NaN where there is none.
    status : {"planned", "held"}
        Whether there is a plan.
    message : str
        How good it is, or why thresholds are held.
    latency : float
        Computing time [s].
    """

    suggestion: int
    tsc: float
    lower: float
    upper: float
    r: float
    c_l: float
    c_u: float
    cost: float
    cost_lower_bound: float
    status: str
    message: str
    latency: float


class OnlineCorrection:
    """
    Algorithm 3, sample by sample: suggestions while the thresholds are being corrected.

    Parameters
    ----------
    corrector : ThresholdCorrector
        Target, model and engine.
    start : (float, float)
        The operator's initial thresholds TSC_l and TSC_u.
    mode : int
        Initial mode: 1 manual, 0 autonomous.
    r : float
        Initial utilization, in [0, 1]; 0 is a rested operator.
    outside : {"hold", "nearest"}
        What to do when measured robot performance lies outside the model's range: hold the
        thresholds, or plan with the nearest value in the range. The message says which. TSC and the
        suggestion use the measured value.

    Raises
    ------
    ValueError
        If an argument is of the wrong kind or out of range.

    Examples
    --------
    >>> import trustlab as tl
    >>> corrector = tl.ThresholdCorrector(tl.published_models()["2"], target=(0.05, 0.4))
    >>> online = tl.OnlineCorrection(corrector, start=(0.0, 0.35))
    >>> measured = (0.26, 0.3, float("nan"), 0.34)
    >>> [online.update(p_r=p_r, p_h=0.39, mode=1).suggestion for p_r in measured]
    [1, -1, -1, 0]
    """

    def __init__(
        self,
        corrector: ThresholdCorrector,
        start: tuple[float, float],
        mode: int = 1,
        r: float = 0.0,
        outside: str = "hold",
    ):
        self.corrector = of_class("corrector", corrector, ThresholdCorrector)
        self.lower, self.upper = threshold_pair("start", start)
        self.mode = whole_number("mode", mode, least=0, most=1)
        self.r = between("r", r, 0.0, 1.0)
        self._nearest = one_of("outside", outside, ("hold", "nearest")) == "nearest"
        self._c = corrector.tsc.constants()
        self._steps: list[OnlineStep] = []

    def update(self, p_r: float, p_h: float, mode: int | None = None) -> OnlineStep:
        """
        Process one sample and return the suggestion; the thresholds are corrected for the next one.

        Parameters
        ----------
        p_r, p_h : float
            Measured robot and human performance; NaN or None where missing: the thresholds are then
            held and nothing is suggested.
        mode : int, optional
            Current mode: 1 manual, 0 autonomous; unchanged when not given or NaN.

        Returns
        -------
        OnlineStep

        Raises
        ------
        ValueError
            If an argument is not a number, or the mode is neither 0 nor 1; the state is left as it
            was.
        """
        began = perf_counter()
        p_r = math.nan if _missing(p_r) else finite_number("p_r", p_r)
        p_h = math.nan if _missing(p_h) else finite_number("p_h", p_h)
        now = self.mode if _missing(mode) else whole_number("mode", mode, least=0, most=1)
        c, r, lower, upper = self._c, self.r, self.lower, self.upper
        tsc = tsc_at.py_func(p_r, p_h, c)
        missing = math.isnan(tsc)
        suggestion = -1 if missing else suggestion_now(tsc, lower, upper)
        nearest = min(max(p_r, c.p_r_min), c.p_r_max)
        inside = abs(p_r - nearest) <= ROUNDING * (c.p_r_max - c.p_r_min)
        outcome = 0.0, 0.0, math.nan, math.nan, "held", MISSING if missing else OUTSIDE
        if not missing and (inside or self._nearest):
            plan = self.corrector.step(r, nearest, lower, upper, now)
            message = plan.message if inside or plan.status == "held" else NEAREST
            costs = plan.cost, plan.cost_lower_bound
            outcome = plan.c_l, plan.c_u, *costs, plan.status, message
        step = OnlineStep(suggestion, tsc, lower, upper, r, *outcome, perf_counter() - began)
        self.lower, self.upper = lower + step.c_l, upper + step.c_u
        self.mode, self.r = now, next_utilization.py_func(r, now, c.a_r)
        self._steps.append(step)
        return step

    def table(self) -> pd.DataFrame:
        """
        Return all samples so far.

        Returns
        -------
        pandas.DataFrame
            One row per sample; the fields of `OnlineStep`.
        """
        return pd.DataFrame(self._steps, columns=OnlineStep._fields)


def _missing(value: Any) -> bool:
    """Return whether a measurement did not come."""
    return pd.isna(value) is True  # an array for what is no single value


# --- consecutive tests ----------------------------------------------------------------------------


@dataclass(frozen=True, eq=False, repr=False)
class CorrectionRun(Result):
    """
    Consecutive tests during which the thresholds of the suggestions are corrected.

    Parameters
    ----------
    data : pandas.DataFrame
        One row per sample: what `OnlineStep` has, then test, t [s] from the start
        of its test, p_r, p_h and mode.
    start, target : (float, float)
        TSC_l and TSC_u at the beginning, and their targets.
    operator : str
        How the operator responds to suggestions.
    """

    title = "Correction run"

    data: pd.DataFrame
    start: tuple[float, float]
    target: tuple[float, float]
    operator: str

    @property
    def message(self) -> str:
        """How many tests, of which operator, and that they are simulated."""
        tests = self.data["test"].nunique()
        return f"{tests} tests, operator {self.operator}; simulated, model of (2.1)-(2.6)"

    def table(self) -> pd.DataFrame:
        """
        Return one row per test.

        Returns
        -------
        pandas.DataFrame
            Columns test, lower, upper (thresholds at its end), remaining (share of the distance to
            the target that is left, summed over both thresholds; NaN where they began there), p_r,
            r (means), switches, held (samples without a plan), largest_gap (of all plans,
            relative).
        """
        data, cost = self.data, self.data["cost"]
        data = data.assign(
            lower=data["lower"] + data["c_l"],
            upper=data["upper"] + data["c_u"],
            switches=data.groupby("test")["mode"].diff().abs() > 0.0,
            held=data["status"] == "held",
            largest_gap=(cost - data["cost_lower_bound"]) / cost.replace(0.0, 1.0),
        )
        how = {"lower": "last", "upper": "last", "p_r": "mean", "r": "mean"}
        how |= {"switches": "sum", "held": "sum", "largest_gap": "max"}
        table = data.groupby("test", as_index=False).agg(how)
        way = np.abs(np.subtract(self.target, self.start)).sum() or np.nan
        left = np.abs(table[["lower", "upper"]].to_numpy() - self.target).sum(axis=1)
        table.insert(3, "remaining", left / way)
        return table


def run_correction(
    corrector: ThresholdCorrector,
    start: tuple[float, float],
    tests: int = 4,
    habit: str = "following",
    duration: float = 1800.0,
    lag: float | None = None,
    sample_time: float = 0.1,
) -> CorrectionRun:
    """
    Correct thresholds over several consecutive tests, Section 2.5 and Fig. 2.18.

    Every test begins in the manual mode, with a rested operator and the robot's least performance;
    thresholds carry over from test to test. No plan anticipates how the operator will respond to
    suggestions.

    Parameters
    ----------
    corrector : ThresholdCorrector
        Model, target, horizon, largest correction and engine.
    start : (float, float)
        The operator's thresholds TSC_l and TSC_u.
    tests : int
        How many tests.
    habit : {"following", "lagging", "ignoring"}
        How the operator responds to suggestions. "following": follows all; "lagging": follows those
        that still stand after `lag`; "ignoring": decides by the thresholds of `start`.
    duration : float
        Length of each test [s]; Section 2.5 does not state its own.
    lag : float
        How long a suggestion must stand before the habit "lagging" follows it [s]; by default 5.
    sample_time : float
        Step of the model [s].

    Returns
    -------
    CorrectionRun
        With `.data` and `.table()`.

    Raises
    ------
    ValueError
        If an argument is of the wrong kind or out of range.

    Notes
    -----
    Simulated: no person took part.

    Examples
    --------
    >>> import trustlab as tl
    >>> corrector = tl.ThresholdCorrector(tl.published_models()["2"], target=(0.05, 0.4))
    >>> run = tl.run_correction(corrector, (0.0, 0.35), tests=1, duration=60.0)
    >>> run.table().columns.tolist()[:5]
    ['test', 'lower', 'upper', 'remaining', 'p_r']
    """
    of_class("corrector", corrector, ThresholdCorrector)
    start = threshold_pair("start", start)
    one_of("habit", habit, ("following", "lagging", "ignoring"))
    tests = whole_number("tests", tests, most=1000)
    sample_time = positive("sample_time", sample_time)
    share = between("duration/sample_time", positive("duration", duration) / sample_time, 1.0, 1e7)
    samples = round(share)
    if lag is not None and habit != "lagging":
        raise ValueError(f"lag would do nothing with habit={habit!r}; leave it out")
    lag = 5.0 if lag is None else not_negative("lag", lag)
    wait = max(1.0, lag / sample_time - 0.5)
    tsc, thresholds = corrector.tsc, start
    parts = []
    for number in range(1, tests + 1):
        online = OnlineCorrection(corrector, thresholds)
        decide = _deciding(online, habit, start, wait)
        run = run_model(tsc, samples, (0.0, tsc.robot.p_min, 1), decide=decide)
        clock = {"test": number, "t": np.arange(samples) * sample_time}
        parts.append(online.table().assign(**clock, **run[["p_r", "p_h", "mode"]]))
        thresholds = online.lower, online.upper
    data = pd.concat(parts, ignore_index=True)
    return CorrectionRun(data, start, corrector.target, habit)


def _deciding(online: OnlineCorrection, habit: str, start: tuple[float, float], wait: float) -> Any:
    """Return the operator, who decides at each sample, and then hears a suggestion."""
    standing = 0  # for how many samples the suggestion to change the mode has stood

    def decide(now: np.void, inputs: np.ndarray) -> None:
        nonlocal standing
        _, p_r, p_h, tsc, mode = now.item()
        mode = int(mode)
        if habit != "lagging":
            thresholds = start if habit == "ignoring" else (online.lower, online.upper)
            mode = threshold_mode.py_func(tsc, *thresholds, mode)
        elif standing >= wait:
            mode, standing = 1 - mode, 0
        inputs[0] = mode
        suggestion = online.update(p_r, p_h, mode).suggestion
        standing = standing + 1 if suggestion == 1 - mode else 0

    return decide
