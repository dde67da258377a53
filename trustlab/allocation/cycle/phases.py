"""The model under rule (2.8), one phase after another: from one switch to the next."""

from collections.abc import Iterable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from trustlab.models.compiled import njit
from trustlab.models.tsc import TscModel, advance, human_at, tsc_at

# Most samples that one search for a steady cycle, or for bounds, simulates: some seconds. What it
# leaves out, results say.
EFFORT = 100_000_000

# Time constants [samples] to which models with slow utilization are resampled for surveys, and
# least for the faster process.
COARSE, FEW = 10_000, 20

# One row per recorded cycle. r is least as a manual phase begins and greatest as it ends.
CYCLE = np.dtype(
    [
        ("r", float),  # utilization and
        ("p_r", float),  # robot performance as the manual phase begins
        ("manual", int),  # dwell times, in samples
        ("autonomous", int),
        ("r_switch", float),  # utilization as the autonomous phase begins
    ]
)


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
    """Return after how many samples a phase never ends: e⁻⁵⁰ of the transient is left."""
    slowest = 1.0 / (1.0 - max(c.a_r, c.a_pr))
    if not 50.0 * slowest < EFFORT:
        raise ValueError(
            f"the model's time constant of {slowest:.3g} samples is too long: 50 of them are "
            f"simulated sample by sample, at most {EFFORT:.0e} samples; describe the model at a "
            "longer sample time (a^m for both a, and b_pr accordingly)"
        )
    return int(50.0 * slowest) + 100


def resampled(tsc: TscModel) -> TscModel:
    """Return the model, at a longer sample time where its time constants are very long."""
    robot = tsc.robot
    human = tsc.human
    times = sorted(1.0 / (1.0 - a) for a in (robot.a, human.a))
    m = int(min(times[1] / COARSE, times[0] / FEW))
    if m < 2:
        return tsc
    a = robot.a**m
    return TscModel(
        replace(robot, a=a, b=robot.b * (1.0 - a) / (1.0 - robot.a)), replace(human, a=human.a**m)
    )


def endless_phase(tsc: TscModel, lower: float, upper: float) -> str:
    """
    Return from where one mode stays for ever under rule (2.8); nothing where none does.

    In the autonomous mode r → 0 and P_r → P_r,min, so that TSC tends to a limit: it falls to a
    TSC_l above the limit from everywhere, and to one below it, or at it, never from r = 0 and P_r ≥
    P_r,min. In the manual mode likewise, with r → 1.
    """
    robot = tsc.robot
    human = tsc.human
    slack = 1e-12 / (1.0 - robot.a)  # rounding stalls P_r so near its limit
    rest = float(tsc.value(robot.p_min, human.p_min))
    if lower <= rest + slack:
        return (
            f"from rest (r = 0) the mode stays autonomous: TSC settles at {rest:.6g} without "
            f"falling to TSC_l = {lower:.6g}"
        )
    # Rounding stalls r below 1 by about 2⁻⁵²/b_r, where (2.6) can be far above its value at 1.
    ends = [float(human.performance(r)) for r in (1.0, max(1.0 - 2.0**-52 / human.b, human.beta))]
    load, stalled = (float(tsc.value(robot.steady_state(1.0, p_h), p_h)) for p_h in ends)
    if upper >= load - slack:
        return (
            f"from full load (r = 1) the mode stays manual: TSC settles at {load:.6g} without "
            f"rising to TSC_u = {upper:.6g}"
        )
    if upper >= stalled - slack:
        return (
            f"the mode may stay manual: as r tends to 1, TSC passes {stalled:.6g} only within "
            f"rounding, and TSC_u = {upper:.6g} is above"
        )
    return ""


def watched(steps: Iterable, task: str, total: int | None = None) -> Any:
    """Return the steps of a computation, on a terminal with a progress bar after two seconds."""
    from tqdm import tqdm

    return tqdm(steps, task, total, leave=False, delay=2.0, disable=None)


@njit
def phase(manual, r, p_r, lower, upper, c, most, seen):
    """
    Simulate one phase from its first sample until TSC meets the other threshold.

    Returns the dwell time (−1 if TSC does not meet it within `most` samples), r and P_r at the
    switch, and `seen` with the samples of the phase added.
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
    Simulate whole cycles, manual phase first, until transients have decayed.

    This takes about `steps` samples, or ends once r and P_r come `near` a known state.

    Returns −1 or −2 if a manual or an autonomous phase never ends, 1 at a known state, else 0; r
    and P_r; and the samples.
    """
    done, first = (
        0,
        most > 0,
    )  # no literals True and False: numba would compile `phase` once for each
    mark = 0
    mark_r = r
    mark_p_r = p_r
    while done < steps:
        period = done - mark
        if r == mark_r and p_r == mark_p_r and period > 0:
            # A motion that repeats to the last bit goes on doing so: whole periods are left out, as
            # long as some samples remain.
            done += (steps - done - 1) // period * period
        if period >= mark // 16:
            mark = done
            mark_r = r
            mark_p_r = p_r
        for i in range(known_r.size):
            if abs(r - known_r[i]) < near and abs(p_r - known_p_r[i]) < near:
                return 1, r, p_r, done
        manual, r, p_r, _ = phase(first, r, p_r, lower, upper, c, most, NOTHING)
        if manual < 0:
            return -1, r, p_r, done + most
        autonomous, r, p_r, _ = phase(not first, r, p_r, lower, upper, c, most, NOTHING)
        if autonomous < 0:
            return -2, r, p_r, done + most
        done += manual + autonomous
    return 0, r, p_r, done


@njit
def record(r, p_r, lower, upper, c, cycles, most):
    """
    Return a row of `CYCLE` for each of so many cycles, and what was seen in all their samples.
    """
    rows = np.empty(cycles, CYCLE)
    seen = NOTHING
    first = most > 0
    for j in range(cycles):
        rows[j].r, rows[j].p_r = r, p_r
        rows[j].manual, r, p_r, seen = phase(first, r, p_r, lower, upper, c, most, seen)
        rows[j].r_switch = r
        rows[j].autonomous, r, p_r, seen = phase(not first, r, p_r, lower, upper, c, most, seen)
    return rows, seen


@njit
def return_map(r, lower, upper, c, most):
    """
    Return utilization one cycle later if thresholds are met exactly, between samples.

    NaN if a phase never ends.

    Without overshoot TSC equals its threshold at a switch, which fixes P_r: the cycle is a smooth
    map of r alone.
    """
    for manual in (True, False):
        start, target = (lower, upper) if manual else (upper, lower)
        mode = 1.0 if manual else 0.0
        p_h = human_at(r, c)
        p_r = (start + c.b_T * p_h) / c.a_T
        before = start
        crossed = False
        for _ in range(most):
            r_before = r
            r, p_r = advance(r, p_r, p_h, mode, c)
            p_h = human_at(r, c)
            tsc = tsc_at(p_r, p_h, c)
            if (manual and tsc >= target) or (not manual and tsc <= target):
                # TSC is interpolated linearly within the sample; r is exact for that fraction of
                # it.
                keep = c.a_r ** ((target - before) / (tsc - before))
                r = 1.0 - (1.0 - r_before) * keep if manual else r_before * keep
                crossed = True
                break
            before = tsc
        if not crossed:
            return np.nan
    return r
