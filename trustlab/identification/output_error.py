"""
The output-error method for any structure: the likelihood, its maximum, and the covariance.

A structure simulates the outputs from the inputs and the parameters θ alone; what the log shows
beyond that, e(θ) = y − ŷ(θ), is noise. It is white, or an AR(1) process plus white noise, whose
Kalman filter leaves prediction errors. The estimate maximises the Gaussian likelihood of these.

[L] Ljung, *System Identification: Theory for the User*, 2nd ed., 1999.
[S] Söderström and Stoica, *System Identification*, 1989.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from trustlab.identification.least_squares import Minimum, NormalEquations, minimise
from trustlab.identification.logged import counts, undo_window, window_means
from trustlab.identification.residuals import (
    FAR,
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
"""Deviance above the best optimum, both searched roughly, up to which an optimum is searched on."""

ROUGH_SEARCH: dict = {"tolerance": 0.1, "max_iterations": 40}
"""How optima are searched before the best is known."""

SINGULAR = 1e-10
"""Smallest eigenvalue of a regular information matrix, scaled to unit diagonal."""

ROUNDING_IN_SEARCH = 1e-6
ROUNDING = 1e-4
"""Shares of the floor of Σ e² below which residuals are mere rounding: in a search, which goes on
until nothing is to be gained, and where it has ended."""

LIKELY = 3.84
"""Deviance above the least up to which a single parameter's value lies in its 95 % interval."""

SWITCHES = 40
"""Switches of mode per session beyond which errors of their stamps are worked out for a sample."""


# --- the likelihood -------------------------------------------------------------------------------


@dataclass(eq=False)
class OutputSeries:
    """
    One output of one run: the data, the unknowns that move it, and its latest prediction errors.

    `places` are those unknowns in the full vector, `square` in a matrix of that size.
    """

    run: int
    output: int
    measured: np.ndarray
    missing: np.ndarray
    places: np.ndarray
    square: tuple
    error: np.ndarray = field(default_factory=lambda: np.empty(0))
    jacobian: np.ndarray = field(default_factory=lambda: np.empty(0))


