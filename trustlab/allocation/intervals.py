"""Intervals of states carried round the cycle in interval arithmetic, for bounds that hold for every trajectory."""

from __future__ import annotations

import numba
import numpy as np

from trustlab.allocation.phases import human_at

__all__ = ["ROUNDING", "carry", "enclose", "human_range", "nest", "overshoot", "phase_image"]

ROUNDING = 1e-12
"""By how much intervals are widened at every step's end, far beyond the rounding of the arithmetic."""


STEEP = 1e-6
"""How near to rest and full load the slope of (2.6) is too steep for differences of neighbouring values."""


@numba.njit(cache=True)
def human_range(low, high, c):
    """Return the least and the greatest P_h over utilizations in [low, high]; (2.6) is concave."""
    one, other = human_at(low, c), human_at(high, c)
    top = c[3] if low <= c[1] <= high else max(one, other)
    return min(one, other), top


@numba.njit(cache=True)
def overshoot(manual, low, high, threshold, c):
    """
    Bound by how much TSC can pass a threshold in the step that meets it, from utilizations in [low, high].

    One step from TSC = threshold changes TSC by this much; from further back it passes by less.
    """
    p_low, p_high = human_range(low, high, c)
    rest, gain = 1.0 - c[4], c[5] / (1.0 - c[4])
    if manual:
        after_low, after_high = c[0] * low + (1.0 - c[0]), c[0] * high + (1.0 - c[0])
    else:
        after_low, after_high = c[0] * low, c[0] * high
    next_low, next_high = human_range(after_low, after_high, c)
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
def carry(manual, low, high, tsc_low, tsc_high, target, c, most, out):
    """
    Carry utilizations [low, high] with TSC in [tsc_low, tsc_high] through one phase.

    Widens `out` = [r low, r high at the crossing, overshoot, dwell low, dwell high, P_r low, P_r high, TSC low,
    TSC high]; returns False if some of them may never cross.
    """
    p_low, p_high = human_range(low, high, c)
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
                out[2] = max(out[2], overshoot(manual, before_low, before_high, target, c))
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
        p_low, p_high = human_range(low, high, c)
    return False


@numba.njit(cache=True)
def phase_image(manual, low, high, start, over, target, c, cells, most, out):
    """Carry [low, high] through one phase cell by cell; TSC begins within one overshoot beyond `start`."""
    out[:] = np.array([np.inf, -np.inf, 0.0, np.inf, 0.0, np.inf, -np.inf, np.inf, -np.inf])
    tsc_low = start - over if manual else start
    tsc_high = start if manual else start + over
    for k in range(cells):
        one = low + (high - low) * k / cells
        other = low + (high - low) * (k + 1) / cells
        if not carry(manual, one, other, tsc_low, tsc_high, target, c, most, out):
            return False
    return True


@numba.njit(cache=True)
def enclose(low, high, over, lower, upper, c, cells, most, manual_out, autonomous_out):
    """
    Carry r in [low, high] and overshoot up to `over` through one cycle; -1 or -2 tells which phase may never end.

    The first two of either result are the utilizations at the beginning of its phase.
    """
    if not phase_image(True, low, high, lower, over, upper, c, cells, most, manual_out):
        return -1
    first, last = max(manual_out[0] - 1e-12, 0.0), min(manual_out[1] + 1e-12, 1.0)
    if not phase_image(False, first, last, upper, manual_out[2], lower, c, cells, most, autonomous_out):
        return -2
    manual_out[0], manual_out[1] = low, high
    autonomous_out[0], autonomous_out[1] = first, last
    return 0


@numba.njit(cache=True)
def nest(lower, upper, c, cells, cycles, most, shrink, manual_out, autonomous_out):
    """Shrink the utilizations at the beginning of manual phases from [0, 1]; return how many cycles that took."""
    low, high = 0.0, 1.0
    over_low = overshoot(False, 0.0, 1.0, lower, c)
    for j in range(cycles):
        if not phase_image(True, low, high, lower, over_low, upper, c, cells, most, manual_out):
            return -1
        first, last = max(manual_out[0] - 1e-12, 0.0), min(manual_out[1] + 1e-12, 1.0)
        if not phase_image(False, first, last, upper, manual_out[2], lower, c, cells, most, autonomous_out):
            return -2
        new_low, new_high = max(low, autonomous_out[0] - 1e-12), min(high, autonomous_out[1] + 1e-12)
        settled = (high - low) - (new_high - new_low) <= shrink * (high - low) and j > 0
        low, high, over_low = new_low, new_high, min(over_low, autonomous_out[2])
        if settled:
            break
    # Once more, so that everything reported belongs to the utilizations found.
    code = enclose(low, high, over_low, lower, upper, c, cells, most, manual_out, autonomous_out)
    return code if code < 0 else j + 1
