"""Trust and self-confidence (TSC), (2.1)-(2.2)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from trustlab.models.checks import not_negative
from trustlab.models.compiled import njit
from trustlab.models.human import HumanModel, next_utilization, performance_at, performance_range
from trustlab.models.robot import RobotModel, next_performance

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


@njit
def human_at(r, c):
    """Return P_h at utilization r, (2.6)."""
    return performance_at(r, c.beta, c.p_h_min, c.p_h_max)


@njit
def human_range(low, high, c):
    """Return the least and greatest P_h over utilizations in [low, high], (2.6)."""
    return performance_range(low, high, c.beta, c.p_h_min, c.p_h_max)


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
        if not isinstance(self.robot, RobotModel) or not isinstance(self.human, HumanModel):
            raise ValueError(
                "TscModel takes a RobotModel and a HumanModel, in this order; "
                f"got {type(self.robot).__name__} and {type(self.human).__name__}"
            )
        robot, human = self.robot, self.human
        # Then P_max > |P_min| for both, so that the denominator of (2.2) is positive as well.
        if not (robot.p_min + robot.p_max > 0.0 and human.p_min + human.p_max > 0.0):
            raise ValueError(
                "a_T and b_T of (2.2) must be positive, so that P_min + P_max must be, but the "
                f"ranges of performance are [{robot.p_min}, {robot.p_max}] (robot) and "
                f"[{human.p_min}, {human.p_max}] (human); use measures of performance that are "
                "not negative"
            )

    def _weights(self) -> tuple[float, float]:
        robot, human = self.robot, self.human
        return performance_weights(robot.p_min, robot.p_max, human.p_min, human.p_max)

    @property
    def a_T(self) -> float:  # noqa: N802
        """a_T = (P_h,max + P_h,min)/(P_r,max P_h,max − P_r,min P_h,min), equation (2.2)."""
        return self._weights()[0]

    @property
    def b_T(self) -> float:  # noqa: N802
        """b_T = (P_r,max + P_r,min)/(P_r,max P_h,max − P_r,min P_h,min), equation (2.2)."""
        return self._weights()[1]

    def constants(self) -> TscConstants:
        """Return the model's constants by name, as compiled code takes them."""
        human, robot = self.human, self.robot
        return TscConstants(
            a_r=human.a,
            beta=human.beta,
            p_h_min=human.p_min,
            p_h_max=human.p_max,
            a_pr=robot.a,
            b_pr=robot.b,
            p_r_min=robot.p_min,
            p_r_max=robot.p_max,
            a_T=self.a_T,
            b_T=self.b_T,
        )

    def value(self, p_r: float | np.ndarray, p_h: float | np.ndarray) -> Any:
        """
        Return TSC = a_T P_r − b_T P_h, equation (2.1).

        Parameters
        ----------
        p_r, p_h : float or array_like
            Robot and human performance, of shapes that broadcast.
        """
        return (
            self.a_T * np.asarray(p_r, dtype=float)[()]
            - self.b_T * np.asarray(p_h, dtype=float)[()]
        )

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
        delta_p_r, delta_p_h = (
            not_negative("delta_p_r", delta_p_r),
            not_negative("delta_p_h", delta_p_h),
        )
        return self.a_T * delta_p_r + self.b_T * delta_p_h

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
