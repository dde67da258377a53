"""Sphericity of the contrasts: Mauchly's test, Greenhouse–Geisser and Huynh–Feldt ε; arrays of studies at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import special

__all__ = [
    "Mauchly",
    "greenhouse_geisser",
    "huynh_feldt",
    "mauchly",
    "mauchly_factor",
    "mauchly_p_value",
    "orthonormal_contrasts",
]

_RELATIVE_RANK = 1e-14
"""Least ratio of eigenvalues that double precision tells from zero in a covariance matrix."""


def orthonormal_contrasts(k: int) -> np.ndarray:
    """
    Return Helmert contrasts of unit length.

    Parameters
    ----------
    k : int
        Number of conditions, at least 2.

    Returns
    -------
    numpy.ndarray, shape (k, k − 1)
        Orthonormal columns, each orthogonal to the constant.
    """
    contrasts = np.zeros((k, k - 1))
    for j in range(1, k):
        contrasts[:j, j - 1] = 1.0
        contrasts[j, j - 1] = -j
        contrasts[:, j - 1] /= np.sqrt(j * (j + 1.0))
    return contrasts


def greenhouse_geisser(covariance: np.ndarray) -> np.ndarray:
    """
    Return ε = (tr M)² / (d tr M²), between 1/d and 1; defined for a singular M too.

    Parameters
    ----------
    covariance : numpy.ndarray, shape (..., d, d)
        Covariance M of orthonormal contrasts.
    """
    d = covariance.shape[-1]
    trace = np.trace(covariance, axis1=-2, axis2=-1)
    square = ((covariance / trace[..., None, None]) ** 2).sum(axis=(-2, -1))
    return np.clip(1.0 / (d * square), 1.0 / d, 1.0)  # the bounds are exact: only rounding is cut


def huynh_feldt(epsilon_gg: np.ndarray, n: int, d: int) -> np.ndarray:
    """
    Return (n d ε − 2) / (d (n − 1 − d ε)), not truncated at 1.

    This is the formula of car and afex. Lecoutre's correction of it concerns designs with groups: with one group
    of subjects, as here, both are the same.

    Parameters
    ----------
    epsilon_gg : numpy.ndarray
        Greenhouse–Geisser ε.
    n : int
        Number of subjects.
    d : int
        Number of conditions less one.
    """
    if d == 1:
        return np.ones_like(epsilon_gg)
    below = d * (n - 1 - d * epsilon_gg)
    undefined = below <= 1e-12 * n
    return np.where(undefined, np.inf, (n * d * epsilon_gg - 2.0) / np.where(undefined, 1.0, below))


@dataclass(frozen=True, eq=False)
class Mauchly:
    """
    Mauchly's test; NaN where it is not defined.

    Parameters
    ----------
    w : numpy.ndarray
        W = det M / (tr M / d)^d.
    chi2 : numpy.ndarray
        −(n − 1) ρ ln W.
    df : int
        d (d + 1)/2 − 1.
    p : numpy.ndarray
        With the second-order term.
    p_first_order : numpy.ndarray
        Upper tail of χ² alone.
    singular : numpy.ndarray of bool
        Where M has no full rank, so that W is zero whatever the population is.
    """

    w: np.ndarray
    chi2: np.ndarray
    df: int
    p: np.ndarray
    p_first_order: np.ndarray
    singular: np.ndarray


def mauchly_factor(n: int, k: int) -> float:
    """
    Return (n − 1) ρ with ρ = 1 − (2d² + d + 2) / (6 d (n − 1)), d = k − 1, so that χ² = −(n − 1) ρ ln W.

    Parameters
    ----------
    n, k : int
        Subjects and conditions, n ≥ k ≥ 3.
    """
    d = k - 1
    return n - 1 - (2 * d**2 + d + 2) / (6 * d)


def mauchly_p_value(chi2: np.ndarray, n: int, k: int) -> np.ndarray:
    """
    Return the p-value of Mauchly's χ² to second order, as R and SPSS print it.

    p = P_f + w₂ (P_{f+4} − P_f) with f = d (d + 1)/2 − 1 and w₂ = (d+2)(d−1)(d−2)(2d³ + 6d² + 3k + 2) / (288 ((n−1) d ρ)²),
    d = k − 1. The expansion can pass 1 by some thousandths when n is hardly above k; it is then given as 1.

    Parameters
    ----------
    chi2 : numpy.ndarray
        χ² as `mauchly` gives it.
    n, k : int
        Subjects and conditions, n ≥ k ≥ 3.
    """
    d = k - 1
    df = d * (d + 1) // 2 - 1
    w2 = (
        (d + 2)
        * (d - 1)
        * (d - 2)
        * (2 * d**3 + 6 * d**2 + 3 * k + 2)
        / (288 * (d * mauchly_factor(n, k)) ** 2)
    )
    first = special.chdtrc(df, chi2)
    return np.minimum(first + w2 * (special.chdtrc(df + 4, chi2) - first), 1.0)


def mauchly(covariance: np.ndarray, n: int, floor: np.ndarray | float = 0.0) -> Mauchly:
    """
    Test whether contrasts have equal variances and no correlation (Mauchly, 1940).

    The p-value follows Anderson (2003) to second order (see `mauchly_p_value`) with k, the number of conditions, in one
    place of w₂ where Anderson has d = k − 1: the convention of R (mauchly.test, car, afex), SPSS and pingouin. Not
    defined for d = 1 (nothing to test) and for n − 1 < d (W is zero by counting).

    Parameters
    ----------
    covariance : numpy.ndarray, shape (..., d, d)
        Covariance M of orthonormal contrasts, with divisor n − 1.
    n : int
        Number of subjects.
    floor : numpy.ndarray or float
        Variance that rounding of the scores alone can cause; an eigenvalue below it counts as zero.
    """
    d = covariance.shape[-1]
    shape = covariance.shape[:-2]
    df = d * (d + 1) // 2 - 1
    if d == 1 or n - 1 < d:
        nan = np.full(shape, np.nan)
        return Mauchly(nan, nan, df, nan, nan, np.full(shape, n - 1 < d))
    sign, log_det = np.linalg.slogdet(covariance)
    trace = np.trace(covariance, axis1=-2, axis2=-1)
    log_w = np.minimum(log_det - d * np.log(trace / d), 0.0)
    singular = sign <= 0
    doubtful = singular | (log_w < np.log(1e-10)) | (trace * _RELATIVE_RANK < floor)
    if doubtful.any():  # λ_min/λ_max ≤ 10⁻¹⁴ implies W ≤ e d 10⁻¹⁴, so that few need their eigenvalues
        eigenvalues = np.linalg.eigvalsh(covariance[doubtful])
        least = np.maximum(d * _RELATIVE_RANK * eigenvalues[..., -1], np.broadcast_to(floor, shape)[doubtful])
        singular = singular.copy()
        singular[doubtful] = eigenvalues[..., 0] <= least
    log_w = np.where(singular, np.nan, log_w)
    chi2 = -mauchly_factor(n, d + 1) * log_w
    p, first = mauchly_p_value(chi2, n, d + 1), special.chdtrc(df, chi2)
    return Mauchly(np.exp(log_w), chi2, df, p, first, singular)
