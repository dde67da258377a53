"""Tables in Parquet, Feather, MATLAB and HDF5 files and data frames, as raw logs."""

import math
import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from trustlab.models.checks import did_you_mean
from trustlab.models.extras import extra
from trustlab.sessions.errors import SessionError, all_or_faults, damage_named, listed
from trustlab.sessions.metadata import metadata_from_json
from trustlab.sessions.readers.assembly import fill_blanks
from trustlab.sessions.readers.limits import Budget
from trustlab.sessions.recipe import NUMBER, ColumnRule, Recipe, TableTime, looked_up
from trustlab.sessions.resampling import RawLog, Stream
from trustlab.sessions.vocabulary import VOCABULARY, to_si

# How cells without a number are written, in lower case.
BLANKS = ("", "nan", "na", "n/a", "null", "none", "-")


@dataclass(frozen=True)
class SourceColumn:
    """
    One column of the file: its name in the session (or "t"), its position from 0, its label in
    errors, its rule. `text` makes a number of a cell that is no number, and raises ValueError.
    """

    name: str
    position: int
    label: str
    rule: ColumnRule | None = None
    text: Callable[[object], float] | None = None

    @property
    def blank(self) -> str | None:
        """How blank cells are filled."""
        return self.rule.blank if self.rule else None


def select_columns(
    names: Sequence[str], recipe: Recipe | None, selection: Sequence[str] | None, where: str
) -> list[SourceColumn]:
    """Return the columns to read from a file with these names (empty without a header)."""
    asked: list[tuple[str, str | int, ColumnRule | None, Callable | None]]
    if recipe is None:
        if selection is None:
            _check_names(names, where)
            selection = [name for name in names if name != "t"]
        asked = [(name, name, None, None) for name in ["t", *selection]]
    else:
        stamps: dict[str, Callable[[object], float]] = {
            "iso": _IsoTimes(recipe.time.from_zero),
            "clock": _clock_time,
        }
        asked = [("t", recipe.time.column, None, stamps.get(recipe.time.unit))]
        rules = [recipe.columns[name] for name in selection or ()]
        asked += [
            (rule.name, rule.column, rule, _cell_reader(rule, recipe))
            for rule in rules
            if rule.kind == "column"
        ]
    finds = [partial(_find, name, key, names, where) for name, key, _, _ in asked]
    places = all_or_faults(finds)
    return [
        SourceColumn(name, place[0], place[1], rule, text)
        for (name, _, rule, text), place in zip(asked, places, strict=True)
    ]


def _cell_reader(rule: ColumnRule, recipe: Recipe) -> Callable[[object], float] | None:
    """Return what makes a number of a cell that is no number."""
    if rule.map:
        return partial(looked_up, rule.map)
    return None if rule.item is None else partial(_item, rule.item, recipe.table.decimal)


class _IsoTimes:
    """Reads dates as seconds since the first of them, or since 1970; UTC without a time zone."""

    def __init__(self, from_first: bool):
        # Nanoseconds, as integers: in seconds since 1970 a float would lose all but seven decimals.
        self.start = None if from_first else 0

    def __call__(self, text: object) -> float:
        try:
            time = datetime.fromisoformat(str(text).strip())
        except ValueError:
            raise ValueError(
                f"{str(text)[:60]!r} is not a time such as 2026-03-01T12:00:00; or give seconds"
            ) from None
        since = (time if time.tzinfo else time.replace(tzinfo=UTC)) - datetime.fromtimestamp(0, UTC)
        finer = re.search(r"[.,]\d{6}(\d{1,3})", str(text))  # digits that datetime drops
        stamp = since // timedelta(microseconds=1) * 1000 + (
            int(finer[1].ljust(3, "0")) if finer else 0
        )
        self.start = stamp if self.start is None else self.start
        return (stamp - self.start) / 10**9


def _clock_time(text: object) -> float:
    """Return the seconds since midnight."""
    written = str(text).replace(",", ".")
    match = re.fullmatch(r"\s*(\d{1,2}):(\d{2}):(\d{2}(?:\.\d{1,12})?)\s*", written, re.ASCII)
    if not match:
        raise ValueError(f"{str(text)[:60]!r} is not a time of the day such as 12:00:00.5")
    hours, minutes, seconds = map(float, match.groups())
    return 3600.0 * hours + 60.0 * minutes + seconds


