"""Limits within which thresholds keep switching, (2.9)-(2.10) and Theorem 1."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trustlab.allocation.step_bounds import step_bounds
from trustlab.models.checks import finite_number, of_class
from trustlab.models.tsc import TscConstants, TscModel

__all__ = ["ThresholdLimits", "check_thresholds", "limits_as_printed", "threshold_limits"]


@dataclass(frozen=True)
class ThresholdLimits:
    """
    Limits of the decision thresholds.

    Parameters
    ----------
    lower, upper : float
        TSC_lb (2.9) and TSC_ub (2.10): TSC_lb < TSC_l < TSC_u < TSC_ub keeps the rule switching (Theorem 1).
    delta_p_h : float
        δ_Ph, the largest one-step change of human performance that was used.
    """

    lower: float
    upper: float
    delta_p_h: float

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
        return self.lower < finite_number("lower", lower) < finite_number("upper", upper) < self.upper

    def __str__(self) -> str:
        if not self.feasible:
            return (
                f"none at δ_Ph = {self.delta_p_h:.3g} (TSC_lb = {self.lower:.4f}, TSC_ub = {self.upper:.4f})"
            )
        return f"TSC_lb = {self.lower:.4f} and TSC_ub = {self.upper:.4f} at δ_Ph = {self.delta_p_h:.3g}"

    def _repr_html_(self) -> str:
        room = "thresholds fit between them" if self.feasible else "no thresholds fit between them (Remark 4)"
        return (
            "<table><tr><th>TSC_lb</th><th>TSC_ub</th><th>δ_Ph</th><th>feasible</th></tr>"
            f"<tr><td>{self.lower:.4f}</td><td>{self.upper:.4f}</td><td>{self.delta_p_h:.3g}</td><td>{self.feasible}: "
            f"{room}</td></tr></table>"
        )

    def __repr__(self) -> str:
        return (
            f"ThresholdLimits(lower={self.lower:.6g}, upper={self.upper:.6g}, delta_p_h={self.delta_p_h:.4g}, "
            f"feasible={self.feasible})"
        )


def limits_as_printed(c: TscConstants, delta_p_h: float) -> tuple[np.ndarray, np.ndarray]:
    """Return TSC_lb (2.9) and TSC_ub (2.10); the constants and δ_Ph may be arrays."""
    slack = c.b_T * delta_p_h / (c.a_T * (1.0 - c.a_pr))
    slope = c.a_T * c.b_pr / (1.0 - c.a_pr) - c.b_T
    lower = c.a_T * (c.p_r_min + slack) - c.b_T * c.p_h_min
    # (2.10) must hold for every P_h, so that the limit is the least of a line over [P_h,min, P_h,max]: one of its ends.
    upper = c.a_T * (c.p_r_min - slack) + slope * np.where(slope < 0.0, c.p_h_max, c.p_h_min)
    return lower, upper


def threshold_limits(tsc: TscModel, delta_p_h: float | None = None) -> ThresholdLimits:
    """
    Return the limits of the decision thresholds, (2.9)-(2.10).

    TSC_lb = a_T b'_1 − b_T P_h,min with b'_1 = P_r,min + b_T δ_Ph/(a_T (1 − a_pr)); TSC_ub = a'_3 P_h + b'_3 at
    P_h,max where a'_3 < 0 and at P_h,min where a'_3 > 0, with a'_3 = a_T b_pr/(1 − a_pr) − b_T and
    b'_3 = a_T (P_r,min − b_T δ_Ph/(a_T (1 − a_pr))).

    Parameters
    ----------
    tsc : TscModel
        The model; its robot's b is used as it is (the printed limits come from the printed, rounded b_pr).
    delta_p_h : float, optional
        δ_Ph, largest one-step change of human performance; from the model (`step_bounds`) when not given.

    Raises
    ------
    ValueError
        If `tsc` is not a `TscModel`, or `delta_p_h` is negative or not finite.
    """
    of_class("tsc", tsc, TscModel)
    if delta_p_h is None:
        delta_p_h = step_bounds(tsc).delta_p_h
    delta_p_h = finite_number("delta_p_h", delta_p_h)
    if delta_p_h < 0.0:
        raise ValueError(f"delta_p_h is a largest change and cannot be negative, got {delta_p_h}")
    lower, upper = limits_as_printed(tsc.constants(), delta_p_h)
    return ThresholdLimits(float(lower), float(upper), delta_p_h)


def check_thresholds(
    tsc: TscModel, lower: float, upper: float, limits: ThresholdLimits | None = None
) -> tuple[float, float]:
    """
    Return thresholds as floats, or say what is wrong with them.

    Parameters
    ----------
    tsc : TscModel
        The model.
    lower, upper : float
        TSC_l and TSC_u.
    limits : ThresholdLimits, optional
        Limits they must keep; only their order is checked when not given.

    Raises
    ------
    ValueError
        If they are not finite, in the wrong order, or outside the limits, which are quoted.
    """
    of_class("tsc", tsc, TscModel)
    if limits is not None:
        of_class("limits", limits, ThresholdLimits, "threshold_limits(tsc) makes them")
    lower, upper = finite_number("lower", lower), finite_number("upper", upper)
    if not lower < upper:
        raise ValueError(f"the lower threshold must be below the upper one, got {lower} and {upper}")
    if limits is None:
        return lower, upper
    if not limits.feasible:
        raise ValueError(
            f"no thresholds keep switching: at δ_Ph = {limits.delta_p_h:.3g} TSC_ub = {limits.upper:.4f} does not exceed "
            f"TSC_lb = {limits.lower:.4f} (Remark 4). {_remedy(tsc, limits)}"
        )
    if not limits.contains(lower, upper):
        raise ValueError(
            f"thresholds ({lower:g}, {upper:g}) must lie strictly between TSC_lb = {limits.lower:.4f} and "
            f"TSC_ub = {limits.upper:.4f} (Theorem 1 at δ_Ph = {limits.delta_p_h:.3g})"
        )
    return lower, upper


def _remedy(tsc: TscModel, limits: ThresholdLimits) -> str:
    """Say which parameter keeps the limits apart."""
    slack = tsc.b_T * limits.delta_p_h / (1.0 - tsc.robot.a)
    gap = limits.upper - limits.lower + 2.0 * slack
    if gap > 0.0:
        most = gap / 2.0 * (1.0 - tsc.robot.a) / tsc.b_T
        return (
            f"δ_Ph = {limits.delta_p_h:.3g} is too large: below {most:.3g} they part; let utilization change more slowly "
            "(a_r nearer to 1) or robot performance more quickly (a_pr smaller)"
        )
    return (
        "Even with δ_Ph = 0 they do not part: widen the range of robot performance (p_max − p_min) or narrow that of "
        "human performance"
    )
