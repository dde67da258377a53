"""Limits within which thresholds keep switching, (2.9)-(2.10), and largest one-step changes."""

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import pandas as pd

from trustlab.models.checks import (
    between,
    finite_number,
    in_order,
    not_negative,
    of_class,
    shown,
)
from trustlab.models.display import Result
from trustlab.models.tsc import TscConstants, TscModel, human_range, next_utilization


@dataclass(frozen=True)
class StepBounds:
    """
    Largest one-step changes.

    Parameters
    ----------
    delta_p_h, delta_p_r : float
        δ_Ph and δ_Pr, of human and robot performance.
    delta_tsc : float
        δ_TSC = a_T δ_Pr + b_T δ_Ph (Remark 3).
    """

    delta_p_h: float
    delta_p_r: float
    delta_tsc: float


def step_bounds(tsc: TscModel, r_low: float = 0.05, r_high: float = 0.95) -> StepBounds:
    """
    Return the largest one-step changes that (2.3), (2.5) and (2.6) allow.

    Parameters
    ----------
    tsc : TscModel
        The model.
    r_low, r_high : float
        Range of utilization that is considered. (2.6) is infinitely steep at rest and at full load,
        so that δ_Ph over all of [0, 1] is of no use; the dissertation takes δ from the fitted
        curves of an experiment, which keeps away from both ends.

    Returns
    -------
    StepBounds
        Suprema over both modes, over r in [r_low, r_high] and P_r in [p_min, p_max].

    Raises
    ------
    ValueError
        If `tsc` is not a `TscModel`, or the range is not within [0, 1].
    """
    of_class("tsc", tsc, TscModel)
    low = between("r_low", r_low, 0.0, 1.0)
    high = between("r_high", r_high, 0.0, 1.0)
    in_order("r_low", low, "r_high", high)
    human, robot = tsc.human, tsc.robot
    delta_p_h = 0.0
    for mode in (0.0, 1.0):
        r = np.linspace(low, high, 4001)
        for _ in range(3):  # the last grid lies between the neighbours of the best point before
            after = next_utilization.py_func(r, mode, human.a)
            change = np.abs(human.performance(after) - human.performance(r))
            k = int(np.argmax(change))
            r = np.linspace(r[max(k - 1, 0)], r[min(k + 1, 4000)], 4001)
        delta_p_h = max(delta_p_h, float(change[k]))
    least, most = human_range(low, high, tsc.constants())
    falls = (1.0 - robot.a) * (robot.p_max - robot.p_min) - robot.b * min(least, 0.0)
    delta_p_r = max(falls, robot.b * most)
    return StepBounds(delta_p_h, delta_p_r, tsc.delta(delta_p_r, delta_p_h))


@dataclass(frozen=True, repr=False)
class ThresholdLimits(Result):
    """
    Limits of the decision thresholds.

    Parameters
    ----------
    lower, upper : float
        TSC_lb (2.9) and TSC_ub (2.10): TSC_lb < TSC_l < TSC_u < TSC_ub keeps the rule switching
        (Theorem 1).
    delta_p_h : float
        δ_Ph, the largest one-step change of human performance that was used.
    """

    lower: float
    upper: float
    delta_p_h: float

    title = "Limits of the thresholds"

    @property
    def feasible(self) -> bool:
        """Whether any thresholds fit between the limits (Remark 4)."""
        return self.lower < self.upper

    def contains(self, lower: float, upper: float) -> bool:
        """
        Return whether TSC_lb < TSC_l < TSC_u < TSC_ub.

        Parameters
        ----------
        lower, upper : float
            TSC_l and TSC_u.

        Raises
        ------
        ValueError
            If a threshold is not a finite number.
        """
        return (
            self.lower < finite_number("lower", lower) < finite_number("upper", upper) < self.upper
        )

    @property
    def message(self) -> str:
        """The limits, or that none fit."""
        ends = f"TSC_lb = {self.lower:.4f} and TSC_ub = {self.upper:.4f} at δ_Ph = "
        ends += f"{self.delta_p_h:.3g}"
        return ends if self.feasible else f"{ends}, between which no thresholds fit (Remark 4)"

    def table(self) -> pd.DataFrame:
        """Return the limits in one row: lower, upper, delta_p_h, feasible."""
        return pd.DataFrame([asdict(self) | {"feasible": self.feasible}])


