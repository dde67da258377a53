"""What a recipe makes of a log: numbers in SI units, times, parts, uniform samples, sessions."""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any

import numpy as np
import pandas as pd

from trustlab.models.checks import warn
from trustlab.sessions.errors import RecipeError, SessionError
from trustlab.sessions.recipe import (
    NUMBER,
    STATES,
    ColumnRule,
    MetadataRule,
    Recipe,
    looked_up,
    plain_key,
)
from trustlab.sessions.session import (
    ROW,
    Metadata,
    Place,
    Session,
    check_column,
    check_rising,
    keep_table,
)

# The longest log that is made by resampling (five and a half hours at 1 kHz).
MAX_SAMPLES = 20_000_000

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

    def error(self, row: int, label: str, words: object) -> SessionError:
        """Return the error about a cell."""
        return SessionError(f"{self.place(row)}, {label}: {words}")


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
        place = f"topic {self.topic!r}, " if self.topic else ""
        return replace(self, frame=frame, place=f"{place}sample {{}}".format)


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


def stream_of(
    table: Table,
    t: np.ndarray,
    rules: Sequence[ColumnRule],
    recipe: Recipe,
    topic: str = "",
) -> Stream:
    """Return the columns of a table that rules name, in SI units, at times in seconds."""
    time = recipe.time
    values = {rule.name: numbers(table, recipe, rule) for rule in rules}
    # All rows as they stand are not copied: a log may have millions.
    rows: Any = slice(None)
    late = np.count_nonzero(np.diff(t) < 0.0) if time.sort else 0
    if late:
        rows = np.argsort(t, kind="stable")
        table.notes[f"sorted {topic}".strip()] = f"{late} samples stood after a later one"
    begin, steps = t[rows][0], np.diff(t[rows])
    # A blank is filled from neighbours in its own session: not from across a jump of time or a gap.
    back = (steps < 0.0) & bool(time.jumps)
    if any(rule.blank for rule in rules):
        rows = np.arange(t.size)[rows]
        parts = np.split(rows, np.flatnonzero(back | (steps > recipe.gap)) + 1)
    for rule in rules:
        if rule.blank:
            column = pd.Series(values[rule.name], t)
            note = f"{column.isna().sum()} of {t.size} cells, filled by {rule.blank!r}"
            table.notes[f"blanks of {rule.name}"] = note
            values[rule.name] = np.full(t.size, np.nan)
            for part in parts:
                values[rule.name][part] = _filled(column.iloc[part], rule.blank)
            rows = rows[~np.isnan(values[rule.name][rows])]
    left = t[rows]
    if left.size < t.size:
        table.notes["rows cut"] = (
            f"{t.size - left.size} of {t.size}, where blanks have no neighbour"
        )
        if not left.size:
            raise SessionError("no row has a value, or blanks to be filled, in every column")
        if np.count_nonzero(np.diff(left) < 0.0) < np.count_nonzero(back):
            raise SessionError(
                "without the rows whose blanks have no neighbour in their session, time does not "
                "run back where the next begins; fill these cells in the log"
            )

    def place(k: int) -> str:
        return table.place(k if isinstance(rows, slice) else rows[k])

    columns = {
        rule.name: check_column(rule.name, rule.convert(values[rule.name][rows]), left, place)
        for rule in rules
    }
    frame = pd.DataFrame(columns, index=pd.Index(left, copy=False), copy=False)
    return Stream(frame, place, topic, all(rule.hold for rule in rules), begin)


def _filled(column: pd.Series, way: str) -> pd.Series:
    """Return a column whose blanks hold the value before, or lie on a line between neighbours."""
    return column.ffill() if way == "hold" else column.interpolate("index", limit_area="inside")


# --- cells to numbers ---------------------------------------------------------------------------


def numbers(table: Table, recipe: Recipe, rule: ColumnRule | None = None) -> np.ndarray:
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
            known[k] = _number(word, mapped, recipe.table.decimal)
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


def times_of(table: Table, recipe: Recipe) -> np.ndarray:
    """Return the times of a table's rows in seconds."""
    time = recipe.time
    ways = {"iso": _dates, "clock": _times_of_day}
    raw = ways.get(time.unit, numbers)(table, recipe)
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


def _dates(table: Table, _: Recipe) -> np.ndarray:
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


def _times_of_day(table: Table, _: Recipe) -> np.ndarray:
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


def parts_of(log: RawLog, recipe: Recipe) -> list[RawLog]:
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
    sample_time = recipe.resampling.sample_time if recipe.resampling else 0.0
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
    notes = [{"part": k, "split": f"part {k} (from 0) {words}"} for k in range(len(whole))]
    pairs = zip(whole, notes, strict=True)
    return [replace(log, streams=part, notes=log.notes | more) for part, more in pairs]


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


