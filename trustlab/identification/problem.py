"""
The likelihood of a model: simulate, compare, whiten.

What a log shows beyond the simulated outputs, e = y − ŷ, is noise: white, or an AR(1) process plus
white noise, whose Kalman filter leaves prediction errors; a sandwich widens the covariance for any
other. A model simulates many lanes in one call: the first at the unknowns themselves, each of the
others with one of them moved a little, so that the differences are derivatives.

[L] Ljung, *System Identification: Theory for the User*, 2nd ed., 1999.
[S] Söderström and Stoica, *System Identification*, 1989.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy import special

from trustlab.identification.log import (
    Run,
    counts,
    in_rows,
    joined,
    undo_window,
    window_means,
)
from trustlab.identification.model import COORDINATES, IdentificationError, Model
from trustlab.models.checks import counted
from trustlab.models.compiled import njit

# Lags of the Ljung–Box test that chooses what the noise model and standard errors allow for.
LAGS = 25

# p value of the Ljung–Box test below which residuals do not count as white.
NOT_WHITE = 1e-3

# Standard errors from the middle of a 95 % interval to its end.
HALF_WIDTH = float(special.ndtri(0.975))

# Robust standard deviations beyond which a sudden residual counts as an outlier: of white noise one
# sample in 5·10⁸ is.
FAR = 6.0


def pooled_correlation(errors: list[np.ndarray], others: list[np.ndarray], lags: int) -> np.ndarray:
    """
    Return the correlation of e(k) with u(k − lag), lag = 0, 1, …, pooled over runs.

    No product crosses from one run to the next; means are those of all runs, as in statsmodels.
    0 where one of them never moves.
    """
    e_mean, u_mean = (np.concatenate(each).mean() for each in (errors, others))
    sums, powers = np.zeros(lags + 1), np.zeros(2)
    for e, u in zip(errors, others, strict=True):
        e, u = e - e_mean, u - u_mean
        sums += [e[lag:] @ u[: max(u.size - lag, 0)] for lag in range(lags + 1)]
        powers += e @ e, u @ u
    scale = np.sqrt(powers.prod())
    return sums / scale if scale > 0.0 else sums


def ljung_box(residuals: list[np.ndarray], lags: int) -> tuple[float, int, float]:
    """
    Return Q = n(n + 2) Σ ρ²(l)/(n − l) over lags l, its degrees of freedom and its p value.
    """
    samples = sum(map(len, residuals))
    lags = min(lags, samples - 1)
    terms = pooled_correlation(residuals, residuals, lags)[1:] ** 2 / (
        samples - np.arange(1, lags + 1)
    )
    q = samples * (samples + 2.0) * np.sum(terms)
    return float(q), lags, float(special.chdtrc(lags, q))


def whiteness_p(residuals: list[np.ndarray]) -> float:
    """Return the p value of the Ljung–Box test."""
    return ljung_box(residuals, LAGS)[2]


def hac_lags(residuals: list[np.ndarray]) -> int:
    """
    Return the bandwidth of the Bartlett window for residuals, by Andrews' rule for an AR(1).

    The rule, 1.1447 (α n)^(1/3) with α = 4ρ²/((1 − ρ)²(1 + ρ)²), is equations (6.2) and (6.4) of
    Andrews (1991), *Econometrica* 59, 817-858; here at most a quarter of the shortest run.
    """
    # White noise on top hides slow noise from the first autocorrelation, but averages out in
    # blocks: the rule is applied to the means over 1, 2, 4, 8 … samples too, and the widest result
    # taken.
    shortest = min(map(len, residuals))
    widest = 0.0
    length = 1
    while length == 1 or shortest // length >= 50:
        means = [in_rows(run, length).mean(axis=1) for run in residuals]
        total = sum(map(len, means))
        rho = min(abs(float(pooled_correlation(means, means, 1)[1])), 0.9999)
        if length == 1 or rho > 3.0 / np.sqrt(total):
            alpha = 4.0 * rho**2 / (1.0 - rho**2) ** 2
            widest = max(widest, length * 1.1447 * (alpha * total) ** (1.0 / 3.0))
        length *= 2
    return int(min(widest, shortest // 4))


def hac_matrix(scores: np.ndarray, lags: int) -> np.ndarray:
    """
    Return the Bartlett-weighted sum of products of scores, shape (n, p), over lags (Newey–West).
    """
    # Sums over lags + 1 scores in a row hold each product at lag l in lags + 1 − l places: as
    # Bartlett weights it.
    total = np.cumsum(np.pad(scores, ((lags + 1, lags), (0, 0))), axis=0)
    sums = total[lags + 1 :] - total[: -lags - 1]
    return sums.T @ sums / (lags + 1)


class Noise(NamedTuple):
    """AR(1) noise under white noise: share of the variance, correlation of successive samples."""

    share: float = 0.0
    memory: float = 0.0


class Process(NamedTuple):
    """
    Noise y = c x + v of a first-order process x and white noise v, from one value to the next.

    x becomes φ x + w; `drive`, `error` and `both` are the variance of w, that of v, and their
    covariance; `variance` is that of x.
    """

    phi: float
    c: float
    drive: float
    error: float
    both: float
    variance: float


@njit
def process(white, slow, memory, samples):
    """
    Return the noise of means over `samples`.

    Of each sample, `white` and `slow` are the deviations of white and AR(1) noise; `memory` is the
    correlation of successive samples of the latter.
    """
    total = 0.0
    power = 1.0
    error = 0.0
    both = 0.0
    # After m samples a shock has added `total` = 1 + … + φ^(m − 1) to the sum.
    for m in range(samples):
        if m > 0:
            error += total * total
            both += total * power
        total += power
        power *= memory
    shock = slow * slow * (1.0 - memory * memory)
    return Process(
        power,
        total / samples,
        slow * slow * (1.0 - power * power),
        (shock * error / samples + white * white) / samples,
        shock * both / samples,
        slow * slow,
    )


@njit
def filter_columns(columns, known, noise, errors):
    """
    Write the prediction errors of a Kalman filter, scaled to variance one; return Σ ln variance.

    Columns, shape (N, p), are filtered alike; where nothing is known the noise is only predicted
    (Kailath, Sayed and Hassibi, *Linear Estimation*, 2000, Section 9.5: correlated noises).
    """
    state = np.zeros(columns.shape[1])
    variance = noise.variance
    before = -1.0
    scale = 1.0
    gain = 0.0
    after = 0.0
    logarithm = 0.0
    logs = 0.0
    for k in range(columns.shape[0]):
        if not known[k]:
            for j in range(state.size):
                errors[k, j] = 0.0
                state[j] *= noise.phi
            variance = noise.phi * noise.phi * variance + noise.drive
            continue
        if abs(variance - before) > 1e-14 * variance:  # the filter settles within some samples
            before = variance
            total = noise.c * noise.c * variance + noise.error
            scale = 1.0 / np.sqrt(total)
            gain = (noise.phi * noise.c * variance + noise.both) / total
            after = noise.phi * noise.phi * variance + noise.drive - gain * gain * total
            logarithm = np.log(total)
        for j in range(state.size):
            error = columns[k, j] - noise.c * state[j]
            errors[k, j] = scale * error
            state[j] = noise.phi * state[j] + gain * error
        variance = after
        logs += logarithm
    return logs


def whiten(columns: np.ndarray, known: np.ndarray, noise: Noise) -> tuple[np.ndarray, float]:
    """
    Return columns, shape (N, p), whitened by a Kalman filter, and the log-determinant.

    Errors and their derivatives are filtered alike ([L] Section 4.3). Where nothing is known the
    columns are 0, so that white noise leaves them as they are.
    """
    if noise == Noise():
        return columns, 0.0
    errors = np.empty(columns.shape)
    of_samples = process(np.sqrt(1.0 - noise.share), np.sqrt(noise.share), noise.memory, 1)
    return errors, filter_columns(columns, known, of_samples, errors)


def scaled_roots(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return scales of the unknowns, and eigenvalues and -vectors with these at unit diagonal."""
    # Units of the unknowns do not decide what is singular.
    scale = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    return scale, *np.linalg.eigh(matrix / np.outer(scale, scale))


