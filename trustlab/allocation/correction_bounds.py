"""What no plan of correction can beat: bounds of the cost (2.43) from some step on, for the exact engine."""

from __future__ import annotations

import numba
import numpy as np

from trustlab.allocation.correction_cycles import least_effort
from trustlab.allocation.phases import human_at

__all__ = ["future_cost", "reachable", "remaining_cost"]

LONG = 1000
"""From how many steps on the bound over many switches is worth its time."""


@numba.njit(cache=True)
def future_cost(first, n, r, p, low, high, mode, at, goal, sign, c, standard, enough):
    """
    Bound the cost from step `first` to n from below, thresholds being at most at `at` (as seen rising) there.

    r, P_r and the box [low, high] are those of step `first`, where the mode is `mode`. Afterwards a rising threshold
    moves at the rate of an autonomous mode for ever, a falling one at that of a manual mode at the operator's best; at
    c_b where the incentives are not the standard ones. Stops as soon as the bound reaches `enough`.
    """
    c_b, span = c[10], c[9] - c[6]
    cost = (goal[0] - at[0]) ** 2 + (goal[1] - at[1]) ** 2
    p_h = human_at(r, c)
    p = c[4] * p + (1.0 - c[4]) * c[6] + mode * c[5] * p_h
    r = c[0] * r + (1.0 - c[0]) * mode
    r_least, r_most, p_least, p_most = r, r, p, p
    worst, finest = c[5] * min(c[2], 0.0), c[5] * max(c[3], 0.0)
    z0, z1 = at[0], at[1]
    up, down = high, -low
    for _ in range(first + 1, n + 1):
        z0 = min(z0 + (up if sign[0] > 0 else down), goal[0])
        z1 = min(z1 + (up if sign[1] > 0 else down), goal[1])
        cost += (goal[0] - z0) ** 2 + (goal[1] - z1) ** 2
        if cost >= enough:
            return cost
        if standard:
            up = max(0.5 * c_b * (2.0 - r_least - (p_least - c[6]) / span), 0.0)
            down = max(0.5 * c_b * (r_most + (p_most - c[6]) / span), 0.0)
            r_least = c[0] * r_least
            r_most = c[0] * r_most + (1.0 - c[0])
            p_least = c[4] * p_least + (1.0 - c[4]) * c[6] + worst
            p_most = c[4] * p_most + (1.0 - c[4]) * c[6] + finest
        else:
            up, down = c_b, c_b
    return cost


@numba.njit(cache=True)
def human_range(least, most, c):
    """Return the least and the greatest P_h of (2.6) for utilization in [least, most]."""
    a, b = human_at(least, c), human_at(most, c)
    top = c[3] if least <= c[1] <= most else max(a, b)
    return min(a, b), top