class Problem:
    """
    A structure and the runs that it is to explain, with the likelihood of the prediction errors.

    The full vector holds the shared parameters, then each run's initial states. With `unwindow` the
    noise is in the values that window means are made of, and these values are compared.
    """

    def __init__(
        self, structure: Structure, runs: list[Run], guess: Mapping, unwindow: bool = False
    ):
        self.structure = structure
        self.runs = runs
        self.unwindow = unwindow
        self.noise = [Noise()] * len(structure.outputs)
        self.log_determinant = 0.0
        self.simulations: list = [None] * len(runs)
        self.evaluated: tuple = (None, None)  # the latest point, and the equations there
        self.shared = len(structure.parameters)
        self.states = len(structure.initial)
        coordinates = [parameter.coordinate(guess) for parameter in structure.unknowns]
        self.coordinates = coordinates[: self.shared] + coordinates[self.shared :] * len(runs)
        firsts = [self.shared + i * self.states for i in range(len(runs))]
        self.places = [np.r_[: self.shared, first : first + self.states] for first in firsts]
        self.affecting = [structure.columns_of(name) for name in structure.outputs]
        self.series = [
            self._series(i, j) for i in range(len(runs)) for j in range(len(structure.outputs))
        ]
        columns = [joined(runs, name) for name in structure.outputs]
        self.counts = np.array([column.size for column in columns], dtype=float)
        # The likelihood of data that are reproduced exactly is infinite: Σ e² has a floor at a
        # billionth of the scale.
        scale = [max(float(np.sqrt(np.mean(column**2))), 1e-300) for column in columns]
        self.floors = self.counts * (1e-9 * np.array(scale)) ** 2

    def _series(self, i: int, j: int) -> OutputSeries:
        run = self.runs[i]
        measured = run[self.structure.outputs[j]]
        if self.unwindow and run.window > 1:
            measured = undo_window(measured, run.window)
        places = self.places[i][self.affecting[j]]
        return OutputSeries(
            i, j, measured, np.zeros(run.size, bool), places, np.ix_(places, places)
        )

    def series_of(self, output: int) -> list[OutputSeries]:
        """Return one output of all runs."""
        return self.series[output :: len(self.structure.outputs)]

    @property
    def names(self) -> list[str]:
        """Names in the full vector; initial states carry the number of their run."""
        names = self.structure.names
        shared, initial = names[: self.shared], names[self.shared :]
        if len(self.runs) == 1:
            return [*shared, *initial]
        return [*shared, *(f"{name}[{i}]" for i in range(len(self.runs)) for name in initial)]

    def vector(self, values: Mapping) -> np.ndarray:
        """Return the full vector of values by name; an initial state may have one value per run."""
        values_in_order = [values[name] for name in self.structure.names]
        states = [np.broadcast_to(v, len(self.runs)) for v in values_in_order[self.shared :]]
        return np.array(
            [*values_in_order[: self.shared], *np.ravel(states, order="F")], dtype=float
        )

    def ends(self, limits: Mapping) -> tuple[np.ndarray, np.ndarray]:
        """Return the lower and the upper end of every unknown as full vectors."""
        low = self.vector({name: pair[0] for name, pair in limits.items()})
        return low, self.vector({name: pair[1] for name, pair in limits.items()})

    def values(self, run: int, theta: np.ndarray) -> dict[str, float]:
        """Return parameters and initial states of one run by name."""
        return dict(zip(self.structure.names, theta[self.places[run]], strict=True))

    def simulate(self, theta: np.ndarray) -> None:
        """Simulate every run: outputs and their derivatives ([L] Section 10.3)."""
        for i, run in enumerate(self.runs):
            checked = self.simulations[i] is not None
            self.simulations[i] = self.structure.predict(run, self.values(i, theta))
            if not checked:
                self.structure.check_sensitivities(run, *self.simulations[i])

    def normal_equations(self, theta: np.ndarray) -> NormalEquations:
        """Return the likelihood, its gradient and its Gauss–Newton matrix ([L] Section 10.2)."""
        size = theta.size
        outputs = len(self.structure.outputs)
        squares = np.zeros(outputs)
        gradients = np.zeros((outputs, size))
        matrices = np.zeros((outputs, size, size))
        self.simulate(theta)
        self.log_determinant = 0.0
        for series in self.series:
            columns, log_determinant = self.whitened(series, *self.differences(series))
            series.error, series.jacobian = columns
            self.log_determinant += log_determinant
            j = series.output
            squares[j] += series.error @ series.error
            gradients[j, series.places] += series.error @ series.jacobian
            matrices[j][series.square] += series.jacobian.T @ series.jacobian
        # The variance of each output maximises the likelihood at Σ e²/n. What is left of minus
        # twice its logarithm is Σ n ln(Σ e²), but for a constant ([L] Section 7.4, [S] Section
        # 7.2); its derivatives weight each output by n/Σ e², so that users need give no weights.
        weights = self.weights(squares)
        value = float(self.counts @ np.log(squares + self.floors))
        exact = bool((squares <= ROUNDING_IN_SEARCH * self.floors).all())
        matrix = (weights @ matrices.reshape(outputs, -1)).reshape(size, size)
        equations = NormalEquations(value, weights @ gradients, matrix, squares, exact)
        self.evaluated = (theta.copy(), equations)
        return equations

    def differences(self, series: OutputSeries) -> tuple[np.ndarray, np.ndarray]:
        """Return measured minus simulated at the latest point, and the simulation's derivatives."""
        outputs, jacobians = self.simulations[series.run]
        simulated = self.observed(series, outputs[series.output])
        return series.measured - simulated, self.observed(series, jacobians[series.output])

    def observed(self, series: OutputSeries, values: np.ndarray) -> np.ndarray:
        """Return simulated values as the log has them: averaged, where noise is in the means."""
        window = self.runs[series.run].window
        return values if window == 1 or self.unwindow else window_means(values, window)

    def fitted(self) -> list[list[np.ndarray]]:
        """Return the outputs at the latest point as the log would have them, by run."""
        return [
            [y if run.window == 1 else window_means(y, run.window) for y in outputs]
            for run, (outputs, _) in zip(self.runs, self.simulations, strict=True)
        ]

    def residuals(self) -> list[list[np.ndarray]]:
        """Return the prediction errors at the latest point, by output, then by run."""
        outputs = range(len(self.structure.outputs))
        return [[series.error for series in self.series_of(j)] for j in outputs]

    def whitened(
        self, series: OutputSeries, *columns: np.ndarray
    ) -> tuple[list[np.ndarray], float]:
        """
        Return an output's Kalman prediction errors and the log-determinant of the noise.

        Further columns are filtered alike ([L] Section 4.3, [S] Section 7.3).
        """
        noise = self.noise[series.output]
        if noise == Noise() and not series.missing.any():
            return list(columns), 0.0
        errors, log_determinant = prediction_errors(np.column_stack(columns), series.missing, noise)
        return [errors[:, 0], errors[:, 1:]][: len(columns)], log_determinant

    def leave_out(self) -> bool:
        """Mark outliers among the residuals as missing; return whether there are new ones."""
        samples = sum(run.size for run in self.runs)
        marks = []
        for j in range(len(self.structure.outputs)):
            errors = [self.differences(series)[0] for series in self.series_of(j)]
            clean = [e[~s.missing] for e, s in zip(errors, self.series_of(j), strict=True)]
            scale = robust_deviation(clean)
            marks.append([outliers(error, scale) for error in errors])
            # More than a quarter are no outliers: the model does not describe these data.
            if sum(mark.sum() for mark in marks[j]) >= 0.25 * samples:
                return False
        pairs = [(series, marks[series.output][series.run]) for series in self.series]
        if all(np.array_equal(mark, series.missing) for series, mark in pairs):
            return False
        for series, mark in pairs:
            series.missing = mark
        self.counts = np.array([sum(float((~m).sum()) for m in of_output) for of_output in marks])
        return True

    def fit_noise(self, free: np.ndarray) -> None:
        """Fit the noise of each output to its residuals; `free` parameters are estimated."""
        for j in range(len(self.noise)):
            parts = []
            for series in self.series_of(j):
                error, jacobian = self.differences(series)
                used = np.isin(series.places, free)
                places = np.r_[0, 1 + np.searchsorted(free, series.places[used])]
                columns = np.column_stack([error, jacobian[:, used]])
                parts.append((columns, series.missing, places))
            self.noise[j] = fit_noise(parts, self.counts[j])

    def deviance(self, squares: np.ndarray) -> float:
        """
        Return minus twice the log-likelihood at its greatest, but for a constant of the data.

        A sample left out counts as one that is `FAR` deviations off: optima that leave out
        different samples can then be compared, in whatever unit the data are.
        """
        of_window = 0.0
        if self.unwindow:
            # The means of n values have 1/n times the density of the values themselves.
            of_window = sum(np.log(counts(run.size, run.window)).sum() for run in self.runs)
        outputs = range(len(self.structure.outputs))
        left_out = np.array([sum(s.missing.sum() for s in self.series_of(j)) for j in outputs])
        value = (self.counts + left_out) @ np.log((squares + self.floors) / self.counts)
        value += FAR**2 * left_out.sum()
        return float(value) + self.log_determinant - 2.0 * len(self.noise) * float(of_window)

    def weights(self, squares: np.ndarray) -> np.ndarray:
        """Return the weight n/Σ e² of every output."""
        return self.counts / (squares + self.floors)

    def search(
        self, start: np.ndarray, low: np.ndarray, high: np.ndarray, **options: Any
    ) -> Minimum:
        """Minimise from a start within bounds, given as parameters; return search coordinates."""

        def equations(x: np.ndarray) -> NormalEquations:
            at = self.normal_equations(self.from_search(x))
            pairs = zip(self.coordinates, x, strict=True)
            slope = np.array([coordinate.slope(value) for coordinate, value in pairs])
            matrix = at.matrix * np.outer(slope, slope)
            return NormalEquations(at.value, at.gradient * slope, matrix, at.squares, at.exact)

        to = self.to_search
        return minimise(equations, to(start), to(low), to(high), **options)

    def to_search(self, theta: np.ndarray) -> np.ndarray:
        """Return search coordinates of parameters."""
        pairs = zip(self.coordinates, theta, strict=True)
        return np.array([coordinate.to(value) for coordinate, value in pairs])

    def from_search(self, x: np.ndarray) -> np.ndarray:
        """Return parameters of search coordinates."""
        pairs = zip(self.coordinates, x, strict=True)
        return np.array([coordinate.back(value) for coordinate, value in pairs])


