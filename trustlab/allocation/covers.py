"""Covers of all states at which manual phases begin: narrowed, carried on, and drawn into traps."""

from __future__ import annotations

import math

import numba
import numpy as np

from trustlab.allocation.intervals import overshoot
from trustlab.allocation.itineraries import BRANCHES, CORNERS, SLACK, clip, contained, cycle
from trustlab.allocation.phases import human_at

__all__ = ["cover", "generation", "merge", "narrow", "reach", "trap"]


@numba.njit(cache=True)
def cover(low, high, over, lower, c, out):
    """Write the polygon that holds all states with r in [low, high] and TSC in [lower − over, lower]."""
    r = 0.5 * (low + high)
    y = human_at(r, c) - c[2]
    slope = y * (c[1] - r) / (r * (1.0 - r))
    one, other, top = human_at(low, c), human_at(high, c), y + c[2]
    out[0, 0], out[0, 1] = low, (lower - over + c[8] * one) / c[7] - SLACK
    out[1, 0], out[1, 1] = high, (lower - over + c[8] * other) / c[7] - SLACK
    out[2, 0], out[2, 1] = high, (lower + c[8] * (top + slope * (high - r))) / c[7] + SLACK
    out[3, 0], out[3, 1] = low, (lower + c[8] * (top - slope * (r - low))) / c[7] + SLACK


@numba.njit(cache=True)
def reach(low, high, over, lower, c):
    """Return by how much TSC can be below `lower` where manual phases begin with r in [low, high], `over` at most."""
    return min(over, overshoot(False, low / c[0], min(high / c[0], 1.0), lower, c))


@numba.njit(cache=True)
def narrow(low, high, over, lower, upper, c, cells, cycles, most, budget):
    """
    Shrink r in [low, high] and overshoot up to `over` at the beginning of manual phases, as far as polygons allow.

    Returns low, high, over, samples stepped through, and after how many more cycles every trajectory is within these.
    """
    out, corners = np.empty((4 * BRANCHES, CORNERS, 2)), np.empty(4 * BRANCHES, np.int64)
    errors, lengths = np.empty(4 * BRANCHES), np.empty((4 * BRANCHES, 2), np.int64)
    poly, waiting = np.empty((CORNERS, 2)), np.empty((64, 2))
    stepped, done = 0, 0
    for _ in range(cycles):
        if high - low < 1e-9:
            break
        new_low, new_high, new_over = np.inf, -np.inf, 0.0
        # Cells of equal ratios of r/(1 − r), so that tangents fit about as well everywhere.
        ratio = (high / (1.0 - high) * (1.0 - low) / low) ** (1.0 / cells)
        one, odds = low, low / (1.0 - low)
        for j in range(cells):
            odds *= ratio
            other = odds / (1.0 + odds) if j < cells - 1 else high
            waiting[0, 0], waiting[0, 1] = one, other
            one, top = other, 1
            while top > 0:
                top -= 1
                left, right = waiting[top, 0], waiting[top, 1]
                cover(left, right, reach(left, right, over, lower, c), lower, c, poly)
                parts, steps = cycle(poly, 4, 0.0, lower, upper, c, most, out, corners, errors, lengths)
                stepped += steps + 40
                if stepped > budget or (parts < 0 and (top > 60 or right < left * (1.0 + 1e-6))):
                    return low, high, over, stepped, done
                if parts < 0:
                    middle = math.sqrt(left / (1.0 - left) * right / (1.0 - right))
                    middle = middle / (1.0 + middle)
                    waiting[top, 0], waiting[top, 1] = left, middle
                    waiting[top + 1, 0], waiting[top + 1, 1] = middle, right
                    top += 2
                for i in range(parts):
                    sag = c[8] * _sag(out[i], corners[i], c)
                    for q in range(corners[i]):
                        r, p = out[i, q, 0], out[i, q, 1]
                        new_low, new_high = min(new_low, r), max(new_high, r)
                        # Between corners P_h is above its chord: TSC is lower there by what the chord leaves.
                        tsc = c[7] * (p - errors[i]) - c[8] * human_at(r, c) - sag
                        new_over = max(new_over, lower - tsc)
        if new_low > new_high:
            break
        new_low, new_high = max(low, new_low * (1.0 - 1e-12)), min(high, new_high + SLACK)
        new_over = min(over, new_over + SLACK)
        settled = new_high - new_low > 0.999 * (high - low) and new_over > 0.99 * over
        low, high, over = new_low, new_high, new_over
        done += 1
        if settled:
            break
    return low, high, over, stepped, done


