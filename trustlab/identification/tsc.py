"""
Robot and operator identified together, (2.3), (2.5) and (2.6): `fit_tsc`, structure, sensitivities.

`fitting.py` says how any structure is fitted, `output_error.py` which likelihood is maximised.
"""

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from trustlab.identification.fit_result import FitResult
from trustlab.identification.fitting import fit
from trustlab.identification.human import (
    build_human,
    human_guess,
    human_parameters,
    initial_utilization,
    simulate_human,
)
from trustlab.identification.robot_performance import (
    build_robot,
    check_excitation,
    robot_guess,
    robot_parameters,
    simulate_robot,
)
from trustlab.identification.runs import LogSettings, Run, as_columns
from trustlab.identification.structure import (
    MODEL_STEP,
    POSTERIOR,
    IdentificationError,
    Parameter,
    Structure,
)
from trustlab.models.compiled import njit
from trustlab.models.tsc import TscModel, gain_of_human_performance
from trustlab.sessions.session import Session


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
    ValueError
        If an argument is not understood.

    Examples
    --------
    >>> import trustlab as tl
    >>> tsc = tl.fit_tsc(tl.read_session("data/sessions/pilot.csv")).model
    >>> round(tsc.robot.a, 3), round(tsc.human.beta, 2)
    (0.996, 0.74)
    """
    return fit(TSC, sessions, fixed=fixed, bounds=bounds, noise=noise, log=log, **settings)


OPERATOR = ("human_a", "human_beta", "human_p_min", "human_p_max", "r0")
ROBOT = ("robot_a", "robot_p_min", "robot_p_max", "p_r0")

RANGES = ("human_p_min", "human_p_max", "robot_p_min", "robot_p_max")

SLOPES = np.dtype([(name, float) for name in (*OPERATOR, *ROBOT)])


@njit
def _through_operator(mode, p_h, by_h, by_r, p_h_max, a, gain, out):
    """
    Write the derivatives of P_r into the records `out`.

    Those by the robot's parameters, `by_r`, are copied; those by the operator's follow from the
    derivatives of P_h, `by_h`, as (2.3) passes them on.
    """
    by_a = 0.0
    by_beta = 0.0
    by_min = 0.0
    by_max = 0.0
    by_r0 = 0.0
    for k in range(mode.size):
        operator = by_h[k]
        robot = by_r[k]
        row = out[k]
        row.human_a = by_a
        row.human_beta = by_beta
        row.human_p_min = by_min
        row.human_p_max = by_max
        row.r0 = by_r0
        row.robot_a = robot.a
        row.robot_p_min = robot.p_min
        row.robot_p_max = robot.p_max
        row.p_r0 = robot.p_r0
        # (2.3) differentiated by x: ∂P_r(k+1) = a ∂P_r(k) + (1 − a) gain M(k) ∂P_h(k), gain =
        # (p_max − p_min)/p_h,max.
        into = (1.0 - a) * gain * mode[k]
        by_a = a * by_a + into * operator.a
        by_beta = a * by_beta + into * operator.beta
        by_min = a * by_min + into * operator.p_min
        # p_h,max acts through the gain, too.
        by_max = a * by_max + into * (operator.p_max - p_h[k] / p_h_max)
        by_r0 = a * by_r0 + into * operator.r0


def _sensitivities(
    run: Run,
    human_a,
    human_beta,
    human_p_min,
    human_p_max,
    robot_a,
    robot_p_min,
    robot_p_max,
    r0,
    p_r0,
):
    """
    Return P_h and P_r with their derivatives, shapes (N, 5) and (N, 9).

    The simulated operator drives the robot: P_h depends on OPERATOR, P_r on OPERATOR and ROBOT.
    """
    p_h, by_human = simulate_human(run, human_a, human_beta, human_p_min, human_p_max, r0)
    p_r, by_robot = simulate_robot(run, p_h, human_p_max, robot_a, robot_p_min, robot_p_max, p_r0)
    gain = (robot_p_max - robot_p_min) / human_p_max
    by = run.scratch("of P_r by all", SLOPES)
    _through_operator(run["mode"], p_h, by_human, by_robot, human_p_max, robot_a, gain, by)
    return [p_h, p_r], [as_columns(by_human), as_columns(by)]


def _without_prefix(values: Mapping, prefix: str) -> dict:
    """Return the values of one of the two models by their names in that model alone."""
    return {
        name.removeprefix(prefix): value
        for name, value in values.items()
        if name.startswith(prefix)
    }


def _guess(runs: list[Run], limits: Mapping) -> list[dict]:
    """Return starting values: the operator's first, then the robot's under the measured P_h."""
    starts = []
    for human in human_guess(runs, _without_prefix(limits, "human_") | {"r0": limits["r0"]}):
        robot = robot_guess(runs, _without_prefix(limits, "robot_"), human["p_max"])
        start = {"r0": human.pop("r0"), "p_r0": robot.pop("p_r0")}
        start |= {f"human_{name}": value for name, value in human.items()}
        starts.append(start | {f"robot_{name}": value for name, value in robot.items()})
    return starts


def _build(**values) -> TscModel:
    operator = build_human(**_without_prefix(values, "human_"))
    robot = build_robot(**_without_prefix(values, "robot_"), p_h_max=operator.p_max)
    try:
        return TscModel(robot, operator)
    except ValueError as error:
        raise IdentificationError(
            f"the fitted ranges of performance give no a_T and b_T of (2.2): {error}", RANGES
        ) from error


TSC = Structure(
    "robot and human model (2.3), (2.5)-(2.6)",
    parameters=(*human_parameters("human_"), *robot_parameters("robot_")),
    initial=(initial_utilization("human_beta"), Parameter("p_r0")),
    outputs=("p_h", "p_r"),
    sensitivities=_sensitivities,
    affected_by={"p_h": OPERATOR, "p_r": (*OPERATOR, *ROBOT)},
    guess=_guess,
    model=_build,
    derived={
        "human_b": lambda at: 1.0 - at["human_a"],
        "robot_b": lambda at: gain_of_human_performance(
            at["robot_a"], at["robot_p_min"], at["robot_p_max"], at["human_p_max"]
        ),
    },
    check=lambda runs, limits: check_excitation(runs, limits, "robot_p_min", "robot_p_max"),
    step=MODEL_STEP,
    remedy=POSTERIOR,
)
