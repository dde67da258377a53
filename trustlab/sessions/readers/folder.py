"""Read all sessions of a folder: which files belong to it, and whether they are complete."""

import os
import warnings
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import pandas as pd

from trustlab.models.checks import one_of
from trustlab.sessions.errors import SessionError
from trustlab.sessions.patterns import PathMatch, PathPattern, natural_key
from trustlab.sessions.readers.file import SUFFIXES, FileReader, suffix_of
from trustlab.sessions.readers.index import SessionIndex
from trustlab.sessions.recipe import Recipe, plain_key
from trustlab.sessions.session import Session

# How the names of folders begin in which files are made.
TEMPORARY = ".trustlab-"


class Sessions(list):
    """
    A list of sessions, and what was left out when they were read.

    Parameters
    ----------
    sessions : iterable of Session
        What was read.
    faults : pandas.DataFrame
        Columns file and error: one row for each file left out.
    """

    def __init__(self, sessions: Iterable[Session], faults: pd.DataFrame):
        super().__init__(sessions)
        self.faults = faults


def read_sessions(
    folder: str | os.PathLike,
    recipe: str | os.PathLike | Recipe | None = None,
    *,
    on_error: str = "raise",
    progress: Callable[[int, int], object] | None = None,
    max_bytes: int | None = None,
    columns: Sequence[str] | None = None,
    resample: str | None = None,
    sample_time: float | None = None,
    delimiter: str | None = None,
    decimal: str | None = None,
) -> Sessions:
    """
    Read all sessions of a folder.

    Parameters
    ----------
    folder : path-like
        With a recipe that has a files pattern: all files at any depth whose paths fit it (the folder may be any folder
        above them, or the one they are in). Without: all logs in the folder itself.
    recipe : str, path-like or Recipe, optional
        As for `read_session`.
    on_error : {"raise", "collect"}
        What to do about a file that has a fault: raise it, or leave the file out and list it in the result's `faults`.
    progress : callable, optional
        Called after each file with the number of files read and the number of all.
    max_bytes : int, optional
        As for `read_session`; for each file.
    columns : sequence of str, optional
        Read only these columns of the sessions.
    resample : {"previous", "linear", "nearest"}, optional
        As for `read_session`.
    sample_time : float, optional
        Time between samples [s] after resampling.
    delimiter, decimal : str, optional
        As for `read_session`; they apply to the CSV files of the folder.

    Returns
    -------
    Sessions
        A list, ordered by participant, then trial, then path, numbers as numbers; its attribute `faults` is a table of
        the files left out, with columns file and error.

    Raises
    ------
    SessionError
        If nothing is found, if the rows of a header file and the files do not correspond one to one, or if a file has
        a fault.
    RecipeError
        If the recipe is unknown or cannot be followed.
    ValueError
        If another argument is not valid, or applies to none of the files.

    Warns
    -----
    UserWarning
        For sessions that the recipe declares superseded by others; they are left out.

    Examples
    --------
    >>> import trustlab as tl
    >>> sessions = tl.read_sessions("data/sessions")
    >>> [session.metadata.participant for session in sessions]
    ['pilot', '1', '2', '3', '4', '5']
    """
    one_of("on_error", on_error, ("raise", "collect"))
    reader = FileReader(recipe, columns, resample, sample_time, delimiter, decimal, max_bytes)
    source = os.fspath(folder) if isinstance(folder, str | os.PathLike) else folder
    if not isinstance(source, str):
        raise SessionError(f"a folder is needed, got {type(folder).__name__}")
    if not os.path.isdir(source):
        hint = "; read a single file with read_session" if os.path.exists(source) else ""
        raise SessionError(f"there is no such folder{hint}", source)
    has_pattern = reader.recipe is not None and reader.recipe.pattern is not None
    paths = _matching(source, reader.recipe, reader.index) if has_pattern else _logs_in(source)
    reader.set_layout(paths)
    sessions, faults = [], []
    for done, path in enumerate(paths, start=1):
        try:
            sessions.extend(reader.read(path))
        except SessionError as error:
            if on_error == "raise":
                raise
            faults.append((path, str(error)))
        if progress is not None:
            progress(done, len(paths))

    def order(session: Session) -> list[tuple]:
        facts = session.metadata
        keys = (facts.participant, facts.more.get("trial"), facts.source, facts.more.get("part"))
        return [natural_key(key) for key in keys]

    return Sessions(sorted(sessions, key=order), pd.DataFrame(faults, columns=["file", "error"]))


def _logs_in(folder: str) -> list[str]:
    logs = []
    for name in os.listdir(folder):
        path = os.path.join(folder, name)
        # Beside the logs, a .txt file is as likely a note; a recipe's pattern can name it.
        is_log = os.path.isfile(path) and suffix_of(Path(path)) in set(SUFFIXES) - {".txt"}
        if is_log or os.path.isfile(os.path.join(path, "metadata.yaml")):
            logs.append(path)
    if not logs:
        what = f"there are no logs in this folder (known: {', '.join(SUFFIXES)}, rosbag2 folders)"
        raise SessionError(f"{what}; for logs further down, give a recipe with a [files] pattern", folder)
    return sorted(logs, key=natural_key)


def _matching(folder: str, recipe: Recipe, index: SessionIndex | None) -> list[str]:
    """Return the files that a recipe reads in a folder, checked against each other and against the header files."""
    sessions = _find(folder, recipe.pattern)
    headers = _find(folder, index.pattern) if index else {}
    if recipe.supersedes:
        gone = _superseded(folder, recipe, sessions)
        kept = lambda item: plain_key(item[1].fields.get(recipe.supersedes.field)) not in gone  # noqa: E731
        sessions, headers = dict(filter(kept, sessions.items())), dict(filter(kept, headers.items()))
    if not sessions and not headers:
        raise SessionError(f"no file in it fits the recipe's pattern {recipe.pattern.text!r}", folder)
    same: dict[tuple, str] = {}
    for path, match in sessions.items():
        key = tuple(match.fields.items())
        other = same.setdefault(key, path)
        if key and other != path:
            fields = ", ".join(f"{name} {value}" for name, value in key)
            raise SessionError(f"this file and {other} are both {fields}; read one of the folders", path)
    if index:
        index.check(headers, sessions)
    return sorted(sessions, key=natural_key)


def _superseded(folder: str, recipe: Recipe, sessions: dict[str, PathMatch]) -> set[str]:
    """Return the values of the path field whose sessions are left out, as those that replace them are there."""
    name = recipe.supersedes.field
    present = {plain_key(match.fields[name]) for match in sessions.values()}
    gone = {old: new for old, new in recipe.supersedes.pairs.items() if old in present and new in present}
    for old, new in gone.items():
        what = f"the sessions of {name} {old} were superseded by those of {name} {new}"
        warnings.warn(f"{folder}: {what} (recipe {recipe.name!r}) and are left out", stacklevel=4)
    return set(gone)


def _find(folder: str, pattern: PathPattern) -> dict[str, PathMatch]:
    """Return the files and rosbag2 folders at any depth of a folder whose paths fit a pattern."""
    found: dict[str, PathMatch] = {}
    for here, folders, files in os.walk(folder):
        folders[:] = sorted(name for name in folders if not name.startswith(TEMPORARY))
        bags = [name for name in folders if os.path.isfile(os.path.join(here, name, "metadata.yaml"))]
        folders[:] = [name for name in folders if name not in bags]  # what is inside a bag is not searched
        for name in sorted([*bags, *files]):
            path = os.path.join(here, name)
            match = pattern.match(path)
            if match is not None:
                found[path] = match
    return found
