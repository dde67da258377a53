"""Limits within which thresholds keep switching, (2.9)-(2.10), and largest one-step changes."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from trustlab.models.checks import (
    between,
    finite_number,
    in_order,
    not_negative,
    of_class,
    rounded_down,
    shown,
)
from trustlab.models.display import as_html
from trustlab.models.tsc import TscConstants, TscModel, next_utilization


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
    human = tsc.human
    robot = tsc.robot
    grid = np.linspace(low, high, 4001)
    best = 0.0
    for mode in (0.0, 1.0):
        for _ in range(6):
            after = next_utilization.py_func(grid, mode, human.a)
            change = np.abs(human.performance(after) - human.performance(grid))
            k = int(np.argmax(change))
            best = max(best, float(change[k]))
            grid = np.linspace(grid[max(k - 1, 0)], grid[min(k + 1, grid.size - 1)], 401)
        grid = np.linspace(low, high, 4001)
    ceiling = robot.p_min + robot.b * human.p_max / (1.0 - robot.a)
    delta_p_r = (1.0 - robot.a) * max(robot.p_max - robot.p_min, ceiling - robot.p_min)
    return StepBounds(best, delta_p_r, tsc.delta(delta_p_r, best))


@dataclass(frozen=True)
class ThresholdLimits:
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

    how_to_get = "trustlab.threshold_limits(tsc) returns them"

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

    def __str__(self) -> str:
        if not self.feasible:
            return (
                f"none at δ_Ph = {self.delta_p_h:.3g} (TSC_lb = {self.lower:.4f}, TSC_ub = "
                f"{self.upper:.4f})"
            )
        return (
            f"TSC_lb = {self.lower:.4f} and TSC_ub = {self.upper:.4f} at δ_Ph = "
            f"{self.delta_p_h:.3g}"
        )

    def _repr_html_(self) -> str:
        room = (
            "thresholds fit between them"
            if self.feasible
            else "no thresholds fit between them (Remark 4)"
        )
        columns = {
            "TSC_lb": self.lower,
            "TSC_ub": self.upper,
            "δ_Ph": self.delta_p_h,
            "feasible": self.feasible,
        }
        return as_html(room, pd.DataFrame([columns]))

    def __repr__(self) -> str:
        return (
            f"ThresholdLimits(lower={self.lower:.6g}, upper={self.upper:.6g}, "
            f"delta_p_h={self.delta_p_h:.4g}, feasible={self.feasible})"
        )


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


def check_thresholds(
    tsc: TscModel, lower: float, upper: float, limits: ThresholdLimits | None = None
) -> tuple[float, float]:
    """Return two thresholds as floats if they are finite, in order, and within limits, if given."""
    of_class("tsc", tsc, TscModel)
    lower, upper = in_order("lower", lower, "upper", upper)
    if limits is None:
        return lower, upper
    of_class("limits", limits, ThresholdLimits)
    if not limits.feasible:
        raise ValueError(
            f"no thresholds keep switching: at δ_Ph = {limits.delta_p_h:.3g} TSC_ub = "
            f"{limits.upper:.4f} does not exceed TSC_lb = {limits.lower:.4f} (Remark 4). "
            f"{_remedy(tsc, limits)}"
        )
    if not limits.contains(lower, upper):
        raise ValueError(
            f"thresholds ({lower:g}, {upper:g}) must lie strictly between TSC_lb = "
            f"{limits.lower:.4f} and TSC_ub = {limits.upper:.4f} (Theorem 1 at δ_Ph = "
            f"{limits.delta_p_h:.3g})"
        )
    return lower, upper


def _remedy(tsc: TscModel, limits: ThresholdLimits) -> str:
    """Say which parameter keeps the limits apart."""
    slack = tsc.b_T * limits.delta_p_h / (1.0 - tsc.robot.a)
    gap = limits.upper - limits.lower + 2.0 * slack
    if gap > 0.0:
        most = gap / 2.0 * (1.0 - tsc.robot.a) / tsc.b_T
        return (
            f"δ_Ph = {limits.delta_p_h:.3g} is too large: below {rounded_down(most):g} they part; "
            "let utilization change more slowly (a_r nearer to 1) or robot performance more "
            "quickly (a_pr smaller)"
        )
    return (
        "Even with δ_Ph = 0 they do not part: widen the range of robot performance (p_max − "
        "p_min) or narrow that of human performance"
    )


def threshold_pair(name: str, pair: tuple[float, float]) -> tuple[float, float]:
    """Return two thresholds, lower and upper, as floats in [−1, 1], where TSC lies by (2.2)."""
    try:
        lower, upper = pair
    except (TypeError, ValueError):
        raise ValueError(
            f"{name} must be two numbers, lower and upper, got {shown(pair)}"
        ) from None
    low = f"the lower {name}"
    high = f"the upper {name}"
    in_order(low, lower, high, upper)
    return between(low, lower, -1.0, 1.0), between(high, upper, -1.0, 1.0)
