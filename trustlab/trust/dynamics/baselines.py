"""What a model of trust has to beat: persistence, running mean, a constant, a person's habit."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy import special

from trustlab.trust.dynamics.linear import Gaussian, LinearTrust
from trustlab.trust.interface import Event, parameter


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


@dataclass(frozen=True)
class Habit(RunningMean):
    """
    People go on as before: ratings about their running mean, reliance at their share so far.

    Parameters
    ----------
    process_sd, rating_sd : float
        See `LinearTrust`; there is no process noise.
    """

    title: ClassVar[str] = "own habit"
    # States: trust, then how often a person could rely on the robot, and how often they did.
    direction: ClassVar[tuple[float, ...]] = (1.0, 0.0, 0.0)
    offset: ClassVar[tuple[float, ...]] = (0.0, 0.0, 0.0)

    def transition(self, event: Event):
        """
        Return a matrix that keeps all, and what is counted.

        Parameters
        ----------
        event : Event
            Its `followed`.
        """
        asked, relied = np.isfinite(event.followed), np.nan_to_num(event.followed)
        return np.eye(3), np.stack([0.0 * asked, asked, relied], axis=-1)

    def preference(self, belief: Gaussian) -> np.ndarray:
        """
        Return the log odds of the share of chances taken so far, one taken and one not added.

        Parameters
        ----------
        belief : Gaussian
            The belief now.
        """
        _, chances, relied = belief.mean.T
        return special.logit((relied + 1.0) / (chances + 2.0))
