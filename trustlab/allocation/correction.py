"""
Correcting an operator's thresholds step by step, Section 2.5: the clipped plan and its certificate.

Let each threshold stay between its value now and its target, a condition beyond (2.42)-(2.44).
Given the modes M(0..N−1), utilization and robot performance follow from (2.44) whatever the
corrections are, and so do the boxes (2.42). Going to the target as fast as the boxes allow then
puts both thresholds nearest to it at every step, and so minimizes every term of (2.43) at once. At
step k any admissible threshold lies between its first value and that of this clipped plan; where
TSC(k) does not lie between the two, rule (2.8) gives the same mode for all plans. If it never does,
all plans have the same modes and clipping is optimal. From the first step at which it does, the
bound of the cost takes the widest boxes that any modes can lead to: those of the autonomous mode
for ever for a threshold that rises, those of the manual mode at the operator's best for one that
falls.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache, partial
from math import isnan
from typing import Any

import numpy as np
import pandas as pd

from trustlab.allocation.limits import threshold_limits, threshold_pair
from trustlab.allocation.steady import limit_cycle
from trustlab.models.checks import (
    finite_number,
    finite_numbers,
    function,
    of_class,
    one_of,
    positive,
    warn,
    whole_number,
)
from trustlab.models.compiled import njit
from trustlab.models.simulation import compiled_for
from trustlab.models.tsc import (
    TscConstants,
    TscModel,
    advance,
    human_at,
    threshold_mode,
    tsc_at,
)

# Rows of arrays that hold both thresholds.
LOWER, UPPER = 0, 1

# Rows of a plan's path, and their names.
R, P_R, L, U, MODE, C_L, C_U = range(7)
COLUMNS = ("r", "p_r", "lower", "upper", "mode", "c_l", "c_u")
SIDES = (LOWER, L, C_L), (UPPER, U, C_U)

# By how much, as a share of its range, robot performance may lie outside and still count as the end
# of the range.
ROUNDING = 1e-9


# --- how much correction is acceptable, (2.41)-(2.42) ---------------------------------------------


def incentive_box(r, p_r, c_b, p_min, p_max):
    """
    Return the bounds c_min ≤ 0 ≤ c_max of (2.42), for numbers or CasADi symbols: arithmetic only.

    Parameters
    ----------
    r, p_r : float
        Utilization and robot performance.
    c_b : float
        Largest correction per step.
    p_min, p_max : float
        Range of robot performance.
    """
    share = (p_r - p_min) / (p_max - p_min)
    return -0.5 * (r + share) * c_b, 0.5 * ((1.0 - r) + (1.0 - share)) * c_b


box = njit(incentive_box)


def incentive_bounds(
    r: float | np.ndarray, p_r: float | np.ndarray, c_b: float, model: TscModel
) -> tuple[float | np.ndarray, float | np.ndarray]:
    """
    Return the least and the greatest correction that an operator can be expected to accept, (2.42).

    c_max = ½[(1 − r) + (P_max − P_r)/(P_max − P_min)] c_b and c_min = −½[r + (P_r − P_min)/(P_max −
    P_min)] c_b: the busier the operator and the better the robot, the less willing the operator is
    to raise the thresholds. The two are always c_b apart.

    Parameters
    ----------
    r : float or array_like
        Utilization, in [0, 1].
    p_r : float or array_like
        Robot performance, within its range up to rounding; of a shape that broadcasts with `r`.
    c_b : float
        Largest correction per step; positive.
    model : TscModel
        The model that gives the range of robot performance.

    Returns
    -------
    c_min, c_max : float or numpy.ndarray
        In [−c_b, 0] and [0, c_b].

    Raises
    ------
    ValueError
        If r lies outside [0, 1] or P_r outside its range by more than rounding, or c_b is not
        positive.

    Examples
    --------
    >>> import trustlab as tl
    >>> model = tl.published_models()["2"]
    >>> least, most = tl.incentive_bounds(r=0.7, p_r=0.30, c_b=1.0, model=model)
    >>> round(float(least), 3), round(float(most), 3)
    (-0.623, 0.377)
    """
    robot = of_class("model", model, TscModel).robot
    load = within_range("r", r, 0.0, 1.0)
    performance = within_range("p_r", p_r, robot.p_min, robot.p_max)
    return incentive_box(load, performance, positive("c_b", c_b), robot.p_min, robot.p_max)


def within_range(name: str, values: Any, least: float, most: float) -> Any:
    """
    Return numbers within their range; where they lie outside by rounding only, the end of the
    range.
    """
    if type(values) is float and least <= values <= most:  # as at nearly every step
        return values
    numbers = finite_numbers(name, values)
    slack = ROUNDING * (most - least)
    outside = (numbers < least - slack) | (numbers > most + slack)
    if outside.any():
        raise ValueError(
            f"{name} = {numbers[outside][0]} lies outside the model's range [{least:g}, {most:g}]; "
            "check its unit, or identify the model anew from this operator's sessions"
        )
    return np.clip(numbers, least, most)[()]


# --- the path -------------------------------------------------------------------------------------


@njit
def _allowed(wish, now, start, target, low, high):
    """Return a correction within its box that keeps a threshold between start and target."""
    wish = target - now if np.isnan(wish) else wish
    least, most = min(start, target) - now, max(start, target) - now
    return min(max(wish, low, least), high, most)


@njit
def sound(low, high, c_b):
    """Return whether a correction's bounds lie in [−c_b, 0] and [0, c_b], but for rounding."""
    slack = 1e-9 * c_b
    return -c_b - slack <= low <= slack and -slack <= high <= c_b + slack


