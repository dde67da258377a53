"""
The exact engine of the correction: branch and bound over the sequences of modes, (2.43)-(2.44).

Given the modes M(0..N−1), utilization and robot performance follow from (2.44) whatever the corrections are, and with
them the boxes (2.42). Each threshold is then a path with bounded steps between its value now and its target. Say that
it rises (a falling one is its mirror image). At step k, (2.8) looks at one threshold only: at TSC_u after the manual
mode, at TSC_l after the autonomous mode. So a sequence of modes is brought about exactly by paths that, at some
steps, stay at or below TSC(k) ("held") or get above it ("moved").

1. Paths with bounded steps under bounds x(k) ≤ h(k) are closed under the pointwise maximum. So one path is above all
   others at every step: tighten h backwards by the greatest step back, then go forward by the greatest step that h
   allows. It is nearest to the target at every step, so it minimizes every term of (2.43) at once; and if it does not
   meet the bounds from below, no path does. Without bounds h it is clipping: (target − threshold) cut to the box.
2. With modes up to k − 1 given, the values that a threshold can have at step k are an interval, which follows step by
   step. Where TSC(k) lies outside it, the mode is certain; where inside, there are two branches. Depth first, this
   visits every sequence of modes that the corrections can bring about, clipping first. If there is no second branch,
   the sequence of modes is the same for all admissible corrections, clipping is optimal and the gap is 0.
3. A branch is dropped when its bound is not below the best plan: its cost so far, paths from then on at the rate that
   an autonomous mode for ever (rising; a manual one at the operator's best, falling) would allow, since (2.42) falls
   in both utilization and performance, and both are least so.
4. Both thresholds at once: that TSC_l stays below TSC_u couples them only when both rise or both fall, and the pointwise
   maximum still exists: TSC_u does not look at TSC_l when both rise, TSC_l not at TSC_u when both fall.
5. Where a held threshold must stay strictly off TSC(k), the least cost is not attained: the plan stays off by a margin
   of 1e-9 c_b, between 1e-15 and 1e-12, and the lower bound is that without the margin.
6. If the budget of steps runs out, what is left is bounded by boxes: all that is reachable, in each mode, encloses r
   and P_r in one rectangle, cut by the thresholds' range at each switch; the rates in its best corner bound the cost.
   Over many switches these boxes grow wide; there whole phases bound how far thresholds can move (`correction_cycles`).
   Both let the thresholds that decide the modes lag behind those that are paid for: that is what is left of the gap.

The lower bound holds up to rounding, about 1e-12 of the cost.
"""

from __future__ import annotations

import types
from collections.abc import Callable

import numba
import numpy as np

from trustlab.allocation.correction_bounds import future_cost, remaining_cost
from trustlab.allocation.correction_dynamics import correction_constants, suggestion_now
from trustlab.allocation.correction_plan import CorrectionPlan, CorrectionStatus
from trustlab.allocation.incentive import box, incentive_box
from trustlab.allocation.phases import human_at
from trustlab.models.checks import whole_number
from trustlab.models.tsc import TscModel

__all__ = ["ExactEngine"]


@numba.njit(cache=True)
def pointwise_best(z, hold, low, high, goal, sign, margin, actions):
    """
    Fill z from z[0] with the path that is greatest at every step, given z(k) ≤ hold(k) and steps in [low, high].

    All is as seen rising: z = x where sign is 1, z = −x where it is −1. `hold` is tightened in place.
    """
    n = z.size - 1
    for k in range(n - 1, 0, -1):
        back = -low[k] if sign > 0 else high[k]
        if hold[k + 1] + back < hold[k]:
            hold[k] = hold[k + 1] + back
    cost = 0.0
    for k in range(n):
        back, forth = (-low[k], high[k]) if sign > 0 else (high[k], -low[k])
        limit = goal if hold[k + 1] >= goal else hold[k + 1] - margin
        step = limit - z[k]
        if step > forth:
            step = forth
        else:
            while z[k] + step > limit:
                step = np.nextafter(step, -np.inf)
            step = max(step, -back)
            if z[k] + step < z[0]:
                step = z[0] - z[k]
                while z[k] + step < z[0]:
                    step = np.nextafter(step, np.inf)
        z[k + 1] = z[k] + step
        actions[k] = sign * step
        cost += (goal - z[k + 1]) ** 2
    return cost


