"""
The covariance of an optimum: of noise, of errors of the mode's stamps, of states held by a bound.

Everything here is in coordinates of the search, in which the likelihood is most nearly Gaussian.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from trustlab.identification.log import late
from trustlab.identification.noise import (
    Noise,
    hac_lags,
    hac_matrix,
    sandwich,
    whiten,
    whiteness_p,
)
from trustlab.identification.problem import Optimum, Problem, Series

NOISES = ("auto", "white", "correlated", "hac")

# p value of the Ljung–Box test below which residuals do not count as white.
NOT_WHITE = 1e-3

# Deviance above the least up to which a single value lies in its 95 % interval.
LIKELY = 3.84

# Switches of mode per session beyond which errors of their stamps are worked out for a sample.
SWITCHES = 40


class ModeDelay(NamedTuple):
    """
    Delay of the mode behind its stamp [s], as residuals show it.

    `shift` is the change of the loose unknowns per second of delay.
    """

    value: float
    stderr: float
    shift: np.ndarray


@dataclass(frozen=True, eq=False)
class Estimate:
    """
    The best optimum with covariance and diagnostics.

    `covariance` is that of the values: 0 in rows of fixed unknowns and NaN in rows of those at a
    bound. `simple_p` is the p value of the whiteness test before the noise was modelled;
    `sandwiched` says that the covariance allows for remaining correlation. `rivals` are optima
    nearly as likely.
    """

    optimum: Optimum
    covariance: np.ndarray
    simple_p: float
    noise: str
    sandwiched: bool
    delay: ModeDelay
    rivals: tuple[Optimum, ...] = ()

    @property
    def problem(self) -> Problem:
        """The problem that is solved."""
        return self.optimum.problem

    @property
    def fixed(self) -> np.ndarray:
        """Which of the full vector are fixed."""
        return self.problem.low == self.problem.high

    @property
    def values(self) -> np.ndarray:
        """The values of the full vector."""
        return self.problem.values(self.optimum.x)

    @property
    def degrees_of_freedom(self) -> float:
        """Samples less unknowns; for correlated noise, those of the slowest output."""
        problem, loose = self.problem, self.optimum.loose.size
        least = problem.counts.sum() - loose
        for count, noise in zip(problem.counts, problem.noise, strict=True):
            if noise.share > 0.0:
                # An AR(1) process tells its size as n (1 − φ)/(1 + φ) independent values would; the
                # fit uses up some.
                values = count * (1.0 - noise.memory) / (1.0 + noise.memory)
                least = min(least, max(values - loose, 3.0))
        return float(least)

    @property
    def sigma(self) -> np.ndarray:
        """Standard deviation √(Σ e²/(n − p)) by output; p is shared out over the outputs."""
        counts = self.problem.counts
        freedom = np.maximum(counts - self.optimum.loose.size / counts.size, 1.0)
        return np.sqrt(self.optimum.equations.squares / freedom)


def whiteness_of(optimum: Optimum) -> float:
    """Return the least p value of the Ljung–Box tests of all outputs ([S] Section 11.2)."""
    pairs = zip(optimum.exact, optimum.problem.by_output(), strict=True)
    tests = [1.0 if exact else whiteness_p([s.white[:, 0] for s in of]) for exact, of in pairs]
    return float(min(tests))


def estimated(optimum: Optimum, noise: str) -> Estimate:
    """Model the noise of an optimum, search again, and return the estimate with its covariance."""
    problem = optimum.problem
    problem.equations(optimum.x)
    simple_p = whiteness_of(optimum)
    if noise == "correlated" or (noise == "auto" and simple_p < NOT_WHITE):
        # The noise belongs to the residuals, and these to the estimates: three rounds settle both.
        for _ in range(3):
            problem.set_noise(problem.fitted_noise())
            optimum = problem.search(optimum.x)
    inverse = optimum.inverse_information()
    modelled = any(model != Noise() for model in problem.noise)
    p_value = whiteness_of(optimum) if modelled else simple_p
    sandwiched = noise == "hac" or (noise in ("auto", "correlated") and p_value < NOT_WHITE)
    delay = mode_delay(optimum, inverse, sandwiched)
    # For white residuals the covariance is the inverse information ([L] Section 9.4, [S] Section
    # 7.5); else that is the bread of a sandwich.
    meat = _meat(optimum) if sandwiched else None
    block = sandwich(inverse, meat, problem.counts.sum()) + _of_stamps(optimum, inverse)
    if any(run.stamp_error > 0.0 for run in problem.runs):
        # Stamps that are not exact may share an error, too: of any size that the residuals allow.
        square = delay.value**2 + delay.stderr**2
        block += square * np.outer(delay.shift, delay.shift)
    shift = _shift_of_states(optimum)
    # The shift is to where the deviance has risen by LIKELY = 1.96²: as a variance, by its square.
    covariance = _of_values(optimum, block) + np.outer(shift, shift) / LIKELY
    return Estimate(
        optimum,
        covariance,
        simple_p,
        "correlated" if modelled else "hac" if sandwiched else "white",
        sandwiched,
        delay,
    )


def _of_values(optimum: Optimum, block: np.ndarray) -> np.ndarray:
    """Return the covariance of the values of the full vector."""
    problem, x = optimum.problem, optimum.x
    # d(value)/dx by a complex step, which is exact to rounding.
    step = 1e-100
    slopes = np.imag(problem.values(x + 1j * step)) / step
    places = problem.free[optimum.loose]
    covariance = np.zeros((x.size, x.size))
    covariance[optimum.at_bound, :] = covariance[:, optimum.at_bound] = np.nan
    covariance[np.ix_(places, places)] = block * np.outer(slopes[places], slopes[places])
    return covariance


def _meat(optimum: Optimum) -> np.ndarray:
    """Return the long-run covariance of the likelihood's scores, summed over runs."""
    problem, weights = optimum.problem, optimum.equations.weights
    lags = max(hac_lags([s.white[:, 0] for s in of]) for of in problem.by_output())
    meat = np.zeros((problem.free.size, problem.free.size))
    for i in range(len(problem.runs)):
        of_run = [series for series in problem.series if series.run == i]
        scores = sum(weights[s.output] * s.white[:, 1:] * s.white[:, :1] for s in of_run)
        places = of_run[0].places[1:] - 1
        meat[np.ix_(places, places)] += hac_matrix(scores, lags)
    return meat[np.ix_(optimum.loose, optimum.loose)]