def _restricted_deviance(gram: np.ndarray, log_determinant: float, samples: float) -> float:
    """Return minus twice the restricted log-likelihood of [e J]ᵀ[e J], but for a constant."""
    scale, roots, vectors = scaled_roots(gram[1:, 1:])
    regular = roots > 1e-10
    along = (gram[0, 1:] / scale) @ vectors[:, regular]
    squares = max(gram[0, 0] - along @ (along / roots[regular]), 1e-300)
    value = (samples - regular.sum()) * np.log(squares) + log_determinant
    return value + np.log(roots[regular]).sum() + 2.0 * np.log(scale).sum()


def _noise(at) -> Noise:
    """Return the noise model at unbounded coordinates: −ln(1 − memory), log odds of the share."""
    memory = float(np.clip(COORDINATES["rate"].back(at[0]), 0.0, 1.0 - 1e-6))
    return Noise(float(COORDINATES["odds"].back(np.clip(at[1], -12.0, 12.0))), memory)


def outliers(error: np.ndarray, scale: float) -> np.ndarray:
    """Return which residuals are far off and begin or end with a jump, as dropouts do."""
    from scipy import ndimage

    far = np.abs(error) > FAR * scale
    if not far.any():
        return far
    jumps = np.abs(np.diff(error, prepend=0.0, append=0.0)) > FAR * scale
    out = np.zeros(error.size, dtype=bool)
    for (stretch,) in ndimage.find_objects(ndimage.label(far)[0]):
        out[stretch] = jumps[stretch.start] or jumps[stretch.stop]
    return out


