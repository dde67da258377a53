"""What a recipe makes of the columns of a log: numbers in SI units, times, parts, sessions."""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any

import numpy as np
import pandas as pd

from trustlab.sessions.errors import RecipeError, SessionError
from trustlab.sessions.recipe import (
    NUMBER,
    STATES,
    BagTime,
    ColumnRule,
    MetadataRule,
    Recipe,
    Resampling,
    TableTime,
    looked_up,
    plain_key,
)
from trustlab.sessions.resampling import RawLog, Stream, require_common_times, resample, rounding
from trustlab.sessions.session import (
    ROW,
    Metadata,
    Place,
    Session,
    check_column,
    check_rising,
    keep_table,
)

# How cells without a number are written.
BLANKS = ("", "nan", "NaN", "NAN", "na", "NA", "n/a", "N/A", "null", "NULL", "none", "None", "-")


@dataclass(frozen=True)
class Table:
    """
    Rows as a file has them: a column for each rule, by the name that the session gives it.

    `frame` holds numbers or texts, times in its column "t"; `place(row)` says where a row stands.
    """

    frame: pd.DataFrame
    place: Place
    metadata: Metadata = field(default_factory=Metadata)
    notes: dict[str, object] = field(default_factory=dict)
    decimal: str = "."

    def error(self, row: int, label: str, words: object) -> SessionError:
        """Return the error about a cell."""
        return SessionError(f"{self.place(row)}, {label}: {words}")


def stream_of(
    table: Table,
    t: np.ndarray,
    rules: Sequence[ColumnRule],
    time: TableTime | BagTime,
    topic: str = "",
    gap: float = np.inf,
) -> Stream:
    """
    Return the columns of a table that rules name, in SI units, at times in seconds.

    The log is split at gaps of more than `gap` [s].
    """
    values = {rule.name: numbers(table, rule) for rule in rules}
    place = table.place
    late = np.count_nonzero(np.diff(t) < 0.0) if time.sort else 0
    if late:
        order = np.argsort(t, kind="stable")
        t, place = t[order], lambda row: table.place(order[row])
        values = {name: column[order] for name, column in values.items()}
        table.notes[f"sorted {topic}".strip()] = f"{late} samples stood after a later one"
    begin = t[0]
    # A blank is filled from neighbours in its own session: not from across a jump of time or a gap.
    steps = np.diff(t)
    back = (steps < 0.0) & bool(time.jumps)
    cuts = np.flatnonzero(back | (steps > gap)) + 1
    whole = np.ones(t.size, dtype=bool)
    for rule in rules:
        blank = np.isnan(values[rule.name]) if rule.blank else np.True_
        if blank.all():  # of a column of blanks alone its check says so
            continue
        note = f"{blank.sum()} of {t.size} cells, filled by {rule.blank!r}"
        table.notes[f"blanks of {rule.name}"] = note
        parts = zip(np.split(t, cuts), np.split(values[rule.name], cuts), strict=True)
        values[rule.name] = np.concatenate([_filled(*part, rule.blank) for part in parts])
        whole &= ~np.isnan(values[rule.name])
    if not whole.all():
        rows = np.flatnonzero(whole)
        if not rows.size:
            raise SessionError("no row has a value, or blanks to be filled, in every column")
        if np.count_nonzero(np.diff(t[rows]) < 0.0) < np.count_nonzero(back):
            raise SessionError(
                "without the rows whose blanks have no neighbour in their session, time does not "
                "run back where the next begins; fill these cells in the log"
            )
        cut = f"{t.size - rows.size} of {t.size}, where blanks have no neighbour"
        table.notes["rows cut"] = cut
        of_all = place
        t, place = t[rows], lambda row: of_all(rows[row])
        values = {name: column[rows] for name, column in values.items()}
    for rule in rules:
        column = rule.convert(values[rule.name])
        values[rule.name] = check_column(rule.name, column, t, place)
    frame = pd.DataFrame(values, index=pd.Index(t, copy=False), copy=False)
    return Stream(frame, place, topic, all(rule.hold for rule in rules), begin)


def _filled(t: np.ndarray, values: np.ndarray, way: str) -> np.ndarray:
    """Return values whose blanks hold the one before, or lie on a line between neighbours."""
    blank = np.isnan(values)
    if way == "hold" or blank.all():
        return pd.Series(values).ffill().to_numpy()
    filled = values.copy()
    filled[blank] = np.interp(t[blank], t[~blank], values[~blank], left=np.nan, right=np.nan)
    return filled


