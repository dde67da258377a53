"""
Corrections of a person's thresholds while they drive: Algorithm 3 sample by sample, and consecutive
tests as in Fig. 2.18, on the model.
"""

import math
from dataclasses import dataclass
from string import ascii_lowercase
from time import perf_counter

import numpy as np
import pandas as pd

from trustlab.allocation.correction import (
    ThresholdCorrector,
    check_mode,
    suggestion_now,
)
from trustlab.allocation.correction_path import ROUNDING, within_range
from trustlab.allocation.limits import threshold_pair
from trustlab.models.checks import (
    between,
    finite_number,
    not_negative,
    of_class,
    one_of,
    positive,
    set_checked,
    whole_number,
)
from trustlab.models.display import Result, axes_or_new
from trustlab.models.tsc import (
    RobotModel,
    TscConstants,
    next_performance,
    next_utilization,
    performance_at,
    threshold_mode,
    tsc_at,
)

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

# Columns of the data, with their order.
COLUMNS = [
    *["test", "t", "r", "p_r", "p_h", "tsc", "mode", "suggestion"],
    *["lower", "upper", "c_l", "c_u"],
    *["cost", "cost_lower_bound", "status", "message", "latency"],
]

HABITS = ("following", "lagging", "ignoring")
SOURCE = "simulated, model of (2.1)-(2.6)"

# Columns of the thresholds, each with that of its corrections.
SIDES = (("lower", "c_l"), ("upper", "c_u"))


# --- sample by sample -----------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class OnlineStep:
    """
    The outcome of one sample.

    Parameters
    ----------
    sample : int
        Number of the sample, from 0.
    suggestion : int
        0 autonomous, 1 manual, −1 nothing.
    tsc : float
        TSC from measured performance (2.1); NaN where a measurement is missing.
    lower, upper : float
        TSC_l and TSC_u on which the suggestion is based.
    c_l, c_u : float
        The corrections added to them for the next sample (2.40); 0 where they are held.
    r : float
        Utilization from the modes so far, by (2.5).
    cost, cost_lower_bound : float
        Of the plan; NaN where there is none.
    status : {"planned", "held"}
        Whether there is a plan.
    message : str
        How good it is, or why thresholds are held.
    latency : float
        Computing time [s].
    """

    sample: int
    suggestion: int
    tsc: float
    lower: float
    upper: float
    c_l: float
    c_u: float
    r: float
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
        thresholds, or plan with the nearest value in the range. The status says which. TSC and the
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
        self.mode = check_mode(mode)
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
        p_r = measured("p_r", p_r)
        p_h = measured("p_h", p_h)
        now = (
            self.mode
            if mode is None or (isinstance(mode, float) and mode != mode)
            else check_mode(mode)
        )
        c = self._c
        lower = self.lower
        upper = self.upper
        suggestion = -1
        status, message = "held", MISSING
        c_l = c_u = 0.0
        cost = bound = math.nan
        tsc = tsc_at.py_func(p_r, p_h, c)
        if math.isinf(tsc) or (tsc != tsc and p_r == p_r and p_h == p_h):
            raise ValueError(f"TSC overflows for p_r = {p_r} and p_h = {p_h}; check their unit")
        if tsc == tsc:
            suggestion = suggestion_now(tsc, lower, upper)
            slack = ROUNDING * (c.p_r_max - c.p_r_min)
            inside = c.p_r_min - slack <= p_r <= c.p_r_max + slack
            message = OUTSIDE
            if inside or self._nearest:
                plan = self.corrector.plan(
                    self.r, min(max(p_r, c.p_r_min), c.p_r_max), lower, upper, now
                )
                c_l, c_u = plan.c_l, plan.c_u
                cost, bound = plan.cost, plan.cost_lower_bound
                status = plan.status
                message = plan.message if inside or status == "held" else NEAREST
        r = self.r
        self.lower = lower + c_l
        self.upper = upper + c_u
        self.mode = now
        self.r = min(max(next_utilization.py_func(r, now, c.a_r), 0.0), 1.0)
        sample = len(self._steps)
        latency = perf_counter() - began
        step = OnlineStep(
            *(sample, suggestion, tsc, lower, upper, c_l, c_u, r, cost, bound),
            *(status, message, latency),
        )
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
        columns = {
            name: [getattr(step, name) for step in self._steps] for name in OnlineStep.__slots__
        }
        return pd.DataFrame(columns)

    def plot(self, axes=None):
        """
        Plot a histogram of the latency of every sample so far.

        Parameters
        ----------
        axes : matplotlib.axes.Axes, optional
            Where to plot; a new figure when not given.

        Returns
        -------
        matplotlib.axes.Axes

        Raises
        ------
        ValueError
            If there is no sample yet.
        """
        return plot_latency([step.latency for step in self._steps], axes)


