"""Largest one-step changes δ of performance and TSC (Assumption 3, Remark 3), computed from the models."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trustlab.models.checks import finite_number, of_class
from trustlab.models.tsc import TscModel

__all__ = ["StepBounds", "step_bounds"]


@dataclass(frozen=True)
class StepBounds:
    """
    Largest one-step changes.

    Parameters
    ----------
    delta_p_h, delta_p_r : float
        δ_Ph and δ_Pr, of human and robot performance.
    delta_tsc : float
        δ_TSC = a_T δ_Pr + b_T δ_Ph (Remark 3).
    """

    delta_p_h: float
    delta_p_r: float
    delta_tsc: float


def step_bounds(tsc: TscModel, r_low: float = 0.05, r_high: float = 0.95) -> StepBounds:
    """
    Return the largest one-step changes that (2.3), (2.5) and (2.6) allow.

    Parameters
    ----------
    tsc : TscModel
        The model.
    r_low, r_high : float
        Range of utilization that is considered. (2.6) is infinitely steep at rest and at full load, so that δ_Ph over
        all of [0, 1] is of no use; the dissertation takes δ from the fitted curves of an experiment, which keeps
        away from both ends.

    Returns
    -------
    StepBounds
        Suprema over both modes, over r in [r_low, r_high] and P_r in [p_min, p_max].

    Raises
    ------
    ValueError
        If `tsc` is not a `TscModel`, or the range is not within [0, 1].
    """
    of_class("tsc", tsc, TscModel)
    low, high = finite_number("r_low", r_low), finite_number("r_high", r_high)
    if not 0.0 <= low < high <= 1.0:
        raise ValueError(f"utilization must range within [0, 1] with r_low < r_high, got [{low}, {high}]")
    human, robot = tsc.human, tsc.robot
    grid = np.linspace(low, high, 4001)
    best = 0.0
    for mode in (0.0, 1.0):
        for _ in range(6):
            after = np.clip(human.a * grid + human.b * mode, 0.0, 1.0)
            change = np.abs(human.performance(after) - human.performance(grid))
            k = int(np.argmax(change))
            best = max(best, float(change[k]))
            grid = np.linspace(grid[max(k - 1, 0)], grid[min(k + 1, grid.size - 1)], 401)
        grid = np.linspace(low, high, 4001)
    ceiling = robot.p_min + robot.b * human.p_max / (1.0 - robot.a)
    delta_p_r = (1.0 - robot.a) * max(robot.p_max - robot.p_min, ceiling - robot.p_min)
    return StepBounds(best, delta_p_r, tsc.delta(delta_p_r, best))
