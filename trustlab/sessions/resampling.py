"""Raw logs, as readers make them, and how their streams come to one uniform time axis."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from trustlab.models.checks import warn
from trustlab.sessions.errors import RecipeError, SessionError
from trustlab.sessions.metadata import Metadata
from trustlab.sessions.recipe import STATES, ColumnRule, Resampling

# The longest log that is read or made by resampling (five and a half hours at 1 kHz).
MAX_SAMPLES = 20_000_000


@dataclass
class Stream:
    """
    Samples that share their times: the columns of a table, or what is read from one topic of a bag.

    `t` [s] and every array of `columns` have shape (N,), in SI units; `place(k)` says where sample
    k stands in the file. `holds` is True where the last sample lasts until the log ends; `remedy`
    is what to do about times that do not rise, beside sorting and splitting the log.
    """

    t: np.ndarray
    columns: dict[str, np.ndarray]
    place: Callable[[int], str]
    topic: str = ""
    holds: bool = False
    remedy: str = ""


@dataclass
class RawLog:
    """
    The streams of one file, not yet checked.

    `metadata` is what the file says about itself, `fault` why reading stopped after the samples
    there are, and `notes` are metadata that reading adds (start_time, resampled). `digests` are
    those of the columns as they were written.
    """

    source: str
    streams: list[Stream]
    metadata: Metadata | None = None
    fault: SessionError | None = None
    notes: dict[str, object] = field(default_factory=dict)
    digests: Mapping[str, str] = field(default_factory=dict)


def require_common_times(log: RawLog) -> None:
    """Raise where the streams of a log have different times: only resampling joins them."""
    first = log.streams[0]
    for stream in log.streams[1:]:
        if not np.array_equal(stream.t, first.t):
            fault = f"topics {first.topic!r} and {stream.topic!r} have stamps of their own"
            how = (
                '[resampling] in the recipe, or read_session(..., resample="previous", '
                "sample_time=0.1)"
            )
            raise RecipeError(f"{fault}; name how to bring them together: {how}")


def resample(
    log: RawLog, resampling: Resampling, rules: Mapping[str, ColumnRule]
) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Return a uniform time axis and the columns of a checked log on it; note how."""
    # Where every stream has samples: from the last first sample to the first last one. A stream
    # that is held has a value beyond its last sample, so that it does not end this interval unless
    # all are held.
    bounding = [stream for stream in log.streams if not stream.holds]
    method, sample_time = resampling.method, resampling.sample_time
    start = max(stream.t[0] for stream in log.streams)
    stop = (
        min(stream.t[-1] for stream in bounding) if bounding else max(s.t[-1] for s in log.streams)
    )
    if len(log.streams) > 1 and stop <= start:
        last = max(log.streams, key=lambda stream: stream.t[0])
        early = min(bounding or log.streams, key=lambda stream: stream.t[-1])
        fault = f"{early.topic!r} ends {start - stop:.6g} s before {last.topic!r} starts"
        hint = "set hold = true for a topic whose last message holds to the end"
        raise SessionError(f"topics do not overlap: {fault} ({hint})")
    grid = _time_grid(start, stop, sample_time)
    # A grid time that rounding put just before a sample belongs to that sample; dates in seconds
    # are rounded to 0.24 µs.
    slack = np.clip(
        2.0 * np.spacing(log.notes.get("start_time", 0.0) + stop),
        1e-6 * sample_time,
        0.5 * sample_time,
    )
    columns = {
        name: _interpolate(stream, name, grid, slack, _method(name, method, rules.get(name)))
        for stream in log.streams
        for name in stream.columns
    }
    gap = max(
        (float(np.diff(stream.t).max()) for stream in bounding if stream.t.size > 1), default=0.0
    )
    log.notes["resampled"] = f"{method} at {sample_time:g} s; longest gap in the log {gap:.6g} s"
    if len(log.streams) == 1:
        _warn_of_gap(log.streams[0].t, sample_time, log.source)
    return grid, columns


def _time_grid(start: float, stop: float, sample_time: float) -> np.ndarray:
    """Return start, start + sample_time … up to stop, which is not passed."""
    start, stop = float(start), float(stop)
    steps = (stop - start) / float(sample_time)
    if not steps < MAX_SAMPLES:
        fault = (
            f"resampling {stop - start:.6g} s to {sample_time:g} s would make {steps:.3g} samples"
        )
        raise SessionError(
            f"{fault}; at most {MAX_SAMPLES} are made; check the times and their unit"
        )
    count = int(steps + 1e-9) + 1  # rounding must not cost the last sample
    if count < 2:
        raise SessionError(
            f"at {sample_time:g} s fewer than two samples are left of {stop - start:.6g} s"
        )
    return np.minimum(start + sample_time * np.arange(count), stop)


def _method(name: str, method: str, rule: ColumnRule | None) -> str:
    """Return the method for one column; the recipe's rule comes before what was asked for."""
    if rule is not None and (rule.hold or rule.resample):
        return rule.resample or "previous"
    return "previous" if name in STATES and method == "linear" else method


def _interpolate(
    stream: Stream, name: str, grid: np.ndarray, slack: float, method: str
) -> np.ndarray:
    """Return a column at the times of the grid; `slack` [s] is rounding."""
    times, values = stream.t, stream.columns[name]
    if method == "linear":
        if name != "yaw":
            return np.interp(grid, times, values)
        # An angle turns the short way, and stays in [−π, π] if the samples are.
        turned = np.interp(grid, times, np.unwrap(values))
        return (
            turned if np.abs(values).max() > np.pi else np.arctan2(np.sin(turned), np.cos(turned))
        )
    if method == "nearest":
        right = np.clip(np.searchsorted(times, grid), 1, len(times) - 1) if len(times) > 1 else 0
        left = np.maximum(right - 1, 0)
        return values[np.where(grid - times[left] <= times[right] - grid, left, right)]
    return values[np.maximum(np.searchsorted(times, grid + slack, side="right") - 1, 0)]


def _warn_of_gap(t: np.ndarray, sample_time: float, source: str) -> None:
    """Warn where resampling bridges a gap much longer than the log's own steps and the new ones."""
    steps = np.diff(t)
    k = int(np.argmax(steps))
    if steps[k] > 10.0 * max(float(np.median(steps)), sample_time):
        fault = f"{source}: resampling bridges a gap of {steps[k]:.6g} s at t = {t[k]:.6g} s"
        remedy = "if the log was interrupted, cut the session there (session.between)"
        warn(f"{fault}; {remedy}")
