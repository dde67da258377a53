"""
The likelihood of a model, and the search for its maximum.

A model simulates many lanes in one call: the first at the unknowns themselves, each of the others
with one of them moved a little, so that the differences are derivatives. A rough search goes from
every start of the model, a fine one on from the best.

[L] Ljung, *System Identification: Theory for the User*, 2nd ed., 1999.
[S] Söderström and Stoica, *System Identification*, 1989.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from trustlab.identification.log import (
    Noise,
    Run,
    averaged,
    counts,
    fitted_noise,
    hac_lags,
    hac_matrix,
    joined,
    never_switches,
    outliers,
    scaled_roots,
    undone,
    whiten,
    whiteness_p,
    window_means,
)
from trustlab.identification.model import IdentificationError, Model
from trustlab.models.checks import counted, of_class
from trustlab.models.compiled import njit

# Steps of the lanes in coordinates of the search; relative where a coordinate has no scale. That of
# a load spans the kink that (2.6) has at rest and at full load.
STEP = 1e-6
STEP_OF_LOAD = 1e-4

# Smallest eigenvalue of a regular information matrix, scaled to unit diagonal.
SINGULAR = 1e-10

# Share of the floor of Σ e² below which residuals are mere rounding.
ROUNDING = 1e-4

# Gain in deviance of the last step: of a fine search, and of those before the best is known.
FINE = 1e-5
ROUGH: dict[str, Any] = {"tolerance": 0.1}

# Evaluations of a search before it goes on otherwise.
MOST = 40

# Deviance per sample by which no noise model gets below the floor of Σ e².
DEPTH = 30.0

# Optima up to this far above the best, in deviance, are searched further.
SHALLOW = 30.0

# Distances from rest or full load, in the coordinate of a load, that are tried where one is near.
NEAR = (0.0, 0.002, 0.008, 0.02, 0.05)

# Shares of the way between them, where means over a window hide it.
APART = (0.1, 0.3, 0.5, 0.8)


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

    measured: np.ndarray
    known: np.ndarray
    places: np.ndarray
    plain: Any = None
    white: Any = None

    @property
    def errors(self) -> np.ndarray:
        """The whitened prediction errors, shape (N,)."""
        return self.white[:, 0]

    @property
    def slopes(self) -> np.ndarray:
        """Their derivatives by the unknowns that move this run, with a minus sign."""
        return self.white[:, 1:]

    @property
    def unknowns(self) -> np.ndarray:
        """Which of the free unknowns these are."""
        return self.places[1:] - 1


class Equations(NamedTuple):
    """
    The likelihood at one point.

    `deviance` is −2 ln likelihood but for a constant, `matrix` the Gauss–Newton matrix of its half,
    `squares` Σ e² and `weights` n/Σ e² by output. `residual` and `root` are a problem of least
    squares with the same value above its floor, gradient and matrix.
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
        self.model, self.limits, self.unwindow = model, limits, unwindow
        self.runs = runs = [undone(run, model.outputs) for run in runs] if unwindow else runs
        self.noise = [Noise()] * len(model.outputs)
        shared, states = len(model.names), len(model.states)
        self.unknowns = [*model.names, *model.states * len(runs)]
        self.coordinates = [model.coordinate(name) for name in self.unknowns]
        self.low, self.high = (
            self.full_vector({name: ends[side] for name, ends in limits.items()}) for side in (0, 1)
        )
        self.free = np.flatnonzero(self.low < self.high)
        kinds = np.array([model.coordinates.get(name) for name in self.unknowns])
        self.loads = self.free[kinds[self.free] == "load"]
        firsts = [shared + i * states for i in range(len(runs))]
        self.of_run = [np.r_[:shared, first : first + states] for first in firsts]
        self.series: list[list[Series]] = []
        for run, mine in zip(self.runs, self.of_run, strict=True):
            places = np.r_[0, 1 + np.flatnonzero(np.isin(self.free, mine))]
            columns = [run[name] for name in model.outputs]
            self.series.append([Series(y, np.ones(run.size, bool), places) for y in columns])
        # The likelihood of data that are reproduced exactly is infinite: Σ e² has a floor at a
        # billionth of the scale.
        powers = [np.sum(joined(runs, name) ** 2) for name in model.outputs]
        self.floors = 1e-18 * np.maximum(powers, 1e-300)
        # The means of n values have 1/n times the density of the values themselves.
        thinned = sum(np.log(counts(run.size, run.undone)).sum() for run in runs)
        self.constant = -2.0 * len(averaged(model.outputs)) * thinned
        self.evaluated: tuple[Any, Any] = (None, None)

    def alike(self, model: Model, limits: Mapping) -> "Problem":
        """Return the problem of another model with the same runs, noise and samples that count."""
        other = Problem(model, self.runs, {**self.limits, **limits})
        other.noise = self.noise
        for of_run, same in zip(other.series, self.series, strict=True):
            for series, alike in zip(of_run, same, strict=True):
                series.known = alike.known
        return other

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
    def counts(self) -> np.ndarray:
        """Number of samples that count, by output."""
        return np.array([sum(s.known.sum() for s in of) for of in self.by_output()], dtype=float)

    def by_output(self) -> list[tuple[Series, ...]]:
        """Return the series of each output."""
        return list(zip(*self.series, strict=True))

    # --- the likelihood at a point ----------------------------------------------------------------

    def _outputs(self, run: Run, i: int, rows: np.ndarray) -> list[np.ndarray]:
        """Return outputs, shape (N, L), of a run in place of run i at L rows of values."""
        columns = dict(zip(self.model.unknowns, rows.T[self.of_run[i]].copy(), strict=True))
        outputs = dict(zip(self.model.outputs, self.model.outputs_of(run, columns), strict=True))
        for name in averaged(outputs) if run.window > 1 else ():
            outputs[name] = window_means(outputs[name], run.window)
        return [*outputs.values()]

    def simulated(self, run: Run, i: int, x: np.ndarray) -> list[np.ndarray]:
        """Return the outputs, shape (N,), of a run in place of run i at a full vector."""
        return [output[:, 0] for output in self._outputs(run, i, self.values(x)[None])]

    def _simulate(self, x: np.ndarray) -> None:
        """Fill the errors and derivatives of every series."""
        steps = STEP * np.maximum(np.abs(x), 1e-3)
        steps[self.loads] = STEP_OF_LOAD
        steps = np.where(x + steps <= self.high, steps, -steps)[self.free]
        lanes = np.tile(x, (1 + self.free.size, 1))
        lanes[np.arange(1, 1 + self.free.size), self.free] += steps
        rows, steps = self.values(lanes), np.r_[1.0, steps]
        for i, (run, of_run) in enumerate(zip(self.runs, self.series, strict=True)):
            places = of_run[0].places
            outputs = self._outputs(run, i, rows[places])
            for series, columns in zip(of_run, outputs, strict=True):
                series.plain = columns
                _differentiate(series.plain, series.measured, series.known, steps[places])

    def equations(self, x: np.ndarray) -> Equations:
        """Return the likelihood and its derivatives at a full vector ([L] Section 10.2)."""
        if self.evaluated[0] is not None and np.array_equal(self.evaluated[0], x):
            return self.evaluated[1]
        # A step may lead to where a model is not defined: the search turns back from there.
        with np.errstate(all="ignore"):
            self._simulate(x)
            products = [self.products(j, noise) for j, noise in enumerate(self.noise)]
            grams = np.stack([gram for gram, _ in products])
            # The variance of each output maximises the likelihood at Σ e²/n. What is left of minus
            # twice its logarithm is Σ n ln(Σ e²/n) ([L] Section 7.4, [S] Section 7.2); its
            # derivatives weight each output by n/Σ e², so that users need give no weights.
            squares, samples = grams[:, 0, 0], self.counts
            weights = samples / (squares + self.floors)
            log_determinant = sum(part for _, part in products)
            deviance = self.constant + samples @ np.log(1.0 / weights) + log_determinant
            above = float(samples @ (DEPTH + np.log1p(squares / self.floors)) + log_determinant)
            gram = np.tensordot(weights, grams, 1)
        residual, root = _least_squares(gram, above)
        equations = Equations(float(deviance), gram[1:, 1:], squares, weights, residual, root)
        self.evaluated = (x.copy(), equations)
        return equations

    def products(self, output: int, noise: Noise) -> tuple[np.ndarray, float]:
        """Return [e J]ᵀ[e J] of an output at the last point, whitened, and the log-determinant."""
        gram, log_determinant = np.zeros((1 + self.free.size,) * 2), 0.0
        for series in self.by_output()[output]:
            series.white, part = whiten(series.plain, series.known, noise)
            gram[np.ix_(series.places, series.places)] += series.white.T @ series.white
            log_determinant += part
        return gram, log_determinant

    def whitened(self, x: np.ndarray) -> list[list[np.ndarray]]:
        """Return the prediction errors of each run, by output."""
        self.equations(x)
        return [[series.errors.copy() for series in of] for of in self.by_output()]

    def exact(self, x: np.ndarray) -> np.ndarray:
        """Return whether an output's residuals are mere rounding, by output."""
        return self.equations(x).squares <= ROUNDING * self.floors

    # --- what the residuals at a point say --------------------------------------------------------

    def fit_noise(self, x: np.ndarray) -> None:
        """Take the noise of each output that its residuals show."""
        self.equations(x)
        self.noise = [
            fitted_noise(lambda noise, j=j: self.products(j, noise), self.counts[j], before)
            for j, before in enumerate(self.noise)
        ]
        self.evaluated = (None, None)

    def leave_out(self, x: np.ndarray) -> bool:
        """Leave out outliers among the residuals; return whether there are new ones."""
        outputs = [self.simulated(run, i, x) for i, run in enumerate(self.runs)]
        marks = []
        for of_output, fitted in zip(self.by_output(), zip(*outputs, strict=True), strict=True):
            pairs = zip(of_output, fitted, strict=True)
            errors = [series.measured - output for series, output in pairs]
            far = outliers(errors, [series.known for series in of_output])
            # More than a quarter are no outliers: the model does not describe these data.
            if np.concatenate(far).mean() >= 0.25:
                return False
            marks += zip(of_output, far, strict=True)
        if self.exact(x).all() or all(np.array_equal(~far, s.known) for s, far in marks):
            return False
        for series, far in marks:
            series.known = ~far
        self.evaluated = (None, None)
        return True


