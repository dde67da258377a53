"""
Robot and operator identified: `fit_tsc`, `fit_human`, `fit_robot`.

With mode M, 1 manual and 0 autonomous, of the trust-based shared control (TSC) of Section 2.2:

    P_r(k + 1) = a P_r(k) + b M P_h(k) + (1 − a) P_r,min                       (2.3)
    r(k + 1) = a r(k) + (1 − a) M                                               (2.5)
    P_h = P_h,min + (P_h,max − P_h,min) (r/β)^β ((1 − r)/(1 − β))^(1 − β)       (2.6)

HUMAN simulates the operator, ROBOT the robot under the measured P_h, and TSC both, one driving the
other; a grid of operators starts the searches of HUMAN and TSC. `fit_robot` is TSC, of which it
keeps the robot's part.
"""

import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from trustlab.identification.fit import fit
from trustlab.identification.log import LogSettings, Run, block_means, joined
from trustlab.identification.model import COORDINATES, IdentificationError, Model
from trustlab.identification.problem import NOT_WHITE, Problem, whiteness_p
from trustlab.identification.result import FitResult
from trustlab.identification.search import SHALLOW, search
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
from trustlab.sessions.errors import SessionError
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
    p_h = run.scratch("p_h", a.size)
    _operate(run["mode"], a, beta, p_min, p_max, r0, p_h)
    return p_h


def simulate_robot(run: Run, a, p_min, p_max, p_h_max, p_r0, p_h=None):
    """Return P_r of robots, shape (N, L), under P_h: by default the measured one."""
    if p_h is None:
        p_h = run.scratch("measured p_h", a.size)
        p_h[:] = run["p_h"][:, None]
    p_r = run.scratch("p_r", a.size)
    b = gain_of_human_performance(a, p_min, p_max, p_h_max)
    _follow(run["mode"], p_h, a, p_min, b, p_r0, p_r)
    return p_r


def simulate_tsc(run: Run, r0, p_r0, **values):
    """Return P_h of operators and P_r of the robots that they drive, shape (N, L) each."""
    human, robot = _without("human_", values), _without("robot_", values)
    p_h = simulate_human(run, **human, r0=r0)
    return p_h, simulate_robot(run, **robot, p_h_max=human["p_max"], p_r0=p_r0, p_h=p_h)


# --- what the estimates make ----------------------------------------------------------------------


def _check_range(p_min: float, p_max: float, prefix: str, contradiction: str) -> None:
    """Say what about the data contradicts the model where the range of performance is empty."""
    low, high = f"{prefix}p_min", f"{prefix}p_max"
    if not p_max > p_min:
        raise IdentificationError(
            f"{contradiction} in these data: the fit has {high} = {p_max:.4g}, not above {low} = "
            f"{p_min:.4g}",
            (low, high),
        )


def build_human(a: float, beta: float, p_min: float, p_max: float, prefix: str = "") -> HumanModel:
    """Return the operator, or say what about the data contradicts (2.6)."""
    words = "human performance is not greatest between rest and full load, as (2.6) has it,"
    _check_range(p_min, p_max, prefix, words)
    return HumanModel(a, beta, p_min, p_max)


def build_robot(
    a: float, p_min: float, p_max: float, p_h_max: float, prefix: str = ""
) -> RobotModel:
    """Return the robot, or say what about the data contradicts (2.3)."""
    words = "robot performance does not rise under manual control, as (2.3) has it,"
    _check_range(p_min, p_max, prefix, words)
    return RobotModel(a, p_min, p_max, p_h_max)


def build_tsc(**values: float) -> TscModel:
    """Return robot and operator."""
    operator = build_human(**_without("human_", values), prefix="human_")
    robot = build_robot(**_without("robot_", values), p_h_max=operator.p_max, prefix="robot_")
    try:
        return TscModel(robot, operator)
    except ValueError as error:
        ranges = ("human_p_min", "human_p_max", "robot_p_min", "robot_p_max")
        raise IdentificationError(
            f"the fitted ranges of performance give no a_T and b_T of (2.2): {error}", ranges
        ) from error


