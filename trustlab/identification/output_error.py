"""The output-error (prediction-error) method for any structure: likelihood, search, covariance."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from trustlab.identification.least_squares import Minimum, NormalEquations, minimise
from trustlab.identification.residuals import hac_lags, hac_matrix, sandwich, whiteness_p
from trustlab.identification.runs import Run, joined
from trustlab.identification.structure import IdentificationError, Structure

NOISES = ("auto", "white", "hac")

SINGULAR = 1e-10
"""Smallest eigenvalue of the information matrix, scaled to unit diagonal, that still counts as information."""


class Problem:
    """A structure with the runs that it is to explain; the full vector holds the parameters, then each run's initial states."""

    def __init__(self, structure: Structure, runs: list[Run], guess: Mapping):
        self.structure, self.runs = structure, runs
        self.shared, self.own = len(structure.parameters), len(structure.initial)
        one_run = [one.coordinate(guess) for one in (*structure.parameters, *structure.initial)]
        self.coordinates = one_run[: self.shared] + one_run[self.shared :] * len(runs)
        # Where the parameters and each run's own initial states stand in the full vector.
        firsts = [self.shared + i * self.own for i in range(len(runs))]
        self.where = [np.r_[: self.shared, first : first + self.own] for first in firsts]
        self.moved = [structure.columns_of(name) for name in structure.outputs]
        measured = [joined(runs, name) for name in structure.outputs]
        self.counts = np.array([values.size for values in measured], dtype=float)
        # The likelihood of data that are reproduced exactly is infinite: Σ e² has a floor at a billionth of the scale.
        scale = [max(float(np.sqrt(np.mean(values**2))), 1e-300) for values in measured]
        self.floors = self.counts * (1e-9 * np.array(scale)) ** 2
        self.latest: list = [None] * len(runs)

    @property
    def names(self) -> list[str]:
        """Names of all coordinates; initial states carry the number of their run."""
        shared, initial = self.structure.names[: self.shared], self.structure.names[self.shared :]
        if len(self.runs) == 1:
            return [*shared, *initial]
        return [*shared, *(f"{name}[{i}]" for i in range(len(self.runs)) for name in initial)]

    def vector(self, values: Mapping) -> np.ndarray:
        """Return the full vector of values by name; an initial state may have one value per run."""
        shared = [values[name] for name in self.structure.names[: self.shared]]
        initial = [values[name] for name in self.structure.names[self.shared :]]
        own = [np.broadcast_to(value, len(self.runs)) for value in initial]
        return np.array([*shared, *np.ravel(own, order="F")], dtype=float)

    def predict(self, run: int, theta: np.ndarray) -> tuple[list[np.ndarray], list[np.ndarray]]:
        """Simulate one run; return its outputs and their derivatives."""
        values = dict(zip(self.structure.names, theta[self.where[run]], strict=True))
        first, self.latest[run] = self.latest[run] is None, self.structure.predict(self.runs[run], values)
        if first:
            self.structure.check_sensitivities(self.runs[run], *self.latest[run])
        return self.latest[run]

    def normal(self, theta: np.ndarray) -> NormalEquations:
        """Accumulate the likelihood's gradient and Gauss–Newton matrix over all runs."""
        p, outputs = theta.size, len(self.structure.outputs)
        squares, gradients, matrices = np.zeros(outputs), np.zeros((outputs, p)), np.zeros((outputs, p, p))
        for i, run in enumerate(self.runs):
            simulated, jacobians = self.predict(i, theta)
            for j, name in enumerate(self.structure.outputs):
                error = run[name] - simulated[j]
                squares[j] += error @ error
                where = self.where[i][self.moved[j]]
                gradients[j, where] += error @ jacobians[j]
                matrices[j][where[:, None], where] += jacobians[j].T @ jacobians[j]
        # With the variance of each output estimated as Σ e²/n, the likelihood is Σ n ln(Σ e²) but for a constant, and
        # its derivatives weight each output by n/Σ e²: no output needs a weight from the user.
        weights = self.weights(squares)
        value = float(self.counts @ np.log(squares + self.floors))
        exact = bool((squares <= 1e-6 * self.floors).all())
        return NormalEquations(value, weights @ gradients, np.einsum("i,ijk", weights, matrices), squares, exact)

    def weights(self, squares: np.ndarray) -> np.ndarray:
        """Return the weight n/Σ e² of every output."""
        return self.counts / (squares + self.floors)

    def residuals(self) -> list[list[np.ndarray]]:
        """Return measured minus predicted at the latest point, by output, then by run."""
        return [
            [run[name] - outputs[j] for run, (outputs, _) in zip(self.runs, self.latest, strict=True)]
            for j, name in enumerate(self.structure.outputs)
        ]

    def search_normal(self, x: np.ndarray) -> NormalEquations:
        """Return `normal` in the coordinates of the search."""
        at = self.normal(self.from_search(x))
        slope = np.array([one.slope(value) for one, value in zip(self.coordinates, x, strict=True)])
        matrix = at.matrix * np.outer(slope, slope)
        return NormalEquations(at.value, at.gradient * slope, matrix, at.squares, at.exact)

    def to_search(self, theta: np.ndarray) -> np.ndarray:
        """Return search coordinates of parameters."""
        return np.array([one.to(value) for one, value in zip(self.coordinates, theta, strict=True)])

    def from_search(self, x: np.ndarray) -> np.ndarray:
        """Return parameters of search coordinates."""
        return np.array([one.back(value) for one, value in zip(self.coordinates, x, strict=True)])

    def search(self, start: np.ndarray, low: np.ndarray, high: np.ndarray, **options):
        """Minimise from a start within bounds, all given as parameters; the result is in search coordinates."""
        to = self.to_search
        return minimise(self.search_normal, to(start), to(low), to(high), **options)


