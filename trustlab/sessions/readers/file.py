"""Read logged sessions: one, all of a folder, a data frame, or several logs of one run joined."""

import difflib
import os
import re
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path

import pandas as pd

from trustlab.models.checks import of_class, one_of, whole_number
from trustlab.models.files import PARTIAL
from trustlab.sessions.errors import (
    RecipeError,
    SessionError,
    alternatives,
    nearest_file,
    source_named,
)
from trustlab.sessions.metadata import Metadata
from trustlab.sessions.patterns import PathMatch, PathPattern, natural_key
from trustlab.sessions.readers.assembly import assemble_session, parts_of, recipe_values
from trustlab.sessions.readers.bags import read_bag, read_topics
from trustlab.sessions.readers.csv_files import read_csv
from trustlab.sessions.readers.index import SessionIndex
from trustlab.sessions.readers.limits import budget_of
from trustlab.sessions.readers.tables import frame_log, read_arrays, read_feather, read_parquet
from trustlab.sessions.recipe import (
    Recipe,
    TableRule,
    asked_resampling,
    load_recipe,
    parse,
)
from trustlab.sessions.resampling import RawLog, Stream
from trustlab.sessions.session import Session

_TEXTS = (".csv", ".csv.gz", ".tsv", ".tsv.gz", ".txt")
_ARRAYS = (".mat", ".h5", ".hdf5")
_TABLES = (*_TEXTS, ".parquet", ".feather", *_ARRAYS)
_BAGS = (".bag", ".mcap", ".db3", ".ulg", ".xdf")
# Suffixes of the files that can be read; a rosbag2 recording may also be a folder.
SUFFIXES = (*_TABLES, *_BAGS)

# How the names of folders begin in which files are made.
TEMPORARY = ".trustlab-"


def read_session(
    path: str | os.PathLike,
    recipe: str | os.PathLike | Recipe | None = None,
    columns: Sequence[str] | None = None,
    resample: str | None = None,
    sample_time: float | None = None,
    delimiter: str | None = None,
    decimal: str | None = None,
    max_bytes: int | None = None,
) -> Session:
    """
    Read one logged session.

    Parameters
    ----------
    path : path-like
        A ``.csv``, ``.csv.gz``, ``.tsv`` or ``.txt`` table, a ``.parquet``, ``.feather``, ``.bag``
        (ROS 1), ``.mcap`` or ``.db3`` file, or a rosbag2 folder; with the extra [formats] also
        ``.ulg`` (PX4), ``.xdf`` (lab streaming layer), ``.mat``, ``.h5`` and ``.hdf5``.
    recipe : str, path-like or Recipe, optional
        How the log's columns become ours: a name from `list_recipes()`, the path of a TOML file, or
        a Recipe. A table with the vocabulary's names in SI units, and t in seconds, needs none; nor
        does anything that `write_session` wrote.
    columns : sequence of str, optional
        Read only these columns of the session; all when not given.
    resample : {"previous", "linear", "nearest"}, optional
        Bring the log to a uniform time axis, within the times it covers, and record it in the
        metadata. "linear" holds the previous value of mode and suggested_mode, and turns yaw the
        short way.
    sample_time : float, optional
        Time between samples [s] after resampling.
    delimiter, decimal : str, optional
        The separator of the cells of a text table read without a recipe ("," ";" "|" tab or space),
        and the decimal mark of its numbers ("." or ","); a comma (in .tsv files a tab) and a point
        when not given. A recipe states them in its [table]; other formats have neither.
    max_bytes : int, optional
        How many bytes a compressed file may unpack to; 256 MiB, or ten times its size if that is
        more, when not given.

    Returns
    -------
    Session

    Raises
    ------
    SessionError
        For the first fault of the file: it names the file, the line, row or message, the column,
        and the remedy.
    RecipeError
        If the recipe is unknown or cannot be followed.
    ValueError
        If another argument is not valid, or does not apply to the file's format.

    Examples
    --------
    >>> import trustlab as tl
    >>> session = tl.read_session("data/sessions/pilot.csv")
    >>> session.columns, session.sample_time
    (['mode', 'p_r', 'p_h'], 0.1)
    """
    reader = FileReader(recipe, columns, resample, sample_time, delimiter, decimal, max_bytes)
    reader.set_layout([path])
    return _only(reader.read(path), str(path))


