"""Rules that allocate control: thresholds of TSC (2.8), Algorithm 2, or a user's own."""

from copy import deepcopy
from dataclasses import dataclass
from typing import Any

import numpy as np

from trustlab.models.checks import (
    finite_number,
    in_order,
    not_negative,
    shown,
    whole_number,
)
from trustlab.models.compiled import njit
from trustlab.models.simulation import asked
from trustlab.models.tsc import threshold_mode

# How far below P_max, as a share of P_max − P_min, performance still counts as P_max in Algorithm
# 2. As printed it is 0, which a measured performance never meets exactly; 0.05 is half-way to 0.9
# (P_max − P_min), where manual is suggested.
PERFORMANCE_TOLERANCE = 0.05


@njit
def performance_suggestion(p_r, p_min, p_max, tolerance=PERFORMANCE_TOLERANCE):
    """
    Return what Algorithm 2 suggests: 0 near P_max, 1 at low performance, −1 (nothing) between.

    Performance is low up to P_min + 0.9(P_max − P_min).
    """
    if p_r >= p_max - tolerance * (p_max - p_min):
        return 0
    if p_r <= p_min + 0.9 * (p_max - p_min):
        return 1
    return -1


@dataclass(slots=True)
class ThresholdRule:
    """
    Rule (2.8): manual once TSC falls to TSC_l, autonomous once it rises to TSC_u.

    Thresholds and mode may be assigned while the rule runs; each step checks them.

    Parameters
    ----------
    lower, upper : float
        TSC_l and TSC_u, lower < upper.
    mode : int
        The initial mode: 1 manual, 0 autonomous.

    Raises
    ------
    ValueError
        If the thresholds are not finite or in the wrong order, or the mode is not 0 or 1.

    Examples
    --------
    >>> import trustlab as tl
    >>> rule = tl.ThresholdRule(lower=0.02, upper=0.45)
    >>> [rule.step(tsc=value) for value in (0.3, 0.5, 0.3, 0.0)]
    [1, 0, 0, 1]
    """

    lower: float
    upper: float
    mode: int = 1

    def __post_init__(self):
        self.lower, self.upper = in_order("lower", self.lower, "upper", self.upper)
        self.mode = whole_number("mode", self.mode, least=0, most=1)

    def step(self, tsc: float | None = None, p_r: float | None = None) -> int:
        """
        Return the mode for this sample and remember it.

        Parameters
        ----------
        tsc : float
            TSC now; needed.
        p_r : float, optional
            Robot performance. The rule does not use it; it is accepted so that both rules are
            called alike.

        Raises
        ------
        ValueError
            If TSC is not a finite number, or what was assigned is no rule; the mode stays.
        """
        numbers = type(self.lower) is type(self.upper) is float and type(self.mode) is int
        ordered = numbers and -np.inf < self.lower < self.upper < np.inf
        if not (ordered and 0 <= self.mode <= 1):  # assigned since
            self.__post_init__()
        tsc = finite_number("tsc, which rule (2.8) needs,", tsc)
        self.mode = int(threshold_mode(tsc, self.lower, self.upper, self.mode))
        return self.mode


@dataclass(frozen=True)
class PerformanceRule:
    """
    Algorithm 2: autonomous at P_r = P_max, manual where P_r is low, else nothing.

    P_r is low up to P_min + 0.9 (P_max − P_min).

    Parameters
    ----------
    p_min, p_max : float
        Least and greatest robot performance.
    tolerance : float
        How far below P_max, as a share of P_max − P_min, counts as P_max; 0 is as printed, which a
        measured performance never meets exactly.

    Raises
    ------
    ValueError
        If p_min is not below p_max, or the tolerance is outside [0, 0.1).

    Examples
    --------
    >>> import trustlab as tl
    >>> rule = tl.PerformanceRule(p_min=0.24, p_max=0.36)
    >>> [rule.step(p_r=p_r) for p_r in (0.30, 0.35, 0.36)]
    [1, None, 0]
    """

    p_min: float
    p_max: float
    tolerance: float = PERFORMANCE_TOLERANCE

    def __post_init__(self):
        low, high = in_order("p_min", self.p_min, "p_max", self.p_max)
        tolerance = not_negative("tolerance", self.tolerance)
        if not tolerance < 0.1:
            raise ValueError(
                f"tolerance must be below 0.1, where manual is suggested, got {tolerance}"
            )
        self.__dict__.update(p_min=low, p_max=high, tolerance=tolerance)

    def step(self, tsc: float | None = None, p_r: float | None = None) -> int | None:
        """
        Return the mode suggested, 1 or 0, or None for no suggestion.

        Parameters
        ----------
        tsc : float, optional
            TSC. The rule does not use it; it is accepted so that both rules are called alike.
        p_r : float
            Robot performance now; needed.

        Raises
        ------
        ValueError
            If P_r is not a finite number.
        """
        p_r = finite_number("p_r, which Algorithm 2 needs,", p_r)
        mode = int(performance_suggestion(p_r, self.p_min, self.p_max, self.tolerance))
        return None if mode < 0 else mode


def prepared_rule(rule: object, mode: int | None) -> tuple[Any, int]:
    """
    Return a rule and the mode before the first sample: the one given, else `rule.mode`, else 1.

    The rule comes back as a copy, so that a run leaves it as it is. A rule that has a mode is set
    to the one given.
    """
    if isinstance(rule, type) or not callable(getattr(rule, "step", None)):
        raise ValueError(
            "rule must have a method step(tsc=…, p_r=…) that returns 1 (manual), 0 (autonomous) or "
            "None (keep the mode), as objects of ThresholdRule and PerformanceRule have; got "
            f"{shown(rule)}"
        )
    rule = asked("rule must be one that copy.deepcopy can copy", deepcopy, rule)
    own = whole_number("rule.mode", getattr(rule, "mode", 1), least=0, most=1)
    mode = own if mode is None else whole_number("mode", mode, least=0, most=1)
    if mode != own and hasattr(rule, "mode"):
        rule.mode = mode
    return rule, mode


def decision(rule: Any, where: str, tsc: float, p_r: float) -> int | None:
    """
    Ask a rule for the mode, 1, 0 or None for the one that is on; `where` is the sample, for errors.
    """
    here = f"at {where}, with TSC = {tsc:.6g} and P_r = {p_r:.6g}"
    mode = asked(f"rule.step failed {here}", rule.step, tsc=tsc, p_r=p_r)
    if mode is None:
        return None
    if isinstance(mode, bool | np.bool_):
        return int(mode)
    name = f"what rule.step returns (1 manual, 0 autonomous, None to keep the mode) {here}"
    return whole_number(name, mode, least=0, most=1)
