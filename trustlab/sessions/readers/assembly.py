"""From a raw log to a session: checks, resampling, constant and computed columns, metadata."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from trustlab.models.checks import warn
from trustlab.sessions.errors import RecipeError, SessionError, source_named
from trustlab.sessions.metadata import Metadata, digest
from trustlab.sessions.readers.doubts import warn_of_doubts
from trustlab.sessions.readers.index import SessionIndex
from trustlab.sessions.recipe import (
    STATES,
    ColumnRule,
    MetadataRule,
    Recipe,
    Resampling,
    mapped,
    plain_key,
)
from trustlab.sessions.resampling import RawLog, Stream, require_common_times, resample
from trustlab.sessions.session import Session, check_column, check_rising, check_time, keep_table

Place = Callable[[int], str]


def fill_blanks(
    blanks: Sequence[tuple[str, str]], raw: dict[str, np.ndarray], place: Place
) -> tuple[dict[str, np.ndarray], Place, dict[str, object]]:
    """Return columns with blanks filled, cut to the rows that can be, their places, and notes."""
    size = len(raw["t"])
    notes: dict[str, object] = {}
    first = 0
    stop = size
    rows = np.arange(size)
    for name, rule in blanks:
        known = np.flatnonzero(~np.isnan(raw[name]))
        if not known.size:  # the check of the column says so
            continue
        first = max(first, int(known[0]))
        if rule == "linear":  # which reaches no further than the last value, as `hold` does
            stop = min(stop, int(known[-1]) + 1)
            raw[name] = np.interp(raw["t"], raw["t"][known], raw[name][known])
        else:
            before = np.searchsorted(known, rows, side="right") - 1
            raw[name] = raw[name][known[before]]
        notes[f"blanks of {name}"] = f"{size - known.size} of {size} cells, filled by {rule!r}"
    if first or stop < size:
        last = size - max(stop, first)
        notes["rows cut"] = (
            f"{first} at the start and {last} at the end, where blanks have no neighbour"
        )
    return (
        {name: values[first:stop] for name, values in raw.items()},
        lambda k: place(first + k),
        notes,
    )


def merge_repeats(log: RawLog, rule: str) -> None:
    """Merge samples that share a time: first, last, or mean (of states and angles the last)."""
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
        stream.t = stream.t[first]
        stream.place = partial(_place_of_row, stream.place, first)
        label = f"repeated times {stream.topic}".strip()
        log.notes[label] = f"{new.size - first.size} of {new.size} samples merged by {rule!r}"


def _place_of_row(place: Place, rows: np.ndarray, k: int) -> str:
    return place(int(rows[k]))


def split_at_gaps(log: RawLog, gap: float) -> list[RawLog]:
    """Return the parts of a log between gaps [s] of all streams whose values do not hold."""
    bounding = [stream for stream in log.streams if not stream.holds] or log.streams[:1]
    times = np.unique(np.concatenate([stream.t for stream in bounding]))
    starts = [-np.inf, *times[1:][np.diff(times) > gap], np.inf]
    least = 2 if len(log.streams) == 1 else 1
    parts = []
    for start, stop in pairwise(starts):
        streams = [_between(stream, start, stop) for stream in log.streams]
        if min(stream.t.size for stream in streams) >= least:
            parts.append(replace(log, streams=streams, notes=dict(log.notes)))
    lost = len(starts) - 1 - len(parts)
    for k, part in enumerate(parts):
        part.notes["part"] = k
        number = f"part {k} (from 0) of {len(parts)}"
        part.notes["split"] = f"{number}, between gaps of more than {gap:g} s; {lost} too short"
    return parts


def _between(stream: Stream, start: float, stop: float) -> Stream:
    first = int(np.searchsorted(stream.t, start))
    end = int(np.searchsorted(stream.t, stop))
    t = stream.t
    if stream.holds and first:  # what was published before holds at the start
        first -= 1
        t = np.maximum(t, start)
    columns = {name: values[first:end] for name, values in stream.columns.items()}
    return replace(stream, t=t[first:end], columns=columns, place=lambda k: stream.place(first + k))


def recipe_values(
    recipe: Recipe | None, path: Path | None, index: SessionIndex | None
) -> dict[str, object]:
    """Return path fields, header cells and the recipe's metadata of one session."""
    if recipe is None:
        return {}
    match = recipe.pattern.match(path) if recipe.pattern and path else None
    origins = [rule.origin for rule in recipe.metadata.values()]
    origins += [rule.origin for rule in recipe.columns.values() if rule.kind == "from"]
    if recipe.pattern and match is None and any(origins):
        remedy = (
            "rename the file or its folder, or take nothing from the path in [metadata] and "
            "[columns]"
        )
        raise SessionError(
            f"the path does not fit the recipe's pattern {recipe.pattern.text!r}; {remedy}"
        )
    values = dict(match.fields) if match else {}
    if index is not None and any(str(origin).startswith("header.") for origin in origins):
        values |= {f"header.{name}": value for name, value in index.row(match, str(path)).items()}
    for name, rule in recipe.metadata.items():
        where = f"metadata {name!r} (from {rule.origin})"
        values[name] = _derived(rule, values, where) if rule.origin else rule.value
    return values