def read_frame(
    frame: pd.DataFrame,
    recipe: str | os.PathLike | Recipe | None = None,
    columns: Sequence[str] | None = None,
    resample: str | None = None,
    sample_time: float | None = None,
) -> Session:
    """
    Return the session in a data frame, by the same recipes and rules as `read_session`.

    Parameters
    ----------
    frame : pandas.DataFrame
        A table as a file would hold it; an index with a name is a column as well.
    recipe : str, path-like or Recipe, optional
        How its columns become ours, of kind "table"; a frame with the vocabulary's names in SI
        units, and t, needs none.
    columns : sequence of str, optional
        Only these columns of the session.
    resample : {"previous", "linear", "nearest"}, optional
        As for `read_session`.
    sample_time : float, optional
        Time between samples [s] after resampling.

    Raises
    ------
    SessionError
        For the first fault: it names the row, the column and the remedy.
    ValueError
        If another argument is not valid.

    Examples
    --------
    >>> import pandas as pd
    >>> import trustlab as tl
    >>> frame = pd.DataFrame({"t": [0.0, 0.1, 0.2], "mode": [1, 1, 0], "p_r": [0.30, 0.31, 0.31]})
    >>> tl.read_frame(frame).duration
    0.2
    """
    of_class("frame", frame, pd.DataFrame)
    reader = FileReader(recipe, columns, resample, sample_time, None, None, None)
    with source_named("data frame"):
        return _only(reader.read_frame(frame), "data frame")


def _only(sessions: list[Session], source: str) -> Session:
    """Return the only session of a log."""
    if len(sessions) != 1:
        fault = f"the recipe splits the log at gaps into {len(sessions)} sessions"
        raise SessionError(f"{fault}; read_sessions returns all of a folder's", source)
    return sessions[0]


def suffix_of(path: Path) -> str:
    """Return the end of a file's name that says its format: ".csv", ".csv.gz" and so on."""
    return "".join(path.suffixes[-2 if path.suffix.lower() == ".gz" else -1 :]).lower()


class FileReader:
    """The arguments of `read_session`, checked, for one file or for many."""

    def __init__(self, recipe, columns, resample, sample_time, delimiter, decimal, max_bytes):
        self.max_bytes = None if max_bytes is None else whole_number("max_bytes", max_bytes)
        self.recipe = None if recipe is None else load_recipe(recipe)
        stated = self.recipe.resampling if self.recipe else None
        self.columns, self.resampling = columns, asked_resampling(resample, sample_time) or stated
        layout = {"delimiter": delimiter, "decimal": decimal}
        self.separators = {name: value for name, value in layout.items() if value is not None}
        if self.separators and self.recipe is not None:
            name = next(iter(self.separators))
            raise RecipeError(
                f"{name} is given beside a recipe, which states it: give it the lines [table] and "
                f"{name} = {self.separators[name]!r}",
                self.recipe.source,
            )
        self.index = SessionIndex(self.recipe) if self.recipe and self.recipe.header else None

    def set_layout(self, paths: Sequence[str | os.PathLike]) -> None:
        """Set how CSV files are written; refuse the arguments where no file is one."""
        if self.separators and not any(str(path).lower().endswith(_TEXTS) for path in paths):
            name = next(iter(self.separators))
            kind = suffix_of(Path(str(paths[0]))) or "folders"
            raise ValueError(
                f"{name} applies to .csv files, not to {kind}: leave it out (file: {paths[0]})"
            )
        self.layout = (
            self.recipe.table if self.recipe else parse(TableRule, self.separators, "arguments")
        )

    def read(self, path: str | os.PathLike) -> list[Session]:
        """Return the sessions of one file or rosbag2 folder: one, unless the recipe splits it."""
        source = os.fspath(path) if isinstance(path, str | os.PathLike) else path
        if not isinstance(source, str):
            raise SessionError(f"a path is needed, got {type(path).__name__}")
        with source_named(source):
            try:
                path = _existing(Path(source))
                values = recipe_values(self.recipe, path, self.index)
                log = self._raw_log(path)
            except OSError as error:
                raise SessionError(f"cannot be read ({error.strerror or error})") from error
        return self._sessions(log, values)

    def read_frame(self, frame: pd.DataFrame) -> list[Session]:
        """Return the session in a data frame, or all that the recipe splits it into."""
        self._check_kind("table")
        values = recipe_values(self.recipe, None, self.index)
        log = frame_log(frame, self.recipe, self._needed())
        return self._sessions(log, values)

    def _sessions(self, log: RawLog, values: Mapping[str, object]) -> list[Session]:
        """Return the sessions that a raw log makes."""
        selection = self._selection()
        return [
            assemble_session(part, self.recipe, values, selection, self.resampling)
            for part in parts_of(log, self.recipe)
        ]

    def _check_kind(self, kind: str) -> None:
        if self.recipe is not None and self.recipe.kind != kind:
            raise RecipeError(
                f"recipe {self.recipe.name!r} reads a {self.recipe.kind}, but this is a {kind}"
            )

    def _needed(self) -> list[str] | None:
        """Return the selected columns, and those that they are computed from."""
        selection = self._selection()
        if self.recipe is None:
            return selection
        needs = [need for name in selection for need in self.recipe.columns[name].needs]
        return list(dict.fromkeys([*selection, *needs]))

    def _raw_log(self, path: Path) -> RawLog:
        suffix = suffix_of(path)
        kind = "bag" if path.is_dir() or suffix in _BAGS else "table"
        self._check_kind(kind)
        needed = self._needed()
        if path.is_file() and path.stat().st_size == 0:
            raise SessionError("the file is empty")
        budget = budget_of(path, self.max_bytes)
        # Each reader imports what it reads with when it is called: rosbags and pyarrow are heavy.
        if suffix in (".ulg", ".xdf"):
            return read_topics(path, self.recipe, needed)
        if suffix in _ARRAYS:
            return read_arrays(path, self.recipe, needed, budget)
        if kind == "bag":
            return read_bag(path, self.recipe, needed, budget)
        if suffix in _TEXTS:
            return read_csv(path, self.recipe, needed, self.layout, budget)
        read = read_parquet if suffix == ".parquet" else read_feather
        return read(path, self.recipe, needed, budget)

    def _selection(self) -> list[str] | None:
        """Return the session's columns to read; None for all of a file without a recipe."""
        known = list(self.recipe.columns) if self.recipe else None
        if self.columns is None:
            return known
        if isinstance(self.columns, str) or not all(isinstance(name, str) for name in self.columns):
            raise SessionError(f"columns must be a list of names, got {self.columns!r}")
        names = [name for name in dict.fromkeys(self.columns) if name != "t"]
        if not names:
            raise SessionError(
                "columns names no column besides t; name at least one, or leave it out"
            )
        for name in names:
            if known is not None and name not in known:
                raise SessionError(
                    f"the recipe has no column {name!r}{alternatives(name, known, 'it has')}"
                )
        return names


