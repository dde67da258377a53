"""Models that are linear in trust: what is believed of it is normal, by Kalman's filter."""

from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np

from trustlab.trust.interface import Event, NormalRating, TrustDynamics, cell, parameter


class Gaussian(NamedTuple):
    """Mean, shape (N, states), and covariance, shape (N, states, states), of the state."""

    mean: np.ndarray
    covariance: np.ndarray


def columns(size: int, *values: Any) -> np.ndarray:
    """Return parameters and signals side by side, a row per person."""
    rows = [np.broadcast_to(value, size) for value in values]
    return np.stack(rows, axis=-1).astype(float)


@dataclass(frozen=True)
class LinearTrust(TrustDynamics):
    """
    Trust that is linear in the state: x' = A x + b + noise, rating = x₁ + noise.

    A subclass returns A and b of an event from `transition`; trust is the first state.

    Parameters
    ----------
    process_sd : float
        Standard deviation of what an event adds to trust, per √dt.
    rating_sd : float
        Standard deviation of a rating about trust.
    """

    rounds: ClassVar[bool] = True
    process_sd: float = parameter(0.05, 1e-3, 1.0)
    rating_sd: float = parameter(0.05, 1e-3, 1.0)

    # The state before the first event is offset + direction · (first rating).
    direction: ClassVar[tuple[float, ...]] = (1.0,)
    offset: ClassVar[tuple[float, ...]] = (0.0,)

    def transition(self, event: Event) -> tuple[Any, Any]:
        """
        Return A and b: two numbers per person, or matrices (N, d, d) and vectors (N, d).

        Parameters
        ----------
        event : Event
            What happened.
        """
        raise NotImplementedError(f"{self.name} has no method transition")

    def start(self, rating, resolution: float = 0.0) -> Gaussian:
        """
        Return the belief after a first rating; trust is anywhere in [0, 1] where there is none.

        Parameters
        ----------
        rating : array_like, shape (N,)
            Ratings, 0 to 1.
        resolution : float
            Step of the scale, 0 where nobody rounds.
        """
        rating = np.atleast_1d(rating)
        missing = np.isnan(rating)
        first = np.where(missing, 0.5, rating)
        variance = np.where(missing, 1.0 / 12.0, self.rating_sd**2 + resolution**2 / 12.0)
        direction = np.array(self.direction)
        mean = np.array(self.offset) + first[:, None] * direction
        return Gaussian(mean, variance[:, None, None] * np.outer(direction, direction))

    def step(self, belief: Gaussian, event: Event) -> Gaussian:
        """
        Return the belief after an event.

        Parameters
        ----------
        belief : Gaussian
            The belief before it.
        event : Event
            What happened.
        """
        size, states = belief.mean.shape
        matrix, shift = self.transition(event)
        if states == 1:
            matrix, shift = columns(size, matrix)[..., None], columns(size, shift)
        mean = (matrix @ belief.mean[..., None])[..., 0] + shift
        covariance = matrix @ belief.covariance @ np.swapaxes(matrix, -1, -2)
        covariance[:, 0, 0] += self.process_sd**2 * event.dt
        return Gaussian(mean, covariance)

    def learn(self, belief: Gaussian, rating, resolution: float = 0.0) -> Gaussian:
        """
        Return the belief after a rating, as a normal one of the same mean and covariance; unchanged
        where the rating is NaN.

        Parameters
        ----------
        belief : Gaussian
            The belief before it.
        rating : array_like, shape (N,)
            Ratings, 0 to 1.
        resolution : float
            Step of the scale, 0 where nobody rounds.
        """
        before = self.rating(belief)
        meant, left = before.within(*cell(np.asarray(rating, float), resolution))
        known = np.isfinite(meant)
        with_trust = belief.covariance[:, :, 0] / before.sd[:, None]
        moved, fall = (meant - before.mean) / before.sd, 1.0 - left / before.sd**2
        moved, fall = (np.where(known, each, 0.0) for each in (moved, fall))
        mean = belief.mean + moved[:, None] * with_trust
        outer = with_trust[:, :, None] * with_trust[:, None, :]
        return Gaussian(mean, belief.covariance - fall[:, None, None] * outer)

    def rating(self, belief: Gaussian) -> NormalRating:
        """
        Return the distribution of the next rating.

        Parameters
        ----------
        belief : Gaussian
            The belief now.
        """
        variance = np.maximum(belief.covariance[:, 0, 0], 0.0) + self.rating_sd**2
        return NormalRating(belief.mean[:, 0], np.sqrt(variance))
