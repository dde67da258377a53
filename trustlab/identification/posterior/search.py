"""
Where the posterior is greatest: starting values from draws of the prior, and ascents from them.

Everything is compiled and adds in a fixed order, so that a search goes the same way everywhere.
"""

from typing import NamedTuple

import numpy as np

from trustlab.identification.model import IdentificationError
from trustlab.identification.posterior.coordinates import Target, density, from_theta
from trustlab.identification.posterior.likelihood import (
    BETA,
    H_MIN,
    H_NOISE,
    H_SPAN,
    MEMORY,
    P_MIN,
    P_NOISE,
    P_SPAN,
    SLOW,
    STATES,
    TAU_P,
    WHITE,
    robot,
    shapes,
    simulate,
)
from trustlab.models.compiled import njit
from trustlab.models.linear_algebra import symmetric_eigen

# Steps of central differences in units of the prior's standard deviation: of the density and of
# its gradient.
STEP = 1e-4
WIDE_STEP = 2e-3

# Least curvature that a step or a proposal goes by: nothing is wider than two prior deviations.
LEAST_CURVATURE = 0.25

# Time constants of the robot that a start tries, in prior deviations from the mean.
GRID = np.linspace(-1.8, 1.8, 7)

# Starts, in prior deviations of times and β, at least as far apart as this.
APART = 0.4


# --- derivatives ----------------------------------------------------------------------------------


@njit
def gradient(x, target):
    """Return the derivatives of the density's logarithm by central differences."""
    out = np.empty(x.size)
    at = x.copy()
    for i in range(x.size):
        at[i] = x[i] + STEP
        above = density(at, target)
        at[i] = x[i] - STEP
        slope = (above - density(at, target)) / (2.0 * STEP)
        out[i] = slope if abs(slope) < np.inf else 0.0  # beside what makes no model
        at[i] = x[i]
    return out


@njit
def curvature(x, target):
    """Return minus the second derivatives of the density's logarithm."""
    size = x.size
    out = np.empty((size, size))
    at = x.copy()
    for i in range(size):
        at[i] = x[i] + WIDE_STEP
        above = gradient(at, target)
        at[i] = x[i] - WIDE_STEP
        below = gradient(at, target)
        for j in range(size):
            out[i, j] = (below[j] - above[j]) / (2.0 * WIDE_STEP)
        at[i] = x[i]
    for i in range(size):
        for j in range(i):
            out[i, j] = 0.5 * (out[i, j] + out[j, i])
            out[j, i] = out[i, j]
    return out


@njit
def inverse_of_size(matrix, least):
    """Return the inverse of a symmetric matrix by its eigenvalues' sizes, at least `least`."""
    size = len(matrix)
    values, vectors = symmetric_eigen(matrix.reshape(1, size, size))
    out = np.zeros((size, size))
    for k in range(size):
        weight = 1.0 / max(abs(values[0, k]), least)
        for i in range(size):
            for j in range(size):
                out[i, j] += weight * vectors[0, i, k] * vectors[0, j, k]
    return out


# --- ascents --------------------------------------------------------------------------------------


@njit
def _product(matrix, vector):
    out = np.zeros(len(matrix))
    for i in range(len(matrix)):
        for j in range(vector.size):
            out[i] += matrix[i, j] * vector[j]
    return out


@njit
def _dot(a, b):
    total = 0.0
    for i in range(a.size):
        total += a[i] * b[i]
    return total


@njit
def _update(inverse, step, change):
    """Update an inverse curvature by a step and the change of the slope (BFGS)."""
    along = _dot(step, change)
    if along <= 1e-10:
        return
    turned = _product(inverse, change)
    factor = (1.0 + _dot(change, turned) / along) / along
    for i in range(step.size):
        for j in range(step.size):
            cross = turned[i] * step[j] + step[i] * turned[j]
            inverse[i, j] += factor * step[i] * step[j] - cross / along


@njit
def ascend(x, target, inverse, most):
    """Return the point and the value that BFGS steps reach from x."""
    value = density(x, target)
    slope = gradient(x, target)
    for _ in range(most):
        step = _product(inverse, slope)
        gain = _dot(step, slope)
        if not gain > 1e-3:  # within a fiftieth of a standard deviation of the top
            break
        share = 1.0
        after = density(x + step, target)
        while not after > value + 1e-4 * share * gain and share > 1e-4:
            share *= 0.4
            after = density(x + share * step, target)
        if not after > value:
            break
        moved = share * step
        x = x + moved
        new = gradient(x, target)
        _update(inverse, moved, slope - new)
        slope = new
        value = after
    return x, value