@dataclass(frozen=True, eq=False)
class Estimate:
    """
    A search's result as parameters, in the order of the problem's full vector; `normal` is taken there.

    `covariance` is 0 in rows of fixed parameters and NaN in rows of those at a bound; `inverse` is the inverse of
    `normal.matrix`, the information matrix, for the `free` ones.
    """

    problem: Problem
    theta: np.ndarray
    covariance: np.ndarray
    fixed: np.ndarray
    search: Minimum
    normal: NormalEquations
    inverse: np.ndarray
    whiteness_p: float
    noise: str

    @property
    def free(self) -> np.ndarray:
        """Numbers of the parameters that were estimated."""
        return np.flatnonzero(~self.fixed & ~self.search.at_bound)

    @property
    def status(self) -> list[str]:
        """Whether each value was estimated, is fixed, or is held by a bound."""
        return np.where(self.fixed, "fixed", np.where(self.search.at_bound, "at bound", "estimated")).tolist()

    @property
    def sigma(self) -> np.ndarray:
        """Standard deviation of the residuals of each output, √(Σ e²/(n − p)); p is shared out over the outputs."""
        counts = self.problem.counts
        return np.sqrt(self.normal.squares / np.maximum(counts - self.free.size / counts.size, 1.0))


def estimate(problem: Problem, start: np.ndarray, limits: Mapping, noise: str = "auto") -> Estimate:
    """Search from `start` within the limits of every name, then give covariance and diagnostics."""
    low, high = (problem.vector({name: pair[side] for name, pair in limits.items()}) for side in (0, 1))
    fixed = low == high
    search = problem.search(start, low, high)
    at_bound, theta = search.at_bound, problem.from_search(search.x)
    # The way to the search coordinate and back rounds: what is fixed or at a bound gets its exact value.
    theta[fixed] = low[fixed]
    theta[at_bound] = np.clip(theta, low, high)[at_bound]
    normal = problem.normal(theta)
    if not normal.finite:
        values = ", ".join(f"{name} = {value:.4g}" for name, value in zip(problem.names, theta, strict=True))
        raise ValueError(
            f"structure {problem.structure.name!r} simulates values that are not finite at {values}; start elsewhere "
            "with guess={...} or narrow the bounds"
        )
    free = np.flatnonzero(~fixed & ~at_bound)
    inverse = _inverse(normal.matrix, free, problem)
    residuals = problem.residuals()
    # Residuals of an exact fit are rounding: there is no noise to call white or not.
    exact = normal.squares <= 1e-4 * problem.floors
    p_value = min(1.0 if exact[j] else whiteness_p(own) for j, own in enumerate(residuals))
    robust = noise == "hac" or (noise == "auto" and p_value < 1e-3)
    # The inverse information matrix is the covariance for white residuals; else it is the bread of a sandwich.
    meat = _meat(problem, residuals, normal.squares)[np.ix_(free, free)] if robust else None
    covariance = np.zeros((theta.size, theta.size))
    covariance[at_bound, :] = covariance[:, at_bound] = np.nan
    covariance[np.ix_(free, free)] = sandwich(inverse, meat, problem.counts.sum())
    allowed_for = "hac" if robust else "white"
    return Estimate(problem, theta, covariance, fixed, search, normal, inverse, float(p_value), allowed_for)


def _inverse(matrix: np.ndarray, free: np.ndarray, problem: Problem) -> np.ndarray:
    """Invert the free part of the information matrix, or name what it says nothing about."""
    part = matrix[np.ix_(free, free)]
    if free.size == 0:
        return part
    diagonal = np.diag(part).copy()
    lost = diagonal <= 1e-30 * diagonal.max(initial=1e-300)
    if not lost.any():
        # Scaled to unit diagonal, so that the units of the parameters do not decide what is singular.
        scale = np.sqrt(diagonal)
        values, vectors = np.linalg.eigh(part / np.outer(scale, scale))
        if values[0] > SINGULAR:
            return (vectors / values) @ vectors.T / np.outer(scale, scale)
        # Parameters with a share in the direction that the data say nothing about.
        lost = np.abs(vectors[:, 0]) > 0.25
    names = tuple(problem.names[free[j]] for j in np.flatnonzero(lost))
    raise IdentificationError(
        f"these data do not determine {' and '.join(names)} ({_why(problem)}); record phases that move the model more, "
        f"or fix a parameter, for example fixed={{{names[-1].split('[')[0]!r}: ...}}",
        names,
    )


def _why(problem: Problem) -> str:
    """Say what about the data makes parameters indistinguishable."""
    structure = problem.structure
    if "mode" in structure.inputs:
        modes = joined(problem.runs, "mode")
        if np.ptp(modes) == 0.0:
            return f"mode never changes: it is {modes[0]:g} throughout"
    ranges = [f"{name} moves by {np.ptp(joined(problem.runs, name)):.3g}" for name in structure.outputs]
    return "several values explain them equally well; " + " and ".join(ranges)


def _meat(problem: Problem, residuals: list, squares: np.ndarray) -> np.ndarray:
    """Return the long-run covariance of the likelihood's scores, summed over runs."""
    weights, size = problem.weights(squares), len(problem.names)
    meat = np.zeros((size, size))
    lags = max(hac_lags(own) for own in residuals)
    for i, run in enumerate(problem.runs):
        where = problem.where[i]
        scores = np.zeros((run.size, where.size))
        for j, jacobian in enumerate(problem.latest[i][1]):
            scores[:, problem.moved[j]] += weights[j] * jacobian * residuals[j][i][:, None]
        meat[np.ix_(where, where)] += hac_matrix(scores, lags)
    return meat