def _without(prefix: str, values: Mapping[str, Any]) -> dict[str, Any]:
    """Return the values of one of the two models by their names in that model alone."""
    pairs = values.items()
    return {name.removeprefix(prefix): x for name, x in pairs if name.startswith(prefix)}


def _with(prefix: str, values: Mapping[str, Any]) -> dict[str, Any]:
    """Return values of one of the two models by their names in both."""
    return {f"{prefix}{name}": value for name, value in values.items()}


def check_order(limits: Mapping, prefix: str = "") -> tuple[str, str]:
    """Refuse limits by which the least performance is not below the greatest; name both."""
    low, high = f"{prefix}p_min", f"{prefix}p_max"
    least, most = limits[low][0], limits[high][1]
    if least >= most:
        raise ValueError(f"{low} is at least {least:g}, not below {high}, at most {most:g}")
    return low, high


def check_excitation(runs: list[Run], limits: Mapping, prefix: str = "") -> None:
    """Refuse data in which nothing separates the least from the greatest robot performance."""
    ranges = check_order(limits, prefix)
    modes = joined(runs, "mode")
    fixed = {name for name in ranges if limits[name][0] == limits[name][1]}
    # A mode that never changes leaves one steady state: under manual control either limit fixes the
    # other, but an autonomous robot says nothing of p_max.
    if np.ptp(modes) > 0.0 or (fixed and (modes[0] > 0.0 or ranges[1] in fixed)):
        return
    lost = ranges[1:] if modes[0] == 0.0 else ranges
    raise IdentificationError(
        f"these data do not determine {' and '.join(lost)}: mode never changes (it is "
        f"{modes[0]:g} throughout); log at least one switch between manual and autonomous "
        f"control, or fix a parameter, for example fixed={{{lost[0]!r}: ...}}",
        lost,
    )


def _check_tsc(runs: list[Run], limits: Mapping) -> None:
    """Refuse data that say nothing of the robot."""
    check_order(limits, "human_")
    check_excitation(runs, limits, "robot_")


def _check_robot(runs: list[Run], limits: Mapping) -> None:
    """Refuse data that say nothing of the robot, and a p_h_max that is not of these data."""
    _check_tsc(runs, limits)
    (low, high), p_h = limits["human_p_max"], joined(runs, "p_h")
    if low == high and not np.median(p_h) <= low <= 1e3 * abs(p_h.max()):
        raise ValueError(
            f"p_h_max, the greatest human performance, is {low:g}, but the measured p_h is "
            f"{np.median(p_h):.4g} in the median and {p_h.max():.4g} at most; give it in this unit"
        )


def _check_driven(runs: list[Run], limits: Mapping) -> None:
    """Refuse data that say nothing of the robot, and a p_h_max that is not fixed and positive."""
    check_excitation(runs, limits)
    if limits["p_h_max"][0] != limits["p_h_max"][1]:
        raise IdentificationError(
            "P_r alone does not determine p_h_max, the greatest human performance, to which p_max "
            "refers: give fixed={'p_h_max': …}",
            ("p_h_max",),
        )
    positive("p_h_max", limits["p_h_max"][0])


# --- where the search starts ----------------------------------------------------------------------

# Utilizations at the start, and best utilizations, of the grid.
RESTS = np.array([0.03, 0.3, 0.6, 0.9, 0.999])
BETAS = np.linspace(0.15, 0.95, 7)

# Points of the grid from which a search on block means starts.
MOST_POINTS = 4


def _rates(runs: list[Run], limits: tuple[float, float], length: int) -> np.ndarray:
    """Return shares kept over a block, for time constants from a few samples to many runs."""
    longest = max(run.size for run in runs) * length
    time_constants = np.geomspace(min(20.0, 0.2 * longest), 4.0 * longest, 14)
    return np.unique(np.clip(1.0 - 1.0 / time_constants, *limits)) ** length


