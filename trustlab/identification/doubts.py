"""
What to say of a fit: remarks, and reasons to doubt its intervals.

Doubtful are a mode stamped early or late, coarse numbers, slow noise, and other values that explain
the data as well.
"""

from collections.abc import Iterator

import numpy as np

from trustlab.identification.estimate import NOT_WHITE, Estimate
from trustlab.identification.noise import hac_lags
from trustlab.identification.problem import Problem
from trustlab.models.display import counted

# Standard errors from which on a delay counts: of sound fits one in a thousand is doubted.
CERTAIN = 3.3

# Correlation times that a record must hold for intervals that cover: with process noise they fall
# short below in simulations.
STRETCHES = 200


# --- remarks --------------------------------------------------------------------------------------


def search_remark(estimate: Estimate) -> str:
    """Say how the search ended."""
    steps = estimate.optimum.steps
    if estimate.optimum.converged:
        return f"Converged in {steps} {'evaluation' if steps == 1 else 'evaluations'}."
    return f"Stopped after {steps} evaluations without reaching a minimum; do not use the numbers."


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
    trials = [run["mode"] for run in problem.runs if "mode" in problem.model.inputs]
    if len(trials) > 1 and all(np.ptp(mode) == 0.0 for mode in trials):
        yield f"Mode never changes within any of the {len(trials)} runs."
    if "p_h" in problem.model.inputs:
        yield (
            "The measured p_h drives the model, and its noise counts as performance: where that is "
            "large, the effect of p_h is underrated."
        )
    yield from _dropouts(problem)
    yield from _noise(estimate)


def _initial_states(estimate: Estimate) -> Iterator[str]:
    """Say which initial loads lie at rest or at full load."""
    problem, optimum = estimate.problem, estimate.optimum
    names = np.array(problem.unknowns)
    for name in problem.model.states:
        if problem.model.coordinates.get(name) != "load":
            continue
        held = optimum.at_bound & (names == name)
        for end, meaning in ((0.0, "a rested operator"), (1.0, "an operator at full load")):
            number = int((held & (estimate.values == end)).sum())
            if number:
                runs = counted(len(problem.runs), "run")
                yield f"{name} = {end:g}, {meaning}, in {number} of {runs}."


def _dropouts(problem: Problem) -> Iterator[str]:
    """Say how many samples of each output were left out as outliers."""
    for name, of_output in zip(problem.model.outputs, problem.by_output(), strict=True):
        lost = [series for series in of_output if not series.known.all()]
        if lost:
            first = problem.runs[lost[0].run].t[~lost[0].known][0]
            yield (
                f"{sum((~series.known).sum() for series in lost)} samples of {name} are far from "
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
            for name, noise in zip(problem.model.outputs, problem.noise, strict=True)
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
    if estimate.optimum.exact.any():
        return
    yield from _coarse(estimate)
    yield from _delay_warning(estimate)
    yield from _slow(estimate)
    yield from _rivals(estimate)


def _rivals(estimate: Estimate) -> Iterator[str]:
    """Find other values that explain the data as well, beyond what standard errors allow."""
    names = estimate.problem.model.names
    shared = len(names)
    stderr = np.sqrt(np.diag(estimate.covariance)[:shared])
    lowest = min((rival.deviance for rival in estimate.rivals), default=0.0)
    values = estimate.values
    for rival in estimate.rivals:
        others = rival.problem.values(rival.x)
        # Where the likelihood is Gaussian, values z standard errors away cost a deviance of z² at
        # least.
        most = stderr * np.sqrt(4.0 + 2.0 * (rival.deviance - lowest))
        far = np.flatnonzero(np.abs(others - values)[:shared] > most)
        if far.size:
            listed = [f"{names[j]} = {others[j]:.4g} for {values[j]:.4g}" for j in far]
            yield (
                f"Other values explain these data nearly as well: {' and '.join(listed)}; record "
                "phases that move the model more."
            )
            return


def _coarse(estimate: Estimate) -> Iterator[str]:
    """Find outputs that are logged in steps which their noise does not blur."""
    for name, sigma in zip(estimate.problem.model.outputs, estimate.sigma, strict=True):
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


def _slow(estimate: Estimate) -> Iterator[str]:
    """Find noise so slow that one record does not tell its size."""
    problem = estimate.problem
    samples = sum(run.size for run in problem.runs)
    memory = [1.0 / (1.0 - noise.memory) for noise in problem.noise if noise.share > 0.01]
    if estimate.sandwiched:
        memory.append(
            max(hac_lags([s.white[:, 0] for s in of_output]) for of_output in problem.by_output())
        )
    if memory and max(memory) * STRETCHES > samples:
        step = problem.runs[0].sample_time
        yield (
            f"Noise is correlated over {max(memory) * step:.3g} s, and there are only "
            f"{samples * step:.4g} s of data: too few for an honest interval; record more."
        )
