"""
Noise: whether residuals are white, what they are else, and which samples lie outside of it.

What a log shows beyond the simulated outputs, e = y − ŷ, is noise: white, or an AR(1) process plus
white noise, whose Kalman filter leaves prediction errors; Newey and West's sum of scores allows for
any other.

[L] Ljung, *System Identification: Theory for the User*, 2nd ed., 1999.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy import special

from trustlab.identification.log import in_rows
from trustlab.identification.model import COORDINATES
from trustlab.models.compiled import njit

# Lags of the Ljung–Box test that chooses what the noise model and standard errors allow for.
LAGS = 25

# p value of the Ljung–Box test below which residuals do not count as white.
NOT_WHITE = 1e-3

# Standard errors from the middle of a 95 % interval to its end.
HALF_WIDTH = float(special.ndtri(0.975))

# Robust standard deviations beyond which a sudden residual counts as an outlier: of white noise one
# sample in 5·10⁸ is.
FAR = 6.0


def pooled_correlation(errors: list[np.ndarray], others: list[np.ndarray], lags: int) -> np.ndarray:
    """
    Return the correlation of e(k) with u(k − lag), lag = 0, 1, …, pooled over runs.

    No product crosses from one run to the next; means are those of all runs, as in statsmodels.
    0 where one of them never moves.
    """
    e_mean, u_mean = (np.concatenate(each).mean() for each in (errors, others))
    sums, powers = np.zeros(lags + 1), np.zeros(2)
    for e, u in zip(errors, others, strict=True):
        e, u = e - e_mean, u - u_mean
        sums += [e[lag:] @ u[: max(u.size - lag, 0)] for lag in range(lags + 1)]
        powers += e @ e, u @ u
    scale = np.sqrt(powers.prod())
    return sums / scale if scale > 0.0 else sums


def ljung_box(residuals: list[np.ndarray], lags: int) -> tuple[float, int, float]:
    """
    Return Q = n(n + 2) Σ ρ²(l)/(n − l) over lags l, its degrees of freedom and its p value.
    """
    samples = sum(map(len, residuals))
    lags = min(lags, samples - 1)
    terms = pooled_correlation(residuals, residuals, lags)[1:] ** 2 / (
        samples - np.arange(1, lags + 1)
    )
    q = samples * (samples + 2.0) * np.sum(terms)
    return float(q), lags, float(special.chdtrc(lags, q))


def whiteness_p(residuals: list[np.ndarray]) -> float:
    """Return the p value of the Ljung–Box test."""
    return ljung_box(residuals, LAGS)[2]


def hac_lags(residuals: list[np.ndarray]) -> int:
    """
    Return the bandwidth of the Bartlett window for residuals, by Andrews' rule for an AR(1).

    The rule, 1.1447 (α n)^(1/3) with α = 4ρ²/((1 − ρ)²(1 + ρ)²), is equations (6.2) and (6.4) of
    Andrews (1991), *Econometrica* 59, 817-858; here at most a quarter of the shortest run.
    """
    # White noise on top hides slow noise from the first autocorrelation, but averages out in
    # blocks: the rule is applied to the means over 1, 2, 4, 8 … samples too, and the widest result
    # taken.
    shortest = min(map(len, residuals))
    widest = 0.0
    length = 1
    while length == 1 or shortest // length >= 50:
        means = [in_rows(run, length).mean(axis=1) for run in residuals]
        total = sum(map(len, means))
        rho = min(abs(float(pooled_correlation(means, means, 1)[1])), 0.9999)
        if length == 1 or rho > 3.0 / np.sqrt(total):
            alpha = 4.0 * rho**2 / (1.0 - rho**2) ** 2
            widest = max(widest, length * 1.1447 * (alpha * total) ** (1.0 / 3.0))
        length *= 2
    return int(min(widest, shortest // 4))


def hac_matrix(scores: np.ndarray, lags: int) -> np.ndarray:
    """
    Return the Bartlett-weighted sum of products of scores, shape (n, p), over lags (Newey–West).
    """
    # Sums over lags + 1 scores in a row hold each product at lag l in lags + 1 − l places: as
    # Bartlett weights it.
    total = np.cumsum(np.pad(scores, ((lags + 1, lags), (0, 0))), axis=0)
    sums = total[lags + 1 :] - total[: -lags - 1]
    return sums.T @ sums / (lags + 1)


class Noise(NamedTuple):
    """AR(1) noise under white noise: share of the variance, correlation of successive samples."""

    share: float = 0.0
    memory: float = 0.0


class Process(NamedTuple):
    """
    Noise y = c x + v of a first-order process x and white noise v, from one value to the next.

    x becomes φ x + w; `drive`, `error` and `both` are the variance of w, that of v, and their
    covariance; `variance` is that of x.
    """

    phi: float
    c: float
    drive: float
    error: float
    both: float
    variance: float


@njit
def process(white, slow, memory, samples):
    """
    Return the noise of means over `samples`.

    Of each sample, `white` and `slow` are the deviations of white and AR(1) noise; `memory` is the
    correlation of successive samples of the latter.
    """
    total = 0.0
    power = 1.0
    error = 0.0
    both = 0.0
    # After m samples a shock has added `total` = 1 + … + φ^(m − 1) to the sum.
    for m in range(samples):
        if m > 0:
            error += total * total
            both += total * power
        total += power
        power *= memory
    shock = slow * slow * (1.0 - memory * memory)
    return Process(
        power,
        total / samples,
        slow * slow * (1.0 - power * power),
        (shock * error / samples + white * white) / samples,
        shock * both / samples,
        slow * slow,
    )


@njit
def filter_columns(columns, known, noise, errors):
    """
    Write the prediction errors of a Kalman filter, scaled to variance one; return Σ ln variance.

    Columns, shape (N, p), are filtered alike; where nothing is known the noise is only predicted
    (Kailath, Sayed and Hassibi, *Linear Estimation*, 2000, Section 9.5: correlated noises).
    """
    state = np.zeros(columns.shape[1])
    variance = noise.variance
    before = -1.0
    scale = 1.0
    gain = 0.0
    after = 0.0
    logarithm = 0.0
    logs = 0.0
    for k in range(columns.shape[0]):
        if not known[k]:
            for j in range(state.size):
                errors[k, j] = 0.0
                state[j] *= noise.phi
            variance = noise.phi * noise.phi * variance + noise.drive
            continue
        if abs(variance - before) > 1e-14 * variance:  # the filter settles within some samples
            before = variance
            total = noise.c * noise.c * variance + noise.error
            scale = 1.0 / np.sqrt(total)
            gain = (noise.phi * noise.c * variance + noise.both) / total
            after = noise.phi * noise.phi * variance + noise.drive - gain * gain * total
            logarithm = np.log(total)
        for j in range(state.size):
            error = columns[k, j] - noise.c * state[j]
            errors[k, j] = scale * error
            state[j] = noise.phi * state[j] + gain * error
        variance = after
        logs += logarithm
    return logs


def whiten(columns: np.ndarray, known: np.ndarray, noise: Noise) -> tuple[np.ndarray, float]:
    """
    Return columns, shape (N, p), whitened by a Kalman filter, and the log-determinant.

    Errors and their derivatives are filtered alike ([L] Section 4.3). Where nothing is known the
    columns are 0, so that white noise leaves them as they are.
    """
    if noise == Noise():
        return columns, 0.0
    errors = np.empty(columns.shape)
    of_samples = process(np.sqrt(1.0 - noise.share), np.sqrt(noise.share), noise.memory, 1)
    return errors, filter_columns(columns, known, of_samples, errors)


def scaled_roots(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return scales of the unknowns, and eigenvalues and -vectors with these at unit diagonal."""
    # Units of the unknowns do not decide what is singular.
    scale = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    return scale, *np.linalg.eigh(matrix / np.outer(scale, scale))


