"""CSV files."""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

from trustlab.sessions.errors import SessionError, nearest
from trustlab.sessions.log import Log, metadata_from_json
from trustlab.sessions.recipes import Recipe
from trustlab.sessions.rules import NUMBER, TableRule, TimeRule, plain_key
from trustlab.sessions.tables import Cell, select_cells, some, table_log

__all__ = ["COMMENT", "read_csv"]

COMMENT = "# trustlab "
"""What the first line of a CSV starts with when the rest of it is metadata."""

_NOT_A_NUMBER = {"nan", "na", "n/a", "null", "none", "inf", "-inf", "+inf", "infinity", "-infinity", "-"}


def _decode(data: bytes, source: str) -> str:
    if not data.strip():
        raise SessionError("the file is empty", source)
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise SessionError("line 1: the text is UTF-16; save the file as UTF-8", source)
    if b"\0" in data:
        line = data[: data.index(b"\0")].count(b"\n") + 1
        raise SessionError(f"line {line}: a zero byte; this is binary data, not a CSV file", source)
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data[: error.start].count(b"\n") + 1
        raise SessionError(
            f"line {line}: byte 0x{data[error.start]:02x} is not UTF-8 text; save the file as UTF-8", source
        ) from error


def read_csv(path: Path, recipe: Recipe | None, wanted: Sequence[str] | None, layout: TableRule) -> Log:
    """
    Return what a CSV file holds.

    Parameters
    ----------
    path : Path
        The file.
    recipe : Recipe, optional
        Which columns are which; without, the file has the vocabulary's names and SI units.
    wanted : sequence of str, optional
        Session columns to read; all when not given, which only a file without a recipe may leave.
    layout : TableRule
        How the table is written.

    Raises
    ------
    SessionError
        If the file is not text, or names or numbers of columns do not fit; faults of single rows are handed on in
        the log, so that the first fault of the file can be told.
    """
    source = str(path)
    text = _decode(path.read_bytes(), source)
    stream = io.StringIO(text, newline="")
    metadata, before = None, layout.skip_lines
    if text.startswith(COMMENT) and not before:
        metadata, _ = metadata_from_json(stream.readline()[len(COMMENT) :], source)
        before = 1
        if not text.endswith(("\n", "\r")):
            line = text.count("\n") + 1
            raise SessionError(
                f"line {line}: is not ended, so that the file was cut short; write it again", source
            )
    else:
        for _ in range(before):
            stream.readline()
    start = stream.tell()
    reader = csv.reader(stream, delimiter=layout.delimiter)
    try:
        first = next(reader, [])
    except csv.Error as error:
        raise SessionError(f"line {before + 1}: not a line of a CSV file ({error})", source) from error
    where = f"line {before + 1}"
    if not first:
        raise SessionError(f"{where}: is empty; the column names or the first row should be here", source)
    if layout.header:
        names, width, line = [name.strip() for name in first], len(first), before + 1 + reader.line_num
        start = stream.tell()
        body, basis = text[start:], f"the header names {width}"
        if not recipe and wanted is None and len(names) == 1 and re.search(r"[;\t]", names[0]):
            raise SessionError(
                f"{where}: columns are separated by {'a tab' if chr(9) in names[0] else ';'!r}, not by commas; read it with "
                f'delimiter="{chr(92) + "t" if chr(9) in names[0] else ";"}" (and decimal="," if numbers have a decimal '
                "comma), or say so in a recipe's [table]",
                source,
            )
        other = next((mark for mark in ";\t|," if mark != layout.delimiter and mark in names[0]), None)
        if recipe and len(names) == 1 and other:
            shown = "\\t" if other == "\t" else other
            raise SessionError(
                f"{where}: one column only, {names[0][:60]!r}; if its names are separated by {other!r}, say so in the recipe: "
                f'[table] delimiter = "{shown}" (and decimal = "," if numbers have a decimal comma)',
                source,
            )
        if not recipe and names[0].startswith("#"):
            raise SessionError(
                f"{where}: a comment stands where the names should; use [table] skip_lines", source
            )
    else:
        names, width, line = [""] * len(first), len(first), before + 1
        body, basis = text[start:], f"the first row has {width}"
    cells = select_cells(names, recipe, wanted, source, where)
    if not body.strip():
        raise SessionError(f"{where}: nothing follows the column names; the log has no samples", source)
    raw = _fast(body, cells, layout, width)
    fault, place = None, _lines(line)
    if raw is None:
        raw, lines, fault = _scan(body, cells, layout, width, basis, line, source)
        place = lambda k: f"line {lines[k]}"  # noqa: E731
    return table_log(source, cells, raw, recipe.time if recipe else TimeRule(), place, metadata, fault)


