"""Descriptive statistics of conditions, and intervals of partial η²."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from scipy import special
from scipy.optimize import brentq

from trustlab.models.checks import not_negative, open_unit, positive
from trustlab.studies.analysis.score_table import ScoreTable


def t_half_width(sd: Any, n: int, level: float = 0.95) -> Any:
    """Return half the width of the interval of a mean of n values, t · sd / √n."""
    return special.stdtrit(n - 1, 0.5 + 0.5 * level) * sd / np.sqrt(n)


def within_subject_sd(values: np.ndarray) -> np.ndarray:
    """
    Return each condition's standard deviation of scores less their subject's mean, times √(k/(k −
    1)).

    Removing the subjects' means (Cousineau, 2005) leaves the spread that a comparison within
    subjects sees; the factor (Morey, 2008) compensates for the variance that this removes. For k =
    2 the interval is 1/√2 times that of the paired difference.
    """
    k = values.shape[1]
    centred = values - values.mean()  # a common offset would cost digits in the subjects' means
    return (centred - centred.mean(axis=1, keepdims=True)).std(axis=0, ddof=1) * np.sqrt(
        k / (k - 1.0)
    )


def describe(scores: ScoreTable, level: float = 0.95) -> pd.DataFrame:
    """
    Return a row per condition: condition n mean sd se median minimum maximum, and both intervals of
    the mean.
    """
    values = scores.values
    n = len(values)
    mean, sd = values.mean(axis=0), values.std(axis=0, ddof=1)
    between, within = t_half_width(sd, n, level), t_half_width(within_subject_sd(values), n, level)
    columns = {
        "condition": pd.Index(scores.conditions, tupleize_cols=False),
        "n": n,
        "mean": mean,
        "sd": sd,
        "se": sd / np.sqrt(n),
        "median": np.median(values, axis=0),
        "minimum": values.min(axis=0),
        "maximum": values.max(axis=0),
        "ci_low": mean - between,
        "ci_high": mean + between,
        "ci_low_within": mean - within,
        "ci_high_within": mean + within,
    }
    return pd.DataFrame(columns)


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


# Beyond this noncentrality SciPy's noncentral F fails; the form for large λ has nine digits there,
# and η² is exact to double precision.
_LARGE = 1e9


def noncentrality_limit(f: float, df1: float, df2: float, probability: float) -> float:
    """
    Return the λ ≥ 0 at which P(F′ ≤ f | λ) is `probability`; 0 where it is less even at λ = 0.
    """
    # F′ df1/df2 = χ′²(λ)/χ²(df2), where χ′²(λ) = λ + df1 to within √λ: only the denominator is left
    # to vary.
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


def partial_eta_interval(
    f: float, df1: float, df2: float, level: float = 0.90
) -> PartialEtaInterval:
    """
    Return the interval of partial η² that inverts the noncentral F distribution.

    With λ_low and λ_high such that P(F′ ≥ f | λ_low) = P(F′ ≤ f | λ_high) = (1 − level)/2, the
    limits are λ / (λ + df1 + df2): λ = n (k − 1) η²/(1 − η²) in the population (`noncentrality`),
    and n (k − 1) = df1 + df2. Where the test is corrected, both degrees of freedom are those times
    ε, and λ is ε times that of the uncorrected F (Box, 1954). Steiger (2004) has one more below,
    for designs between subjects. The customary level is 0.90: its lower limit is above 0 where the
    test's p is below 0.05.

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
    low, high = noncentrality_interval(f, df1, df2, level)
    total = df1 + df2
    return PartialEtaInterval(low / (low + total), high / (high + total), low, high, level)


def noncentrality_interval(f: float, df1: float, df2: float, level: float) -> tuple[float, float]:
    """Return the interval of λ that inverts the noncentral F distribution."""
    tail = 0.5 * (1.0 - level)
    low = noncentrality_limit(f, df1, df2, 1.0 - tail)
    return low, noncentrality_limit(f, df1, df2, tail)
