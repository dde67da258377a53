"""Sphericity: Mauchly's test, Greenhouse–Geisser and Huynh–Feldt ε, and the correction to use."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from scipy import special

CORRECTIONS = ("none", "greenhouse-geisser", "huynh-feldt")

# Smallest ratio of eigenvalues that double precision distinguishes from zero in a covariance
# matrix.
_RELATIVE_RANK = 1e-14


def orthonormal_contrasts(k: int) -> np.ndarray:
    """
    Return Helmert contrasts of unit length, shape (k, k − 1): orthonormal columns, orthogonal to
    the constant.
    """
    contrasts = np.zeros((k, k - 1))
    for j in range(1, k):
        contrasts[:j, j - 1] = 1.0
        contrasts[j, j - 1] = -j
        contrasts[:, j - 1] /= np.sqrt(j * (j + 1.0))
    return contrasts


def greenhouse_geisser(covariance: np.ndarray) -> np.ndarray:
    """
    Return ε = (tr M)² / (d tr M²) of covariances M of orthonormal contrasts, shape (..., d, d); M
    may be singular.
    """
    d = covariance.shape[-1]
    trace = np.trace(covariance, axis1=-2, axis2=-1)
    square = ((covariance / trace[..., None, None]) ** 2).sum(axis=(-2, -1))
    return np.clip(1.0 / (d * square), 1.0 / d, 1.0)  # the bounds are exact: only rounding is cut


def huynh_feldt(epsilon_gg: np.ndarray, n: int, d: int) -> np.ndarray:
    """
    Return (n d ε − 2) / (d (n − 1 − d ε)) for n subjects and d + 1 conditions, not truncated at 1.

    This is the formula of car and afex. Lecoutre's correction concerns designs with groups: with
    one group of subjects, as here, both are the same.
    """
    if d == 1:
        return np.ones_like(epsilon_gg)
    below = d * (n - 1 - d * epsilon_gg)
    undefined = below <= 1e-12 * n
    return np.where(undefined, np.inf, (n * d * epsilon_gg - 2.0) / np.where(undefined, 1.0, below))


def corrected_tests(
    ss_effect: np.ndarray, ss_error: np.ndarray, covariance: np.ndarray, q: int, df_error: int
) -> dict[str, np.ndarray]:
    """
    Return F, ε, partial η² and p under each correction of an effect of d contrasts times q columns
    of the between-subject design.

    `covariance` holds that of the d contrasts, on `df_error` degrees of freedom.
    """
    d = covariance.shape[-1]
    df1, df2 = d * q, d * df_error
    f = (ss_effect / df1) / (ss_error / df2)
    gg = np.ones(len(f)) if d == 1 else greenhouse_geisser(covariance)
    hf = huynh_feldt(gg, df_error + 1, d)
    cut = np.minimum(hf, 1.0)
    return {
        "F": f,
        "p": special.fdtrc(df1, df2, f),
        "eta2_partial": ss_effect / (ss_effect + ss_error),
        "epsilon_gg": gg,
        "epsilon_hf": cut,
        "epsilon_hf_untruncated": hf,
        "p_gg": special.fdtrc(gg * df1, gg * df2, f),
        "p_hf": special.fdtrc(cut * df1, cut * df2, f),
    }


class Mauchly(NamedTuple):
    """Mauchly's test of many studies; NaN where it is not defined or M has no full rank."""

    w: np.ndarray
    chi2: np.ndarray
    df: int
    p: np.ndarray
    p_first_order: np.ndarray


def mauchly_factor(n: Any, k: int) -> Any:
    """
    Return (n − 1) ρ with ρ = 1 − (2d² + d + 2) / (6 d (n − 1)), d = k − 1, so that χ² = −(n − 1) ρ
    ln W.
    """
    d = k - 1
    return n - 1 - (2 * d**2 + d + 2) / (6 * d)


def mauchly_p_value(chi2: Any, n: Any, k: int, cells: int | None = None) -> Any:
    """
    Return the p-value of Mauchly's χ² to second order, as R, SPSS, JASP, jamovi and pingouin print
    it; n ≥ k ≥ 3.

    p = P_f + w₂ (P_{f+4} − P_f) with f = d (d + 1)/2 − 1 and w₂ = (d+2)(d−1)(d−2)(2d³ + 6d² + 3k +
    2) / (288 ((n−1) d ρ)²), d = k − 1 (Anderson, 2003). The expansion can exceed 1 by some
    thousandths when n is hardly above k; it is then 1.
    """
    d = k - 1
    df = d * (d + 1) // 2 - 1
    # Anderson has d in the place of k; the packages named above all put k there, and printed values
    # come from them. In designs of several factors R puts the number of all cells there.
    cubic = 2 * d**3 + 6 * d**2 + 3 * (cells or k) + 2
    w2 = (d + 2) * (d - 1) * (d - 2) * cubic / (288 * (d * mauchly_factor(n, k)) ** 2)
    first = special.chdtrc(df, chi2)
    return np.minimum(first + w2 * (special.chdtrc(df + 4, chi2) - first), 1.0)


