"""
The coordinates in which the posterior is sampled, and its density there.

The mean of P_h over the log and the logarithm of its spread replace P_h,min and the logarithm of
its range: in these the data leave a hill instead of a banana. The map has unit Jacobian, because
the shape of (2.6) depends on neither. Of slow noise the level at low frequencies, its deviation
times the root of its time constant, replaces the deviation, for the same reason. Coordinates are
scaled by the prior's standard deviations.
"""

from typing import NamedTuple

import numpy as np

from trustlab.identification.posterior.likelihood import (
    BETA,
    H_MIN,
    H_SPAN,
    NOISES,
    P_MIN,
    P_R0,
    PER_RUN,
    R0,
    Blocks,
    drive,
    innovations,
    shapes,
)
from trustlab.models.compiled import njit

# Prior standard deviations, and log odds, beyond which the density counts as zero.
FAR = 12.0
FAR_ODDS = 14.0


class Target(NamedTuple):
    """
    Data and prior.

    A priori `whitening` (θ − `mean`) is standard normal. Coordinates are distances from `mean` in
    units of `deviation`, correlated or not. `free` are the places in θ that are sampled; the rest
    stays at the mean.
    """

    blocks: Blocks
    mean: np.ndarray
    deviation: np.ndarray
    whitening: np.ndarray
    free: np.ndarray


@njit
def to_theta(x, target, shape, means):
    """Return the parameters θ of coordinates x; write the shape of (2.6) and its block means."""
    theta = target.mean.copy()
    for k in range(x.size):
        theta[target.free[k]] += target.deviation[target.free[k]] * x[k]
    mean, spread = shapes(theta, target.blocks, shape, means)
    theta[H_SPAN] -= np.log(spread)
    theta[H_MIN] -= np.exp(theta[H_SPAN]) * mean
    for at in NOISES:
        theta[at.slow] -= 0.5 * (theta[at.time] - target.mean[at.time])
    return theta


@njit
def from_theta(theta, target):
    """Return the coordinates x of parameters θ."""
    blocks = target.blocks
    mean, spread = shapes(
        theta, blocks, np.empty(blocks.lengths.size), np.empty(blocks.measured.shape[1])
    )
    centred = theta.copy()
    centred[H_MIN] += np.exp(theta[H_SPAN]) * mean
    centred[H_SPAN] += np.log(spread)
    for at in NOISES:
        centred[at.slow] += 0.5 * (theta[at.time] - target.mean[at.time])
    return ((centred - target.mean) / target.deviation)[target.free]


@njit
def admissible(theta):
    """Return whether θ makes a model: positive performance, shares that are not 0 or 1."""
    odds = abs(theta[BETA])
    for run in range((theta.size - R0) // PER_RUN):
        odds = max(odds, abs(theta[R0 + PER_RUN * run]))
        if theta[P_MIN] + theta[P_R0 + PER_RUN * run] < 0.0:
            return False
    return odds < FAR_ODDS and theta[H_MIN] > 0.0 and theta[P_MIN] > 0.0


@njit
def log_prior(theta, target):
    """Return the logarithm of the prior's density, but for a constant."""
    value = 0.0
    for i in range(theta.size):
        z = 0.0
        for j in range(i + 1):
            z += target.whitening[i, j] * (theta[j] - target.mean[j])
        if not abs(z) < FAR:
            return -np.inf
        value -= 0.5 * z * z
    return value


@njit
def density(x, target):
    """Return the logarithm of the posterior's density at coordinates x, but for a constant."""
    for k in range(x.size):
        if not abs(x[k]) < 2.0 * FAR:
            return -np.inf
    # The first places are free in every target, so that x has β's log odds at its place in θ.
    if abs(target.mean[BETA] + target.deviation[BETA] * x[BETA]) > FAR_ODDS:
        return -np.inf
    blocks = target.blocks
    shape = np.empty(blocks.lengths.size)
    means = np.empty(blocks.measured.shape)
    theta = to_theta(x, target, shape, means[0])
    if not admissible(theta):
        return -np.inf
    prior = log_prior(theta, target)
    if prior == -np.inf:
        return prior
    drive(theta, blocks, shape, means)
    value = prior + innovations(theta, blocks, means, np.empty(means.shape))
    return value if value == value else -np.inf


@njit
def densities(points, target):
    """Return the logarithm of the posterior's density at rows of coordinates."""
    out = np.empty(len(points))
    for i in range(len(points)):
        out[i] = density(points[i], target)
    return out


@njit
def to_thetas(points, target):
    """Return the parameters θ of rows of coordinates."""
    out = np.empty((len(points), target.mean.size))
    shape = np.empty(target.blocks.lengths.size)
    means = np.empty(target.blocks.measured.shape[1])
    for i in range(len(points)):
        out[i] = to_theta(points[i], target, shape, means)
    return out