class Top(NamedTuple):
    """A maximum of the density: where, the logarithm there, and the covariance of its hill."""

    x: np.ndarray
    value: float
    covariance: np.ndarray


def climb(x: np.ndarray, target: Target) -> Top:
    """Ascend twice, each time from the curvature at the beginning."""
    for most in (40, 60):
        inverse = inverse_of_size(curvature(x, target), 0.3)
        x, value = ascend(x, target, inverse, most)
    return Top(x, value, inverse_of_size(curvature(x, target), LEAST_CURVATURE))


# --- starting values ------------------------------------------------------------------------------


@njit
def ridge(columns, left, means, deviations):
    """Return the two coefficients of least squares, drawn to their prior; and Σ e²."""
    scatter = 2e-4  # noise variance against which the prior counts: .014²
    s11 = scatter / deviations[0] ** 2
    s22 = scatter / deviations[1] ** 2
    s12 = 0.0
    t1 = 0.0
    t2 = 0.0
    for k in range(left.size):
        if np.isnan(left[k]):
            continue
        rest = left[k] - means[0] * columns[0, k] - means[1] * columns[1, k]
        s11 += columns[0, k] ** 2
        s12 += columns[0, k] * columns[1, k]
        s22 += columns[1, k] ** 2
        t1 += columns[0, k] * rest
        t2 += columns[1, k] * rest
    determinant = s11 * s22 - s12 * s12
    first = means[0] + (s22 * t1 - s12 * t2) / determinant
    second = means[1] + (s11 * t2 - s12 * t1) / determinant
    squares = 0.0
    for k in range(left.size):
        if not np.isnan(left[k]):
            squares += (left[k] - first * columns[0, k] - second * columns[1, k]) ** 2
    return first, second, squares


@njit
def _within(value, mean, deviation):
    """Return the logarithm of a range, at most 2.5 prior deviations from its mean."""
    return min(max(np.log(max(value, 1e-9)), mean - 2.5 * deviation), mean + 2.5 * deviation)


@njit
def fit_human(theta, target):
    """Set P_h,min and the range of θ by least squares; return Σ e²."""
    blocks = target.blocks
    columns = np.ones(blocks.measured.shape)
    shapes(theta, blocks, np.empty(blocks.lengths.size), columns[1])
    mean = target.mean
    width = np.exp(mean[H_SPAN])
    deviations = np.array([target.deviation[H_MIN], width * target.deviation[H_SPAN]])
    means = np.array([mean[H_MIN], width])
    low, span, squares = ridge(columns, blocks.measured[0], means, deviations)
    theta[H_MIN] = max(low, 1e-3)
    theta[H_SPAN] = _within(span, mean[H_SPAN], target.deviation[H_SPAN])
    return squares


@njit
def fit_robot(theta, target):
    """Set P_r,min, the range and the starts of θ by least squares; return Σ e²."""
    blocks = target.blocks
    runs = blocks.first_block.size - 1
    shape = np.empty(blocks.lengths.size)
    columns = np.empty(blocks.measured.shape)
    shapes(theta, blocks, shape, columns[0])
    low = theta[H_MIN]
    span = np.exp(theta[H_SPAN])
    a = np.exp(-blocks.step / np.exp(theta[TAU_P]))
    none = np.zeros(runs)
    starts = np.zeros(runs)
    for run in range(runs):
        first = blocks.measured[1, blocks.first_block[run]]
        starts[run] = target.mean[P_MIN] if np.isnan(first) else first
    # P_r is linear in its start, P_r,min and the range.
    robot(blocks, shape, a, low, span, 0.0, 0.0, starts, columns[0])
    left = blocks.measured[1] - columns[0]
    robot(blocks, shape, a, low, span, 1.0, 0.0, none, columns[0])
    robot(blocks, shape, a, low, span, 0.0, 1.0 / (low + span), none, columns[1])
    mean = target.mean
    width = np.exp(mean[P_SPAN])
    deviations = np.array([target.deviation[P_MIN], width * target.deviation[P_SPAN]])
    means = np.array([mean[P_MIN], width])
    least, wide, squares = ridge(columns, left, means, deviations)
    theta[P_MIN] = max(least, 1e-3)
    theta[P_SPAN] = _within(wide, mean[P_SPAN], target.deviation[P_SPAN])
    for run in range(runs):
        place = STATES + 2 * run + 1
        reach = 2.5 * target.deviation[place]
        theta[place] = min(max(max(starts[run], 0.0) - theta[P_MIN], -reach), reach)
        theta[place] = max(theta[place], 1e-6 - theta[P_MIN])
    return squares


