"""
Cumulative-link (logit) models with random effects of groups, by adaptive Gauss–Hermite quadrature.

Logit P(y ≤ k) = θ_k − x β − z b, b ~ N(0, L Lᵀ) by group. A logistic model has two categories and
θ fixed at 0.
"""

from functools import reduce
from typing import NamedTuple

import numpy as np
import pandas as pd
from scipy import special
from scipy.optimize import minimize

from trustlab.models.checks import finite_array
from trustlab.models.compiled import njit
from trustlab.studies.regression.newton import polished
from trustlab.studies.table import column_of

# SD below which random effects do not vary.
_SINGULAR = 1e-3

# Nodes of the quadrature of a group, over all its random effects.
MOST_NODES = 10_000

# Steps of the gradient for the search, and for the last digits.
QUICK = 1e-5
EXACT = 2e-3


class Quadrature(NamedTuple):
    """Nodes, a row each, and logarithms of their weights times exp(|node|²)."""

    nodes: np.ndarray
    log_weights: np.ndarray


class Rows(NamedTuple):
    """
    Answers sorted by group; group g has rows first[g] to first[g + 1].

    `x` are regressors of fixed effects, `nominal` those with a coefficient per threshold, `z` those
    of random effects; a row counts `weight` times.
    """

    x: np.ndarray
    nominal: np.ndarray
    z: np.ndarray
    category: np.ndarray
    weight: np.ndarray
    first: np.ndarray


class CumulativeFit(NamedTuple):
    """
    Maximum of the likelihood: coefficients, then thresholds of every category but the last (and
    their nominal effects, a row per threshold), L, and the covariance of coefficients and
    thresholds (zeros where it was not asked for).
    """

    llf: float
    beta: np.ndarray
    thresholds: np.ndarray
    nominal: np.ndarray
    factor: np.ndarray
    covariance: np.ndarray

    @property
    def sd(self) -> float:
        """SD of the first random effect."""
        return abs(float(self.factor[0, 0]))

    @property
    def singular(self) -> bool:
        """Whether a random variance is zero, or a correlation ±1."""
        return bool(np.abs(np.diag(self.factor)).min() < _SINGULAR)


def quadrature(points: int, effects: int) -> Quadrature:
    """Return the nodes of `points` in each direction of some random effects."""
    nodes, weights = np.polynomial.hermite.hermgauss(points)
    logs = np.log(weights) + nodes**2
    grid = np.meshgrid(*[nodes] * effects, indexing="ij")
    total = reduce(np.add.outer, [logs] * effects)
    return Quadrature(np.stack([axis.ravel() for axis in grid], axis=1), total.ravel())


@njit
def _log_probability(lower, upper):
    """
    Return log(F(upper) − F(lower)) of the logistic F, without cancellation.

    F(b) − F(a) = F(b) (1 − F(a)) (1 − e^(a − b)).
    """
    value = 0.0
    if upper < np.inf:
        value -= max(-upper, 0.0) + np.log1p(np.exp(-abs(upper)))
    if lower > -np.inf:
        value -= max(lower, 0.0) + np.log1p(np.exp(-abs(lower)))
        if upper < np.inf:
            value += np.log1p(-np.exp(lower - upper)) if lower < upper else -np.inf
    return value


@njit
def _group(lower, upper, z, weight, v):
    """Return log ∏ P φ(v) of a group but for φ's constant; z is the random effects' share by v."""
    value = 0.0
    for j in range(v.size):
        value -= 0.5 * v[j] * v[j]
    for i in range(lower.size):
        shift = 0.0
        for j in range(v.size):
            shift += z[i, j] * v[j]
        value += weight[i] * _log_probability(lower[i] - shift, upper[i] - shift)
    return value


@njit
def _curve(lower, upper, z, weight, v, slope, factor):
    """Fill in the slope of a group's integrand and the Cholesky factor of its curvature."""
    size = v.size
    for j in range(size):
        slope[j] = -v[j]
        for k in range(size):
            factor[j, k] = 1.0 if j == k else 0.0
    for i in range(lower.size):
        shift = 0.0
        for j in range(size):
            shift += z[i, j] * v[j]
        below = 1.0 / (1.0 + np.exp(shift - lower[i]))
        above = 1.0 / (1.0 + np.exp(shift - upper[i]))
        bend = weight[i] * (below * (1.0 - below) + above * (1.0 - above))
        for j in range(size):
            slope[j] += weight[i] * z[i, j] * (below + above - 1.0)
            for k in range(j + 1):
                factor[j, k] += bend * z[i, j] * z[i, k]
    for j in range(size):
        for k in range(j + 1):
            for m in range(k):
                factor[j, k] -= factor[j, m] * factor[k, m]
            factor[j, k] = np.sqrt(factor[j, j]) if j == k else factor[j, k] / factor[k, k]


