"""Robot performance, (2.3)."""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np

from trustlab.models.checks import finite_array, finite_number, mode_array, open_unit

__all__ = ["RobotModel"]


@numba.njit(cache=True)
def robot_performance(mode, p_h, a, b, p_min, p_r0):
    """Run (2.3) from `p_r0`; the last sample of `mode` and `p_h` has no effect on what is returned."""
    p_r = np.empty(mode.size)
    p_r[0] = p_r0
    for k in range(mode.size - 1):
        p_r[k + 1] = a * p_r[k] + (1.0 - a) * p_min + mode[k] * b * p_h[k]
    return p_r


@dataclass(frozen=True)
class RobotModel:
    """
    How robot performance rises under manual control and decays when the robot is left alone.

    P_r(k+1) = a P_r(k) + (1 − a) P_min + M(k) b P_h(k), equation (2.3), with
    b = (1 − a)(P_max − P_min)/P_h,max, so that P_max is reached under the operator's best performance.

    Parameters
    ----------
    a : float
        a_pr, the share of performance kept over one sample, in (0, 1).
    p_min, p_max : float
        Least and greatest robot performance, in the unit of the measure (m/s for (2.4), 1 for a share).
    p_h_max : float
        Greatest human performance, in the unit of the operator's measure; positive.
    b : float, optional
        b_pr, the gain of human performance per sample. From (2.3) when not given. Give it to use a printed,
        rounded value. `dataclasses.replace` keeps b; pass b=None with the change to have it follow (2.3) again.

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
    b: float | None = None

    def __post_init__(self):
        a = open_unit("a", self.a)
        p_min, p_max = finite_number("p_min", self.p_min), finite_number("p_max", self.p_max)
        if not p_min < p_max:
            raise ValueError(f"p_min must be below p_max, got p_min = {p_min} and p_max = {p_max}")
        p_h_max = finite_number("p_h_max", self.p_h_max)
        if not p_h_max > 0.0:
            raise ValueError(f"p_h_max must be positive, got {p_h_max}")
        b = (1.0 - a) * (p_max - p_min) / p_h_max if self.b is None else finite_number("b", self.b)
        if not b > 0.0:
            raise ValueError(f"b must be positive, got {b}")
        for name, value in zip(
            ("a", "p_min", "p_max", "p_h_max", "b"), (a, p_min, p_max, p_h_max, b), strict=True
        ):
            object.__setattr__(self, name, value)

    @property
    def time_constant(self) -> float:
        """−1/ln a, the time constant of the decay, in samples."""
        return -1.0 / np.log(self.a)

    def steady_state(self, mode: float, p_h: float) -> float:
        """
        Return the performance that (2.3) settles at, P_min + M b P_h/(1 − a).

        Parameters
        ----------
        mode : float
            Manual share M, held for ever, in [0, 1].
        p_h : float
            Human performance P_h, held for ever.
        """
        share = mode_array(np.array([mode]))[0]
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