@numba.njit(cache=True)
def leaf(z, hold, tight, low, high, tsc, mode, goal, sign, margin, actions, strict):
    """Fill the best paths of both thresholds for one sequence of modes; return cost and whether (2.8) brings it about."""
    n = mode.size
    tight[:] = hold
    first = 0 if sign[0] < 0 else 1
    if sign[0] != sign[1]:
        first = 0
    second = 1 - first
    cost = pointwise_best(z[first], tight[first], low, high, goal[first], sign[first], margin, actions[first])
    if sign[0] == sign[1]:
        # Both rise: TSC_l stays below TSC_u. Both fall: TSC_u stays above TSC_l, which is the same mirrored.
        for k in range(1, n + 1):
            tight[second, k] = min(tight[second, k], z[first, k])
    cost += pointwise_best(
        z[second], tight[second], low, high, goal[second], sign[second], margin, actions[second]
    )
    if strict:
        for k in range(1, n):
            lower, upper = sign[0] * z[0, k], sign[1] * z[1, k]
            if lower >= upper:
                return cost, False
            if mode[k - 1] == 1.0:
                if (tsc[k] >= upper) != (mode[k] == 0.0):
                    return cost, False
            elif (tsc[k] <= lower) != (mode[k] == 1.0):
                return cost, False
        if sign[0] * z[0, n] >= sign[1] * z[1, n]:
            return cost, False
    return cost, True