def plot_latency(latency, axes=None):
    """Plot a histogram of latencies [s], with median and 99th percentile, and return its axes."""
    micro = 1e6 * np.asarray(latency, dtype=float)
    if micro.size == 0:
        raise ValueError(
            "there is no latency to plot yet; feed samples with update(p_r, p_h, mode) first"
        )
    axes = axes_or_new(axes, figsize=(7, 3))
    axes.hist(micro, bins=np.geomspace(micro.min(), micro.max() * 1.0001, 80))
    for share, style in ((50, "-"), (99, "--")):
        value = float(np.percentile(micro, share))
        axes.axvline(value, color="C1", ls=style, label=f"{share} %: {value:.1f} µs")
    axes.set(xscale="log", yscale="log", xlabel="latency [µs]", ylabel="samples")
    axes.legend(fontsize="small")
    return axes


def measured(name: str, value: float | None) -> float:
    """Return a measurement as a float, NaN where it is missing."""
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return math.nan
    return finite_number(name, value)


# --- consecutive tests ----------------------------------------------------------------------------


@dataclass(frozen=True, eq=False, repr=False)
class CorrectionRun(Result):
    """
    Consecutive tests during which the thresholds of the suggestions are corrected.

    Parameters
    ----------
    data : pandas.DataFrame
        One row per sample: test, t [s] from the start of its test, then r, p_r, p_h, tsc, mode,
        suggestion, lower, upper, c_l, c_u, cost, cost_lower_bound, status, message, latency [s].
    start, target : (float, float)
        TSC_l and TSC_u at the beginning, and their targets.
    operator : str
        How the operator responds to suggestions.
    source : str
        Where the data come from.
    """

    title = "Correction run"

    data: pd.DataFrame
    start: tuple[float, float]
    target: tuple[float, float]
    operator: str
    source: str = SOURCE

    @property
    def message(self) -> str:
        """How many tests, of which operator, and where the data come from."""
        tests = self.data["test"].nunique()
        return f"{tests} tests, operator {self.operator}; {self.source}"

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
        data = self.data
        tests = self.data.groupby("test", sort=True)
        table = pd.DataFrame(
            {side: (data[side] + data[c]).groupby(data["test"]).last() for side, c in SIDES}
        )
        way = abs(self.target[0] - self.start[0]) + abs(self.target[1] - self.start[1])
        left = abs(self.target[0] - table["lower"]) + abs(self.target[1] - table["upper"])
        table["remaining"] = left / way if way > 0.0 else np.nan
        table[["p_r", "r", "manual_share"]] = tests[["p_r", "r", "mode"]].mean()
        table["switches"] = tests["mode"].agg(lambda mode: np.count_nonzero(np.diff(mode)))
        table["held"] = tests["status"].agg(lambda status: (status == "held").sum())
        gap = (data["cost"] - data["cost_lower_bound"]) / data["cost"].where(
            data["cost"] > 0.0, 1.0
        )
        table["largest_gap"] = gap.groupby(data["test"]).max()
        table["latency_median"] = tests["latency"].median()
        table["latency_p99"] = tests["latency"].quantile(0.99)
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


@dataclass(frozen=True)
class ModelTests:
    """
    Tests on the model: each plan starts from the true utilization and performance.

    Parameters
    ----------
    duration : float
        Length of each test [s]; Section 2.5 does not state its own.
    lag : float
        How long a suggestion must stand before the habit "lagging" follows it [s].
    noise : float
        Standard deviation of a disturbance of robot performance at each step; performance stays
        within the model's range.
    r0 : float
        Utilization at the beginning of each test; 0 is a rested operator.
    p_r0 : float, optional
        Robot performance there; the robot's P_min when not given.
    sample_time : float
        Time between samples [s]; it converts durations to samples.

    Raises
    ------
    ValueError
        If an argument is of the wrong kind or out of range.
    """

    duration: float = 1800.0
    lag: float = 5.0
    noise: float = 0.0
    r0: float = 0.0
    p_r0: float | None = None
    sample_time: float = 0.1

    def __post_init__(self):
        set_checked(self, positive, "duration", "sample_time")
        set_checked(self, not_negative, "lag", "noise")
        between("r0", self.r0, 0.0, 1.0)
        samples = round(min(self.duration / self.sample_time, 1e15))
        name = "the number of samples, duration/sample_time,"
        whole_number(name, samples, most=10_000_000)

    @property
    def samples(self) -> int:
        """How many samples a test has."""
        return round(self.duration / self.sample_time)

    def start(self, robot: RobotModel) -> float:
        """
        Return robot performance at the beginning of each test.

        Parameters
        ----------
        robot : RobotModel
            Within whose range it lies.
        """
        if self.p_r0 is None:
            return robot.p_min
        return within_range("p_r0", self.p_r0, robot.p_min, robot.p_max)