def _item(index: int, decimal: str, text: object) -> float:
    """Return one number of a cell such as "(x, y, z)", or "(x; y; z)" with decimal commas."""
    cell = str(text).strip(" ()[]{}")
    if decimal == "," and "." not in cell:
        cell = re.sub(r"(?<=\d),(?=\d)", ".", cell)
    parts = re.split(r"\s*[,;]\s*|\s+", cell)
    counted = index < len(parts) and all(NUMBER.fullmatch(part) or is_blank(part) for part in parts)
    if not counted or is_blank(parts[index]) or math.isinf(float(parts[index])):
        raise ValueError(f"{str(text)[:60]!r} has no number {index} (from 0)")
    return float(parts[index])


def _find(name: str, key: str | int, names: Sequence[str], where: str) -> tuple[int, str]:
    """Return where a column stands, and its label in errors."""
    if isinstance(key, int):
        if key >= len(names):
            fault = f"the recipe takes {name} from column {key} (from 0)"
            raise SessionError(f"{where}: has {len(names)} columns; {fault}")
        return key, f"{key} ({name})"
    if names.count(key) != 1:
        fault = "occurs twice; rename or remove one"
        if key not in names:
            fault = f"is missing{did_you_mean(key, names) or _time_hint(key, names)}"
        raise SessionError(f"{where}: column {key!r} {fault} (the file has: {listed(names)})")
    return names.index(key), repr(key) if key == name else f"{key!r} ({name})"


def _time_hint(key: str, names: Sequence[str]) -> str:
    likely = [
        name for name in names if re.match(r"(?i)(t|time|stamp|secs?|clock)([^a-z]|$|stamp)", name)
    ]
    return f"; if {likely[0]!r} is time in seconds, rename it to t" if key == "t" and likely else ""


def _check_names(names: Sequence[str], where: str) -> None:
    """Raise unless all names belong to the vocabulary and none occurs twice."""
    numerals = [name for name in names if NUMBER.fullmatch(name.strip())]
    if 2 * len(numerals) > len(names):  # dates may stand among them
        remedy = (
            "add a line of names, or read the file with a recipe that has the lines [table] and "
            "header = false"
        )
        raise SessionError(f"{where}: found numbers instead of column names; {remedy}")
    counts = Counter(names)
    twice = [name for name in names if counts[name] > 1]
    if twice and twice[0]:
        raise SessionError(f"{where}: column {twice[0]!r} occurs twice; rename or remove one")
    for k, name in enumerate(names):
        if not name:
            hint = "name it, or remove it (pandas writes one so unless told index=False)"
            raise SessionError(f"{where}: column {k} (from 0) has no name; {hint}")
        if name not in VOCABULARY and name != "t":
            hint = did_you_mean(name, VOCABULARY) or _time_hint("t", [name])
            remedy = "map it with a recipe, leave it out with columns=[...], or rename it"
            fault = f"column {name[:100]!r} is not in the vocabulary{hint}"
            raise SessionError(f"{where}: {fault} ({remedy}; see trustlab.sessions.vocabulary())")


def table_stream(
    selected: Sequence[SourceColumn],
    raw: Mapping[str, np.ndarray],
    recipe: Recipe | None,
    place: Callable[[int], str],
) -> tuple[Stream, dict[str, object]]:
    """Return the stream of a table's columns, and notes; `raw` is in the file's units."""
    notes: dict[str, object] = {}
    blanks = [(column.name, column.blank) for column in selected if column.blank]
    if blanks:
        raw, place, notes = fill_blanks(blanks, dict(raw), place)
    columns = {}
    for column in selected:
        values = raw[column.name]
        columns[column.name] = column.rule.convert(values) if column.rule else values
    t = columns.pop("t")
    if recipe is not None:
        t = _seconds(t, recipe.time, selected[0].text, notes)
    return Stream(np.asarray(t, dtype=float), columns, place), notes


def _seconds(t: np.ndarray, time: TableTime, stamps: object, notes: dict) -> np.ndarray:
    """Return times in seconds; `stamps` read them if they were texts."""
    factor = 1.0 if time.unit in ("iso", "clock") else to_si(time.unit, "s")
    with np.errstate(over="ignore", invalid="ignore"):
        # Half a day back is the day after.
        if time.unit == "clock" and (np.diff(t) < -43200.0).any():
            midnights = np.cumsum(np.diff(t, prepend=t[0]) < -43200.0)
            notes["midnights"] = f"{midnights[-1]} passed; times count on"
            t = t + 86400.0 * midnights
        if time.from_zero and t.size and np.isfinite(t[0]):
            start = (stamps.start or 0) / 10**9 if isinstance(stamps, _IsoTimes) else 0.0
            notes["start_time"] = start + float(t[0]) * factor
            t = t - t[0]  # before the conversion to float, which would round large integer stamps
        t = np.asarray(t, dtype=float)
        return t * factor if factor != 1.0 else t