@njit(inline="always")
def follow_with(incentive, certain, c, c_b, target, start, mode, given, path):
    """
    Follow (2.44) under the hard switch (2.8), with corrections as given where the boxes (2.42) and
    the intervals allow, and as fast as these allow where given is NaN.

    `path` has r, P_r, TSC_l and TSC_u in its first column, and the rest is filled: rows as named by
    COLUMNS, the last three without their last column. `start` are the thresholds of the first
    column, `given` has the shape (2, N). Returns the cost (2.43), NaN where incentives are not
    sound, and a bound that no admissible plan costs less than, of use where all corrections are
    NaN; where incentives are not `certain` to be (2.42), the bound takes c_b.
    """
    cost = 0.0
    bound = 0.0
    alike = True  # whether all admissible plans have had the same modes so far
    nearest = start.copy()
    # Of the states that other plans may be in, the least and the greatest load and performance.
    least = most = path[R, 0], path[P_R, 0]
    for k in range(path.shape[1] - 1):
        r, p_r = path[R, k], path[P_R, k]
        lower, upper = path[L, k], path[U, k]
        p_h = human_at(r, c)
        tsc = tsc_at(p_r, p_h, c)
        low, high = incentive(r, p_r, c_b, c.p_r_min, c.p_r_max)
        if not sound(low, high, c_b):
            return np.nan, np.nan
        low, high = min(low, 0.0), max(high, 0.0)
        down, up = low, high
        if alike:
            least = most = r, p_r
        elif certain:
            up = max(incentive(least[0], least[1], c_b, c.p_r_min, c.p_r_max)[1], 0.0)
            down = min(incentive(most[0], most[1], c_b, c.p_r_min, c.p_r_max)[0], 0.0)
        else:
            down, up = -c_b, c_b
        # Between switches (2.8) waits for one threshold alone, which other plans have between its
        # first value and this one.
        if alike and k > 0 and mode == 1:
            alike = (tsc >= start[UPPER]) == (tsc >= upper)
        elif alike and k > 0:
            alike = (tsc <= start[LOWER]) == (tsc <= lower)
        mode = threshold_mode(tsc, lower, upper, mode)
        for side, row, change in SIDES:
            goal = target[side]
            step = _allowed(given[side, k], path[row, k], start[side], goal, low, high)
            path[change, k] = step
            path[row, k + 1] = path[row, k] + step
            cost += (path[row, k + 1] - goal) ** 2
            nearest[side] += min(max(goal - nearest[side], down), up)
            bound += (nearest[side] - goal) ** 2
        path[MODE, k] = mode
        path[R, k + 1], path[P_R, k + 1] = advance(r, p_r, p_h, float(mode), c)
        # Performance falls farthest under P_h,min where that is negative, else without anybody.
        rested, _ = advance(least[0], 0.0, 0.0, 0.0, c)
        least = rested, advance(0.0, least[1], min(c.p_h_min, 0.0), 1.0, c)[1]
        most = advance(most[0], most[1], c.p_h_max, 1.0, c)
    return cost, min(bound, cost)