@numba.njit(cache=True)
def _sag(poly, k, c):
    """Return by how much P_h can lie above the chord over the polygon's range of r."""
    low, high = np.inf, -np.inf
    for j in range(k):
        low, high = min(low, poly[j, 0]), max(high, poly[j, 0])
    if low <= 0.0 or high >= 1.0:
        return c[3] - c[2]
    bend = 0.0
    for r in (low, high):
        bend = max(bend, c[1] * (1.0 - c[1]) * (human_at(r, c) - c[2]) / (r * (1.0 - r)) ** 2)
    return bend * (high - low) ** 2 / 8.0


@numba.njit(cache=True)
def trap(r, p, period, lean, width, height, lower, upper, c, most, traps, sizes, errors):
    """
    Write a polygon about a periodic state that returns into itself with one order of dwell times, and its images.

    All trajectories from it tend to that one motion. Halved until it does; returns whether it was found.
    """
    out, corners = np.empty((4 * BRANCHES, CORNERS, 2)), np.empty(4 * BRANCHES, np.int64)
    own, lengths = np.empty(4 * BRANCHES), np.empty((4 * BRANCHES, 2), np.int64)
    for _ in range(40):
        width *= 0.7
        height *= 0.7
        poly = traps[0]
        poly[0, 0], poly[0, 1] = r - width, p - lean * width - height
        poly[1, 0], poly[1, 1] = r + width, p + lean * width - height
        poly[2, 0], poly[2, 1] = r + width, p + lean * width + height
        poly[3, 0], poly[3, 1] = r - width, p - lean * width + height
        sizes[0], errors[0] = 4, 0.0
        good = True
        for j in range(period):
            parts, _steps = cycle(
                traps[j], sizes[j], errors[j], lower, upper, c, most, out, corners, own, lengths
            )
            if parts != 1:
                good = False
                break
            if j + 1 < period:
                sizes[j + 1], errors[j + 1] = corners[0], own[0]
                for q in range(corners[0]):
                    traps[j + 1, q, 0], traps[j + 1, q, 1] = out[0, q, 0], out[0, q, 1]
        if good and contained(out[0], corners[0], own[0], traps[0], 4, 0.0):
            return True
    return False


@numba.njit(cache=True)
def generation(
    polys,
    sizes,
    errors,
    top,
    traps,
    trap_sizes,
    trap_errors,
    lower,
    upper,
    c,
    most,
    budget,
    new,
    new_k,
    new_e,
):
    """
    Carry `top` polygons on by one cycle, but for those within a trap.

    Returns how many there are then in `new`, −1 where one cannot be carried on or there are too many; and the samples
    stepped through.
    """
    out, corners = np.empty((4 * BRANCHES, CORNERS, 2)), np.empty(4 * BRANCHES, np.int64)
    own, lengths = np.empty(4 * BRANCHES), np.empty((4 * BRANCHES, 2), np.int64)
    made, stepped = 0, 0
    while top > 0:
        top -= 1
        inside = False
        for i in range(trap_sizes.size):
            if contained(polys[top], sizes[top], errors[top], traps[i], trap_sizes[i], trap_errors[i]):
                inside = True
                break
        if inside:
            continue
        parts, steps = cycle(
            polys[top], sizes[top], errors[top], lower, upper, c, most, out, corners, own, lengths
        )
        stepped += steps + 40
        if stepped > budget or made + parts >= new.shape[0] or top + 2 >= polys.shape[0]:
            return -1, stepped
        if parts < 0:
            # Too wide: both halves instead.
            left, right = polys[top, : sizes[top], 0].min(), polys[top, : sizes[top], 0].max()
            if left <= 0.0 or right >= 1.0 or right < left * (1.0 + 1e-6):
                return -1, stepped
            middle = math.sqrt(left / (1.0 - left) * right / (1.0 - right))
            whole, k, error, middle = polys[top].copy(), sizes[top], errors[top], middle / (1.0 + middle)
            for side in (1.0, -1.0):
                size = clip(whole, k, side, 0.0, -side * middle, polys[top])
                if size < 0:
                    return -1, stepped
                if size > 0:
                    sizes[top], errors[top] = size, error
                    top += 1
            continue
        for i in range(parts):
            new_k[made], new_e[made] = corners[i], own[i]
            for j in range(corners[i]):
                new[made, j, 0], new[made, j, 1] = out[i, j, 0], out[i, j, 1]
            made += 1
    return made, stepped


