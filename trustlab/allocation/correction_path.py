"""
What an operator accepts, (2.41)-(2.42), and the path of thresholds under corrections, (2.44).
"""

from typing import Any

import numpy as np

from trustlab.models.checks import finite_numbers, of_class, positive
from trustlab.models.compiled import njit
from trustlab.models.tsc import TscModel, advance, human_at, threshold_mode, tsc_at

# Rows of arrays that hold both thresholds.
LOWER, UPPER = 0, 1

# Rows of a plan's path, and their names.
R, P_R, L, U, MODE, C_L, C_U = range(7)
COLUMNS = ("r", "p_r", "lower", "upper", "mode", "c_l", "c_u")

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
    bounds = incentive_box(load, performance, positive("c_b", c_b), robot.p_min, robot.p_max)
    # Thresholds may always be held; rounding must not exclude that.
    return np.minimum(bounds[0], 0.0), np.maximum(bounds[1], 0.0)


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
    if np.isnan(wish):
        return min(max(target - now, low), high)
    moved = now + min(max(wish, low), high)
    return min(max(moved, min(start, target)), max(start, target)) - now


@njit(inline="always")
def follow_with(incentive, certain, c, c_b, target, start, mode, given, path):
    """
    Follow (2.44) under the hard switch (2.8), with corrections as given where the boxes (2.42) and
    the intervals allow, and as fast as these allow where given is NaN.

    `path` has r, P_r, TSC_l and TSC_u in its first column, and the rest is filled: rows as named by
    COLUMNS, the last three without their last column. `start` are the thresholds of the first
    column, `given` has the shape (2, N). Returns the cost (2.43), NaN where incentives leave
    [−c_b, 0] and [0, c_b], and a bound that no admissible plan costs less than, of use where all
    corrections are NaN; where incentives are not `certain` to be (2.42), the bound takes c_b.
    """
    cost = 0.0
    bound = 0.0
    slack = 1e-9 * c_b
    same_modes = True  # whether all admissible plans have had the same modes so far
    # Of the states that other plans may be in, the least and the greatest load and performance.
    r_least, p_least = path[R, 0], path[P_R, 0]
    r_most, p_most = r_least, p_least
    farthest_l, farthest_u = start[LOWER], start[UPPER]
    for k in range(path.shape[1] - 1):
        r, p_r = path[R, k], path[P_R, k]
        lower, upper = path[L, k], path[U, k]
        p_h = human_at(r, c)
        tsc = tsc_at(p_r, p_h, c)
        same_state = same_modes
        if same_state:
            r_least, p_least = r, p_r
            r_most, p_most = r, p_r
            # Between switches (2.8) waits for one threshold alone, which other plans have between
            # its first value and this one.
            if k > 0 and mode == 1:
                same_modes = (tsc >= start[UPPER]) == (tsc >= upper)
            elif k > 0:
                same_modes = (tsc <= start[LOWER]) == (tsc <= lower)
        mode = threshold_mode(tsc, lower, upper, mode)
        low, high = incentive(r, p_r, c_b, c.p_r_min, c.p_r_max)
        if not (-c_b - slack <= low <= slack and -slack <= high <= c_b + slack):
            return np.nan, np.nan
        low, high = min(low, 0.0), max(high, 0.0)
        c_l = _allowed(given[LOWER, k], lower, start[LOWER], target[LOWER], low, high)
        c_u = _allowed(given[UPPER, k], upper, start[UPPER], target[UPPER], low, high)
        path[MODE, k] = mode
        path[C_L, k], path[C_U, k] = c_l, c_u
        path[L, k + 1], path[U, k + 1] = lower + c_l, upper + c_u
        path[R, k + 1], path[P_R, k + 1] = advance(r, p_r, p_h, float(mode), c)
        cost += (path[U, k + 1] - target[UPPER]) ** 2 + (path[L, k + 1] - target[LOWER]) ** 2
        up, down = high, low
        if not same_state:
            up, down = c_b, -c_b
            if certain:
                up = max(incentive(r_least, p_least, c_b, c.p_r_min, c.p_r_max)[1], 0.0)
                down = min(incentive(r_most, p_most, c_b, c.p_r_min, c.p_r_max)[0], 0.0)
        farthest_l += min(max(target[LOWER] - farthest_l, down), up)
        farthest_u += min(max(target[UPPER] - farthest_u, down), up)
        bound += (farthest_u - target[UPPER]) ** 2 + (farthest_l - target[LOWER]) ** 2
        # Performance falls farthest under P_h,min where that is negative, else without anybody.
        p_least = advance(0.0, p_least, min(c.p_h_min, 0.0), 1.0, c)[1]
        r_least = advance(r_least, 0.0, 0.0, 0.0, c)[0]
        r_most, p_most = advance(r_most, p_most, c.p_h_max, 1.0, c)
    return cost, min(bound, cost)


@njit
def follow(c, c_b, target, start, mode, given, path):
    """Follow (2.44) as `follow_with` does, with the incentives (2.42)."""
    return follow_with(box, True, c, c_b, target, start, mode, given, path)
