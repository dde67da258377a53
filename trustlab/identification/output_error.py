"""The output-error (prediction-error) method: search, covariance, and a result that says how sure it is."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy import stats

from trustlab.identification.errors import IdentificationError
from trustlab.identification.fit_result import FitResult, RunFit
from trustlab.identification.greybox import Problem, Structure
from trustlab.identification.least_squares import minimise
from trustlab.identification.residuals import hac_lags, hac_matrix, ljung_box, pooled_autocorrelation
from trustlab.identification.traces import Trace

__all__ = ["Estimate", "check_mode_moves", "estimate", "limits_of", "parameter_table", "result"]

SINGULAR = 1e-10
"""Smallest eigenvalue of the information matrix, scaled to unit diagonal, that still counts as information."""


@dataclass(frozen=True, eq=False)
class Estimate:
    """
    A search's result in the parameters' own coordinates.

    Parameters
    ----------
    theta : numpy.ndarray, shape (p,)
        Shared parameters, then every run's initial states.
    covariance : numpy.ndarray, shape (p, p)
        Zero in rows of fixed parameters, NaN in rows of parameters that a bound holds.
    fixed, at_bound : numpy.ndarray of bool, shape (p,)
        Which were fixed, and which a bound holds.
    inverse : numpy.ndarray, shape (free, free)
        (Σ w JᵀJ)⁻¹ of the free parameters, w = n/Σ e²; for propagating further noise.
    free : numpy.ndarray of int
        Numbers of the free parameters.
    residuals : list of list of numpy.ndarray
        Measured minus fitted, per output and run.
    fitted : list of list of numpy.ndarray
        Fitted values, per output and run.
    cost : float
        ½ Σ e² over all outputs.
    sigma : numpy.ndarray, shape (outputs,)
        Standard deviation of the residuals, √(Σ e²/(n − p)).
    whiteness_p : float
        p of the Ljung–Box test, the smallest over outputs.
    noise : str
        "white" or "hac": how the covariance was computed.
    converged : bool
        Whether the search ended at a minimum.
    iterations : int
        Evaluations used.
    """

    theta: np.ndarray
    covariance: np.ndarray
    fixed: np.ndarray
    at_bound: np.ndarray
    inverse: np.ndarray
    free: np.ndarray
    residuals: list
    fitted: list
    cost: float
    sigma: np.ndarray
    whiteness_p: float
    noise: str
    converged: bool
    iterations: int


def _check_names(structure: Structure, given: Mapping, what: str) -> None:
    known = structure.shared + structure.initial
    for name in given:
        if name not in known:
            close = difflib.get_close_matches(str(name), known, n=1)
            hint = f"; did you mean {close[0]!r}?" if close else ""
            raise ValueError(f"{what} names {name!r}, which is no parameter here ({', '.join(known)}){hint}")


def limits_of(structure: Structure, fixed: Mapping, bounds: Mapping) -> dict[str, tuple[float, float]]:
    """
    Return lowest and highest value by parameter; equal values for a fixed one.

    Parameters
    ----------
    structure : Structure
        The model structure.
    fixed : mapping
        Values to hold, by name.
    bounds : mapping
        (low, high) by name; None for an open side.
    """
    _check_names(structure, fixed, "fixed")
    _check_names(structure, bounds, "bounds")
    out = {}
    for name in structure.shared + structure.initial:
        low, high = structure.bounds(name)
        if name in bounds:
            own_low, own_high = bounds[name]
            own_low = low if own_low is None else float(own_low)
            own_high = high if own_high is None else float(own_high)
            if not own_low < own_high:
                raise ValueError(f"bounds of {name} must be (low, high) with low < high, got {bounds[name]}")
            if own_high <= low or own_low >= high:
                raise ValueError(f"bounds of {name}, {bounds[name]}, lie outside [{low:g}, {high:g}]")
            low, high = max(low, own_low), min(high, own_high)
        if name in fixed:
            value = float(fixed[name])
            if not low <= value <= high:
                raise ValueError(f"{name} is fixed at {value}, outside [{low:g}, {high:g}]")
            low = high = value
        out[name] = (low, high)
    return out


def estimate(
    problem: Problem, start: np.ndarray, limits: dict[str, tuple[float, float]], noise: str = "auto"
) -> Estimate:
    """
    Search from `start`, then give covariance and diagnostics.

    Parameters
    ----------
    problem : Problem
        Structure and data.
    start : numpy.ndarray, shape (p,)
        Shared parameters, then every run's initial states.
    limits : dict
        From `limits_of`.
    noise : {"auto", "white", "hac"}
        Which covariance: for white residuals, or robust to autocorrelated ones (Newey–West); "auto" takes the
        robust one when the Ljung–Box test rejects whiteness at 0.001.

    Raises
    ------
    IdentificationError
        If the data leave a parameter undetermined.
    """
    if noise not in ("auto", "white", "hac"):
        raise ValueError(f'noise must be "auto", "white" or "hac", got {noise!r}')
    structure, runs = problem.structure, len(problem.runs)
    order = [*structure.shared, *structure.initial * runs]
    low, high = (np.array([limits[name][side] for name in order]) for side in (0, 1))
    fixed = low == high
    minimum = minimise(
        problem.search_normal, problem.to_search(start), problem.to_search(low), problem.to_search(high)
    )
    theta = problem.from_search(minimum.x)
    theta[fixed] = low[fixed]
    theta[minimum.at_bound] = np.clip(theta, low, high)[minimum.at_bound]
    normal = problem.normal(theta)
    free = np.flatnonzero(~fixed & ~minimum.at_bound)
    inverse = _inverse(normal.matrix, free, problem)

    fitted, residuals = [[] for _ in structure.outputs], [[] for _ in structure.outputs]
    for i, run in enumerate(problem.runs):
        predicted = problem.predict(i, theta)
        for j, name in enumerate(structure.outputs):
            fitted[j].append(predicted.outputs[j].copy())
            residuals[j].append(getattr(run, name) - predicted.outputs[j])
    exact = normal.squares <= 1e-4 * problem.floors
    correlation = [pooled_autocorrelation(own, 25) for own in residuals]
    # Residuals of an exact fit are rounding: there is no noise to call white or not.
    whiteness = [
        1.0 if exact[j] else ljung_box(rho, int(problem.counts[j]))[2] for j, rho in enumerate(correlation)
    ]
    whiteness_p = float(min(whiteness))
    robust = noise == "hac" or (noise == "auto" and whiteness_p < 1e-3)
    if robust:
        meat = _meat(problem, theta, residuals, normal.squares, free)
        core = inverse @ meat @ inverse
    else:
        core = inverse
    total = problem.counts.sum()
    core = core * (total / max(total - free.size, 1.0))
    covariance = np.zeros((theta.size, theta.size))
    covariance[minimum.at_bound, :] = covariance[:, minimum.at_bound] = np.nan
    covariance[np.ix_(free, free)] = core
    dof = np.maximum(problem.counts - free.size / len(structure.outputs), 1.0)
    return Estimate(
        theta=theta,
        covariance=covariance,
        fixed=fixed,
        at_bound=minimum.at_bound,
        inverse=inverse,
        free=free,
        residuals=residuals,
        fitted=fitted,
        cost=0.5 * float(normal.squares.sum()),
        sigma=np.sqrt(normal.squares / dof),
        whiteness_p=whiteness_p,
        noise="hac" if robust else "white",
        converged=minimum.converged,
        iterations=minimum.iterations,
    )


def _inverse(matrix: np.ndarray, free: np.ndarray, problem: Problem) -> np.ndarray:
    """Invert the free part of the information matrix, or name what it says nothing about."""
    names = problem.names
    part = matrix[np.ix_(free, free)]
    diagonal = np.diag(part).copy()
    if free.size == 0:
        return part
    dead = diagonal <= 1e-30 * diagonal.max(initial=1e-300)
    if not dead.any():
        scale = np.sqrt(diagonal)
        values, vectors = np.linalg.eigh(part / np.outer(scale, scale))
        if values[0] > SINGULAR:
            return (vectors / values) @ vectors.T / np.outer(scale, scale)
        dead = np.abs(vectors[:, 0]) > 0.25
    lost = tuple(names[free[j]] for j in np.flatnonzero(dead))
    raise IdentificationError(
        f"these data do not determine {' and '.join(lost)} ({_why(problem)}); record phases that move the model more, "
        f"or fix a parameter, for example fixed={{{lost[-1].split('[')[0]!r}: ...}}",
        lost,
    )


def _why(problem: Problem) -> str:
    """Say what about the data makes parameters indistinguishable."""
    modes = np.unique(np.concatenate([np.unique(run.mode) for run in problem.runs]))
    if modes.size == 1:
        return f"mode never changes: it is {modes[0]:g} throughout"
    moves = []
    for name in problem.structure.outputs:
        spread = np.ptp(np.concatenate([getattr(run, name) for run in problem.runs]))
        moves.append(f"{name} moves by {spread:.3g}")
    return "several values explain them equally well; " + " and ".join(moves)


def _meat(
    problem: Problem, theta: np.ndarray, residuals: list, squares: np.ndarray, free: np.ndarray
) -> np.ndarray:
    """Return the long-run covariance of the likelihood's scores, over runs."""
    weights = problem.counts / (squares + problem.floors)
    meat = np.zeros((theta.size, theta.size))
    lags = max(hac_lags(own) for own in residuals)
    for i in range(len(problem.runs)):
        where = problem.columns(i)
        jacobians = problem.predict(i, theta).jacobians
        scores = sum(
            weights[j] * jacobians[j] * residuals[j][i][:, None]
            for j in range(len(problem.structure.outputs))
        )
        meat[np.ix_(where, where)] += hac_matrix(scores, lags)
    return meat[np.ix_(free, free)]


