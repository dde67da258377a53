"""Trust known by its probability on a grid, after the OPTIMo of Xu and Dudek."""

from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np

from trustlab.trust.dynamics.linear import columns
from trustlab.trust.interface import (
    Event,
    GridRating,
    NormalRating,
    TrustDynamics,
    cell,
    parameter,
)

BINS = 100
CENTRES = (np.arange(BINS) + 0.5) / BINS
# Where the difference of bins i − j stands among the differences from −(BINS − 1) to BINS − 1.
PLACE = np.arange(BINS)[:, None] - np.arange(BINS)[None, :] + BINS - 1
# A cell so narrow is a point.
POINT = 1e-5
DIFFERENCES = np.arange(1 - BINS, BINS) / BINS


class Grid(NamedTuple):
    """Probability of trust in every bin, shape (N, BINS); the last performance, NaN at first."""

    weights: np.ndarray
    before: np.ndarray


@dataclass(frozen=True)
class GridTrust(TrustDynamics):
    """
    T' ~ N(T + w_b + w_p p + w_d (p − p before), process_sd²) in [0, 1], rating ~ N(T, rating_sd²).

    The filter is exact on the grid. Nothing is forgotten: with many events trust drifts unless w_b
    and w_p cancel.

    Parameters
    ----------
    constant, level, change : float
        w_b, w_p and w_d.
    process_sd, rating_sd : float
        Standard deviations of the walk and of a rating about trust.

    Notes
    -----
    A. Xu, G. Dudek, OPTIMo: online probabilistic trust inference model for asymmetric human-robot
    collaborations, HRI 2015. The paper's grid has 300 bins; its reports of changes of trust and the
    terms of interventions other than the level of trust are left out. The mean without w_d was
    checked against public code of H. Soh and others, whose p is −1 or 1; the rest is from secondary
    text.
    """

    title: ClassVar[str] = "OPTIMo (Xu and Dudek)"
    rounds: ClassVar[bool] = True
    constant: float = parameter(-0.05, -1.0, 1.0)
    level: float = parameter(0.1, -1.0, 1.0)
    change: float = parameter(0.01, -1.0, 1.0)
    process_sd: float = parameter(0.05, 0.01, 1.0)
    rating_sd: float = parameter(0.05, 0.01, 1.0)

    def start(self, rating, resolution: float = 0.0) -> Grid:
        """
        Return the belief after a first rating; uniform where there is none.

        Parameters
        ----------
        rating : array_like, shape (N,)
            Ratings, 0 to 1.
        resolution : float
            Step of the scale, 0 where nobody rounds.
        """
        rating = np.atleast_1d(rating)
        uniform = np.full((rating.size, BINS), 1.0 / BINS)
        return self.learn(Grid(uniform, np.full(rating.size, np.nan)), rating, resolution)

    def step(self, belief: Grid, event: Event) -> Grid:
        """
        Return the belief after an event.

        Parameters
        ----------
        belief : Grid
            The belief before it.
        event : Event
            Its p_r.
        """
        size = len(belief.weights)
        p = np.broadcast_to(event.p_r, size)
        before = np.where(np.isnan(belief.before), p, belief.before)
        shift = self.constant + self.level * p + self.change * (p - before)
        moves = columns(size, shift, self.process_sd)
        # People who see the same move the same way: a kernel for each way that occurs.
        ways, which = np.unique(moves, axis=0, return_inverse=True)
        weights = np.empty_like(belief.weights)
        for i, (mean, sd) in enumerate(ways):
            distance = (DIFFERENCES - mean) / sd
            nearest = np.square(distance).min()
            kernel = np.exp(-0.5 * (np.square(distance) - nearest))[PLACE]
            kernel /= np.maximum(kernel.sum(axis=0), 1e-300)
            rows = which.ravel() == i
            weights[rows] = belief.weights[rows] @ kernel.T
        total = np.maximum(weights.sum(axis=1, keepdims=True), 1e-300)
        return Grid(weights / total, p)

    def learn(self, belief: Grid, rating, resolution: float = 0.0) -> Grid:
        """
        Return the belief after a rating; unchanged where it is NaN.

        Parameters
        ----------
        belief : Grid
            The belief before it.
        rating : array_like, shape (N,)
            Ratings, 0 to 1.
        resolution : float
            Step of the scale, 0 where nobody rounds.
        """
        rating = np.atleast_1d(rating)[:, None]
        ends = cell(rating, resolution) if resolution else (rating - POINT, rating + POINT)
        ratings = NormalRating(CENTRES, columns(len(belief.weights), self.rating_sd))
        # What no bin explains says nothing.
        mass = np.fmax(ratings.mass(*ends), 1e-300)
        weights = belief.weights * np.where(np.isnan(rating), 1.0, mass)
        # Where every bin has lost its probability, so has the rating: NaN, which costs the most.
        with np.errstate(invalid="ignore"):
            return Grid(weights / weights.sum(axis=1, keepdims=True), belief.before)

    def rating(self, belief: Grid) -> GridRating:
        """
        Return the distribution of the next rating.

        Parameters
        ----------
        belief : Grid
            The belief now.
        """
        return GridRating(belief.weights, CENTRES, self.rating_sd)
