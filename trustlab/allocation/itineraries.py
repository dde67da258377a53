"""Sets of states carried round the cycle and cut wherever dwell times change, so that no motion is missed."""

from __future__ import annotations

import numba
import numpy as np

from trustlab.allocation.phases import human_at

__all__ = ["BRANCHES", "CORNERS", "SLACK", "advance", "clip", "contained", "cycle"]

CORNERS = 12
"""Most corners of a polygon."""

BRANCHES = 64
"""Most dwell times that one polygon may be cut into."""

SLACK = 1e-13
"""By how much TSC may be off through rounding; far more than the arithmetic is."""


@numba.njit(cache=True)
def clip(poly, k, along_r, along_p, offset, out):
    """Keep the part of a convex polygon where along_r·x + along_p·y + offset ≥ 0; returns its number of corners."""
    kept = 0
    for j in range(k):
        x0, y0 = poly[j, 0], poly[j, 1]
        i = j + 1 if j + 1 < k else 0
        x1, y1 = poly[i, 0], poly[i, 1]
        v0 = along_r * x0 + along_p * y0 + offset
        v1 = along_r * x1 + along_p * y1 + offset
        if v0 >= 0.0:
            if kept == out.shape[0]:
                return -1
            out[kept, 0], out[kept, 1] = x0, y0
            kept += 1
        if (v0 > 0.0 and v1 < 0.0) or (v0 < 0.0 and v1 > 0.0):
            if kept == out.shape[0]:
                return -1
            part = v0 / (v0 - v1)
            out[kept, 0], out[kept, 1] = x0 + part * (x1 - x0), y0 + part * (y1 - y0)
            kept += 1
    return kept if kept > 2 else 0


@numba.njit(cache=True)
def advance(manual, poly, k, error, target, c, most, out, corners, lengths, errors):
    """
    Carry a polygon of states (r, P_r ± error) through one phase, cut by the sample at which each part crosses `target`.

    With the dwell time fixed r is mapped linearly and P_r as ρ P_r + G(r); G is taken as its tangent at the middle, and
    what a tangent leaves of a concave curve goes to the error. Returns the number of parts in `out`, with their
    `corners`, dwell times `lengths` and `errors`; −1 where a part does not cross within `most`, −2 where the polygon is
    too wide for tangents, −3 where it falls into too many parts. Second result: the samples stepped through.
    """
    r, p = 0.0, 0.0
    for j in range(k):
        r += poly[j, 0] / k
        p += poly[j, 1] / k
    here = np.empty((CORNERS, 2))
    rest = np.empty((CORNERS, 2))
    width, height = 0.0, 0.0
    for j in range(k):
        here[j, 0], here[j, 1] = poly[j, 0] - r, poly[j, 1] - p
        width, height = max(width, abs(here[j, 0])), max(height, abs(here[j, 1]))
    if r <= 0.0 or r >= 1.0 or 2.0 * width > min(r, 1.0 - r):
        return -2, 0
    steep = 1.0 / ((1.0 - width / r) * (1.0 - width / (1.0 - r))) ** 2
    sign = 1.0 if manual else -1.0
    keep_r, keep_p, tangent = 1.0, 1.0, 0.0
    parts = 0
    for n in range(most):
        if r <= 0.0 or r >= 1.0:
            return -2, n
        y = human_at(r, c) - c[2]
        slope = y * (c[1] - r) / (r * (1.0 - r))
        w = keep_r * width
        bend = 0.5 * steep * c[1] * (1.0 - c[1]) * y / (r * (1.0 - r)) ** 2 * w * w
        if n > 0:
            value = sign * (c[7] * p - c[8] * (y + c[2]) - target)
            along_r = sign * (c[7] * tangent - c[8] * slope * keep_r)
            along_p = sign * c[7] * keep_p
            doubt = c[7] * error + c[8] * bend + SLACK
            if value + abs(along_r) * width + abs(along_p) * height + doubt >= 0.0:
                least, greatest = np.inf, -np.inf
                for j in range(k):
                    v = value + along_r * here[j, 0] + along_p * here[j, 1]
                    least, greatest = min(least, v), max(greatest, v)
                if greatest + doubt >= 0.0:
                    if parts == out.shape[0]:
                        return -3, n
                    if least + doubt >= 0.0:
                        size = k
                        for j in range(k):
                            out[parts, j, 0], out[parts, j, 1] = here[j, 0], here[j, 1]
                    else:
                        size = clip(here, k, along_r, along_p, value + doubt, out[parts])
                        if size < 0:
                            return -3, n
                    if size > 0:
                        for j in range(size):
                            x, h = out[parts, j, 0], out[parts, j, 1]
                            out[parts, j, 0] = r + keep_r * x
                            out[parts, j, 1] = p + tangent * x + keep_p * h
                        corners[parts], lengths[parts], errors[parts] = size, n, error
                        parts += 1
                    if least - doubt >= 0.0:
                        return parts, n
                    k = clip(here, k, -along_r, -along_p, doubt - value, rest)
                    if k < 0:
                        return -3, n
                    if k == 0:
                        return parts, n
                    for j in range(k):
                        here[j, 0], here[j, 1] = rest[j, 0], rest[j, 1]
        tangent *= c[4]
        error *= c[4]
        p = c[4] * p + (1.0 - c[4]) * c[6]
        if manual:
            p += c[5] * (y + c[2])
            tangent += c[5] * slope * keep_r
            error += c[5] * bend
            r = c[0] * r + (1.0 - c[0])
        else:
            r = c[0] * r
        keep_r *= c[0]
        keep_p *= c[4]
    return -1, most


@numba.njit(cache=True)
def cycle(poly, k, error, lower, upper, c, most, out, corners, errors, lengths):
    """Carry a polygon through a manual and an autonomous phase; as `advance`, with both dwell times of each part."""
    half, half_k = np.empty((BRANCHES, CORNERS, 2)), np.empty(BRANCHES, np.int64)
    half_n, half_e = np.empty(BRANCHES, np.int64), np.empty(BRANCHES)
    own_n = np.empty(BRANCHES, np.int64)
    middle, steps = advance(True, poly, k, error, upper, c, most, half, half_k, half_n, half_e)
    if middle < 0:
        return middle, steps
    parts = 0
    for j in range(middle):
        more, stepped = advance(
            False,
            half[j],
            half_k[j],
            half_e[j],
            lower,
            c,
            most,
            out[parts : parts + BRANCHES],
            corners[parts:],
            own_n,
            errors[parts:],
        )
        steps += stepped
        if more < 0:
            return more, steps
        for i in range(more):
            lengths[parts + i, 0], lengths[parts + i, 1] = half_n[j], own_n[i]
        parts += more
    return parts, steps


@numba.njit(cache=True)
def contained(poly, k, error, other, m, other_error):
    """Return whether a polygon with its error lies within another (corners anticlockwise) with that one's error."""
    slack = max(0.0, error - other_error)
    for i in range(m):
        x0, y0 = other[i, 0], other[i, 1]
        h = i + 1 if i + 1 < m else 0
        dx, dy = other[h, 0] - x0, other[h, 1] - y0
        for j in range(k):
            if dx * (poly[j, 1] - y0) - dy * (poly[j, 0] - x0) < abs(dx) * slack:
                return False
    return True