# --- a uniform time axis -------------------------------------------------------------------------


def require_common_times(log: RawLog) -> None:
    """Raise where the streams of a log have different times: only resampling joins them."""
    first, *others = log.streams
    for stream in others:
        if not np.array_equal(stream.t, first.t):
            raise RecipeError(
                f"topics {first.topic!r} and {stream.topic!r} have stamps of their own; name how "
                "to bring them together: [resampling] in the recipe, or "
                'read_session(..., resample="previous", sample_time=0.1)'
            )


def rounding(log: RawLog, sample_time: float) -> float:
    """Return how far times may be off [s]: dates in seconds are rounded to 0.24 µs."""
    latest = log.notes.get("start_time", 0.0) + max(stream.t[-1] for stream in log.streams)
    return np.clip(2.0 * np.spacing(latest), 1e-6 * sample_time, 0.5 * sample_time)


def resample(log: RawLog, recipe: Recipe) -> pd.DataFrame:
    """Return the columns of a log on a uniform time axis; note how, and warn of long gaps."""
    for stream in log.streams:
        check_rising(stream.t, stream.place)
    # Where every stream has samples: from the last first sample to the first last one. A stream
    # that is held has a value beyond its last sample, so that it does not end this interval unless
    # all are held.
    bounding = [stream for stream in log.streams if not stream.holds] or [
        max(log.streams, key=lambda stream: stream.t[-1])
    ]
    method, sample_time = recipe.resampling.method, recipe.resampling.sample_time
    late = max(log.streams, key=lambda stream: stream.t[0])
    early = min(bounding, key=lambda stream: stream.t[-1])
    start, stop = late.t[0], early.t[-1]
    if len(log.streams) > 1 and stop <= start:
        raise SessionError(
            f"topics do not overlap: {early.topic!r} ends {start - stop:.6g} s before "
            f"{late.topic!r} starts (set hold = true for a topic whose last message holds to the "
            "end)"
        )
    # A grid time that rounding put just before a sample belongs to that sample.
    slack = rounding(log, sample_time)
    steps = (stop - start + slack) / sample_time  # rounding must not cost the last sample
    if not 1.0 <= steps < MAX_SAMPLES:
        raise SessionError(
            f"resampling {stop - start:.6g} s to {sample_time:g} s would make {steps + 1.0:.3g} "
            f"samples, but 2 to {MAX_SAMPLES:,} are needed; check the times and their unit"
        )
    grid = np.minimum(start + sample_time * np.arange(int(steps) + 1), stop)
    columns = {}
    for stream in log.streams:
        for name, values in stream.frame.items():
            rule = recipe.columns[name]
            usual = "previous" if rule.hold or (name in STATES and method == "linear") else method
            columns[name] = _interpolate(
                name, stream.t, values.to_numpy(), grid, slack, rule.resample or usual
            )
    longest = 0.0
    for stream in bounding:
        gaps = np.diff(stream.t)
        k = int(np.argmax(gaps))
        longest = max(longest, gaps[k])
        # Much longer than the log's own steps and the new ones.
        if gaps[k] > 10.0 * max(float(np.median(gaps)), sample_time):
            where = f"{log.source} {stream.topic}".strip()
            warn(
                f"{where}: resampling bridges a gap of {gaps[k]:.6g} s at t = {stream.t[k]:.6g} s; "
                "if the log was interrupted, cut the session there (session.between)"
            )
    log.notes["resampled"] = (
        f"{method} at {sample_time:g} s; longest gap in the log {longest:.6g} s"
    )
    return pd.DataFrame(columns, index=grid)


def _interpolate(
    name: str,
    times: np.ndarray,
    values: np.ndarray,
    grid: np.ndarray,
    slack: float,
    method: str,
) -> np.ndarray:
    """Return a column at the times of the grid; `slack` [s] is rounding."""
    if name == "step_distance":  # since the sample before: what adds up is the way so far
        way = _interpolate("way", times, values.cumsum(), grid, slack, method)
        steps = np.diff(way).clip(min=0.0)
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


# --- sessions -----------------------------------------------------------------------------------


def session_of(
    log: RawLog,
    recipe: Recipe,
    values: Mapping[str, Any],
    selection: Sequence[str],
) -> Session:
    """Return the session of a log; `values` are those of `derived_values`."""
    place = log.streams[0].place
    if recipe.resampling:
        frame, place = resample(log, recipe), ROW
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
