"""Parquet files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from trustlab.sessions.errors import SessionError
from trustlab.sessions.log import MAX_SAMPLES, Log, metadata_from_json
from trustlab.sessions.recipes import Recipe
from trustlab.sessions.rules import TimeRule, plain_key
from trustlab.sessions.tables import select_cells, some, table_log

__all__ = ["read_parquet"]


def read_parquet(path: Path, recipe: Recipe | None, wanted: Sequence[str] | None) -> Log:
    """
    Return what a Parquet file holds.

    Parameters
    ----------
    path : Path
        The file.
    recipe : Recipe, optional
        Which columns are which; without, the file has the vocabulary's names and SI units.
    wanted : sequence of str, optional
        Session columns to read; all when not given, which only a file without a recipe may leave.

    Raises
    ------
    SessionError
        If the file is damaged, or names or types of columns do not fit.
    """
    import pyarrow as pa
    import pyarrow.parquet

    source = str(path)
    data = path.read_bytes()
    if not data:
        raise SessionError("the file is empty", source)
    # A damaged file can make the decoder raise any of these; all of them mean that it cannot be read.
    damage = (
        pa.ArrowException,
        OSError,
        ValueError,
        TypeError,
        LookupError,
        ArithmeticError,
        MemoryError,
        RuntimeError,
    )
    try:
        with pyarrow.parquet.ParquetFile(pa.BufferReader(data)) as file:
            schema, rows = file.schema_arrow, file.metadata.num_rows
            comment = (schema.metadata or {}).get(b"trustlab")
            names = [str(name) for name in schema.names]
    except damage as error:
        raise SessionError(f"not a Parquet file, or a truncated one ({_short(error)})", source) from error
    if recipe and not recipe.table.header:
        names = [""] * len(names)
    cells = select_cells(names, recipe, wanted, source, "schema")
    if rows == 0:
        raise SessionError("the file has columns but no rows", source)
    if not 0 < rows <= MAX_SAMPLES:
        raise SessionError(f"the file claims {rows} rows; at most {MAX_SAMPLES} are read", source)
    metadata = None
    if comment is not None:
        metadata, _ = metadata_from_json(comment.decode("utf-8", "replace"), source)
    _check_types(cells, schema, source)
    try:
        with pyarrow.parquet.ParquetFile(pa.BufferReader(data)) as file:
            table = file.read(
                columns=list({schema.names[cell.position]: 0 for cell in cells}), use_threads=False
            )
            table.validate(full=True)
            raw = {cell.name: _numbers(table.column(schema.names[cell.position]), cell.map) for cell in cells}
    except damage as error:
        raise SessionError(f"the file is damaged ({_short(error)})", source) from error
    for cell in cells:
        values, unknown = raw[cell.name]
        if unknown is not None:
            row, text = unknown
            raise SessionError(
                f"row {row} (from 0), column {cell.label}: {text[:60]!r} is not in the recipe's map "
                f"(known: {some(list(cell.map))})",
                source,
            )
        raw[cell.name] = values
    time = recipe.time if recipe else TimeRule()
    return table_log(source, cells, raw, time, lambda k: f"row {k} (from 0)", metadata)


def _short(error: BaseException) -> str:
    return (str(error) or type(error).__name__).splitlines()[0][:200]


def _check_types(cells, schema, source) -> None:
    import pyarrow as pa

    for cell in cells:
        kind = schema.field(cell.position).type
        if cell.map or pa.types.is_floating(kind) or pa.types.is_integer(kind) or pa.types.is_boolean(kind):
            continue
        hint = "write numbers"
        if pa.types.is_temporal(kind):
            hint = "write seconds since the start as numbers"
        raise SessionError(f"column {cell.label}: holds {kind}, not numbers; {hint}", source)


def _numbers(column, texts) -> tuple[np.ndarray, tuple[int, str] | None]:
    import pyarrow as pa

    if texts is None:
        if pa.types.is_boolean(column.type):
            column = column.cast(pa.int8())
        if not pa.types.is_signed_integer(
            column.type
        ):  # large times stay exact until their start is taken off
            column = column.cast(pa.float64(), safe=False)
        return column.to_numpy(zero_copy_only=False), None
    values = np.full(len(column), np.nan)
    for row, value in enumerate(column.to_pylist()):
        if plain_key(value) not in texts:
            return values, (row, str(value))
        values[row] = texts[plain_key(value)]
    return values, None
