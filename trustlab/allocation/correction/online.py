"""The correction on a robot: measured performance in at 10 Hz, suggestions out, Algorithm 3."""

import math
from dataclasses import dataclass
from time import perf_counter

import numpy as np
import pandas as pd

from trustlab.allocation.correction.corrector import ThresholdCorrector, check_mode, threshold_pair
from trustlab.allocation.correction.dynamics import suggestion_now
from trustlab.allocation.correction.incentive import ROUNDING
from trustlab.allocation.correction.plan import CorrectionStatus
from trustlab.models.checks import between, finite_number, of_class, one_of
from trustlab.models.display import axes_or_new
from trustlab.models.tsc import next_utilization, tsc_at


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
    status : CorrectionStatus
        How the plan was obtained; its value is a sentence that says what to do.
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
    status: CorrectionStatus
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
        status = CorrectionStatus.MISSING
        c_l = 0.0
        c_u = 0.0
        cost = math.nan
        bound = math.nan
        tsc = tsc_at.py_func(p_r, p_h, c)
        if math.isinf(tsc) or (tsc != tsc and p_r == p_r and p_h == p_h):
            raise ValueError(f"TSC overflows for p_r = {p_r} and p_h = {p_h}; check their unit")
        if tsc == tsc:
            suggestion = suggestion_now(tsc, lower, upper)
            slack = ROUNDING * (c.p_r_max - c.p_r_min)
            inside = c.p_r_min - slack <= p_r <= c.p_r_max + slack
            status = CorrectionStatus.OUTSIDE
            if inside or self._nearest:
                # The engine itself, as the state has been checked: a whole plan and its checks take
                # half as long again.
                state = self.r, min(max(p_r, c.p_r_min), c.p_r_max), lower, upper, now
                c_l, c_u, cost, bound, status = self.corrector.engine.decide(*state)
                if not inside and not status.held:
                    status = CorrectionStatus.NEAREST
        r = self.r
        self.lower = lower + c_l
        self.upper = upper + c_u
        self.mode = now
        self.r = min(max(next_utilization.py_func(r, now, c.a_r), 0.0), 1.0)
        sample = len(self._steps)
        latency = perf_counter() - began
        step = OnlineStep(
            sample, suggestion, tsc, lower, upper, c_l, c_u, r, cost, bound, status, latency
        )
        self._steps.append(step)
        return step

    def table(self) -> pd.DataFrame:
        """
        Return all samples so far.

        Returns
        -------
        pandas.DataFrame
            One row per sample; the fields of `OnlineStep`, status by name.
        """
        columns = {
            name: [getattr(step, name) for step in self._steps] for name in OnlineStep.__slots__
        }
        return pd.DataFrame(columns | {"status": [step.status.name for step in self._steps]})

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
