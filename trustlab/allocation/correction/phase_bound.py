"""
Bounds on how fast thresholds can move on average over many switches: for the exact engine and long horizons.

By (2.42) thresholds rise by ½ c_b Σ (2 − f) at most and fall by ½ c_b Σ f, f = r + (P_r − P_min)/(P_max − P_min). Boxes
around the reachable states grow wide within a few cycles, so Σ f is bounded phase by phase instead.

1. A phase begins where TSC has just crossed a threshold, which lies in a known interval. So P_r follows from r up to that
   interval and one step, and a phase is determined by its mode and r at its first sample. r is divided into cells.
2. From each cell, and each piece of the threshold's interval, tubes enclose r and P_r until the last sample at which TSC can
   reach the other threshold. They give the least Σ f for each length T of the phase, and the cells where the next one begins.
3. For any ρ and v, the least Σ (f − ρ) + v (r at its end − r at its beginning) is the weight of the edge from cell to cell.
   Where no cycle of edges has negative weight, shortest paths exist, and Σ f ≥ ρ K + D over any K samples, D following from
   the shortest paths and the least sum of an unfinished phase. ρ is chosen just below the least mean over all cycles; a poor
   choice of ρ or v loosens the bound but never invalidates it.

A node is a mode with a cell of r: autonomous phases are nodes 0 … CELLS − 1, manual ones CELLS … 2 CELLS − 1, and the
current phase is the last node, START.
"""

from typing import NamedTuple

import numpy as np

from trustlab.allocation.correction.plan import LOWER, UPPER
from trustlab.models.compiled import njit
from trustlab.models.robot import next_performance
from trustlab.models.tsc import human_at, human_range, tsc_at

# Cells of utilization, over [0, 1].
CELLS = 800

START = 2 * CELLS
NODES = START + 1

# Columns of arrays of intervals.
LOW, HIGH = 0, 1

# Pieces of a threshold's interval; the first the narrowest, each 1.35 times the one before.
PIECES = 14

# Most samples of tubes to follow, in all and per step of the horizon; beyond, nothing is proved.
WORK, WORK_EACH = 4_000_000, 100

# Most lengths of phases to store, over all cells.
POOL = 1_500_000

# Tolerance of comparisons for rounding, in units of TSC.
TIGHT = 1e-9


class Phases(NamedTuple):
    """All phases that can follow the current one: for each node its interval of r and, in pools, the sums for each length."""

    first: np.ndarray  # where a node's lengths begin in the pools; −1 where no phase begins in it
    last: np.ndarray  # its greatest length
    ends: np.ndarray  # its interval of r
    least: np.ndarray  # pool: least sign·Σ of performance's share over so many samples
    leave: np.ndarray  # pool: the same where the phase can end there, else infinity


@njit
def is_manual(node, mode):
    """Return whether a node's phase is manual; `mode` is that of the current phase."""
    return mode == 1.0 if node == START else node >= CELLS


@njit
def next_cells(manual, xa, xb, t, keep):
    """Return the nodes, first and last, in which the next phase begins after t samples from r in [xa, xb]."""
    lo, hi = busy(manual, xa, t, keep, 0.0)[1], busy(manual, xb, t, keep, 0.0)[1]
    other = 0 if manual else CELLS
    return other + max(int((lo - 1e-9) * CELLS), 0), other + min(int((hi + 1e-9) * CELLS), CELLS - 1)


@njit
def overshoot_of_any(manual, xa, xb, met, c):
    """
    Bound how far beyond a threshold TSC can be at the first sample of a phase, r being in [xa, xb] there.

    Unlike `overshoot` of the steady cycle this allows for a threshold that moves: `met` is the greatest that a manual phase
    can have begun at, and the least for an autonomous one.
    """
    low, high = human_range(xa, xb, c)
    # One step of (2.3) and (2.5) backwards from the threshold bounds the change of TSC in it.
    if manual:
        bend = xb * (1.0 / c.a_r - 1.0)
        bell = c.p_h_max - c.p_h_min
        if xb + bend <= 1.0:
            bell = max(human_at(xb, c) - human_at(xb + bend, c), 0.0)
        now = (met + c.b_T * high) / c.a_T
        return max(c.a_T * (now - c.p_r_min) * (1.0 / c.a_pr - 1.0) + c.b_T * bell, 0.0)
    bend = min((1.0 - xa) * (1.0 / c.a_r - 1.0), xb)
    bell = max(human_at(xb - bend, c) - human_at(xb, c), 0.0)
    now = (met + c.b_T * low) / c.a_T
    before = human_range(max(1.0 - (1.0 - xa) / c.a_r, 0.0), max(1.0 - (1.0 - xb) / c.a_r, 0.0), c)[HIGH]
    return max(c.a_T * ((1.0 - c.a_pr) * (c.p_r_min - now) + c.b_pr * before) / c.a_pr + c.b_T * bell, 0.0)


