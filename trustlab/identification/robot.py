"""Identification of robot performance, (2.3)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace

import numpy as np
import pandas as pd

from trustlab.identification.arx import arx
from trustlab.identification.bounds import check_method, limits_of
from trustlab.identification.errors import IdentificationError
from trustlab.identification.fit_result import FitResult, RunFit
from trustlab.identification.greybox import HUMAN, ROBOT, Problem
from trustlab.identification.human import estimate_human
from trustlab.identification.identifiability import check_mode_moves, check_output_moves, undetermined
from trustlab.identification.output_error import Estimate, estimate
from trustlab.identification.sensitivities import input_influence
from trustlab.identification.starting_values import robot_start
from trustlab.identification.summary import parameter_table, result
from trustlab.identification.traces import Trace, traces
from trustlab.models.checks import finite_number
from trustlab.models.robot import RobotModel
from trustlab.sessions.session import Session

__all__ = ["build_robot", "fit_robot"]


def fit_robot(
    sessions: Session | Iterable[Session],
    method: str = "output_error",
    p_h_max: float | None = None,
    fixed: Mapping[str, float] | None = None,
    bounds: Mapping[str, tuple] | None = None,
    noise: str = "auto",
) -> FitResult:
    """
    Identify the robot model (2.3) from sessions: a, p_min, p_max, and P_r at the start of every session.

    Parameters
    ----------
    sessions : Session or iterable of Session
        Runs with columns mode, p_h and p_r; parameters are shared, initial performances are not.
    method : {"output_error", "arx"}
        "output_error" minimises Σ (p_r − P_r(k))² of the simulated model. "arx" is the dissertation's least squares
        on P_r(k + 1) = a P_r(k) + b M(k) P_h(k) + c: quick, and biased when p_r is measured with noise.
    p_h_max : float, optional
        Greatest human performance, which p_max refers to. Identified from the same sessions (`fit_human`) when not
        given; its uncertainty is then part of that of p_max.
    fixed : mapping, optional
        Values to hold, by name: a, p_min, p_max, p_r0.
    bounds : mapping, optional
        (low, high) by name, None for an open side.
    noise : {"auto", "white", "hac"}
        What standard errors allow for: white residuals, or autocorrelated ones (Newey–West); "auto" chooses by a
        Ljung–Box test at 0.001. White noise of the input p_h, estimated from its first differences, is allowed for
        in either case.

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
    """
    fixed, bounds = {} if fixed is None else fixed, {} if bounds is None else bounds
    check_method(method, fixed, bounds, noise)
    limits = limits_of(ROBOT, fixed, bounds)
    runs, _ = traces(sessions, "p_h", "p_r")
    check_mode_moves(runs, limits, "p_min", "p_max")
    check_output_moves(runs, "p_r", ("a", "p_min", "p_max"))
    if p_h_max is not None and not finite_number("p_h_max", p_h_max) > 0.0:
        raise ValueError(f"p_h_max must be positive, got {p_h_max}")
    middle = float(np.median(np.concatenate([run.p_h for run in runs])))
    if p_h_max is not None and p_h_max < middle:
        raise ValueError(
            f"p_h_max = {p_h_max} lies below the median of the measured p_h, {middle:.4g}; it is the greatest"
        )
    human = None if p_h_max is not None else _best_operator(runs)
    best = float(p_h_max) if human is None else float(human[1].theta[3])
    if not best > 0.0:
        raise IdentificationError(
            f"column p_h: the operator's greatest performance comes out as {best:.4g}, but (2.3) divides by it; use a measure "
            "of performance that is positive",
            ("p_max",),
        )
    if method == "arx":
        fit = _least_squares(runs, best, np.nan if human is None else _p_max_variance(human[1]))
        return fit if human is None else _doubt_operator(fit, *human)
    start = robot_start(runs, None, best, limits)
    problem = Problem(ROBOT, runs, p_h_max=best)
    theta = np.r_[[start[name] for name in ROBOT.shared], start["p_r0"]]
    found = estimate(problem, theta, limits, noise)
    model = build_robot(*found.theta[:3], best)
    table, covariance = parameter_table(problem, found)
    table, covariance = _with_input_noise(table, covariance, problem, found, human)
    fit = result(problem, found, model, table, covariance)
    return fit if human is None else _doubt_operator(fit, *human)


def build_robot(a: float, p_min: float, p_max: float, p_h_max: float) -> RobotModel:
    """
    Return the model, or say what about the data contradicts (2.3).

    Parameters
    ----------
    a, p_min, p_max, p_h_max : float
        Estimates.

    Raises
    ------
    IdentificationError
        If p_max is not above p_min or a is outside (0, 1).
    """
    if not p_max > p_min:
        raise IdentificationError(
            "robot performance does not rise under manual control in these data (the fit has p_max = "
            f"{p_max:.4g}, not above p_min = {p_min:.4g}), so (2.3) does not describe them",
            ("p_min", "p_max"),
        )
    if not 0.0 < a < 1.0:
        raise IdentificationError(
            f"the fit has a = {a:.6g}, outside (0, 1): performance neither settles nor decays", ("a",)
        )
    return RobotModel(float(a), float(p_min), float(p_max), float(p_h_max))


def _best_operator(runs: list[Trace]) -> tuple[Problem, Estimate]:
    try:
        return estimate_human(runs, limits_of(HUMAN, {}, {}))
    except IdentificationError as error:
        raise IdentificationError(
            f"p_max refers to the operator's best performance, which could not be identified ({error}); "
            "give it as p_h_max=...",
            ("p_max", *error.parameters),
        ) from error


def _doubt_operator(fit: FitResult, problem: Problem, found: Estimate) -> FitResult:
    """Mark p_max as weak where the operator's model, which p_h_max comes from, is not determined itself."""
    names = undetermined(problem, parameter_table(problem, found)[0])
    if found.converged and not names:
        return fit
    parameters = fit.parameters.copy()
    parameters.loc[["p_max", "p_h_max"], "status"] = "weak"
    reason = f"{' and '.join(names)} of the operator's model" if names else "the operator's model"
    sentence = f"p_h_max, and p_max with it, is not to be trusted: these data do not determine {reason}; give p_h_max=..."
    return replace(fit, parameters=parameters, success=False, message=f"{fit.message} {sentence}.")


