"""
The density of the posterior of robot and operator, (2.3), (2.5) and (2.6), compiled.

A log is cut into blocks of at most a second, and these into stretches of constant mode. Over a
stretch (2.5) and (2.3) have closed forms; (2.6) is taken at the stretch's mean utilization, which
moves by less than a hundredth within a second. The noise of each output is a first-order process
plus white noise at the log's own samples; a Kalman filter gives the exact density of its block
means.

The coordinates: the mean of P_h over the log and the logarithm of its spread replace P_h,min and
the logarithm of its range: in these the data leave a hill instead of a banana. The map has unit
Jacobian, because the shape of (2.6) depends on neither. Of slow noise the level at low frequencies,
its deviation times the root of its time constant, replaces the deviation, for the same reason.
Coordinates are scaled by the prior's standard deviations.
"""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
import pandas as pd

from trustlab.identification.log import in_rows
from trustlab.identification.model import COORDINATES, IdentificationError
from trustlab.identification.noise import filter_columns, process
from trustlab.identification.problem import Problem
from trustlab.models.compiled import njit
from trustlab.models.tsc import yerkes_dodson

# Length of a block [s], short beside every time constant of the models.
BLOCK = 1.0

# Blocks that a run needs at least.
FEWEST = 8

OUTPUTS = ("p_h", "p_r")


class NoisePlaces(NamedTuple):
    """
    Where θ has an output's noise.

    Logarithms of the standard deviation of white noise and of first-order noise per sample, and of
    the latter's time constant.
    """

    white: int
    slow: int
    time: int


# Places in the vector θ of unbounded parameters: logarithms of times and ranges, log odds of
# shares. The first seven are the person's and the robot's own.
TAU_R = 0
BETA = 1
H_MIN = 2
H_SPAN = 3
TAU_P = 4
P_MIN = 5
P_SPAN = 6
SHARED = 7
NOISES = (NoisePlaces(7, 8, 9), NoisePlaces(10, 11, 12))
DELAY = 13

# Of the first run; those of the next follow: log odds of utilization, and P_r less P_r,min.
R0 = 14
P_R0 = 15
PER_RUN = 2


class Blocks(NamedTuple):
    """
    Runs as the likelihood reads them.

    Block means of P_h and P_r, shape (2, blocks), and which are known; per stretch its samples,
    mode and block; where each run begins, and the window of its means in samples, 1 for none;
    sample time [s]; samples per block.
    """

    measured: np.ndarray
    known: np.ndarray
    lengths: np.ndarray
    modes: np.ndarray
    block: np.ndarray
    first_stretch: np.ndarray
    first_block: np.ndarray
    windows: np.ndarray
    step: float
    samples: int


