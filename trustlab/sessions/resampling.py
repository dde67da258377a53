"""Bring samples to a uniform time axis, by a way that has a name; nothing is extrapolated."""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping

import numpy as np

from trustlab.sessions.column_rules import ColumnRule
from trustlab.sessions.errors import SessionError, nearest
from trustlab.sessions.log import MAX_SAMPLES, Log
from trustlab.sessions.rules import RESAMPLING

__all__ = [
    "HELD",
    "check_resampling",
    "interpolate",
    "method_for",
    "resample_log",
    "resampled_note",
    "time_grid",
]

HELD = ("mode", "suggested_mode")
"""Columns that name a state; "linear" holds their previous value, as half a state was never there."""


def check_resampling(method: object, sample_time: object, source: str | None) -> None:
    """
    Raise unless both are given and make sense, or neither.

    Parameters
    ----------
    method : str or None
        A name from RESAMPLING.
    sample_time : float or None
        Time between samples [s].
    source : str, optional
        The file, for the error.
    """
    if method is None and sample_time is None:
        return
    if method is None or sample_time is None:
        given, missing = ("sample_time", "resample") if method is None else ("resample", "sample_time")
        raise SessionError(
            f'{given} needs {missing} as well, for example resample="linear", sample_time=0.1 '
            f"(known: {', '.join(RESAMPLING)})",
            source,
        )
    if not isinstance(method, str) or method not in RESAMPLING:
        raise SessionError(
            f"unknown resampling {method!r}{nearest(method, RESAMPLING)} (known: {', '.join(RESAMPLING)})",
            source,
        )
    number = isinstance(sample_time, int | float | np.number) and not isinstance(sample_time, bool)
    if not number or not (math.isfinite(sample_time) and sample_time > 0):
        raise SessionError(f"sample_time must be a positive number of seconds, got {sample_time!r}", source)


def time_grid(start: float, stop: float, sample_time: float, source: str | None) -> np.ndarray:
    """
    Return start, start + sample_time … up to stop, which is not passed.

    Parameters
    ----------
    start, stop : float
        Times [s].
    sample_time : float
        Time between samples [s].
    source : str, optional
        The file, for the error.

    Raises
    ------
    SessionError
        If that makes fewer than two samples or more than MAX_SAMPLES.
    """
    start, stop = float(start), float(stop)
    steps = (stop - start) / float(sample_time)
    if not steps < MAX_SAMPLES:
        raise SessionError(
            f"resampling {stop - start:.6g} s to {sample_time:g} s would make {steps:.3g} samples; at most "
            f"{MAX_SAMPLES} are made; check the times and their unit",
            source,
        )
    count = int(steps + 1e-9) + 1
    if count < 2:
        raise SessionError(
            f"a sample time of {sample_time:g} s leaves fewer than two samples of {stop - start:.6g} s",
            source,
        )
    return np.minimum(start + sample_time * np.arange(count), stop)


def method_for(name: str, method: str, rule: ColumnRule | None) -> str:
    """
    Return the way that one column is resampled.

    Parameters
    ----------
    name : str
        The session's column.
    method : str
        What was asked for.
    rule : ColumnRule, optional
        The recipe's rule, which may ask for its own.
    """
    if rule is not None and (rule.hold or rule.resample is not None):
        return "previous" if rule.hold else rule.resample
    return "previous" if name in HELD and method == "linear" else method


def interpolate(
    times: np.ndarray, values: np.ndarray, grid: np.ndarray, method: str, angle: bool = False
) -> np.ndarray:
    """
    Return values at other times.

    Parameters
    ----------
    times : numpy.ndarray, shape (N,)
        Rising times [s].
    values : numpy.ndarray, shape (N,)
        The samples.
    grid : numpy.ndarray, shape (M,)
        Rising times [s], none before the first of `times`.
    method : {"previous", "linear", "nearest"}
        The value of the sample before, on the line between neighbours, of the sample that is nearest.
    angle : bool
        True for an angle [rad], which turns the short way; in [−π, π] where the samples are.
    """
    if method == "linear":
        if not angle:
            return np.interp(grid, times, values)
        turned = np.interp(grid, times, np.unwrap(values))
        return turned if np.abs(values).max() > np.pi else np.arctan2(np.sin(turned), np.cos(turned))
    if method == "nearest":
        right = np.clip(np.searchsorted(times, grid), 1, len(times) - 1) if len(times) > 1 else 0
        left = np.maximum(right - 1, 0)
        return values[np.where(grid - times[left] <= times[right] - grid, left, right)]
    # A grid time that rounding put just before a sample belongs to that sample.
    slack = 1e-6 * (grid[1] - grid[0])
    return values[np.maximum(np.searchsorted(times, grid + slack, side="right") - 1, 0)]


def resampled_note(method: str, sample_time: float, gap: float) -> str:
    """
    Return what the metadata say of resampling.

    Parameters
    ----------
    method : str
        How.
    sample_time : float
        To which sample time [s].
    gap : float
        The longest time between two samples as logged [s].
    """
    return f"{method} at {sample_time:g} s; longest gap in the log {gap:.6g} s"


def resample_log(log: Log, method: str, sample_time: float, rules: Mapping[str, ColumnRule]) -> None:
    """
    Bring a log whose columns share their times to a uniform time axis.

    Parameters
    ----------
    log : Log
        Checked; changed in place.
    method : str
        A name from RESAMPLING.
    sample_time : float
        Time between samples [s].
    rules : mapping
        The recipe's rules by column, where there is one.
    """
    grid = time_grid(log.t[0], log.t[-1], sample_time, log.source)
    log.columns = {
        name: interpolate(log.t, values, grid, method_for(name, method, rules.get(name)), name == "yaw")
        for name, values in log.columns.items()
    }
    log.notes["resampled"] = resampled_note(method, sample_time, float(np.diff(log.t).max()))
    _warn_of_gaps(log.t, sample_time, log.source)
    log.t = grid
    log.place = lambda k: f"sample {k} after resampling"


def _warn_of_gaps(t: np.ndarray, sample_time: float, source: str | None) -> None:
    """Warn where resampling bridges a gap much longer than the log's own steps and the new ones."""
    steps = np.diff(t)
    k = int(np.argmax(steps))
    if steps[k] > 10.0 * max(float(np.median(steps)), sample_time):
        warnings.warn(
            f"{source}: resampling bridges a gap of {steps[k]:.6g} s at t = {t[k]:.6g} s; if the log was interrupted, cut "
            "the session there (session.between)",
            UserWarning,
            stacklevel=2,
        )
