"""The exact steady cycle of the switched system, found from its return map."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numba
import numpy as np

from trustlab.allocation.limits import check_thresholds
from trustlab.models.human import yerkes_dodson
from trustlab.models.tsc import TscModel

__all__ = ["LimitCycle", "limit_cycle", "pack"]

MOST_CYCLES = 2000
"""Cycles that are recorded once transients have died away."""

NEAR = 2e-5
"""How near in r and P_r a start must come to a motion to count as drawn to it; coexisting ones are farther apart."""


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


@dataclass(frozen=True)
class LimitCycle:
    """
    The steady motion under rule (2.8).

    With switching at whole samples TSC overshoots a threshold by a part of a step, so that the motion may repeat only
    after several cycles or never exactly; extremes and dwell times are then those of the whole attractor.

    Parameters
    ----------
    exists : bool
        Whether the rule keeps switching, from some start at least.
    always : bool
        Whether it keeps switching from every start that was followed.
    reason : str
        What happens where it does not; else how the cycle was found.
    r_low, r_high : float
        Range of utilization; NaN without a cycle, as all below.
    p_r_low, p_r_high : float
        Range of robot performance.
    tsc_low, tsc_high : float
        Range of TSC, overshoot included.
    dwell_manual, dwell_autonomous : tuple of int
        Least and greatest number of samples in a row in each mode.
    period : int or None
        After how many cycles the motion repeats; None where it does not within the cycles followed, or where motions
        of different period coexist.
    motions : int
        How many motions coexist, told apart by the overshoot they lock to.
    unique : bool
        Whether the return map of r has exactly one fixed point on a grid of [0, 1].
    slope : float
        Slope of the return map there; below 1 in size the cycle attracts.
    mean_r, mean_p_r : float
        Time averages of utilization and robot performance.
    """

    exists: bool
    reason: str
    r_low: float = math.nan
    r_high: float = math.nan
    p_r_low: float = math.nan
    p_r_high: float = math.nan
    tsc_low: float = math.nan
    tsc_high: float = math.nan
    dwell_manual: tuple[int, int] | None = None
    dwell_autonomous: tuple[int, int] | None = None
    period: int | None = None
    motions: int = 0
    unique: bool = False
    slope: float = math.nan
    mean_r: float = math.nan
    mean_p_r: float = math.nan
    always: bool = False

    @property
    def stable(self) -> bool:
        """Whether the slope of the return map is below 1 in size."""
        return abs(self.slope) < 1.0

    def table(self):
        """
        Return ranges and means.

        Returns
        -------
        pandas.DataFrame
            Index `quantity`; columns low, high, mean.
        """
        import pandas as pd

        manual, autonomous = (
            pair or (math.nan, math.nan) for pair in (self.dwell_manual, self.dwell_autonomous)
        )
        rows = {
            "r": (self.r_low, self.r_high, self.mean_r),
            "P_r": (self.p_r_low, self.p_r_high, self.mean_p_r),
            "TSC": (self.tsc_low, self.tsc_high, math.nan),
            "dwell time manual": (*manual, math.nan),
            "dwell time autonomous": (*autonomous, math.nan),
        }
        return pd.DataFrame.from_dict(rows, orient="index", columns=["low", "high", "mean"]).rename_axis(
            "quantity"
        )


def _never(constants: np.ndarray) -> int:
    """Return a number of samples after which a phase without a crossing has settled for good."""
    return int(50.0 / (1.0 - max(constants[0], constants[4]))) + 100


def _period(rows: np.ndarray) -> int | None:
    """Return after how many cycles the recorded motion repeats."""
    r, dwell = rows[:, 0], rows[:, 2:4]
    for period in range(1, len(rows) // 3 + 1):
        same = abs(r[period] - r[0]) < 1e-9 and (dwell[period:] == dwell[:-period]).all()
        if same and np.abs(r[period:] - r[:-period]).max() < 1e-9:
            return period
    return None


def _follow(r: float, p_r: float, lower: float, upper: float, c: np.ndarray, most: int):
    """Return the state reached, then cycles and trace of the attractor, and its period."""
    state, r, p_r = settle(r, p_r, lower, upper, c, most, most)
    if state < 0:
        return state, r, p_r, None, None, None
    rows, trace = record(r, p_r, lower, upper, c, 24, most)
    period = _period(rows)
    if period is None:
        rows, trace = record(r, p_r, lower, upper, c, MOST_CYCLES, most)
        period = _period(rows)
    if period is not None:
        rows, trace = record(r, p_r, lower, upper, c, period, most)
    return state, r, p_r, rows, trace, period


def limit_cycle(tsc: TscModel, lower: float, upper: float, starts: int = 64) -> LimitCycle:
    """
    Find the steady cycle of rule (2.8).

    At a switch TSC equals its threshold up to one step, which fixes P_r, so that one cycle is a map of r alone. From
    several starts the motion is followed sample by sample until transients have died away, then over many cycles; the
    return map without overshoot tells whether there is one cycle and whether it attracts.

    Parameters
    ----------
    tsc : TscModel
        The model.
    lower, upper : float
        Thresholds TSC_l and TSC_u.
    starts : int
        How many starts to follow, spread over utilization and overshoot; more find rarer coexisting motions. A start
        that comes near a motion already found is not followed to its end.

    Returns
    -------
    LimitCycle
        With `exists` False where the rule stops switching from every start, and why; `always` False where it does from
        some.

    Raises
    ------
    ValueError
        If the thresholds are not finite or in the wrong order, or `starts` is not positive.
    """
    lower, upper = check_thresholds(tsc, lower, upper)
    if int(starts) != starts or starts < 1:
        raise ValueError(f"starts must be a whole number ≥ 1, got {starts}")
    c = pack(tsc)
    most = _never(c)
    step = tsc.a_T * (1.0 - tsc.robot.a) * (tsc.robot.p_max - tsc.robot.p_min)
    found: dict[tuple, list] = {}
    known, stopped = np.empty((0, 2)), []
    for j in range(int(starts) + 1):
        r = tsc.human.beta if j == 0 else (j - 1) / starts
        begin = lower - (j * 0.6180339887498949 % 1.0) * step
        p_r = (begin + tsc.b_T * tsc.human.performance(r)) / tsc.a_T if j != 1 else tsc.robot.p_min
        state = 0
        if known.size:
            state, r, p_r = settle(r, p_r, lower, upper, c, most // 4, most)
            if state == 0 and (np.abs(known - (r, p_r)) < NEAR).all(axis=1).any():
                continue
        if state == 0:
            state, r, p_r, rows, trace, period = _follow(r, p_r, lower, upper, c, most)
        if state < 0:
            stopped.append((state, r, p_r))
            continue
        key = (period, None if period is None else round(float(rows[:, 0].min()), 8))
        if period is None or key not in found:
            found.setdefault(key, []).append((rows, trace))
            known = np.concatenate([known, rows[:, :2]])
    stays = ""
    if stopped:
        state, r, p_r = stopped[0]
        mode, target, side = (
            ("manual", upper, "rising to TSC_u") if state == -1 else ("autonomous", lower, "falling to TSC_l")
        )
        settled = tsc.value(p_r, tsc.human.performance(min(max(r, 0.0), 1.0)))
        stays = f"stays {mode}: TSC settles at {settled:.4f} without {side} = {target:.4f}"
    if not found:
        return LimitCycle(False, stays)
    followed = [pair for pairs in found.values() for pair in pairs]
    rows = np.concatenate([rows for rows, _ in followed])
    traces = np.array([trace for _, trace in followed])
    periods = {period for period, _ in found}
    ends = np.geomspace(1e-15, 0.015, 16)
    grid = np.r_[ends, np.linspace(0.0, 1.0, 65)[1:-1], 1.0 - ends[::-1]]
    gap = np.array([crossing_map(x, lower, upper, c, most) for x in grid]) - grid
    # The map leads from rest upwards or nowhere, and from full load downwards or nowhere.
    signs = np.r_[1.0, np.sign(gap[np.isfinite(gap)]), -1.0]
    signs = signs[signs != 0.0]
    middle = float(rows[:, 0].mean())
    reach = max(1e-4 * min(middle, 1.0 - middle), 1e-12)
    around = (max(middle - reach, 0.0), min(middle + reach, 1.0))
    after = [crossing_map(x, lower, upper, c, most) for x in around]
    period = periods.pop() if len(periods) == 1 else None
    if len(found) > 1:
        listed = ", ".join("without" if own is None else str(own) for own, _ in found)
        how = f"{len(found)} motions coexist, one overshoot apart (periods {listed}); ranges enclose all of them"
    else:
        how = f"repeats after {period} cycle(s)" if period else f"does not repeat within {len(rows)} cycles"
    if stopped:
        how += f"; but from {len(stopped)} of {int(starts) + 1} starts it {stays}"
    return LimitCycle(
        exists=True,
        reason=how,
        always=not stopped,
        r_low=float(rows[:, 0].min()),
        r_high=float(rows[:, 4].max()),
        p_r_low=float(traces[:, 0].min()),
        p_r_high=float(traces[:, 1].max()),
        tsc_low=float(traces[:, 2].min()),
        tsc_high=float(traces[:, 3].max()),
        dwell_manual=(int(rows[:, 2].min()), int(rows[:, 2].max())),
        dwell_autonomous=(int(rows[:, 3].min()), int(rows[:, 3].max())),
        period=period,
        motions=len(found),
        unique=bool(np.count_nonzero(np.diff(signs)) == 1),
        slope=float((after[1] - after[0]) / (around[1] - around[0])),
        mean_r=float(np.mean(traces[:, 4] / traces[:, 6])),
        mean_p_r=float(np.mean(traces[:, 5] / traces[:, 6])),
    )
