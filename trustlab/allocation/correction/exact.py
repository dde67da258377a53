"""
The exact engine of the correction: branch and bound over the mode sequences, (2.43)-(2.44).

Each threshold is kept between its value now and its target. (2.42)-(2.44) do not ask for this:
without it a plan can be cheaper, by moving a threshold away from its target first so that a switch
comes at a better time. Optimum and lower bound are those of the problem with this constraint;
`ThresholdCorrector` has an example.

Given the modes M(0..N−1), utilization and robot performance follow from (2.44) whatever the
corrections are, and so do the boxes (2.42). Each threshold is then a path with bounded steps
between its value now and its target. Let it rise; a falling one is the mirror image. At step k,
(2.8) compares TSC with one threshold only: with TSC_u after the manual mode, with TSC_l after the
autonomous mode. Hence a mode sequence is produced by exactly those paths that stay at or below
TSC(k) at some steps ("held") and are above it at others ("moved").

1. Paths with bounded steps under bounds x(k) ≤ h(k) are closed under the pointwise maximum. So one
   path is above all others at every step: tighten h backwards by the greatest step back, then go
   forward by the greatest step that h allows. It is nearest to the target at every step, so that it
   minimizes every term of (2.43) at once; and if it violates a bound from below, so does every
   path. Without bounds h it is clipping: (target − threshold) clipped to the box.
2. With modes up to k − 1 given, the values that a threshold can have at step k form an interval,
   computed step by step. Where TSC(k) lies outside it, the mode is certain; where inside, there are
   two branches. Depth first, the search visits every mode sequence that the corrections can
   produce, clipping first. If there is no second branch, all admissible corrections have the same
   mode sequence, clipping is optimal and the gap is 0.
3. A branch is pruned when its bound is not below the cost of the best plan. The bound is the cost
   so far and that of paths which from then on move at the rate that the autonomous mode for ever
   would allow (rising), or the manual mode at the operator's best (falling): the bounds (2.42) fall
   in utilization and performance, which are extreme there.
4. That TSC_l stays below TSC_u couples the thresholds only when both rise or both fall, and the
   pointwise maximum still exists: TSC_u is not limited by TSC_l when both rise, nor TSC_l by TSC_u
   when both fall.
5. Where a held threshold must stay strictly away from TSC(k), the minimum is not attained: the plan
   keeps a margin of 1e-9 c_b, between 1e-15 and 1e-12, and the lower bound is the cost without the
   margin.
6. If the budget of steps runs out, the rest is bounded by boxes: one rectangle per mode encloses
   all reachable r and P_r, cut by the thresholds' range at each switch; the rates in its best
   corner bound the cost. The bound is valid for any horizon, but the boxes grow wide over many
   switches: beyond some 1,000 steps the gap says little about how good the plan is.

The lower bound holds up to rounding, about 1e-12 of the cost.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numba
import numpy as np

from trustlab.allocation.correction.dynamics import suggestion_now
from trustlab.allocation.correction.incentive import box, incentive_box
from trustlab.allocation.correction.lower_bound import BoundProblem, future_cost, reachable
from trustlab.allocation.correction.plan import LOWER, UPPER, CorrectionPlan, CorrectionStatus
from trustlab.models.checks import whole_number
from trustlab.models.compiled import njit
from trustlab.models.tsc import TscConstants, TscModel, advance, human_at, tsc_at

# How many times N steps are searched at most, by default.
SEARCHED = 25


class Workspace(NamedTuple):
    """Arrays for the search, and the best plan found; `search` names their rows."""

    steps: np.ndarray  # shape (8, N + 1)
    thresholds: np.ndarray  # shape (6, 2, N + 1)
    waiting: np.ndarray  # steps that could have gone the other way, the last on top
    states: np.ndarray  # r, P_r, TSC_l, TSC_u and mode at steps 0 … N (no mode at N)
    actions: np.ndarray  # c_l and c_u at steps 0 … N − 1

    @classmethod
    def of(cls, horizon: int) -> Workspace:
        """Return arrays for N steps."""
        n = horizon + 1
        return cls(
            steps=np.empty((8, n)),
            thresholds=np.empty((6, 2, n)),
            waiting=np.empty(n, np.int64),
            states=np.empty((5, n)),
            actions=np.empty((2, horizon)),
        )


@njit
def pointwise_best(z, hold, low, high, goal, sign, margin, actions):
    """
    Fill z with the path that is greatest at every step, from z[0]; return its cost.

    Paths keep z(k) ≤ hold(k) and have steps in [low, high].

    The threshold is seen as rising. `hold` is tightened in place.
    """
    n = z.size - 1
    # Backwards: to be at or below hold(k + 1), a path may exceed it at k by one step back at most.
    for k in range(n - 1, 0, -1):
        back = -low[k] if sign > 0 else high[k]
        if hold[k + 1] + back < hold[k]:
            hold[k] = hold[k + 1] + back
    cost = 0.0
    now = z[0]
    for k in range(n):
        back, forth = (-low[k], high[k]) if sign > 0 else (high[k], -low[k])
        limit = goal if hold[k + 1] >= goal else hold[k + 1] - margin
        step = limit - now
        if step > forth:
            step = forth
        else:
            # The sum may round to just above the limit, where (2.8) would decide otherwise.
            while now + step > limit:
                step = np.nextafter(step, -np.inf)
            step = max(step, -back)
            # Nor may a threshold leave the interval between its start and its target.
            if now + step < z[0]:
                step = z[0] - now
                while now + step < z[0]:
                    step = np.nextafter(step, np.inf)
        now += step
        z[k + 1] = now
        actions[k] = sign * step
        cost += (goal - now) ** 2
    return cost


@njit
def best_paths(z, hold, tight, low, high, tsc, mode, goal, sign, margin, actions, strict):
    """Fill both best paths for one mode sequence; return cost and whether it results."""
    n = z.shape[1] - 1
    # Copied one by one, here and below: assigning arrays takes seconds to compile.
    for j in (LOWER, UPPER):
        for k in range(n + 1):
            tight[j, k] = hold[j, k]
    # Where both rise, TSC_u comes first and limits TSC_l; where both fall, TSC_l limits TSC_u.
    first = LOWER if sign[LOWER] < 0 or sign[LOWER] != sign[UPPER] else UPPER
    second = 1 - first
    cost = pointwise_best(
        z[first], tight[first], low, high, goal[first], sign[first], margin, actions[first]
    )
    if sign[LOWER] == sign[UPPER]:
        for k in range(1, n + 1):
            tight[second, k] = min(tight[second, k], z[first, k])
    cost += pointwise_best(
        z[second], tight[second], low, high, goal[second], sign[second], margin, actions[second]
    )
    if not strict:
        return cost, True
    for k in range(1, n + 1):
        lower = sign[LOWER] * z[LOWER, k]
        upper = sign[UPPER] * z[UPPER, k]
        if lower >= upper:
            return cost, False
        if k == n:
            break
        if mode[k - 1] == 1.0:
            if (tsc[k] >= upper) != (mode[k] == 0.0):
                return cost, False
        elif (tsc[k] <= lower) != (mode[k] == 1.0):
            return cost, False
    return cost, True


@njit(_nrt=True)  # it allocates, also where its caller counts no references
def search(
    constants,
    c_b,
    target,
    budget,
    start,
    r0,
    p0,
    before,
    standard,
    steps,
    thresholds,
    waiting,
    states,
    plan,
):
    """
    Search the mode sequences as `search_within` the incentives (2.42) does.

    The arrays of `Workspace` are passed one by one and the constants as a plain tuple, because
    passing NamedTuples from Python takes longer than many a search.
    """
    problem = problem_of(constants, c_b, target, start, standard)
    room = Workspace(steps, thresholds, waiting, states, plan)
    return search_within(box, problem, budget, r0, p0, before, room)


@njit
def problem_of(constants, c_b, target, start, standard):
    """Return thresholds and targets as those of a problem in which both thresholds rise."""
    sign = np.empty(2)
    goal = np.empty(2)
    for j in (LOWER, UPPER):
        sign[j] = 1.0 if target[j] >= start[j] else -1.0
        goal[j] = sign[j] * target[j]
    return BoundProblem(TscConstants(*constants), c_b, standard, sign, start, goal)


# Inlined: numba caches no function that hands another one over.
@njit(inline="always")
def search_within(incentive, problem, budget, r0, p0, before, room):
    """
    Search the mode sequences and fill the room's states and actions.

    The search begins at r0, p0, the thresholds `start` and the mode before.

    `incentive` is compiled and bounds the corrections; `budget` is how many times N steps may be
    searched. Returns the cost, a lower bound of the cost of what was searched (for the rest see
    `unsearched_cost`), the number of mode sequences followed, whether the search was complete, TSC
    now, and whether incentives stayed within [−c_b, 0] and [0, c_b].
    """
    c, c_b, standard, sign, start, goal = problem
    steps, thresholds, waiting, states, plan = room
    # At each step: state, P_h, box (2.42), TSC and mode of the sequence that is followed, and the
    # least cost so far.
    r, p, p_h, low, high, tsc, mode, spent = steps
    # Both thresholds, seen as rising: the least and the greatest value with the modes so far; the
    # bound that each must not exceed to produce them, and the same tightened; and the best path,
    # with its actions.
    least, most, hold, tight, z, trial = thresholds
    best_r, best_p, best_lower, best_upper, best_mode = states
    n = r.size - 1
    margin = min(max(1e-9 * c_b, 1e-15), 1e-12)
    at = np.empty(2)
    for j in (LOWER, UPPER):
        least[j, 0] = most[j, 0] = z[j, 0] = sign[j] * start[j]
        hold[j, :] = goal[j]
    r[0] = r0
    p[0] = p0
    spent[0] = 0.0
    cost = np.inf
    bound = np.inf
    sequences = 0
    searched = 0
    height = 0
    k = 0
    complete = True
    holds = False
    fresh = True
    while True:
        # Forward from step k to the end: where both modes are possible, the threshold moves and the
        # other mode waits. After backtracking (not fresh) the state at k is known, and the
        # threshold is held there instead.
        while k <= n:
            if k > 0 and fresh:
                r[k], p[k] = advance(r[k - 1], p[k - 1], p_h[k - 1], mode[k - 1], c)
            if k > 0:
                for j in (LOWER, UPPER):
                    rising = sign[j] > 0
                    forth = high[k - 1] if rising else -low[k - 1]
                    back = low[k - 1] if rising else -high[k - 1]
                    most[j, k] = min(most[j, k - 1] + forth, goal[j])
                    least[j, k] = max(least[j, k - 1] + back, least[j, 0])
            if k < n:
                if fresh:
                    p_h[k] = human_at(r[k], c)
                    tsc[k] = tsc_at(p[k], p_h[k], c)
                    a, b = incentive(r[k], p[k], c_b, c.p_r_min, c.p_r_max)
                    slack = 1e-9 * c_b
                    if not (
                        standard or (-c_b - slack <= a <= slack and -slack <= b <= c_b + slack)
                    ):
                        return np.inf, -np.inf, sequences, False, tsc[0], False
                    low[k] = min(a, 0.0)
                    high[k] = max(b, 0.0)
                if k == 0:
                    if tsc[0] >= start[UPPER]:
                        mode[0] = 0.0
                    elif tsc[0] <= start[LOWER]:
                        mode[0] = 1.0
                    else:
                        mode[0] = before
                else:
                    # (2.8) compares TSC(k) with threshold j; θ is TSC(k) seen as rising. A rising
                    # TSC_u has moved when it is above θ (manual stays), a rising TSC_l when it is
                    # at or above θ (manual begins); falling, the converse.
                    j = UPPER if mode[k - 1] == 1.0 else LOWER
                    rising = sign[j] > 0
                    closed = (j == UPPER) == rising
                    theta = sign[j] * tsc[k]
                    if holds:
                        mode[k] = 0.0 if rising else 1.0
                        hold[j, k] = theta
                        most[j, k] = min(most[j, k], theta)
                    else:
                        can_hold = least[j, k] <= theta if closed else least[j, k] < theta
                        can_move = most[j, k] > theta if closed else most[j, k] >= theta
                        hold[LOWER, k] = goal[LOWER]
                        hold[UPPER, k] = goal[UPPER]
                        if can_move:
                            mode[k] = 1.0 if rising else 0.0
                            if can_hold:
                                least[j, k] = max(least[j, k], theta)
                                waiting[height] = k
                                height += 1
                        else:
                            mode[k] = 0.0 if rising else 1.0
            if k > 0:
                total = spent[k - 1]
                for j in (LOWER, UPPER):
                    total += (goal[j] - most[j, k]) ** 2
                spent[k] = total
            holds, fresh = False, True
            searched += 1
            k += 1
        plain = True
        for j in (LOWER, UPPER):
            for i in range(1, n):
                plain = plain and hold[j, i] == goal[j]
        sequences += 1
        searched += n // 2
        # Without the margin: the least cost, attained or not. With it: a plan whose modes (2.8)
        # certainly produces.
        now = np.inf
        meets = True
        for attempt in range(1 if plain else 2):
            gap = margin if attempt == 1 else 0.0
            now, meets = best_paths(
                z, hold, tight, low, high, tsc, mode, goal, sign, gap, trial, attempt == 1
            )
            if not plain and attempt == 0:
                bound = min(bound, now)
        if meets and now < cost:
            cost = now
            for i in range(n + 1):
                best_r[i] = r[i]
                best_p[i] = p[i]
                best_mode[i] = mode[i]
                best_lower[i] = sign[LOWER] * z[LOWER, i]
                best_upper[i] = sign[UPPER] * z[UPPER, i]
            for j in (LOWER, UPPER):
                for i in range(n):
                    plan[j, i] = trial[j, i]
        # Back to the last step with an untried mode whose bound is below the best cost.
        k = -1
        while height > 0:
            if searched > budget * n:
                complete = False
                break
            height -= 1
            i = waiting[height]
            j = UPPER if mode[i - 1] == 1.0 else LOWER
            untried = 0.0 if sign[j] > 0 else 1.0
            for s in (LOWER, UPPER):
                at[s] = min(most[s, i - 1] + (high[i - 1] if sign[s] > 0 else -low[i - 1]), goal[s])
            at[j] = min(at[j], sign[j] * tsc[i])
            enough = cost - spent[i - 1]
            ahead = future_cost(problem, i, n, r[i], p[i], low[i], high[i], untried, at, enough)
            searched += 1 + (n - i) // 16
            if ahead < enough:
                k = i
                holds = True
                fresh = False
                break
        if k < 0:
            break
    return cost, min(bound, cost), sequences, complete, tsc[0], True


@njit
def unsearched_cost(constants, c_b, target, start, standard, steps, thresholds, waiting):
    """Bound from below the cost (2.43) of what a search within its budget did not get to."""
    problem = problem_of(constants, c_b, target, start, standard)
    # The first step with an untried mode: up to it all sequences agree; everything after it is
    # bounded as a whole.
    first = waiting[0]
    n = steps.shape[1] - 1
    path = np.empty((2, n + 1))
    reachable(problem, first, steps, thresholds[1], path)
    rest = 0.0
    for k in range(first, n + 1):
        for_lower = (problem.goal[LOWER] - path[LOWER, k]) ** 2
        rest += for_lower + (problem.goal[UPPER] - path[UPPER, k]) ** 2
    return max(steps[7, first - 1] + rest, 0.0)


class ExactEngine:
    """
    Branch and bound over the mode sequences; the module's head says why it is exact.

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
        The bounds of the corrections: `incentive_box`, or a function like it that Numba can
        compile, with values in [−c_b, 0] and [0, c_b]. Your own is compiled into the search, which
        takes some seconds; its lower bounds over many switches assume corrections of c_b, so that
        gaps are large for long horizons.
    budget : int
        How many times N steps to search at most; more can close a gap, fewer limit the time.

    Raises
    ------
    ValueError
        If the budget is not a whole number from 1 to a million, or the incentive function is not as
        described.
    """

    name = "exact"
    options = ("budget",)

    def __init__(
        self,
        tsc,
        target_lower,
        target_upper,
        c_b,
        horizon,
        incentive=incentive_box,
        budget=SEARCHED,
    ):
        self.horizon = horizon
        self.budget = whole_number("budget", budget, most=1_000_000)
        self._problem = tuple(tsc.constants()), float(c_b), np.array([target_lower, target_upper])
        self._start = np.empty(2)
        self._standard = incentive is incentive_box
        self._search = search if self._standard else _search_with(incentive, tsc, c_b)
        room = Workspace.of(horizon)
        # One step, after which nothing is left, compiles what a plan can need, so that no plan of a
        # run waits for it.
        self._room = Workspace.of(1)
        self._room.waiting[0] = 1
        self._searched(0.5, tsc.robot.p_min, target_lower, target_upper, 1)
        self._unsearched()
        self._room = room

    def reset(self) -> None:
        """Forget nothing: no plan depends on an earlier one."""

    def _searched(self, r, p_r, lower, upper, mode):
        """Return cost, lower bound, number of sequences, status and TSC; `_room` has the plan."""
        # Written for speed: a plan takes about as long as passing its arguments.
        self._start[LOWER], self._start[UPPER] = lower, upper
        steps, thresholds, waiting, states, actions = self._room
        now = self._start, r, p_r, float(mode), self._standard
        cost, bound, sequences, complete, tsc, valid = self._search(
            *self._problem, self.budget, *now, steps, thresholds, waiting, states, actions
        )
        if not valid:
            raise ValueError(
                "the incentive function left [−c_b, 0] and [0, c_b] or returned NaN at a "
                "predicted state; as in (2.41), it must bound corrections by c_b and allow "
                "thresholds to be held"
            )
        if complete:
            return cost, bound, sequences, CorrectionStatus.OPTIMAL, tsc
        return cost, min(bound, self._unsearched()), sequences, CorrectionStatus.BOUNDED, tsc

    def _unsearched(self):
        steps, thresholds, waiting, _, _ = self._room
        return unsearched_cost(
            *self._problem, self._start, self._standard, steps, thresholds, waiting
        )

    def decide(self, *state):
        """Return c_l, c_u, cost, lower bound and status of the plan of `solve`, but no plan."""
        cost, bound, _, status, _ = self._searched(*state)
        return *self._room.actions[:, 0].tolist(), cost, bound, status

    def solve(self, r: float, p_r: float, lower: float, upper: float, mode: int) -> CorrectionPlan:
        """Return the plan from this state, `mode` being that before now."""
        cost, bound, sequences, status, tsc = self._searched(r, p_r, lower, upper, mode)
        actions_l, actions_u = self._room.actions.copy()
        path_r, path_p, path_lower, path_upper, modes = self._room.states.copy()
        return CorrectionPlan(
            c_l=float(actions_l[0]),
            c_u=float(actions_u[0]),
            suggestion=suggestion_now(tsc, lower, upper),
            tsc=tsc,
            actions_l=actions_l,
            actions_u=actions_u,
            r=path_r,
            p_r=path_p,
            lower=path_lower,
            upper=path_upper,
            mode=modes[:-1],
            cost=cost,
            cost_lower_bound=bound,
            status=status,
            engine=self.name,
            message=f"{sequences} mode sequences followed",
        )


def _search_with(incentive: Callable, tsc: TscModel, c_b: float) -> Callable:
    """Compile the search for a user's own incentives, after checking their values at one state."""
    robot = tsc.robot
    try:
        compiled = (
            incentive
            if isinstance(incentive, numba.core.dispatcher.Dispatcher)
            else numba.njit(incentive)
        )
        answer = compiled(0.5, 0.5 * (robot.p_min + robot.p_max), c_b, robot.p_min, robot.p_max)
        low, high = map(float, answer)
    except (numba.core.errors.NumbaError, TypeError, ValueError) as error:
        raise ValueError(
            "incentive must be a function of r, p_r, c_b, p_min, p_max that Numba compiles "
            "(arithmetic, if, min, max) and that returns the least and the greatest correction: "
            f"{str(error).splitlines()[0]}"
        ) from None
    if not (-c_b * (1.0 + 1e-9) <= low <= 0.0 <= high <= c_b * (1.0 + 1e-9)):
        raise ValueError(
            "incentive must return a least correction in [−c_b, 0] and a greatest in [0, c_b], "
            f"got {low} and {high} at r = 0.5 for c_b = {c_b}"
        )

    @numba.njit
    def search_with_incentive(
        constants, c_b, target, budget, start, r0, p0, before, standard, *room
    ):
        problem = problem_of(constants, c_b, target, start, standard)
        return search_within(compiled, problem, budget, r0, p0, before, Workspace(*room))

    return search_with_incentive
