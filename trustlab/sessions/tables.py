"""Tables in CSV, Parquet and Feather files and data frames: columns as the file has them."""

import csv
import gzip
import io
import re
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd

from trustlab.models.checks import did_you_mean
from trustlab.sessions.columns import BLANKS, Table
from trustlab.sessions.errors import SessionError, alternatives, damage_named
from trustlab.sessions.recipe import NUMBER, TableRule
from trustlab.sessions.session import Metadata, metadata_from_json
from trustlab.sessions.vocabulary import VOCABULARY

# Suffixes of the files that can be read; a rosbag2 recording may also be a folder.
TEXTS = (".csv", ".csv.gz", ".tsv", ".tsv.gz", ".txt")
BAGS = (".bag", ".mcap", ".db3")
SUFFIXES = (*TEXTS, ".parquet", ".feather", *BAGS)

# The start of the first line of a CSV file whose rest is metadata.
COMMENT = "# trustlab "

# The bytes at the start and the end of a text that show how it is written.
HEAD = 1 << 20

# Given the names in a file, returns the columns to read: the session's name of each, to its name or
# number in the file.
Choice = Callable[[Sequence[str]], Mapping[str, str | int]]


def suffix_of(path: Path) -> str:
    """Return the end of a file's name that says its format: ".csv", ".csv.gz" and so on."""
    return "".join(path.suffixes[-2 if path.suffix.lower() == ".gz" else -1 :]).lower()


def vocabulary_columns(names: Sequence[str]) -> Mapping[str, str | int]:
    """Return the columns of a file without a recipe, whose names belong to the vocabulary."""
    if 2 * sum(NUMBER.fullmatch(name) is not None for name in names) > len(names):
        remedy = (
            "add a line of names, or read the file with a recipe that has the lines [table] and "
            "header = false"
        )
        raise SessionError(f"found numbers instead of column names; {remedy}")
    for name in names:
        if name not in VOCABULARY and name != "t":
            hint = did_you_mean(name, VOCABULARY) or _time_hint([name])
            remedy = "map it with a recipe, leave it out with columns=[...], or rename it"
            if not name:
                hint, remedy = "", "name it, or remove it (pandas: index=False)"
            fault = f"column {name[:100]!r} is not in the vocabulary{hint}"
            raise SessionError(f"{fault} ({remedy}; see trustlab.sessions.vocabulary())")
    return {name: name for name in ("t", *names)}


def _places(choose: Choice, names: Sequence[str], header: bool) -> dict[str, int]:
    """Return where the chosen columns stand in a file; without a header they have numbers."""
    titles: list[Any] = [*names] if header else [*range(len(names))]
    places = {}
    for name, column in choose(names if header else []).items():
        if titles.count(column) != 1:
            fault = "occurs twice; rename or remove one"
            if column not in titles:
                hint = _time_hint(names) if header and column == "t" else ""
                fault = f"is missing{hint}{alternatives(column, titles, 'the file has')}"
            use = "" if column == name else f" (for {name})"
            raise SessionError(f"column {column!r}{use} {fault}")
        places[name] = titles.index(column)
    return places


def _time_hint(names: Sequence[str]) -> str:
    likely = r"(?i)(t|time|stamp|secs?|clock)([^a-z]|$|stamp)"
    name = next((name for name in names if re.match(likely, name)), None)
    return f"; if {name!r} is time in seconds, rename it to t" if name else ""


def read_arrow(path: Path, choose: Choice, layout: TableRule) -> Table:
    """Return the table in a Parquet or Feather (Arrow IPC) file."""
    import pyarrow as pa
    import pyarrow.feather
    import pyarrow.parquet

    reader = pa.parquet if path.suffix.lower() == ".parquet" else pa.feather
    with damage_named("not a table of this format, or a damaged one", "copy or write it again"):
        schema = (
            reader.read_schema(path)
            if reader is pa.parquet
            else pa.ipc.open_file(pa.memory_map(str(path))).schema
        )
        places = _places(choose, schema.names, layout.header)
        needed = list(dict.fromkeys(schema.names[place] for place in places.values()))
        content = reader.read_table(path, columns=needed)
        content.validate(full=True)
        frame = content.to_pandas(ignore_metadata=True)
    frame = pd.DataFrame({name: frame[schema.names[k]] for name, k in places.items()}, copy=False)
    text = (schema.metadata or {}).get(b"trustlab")
    metadata = metadata_from_json(text.decode("utf-8", "replace"))[0] if text else Metadata()
    return _table(frame, "row {} (from 0)".format, metadata)


def frame_table(frame: pd.DataFrame, choose: Choice, layout: TableRule) -> Table:
    """Return the table in a data frame; an index with a name is a column as well."""
    frame = frame.reset_index(drop=frame.index.name is None)
    places = _places(choose, [str(name) for name in frame.columns], layout.header)
    columns = {name: frame.iloc[:, place] for name, place in places.items()}
    return _table(pd.DataFrame(columns, copy=False), "row {} (from 0)".format, Metadata())


def _table(frame: pd.DataFrame, place: Callable[[int], str], metadata: Metadata) -> Table:
    if frame.empty:
        raise SessionError("nothing follows the column names; the log has no samples")
    return Table(frame, place, metadata)