@njit
def follow(c, c_b, target, start, mode, given, path):
    """Follow (2.44) as `follow_with` does, with the incentives (2.42)."""
    return follow_with(box, True, c, c_b, target, start, mode, given, path)


@cache
def compiled_follow() -> Callable:
    """Return `follow` as compiled, which numba would look for by the types of all arguments."""
    pair, plans, path = np.zeros(2), np.zeros((2, 1)), np.zeros((7, 2))
    return compiled_for(follow, TscConstants(*[0.5] * 10), 0.5, pair, pair, 1, plans, path)


# --- plans ----------------------------------------------------------------------------------------


class TargetWarning(UserWarning):
    """Target thresholds lie outside the limits of Theorem 1, yet simulations keep switching."""


@dataclass(frozen=True, eq=False, slots=True)
class CorrectionPlan:
    """
    Corrections of both thresholds over the horizon, and their effect under the hard switch (2.8).

    Parameters
    ----------
    c_l, c_u : float
        The action now: added to TSC_l and TSC_u, (2.40).
    suggestion : int
        What Algorithm 3 suggests now: 0 autonomous, 1 manual, −1 nothing.
    tsc : float
        TSC now (2.1).
    cost : float
        The cost (2.43), and what the user's own cost adds to it.
    cost_lower_bound : float
        No admissible actions that keep each threshold between its value now and its target cost
        less than this; NaN with costs of one's own. (2.42)-(2.44) do not ask for that, and without
        it a plan can cost less: see `ThresholdCorrector`.
    status : {"planned", "held"}
        Whether there is a plan; where not, the thresholds are held: the actions are 0.
    message : str
        How good the plan is, or why the thresholds are held.
    path : numpy.ndarray, shape (7, N + 1)
        The whole plan, or where thresholds are held what is now; `table` names its rows.
    """

    c_l: float
    c_u: float
    suggestion: int
    tsc: float
    cost: float
    cost_lower_bound: float
    status: str
    message: str
    path: np.ndarray = field(repr=False)

    @property
    def gap(self) -> float:
        """Cost − cost_lower_bound: by how much a plan in the same intervals can be cheaper."""
        return self.cost - self.cost_lower_bound

    @property
    def relative_gap(self) -> float:
        """The gap as a share of the cost; 0 where the cost is 0."""
        return self.gap / self.cost if self.cost > 0.0 else 0.0 * self.gap  # NaN stays NaN

    def table(self) -> pd.DataFrame:
        """
        Return the plan, step by step.

        Returns
        -------
        pandas.DataFrame
            Index `step` (0..N); columns r, p_r, lower, upper, mode, c_l, c_u, the last three NaN at
            step N.
        """
        return pd.DataFrame(self.path.T, columns=list(COLUMNS)).rename_axis("step")


OPTIMAL = "Optimal among plans that keep each threshold between its value now and its target."
BOUNDED = (
    "TSC comes between a threshold and its first value, so that another plan may have other modes; "
    "the gap bounds how much cheaper it can be."
)
UNSOUND = (
    "The thresholds are held, as the incentive leaves [−c_b, 0] and [0, c_b] at a state that the "
    "plan comes to."
)