def read_parquet(
    path: Path, recipe: Recipe | None, selection: Sequence[str] | None, budget: Budget
) -> RawLog:
    """Return the log in a Parquet file."""
    import pyarrow as pa
    from pyarrow import parquet

    with _guard("Parquet"), pa.memory_map(str(path)) as source:
        schema = parquet.read_schema(source)
        # Texts stay a dictionary, as a long one that repeats takes next to nothing in the file.
        texts = [
            each.name
            for each in schema
            if pa.types.is_string(each.type) or pa.types.is_large_string(each.type)
        ]
        file = parquet.ParquetFile(source, read_dictionary=texts)
        rows = file.metadata.num_rows

        def load(names: list[str]) -> Any:
            budget.check(8 * max(rows, 0) * len(names))  # what it states, before what it holds
            return _joined(file.iter_batches(columns=names, use_threads=False), budget)

        return arrow_log(str(path), schema, rows, load, recipe, selection)


def read_feather(
    path: Path, recipe: Recipe | None, selection: Sequence[str] | None, budget: Budget
) -> RawLog:
    """Return the log in a Feather (Arrow IPC) file."""
    import pyarrow as pa
    from pyarrow import dataset

    with _guard("Feather"), pa.memory_map(str(path)) as source:
        file = dataset.dataset(str(path), format="ipc")
        rows = file.count_rows()  # as its headers state; nothing is unpacked for it

        def load(names: list[str]) -> Any:
            budget.check(8 * max(rows, 0) * len(names))
            fields = pa.ipc.IpcReadOptions(
                included_fields=[file.schema.get_field_index(name) for name in names]
            )
            part = pa.ipc.open_file(source, options=fields)
            return _joined(map(part.get_batch, range(part.num_record_batches)), budget)

        return arrow_log(str(path), file.schema, rows, load, recipe, selection)


def frame_log(frame, recipe: Recipe | None, selection: Sequence[str] | None) -> RawLog:
    """Return the log in a data frame."""
    import pyarrow as pa

    frame = frame if frame.index.name is None else frame.reset_index()
    with damage_named(
        "the columns cannot be taken as numbers or texts", "give each column one type"
    ):
        names = [str(name) for name in frame.columns]
        empty = pa.schema([(name, pa.null()) for name in names])

        def load(selection: list[str]) -> Any:
            return pa.table(
                {
                    name: pa.array(frame.iloc[:, names.index(name)], from_pandas=True)
                    for name in selection
                }
            )

        return arrow_log("data frame", empty, len(frame), load, recipe, selection)


def _guard(format: str):
    return damage_named(
        f"not a {format} file, or a damaged or truncated one", "write or copy it again"
    )


def _joined(batches, budget: Budget):
    """Return a table from its batches, counted one by one."""
    import pyarrow as pa

    counted = []
    for batch in batches:
        budget.take(batch.nbytes)
        counted.append(batch)
    table = pa.Table.from_batches(counted)
    table.validate(full=True)
    return table


def arrow_log(
    source: str,
    schema,
    rows: int,
    load: Callable[[list[str]], Any],
    recipe: Recipe | None,
    selection: Sequence[str] | None,
) -> RawLog:
    """Return the log in a table of this schema; `load` gives the columns of these names."""
    names = [str(name) for name in schema.names]
    with_header = recipe is None or recipe.table.header
    selected = select_columns(
        names if with_header else [""] * len(names), recipe, selection, "schema"
    )
    if rows <= 0:
        raise SessionError("the file has columns but no rows")
    comment = (schema.metadata or {}).get(b"trustlab")
    metadata, extra = (
        (None, {}) if comment is None else metadata_from_json(comment.decode("utf-8", "replace"))
    )
    table = load(list(dict.fromkeys(names[column.position] for column in selected)))
    raw = {
        column.name: numbers(table.column(names[column.position]), column) for column in selected
    }
    stream, notes = table_stream(selected, raw, recipe, "row {} (from 0)".format)
    return RawLog(source, [stream], metadata, notes=notes, digests=extra.get("digests", {}))


def is_blank(text: object) -> bool:
    """Return whether a cell holds nothing, or one of the words for it."""
    return str(text).strip().lower() in BLANKS


