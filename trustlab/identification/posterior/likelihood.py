"""
The likelihood of robot and operator, (2.3), (2.5) and (2.6), in logged block means, compiled.

A log is cut into blocks of at most a second, and these into stretches of constant mode. Over a
stretch (2.5) and (2.3) have closed forms; (2.6) is taken at the stretch's mean utilization, which
moves by less than a hundredth within a second. The noise of each output is a first-order process
plus white noise at the log's own samples; a Kalman filter gives the exact density of its block
means.
"""

from typing import NamedTuple

import numpy as np

from trustlab.identification.model import IdentificationError
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
    parts = [_stretches(run["mode"], samples) for run in runs]
    counts = [run.size // samples for run in runs]
    for run, count in zip(runs, counts, strict=True):
        if count < FEWEST:
            raise IdentificationError(
                f"{run.label} lasts {run.size * step:g} s, too short to tell anything of time "
                f"constants of tens of seconds; record at least {FEWEST * samples * step:g} s"
            )
    first_block = np.cumsum([0, *counts])

    def cut(values: np.ndarray) -> np.ndarray:
        return values[: values.size // samples * samples].reshape(-1, samples)

    by_output = problem.by_output()
    measured = [np.concatenate([cut(s.measured).mean(axis=1) for s in of]) for of in by_output]
    known = [np.concatenate([cut(s.known).all(axis=1) for s in of]) for of in by_output]
    return Blocks(
        measured=np.array(measured),
        known=np.array(known),
        lengths=np.concatenate([part[0] for part in parts]),
        modes=np.concatenate([part[1] for part in parts]),
        block=np.concatenate([part[2] + at for part, at in zip(parts, first_block, strict=False)]),
        first_stretch=np.cumsum([0, *(part[0].size for part in parts)]),
        first_block=first_block,
        windows=np.array([1 if problem.unwindow else run.window for run in runs]),
        step=step,
        samples=samples,
    )


def _stretches(mode: np.ndarray, samples: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return length, mode and block of every stretch of constant mode within a block."""
    size = mode.size // samples * samples
    starts = np.unique(np.r_[np.arange(0, size, samples), np.flatnonzero(np.diff(mode[:size])) + 1])
    lengths = np.diff(np.r_[starts, size])
    return lengths, np.ascontiguousarray(mode[starts], dtype=float), starts // samples


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
        starts[run] = theta[P_MIN] + theta[P_R0 + PER_RUN * run]
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
                shifted(means[j], first, last, late, errors)
            if blocks.windows[run] > 1:
                errors = averaged(errors, blocks.windows[run], blocks.samples)
            known = blocks.known[j, first:last]
            count = 0
            for k in range(last - first):
                errors[k] = blocks.measured[j, first + k] - errors[k]
                count += known[k]
            of_run = scaled[j, first:last].reshape((last - first, 1))
            column = errors.reshape((last - first, 1))
            value -= 0.5 * filter_columns(column, known, noise, of_run)
            value -= 0.5 * count * np.log(2.0 * np.pi)
            for k in range(last - first):
                value -= 0.5 * of_run[k, 0] * of_run[k, 0]
    return value
