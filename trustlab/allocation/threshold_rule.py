"""The TSC-based switching rule (2.8), step by step."""

from __future__ import annotations

import math
from dataclasses import dataclass
from numbers import Real

from trustlab.models.checks import finite_number

__all__ = ["ThresholdRule"]


@dataclass
class ThresholdRule:
    """
    Manual when TSC has fallen to TSC_l, autonomous when it has risen to TSC_u, unchanged between, equation (2.8).

    Parameters
    ----------
    lower, upper : float
        TSC_l and TSC_u, lower < upper.
    mode : int
        The mode to begin with: 1 manual, 0 autonomous.

    Raises
    ------
    ValueError
        If the thresholds are not finite or in the wrong order, or the mode is not 0 or 1.

    Examples
    --------
    >>> rule = ThresholdRule(lower=0.02, upper=0.45)
    >>> [rule.step(tsc=value) for value in (0.3, 0.5, 0.3, 0.0)]
    [1, 0, 0, 1]
    """

    lower: float
    upper: float
    mode: int = 1

    def __post_init__(self):
        self.lower, self.upper = finite_number("lower", self.lower), finite_number("upper", self.upper)
        if not self.lower < self.upper:
            raise ValueError(
                f"the lower threshold must be below the upper one, got {self.lower} and {self.upper}"
            )
        if self.mode not in (0, 1):
            raise ValueError(f"mode must be 1 (manual) or 0 (autonomous), got {self.mode!r}")
        self.mode = int(self.mode)

    def step(self, tsc: float, p_r: float | None = None) -> int:
        """
        Return the mode for this sample and remember it.

        Parameters
        ----------
        tsc : float
            TSC now.
        p_r : float, optional
            Robot performance; the rule has no use for it, and takes it so that both rules are called alike.

        Raises
        ------
        ValueError
            If TSC is not a number; the mode stays what it was.
        """
        if not isinstance(tsc, Real) or not math.isfinite(tsc):
            raise ValueError(f"TSC is {tsc}; rule (2.8) needs a finite number, so the mode stays {self.mode}")
        if tsc >= self.upper:
            self.mode = 0
        elif tsc <= self.lower:
            self.mode = 1
        return self.mode
