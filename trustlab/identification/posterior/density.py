"""
The density of the posterior of robot and operator, (2.3), (2.5) and (2.6): prior and likelihood.

Each parameter is normal a priori in the coordinate in which it is unbounded: the logarithm of a
time or a range, the log odds of a share. θ holds these coordinates.

A log is cut into blocks of at most a second, and these into stretches of constant mode. Over a
stretch (2.5) and (2.3) have closed forms; (2.6) is taken at the stretch's mean utilization, which
moves by less than a hundredth within a second. The noise of each output is a first-order process
plus white noise at the log's own samples; a Kalman filter gives the exact density of its block
means.

Points that are proposed have other coordinates still: the mean of P_h over the log and the
logarithm of its spread replace P_h,min and the logarithm of its range: in these the data leave a
hill instead of a banana. The map has unit Jacobian, because the shape of (2.6) depends on neither.
Of slow noise the level at low frequencies, its deviation times the root of its time constant,
replaces the deviation, for the same reason. All are distances from the prior's mean in units of its
standard deviations.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from operator import attrgetter
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from trustlab.identification.log import HALF_WIDTH, filter_columns, in_rows, process
from trustlab.identification.model import COORDINATES, Coordinate, IdentificationError
from trustlab.identification.problem import Problem
from trustlab.identification.tsc import TSC
from trustlab.models.checks import finite_array, finite_numbers, of_class, one_of, positive
from trustlab.models.compiled import njit
from trustlab.models.published import published_models
from trustlab.models.tsc import TscModel, yerkes_dodson

# --- coordinates ---------------------------------------------------------------------------------

LOGARITHM = Coordinate(np.log, np.exp)
PLAIN = COORDINATES["plain"]
ODDS = COORDINATES["odds"]

# The coordinate of every kind of parameter; the first seven are the person's and the robot's own.
SCALES = {
    "human_time_constant": LOGARITHM,
    "beta": ODDS,
    "human_p_min": PLAIN,
    "human_span": LOGARITHM,
    "robot_time_constant": LOGARITHM,
    "robot_p_min": PLAIN,
    "robot_span": LOGARITHM,
    "r0": ODDS,
    "p_r0": PLAIN,
    "white": LOGARITHM,
    "slow": LOGARITHM,
    "slow_time": LOGARITHM,
    "mode_delay": PLAIN,
}
SHARED = 7
SHARED_NAMES = tuple(SCALES)[:SHARED]
NOISE = ("white", "slow", "slow_time")
OUTPUTS = ("p_h", "p_r")

# Places in θ.
TAU_R, BETA, H_MIN, H_SPAN, TAU_P, P_MIN, P_SPAN = range(SHARED)


class NoisePlaces(NamedTuple):
    """
    Where θ has an output's noise.

    Standard deviation of white noise and of first-order noise per sample, and the latter's time
    constant.
    """

    white: int
    slow: int
    time: int


NOISES = (NoisePlaces(7, 8, 9), NoisePlaces(10, 11, 12))
DELAY = 13

# Of the first run; those of the next follow: utilization, and P_r less P_r,min.
R0 = 14
P_R0 = 15
PER_RUN = 2


def unknowns(runs: int) -> dict[str, str]:
    """Return the names of all parameters in the order of θ, and the kind of each."""
    names = {name: name for name in SHARED_NAMES}
    names |= {f"{output}_{kind}": kind for output in OUTPUTS for kind in NOISE}
    names["mode_delay"] = "mode_delay"
    labels = [f"[{run}]" for run in range(runs)] if runs > 1 else [""] * runs
    return names | {f"{kind}{label}": kind for label in labels for kind in ("r0", "p_r0")}


def physical(thetas: np.ndarray, step: float) -> pd.DataFrame:
    """Return rows of θ as parameters in their own units; `step` [s] is that of the models."""
    names = unknowns((thetas.shape[1] - R0) // PER_RUN)
    pairs = zip(names.items(), thetas.T, strict=True)
    table = pd.DataFrame({name: SCALES[kind].back(column) for (name, kind), column in pairs})
    for who in ("human", "robot"):
        table[f"{who}_a"] = np.exp(-step / table[f"{who}_time_constant"])
        table[f"{who}_p_max"] = table[f"{who}_p_min"] + table[f"{who}_span"]
    states = list(names)[R0:]
    table[states[1::PER_RUN]] = table[states[1::PER_RUN]].add(table["robot_p_min"], axis="index")
    model = list(TSC.names)
    model.insert(4, "robot_time_constant")
    model.insert(0, "human_time_constant")
    order = [*model, "mode_delay", *states, *list(names)[SHARED:DELAY]]
    return table.rename(columns={"beta": "human_beta"})[order]


# Least range from which a search begins.
LEAST = 1e-3


def coordinates_of(values: Mapping[str, Any], step: float) -> np.ndarray:
    """Return the first seven coordinates of parameters as `fit_tsc` names them."""
    rows = []
    for who in ("human", "robot"):
        low = values[f"{who}_p_min"]
        span = max(values[f"{who}_p_max"] - low, LEAST)
        rows += [np.log(-step / np.log(values[f"{who}_a"])), low, np.log(span)]
    return np.insert(rows, BETA, ODDS.to(values["human_beta"]))


def transformed(models: Iterable[TscModel]) -> np.ndarray:
    """Return the first seven coordinates of models at steps of 0.1 s."""
    # "human_a" is human.a of the model.
    values = attrgetter(*(name.replace("_", ".", 1) for name in TSC.names))
    return np.array(
        [coordinates_of(dict(zip(TSC.names, values(tsc), strict=True)), 0.1) for tsc in models]
    )


# --- the prior -----------------------------------------------------------------------------------


@dataclass(frozen=True)
class Prior:
    """
    Prior of `sample_posterior`, as medians and spreads; the defaults are "weak".

    A pair (median, spread) replaces a parameter's own: the spread is a standard deviation of the
    natural logarithm of times, ranges and noise, of the log odds of shares, and of the value itself
    for the rest. Performance is in the unit of the measure: m/s for (2.4) and (2.7), where these
    defaults come from. For another measure state the four performances and the noise.

    Parameters
    ----------
    human_time_constant : tuple
        Of utilization [s].
    beta : tuple
        Utilization of greatest performance.
    human_p_min, human_span : tuple
        Least human performance, and the greatest less the least.
    robot_time_constant : tuple
        Of robot performance [s].
    robot_p_min, robot_span : tuple
        Least robot performance, and the greatest less the least.
    r0 : tuple
        Utilization at the first sample of a run.
    p_r0 : tuple
        Robot performance at the first sample of a run, less robot_p_min.
    white, slow : tuple
        Standard deviation of white and of first-order noise, per sample.
    slow_time : tuple
        Time constant of first-order noise [s].
    mode_delay : tuple
        By how much the mode acts later than it is stamped [s]; used with mode_delay=True.
    correlation : numpy.ndarray, optional
        Correlations of the first seven, shape (7, 7); none by default.

    Raises
    ------
    ValueError
        If a median or a spread makes no distribution.

    Examples
    --------
    >>> import trustlab as tl
    >>> prior = tl.Prior(human_p_min=(0.7, 0.2), human_span=(0.2, 0.7))  # a share of 1
    >>> prior.table().loc["human_time_constant"].round(0).tolist()
    [150.0, 38.0, 591.0]
    """

    human_time_constant: tuple[float, float] = (150.0, 0.7)
    beta: tuple[float, float] = (0.73, 1.2)
    human_p_min: tuple[float, float] = (0.40, 0.10)
    human_span: tuple[float, float] = (0.05, 0.7)
    robot_time_constant: tuple[float, float] = (30.0, 0.7)
    robot_p_min: tuple[float, float] = (0.25, 0.10)
    robot_span: tuple[float, float] = (0.13, 0.7)
    r0: tuple[float, float] = (0.12, 1.5)
    p_r0: tuple[float, float] = (0.0, 0.1)
    white: tuple[float, float] = (0.005, 1.2)
    slow: tuple[float, float] = (0.003, 1.5)
    slow_time: tuple[float, float] = (8.0, 0.8)
    mode_delay: tuple[float, float] = (0.0, 1.0)
    correlation: np.ndarray | None = None

    def __post_init__(self):
        for name, scale in SCALES.items():
            median, spread = finite_array(name, getattr(self, name), length=2)
            positive(f"spread of {name}", spread)
            with np.errstate(all="ignore"):
                if not np.isfinite(scale.to(median)):
                    limits = "in (0, 1)" if scale is ODDS else "above 0"
                    raise ValueError(f"median of {name} must lie {limits}, got {median}")
        if self.correlation is not None:
            matrix = finite_numbers("correlation", self.correlation)
            if not (
                matrix.shape == (SHARED, SHARED)
                and np.allclose(np.diag(matrix), 1.0)
                and np.allclose(matrix, matrix.T)
                and np.linalg.eigvalsh(matrix)[0] > 1e-12
            ):
                raise ValueError(
                    "correlation must be a symmetric, positive definite "
                    f"({SHARED}, {SHARED}) matrix with unit diagonal"
                )

    def table(self) -> pd.DataFrame:
        """
        Return what the prior means in the units of the parameters.

        Returns
        -------
        pandas.DataFrame
            Index `parameter`; columns median, low and high, the ends of the 95 % interval.
        """
        rows = {}
        for name, scale in SCALES.items():
            median, spread = getattr(self, name)
            ends = scale.to(median) + np.array([-HALF_WIDTH, HALF_WIDTH]) * spread
            rows[name] = (median, *scale.back(ends))
        return pd.DataFrame(rows, ["median", "low", "high"]).T.rename_axis("parameter")

    def vectors(self, runs: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """
        Return mean, standard deviations and whitening factor of θ, for a number of runs.

        Parameters
        ----------
        runs : int
            Number of runs, each with initial states of its own.
        """
        kinds = unknowns(runs).values()
        mean = np.array([SCALES[kind].to(getattr(self, kind)[0]) for kind in kinds])
        deviation = np.array([getattr(self, kind)[1] for kind in kinds])
        whitening = np.diag(1.0 / deviation)
        if self.correlation is not None:
            factor = np.tril(np.linalg.inv(np.linalg.cholesky(self.correlation)))
            whitening[:SHARED, :SHARED] = factor / deviation[:SHARED]
        return mean, deviation, whitening


def prior_of(mean: np.ndarray, covariance: np.ndarray, prior: Prior | None = None) -> Prior:
    """Return a prior with another mean and covariance of the first seven, in their coordinates."""
    deviation = np.sqrt(np.diag(covariance))
    pairs = {
        name: (float(SCALES[name].back(centre)), float(spread))
        for name, centre, spread in zip(SHARED_NAMES, mean, deviation, strict=True)
    }
    correlation = covariance / np.outer(deviation, deviation)
    return replace(prior or Prior(), correlation=correlation, **pairs)


# Least spreads of the prior made of the printed people, as shares of the weak prior's.
LEAST_SPREAD = 0.25


def _published() -> Prior:
    """Return the spread of the six printed people as a prior, a half wider."""
    values = transformed(published_models().values())
    weak = Prior().vectors(0)[1][:SHARED]
    spread = np.maximum(1.5 * values.std(axis=0, ddof=1), LEAST_SPREAD * weak)
    return prior_of(values.mean(axis=0), np.diag(spread**2))


PRIORS = {"weak": Prior, "published": _published}


def as_prior(prior: str | Prior) -> Prior:
    """Return a prior by name, or the user's own."""
    if isinstance(prior, str):
        return PRIORS[one_of("prior", prior, PRIORS, "a Prior")]()
    return of_class("prior", prior, Prior, "trustlab.Prior(…) states one")


