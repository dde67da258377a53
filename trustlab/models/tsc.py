"""
Trust and self-confidence (2.1)-(2.2), from the performance of robot (2.3) and human (2.5)-(2.6).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from trustlab.models.checks import (
    between,
    finite_array,
    finite_number,
    finite_numbers,
    mode_array,
    not_negative,
    of_class,
    open_unit,
    positive,
    set_checked,
    set_in_order,
)
from trustlab.models.compiled import njit

if TYPE_CHECKING:
    import pandas as pd


class TscConstants(NamedTuple):
    """The constants of a `TscModel` by the names they have in (2.1)-(2.6), for compiled code."""

    a_r: float
    beta: float
    p_h_min: float
    p_h_max: float
    a_pr: float
    b_pr: float
    p_r_min: float
    p_r_max: float
    a_T: float  # noqa: N815
    b_T: float  # noqa: N815


def performance_weights(p_r_min, p_r_max, p_h_min, p_h_max):
    """Return a_T and b_T of (2.2), the weights of performance in TSC; numbers or arrays."""
    scale = p_r_max * p_h_max - p_r_min * p_h_min
    return (p_h_max + p_h_min) / scale, (p_r_max + p_r_min) / scale


def gain_of_human_performance(a, p_min, p_max, p_h_max):
    """Return b_pr = (1 − a_pr)(P_r,max − P_r,min)/P_h,max of (2.3); numbers or arrays."""
    return (1.0 - a) * (p_max - p_min) / p_h_max


@njit
def next_performance(p_r, p_h, mode, a, b, p_min):
    """Return robot performance one sample later, (2.3)."""
    return a * p_r + (1.0 - a) * p_min + mode * b * p_h


@njit
def robot_performance(mode, p_h, a, b, p_min, p_r0):
    """Simulate (2.3) from `p_r0`; the last sample of `mode` and `p_h` has no effect."""
    p_r = np.empty(mode.size)
    p_r[0] = p_r0
    for k in range(mode.size - 1):
        p_r[k + 1] = next_performance(p_r[k], p_h[k], mode[k], a, b, p_min)
    return p_r


@njit
def next_utilization(r, mode, a):
    """Return utilization one sample later, (2.5)."""
    return a * r + (1.0 - a) * mode


@njit
def utilization(mode, a, r0):
    """Simulate (2.5) from `r0`; the last sample of `mode` has no effect."""
    r = np.empty(mode.size)
    r[0] = r0
    for k in range(mode.size - 1):
        r[k + 1] = next_utilization(r[k], mode[k], a)
    return r


@njit
def yerkes_dodson(r, beta):
    """Return (r/β)^β ((1 − r)/(1 − β))^(1 − β): 0 at r = 0 and 1, 1 at r = β."""
    if r <= 0.0 or r >= 1.0:
        return 0.0
    return np.exp(beta * np.log(r / beta) + (1.0 - beta) * np.log((1.0 - r) / (1.0 - beta)))


@njit
def performance_at(r, beta, p_min, p_max):
    """Return human performance at utilization r, (2.6)."""
    return (p_max - p_min) * yerkes_dodson(r, beta) + p_min


@njit
def performance_curve(r, beta, p_min, p_max):
    """Return human performance at each utilization in `r`, (2.6)."""
    p_h = np.empty(r.size)
    for k in range(r.size):
        p_h[k] = performance_at(r[k], beta, p_min, p_max)
    return p_h


@njit
def human_at(r, c):
    """Return P_h at utilization r, (2.6)."""
    return performance_at(r, c.beta, c.p_h_min, c.p_h_max)


@njit
def human_range(low, high, c):
    """Return the least and greatest P_h over utilizations in [low, high], (2.6)."""
    # (2.6) is concave with its maximum at β: the minimum is at an end, and so is the maximum unless
    # β lies between. There it is P_h,max itself, which (2.6) may miss by rounding.
    at_low, at_high = human_at(low, c), human_at(high, c)
    return min(at_low, at_high), c.p_h_max if low <= c.beta <= high else max(at_low, at_high)


@njit
def tsc_at(p_r, p_h, c):
    """Return TSC, (2.1)."""
    return c.a_T * p_r - c.b_T * p_h


@njit
def advance(r, p_r, p_h, mode, c):
    """Return r and P_r one sample later, (2.5) and (2.3); p_h is P_h at r."""
    return next_utilization(r, mode, c.a_r), next_performance(
        p_r, p_h, mode, c.a_pr, c.b_pr, c.p_r_min
    )


# Inlined before it is optimized, so that loops keep its branches, which the processor predicts: as
# selections they would make each step wait for the TSC of the one before, and a simulation take
# twice as long.
@njit(inline="always")
def threshold_mode(tsc, lower, upper, mode):
    """
    Return the mode of rule (2.8): 0 when TSC ≥ upper, 1 when TSC ≤ lower, else `mode` unchanged.
    """
    if tsc >= upper:
        return 0
    if tsc <= lower:
        return 1
    return mode


@dataclass(frozen=True)
class RobotModel:
    """
    Robot performance, which rises under manual control and decays when the robot is left alone.

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
        b_pr, the gain of human performance per sample; by (2.3) when not given. Give it to use a
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
    >>> import trustlab as tl
    >>> robot = tl.RobotModel(a=0.996, p_min=0.24, p_max=0.39, p_h_max=0.4602)
    >>> round(robot.b, 4)
    0.0013
    """

    a: float
    p_min: float
    p_max: float
    p_h_max: float
    b: float = None

    def __post_init__(self):
        set_checked(self, open_unit, "a")
        set_in_order(self, "p_min", "p_max")
        set_checked(self, positive, "p_h_max")
        if self.b is None:
            b = gain_of_human_performance(self.a, self.p_min, self.p_max, self.p_h_max)
            self.__dict__["b"] = b
        set_checked(self, positive, "b")

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


@dataclass(frozen=True)
class HumanModel:
    """
    The operator's utilization, and their performance at a given utilization (Yerkes–Dodson).

    r(k+1) = a r(k) + (1 − a) M(k), equation (2.5), and
    P_h(k) = (P_max − P_min)(r/β)^β ((1 − r)/(1 − β))^(1 − β) + P_min, equation (2.6).

    Parameters
    ----------
    a : float
        a_r = 1 − 1/τ, the share of utilization that remains after one sample, in (0, 1). b_r is 1 −
        a.
    beta : float
        β, the utilization at which the operator performs best, in (0, 1); smaller for a harder
        task.
    p_min, p_max : float
        Human performance at r = 0 and r = 1, and at r = β, in the unit of the measure.

    Raises
    ------
    ValueError
        If a or beta is outside (0, 1) or p_min is not below p_max.

    Notes
    -----
    Saeidi, *Trust-based control of (semi)autonomous mobile robotic systems*, Section 2.2.3.

    Examples
    --------
    >>> import trustlab as tl
    >>> human = tl.HumanModel(a=0.9991, beta=0.74, p_min=0.391, p_max=0.4602)
    >>> round(float(human.performance(0.74)), 4)
    0.4602
    """

    a: float
    beta: float
    p_min: float
    p_max: float

    def __post_init__(self):
        set_checked(self, open_unit, "a", "beta")
        set_in_order(self, "p_min", "p_max")

    @property
    def b(self) -> float:
        """b_r = 1 − a_r = 1/τ, equation (2.5)."""
        return 1.0 - self.a

    @property
    def time_constant(self) -> float:
        """
        −1/ln a, in samples: after this many, 1/e of a deviation is left.

        τ of (2.5), 1/b, is half a sample more.
        """
        return -1.0 / np.log(self.a)

    def performance(self, r: float | np.ndarray) -> Any:
        """
        Return human performance at utilization `r`, equation (2.6).

        Parameters
        ----------
        r : float or array_like
            Utilization, in [0, 1].

        Returns
        -------
        float or numpy.ndarray
            Performance, of the shape of `r`.

        Raises
        ------
        ValueError
            If a utilization lies outside [0, 1].
        """
        array = finite_numbers("r", r)
        inside = (array >= 0.0) & (array <= 1.0)
        if not inside.all():
            raise ValueError(f"utilization r must lie in [0, 1], got {array[~inside].flat[0]}")
        p_h = performance_curve(array.ravel(), self.beta, self.p_min, self.p_max)
        return p_h.item() if array.ndim == 0 else p_h.reshape(array.shape)

    def simulate(self, mode: np.ndarray, r0: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
        """
        Simulate (2.5) and (2.6).

        Parameters
        ----------
        mode : array_like, shape (N,)
            1 manual, 0 autonomous, or a manual share in [0, 1], per sample.
        r0 : float
            Utilization at the first sample, in [0, 1]; 0 is a rested operator.

        Returns
        -------
        r : numpy.ndarray, shape (N,)
            Utilization; sample k + 1 follows from sample k.
        p_h : numpy.ndarray, shape (N,)
            Human performance.

        Raises
        ------
        ValueError
            If a mode or `r0` lies outside [0, 1].
        """
        start = between("r0", r0, 0.0, 1.0)
        r = utilization(mode_array(mode), self.a, start)
        return r, performance_curve(r, self.beta, self.p_min, self.p_max)


@dataclass(frozen=True)
class TscModel:
    """
    The difference between trust in the robot and self-confidence, from the performance of both.

    TSC(k) = a_T P_r(k) − b_T P_h(k), equation (2.1), with a_T and b_T of (2.2), so that TSC is +1
    where the robot is at its best and the operator at their worst, and −1 the other way round.

    Parameters
    ----------
    robot : RobotModel
        Robot performance (2.3).
    human : HumanModel
        Human utilization and performance (2.5)-(2.6).

    Raises
    ------
    ValueError
        If the ranges of performance give no positive a_T and b_T.

    Notes
    -----
    Saeidi, *Trust-based control of (semi)autonomous mobile robotic systems*, Section 2.2.1.

    Examples
    --------
    >>> import trustlab as tl
    >>> robot = tl.RobotModel(a=0.996, p_min=0.24, p_max=0.39, p_h_max=0.4602)
    >>> human = tl.HumanModel(a=0.9991, beta=0.74, p_min=0.391, p_max=0.4602)
    >>> tsc = tl.TscModel(robot, human)
    >>> round(tsc.a_T, 2), round(tsc.b_T, 2)
    (9.94, 7.36)
    """

    robot: RobotModel
    human: HumanModel

    how_to_get = (
        "fit one with trustlab.fit_tsc(session) or build it with trustlab.TscModel(robot, human)"
    )

    def __post_init__(self):
        robot, human = self.robot, self.human
        of_class("robot", robot, RobotModel)
        of_class("human", human, HumanModel)
        # Then P_max > |P_min| for both, so that the denominator of (2.2) is positive as well.
        if not (robot.p_min + robot.p_max > 0.0 and human.p_min + human.p_max > 0.0):
            raise ValueError(
                "a_T and b_T of (2.2) must be positive, so that P_min + P_max must be, but the "
                f"ranges of performance are [{robot.p_min}, {robot.p_max}] (robot) and "
                f"[{human.p_min}, {human.p_max}] (human); use measures of performance that are "
                "not negative"
            )

    def constants(self) -> TscConstants:
        """Return the model's constants by name, as compiled code takes them."""
        human, robot = self.human, self.robot
        ranges = robot.p_min, robot.p_max, human.p_min, human.p_max
        a_T, b_T = performance_weights(*ranges)
        return TscConstants(
            human.a, human.beta, human.p_min, human.p_max,
            robot.a, robot.b, robot.p_min, robot.p_max, a_T, b_T,
        )  # fmt: skip

    @property
    def a_T(self) -> float:  # noqa: N802
        """a_T = (P_h,max + P_h,min)/(P_r,max P_h,max − P_r,min P_h,min), equation (2.2)."""
        return self.constants().a_T

    @property
    def b_T(self) -> float:  # noqa: N802
        """b_T = (P_r,max + P_r,min)/(P_r,max P_h,max − P_r,min P_h,min), equation (2.2)."""
        return self.constants().b_T

    def value(self, p_r: float | np.ndarray, p_h: float | np.ndarray) -> Any:
        """
        Return TSC = a_T P_r − b_T P_h, equation (2.1).

        Parameters
        ----------
        p_r, p_h : float or array_like
            Robot and human performance, of shapes that broadcast.
        """
        robot, human = finite_numbers("p_r", p_r)[()], finite_numbers("p_h", p_h)[()]
        return self.a_T * robot - self.b_T * human

    def delta(self, delta_p_r: float, delta_p_h: float) -> float:
        """
        Return the largest one-step change of TSC, a_T δ_Pr + b_T δ_Ph (Remark 3).

        Parameters
        ----------
        delta_p_r, delta_p_h : float
            Largest one-step changes of robot and human performance; not negative.

        Raises
        ------
        ValueError
            If a change is negative or not finite.
        """
        of_robot = self.a_T * not_negative("delta_p_r", delta_p_r)
        return of_robot + self.b_T * not_negative("delta_p_h", delta_p_h)

    def simulate(
        self, mode: np.ndarray, r0: float = 0.0, p_r0: float | None = None
    ) -> pd.DataFrame:
        """
        Simulate (2.1), (2.3), (2.5) and (2.6) under a given sequence of modes.

        Parameters
        ----------
        mode : array_like, shape (N,)
            1 manual, 0 autonomous, or a manual share in [0, 1], per sample.
        r0 : float
            Utilization at the first sample, in [0, 1].
        p_r0 : float, optional
            Robot performance at the first sample; the robot's P_min when not given.

        Returns
        -------
        pandas.DataFrame
            Columns r, p_r, p_h, tsc, mode; one row per sample.

        Raises
        ------
        ValueError
            If a mode or `r0` lies outside [0, 1].
        """
        import pandas as pd

        r, p_h = self.human.simulate(mode, r0)
        p_r = self.robot.simulate(mode, p_h, p_r0)
        tsc, modes = self.value(p_r, p_h), np.asarray(mode, float)
        return pd.DataFrame({"r": r, "p_r": p_r, "p_h": p_h, "tsc": tsc, "mode": modes})