# --- its maximum ----------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class LocalOptimum:
    """Where a search settled: parameters, likelihood there, and which parameters are `free`."""

    problem: Problem
    search: Minimum
    theta: np.ndarray
    equations: NormalEquations
    deviance: float
    free: np.ndarray

    @property
    def exact(self) -> np.ndarray:
        """Whether an output's residuals are mere rounding, by output: no noise to be tested."""
        return self.equations.squares <= ROUNDING * self.problem.floors

    def whiteness_p(self) -> float:
        """Return the least p value of the Ljung–Box tests of all outputs ([S] Section 11.2)."""
        residuals = self.problem.residuals()
        tests = [1.0 if self.exact[j] else whiteness_p(e) for j, e in enumerate(residuals)]
        return float(min(tests))

    def inverse_information(self) -> np.ndarray:
        """
        Return the inverse of the information matrix of the free parameters.

        Where the matrix is singular, raise: the parameters involved are not identifiable.
        """
        free = self.free
        names = self.problem.names
        matrix = self.equations.matrix[np.ix_(free, free)]
        if free.size == 0:
            return matrix
        diagonal = np.diag(matrix).copy()
        unknown = diagonal <= 1e-30 * diagonal.max(initial=1e-300)
        if not unknown.any():
            # Scaled to unit diagonal, so that the units of the parameters do not decide what is
            # singular.
            scale = np.sqrt(diagonal)
            values, vectors = np.linalg.eigh(matrix / np.outer(scale, scale))
            if values[0] > SINGULAR:
                return (vectors / values) @ vectors.T / np.outer(scale, scale)
            # Parameters with a share in the direction that the data say nothing about.
            unknown = np.abs(vectors[:, 0]) > 0.25
        lost = tuple(names[free[j]] for j in np.flatnonzero(unknown))
        raise IdentificationError(
            f"these data do not determine {' and '.join(lost)} ({_cause(self.problem)}); record "
            "phases that move the model more, or fix a parameter, for example "
            f"fixed={{{lost[-1].split('[')[0]!r}: ...}}",
            lost,
        )


