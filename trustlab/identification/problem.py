"""
The likelihood of a model: simulate, compare, whiten, and search where it is greatest.

What a log shows beyond the simulated outputs, e = y − ŷ, is noise: white, or an AR(1) process plus
white noise, whose Kalman filter leaves prediction errors. A model simulates many lanes in one call:
the first at the unknowns themselves, each of the others with one of them moved a little, so that
the differences are derivatives.

[L] Ljung, *System Identification: Theory for the User*, 2nd ed., 1999.
[S] Söderström and Stoica, *System Identification*, 1989.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from trustlab.identification.log import Run, counts, joined, undo_window, window_means
from trustlab.identification.model import IdentificationError, Model
from trustlab.identification.noise import FAR, Noise, fit_noise, outliers, robust_deviation, whiten
from trustlab.models.compiled import njit

# Steps of the lanes in coordinates of the search; relative where a coordinate has no scale. That of
# a load spans the kink that (2.6) has at rest and at full load.
STEP = 1e-6
STEP_OF_LOAD = 1e-4

# Smallest eigenvalue of a regular information matrix, scaled to unit diagonal.
SINGULAR = 1e-10

# Gain of a fine search's last step, in deviance.
FINE = 1e-5

# Share of the floor of Σ e² below which residuals are mere rounding.
ROUNDING = 1e-4


@njit
def _differentiate(lanes, measured, known, steps):
    """Turn simulated lanes, shape (N, L), into errors and derivatives; 0 where nothing is known."""
    for k in range(measured.size):
        first = lanes[k, 0]
        for lane in range(1, lanes.shape[1]):
            lanes[k, lane] = (lanes[k, lane] - first) / steps[lane] if known[k] else 0.0
        lanes[k, 0] = measured[k] - first if known[k] else 0.0


@dataclass(eq=False)
class Series:
    """
    One output of one run: measured, which samples count, and its columns [e J] at the last point.

    `places` are the columns' indices: 0 for the error, 1 + i for the i-th free unknown.
    """

    run: int
    output: int
    measured: np.ndarray
    known: np.ndarray
    places: np.ndarray
    plain: np.ndarray = field(default_factory=lambda: np.empty((0, 0)))
    white: np.ndarray = field(default_factory=lambda: np.empty((0, 0)))

    @property
    def errors(self) -> np.ndarray:
        """Prediction errors of the samples that count."""
        return self.white[self.known, 0]


class Equations(NamedTuple):
    """
    The likelihood at one point.

    `deviance` is −2 ln likelihood but for a constant, `matrix` the Gauss–Newton matrix of its half,
    `squares` Σ e² and `weights` n/Σ e² by output. `residual` and `root` are a problem of least
    squares with the same gradient and matrix.
    """

    deviance: float
    matrix: np.ndarray
    squares: np.ndarray
    weights: np.ndarray
    residual: np.ndarray
    root: np.ndarray


class Problem:
    """
    A model and the runs that it is to explain.

    The full vector holds the names, then the states of every run, in coordinates of the search;
    those with low < high are free. With `unwindow` the noise is in the values that window means are
    made of, and these values are compared.
    """

    def __init__(self, model: Model, runs: list[Run], limits: Mapping, unwindow: bool = False):
        self.model, self.runs = model, runs
        self.unwindow = unwindow
        self.noise = [Noise()] * len(model.outputs)
        shared, states = len(model.names), len(model.states)
        self.unknowns = [*model.names, *model.states * len(runs)]
        self.coordinates = [model.coordinate(name) for name in self.unknowns]
        self.low, self.high = (self._vector(limits, end) for end in (0, 1))
        self.free = np.flatnonzero(self.low < self.high)
        loads = [model.coordinates.get(name) == "load" for name in self.unknowns]
        self.loads = np.flatnonzero(loads)
        firsts = [shared + i * states for i in range(len(runs))]
        self.of_run = [np.r_[:shared, first : first + states] for first in firsts]
        self.series = [
            self._series(i, j) for i in range(len(runs)) for j in range(len(model.outputs))
        ]
        # The likelihood of data that are reproduced exactly is infinite: Σ e² has a floor at a
        # billionth of the scale.
        columns = [joined(runs, name) for name in model.outputs]
        scale = [max(float(np.sqrt(np.mean(column**2))), 1e-300) for column in columns]
        self.floors = np.array([c.size for c in columns]) * (1e-9 * np.array(scale)) ** 2
        self.evaluated: tuple[Any, Any] = (None, None)

    def _series(self, i: int, j: int) -> Series:
        run = self.runs[i]
        measured = run[self.model.outputs[j]]
        if self.unwindow and run.window > 1:
            measured = undo_window(measured, run.window)
        mine = np.flatnonzero(np.isin(self.free, self.of_run[i]))
        return Series(i, j, measured, np.ones(run.size, bool), np.r_[0, 1 + mine])

    def _vector(self, limits: Mapping, end: int) -> np.ndarray:
        return self.full_vector({name: pair[end] for name, pair in limits.items()})

    def full_vector(self, values: Mapping) -> np.ndarray:
        """Return the full vector of values by name; a state may have one value per run."""
        model, count = self.model, len(self.runs)
        states = [np.broadcast_to(values[name], count) for name in model.states]
        row = [*(values[name] for name in model.names), *np.ravel(states, order="F")]
        with np.errstate(divide="ignore"):
            pairs = zip(self.coordinates, row, strict=True)
            return np.array([coordinate.to(float(value)) for coordinate, value in pairs])

    def values(self, x: np.ndarray) -> np.ndarray:
        """Return the values of full vectors, shape (…, unknowns)."""
        columns = [c.back(x[..., j]) for j, c in enumerate(self.coordinates)]
        return np.stack(columns, axis=-1)

    @property
    def labels(self) -> list[str]:
        """Names in the full vector; states carry the number of their run."""
        names, runs = self.model.names, range(len(self.runs))
        if len(self.runs) == 1:
            return [*names, *self.model.states]
        return [*names, *(f"{state}[{i}]" for i in runs for state in self.model.states)]

    @property
    def counts(self) -> np.ndarray:
        """Number of samples that count, by output."""
        return np.array([sum(s.known.sum() for s in of) for of in self.by_output()], dtype=float)

    def by_output(self) -> list[list[Series]]:
        """Return the series of each output."""
        outputs = len(self.model.outputs)
        return [self.series[j::outputs] for j in range(outputs)]

    # --- the likelihood at a point ----------------------------------------------------------------

    def simulated(self, run: Run, i: int, x: np.ndarray) -> list[np.ndarray]:
        """Return the outputs, shape (N,), of a run in place of run i at a full vector."""
        row = self.values(x)[self.of_run[i]]
        values = {n: np.array([v]) for n, v in zip(self.model.unknowns, row, strict=True)}
        return [output[:, 0].copy() for output in self.model.outputs_of(run, values)]

    def observed(self, series: Series, values: np.ndarray) -> np.ndarray:
        """Return simulated values as the log has them: averaged, where noise is in the means."""
        window = self.runs[series.run].window
        return values if window == 1 or self.unwindow else window_means(values, window)

    def _simulate(self, x: np.ndarray) -> None:
        """Fill the errors and derivatives of every series."""
        loads = np.isin(self.free, self.loads)
        sizes = np.maximum(np.abs(x[self.free]), 1e-3)
        steps = np.where(loads, STEP_OF_LOAD, STEP * sizes)
        steps = np.where(x[self.free] + steps <= self.high[self.free], steps, -steps)
        lanes = np.tile(x, (1 + self.free.size, 1))
        lanes[np.arange(1, 1 + self.free.size), self.free] += steps
        rows = self.values(lanes)
        steps = np.r_[1.0, steps]
        outputs = len(self.model.outputs)
        for i, run in enumerate(self.runs):
            of_run = self.series[i * outputs : (i + 1) * outputs]
            places = of_run[0].places
            table = rows[np.ix_(places, self.of_run[i])]
            columns = dict(zip(self.model.unknowns, table.T.copy(), strict=True))
            for series, lanes_of in zip(of_run, self.model.outputs_of(run, columns), strict=True):
                series.plain = self.observed(series, lanes_of)
                _differentiate(series.plain, series.measured, series.known, steps[places])

    def equations(self, x: np.ndarray) -> Equations:
        """Return the likelihood and its derivatives at a full vector ([L] Section 10.2)."""
        if self.evaluated[0] is not None and np.array_equal(self.evaluated[0], x):
            return self.evaluated[1]
        # A step may lead to where a model is not defined: the search turns back from there.
        with np.errstate(all="ignore"):
            self._simulate(x)
        size = 1 + self.free.size
        grams = np.zeros((len(self.noise), size, size))
        log_determinant = 0.0
        for series in self.series:
            series.white = series.plain
            if self.noise[series.output] != Noise():
                series.white, logs = whiten(series.plain, series.known, self.noise[series.output])
                log_determinant += logs
            places = np.ix_(series.places, series.places)
            grams[series.output][places] += series.white.T @ series.white
        # The variance of each output maximises the likelihood at Σ e²/n. What is left of minus
        # twice its logarithm is Σ n ln(Σ e²/n) ([L] Section 7.4, [S] Section 7.2); its derivatives
        # weight each output by n/Σ e², so that users need give no weights.
        squares, counted = grams[:, 0, 0], self.counts
        weights = counted / (squares + self.floors)
        deviance = float(counted @ np.log(1.0 / weights)) + log_determinant
        gram = np.tensordot(weights, grams, 1)
        residual, root = _least_squares(gram)
        equations = Equations(deviance, gram[1:, 1:], squares, weights, residual, root)
        self.evaluated = (x.copy(), equations)
        return equations

    # --- the search -------------------------------------------------------------------------------

    def search(
        self, x: np.ndarray, tolerance: float = FINE, most: int = 40, method: str = "dogbox"
    ) -> "Optimum":
        """Return the optimum next to a full vector; its last step gained less than `tolerance`."""
        x = np.clip(x, self.low, self.high)
        first = self.equations(x)
        if not np.isfinite(first.deviance + first.matrix.sum()):
            values = zip(self.labels, self.values(x), strict=True)
            raise ValueError(
                "the model simulates values that are not finite at "
                f"{', '.join(f'{name} = {value:.4g}' for name, value in values)}; start elsewhere "
                "with guess={...} or narrow the bounds"
            )
        moving = np.ones(self.free.size, bool)
        x, held, converged, steps = self.descend(x, moving, tolerance, most, method)
        ends = np.where(x - self.low < self.high - x, self.low, self.high)
        at_end = np.isin(self.free, self.loads) & (np.abs(x - ends)[self.free] < STEP_OF_LOAD)
        if not converged and (at_end.any() or tolerance <= FINE):
            # (2.6) has a kink at rest and at full load, which defies any quadratic model: a search
            # that does not settle there goes on with the others. One that is to be fine goes on.
            x[self.free[at_end]] = ends[self.free[at_end]]
            x, held, converged, more = self.descend(x, ~at_end, tolerance, 4 * most)
            held, steps = held | at_end, steps + more
        at_bound = np.zeros(x.size, bool)
        at_bound[self.free] = held
        return Optimum(self, x, at_bound, converged, steps)

    def descend(
        self,
        start: np.ndarray,
        moving: np.ndarray,
        tolerance: float,
        most: int,
        method: str = "dogbox",
    ) -> tuple[np.ndarray, np.ndarray, bool, int]:
        """
        Search with some of the free unknowns moving.

        Return where it ended, which of the free unknowns a bound holds, whether it settled, and
        after how many evaluations.
        """
        from scipy.optimize import least_squares

        places = self.free[moving]
        held = np.zeros(self.free.size, bool)
        if places.size == 0:
            return start, held, True, 1
        # A search for least squares uses no more of f and J than |f|², Jᵀf and JᵀJ. Those of the
        # likelihood itself fit in one row more than there are unknowns.
        floor = float(self.counts @ np.log(self.floors / self.counts)) - 30.0 * self.counts.sum()

        def at(x: np.ndarray) -> np.ndarray:
            full = start.copy()
            full[places] = x
            return full

        def residuals(x: np.ndarray) -> np.ndarray:
            here = self.equations(at(x))
            rest = here.deviance - floor - here.residual @ here.residual
            return np.r_[here.residual, np.sqrt(max(rest, 0.0))]

        def jacobian(x: np.ndarray) -> np.ndarray:
            root = self.equations(at(x)).root[:, moving]
            return np.vstack([root, np.zeros(places.size)])

        end = least_squares(
            residuals,
            start[places],
            jacobian,
            bounds=(self.low[places], self.high[places]),
            # "dogbox" holds what reaches a bound there, and may run to one from far away; "trf"
            # comes near a bound in many steps, and finds its way from far.
            method=method,
            x_scale="jac",
            ftol=max(tolerance / (self.equations(start).deviance - floor), 4e-16),
            xtol=1e-13,
            gtol=1e-13,
            max_nfev=most,
        )
        held[moving] = end.active_mask != 0
        # No search can come closer than rounding.
        exact = (self.equations(at(end.x)).squares <= ROUNDING * self.floors).all()
        return at(end.x), held, bool(end.success or exact), int(end.nfev)

    def robust_search(self, x: np.ndarray, robust: bool, **options: Any) -> "Optimum":
        """Search, and again without the outliers that show."""
        optimum = self.search(x, **options)
        for _ in range(5):
            if not robust or optimum.exact.all() or not self._leave_out():
                break
            optimum = self.search(optimum.x, **options)
        return optimum

    def _leave_out(self) -> bool:
        """Leave out outliers among the residuals; return whether there are new ones."""
        samples = sum(run.size for run in self.runs)
        marks: list[tuple[Series, np.ndarray]] = []
        for of_output in self.by_output():
            scale = robust_deviation([s.plain[s.known, 0] for s in of_output])
            far = [outliers(error, scale) for error in self._all_errors(of_output)]
            # More than a quarter are no outliers: the model does not describe these data.
            if sum(mark.sum() for mark in far) >= 0.25 * samples:
                return False
            marks += zip(of_output, far, strict=True)
        if all(np.array_equal(~mark, series.known) for series, mark in marks):
            return False
        for series, mark in marks:
            series.known = ~mark
        self.evaluated = (None, None)
        return True

    def _all_errors(self, of_output: list[Series]) -> list[np.ndarray]:
        """Return measured minus simulated of all samples, also of those left out."""
        errors = []
        for series in of_output:
            simulated = self.simulated(self.runs[series.run], series.run, self.evaluated[0])
            errors.append(series.measured - self.observed(series, simulated[series.output]))
        return errors

    def fitted_noise(self) -> list[Noise]:
        """Return the noise of each output that its residuals at the last point show."""
        noise = []
        for before, count, of_output in zip(self.noise, self.counts, self.by_output(), strict=True):
            parts = [(series.plain, series.known, series.places) for series in of_output]
            noise.append(fit_noise(parts, count, before))
        return noise

    def set_noise(self, noise: list[Noise]) -> None:
        """Take another noise of each output."""
        self.noise, self.evaluated = noise, (None, None)


def _least_squares(gram: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return f and J with JᵀJ and Jᵀf of [e J]ᵀ[e J]."""
    scale = np.sqrt(np.maximum(np.diag(gram)[1:], 1e-300))
    if not np.isfinite(gram).all():
        return np.full(scale.size, np.inf), np.full((scale.size, scale.size), np.inf)
    roots, vectors = np.linalg.eigh(gram[1:, 1:] / np.outer(scale, scale))
    roots = np.maximum(roots, 1e-14)
    root = np.sqrt(roots)[:, None] * vectors.T
    return -(root @ (gram[0, 1:] / scale)) / roots, root * scale


