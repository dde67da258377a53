"""
Bounds on how fast thresholds can move on average over many switches: for the exact engine and long
horizons.

By (2.42) thresholds rise by ½ c_b Σ (2 − f) at most and fall by ½ c_b Σ f, f = r + (P_r −
P_min)/(P_max − P_min). Boxes around the reachable states grow wide within a few cycles, so Σ f is
bounded phase by phase instead.

1. A phase begins where TSC has just crossed a threshold, which lies in a known interval. So P_r
follows from r up to that
   interval and one step, and a phase is determined by its mode and r at its first sample. r is
   divided into cells.
2. From each cell, and each piece of the threshold's interval, tubes enclose r and P_r until the
last sample at which TSC can
   reach the other threshold. They give the least Σ f for each length T of the phase, and the cells
   where the next one begins.
3. For any ρ and v, the least Σ (f − ρ) + v (r at its end − r at its beginning) is the weight of the
edge from cell to cell.
   Where no cycle of edges has negative weight, shortest paths exist, and Σ f ≥ ρ K + D over any K
   samples, D following from the shortest paths and the least sum of an unfinished phase. ρ is
   chosen just below the least mean over all cycles; a poor choice of ρ or v loosens the bound but
   never invalidates it.

A node is a mode with a cell of r: autonomous phases are nodes 0 … CELLS − 1, manual ones CELLS … 2
CELLS − 1, and the current phase is START. An unfinished phase is an edge to END, from which nothing
goes on.
"""

import numpy as np

from trustlab.allocation.correction.plan import LOWER, UPPER
from trustlab.models.compiled import njit
from trustlab.models.robot import next_performance
from trustlab.models.tsc import human_at, human_range, tsc_at

# Cells of utilization, over [0, 1].
CELLS = 800

START, END = 2 * CELLS, 2 * CELLS + 1

# Columns of arrays of intervals.
LOW, HIGH = 0, 1

# Where the interval of a threshold is cut into pieces; the first is the narrowest, each 1.35 times
# the one before.
PIECES = 14
CUTS = np.append(0.0, np.cumsum(1.35 ** np.arange(PIECES)) / np.sum(1.35 ** np.arange(PIECES)))

# Most samples of tubes to follow, in all and per step of the horizon; beyond, nothing is proved.
WORK, WORK_EACH = 4_000_000, 100

# Most lengths of phases to store, over all cells.
POOL = 1_500_000

# Tolerance of comparisons for rounding, in units of TSC.
TIGHT = 1e-9


# A phase of so many samples from a node to the nodes `first` … `last`; effort is the least sign·Σ f
# + v (r at its end − r at its beginning), where the end of an unfinished phase counts as the r of
# now.
EDGE = np.dtype([("start", int), ("first", int), ("last", int), ("length", int), ("effort", float)])


@njit
def next_cells(manual, xa, xb, t, keep):
    """
    Return the nodes, first and last, in which the next phase begins after t samples from r in [xa,
    xb].
    """
    lo, hi = busy(manual, xa, t, keep, 0.0)[1], busy(manual, xb, t, keep, 0.0)[1]
    other = 0 if manual else CELLS
    return other + max(int((lo - 1e-9) * CELLS), 0), other + min(
        int((hi + 1e-9) * CELLS), CELLS - 1
    )


