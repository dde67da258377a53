"""The dissertation's model (3.2): trust decays with its level and grows with performance."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from trustlab.models.trust import trust_step
from trustlab.trust.dynamics.linear import LinearTrust
from trustlab.trust.interface import Event, parameter


@dataclass(frozen=True)
class PerformanceTrust(LinearTrust):
    """
    Trust by (3.2): the same rate after success and after failure.

    Parameters
    ----------
    a : float
        Rate of trust, per unit of dt.
    gain : float
        b/a, the level that trust settles at under full performance; at most 1 by (3.4).
    process_sd, rating_sd : float
        See `LinearTrust`.
    """

    title: ClassVar[str] = "performance, (3.2)"
    a: float = parameter(0.2, 0.0, np.inf)
    gain: float = parameter(0.8, 0.0, 1.0)

    def transition(self, event: Event):
        """
        Return e^(−a dt) and (b/a)(1 − e^(−a dt)) p, of (3.2).

        Parameters
        ----------
        event : Event
            Its dt and p_r.
        """
        decay = np.exp(-self.a * event.dt)
        return decay, trust_step.py_func(0.0, event.p_r, decay, self.gain)  # (3.2)
