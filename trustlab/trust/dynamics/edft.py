"""Reliance with inertia: the extended decision field theory of Gao and Lee."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from trustlab.trust.dynamics.linear import Gaussian, LinearTrust, columns
from trustlab.trust.interface import Event, parameter

# States: trust, belief in the robot and where it began, self-confidence, belief in oneself and
# where it began, preference for the robot.
T, B_R, B_R0, S, B_H, B_H0, P = range(7)


@dataclass(frozen=True)
class FieldTrust(LinearTrust):
    """
    Trust follows a belief in the robot's capability, which is learned only where it is seen.

    B_r' = B_r + g (p_r − B_r) where the robot is seen, else B_r + h (B_r0 − B_r); B_h likewise for
    the person's performance, seen in manual mode. T' = (1 − s) T + s B_r', S' = (1 − s) S + s B_h',
    P' = (1 − s) P + s (T' − S').

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
    J. Gao, J. D. Lee, IEEE Trans. SMC A 36(5), 2006. Beliefs begin at the first rating of trust,
    self-confidence at .5; noise acts on trust alone, and reliance is logistic in P in place of two
    thresholds. From the abstract and secondary text.
    """

    title: ClassVar[str] = "decision field (Gao and Lee)"
    direction: ClassVar[tuple[float, ...]] = (1.0, 1.0, 1.0, 0.0, 0.0, 0.0, 1.0)
    offset: ClassVar[tuple[float, ...]] = (0.0, 0.0, 0.0, 0.5, 0.5, 0.5, -0.5)
    learning: float = parameter(0.3, 0.0, 1.0)
    forgetting: float = parameter(0.1, 0.0, 1.0)
    inertia: float = parameter(0.5, 0.0, 1.0)

    def transition(self, event: Event):
        """
        Return the matrix of the seven states and what performance adds.

        Parameters
        ----------
        event : Event
            Its p_r, p_h, mode and seen.
        """
        size = max(np.size(event.p_r), np.size(self.inertia))
        # A sum of states and a number is a row of their coefficients.
        *state, number = np.eye(8)
        names = self.inertia, self.learning, self.forgetting
        s, learning, forgetting = (columns(size, each) for each in names)
        after = np.tile(state, (size, 1, 1))
        ends = [(T, B_R, B_R0, event.seen, event.p_r), (S, B_H, B_H0, event.mode, event.p_h)]
        for level, belief, origin, visible, performance in ends:
            learned = columns(size, performance) * number - state[belief]
            forgotten = state[origin] - state[belief]
            visible = columns(size, visible) > 0.5
            after[:, belief] += np.where(visible, learning * learned, forgetting * forgotten)
            after[:, level] += s * (after[:, belief] - state[level])
        after[:, P] += s * (after[:, T] - after[:, S] - state[P])
        return after[..., :7], after[..., 7]

    def preference(self, belief: Gaussian) -> np.ndarray:
        """
        Return P, the preference for the robot.

        Parameters
        ----------
        belief : Gaussian
            The belief now.
        """
        return belief.mean[:, P]
