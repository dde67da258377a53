"""Trust as a time series of performance and faults, after Lee and Moray."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from trustlab.trust.dynamics.linear import LinearTrust, columns
from trustlab.trust.interface import Event, parameter


@dataclass(frozen=True)
class SeriesTrust(LinearTrust):
    """
    T(k) = φ T(k−1) + c + A₁ p(k) + A₂ p(k−1) + F₁ f(k) + F₂ f(k−1) + e(k).

    The state holds T, p(k−1) and f(k−1). Before the first event p is .5 and f is 0.

    Parameters
    ----------
    memory : float
        φ.
    constant : float
        c.
    now, before : float
        A₁ and A₂, of performance.
    fault_now, fault_before : float
        F₁ and F₂, of the size of faults.
    process_sd, rating_sd : float
        See `LinearTrust`; e is of the process.

    Notes
    -----
    J. Lee, N. Moray, Trust, control strategies and allocation of function in human-machine systems,
    Ergonomics 35(10), 1992. Here the products A φ of the paper are coefficients of their own, and
    ratings have an error beside e. From secondary text.
    """

    title: ClassVar[str] = "time series (Lee and Moray)"
    direction: ClassVar[tuple[float, ...]] = (1.0, 0.0, 0.0)
    offset: ClassVar[tuple[float, ...]] = (0.0, 0.5, 0.0)
    memory: float = parameter(0.7, 0.0, 1.0)
    constant: float = parameter(0.1, -1.0, 1.0)
    now: float = parameter(0.1, -1.0, 1.0)
    before: float = parameter(0.01, -1.0, 1.0)
    fault_now: float = parameter(0.0, -1.0, 1.0)
    fault_before: float = parameter(0.0, -1.0, 1.0)

    @classmethod
    def as_performance(cls, a, gain, **noise):
        """
        Return this model where it is (3.2), for events of length 1.

        Parameters
        ----------
        a, gain, **noise : float
            Parameters of `PerformanceTrust`.
        """
        memory = float(np.exp(-a))
        return cls(memory=memory, constant=0.0, now=(1.0 - memory) * gain, before=0.0, **noise)

    def transition(self, event: Event):
        """
        Return the matrix of (T, p(k−1), f(k−1)) and what performance and fault add.

        Parameters
        ----------
        event : Event
            Its p_r and fault.
        """
        size = max(np.size(event.p_r), np.size(self.memory))
        matrix = np.zeros((size, 3, 3))
        matrix[:, 0] = columns(size, self.memory, self.before, self.fault_before)
        change = self.constant + self.now * event.p_r + self.fault_now * event.fault
        return matrix, columns(size, change, event.p_r, event.fault)
