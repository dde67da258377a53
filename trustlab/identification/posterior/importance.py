"""
Importance sampling from mixtures of t distributions, with Pareto-smoothed weights.

[C] Cornuet, Marin, Mira and Robert, Adaptive multiple importance sampling, *Scandinavian Journal of
Statistics* 39 (2012), 798-812.
[V] Vehtari, Simpson, Gelman, Yao and Gabry, Pareto smoothed importance sampling, *Journal of
Machine Learning Research* 25 (2024), 72.
[Z] Zhang and Stephens, A new and efficient estimation method for the generalized Pareto
distribution, *Technometrics* 51 (2009), 316-325.
"""

from typing import NamedTuple

import numpy as np
from scipy import special

# Degrees of freedom of the proposals: tails that are heavier than a normal posterior's.
FREEDOM = 7.0


# Independent points that a mixture is fitted to at least.
LEVEL = 80.0


class Component(NamedTuple):
    """One part of a mixture: its weight, centre and scale matrix."""

    weight: float
    centre: np.ndarray
    scale: np.ndarray


class Sample(NamedTuple):
    """
    Weighted points: coordinates (N, d), weights that add up to 1, and diagnostics.

    `k_hat` is the shape of the weights' tail ([V]: above 0.7 they are not to be trusted),
    `effective` the number of equally weighted points that would serve as well.
    """

    points: np.ndarray
    weights: np.ndarray
    k_hat: float
    effective: float


def smoothed(log_weights: np.ndarray) -> tuple[np.ndarray, float]:
    """Return logarithms of weights with the tail smoothed, [V] Section 2.1, and k̂."""
    log_weights = log_weights - log_weights.max()
    size = log_weights.size
    tail = int(min(0.2 * size, 3.0 * np.sqrt(size)))
    order = np.argsort(log_weights, kind="stable")
    cut = np.exp(log_weights[order[-tail - 1]])
    excess = np.exp(log_weights[order[-tail:]]) - cut
    if not excess[-1] > 0.0:
        return log_weights, np.inf
    excess = np.maximum(excess, 1e-300)
    shape, scale = pareto_fit(excess)
    ranks = (np.arange(1, tail + 1) - 0.5) / tail
    if abs(shape) > 1e-9:
        quantiles = scale / shape * np.expm1(-shape * np.log1p(-ranks))
    else:
        quantiles = -scale * np.log1p(-ranks)
    smooth = log_weights.copy()
    smooth[order[-tail:]] = np.minimum(np.log(cut + quantiles), 0.0)
    return smooth, shape


def pareto_fit(excess: np.ndarray) -> tuple[float, float]:
    """Return shape and scale of a generalized Pareto distribution of sorted excesses, [Z]."""
    size = excess.size
    points = 30 + int(np.sqrt(size))
    grid = 1.0 - np.sqrt(points / (np.arange(1, points + 1) - 0.5))
    grid = grid / (3.0 * excess[int(size / 4 + 0.5) - 1]) + 1.0 / excess[-1]
    shapes = np.mean(np.log1p(-grid[:, None] * excess), axis=1)
    profile = size * (np.log(-grid / shapes) - shapes - 1.0)
    weights = np.exp(profile - profile.max())
    best = np.sum(grid * weights) / weights.sum()
    shape = float(np.mean(np.log1p(-best * excess)))
    # The shape is drawn to 0.5 as ten more excesses would ([V] Appendix C).
    return (size * shape + 10.0 * 0.5) / (size + 10.0), -shape / best


def log_parts(points: np.ndarray, parts: list[Component]) -> np.ndarray:
    """Return the logarithm of each part's weight times density, shape (points, parts)."""
    from scipy import stats

    densities = [stats.multivariate_t(p.centre, p.scale, FREEDOM).logpdf(points) for p in parts]
    return np.column_stack(densities) + np.log([part.weight for part in parts])


def _drawn(part: Component, count: int, rng: np.random.Generator) -> np.ndarray:
    """Return points of a multivariate t distribution."""
    # SciPy draws by singular vectors, whose signs may differ between processors.
    normal = rng.standard_normal((count, part.centre.size)) @ np.linalg.cholesky(part.scale).T
    return part.centre + normal / np.sqrt(rng.chisquare(FREEDOM, count) / FREEDOM)[:, None]


def drawn(parts: list[Component], count: int, rng: np.random.Generator) -> np.ndarray:
    """Return points of a mixture, in random order."""
    shares = np.array([part.weight for part in parts])
    counts = rng.multinomial(count, shares / shares.sum())
    points = [_drawn(part, number, rng) for part, number in zip(parts, counts, strict=True)]
    return rng.permutation(np.concatenate(points))


def weighed(points: np.ndarray, values: np.ndarray, parts: list[Component]) -> Sample:
    """
    Return points weighed by what was drawn there: density over that of all proposals together.

    `values` are logarithms of the posterior's density. A component's weight is the number of points
    that it proposed, so that rounds add up to one mixture ([C]: no round is chosen for its luck).
    """
    proposed = special.logsumexp(log_parts(points, parts), axis=1)
    log_weights = np.where(np.isfinite(values), values - proposed, -1e300)
    log_weights, k_hat = smoothed(log_weights)
    weights = np.exp(log_weights - log_weights.max())
    weights /= weights.sum()
    return Sample(points, weights, k_hat, float(1.0 / np.sum(weights**2)))


def fitted_mixture(sample: Sample, count: int, rng: np.random.Generator) -> list[Component]:
    """Return a mixture of so many parts that resembles a weighted sample (EM, shrunk scales)."""
    weights = np.maximum(sample.weights, 1e-300)
    while 1.0 / np.sum(weights**2) < LEVEL:  # few points carry all weight: level them
        weights = weights**0.6
        weights /= weights.sum()
    kept = weights > 1e-4 * weights.max()
    points = sample.points[kept]
    weights = weights[kept] / weights[kept].sum()
    size = points.shape[1]
    mean = weights @ points
    overall = np.cov(points.T, aweights=weights) + 1e-6 * np.eye(size)
    if count == 1:
        return [Component(1.0, mean, 1.1 * overall)]
    effective = 1.0 / np.sum(weights**2)
    first = rng.choice(len(points), count, p=weights, replace=False)
    parts = [Component(1.0 / count, points[k], overall) for k in first]
    for _ in range(8):
        shares = special.softmax(log_parts(points, parts), axis=1) * weights[:, None]
        parts = [_refitted(points, share, overall, effective) for share in shares.T]
    return [Component(part.weight, part.centre, 1.1 * part.scale) for part in parts]


def _refitted(
    points: np.ndarray, share: np.ndarray, overall: np.ndarray, effective: float
) -> Component:
    """Return one part of a mixture from its share of every point's weight."""
    weight = share.sum() + 1e-3
    each = share / share.sum()
    centre = each @ points
    apart = points - centre
    size = points.shape[1]
    shrink = 2.0 * size / (2.0 * size + effective * weight)
    scale = (1.0 - shrink) * (apart.T * each) @ apart + shrink * overall
    return Component(float(weight), centre, scale + 1e-6 * np.eye(size))


def resampled(sample: Sample, count: int, rng: np.random.Generator) -> np.ndarray:
    """Return so many equally weighted points, in random order."""
    at = (np.arange(count) + rng.random()) / count
    rows = np.minimum(np.searchsorted(np.cumsum(sample.weights), at), len(sample.points) - 1)
    return sample.points[rng.permutation(rows)]
