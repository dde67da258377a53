"""
`fit_robot`: the robot's model (2.3) alone, and the errors that come with the operator's P_h.

The measured P_h drives the simulated robot, unless the log hides it: with a window, a finer step or
a delay of the mode the fitted operator drives it, as in `fit_tsc`.
"""

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd

from trustlab.identification.fit_result import FitResult, parameter_table
from trustlab.identification.fitting import (
    METHODS,
    check_data,
    estimate_runs,
    estimate_table,
    refuse_options,
    result,
    weak_parameters,
)
from trustlab.identification.human import HUMAN
from trustlab.identification.logged import logged_structure
from trustlab.identification.output_error import Estimate
from trustlab.identification.regression import regress
from trustlab.identification.robot_structure import robot_structure
from trustlab.identification.runs import LogSettings, Run, joined, log_settings, read_runs
from trustlab.identification.structure import POSTERIOR, IdentificationError
from trustlab.identification.tsc import TSC
from trustlab.models.checks import one_of, positive
from trustlab.models.tsc import gain_of_human_performance
from trustlab.sessions.session import Session


def fit_robot(
    sessions: Session | Iterable[Session],
    method: str = "output_error",
    p_h_max: float | None = None,
    fixed: Mapping[str, float] | None = None,
    bounds: Mapping[str, tuple] | None = None,
    noise: str = "auto",
    log: LogSettings | None = None,
    **settings: Any,
) -> FitResult:
    """
    Identify the robot model (2.3): a, p_min, p_max, and P_r at the start of every session.

    Parameters
    ----------
    sessions : Session or iterable of Session
        Runs with columns mode, p_h and p_r; parameters are shared, initial performances are not.
    method : {"output_error", "regression"}
        "output_error" minimises Σ (p_r − P_r(k))² of the simulated model. "regression" is the
        dissertation's least squares (an ARX model) on P_r(k + 1) = a P_r(k) + b M(k) P_h(k) + c:
        quick, and biased when p_r is measured with noise.
    p_h_max : float, optional
        Greatest human performance, to which p_max refers in (2.3). By default it is identified from
        the same sessions (`fit_human`), and its uncertainty is part of that of p_max.
    fixed : mapping, optional
        Values to hold, by name: a, p_min, p_max, p_r0.
    bounds : mapping, optional
        Bounds (low, high) by name; None leaves a side open.
    noise : {"auto", "white", "correlated", "hac"}
        What the standard errors allow for; see `fit`. White noise on the input p_h is always
        allowed for; its variance is estimated from first differences.
    log : LogSettings, optional
        How the log shows the model: window, step, mode_delay, stamp_error, robust. With a window, a
        finer step or a delay the measured P_h is not what drives the robot: the fitted operator
        takes its place, as in `fit_tsc`.
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
    ValueError
        If an argument is not understood.

    Examples
    --------
    >>> import trustlab as tl
    >>> fit = tl.fit_robot(tl.read_session("data/sessions/pilot.csv"))
    >>> round(fit.model.a, 3), fit.success
    (0.996, True)
    """
    log = log_settings(log, settings)
    if one_of("method", method, METHODS) == "regression":
        refuse_options(fixed, bounds, noise, log)
    for values in (fixed, bounds):
        if isinstance(values, Mapping) and "p_h_max" in values:
            raise ValueError(
                "p_h_max is not a parameter of the search; give it as fit_robot(..., p_h_max=...)"
            )
    runs = read_runs(sessions, "mode", "p_h", "p_r", log=log)
    structure = robot_structure(1.0)  # its limits and checks hold for any p_h_max
    limits = structure.limits(fixed, bounds)
    hidden = log.step or log.mode_delay or any(run.window > 1 for run in runs)
    if method == "output_error" and hidden:
        return _fit_with_operator(runs, p_h_max, limits, noise, log)
    check_data(structure, runs, limits)
    operator = _fit_operator(runs) if p_h_max is None else None
    best = _checked_best(runs, p_h_max) if operator is None else _parameter(operator, "p_max")
    structure = robot_structure(best)
    if method == "regression":
        fit = regress(structure, runs)
        values = fit.parameters["value"].to_numpy()
        covariance = fit.covariance.to_numpy()
        tables = _tables(values, ["estimated"] * 3, covariance, best, operator)
        fit = replace(fit, parameters=tables[0], covariance=tables[1])
    else:
        estimate = estimate_runs(structure, runs, limits, noise, robust=log.robust)
        fit = result(estimate, _tables_of(estimate, best, operator))
    return fit if operator is None else _flag_weak_operator(fit, operator)


ROWS = {
    "robot_a": "a",
    "robot_p_min": "p_min",
    "robot_p_max": "p_max",
    "human_p_max": "p_h_max",
    "robot_b": "b",
    "mode_delay": "mode_delay",
}
"""Rows of the joint fit that belong to the robot, and their names here."""