def _operators(means: list[Run], limits: Mapping, length: int) -> list[dict[str, float]]:
    """Return the best operators of a grid, for each third of the rates and each r0."""
    rates = _rates(means, limits["a"], length)
    axes = np.meshgrid(
        rates,
        np.unique(np.clip(RESTS, *limits["r0"])),
        np.unique(np.clip(BETAS, *limits["beta"])),
        indexing="ij",
    )
    a, r0, beta = (axis.ravel() for axis in axes)
    shapes = [simulate_human(run, a, beta, 0.0 * a, 1.0 + 0.0 * a, r0) for run in means]
    # P_h = p_min + (p_max − p_min) shape, (2.6): a line at every point of the grid.
    shape, p_h = np.concatenate(shapes), joined(means, "p_h")
    middle = shape.mean(axis=0)
    power = np.maximum(np.sum(shape**2, axis=0) - p_h.size * middle**2, 1e-12)
    span = (p_h - p_h.mean()) @ shape / power
    p_min = p_h.mean() - span * middle
    explained = np.where(span > 0.0, span**2 * power, 0.0)
    order = np.argsort(-explained, kind="stable")
    thirds = np.searchsorted(rates, a[order]) * 3 // rates.size
    kinds = np.unique(np.column_stack([thirds, r0[order]]), axis=0, return_index=True)[1]
    columns = {"a": a, "beta": beta, "p_min": p_min, "p_max": p_min + span, "r0": r0}
    points = order[np.sort(kinds)[:MOST_POINTS]]
    return [{name: float(column[k]) for name, column in columns.items()} for k in points]


def _robot(
    means: list[Run], limits: Mapping, length: int, p_h_max: float, drives: list
) -> dict[str, Any]:
    """Return the robot that suits best under P_h, an array (blocks,) for each run."""
    from scipy import signal

    robots = []
    for a in _rates(means, limits["a"], length):
        parts = []
        for run, p_h in zip(means, drives, strict=True):
            # (2.3): P_r(k) = aᵏ P_r(0) + (1 − aᵏ − rise) P_min + rise P_max.
            kept = a ** np.arange(run.size)
            rise = signal.lfilter([0.0, 1.0 - a], [1.0, -a], run["mode"] * p_h / p_h_max)
            parts.append([1.0 - kept - rise, rise, run["p_r"] - kept * run["p_r"][0]])
        *design, target = np.hstack(parts)
        ranges = np.linalg.lstsq(np.transpose(design), target)[0]
        robots.append((np.sum((target - ranges @ design) ** 2), a, *ranges))
    _, a, p_min, p_max = min(robots)
    return {"a": a, "p_min": p_min, "p_max": p_max, "p_r0": [run["p_r"][0] for run in means]}


def _refined(
    model: Model, means: list[Run], points: list[dict], limits: Mapping, length: int
) -> list[dict]:
    """Search from points on block means, and return the optima that are nearly as good."""
    rates = [name for name in model.names if model.coordinates.get(name) == "rate"]
    edges = COORDINATES["rate"]

    def over(values: dict, samples: float) -> dict:
        """Return values with rates over so many samples in place of one."""
        powers = {name: values[name] ** samples for name in rates}
        return values | {n: np.clip(power, edges.low, edges.high) for n, power in powers.items()}

    coarse = over({name: np.array(ends) for name, ends in limits.items()}, length)
    problem = Problem(model, means, coarse)
    optima = [search(problem, problem.full_vector(p), tolerance=1e-2, most=15) for p in points]
    optima.sort(key=lambda optimum: optimum.deviance)
    return [
        over(optimum.values(), 1.0 / length)
        for k, optimum in enumerate(optima)
        if optimum.deviance < optima[0].deviance + SHALLOW
        and not any(optimum.same_as(other) for other in optima[:k])
    ]


def human_starts(runs: list[Run], limits: Mapping) -> list[dict]:
    """Return operators near the best optima of block means."""
    means, length = block_means(runs)
    return _refined(HUMAN, means, _operators(means, limits, length), limits, length)


def robot_starts(runs: list[Run], limits: Mapping) -> list[dict]:
    """Return the robot that suits block means best under the measured P_h."""
    means, length = block_means(runs)
    p_h_max = limits["p_h_max"][0]
    robot = _robot(means, limits, length, p_h_max, [run["p_h"] for run in means])
    return [robot | {"a": robot["a"] ** (1.0 / length), "p_h_max": p_h_max}]


