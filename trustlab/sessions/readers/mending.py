"""What a recipe's rules mend in a raw log, each counted in the log's notes: blanks, repeated times, gaps to split at."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from itertools import pairwise

import numpy as np

from trustlab.sessions.resampling import STATES, RawLog, Stream

Place = Callable[[int], str]


def fill_blanks(
    blanks: Sequence[tuple[str, str]], raw: dict[str, np.ndarray], place: Place
) -> tuple[dict[str, np.ndarray], Place, dict[str, object]]:
    """Return columns with their blanks filled, cut to the rows that the rules reach, where these rows stand, and notes."""
    size = len(raw["t"])
    notes: dict[str, object] = {}
    raw, first, stop = dict(raw), 0, size
    for name, rule in blanks:
        known = np.flatnonzero(~np.isnan(raw[name]))
        if not known.size:  # the check of the column says so
            continue
        first = max(first, int(known[0]))
        if rule == "linear":  # which reaches no further than the last value, as `hold` does
            stop = min(stop, int(known[-1]) + 1)
            raw[name] = np.interp(raw["t"], raw["t"][known], raw[name][known])
        else:
            raw[name] = raw[name][known[np.searchsorted(known, np.arange(size), side="right") - 1]]
        notes[f"blanks of {name}"] = f"{size - known.size} of {size} cells, filled by {rule!r}"
    if first or stop < size:
        notes["rows cut"] = (
            f"{first} at the start and {size - max(stop, first)} at the end, where blanks have no neighbour"
        )
    return {name: values[first:stop] for name, values in raw.items()}, lambda k: place(first + k), notes


def merge_repeats(log: RawLog, rule: str) -> None:
    """Keep one sample of those that share a time: the first, the last, or their mean (of states and angles the last)."""
    for stream in log.streams:
        new = np.diff(stream.t, prepend=-np.inf) != 0.0
        if new.all():
            continue
        first = np.flatnonzero(new)
        last = np.append(first[1:], stream.t.size) - 1
        for name, values in stream.columns.items():
            if rule == "mean" and name not in (*STATES, "yaw"):
                stream.columns[name] = np.add.reduceat(values, first) / (last - first + 1)
            else:
                stream.columns[name] = values[first if rule == "first" else last]
        stream.t, stream.place = stream.t[first], partial(_moved, stream.place, first)
        label = f"repeated times {stream.topic}".strip()
        log.notes[label] = f"{new.size - first.size} of {new.size} samples merged by {rule!r}"


def _moved(place: Place, rows: np.ndarray, k: int) -> str:
    return place(int(rows[k]))


def split_at_gaps(log: RawLog, gap: float) -> list[RawLog]:
    """Return the parts of a log between gaps [s] in which no stream has a sample, but those that are held."""
    times = np.unique(np.concatenate([stream.t for stream in log.streams if not stream.held] or [log.streams[0].t]))
    starts = [-np.inf, *times[1:][np.diff(times) > gap], np.inf]
    parts = []
    for start, stop in pairwise(starts):
        streams = [_between(stream, start, stop) for stream in log.streams]
        if min(stream.t.size for stream in streams) > (1 if len(streams) == 1 else 0):
            parts.append(replace(log, streams=streams, notes=dict(log.notes)))
    lost = len(starts) - 1 - len(parts)
    for k, part in enumerate(parts):
        part.notes["part"] = k
        part.notes["split"] = (
            f"part {k} (from 0) of {len(parts)}, between gaps of more than {gap:g} s; {lost} too short"
        )
    return parts


def _between(stream: Stream, start: float, stop: float) -> Stream:
    first, end = (int(np.searchsorted(stream.t, time)) for time in (start, stop))
    t = stream.t
    if stream.held and first:  # what was published before holds at the start
        first, t = first - 1, np.maximum(t, start)
    columns = {name: values[first:end] for name, values in stream.columns.items()}
    return replace(stream, t=t[first:end], columns=columns, place=lambda k: stream.place(first + k))
