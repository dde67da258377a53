"""Tables in columns: Parquet and Feather files, and data frames."""

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from trustlab.sessions.errors import SessionError, damage_named
from trustlab.sessions.metadata import metadata_from_json
from trustlab.sessions.readers.tables import SourceColumn, select_columns, table_stream
from trustlab.sessions.readers.unpacking import Budget, feather_size
from trustlab.sessions.recipe import Recipe
from trustlab.sessions.resampling import RawLog


def read_parquet(path: Path, recipe: Recipe | None, wanted: Sequence[str] | None, budget: Budget) -> RawLog:
    """Return the log in a Parquet file."""
    import pyarrow as pa
    from pyarrow import parquet

    with _guard("Parquet"), pa.memory_map(str(path)) as source:
        schema = parquet.read_schema(source)
        # Texts stay a dictionary, as a long one that repeats takes next to nothing in the file.
        texts = [
            field.name for field in schema if pa.types.is_string(field.type) or pa.types.is_large_string(field.type)
        ]
        file = parquet.ParquetFile(source, read_dictionary=texts)
        rows = file.metadata.num_rows

        def load(names: list[str]) -> Any:
            budget.take(8 * max(rows, 0) * len(names))  # what it claims, before what it holds
            return _joined(file.iter_batches(columns=names, use_threads=False), Budget(budget.most))

        return arrow_log(str(path), schema, rows, load, recipe, wanted)


def read_feather(path: Path, recipe: Recipe | None, wanted: Sequence[str] | None, budget: Budget) -> RawLog:
    """Return the log in a Feather (Arrow IPC) file."""
    import pyarrow as pa

    with _guard("Feather"), pa.memory_map(str(path)) as source:
        Budget(budget.most).take(feather_size(source.read_buffer()))
        file = pa.ipc.open_file(source)
        batches = file.num_record_batches

        def load(names: list[str]) -> Any:
            fields = pa.ipc.IpcReadOptions(included_fields=[file.schema.get_field_index(name) for name in names])
            part = pa.ipc.open_file(source, options=fields)
            return _joined(map(part.get_batch, range(batches)), budget)

        return arrow_log(str(path), file.schema, batches, load, recipe, wanted)


def frame_log(frame, recipe: Recipe | None, wanted: Sequence[str] | None) -> RawLog:
    """Return the log in a data frame."""
    import pyarrow as pa

    frame = frame if frame.index.name is None else frame.reset_index()
    with damage_named("the columns cannot be taken as numbers or texts", "give each column one type"):
        names = [str(name) for name in frame.columns]
        empty = pa.schema([(name, pa.null()) for name in names])

        def load(wanted: list[str]) -> Any:
            return pa.table({name: pa.array(frame.iloc[:, names.index(name)], from_pandas=True) for name in wanted})

        return arrow_log("data frame", empty, len(frame), load, recipe, wanted)


def _guard(format: str):
    return damage_named(f"not a {format} file, or a damaged or truncated one", "write or copy it again")


def _joined(batches, budget: Budget):
    """Return a table from its batches, counted one by one."""
    import pyarrow as pa

    kept = []
    for batch in batches:
        budget.take(batch.nbytes)
        kept.append(batch)
    table = pa.Table.from_batches(kept)
    table.validate(full=True)
    return table


def arrow_log(
    source: str,
    schema,
    rows: int,
    load: Callable[[list[str]], Any],
    recipe: Recipe | None,
    wanted: Sequence[str] | None,
) -> RawLog:
    """Return the log in a table of this schema; `load` gives the columns of these names."""
    names = [str(name) for name in schema.names]
    with_header = recipe is None or recipe.table.header
    selected = select_columns(names if with_header else [""] * len(names), recipe, wanted, "schema")
    if rows <= 0:
        raise SessionError("the file has columns but no rows")
    comment = (schema.metadata or {}).get(b"trustlab")
    metadata, extra = (None, {}) if comment is None else metadata_from_json(comment.decode("utf-8", "replace"))
    own = {each.name: names[each.position] for each in selected}
    table = load(list(dict.fromkeys(own.values())))
    raw = {each.name: numbers(table.column(own[each.name]), each) for each in selected}
    stream, notes = table_stream(selected, raw, recipe, "row {} (from 0)".format)
    return RawLog(source, [stream], metadata, notes=notes, digests=extra.get("digests", {}))


def numbers(values, column: SourceColumn) -> np.ndarray:
    """Return the numbers of a column of Arrow; raise where it has none."""
    import pyarrow as pa

    def attempt(text: object) -> float:
        if column.blank and (text is None or not str(text).strip()):
            return math.nan
        try:
            return column.text(text)
        except ValueError:
            return math.inf

    if column.text:
        coded = pa.chunked_array(values).combine_chunks().dictionary_encode()  # read every text once
        known = [attempt(text) for text in [*coded.dictionary.to_pylist(), None]]
        read = np.array(known, dtype=float)[coded.indices.fill_null(len(known) - 1).to_numpy(zero_copy_only=False)]
        if np.isinf(read).any():
            k = int(np.argmax(np.isinf(read)))
            try:
                column.text(values[k].as_py())
            except ValueError as error:
                raise SessionError(f"row {k} (from 0), column {column.label}: {error}") from None
        return read
    kind = values.type
    if not (pa.types.is_floating(kind) or pa.types.is_integer(kind) or pa.types.is_boolean(kind)):
        hint = "write seconds since the start as numbers" if pa.types.is_temporal(kind) else "write numbers"
        raise SessionError(f"column {column.label}: holds {kind}, not numbers; {hint}")
    if pa.types.is_boolean(kind):
        values = values.cast(pa.int8())
    if not pa.types.is_signed_integer(values.type):  # large times stay exact until their start is subtracted
        values = values.cast(pa.float64(), safe=False)
    return values.to_numpy(zero_copy_only=False)
