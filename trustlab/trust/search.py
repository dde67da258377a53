"""Coordinates of least loss by differences: of all people, of each, and the ends of intervals."""

from collections.abc import Callable

import numpy as np
from scipy.optimize import minimize

# A loss of each row of coordinates, shape (rows, parameters), on the person with its number.
Losses = Callable[[np.ndarray, np.ndarray], np.ndarray]
# Steps of first and second differences, in coordinates without bounds.
STEP = 1e-6
CURVE = 3e-3
# Beyond ±9 a parameter is at its bound for all purposes.
EDGE = 9.0
ROUNDS = 30
# The root of twice the fall of the log-likelihood at the ends of a 95 % interval, and its error.
FALL = 1.96
NEAR = 0.02
# Spread of a coordinate that is held where it is put.
HELD = 1e-4


def pooled_optimum(losses: Losses, start: np.ndarray, people: np.ndarray) -> np.ndarray:
    """Return the coordinates of least total loss: all differences of a gradient in one run."""
    moves = np.concatenate([np.zeros((1, start.size)), STEP * np.eye(start.size)])

    def loss_and_slope(x: np.ndarray):
        totals = total_loss(losses, x + moves, people) / people.size
        return totals[0], (totals[1:] - totals[0]) / STEP

    if not start.size:
        return start
    bounds = [(-EDGE, EDGE)] * start.size
    return minimize(loss_and_slope, start, jac=True, method="L-BFGS-B", bounds=bounds).x


def total_loss(losses: Losses, x: np.ndarray, people: np.ndarray) -> np.ndarray:
    """Return the loss of all people at each row of coordinates."""
    each = losses(np.repeat(x, people.size, axis=0), np.tile(people, len(x)))
    return each.reshape(len(x), people.size).sum(axis=1)


def profile_ends(losses: Losses, centre: np.ndarray, people: np.ndarray) -> np.ndarray:
    """
    Return the ends of 95 % intervals of pooled coordinates, shape (2, parameters).

    At an end the log-likelihood, with all other coordinates at their best, is 1.92 less than at the
    centre: D. J. Venzon, S. H. Moolgavkar, Applied Statistics 37(1), 1988. An end is infinite where
    a parameter reaches its bound before, and NaN where the search did not settle.
    """
    # Every end is searched like a person whose coordinates are all free but one.
    place = np.tile(np.arange(centre.size), 2)
    side = np.repeat([-1.0, 1.0], centre.size)
    spread = np.full((place.size, centre.size), np.inf)
    spread[np.arange(place.size), place] = HELD

    def total(x: np.ndarray, _: np.ndarray) -> np.ndarray:
        return total_loss(losses, x, people)

    least, _, curvature = derivatives(total, centre[None], place[:1])
    covariance = np.linalg.inv(definite(curvature[0]))
    variance = np.diag(covariance)
    distance = np.minimum(FALL * np.sqrt(variance), 1.0)[place]
    # How the others change with a coordinate while the loss is quadratic; those that it leaves open
    # stay about where they are.
    along = (covariance / variance).T[place] * distance[:, None]
    along = np.clip(along, -1.0, 1.0) / distance[:, None]
    ends = np.full(place.size, np.nan)
    x = np.tile(centre, (place.size, 1))
    rows = np.arange(place.size)
    before = np.zeros(place.size)
    reached = np.zeros(place.size)
    for _ in range(ROUNDS):
        at = np.clip(centre[place] + side * distance, -EDGE, EDGE)[rows]
        change = at - x[rows, place[rows]]
        x[rows] += change[:, None] * along[rows]
        for _ in range(4):
            stepped, _, moved = newton_step(total, x[rows], rows, x[rows], spread[rows])
            x[rows] = np.clip(stepped, -EDGE, EDGE)
            if moved < 0.05:
                break
        fall = np.sqrt(2.0 * np.maximum(total(x[rows], rows) - least, 1e-12))
        settled = np.abs(fall - before[rows]) < NEAR
        beyond = settled & (np.abs(at) == EDGE) & (fall < FALL)
        ends[rows] = np.where(beyond, np.inf * side[rows], at)
        power = _power(fall, before[rows], distance[rows], reached[rows])
        before[rows] = fall
        reached[rows] = distance[rows]
        distance[rows] *= np.clip((FALL / fall) ** (1.0 / power), 0.5, 2.0)
        distance = np.minimum(distance, 2.0 * EDGE)
        rows = rows[~beyond & ~(settled & (np.abs(fall - FALL) < NEAR))]
        if not rows.size:
            break
    # Towards a bound the likelihood may level off before it has fallen enough.
    ends[rows] = np.where(before[rows] < FALL, np.inf * side[rows], np.nan)
    return ends.reshape(2, centre.size)