def _least_squares(gram: np.ndarray, above: float) -> tuple[np.ndarray, np.ndarray]:
    """Return f and J, with |f|² the deviance above its floor, of the products [e J]ᵀ[e J]."""
    # A search for least squares uses no more of f and J than |f|², Jᵀf and JᵀJ: those of the
    # likelihood itself fit in one row more than there are unknowns.
    if not np.isfinite(gram).all():
        return np.full(len(gram), np.inf), np.full_like(gram[:, 1:], np.inf)
    scale, roots, vectors = scaled_roots(gram[1:, 1:])
    roots = np.maximum(roots, 1e-14)
    root = np.sqrt(roots)[:, None] * vectors.T
    residual = -(root @ (gram[0, 1:] / scale)) / roots
    rest = np.sqrt(max(above - residual @ residual, 0.0))
    return np.append(residual, rest), np.vstack([root * scale, 0.0 * scale])


# --- the search -----------------------------------------------------------------------------------


@dataclass(eq=False)
class Optimum:
    """Where a search settled: a full vector, and the likelihood there."""

    problem: Problem
    x: np.ndarray
    converged: bool

    def __post_init__(self):
        equations = self.problem.equations(self.x)
        self.deviance, self.matrix = equations.deviance, equations.matrix

    @property
    def at_bound(self) -> np.ndarray:
        """Which of the full vector a bound holds."""
        low, high = self.problem.low, self.problem.high
        return (low < high) & ((self.x <= low) | (self.x >= high))

    @property
    def loose(self) -> np.ndarray:
        """Which of the free unknowns no bound holds: indices into `problem.free`."""
        return np.flatnonzero(~self.at_bound[self.problem.free])

    def values(self) -> dict[str, Any]:
        """Return estimates by name; of states an array, shape (runs,)."""
        model, row = self.problem.model, self.problem.values(self.x)
        values: dict[str, Any] = dict(zip(model.names, row.tolist(), strict=False))
        states = row[len(model.names) :].reshape(len(self.problem.runs), -1).T
        return values | dict(zip(model.states, states, strict=False))

    def whiteness_p(self) -> float:
        """Return the least p value of the Ljung–Box tests of all outputs ([S] Section 11.2)."""
        pairs = zip(self.problem.exact(self.x), self.problem.whitened(self.x), strict=True)
        return min(1.0 if exact else whiteness_p(errors) for exact, errors in pairs)

    def sandwich(self, inverse: np.ndarray) -> np.ndarray:
        """Return the covariance by the long-run covariance of the scores, summed over runs."""
        problem, loose = self.problem, self.loose
        lags = max(map(hac_lags, problem.whitened(self.x)))
        weights = problem.equations(self.x).weights
        total = np.zeros((problem.free.size,) * 2)
        for of_run in problem.series:
            pairs = zip(weights, of_run, strict=True)
            scores = sum(weight * s.slopes * s.errors[:, None] for weight, s in pairs)
            unknowns = of_run[0].unknowns
            total[np.ix_(unknowns, unknowns)] += hac_matrix(scores, lags)
        return inverse @ total[np.ix_(loose, loose)] @ inverse

    def inverse_information(self) -> np.ndarray:
        """
        Return the inverse of the information matrix of the loose unknowns.

        Where the matrix is singular, raise: the unknowns involved are not identifiable.
        """
        problem, loose = self.problem, self.loose
        scale, roots, vectors = scaled_roots(self.matrix[np.ix_(loose, loose)])
        singular = roots <= SINGULAR
        if not singular.any():
            return (vectors / roots) @ vectors.T / np.outer(scale, scale)
        # Unknowns with a share in the directions that the data say nothing about.
        unknown = np.abs(vectors[:, singular]).max(axis=1) > 0.25
        lost = tuple(dict.fromkeys(problem.unknowns[j] for j in problem.free[loose[unknown]]))
        cause = "several values explain them equally well"
        if never_switches(problem.runs):
            cause = f"mode never changes within any of the {counted(len(problem.runs), 'run')}"
        raise IdentificationError(
            f"these data do not determine {' and '.join(lost)} ({cause}); record phases "
            "that move the model more, or fix a parameter, for example "
            f"fixed={{{lost[-1]!r}: ...}}",
            lost,
        )