@numba.njit(cache=True)
def reachable(first, n, r, p, mode, most, start, low, high, goal, sign, c, standard, path):
    """
    Fill `path` with how far thresholds can be from step `first` to n, whatever the modes, from boxes that enclose r and P_r.

    One box per mode of the step before; at each step the part of it that (2.8) lets stay and the part that it lets
    switch, for thresholds anywhere between their start and the farthest they can have moved, go on as one box each.
    """
    c_b, span = c[10], c[9] - c[6]
    near = np.empty(2)
    near[0], near[1] = most[0, first - 1], most[1, first - 1]
    up, down = high[first - 1], -low[first - 1]
    # Row 0 autonomous, row 1 manual, by the mode of the step before: r from, r to, P_r from, P_r to.
    boxes, nexts = np.empty((2, 4)), np.empty((2, 4))
    alive, lives = np.zeros(2, np.bool_), np.zeros(2, np.bool_)
    m = int(mode[first - 1])
    alive[m] = True
    boxes[m, 0] = boxes[m, 1] = r[first]
    boxes[m, 2] = boxes[m, 3] = p[first]
    for k in range(first, n + 1):
        for j in range(2):
            near[j] = min(near[j] + (up if sign[j] > 0 else down), goal[j])
            path[j, k] = near[j]
        if k == n:
            break
        lives[:] = False
        up, down = 0.0, 0.0
        for m in range(2):
            if not alive[m]:
                continue
            r_low, r_high, p_low, p_high = boxes[m]
            h_low, h_high = human_range(r_low, r_high, c)
            if standard:
                up = max(up, 0.5 * c_b * (2.0 - r_low - (p_low - c[6]) / span))
                down = max(down, 0.5 * c_b * (r_high + (p_high - c[6]) / span))
            else:
                up, down = c_b, c_b
            # The threshold that counts lies between x_low and x_high.
            x_low, x_high = sign[m] * start[m], sign[m] * near[m]
            if x_low > x_high:
                x_low, x_high = x_high, x_low
            for to in range(2):
                a, b = p_low, p_high
                # Who is left alone has TSC above TSC_l or has just met TSC_u; who drives, the other way round.
                if to == 0:
                    a = max(a, (x_low + c[8] * h_low) / c[7])
                else:
                    b = min(b, (x_high + c[8] * h_high) / c[7])
                if a > b + 1e-12:
                    continue
                new_r_low, new_r_high = c[0] * r_low + (1.0 - c[0]) * to, c[0] * r_high + (1.0 - c[0]) * to
                new_p_low = c[4] * a + (1.0 - c[4]) * c[6] + to * c[5] * h_low
                new_p_high = c[4] * b + (1.0 - c[4]) * c[6] + to * c[5] * h_high
                if lives[to]:
                    nexts[to, 0], nexts[to, 1] = min(nexts[to, 0], new_r_low), max(nexts[to, 1], new_r_high)
                    nexts[to, 2], nexts[to, 3] = min(nexts[to, 2], new_p_low), max(nexts[to, 3], new_p_high)
                else:
                    nexts[to, 0], nexts[to, 1] = new_r_low, new_r_high
                    nexts[to, 2], nexts[to, 3] = new_p_low, new_p_high
                    lives[to] = True
        boxes[:] = nexts
        alive[:] = lives


@numba.njit(cache=True)
def by_phases(ends, path, first, n, r, p, mode, most, start, sign, c):
    """Lower `path` to what whole phases allow, for thresholds up to `ends`; return whether it stays within them."""
    before, limits, slopes = first - 1, np.empty((2, 2)), np.zeros((2, 2))
    for j in range(2):
        a, b = sign[j] * start[j], sign[j] * ends[j]
        limits[j, 0], limits[j, 1] = min(a, b), max(a, b)
    lean = 0.55 / (1.0 - c[0])
    for way in (1.0, -1.0):
        if sign[0] != way and sign[1] != way:
            continue
        mean, extra = least_effort(r[before], p[before], mode[before], n - before, limits, way, way * lean, c)
        if extra == -np.inf:
            return False
        for j in range(2):
            if sign[j] == way:
                # (2.42): up by ½ c_b Σ (2 − f) at most, down by ½ c_b Σ f.
                slopes[j, 0] = 0.5 * c[10] * ((2.0 if way > 0 else 0.0) - mean)
                slopes[j, 1] = most[j, before] - 0.5 * c[10] * extra
    for j in range(2):
        far = max(slopes[j, 0] * (n - before), slopes[j, 0]) + slopes[j, 1]
        if min(far, path[j, n]) > ends[j]:
            return False
    for j in range(2):
        for k in range(first, n + 1):
            path[j, k] = min(path[j, k], slopes[j, 0] * (k - before) + slopes[j, 1])
    return True


@numba.njit(cache=True)
def remaining_cost(first, n, r, p, mode, most, start, low, high, goal, sign, c, standard, guess):
    """
    Bound the cost from step `first` to n from below: from boxes and, where that is long, from whole phases.

    Whole phases need limits of the thresholds. `guess` has how far both may move at most, from a plan: what follows from
    it is true if it stays within it, by induction over the steps. If it does not, the limits are those of the boxes.
    """
    path, before = np.empty((2, n + 1)), first - 1
    reachable(first, n, r, p, mode, most, start, low, high, goal, sign, c, standard, path)
    if standard and n - before > LONG:
        ends = np.minimum(guess, path[:, n])
        if not by_phases(ends, path, first, n, r, p, mode, most, start, sign, c):
            by_phases(path[:, n].copy(), path, first, n, r, p, mode, most, start, sign, c)
    cost = 0.0
    for k in range(first, n + 1):
        cost += (goal[0] - path[0, k]) ** 2 + (goal[1] - path[1, k]) ** 2
    return cost