def read_csv(path: Path, choose: Choice, layout: TableRule, texts: Collection[str]) -> Table:
    """Return the table in a text file; `texts` are columns that no numbers are made of here."""
    layout = replace(
        layout, delimiter=layout.delimiter or ("\t" if ".tsv" in path.name.lower() else ",")
    )
    content = path.read_bytes()
    if path.suffix.lower() == ".gz":
        with damage_named("not a gzip file, or a damaged or truncated one", "copy it again"):
            content = gzip.decompress(content)
    if layout.delimiter == " ":  # a run of which separates once
        content = re.sub(rb"(?m)^ +| +(?=\r?$)", b"", re.sub(rb" {2,}", b" ", content))
    head = io.TextIOWrapper(
        io.BytesIO(content[:HEAD]), layout.encoding, errors="surrogateescape", newline=""
    )
    lines = head.read().removeprefix("\ufeff").splitlines(keepends=True)
    before, metadata = layout.skip_lines, Metadata()
    if lines[0].startswith(COMMENT) and not before:
        before, metadata = 1, metadata_from_json(lines[0][len(COMMENT) :])[0]
    try:
        names = next(csv.reader(lines[before:], delimiter=layout.delimiter), [])
        names = [name.strip() for name in names]
        places = _places(choose, names, layout.header)
    except (SessionError, csv.Error) as error:
        _refuse_encoding(content, layout.encoding)
        fault = _layout_fault(names, content, layout) or error
        raise SessionError(f"line {before + 1}: {fault}") from error
    before += layout.header
    frame = _parsed(content, before, len(names), places, layout, {places[name] for name in texts})
    ends = content[-HEAD:]
    ends = ends[len(ends.rstrip(b"\r\n")) :]
    empty = max(ends.count(b"\n") or ends.count(b"\r"), 1) - 1
    table = _table(
        frame.iloc[: len(frame) - empty], lambda row: f"line {before + 1 + row}", metadata
    )
    if not ends:
        table.notes["last line"] = "has no end; the file may have been cut short in it"
    return table


def _layout_fault(names: Sequence[str], content: bytes, layout: TableRule) -> str:
    """Say what the line of names shows of a table that is written in another way; else nothing."""
    if b"\0" in content[:HEAD]:
        return "this is no text in UTF-8; save the file as UTF-8"
    if not "".join(names):
        return "is empty; the names of the columns or the first row should be here"
    if names[0].startswith("#"):
        return "found a comment instead of the names; skip it with [table] skip_lines in a recipe"
    mark = next(
        (mark for mark in ";\t|, " if mark != layout.delimiter and mark in "".join(names)), ""
    )
    if len(names) != 1 or not mark:
        return ""
    written = "\\t" if mark == "\t" else mark
    return (
        f"one column only, {names[0][:60]!r}; if its names are separated by {mark!r}, read it with "
        f'delimiter="{written}", or with a recipe that has the lines [table] and '
        f'delimiter = "{written}" (decimal = "," if numbers have a decimal comma)'
    )


def _parsed(
    content: bytes,
    before: int,
    width: int,
    places: Mapping[str, int],
    layout: TableRule,
    texts: set[int],
) -> pd.DataFrame:
    """Return the columns at these places: as numbers, or as texts where a cell is no number."""
    import pyarrow as pa
    import pyarrow.csv

    odd: list[Any] = []

    def skip(row: Any) -> str:
        odd.append(row)
        return "skip"

    def parse(threads: bool) -> Any:
        kinds = {str(k): pa.string() if k in texts else pa.float64() for k in places.values()}
        return pa.csv.read_csv(
            pa.BufferReader(content),
            pa.csv.ReadOptions(
                column_names=[*map(str, range(width))],
                skip_rows=before,
                encoding=layout.encoding,
                use_threads=threads,
            ),
            pa.csv.ParseOptions(
                delimiter=layout.delimiter, ignore_empty_lines=False, invalid_row_handler=skip
            ),
            pa.csv.ConvertOptions(
                include_columns=[*kinds],
                column_types=kinds,
                null_values=BLANKS,
                strings_can_be_null=False,
                decimal_point=layout.decimal,
            ),
        )

    table = None
    while table is None:
        try:
            table = parse(threads=True)
        except (pa.ArrowInvalid, UnicodeDecodeError) as error:
            column = re.search(r"In CSV column #(\d+): .* conversion error to double", str(error))
            if column:  # read its cells as texts, so that the first odd one can be named
                texts = {*texts, int(column[1])}
            elif content.count(b"\n") <= before:
                return pd.DataFrame(columns=list(places))
            else:
                _refuse_encoding(content, layout.encoding)
                raise SessionError(f"not a CSV file ({error}); write it again") from error
    if odd:
        odd.clear()
        parse(threads=False)  # which counts the rows
        row = odd[0]
        hint = "complete the row, or remove the extra commas (a decimal comma?)"
        if row.text.count('"') % 2:
            hint = "a quotation mark that opens here does not close in this line"
        cells = f"has {row.actual_columns} cells, but the first line has {width}"
        raise SessionError(f"line {row.number}: {cells}; {hint}")
    frame = table.to_pandas(split_blocks=True, self_destruct=True)
    del table
    return pd.DataFrame({name: frame[str(k)] for name, k in places.items()}, copy=False)


def _refuse_encoding(content: bytes, encoding: str) -> None:
    """Raise where a text has bytes that its encoding has not."""
    try:
        content.decode(encoding)
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        raise SessionError(
            f"line {line}: byte 0x{content[error.start]:02x} is not {encoding.upper()} text; save "
            "the file as UTF-8, or, if Windows wrote it, add to a recipe the lines [table] and "
            'encoding = "cp1252"'
        ) from None