def _whitened(series: Series, values: np.ndarray, noise: Noise) -> np.ndarray:
    """Return a change of an output as its prediction errors see it."""
    if noise == Noise():
        return values * series.known
    return whiten(values[:, None], series.known, noise)[0][:, 0]


def _of_stamps(optimum: Optimum, inverse: np.ndarray) -> np.ndarray:
    """Return the covariance due to independent errors of the mode's stamps."""
    problem, weights = optimum.problem, optimum.equations.weights
    added = np.zeros(inverse.shape)
    for i, run in enumerate(problem.runs):
        if run.stamp_error == 0.0 or "mode" not in run.columns:
            continue
        mode = run["mode"]
        simulated = problem.simulated(run, i, optimum.x)
        switches = np.flatnonzero(np.diff(mode > 0.5)) + 1
        # Neighbours add about the same: of thousands of switches some stand for all.
        chosen = switches[:: 1 + switches.size // SWITCHES]
        for k in chosen:
            # One switch a sample later, and what the estimates make of it.
            moved = mode.copy()
            moved[k] = mode[k - 1]
            outputs = problem.simulated(run.changed({"mode": moved}), i, optimum.x)
            by_all = np.zeros(problem.free.size)
            for series in (s for s in problem.series if s.run == i):
                j = series.output
                change = problem.observed(series, outputs[j] - simulated[j]) / run.sample_time
                change = _whitened(series, change, problem.noise[j])
                by_all[series.places[1:] - 1] += weights[j] * (change @ series.white[:, 1:])
            shift = run.stamp_error * inverse @ by_all[optimum.loose]
            added += np.outer(shift, shift) * switches.size / chosen.size
    return added


def mode_delay(optimum: Optimum, inverse: np.ndarray, sandwiched: bool) -> ModeDelay:
    """Return the delay of the mode that the residuals show, to first order; 0 if they cannot."""
    problem, loose = optimum.problem, optimum.loose
    weights = optimum.equations.weights
    none = ModeDelay(0.0, 0.0, np.zeros(loose.size))
    inputs = set(problem.model.inputs)
    if not {"mode"} <= inputs <= {"mode", "p_h"} or "mode_delay" in problem.model.names:
        return none
    slopes = []
    by_all = np.zeros(problem.free.size)
    runs = list(enumerate(problem.runs))
    simulated = [problem.simulated(run, i, optimum.x) for i, run in runs]
    moved = [problem.simulated(late(run, run.sample_time), i, optimum.x) for i, run in runs]
    if all(np.array_equal(one, other) for one, other in zip(simulated, moved, strict=True)):
        return none  # a model that takes no notice of mode
    for series in problem.series:
        # Mode acting later shifts the whole simulation, but for states, which are estimated.
        values = problem.observed(series, simulated[series.run][series.output])
        slope = -np.gradient(values, problem.runs[series.run].sample_time)
        slope = _whitened(series, slope, problem.noise[series.output])
        slopes.append(slope)
        by_all[series.places[1:] - 1] += weights[series.output] * (slope @ series.white[:, 1:])
    answer = np.zeros(by_all.size)
    answer[loose] = inverse @ by_all[loose]
    total = information = score = spread = 0.0
    for series, slope in zip(problem.series, slopes, strict=True):
        weight = weights[series.output]
        # What of the delay's effect the estimates cannot imitate.
        rest = slope - series.white[:, 1:] @ answer[series.places[1:] - 1]
        errors = series.white[:, 0]
        total += weight * (slope @ slope)
        information += weight * (rest @ rest)
        score += weight * (rest @ errors)
        if sandwiched:
            spread += weight**2 * hac_matrix((rest * errors)[:, None], hac_lags([errors])).item()
    if information <= 1e-9 * total:
        return none._replace(shift=answer[loose])
    stderr = np.sqrt(spread if sandwiched else information) / information
    return ModeDelay(float(score / information), float(stderr), answer[loose])


def _shift_of_states(optimum: Optimum) -> np.ndarray:
    """
    Return how far the values move if states leave their bound as far as data allow.

    These states are moved together, equally far in their coordinates, and the rest is estimated
    again (the profile of the likelihood), up to a deviance `LIKELY` above the least.
    """
    problem = optimum.problem
    shared = len(problem.model.names)
    held = np.flatnonzero(optimum.at_bound[shared:]) + shared
    if held.size == 0 or optimum.loose.size == 0 or optimum.exact.all():
        return np.zeros(optimum.x.size)
    low, high = problem.low[held], problem.high[held]
    inwards = np.where(optimum.x[held] <= low, 1.0, -1.0) * (high - low)
    inwards[~np.isfinite(inwards)] = 0.0
    moving = ~optimum.at_bound[problem.free]
    likely = optimum.x
    near, far = 1e-4, 1.0
    for _ in range(7):  # bisect the share of the way to the other bound, on a logarithmic scale
        share = np.sqrt(near * far)
        x = likely.copy()
        x[held] = optimum.x[held] + share * inwards
        x = problem.descend(x, moving, 0.1, 40)[0]
        if problem.equations(x).deviance < optimum.equations.deviance + LIKELY:
            near, likely = share, x
        else:
            far = share
    problem.equations(optimum.x)
    return problem.values(likely) - optimum.problem.values(optimum.x)