@numba.njit(cache=True)
def merge(polys, sizes, errors, top, lean, width, height):
    """
    Put polygons that are small and near one another into one that holds them all, so that their number stays low.

    Near is in one cell of a grid, `width` in r by `height` across the direction (1, `lean`) in P_r; small is smaller
    than a cell. Returns how many polygons are left.
    """
    keys = np.empty(top, np.int64)
    boxes = np.empty((top, 4))
    for i in range(top):
        boxes[i, 0], boxes[i, 1], boxes[i, 2], boxes[i, 3] = np.inf, -np.inf, np.inf, -np.inf
        for j in range(sizes[i]):
            r, h = polys[i, j, 0], polys[i, j, 1] - lean * polys[i, j, 0]
            boxes[i, 0], boxes[i, 1] = min(boxes[i, 0], r), max(boxes[i, 1], r)
            boxes[i, 2], boxes[i, 3] = min(boxes[i, 2], h), max(boxes[i, 3], h)
        keys[i] = -1 - i
    low_r, low_h = boxes[:, 0].min(), boxes[:, 2].min()
    for i in range(top):
        if boxes[i, 1] - boxes[i, 0] <= width and boxes[i, 3] - boxes[i, 2] <= height:
            column = (0.5 * (boxes[i, 0] + boxes[i, 1]) - low_r) / width
            row = (0.5 * (boxes[i, 2] + boxes[i, 3]) - low_h) / height
            if column < 1e9 and row < 1e9:
                keys[i] = np.int64(column) * 1_000_000_000 + np.int64(row)
    order = np.argsort(keys)
    drop = np.zeros(top, np.bool_)
    start = 0
    while start < top:
        end = start + 1
        while end < top and keys[order[end]] == keys[order[start]]:
            end += 1
        if end - start > 1:
            first = order[start]
            for q in range(start + 1, end):
                i = order[q]
                drop[i] = True
                boxes[first, 0], boxes[first, 1] = (
                    min(boxes[first, 0], boxes[i, 0]),
                    max(boxes[first, 1], boxes[i, 1]),
                )
                boxes[first, 2], boxes[first, 3] = (
                    min(boxes[first, 2], boxes[i, 2]),
                    max(boxes[first, 3], boxes[i, 3]),
                )
                errors[first] = max(errors[first], errors[i])
            left, right, low, high = boxes[first, 0], boxes[first, 1], boxes[first, 2], boxes[first, 3]
            sizes[first] = 4
            errors[first] += 1e-15
            polys[first, 0, 0], polys[first, 0, 1] = left, low + lean * left
            polys[first, 1, 0], polys[first, 1, 1] = right, low + lean * right
            polys[first, 2, 0], polys[first, 2, 1] = right, high + lean * right
            polys[first, 3, 0], polys[first, 3, 1] = left, high + lean * left
        start = end
    kept = 0
    for i in range(top):
        if not drop[i]:
            if kept != i:
                polys[kept] = polys[i]
                sizes[kept], errors[kept] = sizes[i], errors[i]
            kept += 1
    return kept