@numba.njit(cache=True)
def search(c, start, goal_x, r0, p0, before, budget, standard, work, two, stack, best, actions):
    """
    Search the sequences of modes; fill `best` (r, P_r, TSC_l, TSC_u, M) and `actions`.

    Returns cost, lower bound, the number of sequences followed, whether the search was complete, TSC now, and whether
    the incentives stayed within [−c_b, 0] and [0, c_b].
    """
    n = work.shape[1] - 1
    r, p, low, high, tsc, mode, spent = work
    least, most, hold, z, tight, trial = two
    c_b, margin = c[10], min(max(1e-9 * c[10], 1e-15), 1e-12)
    sign, goal = np.empty(2), np.empty(2)
    for j in range(2):
        sign[j] = 1.0 if goal_x[j] >= start[j] else -1.0
        goal[j] = sign[j] * goal_x[j]
        least[j, 0] = most[j, 0] = z[j, 0] = sign[j] * start[j]
        hold[j, :] = goal[j]
    r[0], p[0], spent[0] = r0, p0, 0.0
    cost, bound, leaves, steps, height, k = np.inf, np.inf, 0, 0, 0, 0
    complete, held, fresh = True, False, True
    while True:
        while k <= n:
            if k > 0 and fresh:
                p_h = human_at(r[k - 1], c)
                r[k] = c[0] * r[k - 1] + (1.0 - c[0]) * mode[k - 1]
                p[k] = c[4] * p[k - 1] + (1.0 - c[4]) * c[6] + mode[k - 1] * c[5] * p_h
            if k > 0:
                spent[k] = spent[k - 1]
                for j in range(2):
                    rising = sign[j] > 0
                    forth = high[k - 1] if rising else -low[k - 1]
                    back = low[k - 1] if rising else -high[k - 1]
                    most[j, k] = min(most[j, k - 1] + forth, goal[j])
                    least[j, k] = max(least[j, k - 1] + back, least[j, 0])
            if k < n:
                if fresh:
                    tsc[k] = c[7] * p[k] - c[8] * human_at(r[k], c)
                    a, b = box(r[k], p[k], c_b, c[6], c[9])
                    slack = 1e-9 * c_b
                    if not (standard or (-c_b - slack <= a <= slack and -slack <= b <= c_b + slack)):
                        return np.inf, -np.inf, leaves, False, tsc[0], False
                    low[k], high[k] = min(a, 0.0), max(b, 0.0)
                if k == 0:
                    if tsc[0] >= start[1]:
                        mode[0] = 0.0
                    elif tsc[0] <= start[0]:
                        mode[0] = 1.0
                    else:
                        mode[0] = before
                else:
                    j = 1 if mode[k - 1] == 1.0 else 0
                    rising = sign[j] > 0
                    closed = (j == 1) == rising
                    theta = sign[j] * tsc[k]
                    if held:
                        mode[k] = 0.0 if rising else 1.0
                        hold[j, k] = theta
                        most[j, k] = min(most[j, k], theta)
                    else:
                        can_hold = least[j, k] <= theta if closed else least[j, k] < theta
                        can_move = most[j, k] > theta if closed else most[j, k] >= theta
                        hold[0, k], hold[1, k] = goal[0], goal[1]
                        if can_move:
                            mode[k] = 1.0 if rising else 0.0
                            if can_hold:
                                least[j, k] = max(least[j, k], theta)
                                stack[height] = k
                                height += 1
                        else:
                            mode[k] = 0.0 if rising else 1.0
            if k > 0:
                for j in range(2):
                    spent[k] += (goal[j] - most[j, k]) ** 2
            held, fresh = False, True
            steps += 1
            k += 1
        plain = True
        for j in range(2):
            for i in range(1, n):
                plain = plain and hold[j, i] == goal[j]
        leaves += 1
        steps += n // 2
        # Without the margin: the least cost, attained or not. With it: a plan that (2.8) is sure to bring about.
        now, meets = np.inf, True
        for attempt in range(1 if plain else 2):
            gap = margin if attempt == 1 else 0.0
            now, meets = leaf(z, hold, tight, low, high, tsc, mode[:n], goal, sign, gap, trial, attempt == 1)
            if not plain and attempt == 0:
                bound = min(bound, now)
        if meets and now < cost:
            cost = now
            best[0], best[1], best[4] = r, p, mode
            best[2], best[3] = sign[0] * z[0], sign[1] * z[1]
            actions[:] = trial[:, :n]
        # Back to the last step that could have gone the other way, unless it cannot be better.
        k = -1
        while height > 0:
            if steps > budget * n:
                complete = False
                break
            height -= 1
            i = stack[height]
            j = 1 if mode[i - 1] == 1.0 else 0
            other = 0.0 if sign[j] > 0 else 1.0
            at = np.empty(2)
            for s in range(2):
                rising = sign[s] > 0
                at[s] = min(most[s, i - 1] + (high[i - 1] if rising else -low[i - 1]), goal[s])
            at[j] = min(at[j], sign[j] * tsc[i])
            ahead = future_cost(
                i, n, r[i], p[i], low[i], high[i], other, at, goal, sign, c, standard, cost - spent[i - 1]
            )
            steps += 1 + (n - i) // 16
            if spent[i - 1] + ahead < cost:
                k, held, fresh = i, True, False
                break
        if k < 0:
            break
    if not complete:
        i = stack[0]
        guess = np.empty(2)
        for j in range(2):
            way = sign[j] * best[2 + j, n] - least[j, 0]
            guess[j] = min(least[j, 0] + 1.3 * way + 50.0 * c_b, goal[j])
        rest = remaining_cost(i, n, r, p, mode, most, least[:, 0], low, high, goal, sign, c, standard, guess)
        bound = min(bound, max(spent[i - 1] + rest, 0.0))
    return cost, min(bound, cost), leaves, complete, tsc[0], True


