"""
The correction inside a compiled loop: thresholds that move sample by sample while a testbed runs.
"""

from typing import NamedTuple

import numpy as np

from trustlab.allocation.correction.corrector import ThresholdCorrector
from trustlab.allocation.correction.exact import ExactEngine, Workspace, search, unsearched_cost
from trustlab.allocation.correction.incentive import incentive_box
from trustlab.allocation.correction.plan import LOWER, UPPER
from trustlab.models.compiled import njit
from trustlab.models.tsc import TscConstants

# What is logged at each sample; NaN where nothing was planned.
CORRECTED = np.dtype(
    [
        ("lower", float),
        ("upper", float),
        ("cost", float),
        ("bound", float),
        # Performance lay outside the model's range, and its nearest end was used.
        ("clipped", bool),
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
    corrector: ThresholdCorrector,
    thresholds: tuple[float, float],
    samples: int,
    adopted: bool = False,
) -> LoopCorrection:
    """Return what a loop of so many samples needs to correct these thresholds."""
    if not isinstance(corrector.engine, ExactEngine) or corrector.incentive is not incentive_box:
        raise ValueError(
            "a compiled loop corrects with the incentives (2.42) and the exact engine alone, got "
            f"{corrector}; leave out engine= and incentive=, or take the model as the setting, "
            "trustlab.allocation.ModelTests"
        )
    return LoopCorrection(
        adopted=adopted,
        constants=tuple(corrector.tsc.constants()),
        c_b=corrector.c_b,
        target=np.array(corrector.target),
        budget=corrector.engine.budget,
        thresholds=np.array(thresholds),
        work=Workspace.of(corrector.horizon),
        log=np.full(samples, np.array((np.nan, np.nan, np.nan, np.nan, False), CORRECTED)),
    )


@njit(inline="always")
def correct_thresholds(correction, k, r, p_r, mode):
    """Log sample k, plan, and correct the thresholds by one step; return c_l and c_u."""
    c = TscConstants(*correction.constants)
    thresholds = correction.thresholds
    work = correction.work
    now = min(max(p_r, c.p_r_min), c.p_r_max)
    standard = True  # incentives are those of (2.42)
    problem = (correction.constants, correction.c_b, correction.target)
    state = (thresholds, r, now, float(mode), standard)
    room = (work.steps, work.thresholds, work.waiting, work.states)
    cost, bound, _, complete, _, _ = search(
        *problem, correction.budget, *state, *room, work.actions
    )
    if not complete:
        bound = min(bound, unsearched_cost(*problem, thresholds, standard, *room[:3]))
    row = correction.log[k]
    row.lower = thresholds[LOWER]
    row.upper = thresholds[UPPER]
    row.cost = cost
    row.bound = bound
    row.clipped = now != p_r
    c_l = work.actions[LOWER, 0]
    c_u = work.actions[UPPER, 0]
    thresholds[LOWER] += c_l
    thresholds[UPPER] += c_u
    return c_l, c_u
