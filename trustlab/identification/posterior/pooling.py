"""
Partial pooling: parameters of people are normal, with a mean and a covariance that are sampled.

[L] Lunn, Barrett, Sweeting and Thompson, Fully Bayesian hierarchical modelling in two stages, with
application to meta-analysis, *Applied Statistics* 62 (2013), 551-572: draws of each person alone
serve the Gibbs sampler of all.
[H] Huang and Wand, Simple marginally noninformative prior distributions for covariance matrices,
*Bayesian Analysis* 8 (2013), 439-452.

Coordinates z are θ of the first seven parameters less the prior's mean, in its deviations. Half of
the prior's variance is that of the population's mean, half the expected variance within it, so that
a person of a population has the same prior, but for heavier tails, as a person alone.
"""

from typing import NamedTuple

import numpy as np

from trustlab.models.compiled import njit

# Variance of the population's mean. A spread within the population is half-t, [H]; its degrees of
# freedom give correlations a standard deviation of 1/√(FREEDOM + 1), its scale the variance left.
OF_MEAN = 0.5
FREEDOM = 8.0
SCALE = np.sqrt((1.0 - OF_MEAN) * (FREEDOM - 2.0) / FREEDOM)

# Draws of the covariance for each of the people: without these the sampler moves slowly.
REPEATS = 4

# Steps of the Gibbs sampler, and how many of them are left out at its beginning.
STEPS = 4000
SETTLING = 800


class Pool(NamedTuple):
    """
    What the Gibbs sampler draws.

    Means (steps, 7) and covariances (steps, 7, 7) of the population; for every person the
    probability of each of their draws.
    """

    means: np.ndarray
    covariances: np.ndarray
    weights: list[np.ndarray]


@njit
def choose(draws, base, mean, whitening, uniform, weights):
    """Return a draw with probability ∝ exp(base) · normal density; add these to `weights`."""
    logarithms = base.copy()
    for k in range(len(draws)):
        for i in range(mean.size):
            z = 0.0
            for j in range(i + 1):
                z += whitening[i, j] * (draws[k, j] - mean[j])
            logarithms[k] -= 0.5 * z * z
    probability = np.exp(logarithms - logarithms.max())
    total = 0.0
    for value in probability:
        total += value
    weights += probability / total
    limit = uniform * total
    passed = 0.0
    for k in range(len(draws)):
        passed += probability[k]
        if passed > limit:
            return k
    return len(draws) - 1


def pool(draws: list[np.ndarray], base: list[np.ndarray], rng: np.random.Generator) -> Pool:
    """
    Sample mean and covariance of a population, and who its people are.

    Parameters
    ----------
    draws : list of numpy.ndarray
        Of each person the draws z, shape (draws, 7), under a prior of their own.
    base : list of numpy.ndarray
        Minus the logarithm of that prior's density at the draws.
    rng : numpy.random.Generator
        Random numbers.
    """
    size = draws[0].shape[1]
    weights = [np.zeros(len(each)) for each in draws]
    people = np.array([each.mean(axis=0) for each in draws])
    covariance = SCALE**2 * np.eye(size)
    means = np.empty((STEPS, size))
    covariances = np.empty((STEPS, size, size))
    for step in range(STEPS):
        if step == SETTLING:
            weights = [np.zeros(len(each)) for each in draws]
        means[step] = _mean(people, covariance, rng)
        for _ in range(REPEATS):
            covariance = _covariance(people - means[step], covariance, rng)
        covariances[step] = covariance
        whitening = np.linalg.inv(np.linalg.cholesky(covariance))
        for i, each in enumerate(draws):
            k = choose(each, base[i], means[step], whitening, rng.random(), weights[i])
            people[i] = each[k]
    shares = [each / each.sum() for each in weights]
    return Pool(means[SETTLING:], covariances[SETTLING:], shares)


def _mean(people: np.ndarray, covariance: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return a draw of the population's mean."""
    count, size = people.shape
    precision = np.linalg.inv(covariance)
    posterior = np.linalg.inv(count * precision + np.eye(size) / OF_MEAN)
    centre = posterior @ precision @ people.sum(axis=0)
    return centre + np.linalg.cholesky(posterior) @ rng.standard_normal(size)


def _covariance(apart: np.ndarray, covariance: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return a draw of the population's covariance, [H] (2), by way of its auxiliary scales."""
    count, size = apart.shape
    rates = FREEDOM * np.diag(np.linalg.inv(covariance)) + SCALE**-2
    auxiliary = rates / rng.gamma(0.5 * (FREEDOM + size), size=size)
    scatter = apart.T @ apart + 2.0 * FREEDOM * np.diag(1.0 / auxiliary)
    # The inverse has a Wishart distribution, here by Bartlett's decomposition.
    freedom = FREEDOM + size - 1.0 + count
    triangle = np.tril(rng.standard_normal((size, size)), -1)
    triangle += np.diag(np.sqrt(rng.chisquare(freedom - np.arange(size))))
    root = np.linalg.cholesky(np.linalg.inv(scatter)) @ triangle
    return np.linalg.inv(root @ root.T)