class ThresholdCorrector:
    """
    Model predictive control of both thresholds, (2.40)-(2.44).

    At each step the corrections of the next N steps are chosen that minimize Σ (TSC_u − TSC_ud)² +
    (TSC_l − TSC_ld)², within what the operator can be expected to accept (2.42), the thresholds
    staying between where they are and their targets; the first correction is applied.

    Parameters
    ----------
    tsc : TscModel
        The operator's and the robot's model; one step is the model's sample time.
    target : (float, float)
        TSC_ld and TSC_ud.
    c_b : float
        Largest correction per step (2.42); positive.
    horizon : int
        N, how many steps to look ahead; from 1 to a million.
    incentive : callable, optional
        The bounds of correction in place of (2.42): takes r, p_r, c_b, p_min, p_max and returns the
        least and the greatest correction, in [−c_b, 0] and [0, c_b]. `incentive_box` when not
        given.
    engine : {None, "casadi"}
        None plans by clipping, with a proved lower bound of the cost; "casadi" solves a nonlinear
        program, for costs of your own.
    extra_cost : callable, optional
        With CasADi: extra_cost(x, u, k), a scalar added to (2.43) for k = 0 … N − 1, with x = [r,
        P_r, TSC_u, TSC_l] and u = [c_u, c_l] of step k as CasADi symbols; in the unit of (2.43),
        TSC². The solver takes r and P_r from the clipped plan, so that they are weights of what the
        thresholds and their corrections cost; what they cost themselves decides only between the
        solver's plan and the clipped one, though a plan with other modes may cost less.
    limit : float, optional
        With CasADi: seconds that a step may compute, 1 when not given; if it takes longer, the
        thresholds are held. What is followed outside of the solver is not interrupted: with an
        incentive of your own some 30 µs for each step of the horizon.

    Raises
    ------
    ValueError
        If an argument is out of range, or does nothing, or the rule does not keep switching under
        the target.

    Warns
    -----
    TargetWarning
        If the target lies outside the limits of Theorem 1 at the model's own δ_Ph, but its steady
        cycle exists from every start: the theorem is sufficient, not necessary, and the thresholds
        that Section 2.5 prints for the pilot operator are such a case.

    Notes
    -----
    That a threshold stays between its value now and its target is a condition beyond (2.42)-(2.44).
    It keeps corrections from moving an operator's thresholds the wrong way. Without it a plan can
    cost less: a threshold that first moves away from its target can bring on a switch which widens
    the bounds (2.42) of all later corrections. For the pilot operator at r = 0.97 and P_r = 0.389
    in the manual mode, thresholds 0.2149 and 0.645, target (0.29, 0.72), c_b = 0.01 and N = 100,
    the optimum with the condition costs 0.8477, while lowering TSC_u for two steps first costs
    0.5998 in all.

    Examples
    --------
    >>> import trustlab as tl
    >>> model = tl.published_models()["2"]
    >>> corrector = tl.ThresholdCorrector(model, target=(0.05, 0.4), horizon=200)
    >>> step = corrector.step(r=0.7, p_r=0.33, lower=0.0, upper=0.35, mode=1)
    >>> round(step.c_l * 1e6, 3), step.suggestion, step.gap
    (2.409, -1, 0.0)
    """

    how_to_get = "trustlab.ThresholdCorrector(tsc, target) makes one"

    def __init__(
        self,
        tsc: TscModel,
        target: tuple[float, float],
        c_b: float = 1e-5,
        horizon: int = 200,
        incentive: Callable = incentive_box,
        engine: str | None = None,
        extra_cost: Callable | None = None,
        limit: float | None = None,
    ):
        self.tsc = of_class("tsc", tsc, TscModel)
        self.target = check_target(tsc, target)
        self.c_b = positive("c_b", c_b)
        self.horizon = whole_number("horizon", horizon, most=1_000_000)
        self._range = tsc.robot.p_min, tsc.robot.p_max
        self.incentive = function("incentive", incentive)
        for r in (0.1, 0.5, 0.9):
            try:
                bounds = incentive(r, 0.5 * sum(self._range), self.c_b, *self._range)
                low, high = map(float, bounds)
                if not sound.py_func(low, high, self.c_b):
                    raise ValueError(f"it returned {low:g} and {high:g}")
            except Exception as error:
                raise ValueError(
                    "incentive must be a function of r, p_r, c_b, p_min and p_max that returns the "
                    "least correction, in [−c_b, 0], and the greatest, in [0, c_b], but at r = "
                    f"{r}, c_b = {self.c_b:g}: {type(error).__name__}: {error}"
                ) from error
        self.program: Any = None
        if engine is not None:
            one_of("engine", engine, ("casadi",), "None")
            from trustlab.allocation.casadi_correction import CorrectionProgram

            self.program = CorrectionProgram(self, extra_cost, 1.0 if limit is None else limit)
        elif extra_cost is not None or limit is not None:
            raise ValueError('extra_cost and limit would do nothing without engine="casadi"')
        self._problem = tsc.constants(), self.c_b, np.array(self.target)
        self._clipped = np.full((2, self.horizon), np.nan)
        self._empty = np.full((7, self.horizon + 1), np.nan)
        compiled_follow()  # here, as no step of a loop should wait for it

    def step(
        self, r: float, p_r: float, lower: float, upper: float, mode: int = 1
    ) -> CorrectionPlan:
        """
        Return the correction now, with the whole plan behind it.

        Parameters
        ----------
        r : float
            Utilization now, in [0, 1].
        p_r : float
            Robot performance now, within the model's range up to rounding.
        lower, upper : float
            TSC_l and TSC_u now, lower < upper, in [−1, 1] as TSC is.
        mode : int
            Mode before now: 1 manual, 0 autonomous.

        Returns
        -------
        CorrectionPlan
            With .c_l, .c_u, .suggestion, .status, .cost, .cost_lower_bound, .gap and .table().

        Raises
        ------
        ValueError
            If an argument is not a number or out of range.
        """
        r = within_range("r", finite_number("r", r), 0.0, 1.0)
        p_r = within_range("p_r", finite_number("p_r", p_r), *self._range)
        lower, upper = threshold_pair("threshold", (lower, upper))
        mode = whole_number("mode", mode, least=0, most=1)
        state = np.array([r, p_r, lower, upper])
        cost, bound, path = self.followed(state, mode, self._clipped)
        message = OPTIMAL if cost == bound else BOUNDED
        if isnan(cost):
            message = UNSOUND
        elif self.program is not None:
            bound = np.nan
            cost, path, message = self.program.improved(state, mode, cost, path)
        held = isnan(cost)
        if held:  # nothing is predicted
            path[:, 1:] = np.nan
            path[[C_L, C_U], 0] = 0.0
        c = self._problem[0]
        tsc = tsc_at.py_func(p_r, human_at.py_func(r, c), c)
        return CorrectionPlan(
            float(path[C_L, 0]),
            float(path[C_U, 0]),
            suggestion_now(tsc, lower, upper),
            float(tsc),
            cost,
            bound,
            "held" if held else "planned",
            message,
            path,
        )

    def followed(
        self, state: np.ndarray, mode: int, given: np.ndarray
    ) -> tuple[float, float, np.ndarray]:
        """
        Return cost (2.43), its bound, and the path of corrections; the cost of unsound incentives
        is NaN.

        Parameters
        ----------
        state : numpy.ndarray, shape (4,)
            r, P_r, TSC_l and TSC_u now.
        mode : int
            Mode before now.
        given : numpy.ndarray, shape (2, N)
            Corrections c_l and c_u, contiguous; NaN for clipped ones.
        """
        path = self._empty.copy()
        path[:4, 0] = state
        run: Callable = partial(follow_with.py_func, self.incentive, False)
        if self.incentive is incentive_box:
            run = compiled_follow()
        return *run(*self._problem, state[2:], mode, given, path), path