# --- the likelihood, compiled ---------------------------------------------------------------------

# Length of a block [s], and how many a run needs at least.
BLOCK = 1.0
FEWEST = 8


class Blocks(NamedTuple):
    """
    Runs as the likelihood reads them.

    Block means of P_h and P_r, shape (2, blocks), and which are known; per stretch of constant mode
    within a block its samples, mode and block; where each run begins and the last ends, in
    stretches and in blocks, and the window of its means in samples, 1 for none; sample time [s];
    samples per block; time of the first sample [s].
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
    start: float


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
    starts = np.flatnonzero(np.diff(mode, axis=1, prepend=np.nan) != 0.0)
    return Blocks(
        measured=np.array([in_blocks(s.measured for s in of).mean(axis=1) for of in by_output]),
        known=np.array([in_blocks(s.known for s in of).all(axis=1) for of in by_output]),
        lengths=np.diff(starts, append=mode.size),
        modes=mode.ravel()[starts],
        block=starts // samples,
        first_stretch=np.searchsorted(starts, samples * first_block),
        first_block=first_block,
        windows=np.array([1 if problem.unwindow else run.window for run in runs]),
        step=step,
        samples=samples,
        start=float(runs[0].t[0]),
    )


@njit
def relaxation(theta, place, blocks):
    """
    Return by number of samples which share of a distance is left, and is there on average; and the
    share of that at the first sample which is left when a mode that acts late begins to.
    """
    tau = np.exp(theta[place])
    left = np.empty(blocks.samples + 1)
    share = np.empty(blocks.samples + 1)
    loss = -np.expm1(-blocks.step / tau)
    for length in range(1, left.size):
        left[length] = np.exp(-blocks.step * length / tau)
        share[length] = (1.0 - left[length]) / (loss * length)
    return left, share, np.exp(-theta[DELAY] / tau)


@njit
def utilize(theta, blocks, shape, means):
    """Write (2.6) between 0 and 1, by stretch and as block means; return mean and spread."""
    left, share, begun = relaxation(theta, TAU_R, blocks)
    beta = 1.0 / (1.0 + np.exp(-theta[BETA]))
    means[:] = 0.0
    for run in range(blocks.windows.size):
        first = blocks.first_stretch[run]
        mode = blocks.modes[first]
        r = mode + (1.0 / (1.0 + np.exp(-theta[R0 + PER_RUN * run])) - mode) * begun
        r = min(max(r, 0.0), 1.0)
        for s in range(first, blocks.first_stretch[run + 1]):
            # (2.5) over the stretch: r(k) = M + (r − M) aᵏ, and its mean.
            mode, length = blocks.modes[s], blocks.lengths[s]
            shape[s] = yerkes_dodson(mode + (r - mode) * share[length], beta)
            means[blocks.block[s]] += shape[s] * length / blocks.samples
            r = mode + (r - mode) * left[length]
    mean = 0.0
    square = 0.0
    for value in means:
        mean += value / means.size
        square += value * value / means.size
    return mean, np.sqrt(max(square - mean * mean, 1e-10))


@njit
def perform(theta, blocks, shape, means):
    """Turn the shape of (2.6), block means in means[0], into block means of P_h and P_r, (2.3)."""
    low = theta[H_MIN]
    span = np.exp(theta[H_SPAN])
    p_min = theta[P_MIN]
    gain = np.exp(theta[P_SPAN]) / (low + span)
    left, share, begun = relaxation(theta, TAU_P, blocks)
    means[0] = low + span * means[0]
    means[1] = 0.0
    for run in range(blocks.windows.size):
        first = blocks.first_stretch[run]
        p_r = p_min + theta[P_R0 + PER_RUN * run]
        for s in range(first, blocks.first_stretch[run + 1]):
            # (2.3) tends to P_min + M gain P_h, gain = (P_max − P_min)/P_h,max.
            goal = p_min + blocks.modes[s] * gain * (low + span * shape[s])
            if s == first:
                p_r = goal + (p_r - goal) * begun
            length = blocks.lengths[s]
            mean = goal + (p_r - goal) * share[length]
            means[1, blocks.block[s]] += mean * length / blocks.samples
            p_r = goal + (p_r - goal) * left[length]


def simulate(theta: np.ndarray, blocks: Blocks) -> np.ndarray:
    """Return block means of P_h and P_r, shape (2, blocks)."""
    shape, means = np.empty(blocks.lengths.size), np.empty(blocks.measured.shape)
    utilize(theta, blocks, shape, means[0])
    perform(theta, blocks, shape, means)
    return means


@njit
def _sum_until(at, values, sums):
    """Return what values add up to at a place in blocks, linear within a block and before all."""
    last = values.size - 1
    k = max(min(int(at), last), 0)
    part = at - k
    before = max(k - 1, 0)
    after = min(k + 1, last)
    rise = (values[after] - values[before]) / (after - before)
    return sums[k] + part * (values[k] - 0.5 * (1.0 - part) * rise)


@njit
def logged(values, late, window, samples):
    """
    Return block means of what a log shows of block means: later by so many blocks, and averaged
    over the last `window` samples.
    """
    sums = np.zeros(values.size)
    for k in range(values.size - 1):
        sums[k + 1] = sums[k] + values[k]
    # Of a moving mean that at the block's middle sample; of none the block itself.
    ahead = 1.0 if window == 1 else 0.5 * (samples + 1) / samples
    length = 1.0 if window == 1 else window / samples
    out = np.empty(values.size)
    for k in range(values.size):
        end = min(k + ahead - late, values.size)
        # The log begins at −late, unless that is beyond the last value.
        begin = max(end - length, min(-late, end - 0.5))
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
        for run in range(blocks.windows.size):
            first = blocks.first_block[run]
            last = blocks.first_block[run + 1]
            expected = means[j, first:last]
            if late != 0.0 or blocks.windows[run] > 1:
                expected = logged(expected, late, blocks.windows[run], blocks.samples)
            known = blocks.known[j, first:last]
            column = (blocks.measured[j, first:last] - expected).reshape((last - first, 1))
            errors = scaled[j, first:last].reshape((last - first, 1))
            value -= 0.5 * filter_columns(column, known, noise, errors)
            for k in range(last - first):
                value -= 0.5 * (errors[k, 0] ** 2 + known[k] * np.log(2.0 * np.pi))
    return value


@njit
def likelihoods(thetas, blocks):
    """Return the log-likelihood of rows of θ whose P_h is centred; write P_h,min and its range."""
    values = np.empty(len(thetas))
    shape = np.empty(blocks.lengths.size)
    means = np.empty(blocks.measured.shape)
    scaled = np.empty(blocks.measured.shape)
    for i in range(len(thetas)):
        theta = thetas[i]
        mean, spread = utilize(theta, blocks, shape, means[0])
        theta[H_SPAN] -= np.log(spread)
        theta[H_MIN] -= np.exp(theta[H_SPAN]) * mean
        perform(theta, blocks, shape, means)
        values[i] = innovations(theta, blocks, means, scaled)
    return values


# --- the density ----------------------------------------------------------------------------------

# Prior standard deviations, and log odds, beyond which the density counts as zero.
FAR = 12.0
FAR_ODDS = 14.0

# The places of both outputs' white noise, slow noise and its time constant.
WHITE, SLOW, SLOW_TIME = map(list, zip(*NOISES, strict=True))


class Target(NamedTuple):
    """
    Data and prior.

    A priori `whitening` (θ − `mean`) is standard normal. Points are distances from `mean` in units
    of `deviation`, correlated or not. `free` are the places in θ that are sampled; the rest stays
    at the mean.
    """

    blocks: Blocks
    mean: np.ndarray
    deviation: np.ndarray
    whitening: np.ndarray
    free: np.ndarray


def evaluated(points: np.ndarray, target: Target) -> tuple[np.ndarray, np.ndarray]:
    """Return θ of rows of points, and the logarithm of their density, but for a constant."""
    thetas = np.tile(target.mean, (len(points), 1))
    # What is further off only needs to be finite.
    near = np.clip(points, -2.0 * FAR, 2.0 * FAR)
    thetas[:, target.free] += target.deviation[target.free] * near
    thetas[:, SLOW] -= 0.5 * (thetas[:, SLOW_TIME] - target.mean[SLOW_TIME])
    thetas[:, BETA] = np.clip(thetas[:, BETA], -FAR_ODDS, FAR_ODDS)
    values = likelihoods(thetas, target.blocks)
    z = (thetas - target.mean) @ target.whitening.T
    possible = admissible(thetas) & (np.abs(z) < FAR).all(axis=1) & np.isfinite(values)
    return thetas, np.where(possible, values - 0.5 * (z**2).sum(axis=1), -np.inf)


def densities(points: np.ndarray, target: Target) -> np.ndarray:
    """Return the logarithm of the posterior's density at rows of points."""
    return evaluated(points, target)[1]


