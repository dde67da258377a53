"""Robot performance, (2.3)."""

from dataclasses import dataclass

import numpy as np

from trustlab.models.checks import (
    between,
    finite_array,
    finite_number,
    in_order,
    mode_array,
    open_unit,
    positive,
)
from trustlab.models.compiled import njit


def gain_of_human_performance(a, p_min, p_max, p_h_max):
    """Return b_pr = (1 − a_pr)(P_r,max − P_r,min)/P_h,max of (2.3); takes numbers or arrays."""
    return (1.0 - a) * (p_max - p_min) / p_h_max


@njit
def next_performance(p_r, p_h, mode, a, b, p_min):
    """Return robot performance one sample later, (2.3)."""
    return a * p_r + (1.0 - a) * p_min + mode * b * p_h


@njit
def robot_performance(mode, p_h, a, b, p_min, p_r0):
    """
    Simulate (2.3) from `p_r0`; the last sample of `mode` and `p_h` does not affect the result.
    """
    p_r = np.empty(mode.size)
    p_r[0] = p_r0
    for k in range(mode.size - 1):
        p_r[k + 1] = next_performance(p_r[k], p_h[k], mode[k], a, b, p_min)
    return p_r


@dataclass(frozen=True)
class RobotModel:
    """
    How robot performance rises under manual control and decays when the robot is left alone.

    P_r(k+1) = a P_r(k) + (1 − a) P_min + M(k) b P_h(k), equation (2.3), with b = (1 − a)(P_max −
    P_min)/P_h,max, so that P_max is reached under the operator's best performance.

    Parameters
    ----------
    a : float
        a_pr, the share of performance kept over one sample, in (0, 1).
    p_min, p_max : float
        Least and greatest robot performance, in the unit of the measure (m/s for (2.4), 1 for a
        share).
    p_h_max : float
        Greatest human performance, in the unit of the operator's measure; positive.
    b : float, optional
        b_pr, the gain of human performance per sample. From (2.3) when not given. Give it to use a
        printed, rounded value. `dataclasses.replace` keeps b; pass b=None with the change to have
        it follow (2.3) again.

    Raises
    ------
    ValueError
        If a is outside (0, 1), p_min is not below p_max, or p_h_max or b is not positive.

    Notes
    -----
    Saeidi, *Trust-based control of (semi)autonomous mobile robotic systems*, Section 2.2.2.

    Examples
    --------
    >>> robot = RobotModel(a=0.996, p_min=0.24, p_max=0.39, p_h_max=0.4602)
    >>> round(robot.b, 4)
    0.0013
    """

    a: float
    p_min: float
    p_max: float
    p_h_max: float
    b: float = None  # by (2.3) where it is not given

    def __post_init__(self):
        a = open_unit("a", self.a)
        p_min, p_max = in_order("p_min", self.p_min, "p_max", self.p_max)
        p_h_max = positive("p_h_max", self.p_h_max)
        b = positive(
            "b", gain_of_human_performance(a, p_min, p_max, p_h_max) if self.b is None else self.b
        )
        self.__dict__.update(a=a, p_min=p_min, p_max=p_max, p_h_max=p_h_max, b=b)

    @property
    def time_constant(self) -> float:
        """−1/ln a, in samples: after this many, 1/e of a deviation is left."""
        return -1.0 / np.log(self.a)

    def steady_state(self, mode: float, p_h: float) -> float:
        """
        Return the performance to which (2.3) converges, P_min + M b P_h/(1 − a).

        Parameters
        ----------
        mode : float
            Constant manual share M, in [0, 1].
        p_h : float
            Constant human performance P_h.
        """
        share = between("mode", mode, 0.0, 1.0)
        return self.p_min + share * self.b * finite_number("p_h", p_h) / (1.0 - self.a)

    def simulate(self, mode: np.ndarray, p_h: np.ndarray, p_r0: float | None = None) -> np.ndarray:
        """
        Simulate (2.3).

        Parameters
        ----------
        mode : array_like, shape (N,)
            1 manual, 0 autonomous, or a manual share in [0, 1], per sample.
        p_h : array_like, shape (N,)
            Human performance per sample.
        p_r0 : float, optional
            Robot performance at the first sample; P_min when not given.

        Returns
        -------
        numpy.ndarray, shape (N,)
            Robot performance; sample k + 1 follows from sample k.

        Raises
        ------
        ValueError
            If an input is not finite, lengths differ, or a mode lies outside [0, 1].
        """
        mode = mode_array(mode)
        p_h = finite_array("p_h", p_h, length=mode.size)
        start = self.p_min if p_r0 is None else finite_number("p_r0", p_r0)
        return robot_performance(mode, p_h, self.a, self.b, self.p_min, start)