# --- cells to numbers ---------------------------------------------------------------------------


def numbers(table: Table, rule: ColumnRule | None = None) -> np.ndarray:
    """Return the numbers of a column, or of times where there is no rule; NaN for blank cells."""
    values = table.frame[rule.name if rule else "t"]
    label = rule.label if rule else "column t"
    mapped = rule if rule and rule.map else None
    kind = values.dtype.kind
    if mapped is None:
        if kind in "iufb":
            if not isinstance(values.dtype, np.dtype):  # a column of pandas' own, with a mask
                return values.to_numpy(dtype=float, na_value=np.nan).copy()
            # Large integers stay exact until times are counted from the first of them.
            return np.asarray(values.array, dtype=None if kind == "i" else float)
        if kind in "mMc":
            hint = 'write seconds, or set [time] unit = "iso" in a recipe'
            hint = "write seconds, its .dt.total_seconds()" if kind == "m" else hint
            raise table.error(0, label, f"holds {values.dtype}, not numbers; {hint}")
    cells = values.map(str, na_action="ignore") if values.dtype == object else values
    codes, words = pd.factorize(cells)
    known = np.full(len(words) + 1, np.nan)  # the last is for cells that are missing
    for k, word in enumerate(words):
        try:
            known[k] = _number(word, mapped, table.decimal)
        except ValueError as error:
            raise table.error(int(np.argmax(codes == k)), label, error) from None
    return known[codes]


def _number(cell: object, mapped: ColumnRule | None, decimal: str) -> float:
    """Return the number of a cell as it is written, or by the map of a rule."""
    written = str(cell).strip()
    blank = written in BLANKS
    if mapped and (plain_key(written) in mapped.map or not (blank and mapped.blank)):
        return looked_up(mapped.map, cell)
    if blank:
        return math.nan
    # With a decimal comma a point has no meaning: "!" makes such a number fail.
    text = written if decimal == "." else written.replace(".", "!").replace(",", ".")
    if NUMBER.fullmatch(text):
        return float(text)
    remedy = (
        'correct it, or turn words into numbers with a recipe\'s map ([time] unit = "iso" or '
        '"clock" reads dates)'
    )
    if decimal == "." and re.fullmatch(r"[+-]?\d+,\d+", written):
        remedy = 'read the file with decimal=",", or set it in a recipe'
    raise ValueError(f"{written[:60]!r} is not a number; {remedy}")


# --- times --------------------------------------------------------------------------------------


def times_of(table: Table, time: TableTime) -> np.ndarray:
    """Return the times of a table's rows in seconds."""
    ways = {"iso": _dates, "clock": _times_of_day}
    raw = ways.get(time.unit, numbers)(table)
    blank = np.isnan(raw)
    if blank.any():
        raise table.error(int(np.argmax(blank)), "column t", "is blank; every row needs a time")
    if table.frame["t"].dtype == np.float32:
        digit, steps = np.spacing(np.float32(np.abs(raw).max())), np.abs(np.diff(raw))
        if 0.0 in steps and steps[steps > 0.0].min(initial=np.inf) <= digit:
            fault = f"32-bit floats know times about {raw[0]:g} to {digit:g}: write 64-bit ones"
            raise table.error(int(np.argmin(steps)) + 1, "column t", f"repeats; {fault}")
    if time.from_zero and np.isfinite(raw[0]):
        table.notes["start_time"] = float(time.seconds(raw[0].item()))
        raw = raw - raw[0]  # before the conversion to float, which would round large integers
    with np.errstate(over="ignore"):
        return np.asarray(time.seconds(raw), dtype=float)


def _dates(table: Table) -> np.ndarray:
    """Return dates as whole nanoseconds since 1970; UTC without a time zone."""
    texts = table.frame["t"]
    if texts.dtype.kind != "M":
        texts = texts.astype("str").str.strip().str.replace(",", ".")
        zoned = texts.str.contains(r"[zZ]$|:.*[+-]\d\d")
        _check_times(table, zoned != zoned.iloc[0], "the first: all have a time zone, or none")
    stamps = pd.to_datetime(texts, format="ISO8601", utc=True, errors="coerce")
    known = stamps.dt.year.between(1700, 2200)  # what nanoseconds in 64 bits can hold
    _check_times(table, ~known, "2026-03-01T12:00:00; or give seconds")
    return stamps.astype("datetime64[ns, UTC]").astype("int64").to_numpy()


