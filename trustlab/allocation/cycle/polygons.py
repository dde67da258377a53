"""
Polygons of states (r, P_r) propagated round the cycle: tighter than intervals, as they keep how r
and P_r move together.

States in which a manual phase begins lie in a thin strip: TSC is at most one overshoot below TSC_l.
The strip is cut into cells of r, each a polygon. While the dwell time is the same for a whole
polygon, r is mapped linearly and P_r is mapped as ρ P_r + G(r), G smooth: a polygon stays a polygon
up to the curvature of G. Where the dwell times within a polygon differ, it is cut along TSC =
threshold into one part for each dwell time.
"""

import math

import numpy as np

from trustlab.allocation.cycle.propagation import overshoot
from trustlab.models.compiled import njit
from trustlab.models.tsc import advance, human_at, tsc_at

# Columns of a corner: utilization and robot performance.
R, P = 0, 1

# Columns of an interval of utilization.
LEFT, RIGHT = 0, 1

# Most corners of a polygon.
CORNERS = 12

# Most parts, one for each dwell time, into which one phase may cut a polygon.
PARTS = 64

# Why a polygon could not be propagated: its phase does not end, tangents do not fit it, or it falls
# into too many parts.
TOO_LONG = -1
TOO_WIDE = -2
TOO_MANY = -3

# Utilization below which polygons are not used: the squares of (2.6)'s denominators would
# underflow.
REST = 1e-100

# By how much TSC may be wrong through rounding; far more than it is.
SLACK = 1e-13


@njit
def clip(poly, k, along_r, along_p, offset, out):
    """
    Keep the part of a convex polygon where along_r·r + along_p·P_r + offset ≥ 0; return its number
    of corners.
    """
    kept = 0
    for j in range(k):
        x0, y0 = poly[j, R], poly[j, P]
        i = j + 1 if j + 1 < k else 0
        x1, y1 = poly[i, R], poly[i, P]
        v0 = along_r * x0 + along_p * y0 + offset
        v1 = along_r * x1 + along_p * y1 + offset
        if v0 >= 0.0:
            if kept == out.shape[0]:
                return TOO_MANY
            out[kept, R], out[kept, P] = x0, y0
            kept += 1
        # An edge that changes sides is cut where it does.
        if (v0 > 0.0 and v1 < 0.0) or (v0 < 0.0 and v1 > 0.0):
            if kept == out.shape[0]:
                return TOO_MANY
            part = v0 / (v0 - v1)
            out[kept, R], out[kept, P] = x0 + part * (x1 - x0), y0 + part * (y1 - y0)
            kept += 1
    return kept if kept > 2 else 0


@njit
def copied(poly, k, out):
    """Copy k corners, one by one, as assigning slices takes seconds to compile; return k."""
    for j in range(k):
        out[j, R], out[j, P] = poly[j, R], poly[j, P]
    return k


@njit
def slope_at(r, bell, c):
    """Return dP_h/dr of (2.6) from r and P_h − P_h,min there."""
    return bell * (c.beta - r) / (r * (1.0 - r))