def admissible(thetas: np.ndarray) -> np.ndarray:
    """Return which rows make a model: positive performance, shares that are not 0 or 1."""
    odds = np.column_stack([thetas[:, BETA], thetas[:, R0::PER_RUN]])
    levels = np.column_stack([thetas[:, H_MIN], thetas[:, P_MIN]])
    starts = thetas[:, [P_MIN]] + thetas[:, P_R0::PER_RUN]
    possible = (np.abs(odds) < FAR_ODDS).all(axis=1) & (levels > 0.0).all(axis=1)
    return possible & (starts >= 0.0).all(axis=1)


def point_of(theta: np.ndarray, target: Target) -> np.ndarray:
    """Return the point of parameters θ."""
    p_h = simulate(theta, target.blocks)[0]
    centred = theta.copy()
    centred[[H_MIN, H_SPAN]] = p_h.mean(), np.log(p_h.std())
    centred[SLOW] += 0.5 * (theta[SLOW_TIME] - target.mean[SLOW_TIME])
    return ((centred - target.mean) / target.deviation)[target.free]


# Steps of central differences in units of the prior's standard deviation: of the density and of
# its gradient.
STEP = 1e-4
WIDE_STEP = 2e-3


def gradients(points: np.ndarray, target: Target) -> np.ndarray:
    """Return the derivatives of the density's logarithm at rows of points."""
    steps = STEP * np.eye(points.shape[1])
    around = points[:, None] + np.concatenate([steps, -steps])
    values = densities(around.reshape(-1, len(steps)), target).reshape(len(points), 2, -1)
    with np.errstate(invalid="ignore"):
        slopes = (values[:, 0] - values[:, 1]) / (2.0 * STEP)
    return np.where(np.isfinite(slopes), slopes, 0.0)  # beside what makes no model


def curvature(x: np.ndarray, target: Target) -> np.ndarray:
    """Return minus the second derivatives of the density's logarithm."""
    steps = WIDE_STEP * np.eye(x.size)
    bends = gradients(x - steps, target) - gradients(x + steps, target)
    return (bends + bends.T) / (4.0 * WIDE_STEP)