def _derived(rule: MetadataRule, values: Mapping[str, object], where: str) -> object:
    """Return an entry of the metadata that comes from a value known already."""
    value = _known(rule.origin, values, where)
    if rule.map is None:
        return value
    if rule.default is not None and plain_key(value) not in rule.map:
        return rule.default
    return mapped(rule.map, value, where)


def _known(origin: str, values: Mapping[str, object], where: str) -> object:
    if origin not in values:
        columns = [name for name in values if name.startswith("header.")]
        raise SessionError(f"{where}: there is no {origin} (known: {', '.join(columns or values)})")
    if values[origin] == "":
        raise SessionError(f"{where}: {origin} is empty in the header")
    return values[origin]


def parts_of(log: RawLog, recipe: Recipe | None) -> list[RawLog]:
    """Return the parts of a raw log that make a session each: all of it, or those between gaps."""
    with source_named(log.source):
        if recipe and recipe.time.repeated:
            merge_repeats(log, recipe.time.repeated)
        if recipe and recipe.splitting:
            _check(log, uniform=False)
            return split_at_gaps(log, recipe.splitting.gap)
    return [log]


def assemble_session(
    log: RawLog,
    recipe: Recipe | None,
    values: Mapping[str, object],
    selection: Sequence[str] | None,
    resampling: Resampling | None,
) -> Session:
    """Return the session of a raw log; `values` are those of `recipe_values`."""
    rules: Mapping[str, Any] = recipe.columns if recipe else {}
    with source_named(log.source):
        if recipe is None and log.fault is None:
            _check_digests(log)
        if resampling is None:
            require_common_times(log)
            _check(log, uniform=True)
            t = log.streams[0].t
            columns = {
                name: each for stream in log.streams for name, each in stream.columns.items()
            }
        else:
            _check(log, uniform=False)
            t, columns = resample(log, resampling, rules)
        for name, rule in rules.items():
            if rule.kind == "value":
                columns[name] = np.full(t.size, rule.convert(rule.value))
            elif rule.kind == "from":
                columns[name] = np.full(t.size, _constant(rule, values))
        for name, rule in rules.items():
            if rule.above is not None and name in columns:
                count = int(columns[name].sum())
                log.notes[f"{name} above {rule.above:g}"] = f"{count} of {t.size} samples"
                if count in (0, t.size):
                    same = f"column {name} is {count and 1} throughout"
                    warn(f"{log.source}: {same}: {rule.above:g} divides no sample from the others")
            if rule.needs and (selection is None or name in selection):
                with np.errstate(over="ignore"):  # the session refuses what is not finite
                    columns[name] = rule.compute(columns)
        names = selection or list(rules or columns)
        # Arrays that belong to others (a frame, a mapped file, another session) are read-only, and
        # those alone are copied.
        table = {name: _writable(columns[name]) for name in names}
        frame = pd.DataFrame(table, index=pd.Index(_writable(t), name="t"), copy=False)
        warn_of_doubts(log.source, t, table)
        return keep_table(frame, _metadata(log, recipe, values))


_writable = partial(np.require, dtype=float, requirements="CW")


def _constant(rule: ColumnRule, values: Mapping[str, object]) -> float:
    where = f"column {rule.name!r} (from {rule.origin})"
    value = _known(rule.origin, values, where)
    if rule.map is not None:
        value = mapped(rule.map, value, where)
    if not isinstance(value, int | float):
        raise RecipeError(f"{where}: {value!r} is not a number; give it a map")
    return float(rule.convert(value))


def _metadata(log: RawLog, recipe: Recipe | None, values: Mapping[str, Any]) -> Metadata:
    table = {name: values[name] for name in (recipe.metadata if recipe else ())}
    if not isinstance(table.get("synthetic", False), bool):
        raise RecipeError(f"metadata 'synthetic' must be true or false, got {table['synthetic']!r}")
    return (log.metadata or Metadata()).changed(**log.notes | table, source=log.source)


def _check_digests(log: RawLog) -> None:
    """Raise where a column is not what the file's metadata say that it was when it was written."""
    for stream in log.streams:
        for name, values in {"t": stream.t, **stream.columns}.items():
            if name in log.digests and log.digests[name] != digest(values):
                fault = (
                    f"column {name!r} is not as trustlab wrote it, so the file is damaged or "
                    "was edited"
                )
                remedy = "copy or write it again; of an edited .csv file, remove the first line"
                raise SessionError(f"{fault}; {remedy}")


def _check(log: RawLog, uniform: bool) -> None:
    """Raise the first fault: first in the file, or in time where there are several streams."""
    alone = len(log.streams) == 1
    faults: list[tuple[float, SessionError]] = []
    if log.fault is not None:
        row = log.streams[0].t.size if log.fault.row is None else log.fault.row
        faults.append((row, log.fault))
    for stream in log.streams:
        # A fault that ended reading explains irregular times and a short log, which are then not
        # worth a word.
        too_short = alone and stream.t.size < 2
        check = check_time if log.fault is None and (uniform or too_short) else check_rising
        checks = [partial(check, stream.t, stream.place, stream.remedy)]
        for name, values in stream.columns.items():
            checks.append(partial(check_column, name, values, stream.t, stream.place))
        for check in checks:
            try:
                check()
            except SessionError as error:
                row = stream.t.size if error.row is None else error.row
                position = row if alone else float(stream.t[min(row, stream.t.size - 1)])
                faults.append((position, error))
    if faults:
        raise min(faults, key=lambda fault: fault[0])[1]