def _fit_with_operator(
    runs: list[Run], p_h_max: float | None, limits: Mapping, noise: str, log: LogSettings
) -> FitResult:
    """Fit operator and robot together and return what belongs to the robot."""
    structure = logged_structure(TSC, runs[0].sample_time, log)
    names = {name: joint for joint, name in ROWS.items()}
    joint_limits = structure.limits()
    joint_limits |= {names.get(name, name): pair for name, pair in limits.items()}
    if p_h_max is not None:
        best = _checked_best(runs, p_h_max)
        joint_limits["human_p_max"] = (best, best)
    check_data(structure, runs, joint_limits)
    joint = result(estimate_runs(structure, runs, joint_limits, noise, robust=log.robust))
    parameters = joint.parameters.rename(ROWS)
    parameters = parameters.loc[[name for name in ROWS.values() if name in parameters.index]]
    if p_h_max is not None:
        parameters.loc["p_h_max", "status"] = "given"
    covariance = joint.covariance.rename(index=ROWS, columns=ROWS)
    free = [name for name in parameters.index if name in covariance.index]
    return replace(
        joint,
        model=joint.model.robot,  # type: ignore[attr-defined]
        parameters=parameters,
        covariance=covariance.loc[free, free],
        initial_states=joint.initial_states[["p_r0", "p_r0_stderr"]],
        runs=[run.only("p_r") for run in joint.runs],
        sigma={"p_r": joint.sigma["p_r"]},
        cost=0.5 * float(sum(np.sum(run.residual("p_r") ** 2) for run in joint.runs)),
    )


# --- the operator's greatest performance, and the errors that come of it --------------------------


def _checked_best(runs: list[Run], p_h_max: float) -> float:
    """Check the user's greatest human performance against the data."""
    best = positive("p_h_max", p_h_max)
    middle = float(np.median(joined(runs, "p_h")))
    if best < middle:
        raise ValueError(
            f"p_h_max = {p_h_max} lies below the median of the measured p_h, {middle:.4g}; it is "
            "the greatest"
        )
    return best


def _fit_operator(runs: list[Run]) -> Estimate:
    """Identify the operator, whose p_max is the p_h_max of (2.3)."""
    limits = HUMAN.limits()
    try:
        check_data(HUMAN, runs, limits)
        operator = estimate_runs(HUMAN, runs, limits)
    except IdentificationError as error:
        raise IdentificationError(
            "p_max refers to the operator's best performance, which could not be identified "
            f"({error}); give it as p_h_max=...",
            ("p_max", *error.parameters),
        ) from error
    best = _parameter(operator, "p_max")
    if not best > 0.0:
        raise IdentificationError(
            f"column p_h: the operator's greatest performance comes out as {best:.4g}, but (2.3) "
            "divides by it; use a measure of performance that is positive",
            ("p_max",),
        )
    return operator


def _parameter(estimate: Estimate, name: str) -> float:
    """Return one estimate."""
    return float(estimate.theta[estimate.problem.names.index(name)])


