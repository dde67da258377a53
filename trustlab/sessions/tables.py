"""Tables in CSV and Parquet files and data frames: columns as the file has them."""

import csv
import gzip
import io
import re
from codecs import BOM_UTF8
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd

from trustlab.sessions.columns import BLANKS, Table
from trustlab.sessions.errors import SessionError, alternatives, damage_named
from trustlab.sessions.recipe import NUMBER, TableRule
from trustlab.sessions.session import Metadata, metadata_from_json
from trustlab.sessions.vocabulary import known_column

# Suffixes of the files that can be read; a rosbag2 recording may also be a folder.
TEXTS = (".csv", ".csv.gz", ".tsv", ".tsv.gz", ".txt")
BAGS = (".bag", ".mcap", ".db3")
SUFFIXES = (*TEXTS, ".parquet", *BAGS)

# The start of the first line of a CSV file whose rest is metadata.
COMMENT = "# trustlab "

# How a line begins that stands before the names; the second is Excel's.
COMMENTS = ("#", "sep=")

# The bytes at the start and the end of a text that show how it is written.
HEAD = 1 << 20

# The columns to read: the session's name of each, to its name or number in the file. None stands
# for all columns of a file whose names are those of the vocabulary.
Chosen = Mapping[str, str | int] | None


def suffix_of(path: Path) -> str:
    """Return the end of a file's name that says its format: ".csv", ".csv.gz" and so on."""
    return "".join(path.suffixes[-2 if path.suffix.lower() == ".gz" else -1 :]).lower()


def positions(chosen: Chosen, titles: Sequence[str]) -> dict[str, int]:
    """Return where the chosen columns stand in a file, by the session's name of each."""
    if chosen is None:
        for name in titles:
            if NUMBER.fullmatch(name):
                raise SessionError(
                    "found numbers instead of column names; add a line of names, or a recipe with "
                    "the lines [table] and header = false"
                )
            if name != "t":
                known_column(name)
        chosen = {name: name for name in ("t", *titles)}
    places = {}
    for name, column in chosen.items():
        title = str(column)  # columns without names have numbers, as in streams of XDF
        if titles.count(title) != 1:
            fault = "occurs twice; rename or remove one"
            if title not in titles:
                hint = "; time needs the name t" if title == "t" else ""
                fault = f"is missing{hint}{alternatives(title, titles, 'there are')}"
            use = "" if title == name else f" (for {name})"
            raise SessionError(f"column {column!r}{use} {fault}")
        places[name] = titles.index(title)
    return places


def read_parquet(path: Path, chosen: Chosen) -> Table:
    """Return the table in a Parquet file."""
    import pyarrow.parquet as pq

    with damage_named("not a table of this format, or a damaged one", "copy or write it again"):
        schema = pq.read_schema(path)
        places = positions(chosen, schema.names)
        content = pq.read_table(path, columns=[*{schema.names[k]: k for k in places.values()}])
        content.validate(full=True)
        frame = content.to_pandas(ignore_metadata=True)
    frame = pd.DataFrame({name: frame[schema.names[k]] for name, k in places.items()}, copy=False)
    text = (schema.metadata or {}).get(b"trustlab")
    metadata = metadata_from_json(text.decode("utf-8", "replace"))[0] if text else Metadata()
    return Table(frame, "row {} (from 0)".format, metadata)


def frame_table(frame: pd.DataFrame, chosen: Chosen) -> Table:
    """Return the table in a data frame; an index with a name is a column as well."""
    index = frame.index.name
    if index is not None and index in frame:
        raise SessionError(f"{index!r} is both index and column; frame.reset_index(drop=True)")
    frame = frame.reset_index(drop=index is None)
    places = positions(chosen, [str(name) for name in frame.columns])
    columns = {name: frame.iloc[:, place].copy() for name, place in places.items()}
    frame = pd.DataFrame(columns, copy=False)
    return Table(frame, "row {} (from 0)".format)