def _cause(problem: Problem) -> str:
    """Say what about the data makes parameters indistinguishable."""
    structure = problem.structure
    if "mode" in structure.inputs:
        modes = joined(problem.runs, "mode")
        if np.ptp(modes) == 0.0:
            return f"mode never changes: it is {modes[0]:g} throughout"
        if all(np.ptp(run["mode"]) == 0.0 for run in problem.runs):
            return f"mode never changes within any of the {len(problem.runs)} runs"
    ranges = [
        f"{name} moves by {np.ptp(joined(problem.runs, name)):.3g}" for name in structure.outputs
    ]
    return "several values explain them equally well; " + " and ".join(ranges)


def local_optimum(
    problem: Problem, start: np.ndarray, limits: Mapping, robust: bool, rough: bool = False
) -> LocalOptimum:
    """Search from `start` within the limits, and again without the outliers that show."""
    options = ROUGH_SEARCH if rough else {}
    optimum = _search(problem, start, limits, **options)
    for _ in range(5):
        searchable = optimum.equations.finite and not optimum.exact.all()
        if not robust or not searchable or not problem.leave_out():
            break
        optimum = _search(problem, optimum.theta, limits, **options)
    return optimum


def _search(problem: Problem, start: np.ndarray, limits: Mapping, **options: Any) -> LocalOptimum:
    """Search from `start` within the limits."""
    low, high = problem.ends(limits)
    minimum = problem.search(start, low, high, **options)
    theta = problem.from_search(minimum.x)
    # The way to the search coordinate and back rounds: what is fixed or at a bound gets its exact
    # value.
    fixed = low == high
    at_bound = minimum.at_bound
    theta[fixed] = low[fixed]
    theta[at_bound] = np.clip(theta, low, high)[at_bound]
    # The search mostly ends where it evaluated last.
    point, equations = problem.evaluated
    if not np.array_equal(point, theta):
        equations = problem.normal_equations(theta)
    deviance = problem.deviance(equations.squares) if equations.finite else np.inf
    return LocalOptimum(
        problem, minimum, theta, equations, deviance, np.flatnonzero(~fixed & ~at_bound)
    )


