"""The [header] files of a recipe: tables beside the sessions that index them, one row for each."""

import csv
import io
import os
import re
from collections.abc import Mapping
from pathlib import Path

from trustlab.models.checks import did_you_mean
from trustlab.sessions.errors import SessionError, source_named
from trustlab.sessions.patterns import PathMatch
from trustlab.sessions.recipe import NUMBER, Recipe, plain_key


def _typed(text: str) -> object:
    text = text.strip()
    if re.fullmatch(r"[+-]?\d{1,15}", text, re.ASCII):
        return int(text)
    return float(text) if NUMBER.fullmatch(text) else text


class SessionIndex:
    """The header files of one recipe, each read once; path fields are the key of a row."""

    def __init__(self, recipe: Recipe):
        self.pattern, self.keys = recipe.header.file, recipe.header.keys
        self._tables: dict[str, dict[tuple, tuple[int, dict]]] = {}

    def row(self, match: PathMatch, source: str) -> Mapping[str, object]:
        """Return the row of a session, whose path is `match` and whose file is `source`."""
        path = self._path(match)
        rows = self._table(path, source)
        if self._key(match) not in rows:
            named = ", ".join(
                f"{column} {match.fields[name]}" for name, column in self.keys.items()
            )
            fault = f"the header {path} has no row for {named}"
            raise SessionError(f"{fault}; add it, or move the file out of the folder", source)
        return rows[self._key(match)][1]

    def check(self, headers: Mapping[str, PathMatch], matches: Mapping[str, PathMatch]) -> None:
        """Check that rows of the header files and session files correspond one to one."""
        used: dict[str, set] = {os.path.abspath(path): set() for path in headers}
        for path, match in matches.items():
            self.row(match, path)
            header = os.path.abspath(self._path(match))
            if header in used:  # one above the folder names sessions that are not in it
                used[header].add(self._key(match))
        for header, keys in used.items():
            for key, (line, _) in self._table(header, header).items():
                if key not in keys:
                    named = ", ".join(map(" ".join, zip(self.keys.values(), key, strict=True)))
                    fault = (
                        f"line {line}: names {named}, which has no file; add the file or "
                        "remove the row"
                    )
                    raise SessionError(fault, header)

    def _path(self, match: PathMatch) -> str:
        return os.path.join(match.base, *self.pattern.fill(match.texts).split("/"))

    def _key(self, match: PathMatch) -> tuple[str, ...]:
        return tuple(plain_key(match.fields[name]) for name in self.keys)

    def _table(self, path: str, source: str) -> dict[tuple, tuple[int, dict]]:
        """Return the rows of a header file by key, with line numbers; `source` needs it."""
        if path not in self._tables:
            try:
                text = Path(path).read_bytes().decode("utf-8-sig")
            except FileNotFoundError:
                raise SessionError(f"its header file {path} does not exist", source) from None
            except (OSError, UnicodeDecodeError) as error:
                raise SessionError(f"cannot be read as UTF-8 text ({error})", path) from error
            with source_named(path):
                self._tables[path] = self._parse(text)
        return self._tables[path]

    def _parse(self, text: str) -> dict[tuple, tuple[int, dict]]:
        reader = csv.reader(io.StringIO(text, newline=""))
        try:
            lines = [(reader.line_num, cells) for cells in reader if cells]
        except csv.Error as error:
            raise SessionError(
                f"line {reader.line_num}: not a line of a CSV file ({error})"
            ) from error
        names = [name.strip() for name in lines.pop(0)[1]] if lines else []
        for column in self.keys.values():
            if names.count(column) != 1:
                fault = (
                    "occurs twice"
                    if column in names
                    else f"is missing{did_you_mean(column, names)}"
                )
                raise SessionError(f"line 1: column {column!r} {fault}")
        rows: dict[tuple, tuple[int, dict]] = {}
        for line, cells in lines:
            if len(cells) != len(names):
                raise SessionError(
                    f"line {line}: has {len(cells)} cells, but the header names {len(names)}"
                )
            row = {name: _typed(cell) for name, cell in zip(names, cells, strict=True)}
            key = tuple(plain_key(row[column]) for column in self.keys.values())
            if "" in key:
                raise SessionError(f"line {line}: a key is empty ({', '.join(self.keys.values())})")
            if key in rows:
                raise SessionError(
                    f"line {line}: {' '.join(key)} occurs twice, first in line {rows[key][0]}"
                )
            rows[key] = (line, row)
        return rows
