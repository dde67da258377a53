"""
Robot and operator identified: `fit_tsc`, `fit_human`, `fit_robot`.

With mode M, 1 manual and 0 autonomous, of the trust-based shared control (TSC) of Section 2.2:

    P_r(k + 1) = a P_r(k) + b M P_h(k) + (1 − a) P_r,min                       (2.3)
    r(k + 1) = a r(k) + (1 − a) M                                               (2.5)
    P_h = P_h,min + (P_h,max − P_h,min) (r/β)^β ((1 − r)/(1 − β))^(1 − β)       (2.6)

HUMAN simulates the operator, ROBOT the robot under the measured P_h, and TSC both, one driving the
other; a grid of operators starts the searches of HUMAN and TSC. `fit_robot` is TSC under the
robot's own names, of which it keeps the robot's part.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pandas as pd

from trustlab.identification.fit import fit
from trustlab.identification.log import (
    NOT_WHITE,
    LogSettings,
    Run,
    block_means,
    joined,
    whiteness_p,
)
from trustlab.identification.model import COORDINATES, IdentificationError, Model
from trustlab.identification.problem import SHALLOW, Problem, distinct, search
from trustlab.identification.result import FitResult
from trustlab.models.checks import positive
from trustlab.models.compiled import njit
from trustlab.models.tsc import (
    HumanModel,
    RobotModel,
    TscModel,
    gain_of_human_performance,
    next_performance,
    next_utilization,
    yerkes_dodson,
)
from trustlab.sessions.session import Session

# --- the simulation -------------------------------------------------------------------------------


@njit
def _operate(mode, a, beta, p_min, p_max, r0, p_h):
    """Write P_h of L operators, shape (N, L)."""
    shapes = np.empty((2, mode.size))
    for lane in range(a.size):
        # Computing the shape is slow: lanes with the same a, β and r0 as the first reuse its shape.
        same = a[lane] == a[0] and beta[lane] == beta[0] and r0[lane] == r0[0]
        shape = shapes[0] if same else shapes[1]
        if lane == 0 or not same:
            r = r0[lane]
            for k in range(mode.size):
                shape[k] = yerkes_dodson(r, beta[lane])
                r = next_utilization(r, mode[k], a[lane])  # (2.5)
        span = p_max[lane] - p_min[lane]
        for k in range(mode.size):
            p_h[k, lane] = p_min[lane] + span * shape[k]  # (2.6)


@njit
def _follow(mode, p_h, a, p_min, b, p_r0, p_r):
    """Write P_r of L robots, shape (N, L), each driven by its column of `p_h`."""
    now = p_r0.copy()
    for k in range(mode.size):
        for lane in range(now.size):
            p_r[k, lane] = now[lane]
            now[lane] = next_performance(
                now[lane], p_h[k, lane], mode[k], a[lane], b[lane], p_min[lane]
            )  # (2.3)


def simulate_human(run: Run, a, beta, p_min, p_max, r0):
    """Return P_h of operators, shape (N, L)."""
    p_h = np.empty((run.size, a.size))
    _operate(run["mode"], a, beta, p_min, p_max, r0, p_h)
    return p_h


def simulate_robot(run: Run, a, p_min, p_max, p_h_max, p_r0, p_h=None):
    """Return P_r of robots, shape (N, L), under P_h: by default the measured one."""
    if p_h is None:
        p_h = np.tile(run["p_h"][:, None], a.size)
    p_r = np.empty((run.size, a.size))
    b = gain_of_human_performance(a, p_min, p_max, p_h_max)
    _follow(run["mode"], p_h, a, p_min, b, p_r0, p_r)
    return p_r


# --- one model of both ----------------------------------------------------------------------------


def _part(names: Mapping[str, str], values: Mapping[str, Any]) -> dict[str, Any]:
    """Return the values of one of two models by their names in that model alone."""
    return {own: values[joint] for own, joint in names.items() if joint in values}


def _joint(names: Mapping[str, str], values: Mapping[str, Any]) -> dict[str, Any]:
    """Return values of one of two models by their names in both."""
    return {joint: values[own] for own, joint in names.items() if own in values}


# What is wrong with data that fit better with the ends of the range the other way round.
CONTRADICTIONS = {
    HumanModel: "human performance is not greatest between rest and full load, as (2.6) has it,",
    RobotModel: "robot performance does not rise under manual control (is mode 1 there?), as (2.3) "
    "has it,",
}


def made(kind: type, names: Mapping[str, str], values: Mapping) -> Any:
    """Return an operator or a robot of estimates, or say what about the data contradicts it."""
    low, high = names["p_min"], names["p_max"]
    if not values[high] > values[low]:
        raise IdentificationError(
            f"{CONTRADICTIONS[kind]} in these data, or bounds rule it out: the fit has {high} = "
            f"{values[high]:.4g}, not above {low} = {values[low]:.4g}",
            (low, high),
        )
    return kind(**_part(names, values))


def build_tsc(**values: float) -> TscModel:
    """Return robot and operator."""
    operator, robot = made(HumanModel, OPERATOR, values), made(RobotModel, MACHINE, values)
    try:
        return TscModel(robot, operator)
    except ValueError as error:
        ranges = ("human_p_min", "human_p_max", "robot_p_min", "robot_p_max")
        raise IdentificationError(
            f"the fitted ranges of performance give no a_T and b_T of (2.2): {error}", ranges
        ) from error


def _check_robot(runs: list[Run], limits: Mapping) -> None:
    """Refuse data that say nothing of the robot, and a p_h_max that is not of these data."""
    (low, high), p_h = limits["p_h_max"], joined(runs, "p_h")
    if low == high and not np.median(p_h) <= low <= 1e3 * abs(p_h.max()):
        raise ValueError(
            f"p_h_max, the greatest human performance, is {low:g}, but the measured p_h is "
            f"{np.median(p_h):.4g} in the median and {p_h.max():.4g} at most; give it in this unit"
        )
    _check(ALONE, runs, limits)


def _check(names: Mapping[str, str], runs: list[Run], limits: Mapping) -> None:
    """Refuse data that say nothing of the robot."""
    of_robot, modes = _part(names, limits), joined(runs, "mode")
    fixed = {name for name, (low, high) in of_robot.items() if low == high}
    # A mode that never changes leaves one steady state: under manual control either limit fixes the
    # other, but an autonomous robot says nothing of p_max.
    enough = ["p_max"] if modes[0] == 0.0 else ["p_min", "p_max"]
    if np.ptp(modes) == 0.0 and not fixed.intersection(enough):
        lost = tuple(names[name] for name in enough)
        raise IdentificationError(
            f"these data do not determine {' and '.join(lost)}: mode never changes (it is "
            f"{modes[0]:g} throughout); log at least one switch between manual and autonomous "
            f"control, or fix a parameter, for example fixed={{{lost[0]!r}: ...}}",
            lost,
        )


# --- where the search starts ----------------------------------------------------------------------

# Utilizations at the start, and best utilizations, of the grid.
RESTS = np.array([0.03, 0.3, 0.6, 0.9, 0.999])
BETAS = np.linspace(0.15, 0.95, 7)

# Points of the grid from which a search on block means starts.
MOST_POINTS = 4


def _operators(means: list[Run], limits: Mapping, length: int) -> Iterator[dict[str, Any]]:
    """Yield the best operators of a grid, by thirds of the rates and r0, and their P_h by run."""
    # Shares kept over a block, for time constants from a few samples to many runs.
    longest = max(run.size for run in means) * length
    time_constants = np.geomspace(min(20.0, 0.2 * longest), 4.0 * longest, 14)
    rates = np.unique(np.clip(1.0 - 1.0 / time_constants, *limits["a"])) ** length
    r0s = np.unique(np.clip(RESTS, *limits["r0"]))
    betas = np.unique(np.clip(BETAS, *limits["beta"]))
    a, r0, beta = map(np.ravel, np.meshgrid(rates, r0s, betas, indexing="ij"))
    shapes = [simulate_human(run, a, beta, 0.0 * a, 1.0 + 0.0 * a, r0) for run in means]
    # P_h = p_min + (p_max − p_min) shape, (2.6): a line at every point of the grid.
    shape, p_h = np.concatenate(shapes), joined(means, "p_h")
    middle = shape.mean(axis=0)
    power = np.maximum(np.sum(shape**2, axis=0) - p_h.size * middle**2, 1e-12)
    span = (p_h - p_h.mean()) @ shape / power
    p_min = p_h.mean() - span * middle
    order = np.argsort(-np.where(span > 0.0, span**2 * power, 0.0), kind="stable")
    kinds = pd.DataFrame({"third": np.searchsorted(rates, a) * 3 // rates.size, "r0": r0})
    for k in kinds.loc[order].drop_duplicates().index[:MOST_POINTS]:
        # Each run begins where that suits this operator best.
        alike = np.flatnonzero((a == a[k]) & (beta == beta[k]))
        curves = [p_min[k] + span[k] * of_run[:, alike] for of_run in shapes]
        best = [
            np.sum((p_h.T - run["p_h"]) ** 2, axis=1).argmin()
            for p_h, run in zip(curves, means, strict=True)
        ]
        yield {
            "a": a[k],
            "beta": beta[k],
            "p_min": p_min[k],
            "p_max": p_min[k] + span[k],
            "r0": r0[alike[best]],
            "drives": [p_h[:, j] for p_h, j in zip(curves, best, strict=True)],
        }


def _robot(means: list[Run], limits: Mapping, p_h_max: float, drives: list) -> dict[str, Any]:
    """Return the robot that suits block means best under P_h, an array (blocks,) for each run."""
    # (2.3) is a regression of P_r on P_r, M P_h and 1, all a block before.
    before = [
        np.column_stack([run["p_r"], run["mode"] * p_h, np.ones(run.size)])[:-1]
        for run, p_h in zip(means, drives, strict=True)
    ]
    after = np.concatenate([run["p_r"][1:] for run in means])
    a, b, c = np.linalg.lstsq(np.concatenate(before), after)[0]
    a = float(np.clip(a, *limits["a"]))
    low = c / (1.0 - a)
    first = [run["p_r"][0] for run in means]
    high = low + b * p_h_max / (1.0 - a)
    return {"a": a, "p_min": low, "p_max": high, "p_r0": first, "p_h_max": p_h_max}


def _refined(model: Model, points_of: Callable, runs: list[Run], limits: Mapping) -> list[dict]:
    """Search from points on block means, and return the optima that are nearly as good."""
    means, length = block_means(runs)
    rates = [name for name in model.names if model.coordinates.get(name) == "rate"]
    edges = COORDINATES["rate"]

    def over(values: dict, samples: float) -> dict:
        """Return values with rates over so many samples in place of one."""
        powers = {n: np.clip(values[n] ** samples, edges.low, edges.high) for n in rates}
        return values | powers

    coarse = over({name: np.array(ends) for name, ends in limits.items()}, length)
    problem = Problem(model, means, coarse)
    at = [problem.full_vector(point) for point in points_of(means, limits, length)]
    optima = [search(problem, x, tolerance=1e-2, most=15) for x in at]
    return [over(optimum.values(), 1.0 / length) for optimum in distinct(optima, SHALLOW)]


def robot_starts(runs: list[Run], limits: Mapping) -> list[dict]:
    """Return the robot that suits block means best under the measured P_h."""
    means, length = block_means(runs)
    low, high = limits["p_h_max"]  # fixed, as P_r alone does not determine it
    p_h_max = low if low == high else joined(runs, "p_h").max()
    robot = _robot(means, limits, p_h_max, [run["p_h"] for run in means])
    return [robot | {"a": robot["a"] ** (1.0 / length)}]


# --- the models -----------------------------------------------------------------------------------

# Names in the joint model of the operator's and the robot's unknowns.
OPERATOR = {name: f"human_{name}" for name in ("a", "beta", "p_min", "p_max")} | {"r0": "r0"}
MACHINE = {name: f"robot_{name}" for name in ("a", "p_min", "p_max")}
MACHINE |= {"p_h_max": "human_p_max", "p_r0": "p_r0"}

# The robot's own names.
ALONE = {name: name for name in MACHINE}

COORDINATE = {"a": "rate", "beta": "odds", "r0": "load"}
HINTS = {
    "a": "record a rise or a decay long enough to show its curvature",
    "beta": "record phases that take utilization to both sides of the best one",
    "p_min": "record a phase long enough to settle at the least performance",
    "p_max": "record a phase long enough to come near the greatest performance",
}


def _half_ranges(*ranges: tuple[str, str]) -> Callable:
    """Return the function that says how wide half a useful interval of performances may be."""

    def size(values: Mapping[str, float]) -> dict[str, float]:
        # A limit counts as determined if its half-width is below half the range, and half the
        # greatest performance: a range whose one end is open is no measure of the other.
        return {
            name: 0.5 * min(abs(values[high] - values[low]), abs(values[high]))
            for low, high in ranges
            for name in (low, high)
        }

    return size


def joint_model(human: Mapping[str, str], robot: Mapping[str, str], names: Iterable[str]) -> Model:
    """Return the model of an operator who drives a robot; names are those of its parts in it."""

    def simulate(run: Run, **values):
        p_h = simulate_human(run, **_part(human, values))
        return p_h, simulate_robot(run, **_part(robot, values), p_h=p_h)

    def points(means, limits, length):
        """Yield operators, each with the robot that suits it."""
        for operator in _operators(means, _part(human, limits), length):
            machine = _robot(means, _part(robot, limits), operator["p_max"], operator["drives"])
            yield _joint(robot, machine) | _joint(human, operator)

    def gain(**values):
        return gain_of_human_performance(
            *(values[robot[n]] for n in ("a", "p_min", "p_max", "p_h_max"))
        )

    model = Model(
        tuple(names),
        ("r0", "p_r0"),
        ("p_h", "p_r"),
        size=_half_ranges((human["p_min"], human["p_max"]), (robot["p_min"], robot["p_max"])),
        simulate=simulate,
        lanes=True,
        coordinates=_joint(human, COORDINATE) | {robot["a"]: "rate"},
        derived={
            "human_b": lambda human_a, **_: 1.0 - human_a,
            f"{robot['a'][:-1]}b": gain,
        },
        hints=_joint(human, HINTS) | _joint(robot, HINTS),
        check=partial(_check, robot),
    )
    return replace(model, starts=partial(_refined, model, points))


HUMAN = Model(
    ("a", "beta", "p_min", "p_max"),
    ("r0",),
    ("p_h",),
    size=_half_ranges(("p_min", "p_max")),
    simulate=simulate_human,
    lanes=True,
    coordinates=COORDINATE,
    build=lambda **values: made(HumanModel, {name: name for name in values}, values),
    derived={"b": lambda a, **_: 1.0 - a},
    hints=HINTS,
)
HUMAN = replace(HUMAN, starts=partial(_refined, HUMAN, _operators))

ROBOT = Model(
    ("a", "p_min", "p_max", "p_h_max"),
    ("p_r0",),
    ("p_r",),
    size=_half_ranges(("p_min", "p_max")),
    simulate=simulate_robot,
    starts=robot_starts,
    inputs=("mode", "p_h"),
    lanes=True,
    coordinates={"a": "rate"},
    build=lambda **values: made(RobotModel, ALONE, values),
    derived={"b": gain_of_human_performance},
    hints=_joint(ALONE, HINTS),
    check=_check_robot,
)

TSC = replace(
    joint_model(OPERATOR, MACHINE, [*OPERATOR.values()][:4] + [*MACHINE.values()][:3]),
    build=build_tsc,
)


# --- fits -----------------------------------------------------------------------------------------


def fit_tsc(
    sessions: Session | Iterable[Session],
    fixed: Mapping[str, float] | None = None,
    bounds: Mapping[str, tuple] | None = None,
    noise: str = "auto",
    log: LogSettings | None = None,
    **settings: Any,
) -> FitResult:
    """
    Identify robot (2.3) and operator (2.5)-(2.6) together, by one likelihood.

    The fitted operator drives the robot.

    Parameters
    ----------
    sessions : Session or iterable of Session
        Runs with columns mode, p_h and p_r; parameters are shared, initial states are not.
    fixed : mapping, optional
        Values to hold, by name: human_a, human_beta, human_p_min, human_p_max, robot_a,
        robot_p_min, robot_p_max, r0, p_r0.
    bounds : mapping, optional
        Bounds (low, high) by name; None leaves a side open.
    noise : {"auto", "white", "correlated", "hac"}
        What the standard errors allow for; see `fit`.
    log : LogSettings, optional
        How the log shows the model: window, mode_delay, stamp_error, robust.
    **settings : float or bool
        Fields of `LogSettings` as keywords; they replace those of `log`.

    Returns
    -------
    FitResult
        With a TscModel; each output is weighted by the inverse of its own residual variance.

    Raises
    ------
    IdentificationError
        If the data do not determine a parameter, which is named, or the fitted ranges give no a_T
        and b_T of (2.2).
    SessionError
        If a column is missing.
    TypeError
        If a setting is not known.
    ValueError
        If an argument is not understood.

    Examples
    --------
    >>> import trustlab as tl
    >>> tsc = tl.fit_tsc(tl.read_session("data/sessions/pilot.csv")).model
    >>> round(tsc.robot.a, 3), round(tsc.human.beta, 2)
    (0.996, 0.74)
    """
    return fit(TSC, sessions, fixed, bounds, noise, log=log, **settings)


def fit_human(
    sessions: Session | Iterable[Session],
    fixed: Mapping[str, float] | None = None,
    bounds: Mapping[str, tuple] | None = None,
    noise: str = "auto",
    log: LogSettings | None = None,
    **settings: Any,
) -> FitResult:
    """
    Identify the operator (2.5)-(2.6): a, beta, p_min, p_max, and r0 of every session.

    Parameters
    ----------
    sessions : Session or iterable of Session
        Runs with columns mode and p_h; parameters are shared, initial utilizations are not.
    fixed : mapping, optional
        Values to hold, by name: a, beta, p_min, p_max, r0.
    bounds : mapping, optional
        Bounds (low, high) by name; None leaves a side open.
    noise : {"auto", "white", "correlated", "hac"}
        What the standard errors allow for; see `fit`.
    log : LogSettings, optional
        How the log shows the model: window, mode_delay, stamp_error, robust.
    **settings : float or bool
        Fields of `LogSettings` as keywords; they replace those of `log`.

    Returns
    -------
    FitResult
        With a HumanModel.

    Raises
    ------
    IdentificationError
        If the data do not determine a parameter; it is named.
    SessionError
        If a column is missing.
    TypeError
        If a setting is not known.
    ValueError
        If an argument is not understood.

    Examples
    --------
    >>> import trustlab as tl
    >>> fit = tl.fit_human(tl.read_session("data/sessions/pilot.csv"))
    >>> round(fit.model.beta, 2), fit.success
    (0.74, True)
    """
    return fit(HUMAN, sessions, fixed, bounds, noise, log=log, **settings)


def fit_robot(
    sessions: Session | Iterable[Session],
    p_h_max: float | None = None,
    fixed: Mapping[str, float] | None = None,
    bounds: Mapping[str, tuple] | None = None,
    noise: str = "auto",
    log: LogSettings | None = None,
    **settings: Any,
) -> FitResult:
    """
    Identify the robot (2.3): a, p_min, p_max, and P_r at the start of every session.

    This is `fit_tsc`, of which it reports the robot's part: the fitted operator drives the robot.

    Parameters
    ----------
    sessions : Session or iterable of Session
        Runs with columns mode, p_h and p_r; parameters are shared, initial performances are not.
    p_h_max : float, optional
        Greatest human performance, to which p_max refers in (2.3). By default it is identified from
        the same sessions.
    fixed : mapping, optional
        Values to hold, by name: a, p_min, p_max, p_r0; of the operator human_a, human_beta,
        human_p_min, r0.
    bounds : mapping, optional
        Bounds (low, high) by name; None leaves a side open.
    noise : {"auto", "white", "correlated", "hac"}
        What the standard errors allow for; see `fit`.
    log : LogSettings, optional
        How the log shows the model: window, mode_delay, stamp_error, robust.
    **settings : float or bool
        Fields of `LogSettings` as keywords; they replace those of `log`.

    Returns
    -------
    FitResult
        With a RobotModel.

    Raises
    ------
    IdentificationError
        If the data do not determine a parameter; it is named.
    SessionError
        If a column is missing.
    TypeError
        If a setting is not known.
    ValueError
        If an argument is not understood.

    Notes
    -----
    The dissertation's least squares on P_r(k + 1) = a P_r(k) + b M(k) P_h(k) + c is `arx`: quick,
    and biased when p_r is measured with noise. For an operator who does not follow (2.5)-(2.6),
    ``fit(trustlab.identification.ROBOT, sessions, fixed={"p_h_max": …})`` drives the robot with the
    measured P_h, whose noise it takes for P_h itself.

    Examples
    --------
    >>> import trustlab as tl
    >>> fit = tl.fit_robot(tl.read_session("data/sessions/pilot.csv"))
    >>> round(fit.model.a, 3), fit.success
    (0.996, True)
    """
    if p_h_max is not None:
        if fixed and "p_h_max" in fixed:
            raise ValueError("p_h_max is given twice: as itself and in fixed; give one of them")
        fixed = {**(fixed or {}), "p_h_max": positive("p_h_max", p_h_max)}
    try:
        joint = fit(OF_ROBOT, sessions, fixed, bounds, noise, log=log, **settings)
    except IdentificationError as error:
        if not any(name.startswith("human_") for name in error.parameters):
            raise
        raise IdentificationError(f"{error}; {DRIVEN}", error.parameters) from error
    message = joint.message
    if joint.noise != "white" and whiteness_p(joint.residuals("p_h")) < NOT_WHITE:
        message += f" The residuals of p_h are not white: {DRIVEN}."
    mine = [name for name in joint.parameters.index if not name.startswith("human_")]
    free = joint.covariance.index.intersection(mine)
    return replace(
        joint,
        parameters=joint.parameters.loc[mine],
        covariance=joint.covariance.loc[free, free],
        initial_states=joint.initial_states[["p_r0", "p_r0_stderr"]],
        sigma={"p_r": joint.sigma["p_r"]},
        cost=0.5 * float(sum(np.sum(run.errors["p_r"] ** 2) for run in joint.runs)),
        message=message,
    )


# What to do where (2.5)-(2.6) do not describe the operator.
DRIVEN = (
    "if the operator does not follow (2.5)-(2.6), fit the robot driven by the measured p_h: "
    "trustlab.fit(trustlab.identification.ROBOT, sessions, fixed={'p_h_max': …})"
)

# TSC under the robot's own names; the operator's estimates need not make a model.
OF_ROBOT = replace(
    joint_model(
        {**OPERATOR, "p_max": "p_h_max"},
        ALONE,
        ["a", "p_min", "p_max", "p_h_max", "human_a", "human_beta", "human_p_min"],
    ),
    build=lambda **values: made(RobotModel, ALONE, values),
    check=_check_robot,
)
