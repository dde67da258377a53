"""Parquet files."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from trustlab.sessions.errors import SessionError, damage_named
from trustlab.sessions.metadata import metadata_from_json
from trustlab.sessions.readers.tables import SourceColumn, select_columns, table_stream
from trustlab.sessions.recipe import Recipe, mapped
from trustlab.sessions.resampling import MAX_SAMPLES, RawLog


def read_parquet(path: Path, recipe: Recipe | None, wanted: Sequence[str] | None) -> RawLog:
    """Return the log in a Parquet file."""
    import pyarrow as pa
    import pyarrow.parquet

    guard = damage_named("not a Parquet file, or a damaged or truncated one", "write or copy it again")
    with guard, pyarrow.parquet.ParquetFile(pa.BufferReader(path.read_bytes())) as file:
        schema, rows = file.schema_arrow, file.metadata.num_rows
        names = [str(name) for name in schema.names]
        with_header = recipe is None or recipe.table.header
        selected = select_columns(names if with_header else [""] * len(names), recipe, wanted, "schema")
        if rows == 0:
            raise SessionError("the file has columns but no rows")
        if not 0 < rows <= MAX_SAMPLES:
            raise SessionError(f"the file claims {rows} rows; at most {MAX_SAMPLES} are read")
        comment = (schema.metadata or {}).get(b"trustlab")
        metadata = None if comment is None else metadata_from_json(comment.decode("utf-8", "replace"))[0]
        own = {each.name: names[each.position] for each in selected}
        table = file.read(columns=list(dict.fromkeys(own.values())), use_threads=False)
        table.validate(full=True)
        raw = {each.name: _numbers(table.column(own[each.name]), each) for each in selected}
    table, notes = table_stream(selected, raw, recipe, "row {} (from 0)".format)
    return RawLog(str(path), [table], metadata, notes=notes)


def _numbers(values, column: SourceColumn) -> np.ndarray:
    import pyarrow as pa

    if column.map:
        rows = enumerate(values.to_pylist())
        coded = [mapped(column.map, value, f"row {k} (from 0), column {column.label}") for k, value in rows]
        return np.array(coded, dtype=float)
    kind = values.type
    if not (pa.types.is_floating(kind) or pa.types.is_integer(kind) or pa.types.is_boolean(kind)):
        hint = "write seconds since the start as numbers" if pa.types.is_temporal(kind) else "write numbers"
        raise SessionError(f"column {column.label}: holds {kind}, not numbers; {hint}")
    if pa.types.is_boolean(kind):
        values = values.cast(pa.int8())
    if not pa.types.is_signed_integer(values.type):  # large times stay exact until their start is subtracted
        values = values.cast(pa.float64(), safe=False)
    return values.to_numpy(zero_copy_only=False)