# --- its curvature: covariance and diagnostics ----------------------------------------------------


class ModeDelay(NamedTuple):
    """
    Delay of the mode behind its stamp [s], as residuals show it.

    `shift` is the change of the estimates per second of delay.
    """

    value: float
    stderr: float
    shift: np.ndarray


@dataclass(frozen=True, eq=False)
class Estimate(LocalOptimum):
    """
    The best optimum with covariance and diagnostics.

    `covariance` is 0 in rows of fixed parameters and NaN in rows of those at a bound; `inverse` is
    the inverse information matrix of the `free` ones. `simple_p` is the p value of the whiteness
    test before the noise was modelled; `sandwiched` says that the covariance allows for remaining
    correlation. `delay` is that of the mode. `rivals` are optima nearly as likely.
    """

    limits: Mapping
    fixed: np.ndarray
    covariance: np.ndarray
    inverse: np.ndarray
    simple_p: float
    noise: str
    sandwiched: bool
    delay: ModeDelay
    rivals: tuple[LocalOptimum, ...] = ()

    @property
    def degrees_of_freedom(self) -> float:
        """Samples less parameters; for correlated noise, those of the slowest output."""
        problem = self.problem
        least = problem.counts.sum() - self.free.size
        for count, columns, noise in zip(
            problem.counts, problem.affecting, problem.noise, strict=True
        ):
            if noise.share > 0.0:
                # An AR(1) process tells its size as n (1 − φ)/(1 + φ) independent values would; the
                # fit uses up some.
                values = count * (1.0 - noise.memory) / (1.0 + noise.memory)
                least = min(least, max(values - np.isin(columns, self.free).sum(), 3.0))
        return float(least)

    @property
    def status(self) -> list[str]:
        """Whether each value was estimated, is fixed, or is held by a bound."""
        status = np.where(self.search.at_bound, "at bound", "estimated")
        return np.where(self.fixed, "fixed", status).tolist()

    @property
    def sigma(self) -> np.ndarray:
        """Standard deviation √(Σ e²/(n − p)) by output; p is shared out over the outputs."""
        counts = self.problem.counts
        freedom = np.maximum(counts - self.free.size / counts.size, 1.0)
        return np.sqrt(self.equations.squares / freedom)


def fit_problem(
    problem: Problem, start: np.ndarray, limits: Mapping, noise: str = "auto", robust: bool = True
) -> Estimate:
    """Search from `start`, leave out outliers, model the noise; then covariance and diagnostics."""
    optimum = local_optimum(problem, start, limits, robust)
    if not optimum.equations.finite:
        pairs = zip(problem.names, optimum.theta, strict=True)
        raise ValueError(
            f"structure {problem.structure.name!r} simulates values that are not finite at "
            f"{', '.join(f'{name} = {value:.4g}' for name, value in pairs)}; start elsewhere with "
            "guess={...} or narrow the bounds"
        )
    simple_p = optimum.whiteness_p()
    if noise == "correlated" or (noise == "auto" and simple_p < NOT_WHITE):
        # The noise model belongs to the residuals, and these to the parameters: three rounds settle
        # both.
        for _ in range(3):
            problem.fit_noise(optimum.free)
            optimum = _search(problem, optimum.theta, limits)
    inverse = optimum.inverse_information()
    modelled = any(model != Noise() for model in problem.noise)
    p_value = optimum.whiteness_p() if modelled else simple_p
    sandwiched = noise == "hac" or (noise in ("auto", "correlated") and p_value < NOT_WHITE)
    delay = _mode_delay(optimum, inverse, sandwiched)
    low, high = problem.ends(limits)
    covariance = _covariance(optimum, inverse, sandwiched, delay)
    shift = _shift_by_states_at_bound(optimum, limits)
    # The shift is to where the deviance has risen by LIKELY = 1.96²: as a variance, by its square.
    covariance[np.ix_(optimum.free, optimum.free)] += np.outer(shift, shift) / LIKELY
    return Estimate(
        **vars(optimum),
        limits=limits,
        fixed=low == high,
        covariance=covariance,
        inverse=inverse,
        simple_p=simple_p,
        noise="correlated" if modelled else "hac" if sandwiched else "white",
        sandwiched=sandwiched,
        delay=delay,
    )


