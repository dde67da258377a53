"""How much correction an operator can be expected to accept, (2.41)-(2.42)."""

import numpy as np

from trustlab.models.checks import between, finite_number, positive, warn
from trustlab.models.compiled import njit
from trustlab.models.published import published_models
from trustlab.models.tsc import RobotModel, TscModel

# By how much, as a share of its range, robot performance may lie outside and still count as the end
# of the range.
ROUNDING = 1e-9


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
    r: float | np.ndarray,
    p_r: float | np.ndarray,
    c_b: float,
    model: TscModel | RobotModel | None = None,
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
    model : TscModel or RobotModel, optional
        The model that gives the range of robot performance. Without one the printed range of the
        pilot operator of Section 2.5 is used, P_r from 0.24 to 0.39 m/s, and a warning says so.

    Returns
    -------
    c_min, c_max : float or numpy.ndarray
        In [−c_b, 0] and [0, c_b].

    Raises
    ------
    ValueError
        If r lies outside [0, 1], P_r outside its range by more than rounding, or c_b is not
        positive.

    Warns
    -----
    UserWarning
        If no model is given.

    Examples
    --------
    >>> import trustlab as tl
    >>> model = tl.published_models()["2"]
    >>> least, most = tl.incentive_bounds(r=0.7, p_r=0.30, c_b=1e-5, model=model)
    >>> least < 0.0 < most
    True
    """
    if model is None:
        model = published_models()["pilot"]
        warn(
            "incentive_bounds takes the pilot operator's range of robot performance, "
            f"{model.robot.p_min} to {model.robot.p_max} m/s, as no model= was given; pass the "
            "TscModel of your operator and robot"
        )
    robot = model.robot if isinstance(model, TscModel) else model
    if not isinstance(robot, RobotModel):
        raise ValueError(f"model must be a TscModel or a RobotModel, got {type(model).__name__}")
    c_b = positive("c_b", c_b)
    if not np.ndim(r) and not np.ndim(p_r):
        r = between("r", r, 0.0, 1.0)
        p_r = within_range("p_r", finite_number("p_r", p_r), robot.p_min, robot.p_max)
    try:
        load, performance = np.broadcast_arrays(
            np.asarray(r, dtype=float), np.asarray(p_r, dtype=float)
        )
    except (TypeError, ValueError) as error:
        raise ValueError(f"r and p_r must be numbers of shapes that broadcast: {error}") from None
    if load.size == 0:
        raise ValueError("r and p_r are empty; give at least one sample")
    slack = ROUNDING * (robot.p_max - robot.p_min)
    for name, values, least, most in (
        ("r", load, 0.0, 1.0),
        ("p_r", performance, robot.p_min - slack, robot.p_max + slack),
    ):
        inside = (values >= least) & (values <= most)
        if not inside.all():
            where = tuple(map(int, np.unravel_index(int(np.argmin(inside)), inside.shape)))
            raise ValueError(
                f"{name} must lie in [{least:g}, {most:g}], but sample {where} is {values[where]}"
            )
    performance = np.clip(performance, robot.p_min, robot.p_max)
    low, high = incentive_box(load, performance, c_b, robot.p_min, robot.p_max)
    # Thresholds may always be held; rounding must not exclude that.
    low = np.minimum(low, 0.0)
    high = np.maximum(high, 0.0)
    return (low, high) if np.ndim(low) else (float(low), float(high))


def within_range(name: str, value: float, least: float, most: float) -> float:
    """
    Return a value within its range; where it lies outside by rounding only, the end of the range.
    """
    number = value if type(value) is float else finite_number(name, value)
    if least <= number <= most:
        return number
    slack = ROUNDING * (most - least)
    if not least - slack <= number <= most + slack:
        raise ValueError(
            f"{name} = {number} lies outside the model's range [{least:g}, {most:g}]; check its "
            "unit, or identify the model anew from this operator's sessions"
        )
    return min(max(number, least), most)
