"""The model under rule (2.8), one phase after another: samples under one mode from a switch to the next."""

from typing import NamedTuple

import numpy as np

from trustlab.models.compiled import njit
from trustlab.models.tsc import advance, human_at, tsc_at

CYCLE = np.dtype(
    [
        ("r", float),  # utilization and
        ("p_r", float),  # robot performance as the manual phase begins
        ("manual", int),  # dwell times, in samples
        ("autonomous", int),
        ("r_switch", float),  # utilization as the autonomous phase begins
    ]
)
"""One row per recorded cycle. r is least as a manual phase begins and greatest as it ends."""


class Seen(NamedTuple):
    """Extremes and sums over the samples of a trajectory."""

    p_r_low: float
    p_r_high: float
    tsc_low: float
    tsc_high: float
    sum_r: float
    sum_p_r: float
    samples: float


NOTHING = Seen(np.inf, -np.inf, np.inf, -np.inf, 0.0, 0.0, 0.0)


def longest_phase(c) -> int:
    """Return a number of samples after which a phase that has not ended never will: e⁻⁵⁰ of the transient is left."""
    return int(50.0 / (1.0 - max(c.a_r, c.a_pr))) + 100


@njit
def phase(manual, r, p_r, lower, upper, c, most, seen):
    """
    Simulate one phase from its first sample until TSC meets the other threshold.

    Returns the dwell time (−1 if TSC does not meet it within `most` samples), r and P_r at the switch, and `seen` with the
    samples of the phase added.
    """
    mode = 1.0 if manual else 0.0
    p_h = human_at(r, c)
    for n in range(most):
        tsc = tsc_at(p_r, p_h, c)
        if n > 0 and ((manual and tsc >= upper) or (not manual and tsc <= lower)):
            return n, r, p_r, seen
        seen = Seen(
            min(seen.p_r_low, p_r),
            max(seen.p_r_high, p_r),
            min(seen.tsc_low, tsc),
            max(seen.tsc_high, tsc),
            seen.sum_r + r,
            seen.sum_p_r + p_r,
            seen.samples + 1.0,
        )
        r, p_r = advance(r, p_r, p_h, mode, c)
        p_h = human_at(r, c)
    return -1, r, p_r, seen


@njit
def settle(r, p_r, lower, upper, c, steps, most, known_r, known_p_r, near):
    """
    Simulate whole cycles, manual phase first, for about `steps` samples or until r and P_r come `near` a known state.

    Returns −1 or −2 if a manual or an autonomous phase never ends, 1 at a known state, else 0; and r and P_r.
    """
    done = 0
    while done < steps:
        for i in range(known_r.size):
            if abs(r - known_r[i]) < near and abs(p_r - known_p_r[i]) < near:
                return 1, r, p_r
        manual, r, p_r, _ = phase(True, r, p_r, lower, upper, c, most, NOTHING)
        if manual < 0:
            return -1, r, p_r
        autonomous, r, p_r, _ = phase(False, r, p_r, lower, upper, c, most, NOTHING)
        if autonomous < 0:
            return -2, r, p_r
        done += manual + autonomous
    return 0, r, p_r


@njit
def record(r, p_r, lower, upper, c, cycles, most):
    """Return a row of `CYCLE` for each of so many cycles, and what was seen in all their samples."""
    rows, seen = np.empty(cycles, CYCLE), NOTHING
    for j in range(cycles):
        rows[j].r, rows[j].p_r = r, p_r
        rows[j].manual, r, p_r, seen = phase(True, r, p_r, lower, upper, c, most, seen)
        rows[j].r_switch = r
        rows[j].autonomous, r, p_r, seen = phase(False, r, p_r, lower, upper, c, most, seen)
    return rows, seen


@njit
def return_map(r, lower, upper, c, most):
    """
    Return utilization one cycle later if thresholds are met exactly, between samples; NaN if a phase never ends.

    Without overshoot TSC equals its threshold at a switch, which fixes P_r: the cycle is a smooth map of r alone.
    """
    for manual in (True, False):
        start, target = (lower, upper) if manual else (upper, lower)
        mode = 1.0 if manual else 0.0
        p_h = human_at(r, c)
        p_r, before, crossed = (start + c.b_T * p_h) / c.a_T, start, False
        for _ in range(most):
            r_before = r
            r, p_r = advance(r, p_r, p_h, mode, c)
            p_h = human_at(r, c)
            tsc = tsc_at(p_r, p_h, c)
            if (manual and tsc >= target) or (not manual and tsc <= target):
                # TSC is interpolated linearly within the sample; r is exact for that fraction of it.
                keep = c.a_r ** ((target - before) / (tsc - before))
                r = 1.0 - (1.0 - r_before) * keep if manual else r_before * keep
                crossed = True
                break
            before = tsc
        if not crossed:
            return np.nan
    return r
