"""Suggestions that maximise robot performance, Algorithm 2."""

from __future__ import annotations

from dataclasses import dataclass

from trustlab.allocation.kernels import PERFORMANCE_TOLERANCE, performance_suggestion
from trustlab.models.checks import finite_number

__all__ = ["PerformanceRule"]


@dataclass(frozen=True)
class PerformanceRule:
    """
    Suggest autonomous at P_r = P_max, manual at P_r ≤ P_min + 0.9 (P_max − P_min), else nothing (Algorithm 2).

    Parameters
    ----------
    p_min, p_max : float
        Least and greatest robot performance.
    tolerance : float
        How far below P_max, as a share of P_max − P_min, counts as P_max; 0 is as printed, which a measured
        performance never meets exactly.

    Raises
    ------
    ValueError
        If p_min is not below p_max, or the tolerance is outside [0, 0.1).
    """

    p_min: float
    p_max: float
    tolerance: float = PERFORMANCE_TOLERANCE

    def __post_init__(self):
        low, high = finite_number("p_min", self.p_min), finite_number("p_max", self.p_max)
        if not low < high:
            raise ValueError(f"p_min must be below p_max, got {low} and {high}")
        tolerance = finite_number("tolerance", self.tolerance)
        if not 0.0 <= tolerance < 0.1:
            raise ValueError(
                f"tolerance must lie in [0, 0.1), where manual is suggested from, got {tolerance}"
            )
        for name, value in (("p_min", low), ("p_max", high), ("tolerance", tolerance)):
            object.__setattr__(self, name, value)

    def step(self, p_r: float, tsc: float | None = None) -> int | None:
        """
        Return the mode suggested, 1 or 0, or None for no suggestion.

        Parameters
        ----------
        p_r : float
            Robot performance now.
        tsc : float, optional
            TSC; the rule has no use for it, and takes it so that both rules are called alike. It is checked all the
            same: a NaN in the loop that drives the rule should not go on unseen.

        Raises
        ------
        ValueError
            If a value given is not a finite number.
        """
        p_r = finite_number("p_r, which Algorithm 2 needs,", p_r)
        if tsc is not None:
            finite_number("tsc (unused by Algorithm 2)", tsc)
        found = int(performance_suggestion(p_r, self.p_min, self.p_max, self.tolerance))
        return None if found < 0 else found