def _p_max_variance(found: Estimate) -> float:
    variance = found.covariance[3, 3]
    return float(variance) if np.isfinite(variance) else np.inf


def _with_input_noise(table, covariance, problem: Problem, found: Estimate, human):
    """Add what noise in p_h contributes, directly and through p_h_max, and the rows of p_h_max and b."""
    a, p_min, p_max = found.theta[:3]
    best, gain = problem.p_h_max, (p_max - p_min) / problem.p_h_max
    full = np.nan_to_num(found.covariance)
    cross = np.zeros(full.shape[0])
    if found.noise == "white" and found.free.size:
        direct, cross = _input_terms(problem, found, human)
        full = full + direct
    names = list(ROBOT.shared)
    total = np.zeros((4, 4))
    total[:3, :3], total[:3, 3], total[3, :3] = full[:3, :3], cross[:3], cross[:3]
    total[3, 3] = 0.0 if human is None else _p_max_variance(human[1])
    # What a change of p_h_max does: p_max follows it where it is free, else the other parameters have to give way.
    through, absorbed = np.eye(4), 2 in found.free
    if absorbed:
        through[2, 3] = gain
    elif found.free.size:
        moved = gain * found.inverse @ problem.normal(found.theta).matrix[found.free, 2]
        for j, k in enumerate(found.free):
            if k < 3:
                through[k, 3] = moved[j]
    slope = np.array([-gain, -(1.0 - a) / best, (1.0 - a) / best, -(1.0 - a) * gain / best])
    total = through @ total @ through.T
    b_variance = slope @ total @ slope
    for j, name in enumerate(names):
        if table.loc[name, "status"] == "estimated":
            table.loc[name, "stderr"] = np.sqrt(total[j, j])
    given = human is None
    table.loc["p_h_max"] = [
        best,
        np.nan if given else np.sqrt(total[3, 3]),
        "given" if given else "estimated",
    ]
    table.loc["b"] = [(1.0 - a) * gain, np.sqrt(b_variance), "derived"]
    kept = [*covariance.index, *([] if given else ["p_h_max"])]
    where = [[*names, "p_h_max"].index(name) for name in kept]
    return table, pd.DataFrame(
        total[np.ix_(where, where)], index=pd.Index(kept, name="parameter"), columns=kept
    )