@njit
def tube(manual, xa, xb, p_low, p_high, ends, most, sign, offset, c, h, known, least, leave):
    """
    Follow one tube until its phase has certainly ended; lower `least` and `leave` at each length; return length, known.

    `least[T]` is the least sign·Σ of performance's share over the first T samples, `leave[T]` the same where the phase can end.
    `h` holds the range of P_h over the phase as far as `known`.
    """
    total, span = 0.0, c.p_r_max - c.p_r_min
    mode = 1.0 if manual else 0.0
    for t in range(1, most + 1):
        if t >= known:
            keep = c.a_r**t
            one, other = busy(manual, xa, t, keep, 0.0)[1], busy(manual, xb, t, keep, 0.0)[1]
            h[t, LOW], h[t, HIGH] = human_range(one, other, c)
            known, least[t], leave[t] = t + 1, np.inf, np.inf
        total += (p_low - c.p_r_min) / span if sign > 0 else (c.p_r_min - p_high) / span
        total -= offset
        p_low = next_performance(p_low, h[t - 1, LOW], mode, c.a_pr, c.b_pr, c.p_r_min)
        p_high = next_performance(p_high, h[t - 1, HIGH], mode, c.a_pr, c.b_pr, c.p_r_min)
        least[t] = min(least[t], total)
        low, high = tsc_at(p_low, h[t, HIGH], c), tsc_at(p_high, h[t, LOW], c)
        # The tube continues with the states whose TSC has not yet passed the farthest value of the threshold.
        if manual:
            if high >= ends[LOW] - TIGHT:
                leave[t] = min(leave[t], total)
            if low >= ends[HIGH] + TIGHT:
                return t, known
            p_high = min(p_high, (ends[HIGH] + TIGHT + c.b_T * h[t, HIGH]) / c.a_T)
        else:
            if low <= ends[HIGH] + TIGHT:
                leave[t] = min(leave[t], total)
            if high <= ends[LOW] - TIGHT:
                return t, known
            p_low = max(p_low, (ends[LOW] - TIGHT + c.b_T * h[t, LOW]) / c.a_T)
        if p_low > p_high:
            return t, known
    return most, known


@njit
def busy(manual, x, t, keep, share):
    """Return Σ r over the first t samples of a phase that begins at r = x, and r after it; keep is a_r^t, share its sum."""
    if manual:
        return t - (1.0 - x) * share, 1.0 - (1.0 - x) * keep
    return x * share, x * keep


@njit
def edge(manual, xa, xb, t, keep, share, sign, v):
    """Return the least of sign·Σ r + v·(r after − r before) over x in [xa, xb], which is linear in x."""
    sum_a, after_a = busy(manual, xa, t, keep, share)
    sum_b, after_b = busy(manual, xb, t, keep, share)
    return min(sign * sum_a + v * (after_a - xa), sign * sum_b + v * (after_b - xb))


@njit
def all_phases(r, p, mode, k, limits, sign, c):
    """Follow the current phase, then one from every cell in which a phase can begin; return them and whether all were followed."""
    span = c.p_r_max - c.p_r_min
    p_most = max(p, c.p_r_min + c.b_pr * max(c.p_h_max, 0.0) / (1.0 - c.a_pr)) + 1e-12
    p_least = min(p, c.p_r_min + c.b_pr * min(c.p_h_min, 0.0) / (1.0 - c.a_pr)) - 1e-12
    # With a rounded b_pr, f can leave [0, 2] and rates are cut at 0: subtract by how much f can be outside.
    offset = max((p_most - c.p_r_min) / span - 1.0, 0.0) if sign > 0 else max((c.p_r_min - p_least) / span, 0.0)
    first, last, cells = np.full(NODES, -1, np.int64), np.zeros(NODES, np.int64), np.zeros((NODES, 2))
    phases = Phases(first, last, cells, np.empty(POOL), np.empty(POOL))
    queue, queued = np.empty(NODES, np.int64), np.zeros(NODES, np.bool_)
    allowed = WORK + WORK_EACH * k
    h = np.empty((k + 2, 2))
    weights = 1.35 ** np.arange(PIECES)
    whole, cuts = weights.sum(), np.zeros(PIECES + 1)
    sums = np.cumsum(weights)
    for j in range(PIECES):
        cuts[j + 1] = sums[j] / whole
    queue[0], queued[START], head, tail, used, work = START, True, 0, 1, 0, 0
    while head < tail:
        node = queue[head]
        head += 1
        start, manual = node == START, is_manual(node, mode)
        xa = r if start else (node % CELLS) / CELLS
        xb = r if start else (node % CELLS + 1) / CELLS
        room = min(k, POOL - used - 1)
        phases.first[node] = used
        phases.ends[node, LOW], phases.ends[node, HIGH] = xa, xb
        mine, gone = phases.least[used : used + room + 1], phases.leave[used : used + room + 1]
        mine[0], gone[0] = 0.0, np.inf
        h[0, LOW], h[0, HIGH] = human_range(xa, xb, c)
        known, length = 1, 0
        goal = limits[UPPER] if manual else limits[LOWER]
        a, b = limits[LOWER] if manual else limits[UPPER]
        if manual:
            a -= overshoot_of_any(True, xa, xb, b, c)
        else:
            b += overshoot_of_any(False, xa, xb, a, c)
        for j in range(1 if start else PIECES):
            low = high = p
            if not start:
                # Narrow pieces where P_r is least (or greatest), since the extreme of the sum lies there.
                one = a + (b - a) * (cuts[j] if sign > 0 else 1.0 - cuts[j + 1])
                two = a + (b - a) * (cuts[j + 1] if sign > 0 else 1.0 - cuts[j])
                low = max((one - TIGHT + c.b_T * h[0, LOW]) / c.a_T, p_least)
                high = min((two + TIGHT + c.b_T * h[0, HIGH]) / c.a_T, p_most)
            if low > high:
                continue
            t, known = tube(manual, xa, xb, low, high, goal, room, sign, offset, c, h, known, mine, gone)
            work += t
            length = max(length, t)
        if (length == room and room < k) or work > allowed:
            return phases, False
        phases.last[node] = length
        used += length + 1
        for t in range(1, length + 1):
            if gone[t] < np.inf:
                one, two = next_cells(manual, xa, xb, t, c.a_r**t)
                for other in range(one, two + 1):
                    if not queued[other]:
                        queued[other] = True
                        queue[tail] = other
                        tail += 1
    return phases, True


