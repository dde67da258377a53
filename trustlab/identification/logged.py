"""
How a log shows a model: window means, a mode stamped early or late, samples further apart than the
model's steps.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace

import numpy as np

from trustlab.identification.runs import Run
from trustlab.identification.structure import Parameter, Structure

# Time [s] by which the mode acts later than the log says; negative where it is stamped late.
DELAY = Parameter("mode_delay", guess=0.0)


def counts(size: int, window: int) -> np.ndarray:
    """
    Return the number of samples in the window that ends at each sample: of what there is at the
    start.
    """
    return np.minimum(np.arange(1.0, size + 1.0), window)


def window_means(values: np.ndarray, window: int) -> np.ndarray:
    """Return the means over the last `window` samples, down the columns."""
    sums = np.cumsum(values, axis=0)
    sums[window:] -= sums[:-window].copy()
    return sums / _down(counts(len(values), window), values)


def undo_window(means: np.ndarray, window: int) -> np.ndarray:
    """Return the values that `window_means` was made of."""
    sums = means * _down(counts(len(means), window), means)
    # What the window gained over a sample is the new value less the one that left it: z(k) = Δs(k)
    # + z(k − W).
    gained = np.diff(sums, axis=0, prepend=0.0 * sums[:1])
    padded = np.concatenate([gained, np.zeros((-len(means) % window, *means.shape[1:]))])
    return (
        padded.reshape(-1, window, *means.shape[1:])
        .cumsum(axis=0)
        .reshape(padded.shape)[: len(means)]
    )


def _down(weights: np.ndarray, values: np.ndarray) -> np.ndarray:
    return weights.reshape(-1, *[1] * (values.ndim - 1))


def as_logged(structure: Structure, ratio: int, delayed: bool) -> Structure:
    """
    Return a structure as the log shows it: with `ratio` model steps per sample and, if `delayed`, a
    mode delay to estimate.

    Between samples the inputs keep the last value logged.
    """

    def sensitivities(run: Run, mode_delay: float = 0.0, **values):
        fine = refined(run, ratio)
        outputs, jacobians = structure.predict(late(fine, mode_delay) if delayed else fine, values)
        if delayed:
            step = 0.5 * fine.sample_time
            after, before = (
                structure.predict(late(fine, mode_delay + by), values)[0] for by in (step, -step)
            )
            slopes = [
                (one - other) / (2.0 * step) for one, other in zip(after, before, strict=True)
            ]
            jacobians = [np.column_stack(pair) for pair in zip(jacobians, slopes, strict=True)]
        return [one[::ratio] for one in outputs], [one[::ratio] for one in jacobians]

    def guess(runs: list[Run], limits: Mapping) -> Mapping | list[Mapping]:
        return (
            {}
            if structure.guess is None
            else structure.guess([refined(run, ratio) for run in runs], limits)
        )

    def model(mode_delay: float = 0.0, **values):
        return values if structure.model is None else structure.model(**values)

    moving = {
        name: [structure.names[j] for j in structure.columns_of(name)] for name in structure.outputs
    }
    return replace(
        structure,
        parameters=(*structure.parameters, DELAY) if delayed else structure.parameters,
        affected_by={
            name: (*own, "mode_delay") if delayed else own for name, own in moving.items()
        },
        sensitivities=sensitivities,
        guess=guess,
        model=model,
        linear=None,
        step=None,
    )


def refined(run: Run, ratio: int) -> Run:
    """Return a run with `ratio` samples for each, all columns held."""
    if ratio == 1:
        return run
    columns = {name: np.repeat(values, ratio) for name, values in run.columns.items()}
    t = run.t[0] + run.sample_time / ratio * np.arange(run.size * ratio)
    return replace(run, t=t, columns=columns, kept={})


def late(run: Run, delay: float) -> Run:
    """
    Return a run whose mode acts later by `delay` [s]; a part of a sample is a share of the mode
    over that sample.
    """
    if delay == 0.0 or "mode" not in run.columns:
        return run
    at = np.arange(run.size, dtype=float)
    moved = np.interp(at - delay / run.sample_time, at, run["mode"])
    return replace(run, columns={**run.columns, "mode": moved}, kept={})


def averaged(run: Run, names: Iterable[str], change: Callable) -> Run:
    """Return a run without a window, some of its columns changed by `change(values, window)`."""
    changed = {name: change(run[name], run.window) for name in names}
    return replace(run, columns={**run.columns, **changed}, window=1, kept={})
