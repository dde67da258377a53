"""CSV files."""

import csv
import io
import math
import re
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np

from trustlab.sessions.errors import SessionError
from trustlab.sessions.metadata import metadata_from_json
from trustlab.sessions.readers.tables import SourceColumn, select_columns, table_stream
from trustlab.sessions.recipe import NUMBER, Recipe, TableRule, mapped, plain_key
from trustlab.sessions.resampling import RawLog

COMMENT = "# trustlab "
"""The start of the first line of a CSV file whose rest is metadata."""

_FILL = "fill it or cut it out before reading, by a rule that you state"
_NOT_A_NUMBER = {"nan", "na", "n/a", "null", "none", "inf", "-inf", "+inf", "infinity", "-infinity", "-"}


def read_csv(path: Path, recipe: Recipe | None, wanted: Sequence[str] | None, layout: TableRule) -> RawLog:
    """
    Return the log in a CSV file.

    Faults of the text and of its columns are raised; a fault in a row is handed on in the log, together with the rows
    before it, so that the first fault of the file can be reported.
    """
    text = _decode(path.read_bytes())
    stream = io.StringIO(text, newline="")
    metadata, before = None, layout.skip_lines
    if text.startswith(COMMENT) and not before:
        metadata, _ = metadata_from_json(stream.readline()[len(COMMENT) :])
        before = 1
        if not text.endswith(("\n", "\r")):  # a file of ours ends its last line
            line = text.count("\n") + 1
            raise SessionError(f"line {line}: has no end, so the file was cut short; write it again")
    else:
        for _ in range(before):
            stream.readline()
    start = stream.tell()
    where = f"line {before + 1}"
    reader = csv.reader(stream, delimiter=layout.delimiter)
    try:
        first = next(reader, [])
    except csv.Error as error:
        raise SessionError(f"{where}: not a line of a CSV file ({error})") from error
    if not first:
        raise SessionError(f"{where}: is empty; the column names or the first row should be here")
    width, line = len(first), before + 1
    if layout.header:
        names, basis = [name.strip() for name in first], f"the header names {width}"
        start, line = stream.tell(), line + reader.line_num
        _check_header(names, layout, recipe, wanted, where)
    else:
        names, basis = [""] * width, f"the first row has {width}"
    selected = select_columns(names, recipe, wanted, where)
    body = text[start:]
    if not body.strip():
        raise SessionError(f"{where}: nothing follows the column names; the log has no samples")
    raw, fault = _fast(body, selected, layout, width), None
    place: Callable[[int], str] = lambda k: f"line {line + k}"  # noqa: E731
    if raw is None:
        raw, lines, fault = _scan(body, selected, layout, width, basis, line)
        place = lambda k: f"line {lines[k]}"  # noqa: E731
    table, notes = table_stream(selected, raw, recipe, place)
    return RawLog(str(path), [table], metadata, fault, notes)


def _decode(data: bytes) -> str:
    if not data.strip():
        raise SessionError("the file is empty")
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise SessionError("line 1: the text is UTF-16; save the file as UTF-8")
    if b"\0" in data:
        line = data[: data.index(b"\0")].count(b"\n") + 1
        raise SessionError(f"line {line}: a zero byte; this is binary data, not a CSV file")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data[: error.start].count(b"\n") + 1
        what = f"byte 0x{data[error.start]:02x} is not UTF-8 text"
        raise SessionError(f"line {line}: {what}; save the file as UTF-8") from error


def _check_header(
    names: Sequence[str], layout: TableRule, recipe: Recipe | None, wanted: Sequence[str] | None, where: str
) -> None:
    """Raise where the line of names shows that the table is written in another way."""
    if not recipe and names[0].startswith("#"):
        raise SessionError(f"{where}: found a comment instead of the names; skip it with [table] skip_lines")
    other = next((mark for mark in ";\t|," if mark != layout.delimiter and mark in names[0]), None)
    if len(names) > 1 or other is None or (not recipe and (wanted is not None or other in "|,")):
        return
    written = "\\t" if other == "\t" else other
    comma = "if numbers have a decimal comma"
    how = f'read it with delimiter="{written}" (and decimal="," {comma}), or set them in a recipe\'s [table]'
    if recipe:
        how = f'set [table] delimiter = "{written}" (and decimal = "," {comma}) in the recipe'
    what = f"one column only, {names[0][:60]!r}; if its names are separated by {other!r}, {how}"
    raise SessionError(f"{where}: {what}")


