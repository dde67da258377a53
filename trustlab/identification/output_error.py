"""The output-error (prediction-error) method for any structure: likelihood, search, covariance."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import chain
from typing import NamedTuple

import numpy as np

from trustlab.identification.least_squares import Minimum, NormalEquations, minimise
from trustlab.identification.logged import counts, undo_window, window_means
from trustlab.identification.residuals import (
    Noise,
    fit_noise,
    hac_lags,
    hac_matrix,
    outliers,
    prediction_errors,
    robust_deviation,
    sandwich,
    whiteness_p,
)
from trustlab.identification.runs import Run, joined
from trustlab.identification.structure import IdentificationError, Structure

NOISES = ("auto", "white", "correlated", "hac")

NOT_WHITE = 1e-3
"""p value of the Ljung–Box test below which residuals do not count as white."""

SHALLOW = 30.0
"""
Deviance by which a valley of the likelihood may lie above the deepest found roughly and still be
searched.
"""

ROUGHLY: dict = {"tolerance": 0.1, "max_iterations": 40}
"""How valleys are searched before the deepest is known."""

SINGULAR = 1e-10
"""
Smallest eigenvalue of the information matrix, scaled to unit diagonal, that still counts as
information.
"""

SWITCHES = 40
"""
Switches of mode per session from which on errors of their stamps are worked out for some of them
only.
"""


class Problem:
    """
    A structure with the runs that it is to explain; the full vector holds the parameters, then each
    run's initial states.

    The likelihood is that of the prediction errors: of the residuals where noise is white, else of
    what a Kalman filter leaves of them. With `unwindow` the noise is in the values that the window
    means are made of, and they are compared.
    """

    def __init__(
        self, structure: Structure, runs: list[Run], guess: Mapping, unwindow: bool = False
    ):
        self.structure = structure
        self.runs = runs
        self.unwindow = unwindow
        self.noise = [Noise()] * len(structure.outputs)
        self.missing = [[np.zeros(run.size, dtype=bool) for run in runs] for _ in structure.outputs]
        self.errors: list = [[]] * len(
            runs
        )  # prediction errors and their derivatives at the latest point
        self.outliers, self.logs = 0, 0.0
        self.last: tuple = (None, None)  # the latest point, and what `normal` returned there
        self.shared, self.own = len(structure.parameters), len(structure.initial)
        one_run = [one.coordinate(guess) for one in (*structure.parameters, *structure.initial)]
        self.coordinates = one_run[: self.shared] + one_run[self.shared :] * len(runs)
        # Where the parameters and each run's own initial states stand in the full vector.
        firsts = [self.shared + i * self.own for i in range(len(runs))]
        self.where = [np.r_[: self.shared, first : first + self.own] for first in firsts]
        self.moved = [structure.columns_of(name) for name in structure.outputs]
        moved = [[where[own] for own in self.moved] for where in self.where]
        # What affects an output of a run: its places in a vector, and in a matrix.
        self.places = [[(own, np.ix_(own, own)) for own in run] for run in moved]
        # What is compared with the simulation: the log, or what its window means were made of.
        self.measured = [
            [
                undo_window(run[name], run.window) if unwindow and run.window > 1 else run[name]
                for name in structure.outputs
            ]
            for run in runs
        ]
        measured = [joined(runs, name) for name in structure.outputs]
        self.counts = np.array([values.size for values in measured], dtype=float)
        # The likelihood of data that are reproduced exactly is infinite: Σ e² has a floor at a
        # billionth of the scale.
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
        first, self.latest[run] = (
            self.latest[run] is None,
            self.structure.predict(self.runs[run], values),
        )
        if first:
            self.structure.check_sensitivities(self.runs[run], *self.latest[run])
        return self.latest[run]

    def normal(self, theta: np.ndarray) -> NormalEquations:
        """Accumulate the likelihood's gradient and Gauss–Newton matrix over all runs."""
        p, outputs = theta.size, len(self.structure.outputs)
        squares = np.zeros(outputs)
        gradients = np.zeros((outputs, p))
        matrices = np.zeros((outputs, p, p))
        self.logs = 0.0
        for i in range(len(self.runs)):
            self.predict(i, theta)
            self.errors[i] = []
            for j in range(outputs):
                (error, jacobian), logs = self.whitened(i, j, *self.differences(i, j))
                self.errors[i].append((error, jacobian))
                self.logs += logs
                squares[j] += error @ error
                where, square = self.places[i][j]
                gradients[j, where] += error @ jacobian
                matrices[j][square] += jacobian.T @ jacobian
        # With the variance of each output estimated as Σ e²/n, the likelihood is Σ n ln(Σ e²) but
        # for a constant, and its derivatives weight each output by n/Σ e²: no output needs a weight
        # from the user.
        weights = self.weights(squares)
        value = float(self.counts @ np.log(squares + self.floors))
        exact = bool((squares <= 1e-6 * self.floors).all())
        matrix = (weights @ matrices.reshape(outputs, -1)).reshape(p, p)
        self.last = (
            theta.copy(),
            NormalEquations(value, weights @ gradients, matrix, squares, exact),
        )
        return self.last[1]

    def differences(self, run: int, output: int) -> tuple[np.ndarray, np.ndarray]:
        """
        Return measured minus simulated at the latest point, and the derivatives: of window means,
        or of what they are made of.
        """
        simulated, jacobian = (one[output] for one in self.latest[run])
        return self.measured[run][output] - self.seen(run, simulated), self.seen(run, jacobian)

    def seen(self, run: int, values: np.ndarray) -> np.ndarray:
        """
        Return simulated values as they are compared with the log: averaged over the window where
        noise is in the means.
        """
        window = self.runs[run].window
        return values if window == 1 or self.unwindow else window_means(values, window)

    def fitted(self) -> list[list[np.ndarray]]:
        """Return the outputs at the latest point as the log would have them, by run."""
        return [
            [one if run.window == 1 else window_means(one, run.window) for one in outputs]
            for run, (outputs, _) in zip(self.runs, self.latest, strict=True)
        ]

    def whitened(
        self, run: int, output: int, *columns: np.ndarray
    ) -> tuple[list[np.ndarray], float]:
        """
        Return a column of one run's output, and others where given, as a Kalman filter leaves them,
        and the log determinant of the noise.
        """
        missing, noise = self.missing[output][run], self.noise[output]
        if noise == Noise() and not (self.outliers and missing.any()):
            return list(columns), 0.0
        whole, logs = prediction_errors(np.column_stack(columns), missing, noise)
        return [whole[:, 0], whole[:, 1:]][: len(columns)], logs

    def leave_out(self) -> bool:
        """
        Count outliers among the residuals as missing; return whether there are any that were not
        known.
        """
        found, few = [], True
        for j, known in enumerate(self.missing):
            own = [self.differences(i, j)[0] for i in range(len(self.runs))]
            scale = robust_deviation([error[~lost] for error, lost in zip(own, known, strict=True)])
            found.append([outliers(error, scale) for error in own])
            few = few and sum(one.sum() for one in found[-1]) < 0.25 * sum(
                run.size for run in self.runs
            )
        # More than a quarter are no outliers: the model does not describe these data.
        if not few or all(map(np.array_equal, chain(*found), chain(*self.missing))):
            return False
        self.missing, self.outliers = found, sum(int(one.sum()) for own in found for one in own)
        self.counts = np.array([sum(float((~lost).sum()) for lost in own) for own in found])
        return True

    def fit_noise(self, free: np.ndarray) -> None:
        """
        Take the noise model of each output that its residuals show at the latest point; `free`
        parameters are estimated.
        """
        for j in range(len(self.noise)):
            parts = []
            for i in range(len(self.runs)):
                error, jacobian = self.differences(i, j)
                where = self.places[i][j][0]
                used = np.isin(where, free)
                places = np.r_[0, 1 + np.searchsorted(free, where[used])]
                parts.append(
                    (np.column_stack([error, jacobian[:, used]]), self.missing[j][i], places)
                )
            self.noise[j] = fit_noise(parts, self.counts[j])

    def deviance(self, squares: np.ndarray) -> float:
        """
        Return minus twice the logarithm of the greatest likelihood, but for a constant of the data.
        """
        # The means of n values have 1/n times the density of the values themselves.
        of_window = (
            sum(np.log(counts(run.size, run.window)).sum() for run in self.runs)
            if self.unwindow
            else 0.0
        )
        value = self.counts @ np.log((squares + self.floors) / self.counts)
        return float(value) + self.logs - 2.0 * len(self.noise) * float(of_window)

    def weights(self, squares: np.ndarray) -> np.ndarray:
        """Return the weight n/Σ e² of every output."""
        return self.counts / (squares + self.floors)

    def residuals(self) -> list[list[np.ndarray]]:
        """Return the prediction errors at the latest point, by output, then by run."""
        return [
            [errors[j][0] for errors in self.errors] for j in range(len(self.structure.outputs))
        ]

    def search_normal(self, x: np.ndarray) -> NormalEquations:
        """Return `normal` in the coordinates of the search."""
        at = self.normal(self.from_search(x))
        slope = np.array([one.slope(value) for one, value in zip(self.coordinates, x, strict=True)])
        return NormalEquations(
            at.value, at.gradient * slope, at.matrix * np.outer(slope, slope), at.squares, at.exact
        )

    def to_search(self, theta: np.ndarray) -> np.ndarray:
        """Return search coordinates of parameters."""
        return np.array([one.to(value) for one, value in zip(self.coordinates, theta, strict=True)])

    def from_search(self, x: np.ndarray) -> np.ndarray:
        """Return parameters of search coordinates."""
        return np.array([one.back(value) for one, value in zip(self.coordinates, x, strict=True)])

    def search(self, start: np.ndarray, low: np.ndarray, high: np.ndarray, **options):
        """
        Minimise from a start within bounds, all given as parameters; the result is in search
        coordinates.
        """
        to = self.to_search
        return minimise(self.search_normal, to(start), to(low), to(high), **options)