def check_mode_moves(runs: list[Trace], limits: dict[str, tuple[float, float]], low: str, high: str) -> None:
    """
    Refuse data in which nothing separates the least from the greatest robot performance.

    Parameters
    ----------
    runs : list of Trace
        The data.
    limits : dict
        From `limits_of`.
    low, high : str
        Names of the least and the greatest robot performance.

    Raises
    ------
    IdentificationError
        If mode never changes and neither parameter is fixed, or is 0 throughout and `high` is not fixed.
    """
    modes = np.concatenate([run.mode for run in runs])
    held = {name for name in (low, high) if limits[name][0] == limits[name][1]}
    if np.ptp(modes) > 0.0 or (held and (modes[0] > 0.0 or high in held)):
        return
    lost = (high,) if modes[0] == 0.0 else (low, high)
    what = " and ".join(lost)
    raise IdentificationError(
        f"these data do not determine {what}: mode never changes (it is {modes[0]:g} throughout); log at least one "
        f"switch between manual and autonomous control, or fix a parameter, for example fixed={{{lost[0]!r}: ...}}",
        lost,
    )


HINTS = {
    "a": "record a rise or a decay long enough to see its curvature",
    "beta": "record phases that take utilization to both sides of its best",
    "p_min": "record a phase long enough to settle at the least performance",
    "p_max": "record a phase long enough to come near the greatest performance",
}