def robust_deviation(errors: list[np.ndarray]) -> float:
    """Return the standard deviation of Gaussian residuals with this median of absolute values."""
    sizes = np.abs(np.concatenate(errors))
    # A few thousand samples tell it to a few per cent.
    return 1.4826 * float(np.median(sizes[:: 1 + sizes.size // 4000]))


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
    plain: Any = None
    white: Any = None


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
        # Of runs of its own, in whose buffers no other problem writes.
        self.model, self.runs = model, [run.changed({}) for run in runs]
        self.unwindow = unwindow
        self.noise = [Noise()] * len(model.outputs)
        shared, states = len(model.names), len(model.states)
        self.unknowns = [*model.names, *model.states * len(runs)]
        self.coordinates = [model.coordinate(name) for name in self.unknowns]
        self.low, self.high = (
            self.full_vector({name: ends[side] for name, ends in limits.items()}) for side in (0, 1)
        )
        self.free = np.flatnonzero(self.low < self.high)
        loads = [model.coordinates.get(name) == "load" for name in self.unknowns]
        self.loads = self.free[np.array(loads)[self.free]]
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
        if len(self.runs) == 1:
            return self.unknowns
        states = [f"{name}[{i}]" for i in range(len(self.runs)) for name in self.model.states]
        return [*self.model.names, *states]

    @property
    def counts(self) -> np.ndarray:
        """Number of samples that count, by output."""
        return np.array([sum(s.known.sum() for s in of) for of in self.by_output()], dtype=float)

    def by_output(self) -> list[list[Series]]:
        """Return the series of each output."""
        outputs = len(self.model.outputs)
        return [self.series[j::outputs] for j in range(outputs)]

    def by_run(self) -> list[list[Series]]:
        """Return the series of each run."""
        return list(map(list, zip(*self.by_output(), strict=True)))

    # --- the likelihood at a point ----------------------------------------------------------------

    def simulated(self, run: Run, i: int, x: np.ndarray) -> list[np.ndarray]:
        """Return the outputs, shape (N,), of a run in place of run i at a full vector."""
        columns = self.values(x)[self.of_run[i], None]
        values = dict(zip(self.model.unknowns, columns, strict=True))
        # In buffers of its own: those of a run hold the errors and derivatives of the last point.
        return [output[:, 0] for output in self.model.outputs_of(run.changed({}), values)]

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
        for run, mine, of_run in zip(self.runs, self.of_run, self.by_run(), strict=True):
            places = of_run[0].places
            table = rows[np.ix_(places, mine)]
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
            products = [self.products(j, noise) for j, noise in enumerate(self.noise)]
        grams = np.stack([gram for gram, _ in products])
        log_determinant = sum(part for _, part in products)
        # The variance of each output maximises the likelihood at Σ e²/n. What is left of minus
        # twice its logarithm is Σ n ln(Σ e²/n) ([L] Section 7.4, [S] Section 7.2); its derivatives
        # weight each output by n/Σ e², so that users need give no weights.
        squares, samples = grams[:, 0, 0], self.counts
        weights = samples / (squares + self.floors)
        with np.errstate(all="ignore"):
            deviance = float(samples @ np.log(1.0 / weights)) + log_determinant
            gram = np.tensordot(weights, grams, 1)
        residual, root = _least_squares(gram)
        equations = Equations(deviance, gram[1:, 1:], squares, weights, residual, root)
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

    def set_noise(self, noise: list[Noise]) -> None:
        """Take another noise of each output."""
        self.noise, self.evaluated = noise, (None, None)

    def fit_noise(self) -> None:
        """Take the noise of each output that its residuals at the last point show."""
        self.set_noise([self._fitted_noise(output) for output in range(len(self.noise))])

    def _fitted_noise(self, output: int) -> Noise:
        """
        Return the noise model of greatest restricted likelihood, near that of the round before.

        Restricted (Patterson & Thompson 1971, *Biometrika* 58, 545-554): the parameters are solved
        for at every noise model, and what they take from the residuals is allowed for.
        """
        from scipy import optimize

        def deviance(at):
            gram, log_determinant = self.products(output, _noise(at))
            return _restricted_deviance(gram, log_determinant, self.counts[output])

        before = self.noise[output]
        memories, shares, size = [0.3, 0.9, 0.99, 0.999], [0.05, 0.5, 0.95], 1.0
        if before != Noise():
            memories, shares, size = [before.memory], [before.share], 0.3
        rate, odds = COORDINATES["rate"], COORDINATES["odds"]
        starts = [(rate.to(m), odds.to(s)) for m in memories for s in shares]
        best = np.array(min(starts, key=deviance))
        simplex = best + size * np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.5]])
        options = {"initial_simplex": simplex, "xatol": 0.02, "fatol": 0.02, "maxfev": 80}
        return _noise(optimize.minimize(deviance, best, method="Nelder-Mead", options=options).x)