class ExactEngine:
    """
    Branch and bound over the sequences of modes; how, and why it is exact, is at the head of this module.

    Parameters
    ----------
    tsc : TscModel
        The model.
    target_lower, target_upper : float
        TSC_ld and TSC_ud.
    c_b : float
        Largest correction per step.
    horizon : int
        N, steps.
    incentive : callable
        The bounds of correction, `incentive_box` or a function like it that Numba can compile, with values in
        [−c_b, 0] and [0, c_b]. One of your own is compiled into the search here, which takes 5 to 20 s; over many switches its bound is one of boxes that widen to c_b, so gaps of long horizons are large.
    budget : int
        How many times N steps to search at most; more can close a gap, less limits the time.

    Raises
    ------
    ValueError
        If the budget is no whole number from 1 to a million, or an incentive of the user's is not as described.
    """

    name = "exact"

    def __init__(
        self,
        tsc: TscModel,
        target_lower: float,
        target_upper: float,
        c_b: float,
        horizon: int,
        incentive: Callable = incentive_box,
        budget: int = 25,
    ):
        self.horizon, self.budget = horizon, whole_number("budget", budget, most=1_000_000)
        self._constants = correction_constants(tsc, c_b)
        self._goal = np.array([target_lower, target_upper])
        self._start = np.empty(2)
        self._standard = incentive is incentive_box
        self._search = search if self._standard else _search_with(incentive, tsc, c_b)
        # Compiled now, by a plan of one step, so that the first plan of a run does not wait for it.
        self._room(1)
        self._searched(0.5, tsc.robot.p_min, target_lower, target_upper, 1)
        self._room(horizon)

    def _room(self, horizon: int) -> None:
        self._work, self._two = np.empty((7, horizon + 1)), np.empty((6, 2, horizon + 1))
        self._stack = np.empty(horizon + 1, np.int64)

    def _searched(self, r, p_r, lower, upper, mode):
        """Return what `search` returns, and what it fills."""
        self._start[0], self._start[1] = lower, upper
        n = self._stack.size
        best, actions = np.empty((5, n)), np.empty((2, n - 1))
        found = self._search(
            self._constants,
            self._start,
            self._goal,
            r,
            p_r,
            float(mode),
            self.budget,
            self._standard,
            self._work,
            self._two,
            self._stack,
            best,
            actions,
        )
        return found, best, actions

    def solve(self, r: float, p_r: float, lower: float, upper: float, mode: int) -> CorrectionPlan:
        """
        Return the plan from this state.

        Parameters
        ----------
        r, p_r : float
            Utilization and robot performance now.
        lower, upper : float
            TSC_l and TSC_u now.
        mode : int
            Mode before now: 1 manual, 0 autonomous.

        Raises
        ------
        ValueError
            If the user's incentives leave [−c_b, 0] and [0, c_b].
        """
        found, best, actions = self._searched(r, p_r, lower, upper, mode)
        cost, bound, leaves, complete, tsc, valid = found
        if not valid:
            raise ValueError(
                "the incentive function left [−c_b, 0] and [0, c_b] or gave NaN at a predicted state; as in (2.41), it "
                "must bound corrections by c_b and let thresholds be held"
            )
        return CorrectionPlan(
            float(actions[0, 0]),
            float(actions[1, 0]),
            suggestion_now(tsc, lower, upper),
            tsc,
            actions[0],
            actions[1],
            best[0],
            best[1],
            best[2],
            best[3],
            best[4, :-1],
            cost,
            bound,
            CorrectionStatus.OPTIMAL if complete else CorrectionStatus.BOUNDED,
            "exact",
            message=f"{leaves} sequences of modes followed",
        )


def _search_with(incentive: Callable, tsc: TscModel, c_b: float) -> Callable:
    """Compile the search for a user's own incentives, once they have answered for one state as they should."""
    compiled = incentive if isinstance(incentive, numba.core.dispatcher.Dispatcher) else numba.njit(incentive)
    robot = tsc.robot
    try:
        answer = compiled(0.5, 0.5 * (robot.p_min + robot.p_max), c_b, robot.p_min, robot.p_max)
        low, high = map(float, answer)
    except (numba.core.errors.NumbaError, TypeError, ValueError) as error:
        raise ValueError(
            "incentive must take r, p_r, c_b, p_min, p_max, return the least and the greatest correction, and be code "
            f"that Numba compiles (arithmetic, if, min, max): {str(error).splitlines()[0]}"
        ) from None
    if not (-c_b * (1.0 + 1e-9) <= low <= 0.0 <= high <= c_b * (1.0 + 1e-9)):
        raise ValueError(
            f"incentive must return a least correction in [−c_b, 0] and a greatest in [0, c_b], got {low} and {high} at "
            f"r = 0.5 for c_b = {c_b}"
        )
    plain = search.py_func
    own = types.FunctionType(
        plain.__code__, plain.__globals__ | {"box": compiled}, "search_with_own_incentive"
    )
    return numba.njit(own)