def _power(fall, fall_before, distance, distance_before) -> np.ndarray:
    """
    Return the power of the distance that a fall is by its last two values.

    It is 1 where the loss is quadratic, and more where a parameter leaves its bound.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        power = np.log(fall / fall_before) / np.log(distance / distance_before)
    return np.where(np.isfinite(power), np.clip(power, 1.0, 20.0), 1.0)


def derivatives(losses: Losses, x: np.ndarray, people: np.ndarray):
    """Return every person's loss, gradient and matrix of second derivatives, by differences."""
    size, count = x.shape
    i, j = np.tril_indices(count)
    unit = CURVE * np.eye(count)
    moves = np.concatenate([np.zeros((1, count)), unit, -unit, unit[i] + unit[j]])
    stacked = (x + moves[:, None]).reshape(-1, count)
    values = losses(stacked, np.tile(people, len(moves))).reshape(len(moves), size)
    centre, ahead, behind, both = np.split(values, [1, count + 1, 2 * count + 1])
    slope = (ahead - behind).T / (2.0 * CURVE)
    # ∂²f/∂i∂j ≈ (f(i + j) − f(i) − f(j) + f)/h²
    mixed = (both - ahead[i] - ahead[j] + centre).T / CURVE**2
    curvature = np.zeros((size, count, count))
    curvature[:, i, j] = mixed
    curvature[:, j, i] = mixed
    return centre[0], slope, curvature


def newton_step(
    losses: Losses, x: np.ndarray, people: np.ndarray, centre: np.ndarray, spread: np.ndarray
):
    """
    Return everybody's coordinates after a step that lowers the loss with a normal prior, the
    curvature of the loss, and the greatest move.
    """
    loss, slope, curvature = derivatives(losses, x, people)
    weight = spread**-2.0

    def prior(coordinates: np.ndarray) -> np.ndarray:
        return 0.5 * ((coordinates - centre) ** 2 * weight).sum(axis=1)

    loss = loss + prior(x)
    slope = slope + (x - centre) * weight
    matrix = definite(curvature + weight[..., None] * np.eye(x.shape[1]))
    direction = -np.linalg.solve(matrix, slope[..., None])[..., 0]
    direction *= np.minimum(1.0, 2.0 / np.maximum(np.abs(direction).max(axis=1), 1e-12))[:, None]
    share = np.ones(people.size)
    for _ in range(6):
        tried = x + share[:, None] * direction
        worse = ~(losses(tried, people) + prior(tried) <= loss)
        if not worse.any():
            break
        share[worse] *= 0.3
    share[worse] = 0.0
    step = share[:, None] * direction
    return x + step, curvature, float(np.abs(step).max())


def definite(matrices: np.ndarray) -> np.ndarray:
    """Return symmetric matrices with eigenvalues of at least 1e-3."""
    values, vectors = np.linalg.eigh(matrices)
    values = np.maximum(values, 1e-3)
    return (vectors * values[..., None, :]) @ np.swapaxes(vectors, -1, -2)
