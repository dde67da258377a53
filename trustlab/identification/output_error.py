"""The output-error (prediction-error) method: search and covariance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trustlab.identification.errors import IdentificationError
from trustlab.identification.greybox import Problem
from trustlab.identification.least_squares import minimise
from trustlab.identification.residuals import hac_lags, hac_matrix, ljung_box, pooled_autocorrelation

__all__ = ["Estimate", "estimate"]

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
        predicted = problem.latest(i)  # what `normal` has just simulated
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
        scores = np.zeros((problem.runs[i].mode.size, where.size))
        for j, moved in enumerate(problem.structure.moves):
            scores[:, list(moved)] += weights[j] * jacobians[j] * residuals[j][i][:, None]
        meat[np.ix_(where, where)] += hac_matrix(scores, lags)
    return meat[np.ix_(free, free)]
