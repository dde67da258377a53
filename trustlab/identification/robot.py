"""`fit_robot`: the robot's part of the joint fit of robot and operator, under names of its own."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from trustlab.identification.fit_result import FitResult
from trustlab.identification.fitting import check_data, estimate_runs, result
from trustlab.identification.logged import logged_structure
from trustlab.identification.output_error import NOT_WHITE, Estimate
from trustlab.identification.residuals import whiteness_p
from trustlab.identification.robot_performance import build_robot, check_excitation
from trustlab.identification.runs import LogSettings, Run, joined, log_settings, read_runs
from trustlab.identification.structure import IdentificationError, Parameter, Structure
from trustlab.identification.tsc import OPERATOR, TSC
from trustlab.models.checks import positive
from trustlab.models.tsc import RobotModel
from trustlab.sessions.session import Session


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
    Identify the robot model (2.3): a, p_min, p_max, and P_r at the start of every session.

    Robot and operator are fitted together, as in `fit_tsc`: the fitted operator drives the robot.

    Parameters
    ----------
    sessions : Session or iterable of Session
        Runs with columns mode, p_h and p_r; parameters are shared, initial states are not.
    p_h_max : float, optional
        Greatest human performance, to which p_max refers in (2.3). By default it is identified with
        the rest, and its uncertainty is part of that of p_max.
    fixed : mapping, optional
        Values to hold, by name: a, p_min, p_max, p_r0; of the operator human_a, human_beta,
        human_p_min, r0; mode_delay where it is estimated.
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
        With a RobotModel. Where p_h is not white about the fitted operator, the message says so:
        `identification.robot_structure` is driven by the measured p_h.

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
    >>> fit = tl.fit_robot(tl.read_session("data/sessions/pilot.csv"))
    >>> round(fit.model.a, 3), fit.success
    (0.996, True)
    """
    if "method" in settings:
        raise TypeError(
            "fit_robot has no method=…; least squares on one-step predictions is trustlab.arx"
        )
    log = log_settings(log, settings)
    for values in (fixed, bounds):
        if isinstance(values, Mapping) and "p_h_max" in values:
            raise ValueError(
                "p_h_max is an argument of its own; give it as fit_robot(..., p_h_max=...)"
            )
    runs = read_runs(sessions, "mode", "p_h", "p_r", log=log)
    structure = logged_structure(ROBOT, runs[0].sample_time, log)
    limits = structure.limits(fixed, bounds)
    if p_h_max is not None:
        best = _checked_best(runs, p_h_max)
        limits["p_h_max"] = (best, best)
    try:
        check_data(structure, runs, limits)
        estimate = estimate_runs(structure, runs, limits, noise, robust=log.robust)
        joint = result(estimate)
    except IdentificationError as error:
        if not set(OPERATOR_NAMES) & set(error.parameters):
            raise
        raise IdentificationError(f"{error}; {DRIVEN}", error.parameters) from error
    return _robot_of(joint, estimate, p_h_max is not None)


NAMES = {
    "robot_a": "a",
    "robot_p_min": "p_min",
    "robot_p_max": "p_max",
    "human_p_max": "p_h_max",
    "robot_b": "b",
}
"""What `fit_robot` calls parameters of the joint fit; the others keep their names."""

JOINT = {name: joint for joint, name in NAMES.items()}

ROWS = ("a", "p_min", "p_max", "p_h_max", "b", "mode_delay")

OPERATOR_NAMES = tuple(NAMES.get(name, name) for name in OPERATOR if name != "r0")

DRIVEN = (
    "if the operator does not follow (2.5)-(2.6), fit the robot driven by the measured p_h: "
    "trustlab.fit(trustlab.identification.robot_structure(p_h_max), sessions)"
)