def _tables_of(
    estimate: Estimate, best: float, operator: Estimate | None
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Return the tables of a fit, with the errors that come of the measured P_h."""
    covariance = np.nan_to_num(estimate.covariance)
    shared = np.zeros(estimate.theta.size)
    # Robust errors see the noise of P_h already: filtered by (2.3), it is part of the residuals'
    # autocorrelation.
    if estimate.noise == "white" and estimate.free.size:
        direct, shared = _input_noise(estimate, best, operator)
        covariance = covariance + direct
    shift = _shift_by_best(estimate, best)
    return _tables(
        estimate.theta[:3],
        estimate.status[:3],
        covariance[:3, :3],
        best,
        operator,
        shared[:3],
        shift[:3],
    )


def _input_influence(mode: np.ndarray, a: float, b: float, jacobian: np.ndarray) -> np.ndarray:
    """
    Return LᵀJ, shape (N, p), where L maps a change of P_h to the change of simulated P_r (2.3).
    """
    from scipy import signal

    # L[k, i] = b M(i) a^(k−1−i) for i < k: one backward recursion per column instead of an N × N
    # matrix.
    tail = signal.lfilter([0.0, 1.0], [1.0, -a], jacobian[::-1], axis=0)[::-1]
    return b * mode[:, None] * tail


def _input_noise(
    estimate: Estimate, best: float, operator: Estimate | None
) -> tuple[np.ndarray, np.ndarray]:
    """
    Return the covariance due to noise of the measured P_h, and that shared with p̂_h,max.

    The simulation is driven by the measured P_h, whose noise e_h reaches the estimates: to first
    order θ̂ − θ = (JᵀJ)⁻¹ Jᵀ(e_r − L e_h), with L the response of simulated P_r to P_h. So e_h,
    white with variance σ², adds σ² (JᵀJ)⁻¹ JᵀL LᵀJ (JᵀJ)⁻¹. p̂_h,max = p_h,max + gᵀe_h comes from
    the same samples of P_h, so that its covariance with θ̂ is −σ² (JᵀJ)⁻¹ JᵀL g.
    """
    problem, free = estimate.problem, estimate.free
    # The first difference of a signal that moves slowly under white noise has variance 2σ².
    steps = np.concatenate([np.diff(run["p_h"]) for run in problem.runs])
    variance = 0.5 * float(np.mean(steps**2))
    g = [np.zeros(run.size) for run in problem.runs]
    if operator is not None:
        variance = min(variance, float(operator.sigma[0]) ** 2)
        g = _best_by_samples(operator)
    a, p_min, p_max = estimate.theta[:3]
    b = gain_of_human_performance(a, p_min, p_max, best)
    size = estimate.theta.size
    spread = np.zeros((size, size))  # JᵀL LᵀJ
    mixed = np.zeros(size)  # JᵀL g
    for i, (run, places) in enumerate(zip(problem.runs, problem.places, strict=True)):
        _, (jacobian,) = problem.simulations[i]
        influence = _input_influence(run["mode"], a, b, jacobian)
        spread[np.ix_(places, places)] += influence.T @ influence
        mixed[places] += influence.T @ g[i]
    # `inverse` is (w JᵀJ)⁻¹ with w = n/Σ e²: times w it is (JᵀJ)⁻¹.
    solve = estimate.inverse * problem.weights(estimate.equations.squares)[0]
    direct = np.zeros((size, size))
    shared = np.zeros(size)
    direct[np.ix_(free, free)] = variance * solve @ spread[np.ix_(free, free)] @ solve.T
    shared[free] = -variance * solve @ mixed[free]
    return direct, shared


def _best_by_samples(operator: Estimate) -> list[np.ndarray]:
    """Return g, the derivative of p̂_h,max by every sample of P_h; 0 for correlated residuals."""
    problem = operator.problem
    row = problem.names.index("p_max")
    solve = np.zeros(operator.theta.size)
    if operator.noise == "white":
        # p̂_h,max is one row of (JᵀJ)⁻¹ Jᵀ P_h, with the operator's own J.
        weight = problem.weights(operator.equations.squares)[0]
        solve[operator.free] = operator.inverse[list(operator.free).index(row)] * weight
    return [
        jacobians[0] @ solve[places]
        for (_, jacobians), places in zip(problem.simulations, problem.places, strict=True)
    ]


def _shift_by_best(estimate: Estimate, best: float) -> np.ndarray:
    """Return the derivative of all estimates by the p_h,max that they are made with."""
    # P_r depends on p_h,max through (p_max − p_min)/p_h,max alone, so ∂P_r/∂p_h,max = −gain
    # ∂P_r/∂p_max, and least squares answers with gain (JᵀJ)⁻¹ Jᵀ ∂P_r/∂p_max: p_max alone follows
    # where it is free, the others give way where it is not.
    gain = (_parameter(estimate, "p_max") - _parameter(estimate, "p_min")) / best
    shift = np.zeros(estimate.theta.size)
    by_p_max = estimate.equations.matrix[estimate.free, estimate.problem.names.index("p_max")]
    shift[estimate.free] = gain * estimate.inverse @ by_p_max
    return shift


def _tables(
    values: np.ndarray,
    status: list[str],
    covariance: np.ndarray,
    best: float,
    operator: Estimate | None,
    shared: np.ndarray | float = 0.0,
    shift: np.ndarray | None = None,
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """
    Return table and covariance of a, p_min, p_max and p_h_max, and the row of b.

    `shared` is their covariance with p̂_h,max, `shift` their derivative by it.
    """
    row = HUMAN.names.index("p_max")
    total = np.zeros((4, 4))
    total[:3, :3] = covariance
    total[3, 3] = 0.0 if operator is None else operator.covariance[row, row]
    total[:3, 3] = total[3, :3] = shared
    # The estimates were made with p̂_h,max in place of p_h,max: its error is added to each as far
    # as it shifts them. Of a regression it shifts p_max alone, by the gain.
    _, p_min, p_max = values
    through = np.eye(4)
    through[:3, 3] = (0.0, 0.0, (p_max - p_min) / best) if shift is None else shift
    return parameter_table(
        ("a", "p_min", "p_max", "p_h_max"),
        np.r_[values, best],
        through @ total @ through.T,
        [*status, "given" if operator is None else "estimated"],
        {"b": lambda at: gain_of_human_performance(**at)},
    )


def _flag_weak_operator(fit: FitResult, operator: Estimate) -> FitResult:
    """Mark p_max weak if the operator fit that supplies p_h_max is weak."""
    names = [parameter.name for parameter in weak_parameters(operator, estimate_table(operator)[0])]
    if operator.search.converged and not names:
        return fit
    parameters = fit.parameters.copy()
    parameters.loc[["p_max", "p_h_max"], "status"] = "weak"
    reason = f"{' and '.join(names)} of the operator's model" if names else "the operator's model"
    sentence = (
        "Do not rely on p_h_max, nor on p_max, which refers to it: these data do not determine "
        f"{reason}; give p_h_max=..."
    )
    words = [fit.message, f"{sentence}.", POSTERIOR if fit.success else ""]
    return replace(fit, parameters=parameters, success=False, message=" ".join(words).strip())