def _covariance(
    optimum: LocalOptimum, inverse: np.ndarray, sandwiched: bool, delay: ModeDelay
) -> np.ndarray:
    """Return the covariance of the full vector: of noise, and of errors of the mode's stamps."""
    problem, free = optimum.problem, optimum.free
    # For white residuals the covariance is the inverse information ([L] Section 9.4, [S] Section
    # 7.5); else that is the bread of a sandwich.
    meat = _meat(optimum)[np.ix_(free, free)] if sandwiched else None
    block = sandwich(inverse, meat, problem.counts.sum()) + _stamp_covariance(optimum, inverse)
    if any(run.stamp_error > 0.0 for run in problem.runs):
        # Stamps that are not exact may share an error, too: of any size that the residuals allow.
        square = delay.value**2 + delay.stderr**2
        block += square * np.outer(delay.shift, delay.shift)
    covariance = np.zeros((optimum.theta.size, optimum.theta.size))
    at_bound = optimum.search.at_bound
    covariance[at_bound, :] = covariance[:, at_bound] = np.nan
    covariance[np.ix_(free, free)] = block
    return covariance


def _shift_by_states_at_bound(optimum: LocalOptimum, limits: Mapping) -> np.ndarray:
    """
    Return how far estimates move if initial states at a bound leave it as far as data allow.

    These states are moved together, equally far in their search coordinates, and the rest is
    estimated again (the profile of the likelihood), up to a deviance LIKELY above the least.
    """
    problem = optimum.problem
    places = np.flatnonzero(optimum.search.at_bound)
    places = places[places >= problem.shared]
    if places.size == 0 or optimum.free.size == 0 or optimum.exact.all():
        return np.zeros(optimum.free.size)
    low, high = (problem.to_search(end) for end in problem.ends(limits))
    bound = problem.to_search(optimum.theta)[places]
    inwards = np.where(bound == low[places], 1.0, -1.0) * (high - low)[places]
    inwards[~np.isfinite(inwards)] = 0.0
    near, far = 1e-4, 1.0  # shares of the way to the other bound
    likely = optimum
    for _ in range(7):
        share = np.sqrt(near * far)
        theta = problem.to_search(optimum.theta)
        theta[places] = bound + share * inwards
        theta = problem.from_search(theta)
        moved = _search(problem, theta, _holding(problem, limits, places, theta))
        if moved.deviance < optimum.deviance + LIKELY:
            near, likely = share, moved
        else:
            far = share
    problem.normal_equations(optimum.theta)
    return (likely.theta - optimum.theta)[optimum.free]


def _holding(problem: Problem, limits: Mapping, places: np.ndarray, theta: np.ndarray) -> dict:
    """Return limits that hold some initial states, by their places, at values."""
    low, high = problem.ends(limits)
    low[places] = high[places] = theta[places]
    states = problem.structure.names[problem.shared :]
    held = {}
    for j, name in enumerate(states):
        of_runs = slice(problem.shared + j, None, problem.states)
        held[name] = (low[of_runs], high[of_runs])
    return {**limits, **held}