class Delay(NamedTuple):
    """
    By how much later than its stamp mode acts [s], as residuals show it; `shift` is what a second
    does to the estimates.
    """

    value: float
    stderr: float
    shift: np.ndarray


@dataclass(frozen=True, eq=False)
class Estimate:
    """
    A search's result as parameters, in the order of the problem's full vector; `normal` is taken
    there.

    `covariance` is 0 in rows of fixed parameters and NaN in rows of those at a bound; `inverse` is
    the inverse of `normal.matrix`, the information matrix, for the `free` ones. `simple_p` is the p
    value of the whiteness test before the noise was modelled, `whiteness_p` after; `sandwiched`
    where the covariance allows for what is left. `delay` is that of the mode that the residuals
    show. `rivals` are valleys of the likelihood that are nearly as deep.
    """

    problem: Problem
    limits: Mapping
    theta: np.ndarray
    covariance: np.ndarray
    fixed: np.ndarray
    search: Minimum
    normal: NormalEquations
    inverse: np.ndarray
    whiteness_p: float
    simple_p: float
    noise: str
    sandwiched: bool
    delay: Delay
    rivals: tuple["Valley", ...] = ()

    @property
    def free(self) -> np.ndarray:
        """Numbers of the parameters that were estimated."""
        return np.flatnonzero(~self.fixed & ~self.search.at_bound)

    @property
    def degrees_of_freedom(self) -> float:
        """
        Samples less parameters; where noise is correlated, times that it had to change, of the
        slowest output.
        """
        problem, least = self.problem, self.problem.counts.sum() - self.free.size
        for count, moved, (share, kept) in zip(
            problem.counts, problem.moved, problem.noise, strict=True
        ):
            if share > 0.0:
                # An AR(1) process tells its size as n (1 − φ)/(1 + φ) independent values would; the
                # fit uses up some.
                own = count * (1.0 - kept) / (1.0 + kept) - np.isin(moved, self.free).sum()
                least = min(least, max(own, 3.0))
        return float(least)

    @property
    def status(self) -> list[str]:
        """Whether each value was estimated, is fixed, or is held by a bound."""
        return np.where(
            self.fixed, "fixed", np.where(self.search.at_bound, "at bound", "estimated")
        ).tolist()

    @property
    def sigma(self) -> np.ndarray:
        """
        Standard deviation of the residuals of each output, √(Σ e²/(n − p)); p is shared out over
        the outputs.
        """
        counts = self.problem.counts
        return np.sqrt(self.normal.squares / np.maximum(counts - self.free.size / counts.size, 1.0))


