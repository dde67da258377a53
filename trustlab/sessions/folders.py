"""Which files of a folder are logs, and the tables beside them that say what each session is."""

import functools
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import pandas as pd

from trustlab.models.checks import did_you_mean
from trustlab.models.files import PARTIAL
from trustlab.sessions.errors import SessionError, source_named
from trustlab.sessions.patterns import PathMatch, PathPattern, natural_key
from trustlab.sessions.recipe import NUMBER, HeaderRule, plain_key
from trustlab.sessions.tables import SUFFIXES, suffix_of

# How the names begin of what is no log: of editors and systems, and of files being made.
HIDDEN = (".", "~$")


class Header:
    """The tables beside the sessions, each read once, with one row for each session."""

    def __init__(self, rule: HeaderRule):
        self.rule = rule
        self._table = functools.cache(self._read)

    def row(self, match: PathMatch) -> dict[str, object]:
        """Return the cells of a session, as "header." and the name of their column."""
        path, key = self._place(match)
        rows = self._table(path)
        if key not in rows:
            raise SessionError(
                f"the header {path} has no row for {self._words(key)}; add it, or move the file "
                "out of the folder"
            )
        return {f"header.{name}": value for name, value in rows[key].items()}

    def check(self, paths: Sequence[str], matches: Mapping[str, PathMatch]) -> None:
        """Raise unless rows of the header files and session files correspond one to one."""
        # A header above the folder names sessions that are not in it.
        used = {os.path.abspath(path): set() for path in paths if self.rule.file.match(path)}
        for path, match in matches.items():
            with source_named(path):
                self.row(match)
            header, key = self._place(match)
            used.get(header, set()).add(key)
        for header, keys in used.items():
            for key in self._table(header).keys() - keys:
                raise SessionError(
                    f"names {self._words(key)}, which has no file; add it or remove the row", header
                )

    def _words(self, key: tuple[str, ...]) -> str:
        return ", ".join(map(" ".join, zip(self.rule.keys.values(), key, strict=True)))

    def _place(self, match: PathMatch) -> tuple[str, tuple[str, ...]]:
        """Return the header file of a session, and the key of its row."""
        path = os.path.join(match.base, self.rule.file.fill(match.texts))
        return path, tuple(plain_key(match.fields[name]) for name in self.rule.keys)

    def _read(self, path: str) -> dict[tuple, dict]:
        """Return the rows of a header file by key."""
        with source_named(path):
            try:
                cells = pd.read_csv(path, dtype=str, keep_default_na=False, index_col=False)
            except (OSError, ValueError) as error:  # pandas' own errors are ValueErrors
                raise SessionError(f"this header file cannot be read ({error})") from error
            cells.columns = cells.columns.str.strip()
            for column in self.rule.keys.values():
                if list(cells.columns).count(column) != 1:
                    raise SessionError(f"needs one column {column!r}{did_you_mean(column, cells)}")
            rows = {}
            for line, values in enumerate(cells.to_dict("records"), start=2):
                row = {name: _typed(cell.strip()) for name, cell in values.items()}
                key = tuple(plain_key(row[column]) for column in self.rule.keys.values())
                if "" in key or key in rows:
                    raise SessionError(f"line {line}: {self._words(key)} is empty, or occurs twice")
                rows[key] = row
            return rows


def _typed(cell: str) -> int | float | str:
    if re.fullmatch(r"[+-]?\d{1,15}", cell, re.ASCII):
        return int(cell)
    return float(cell) if NUMBER.fullmatch(cell) else cell


def logs_in(folder: str) -> list[str]:
    """Return the logs in a folder itself."""
    # Beside the logs, a .txt file is as likely a note; a recipe's pattern can name it.
    logs = [
        str(path)
        for path in Path(folder).iterdir()
        if not path.name.startswith(HIDDEN)
        and (
            (path.is_file() and suffix_of(path) in set(SUFFIXES) - {".txt"})
            or (path / "metadata.yaml").is_file()
        )
    ]
    if not logs:
        raise SessionError(
            f"there are no logs in this folder (known: {', '.join(SUFFIXES)}, rosbag2 folders); "
            "for logs further down, give a recipe with a [files] pattern",
            folder,
        )
    return sorted(logs, key=natural_key)


def matching(folder: str, pattern: PathPattern, header: Header | None) -> list[str]:
    """Return the files whose paths fit a pattern, checked against the header files."""
    paths = list(_files(folder))
    matches = {path: match for path in paths if (match := pattern.match(path))}
    if not matches:
        raise SessionError(
            f"no file in it fits the recipe's pattern {pattern.text!r} (there are "
            f"{', '.join(paths[:3]) or 'none'} …)",
            folder,
        )
    same = {}
    for path, match in matches.items():
        key = tuple(match.fields.items())
        twin = same.setdefault(key, path)
        if key and twin != path:
            fields = ", ".join(f"{name} {value}" for name, value in key)
            raise SessionError(
                f"this file and {twin} are both {fields}; read one of the folders", path
            )
    if header:
        header.check(paths, matches)
    return sorted(matches, key=natural_key)


def _files(folder: str) -> Iterator[str]:
    """Yield the files at any depth of a folder, and its rosbag2 folders in place of their files."""
    known = []
    for here, folders, files in os.walk(folder, followlinks=True):
        if not known or os.path.islink(here):  # a link may lead to what is read elsewhere
            target = Path(here).resolve()
            if any(target.is_relative_to(each) or each.is_relative_to(target) for each in known):
                folders.clear()
                continue
            known.append(target)
        bags = [
            name for name in folders if os.path.isfile(os.path.join(here, name, "metadata.yaml"))
        ]
        folders[:] = sorted(name for name in {*folders} - {*bags} if not name.startswith(HIDDEN))
        for name in sorted([*bags, *files]):
            if PARTIAL not in name and not name.startswith(HIDDEN):
                yield os.path.join(here, name)


def external_data(name: str) -> Path | None:
    """
    Return the folder of a third-party data set, or None where it is absent.

    Parameters
    ----------
    name : str
        The data set's folder, for example "autonomy_cl_trust"; looked for in the folder that the
        environment variable TRUSTLAB_DATA names, or else in data/external of the repository.
    """
    location = os.environ.get("TRUSTLAB_DATA")
    root = Path(location) if location else Path(__file__).resolve().parents[2] / "data" / "external"
    folder = root / name
    return folder if folder.is_dir() else None