def distinct(optima: Iterable[Optimum], within: float) -> list[Optimum]:
    """Return optima that are nearly as good as the best, each once, the best first."""
    kept: list[Optimum] = []
    for optimum in sorted(optima, key=lambda each: each.deviance):
        free = optimum.problem.free
        steps = [(optimum.x - other.x)[free] for other in kept]
        # Rough optima within five standard errors of each other are one.
        apart = all(step @ o.matrix @ step >= 25.0 for step, o in zip(steps, kept, strict=True))
        if apart and optimum.deviance < (kept or [optimum])[0].deviance + within:
            kept.append(optimum)
    return kept


def search(
    problem: Problem,
    x: np.ndarray,
    tolerance: float = FINE,
    most: int = MOST,
    method: str = "dogbox",
    held: Any = (),
) -> Optimum:
    """
    Return the optimum next to a full vector; its last step gained less than `tolerance`.

    Unknowns that are `held`, places in the full vector, stay.
    """
    from scipy.optimize import least_squares

    start = np.clip(x, problem.low, problem.high)
    first = problem.equations(start)
    if not np.isfinite(first.deviance + first.matrix.sum()):
        values = zip(problem.unknowns, problem.values(start), strict=True)
        raise ValueError(
            "the model simulates values that are not finite at "
            f"{', '.join(f'{name} = {value:.4g}' for name, value in values)}; start elsewhere, "
            "by `starts` of the model or narrower bounds"
        )
    moving = ~np.isin(problem.free, held)
    places = problem.free[moving]
    low, high = problem.low[places], problem.high[places]
    if places.size == 0:
        return Optimum(problem, start, True)

    def at(x: np.ndarray) -> np.ndarray:
        full = start.copy()
        full[places] = x
        return full

    def stop(intermediate_result: Any) -> None:
        # Where a Gauss–Newton step would gain nothing, only rounding would move the search.
        x = intermediate_result.x
        here = problem.equations(at(x))
        root = here.root[:, moving]
        gain = here.residual @ root @ np.linalg.lstsq(root, here.residual)[0]
        if ((low < x) & (x < high)).all() and gain < 0.01 * tolerance:
            raise StopIteration

    end = least_squares(
        lambda x: problem.equations(at(x)).residual,
        start[places],
        lambda x: problem.equations(at(x)).root[:, moving],
        bounds=(low, high),
        # "dogbox" holds what reaches a bound there, and may run to one from far away; "trf"
        # comes near a bound in many steps, and finds its way from far.
        method=method,
        x_scale="jac",
        ftol=max(tolerance / (first.residual @ first.residual), 4e-16),
        xtol=1e-13,
        gtol=1e-13,
        max_nfev=most,
        callback=stop,
    )
    # The callback's status is −2. No search can come closer than rounding.
    settled = end.success or end.status == -2 or problem.exact(at(end.x)).all()
    optimum = Optimum(problem, at(end.x), bool(settled))
    ends = ends_of_loads(optimum)[0]
    at_end = np.abs(optimum.x[problem.loads] - ends) < STEP_OF_LOAD
    if settled or most > MOST or not (at_end.any() or tolerance <= FINE):
        return optimum
    # (2.6) has a kink at rest and at full load, which defies any quadratic model: a search that
    # does not settle there goes on with the others. One that is to be fine goes on.
    places = problem.loads[at_end]
    optimum.x[places] = ends[at_end]
    return search(problem, optimum.x, tolerance, 4 * MOST, held=[*held, *places])


