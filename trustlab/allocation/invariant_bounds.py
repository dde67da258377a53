"""Bounds on the switched system that hold for every trajectory: intervals carried round the cycle."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numba
import numpy as np

from trustlab.allocation.limit_cycle import human_at, pack
from trustlab.allocation.limits import check_thresholds
from trustlab.models.tsc import TscModel

__all__ = ["InvariantBounds", "invariant_bounds"]

ROUNDING = 1e-12
"""By how much intervals are widened at every step's end, far beyond the rounding of the arithmetic."""


STEEP = 1e-6
"""How near to rest and full load the slope of (2.6) is too steep for differences of neighbouring values."""


@numba.njit(cache=True)
def _human_range(low, high, c):
    """Return the least and the greatest P_h over utilizations in [low, high]; (2.6) is concave."""
    one, other = human_at(low, c), human_at(high, c)
    top = c[3] if low <= c[1] <= high else max(one, other)
    return min(one, other), top


@numba.njit(cache=True)
def _overshoot(manual, low, high, threshold, c):
    """
    Bound by how much TSC can pass a threshold in the step that meets it, from utilizations in [low, high].

    One step from TSC = threshold changes TSC by this much; from further back it passes by less.
    """
    p_low, p_high = _human_range(low, high, c)
    rest, gain = 1.0 - c[4], c[5] / (1.0 - c[4])
    if manual:
        after_low, after_high = c[0] * low + (1.0 - c[0]), c[0] * high + (1.0 - c[0])
    else:
        after_low, after_high = c[0] * low, c[0] * high
    next_low, next_high = _human_range(after_low, after_high, c)
    # ΔTSC = rest (a_T (P_min + M gain P_h) − threshold − b_T P_h) − b_T (P_h(after) − P_h), worst case over the range.
    slope = rest * (c[7] * gain * (1.0 if manual else 0.0) - c[8])
    base = rest * (c[7] * c[6] - threshold)
    # What any two of the values can differ by; then, away from the steep ends, chords of a concave function: every
    # one-step change lies between the chords at the two ends of the range.
    least, most = next_low - p_high, next_high - p_low
    if (manual and 1.0 - high > STEEP) or (not manual and low > STEEP):
        step_low, step_high = abs(after_low - low), abs(after_high - high)
        chord_low = (human_at(after_low, c) - human_at(low, c)) / step_low
        chord_high = (human_at(after_high, c) - human_at(high, c)) / step_high
        shortest, longest = min(step_low, step_high), max(step_low, step_high)
        one, other = np.inf, -np.inf
        for chord in (chord_low, chord_high):
            for length in (shortest, longest):
                one, other = min(one, chord * length), max(other, chord * length)
        slack = 1e-6 * max(abs(one), abs(other))
        least, most = max(least, one - slack), min(most, other + slack)
    if manual:
        over = base + max(slope * p_low, slope * p_high) - c[8] * least
    else:
        over = -(base + min(slope * p_low, slope * p_high)) + c[8] * most
    return max(0.0, over) * (1.0 + 1e-9) + ROUNDING