def read_csv(path: Path, chosen: Chosen, layout: TableRule, texts: Collection[str]) -> Table:
    """Return the table in a text file; `texts` are columns that no numbers are made of here."""
    usual = "\t" if suffix_of(path).startswith(".tsv") else ","
    layout = replace(layout, delimiter=layout.delimiter or usual)
    source: bytes | Path = path
    if path.suffix.lower() == ".gz":
        with damage_named("not a gzip file, or a damaged or truncated one", "copy it again"):
            source = gzip.decompress(path.read_bytes())
    if layout.delimiter == " ":  # a run of which separates once
        with _opened(source) as file:
            spaced = re.sub(rb" {2,}", b" ", file.read())
        source = re.sub(rb"(?m)^ +| +(?=\r?$)", b"", spaced)
    with _opened(source) as file:
        head = io.BytesIO(file.read(HEAD).removeprefix(BOM_UTF8))
        file.seek(max(0, file.size() - HEAD))
        end = file.read()
    lines = [*io.TextIOWrapper(head, layout.encoding, "surrogateescape", newline="")] or [""]
    before, metadata = layout.skip_lines, Metadata()
    if lines[0].startswith(COMMENT) and not before:
        before, metadata = 1, metadata_from_json(lines[0][len(COMMENT) :])[0]
    try:
        rows = csv.reader(lines[before:], delimiter=layout.delimiter)
        names = [name.strip() for name in next(rows, [])]
        titles = names if layout.header else [*map(str, range(len(names)))]
        places = positions(chosen, titles)
    except (SessionError, csv.Error) as error:
        refuse_encoding(source, layout.encoding)
        fault = f"a quotation mark that opens here does not close ({error})"
        if isinstance(error, SessionError):
            fault = _layout_fault(names, layout) or str(error)
        raise SessionError(f"line {before + 1}: {fault}") from error
    before += rows.line_num * layout.header  # a name may have a line break
    frame = _parsed(source, before, len(names), places, layout, {places[name] for name in texts})
    ends = end[len(end.rstrip(b"\r\n")) :]
    empty = max(ends.count(b"\n") or ends.count(b"\r"), 1) - 1
    cut = "has no end; the file may have been cut short in it"
    notes: dict[str, object] = {} if ends else {"last line": cut}
    place = lambda row: f"line {before + 1 + row}"  # noqa: E731
    return Table(frame.iloc[: len(frame) - empty], place, metadata, notes)


def _opened(source: bytes | Path) -> Any:
    """Return a text to read, in memory or in a file, as Arrow's readers take it."""
    import pyarrow as pa

    return pa.BufferReader(source) if isinstance(source, bytes) else pa.OSFile(str(source))


def _layout_fault(names: Sequence[str], layout: TableRule) -> str:
    """Say what the line of names shows of a table that is written in another way; else nothing."""
    if not "".join(names):
        return "is empty; the names of the columns or the first row should be here"
    if names[0].startswith(COMMENTS):
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
    source: bytes | Path,
    before: int,
    width: int,
    places: Mapping[str, int],
    layout: TableRule,
    texts: set[int],
) -> pd.DataFrame:
    """Return the columns at these places: as numbers, or as texts where a cell is no number."""
    import pyarrow as pa
    import pyarrow.csv

    def read(texts: Collection[int], threads: bool) -> pa.Table:
        kinds = {str(k): pa.string() if k in texts else pa.float64() for k in places.values()}
        return pa.csv.read_csv(
            _opened(source),
            pa.csv.ReadOptions(
                column_names=[*map(str, range(width))],
                skip_rows=before,
                encoding=layout.encoding,
                use_threads=threads,
            ),
            pa.csv.ParseOptions(delimiter=layout.delimiter, ignore_empty_lines=False),
            pa.csv.ConvertOptions(
                include_columns=[*kinds],
                column_types=kinds,
                null_values=BLANKS,
                strings_can_be_null=False,
                decimal_point=layout.decimal,
            ),
        )

    try:
        table = read(texts, True)
    except (pa.ArrowInvalid, UnicodeDecodeError):
        # Cells as texts, so that the first odd one can be named; one thread alone counts the rows.
        texts = {*places.values()}
        try:
            table = read(texts, False)
        except (pa.ArrowInvalid, UnicodeDecodeError) as error:
            fault = str(error)
            if "Empty CSV" in fault or "Could not skip" in fault:
                return pd.DataFrame(columns=list(places))
            refuse_encoding(source, layout.encoding)
            raise SessionError(_ragged(fault)) from error

    frame = table.to_pandas()
    return pd.DataFrame({name: frame[str(k)] for name, k in places.items()}, copy=False)


def _ragged(fault: str) -> str:
    """Return in our words what Arrow says of a row with too many or too few cells."""
    row = re.search(r"Row #(\d+): Expected (\d+) columns, got (\d+): (.*)", fault, re.DOTALL)
    if not row:
        return f"not a CSV file ({fault.splitlines()[0][:200]}); write it again"
    line, width, cells, text = row.groups()
    hint = "complete the row, or remove the extra commas (a decimal comma?)"
    if text.count('"') % 2:
        hint = "a quotation mark that opens here does not close in this line"
    return f"line {line}: has {cells} cells, but the first line has {width}; {hint}"


def refuse_encoding(source: bytes | Path, encoding: str) -> None:
    """Raise where a text has bytes that its encoding has not."""
    content = _opened(source).read()
    if b"\0" in content[:HEAD]:
        raise SessionError("this is UTF-16 or no text at all; save the file as UTF-8")
    try:
        content.decode(encoding)
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        raise SessionError(
            f"line {line}: byte 0x{content[error.start]:02x} is not {encoding.upper()} text; save "
            "the file as UTF-8, or, if Windows wrote it, add to a recipe the lines [table] and "
            'encoding = "cp1252"'
        ) from None