def tsc_starts(runs: list[Run], limits: Mapping) -> list[dict]:
    """Return operators near the best optima of block means, each with the robot that suits it."""
    means, length = block_means(runs)
    of_human = _without("human_", limits) | {"r0": limits["r0"]}
    points = []
    for operator in _operators(means, of_human, length):
        values = {name: np.array([value]) for name, value in operator.items()}
        drives = [simulate_human(run, **values)[:, 0].copy() for run in means]
        robot = _robot(means, _without("robot_", limits), length, operator["p_max"], drives)
        start = {"r0": operator.pop("r0"), "p_r0": robot.pop("p_r0")}
        points.append(_with("human_", operator) | _with("robot_", robot) | start)
    return _refined(TSC, means, points, limits, length)


# --- the three models -----------------------------------------------------------------------------

HUMAN_NAMES = ("a", "beta", "p_min", "p_max")
ROBOT_NAMES = ("a", "p_min", "p_max")
COORDINATE = {"a": "rate", "beta": "odds"}
HINTS = {
    "a": "record a rise or a decay long enough to show its curvature",
    "beta": "record phases that take utilization to both sides of the best one",
    "p_min": "record a phase long enough to settle at the least performance",
    "p_max": "record a phase long enough to come near the greatest performance",
}


def _half_ranges(*prefixes: str) -> Callable:
    """Return the function that says how wide half a useful interval of performances may be."""

    def size(values: Mapping[str, float]) -> dict[str, float]:
        # A limit counts as determined if its half-width is below half the range.
        widths = {}
        for prefix in prefixes:
            low, high = f"{prefix}p_min", f"{prefix}p_max"
            widths[low] = widths[high] = 0.5 * abs(values[high] - values[low])
        return widths

    return size


HUMAN = Model(
    HUMAN_NAMES,
    ("r0",),
    ("p_h",),
    size=_half_ranges(""),
    simulate=simulate_human,
    starts=human_starts,
    lanes=True,
    coordinates=COORDINATE | {"r0": "load"},
    build=build_human,
    derived={"b": lambda a, **_: 1.0 - a},
    hints=HINTS,
    check=lambda runs, limits: check_order(limits),
)

ROBOT = Model(
    (*ROBOT_NAMES, "p_h_max"),
    ("p_r0",),
    ("p_r",),
    size=_half_ranges(""),
    simulate=simulate_robot,
    starts=robot_starts,
    inputs=("mode", "p_h"),
    lanes=True,
    coordinates={"a": "rate"},
    build=build_robot,
    derived={
        "b": lambda a, p_min, p_max, p_h_max, **_: gain_of_human_performance(
            a, p_min, p_max, p_h_max
        )
    },
    hints=HINTS,
    check=_check_driven,
)