@njit
def _backward(factor, vector):
    """Replace a vector by C⁻ᵀ vector, C the factor."""
    for j in range(vector.size - 1, -1, -1):
        for k in range(j + 1, vector.size):
            vector[j] -= factor[k, j] * vector[k]
        vector[j] /= factor[j, j]


@njit
def _log_integral(lower, upper, z, weight, v, nodes, log_weights):
    """
    Return log ∫ ∏ P φ(v) dv of a group; nodes lie about its mode (Pinheiro and Bates, 1995), which
    is searched for from v and left there.
    """
    size = z.shape[1]
    here = _group(lower, upper, z, weight, v)
    step = np.empty(size)
    factor = np.empty((size, size))
    for _ in range(200):
        _curve(lower, upper, z, weight, v, step, factor)
        for j in range(size):
            for k in range(j):
                step[j] -= factor[j, k] * step[k]
            step[j] /= factor[j, j]
        _backward(factor, step)
        if np.abs(step).max() < 1e-10:
            break
        # The integrand is log-concave: a step that is short enough goes up.
        for _ in range(40):
            there = _group(lower, upper, z, weight, v + step)
            if there >= here - 1e-13 * (1.0 + abs(here)):
                break
            step *= 0.5
        v += step
        here = there
    values = np.empty(len(nodes))
    point = np.empty(size)
    for n in range(len(nodes)):
        # point = v + √2 C⁻ᵀ node, C Cᵀ the curvature.
        for j in range(size):
            point[j] = np.sqrt(2.0) * nodes[n, j]
        _backward(factor, point)
        point += v
        values[n] = log_weights[n] + _group(lower, upper, z, weight, point)
    greatest = values.max()
    if greatest == -np.inf:
        return greatest
    log_det = 0.0
    for j in range(size):
        log_det += np.log(factor[j, j])
    share = np.exp(values - greatest).sum()
    return greatest + np.log(share) - log_det - 0.5 * size * np.log(np.pi)


@njit
def log_likelihood(lower, upper, z, weight, first, factor, modes, nodes, log_weights):
    """
    Return Σ log ∫ ∏ (F(upper − z L v) − F(lower − z L v))^weight φ(v) dv over groups.

    Parameters
    ----------
    lower, upper : numpy.ndarray
        Bounds θ − x β of every row's category; infinite for the first and last.
    z, weight, first : numpy.ndarray
        As of `Rows`.
    factor : numpy.ndarray, shape (q, q)
        L, lower triangular.
    modes : numpy.ndarray, shape (groups, q)
        Where the search for modes starts; afterwards, the modes.
    nodes, log_weights : numpy.ndarray
        As of `Quadrature`.
    """
    scaled = np.zeros(z.shape)
    for i in range(len(z)):
        for j in range(z.shape[1]):
            for k in range(j, z.shape[1]):
                scaled[i, j] += z[i, k] * factor[k, j]
    total = 0.0
    for g in range(first.size - 1):
        rows = slice(first[g], first[g + 1])
        total += _log_integral(
            lower[rows], upper[rows], scaled[rows], weight[rows], modes[g], nodes, log_weights
        )
    return total


@njit
def _unpacked(parameters, rows, cuts):
    """
    Return β, thresholds, nominal effects and L. Parameters are β, θ_1, log(θ_k − θ_(k−1)), nominal
    effects by threshold, and the entries of L by rows; without cuts θ is one 0.
    """
    count = rows.x.shape[1]
    beta = parameters[:count]
    thresholds = np.zeros(max(cuts, 1))
    for k in range(cuts):
        value = parameters[count + k]
        thresholds[k] = value if k == 0 else thresholds[k - 1] + np.exp(value)
    place = count + cuts
    nominal = np.zeros((thresholds.size, rows.nominal.shape[1]))
    for k in range(nominal.shape[0]):
        for j in range(nominal.shape[1]):
            nominal[k, j] = parameters[place]
            place += 1
    size = rows.z.shape[1]
    factor = np.zeros((size, size))
    for j in range(size):
        for k in range(j + 1):
            factor[j, k] = parameters[place]
            place += 1
    return beta, thresholds, nominal, factor


