"""
The likelihood of robot and operator, (2.3), (2.5) and (2.6), in logged block means, compiled.

A log is cut into blocks of at most a second, and these into stretches of constant mode. Over a
stretch (2.5) and (2.3) have closed forms; (2.6) is taken at the stretch's mean utilization, which
moves by less than a hundredth within a second. The noise of each output is a first-order process
plus white noise at the log's own samples; a Kalman filter gives the exact density of its block
means (Kailath, Sayed and Hassibi, *Linear Estimation*, 2000, Section 9.5: correlated noises).
"""

from typing import NamedTuple

import numpy as np

from trustlab.models.compiled import njit
from trustlab.models.tsc import yerkes_dodson

# Places in the vector θ of unbounded parameters: logarithms of times and ranges, log odds of
# shares.
TAU_R = 0
BETA = 1
H_MIN = 2
H_SPAN = 3
TAU_P = 4
P_MIN = 5
P_SPAN = 6
SHARED = 7
H_NOISE = 7
P_NOISE = 10
DELAY = 13
STATES = 14

# Of each output's noise, from its first place: logarithms of the standard deviation of white noise
# and of first-order noise per sample, and of the latter's time constant.
WHITE = 0
SLOW = 1
MEMORY = 2


class Blocks(NamedTuple):
    """
    Runs as the likelihood reads them.

    Block means of P_h and P_r, shape (2, blocks), NaN where missing; per stretch its samples, mode
    and block; where each run begins; sample time [s]; samples per block.
    """

    measured: np.ndarray
    lengths: np.ndarray
    modes: np.ndarray
    block: np.ndarray
    first_stretch: np.ndarray
    first_block: np.ndarray
    step: float
    samples: int


@njit
def shapes(theta, blocks, shape, means):
    """Write (2.6) between 0 and 1, by stretch and as block means; return mean and spread."""
    tau = np.exp(theta[TAU_R])
    a = np.exp(-blocks.step / tau)
    loss = -np.expm1(-blocks.step / tau)
    beta = 1.0 / (1.0 + np.exp(-theta[BETA]))
    means[:] = 0.0
    length = 0
    power = 1.0
    share = 1.0
    for run in range(blocks.first_block.size - 1):
        r = 1.0 / (1.0 + np.exp(-theta[STATES + 2 * run]))
        for s in range(blocks.first_stretch[run], blocks.first_stretch[run + 1]):
            if blocks.lengths[s] != length:
                length = blocks.lengths[s]
                power = a**length
                share = (1.0 - power) / (length * loss)
            mode = blocks.modes[s]
            # (2.5) over the stretch: r(k) = M + (r − M) aᵏ, and its mean.
            shape[s] = yerkes_dodson(mode + (r - mode) * share, beta)
            means[blocks.block[s]] += shape[s] * length / blocks.samples
            r = mode + (r - mode) * power
    total = 0.0
    squares = 0.0
    for value in means:
        total += value
        squares += value * value
    mean = total / means.size
    return mean, np.sqrt(max(squares / means.size - mean * mean, 1e-10))


@njit
def robot(blocks, shape, a, low, span, p_min, gain, starts, means):
    """Write block means of P_r, (2.3), driven by P_h = low + span · shape."""
    means[:] = 0.0
    length = 0
    power = 1.0
    share = 1.0
    for run in range(blocks.first_block.size - 1):
        p = starts[run]
        for s in range(blocks.first_stretch[run], blocks.first_stretch[run + 1]):
            if blocks.lengths[s] != length:
                length = blocks.lengths[s]
                power = a**length
                share = (1.0 - power) / (length * (1.0 - a))
            # (2.3) tends to P_min + M gain P_h, gain = (P_max − P_min)/P_h,max.
            goal = p_min + blocks.modes[s] * gain * (low + span * shape[s])
            means[blocks.block[s]] += (goal + (p - goal) * share) * length / blocks.samples
            p = goal + (p - goal) * power


@njit
def initial_performance(theta, runs):
    """Return P_r at the first sample of every run: θ holds its distance from P_min."""
    starts = np.empty(runs)
    for run in range(runs):
        starts[run] = theta[P_MIN] + theta[STATES + 2 * run + 1]
    return starts


@njit
def simulate(theta, blocks):
    """Return block means of P_h and P_r, shape (2, blocks)."""
    means = np.empty(blocks.measured.shape)
    shape = np.empty(blocks.lengths.size)
    shapes(theta, blocks, shape, means[0])
    drive(theta, blocks, shape, means)
    return means


