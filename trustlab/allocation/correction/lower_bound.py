"""
Lower bounds of the cost (2.43) from some step on, which no plan can beat: for the exact engine.
"""

from typing import NamedTuple

import numpy as np

from trustlab.allocation.correction.plan import LOWER, UPPER
from trustlab.models.compiled import njit
from trustlab.models.tsc import (
    TscConstants,
    advance,
    human_at,
    human_range,
    next_performance,
    next_utilization,
)

# A rectangle of states.
BOX = np.dtype([("r_low", float), ("r_high", float), ("p_low", float), ("p_high", float)])


class BoundProblem(NamedTuple):
    """What stays the same throughout a search; thresholds are seen as rising, × `sign`."""

    c: TscConstants
    c_b: float
    standard: bool  # whether the incentives are (2.42)
    sign: np.ndarray  # 1 for a threshold that rises to its target, −1 for one that falls
    start: np.ndarray
    goal: np.ndarray


@njit
def future_cost(problem, first, n, r, p, low, high, mode, at, enough):
    """
    Bound the cost from step `first` to n from below.

    The thresholds are at most `at` at step `first` (seen as rising).

    r, P_r and the box [low, high] are those of step `first`, where the mode is `mode`. Stops as
    soon as the bound reaches `enough`.
    """
    # A threshold can rise by ½ c_b (2 − r − share) and fall by ½ c_b (r + share), share being that
    # of P_r in its range. So it rises fastest where r and P_r are least, as in the autonomous mode
    # for ever, and falls fastest where they are greatest, as in the manual mode with the operator
    # at their best. Other incentives than (2.42) are bounded by c_b alone.
    c, c_b, standard, sign, _, goal = problem
    span = c.p_r_max - c.p_r_min
    cost = (goal[LOWER] - at[LOWER]) ** 2 + (goal[UPPER] - at[UPPER]) ** 2
    r, p = advance(r, p, human_at(r, c), mode, c)
    r_least = r
    r_most = r
    p_least = p
    p_most = p
    # The P_h that adds least and most to P_r. It adds nothing in the autonomous mode, so that 0
    # bounds both unless P_h changes sign.
    worst = min(c.p_h_min, 0.0)
    finest = max(c.p_h_max, 0.0)
    z_lower = at[LOWER]
    z_upper = at[UPPER]
    up = high
    down = -low
    for _ in range(first + 1, n + 1):
        z_lower = min(z_lower + (up if sign[LOWER] > 0 else down), goal[LOWER])
        z_upper = min(z_upper + (up if sign[UPPER] > 0 else down), goal[UPPER])
        cost += (goal[LOWER] - z_lower) ** 2 + (goal[UPPER] - z_upper) ** 2
        if cost >= enough:
            return cost
        if standard:
            up = max(0.5 * c_b * (2.0 - r_least - (p_least - c.p_r_min) / span), 0.0)
            down = max(0.5 * c_b * (r_most + (p_most - c.p_r_min) / span), 0.0)
            r_least = next_utilization(r_least, 0.0, c.a_r)
            r_most = next_utilization(r_most, 1.0, c.a_r)
            p_least = next_performance(p_least, worst, 1.0, c.a_pr, c.b_pr, c.p_r_min)
            p_most = next_performance(p_most, finest, 1.0, c.a_pr, c.b_pr, c.p_r_min)
        else:
            up, down = c_b, c_b
    return cost


@njit
def reachable(problem, first, steps, most, path):
    """
    Fill `path` with how far thresholds can have moved from step `first` to n, in any mode.

    Boxes enclose r and P_r.

    There is one box for each mode of the step before. At each step (2.8) splits a box into the part
    that stays in its mode and the part that switches, for thresholds anywhere between their start
    and the farthest they can have moved; parts with the same mode are enclosed in one box.
    """
    c, c_b, standard, sign, start, goal = problem
    r, p, _, low, high, _, mode, _ = steps
    n = r.size - 1
    span = c.p_r_max - c.p_r_min
    near = np.empty(2)
    for j in (LOWER, UPPER):
        near[j] = most[j, first - 1]
    up = high[first - 1]
    down = -low[first - 1]
    boxes, nexts = np.empty(2, BOX), np.empty(2, BOX)  # by mode, as are those alive
    alive = np.zeros(2, np.bool_)
    lives = np.zeros(2, np.bool_)
    m = int(mode[first - 1])
    alive[m] = True
    boxes[m].r_low = boxes[m].r_high = r[first]
    boxes[m].p_low = boxes[m].p_high = p[first]
    for k in range(first, n + 1):
        for j in (LOWER, UPPER):
            near[j] = min(near[j] + (up if sign[j] > 0 else down), goal[j])
            path[j, k] = near[j]
        if k == n:
            break
        lives[:] = False
        up, down = 0.0, 0.0
        for m in range(2):
            if not alive[m]:
                continue
            b = boxes[m]
            h_low, h_high = human_range(b.r_low, b.r_high, c)
            if standard:
                up = max(up, 0.5 * c_b * (2.0 - b.r_low - (b.p_low - c.p_r_min) / span))
                down = max(down, 0.5 * c_b * (b.r_high + (b.p_high - c.p_r_min) / span))
            else:
                up, down = c_b, c_b
            # The threshold that decides, TSC_l in the autonomous mode and TSC_u in the manual one,
            # lies between these.
            x_low = sign[m] * start[m]
            x_high = sign[m] * near[m]
            if x_low > x_high:
                x_low, x_high = x_high, x_low
            for to in range(2):
                p_low = b.p_low
                p_high = b.p_high
                # The autonomous mode requires TSC above TSC_l, or at least TSC_u; the manual mode
                # the converse.
                if to == 0:
                    p_low = max(p_low, (x_low + c.b_T * h_low) / c.a_T)
                else:
                    p_high = min(p_high, (x_high + c.b_T * h_high) / c.a_T)
                if p_low > p_high + 1e-12:
                    continue
                r_low = next_utilization(b.r_low, to, c.a_r)
                r_high = next_utilization(b.r_high, to, c.a_r)
                p_low = next_performance(p_low, h_low, to, c.a_pr, c.b_pr, c.p_r_min)
                p_high = next_performance(p_high, h_high, to, c.a_pr, c.b_pr, c.p_r_min)
                after = nexts[to]
                if lives[to]:
                    r_low = min(after.r_low, r_low)
                    r_high = max(after.r_high, r_high)
                    p_low = min(after.p_low, p_low)
                    p_high = max(after.p_high, p_high)
                after.r_low = r_low
                after.r_high = r_high
                after.p_low = p_low
                after.p_high = p_high
                lives[to] = True
        boxes, nexts = nexts, boxes
        alive, lives = lives, alive
