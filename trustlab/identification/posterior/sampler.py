"""From a target to a weighted sample: tops, proposals, adaptation, walkers where these fail."""

from typing import NamedTuple

import numpy as np

from trustlab.identification.posterior.coordinates import Target, densities
from trustlab.identification.posterior.ensemble import ensemble_sample
from trustlab.identification.posterior.importance import (
    Component,
    Sample,
    drawn,
    fitted_mixture,
    resampled,
    weighed,
)
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
        sample = ensemble_sample(target, resampled(sample, 400, rng), mixture, rng)
    return Sampled(sample, method)


def shared(mixture: list[Component], count: int) -> list[Component]:
    """Return a mixture whose weights are the points that each part proposes of so many."""
    total = sum(part.weight for part in mixture)
    return [part._replace(weight=count * part.weight / total) for part in mixture]