def _times_of_day(table: Table) -> np.ndarray:
    """Return times of the day as seconds since the first midnight."""
    pattern = r"^\s*(\d{1,2}):([0-5]\d):([0-5]\d(?:[.,]\d{1,12})?)\s*$"
    parts = table.frame["t"].astype("str").str.extract(pattern, flags=re.ASCII)
    _check_times(table, parts[0].isna(), "12:00:00.5")
    parts[2] = parts[2].str.replace(",", ".")
    t = parts.astype(float).to_numpy() @ [3600.0, 60.0, 1.0]
    # Half a day back is the day after.
    days = np.cumsum(np.diff(t, prepend=t[:1]) < -43200.0)
    if days[-1]:
        table.notes["midnights"] = f"{days[-1]} passed; times count on"
    return t + 86400.0 * days


def _check_times(table: Table, bad: pd.Series, example: str) -> None:
    if bad.any():
        row = int(np.argmax(bad))
        cell = str(table.frame["t"].iloc[row])[:60]
        raise table.error(row, "column t", f"{cell!r} is not a time such as {example}")


# --- parts of a log -----------------------------------------------------------------------------


def parts_of(log: RawLog, recipe: Recipe, resampling: Resampling | None) -> list[RawLog]:
    """Return the parts of a log that make a session each: all of it, or what the recipe splits."""
    time, gap = recipe.time, recipe.gap
    streams = log.streams
    if time.repeated:
        streams = [_merged(stream, time.repeated, log.notes) for stream in streams]
    parts, reasons = [streams], []
    if time.jumps:
        reasons.append("where time runs back")
        frame = streams[0].frame
        back = np.diff(frame.index, prepend=-np.inf) < 0.0
        parts = [[streams[0].of(part)] for _, part in frame.groupby(np.cumsum(back))]
    if np.isfinite(gap):
        reasons.append(f"at gaps of more than {gap:g} s")
        parts = [part for each in parts for part in _between_gaps(each, gap)]
    if not reasons:
        return [replace(log, streams=streams)]
    sample_time = resampling.sample_time if resampling else 0.0
    least = sample_time - rounding(log, sample_time)
    # Each topic needs a sample, and one of them two: one sample alone has no sample time.
    whole = [
        part
        for part in parts
        if all(stream.t.size for stream in part) and max(np.ptp(each.t) for each in part) > least
    ]
    split = f"split {' and '.join(reasons)}"
    if not whole:
        raise SessionError(f"{split}, no part has two samples, a sample time apart")
    words = f"of {len(whole)}, {split}; {len(parts) - len(whole)} too short"
    return [
        replace(
            log,
            streams=part,
            notes=log.notes | {"part": k, "split": f"part {k} (from 0) {words}"},
        )
        for k, part in enumerate(whole)
    ]


def _merged(stream: Stream, rule: str, notes: dict) -> Stream:
    """Merge samples that share a time: first, last, or mean (of states and angles the last)."""
    groups = np.cumsum(np.diff(stream.t, prepend=-np.inf) != 0.0)
    if groups[-1] == groups.size:
        return stream
    whole = (*STATES, "yaw") if rule == "mean" else ()
    own = dict.fromkeys(whole, "last") | {"step_distance": "sum"}  # since the sample before
    merged = stream.frame.groupby(groups).agg({n: own.get(n, rule) for n in stream.frame})
    merged.index = stream.frame.index[np.flatnonzero(np.diff(groups, prepend=0))]
    label = f"repeated times {stream.topic}".strip()
    notes[label] = f"{groups.size - groups[-1]} of {groups.size} samples merged by {rule!r}"
    return stream.of(merged)


def _between_gaps(streams: list[Stream], gap: float) -> list[list[Stream]]:
    """Return the streams between gaps [s] of all streams whose values do not hold."""
    for stream in streams:
        check_rising(stream.t, stream.place)
    bounding = [stream for stream in streams if not stream.holds] or streams[:1]
    times = np.unique(np.concatenate([stream.t for stream in bounding]))
    ends = times[1:][np.diff(times) > gap]
    spans = pairwise([-np.inf, *ends, np.inf])
    return [[_within(stream, *span) for stream in streams] for span in spans]


