"""
The correction inside a compiled loop: thresholds that move sample by sample while a testbed runs.
"""

from typing import NamedTuple

import numpy as np

from trustlab.allocation.correction.exact import SEARCHED, Workspace, search, unsearched_cost
from trustlab.allocation.correction.plan import LOWER, UPPER
from trustlab.models.compiled import njit
from trustlab.models.tsc import TscConstants, TscModel

# What is logged at each sample; NaN where nothing was planned.
CORRECTED = np.dtype(
    [
        ("lower", float),
        ("upper", float),
        ("cost", float),
        ("bound", float),
        (
            "clipped",
            bool,
        ),  # performance lay outside the model's range, and its nearest end was used
    ]
)


class LoopCorrection(NamedTuple):
    """
    What the exact engine needs in a compiled loop; `thresholds` is updated by every correction.
    """

    adopted: bool  # whether the operator's own thresholds move along
    constants: tuple  # of TscConstants, in their order
    c_b: float
    target: np.ndarray
    budget: int
    thresholds: np.ndarray
    work: Workspace
    log: np.ndarray  # rows of CORRECTED


def loop_correction(
    tsc: TscModel,
    start: tuple[float, float],
    target: tuple[float, float],
    c_b: float,
    horizon: int,
    samples: int,
    adopted: bool = False,
    budget: int = SEARCHED,
) -> LoopCorrection:
    """
    Return what a loop of so many samples needs to correct thresholds from `start` towards `target`,
    which the caller has checked.
    """
    return LoopCorrection(
        adopted=adopted,
        constants=tuple(tsc.constants()),
        c_b=float(c_b),
        target=np.array(target, dtype=float),
        budget=budget,
        thresholds=np.array(start, dtype=float),
        work=Workspace.of(horizon),
        log=np.full(samples, np.array((np.nan, np.nan, np.nan, np.nan, False), CORRECTED)),
    )


@njit(inline="always")
def correct_thresholds(correction, k, r, p_r, mode):
    """Log sample k, plan, and correct the thresholds by one step; return c_l and c_u."""
    c = TscConstants(*correction.constants)
    thresholds = correction.thresholds
    work = correction.work
    now = min(max(p_r, c.p_r_min), c.p_r_max)
    problem, standard = (correction.constants, correction.c_b, correction.target), True
    state, room = (
        (thresholds, r, now, float(mode), standard),
        (work.steps, work.thresholds, work.waiting, work.states),
    )
    cost, bound, _, complete, _, _ = search(
        *problem, correction.budget, *state, *room, work.actions
    )
    if not complete:
        bound = min(bound, unsearched_cost(*problem, thresholds, standard, *room[:3]))
    row = correction.log[k]
    row.lower, row.upper = thresholds[LOWER], thresholds[UPPER]
    row.cost = cost
    row.bound = bound
    row.clipped = now != p_r
    c_l, c_u = work.actions[LOWER, 0], work.actions[UPPER, 0]
    thresholds[LOWER] += c_l
    thresholds[UPPER] += c_u
    return c_l, c_u
