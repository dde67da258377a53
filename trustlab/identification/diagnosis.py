"""
What to say of a fit: remarks, and reasons to doubt its intervals.

Doubtful are a mode stamped early or late, coarse numbers, an unstated window and slow noise.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from trustlab.identification.output_error import NOT_WHITE, Estimate, Problem, local_optimum
from trustlab.identification.residuals import hac_lags, robust_deviation

CERTAIN = 3.3
"""Standard errors from which on a delay counts: of sound fits one in a thousand is doubted."""

GAIN = 30.0
"""Fall of the deviance from which on a window counts."""

STRETCHES = 200
"""
Correlation times that a record must hold for intervals that cover: with process noise they fall
short below in simulations.
"""


# --- remarks --------------------------------------------------------------------------------------


def search_remark(estimate: Estimate) -> str:
    """Say how the search ended."""
    evaluations = estimate.search.iterations
    if estimate.search.converged:
        return f"Converged in {evaluations} evaluations."
    return (
        f"Stopped after {evaluations} evaluations without reaching a minimum; do not use the "
        "numbers."
    )


def remarks(estimate: Estimate) -> Iterator[str]:
    """Say what a reader should know of the data and of what the intervals allow for."""
    problem = estimate.problem
    yield from _initial_states(estimate)
    people = {run.participant for run in problem.runs}
    if len(people) > 1:
        yield (
            f"{len(people)} participants share one set of parameters; fit them one by one "
            "unless that is meant."
        )
    windows = sorted({run.window * run.sample_time for run in problem.runs if run.window > 1})
    if windows:
        where = "in the values that are averaged" if problem.unwindow else "in the means"
        spans = " and ".join(f"{window:g} s" for window in windows)
        yield (
            f"The outputs are fitted as means over a moving window of {spans}, with noise {where}."
        )
    trials = [run["mode"] for run in problem.runs if "mode" in problem.structure.inputs]
    if len(trials) > 1 and all(np.ptp(mode) == 0.0 for mode in trials):
        yield f"Mode never changes within any of the {len(trials)} runs."
    yield from _dropouts(problem)
    yield from _noise(estimate)


def _initial_states(estimate: Estimate) -> Iterator[str]:
    """Say which initial states lie at an end that has a meaning."""
    problem = estimate.problem
    for j, parameter in enumerate(problem.structure.initial):
        column = slice(problem.shared + j, None, problem.states)
        at_bound = estimate.search.at_bound[column]
        values = estimate.theta[column]
        for end, meaning in parameter.ends.items():
            number = int((at_bound & (values == end)).sum())
            if number:
                yield (
                    f"{parameter.name} = {end:g}, {meaning}, in {number} of {len(problem.runs)} "
                    "run(s)."
                )


def _dropouts(problem: Problem) -> Iterator[str]:
    """Say how many samples of each output were left out as outliers."""
    for j, name in enumerate(problem.structure.outputs):
        lost = [series for series in problem.series_of(j) if series.missing.any()]
        if lost:
            first = problem.runs[lost[0].run].t[lost[0].missing][0]
            yield (
                f"{sum(series.missing.sum() for series in lost)} samples of {name} are far from "
                f"the model all of a sudden, the first at {first:g} s (dropouts?); they are left "
                "out, robust=False keeps them."
            )


def _noise(estimate: Estimate) -> Iterator[str]:
    """Say what the standard errors allow for."""
    white = estimate.simple_p >= NOT_WHITE
    test = f"Residuals are not white (Ljung–Box p = {estimate.simple_p:.2g})"
    if estimate.noise == "correlated":
        problem = estimate.problem
        step = problem.runs[0].sample_time
        parts = [
            f"{name} has {100.0 * noise.share:.3g} % of its noise correlated over "
            f"{-step / np.log(noise.memory):.3g} s"
            for name, noise in zip(problem.structure.outputs, problem.noise, strict=True)
            if noise.share > 0.0 and noise.memory > 0.0
        ]
        begin = "The fit allows" if white else f"{test}: the fit allows"
        left = ", and standard errors for what correlation is left" if estimate.sandwiched else ""
        yield f"{begin} for correlated noise ({'; '.join(parts)}){left}."
    elif estimate.noise == "hac":
        begin = "Standard errors" if white else f"{test}: standard errors"
        yield f"{begin} allow for autocorrelation."
    elif not white:
        yield f'{test}: these standard errors are too small; use noise="auto".'


# --- doubts ---------------------------------------------------------------------------------------


def doubts(estimate: Estimate) -> Iterator[str]:
    """Give every reason why the intervals of a fit cannot be trusted, and what to do."""
    if estimate.exact.any():
        return
    yield from _sparse(estimate)
    yield from _coarse(estimate)
    yield from _window(estimate)
    yield from _delay_warning(estimate)
    yield from _slow(estimate)
    yield from _rivals(estimate)


def _rivals(estimate: Estimate) -> Iterator[str]:
    """Find other values that explain the data as well, beyond what standard errors allow."""
    shared = estimate.problem.shared
    names = estimate.problem.structure.names
    stderr = np.sqrt(np.diag(estimate.covariance)[:shared])
    lowest = min((rival.deviance for rival in estimate.rivals), default=0.0)
    for rival in estimate.rivals:
        distance = np.abs(rival.theta - estimate.theta)[:shared]
        # Where the likelihood is Gaussian, values z standard errors away cost a deviance of z² at
        # least.
        far = np.flatnonzero(distance > stderr * np.sqrt(4.0 + 2.0 * (rival.deviance - lowest)))
        if far.size:
            values = " and ".join(
                f"{names[j]} = {rival.theta[j]:.4g} for {estimate.theta[j]:.4g}" for j in far
            )
            yield (
                f"Other values explain these data nearly as well: {values}; record phases that "
                "move the model more."
            )
            return


def _sparse(estimate: Estimate) -> Iterator[str]:
    """Find logs with samples further apart than the model's steps."""
    model_step = estimate.problem.structure.step
    step = estimate.problem.runs[0].sample_time
    if model_step is not None and step > 1.5 * model_step:
        yield (
            f"The log has a sample every {step:g} s, the model a step every {model_step:g} s: "
            f"state step={model_step:g}, and with stamp_error={step / 12**0.5:.2g} that mode may "
            f"have switched anywhere between samples (or step={step:g} if your model steps with "
            "the log)."
        )