class Valley(NamedTuple):
    """
    Where a search settled: the minimum, its parameters, likelihood and deviance, and what was free
    to move.
    """

    problem: Problem
    found: Minimum
    theta: np.ndarray
    normal: NormalEquations
    deviance: float
    free: np.ndarray

    def inverse(self) -> np.ndarray:
        """
        Return the inverse of the information about the free parameters; raise where there is none
        about one.
        """
        free, names = self.free, self.problem.names
        part = self.normal.matrix[np.ix_(free, free)]
        if free.size == 0:
            return part
        diagonal = np.diag(part).copy()
        lost = diagonal <= 1e-30 * diagonal.max(initial=1e-300)
        if not lost.any():
            # Scaled to unit diagonal, so that the units of the parameters do not decide what is
            # singular.
            scale = np.sqrt(diagonal)
            values, vectors = np.linalg.eigh(part / np.outer(scale, scale))
            if values[0] > SINGULAR:
                return (vectors / values) @ vectors.T / np.outer(scale, scale)
            # Parameters with a share in the direction that the data say nothing about.
            lost = np.abs(vectors[:, 0]) > 0.25
        unknown = tuple(names[free[j]] for j in np.flatnonzero(lost))
        raise IdentificationError(
            f"these data do not determine {' and '.join(unknown)} ({_why(self.problem)}); record "
            "phases that move the model more, or fix a parameter, for example "
            f"fixed={{{unknown[-1].split('[')[0]!r}: ...}}",
            unknown,
        )


