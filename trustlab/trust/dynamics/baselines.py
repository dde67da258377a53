"""What a model of trust has to beat: persistence, a running mean, a constant."""

from dataclasses import dataclass
from typing import ClassVar

from trustlab.trust.dynamics.linear import LinearTrust
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