@njit
def overshoot_of_any(manual, xa, xb, met, c):
    """
    Bound how far beyond a threshold TSC can be at the first sample of a phase, r being in [xa, xb]
    there.

    Unlike `overshoot` of the steady cycle this allows for a threshold that moves: `met` is the
    greatest that a manual phase can have begun at, and the least for an autonomous one.
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
    before = human_range(max(1.0 - (1.0 - xa) / c.a_r, 0.0), max(1.0 - (1.0 - xb) / c.a_r, 0.0), c)[
        HIGH
    ]
    return max(
        c.a_T * ((1.0 - c.a_pr) * (c.p_r_min - now) + c.b_pr * before) / c.a_pr + c.b_T * bell, 0.0
    )


@njit
def tube(manual, xa, xb, p_low, p_high, ends, most, sign, offset, c, h, known, least, leave):
    """
    Follow one tube until its phase has certainly ended; lower `least` and `leave` at each length;
    return length, known.

    `least[T]` is the least sign·Σ of performance's share over the first T samples, `leave[T]` the
    same where the phase can end. `h` holds the range of P_h over the phase as far as `known`.
    """
    total, span = 0.0, c.p_r_max - c.p_r_min
    mode = 1.0 if manual else 0.0
    for t in range(1, most + 1):
        if t >= known:
            keep = c.a_r**t
            one, other = busy(manual, xa, t, keep, 0.0)[1], busy(manual, xb, t, keep, 0.0)[1]
            h[t, LOW], h[t, HIGH] = human_range(one, other, c)
            known = t + 1
            least[t] = np.inf
            leave[t] = np.inf
        total += (p_low - c.p_r_min) / span if sign > 0 else (c.p_r_min - p_high) / span
        total -= offset
        p_low = next_performance(p_low, h[t - 1, LOW], mode, c.a_pr, c.b_pr, c.p_r_min)
        p_high = next_performance(p_high, h[t - 1, HIGH], mode, c.a_pr, c.b_pr, c.p_r_min)
        least[t] = min(least[t], total)
        low, high = tsc_at(p_low, h[t, HIGH], c), tsc_at(p_high, h[t, LOW], c)
        # The tube continues with the states whose TSC has not yet passed the farthest value of the
        # threshold.
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
    """
    Return Σ r over the first t samples of a phase that begins at r = x, and r after it; keep is
    a_r^t, share its sum.
    """
    if manual:
        return t - (1.0 - x) * share, 1.0 - (1.0 - x) * keep
    return x * share, x * keep


@njit
def all_phases(r, p, mode, k, limits, sign, v, c):
    """
    Follow the current phase, then one from every cell in which a phase can begin.

    Returns the edges, where those of each node begin and end among them, and whether all phases
    were followed.
    """
    span = c.p_r_max - c.p_r_min
    p_most = max(p, c.p_r_min + c.b_pr * max(c.p_h_max, 0.0) / (1.0 - c.a_pr)) + 1e-12
    p_least = min(p, c.p_r_min + c.b_pr * min(c.p_h_min, 0.0) / (1.0 - c.a_pr)) - 1e-12
    # With a rounded b_pr, f can leave [0, 2] and rates are cut at 0: subtract by how much f can be
    # outside.
    offset = (
        max((p_most - c.p_r_min) / span - 1.0, 0.0)
        if sign > 0
        else max((c.p_r_min - p_least) / span, 0.0)
    )
    edges = np.empty(2 * POOL, EDGE)
    begin = np.zeros(END, np.int64)
    end = np.zeros(END, np.int64)
    # Of one node, over so many samples: least sign·Σ of performance's share, and the same where the
    # phase can end there.
    least, leave = np.empty(k + 2), np.empty(k + 2)
    queue, queued = np.empty(END, np.int64), np.zeros(END, np.bool_)
    allowed = WORK + WORK_EACH * k
    h = np.empty((k + 2, 2))
    queue[0] = START
    queued[START] = True
    head = 0
    tail = 1
    used = 0
    count = 0
    work = 0
    while head < tail:
        node = queue[head]
        head += 1
        start = node == START
        manual = mode == 1.0 if start else node >= CELLS
        xa = r if start else (node % CELLS) / CELLS
        xb = r if start else (node % CELLS + 1) / CELLS
        room = min(k, POOL - used - 1)
        least[0], leave[0] = 0.0, np.inf
        h[0, LOW], h[0, HIGH] = human_range(xa, xb, c)
        known, length = np.int64(1), 0  # no literal 1: numba would compile `tube` for it as well
        goal = limits[UPPER] if manual else limits[LOWER]
        a, b = limits[LOWER] if manual else limits[UPPER]
        over = overshoot_of_any(manual, xa, xb, b if manual else a, c)
        if manual:
            a -= over
        else:
            b += over
        for j in range(1 if start else PIECES):
            low = high = p
            if not start:
                # Narrow pieces where P_r is least (or greatest), since the extreme of the sum lies
                # there.
                one = a + (b - a) * (CUTS[j] if sign > 0 else 1.0 - CUTS[j + 1])
                two = a + (b - a) * (CUTS[j + 1] if sign > 0 else 1.0 - CUTS[j])
                low = max((one - TIGHT + c.b_T * h[0, LOW]) / c.a_T, p_least)
                high = min((two + TIGHT + c.b_T * h[0, HIGH]) / c.a_T, p_most)
            if low > high:
                continue
            t, known = tube(
                manual, xa, xb, low, high, goal, room, sign, offset, c, h, known, least, leave
            )
            work += t
            length = max(length, t)
        if (length == room and room < k) or work > allowed:
            return edges, begin, end, False
        used += length + 1
        begin[node] = count
        for t in range(length + 1):
            keep = c.a_r**t
            share = (1.0 - keep) / (1.0 - c.a_r)
            stay = np.inf
            go = np.inf
            for x in (xa, xb):  # both are linear in x
                total, after = busy(manual, x, t, keep, share)
                stay, go = (
                    min(stay, sign * total + v * (r - x)),
                    min(go, sign * total + v * (after - x)),
                )
            edge = edges[count]
            edge.start = node
            edge.first = END
            edge.last = END
            edge.length = t
            edge.effort = least[t] + stay
            count += 1
            if leave[t] == np.inf:
                continue
            one, two = next_cells(manual, xa, xb, t, keep)
            edge = edges[count]
            edge.start = node
            edge.first = one
            edge.last = two
            edge.length = t
            edge.effort = leave[t] + go
            count += 1
            for other in range(one, two + 1):
                if not queued[other]:
                    queued[other] = True
                    queue[tail] = other
                    tail += 1
        end[node] = count
    return edges, begin, end, True


@njit
def shortest(edges, begin, end, rho, passes, dist, back):
    """
    Fill `dist` with the shortest paths from the current phase; return whether they have converged
    (Bellman–Ford).
    """
    fresh, again = np.empty(END + 1, np.bool_), np.empty(END + 1, np.bool_)
    for node in range(END + 1):
        dist[node] = np.inf
        back[node] = -1
        fresh[node] = False
    dist[START], fresh[START] = 0.0, True
    for _ in range(passes):
        moved = False
        for node in range(END + 1):
            again[node] = False
        for node in range(END):
            if not fresh[node]:
                continue
            for i in range(begin[node], end[node]):
                edge = edges[i]
                to = dist[node] + edge.effort - rho * edge.length
                for other in range(edge.first, edge.last + 1):
                    if to < dist[other]:
                        dist[other], back[other] = to, i
                        again[other], moved = True, True
        if not moved:
            return True
        fresh, again = again, fresh
    return False


@njit
def cycle_mean(edges, back):
    """
    Return the least mean of f over the cycles among the predecessors; infinity where there is none.
    """
    seen = np.zeros(END, np.int64)
    best = np.inf
    for first in range(END):
        # Go back along predecessors until a node repeats: one seen in this walk closes a cycle, one
        # seen earlier gives nothing new.
        node = first
        while node >= 0 and seen[node] == 0:
            seen[node] = first + 1
            node = edges[back[node]].start if back[node] >= 0 else -1
        if node < 0 or seen[node] != first + 1:
            continue
        total = 0.0
        length = 0
        at = node
        while True:
            edge = edges[back[at]]
            total = total + edge.effort
            length = length + edge.length
            at = edge.start
            if at == node:
                break
        best = min(best, total / length)
    return best


@njit
def least_effort(r, p, mode, k, limits, sign, v, c):
    """
    Return ρ and D such that sign·Σ f ≥ ρ K + D over the first K ≤ k samples; D is −inf if unknown.

    The first sample has r and P_r, and the mode that (2.8) gives there. `limits` are the least and
    the greatest value of TSC_l, then of TSC_u, over these samples. `v` is any number.
    """
    edges, begin, end, done = all_phases(r, p, mode, k, limits, sign, v, c)
    dist, back = np.empty(END + 1), np.empty(END + 1, np.int64)
    rho = 2.0 if sign > 0 else 0.0
    for _ in range(12 if done else 0):
        if shortest(edges, begin, end, rho, 40, dist, back):
            return rho, dist[END]
        rho = min(cycle_mean(edges, back), rho) - 1e-4
    return 0.0, -np.inf
