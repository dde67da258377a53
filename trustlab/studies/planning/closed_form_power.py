"""
Power in closed form: noncentral F where sphericity holds, Box's approximation elsewhere, and exact
binomial intervals.
"""

import numpy as np
from numpy.typing import ArrayLike
from scipy import special

from trustlab.models.checks import finite_number, not_negative, open_unit, whole_number


def noncentrality(eta2_partial: float, n: int, k: int) -> float:
    """
    Return λ = n (k − 1) η² / (1 − η²), the noncentrality of F at a population partial η².

    η² = S / (S + (k − 1) σ_e²) with S = Σ (μ_j − μ)² and σ_e² the mean variance of orthonormal
    contrasts, so that λ = n S / σ_e². With Cohen's f² = η² / (1 − η²).

    Parameters
    ----------
    eta2_partial : float
        Partial η² of the population, in [0, 1).
    n, k : int
        Subjects and conditions.

    Raises
    ------
    ValueError
        If η² lies outside [0, 1), or a number is not whole or too small.
    """
    eta2 = finite_number("eta2_partial", eta2_partial)
    if not 0.0 <= eta2 < 1.0:
        raise ValueError(f"eta2_partial must lie in [0, 1), got {eta2}")
    n, k = whole_number("n", n, least=2), whole_number("k", k, least=2)
    return n * (k - 1) * eta2 / (1.0 - eta2)


def noncentral_f_power(
    n: int, k: int, noncentrality: float, alpha: float = 0.05, epsilon: float = 1.0
) -> float:
    """
    Return the power of the repeated-measures F with n subjects and k conditions.

    With sphericity (ε = 1) F is exactly noncentral with k − 1 and (n − 1)(k − 1) degrees of
    freedom. Below 1 it is taken as noncentral F with both degrees of freedom and λ times ε, after
    Box: an approximation of the test with ε known, and no more than a guide. A paired t-test is the
    case k = 2 with λ = n d_z².

    Parameters
    ----------
    n, k : int
        Subjects and conditions; at least 2.
    noncentrality : float
        λ, not negative; `noncentrality(eta2_partial, n, k)` gives it.
    alpha : float
        Level of the test.
    epsilon : float
        ε of the population, from 1/(k − 1) to 1.

    Raises
    ------
    ValueError
        If an argument is out of range.

    References
    ----------
    G. E. P. Box, Annals of Mathematical Statistics 25 (1954) 290-302 and 484-498.
    """
    n, k = whole_number("n", n, least=2), whole_number("k", k, least=2)
    value = not_negative("noncentrality", noncentrality)
    alpha, epsilon = open_unit("alpha", alpha), finite_number("epsilon", epsilon)
    if not 1.0 / (k - 1) - 1e-12 <= epsilon <= 1.0 + 1e-12:
        raise ValueError(
            f"epsilon must lie in [1/(k − 1), 1] = [{1.0 / (k - 1):.4g}, 1], got {epsilon}"
        )
    df1, df2 = epsilon * (k - 1), epsilon * (k - 1) * (n - 1)
    critical = special.fdtri(df1, df2, 1.0 - alpha)
    return float(1.0 - special.ncfdtr(df1, df2, epsilon * value, critical))


def clopper_pearson(
    count: ArrayLike, total: int, level: float = 0.95
) -> tuple[np.ndarray, np.ndarray]:
    """
    Return the exact interval of a share of which `count` in `total` draws were found (Clopper and
    Pearson, 1934).

    Parameters
    ----------
    count : array_like of int
        How often, from 0 to `total`.
    total : int
        Draws.
    level : float
        Coverage.

    Returns
    -------
    low, high : numpy.ndarray
        Limits, of the shape of `count`.

    Raises
    ------
    ValueError
        If a count is not whole or lies outside 0 to `total`.
    """
    total, level = whole_number("total", total), open_unit("level", level)
    found = np.asarray(count)
    if found.dtype.kind not in "iu" or ((found < 0) | (found > total)).any():
        raise ValueError(f"count must hold whole numbers from 0 to {total}, got {count!r:.60}")
    from statsmodels.stats.proportion import proportion_confint

    low, high = proportion_confint(found, total, alpha=1.0 - level, method="beta")
    return np.asarray(low), np.asarray(high)
