"""
How fast thresholds can move on average, over many switches: the bound of the exact engine for long horizons.

By (2.42) thresholds rise by ½ c_b Σ (2 − f) at most and fall by ½ c_b Σ f, f = r + (P_r − P_min)/(P_max − P_min). Boxes
round all that is reachable grow wide within a few cycles, so Σ f is bounded phase by phase instead.

1. A phase begins where TSC has just met a threshold, which lies in a known interval. So P_r follows from r up to that
   interval and one step, and a phase is known by its mode and r at its first sample. r is cut into cells.
2. From each cell, and each piece of the threshold's interval, tubes enclose r and P_r until the last sample at which TSC can
   meet the other threshold. They give, for each length T of the phase, the least Σ f, and the cells in which the next begins.
3. With any ρ and v, the least Σ (f − ρ) + v (r at its end − r at its beginning) weights the steps from cell to cell. Where
   no cycle of steps is negative, shortest paths exist, and Σ f ≥ ρ K + D over any K samples, D from the shortest paths
   and the least of an unfinished phase. ρ is chosen just below the least mean over all cycles; a bad choice of ρ or v
   costs tightness only.
"""

from __future__ import annotations

import numba
import numpy as np

from trustlab.allocation.phases import human_at

__all__ = ["least_effort"]

CELLS = 800
"""Cells of utilization, over [0, 1]."""

PIECES = 14
"""Pieces of a threshold's interval; the first the narrowest, each 1.35 times the one before."""

WORK, WORK_EACH = 4_000_000, 100
"""Samples of tubes followed at most: so many, and so many per step of the horizon; beyond, nothing is proved."""

POOL = 1_500_000
"""Lengths of phases kept at most, over all cells."""

TIGHT = 1e-9
"""What comparisons allow for rounding, in units of TSC."""


@numba.njit(cache=True)
def human_between(a, b, c):
    """Return the least and the greatest P_h of (2.6) for utilization in [a, b]."""
    first, last = human_at(a, c), human_at(b, c)
    return min(first, last), c[3] if a <= c[1] <= b else max(first, last)


@numba.njit(cache=True)
def overshoot(manual, xa, xb, met, c):
    """
    Bound from above by how much TSC can have passed a threshold at the first sample of a phase, r being in [xa, xb] there.

    `met` is the greatest threshold for a manual phase, which TSC fell to, and the least for an autonomous one.
    """
    low, high = human_between(xa, xb, c)
    if manual:
        bend = xb * (1.0 / c[0] - 1.0)
        bell = c[3] - c[2] if xb + bend > 1.0 else max(human_at(xb, c) - human_at(xb + bend, c), 0.0)
        now = (met + c[8] * high) / c[7]
        return max(c[7] * (now - c[6]) * (1.0 / c[4] - 1.0) + c[8] * bell, 0.0)
    bend = min((1.0 - xa) * (1.0 / c[0] - 1.0), xb)
    bell = max(human_at(xb - bend, c) - human_at(xb, c), 0.0)
    now = (met + c[8] * low) / c[7]
    before = human_between(max(1.0 - (1.0 - xa) / c[0], 0.0), max(1.0 - (1.0 - xb) / c[0], 0.0), c)[1]
    return max(c[7] * ((1.0 - c[4]) * (c[6] - now) + c[5] * before) / c[4] + c[8] * bell, 0.0)


@numba.njit(cache=True)
def tube(manual, xa, xb, p_low, p_high, ends, most, sign, offset, c, h, known, least, leave):
    """
    Follow one tube until its phase is over for sure; lower `least` and `leave` at each length; return length, known.

    `least[T]` is the least sign·Σ of performance's share over the first T samples, `leave[T]` the same where the phase can end.
    `h` holds the range of P_h over the phase as far as `known`.
    """
    total, span, flow = 0.0, c[9] - c[6], (1.0 - c[4]) * c[6]
    drive = c[5] if manual else 0.0
    for t in range(1, most + 1):
        if t >= known:
            keep = c[0] ** t
            if manual:
                h[t] = human_between(1.0 - (1.0 - xa) * keep, 1.0 - (1.0 - xb) * keep, c)
            else:
                h[t] = human_between(xa * keep, xb * keep, c)
            known, least[t], leave[t] = t + 1, np.inf, np.inf
        total += (p_low - c[6]) / span if sign > 0 else (c[6] - p_high) / span
        total -= offset
        p_low = c[4] * p_low + flow + drive * h[t - 1, 0]
        p_high = c[4] * p_high + flow + drive * h[t - 1, 1]
        least[t] = min(least[t], total)
        low, high = c[7] * p_low - c[8] * h[t, 1], c[7] * p_high - c[8] * h[t, 0]
        if manual:
            if high >= ends[0] - TIGHT:
                leave[t] = min(leave[t], total)
            if low >= ends[1] + TIGHT:
                return t, known
            p_high = min(p_high, (ends[1] + TIGHT + c[8] * h[t, 1]) / c[7])
        else:
            if low <= ends[1] + TIGHT:
                leave[t] = min(leave[t], total)
            if high <= ends[0] - TIGHT:
                return t, known
            p_low = max(p_low, (ends[0] - TIGHT + c[8] * h[t, 0]) / c[7])
        if p_low > p_high:
            return t, known
    return most, known


