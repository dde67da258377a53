"""The interval of partial η² from the noncentral F distribution."""

from __future__ import annotations

from dataclasses import dataclass

from scipy import special
from scipy.optimize import brentq

from trustlab.models.checks import finite_number, open_unit

__all__ = ["PartialEtaInterval", "noncentrality_limit", "partial_eta_interval"]


@dataclass(frozen=True)
class PartialEtaInterval:
    """
    Interval of partial η² and of the noncentrality it comes from.

    Parameters
    ----------
    low, high : float
        Limits of partial η².
    noncentrality_low, noncentrality_high : float
        Limits of λ.
    level : float
        Coverage.
    """

    low: float
    high: float
    noncentrality_low: float
    noncentrality_high: float
    level: float


def noncentrality_limit(f: float, df1: float, df2: float, probability: float) -> float:
    """
    Return the λ ≥ 0 at which P(F′ ≤ f | λ) is `probability`; 0 where even λ = 0 gives less.

    Parameters
    ----------
    f : float
        Observed F.
    df1, df2 : float
        Degrees of freedom.
    probability : float
        In (0, 1).
    """

    def excess(noncentrality: float) -> float:
        return float(special.ncfdtr(df1, df2, noncentrality, f)) - probability

    if excess(0.0) <= 0.0:
        return 0.0
    high = max(1.0, 2.0 * df1 * f)
    while excess(high) > 0.0:
        high *= 2.0
    return float(brentq(excess, 0.0, high, xtol=1e-12 * high, rtol=1e-13, maxiter=500))


def partial_eta_interval(f: float, df1: float, df2: float, level: float = 0.90) -> PartialEtaInterval:
    """
    Return the interval of partial η² that inverts the noncentral F distribution.

    With λ_low and λ_high such that P(F′ ≥ f | λ_low) = P(F′ ≤ f | λ_high) = (1 − level)/2, the limits are
    λ / (λ + df1 + df2 + 1) (Steiger, 2004; Smithson, 2003). Some programs put λ + df2 below: take λ from the result
    for those. The customary level is 0.90: its lower limit is above 0 where the test's p is below 0.05.

    Parameters
    ----------
    f : float
        Observed F, at least 0.
    df1, df2 : float
        Degrees of freedom, above 0.
    level : float
        Coverage, in (0, 1).

    Raises
    ------
    ValueError
        If F is negative or a number is not finite.
    """
    f, df1, df2 = finite_number("f", f), finite_number("df1", df1), finite_number("df2", df2)
    level = open_unit("level", level)
    if f < 0.0:
        raise ValueError(f"f must be at least 0, got {f}")
    if df1 <= 0.0 or df2 <= 0.0:
        raise ValueError(f"df1 and df2 must be above 0, got {df1} and {df2}")
    tail = 0.5 * (1.0 - level)
    low = noncentrality_limit(f, df1, df2, 1.0 - tail)
    high = noncentrality_limit(f, df1, df2, tail)
    total = df1 + df2 + 1.0
    return PartialEtaInterval(low / (low + total), high / (high + total), low, high, level)