@njit
def propagate(manual, poly, k, error, target, c, most, out, corners, errors):
    """
    Propagate a polygon of states (r, P_r ± error) through one phase; return how many parts are in
    `out`, and the samples.

    A negative number of parts says why there are none.
    """
    # The polygon is kept relative to its middle (r, p), in the coordinates it had at the first
    # sample: a state x, h off the middle then is keep_r·x and tangent·x + keep_p·h off it now,
    # tangent being G'. What G is off its tangent, at most, is added to `error`: second derivative
    # times half the square of the polygon's half width.
    r, p = 0.0, 0.0
    for j in range(k):
        r += poly[j, R] / k
        p += poly[j, P] / k
    here, rest = np.empty((CORNERS, 2)), np.empty((CORNERS, 2))
    width, height = 0.0, 0.0
    for j in range(k):
        here[j, R], here[j, P] = poly[j, R] - r, poly[j, P] - p
        width, height = max(width, abs(here[j, R])), max(height, abs(here[j, P]))
    if r <= 0.0 or r >= 1.0 or 2.0 * width > min(r, 1.0 - r):
        return TOO_WIDE, 0
    # P_h'' = −β(1 − β)(P_h − P_h,min)/(r(1 − r))² grows within the polygon by no more than this
    # factor.
    steep = 1.0 / ((1.0 - width / r) * (1.0 - width / (1.0 - r))) ** 2
    sign, mode = (1.0, 1.0) if manual else (-1.0, 0.0)
    keep_r = 1.0
    keep_p = 1.0
    tangent = 0.0
    parts = 0
    for n in range(most):
        if r <= REST or r >= 1.0:
            return TOO_WIDE, n
        p_h = human_at(r, c)
        bell = p_h - c.p_h_min
        slope = slope_at(r, bell, c)
        half = keep_r * width
        bend = 0.5 * steep * c.beta * (1.0 - c.beta) * bell / (r * (1.0 - r)) ** 2 * half * half
        if n > 0:
            # How far TSC is beyond the target, as a linear function of the state at the first
            # sample; and its error.
            value = sign * (tsc_at(p, p_h, c) - target)
            along_r = sign * (c.a_T * tangent - c.b_T * slope * keep_r)
            along_p = sign * c.a_T * keep_p
            doubt = c.a_T * error + c.b_T * bend + SLACK
            # Cheap test first: at most samples no corner is near the target.
            if value + abs(along_r) * width + abs(along_p) * height + doubt >= 0.0:
                least, greatest = np.inf, -np.inf
                for j in range(k):
                    v = value + along_r * here[j, R] + along_p * here[j, P]
                    least, greatest = min(least, v), max(greatest, v)
                if greatest + doubt >= 0.0:
                    if parts == out.shape[0]:
                        return TOO_MANY, n
                    # What may have met the target goes out as one part, mapped to where it is now.
                    if least + doubt >= 0.0:
                        size = copied(here, k, out[parts])
                    else:
                        size = clip(here, k, along_r, along_p, value + doubt, out[parts])
                        if size < 0:
                            return TOO_MANY, n
                    if size > 0:
                        for j in range(size):
                            x, h = out[parts, j, R], out[parts, j, P]
                            out[parts, j, R] = r + keep_r * x
                            out[parts, j, P] = p + tangent * x + keep_p * h
                        corners[parts], errors[parts] = size, error
                        parts += 1
                    if least - doubt >= 0.0:
                        return parts, n
                    # What may not have met it yet goes on; within the error of either, states are
                    # in both.
                    k = clip(here, k, -along_r, -along_p, doubt - value, rest)
                    if k < 0:
                        return TOO_MANY, n
                    if k == 0:
                        return parts, n
                    copied(rest, k, here)
        tangent = c.a_pr * tangent + mode * c.b_pr * slope * keep_r
        error = c.a_pr * error + mode * c.b_pr * bend
        r, p = advance(r, p, p_h, mode, c)
        keep_r *= c.a_r
        keep_p *= c.a_pr
    return TOO_LONG, most


@njit(inline="always")
def propagate_cycle(poly, k, error, lower, upper, c, most, out, corners, errors):
    """Propagate a polygon through a manual and an autonomous phase, as `propagate`."""
    half = np.empty((PARTS, CORNERS, 2))
    half_corners, half_errors = np.empty(PARTS, np.int64), np.empty(PARTS)
    manual = k >= 0  # no literals True and False: numba would compile `propagate` once for each
    middle, steps = propagate(
        manual, poly, k, error, upper, c, most, half, half_corners, half_errors
    )
    if middle < 0:
        return middle, steps
    parts = 0
    for j in range(middle):
        room = out[parts : parts + PARTS], corners[parts:], errors[parts:]
        more, stepped = propagate(
            not manual, half[j], half_corners[j], half_errors[j], lower, c, most, *room
        )
        steps += stepped
        if more < 0:
            return more, steps
        parts += more
    return parts, steps


@njit
def strip(low, high, over, lower, c, out):
    """
    Fill `out` with the four corners that enclose all states with r in [low, high] and TSC in [lower
    − over, lower].
    """
    # P_r = (TSC + b_T P_h(r))/a_T is concave in r: from below it is enclosed by its chord, from
    # above by its tangent.
    r = 0.5 * (low + high)
    top = human_at(r, c)
    slope = slope_at(r, top - c.p_h_min, c)
    out[0, R], out[0, P] = low, (lower - over + c.b_T * human_at(low, c)) / c.a_T - SLACK
    out[1, R], out[1, P] = high, (lower - over + c.b_T * human_at(high, c)) / c.a_T - SLACK
    out[2, R], out[2, P] = high, (lower + c.b_T * (top + slope * (high - r))) / c.a_T + SLACK
    out[3, R], out[3, P] = low, (lower + c.b_T * (top - slope * (r - low))) / c.a_T + SLACK