def _build(a, p_min, p_max, p_h_max, human_p_min, **_) -> RobotModel:
    """Return the model, or say what about the data contradicts (2.3)."""
    if not p_h_max > max(human_p_min, 0.0):
        raise IdentificationError(
            f"column p_h: the operator's greatest performance comes out as {p_h_max:.4g} and the "
            f"least as {human_p_min:.4g}, but the greatest must be positive and above the least; "
            "use a measure of performance that is",
            ("p_h_max", "human_p_min"),
        )
    return build_robot(a, p_min, p_max, p_h_max)


def _renamed() -> Structure:
    """Return the joint structure under the names of `fit_robot`, with the robot as its model."""

    def parameter(of: Parameter) -> Parameter:
        span = of.span and (ours(of.span[0]), ours(of.span[1]))
        return replace(of, name=ours(of.name), span=span)

    def ours(name: str) -> str:
        return NAMES.get(name, name)

    def theirs(values: Mapping) -> dict:
        return {JOINT.get(name, name): value for name, value in values.items()}

    def guess(runs: list[Run], limits: Mapping) -> list[dict]:
        return [
            {ours(name): value for name, value in start.items()}
            for start in TSC.guess(runs, theirs(limits))
        ]

    def by_their_names(function: Callable) -> Callable:
        return lambda at: function(theirs(at))

    return replace(
        TSC,
        parameters=tuple(map(parameter, TSC.parameters)),
        sensitivities=lambda run, **values: TSC.sensitivities(run, **theirs(values)),
        affected_by={output: tuple(map(ours, TSC.affected_by[output])) for output in TSC.outputs},
        guess=guess,
        model=_build,
        derived={ours(name): by_their_names(row) for name, row in TSC.derived.items()},
        check=check_excitation,
    )


ROBOT = _renamed()


def _checked_best(runs: list[Run], p_h_max: float) -> float:
    """Check the user's greatest human performance against the data."""
    best = positive("p_h_max", p_h_max)
    middle = float(np.median(joined(runs, "p_h")))
    if best < middle:
        raise ValueError(
            f"p_h_max = {p_h_max} lies below the median of the measured p_h, {middle:.4g}; it is "
            "the greatest"
        )
    greatest = float(np.max(joined(runs, "p_h")))
    if best > 1e3 * greatest:
        raise ValueError(
            f"p_h_max = {p_h_max} is over a thousand times the measured p_h, {greatest:.4g}; give "
            "it in the unit of p_h"
        )
    return best


def _robot_of(joint: FitResult, estimate: Estimate, given: bool) -> FitResult:
    """Return what of the joint fit belongs to the robot; `given` says that p_h_max was."""
    parameters = joint.parameters.loc[[name for name in ROWS if name in joint.parameters.index]]
    message = joint.message
    if given:
        parameters.loc["p_h_max", "status"] = "given"
    else:
        # p_max refers to p_h_max, which is as good as the operator's model.
        operator = joint.parameters["status"].reindex([*OPERATOR_NAMES])
        if operator.isin(["weak", "at bound"]).any():
            parameters.loc[["p_max", "p_h_max"], "status"] = "weak"
            message += " Do not rely on p_h_max, nor on p_max, which refers to it; give p_h_max=…."
    free = [name for name in parameters.index if name in joint.covariance.index]
    if _operator_differs(estimate):
        message += f" The residuals of p_h are not white: {DRIVEN}."
    return replace(
        joint,
        parameters=parameters,
        covariance=joint.covariance.loc[free, free],
        initial_states=joint.initial_states[["p_r0", "p_r0_stderr"]],
        runs=[run.only("p_r") for run in joint.runs],
        sigma={"p_r": joint.sigma["p_r"]},
        cost=0.5 * float(sum(np.sum(run.residual("p_r") ** 2) for run in joint.runs)),
        message=message,
    )


def _operator_differs(estimate: Estimate) -> bool:
    """Return whether p_h less the fitted operator is not white, before any model of its noise."""
    problem = estimate.problem
    of_p_h = TSC.outputs.index("p_h")
    residuals = [
        np.where(series.missing, 0.0, problem.differences(series)[0])
        for series in problem.series_of(of_p_h)
    ]
    return not estimate.exact[of_p_h] and whiteness_p(residuals) < NOT_WHITE