@numba.njit(cache=True)
def _carry(manual, low, high, tsc_low, tsc_high, target, c, most, out):
    """
    Carry utilizations [low, high] with TSC in [tsc_low, tsc_high] through one phase.

    Widens `out` = [r low, r high at the crossing, overshoot, dwell low, dwell high, P_r low, P_r high, TSC low,
    TSC high]; returns False if some of them may never cross.
    """
    p_low, p_high = _human_range(low, high, c)
    r_low, r_high = (tsc_low + c[8] * p_low) / c[7], (tsc_high + c[8] * p_high) / c[7]
    first = -1
    before_low, before_high, last_low, last_high = low, high, low, high
    for n in range(most):
        t_low, t_high = c[7] * r_low - c[8] * p_high, c[7] * r_high - c[8] * p_low
        out[5], out[6] = min(out[5], r_low), max(out[6], r_high)
        out[7], out[8] = (
            min(out[7], max(t_low, tsc_low) if n == 0 else t_low),
            max(out[8], min(t_high, tsc_high) if n == 0 else t_high),
        )
        if n > 0:
            if first < 0 and ((manual and t_high >= target) or (not manual and t_low <= target)):
                first = n
                out[3] = min(out[3], n)
                before_low = last_low
                before_high = last_high
            if first > 0:
                out[0], out[1] = min(out[0], low), max(out[1], high)
                before_low, before_high = min(before_low, last_low), max(before_high, last_high)
            if (manual and t_low >= target) or (not manual and t_high <= target):
                out[4] = max(out[4], n)
                out[2] = max(out[2], _overshoot(manual, before_low, before_high, target, c))
                return True
        last_low, last_high = low, high
        if manual:
            r_low = c[4] * r_low + (1.0 - c[4]) * c[6] + c[5] * p_low
            r_high = c[4] * r_high + (1.0 - c[4]) * c[6] + c[5] * p_high
            low, high = c[0] * low + (1.0 - c[0]), c[0] * high + (1.0 - c[0])
        else:
            r_low = c[4] * r_low + (1.0 - c[4]) * c[6]
            r_high = c[4] * r_high + (1.0 - c[4]) * c[6]
            low, high = c[0] * low, c[0] * high
        p_low, p_high = _human_range(low, high, c)
    return False


@numba.njit(cache=True)
def _phase_image(manual, low, high, start, overshoot, target, c, cells, most, out):
    """Carry [low, high] through one phase cell by cell; TSC begins within one overshoot beyond `start`."""
    out[:] = np.array([np.inf, -np.inf, 0.0, np.inf, 0.0, np.inf, -np.inf, np.inf, -np.inf])
    tsc_low = start - overshoot if manual else start
    tsc_high = start if manual else start + overshoot
    for k in range(cells):
        one = low + (high - low) * k / cells
        other = low + (high - low) * (k + 1) / cells
        if not _carry(manual, one, other, tsc_low, tsc_high, target, c, most, out):
            return False
    return True


@numba.njit(cache=True)
def _nest(lower, upper, c, cells, cycles, most, shrink, manual_out, autonomous_out):
    """Shrink the utilizations at the beginning of manual phases from [0, 1]; return how many cycles that took."""
    low, high = 0.0, 1.0
    over_low = _overshoot(False, 0.0, 1.0, lower, c)
    for j in range(cycles):
        if not _phase_image(True, low, high, lower, over_low, upper, c, cells, most, manual_out):
            return -1
        first, last = max(manual_out[0] - 1e-12, 0.0), min(manual_out[1] + 1e-12, 1.0)
        if not _phase_image(False, first, last, upper, manual_out[2], lower, c, cells, most, autonomous_out):
            return -2
        new_low, new_high = max(low, autonomous_out[0] - 1e-12), min(high, autonomous_out[1] + 1e-12)
        settled = (high - low) - (new_high - new_low) <= shrink * (high - low) and j > 0
        low, high, over_low = new_low, new_high, min(over_low, autonomous_out[2])
        if settled:
            break
    # Once more, so that everything reported belongs to the utilizations found.
    if not _phase_image(True, low, high, lower, over_low, upper, c, cells, most, manual_out):
        return -1
    first, last = max(manual_out[0] - 1e-12, 0.0), min(manual_out[1] + 1e-12, 1.0)
    if not _phase_image(False, first, last, upper, manual_out[2], lower, c, cells, most, autonomous_out):
        return -2
    manual_out[0], manual_out[1] = low, high
    autonomous_out[0], autonomous_out[1] = first, last
    return j + 1