@njit
def shortest(mode, phases, sign, rho, v, keeps, shares, passes, dist, back, taken):
    """Fill `dist` with the shortest paths from the current phase; return whether they have converged (Bellman–Ford)."""
    dist[:] = np.inf
    dist[START] = 0.0
    back[:], taken[:] = -1, 0
    fresh, again = np.zeros(NODES, np.bool_), np.zeros(NODES, np.bool_)
    fresh[START] = True
    for _ in range(passes):
        again[:] = False
        moved = False
        for node in range(NODES):
            if not fresh[node]:
                continue
            manual, base = is_manual(node, mode), phases.first[node]
            xa, xb = phases.ends[node]
            for t in range(1, phases.last[node] + 1):
                gone = phases.leave[base + t]
                if gone == np.inf:
                    continue
                to = dist[node] + gone + edge(manual, xa, xb, t, keeps[t], shares[t], sign, v) - rho * t
                one, two = next_cells(manual, xa, xb, t, keeps[t])
                for other in range(one, two + 1):
                    if to < dist[other]:
                        dist[other] = to
                        back[other], taken[other] = node, t
                        again[other], moved = True, True
        if not moved:
            return True
        fresh, again = again, fresh
    return False


@njit
def cycle_mean(mode, phases, sign, v, keeps, shares, back, taken):
    """Return the least mean of f over the cycles among the predecessors; infinity where there is none."""
    seen = np.zeros(NODES, np.int64)
    best = np.inf
    for begin in range(NODES):
        # Go back along predecessors until a node repeats: one seen in this walk closes a cycle, one seen earlier gives nothing new.
        node = begin
        while node >= 0 and seen[node] == 0:
            seen[node] = begin + 1
            node = back[node]
        if node < 0 or seen[node] != begin + 1:
            continue
        total, length, at = 0.0, 0, node
        while True:
            before, t = back[at], taken[at]
            xa, xb = phases.ends[before]
            total += phases.leave[phases.first[before] + t]
            total += edge(is_manual(before, mode), xa, xb, t, keeps[t], shares[t], sign, v)
            length += t
            at = before
            if at == node:
                break
        best = min(best, total / length)
    return best


@njit
def least_effort(r, p, mode, k, limits, sign, v, c):
    """
    Return ρ and D such that sign·Σ f ≥ ρ K + D over the first K ≤ k samples; D is −inf if unknown.

    The first sample has r and P_r, and the mode that (2.8) gives there. `limits` are the least and the greatest value of
    TSC_l, then of TSC_u, over these samples. `v` is any number.
    """
    phases, done = all_phases(r, p, mode, k, limits, sign, c)
    if not done:
        return 0.0, -np.inf
    longest = phases.last.max()
    keeps = np.empty(longest + 1)
    for t in range(longest + 1):
        keeps[t] = c.a_r**t
    shares = (1.0 - keeps) / (1.0 - c.a_r)
    dist, back, taken = np.empty(NODES), np.empty(NODES, np.int64), np.empty(NODES, np.int64)
    rho, found = 2.0 if sign > 0 else 0.0, False
    for _ in range(12):
        if shortest(mode, phases, sign, rho, v, keeps, shares, 40, dist, back, taken):
            found = True
            break
        mean = cycle_mean(mode, phases, sign, v, keeps, shares, back, taken)
        rho = min(mean, rho) - 1e-4
    if not found:
        return 0.0, -np.inf
    # Add what an unfinished phase can contribute, and subtract the terms of v.
    worst = np.inf
    for node in range(NODES):
        base = phases.first[node]
        if base < 0 or dist[node] == np.inf:
            continue
        manual = is_manual(node, mode)
        for t in range(phases.last[node] + 1):
            rest = phases.least[base + t]
            if rest == np.inf:
                continue
            for x in phases.ends[node]:
                own = sign * busy(manual, x, t, keeps[t], shares[t])[0] - rho * t
                worst = min(worst, dist[node] + own + rest + v * (r - x))
    return rho, worst
