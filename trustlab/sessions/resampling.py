"""Streams of samples that share their times, and how they come to one uniform time axis."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
import pandas as pd

from trustlab.models.checks import warn
from trustlab.sessions.errors import RecipeError, SessionError
from trustlab.sessions.recipe import STATES, ColumnRule, Resampling
from trustlab.sessions.session import ROW, Metadata, Place

# The longest log that is made by resampling (five and a half hours at 1 kHz).
MAX_SAMPLES = 20_000_000


@dataclass(frozen=True)
class Stream:
    """
    Samples that share their times: the columns of a table, or what is read from one topic of a bag.

    `frame` has them in SI units, indexed by time [s]; `place(k)` says where sample k stands in the
    file. `holds` is True where the last sample lasts until the log ends; `begin` is the time of the
    first sample in the file [s], whatever was cut since.
    """

    frame: pd.DataFrame
    place: Place = ROW
    topic: str = ""
    holds: bool = False
    begin: float = 0.0

    @property
    def t(self) -> np.ndarray:
        """Time [s], shape (N,)."""
        return self.frame.index.to_numpy()

    def of(self, frame: pd.DataFrame) -> "Stream":
        """Return the stream of other samples, which are no longer those of the file's rows."""
        place = f"topic {self.topic!r}, sample {{}}".format if self.topic else "sample {}".format
        return replace(self, frame=frame, place=place)


@dataclass(frozen=True)
class RawLog:
    """
    The streams of one file.

    `metadata` is what the file says about itself, and `notes` are what reading adds to it
    (start_time, resampled, what was filled, merged or split).
    """

    source: str
    streams: list[Stream]
    metadata: Metadata = field(default_factory=Metadata)
    notes: dict[str, object] = field(default_factory=dict)


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


def rounding(log: RawLog, sample_time: float) -> float:
    """Return how far times may be off [s]: dates in seconds are rounded to 0.24 µs."""
    latest = log.notes.get("start_time", 0.0) + max(stream.t[-1] for stream in log.streams)
    return np.clip(2.0 * np.spacing(latest), 1e-6 * sample_time, 0.5 * sample_time)


def resample(log: RawLog, resampling: Resampling, rules: Mapping[str, ColumnRule]) -> pd.DataFrame:
    """Return the columns of a checked log on a uniform time axis; note how."""
    # Where every stream has samples: from the last first sample to the first last one. A stream
    # that is held has a value beyond its last sample, so that it does not end this interval unless
    # all are held.
    bounding = [stream for stream in log.streams if not stream.holds] or [
        max(log.streams, key=lambda stream: stream.t[-1])
    ]
    method, sample_time = resampling.method, resampling.sample_time
    late = max(log.streams, key=lambda stream: stream.t[0])
    early = min(bounding, key=lambda stream: stream.t[-1])
    start, stop = late.t[0], early.t[-1]
    if len(log.streams) > 1 and stop <= start:
        fault = f"{early.topic!r} ends {start - stop:.6g} s before {late.topic!r} starts"
        hint = "set hold = true for a topic whose last message holds to the end"
        raise SessionError(f"topics do not overlap: {fault} ({hint})")
    # A grid time that rounding put just before a sample belongs to that sample.
    slack = rounding(log, sample_time)
    grid = _time_grid(float(start), float(stop), sample_time, slack)
    columns = {
        name: _interpolate(stream, name, grid, slack, _method(name, method, rules.get(name)))
        for stream in log.streams
        for name in stream.frame
    }
    gaps = [np.diff(stream.t).max(initial=0.0) for stream in bounding]
    log.notes["resampled"] = (
        f"{method} at {sample_time:g} s; longest gap in the log {max(gaps):.6g} s"
    )
    for stream in bounding:
        _warn_of_gap(stream, sample_time, log.source)
    return pd.DataFrame(columns, index=grid)


def _time_grid(start: float, stop: float, sample_time: float, slack: float) -> np.ndarray:
    """Return start, start + sample_time … up to stop, which is not passed."""
    steps = (stop - start + slack) / sample_time  # rounding must not cost the last sample
    if not 1.0 <= steps < MAX_SAMPLES:
        raise SessionError(
            f"resampling {stop - start:.6g} s to {sample_time:g} s would make {steps + 1.0:.3g} "
            f"samples, but 2 to {MAX_SAMPLES:,} are needed; check the times and their unit"
        )
    return np.minimum(start + sample_time * np.arange(int(steps) + 1), stop)


def _method(name: str, method: str, rule: ColumnRule | None) -> str:
    """Return the method for one column; the recipe's rule comes before what was asked for."""
    if rule is not None and (rule.hold or rule.resample):
        return rule.resample or "previous"
    return "previous" if name in STATES and method == "linear" else method


def _interpolate(
    stream: Stream, name: str, grid: np.ndarray, slack: float, method: str
) -> np.ndarray:
    """Return a column at the times of the grid; `slack` [s] is rounding."""
    times, values = stream.t, stream.frame[name].to_numpy()
    if name == "step_distance":  # since the sample before: what adds up is the way so far
        way = stream.of(pd.DataFrame({"way": values.cumsum()}, index=times))
        steps = np.diff(_interpolate(way, "way", grid, slack, method)).clip(min=0.0)
        return np.r_[steps[:1], steps]
    if method == "linear":
        if name != "yaw":
            return np.interp(grid, times, values)
        # An angle turns the short way, and stays in [−π, π] if the samples are.
        turned = np.interp(grid, times, np.unwrap(values))
        return (
            turned if np.abs(values).max() > np.pi else np.arctan2(np.sin(turned), np.cos(turned))
        )
    before = np.maximum(np.searchsorted(times, grid + slack, side="right") - 1, 0)
    if method == "previous":
        return values[before]
    right = np.clip(np.searchsorted(times, grid), min(1, len(times) - 1), len(times) - 1)
    left = np.maximum(right - 1, 0)
    return values[np.where(grid - times[left] <= times[right] - grid, left, right)]


def _warn_of_gap(stream: Stream, sample_time: float, source: str) -> None:
    """Warn where resampling bridges a gap much longer than the log's own steps and the new ones."""
    t, steps = stream.t, np.diff(stream.t)
    k = int(np.argmax(steps))
    if steps[k] > 10.0 * max(float(np.median(steps)), sample_time):
        where = f"{source} {stream.topic}".strip()
        fault = f"{where}: resampling bridges a gap of {steps[k]:.6g} s at t = {t[k]:.6g} s"
        remedy = "if the log was interrupted, cut the session there (session.between)"
        warn(f"{fault}; {remedy}")