def settle(
    problem: Problem, start: np.ndarray, limits: Mapping, robust: bool, rough: bool = False
) -> Valley:
    """
    Search from `start` within the limits of every name, and again without the outliers that show.
    """
    low, high = (
        problem.vector({name: pair[side] for name, pair in limits.items()}) for side in (0, 1)
    )
    options = ROUGHLY if rough else {}
    valley = _search(problem, start, low, high, **options)
    for _ in range(5):
        if (
            not robust
            or not valley.normal.finite
            or _exact(problem, valley.normal).all()
            or not problem.leave_out()
        ):
            break
        valley = _search(problem, valley.theta, low, high, **options)
    return valley


def _search(
    problem: Problem, start: np.ndarray, low: np.ndarray, high: np.ndarray, **options: float
) -> Valley:
    found = problem.search(start, low, high, **options)
    theta = problem.from_search(found.x)
    # The way to the search coordinate and back rounds: what is fixed or at a bound gets its exact
    # value.
    theta[low == high] = low[low == high]
    theta[found.at_bound] = np.clip(theta, low, high)[found.at_bound]
    # The search mostly ends where it evaluated last.
    normal = problem.last[1] if np.array_equal(problem.last[0], theta) else problem.normal(theta)
    deviance = problem.deviance(normal.squares) if normal.finite else np.inf
    return Valley(
        problem, found, theta, normal, deviance, np.flatnonzero((low < high) & ~found.at_bound)
    )