def _fast(body: str, selected: Sequence[SourceColumn], layout: TableRule, width: int) -> dict[str, np.ndarray] | None:
    """Return the columns, or None where anything is unusual and `_scan` must find out what."""
    import pyarrow as pa
    import pyarrow.csv

    texts = {str(each.position) for each in selected if each.map}
    if texts & {str(each.position) for each in selected if not each.map}:
        return None  # one column read as texts and as numbers
    types = {str(each.position): pa.string() if each.map else pa.float64() for each in selected}
    try:
        table = pyarrow.csv.read_csv(
            pa.BufferReader(body.encode()),
            pyarrow.csv.ReadOptions(column_names=[str(k) for k in range(width)], use_threads=False),
            pyarrow.csv.ParseOptions(delimiter=layout.delimiter, ignore_empty_lines=False),
            pyarrow.csv.ConvertOptions(
                include_columns=list(types),
                column_types=types,
                null_values=[],
                strings_can_be_null=False,
                decimal_point=layout.decimal,
            ),
        )
    except (pa.ArrowException, ValueError, MemoryError):
        return None
    raw = {}
    for each in selected:
        values = table.column(str(each.position))
        if each.map:
            coded = values.combine_chunks().dictionary_encode()  # look every text up once
            known = [each.map.get(plain_key(text)) for text in coded.dictionary.to_pylist()]
            if None in known:
                return None
            raw[each.name] = np.array(known, dtype=float)[coded.indices.to_numpy(zero_copy_only=False)]
        else:
            raw[each.name] = values.to_numpy()
            if not np.isfinite(raw[each.name]).all():
                return None
    return raw


def _scan(
    body: str, selected: Sequence[SourceColumn], layout: TableRule, width: int, basis: str, line: int
) -> tuple[dict[str, np.ndarray], list[int], SessionError | None]:
    """Return columns, line numbers and the first fault, reading row by row: the reference that `_fast` must agree with."""
    rows: list[list[float]] = []
    lines: list[int] = []
    selected = sorted(selected, key=lambda each: each.position)  # the leftmost fault of a row comes first
    fault = None
    try:
        for here, row in _rows(body, layout, width, basis, line):
            rows.append([_cell(each, row, layout, here, len(rows)) for each in selected])
            lines.append(here)
    except SessionError as error:
        fault = error
    data = np.array(rows, dtype=float).reshape(len(rows), len(selected))
    return {each.name: data[:, k] for k, each in enumerate(selected)}, lines, fault


def _rows(body: str, layout: TableRule, width: int, basis: str, line: int) -> Iterator[tuple[int, list[str]]]:
    """Yield the line number and the cells of every row; empty lines are allowed at the end only."""
    reader = csv.reader(io.StringIO(body, newline=""), delimiter=layout.delimiter)
    blank = None
    here = line
    try:
        for cells in reader:
            if len(cells) <= 1 and not "".join(cells).strip():
                blank = here if blank is None else blank
            elif blank is not None:
                raise SessionError(f"line {blank}: is empty, with samples after it; remove it or fill it in")
            elif len(cells) != width:
                last = line + reader.line_num - 1
                hint = "complete the row, or remove the extra commas (a decimal comma?)"
                if last > here:
                    hint = f"a quotation mark that opens here closes in line {last}"
                raise SessionError(f"line {here}: has {len(cells)} cells, but {basis}; {hint}")
            else:
                yield here, cells
            here = line + reader.line_num
    except csv.Error as error:
        last = line + reader.line_num - 1
        raise SessionError(f"line {last}: not a line of a CSV file ({error})") from error


def _cell(column: SourceColumn, row: Sequence[str], layout: TableRule, line: int, k: int) -> float:
    """Return the number in one cell of row k."""
    where = f"line {line}, column {column.label}"
    if column.map is not None:
        return float(mapped(column.map, row[column.position], where, row=k))
    try:
        return _number(row[column.position].strip(" \t"), layout.decimal)
    except ValueError as error:
        raise SessionError(f"{where}: {error}", row=k) from None


def _number(text: str, decimal: str) -> float:
    if not text:
        raise ValueError(f"the cell is empty; {_FILL}")
    # With a decimal comma a point has no meaning: "!" makes such a number fail.
    number = text if decimal == "." else text.replace(".", "!").replace(",", ".")
    if NUMBER.fullmatch(number):
        value = float(number)
        if math.isinf(value):
            raise ValueError(f"{text[:60]!r} is too large for a number")
        return value
    shown = repr(text[:60])
    if text.lower() in _NOT_A_NUMBER:
        raise ValueError(f"{shown} is not a finite number; {_FILL}")
    if decimal == "." and re.fullmatch(r"[+-]?\d+,\d+", text):
        raise ValueError(f'{shown} is not a number; read the file with decimal=",", or set it in a recipe')
    raise ValueError(f"{shown} is not a number; correct it, or turn words into numbers with a recipe's map")