def _least_squares(gram: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return f and J with JᵀJ and Jᵀf of [e J]ᵀ[e J]."""
    if not np.isfinite(gram).all():
        return np.full(len(gram) - 1, np.inf), np.full_like(gram[1:, 1:], np.inf)
    scale, roots, vectors = scaled_roots(gram[1:, 1:])
    roots = np.maximum(roots, 1e-14)
    root = np.sqrt(roots)[:, None] * vectors.T
    return -(root @ (gram[0, 1:] / scale)) / roots, root * scale


# --- an optimum -----------------------------------------------------------------------------------


@dataclass(eq=False)
class Optimum:
    """Where a search settled: a full vector, the likelihood there, and what a bound holds."""

    problem: Problem
    x: np.ndarray
    at_bound: np.ndarray
    converged: bool
    steps: int

    def __post_init__(self):
        self.equations = self.problem.equations(self.x)
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
        model, row = self.problem.model, self.problem.values(self.x)
        values: dict[str, Any] = dict(zip(model.names, row.tolist(), strict=False))
        states = row[len(model.names) :].reshape(len(self.problem.runs), -1).T
        return values | dict(zip(model.states, states, strict=False))

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
        problem, loose = self.problem, self.loose
        matrix = self.equations.matrix[np.ix_(loose, loose)]
        scale, roots, vectors = scaled_roots(matrix)
        singular = roots <= SINGULAR
        if not singular.any():
            return (vectors / roots) @ vectors.T / np.outer(scale, scale)
        # Unknowns with a share in the directions that the data say nothing about.
        unknown = np.abs(vectors[:, singular]).max(axis=1) > 0.25
        lost = tuple(problem.labels[j] for j in problem.free[loose[unknown]])
        cause = "several values explain them equally well"
        modes = [run["mode"] for run in problem.runs if "mode" in problem.model.inputs]
        if modes and all(np.ptp(mode) == 0.0 for mode in modes):
            cause = f"mode never changes within any of the {counted(len(modes), 'run')}"
        raise IdentificationError(
            f"these data do not determine {' and '.join(lost)} ({cause}); record phases "
            "that move the model more, or fix a parameter, for example "
            f"fixed={{{lost[-1].split('[')[0]!r}: ...}}",
            lost,
        )