@njit
def chord_error(poly, k, c):
    """Return by how much P_h can lie above the chord over the polygon's range of r."""
    low, high = np.inf, -np.inf
    for j in range(k):
        low, high = min(low, poly[j, R]), max(high, poly[j, R])
    if low <= REST or high >= 1.0:
        return c.p_h_max - c.p_h_min
    bend = 0.0
    for r in (low, high):
        bend = max(
            bend, c.beta * (1.0 - c.beta) * (human_at(r, c) - c.p_h_min) / (r * (1.0 - r)) ** 2
        )
    return bend * (high - low) ** 2 / 8.0


@njit
def narrow(low, high, over, lower, upper, c, cells, cycles, most, budget):
    """
    Shrink r in [low, high] and overshoot up to `over`, as a manual phase begins, as far as polygons
    allow.

    Returns low, high, over, and how many more cycles it takes until every trajectory is within
    these.
    """
    out = np.empty((4 * PARTS, CORNERS, 2))
    corners, errors = np.empty(4 * PARTS, np.int64), np.empty(4 * PARTS)
    poly, waiting = np.empty((CORNERS, 2)), np.empty((64, 2))
    stepped = 0
    done = 0
    autonomous = cells < 0  # no literal False, as above
    for _ in range(cycles):
        if high - low < 1e-9:
            break
        new_low = np.inf
        new_high = -np.inf
        new_over = 0.0
        # Cells of equal ratios of r/(1 − r), so that tangents fit about as well everywhere.
        ratio = (high / (1.0 - high) * (1.0 - low) / low) ** (1.0 / cells)
        one, odds = low, low / (1.0 - low)
        for j in range(cells):
            odds *= ratio
            other = odds / (1.0 + odds) if j < cells - 1 else high
            # A stack of intervals: one that cannot be propagated as a whole is replaced by its
            # halves.
            waiting[0, LEFT], waiting[0, RIGHT] = one, other
            one, top = other, 1
            while top > 0:
                top -= 1
                left, right = waiting[top, LEFT], waiting[top, RIGHT]
                # The utilizations one sample earlier, in the autonomous phase, limit the overshoot
                # of this cell.
                cell_over = min(
                    over, overshoot(autonomous, left / c.a_r, min(right / c.a_r, 1.0), lower, c)
                )
                strip(left, right, cell_over, lower, c, poly)
                parts, steps = propagate_cycle(
                    poly, np.int64(4), 0.0, lower, upper, c, most, out, corners, errors
                )
                stepped += steps + 40
                if stepped > budget or (parts < 0 and (top > 60 or right < left * (1.0 + 1e-6))):
                    return low, high, over, done
                if parts < 0:
                    middle = math.sqrt(left / (1.0 - left) * right / (1.0 - right))
                    middle = middle / (1.0 + middle)
                    waiting[top, LEFT], waiting[top, RIGHT] = left, middle
                    waiting[top + 1, LEFT], waiting[top + 1, RIGHT] = middle, right
                    top += 2
                for i in range(parts):
                    sag = c.b_T * chord_error(out[i], corners[i], c)
                    for q in range(corners[i]):
                        r, p = out[i, q, R], out[i, q, P]
                        new_low, new_high = min(new_low, r), max(new_high, r)
                        # Between corners P_h is above its chord, so that TSC is lower there by as
                        # much.
                        tsc = tsc_at(p - errors[i], human_at(r, c), c) - sag
                        new_over = max(new_over, lower - tsc)
        if new_low > new_high:
            break
        new_low, new_high = max(low, new_low * (1.0 - 1e-12)), min(high, new_high + SLACK)
        new_over = min(over, new_over + SLACK)
        settled = new_high - new_low > 0.999 * (high - low) and new_over > 0.99 * over
        low = new_low
        high = new_high
        over = new_over
        done += 1
        if settled:
            break
    return low, high, over, done