@njit
def _loss(parameters, rows, cuts, modes, nodes, log_weights):
    """Return the negative log-likelihood."""
    beta, thresholds, nominal, factor = _unpacked(parameters, rows, cuts)
    lower = np.full(rows.category.size, -np.inf)
    upper = np.full(rows.category.size, np.inf)
    for i in range(rows.category.size):
        eta = 0.0
        for j in range(beta.size):
            eta += rows.x[i, j] * beta[j]
        for side in range(2):
            k = rows.category[i] - 1 + side
            if k < 0 or k >= thresholds.size:
                continue
            bound = thresholds[k] - eta
            for j in range(nominal.shape[1]):
                bound -= rows.nominal[i, j] * nominal[k, j]
            if side:
                upper[i] = bound
            else:
                lower[i] = bound
    return -log_likelihood(
        lower, upper, rows.z, rows.weight, rows.first, factor, modes, nodes, log_weights
    )


@njit
def _slope(parameters, size, rows, cuts, modes, nodes, log_weights):
    """
    Return the gradient of the loss by differences: central ones for a search, or with wider steps
    those whose error falls with the fourth power.
    """
    slope = np.empty(parameters.size)
    values = np.empty(4)
    offsets = (-1.0, 1.0, -2.0, 2.0)
    count = 4 if size == EXACT else 2
    for i in range(parameters.size):
        step = size * max(1.0, abs(parameters[i]))
        moved = parameters.copy()
        for j in range(count):
            moved[i] = parameters[i] + offsets[j] * step
            values[j] = _loss(moved, rows, cuts, modes, nodes, log_weights)
        near = values[1] - values[0]
        far = values[3] - values[2]
        slope[i] = (8.0 * near - far) / (12.0 * step) if count == 4 else near / (2.0 * step)
    return slope