@njit
def drive(theta, blocks, shape, means):
    """Turn the shape of (2.6), block means in means[0], into block means of P_h and P_r."""
    low = theta[H_MIN]
    span = np.exp(theta[H_SPAN])
    a = np.exp(-blocks.step / np.exp(theta[TAU_P]))
    gain = np.exp(theta[P_SPAN]) / (low + span)
    starts = initial_performance(theta, blocks.first_block.size - 1)
    robot(blocks, shape, a, low, span, theta[P_MIN], gain, starts, means[1])
    for k in range(means.shape[1]):
        means[0, k] = low + span * means[0, k]


class BlockNoise(NamedTuple):
    """
    First-order noise x plus white noise as block means y = c x + v show it.

    From one block to the next x becomes φ x + w; `drive`, `error` and `both` are the variance of w,
    that of v, and their covariance; `variance` is that of x.
    """

    phi: float
    c: float
    drive: float
    error: float
    both: float
    variance: float


@njit
def block_noise(white, slow, memory, samples):
    """Return the noise of means over `samples`, of deviations and correlation per sample."""
    total = 0.0
    power = 1.0
    error = 0.0
    both = 0.0
    # After m samples a shock has added `total` = 1 + … + φ^(m − 1) to the block's sum.
    for m in range(samples):
        if m > 0:
            error += total * total
            both += total * power
        total += power
        power *= memory
    shock = slow * slow * (1.0 - memory * memory)
    return BlockNoise(
        power,
        total / samples,
        slow * slow * (1.0 - power * power),
        (shock * error / samples + white * white) / samples,
        shock * both / samples,
        slow * slow,
    )


@njit
def prediction_error_density(errors, noise, scaled):
    """Return ln density of one run's errors by a Kalman filter; write the scaled innovations."""
    x = 0.0
    variance = noise.variance
    before = -1.0
    value = 0.0
    total = 1.0
    scale = 1.0
    gain = 0.0
    after = 0.0
    logarithm = 0.0
    for k in range(errors.size):
        if np.isnan(errors[k]):  # nothing was measured: x is only predicted
            scaled[k] = np.nan
            x *= noise.phi
            variance = noise.phi * noise.phi * variance + noise.drive
            continue
        if abs(variance - before) > 1e-14 * variance:  # the filter settles within some blocks
            before = variance
            total = noise.c * noise.c * variance + noise.error
            scale = 1.0 / np.sqrt(total)
            gain = (noise.phi * noise.c * variance + noise.both) / total
            after = noise.phi * noise.phi * variance + noise.drive - gain * gain * total
            logarithm = np.log(2.0 * np.pi * total)
        innovation = errors[k] - noise.c * x
        scaled[k] = innovation * scale
        value -= 0.5 * (logarithm + scaled[k] * scaled[k])
        x = noise.phi * x + gain * innovation
        variance = after
    return value


@njit
def shifted(values, first, last, blocks_late, out):
    """Write values[first:last], later by a number of blocks, linear between them."""
    for k in range(last - first):
        at = min(max(k - blocks_late, 0.0), last - first - 1.0)
        before = min(int(at), max(last - first - 2, 0))
        after = min(before + 1, last - first - 1)
        near = values[first + before]
        out[k] = near + (at - before) * (values[first + after] - near)


@njit
def innovations(theta, blocks, means, scaled):
    """
    Return the log-likelihood of simulated block means.

    Write the scaled prediction errors, shape (2, blocks).
    """
    late = theta[DELAY] / (blocks.step * blocks.samples)
    value = 0.0
    for j in range(2):
        place = H_NOISE if j == 0 else P_NOISE
        noise = block_noise(
            np.exp(theta[place + WHITE]),
            np.exp(theta[place + SLOW]),
            np.exp(-blocks.step / np.exp(theta[place + MEMORY])),
            blocks.samples,
        )
        for run in range(blocks.first_block.size - 1):
            first = blocks.first_block[run]
            last = blocks.first_block[run + 1]
            errors = means[j, first:last].copy()
            if late != 0.0:
                shifted(means[j], first, last, late, errors)
            for k in range(last - first):
                errors[k] = blocks.measured[j, first + k] - errors[k]
            value += prediction_error_density(errors, noise, scaled[j, first:last])
    return value


@njit
def log_likelihood(theta, blocks):
    """Return the logarithm of the density of all block means."""
    return innovations(theta, blocks, simulate(theta, blocks), np.empty(blocks.measured.shape))