def held_at(optimum: Optimum, held: np.ndarray, places: np.ndarray) -> Optimum:
    """Return what a search finds with some unknowns held at other places."""
    x = optimum.x.copy()
    x[held] = places
    return search(optimum.problem, x, held=held, **ROUGH)


# --- from every start -----------------------------------------------------------------------------


def rough_optima(
    model: Model, runs: list[Run], limits: Mapping, robust: bool = True
) -> list[Optimum]:
    """
    Search roughly from every start, and return the optima of one problem, the most likely first.

    Where outputs are means over a window, the likelihood decides if noise is in them or in the
    values that they are made of; these means hide where utilization began.
    """
    for output in model.outputs:
        values = joined(runs, output)
        if np.ptp(values) == 0.0:
            raise IdentificationError(
                f"{output} never moves (it is {values[0]:g} throughout), so the model cannot be "
                "identified; record a session in which it is measured",
                model.names,
            )
    views = []
    for unwindow, seen in _views(model, runs):
        problem = Problem(model, runs, limits, unwindow)
        optima = []
        points = [*model.starts(seen, limits)] if model.starts else [{}]
        for point in points or [None]:
            remedy = "`starts` returns a list of dictionaries of values by name"
            model.check_names(of_class("each of the starts", point, dict, remedy), "starts")
            # A model's own start lies near an optimum; another may lie anywhere.
            method = "dogbox" if set(model.unknowns) <= point.keys() else "trf"
            x = problem.full_vector(_completed(dict(point), limits))
            optima.append(search(problem, x, method=method, **ROUGH))
        views.append(_sorted(optima))
    optima = views[0]
    if len(views) > 1:
        optima = min(views, key=lambda view: _deviance_with_noise(view[0]))
    if robust:
        optima = _without_outliers(optima, **ROUGH)
    best = optima[0]
    for held in _held_elsewhere(best, slice(None), APART) if len(views) > 1 else ():
        if held.deviance < best.deviance + SHALLOW:
            optima.append(search(best.problem, held.x, **ROUGH))
    return _sorted(optima)