def blocks_of(problem: Problem) -> Blocks:
    """Return the series that a fit compares as means over blocks of at most a second."""
    runs = problem.runs
    step = runs[0].sample_time
    samples = max(1, int(BLOCK / step + 1e-6))
    for run in runs:
        if run.size // samples < FEWEST:
            raise IdentificationError(
                f"{run.label} lasts {run.size * step:g} s, too short to tell anything of time "
                f"constants of tens of seconds; record at least {FEWEST * samples * step:g} s"
            )

    def in_blocks(columns: Iterable[np.ndarray]) -> np.ndarray:
        return np.concatenate([in_rows(values, samples) for values in columns])

    by_output = problem.by_output()
    mode = in_blocks(run["mode"] for run in runs)
    first_block = np.cumsum([0, *(run.size // samples for run in runs)])
    # A stretch begins with every block and change of mode within one.
    begins = np.diff(mode, axis=1, prepend=np.nan) != 0.0
    starts = np.flatnonzero(begins)
    return Blocks(
        measured=np.array([in_blocks(s.measured for s in of).mean(axis=1) for of in by_output]),
        known=np.array([in_blocks(s.known for s in of).all(axis=1) for of in by_output]),
        lengths=np.diff(starts, append=mode.size),
        modes=mode[begins],
        block=starts // samples,
        first_stretch=np.searchsorted(starts, samples * first_block),
        first_block=first_block,
        windows=np.array([1 if problem.unwindow else run.window for run in runs]),
        step=step,
        samples=samples,
    )


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
        r = 1.0 / (1.0 + np.exp(-theta[R0 + PER_RUN * run]))
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
    mean = means.mean()
    return mean, np.sqrt(max((means * means).mean() - mean * mean, 1e-10))


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
    # P_r at the first sample of every run: θ holds its distance from P_min.
    starts = theta[P_MIN] + theta[P_R0::PER_RUN]
    robot(blocks, shape, a, low, span, theta[P_MIN], gain, starts, means[1])
    means[0] = low + span * means[0]


@njit
def shifted(values, late):
    """Return values that come later by a number of blocks, linear between them."""
    last = values.size - 1
    out = np.empty(values.size)
    for k in range(values.size):
        at = min(max(k - late, 0.0), last)
        before = min(int(at), last - 1)
        out[k] = values[before] + (at - before) * (values[before + 1] - values[before])
    return out


@njit
def _sum_until(at, values, sums):
    """Return the sum of values up to a place in blocks, linear within a block."""
    last = values.size - 1
    k = min(int(at), last)
    part = at - k
    before = max(k - 1, 0)
    after = min(k + 1, last)
    rise = (values[after] - values[before]) / (after - before)
    return sums[k] + part * (values[k] - 0.5 * (1.0 - part) * rise)


@njit
def averaged(values, window, samples):
    """Return block means of what a moving window over so many samples makes of block means."""
    sums = np.zeros(values.size)
    for k in range(values.size - 1):
        sums[k + 1] = sums[k] + values[k]
    out = np.empty(values.size)
    for k in range(values.size):
        end = k + 0.5 * (samples + 1) / samples  # the mean at the block's middle sample
        begin = max(end - window / samples, 0.0)
        total = _sum_until(end, values, sums) - _sum_until(begin, values, sums)
        out[k] = total / (end - begin)
    return out


@njit
def innovations(theta, blocks, means, scaled):
    """
    Return the log-likelihood of simulated block means.

    Write the scaled prediction errors, shape (2, blocks), 0 where nothing is known.
    """
    late = theta[DELAY] / (blocks.step * blocks.samples)
    value = 0.0
    for j in range(2):
        at = NOISES[j]
        noise = process(
            np.exp(theta[at.white]),
            np.exp(theta[at.slow]),
            np.exp(-blocks.step / np.exp(theta[at.time])),
            blocks.samples,
        )
        for run in range(blocks.first_block.size - 1):
            first = blocks.first_block[run]
            last = blocks.first_block[run + 1]
            errors = means[j, first:last].copy()
            if late != 0.0:
                errors = shifted(errors, late)
            if blocks.windows[run] > 1:
                errors = averaged(errors, blocks.windows[run], blocks.samples)
            known = blocks.known[j, first:last]
            column = (blocks.measured[j, first:last] - errors).reshape((last - first, 1))
            of_run = scaled[j, first:last].reshape((last - first, 1))
            value -= 0.5 * filter_columns(column, known, noise, of_run)
            value -= 0.5 * known.sum() * np.log(2.0 * np.pi)
            for error in of_run[:, 0]:
                value -= 0.5 * error * error
    return value


# --- θ as parameters ---------------------------------------------------------------------------


def physical(thetas: np.ndarray, step: float) -> pd.DataFrame:
    """Return rows of θ as parameters in their own units; `step` [s] is that of the models."""
    columns, theta = {}, thetas.T
    share = COORDINATES["odds"].back
    for who, time, low, span in (("human", TAU_R, H_MIN, H_SPAN), ("robot", TAU_P, P_MIN, P_SPAN)):
        columns[f"{who}_time_constant"] = np.exp(theta[time])
        columns[f"{who}_a"] = np.exp(-step / np.exp(theta[time]))
        if who == "human":
            columns["human_beta"] = share(theta[BETA])
        columns[f"{who}_p_min"] = theta[low]
        columns[f"{who}_p_max"] = theta[low] + np.exp(theta[span])
    columns["mode_delay"] = theta[DELAY]
    runs = (len(theta) - R0) // PER_RUN
    for run in range(runs):
        label = f"[{run}]" if runs > 1 else ""
        columns[f"r0{label}"] = share(theta[R0 + PER_RUN * run])
        columns[f"p_r0{label}"] = theta[P_MIN] + theta[P_R0 + PER_RUN * run]
    for output, at in zip(OUTPUTS, NOISES, strict=True):
        for part, place in at._asdict().items():
            name = "slow_time" if part == "time" else part
            columns[f"{output}_{name}"] = np.exp(theta[place])
    return pd.DataFrame(columns)


# --- coordinates ---------------------------------------------------------------------------------

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
    theta[target.free] += target.deviation[target.free] * x
    mean, spread = shapes(theta, target.blocks, shape, means)
    theta[H_SPAN] -= np.log(spread)
    theta[H_MIN] -= np.exp(theta[H_SPAN]) * mean
    for at in NOISES:
        theta[at.slow] -= 0.5 * (theta[at.time] - target.mean[at.time])
    return theta


@njit
def from_theta(theta, target):
    """Return the coordinates x of parameters θ."""
    shape, means = np.empty(target.blocks.lengths.size), np.empty(target.blocks.measured.shape[1])
    mean, spread = shapes(theta, target.blocks, shape, means)
    centred = theta.copy()
    centred[H_MIN] += np.exp(theta[H_SPAN]) * mean
    centred[H_SPAN] += np.log(spread)
    for at in NOISES:
        centred[at.slow] += 0.5 * (theta[at.time] - target.mean[at.time])
    return ((centred - target.mean) / target.deviation)[target.free]


@njit
def admissible(theta):
    """Return whether θ makes a model: positive performance, shares that are not 0 or 1."""
    odds = max(abs(theta[BETA]), np.abs(theta[R0::PER_RUN]).max())
    lowest = theta[P_MIN] + min(theta[P_R0::PER_RUN].min(), 0.0)
    return odds < FAR_ODDS and theta[H_MIN] > 0.0 and theta[P_MIN] > 0.0 and lowest >= 0.0


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
    if not (np.abs(x) < 2.0 * FAR).all():
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


# --- derivatives ----------------------------------------------------------------------------------

# Steps of central differences in units of the prior's standard deviation: of the density and of
# its gradient.
STEP = 1e-4
WIDE_STEP = 2e-3


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
        out[i] = (gradient(at, target) - above) / (2.0 * WIDE_STEP)
        at[i] = x[i]
    return 0.5 * (out + out.T)
