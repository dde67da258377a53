"""Trust with a memory and a bias, after Hu, Akash, Reid and Jain."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from trustlab.trust.dynamics.linear import LinearTrust, columns
from trustlab.trust.interface import Event, parameter


@dataclass(frozen=True)
class CumulativeTrust(LinearTrust):
    """
    T' = T + e (p − T) + c (C − T) + b (B − T), C' = (1 − g) C + g T'.

    C is cumulative trust, B a person's expectation. The weights e, c, b are shares of `change`, so
    that their sum is below 1.

    Parameters
    ----------
    change : float
        e + c + b.
    experience : float
        e as a share of `change`.
    memory : float
        c as a share of what experience leaves; b is the rest.
    forgetting : float
        g.
    bias : float
        B.
    process_sd, rating_sd : float
        See `LinearTrust`.

    Notes
    -----
    W.-L. Hu, K. Akash, T. Reid, N. Jain, IEEE Trans. Human-Machine Systems 49(6), 2019, from the
    abstract and secondary text. Noise acts on trust after cumulative trust has taken its share.
    """

    title: ClassVar[str] = "memory and bias (Hu and Akash)"
    direction: ClassVar[tuple[float, ...]] = (1.0, 1.0)
    offset: ClassVar[tuple[float, ...]] = (0.0, 0.0)
    change: float = parameter(0.3, 0.0, 1.0)
    experience: float = parameter(0.5, 0.0, 1.0)
    memory: float = parameter(0.5, 0.0, 1.0)
    forgetting: float = parameter(0.2, 0.0, 1.0)
    bias: float = parameter(0.5, 0.0, 1.0)

    @classmethod
    def as_performance(cls, a, gain, **noise):
        """
        Return this model where it is (3.2), for events of length 1.

        Parameters
        ----------
        a, gain, **noise : float
            Parameters of `PerformanceTrust`.
        """
        change = 1.0 - float(np.exp(-a))
        return cls(change=change, experience=gain, memory=0.0, bias=0.0, **noise)

    def transition(self, event: Event):
        """
        Return the matrix of trust and cumulative trust, and what experience and bias add.

        Parameters
        ----------
        event : Event
            Its p_r.
        """
        size = max(np.size(event.p_r), np.size(self.change))
        # Trust after the event as coefficients of trust, cumulative trust and 1.
        experience = self.change * self.experience
        memory = (self.change - experience) * self.memory
        expectation = self.change - experience - memory
        pull = experience * event.p_r + expectation * self.bias
        trust, g = columns(size, 1.0 - self.change, memory, pull), columns(size, self.forgetting)
        after = np.stack([trust, (1.0 - g) * [0.0, 1.0, 0.0] + g * trust], axis=1)
        return after[..., :2], after[..., 2]
