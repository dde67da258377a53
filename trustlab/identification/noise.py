"""
Residuals: outliers, whiteness, and two ways to allow for correlation.

A Kalman filter whitens AR(1) noise; a sandwich widens the covariance for any other.
"""

from typing import NamedTuple

import numpy as np
from scipy import special

from trustlab.models.compiled import njit

# Lags of the Ljung–Box test that chooses between white and robust standard errors.
LAGS = 25

# Robust standard deviations beyond which a sudden residual counts as an outlier: of white noise one
# sample in 5·10⁸ is.
FAR = 6.0


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


def pooled_cross_correlation(
    residuals: list[np.ndarray], inputs: list[np.ndarray], lags: int
) -> np.ndarray:
    """
    Return the correlation of e(k) with u(k − lag), pooled over runs.

    Lags run from −lags to lags; 0 where no input moves.
    """
    from scipy import signal

    e_mean = np.concatenate(residuals).mean()
    u_mean = np.concatenate(inputs).mean()
    sums = np.zeros(2 * lags + 1)
    e_power = 0.0
    u_power = 0.0
    for e, u in zip(residuals, inputs, strict=True):
        e = e - e_mean
        u = u - u_mean
        e_power += e @ e
        u_power += u @ u
        sums += signal.correlate(e, u)[e.size - 1 - lags : e.size + lags]
    scale = np.sqrt(e_power * u_power)
    return sums / scale if scale > 0.0 else sums


def ljung_box(correlation: np.ndarray, samples: int) -> tuple[float, int, float]:
    """
    Return Q = n(n + 2) Σ ρ²(l)/(n − l) of ρ(0) … ρ(lags), its degrees of freedom and its p value.
    """
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

    The rule, 1.1447 (α n)^(1/3) with α = 4ρ²/((1 − ρ)²(1 + ρ)²), is equations (6.2) and (6.4) of
    Andrews (1991), *Econometrica* 59, 817-858; here at most a quarter of the shortest run.
    """
    # White noise on top hides slow noise from the first autocorrelation, but averages out in
    # blocks: the rule is applied to the means over 1, 2, 4, 8 … samples too, and the widest result
    # taken.
    shortest = min(run.size for run in residuals)
    widest = 0.0
    length = 1
    while length == 1 or shortest // length >= 50:
        means = [
            run[: run.size // length * length].reshape(-1, length).mean(axis=1) for run in residuals
        ]
        total = sum(run.size for run in means)
        rho = min(abs(float(pooled_autocorrelation(means, 1)[1])), 0.9999)
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


def sandwich(bread: np.ndarray, meat: np.ndarray | None, samples: float) -> np.ndarray:
    """
    Return n/(n − p) · bread · meat · bread, or n/(n − p) · bread for white residuals.

    `bread` is the inverse of the information matrix Σ w JᵀJ with w = n/Σ e², `meat` the long-run
    covariance of the scores w Jᵀe.
    """
    # The residuals of a fit with p parameters are too small by (n − p)/n on average. The factor
    # makes the white form s² (JᵀJ)⁻¹ with s² = Σ e²/(n − p). The robust form takes the same factor
    # (HC1 of MacKinnon & White 1985, Stata's newey): both agree where residuals are white.
    factor = samples / max(samples - len(bread), 1.0)
    return factor * (bread if meat is None else bread @ meat @ bread)


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

    Errors and their derivatives are filtered alike ([L] Section 4.3).
    """
    errors = np.empty(columns.shape)
    of_samples = process(np.sqrt(1.0 - noise.share), np.sqrt(noise.share), noise.memory, 1)
    return errors, filter_columns(columns, known, of_samples, errors)


def fit_noise(
    parts: list[tuple[np.ndarray, np.ndarray, np.ndarray]], samples: float, before: Noise
) -> Noise:
    """
    Return the noise model of greatest restricted likelihood, near that of the round before.

    A part is one run: residual and derivatives side by side, shape (N, 1 + p); which samples are
    known; and the places of the columns among those of all runs. Restricted (Patterson & Thompson
    1971, *Biometrika* 58, 545-554): the parameters are solved for at every noise model, and what
    they take from the residuals is allowed for.
    """
    from scipy import optimize

    def deviance(at):
        return _restricted_deviance(parts, samples, _noise(at))

    memories, shares = np.array([0.3, 0.9, 0.99, 0.999]), np.array([0.05, 0.5, 0.95])
    starts = [_coordinates(Noise(s, m)) for m in memories for s in shares]
    size = 1.0
    if before != Noise():
        starts, size = [_coordinates(before)], 0.3
    best = np.array(min(starts, key=deviance))
    simplex = best + size * np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.5]])
    options = {"initial_simplex": simplex, "xatol": 0.02, "fatol": 0.02, "maxfev": 80}
    return _noise(optimize.minimize(deviance, best, method="Nelder-Mead", options=options).x)


def _restricted_deviance(parts: list[tuple], samples: float, noise: Noise) -> float:
    """Return minus twice the restricted log-likelihood, but for a constant."""
    size = 1 + max(int(places.max()) for *_, places in parts)
    gram = np.zeros((size, size))
    log_determinant = 0.0
    for values, known, places in parts:
        errors, part = whiten(values, known, noise)
        gram[np.ix_(places, places)] += errors.T @ errors
        log_determinant += part
    scale = np.sqrt(np.maximum(np.diag(gram)[1:], 1e-300))
    roots, vectors = np.linalg.eigh(gram[1:, 1:] / np.outer(scale, scale))
    regular = roots > 1e-10
    along = (gram[0, 1:] / scale) @ vectors[:, regular]
    squares = max(gram[0, 0] - along @ (along / roots[regular]), 1e-300)
    value = (samples - regular.sum()) * np.log(squares) + log_determinant
    return value + np.log(roots[regular]).sum() + 2.0 * np.log(scale).sum()


def _coordinates(noise: Noise) -> tuple[float, float]:
    """Return unbounded coordinates: −ln(1 − memory), log odds of the share."""
    return -np.log1p(-noise.memory), np.log(noise.share) - np.log1p(-noise.share)


def _noise(at) -> Noise:
    """Return the noise model at unbounded coordinates."""
    share = 1.0 / (1.0 + np.exp(-np.clip(at[1], -12.0, 12.0)))
    return Noise(float(share), float(np.clip(-np.expm1(-at[0]), 0.0, 1.0 - 1e-6)))


def outliers(error: np.ndarray, scale: float) -> np.ndarray:
    """Return which residuals are far off and begin or end with a jump, as dropouts do."""
    from scipy import ndimage

    far = np.abs(error) > FAR * scale
    if not far.any():
        return far
    jumps = np.abs(np.diff(error, prepend=0.0, append=0.0)) > FAR * scale
    out = np.zeros(error.size, dtype=bool)
    for (stretch,) in ndimage.find_objects(ndimage.label(far)[0]):
        out[stretch] = jumps[stretch.start] or jumps[stretch.stop]
    return out


def robust_deviation(errors: list[np.ndarray]) -> float:
    """Return the standard deviation of Gaussian residuals with this median of absolute values."""
    sizes = np.abs(np.concatenate(errors))
    # A few thousand samples tell it to a few per cent.
    return 1.4826 * float(np.median(sizes[:: 1 + sizes.size // 4000]))