@numba.njit(cache=True)
def busy(manual, x, t, keep, share):
    """Return Σ r over the first t samples of a phase that begins at r = x, and r after it."""
    if manual:
        return t - (1.0 - x) * share, 1.0 - (1.0 - x) * keep
    return x * share, x * keep


@numba.njit(cache=True)
def edge(manual, xa, xb, t, keep, share, sign, v):
    """Return the least of sign·Σ r + v·(r after − r before) over x in [xa, xb], which is linear in x."""
    a, b = busy(manual, xa, t, keep, share), busy(manual, xb, t, keep, share)
    return min(sign * a[0] + v * (a[1] - xa), sign * b[0] + v * (b[1] - xb))


@numba.njit(cache=True)
def all_phases(r, p, mode, k, limits, sign, c):
    """
    Follow the phase that is on, then one from every cell that a phase can begin in.

    Returns the nodes' modes and ends of r, where each has its lengths in the pools, the pools, and whether all was done.
    """
    nodes = 2 * CELLS + 1
    span = c[9] - c[6]
    p_most = max(p, c[6] + c[5] * max(c[3], 0.0) / (1.0 - c[4])) + 1e-12
    p_least = min(p, c[6] + c[5] * min(c[2], 0.0) / (1.0 - c[4])) - 1e-12
    # Rates are cut at 0 where f leaves [0, 2] because b_pr was rounded: f less what it can be outside by.
    offset = max((p_most - c[6]) / span - 1.0, 0.0) if sign > 0 else max((c[6] - p_least) / span, 0.0)
    first, last = np.full(nodes, -1, np.int64), np.zeros(nodes, np.int64)
    ends, queue, queued = np.zeros((nodes, 2)), np.empty(nodes, np.int64), np.zeros(nodes, np.bool_)
    allowed = WORK + WORK_EACH * k
    least, leave = np.empty(POOL), np.empty(POOL)
    h = np.empty((k + 2, 2))
    weights = 1.35 ** np.arange(PIECES)
    cuts = np.zeros(PIECES + 1)
    cuts[1:] = np.cumsum(weights) / weights.sum()
    queue[0], queued[nodes - 1], head, tail, used, work = nodes - 1, True, 0, 1, 0, 0
    while head < tail:
        node = queue[head]
        head += 1
        start = node == nodes - 1
        manual = mode == 1.0 if start else node >= CELLS
        xa = r if start else (node % CELLS) / CELLS
        xb = r if start else (node % CELLS + 1) / CELLS
        room = min(k, POOL - used - 1)
        first[node], ends[node, 0], ends[node, 1] = used, xa, xb
        mine, gone = least[used : used + room + 1], leave[used : used + room + 1]
        mine[0], gone[0] = 0.0, np.inf
        h[0] = human_between(xa, xb, c)
        known, length = 1, 0
        goal = limits[1] if manual else limits[0]
        a, b = limits[0, 0], limits[0, 1]
        if manual:
            a -= overshoot(True, xa, xb, b, c)
        else:
            a, b = limits[1, 0], limits[1, 1]
            b += overshoot(False, xa, xb, a, c)
        for j in range(1 if start else PIECES):
            low = high = p
            if not start:
                one = a + (b - a) * (cuts[j] if sign > 0 else 1.0 - cuts[j + 1])
                two = a + (b - a) * (cuts[j + 1] if sign > 0 else 1.0 - cuts[j])
                low = max((one - TIGHT + c[8] * h[0, 0]) / c[7], p_least)
                high = min((two + TIGHT + c[8] * h[0, 1]) / c[7], p_most)
            if low > high:
                continue
            t, known = tube(manual, xa, xb, low, high, goal, room, sign, offset, c, h, known, mine, gone)
            work += t
            length = max(length, t)
        if (length == room and room < k) or work > allowed:
            return first, last, ends, least, leave, False
        last[node] = length
        used += length + 1
        for t in range(1, length + 1):
            if gone[t] < np.inf:
                keep = c[0] ** t
                lo, hi = busy(manual, xa, t, keep, 0.0)[1], busy(manual, xb, t, keep, 0.0)[1]
                one = max(int((lo - 1e-9) * CELLS), 0)
                two = min(int((hi + 1e-9) * CELLS), CELLS - 1)
                for cell in range(one, two + 1):
                    other = cell + (0 if manual else CELLS)
                    if not queued[other]:
                        queued[other] = True
                        queue[tail] = other
                        tail += 1
    return first, last, ends, least, leave, True