def _is_weak(kind: str, value: float, stderr: float, span: float) -> bool:
    half = stats.norm.ppf(0.975) * stderr
    if kind == "rate":
        return half > 0.5 * (1.0 - value)
    if kind == "logit":
        return half > 0.25
    return half > 0.5 * abs(span)


def result(
    problem: Problem, found: Estimate, model: object, table: pd.DataFrame, covariance: pd.DataFrame
) -> FitResult:
    """
    Put an estimate, its model and its table of parameters into a FitResult.

    Parameters
    ----------
    problem : Problem
        Structure and data.
    found : Estimate
        The estimate.
    model : RobotModel, HumanModel or TscModel
        The model at the estimate.
    table : pandas.DataFrame
        Index `parameter`; columns value, stderr, status; statuses of weakly determined parameters are set here.
    covariance : pandas.DataFrame
        Covariance of the estimated parameters.
    """
    structure, table = problem.structure, table.copy()
    sentences = [f"Converged in {found.iterations} evaluations."]
    if not found.converged:
        sentences = [
            f"Stopped after {found.iterations} evaluations without reaching a minimum; do not use the numbers."
        ]
    maps, success = dict(zip(structure.shared, structure.maps, strict=False)), found.converged
    for name in structure.shared:
        value, stderr, status = table.loc[name, ["value", "stderr", "status"]]
        stem = name.split("_", 1)[1] if name.startswith(("human_", "robot_")) else name
        prefix = name[: len(name) - len(stem)]
        span = table.loc[prefix + "p_max", "value"] - table.loc[prefix + "p_min", "value"]
        if status == "at bound":
            success = False
            sentences.append(f"{name} ran into its bound at {value:.6g}: these data do not determine it.")
        elif status == "estimated" and _is_weak(maps[name], value, stderr, span):
            success = False
            table.loc[name, "status"] = "weak"
            half = stats.norm.ppf(0.975) * stderr
            sentences.append(
                f"{name} is hardly determined by these data ({value:.4g} ± {half:.2g}); {HINTS[stem]}, or fix it."
            )
    for name in structure.initial:
        first = len(structure.shared) + structure.initial.index(name)
        where = np.arange(first, found.theta.size, len(structure.initial))
        held = int(found.at_bound[where].sum())
        if held:
            sentences.append(f"{name} lies on its bound in {held} of {len(where)} run(s).")
    if found.noise == "hac":
        sentences.append(
            f"Residuals are not white (Ljung–Box p = {found.whiteness_p:.2g}): standard errors allow for autocorrelation."
            if found.whiteness_p < 1e-3
            else "Standard errors allow for autocorrelated residuals."
        )
    elif found.whiteness_p < 1e-3:
        sentences.append(
            f"Residuals are not white (Ljung–Box p = {found.whiteness_p:.2g}): these standard errors are too small; "
            'use noise="hac".'
        )
    stderr = np.sqrt(np.where(found.fixed, np.nan, np.diag(found.covariance)))
    shared, own = len(structure.shared), len(structure.initial)
    states = {}
    for j, name in enumerate(structure.initial):
        states[name] = found.theta[shared + j :: own]
        states[f"{name}_stderr"] = stderr[shared + j :: own]
    index = pd.Index([run.label for run in problem.runs], name="run")
    runs = [
        RunFit(
            run.label,
            run.synthetic,
            run.t,
            run.mode,
            {name: getattr(run, name) for name in structure.outputs},
            {name: found.fitted[j][i] for j, name in enumerate(structure.outputs)},
        )
        for i, run in enumerate(problem.runs)
    ]
    return FitResult(
        model=model,
        method="output_error",
        parameters=table,
        covariance=covariance,
        initial_states=pd.DataFrame(states, index=index),
        runs=runs,
        noise=found.noise,
        sigma=dict(zip(structure.outputs, found.sigma.tolist(), strict=True)),
        cost=found.cost,
        success=bool(success),
        message=" ".join(sentences),
        degrees_of_freedom=float(problem.counts.sum() - found.free.size),
    )


def parameter_table(problem: Problem, found: Estimate) -> tuple[pd.DataFrame, pd.DataFrame]:
    """
    Return the shared parameters' table and covariance.

    Parameters
    ----------
    problem : Problem
        Structure and data.
    found : Estimate
        The estimate.

    Returns
    -------
    table : pandas.DataFrame
        Index `parameter`; columns value, stderr, status.
    covariance : pandas.DataFrame
        Of the estimated shared parameters.
    """
    names = list(problem.structure.shared)
    size = len(names)
    status = np.where(found.fixed, "fixed", np.where(found.at_bound, "at bound", "estimated"))[:size]
    stderr = np.where(status == "estimated", np.sqrt(np.abs(np.diag(found.covariance)[:size])), np.nan)
    index = pd.Index(names, name="parameter")
    table = pd.DataFrame(
        {"value": found.theta[:size], "stderr": stderr, "status": status.astype(object)}, index=index
    )
    full = pd.DataFrame(found.covariance[:size, :size], index=index, columns=names)
    kept = [name for name in names if table.loc[name, "status"] == "estimated"]
    return table, full.loc[kept, kept]
