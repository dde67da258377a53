"""The interval of partial η² from the noncentral F distribution."""

from dataclasses import dataclass

from scipy import special
from scipy.optimize import brentq

from trustlab.models.checks import not_negative, open_unit, positive


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


# Noncentrality beyond which the noncentral F of SciPy fails; the form for large λ has nine digits there, and η² all of its own.
_LARGE = 1e9


def noncentrality_limit(f: float, df1: float, df2: float, probability: float) -> float:
    """Return the λ ≥ 0 at which P(F′ ≤ f | λ) is `probability`; 0 where it is less even at λ = 0."""
    # F′ df1/df2 = χ′²(λ)/χ²(df2), where χ′²(λ) = λ + df1 to within √λ: only the denominator is left to vary.
    large = df1 * (f * float(special.chdtri(df2, probability)) / df2 - 1.0)
    if large > _LARGE:
        return large

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
    λ / (λ + df1 + df2): λ = n (k − 1) η²/(1 − η²) in the population (`noncentrality`), and n (k − 1) = df1 + df2. Where
    the test is corrected, both degrees of freedom are those times ε, and λ is ε times that of the uncorrected F (Box,
    1954). Steiger (2004) has one more below, for designs between subjects. The customary level is 0.90: its lower limit
    is above 0 where the test's p is below 0.05.

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
    f, level = not_negative("f", f), open_unit("level", level)
    df1, df2 = positive("df1", df1), positive("df2", df2)
    tail = 0.5 * (1.0 - level)
    low = noncentrality_limit(f, df1, df2, 1.0 - tail)
    high = noncentrality_limit(f, df1, df2, tail)
    total = df1 + df2
    return PartialEtaInterval(low / (low + total), high / (high + total), low, high, level)