def _meat(optimum: LocalOptimum) -> np.ndarray:
    """Return the long-run covariance of the likelihood's scores, summed over runs."""
    problem = optimum.problem
    weights = problem.weights(optimum.equations.squares)
    size = optimum.theta.size
    meat = np.zeros((size, size))
    lags = max(hac_lags(errors) for errors in problem.residuals())
    for i, (run, places) in enumerate(zip(problem.runs, problem.places, strict=True)):
        scores = np.zeros((run.size, places.size))
        for series in problem.series:
            if series.run == i:
                columns = problem.affecting[series.output]
                score = weights[series.output] * series.jacobian * series.error[:, None]
                scores[:, columns] += score
        meat[np.ix_(places, places)] += hac_matrix(scores, lags)
    return meat


def _stamp_covariance(optimum: LocalOptimum, inverse: np.ndarray) -> np.ndarray:
    """Return the covariance due to independent errors of the mode's stamps."""
    problem, free = optimum.problem, optimum.free
    weights = problem.weights(optimum.equations.squares)
    added = np.zeros((free.size, free.size))
    for i, run in enumerate(problem.runs):
        if run.stamp_error == 0.0 or "mode" not in run.columns:
            continue
        mode = run["mode"]
        values = problem.values(i, optimum.theta)
        of_run = [series for series in problem.series if series.run == i]
        switches = np.flatnonzero(np.diff(mode > 0.5)) + 1
        # Neighbours add about the same: of thousands of switches some stand for all.
        chosen = switches[:: 1 + switches.size // SWITCHES]
        for k in chosen:
            # One switch a sample later, and what the estimates make of it.
            moved = mode.copy()
            moved[k] = mode[k - 1]
            outputs, _ = problem.structure.predict(run.changed({"mode": moved}), values)
            by_all = np.zeros(optimum.theta.size)
            for series in of_run:
                j = series.output
                change = outputs[j] - problem.simulations[i][0][j]
                change = problem.observed(series, change) / run.sample_time
                (change,), _ = problem.whitened(series, change)
                by_all[series.places] += weights[j] * (change @ series.jacobian)
            shift = run.stamp_error * inverse @ by_all[free]
            added += np.outer(shift, shift) * switches.size / chosen.size
    return added


def _mode_delay(optimum: LocalOptimum, inverse: np.ndarray, sandwiched: bool) -> ModeDelay:
    """Return the delay of the mode that the residuals show, to first order; 0 if they cannot."""
    problem, free = optimum.problem, optimum.free
    weights = problem.weights(optimum.equations.squares)
    inputs = set(problem.structure.inputs)
    if not {"mode"} <= inputs <= {"mode", "p_h"} or "mode_delay" in problem.structure.names:
        return ModeDelay(0.0, 0.0, np.zeros(free.size))
    slopes = []
    by_all = np.zeros(optimum.theta.size)
    for series in problem.series:
        # Mode acting later shifts the whole simulation, but for initial states, which are
        # estimated.
        simulated = problem.simulations[series.run][0][series.output]
        sample_time = problem.runs[series.run].sample_time
        slope = -np.gradient(problem.observed(series, simulated), sample_time)
        (slope,), _ = problem.whitened(series, slope)
        slopes.append(slope)
        by_all[series.places] += weights[series.output] * (slope @ series.jacobian)
    answer = np.zeros(by_all.size)
    answer[free] = inverse @ by_all[free]
    total = information = score = spread = 0.0
    for series, slope in zip(problem.series, slopes, strict=True):
        weight = weights[series.output]
        # What of the delay's effect the estimates cannot imitate.
        rest = slope - series.jacobian @ answer[series.places]
        total += weight * (slope @ slope)
        information += weight * (rest @ rest)
        score += weight * (rest @ series.error)
        if sandwiched:
            products = (rest * series.error)[:, None]
            spread += weight**2 * hac_matrix(products, hac_lags([series.error])).item()
    if information <= 1e-9 * total:
        return ModeDelay(0.0, 0.0, answer[free])
    stderr = np.sqrt(spread if sandwiched else information) / information
    return ModeDelay(float(score / information), float(stderr), answer[free])