def _within(stream: Stream, start: float, stop: float) -> Stream:
    """Return the samples with start ≤ t < stop, and the one that holds at the start."""
    t = stream.t
    first, end = np.searchsorted(t, [start, stop])
    held = stream.holds and first > 0 and not (first < end and t[first] == start)
    part = stream.frame.iloc[first - held : end]
    return stream.of(part.set_axis(np.maximum(part.index, start)) if held else part)


# --- sessions -----------------------------------------------------------------------------------


def session_of(
    log: RawLog,
    recipe: Recipe,
    values: Mapping[str, Any],
    selection: Sequence[str],
    resampling: Resampling | None,
) -> Session:
    """Return the session of a log; `values` are those of `derived_values`."""
    place = log.streams[0].place
    if resampling is not None:
        for stream in log.streams:
            check_rising(stream.t, stream.place)
        frame, place = resample(log, resampling, recipe.columns), ROW
    else:
        require_common_times(log)
        frame = pd.concat([stream.frame for stream in log.streams], axis=1)
    for rule in rules_of(recipe, selection):
        if rule.needs:
            frame[rule.name] = _computed(rule, frame)
        elif rule.kind in ("value", "from"):
            frame[rule.name] = _constant(rule, values)
    entries = {name: values[name] for name in recipe.metadata}
    metadata = log.metadata.changed(**log.notes | entries, source=log.source)
    session = keep_table(frame[list(selection)].rename_axis(index="t"), metadata, place)
    # As in `Session.between`: fits must know of means that began before (by half a sample or more).
    if "performance_window" in metadata.more and any(
        log.notes.get("part") or stream.begin < session.t[0] - session.sample_time / 2
        for stream in log.streams
        if {"p_r", "p_h"} & {*stream.frame}
    ):
        return session.with_metadata(performance_cut=True)
    return session


def rules_of(recipe: Recipe, names: Sequence[str]) -> list[ColumnRule]:
    """Return the rules of columns, after those of the columns that these need."""
    needs = [need for name in names for need in recipe.columns[name].needs]
    return [recipe.columns[name] for name in dict.fromkeys([*needs, *names])]


def _computed(rule: ColumnRule, frame: pd.DataFrame) -> np.ndarray:
    """Return the distance between two positions, or from the sample before."""
    places = frame[list(rule.needs)].to_numpy().T
    with np.errstate(over="ignore"):  # the session refuses what is not finite
        if rule.kind == "distance":
            axes = len(rule.axes)
            return np.linalg.norm(places[:axes] - places[axes:], axis=0)
        steps = np.linalg.norm(np.diff(places), axis=0)
    # Nothing stands before the first sample: it gets the second one's distance.
    return np.r_[steps[:1], steps]


def derived_values(recipe: Recipe, known: Mapping[str, object]) -> dict[str, object]:
    """Return what is known of a session (path fields, header cells) with the recipe's metadata."""
    values = dict(known)
    for name, rule in recipe.metadata.items():
        if not rule.origin:
            values[name] = rule.value
        elif name not in known or rule.origin in known:
            values[name] = _derived(rule, values, f"metadata {name!r} (from {rule.origin})")
    return values


def _derived(rule: MetadataRule | ColumnRule, values: Mapping[str, object], where: str) -> Any:
    """Return what comes from a value known already."""
    value = values.get(rule.origin, "")
    if value == "":
        listing = ", ".join(values) or "nothing"
        remedy = "fields come from a path that fits [files] pattern, or from read_frame(…, name=…)"
        fault = f"there is no {rule.origin}, or it is empty (known: {listing})"
        raise SessionError(f"{where}: {fault}; {remedy}")
    if rule.map is None:
        return value
    try:
        return looked_up(rule.map, value, getattr(rule, "default", None))
    except ValueError as error:
        raise SessionError(f"{where}: {error}") from None


def _constant(rule: ColumnRule, values: Mapping[str, object]) -> float:
    """Return the number of a column that is the same throughout."""
    if rule.kind == "value":
        return float(rule.convert(rule.value))
    where = f"column {rule.name!r} (from {rule.origin})"
    value = _derived(rule, values, where)
    if not isinstance(value, int | float):
        raise RecipeError(f"{where}: {value!r} is not a number; give it a map")
    return float(rule.convert(value))