def suggestion_now(tsc: float, lower: float, upper: float) -> int:
    """Return what Algorithm 3 suggests: 0 from TSC_u on, 1 up to TSC_l, else −1, nothing."""
    return threshold_mode.py_func(tsc, lower, upper, -1)


# --- checks ---------------------------------------------------------------------------------------


def check_target(tsc: TscModel, target: tuple[float, float]) -> tuple[float, float]:
    """Return target thresholds if the rule keeps switching under them; warn outside Theorem 1."""
    lower, upper = threshold_pair("target", target)
    limits = threshold_limits(tsc, None)
    if limits.contains(lower, upper):
        return lower, upper
    where = f"target ({lower:g}, {upper:g}) lies outside the limits of Theorem 1, {limits.message}"
    cycle = limit_cycle(tsc, lower, upper)
    if not cycle.always:
        raise ValueError(
            f"{where}, and the rule does not keep switching under it from every start: "
            f"{cycle.reason}. Choose a target with trustlab.limit_cycle(tsc, lower, upper).always, "
            "for example with trustlab.choose_thresholds(tsc)"
        )
    warn(
        f"{where}, so the theorem does not promise that the rule keeps switching; its steady "
        "cycle does exist, from every start (trustlab.limit_cycle)",
        TargetWarning,
    )
    return lower, upper
