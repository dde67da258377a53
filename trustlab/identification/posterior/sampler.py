"""
From a target to a weighted sample: tops, proposals, adaptation, walkers where these fail.

[G] Goodman and Weare, Ensemble samplers with affine invariance, *Communications in Applied
Mathematics and Computational Science* 5 (2010), 65-80.
"""

from typing import NamedTuple

import numpy as np

from trustlab.identification.posterior.coordinates import Target, densities
from trustlab.identification.posterior.importance import (
    Component,
    Sample,
    drawn,
    fitted_mixture,
    resampled,
    weighed,
)
from trustlab.identification.posterior.likelihood import SHARED
from trustlab.identification.posterior.search import Top, climb, starting_points

# Draws of the prior that starts are chosen from, and starts.
DRAWS = 150
STARTS = 3

# A sample is good where k̂ is at most this and it is worth at least so many independent draws.
MOST_K = 0.7
FEWEST = 1000.0

# Points that are weighed first, and in each round of adaptation; parts of the mixtures of rounds.
POINTS = 4000
MORE_POINTS = 8000
ROUNDS = (1, 3, 3, 5)

# Walkers keep one of so many steps. After each round of kept steps it is asked whether they have
# gone for enough autocorrelation times, until there are the most.
STEPS = 10
ROUND = 200
MOST_KEPT = 2000
LENGTHS = 50


class Sampled(NamedTuple):
    """A weighted sample, and how it was made."""

    sample: Sample
    method: str


def good(sample: Sample) -> bool:
    """Return whether weights may be trusted as far as they tell."""
    return sample.k_hat <= MOST_K and sample.effective >= FEWEST


def tops_of(target: Target, rng: np.random.Generator) -> list[Top]:
    """Return the maxima that ascents from several starts reach, the highest first."""
    climbed = [climb(x, target) for x in starting_points(target, rng, DRAWS, STARTS)]
    climbed.sort(key=lambda top: -top.value)
    apart: list[Top] = []
    for top in climbed:
        if top.value > climbed[0].value - 12.0 and all(_apart(top, t) for t in apart):
            apart.append(top)
    return apart


def _apart(top: Top, higher: Top) -> bool:
    """Return whether a maximum lies outside of a higher one's hill."""
    distance = top.x - higher.x
    return bool(distance @ np.linalg.solve(higher.covariance, distance) > 4.0)


def proposals(tops: list[Top]) -> list[Component]:
    """Return a part for each maximum, and a wide one along the weakest directions."""
    highest = tops[0]
    parts = []
    for top in tops:
        _, log_volume = np.linalg.slogdet(top.covariance)
        weight = np.exp(top.value - highest.value + 0.5 * log_volume)
        parts.append(Component(weight, top.x, 1.15 * top.covariance))
    values, vectors = np.linalg.eigh(highest.covariance)
    values[-3:] = np.maximum(np.minimum(6.0 * values[-3:], 1.5), values[-3:])
    total = sum(part.weight for part in parts)
    return [*parts, Component(0.3 * total, highest.x, (vectors * values) @ vectors.T)]


def sample_target(
    target: Target, tops: list[Top], rng: np.random.Generator, count: int = POINTS
) -> Sampled:
    """
    Sample a posterior from its maxima.

    Proposals are adapted where weights are bad, and walkers come last.
    """
    mixture = proposals(tops)
    wide = Component(0.1, mixture[-1].centre, mixture[-1].scale)
    points = drawn(mixture, count, rng)
    values = densities(points, target)
    proposed = shared(mixture, count)
    sample = weighed(points, values, proposed)
    method = "importance"
    for parts in ROUNDS:
        if good(sample):
            break
        method = "adapted mixture"
        mixture = [*fitted_mixture(sample, parts, rng), wide]
        more = drawn(mixture, MORE_POINTS, rng)
        points = np.concatenate([points, more])
        values = np.concatenate([values, densities(more, target)])
        proposed += shared(mixture, MORE_POINTS)
        sample = weighed(points, values, proposed)
    if not good(sample):
        method = "ensemble"
        sample = walked(target, sample, rng)
    return Sampled(sample, method)


def shared(mixture: list[Component], count: int) -> list[Component]:
    """Return a mixture whose weights are the points that each part proposes of so many."""
    total = sum(part.weight for part in mixture)
    return [part._replace(weight=count * part.weight / total) for part in mixture]


def walked(target: Target, sample: Sample, rng: np.random.Generator) -> Sample:
    """
    Return points of emcee's walkers, which begin at draws of a weighted sample.

    They stretch ([G] Section 2) and do nothing else: differences of walkers as moves left a
    posterior a fifth too narrow, and no diagnostic told. The model's coordinates alone judge how
    far they have gone. Those of the noise may wait long for another explanation that data hardly
    tell apart: slow noise so quick that it is white. The model does not depend on it.
    """
    import emcee

    size = sample.points.shape[1]
    count = 2 * size + 4
    # A draw of great weight comes many times, and walkers must lie apart.
    points = resampled(sample, 10 * count, rng)
    points = points + 0.01 * rng.standard_normal(points.shape)
    begin = points[np.isfinite(densities(points, target))][:count]
    sampler = emcee.EnsembleSampler(
        count,
        size,
        densities,
        moves=emcee.moves.StretchMove(),
        args=[target],
        vectorize=True,
    )
    # emcee draws from a state of its own, which would be another one each time.
    sampler.random_state = np.random.MT19937(int(rng.integers(2**63))).state
    enough = False
    while not enough and sampler.iteration < MOST_KEPT:
        begin = sampler.run_mcmc(begin, ROUND, thin_by=STEPS)
        settled = sampler.get_chain(discard=sampler.iteration // 3)
        # 0/0 where a walker never moved: an unknown time is as long as the chain.
        with np.errstate(invalid="ignore"):
            times = emcee.autocorr.integrated_time(settled[:, :, :SHARED], tol=0)
        time = float(np.nan_to_num(times, nan=len(settled)).max())
        enough = len(settled) > LENGTHS * time
    thin = settled[:: max(1, int(time / 4.0))].reshape(-1, size)
    weights = np.full(len(thin), 1.0 / len(thin))
    # There are no weights whose tail could be long; short chains are marked as bad weights are.
    return Sample(thin, weights, 0.0 if enough else np.inf, len(settled) * count / time)
