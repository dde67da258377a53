"""Logistic models with a random intercept per group, by adaptive Gauss–Hermite quadrature."""

from typing import NamedTuple

import numpy as np
import pandas as pd
from scipy import special
from scipy.optimize import minimize

from trustlab.models.checks import finite_array
from trustlab.models.compiled import njit
from trustlab.studies.columns import column_of
from trustlab.studies.regression.newton import polished


class LogisticFit(NamedTuple):
    """
    Estimates: log-likelihood without binomial coefficients, logits, SD of the intercepts,
    covariance of the logits.
    """

    llf: float
    beta: np.ndarray
    sd: float
    covariance: np.ndarray


@njit
def _log_likelihood(eta, counts, trials, first, sd, nodes, log_weights):
    """
    Return Σ log ∫ ∏ p^count (1 − p)^(trials − count) φ(v) dv over groups, logit p = η + sd v,
    without binomial coefficients.

    Group g has rows first[g] to first[g + 1]. Nodes lie about the mode of each group's integrand
    (Pinheiro and Bates, 1995); one node is Laplace's approximation.
    """
    total = 0.0
    values = np.empty(nodes.size)
    for g in range(first.size - 1):
        v = 0.0
        low = -1e3
        high = 1e3
        curvature = 1.0
        for _ in range(200):
            slope, curvature = -v, 1.0
            for i in range(first[g], first[g + 1]):
                p = 1.0 / (1.0 + np.exp(-(eta[i] + sd * v)))
                slope += sd * (counts[i] - trials[i] * p)
                curvature += sd * sd * trials[i] * p * (1.0 - p)
            if slope > 0.0:
                low = v
            else:
                high = v
            step = slope / curvature
            if abs(step) < 1e-11:
                break
            # The slope falls in v: where Newton's step leaves the bracket, the bracket is halved.
            v = v + step if low < v + step < high else 0.5 * (low + high)
        spread = np.sqrt(2.0 / curvature)
        greatest, share = -np.inf, 0.0
        for k in range(nodes.size):
            u = v + spread * nodes[k]
            values[k] = log_weights[k] + nodes[k] ** 2 - 0.5 * u * u
            for i in range(first[g], first[g + 1]):
                x = eta[i] + sd * u
                values[k] += counts[i] * x - trials[i] * (max(x, 0.0) + np.log1p(np.exp(-abs(x))))
            greatest = max(greatest, values[k])
        for value in values:
            share += np.exp(value - greatest)
        total += greatest + np.log(share) + np.log(spread) - 0.5 * np.log(2.0 * np.pi)
    return total


@njit
def _loss(parameters, rows, counts, trials, first, nodes, log_weights):
    """Return the negative log-likelihood at logits and SD (of either sign)."""
    eta = np.zeros(counts.size)
    for i in range(counts.size):
        for j in range(rows.shape[1]):
            eta[i] += rows[i, j] * parameters[j]
    return -_log_likelihood(eta, counts, trials, first, abs(parameters[-1]), nodes, log_weights)


@njit
def _slope(parameters, rows, counts, trials, first, nodes, log_weights):
    """Return the gradient of the loss by central differences, for the search."""
    slope = np.empty(parameters.size)
    data = rows, counts, trials, first, nodes, log_weights
    for i in range(parameters.size):
        step = 1e-5 * max(1.0, abs(parameters[i]))
        moved = parameters.copy()
        moved[i] = parameters[i] + step
        above = _loss(moved, *data)
        moved[i] = parameters[i] - step
        slope[i] = (above - _loss(moved, *data)) / (2.0 * step)
    return slope


@njit
def _exact_slope(parameters, rows, counts, trials, first, nodes, log_weights):
    """Return the gradient by wider differences, whose error falls with the fourth power."""
    slope = np.empty(parameters.size)
    data = rows, counts, trials, first, nodes, log_weights
    for i in range(parameters.size):
        step = 2e-3 * max(1.0, abs(parameters[i]))
        moved = parameters.copy()
        values = np.empty(4)
        for j, size in enumerate((-2.0, -1.0, 1.0, 2.0)):
            moved[i] = parameters[i] + size * step
            values[j] = _loss(moved, *data)
        near = values[2] - values[1]
        far = values[3] - values[0]
        slope[i] = (8.0 * near - far) / (12.0 * step)
    return slope


class Logistic:
    """Counts out of trials by group: a random-intercept model is fitted to them or draws them."""

    def __init__(self, codes: np.ndarray, trials: np.ndarray, points: int):
        self.codes, self.trials = codes, trials
        self._order = np.argsort(codes, kind="stable")
        self._first = np.concatenate([[0], np.cumsum(np.bincount(codes))])
        self._nodes, weights = np.polynomial.hermite.hermgauss(points)
        self._log_weights = np.log(weights)

    def fit(self, counts: np.ndarray, x: np.ndarray, covariance: bool = False) -> LogisticFit:
        """
        Return the maximum of the likelihood; with `covariance`, to the last digits and with the
        inverse of the observed information.
        """
        order = self._order
        unit = np.abs(x).max(axis=0)
        rows = np.ascontiguousarray(x[order] / unit)
        quadrature = self._first, self._nodes, self._log_weights
        data = (rows, counts[order], self.trials[order], *quadrature)
        # Least squares of empirical logits: near enough to start from.
        logits = np.log((counts + 0.5) / (self.trials - counts + 0.5))
        start = np.append(unit * np.linalg.lstsq(x, logits, rcond=None)[0], 0.7)
        point = minimize(_loss, start, data, "BFGS", jac=_slope, options={"gtol": 1e-6}).x
        information = np.zeros((unit.size, unit.size))
        if covariance:
            # Where the intercepts do not vary the SD is at its boundary, and carries no information
            # on the logits.
            free = np.arange(point.size if abs(point[-1]) > _SINGULAR else point.size - 1)
            point, hessian = polished(
                lambda parameters: _exact_slope(parameters, *data), point, free
            )
            inverse = np.linalg.inv(hessian)
            information = inverse[: unit.size, : unit.size] / np.outer(unit, unit)
        return LogisticFit(
            -float(_loss(point, *data)), point[:-1] / unit, abs(float(point[-1])), information
        )

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

    def draw(self, fit: LogisticFit, x: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Return counts drawn from a fitted model."""
        effects = fit.sd * rng.standard_normal(self.codes.max() + 1)
        return rng.binomial(
            self.trials.astype(int), special.expit(x @ fit.beta + effects[self.codes])
        ).astype(float)


# SD below which intercepts do not vary.
_SINGULAR = 1e-3


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