def _sorted(optima: Iterable[Optimum]) -> list[Optimum]:
    return sorted(optima, key=lambda optimum: optimum.deviance)


def _without_outliers(optima: list[Optimum], **options: Any) -> list[Optimum]:
    """Search again without the outliers that the best optimum shows."""
    problem = optima[0].problem
    for _ in range(5):  # each round shows them better
        if not problem.leave_out(optima[0].x):
            break
        optima = _sorted(search(problem, optimum.x, **options) for optimum in optima)
    return optima


def _views(model: Model, runs: list[Run]) -> Iterator[tuple[bool, list[Run]]]:
    """
    Yield whether noise is in the values that a window averages, and runs for starting values.

    Where it is in the means, the inputs are averaged for these, which gives a linear model's means
    but for the beginning.
    """
    if all(run.window == 1 for run in runs) or not averaged(model.outputs):
        yield False, runs
        return
    yield True, [undone(run, model.outputs) for run in runs]
    yield False, [run.mapped(model.inputs, window_means).changed({}, window=1) for run in runs]


def _completed(start: dict, limits: Mapping) -> dict:
    """Return a start with the middle of the bounds where it has no value."""
    for name, (low, high) in limits.items():
        if name not in start and not np.isfinite(high - low):
            raise ValueError(f"{name} needs bounds on both sides, or a start: Model(starts=…)")
        start.setdefault(name, 0.5 * (low + high))
    return start


