"""Trust with inertia: the belief of the extended decision field theory of Gao and Lee."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from trustlab.trust.dynamics.linear import LinearTrust, columns
from trustlab.trust.interface import Event, parameter


@dataclass(frozen=True)
class FieldTrust(LinearTrust):
    """
    Trust follows a belief in the robot's capability, which is learned only where it is seen.

    B' = B + g (p − B) where the robot is seen, else B + h (B_0 − B), and T' = (1 − s) T + s B'. The
    state holds T, B and B_0, where the belief began.

    Parameters
    ----------
    learning : float
        g = 1/b₁.
    forgetting : float
        h = 1/b₀.
    inertia : float
        s, the share of what is new.
    process_sd, rating_sd : float
        See `LinearTrust`.

    Notes
    -----
    J. Gao, J. D. Lee, IEEE Trans. SMC A 36(5), 2006. The belief begins at the first rating of
    trust; noise acts on trust alone. Self-confidence and the preference for the robot, which decide
    on reliance and not on trust, are left out. From the abstract and secondary text.
    """

    title: ClassVar[str] = "decision field (Gao and Lee)"
    direction: ClassVar[tuple[float, ...]] = (1.0, 1.0, 1.0)
    offset: ClassVar[tuple[float, ...]] = (0.0, 0.0, 0.0)
    learning: float = parameter(0.3, 0.0, 1.0)
    forgetting: float = parameter(0.1, 0.0, 1.0)
    inertia: float = parameter(0.5, 0.0, 1.0)

    def transition(self, event: Event):
        """
        Return the matrix of T, B and B_0 and what performance adds.

        Parameters
        ----------
        event : Event
            Its p_r and seen.
        """
        size = max(np.size(event.p_r), np.size(self.inertia))
        seen, s = np.asarray(event.seen) > 0.5, self.inertia
        forgotten = np.where(seen, 0.0, self.forgetting)
        kept = 1.0 - np.where(seen, self.learning, forgotten)
        gain = np.where(seen, self.learning * event.p_r, 0.0)
        matrix = np.zeros((size, 3, 3))
        matrix[:, 0] = columns(size, 1.0 - s, s * kept, s * forgotten)
        matrix[:, 1] = columns(size, 0.0, kept, forgotten)
        matrix[:, 2, 2] = 1.0
        return matrix, columns(size, s * gain, gain, 0.0)