def _input_terms(problem: Problem, found: Estimate, human) -> tuple[np.ndarray, np.ndarray]:
    """
    Return the covariance that white noise of p_h adds, and its covariance with the identified p_h_max.

    To first order θ̂ − θ = (JᵀJ)⁻¹Jᵀ(e_r − L e_h), with L the response of simulated P_r to P_h, and
    p̂_h,max − p_h,max = gᵀe_h; e_h is white with half the mean square of the first differences of p_h (or the
    residual variance of the operator's fit, where that is less).
    """
    size, free = found.theta.size, found.free
    steps = np.concatenate([np.diff(run.p_h) for run in problem.runs])
    variance = 0.5 * float(np.mean(steps**2))
    a, b = found.theta[0], (1.0 - found.theta[0]) * (found.theta[2] - found.theta[1]) / problem.p_h_max
    spread, mixed = np.zeros((size, size)), np.zeros(size)
    squares = sum(float(e @ e) for e in found.residuals[0])
    if human is not None:
        variance = min(variance, float(human[1].sigma[0]) ** 2)
    solve = found.inverse * (problem.counts[0] / (squares + problem.floors[0]))
    known = human is not None and 3 in human[1].free and human[1].noise == "white"
    if known:
        other, its = human
        weight = other.counts[0] / (sum(float(e @ e) for e in its.residuals[0]) + other.floors[0])
        row = its.inverse[list(its.free).index(3)] * weight
    for i, run in enumerate(problem.runs):
        where = problem.columns(i)
        influence = input_influence(run.mode, a, b, problem.predict(i, found.theta).jacobians[0])
        spread[np.ix_(where, where)] += influence.T @ influence
        if known:
            columns = other.columns(i)
            inside = [j for j, column in enumerate(columns) if column in its.free]
            weights = np.array([row[list(its.free).index(columns[j])] for j in inside])
            mixed[where] += influence.T @ (other.predict(i, its.theta).jacobians[0][:, inside] @ weights)
    direct, cross = np.zeros((size, size)), np.zeros(size)
    direct[np.ix_(free, free)] = variance * solve @ spread[np.ix_(free, free)] @ solve.T
    cross[free] = -variance * solve @ mixed[free]
    return direct, cross


def _least_squares(runs: list[Trace], best: float, best_variance: float) -> FitResult:
    """Fit P_r(k + 1) = a P_r(k) + b M(k) P_h(k) + c and turn it into (2.3)."""
    drives = [(run.mode * run.p_h)[:, None] for run in runs]
    fit = arx([run.p_r for run in runs], drives, na=1, nb=1, nk=1, intercept=True)
    a, b, c = -fit.coefficients[0], fit.coefficients[1], fit.coefficients[2]
    if not 0.0 < a < 1.0:
        raise IdentificationError(f"least squares has a = {a:.6g}, outside (0, 1); use output_error", ("a",))
    rest = 1.0 - a
    p_min, gain = c / rest, b / rest
    p_max = p_min + gain * best
    model = build_robot(a, p_min, p_max, best)
    known = np.isfinite(best_variance)
    # Rows: a, p_min, p_max, p_h_max, b; columns: a1 = −a, b, c, p_h_max.
    slope = np.array(
        [
            [-1.0, 0.0, 0.0, 0.0],
            [-p_min / rest, 0.0, 1.0 / rest, 0.0],
            [-p_max / rest, best / rest, 1.0 / rest, gain],
            [0.0, 0.0, 0.0, 1.0],
            [0.0, 1.0, 0.0, 0.0],
        ]
    )
    inner = np.zeros((4, 4))
    inner[:3, :3], inner[3, 3] = fit.covariance, best_variance if known else 0.0
    total = slope @ inner @ slope.T
    names = ["a", "p_min", "p_max", "p_h_max", "b"]
    stderr = np.sqrt(np.diag(total))
    stderr[3] = stderr[3] if known else np.nan
    status = ["estimated"] * 3 + ["estimated" if known else "given", "derived"]
    index = pd.Index(names, name="parameter")
    kept = names[: 4 if known else 3]
    fits = []
    for run in runs:
        simulated = model.simulate(run.mode, run.p_h, float(run.p_r[0]))
        fits.append(RunFit(run.label, run.synthetic, run.t, run.mode, {"p_r": run.p_r}, {"p_r": simulated}))
    errors = np.concatenate([run.measured["p_r"] - run.fitted["p_r"] for run in fits])
    measured = np.concatenate([run.measured["p_r"] for run in fits])
    worthless = errors @ errors >= np.sum((measured - measured.mean()) ** 2)
    return FitResult(
        model=model,
        method="arx",
        parameters=pd.DataFrame(
            {"value": [a, p_min, p_max, best, b], "stderr": stderr, "status": status}, index=index
        ),
        covariance=pd.DataFrame(total, index=index, columns=names).loc[kept, kept],
        initial_states=pd.DataFrame(
            {"p_r0": [run.p_r[0] for run in runs], "p_r0_stderr": np.nan},
            index=pd.Index([run.label for run in runs], name="run"),
        ),
        runs=fits,
        noise="white",
        sigma={"p_r": fit.sigma},
        cost=0.5 * float(errors @ errors),
        success=not worthless,
        message=(
            "Least squares on one-step predictions: measurement noise on p_r biases a towards 0, and these standard "
            "errors do not show it; compare output_error."
            + (
                " The simulated model explains less than the mean does; do not use the numbers."
                if worthless
                else ""
            )
        ),
        degrees_of_freedom=float(fit.degrees_of_freedom),
    )
