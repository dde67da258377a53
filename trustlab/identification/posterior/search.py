"""Where the posterior is greatest: ascents from the optima of a fit."""

from typing import NamedTuple

import numpy as np

from trustlab.identification.model import IdentificationError
from trustlab.identification.posterior.coordinates import FAR, Target, density, from_theta
from trustlab.identification.posterior.likelihood import (
    BETA,
    H_MIN,
    H_SPAN,
    NOISES,
    P_MIN,
    P_R0,
    P_SPAN,
    PER_RUN,
    R0,
    TAU_P,
    TAU_R,
    simulate,
)
from trustlab.identification.problem import Optimum
from trustlab.models.compiled import njit

# Steps of central differences in units of the prior's standard deviation: of the density and of
# its gradient.
STEP = 1e-4
WIDE_STEP = 2e-3

# Least curvature that a proposal goes by, nothing being wider than two prior deviations, and that
# an ascent begins with.
LEAST_CURVATURE = 0.25
STEEP = 0.3

# Slope per deviation of the hill at which an ascent ends, and minus the density where it is zero.
CLOSE = 1e-3
NOWHERE = 1e10

# Prior deviations from the mean within which an ascent begins: further out the prior would rule.
BULK = 2.5

# Least performance, range and share from which one begins.
LEAST = 1e-3


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


# --- ascents --------------------------------------------------------------------------------------


class Top(NamedTuple):
    """A maximum of the density: where, the logarithm there, and the covariance of its hill."""

    x: np.ndarray
    value: float
    covariance: np.ndarray


def hill(x: np.ndarray, target: Target, least: float) -> np.ndarray:
    """Return the inverse of the curvature's size, which is at least `least` in any direction."""
    values, vectors = np.linalg.eigh(curvature(x, target))
    return (vectors / np.maximum(np.abs(values), least)) @ vectors.T


def climb(x: np.ndarray, target: Target) -> Top:
    """Return the maximum that an ascent from x reaches."""
    from scipy.optimize import minimize

    # Distances in deviations of the hill, as its curvature at the beginning foretells these.
    root = np.linalg.cholesky(hill(x, target, STEEP))
    end = minimize(
        lambda z: -max(density(x + root @ z, target), -NOWHERE),
        np.zeros(x.size),
        jac=lambda z: -gradient(x + root @ z, target) @ root,
        method="BFGS",
        options={"gtol": CLOSE, "maxiter": 100},
    )
    reached = x + root @ end.x
    step = hill(reached, target, LEAST_CURVATURE) @ gradient(reached, target)
    # After Newton's step, and rounded, it is the same point on every processor. Where an ascent
    # stopped short, the step may lead to where there is no model.
    points = (np.round(reached + step, 4), np.round(reached, 4), x)
    top = next(point for point in points if density(point, target) >= density(x, target))
    return Top(top, float(density(top, target)), hill(top, target, LEAST_CURVATURE))


# --- where ascents begin --------------------------------------------------------------------------


def starting_points(target: Target, optima: list[Optimum]) -> list[np.ndarray]:
    """Return coordinates of the optima of a fit, drawn to the prior, and of its mean."""
    thetas = [*(_theta(optimum.values(), target) for optimum in optima), target.mean]
    points = [from_theta(_with_noise(theta, target), target) for theta in thetas]
    # To a thousandth of a prior deviation: from there on all is compiled and the same everywhere.
    points = [np.round(x, 3) for x in points]
    points = [x for x in points if density(x, target) > -np.inf]
    means = np.average(target.blocks.measured, axis=1, weights=target.blocks.known)
    low, span = [H_MIN, P_MIN], [H_SPAN, P_SPAN]
    ranges = np.exp(target.mean[span] + BULK * target.deviation[span])
    far = np.abs(means - target.mean[low]) > FAR * target.deviation[low] + ranges
    if far.any() or not points:
        raise IdentificationError(
            f"the data lie far from what the prior expects: p_h is {means[0]:.3g} and p_r "
            f"{means[1]:.3g} on average; state the scale of your measure with "
            "prior=trustlab.Prior(human_p_min=(…, …), human_span=(…, …), robot_p_min=(…, …), "
            "robot_span=(…, …))"
        )
    return sorted(points, key=lambda x: -density(x, target))


def _drawn_to_prior(theta: np.ndarray, target: Target) -> np.ndarray:
    """Return θ within the prior's bulk, and such that it makes a model."""
    reach = BULK * target.deviation
    theta = np.clip(theta, target.mean - reach, target.mean + reach)
    theta[[H_MIN, P_MIN]] = np.maximum(theta[[H_MIN, P_MIN]], LEAST)
    theta[P_R0::PER_RUN] = np.maximum(theta[P_R0::PER_RUN], LEAST - theta[P_MIN])
    return theta


def _theta(values: dict, target: Target) -> np.ndarray:
    """Return θ of a fit's estimates by name, noise at the prior's mean."""
    theta = target.mean.copy()
    step = target.blocks.step
    spans = [values[f"{who}_p_max"] - values[f"{who}_p_min"] for who in ("human", "robot")]
    theta[[TAU_R, TAU_P]] = np.log(-step / np.log([values["human_a"], values["robot_a"]]))
    theta[[H_MIN, P_MIN]] = values["human_p_min"], values["robot_p_min"]
    theta[[H_SPAN, P_SPAN]] = np.log(np.maximum(spans, LEAST))
    theta[BETA] = _log_odds(values["human_beta"])
    theta[R0::PER_RUN] = _log_odds(values["r0"])
    theta[P_R0::PER_RUN] = values["p_r0"] - values["robot_p_min"]
    return _drawn_to_prior(theta, target)


def _log_odds(share: np.ndarray | float) -> np.ndarray:
    share = np.clip(share, LEAST, 1.0 - LEAST)
    return np.log(share) - np.log1p(-share)


def _with_noise(theta: np.ndarray, target: Target) -> np.ndarray:
    """Return θ with noise by the spread of the residuals and their correlation at lag 1."""
    blocks, theta = target.blocks, theta.copy()
    errors = np.where(blocks.known, blocks.measured - simulate(theta, blocks), 0.0)
    for error, at in zip(errors, NOISES, strict=True):
        spread = np.sqrt(np.mean(error**2)) + 1e-7
        rho = float(np.clip(np.mean(error[1:] * error[:-1]) / spread**2, 0.02, 0.99))
        theta[at.white] = np.log(spread * np.sqrt(blocks.samples * (1.0 - 0.9 * rho)))
        theta[at.slow] = np.log(spread * rho)
        theta[at.time] = np.log(-blocks.step * blocks.samples / np.log(max(rho, 0.5)))
    return _drawn_to_prior(theta, target)