def estimate(
    problem: Problem, start: np.ndarray, limits: Mapping, noise: str = "auto", robust: bool = True
) -> Estimate:
    """
    Search from `start`, leave out outliers, model the noise, then give covariance and diagnostics.
    """
    low, high = (
        problem.vector({name: pair[side] for name, pair in limits.items()}) for side in (0, 1)
    )
    valley = settle(problem, start, limits, robust)
    if not valley.normal.finite:
        values = ", ".join(
            f"{name} = {value:.4g}" for name, value in zip(problem.names, valley.theta, strict=True)
        )
        raise ValueError(
            f"structure {problem.structure.name!r} simulates values that are not finite at "
            f"{values}; start elsewhere with guess={{...}} or narrow the bounds"
        )
    simple_p = _whiteness(problem, valley.normal)
    if noise == "correlated" or (noise == "auto" and simple_p < NOT_WHITE):
        # The noise model belongs to the residuals, and these to the parameters: three rounds settle
        # both.
        for _ in range(3):
            problem.fit_noise(valley.free)
            valley = _search(problem, valley.theta, low, high)
    _, found, theta, normal, _, free = valley
    inverse, fixed = valley.inverse(), low == high
    modelled = any(one != Noise() for one in problem.noise)
    p_value = _whiteness(problem, normal) if modelled else simple_p
    sandwiched = noise == "hac" or (noise in ("auto", "correlated") and p_value < NOT_WHITE)
    # The inverse information matrix is the covariance for white residuals; else it is the bread of
    # a sandwich.
    meat = _meat(problem, normal.squares)[np.ix_(free, free)] if sandwiched else None
    covariance = np.zeros((theta.size, theta.size))
    covariance[found.at_bound, :] = covariance[:, found.at_bound] = np.nan
    covariance[np.ix_(free, free)] = sandwich(inverse, meat, problem.counts.sum())
    covariance[np.ix_(free, free)] += _of_stamps(problem, theta, inverse, free, normal.squares)
    delay = _delay(problem, inverse, free, normal.squares, sandwiched)
    if any(run.stamp_error > 0.0 for run in problem.runs):
        # Stamps that are not exact may share an error, too: of any size that the residuals allow.
        covariance[np.ix_(free, free)] += (delay.value**2 + delay.stderr**2) * np.outer(
            delay.shift, delay.shift
        )
    allowed_for = "correlated" if modelled else "hac" if sandwiched else "white"
    tests = (p_value, simple_p, allowed_for, sandwiched, delay)
    return Estimate(problem, limits, theta, covariance, fixed, found, normal, inverse, *tests)


def _exact(problem: Problem, normal: NormalEquations) -> np.ndarray:
    """
    Return for every output whether its residuals are rounding: there is no noise to call white or
    not.
    """
    return normal.squares <= 1e-4 * problem.floors


def _whiteness(problem: Problem, normal: NormalEquations) -> float:
    """Return the least p value of the Ljung–Box tests of all outputs."""
    exact = _exact(problem, normal)
    return float(
        min(1.0 if exact[j] else whiteness_p(own) for j, own in enumerate(problem.residuals()))
    )


def _why(problem: Problem) -> str:
    """Say what about the data makes parameters indistinguishable."""
    structure = problem.structure
    if "mode" in structure.inputs:
        modes = joined(problem.runs, "mode")
        if np.ptp(modes) == 0.0:
            return f"mode never changes: it is {modes[0]:g} throughout"
    ranges = [
        f"{name} moves by {np.ptp(joined(problem.runs, name)):.3g}" for name in structure.outputs
    ]
    return "several values explain them equally well; " + " and ".join(ranges)


