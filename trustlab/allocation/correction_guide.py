"""The correction inside a compiled loop: thresholds that move sample by sample while a testbed runs."""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np

from trustlab.allocation.correction_dynamics import correction_constants
from trustlab.allocation.correction_exact import search
from trustlab.models.tsc import TscModel

__all__ = ["Guide", "guide", "guided", "no_guide"]


class Guide(NamedTuple):
    """What the exact engine needs in a compiled loop; rows of `trace`: TSC_l, TSC_u, cost, lower bound, whether held."""

    active: bool
    adopted: bool
    constants: np.ndarray
    goal: np.ndarray
    start: np.ndarray
    budget: int
    work: np.ndarray
    two: np.ndarray
    stack: np.ndarray
    best: np.ndarray
    actions: np.ndarray
    trace: np.ndarray


def guide(
    tsc: TscModel,
    start: tuple[float, float],
    target: tuple[float, float],
    c_b: float,
    horizon: int,
    samples: int,
    adopted: bool = False,
    budget: int = 25,
) -> Guide:
    """
    Return what a loop needs to correct thresholds as it goes.

    Parameters
    ----------
    tsc : TscModel
        The model.
    start, target : (float, float)
        TSC_l and TSC_u to begin with, and those wanted; checked before.
    c_b : float
        Largest correction per step.
    horizon : int
        N of (2.43).
    samples : int
        Rows to keep of the trace.
    adopted : bool
        Whether the operator's own thresholds move along.
    budget : int
        As for `ExactEngine`.
    """
    n = horizon + 1
    return Guide(
        True,
        adopted,
        correction_constants(tsc, c_b),
        np.array(target, dtype=float),
        np.array(start, dtype=float),
        budget,
        np.empty((7, n)),
        np.empty((6, 2, n)),
        np.empty(n, np.int64),
        np.empty((5, n)),
        np.empty((2, horizon)),
        np.full((samples, 5), np.nan),
    )


def no_guide() -> Guide:
    """Return a guide that is never used."""
    empty = np.empty((1, 1))
    nothing = (empty, np.empty((1, 1, 1)), np.empty(1, np.int64), empty, empty, empty)
    return Guide(False, False, np.empty(1), np.empty(2), np.empty(2), 1, *nothing)


@numba.njit(cache=True)
def guided(guide, k, r, p_r, mode):
    """
    Correct the thresholds in `guide.start` by one step and log them as they were; return c_l and c_u.

    Performance outside the model's range is planned with as at its end, and logged as such (column 4 of the trace).
    """
    p_min, p_max = guide.constants[6], guide.constants[9]
    now = min(max(p_r, p_min), p_max)
    cost, bound = search(
        guide.constants,
        guide.start,
        guide.goal,
        r,
        now,
        float(mode),
        guide.budget,
        True,
        guide.work,
        guide.two,
        guide.stack,
        guide.best,
        guide.actions,
    )[:2]
    trace = guide.trace
    trace[k, 0], trace[k, 1], trace[k, 2], trace[k, 3] = guide.start[0], guide.start[1], cost, bound
    trace[k, 4] = 1.0 if now != p_r else 0.0
    guide.start[0] += guide.actions[0, 0]
    guide.start[1] += guide.actions[1, 0]
    return guide.actions[0, 0], guide.actions[1, 0]