@njit
def fit_noise(theta, target):
    """Set the noise of θ from the residuals' spread and their correlation at lag 1."""
    blocks = target.blocks
    means = simulate(theta, blocks)
    for j in range(2):
        errors = blocks.measured[j] - means[j]
        square = 1e-14
        product = 0.0
        count = 1e-9
        before = 0.0
        for k in range(errors.size):
            error = 0.0 if np.isnan(errors[k]) else errors[k]
            square += error * error
            product += error * before
            count += 1.0
            before = error
        rho = min(max(product / square, 0.02), 0.99)
        spread = np.sqrt(square / count)
        place = H_NOISE if j == 0 else P_NOISE
        of_noise = (
            np.log(spread * np.sqrt(blocks.samples * (1.0 - 0.9 * rho))),
            np.log(spread * rho),
            np.log(-blocks.step * blocks.samples / np.log(max(rho, 0.5))),
        )
        for part, value in zip((WHITE, SLOW, MEMORY), of_noise):  # noqa: B905 (numba)
            reach = 2.5 * target.deviation[place + part]
            mean = target.mean[place + part]
            theta[place + part] = min(max(value, mean - reach), mean + reach)


@njit
def fit_humans(thetas, target):
    """Complete each row θ by least squares in P_h, in place; return what they leave over."""
    squares = np.empty(len(thetas))
    for i in range(len(thetas)):
        squares[i] = fit_human(thetas[i], target)
    return squares


@njit
def fit_the_rest(thetas, target):
    """Complete each row θ by least squares in P_r and by its noise, in place."""
    for theta in thetas:
        best = np.inf
        candidate = theta.copy()
        for shift in GRID:
            candidate[TAU_P] = target.mean[TAU_P] + shift * target.deviation[TAU_P]
            error = fit_robot(candidate, target)
            if error < best:
                best = error
                for i in range(theta.size):  # an assignment of the row would compile for seconds
                    theta[i] = candidate[i]
        fit_noise(theta, target)


def screened(thetas: np.ndarray, target: Target, keep: int) -> np.ndarray:
    """Return `keep` of the rows θ, completed by least squares, the best in P_h first."""
    order = np.argsort(fit_humans(thetas, target), kind="stable")
    best = thetas[order[:keep]]
    fit_the_rest(best, target)
    return best


def starting_points(target: Target, rng: np.random.Generator, draws: int, most: int) -> list:
    """Return the best draws of the prior, completed by least squares and apart from each other."""
    z = np.clip(rng.standard_normal((draws, target.mean.size)), -2.0, 2.0)
    z[0] = 0.0
    thetas = target.mean + target.deviation * z
    points = []
    for theta in screened(thetas, target, 4 * most):
        at = target.mean.copy()
        at[target.free] = theta[target.free]
        x = from_theta(at, target)
        value = density(x, target)
        if value > -np.inf:
            points.append((value, x))
    if not points:
        means = np.nanmean(target.blocks.measured, axis=1)
        raise IdentificationError(
            f"the data lie far from what the prior expects: p_h is {means[0]:.3g} and p_r "
            f"{means[1]:.3g} on average; state the scale of your measure with "
            "prior=trustlab.Prior(human_p_min=(…, …), human_span=(…, …), robot_p_min=(…, …), "
            "robot_span=(…, …))"
        )
    chosen: list[np.ndarray] = []
    for _, x in sorted(points, key=lambda point: -point[0]):
        places = [0, BETA, TAU_P]
        if all(np.abs(x - start)[places].max() > APART for start in chosen):
            chosen.append(x)
    return chosen[:most]