def _deviance_with_noise(optimum: Optimum) -> float:
    """Return the deviance once the noise has a model, which rounded or averaged noise needs."""
    problem, white = optimum.problem, optimum.problem.noise
    problem.fit_noise(optimum.x)
    end = search(problem, optimum.x, **ROUGH)
    problem.noise, problem.evaluated = white, (None, None)
    return end.deviance


def _held_elsewhere(optimum: Optimum, which: Any, shares: tuple) -> Iterator[Optimum]:
    """Yield searches with some loads held at shares of the way from their nearer end."""
    ends, inwards = ends_of_loads(optimum)
    held = optimum.problem.loads[which]
    for share in shares if held.size else ():
        yield held_at(optimum, held, (ends + share * inwards)[which])


def best_optimum(optimum: Optimum, robust: bool = True) -> Optimum:
    """Return the fine optimum at a rough one; beside it where (2.6) bends and that is better."""
    problem = optimum.problem
    optimum = search(problem, optimum.x)
    if robust:
        (optimum,) = _without_outliers([optimum])
    near = np.abs(optimum.x[problem.loads] - ends_of_loads(optimum)[0]) < NEAR[-1]
    held = _sorted(_held_elsewhere(optimum, near, NEAR))[:1]
    return _sorted([optimum, *(search(problem, best.x) for best in held)])[0]


def ends_of_loads(optimum: Optimum) -> tuple[np.ndarray, np.ndarray]:
    """Return the nearer end of every free load's range, and the way from there to the other."""
    problem, loads = optimum.problem, optimum.problem.loads
    x, low, high = optimum.x[loads], problem.low[loads], problem.high[loads]
    ends = np.where(x - low < high - x, low, high)
    return ends, low + high - 2.0 * ends
