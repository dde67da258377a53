"""Trust that changes at one rate after success and at another after failure."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from trustlab.trust.dynamics.linear import LinearTrust
from trustlab.trust.interface import Event, parameter


@dataclass(frozen=True)
class SwitchedTrust(LinearTrust):
    """
    T' = T + (1 − e^(−g dt)) (level − T), with a rate and a level for success and for failure.

    With equal rates and a level of 0 after failure it is (3.2) for performance of 0 or 1.

    Parameters
    ----------
    rate_success, rate_failure : float
        g, per unit of dt.
    level_success, level_failure : float
        Where trust settles under success, and under failure, alone.
    process_sd, rating_sd : float
        See `LinearTrust`.

    Notes
    -----
    Of the class of switched linear models, as in Williams, Chapman and Manzie, Trust modeling and
    estimation in human-autonomy interactions, arXiv 2510.09013, 2025, from the abstract. Success is
    a performance of .5 or more.
    """

    title: ClassVar[str] = "switched, asymmetric"
    rate_success: float = parameter(0.2, 0.0, np.inf)
    rate_failure: float = parameter(0.3, 0.0, np.inf)
    level_success: float = parameter(0.8, 0.0, 1.0)
    level_failure: float = parameter(0.2, 0.0, 1.0)

    @classmethod
    def as_performance(cls, a, gain, **noise):
        """
        Return this model where it is (3.2), for performances of 0 and 1.

        Parameters
        ----------
        a, gain, **noise : float
            Parameters of `PerformanceTrust`.
        """
        levels = {"level_success": gain, "level_failure": 0.0}
        return cls(rate_success=a, rate_failure=a, **levels, **noise)

    def transition(self, event: Event):
        """
        Return e^(−g dt) and (1 − e^(−g dt)) level, of success or failure.

        Parameters
        ----------
        event : Event
            Its dt and p_r.
        """
        success = event.p_r >= 0.5
        decay = np.exp(-np.where(success, self.rate_success, self.rate_failure) * event.dt)
        return decay, (1.0 - decay) * np.where(success, self.level_success, self.level_failure)
