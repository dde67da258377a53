"""
From runs to an estimate: the search, the optimum, and its covariance.

A rough search goes from every start of the model, a fine one on from the best. The covariance adds
three parts: of noise, of errors of the mode's stamps, of states held by a bound; in coordinates of
the search, in which the likelihood is most nearly Gaussian.

[L] Ljung, *System Identification: Theory for the User*, 2nd ed., 1999.
[S] Söderström and Stoica, *System Identification*, 1989.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from trustlab.identification.log import (
    Run,
    averaged,
    late,
    undo_window,
    window_means,
)
from trustlab.identification.model import Model
from trustlab.identification.problem import (
    FINE,
    NOT_WHITE,
    ROUNDING,
    STEP_OF_LOAD,
    Noise,
    Optimum,
    Problem,
    Series,
    hac_lags,
    hac_matrix,
    outliers,
    robust_deviation,
    whiten,
    whiteness_p,
)

# Status of a search that its callback stopped.
STOPPED = -2

# How optima are searched before the best is known.
ROUGH: dict[str, Any] = {"tolerance": 0.1, "most": 40}

# --- the search ----------------------------------------------------------------------------------


def search(
    problem: Problem, x: np.ndarray, tolerance: float = FINE, most: int = 40, method: str = "dogbox"
) -> Optimum:
    """Return the optimum next to a full vector; its last step gained less than `tolerance`."""
    x = np.clip(x, problem.low, problem.high)
    first = problem.equations(x)
    if not np.isfinite(first.deviance + first.matrix.sum()):
        values = zip(problem.labels, problem.values(x), strict=True)
        raise ValueError(
            "the model simulates values that are not finite at "
            f"{', '.join(f'{name} = {value:.4g}' for name, value in values)}; start elsewhere "
            "with guess={...} or narrow the bounds"
        )
    moving = np.ones(problem.free.size, bool)
    x, held, converged, steps = descend(problem, x, moving, tolerance, most, method)
    ends = np.where(x - problem.low < problem.high - x, problem.low, problem.high)
    at_end = np.isin(problem.free, problem.loads) & (np.abs(x - ends)[problem.free] < STEP_OF_LOAD)
    if not converged and (at_end.any() or tolerance <= FINE):
        # (2.6) has a kink at rest and at full load, which defies any quadratic model: a search
        # that does not settle there goes on with the others. One that is to be fine goes on.
        x[problem.free[at_end]] = ends[problem.free[at_end]]
        x, held, converged, more = descend(problem, x, ~at_end, tolerance, 4 * most)
        held, steps = held | at_end, steps + more
    at_bound = np.zeros(x.size, bool)
    at_bound[problem.free] = held
    return Optimum(problem, x, at_bound, converged, steps)


def descend(
    problem: Problem,
    start: np.ndarray,
    moving: np.ndarray,
    tolerance: float,
    most: int,
    method: str = "dogbox",
) -> tuple[np.ndarray, np.ndarray, bool, int]:
    """
    Search with some of the free unknowns moving.

    Return where it ended, which of the free unknowns a bound holds, whether it settled, and
    after how many evaluations.
    """
    from scipy.optimize import least_squares

    places = problem.free[moving]
    held = np.zeros(problem.free.size, bool)
    if places.size == 0:
        return start, held, True, 1
    # A search for least squares uses no more of f and J than |f|², Jᵀf and JᵀJ. Those of the
    # likelihood itself fit in one row more than there are unknowns.
    floor = (
        float(problem.counts @ np.log(problem.floors / problem.counts))
        - 30.0 * problem.counts.sum()
    )

    def at(x: np.ndarray) -> np.ndarray:
        full = start.copy()
        full[places] = x
        return full

    def residuals(x: np.ndarray) -> np.ndarray:
        here = problem.equations(at(x))
        with np.errstate(invalid="ignore"):  # where a model is not defined: ∞ − ∞
            rest = here.deviance - floor - here.residual @ here.residual
        return np.r_[here.residual, np.sqrt(max(rest, 0.0))]

    def jacobian(x: np.ndarray) -> np.ndarray:
        root = problem.equations(at(x)).root[:, moving]
        return np.vstack([root, np.zeros(places.size)])

    low, high = problem.low[places], problem.high[places]

    def stop(intermediate_result: Any) -> None:
        # Where a Gauss–Newton step would gain nothing, only rounding would move the search.
        x = intermediate_result.x
        here = problem.equations(at(x))
        root = here.root[:, moving]
        gain = here.residual @ root @ np.linalg.lstsq(root, here.residual)[0]
        if ((low < x) & (x < high)).all() and gain < 0.01 * tolerance:
            raise StopIteration

    end = least_squares(
        residuals,
        start[places],
        jacobian,
        bounds=(low, high),
        # "dogbox" holds what reaches a bound there, and may run to one from far away; "trf"
        # comes near a bound in many steps, and finds its way from far.
        method=method,
        x_scale="jac",
        ftol=max(tolerance / (problem.equations(start).deviance - floor), 4e-16),
        xtol=1e-13,
        gtol=1e-13,
        max_nfev=most,
        callback=stop,
    )
    held[moving] = end.active_mask != 0
    # No search can come closer than rounding.
    exact = (problem.equations(at(end.x)).squares <= ROUNDING * problem.floors).all()
    settled = end.success or end.status == STOPPED or exact
    return at(end.x), held, bool(settled), int(end.nfev)


def robust_search(problem: Problem, x: np.ndarray, robust: bool, **options: Any) -> Optimum:
    """Search, and again without the outliers that show."""
    optimum = search(problem, x, **options)
    for _ in range(5):
        if not robust or optimum.exact.all() or not _leave_out(problem):
            break
        optimum = search(problem, optimum.x, **options)
    return optimum


def _leave_out(problem: Problem) -> bool:
    """Leave out outliers among the residuals; return whether there are new ones."""
    marks: list[tuple[Series, np.ndarray]] = []
    for of_output in problem.by_output():
        scale = robust_deviation([s.plain[s.known, 0] for s in of_output])
        far = [outliers(_errors(problem, series), scale) for series in of_output]
        # More than a quarter are no outliers: the model does not describe these data.
        if np.concatenate(far).mean() >= 0.25:
            return False
        marks += zip(of_output, far, strict=True)
    if all(np.array_equal(~mark, series.known) for series, mark in marks):
        return False
    for series, mark in marks:
        series.known = ~mark
    problem.evaluated = (None, None)
    return True


def _errors(problem: Problem, series: Series) -> np.ndarray:
    """Return measured minus simulated of all samples, also of those left out."""
    outputs = problem.simulated(problem.runs[series.run], series.run, problem.evaluated[0])
    return series.measured - problem.observed(series, outputs[series.output])


# --- the covariance ------------------------------------------------------------------------------

NOISES = ("auto", "white", "correlated", "hac")

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
    `sandwiched` says that the covariance allows for remaining correlation. `rivals` are the best
    of the rough optima and others nearly as likely.
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
    def stderr(self) -> np.ndarray:
        """Standard errors of the full vector; NaN for what is fixed or held by a bound."""
        return np.sqrt(np.where(self.fixed, np.nan, np.diag(self.covariance)))

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
            problem.fit_noise()
            optimum = search(problem, optimum.x)
    inverse = optimum.inverse_information()
    modelled = any(model != Noise() for model in problem.noise)
    p_value = whiteness_of(optimum) if modelled else simple_p
    sandwiched = noise == "hac" or (noise in ("auto", "correlated") and p_value < NOT_WHITE)
    delay = mode_delay(optimum, inverse, sandwiched)
    # For white residuals the covariance is the inverse information ([L] Section 9.4, [S] Section
    # 7.5); else that is the bread of a sandwich. Residuals are too small by (n − p)/n on average:
    # the factor makes the white form s² (JᵀJ)⁻¹ with s² = Σ e²/(n − p), and the robust one HC1 of
    # MacKinnon & White 1985 (Stata's newey).
    samples = problem.counts.sum()
    factor = samples / max(samples - len(inverse), 1.0)
    block = factor * (inverse @ _meat(optimum) @ inverse if sandwiched else inverse)
    block += _of_stamps(optimum, inverse)
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
    for of_run in problem.by_run():
        scores = sum(weights[s.output] * s.white[:, 1:] * s.white[:, :1] for s in of_run)
        places = of_run[0].places[1:] - 1
        meat[np.ix_(places, places)] += hac_matrix(scores, lags)
    return meat[np.ix_(optimum.loose, optimum.loose)]


def _changes(optimum: Optimum, i: int, modes: list[np.ndarray]) -> list[tuple[Series, np.ndarray]]:
    """Return how outputs of run i change, per second, where other modes act a sample later."""
    problem, run = optimum.problem, optimum.problem.runs[i]
    simulated = problem.simulated(run, i, optimum.x)
    moved = [problem.simulated(run.changed({"mode": mode}), i, optimum.x) for mode in modes]
    changes = []
    for series in problem.by_run()[i]:
        j = series.output
        later = np.column_stack([outputs[j] - simulated[j] for outputs in moved])
        changes.append((series, problem.observed(series, later) / run.sample_time))
    return changes


def _answers(
    optimum: Optimum, inverse: np.ndarray, changes: list[tuple[Series, np.ndarray]]
) -> tuple[list[np.ndarray], np.ndarray]:
    """
    Return changes of outputs, shape (N, K) by series, as prediction errors see them, and what the
    loose unknowns make of them, shape (unknowns, K).
    """
    problem, weights = optimum.problem, optimum.equations.weights
    totals = np.zeros((problem.free.size, changes[0][1].shape[1]))
    seen = []
    for series, change in changes:
        noise = problem.noise[series.output]
        seen.append(whiten(change * series.known[:, None], series.known, noise)[0])
        totals[series.places[1:] - 1] += weights[series.output] * series.white[:, 1:].T @ seen[-1]
    return seen, inverse @ totals[optimum.loose]


def _of_stamps(optimum: Optimum, inverse: np.ndarray) -> np.ndarray:
    """Return the covariance due to independent errors of the mode's stamps."""
    problem = optimum.problem
    added = np.zeros(inverse.shape)
    for i, run in enumerate(problem.runs):
        mode = run.columns.get("mode", np.zeros(1))
        switches = np.flatnonzero(np.diff(mode > 0.5)) + 1
        if run.stamp_error == 0.0 or switches.size == 0:
            continue
        # Neighbours add about the same: of thousands of switches some stand for all.
        chosen = switches[:: 1 + switches.size // SWITCHES]
        modes = []
        for k in chosen:
            # One switch a sample later, and what the estimates make of it.
            moved = mode.copy()
            moved[k] = mode[k - 1]
            modes.append(moved)
        changes = _changes(optimum, i, modes)
        shifts = run.stamp_error * _answers(optimum, inverse, changes)[1]
        added += shifts @ shifts.T * switches.size / chosen.size
    return added


def mode_delay(optimum: Optimum, inverse: np.ndarray, sandwiched: bool) -> ModeDelay:
    """Return the delay of the mode that the residuals show, to first order; 0 if they cannot."""
    problem, loose = optimum.problem, optimum.loose
    weights = optimum.equations.weights
    none = ModeDelay(0.0, 0.0, np.zeros(loose.size))
    if "mode" not in problem.model.inputs or "mode_delay" in problem.model.names:
        return none
    changes = []
    for i, run in enumerate(problem.runs):
        # Half a sample either way: simulations bend where a delay takes in another sample.
        ends = [late(run, half * run.sample_time)["mode"] for half in (0.5, -0.5)]
        pairs = _changes(optimum, i, ends)
        changes += [(series, change[:, :1] - change[:, 1:]) for series, change in pairs]
    slopes, shift = _answers(optimum, inverse, changes)
    answer = np.zeros(problem.free.size)
    answer[loose] = shift[:, 0]
    total = information = score = spread = 0.0
    for series, slope in zip(problem.series, slopes, strict=True):
        weight, errors = weights[series.output], series.white[:, 0]
        # What of the delay's effect the estimates cannot imitate.
        rest = slope[:, 0] - series.white[:, 1:] @ answer[series.places[1:] - 1]
        total += weight * np.sum(slope**2)
        information += weight * (rest @ rest)
        score += weight * (rest @ errors)
        if sandwiched:
            spread += weight**2 * hac_matrix((rest * errors)[:, None], hac_lags([errors])).item()
    if information <= 1e-9 * total:
        return none._replace(shift=answer[loose])
    stderr = np.sqrt(spread if sandwiched else information) / information
    return ModeDelay(float(score / information), float(stderr), answer[loose])


def _with_held(optimum: Optimum, held: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Return the full vector that a search finds with some unknowns held at other places."""
    x = optimum.x.copy()
    x[held] = places
    moving = ~np.isin(optimum.problem.free, held)
    return descend(optimum.problem, x, moving, **ROUGH)[0]


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
    likely = optimum.x
    near, far = 1e-4, 1.0
    for _ in range(7):  # bisect the share of the way to the other bound, on a logarithmic scale
        share = np.sqrt(near * far)
        x = _with_held(optimum, held, optimum.x[held] + share * inwards)
        if problem.equations(x).deviance < optimum.equations.deviance + LIKELY:
            near, likely = share, x
        else:
            far = share
    problem.equations(optimum.x)
    return problem.values(likely) - optimum.problem.values(optimum.x)


# --- from every start ----------------------------------------------------------------------------

# Optima up to this far above the best, in deviance, are searched further.
SHALLOW = 30.0

# Other optima within this deviance of the best still count as possible: odds of e⁵ to 1.
RIVAL = 10.0

# Distances from rest or full load, in the coordinate of a load, that are tried where one is near.
NEAR = (0.0, 0.002, 0.008, 0.02, 0.05)


def estimate_runs(
    model: Model,
    runs: list[Run],
    limits: Mapping,
    noise: str = "auto",
    guess: Mapping[str, float] | None = None,
    robust: bool = True,
) -> Estimate:
    """Search from every start, and return the best optimum as an estimate."""
    if guess is not None:
        model.check_names(guess, "guess")
    optima = rough_optima(model, runs, limits, guess, robust)
    best = optima[0]
    others = [optimum for optimum in optima[1:] if not optimum.same_as(best)]
    rivals = [optimum for optimum in others if optimum.deviance < best.deviance + RIVAL]
    for optimum in rivals:
        # Raises where one that is nearly as likely does not determine the unknowns.
        optimum.inverse_information()
    optimum = _beside_ends(robust_search(best.problem, best.x, robust))
    return replace(estimated(optimum, noise), rivals=(best, *rivals))


def rough_optima(
    model: Model,
    runs: list[Run],
    limits: Mapping,
    guess: Mapping[str, float] | None = None,
    robust: bool = True,
) -> list[Optimum]:
    """Search roughly from every start, and return the optima, the most likely first."""
    optima = []
    for unwindow, view in _views(model, runs):
        for values in model.starts(view, limits) if model.starts else [{}]:
            problem = Problem(model, runs, limits, unwindow)
            x = problem.full_vector(_completed({**values, **(guess or {})}, limits))
            # A model's own start lies near an optimum; another may lie anywhere.
            near = not guess and values.keys() >= set(model.unknowns)
            method = "dogbox" if near else "trf"
            optima.append(robust_search(problem, x, robust, method=method, **ROUGH))
    optima.sort(key=lambda optimum: optimum.deviance)
    if any(run.window > 1 for run in runs):
        bests = [next(o for o in optima if o.problem.unwindow == view) for view in (True, False)]
        chosen = min(bests, key=_deviance_with_noise)
        optima = [o for o in optima if o.problem.unwindow == chosen.problem.unwindow]
        # Means hide where utilization began: another beginning may explain them as well.
        optima += _elsewhere(chosen)
        optima.sort(key=lambda optimum: optimum.deviance)
    return optima


def _deviance_with_noise(optimum: Optimum) -> float:
    """Return the deviance once the noise has a model, which rounded or averaged noise needs."""
    problem = optimum.problem
    white = problem.noise
    problem.equations(optimum.x)
    problem.fit_noise()
    deviance = search(problem, optimum.x, **ROUGH).deviance
    problem.set_noise(white)
    return deviance


def _elsewhere(optimum: Optimum) -> Iterator[Optimum]:
    """Hold loads at other places, search there, and go on from there with them free."""
    problem = optimum.problem
    loads = problem.loads
    for share in (0.1, 0.3, 0.5, 0.8) if loads.size else ():
        places = problem.low[loads] + share * (problem.high - problem.low)[loads]
        x = _with_held(optimum, loads, places)
        if problem.equations(x).deviance < optimum.equations.deviance + SHALLOW:
            yield search(problem, x, **ROUGH)


def _beside_ends(optimum: Optimum) -> Optimum:
    """Search again from loads held where the best are near their end: (2.6) bends there."""
    problem, x = optimum.problem, optimum.x
    loads = problem.loads
    low, high = problem.low[loads], problem.high[loads]
    ends = np.where(x[loads] - low < high - x[loads], low, high)
    near = np.abs(x[loads] - ends) < NEAR[-1]
    if not near.any():
        return optimum
    inwards = low + high - 2.0 * ends
    tried = [_with_held(optimum, loads[near], (ends + s * inwards)[near]) for s in NEAR]
    other = search(problem, min(tried, key=lambda x: problem.equations(x).deviance))
    return min(optimum, other, key=lambda each: each.deviance)


def _views(model: Model, runs: list[Run]) -> list[tuple[bool, list[Run]]]:
    """
    Return the ways to see windowed runs, as they are for starting values: with noise in the values
    that the window averages, which are undone, or in the means.

    The likelihoods of both decide. In the second view the inputs are averaged as well, which gives
    a linear model's means but for the beginning.
    """
    if not any(run.window > 1 for run in runs):
        return [(False, runs)]
    return [
        (True, [averaged(run, model.outputs, undo_window) for run in runs]),
        (False, [averaged(run, model.inputs, window_means) for run in runs]),
    ]


def _completed(start: dict, limits: Mapping) -> dict:
    """Return a start with the middle of the bounds where it has no value."""
    for name, (low, high) in limits.items():
        if name not in start and not np.isfinite(high - low):
            raise ValueError(
                f"{name} needs a guess, or bounds on both sides: guess={{{name!r}: …}}"
            )
        start.setdefault(name, 0.5 * (low + high))
    return start