def _of_stamps(
    problem: Problem, theta: np.ndarray, inverse: np.ndarray, free: np.ndarray, squares: np.ndarray
) -> np.ndarray:
    """
    Return what errors of the mode's stamps, independent from switch to switch, add to the
    covariance.
    """
    weights, added = problem.weights(squares), np.zeros((free.size, free.size))
    for i, run in enumerate(problem.runs):
        if run.stamp_error == 0.0 or "mode" not in run.columns:
            continue
        mode, values = (
            run["mode"],
            dict(zip(problem.structure.names, theta[problem.where[i]], strict=True)),
        )
        switches = np.flatnonzero(np.diff(mode > 0.5)) + 1
        # Neighbours add about the same: of thousands of switches some stand for all.
        chosen = switches[:: 1 + switches.size // SWITCHES]
        for k in chosen:
            # One switch a sample later, and what the estimates make of it.
            moved = mode.copy()
            moved[k] = mode[k - 1]
            late = replace(run, columns={**run.columns, "mode": moved}, kept={})
            outputs, by_all = problem.structure.predict(late, values)[0], np.zeros(theta.size)
            for j, (_, jacobian) in enumerate(problem.errors[i]):
                change = problem.seen(i, outputs[j] - problem.latest[i][0][j]) / run.sample_time
                (change,), _ = problem.whitened(i, j, change)
                by_all[problem.places[i][j][0]] += weights[j] * (change @ jacobian)
            shift = run.stamp_error * inverse @ by_all[free]
            added += np.outer(shift, shift) * switches.size / chosen.size
    return added


def _delay(
    problem: Problem, inverse: np.ndarray, free: np.ndarray, squares: np.ndarray, sandwiched: bool
) -> Delay:
    """
    Return the delay of the mode's effect that the residuals show, to first order; 0 where they
    cannot show one.
    """
    weights = problem.weights(squares)
    parts = []
    by_all = np.zeros(len(problem.names))
    inputs = set(problem.structure.inputs)
    if not {"mode"} <= inputs <= {"mode", "p_h"} or "mode_delay" in problem.structure.names:
        return Delay(0.0, 0.0, np.zeros(free.size))
    for i, run in enumerate(problem.runs):
        for j, simulated in enumerate(problem.latest[i][0]):
            # Mode acting later shifts the whole simulation, but for initial states, which are
            # estimated.
            (slope,), _ = problem.whitened(
                i, j, -np.gradient(problem.seen(i, simulated), run.sample_time)
            )
            error, jacobian = problem.errors[i][j]
            where = problem.places[i][j][0]
            by_all[where] += weights[j] * (slope @ jacobian)
            parts.append((slope, error, jacobian, where, weights[j]))
    answer = np.zeros(by_all.size)
    answer[free] = inverse @ by_all[free]
    information = score = spread = 0.0
    for slope, error, jacobian, where, weight in parts:
        own = slope - jacobian @ answer[where]
        information += weight * (own @ own)
        score += weight * (own @ error)
        if sandwiched:
            spread += weight**2 * hac_matrix((own * error)[:, None], hac_lags([error])).item()
    if information <= 1e-9 * sum(weight * (slope @ slope) for slope, *_, weight in parts):
        return Delay(0.0, 0.0, answer[free])
    stderr = np.sqrt(spread if sandwiched else information) / information
    return Delay(float(score / information), float(stderr), answer[free])


def _meat(problem: Problem, squares: np.ndarray) -> np.ndarray:
    """Return the long-run covariance of the likelihood's scores, summed over runs."""
    weights, size = problem.weights(squares), len(problem.names)
    meat = np.zeros((size, size))
    lags = max(hac_lags(own) for own in problem.residuals())
    for i, run in enumerate(problem.runs):
        where = problem.where[i]
        scores = np.zeros((run.size, where.size))
        for j, (error, jacobian) in enumerate(problem.errors[i]):
            scores[:, problem.moved[j]] += weights[j] * jacobian * error[:, None]
        meat[np.ix_(where, where)] += hac_matrix(scores, lags)
    return meat