class Cumulative:
    """
    Answers in ordered categories by group; a model is fitted to them or draws them.

    Parameters
    ----------
    codes : numpy.ndarray
        Group of each row.
    z : numpy.ndarray, shape (N, q)
        Regressors of random effects.
    points : int
        Nodes of the quadrature in each direction.
    categories : int
        How many there are; 2 with thresholds fixed at 0 where `cuts` is 0.
    cuts : int, optional
        Free thresholds; categories − 1 when not given.
    weight : numpy.ndarray, optional
        How often each row counts; once when not given.
    """

    def __init__(
        self,
        codes: np.ndarray,
        z: np.ndarray,
        points: int,
        categories: int,
        cuts: int | None = None,
        weight: np.ndarray | None = None,
    ):
        self.codes = codes
        self.z = z
        self.categories = categories
        self.cuts = categories - 1 if cuts is None else cuts
        self._weight = np.ones(len(z)) if weight is None else weight
        self._order = np.argsort(codes, kind="stable")
        self._first = np.concatenate([[0], np.cumsum(np.bincount(codes))])
        self._quadrature = quadrature(points, z.shape[1])

    def fit(
        self,
        category: np.ndarray,
        x: np.ndarray,
        *,
        nominal: np.ndarray | None = None,
        start: np.ndarray | None = None,
        covariance: bool = False,
    ) -> CumulativeFit:
        """
        Return the maximum of the likelihood; with `covariance`, to the last digits and with the
        inverse of the observed information. `nominal` regressors have an effect on every threshold.
        """
        order = self._order
        nominal = np.zeros((len(x), 0)) if nominal is None else nominal
        unit = np.abs(x).max(axis=0, initial=0.0) if x.shape[1] else np.ones(0)
        rows = Rows(
            np.ascontiguousarray(x[order] / unit),
            np.ascontiguousarray(nominal[order]),
            np.ascontiguousarray(self.z[order]),
            category[order].astype(np.int64),
            self._weight[order],
            self._first,
        )
        modes = np.zeros((self._first.size - 1, self.z.shape[1]))
        data = (rows, self.cuts, modes, *self._quadrature)
        start = self._start(category, nominal.shape[1], unit * 0.0 if start is None else start)
        search = minimize(
            _loss, start, data, "BFGS", jac=lambda p, *d: _slope(p, QUICK, *d), options=_OPTIONS
        )
        point = search.x
        spread = _unpacked(point, *data[:2])[3]
        fixed = point.size - spread.shape[0] * (spread.shape[0] + 1) // 2
        information = np.zeros((fixed, fixed))
        if covariance:
            # Where random effects do not vary L is at its boundary, and carries no information on
            # the rest.
            regular = np.abs(np.diag(spread)).min() > _SINGULAR
            free = np.arange(point.size if regular else fixed)
            point, hessian = polished(lambda p: _slope(p, EXACT, *data), point, free)
            information = self._covariance(np.linalg.inv(hessian)[:fixed, :fixed], point, unit)
        beta, thresholds, effects, factor = _unpacked(point, *data[:2])
        return CumulativeFit(
            -float(_loss(point, *data)), beta / unit, thresholds, effects, factor, information
        )

    def _start(self, category: np.ndarray, nominal: int, beta: np.ndarray) -> np.ndarray:
        """Return where the search starts: thresholds as without effects, and random ones of .7."""
        counts = np.bincount(category.astype(int), self._weight, minlength=self.categories)
        below = np.cumsum(counts)[:-1] / counts.sum()
        theta = special.logit(np.clip(below, 1e-3, 1.0 - 1e-3))[: self.cuts]
        gaps = np.log(np.maximum(np.diff(theta), 1e-2))
        factor = 0.7 * np.eye(self.z.shape[1])[np.tril_indices(self.z.shape[1])]
        effects = np.zeros(nominal * max(self.cuts, 1))
        return np.concatenate([beta, theta[:1], gaps, effects, factor])

    def _covariance(self, inverse: np.ndarray, point: np.ndarray, unit: np.ndarray) -> np.ndarray:
        """Return the covariance of coefficients and thresholds from that of the parameters."""
        turn = np.eye(len(inverse))
        turn[: unit.size, : unit.size] = np.diag(1.0 / unit)
        for k in range(1, self.cuts):
            turn[unit.size + k :, unit.size + k] = 0.0
            below = slice(unit.size + k, unit.size + self.cuts)
            turn[below, unit.size + k] = np.exp(point[unit.size + k])
            turn[unit.size + k, unit.size] = 1.0
        return turn @ inverse @ turn.T

    def draw(self, fit: CumulativeFit, x: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Return categories drawn from a fitted model."""
        normal = rng.standard_normal((self.codes.max() + 1, self.z.shape[1]))
        effects = (normal @ fit.factor.T)[self.codes]
        eta = x @ fit.beta + (self.z * effects).sum(axis=1)
        noise = special.logit(rng.random(len(x)))
        return (eta[:, None] + noise[:, None] > fit.thresholds).sum(axis=1).astype(float)


_OPTIONS = {"gtol": 1e-6}


class Logistic:
    """
    Counts out of trials by group: the model of two categories, successes and failures, with a
    threshold of 0 and random intercepts.
    """

    def __init__(self, codes: np.ndarray, trials: np.ndarray, points: int):
        self.codes = codes
        self.trials = trials
        self.points = points

    def fit(self, counts: np.ndarray, x: np.ndarray, covariance: bool = False) -> CumulativeFit:
        """
        Return the maximum of the likelihood, without binomial coefficients; with `covariance`, to
        the last digits and with the inverse of the observed information.
        """
        weight = np.concatenate([self.trials - counts, counts])
        rows = np.flatnonzero(weight)
        codes = np.tile(self.codes, 2)[rows]
        category = np.repeat([0.0, 1.0], counts.size)[rows]
        model = Cumulative(codes, np.ones((rows.size, 1)), self.points, 2, 0, weight[rows])
        # Least squares of empirical logits: near enough to start from.
        logits = np.log((counts + 0.5) / (self.trials - counts + 0.5))
        start = np.abs(x).max(axis=0) * np.linalg.lstsq(x, logits, rcond=None)[0]
        return model.fit(category, np.tile(x, (2, 1))[rows], start=start, covariance=covariance)

    def constant_groups(self, counts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the groups with no success at all, and those with nothing else."""
        successes = np.bincount(self.codes, counts)
        trials = np.bincount(self.codes, self.trials)
        return np.flatnonzero(successes == 0), np.flatnonzero(successes == trials)

    def log_coefficients(self, counts: np.ndarray) -> float:
        """Return the sum of the logarithms of the binomial coefficients."""
        return float(
            -(np.log1p(self.trials) + special.betaln(counts + 1, self.trials - counts + 1)).sum()
        )

    def draw(self, fit: CumulativeFit, x: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Return counts drawn from a fitted model."""
        effects = fit.sd * rng.standard_normal(self.codes.max() + 1)
        return rng.binomial(
            self.trials.astype(int), special.expit(x @ fit.beta + effects[self.codes])
        ).astype(float)


def checked_counts(counts: np.ndarray, data: pd.DataFrame, trials: str | None) -> np.ndarray:
    """Return the number of trials of every row, which successes must be counts out of."""
    out_of = np.ones(counts.size)
    remedy = 'trials="…" names the column with how many there were'
    if trials is not None:
        out_of = finite_array("trials", column_of(data, "trials", trials))
        remedy = "check both columns"
    fractional = (out_of != np.round(out_of)) | (counts != np.round(counts))
    bad = (out_of < 1) | (counts < 0) | (counts > out_of) | fractional
    if bad.any():
        row = int(np.argmax(bad))
        raise ValueError(
            f"row {row}: {counts[row]:g} of {out_of[row]:g} is no number of successes; {remedy}"
        )
    return out_of