def limits_as_printed(c: TscConstants, delta_p_h: float) -> tuple[Any, Any]:
    """Return TSC_lb (2.9) and TSC_ub (2.10); the constants and δ_Ph may be arrays."""
    slack = c.b_T * delta_p_h / (c.a_T * (1.0 - c.a_pr))
    slope = c.a_T * c.b_pr / (1.0 - c.a_pr) - c.b_T
    lower = c.a_T * (c.p_r_min + slack) - c.b_T * c.p_h_min
    # (2.10) must hold for every P_h, so that the limit is the least of a line over [P_h,min,
    # P_h,max]: one of its ends.
    upper = c.a_T * (c.p_r_min - slack) + slope * np.where(slope < 0.0, c.p_h_max, c.p_h_min)
    return lower, upper


def threshold_limits(tsc: TscModel, delta_p_h: float | None = 0.0) -> ThresholdLimits:
    """
    Return the limits of the decision thresholds, (2.9)-(2.10).

    TSC_lb = a_T b'_1 − b_T P_h,min with b'_1 = P_r,min + b_T δ_Ph/(a_T (1 − a_pr)); TSC_ub = a'_3
    P_h + b'_3 at P_h,max where a'_3 < 0 and at P_h,min where a'_3 > 0, with a'_3 = a_T b_pr/(1 −
    a_pr) − b_T and b'_3 = a_T (P_r,min − b_T δ_Ph/(a_T (1 − a_pr))).

    Parameters
    ----------
    tsc : TscModel
        The model; its robot's b is used as it is (the printed limits come from the printed, rounded
        b_pr).
    delta_p_h : float, optional
        δ_Ph, largest one-step change of human performance. 0, as where TSC settles, gives the
        widest limits; None takes the model's own, `step_bounds`; printed limits have a printed one.

    Raises
    ------
    ValueError
        If `tsc` is not a `TscModel`, or `delta_p_h` is negative or not finite.

    Examples
    --------
    >>> import trustlab as tl
    >>> limits = tl.threshold_limits(tl.published_models()["2"])
    >>> round(limits.lower, 3), round(limits.upper, 3)
    (-0.548, 0.548)
    """
    of_class("tsc", tsc, TscModel)
    if delta_p_h is None:
        delta_p_h = step_bounds(tsc).delta_p_h
    lower, upper = limits_as_printed(tsc.constants(), not_negative("delta_p_h", delta_p_h))
    return ThresholdLimits(float(lower), float(upper), float(delta_p_h))


def check_thresholds(tsc: TscModel, pair: tuple[float, float]) -> tuple[float, float]:
    """Return two thresholds as floats if they keep within the limits of Theorem 1 at δ_Ph = 0."""
    limits = threshold_limits(tsc)
    lower, upper = threshold_pair("threshold", pair)
    if not limits.contains(lower, upper):
        widen = "" if limits.feasible else "; widen the range of robot performance (p_max − p_min)"
        raise ValueError(
            f"by Theorem 1 thresholds, here ({lower:g}, {upper:g}), must lie strictly between "
            f"{limits.message}{widen}"
        )
    return lower, upper


def threshold_pair(name: str, pair: tuple[float, float], most: float = 1.0) -> tuple[float, float]:
    """Return two thresholds, lower and upper, as floats in ± most: TSC lies in ± 1 by (2.2)."""
    try:
        lower, upper = pair
    except (TypeError, ValueError):
        raise ValueError(
            f"{name} must be two numbers, lower and upper, got {shown(pair)}"
        ) from None
    low, high = f"the lower {name}", f"the upper {name}"
    lower, upper = in_order(low, lower, high, upper)
    return between(low, lower, -most, most), between(high, upper, -most, most)