def _existing(path: Path) -> Path:
    """Return the path when something that can be read is there."""
    if not path.exists():
        looked = "" if path.is_absolute() else f" (looked in {path.parent.absolute()})"
        raise SessionError(f"there is no such file{looked}{nearest_file(path)}")
    if path.suffix.lower() in (".xlsx", ".xls", ".ods"):
        way = "frame = pandas.read_excel(path); session = trustlab.read_frame(frame)"
        raise SessionError(
            'a spreadsheet cannot be read; save it as "CSV UTF-8" and read that, or with pandas: '
            f"{way}"
        )
    if path.is_dir():
        if not (path / "metadata.yaml").is_file():
            hint = "use read_sessions for a folder of sessions"
            if any(path.glob("*.db3")) or any(path.glob("*.mcap")):
                hint += (
                    ", run `ros2 bag reindex` on a recording, or name the .db3 or .mcap file in it"
                )
            raise SessionError(f"a folder without metadata.yaml is not a rosbag2 recording; {hint}")
    elif suffix_of(path) not in SUFFIXES:
        hint = alternatives(path.suffix, [*SUFFIXES, "rosbag2 folders"])
        way = "frame = pandas.read_…(path); session = trustlab.read_frame(frame)"
        raise SessionError(
            f"cannot read {path.suffix or 'files without a suffix'}{hint}; with pandas: {way}"
        )
    return path


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
        With a recipe that has a files pattern: all files at any depth whose paths fit it (the
        folder may be any folder above them, or the one they are in). Without: all logs in the
        folder itself.
    recipe : str, path-like or Recipe, optional
        As for `read_session`.
    on_error : {"raise", "collect"}
        What to do about a file that has a fault: raise it, or leave the file out and list it in the
        result's `faults`.
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
        A list, ordered by participant, then trial, then path, numbers as numbers; its attribute
        `faults` is a table of the files left out, with columns file and error.

    Raises
    ------
    SessionError
        If nothing is found, if the rows of a header file and the files do not correspond one to
        one, or if a file has a fault.
    RecipeError
        If the recipe is unknown or cannot be followed.
    ValueError
        If another argument is not valid, or applies to none of the files.

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
        fault = f"there are no logs in this folder (known: {', '.join(SUFFIXES)}, rosbag2 folders)"
        raise SessionError(
            f"{fault}; for logs further down, give a recipe with a [files] pattern", folder
        )
    return sorted(logs, key=natural_key)