# --- the noise of residuals -----------------------------------------------------------------------


def fitted_noise(products: Callable, samples: float, before: Noise) -> Noise:
    """
    Return the noise model of greatest restricted likelihood, near that of the round before.

    Restricted (Patterson & Thompson 1971, *Biometrika* 58, 545-554): the parameters are solved for
    at every noise model, and what they take from the residuals is allowed for. `products(noise)`
    are [e J]ᵀ[e J], whitened, and the log-determinant.
    """
    from scipy import optimize

    rate, odds = COORDINATES["rate"], COORDINATES["odds"]

    def noise_at(x: np.ndarray) -> Noise:
        memory = float(np.clip(rate.back(x[0]), 0.0, 1.0 - 1e-6))
        return Noise(float(odds.back(np.clip(x[1], -12.0, 12.0))), memory)

    def deviance(x: np.ndarray) -> float:
        gram, log_determinant = products(noise_at(x))
        scale, roots, vectors = scaled_roots(gram[1:, 1:])
        regular = roots > 1e-10
        along = (gram[0, 1:] / scale) @ vectors[:, regular]
        squares = max(gram[0, 0] - along @ (along / roots[regular]), 1e-300)
        value = (samples - regular.sum()) * np.log(squares) + log_determinant
        return value + np.log(roots[regular]).sum() + 2.0 * np.log(scale).sum()

    memories, shares, size = [0.3, 0.9, 0.99, 0.999], [0.05, 0.5, 0.95], 1.0
    if before != Noise():
        memories, shares, size = [before.memory], [before.share], 0.3
    starts = [np.array([rate.to(m), odds.to(s)]) for m in memories for s in shares]
    best = min(starts, key=deviance)
    simplex = best + size * np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.5]])
    options = {"initial_simplex": simplex, "xatol": 0.02, "fatol": 0.02, "maxfev": 80}
    return noise_at(optimize.minimize(deviance, best, method="Nelder-Mead", options=options).x)


def outliers(errors: list[np.ndarray], known: list[np.ndarray]) -> list[np.ndarray]:
    """Return which residuals are far off and begin or end with a jump, as dropouts do."""
    sizes = np.abs(np.concatenate(errors)[np.concatenate(known)])
    # The standard deviation of Gaussian residuals with this median; a few thousand of those that
    # count so far tell it to a few per cent.
    limit = FAR * 1.4826 * float(np.median(sizes[:: 1 + sizes.size // 4000]))
    marks = []
    for error in errors:
        mark = np.abs(error) > limit
        jumps = np.abs(np.diff(error, prepend=0.0, append=0.0)) > limit
        ends = np.flatnonzero(np.diff(mark, prepend=False, append=False))
        for first, stop in ends.reshape(-1, 2):
            mark[first:stop] = jumps[first] or jumps[stop]
        marks.append(mark)
    return marks
