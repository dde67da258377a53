"""What a model leaves unexplained: correlations, whiteness, and covariances that allow for autocorrelated noise."""

import numpy as np
from scipy import special

LAGS = 25
"""Lags of the Ljung–Box test that chooses between white and robust standard errors."""


def pooled_autocorrelation(residuals: list[np.ndarray], lags: int) -> np.ndarray:
    """
    Return the autocorrelation ρ(0) = 1, ρ(1), … of residuals, pooled over runs.

    No product crosses from one run to the next; the mean is that of all runs, as in statsmodels.
    """
    mean = np.concatenate(residuals).mean()
    sums = np.zeros(lags + 1)
    for run in residuals:
        centred = run - mean
        sums += [centred[: max(run.size - lag, 0)] @ centred[lag:] for lag in range(lags + 1)]
    return sums / sums[0] if sums[0] > 0.0 else np.r_[1.0, np.zeros(lags)]


def pooled_cross_correlation(residuals: list[np.ndarray], inputs: list[np.ndarray], lags: int) -> np.ndarray:
    """Return the correlation of e(k) with u(k − lag) for −lags … lags, pooled over runs; 0 where no input moves."""
    e_mean, u_mean = np.concatenate(residuals).mean(), np.concatenate(inputs).mean()
    sums, e_power, u_power = np.zeros(2 * lags + 1), 0.0, 0.0
    for e, u in zip(residuals, inputs, strict=True):
        e, u = e - e_mean, u - u_mean
        e_power, u_power = e_power + e @ e, u_power + u @ u
        for lag in range(-lags, lags + 1):
            size = e.size - abs(lag)
            if size > 0:
                sums[lag + lags] += e[max(lag, 0) :][:size] @ u[max(-lag, 0) :][:size]
    scale = np.sqrt(e_power * u_power)
    return sums / scale if scale > 0.0 else sums


def ljung_box(correlation: np.ndarray, samples: int) -> tuple[float, int, float]:
    """Return Q = n(n + 2) Σ ρ²(l)/(n − l) of ρ(0) … ρ(lags), its degrees of freedom and its p value."""
    lags = min(correlation.size - 1, samples - 1)
    terms = correlation[1 : lags + 1] ** 2 / (samples - np.arange(1, lags + 1))
    q = samples * (samples + 2.0) * np.sum(terms)
    return float(q), lags, float(special.chdtrc(lags, q))


def whiteness_p(residuals: list[np.ndarray]) -> float:
    """Return the p value of the Ljung–Box test."""
    return ljung_box(pooled_autocorrelation(residuals, LAGS), sum(run.size for run in residuals))[2]


def hac_lags(residuals: list[np.ndarray]) -> int:
    """
    Return the bandwidth of the Bartlett window for residuals, by Andrews' rule for an AR(1).

    The rule, 1.1447 (α n)^(1/3) with α = 4ρ²/((1 − ρ)²(1 + ρ)²), is equations (6.2) and (6.4) of Andrews (1991),
    *Econometrica* 59, 817-858; here at most a quarter of the shortest run.
    """
    # White noise on top hides slow noise from the first autocorrelation, but averages out in blocks: the rule is applied
    # to the means over 1, 2, 4, 8 … samples too, and the widest result taken.
    shortest, widest, length = min(run.size for run in residuals), 0.0, 1
    while length == 1 or shortest // length >= 50:
        means = [run[: run.size // length * length].reshape(-1, length).mean(axis=1) for run in residuals]
        total = sum(run.size for run in means)
        rho = min(abs(float(pooled_autocorrelation(means, 1)[1])), 0.9999)
        if length == 1 or rho > 3.0 / np.sqrt(total):
            alpha = 4.0 * rho**2 / (1.0 - rho**2) ** 2
            widest = max(widest, length * 1.1447 * (alpha * total) ** (1.0 / 3.0))
        length *= 2
    return int(min(widest, shortest // 4))


def hac_matrix(scores: np.ndarray, lags: int) -> np.ndarray:
    """Return the Bartlett-weighted sum of products of scores, shape (n, p), over lags (Newey–West; by statsmodels)."""
    from statsmodels.stats.sandwich_covariance import S_hac_simple

    return S_hac_simple(scores, nlags=lags)


def sandwich(bread: np.ndarray, meat: np.ndarray | None, samples: float) -> np.ndarray:
    """
    Return n/(n − p) · bread · meat · bread, or n/(n − p) · bread for white residuals.

    `bread` is the inverse of the information matrix Σ w JᵀJ with w = n/Σ e², `meat` the long-run covariance of the
    scores w Jᵀe.
    """
    # Residuals of a fit with p parameters are too small by (n − p)/n on average. The factor makes the white form
    # s² (JᵀJ)⁻¹ with s² = Σ e²/(n − p); the robust form takes the same one (the small-sample form of MacKinnon & White
    # 1985, HC1, and Stata's newey), so that both agree where residuals are white.
    factor = samples / max(samples - len(bread), 1.0)
    return factor * (bread if meat is None else bread @ meat @ bread)