class Responder:
    """An operator who follows suggestions at once, after `wait` samples, or not at all."""

    def __init__(self, habit: str, start: tuple[float, float], wait: int):
        self.habit = habit
        self.start = start
        self.wait = wait
        self.mode = 1
        self._suggested = -1
        self._samples = 0  # for how many samples that suggestion has stood

    def decide(self, tsc: float, online: OnlineCorrection) -> int:
        """Return the operator's mode at this sample."""
        if self.habit != "lagging":
            ignores = self.habit == "ignoring"
            thresholds = self.start if ignores else (online.lower, online.upper)
            self.mode = threshold_mode.py_func(tsc, *thresholds, self.mode)
        elif self._suggested >= 0 and self._samples >= self.wait:
            self.mode = self._suggested
            self._suggested = -1
        return self.mode

    def hear(self, suggestion: int) -> None:
        """Count for how many samples a suggestion has stood; one that is withdrawn is forgotten."""
        if suggestion < 0 or suggestion == self.mode:
            self._suggested = -1
            self._samples = 0
        elif suggestion == self._suggested:
            self._samples += 1
        else:
            self._suggested = suggestion
            self._samples = 1


def _closed_loop(
    online: OnlineCorrection,
    operator: Responder,
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
        mode = operator.decide(tsc_at.py_func(p_r, p_h, c), online)
        operator.hear(online.update(p_r, p_h, mode).suggestion)
        truth["p_r"][k] = p_r
        truth["p_h"][k] = p_h
        truth["mode"][k] = mode
        r = min(max(next_utilization(r, mode, c.a_r), 0.0), 1.0)
        p_r = next_performance(p_r, p_h, mode, c.a_pr, c.b_pr, c.p_r_min)
        if push:
            p_r = min(max(p_r + push, c.p_r_min), c.p_r_max)
    return truth


def run_correction(
    corrector: ThresholdCorrector,
    start: tuple[float, float],
    tests: int = 4,
    habit: str = "following",
    seed: int | np.random.SeedSequence = 0,
    setting: ModelTests | None = None,
) -> CorrectionRun:
    """
    Correct thresholds over several consecutive tests, Section 2.5 and Fig. 2.18.

    Every test begins in the manual mode; thresholds carry over from test to test. No plan
    anticipates how the operator will respond to suggestions.

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
        that still stand after a lag; "ignoring": decides by the thresholds of `start`.
    seed : int or numpy.random.SeedSequence
        Of all that is random.
    setting : ModelTests, optional
        How long the tests are, and from where they begin; `ModelTests()` when not given.

    Returns
    -------
    CorrectionRun
        With `.data`, `.table()` and `.plot()`.

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
    >>> setting = tl.allocation.ModelTests(duration=60.0)
    >>> run = tl.run_correction(corrector, (0.0, 0.35), tests=1, setting=setting)
    >>> run.table().columns.tolist()[:5]
    ['test', 'lower', 'upper', 'remaining', 'p_r']
    """
    of_class("corrector", corrector, ThresholdCorrector)
    setting = of_class("setting", ModelTests() if setting is None else setting, ModelTests)
    start = threshold_pair("start", start)
    one_of("habit", habit, HABITS)
    tests = whole_number("tests", tests, most=1000)
    if not isinstance(seed, np.random.SeedSequence):
        seed = whole_number("seed", seed, least=0)
    p_r0, r0 = setting.start(corrector.tsc.robot), setting.r0
    wait = round(min(setting.lag / setting.sample_time, setting.samples + 1))
    if corrector.program is not None:
        corrector.program.reset()
    rng, thresholds = np.random.default_rng(seed), start
    parts = []
    for number in range(1, tests + 1):
        online = OnlineCorrection(corrector, thresholds, 1, r0, outside="nearest")
        operator = Responder(habit, start, wait)
        disturbance = rng.standard_normal(setting.samples) * setting.noise
        truth = _closed_loop(online, operator, corrector.tsc.constants(), r0, p_r0, disturbance)
        time = np.arange(setting.samples) * setting.sample_time
        parts.append(online.table().assign(test=number, t=time, **truth))
        thresholds = online.lower, online.upper
    frame = pd.concat(parts, ignore_index=True)[COLUMNS]
    return CorrectionRun(frame, start, corrector.target, habit)