def numbers(values, column: SourceColumn) -> np.ndarray:
    """Return the numbers of a column of Arrow; raise where it has none."""
    import pyarrow as pa

    if column.text:
        return _numbers_of_texts(values, column)
    kind = values.type.value_type if pa.types.is_dictionary(values.type) else values.type
    if not (pa.types.is_floating(kind) or pa.types.is_integer(kind) or pa.types.is_boolean(kind)):
        hint = "write numbers, or turn words into numbers with a recipe's map"
        if pa.types.is_temporal(kind):
            hint = 'write seconds, or set [time] unit = "iso" in a recipe'
        raise SessionError(f"column {column.label}: holds {kind}, not numbers; {hint}")
    # Large integer times stay exact until their start is subtracted.
    if not pa.types.is_signed_integer(values.type):
        values = values.cast(pa.float64(), safe=False)
    return values.to_numpy(zero_copy_only=False)


def _numbers_of_texts(values, column: SourceColumn) -> np.ndarray:
    """Return the numbers that the texts of a column mean; each text is read once."""
    import pyarrow as pa

    def attempt(text: object) -> float:
        try:
            return column.text(text)
        except ValueError:
            return math.nan if column.blank and is_blank(text) else math.inf

    coded = pa.chunked_array(values).combine_chunks().dictionary_encode()
    words = [*coded.dictionary.to_pylist(), None]
    known = np.array([attempt(word) for word in words], dtype=float)
    codes = coded.indices.fill_null(len(words) - 1).to_numpy(zero_copy_only=False)
    result = known[codes]
    if np.isinf(result).any():
        k = int(np.argmax(np.isinf(result)))
        try:
            column.text(values[k].as_py())
        except ValueError as error:
            raise SessionError(f"row {k} (from 0), column {column.label}: {error}") from None
    return result


def read_arrays(
    path: Path, recipe: Recipe | None, selection: Sequence[str] | None, budget: Budget
) -> RawLog:
    """Return the log in arrays of a MATLAB or HDF5 file: "name", "group/name" or "name[1]"."""
    import pyarrow as pa

    with _guard("MATLAB or HDF5"):
        arrays = dict(
            _matlab_arrays(path, budget)
            if path.suffix.lower() == ".mat"
            else _hdf5_arrays(path, budget)
        )

        def load(names: list[str]) -> Any:
            columns = {name: arrays[name]() for name in names}
            sizes = {name: len(column) for name, column in columns.items()}
            if len(set(sizes.values())) > 1:
                listing = ", ".join(f"{name} {size}" for name, size in sizes.items())
                raise SessionError(f"the columns differ in their number of values: {listing}")
            return pa.table(columns)

        return arrow_log(
            str(path), pa.schema([(name, pa.null()) for name in arrays]), 1, load, recipe, selection
        )


Arrays = Iterator[tuple[str, Callable[[], np.ndarray]]]


def _columns(name: str, shape: tuple[int, ...], read: Callable[[], np.ndarray]) -> Arrays:
    """Yield the columns of an array: a row of values counts as a column of them."""
    if len(shape) == 1 or (len(shape) == 2 and 1 in shape):
        yield name, lambda: read().ravel()
    elif len(shape) == 2:
        for k in range(shape[1]):
            yield f"{name}[{k}]", partial(lambda k: read()[:, k], k)


def _matlab_arrays(path: Path, budget: Budget) -> Arrays:
    from scipy import io

    try:
        budget.take(sum(8 * math.prod(shape) for _, shape, _ in io.whosmat(path)))
    except NotImplementedError:
        # From version 7.3 on, these are HDF5 files with rows and columns changed over.
        yield from _hdf5_arrays(path, budget, transposed=True)
        return
    for title, content in io.loadmat(path, simplify_cells=True).items():
        parts = {title: content}
        if isinstance(content, dict):
            parts = {f"{title}.{name}": values for name, values in content.items()}
        for name, values in parts.items():
            if isinstance(values, np.ndarray) and values.dtype.kind in "biuf":
                yield from _columns(name, values.shape, partial(np.asarray, values))


def _hdf5_arrays(path: Path, budget: Budget, transposed: bool = False) -> Arrays:
    with extra("formats"):
        import h5py

    def read(name: str) -> np.ndarray:
        with h5py.File(path, "r") as file:
            budget.take(8 * math.prod(file[name].shape))
            values = file[name][()]
        return values.T if transposed else values

    shapes: dict[str, tuple[int, ...]] = {}

    def note(name: str, item: object) -> None:
        if isinstance(item, h5py.Dataset):
            shapes[name] = item.shape

    with h5py.File(path, "r") as file:
        file.visititems(note)
    for name, shape in shapes.items():
        yield from _columns(name, shape[::-1] if transposed else shape, partial(read, name))