TSC = Model(
    (*_with("human_", dict.fromkeys(HUMAN_NAMES)), *_with("robot_", dict.fromkeys(ROBOT_NAMES))),
    ("r0", "p_r0"),
    ("p_h", "p_r"),
    size=_half_ranges("human_", "robot_"),
    simulate=simulate_tsc,
    starts=tsc_starts,
    lanes=True,
    coordinates=_with("human_", COORDINATE) | {"robot_a": "rate", "r0": "load"},
    build=build_tsc,
    derived={
        "human_b": lambda human_a, **_: 1.0 - human_a,
        "robot_b": lambda robot_a, robot_p_min, robot_p_max, human_p_max, **_: (
            gain_of_human_performance(robot_a, robot_p_min, robot_p_max, human_p_max)
        ),
    },
    hints=_with("human_", HINTS) | _with("robot_", HINTS),
    check=_check_tsc,
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
        How the log shows the model: window, step, mode_delay, stamp_error, robust.
    **settings : float, bool or mapping
        Fields of `LogSettings` as keywords; they replace those of `log`. And `guess`, as of `fit`.

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
        How the log shows the model: window, step, mode_delay, stamp_error, robust.
    **settings : float, bool or mapping
        Fields of `LogSettings` as keywords; they replace those of `log`. And `guess`, as of `fit`.

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
        Values to hold, by name: a, p_min, p_max, p_r0.
    bounds : mapping, optional
        Bounds (low, high) by name; None leaves a side open.
    noise : {"auto", "white", "correlated", "hac"}
        What the standard errors allow for; see `fit`.
    log : LogSettings, optional
        How the log shows the model: window, step, mode_delay, stamp_error, robust.
    **settings : float, bool or mapping
        Fields of `LogSettings` as keywords; they replace those of `log`. And `guess`, as of `fit`.

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
        fixed = {**(fixed or {}), "p_h_max": positive("p_h_max", p_h_max)}
    fixed, bounds = _joint("fixed", fixed), _joint("bounds", bounds)
    if "guess" in settings:
        settings["guess"] = _joint("guess", settings["guess"])
    model = replace(TSC, build=_robot_part, check=_check_robot)
    try:
        return _robot_of(fit(model, sessions, fixed, bounds, noise, log=log, **settings))
    except IdentificationError as error:
        text = _robots(str(error))
        if any(name.startswith("human_") for name in error.parameters):
            text = f"{text}; {DRIVEN}"
        raise IdentificationError(text, tuple(map(_robots, error.parameters))) from error
    except SessionError:
        raise
    except ValueError as error:
        raise ValueError(_robots(str(error))) from error


# What to do where (2.5)-(2.6) do not describe the operator.
DRIVEN = (
    "if the operator does not follow (2.5)-(2.6), fit the robot driven by the measured p_h: "
    "trustlab.fit(trustlab.identification.ROBOT, sessions, fixed={'p_h_max': …})"
)

OF_JOINT = {name: f"robot_{name}" for name in ROBOT_NAMES} | {"p_h_max": "human_p_max"}


def _robot_part(**values: float) -> RobotModel:
    """Return the robot of a joint fit; the operator's estimates need not make a model."""
    return build_robot(**_without("robot_", values), p_h_max=values["human_p_max"], prefix="robot_")


def _joint(argument: str, values: Any) -> Any:
    """Return values by the names of the joint fit."""
    if not isinstance(values, Mapping):
        return values  # which `fit` refuses, or None
    ROBOT.check_names([name for name in values if name != "mode_delay"], argument)
    return {OF_JOINT.get(name, name): value for name, value in values.items()}


def _robots(text: str) -> str:
    """Return a name of the joint fit, or a text of such names, with the robot's own."""
    text = re.sub(r"\brobot_(a|b|p_min|p_max|time_constant)\b", r"\1", text)
    return re.sub(r"\bhuman_p_max\b", "p_h_max", text)


def _robot_of(joint: FitResult) -> FitResult:
    """Keep the robot's part of a joint fit."""
    rows = joint.parameters.rename(index=_robots)
    of_human = rows.index.str.startswith("human_")
    operator, parameters = rows[of_human], rows[~of_human]
    rest = parameters.index.difference(ROBOT.names, sort=False)
    parameters = parameters.loc[[*ROBOT.names, *rest]]
    sentences = [_robots(joint.message)]
    fixed = parameters.loc["p_h_max", "status"] == "fixed"
    if not fixed and operator["status"].isin(["weak", "at bound"]).any():
        # p_max refers to p_h_max, which is as good as the operator's model.
        parameters.loc[["p_max", "p_h_max"], "status"] = "weak"
        sentences.append(
            "Do not rely on p_h_max, nor on p_max, which refers to it: give p_h_max=…."
        )
    # Prediction errors are 0 where a sample is left out.
    errors = [np.where(run.errors["p_h"] == 0.0, 0.0, run.residual("p_h")) for run in joint.runs]
    if joint.noise != "white" and whiteness_p(errors) < NOT_WHITE:
        sentences.append(f"The residuals of p_h are not white: {DRIVEN}.")
    covariance = joint.covariance.rename(index=_robots, columns=_robots)
    free = parameters.index.intersection(covariance.index)
    return replace(
        joint,
        parameters=parameters,
        covariance=covariance.loc[free, free],
        initial_states=joint.initial_states[["p_r0", "p_r0_stderr"]],
        sigma={"p_r": joint.sigma["p_r"]},
        cost=0.5 * float(sum(np.sum(run.errors["p_r"] ** 2) for run in joint.runs)),
        message=" ".join(sentences),
    )