def _matching(folder: str, recipe: Recipe, index: SessionIndex | None) -> list[str]:
    """Return the files that a recipe reads in a folder, checked against the header files."""
    sessions = _find(folder, recipe.pattern)
    headers = _find(folder, index.pattern) if index else {}
    if not sessions and not headers:
        raise SessionError(
            f"no file in it fits the recipe's pattern {recipe.pattern.text!r}"
            f"{_nearly_fitting(folder, recipe.pattern)}",
            folder,
        )
    same: dict[tuple, str] = {}
    for path, match in sessions.items():
        key = tuple(match.fields.items())
        twin = same.setdefault(key, path)
        if key and twin != path:
            fields = ", ".join(f"{name} {value}" for name, value in key)
            raise SessionError(
                f"this file and {twin} are both {fields}; read one of the folders", path
            )
    if index:
        index.check(headers, sessions)
    return sorted(sessions, key=natural_key)


def _nearly_fitting(folder: str, pattern: PathPattern) -> str:
    """Say which file comes nearest to a pattern that none fits, and what keeps it out."""
    looser = pattern.of_texts()
    for path in _find(folder, looser):
        name = os.path.relpath(path, folder)
        return f"; {name} would fit {looser.text!r}, whose fields need not be numbers"
    paths = [os.path.join(here, name) for here, _, files in os.walk(folder) for name in files]
    names = {os.path.relpath(path, folder).lower(): path for path in paths}
    fixed = re.sub(r"{[^}]*}", "", pattern.text).lower()
    near = difflib.get_close_matches(fixed, names, 1)
    return f"; the nearest is {os.path.relpath(names[near[0]], folder)}" if near else ""


def _find(folder: str, pattern: PathPattern) -> dict[str, PathMatch]:
    """Return the files and rosbag2 folders at any depth of a folder whose paths fit a pattern."""
    matches: dict[str, PathMatch] = {}
    for here, folders, files in os.walk(folder):
        folders[:] = sorted(name for name in folders if not name.startswith(TEMPORARY))
        bags = [
            name for name in folders if os.path.isfile(os.path.join(here, name, "metadata.yaml"))
        ]
        folders[:] = [
            name for name in folders if name not in bags
        ]  # what is inside a bag is not searched
        for name in sorted([*bags, *files]):
            if PARTIAL in name:
                continue
            path = os.path.join(here, name)
            match = pattern.match(path)
            if match is not None:
                matches[path] = match
    return matches


def join_sessions(
    sessions: Sequence[Session], resample: str | None = None, sample_time: float | None = None
) -> Session:
    """
    Join sessions that log one run, as one file per sensor, on one time axis.

    Their times must count from the same instant. Where the times differ, resampling is asked for by
    name, and the result spans the time that all of them cover.

    Parameters
    ----------
    sessions : sequence of Session
        With different columns each; metadata that several of them give must agree.
    resample : {"previous", "linear", "nearest"}, optional
        As for `read_session`.
    sample_time : float, optional
        Time between samples [s] after resampling.

    Returns
    -------
    Session
        Its metadata `joined` name the sources.

    Raises
    ------
    SessionError
        If two sessions have the same column, differ in their metadata, or share no time.
    RecipeError
        If their times differ and no resampling is asked for.

    Examples
    --------
    >>> import trustlab as tl
    >>> session = tl.read_session("data/sessions/pilot.csv")
    >>> one, other = (tl.Session(session.data[names]) for names in (["mode"], ["p_r", "p_h"]))
    >>> tl.join_sessions([one, other]).columns
    ['mode', 'p_r', 'p_h']
    """
    sessions = [of_class("each session", session, Session) for session in sessions]
    counts = Counter(name for session in sessions for name in session.columns)
    twice = [name for name, count in counts.items() if count > 1]
    if twice or not sessions:
        fault = (
            f"column {twice[0]!r} is in two of the sessions"
            if twice
            else "there are no sessions to join"
        )
        raise SessionError(fault)
    known: dict[str, object] = {}
    for session in sessions:
        for name, value in session.metadata.as_dict().items():
            # What a file says about its own start and mending is not the others' as well.
            if (
                name not in ("source", "resampled")
                and value is not None
                and known.setdefault(name, value) != value
            ):
                fault = (
                    f"metadata {name!r} are {known[name]!r} in one session and {value!r} in another"
                )
                raise SessionError(
                    f"{fault}; these are not of one run, or say so with session.with_metadata"
                )
    streams = [
        Stream(
            session.t,
            {name: session[name] for name in session.columns},
            "sample {}".format,
            session.label,
        )
        for session in sessions
    ]
    metadata = Metadata().changed(
        **known, joined=[str(session.metadata.source) for session in sessions]
    )
    try:
        log = RawLog("joined", streams, metadata)
        return assemble_session(log, None, {}, None, asked_resampling(resample, sample_time))
    except RecipeError as error:
        how = 'join_sessions(sessions, resample="linear", sample_time=0.1)'
        raise RecipeError(
            f"the sessions have times of their own; name how to bring them together: {how}"
        ) from error
