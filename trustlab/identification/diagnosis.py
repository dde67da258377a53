"""
What residuals say against a fit: a mode stamped early or late, coarse numbers, a window that nobody
stated, slow noise.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from trustlab.identification.output_error import NOT_WHITE, Estimate, Problem, settle
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


def doubted(found: Estimate) -> Iterator[str]:
    """
    Say for each reason why the intervals of a fit cannot be trusted what it is, and what to do.
    """
    if (found.normal.squares <= 1e-4 * found.problem.floors).any():
        return
    yield from _sparse(found)
    yield from _coarse(found)
    yield from _window(found)
    yield from _delay(found)
    yield from _slow(found)
    yield from _rivals(found)


def _rivals(found: Estimate) -> Iterator[str]:
    """
    Find other values that explain the data nearly as well, further away than the standard errors
    allow.
    """
    names, stderr = (
        found.problem.structure.names,
        np.sqrt(np.diag(found.covariance)[: found.problem.shared]),
    )
    lowest = min((other.deviance for other in found.rivals), default=0.0)
    for other in found.rivals:
        apart = np.abs(other.theta - found.theta)[: found.problem.shared]
        # Where the likelihood is Gaussian, values z standard errors away cost a deviance of z² at
        # least.
        far = np.flatnonzero(apart > stderr * np.sqrt(4.0 + 2.0 * (other.deviance - lowest)))
        if far.size:
            values = " and ".join(
                f"{names[j]} = {other.theta[j]:.4g} for {found.theta[j]:.4g}" for j in far
            )
            yield (
                f"Other values explain these data nearly as well: {values}; record phases that "
                "move the model more."
            )
            return


def _sparse(found: Estimate) -> Iterator[str]:
    """Find logs with samples further apart than the model's steps."""
    own, step = found.problem.structure.step, found.problem.runs[0].sample_time
    if own is not None and step > 1.5 * own:
        yield (
            f"The log has a sample every {step:g} s, the model a step every {own:g} s: state "
            f"step={own:g}, and with stamp_error={step / 12**0.5:.2g} that mode may have switched "
            f"anywhere between samples (or step={step:g} if your model steps with the log)."
        )


def _coarse(found: Estimate) -> Iterator[str]:
    """Find outputs that are logged in steps which their noise does not blur."""
    for name, sigma in zip(found.problem.structure.outputs, found.sigma, strict=True):
        values = np.concatenate([run[name][:2000] for run in found.problem.runs[:4]])
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


def _delay(found: Estimate) -> Iterator[str]:
    """
    Test whether a mode that acts later or earlier than its stamp explains part of the residuals.
    """
    delay, stderr = found.delay.value, found.delay.stderr
    # Errors of the stamps' own size are in the intervals already.
    known = max(run.stamp_error for run in found.problem.runs)
    if abs(delay) > CERTAIN * np.hypot(stderr, known):
        early = "early" if delay > 0.0 else "late"
        yield (
            f"The residuals look as if mode were stamped {abs(delay):.2g} s {early} (± "
            f"{2.0 * stderr:.1g} s, samples are {found.problem.runs[0].sample_time:g} s apart): "
            "estimate it with mode_delay=True."
        )


def _window(found: Estimate) -> Iterator[str]:
    """Test whether the outputs are means over a window that nobody stated."""
    problem = found.problem
    if found.simple_p >= NOT_WHITE or any(run.window > 1 for run in problem.runs):
        return
    now, best = problem.deviance(found.normal.squares), (0.0, 0.0)
    guess = dict(zip(problem.names, found.theta, strict=True))
    for window in _windows(problem):
        runs = [replace(run, window=window, kept={}) for run in problem.runs]
        for unwindow in (True, False):
            other = Problem(problem.structure, runs, guess, unwindow)
            valley = settle(other, found.theta, found.limits, False, rough=True)
            best = max(best, (now - valley.deviance, window * problem.runs[0].sample_time))
    if best[0] > GAIN:
        outputs = " and ".join(problem.structure.outputs)
        yield (
            f"The residuals are explained by a window of {best[1]:g} s, if the log has means over "
            f"it in place of {outputs}: give window={best[1]:g}, or what the log's makers say."
        )


def _windows(problem: Problem) -> list[int]:
    """Return windows to try, in samples."""
    step, shortest = problem.runs[0].sample_time, min(run.size for run in problem.runs)
    shown = set()
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
            shown.add(lag)
    # Noise on the means hides that: there the usual windows are tried.
    usual = [round(seconds / step) for seconds in (10.0, 30.0, 100.0)]
    return sorted(shown) or [window for window in usual if 2 <= window < shortest]


def _slow(found: Estimate) -> Iterator[str]:
    """Find noise so slow that one record does not tell its size."""
    problem = found.problem
    duration = sum(run.size for run in problem.runs)
    memory = [1.0 / (1.0 - kept) for share, kept in problem.noise if share > 0.01]
    if found.sandwiched:
        memory.append(max(hac_lags(own) for own in problem.residuals()))
    if memory and max(memory) * STRETCHES > duration:
        yield (
            f"Noise is correlated over {max(memory) * problem.runs[0].sample_time:.3g} s, and "
            f"there are only {duration * problem.runs[0].sample_time:.4g} s of data: too few for "
            "an honest interval; record more."
        )