# --- an optimum -----------------------------------------------------------------------------------


class Optimum:
    """Where a search settled: a full vector, the likelihood there, and what a bound holds."""

    def __init__(
        self, problem: Problem, x: np.ndarray, at_bound: np.ndarray, converged: bool, steps: int
    ):
        self.problem, self.x = problem, x
        self.at_bound = at_bound
        self.converged, self.steps = converged, steps
        self.equations = problem.equations(x)
        self.deviance = self._comparable()

    @property
    def loose(self) -> np.ndarray:
        """Which of the free unknowns no bound holds: indices into `problem.free`."""
        return np.flatnonzero(~self.at_bound[self.problem.free])

    @property
    def exact(self) -> np.ndarray:
        """Whether an output's residuals are mere rounding, by output: no noise to be tested."""
        return self.equations.squares <= ROUNDING * self.problem.floors

    def values(self) -> dict[str, Any]:
        """Return estimates by name; of states an array, shape (runs,)."""
        model = self.problem.model
        row = self.problem.values(self.x)
        shared = len(model.names)
        states = row[shared:].reshape(len(self.problem.runs), len(model.states))
        values: dict[str, Any] = dict(zip(model.names, row[:shared].tolist(), strict=True))
        return values | dict(zip(model.states, states.T, strict=True))

    def same_as(self, other: "Optimum") -> bool:
        """Return whether two rough optima are one: within five standard errors."""
        step = (self.x - other.x)[self.problem.free]
        return float(step @ other.equations.matrix @ step) < 25.0

    def _comparable(self) -> float:
        """
        Return the deviance, comparable between optima that leave out different samples.

        A sample left out counts as one that is `FAR` deviations off, in whatever unit data are.
        """
        problem, at = self.problem, self.equations
        of_window = 0.0
        if problem.unwindow:
            # The means of n values have 1/n times the density of the values themselves.
            of_window = sum(np.log(counts(run.size, run.window)).sum() for run in problem.runs)
        lost = np.array([sum((~s.known).sum() for s in of) for of in problem.by_output()])
        variance = (at.squares + problem.floors) / problem.counts
        added = lost @ np.log(variance) + FAR**2 * lost.sum()
        return float(at.deviance + added - 2.0 * len(problem.noise) * of_window)

    def inverse_information(self) -> np.ndarray:
        """
        Return the inverse of the information matrix of the loose unknowns.

        Where the matrix is singular, raise: the unknowns involved are not identifiable.
        """
        loose = self.loose
        labels = [self.problem.labels[j] for j in self.problem.free[loose]]
        matrix = self.equations.matrix[np.ix_(loose, loose)]
        if loose.size == 0:
            return matrix
        diagonal = np.diag(matrix).copy()
        unknown = diagonal <= 1e-30 * diagonal.max(initial=1e-300)
        if not unknown.any():
            # Scaled to unit diagonal: units of the unknowns do not decide what is singular.
            scale = np.sqrt(diagonal)
            values, vectors = np.linalg.eigh(matrix / np.outer(scale, scale))
            if values[0] > SINGULAR:
                return (vectors / values) @ vectors.T / np.outer(scale, scale)
            # Unknowns with a share in the direction that the data say nothing about.
            unknown = np.abs(vectors[:, 0]) > 0.25
        lost = tuple(label for label, flag in zip(labels, unknown, strict=True) if flag)
        raise IdentificationError(
            f"these data do not determine {' and '.join(lost)} ({self._cause()}); record phases "
            "that move the model more, or fix a parameter, for example "
            f"fixed={{{lost[-1].split('[')[0]!r}: ...}}",
            lost,
        )

    def _cause(self) -> str:
        """Say what about the data makes unknowns indistinguishable."""
        runs, model = self.problem.runs, self.problem.model
        if "mode" in model.inputs:
            modes = joined(runs, "mode")
            if np.ptp(modes) == 0.0:
                return f"mode never changes: it is {modes[0]:g} throughout"
            if all(np.ptp(run["mode"]) == 0.0 for run in runs):
                return f"mode never changes within any of the {len(runs)} runs"
        ranges = [f"{name} moves by {np.ptp(joined(runs, name)):.3g}" for name in model.outputs]
        return "several values explain them equally well; " + " and ".join(ranges)