def _lines(first: int) -> Callable[[int], str]:
    return lambda k: f"line {first + k}"


def _fast(body: str, cells: Sequence[Cell], layout: TableRule, width: int) -> dict[str, np.ndarray] | None:
    """Return the columns, or None where anything is unusual and `_scan` must say what."""
    import pyarrow as pa
    import pyarrow.csv

    texts = {str(cell.position) for cell in cells if cell.map}
    if texts & {str(cell.position) for cell in cells if not cell.map}:
        return None
    included = {str(cell.position): None for cell in cells}
    try:
        table = pyarrow.csv.read_csv(
            pa.BufferReader(body.encode()),
            pyarrow.csv.ReadOptions(column_names=[str(k) for k in range(width)], use_threads=False),
            pyarrow.csv.ParseOptions(delimiter=layout.delimiter, ignore_empty_lines=False),
            pyarrow.csv.ConvertOptions(
                include_columns=list(included),
                column_types={name: pa.string() if name in texts else pa.float64() for name in included},
                null_values=[],
                strings_can_be_null=False,
                decimal_point=layout.decimal,
            ),
        )
    except (pa.ArrowException, ValueError, MemoryError):
        return None
    raw = {}
    for cell in cells:
        values = table.column(str(cell.position))
        if cell.map:
            coded = values.combine_chunks().dictionary_encode()
            known = [cell.map.get(plain_key(text)) for text in coded.dictionary.to_pylist()]
            if None in known:
                return None
            raw[cell.name] = np.array(known, dtype=float)[coded.indices.to_numpy(zero_copy_only=False)]
        else:
            raw[cell.name] = values.to_numpy()
            if not np.isfinite(raw[cell.name]).all():
                return None
    return raw


def _scan(body, cells, layout, width, basis, line, source):
    """Return columns, line numbers and the first fault, reading row by row: what `_fast` must agree with."""
    rows: list[list[float]] = []
    lines: list[int] = []
    fault = None
    reader = csv.reader(io.StringIO(body, newline=""), delimiter=layout.delimiter)
    cells = sorted(cells, key=lambda cell: cell.position)
    blank = None
    while fault is None:
        here = line + reader.line_num
        try:
            row = next(reader, None)
        except csv.Error as error:
            fault = SessionError(
                f"line {line + reader.line_num - 1}: not a line of a CSV file ({error})", source
            )
            break
        if row is None:
            break
        if not row or (len(row) == 1 and not row[0].strip()):
            blank = here if blank is None else blank
            continue
        if blank is not None:
            fault = SessionError(
                f"line {blank}: is empty, with samples after it; remove it or fill it in", source
            )
            break
        if len(row) != width:
            last = line + reader.line_num - 1
            hint = (
                f"; a quotation mark that opens here closes in line {last}"
                if last > here
                else "; complete the row, or take out the commas that are too many (a decimal comma?)"
            )
            fault = SessionError(f"line {here}: has {len(row)} cells where {basis}{hint}", source)
            break
        values = []
        for cell in cells:
            value, wrong = _parse(row[cell.position], cell.map, layout.decimal)
            if wrong:
                fault = SessionError(f"line {here}, column {cell.label}: {wrong}", source, row=len(rows))
                break
            values.append(value)
        else:
            rows.append(values)
            lines.append(here)
    data = np.array(rows, dtype=float).reshape(len(rows), len(cells))
    return {cell.name: data[:, k] for k, cell in enumerate(cells)}, lines, fault


def _parse(cell: str, texts: Mapping[str, float] | None, decimal: str) -> tuple[float, str | None]:
    text = cell.strip(" \t")
    shown = repr(text[:60])
    if texts is not None:
        value = texts.get(plain_key(cell))
        if value is None:
            return (
                math.nan,
                f"{shown} is not in the recipe's map (known: {some(list(texts))}){nearest(text, texts)}",
            )
        return float(value), None
    if not text:
        return math.nan, "the cell is empty; fill or cut it before reading, by a rule you can name"
    number = text
    if decimal == ",":
        number = text.replace(".", "!").replace(",", ".")
    if NUMBER.fullmatch(number) is None:
        if text.lower() in _NOT_A_NUMBER:
            return (
                math.nan,
                f"{shown} is not a finite number; fill or cut it before reading, by a rule you can name",
            )
        comma = re.fullmatch(r"[+-]?\d+,\d+", text) and decimal == "."
        return math.nan, f"{shown} is not a number; " + (
            'say decimal = "," in a recipe'
            if comma
            else "correct it, or turn words into numbers with a recipe's map"
        )
    value = float(number)
    if math.isinf(value):
        return value, f"{shown} is too large for a number"
    return value, None
