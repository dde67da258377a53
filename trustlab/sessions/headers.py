"""Header files: a table beside the sessions with one row for each."""

from __future__ import annotations

import csv
import io
import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

from trustlab.sessions.errors import SessionError, nearest
from trustlab.sessions.patterns import PathMatch, PathPattern
from trustlab.sessions.recipes import Recipe
from trustlab.sessions.rules import NUMBER, plain_key

__all__ = ["Headers", "find_files"]


def _typed(text: str) -> object:
    text = text.strip()
    if re.fullmatch(r"[+-]?\d{1,15}", text, re.ASCII):
        return int(text)
    return float(text) if NUMBER.fullmatch(text) else text


class Headers:
    """
    The header files of one recipe, each read once.

    Parameters
    ----------
    recipe : Recipe
        A recipe with a header.
    """

    def __init__(self, recipe: Recipe):
        self.rule = recipe.header
        self.pattern = PathPattern(recipe.header.file, recipe.source)
        self._tables: dict[str, dict[tuple, tuple[int, dict]]] = {}

    def path(self, match: PathMatch) -> str:
        """
        Return where the header of a session should be.

        Parameters
        ----------
        match : PathMatch
            The session's path.
        """
        return os.path.join(match.base, *self.pattern.fill(match.texts).split("/"))

    def key(self, match: PathMatch) -> tuple:
        """
        Return what the row of a session is found by.

        Parameters
        ----------
        match : PathMatch
            The session's path.
        """
        return tuple(plain_key(match.fields[name]) for name in self.rule.keys)

    def row(self, match: PathMatch, source: str) -> Mapping[str, object]:
        """
        Return the header's row of a session.

        Parameters
        ----------
        match : PathMatch
            The session's path.
        source : str
            The session's file, for the error.

        Raises
        ------
        SessionError
            If there is no header, it is damaged, or has no such row.
        """
        path = self.path(match)
        rows = self.table(path, source)
        if self.key(match) not in rows:
            named = ", ".join(f"{column} {match.fields[name]}" for name, column in self.rule.keys.items())
            raise SessionError(
                f"the header {path} has no row for {named}; add it, or move the file out of the folder",
                source,
            )
        return rows[self.key(match)][1]

    def table(self, path: str, source: str | None = None) -> dict[tuple, tuple[int, dict]]:
        """
        Return the rows of a header: key to line number and cells.

        Parameters
        ----------
        path : str
            The header file.
        source : str, optional
            The session that needs it, for the error.

        Raises
        ------
        SessionError
            If it is not there, not a CSV file, a key column is missing, or a row is ragged, without key or there twice.
        """
        if path in self._tables:
            return self._tables[path]
        try:
            text = Path(path).read_bytes().decode("utf-8-sig")
        except FileNotFoundError:
            raise SessionError(f"its header {path} is not there", source or path) from None
        except (OSError, UnicodeDecodeError) as error:
            raise SessionError(f"cannot be read as UTF-8 text ({error})", path) from error
        reader = csv.reader(io.StringIO(text, newline=""))
        rows: dict[tuple, tuple[int, dict]] = {}
        try:
            names = [name.strip() for name in next(reader, [])]
            for column in self.rule.keys.values():
                if names.count(column) != 1:
                    what = "is there twice" if column in names else f"is missing{nearest(column, names)}"
                    raise SessionError(f"line 1: column {column!r} {what}", path)
            for cells in reader:
                line = reader.line_num
                if not cells:
                    continue
                if len(cells) != len(names):
                    raise SessionError(
                        f"line {line}: has {len(cells)} cells where the header names {len(names)}", path
                    )
                row = {name: _typed(cell) for name, cell in zip(names, cells, strict=True)}
                key = tuple(plain_key(row[column]) for column in self.rule.keys.values())
                if "" in key:
                    raise SessionError(
                        f"line {line}: a key is empty ({', '.join(self.rule.keys.values())})", path
                    )
                if key in rows:
                    raise SessionError(
                        f"line {line}: {' '.join(key)} is there twice, first in line {rows[key][0]}", path
                    )
                rows[key] = (line, row)
        except csv.Error as error:
            raise SessionError(f"line {reader.line_num}: not a line of a CSV file ({error})", path) from error
        self._tables[path] = rows
        return rows

    def check(self, headers: Mapping[str, PathMatch], matches: Mapping[str, PathMatch]) -> None:
        """
        Raise unless headers and files name each other.

        Parameters
        ----------
        headers : mapping
            Header files that were found.
        matches : mapping
            Session files that were found.

        Raises
        ------
        SessionError
            If a header names a session without a file, or a file has no row or no header.
        """
        found: dict[str, set] = {os.path.abspath(path): set() for path in headers}
        for path, match in matches.items():
            header = os.path.abspath(self.path(match))
            if header not in found:
                raise SessionError(f"its header {header} is not there", path)
            self.row(match, path)
            found[header].add(self.key(match))
        for header, keys in found.items():
            for key, (line, _) in self.table(header).items():
                if key not in keys:
                    named = ", ".join(
                        f"{column} {value}"
                        for column, value in zip(self.rule.keys.values(), key, strict=True)
                    )
                    raise SessionError(
                        f"line {line}: names {named}, which has no file; bring the file or take the row out",
                        header,
                    )


def find_files(folder: str, patterns: Sequence[PathPattern]) -> list[dict[str, PathMatch]]:
    """
    Return, for each pattern, the files and rosbag2 folders at any depth of a folder whose paths fit it.

    Parameters
    ----------
    folder : str
        Where to look.
    patterns : sequence of PathPattern
        What to look for.
    """
    found: list[dict[str, PathMatch]] = [{} for _ in patterns]
    for here, folders, files in os.walk(folder):
        folders.sort()
        bags = [name for name in folders if os.path.isfile(os.path.join(here, name, "metadata.yaml"))]
        folders[:] = [name for name in folders if name not in bags]
        for name in sorted([*bags, *files]):
            path = os.path.join(here, name)
            for matches, pattern in zip(found, patterns, strict=True):
                match = pattern.match(path)
                if match is not None:
                    matches[path] = match
    return found