def _coarse(estimate: Estimate) -> Iterator[str]:
    """Find outputs that are logged in steps which their noise does not blur."""
    for name, sigma in zip(estimate.problem.structure.outputs, estimate.sigma, strict=True):
        values = np.concatenate([run[name][:2000] for run in estimate.problem.runs[:4]])
        levels = np.unique(values)
        step = float(np.diff(levels).min(initial=np.inf))
        # Rounding is noise like any other where noise before it has more than half a step as its
        # standard deviation.
        if 1.6 * sigma < step < np.inf and levels.size < 0.5 * values.size:
            steps = (levels - levels[0]) / step
            if np.allclose(steps, np.round(steps), atol=1e-3):
                yield (
                    f"{name} is logged in steps of {step:.2g}, more than its noise ({sigma:.2g}): "
                    "rounding shifts the estimates by more than these standard errors; log more "
                    "digits."
                )


def _delay_warning(estimate: Estimate) -> Iterator[str]:
    """Test whether a mode that acts later or earlier than its stamp explains the residuals."""
    runs = estimate.problem.runs
    delay, stderr, _ = estimate.delay
    # Errors of the stamps' own size are in the intervals already.
    stamp_error = max(run.stamp_error for run in runs)
    if abs(delay) > CERTAIN * np.hypot(stderr, stamp_error):
        early = "early" if delay > 0.0 else "late"
        yield (
            f"The residuals look as if mode were stamped {abs(delay):.2g} s {early} (± "
            f"{2.0 * stderr:.1g} s, samples are {runs[0].sample_time:g} s apart): "
            "estimate it with mode_delay=True."
        )


def _window(estimate: Estimate) -> Iterator[str]:
    """Test whether the outputs are means over a window not stated, or a sample off it."""
    problem = estimate.problem
    if estimate.simple_p >= NOT_WHITE:
        return
    stated = max(run.window for run in problem.runs)
    deviance = problem.deviance(estimate.equations.squares)
    guess = dict(zip(problem.names, estimate.theta, strict=True))
    best = (0.0, 0.0)
    for window in _candidate_windows(problem) if stated == 1 else (stated - 1, stated + 1):
        runs = [replace(run, window=window) for run in problem.runs]
        for unwindow in (True, False):
            averaged = Problem(problem.structure, runs, guess, unwindow)
            optimum = local_optimum(averaged, estimate.theta, estimate.limits, False, rough=True)
            gain = deviance - optimum.deviance
            best = max(best, (gain, window * problem.runs[0].sample_time))
    if best[0] > GAIN and stated > 1:
        yield (
            f"The residuals are better explained by a window of {best[1]:g} s, a sample off the "
            "one stated; the sum of (2.4), taken literally, has W + 1 samples: give "
            f"window={best[1]:g}."
        )
    elif best[0] > GAIN:
        outputs = " and ".join(problem.structure.outputs)
        yield (
            f"The residuals are explained by a window of {best[1]:g} s, if the log has means over "
            f"it in place of {outputs}: give window={best[1]:g}, or what the log's makers say."
        )


def _candidate_windows(problem: Problem) -> list[int]:
    """Return windows to try, in samples."""
    candidates = set()
    for name in problem.structure.outputs:
        # A window mean moves by (z(k) − z(k − W))/W: with noise in z its differences are correlated
        # by −½ at lag W. Second differences have that, too, and next to nothing of what moves
        # slowly.
        moves = np.diff(max((run[name] for run in problem.runs), key=len), n=2)
        # The first means are of few samples and move much more.
        most = 4.0 * robust_deviation([moves])
        power = np.abs(np.fft.rfft(np.clip(moves, -most, most), 2 * moves.size)) ** 2
        correlation = np.fft.irfft(power)[: max(5, moves.size * 3 // 4)]
        lag = int(np.argmin(correlation[4:])) + 4
        if correlation[lag] < -0.2 * correlation[0]:
            candidates.add(lag)
    if candidates:
        return sorted(candidates)
    # Noise on the means hides that: the usual windows are tried.
    shortest = min(run.size for run in problem.runs)
    usual = [round(seconds / problem.runs[0].sample_time) for seconds in (10.0, 30.0, 100.0)]
    return [window for window in usual if 2 <= window < shortest]


def _slow(estimate: Estimate) -> Iterator[str]:
    """Find noise so slow that one record does not tell its size."""
    problem = estimate.problem
    samples = sum(run.size for run in problem.runs)
    memory = [1.0 / (1.0 - noise.memory) for noise in problem.noise if noise.share > 0.01]
    if estimate.sandwiched:
        memory.append(max(hac_lags(errors) for errors in problem.residuals()))
    if memory and max(memory) * STRETCHES > samples:
        step = problem.runs[0].sample_time
        yield (
            f"Noise is correlated over {max(memory) * step:.3g} s, and there are only "
            f"{samples * step:.4g} s of data: too few for an honest interval; record more."
        )
