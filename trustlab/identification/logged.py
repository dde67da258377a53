"""How a log shows a model: window means, a shifted mode, several model steps per sample."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace

import numpy as np

from trustlab.identification.runs import LogSettings, Run
from trustlab.identification.structure import Parameter, Structure

# Time [s] by which the mode acts later than the log says; negative where it is stamped late.
DELAY = Parameter("mode_delay", guess=0.0)


def counts(size: int, window: int) -> np.ndarray:
    """Return each window's sample count; windows at the start are shorter."""
    return np.minimum(np.arange(1.0, size + 1.0), window)


def window_means(values: np.ndarray, window: int) -> np.ndarray:
    """Return the means over the last `window` samples, down the columns."""
    sums = np.cumsum(values, axis=0)
    sums[window:] -= sums[:-window].copy()
    return sums / _down(counts(len(values), window), values)


def undo_window(means: np.ndarray, window: int) -> np.ndarray:
    """Return the values that `window_means` was made of."""
    sums = means * _down(counts(len(means), window), means)
    # Each sample the window gains the new value and loses the oldest: z(k) = Δs(k) + z(k − W).
    gained = np.diff(sums, axis=0, prepend=0.0 * sums[:1])
    columns = means.shape[1:]
    padded = np.concatenate([gained, np.zeros((-len(means) % window, *columns))])
    values = padded.reshape(-1, window, *columns).cumsum(axis=0).reshape(padded.shape)
    return values[: len(means)]


def _down(weights: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return weights of the rows in the shape that multiplies the columns of `values`."""
    return weights.reshape(-1, *[1] * (values.ndim - 1))


def logged_structure(structure: Structure, sample_time: float, log: LogSettings) -> Structure:
    """
    Return a structure as the log shows it: finer steps, a mode delay to estimate, or both.

    Between samples the inputs keep the last value logged.
    """
    if log.step is None and not log.mode_delay:
        return structure
    ratio = 1 if log.step is None else _steps_per_sample(sample_time, log.step)
    delayed = log.mode_delay

    def sensitivities(run: Run, mode_delay: float = 0.0, **values):
        fine = refined(run, ratio)
        outputs, jacobians = structure.predict(late(fine, mode_delay), values)
        if delayed:
            step = 0.5 * fine.sample_time
            after, _ = structure.predict(late(fine, mode_delay + step), values)
            before, _ = structure.predict(late(fine, mode_delay - step), values)
            slopes = [(a - b) / (2.0 * step) for a, b in zip(after, before, strict=True)]
            jacobians = [np.column_stack(pair) for pair in zip(jacobians, slopes, strict=True)]
        return [y[::ratio] for y in outputs], [by[::ratio] for by in jacobians]

    def guess(runs: list[Run], limits: Mapping) -> Mapping | list[Mapping]:
        if structure.guess is None:
            return {}
        return structure.guess([refined(run, ratio) for run in runs], limits)

    def model(mode_delay: float = 0.0, **values):
        return values if structure.model is None else structure.model(**values)

    added = (DELAY,) if delayed else ()
    affecting = {}
    for output in structure.outputs:
        names = [structure.names[j] for j in structure.columns_of(output)]
        affecting[output] = [*names, *(parameter.name for parameter in added)]
    return replace(
        structure,
        parameters=(*structure.parameters, *added),
        affected_by=affecting,
        sensitivities=sensitivities,
        guess=guess,
        model=model,
        linear=None,
        step=None,
    )


def _steps_per_sample(sample_time: float, step: float) -> int:
    """Return the whole number of steps in a sample."""
    ratio = sample_time / step
    if round(ratio) < 1 or abs(ratio - round(ratio)) > 1e-6 * ratio:
        raise ValueError(
            f"step = {step:g} s does not divide the log's sample time, {sample_time:g} s"
        )
    return round(ratio)


def refined(run: Run, ratio: int) -> Run:
    """Return a run with `ratio` samples for each, all columns held."""
    if ratio == 1:
        return run
    columns = {name: np.repeat(values, ratio) for name, values in run.columns.items()}
    t = run.t[0] + run.sample_time / ratio * np.arange(run.size * ratio)
    return replace(run, t=t, columns=columns)


def late(run: Run, delay: float) -> Run:
    """Return a run whose mode acts later by `delay` [s]; part of a sample becomes a share of it."""
    if delay == 0.0 or "mode" not in run.columns:
        return run
    at = np.arange(run.size, dtype=float)
    return run.changed({"mode": np.interp(at - delay / run.sample_time, at, run["mode"])})


def averaged(run: Run, names: Iterable[str], change: Callable) -> Run:
    """Return a run without a window, some of its columns changed by `change(values, window)`."""
    return run.changed({name: change(run[name], run.window) for name in names}, window=1)