@dataclass(frozen=True)
class InvariantBounds:
    """
    Bounds for every trajectory under rule (2.8), whatever its start.

    They hold from the `cycles`-th return to manual control on, overshoot of the thresholds included.

    Parameters
    ----------
    guaranteed : bool
        Whether every trajectory is shown to keep switching; where not, the bounds are the trivial ones.
    reason : str
        What was shown.
    cycles : int
        After how many returns to manual control the bounds hold.
    r_low, r_high : float
        Utilization.
    p_r_low, p_r_high : float
        Robot performance.
    tsc_low, tsc_high : float
        TSC; beyond the thresholds by the overshoot of one step.
    dwell_manual_low, dwell_manual_high : float
        Samples in a row under manual control.
    dwell_autonomous_low, dwell_autonomous_high : float
        Samples in a row under autonomous control.
    """

    guaranteed: bool
    reason: str
    cycles: int
    r_low: float
    r_high: float
    p_r_low: float
    p_r_high: float
    tsc_low: float
    tsc_high: float
    dwell_manual_low: float
    dwell_manual_high: float
    dwell_autonomous_low: float
    dwell_autonomous_high: float

    def table(self):
        """
        Return the bounds as a table.

        Returns
        -------
        pandas.DataFrame
            Index `quantity`; columns low, high.
        """
        import pandas as pd

        rows = {
            "r": (self.r_low, self.r_high),
            "P_r": (self.p_r_low, self.p_r_high),
            "TSC": (self.tsc_low, self.tsc_high),
            "dwell time manual": (self.dwell_manual_low, self.dwell_manual_high),
            "dwell time autonomous": (self.dwell_autonomous_low, self.dwell_autonomous_high),
        }
        return pd.DataFrame.from_dict(rows, orient="index", columns=["low", "high"]).rename_axis("quantity")


def invariant_bounds(
    tsc: TscModel, lower: float, upper: float, cells: int = 32, cycles: int = 200
) -> InvariantBounds:
    """
    Bound utilization, robot performance and dwell times for every trajectory under rule (2.8).

    At a switch TSC equals its threshold up to the overshoot of one step, so that the state is an interval of r with an
    interval of TSC. Both are carried through a manual and an autonomous phase in interval arithmetic; beginning with
    r in [0, 1] the intervals nest, and what they nest to encloses every trajectory after as many cycles.

    Parameters
    ----------
    tsc : TscModel
        The model.
    lower, upper : float
        Thresholds TSC_l and TSC_u.
    cells : int
        Into how many parts an interval of r is cut; more give tighter bounds and take longer.
    cycles : int
        Most cycles to follow; fewer give valid but wider bounds that hold sooner.

    Returns
    -------
    InvariantBounds

    Raises
    ------
    ValueError
        If the thresholds are not finite or in the wrong order, or `cells` or `cycles` is not positive.
    """
    lower, upper = check_thresholds(tsc, lower, upper)
    for name, value in (("cells", cells), ("cycles", cycles)):
        if int(value) != value or value < 1:
            raise ValueError(f"{name} must be a whole number ≥ 1, got {value}")
    c = pack(tsc)
    most = int(60.0 / (1.0 - max(c[0], c[4]))) + 100
    manual, autonomous = np.empty(9), np.empty(9)
    done = _nest(lower, upper, c, int(cells), int(cycles), most, 1e-3, manual, autonomous)
    if done < 0:
        phase = "a manual" if done == -1 else "an autonomous"
        ceiling = tsc.robot.p_min + tsc.robot.b * tsc.human.p_max / (1.0 - tsc.robot.a)
        return InvariantBounds(
            False,
            f"{phase} phase may never end from some utilization",
            0,
            0.0,
            1.0,
            tsc.robot.p_min,
            ceiling,
            -math.inf,
            math.inf,
            1.0,
            math.inf,
            1.0,
            math.inf,
        )
    worst = max(manual[4], autonomous[4]) * ROUNDING
    return InvariantBounds(
        True,
        f"every trajectory keeps switching; intervals nested over {done} cycles",
        done + 1,
        float(max(manual[0] - worst, 0.0)),
        float(min(autonomous[1] + worst, 1.0)),
        float(min(manual[5], autonomous[5]) - worst),
        float(max(manual[6], autonomous[6]) + worst),
        float(min(manual[7], lower - autonomous[2]) - worst),
        float(max(autonomous[8], upper + manual[2]) + worst),
        float(manual[3]),
        float(manual[4]),
        float(autonomous[3]),
        float(autonomous[4]),
    )
