"""One phase after another under rule (2.8), sample by sample: what the steady cycle and its bounds are computed from."""

from __future__ import annotations

import numba
import numpy as np

from trustlab.models.human import yerkes_dodson
from trustlab.models.tsc import TscModel

__all__ = ["crossing_map", "human_at", "pack", "phase", "record", "settle"]


def pack(tsc: TscModel) -> np.ndarray:
    """
    Return a model's constants as compiled loops take them: a_r, β, P_h,min, P_h,max, a_pr, b_pr, P_r,min, a_T, b_T.

    Parameters
    ----------
    tsc : TscModel
        The model.
    """
    human, robot = tsc.human, tsc.robot
    values = [human.a, human.beta, human.p_min, human.p_max, robot.a, robot.b, robot.p_min, tsc.a_T, tsc.b_T]
    return np.array(values)


@numba.njit(cache=True)
def human_at(r, c):
    """Return P_h of (2.6) at utilization r."""
    return c[2] + (c[3] - c[2]) * yerkes_dodson(r, c[1])


@numba.njit(cache=True)
def phase(manual, r, p_r, lower, upper, c, most, trace):
    """
    Run one phase from its first sample until TSC crosses the other threshold.

    Returns the number of samples in the phase (−1 if there is no crossing within `most`), r and P_r at the crossing, and
    adds every sample on the way to `trace` = [P_r low, P_r high, TSC low, TSC high, Σ r, Σ P_r, samples].
    """
    p_h = human_at(r, c)
    for n in range(most):
        tsc = c[7] * p_r - c[8] * p_h
        if n > 0 and ((manual and tsc >= upper) or (not manual and tsc <= lower)):
            return n, r, p_r
        trace[0], trace[1] = min(trace[0], p_r), max(trace[1], p_r)
        trace[2], trace[3] = min(trace[2], tsc), max(trace[3], tsc)
        trace[4] += r
        trace[5] += p_r
        trace[6] += 1.0
        if manual:
            p_r = c[4] * p_r + (1.0 - c[4]) * c[6] + c[5] * p_h
            r = c[0] * r + (1.0 - c[0])
        else:
            p_r = c[4] * p_r + (1.0 - c[4]) * c[6]
            r = c[0] * r
        p_h = human_at(r, c)
    return -1, r, p_r


@numba.njit(cache=True)
def settle(r, p_r, lower, upper, c, steps, most):
    """Run whole cycles from the beginning of a manual phase for about `steps` samples; -1 or -2 tells which mode stays."""
    trace = np.array([np.inf, -np.inf, np.inf, -np.inf, 0.0, 0.0, 0.0])
    done = 0
    while done < steps:
        n, r, p_r = phase(True, r, p_r, lower, upper, c, most, trace)
        if n < 0:
            return -1, r, p_r
        m, r, p_r = phase(False, r, p_r, lower, upper, c, most, trace)
        if m < 0:
            return -2, r, p_r
        done += n + m
    return 0, r, p_r


@numba.njit(cache=True)
def record(r, p_r, lower, upper, c, cycles, most):
    """Return r, P_r at the start, dwell times, and r at the middle of each cycle, with the trace of all samples."""
    rows = np.empty((cycles, 5))
    trace = np.array([np.inf, -np.inf, np.inf, -np.inf, 0.0, 0.0, 0.0])
    for j in range(cycles):
        rows[j, 0], rows[j, 1] = r, p_r
        n, r, p_r = phase(True, r, p_r, lower, upper, c, most, trace)
        rows[j, 2], rows[j, 4] = n, r
        m, r, p_r = phase(False, r, p_r, lower, upper, c, most, trace)
        rows[j, 3] = m
    return rows, trace


@numba.njit(cache=True)
def crossing_map(r, lower, upper, c, most):
    """Return r one cycle later when thresholds are met exactly, between samples; NaN if a phase never ends."""
    for manual in (True, False):
        start, target = (lower, upper) if manual else (upper, lower)
        p_h = human_at(r, c)
        p_r, before, crossed = (start + c[8] * p_h) / c[7], start, False
        for _ in range(most):
            now_r = r
            if manual:
                p_r = c[4] * p_r + (1.0 - c[4]) * c[6] + c[5] * p_h
                r = c[0] * r + (1.0 - c[0])
            else:
                p_r = c[4] * p_r + (1.0 - c[4]) * c[6]
                r = c[0] * r
            p_h = human_at(r, c)
            tsc = c[7] * p_r - c[8] * p_h
            if (manual and tsc >= target) or (not manual and tsc <= target):
                part = (target - before) / (tsc - before)
                keep = c[0] ** part
                r = 1.0 - (1.0 - now_r) * keep if manual else now_r * keep
                crossed = True
                break
            before = tsc
        if not crossed:
            return np.nan
    return r
