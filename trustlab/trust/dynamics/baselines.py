"""What a model of trust has to beat: persistence, running mean, a constant, a person's habit."""

from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np
from scipy import special

from trustlab.trust.dynamics.linear import Gaussian, LinearTrust
from trustlab.trust.interface import Event, NormalRating, TrustDynamics, parameter


@dataclass(frozen=True)
class Persistence(LinearTrust):
    """
    The next rating is about the last: a random walk that no event moves.

    Parameters
    ----------
    process_sd, rating_sd : float
        See `LinearTrust`.
    """

    title: ClassVar[str] = "persistence"

    def transition(self, event: Event):
        """
        Return 1 and 0.

        Parameters
        ----------
        event : Event
            Without effect.
        """
        return 1.0, 0.0


@dataclass(frozen=True)
class RunningMean(Persistence):
    """
    The next rating is about the mean of the person's ratings so far.

    Parameters
    ----------
    process_sd, rating_sd : float
        See `LinearTrust`; there is no process noise.
    """

    title: ClassVar[str] = "running mean"
    process_sd: float = 0.0


@dataclass(frozen=True)
class Constant(LinearTrust):
    """
    Every rating is about the same number, whoever gives it.

    Parameters
    ----------
    level : float
        The number.
    process_sd, rating_sd : float
        See `LinearTrust`; there is no process noise.
    """

    title: ClassVar[str] = "constant"
    process_sd: float = 0.0
    level: float = parameter(0.5, 0.0, 1.0)

    def transition(self, event: Event):
        """
        Return 0 and the level.

        Parameters
        ----------
        event : Event
            Without effect.
        """
        return 0.0, self.level


class RelianceRecord(NamedTuple):
    """The belief in ratings, and how often a person could rely on the robot and did, shape (N,)."""

    ratings: Gaussian
    chances: np.ndarray
    relied: np.ndarray


@dataclass(frozen=True)
class Habit(TrustDynamics):
    """
    People go on as before: ratings about their running mean, reliance at their share so far.

    Parameters
    ----------
    rating_sd : float
        Standard deviation of ratings about their mean.
    """

    title: ClassVar[str] = "own habit"
    rating_sd: float = parameter(0.1, 1e-3, 1.0)

    @property
    def _ratings(self) -> RunningMean:
        mean = RunningMean()
        mean.__dict__["rating_sd"] = self.rating_sd
        return mean

    def start(self, rating) -> RelianceRecord:
        """
        Return the belief after a first rating.

        Parameters
        ----------
        rating : array_like, shape (N,)
            Ratings, 0 to 1.
        """
        belief = self._ratings.start(rating)
        none = np.zeros(len(belief.mean))
        return RelianceRecord(belief, none, none)

    def step(self, belief: RelianceRecord, event: Event) -> RelianceRecord:
        """
        Return the belief after an event.

        Parameters
        ----------
        belief : RelianceRecord
            The belief before it.
        event : Event
            Its `followed`.
        """
        asked = np.isfinite(event.followed)
        relied = belief.relied + np.where(asked, event.followed, 0.0)
        return RelianceRecord(belief.ratings, belief.chances + asked, relied)

    def learn(self, belief: RelianceRecord, rating) -> RelianceRecord:
        """
        Return the belief after a rating; unchanged where it is NaN.

        Parameters
        ----------
        belief : RelianceRecord
            The belief before it.
        rating : array_like, shape (N,)
            Ratings, 0 to 1.
        """
        return belief._replace(ratings=self._ratings.learn(belief.ratings, rating))

    def rating(self, belief: RelianceRecord) -> NormalRating:
        """
        Return the distribution of the next rating.

        Parameters
        ----------
        belief : RelianceRecord
            The belief now.
        """
        return self._ratings.rating(belief.ratings)

    def preference(self, belief: RelianceRecord) -> np.ndarray:
        """
        Return the log odds of the share of chances taken so far, one taken and one not added.

        Parameters
        ----------
        belief : RelianceRecord
            The belief now.
        """
        return special.logit((belief.relied + 1.0) / (belief.chances + 2.0))
