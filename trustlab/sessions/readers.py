"""Read logged sessions: CSV, Parquet, ROS 1 and ROS 2 bags, and whole folders of them."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path

from trustlab.sessions.errors import RecipeError, SessionError, nearest, nearest_file
from trustlab.sessions.finishing import finish, metadata_values
from trustlab.sessions.headers import Headers, find_files
from trustlab.sessions.patterns import natural_key
from trustlab.sessions.recipes import Recipe, load_recipe, table_rule
from trustlab.sessions.resampling import check_resampling
from trustlab.sessions.rules import TableRule, plain_key
from trustlab.sessions.session import Session

__all__ = ["read_session", "read_sessions"]

_TABLES = (".csv", ".parquet")
_BAGS = (".bag", ".mcap", ".db3")


def read_session(
    path: str | os.PathLike,
    recipe: str | os.PathLike | Recipe | None = None,
    columns: Sequence[str] | None = None,
    resample: str | None = None,
    sample_time: float | None = None,
    delimiter: str | None = None,
    decimal: str | None = None,
) -> Session:
    """
    Read one logged session.

    Parameters
    ----------
    path : path-like
        A ``.csv``, ``.parquet``, ``.bag`` (ROS 1), ``.mcap`` or ``.db3`` file, or a rosbag2 folder.
    recipe : str, path-like or Recipe, optional
        How the log's columns become ours: a name from `list_recipes()`, the path of a TOML file, or a Recipe. A table
        with the vocabulary's names in SI units, and t in seconds, needs none; nor does anything `write_session`
        wrote.
    columns : sequence of str, optional
        Read these columns of the session only; all when not given.
    resample : {"previous", "linear", "nearest"}, optional
        Bring the log to a uniform time axis, within the times there are, and say so in the metadata. "linear" holds
        the previous value of mode and suggested_mode, and turns yaw the short way.
    sample_time : float, optional
        Time between samples [s] after resampling.
    delimiter, decimal : str, optional
        What separates the cells of a CSV read without a recipe ("," ";" "|" tab or space), and the decimal mark of
        its numbers ("." or ","); a comma and a point when not given. A recipe says so in its [table].

    Returns
    -------
    Session

    Raises
    ------
    SessionError
        For the first fault of the file: it says the file, the line, row or message, the column, and the remedy.
    RecipeError
        If the recipe is unknown or cannot be followed.
    """
    recipe = load_recipe(recipe) if recipe is not None else None
    check_resampling(resample, sample_time, str(path))
    return _read(path, recipe, columns, resample, sample_time, _layout(recipe, delimiter, decimal), None)


def _layout(recipe: Recipe | None, delimiter: str | None, decimal: str | None) -> TableRule:
    given = {
        name: value for name, value in (("delimiter", delimiter), ("decimal", decimal)) if value is not None
    }
    if recipe is None:
        return table_rule(given, None)
    if given:
        raise RecipeError(
            f"{next(iter(given))} is given, but a recipe says it itself, in [table]", recipe.source
        )
    return recipe.table


def _read(path, recipe, columns, resample, sample_time, layout, headers) -> Session:
    source = os.fspath(path) if isinstance(path, str | os.PathLike) else path
    if not isinstance(source, str):
        raise SessionError(f"a path is needed, got {type(path).__name__}")
    try:
        path = _existing(Path(source))
        if recipe is None:
            wanted = _names(columns, None, source)
            values = {}
        else:
            wanted = _names(columns, recipe, source)
            values = _values(recipe, path, headers)
            if resample is None:
                resample, sample_time = recipe.method, recipe.sample_time
        needed = _with_needs(recipe, wanted) if recipe else wanted
        suffix = path.suffix.lower()
        if path.is_dir() or suffix in _BAGS:
            _check_kind(recipe, "bag", source)
            if path.is_file() and path.stat().st_size == 0:
                raise SessionError("the file is empty", source)
            from trustlab.sessions.bags import read_bag

            log = read_bag(path, recipe, needed, resample, sample_time)
        elif suffix == ".csv":
            _check_kind(recipe, "table", source)
            from trustlab.sessions.csv_files import read_csv

            log = read_csv(path, recipe, needed, layout)
        else:
            _check_kind(recipe, "table", source)
            from trustlab.sessions.parquet_files import read_parquet

            log = read_parquet(path, recipe, needed)
    except OSError as error:
        raise SessionError(f"cannot be read ({error.strerror or error})", source) from error
    return finish(log, recipe, values, wanted, resample, sample_time)


def _check_kind(recipe: Recipe | None, kind: str, source: str) -> None:
    if recipe is not None and recipe.kind != kind:
        raise RecipeError(f"recipe {recipe.name!r} reads a {recipe.kind}, but this is a {kind}", source)


def _existing(path: Path) -> Path:
    """Return the path when something we can read is there."""
    source = str(path)
    try:
        there = path.exists()
    except ValueError:
        there = False
    if not there:
        looked = "" if path.is_absolute() else f" (looked in {path.parent.absolute()})"
        raise SessionError(f"there is no such file{looked}{nearest_file(path)}", source)
    if path.suffix.lower() in (".xlsx", ".xls", ".ods"):
        raise SessionError('a spreadsheet cannot be read; save it as "CSV UTF-8" and read that', source)
    if path.is_dir():
        if not (path / "metadata.yaml").is_file():
            hint = "use read_sessions for a folder of sessions"
            if any(path.glob("*.db3")) or any(path.glob("*.mcap")):
                hint += ", run `ros2 bag reindex` on a recording, or name the .db3 or .mcap file in it"
            raise SessionError(f"a folder without metadata.yaml is not a rosbag2 recording; {hint}", source)
    elif path.suffix.lower() not in (*_TABLES, *_BAGS):
        raise SessionError(
            f"cannot read {path.suffix or 'files without a suffix'}{nearest(path.suffix, (*_TABLES, *_BAGS))} "
            f"(known: {', '.join((*_TABLES, *_BAGS))}, or a rosbag2 folder)",
            source,
        )
    return path


def _names(columns: Sequence[str] | None, recipe: Recipe | None, source: str) -> list[str] | None:
    known = list(recipe.columns) if recipe else None
    if columns is None:
        return known
    if isinstance(columns, str) or not all(isinstance(name, str) for name in columns):
        raise SessionError(f"columns must be a list of names, got {columns!r}", source)
    names = [name for name in dict.fromkeys(columns) if name != "t"]
    if not names:
        raise SessionError("columns names no column besides t; name at least one, or leave it out", source)
    for name in names if known is not None else ():
        if name not in known:
            raise SessionError(
                f"the recipe has no column {name!r}{nearest(name, known)} (it has: {', '.join(known)})",
                source,
            )
    return names


def _with_needs(recipe: Recipe, wanted: Sequence[str]) -> list[str]:
    needed = dict.fromkeys(wanted)
    for name in wanted:
        needed |= dict.fromkeys(recipe.columns[name].needs)
    return list(needed)


def _values(recipe: Recipe, path: Path, headers: Headers | None) -> dict[str, object]:
    source = str(path)
    match = recipe.pattern.match(path) if recipe.pattern else None
    uses = [rule.origin for rule in recipe.metadata.values()]
    uses += [rule.key for rule in recipe.columns.values() if rule.kind == "from"]
    if recipe.pattern and match is None and any(uses):
        raise SessionError(
            f"the path does not fit the recipe's pattern {recipe.pattern.text!r}, which metadata come from; rename the "
            "file or its folder to fit it, or take what comes from the path out of the recipe's [metadata] and [columns]",
            source,
        )
    row = {}
    if recipe.header is not None and any(str(origin).startswith("header.") for origin in uses):
        row = (headers or Headers(recipe)).row(match, source)
    return metadata_values(recipe, match, row, source)


def read_sessions(
    folder: str | os.PathLike,
    recipe: str | os.PathLike | Recipe | None = None,
    *,
    columns: Sequence[str] | None = None,
    resample: str | None = None,
    sample_time: float | None = None,
    delimiter: str | None = None,
    decimal: str | None = None,
    progress: Callable[[int, int], object] | None = None,
) -> list[Session]:
    """
    Read all sessions of a folder.

    Parameters
    ----------
    folder : path-like
        With a recipe that has a files pattern: all files at any depth whose paths fit it (the folder may be any
        above them, or the one they are in). Without: all logs that stand in the folder itself.
    recipe : str, path-like or Recipe, optional
        As for `read_session`.
    columns : sequence of str, optional
        Read these columns of the sessions only.
    resample : {"previous", "linear", "nearest"}, optional
        As for `read_session`.
    sample_time : float, optional
        Time between samples [s] after resampling.
    delimiter, decimal : str, optional
        As for `read_session`.
    progress : callable, optional
        Called with the number of files read and the number there are, after each.

    Returns
    -------
    list of Session
        Ordered by participant, then trial, then path, numbers as numbers.

    Raises
    ------
    SessionError
        If nothing is found, a header names a session without a file or a file has no row in it, or a file has a
        fault.
    RecipeError
        If the recipe is unknown or cannot be followed.

    Warns
    -----
    UserWarning
        For sessions that the recipe says were superseded by others; they are left out.
    """
    recipe = load_recipe(recipe) if recipe is not None else None
    source = os.fspath(folder) if isinstance(folder, str | os.PathLike) else folder
    if not isinstance(source, str):
        raise SessionError(f"a folder is needed, got {type(folder).__name__}")
    check_resampling(resample, sample_time, source)
    try:
        is_folder = os.path.isdir(source)
    except ValueError:
        is_folder = False
    if not is_folder:
        hint = "; read a single file with read_session" if os.path.exists(source) else ""
        raise SessionError(f"there is no such folder{hint}", source)
    headers = Headers(recipe) if recipe and recipe.header else None
    paths = _matching(source, recipe, headers) if recipe and recipe.pattern else _direct(source)
    layout = _layout(recipe, delimiter, decimal)
    sessions = []
    for done, path in enumerate(paths, start=1):
        sessions.append(_read(path, recipe, columns, resample, sample_time, layout, headers))
        if progress is not None:
            progress(done, len(paths))
    return sorted(
        sessions,
        key=lambda session: (
            natural_key(session.metadata.participant),
            natural_key(session.metadata.more.get("trial")),
            natural_key(session.metadata.source),
        ),
    )


def _direct(folder: str) -> list[str]:
    paths = [os.path.join(folder, name) for name in os.listdir(folder)]
    logs = [
        path
        for path in paths
        if (os.path.isfile(path) and Path(path).suffix.lower() in (*_TABLES, *_BAGS))
        or os.path.isfile(os.path.join(path, "metadata.yaml"))
    ]
    if not logs:
        raise SessionError(
            f"no logs stand in this folder (known: {', '.join((*_TABLES, *_BAGS))}, rosbag2 folders); for logs in "
            "folders below it, give a recipe with a [files] pattern",
            folder,
        )
    return sorted(logs, key=natural_key)


def _matching(folder: str, recipe: Recipe, headers: Headers | None) -> list[str]:
    """Return the files a recipe reads in a folder, checked against each other and the headers."""
    patterns = [recipe.pattern] + ([headers.pattern] if headers else [])
    matches, *others = find_files(folder, patterns)
    if recipe.superseded:
        name = recipe.superseded_field
        present = {plain_key(match.fields[name]) for match in matches.values()}
        gone = {old: new for old, new in recipe.superseded.items() if old in present and new in present}
        for old, new in gone.items():
            warnings.warn(
                f"{folder}: the sessions of {name} {old} were superseded by those of {name} {new} (recipe "
                f"{recipe.name!r}) and are left out",
                UserWarning,
                stacklevel=3,
            )
        matches, *others = (
            {path: match for path, match in found.items() if plain_key(match.fields.get(name)) not in gone}
            for found in (matches, *others)
        )
    if not matches and not any(others):
        raise SessionError(
            f"no file at any depth of this folder fits the recipe's pattern {recipe.pattern.text!r}", folder
        )
    same: dict[tuple, str] = {}
    for path, match in matches.items():
        key = tuple(match.fields.items())
        if key in same and key:
            fields = ", ".join(f"{name} {value}" for name, value in key)
            raise SessionError(f"this file and {same[key]} are both {fields}; read one of the folders", path)
        same[key] = path
    if headers:
        headers.check(others[0], matches)
    return sorted(matches, key=natural_key)