def mauchly(
    covariance: np.ndarray, n: int, floor: np.ndarray | float = 0.0, cells: int | None = None
) -> Mauchly:
    """
    Test whether contrasts have equal variances and no correlation: W = det M / (tr M / d)^d
    (Mauchly, 1940).

    `covariance` holds covariances M of orthonormal contrasts, divisor n − 1, shape (..., d, d). An
    eigenvalue below `floor`, the variance that rounding of the scores alone can cause, counts as
    zero. Not defined for d = 1 (nothing to test) and for n − 1 < d (M is singular whatever the
    population is).
    """
    d = covariance.shape[-1]
    shape = covariance.shape[:-2]
    df = d * (d + 1) // 2 - 1
    if d == 1 or n - 1 < d:
        nan = np.full(shape, np.nan)
        return Mauchly(nan, nan, df, nan, nan)
    sign, log_det = np.linalg.slogdet(covariance)
    trace = np.trace(covariance, axis1=-2, axis2=-1)
    log_w = np.minimum(log_det - d * np.log(trace / d), 0.0)
    singular = sign <= 0
    doubtful = singular | (log_w < np.log(1e-10)) | (trace * _RELATIVE_RANK < floor)
    # λ_min/λ_max ≤ 10⁻¹⁴ implies W ≤ e d 10⁻¹⁴, so that few need their eigenvalues.
    if doubtful.any():
        eigenvalues = np.linalg.eigvalsh(covariance[doubtful])
        least = np.maximum(
            d * _RELATIVE_RANK * eigenvalues[..., -1], np.broadcast_to(floor, shape)[doubtful]
        )
        singular = singular.copy()
        singular[doubtful] = eigenvalues[..., 0] <= least
    log_w = np.where(singular, np.nan, log_w)
    chi2 = -mauchly_factor(n, d + 1) * log_w
    return Mauchly(
        np.exp(log_w), chi2, df, mauchly_p_value(chi2, n, d + 1, cells), special.chdtrc(df, chi2)
    )


def why_no_mauchly(n: int, k: int, w: float) -> str:
    """Return why Mauchly's test is not defined; an empty text where it is."""
    if k == 2:
        return (
            "With two conditions sphericity always holds; there is nothing for Mauchly's test "
            "to test."
        )
    if n <= k - 1:
        why = f"{n} subjects are too few for {k} conditions (at least {k} are needed)"
    elif np.isnan(w):
        why = (
            "the covariance of the contrasts is singular (a condition is a linear combination "
            "of others)"
        )
    else:
        return ""
    return f"Mauchly's test is not defined: {why}."


def choose_correction(
    test: Mapping, df1: int, df2: int, df_error: int, correction: str, alpha: float
) -> dict[str, Any]:
    """
    Return the correction that applies to a test and why, its degrees of freedom and p.

    "auto" is Greenhouse–Geisser where Mauchly's test rejects sphericity at `alpha` or is not
    defined, else none; one contrast needs none.
    """
    d = df2 // df_error
    why = why_no_mauchly(df_error + 1, d + 1, test["mauchly_w"])
    applied, reason = _chosen_correction(
        correction, alpha, d, test["mauchly_p"], test["epsilon_gg"], why
    )
    epsilon, p = {
        "none": (1.0, test["p"]),
        "greenhouse-geisser": (test["epsilon_gg"], test["p_gg"]),
        "huynh-feldt": (test["epsilon_hf"], test["p_hf"]),
    }[applied]
    return {
        "mauchly_reason": why,
        "correction": applied,
        "reason": reason,
        "df1_corrected": df1 * epsilon,
        "df2_corrected": df2 * epsilon,
        "p_corrected": p,
    }


def _chosen_correction(
    correction: str, alpha: float, d: int, p: float, epsilon_gg: float, why_not: str
) -> tuple[str, str]:
    """Return the correction that applies to d contrasts and the reason in a sentence or two."""
    if d == 1:
        return "none", why_not
    if correction != "auto":
        applied = f"Correction “{correction}” applies, whatever Mauchly's test says."
        return correction, f"{applied} {why_not}".strip()
    if why_not:
        return "greenhouse-geisser", f"{why_not} Sphericity cannot be tested and is not assumed."
    if p >= alpha:
        return "none", f"Mauchly's test does not reject sphericity (p = {p:.3g} ≥ {alpha:g})."
    reason = f"Mauchly's test rejects sphericity (p = {p:.3g} < {alpha:g})."
    if epsilon_gg > 0.75:
        reason += " Greenhouse–Geisser ε is above 0.75, where Huynh–Feldt's is less conservative."
    return "greenhouse-geisser", reason