@numba.njit(cache=True)
def shortest(mode, k, first, last, ends, leave, sign, rho, v, powers, passes, dist, back, taken):
    """Fill `dist` with the shortest paths from the phase that is on; return whether nothing changes any more."""
    nodes = first.size
    dist[:] = np.inf
    dist[nodes - 1] = 0.0
    back[:], taken[:] = -1, 0
    fresh, again = np.zeros(nodes, np.bool_), np.zeros(nodes, np.bool_)
    fresh[nodes - 1] = True
    for _ in range(passes):
        again[:] = False
        moved = False
        for node in range(nodes):
            if not fresh[node]:
                continue
            manual = mode == 1.0 if node == nodes - 1 else node >= CELLS
            xa, xb, base = ends[node, 0], ends[node, 1], first[node]
            for t in range(1, last[node] + 1):
                gone = leave[base + t]
                if gone == np.inf:
                    continue
                keep, share = powers[t, 0], powers[t, 1]
                to = dist[node] + gone + edge(manual, xa, xb, t, keep, share, sign, v) - rho * t
                lo, hi = busy(manual, xa, t, keep, share)[1], busy(manual, xb, t, keep, share)[1]
                one = max(int((lo - 1e-9) * CELLS), 0)
                two = min(int((hi + 1e-9) * CELLS), CELLS - 1)
                for cell in range(one, two + 1):
                    other = cell + (0 if manual else CELLS)
                    if to < dist[other]:
                        dist[other] = to
                        back[other], taken[other] = node, t
                        again[other], moved = True, True
        if not moved:
            return True
        fresh[:] = again
    return False


@numba.njit(cache=True)
def cycle_mean(mode, first, ends, leave, sign, v, powers, back, taken):
    """Return the least mean of f over the cycles among the predecessors; infinity where there is none."""
    nodes = first.size
    seen = np.zeros(nodes, np.int64)
    best = np.inf
    for begin in range(nodes):
        node = begin
        while node >= 0 and seen[node] == 0:
            seen[node] = begin + 1
            node = back[node]
        if node < 0 or seen[node] != begin + 1:
            continue
        total, length, at = 0.0, 0, node
        while True:
            before, t = back[at], taken[at]
            manual = mode == 1.0 if before == nodes - 1 else before >= CELLS
            keep, share = powers[t, 0], powers[t, 1]
            total += leave[first[before] + t]
            total += edge(manual, ends[before, 0], ends[before, 1], t, keep, share, sign, v)
            length += t
            at = before
            if at == node:
                break
        best = min(best, total / length)
    return best


@numba.njit(cache=True)
def least_effort(r, p, mode, k, limits, sign, v, c):
    """
    Return ρ and D such that sign·Σ f ≥ ρ K + D over the first K ≤ k samples; D is −inf if unknown.

    The first sample has r and P_r, and the mode that (2.8) gives there. `limits` are the least and the greatest value of
    TSC_l, then of TSC_u, over these samples. `v` is any number.
    """
    first, last, ends, least, leave, done = all_phases(r, p, mode, k, limits, sign, c)
    if not done:
        return 0.0, -np.inf
    nodes = first.size
    longest = last.max()
    powers = np.empty((longest + 1, 2))
    for t in range(longest + 1):
        powers[t, 0] = c[0] ** t
        powers[t, 1] = (1.0 - powers[t, 0]) / (1.0 - c[0])
    dist, back, taken = np.empty(nodes), np.empty(nodes, np.int64), np.empty(nodes, np.int64)
    rho, found = 2.0 if sign > 0 else 0.0, False
    for _ in range(12):
        if shortest(mode, k, first, last, ends, leave, sign, rho, v, powers, 40, dist, back, taken):
            found = True
            break
        mean = cycle_mean(mode, first, ends, leave, sign, v, powers, back, taken)
        rho = min(mean, rho) - 1e-4
    if not found:
        return 0.0, -np.inf
    # What an unfinished phase can add, and v taken back.
    worst = np.inf
    for node in range(nodes):
        if first[node] < 0 or dist[node] == np.inf:
            continue
        manual = mode == 1.0 if node == nodes - 1 else node >= CELLS
        for t in range(last[node] + 1):
            rest = least[first[node] + t]
            if rest == np.inf:
                continue
            for x in ends[node]:
                own = sign * busy(manual, x, t, powers[t, 0], powers[t, 1])[0] - rho * t
                worst = min(worst, dist[node] + own + rest + v * (r - x))
    return rho, worst
