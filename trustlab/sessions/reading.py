"""Read logged sessions: one, all of a folder, or a data frame."""

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from difflib import get_close_matches
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pandas as pd

from trustlab.models.checks import list_of, of_class, one_of, shown, warn
from trustlab.models.files import path_of
from trustlab.models.published import data_folder
from trustlab.sessions.bags import read_bag, read_written
from trustlab.sessions.columns import (
    RawLog,
    Table,
    derived_values,
    parts_of,
    rules_of,
    session_of,
    stream_of,
    times_of,
)
from trustlab.sessions.errors import (
    RecipeError,
    SessionError,
    alternatives,
    source_named,
)
from trustlab.sessions.folders import Header, logs_in, matching
from trustlab.sessions.patterns import natural_key
from trustlab.sessions.recipe import (
    ColumnRule,
    Method,
    Recipe,
    Resampling,
    TableRule,
    TimeRule,
    load_recipe,
    parse,
)
from trustlab.sessions.session import Session
from trustlab.sessions.tables import (
    BAGS,
    SUFFIXES,
    TEXTS,
    Chosen,
    frame_table,
    read_csv,
    read_parquet,
    suffix_of,
)
from trustlab.sessions.vocabulary import VOCABULARY


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
        A ``.csv``, ``.csv.gz``, ``.tsv`` or ``.txt`` table, a ``.parquet``, ``.bag`` (ROS 1),
        ``.mcap`` or ``.db3`` file, or a rosbag2 folder.
    recipe : str, path-like or Recipe, optional
        How the log's columns become ours: the name of a recipe of ours, the path of a TOML file, or
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

    Returns
    -------
    Session

    Raises
    ------
    SessionError
        If the file cannot be read or its first fault: the error names the file, the line, row or
        message, the column, and the remedy.
    RecipeError
        If the recipe is unknown or cannot be followed.
    ValueError
        If another argument is not valid, or does not apply to the file's format.

    Warns
    -----
    UserWarning
        If times or performance are hardly meant as they are read, or the last line has no end.

    Examples
    --------
    >>> import trustlab as tl
    >>> session = tl.read_session("data/sessions/pilot.csv")
    >>> session.columns, session.sample_time
    (['mode', 'p_r', 'p_h'], 0.1)
    """
    reader = Reader(recipe, columns, resample, sample_time, delimiter=delimiter, decimal=decimal)
    sessions = reader.read(path)
    reader.warn()
    return _only(sessions, str(path), "read_sessions returns all of a folder's")


def read_frame(
    frame: pd.DataFrame,
    recipe: str | os.PathLike | Recipe | None = None,
    columns: Sequence[str] | None = None,
    resample: str | None = None,
    sample_time: float | None = None,
    **metadata: object,
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
    **metadata : object
        participant, condition or any other name, but none close to an argument. Where the recipe
        takes metadata from the path of a file, they stand for the fields of its pattern.

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
    >>> tl.read_frame(frame, participant=3).label
    'participant 3'
    """
    of_class("frame", frame, pd.DataFrame)
    reader = Reader(recipe, columns, resample, sample_time)
    sessions = reader.read_frame(frame, metadata)
    reader.warn()
    return _only(sessions, "data frame", "give one part at a time")


def example(name: str = "pilot") -> Session:
    """
    Read a session that comes with trustlab.

    Parameters
    ----------
    name : {"pilot"}
        The pilot operator of the dissertation, simulated: 33 minutes at 10 Hz, with `mode`, `p_r`
        and `p_h` [m/s].

    Returns
    -------
    Session
        The session, marked as synthetic in its metadata.

    Raises
    ------
    ValueError
        If there is no such session; the error lists those there are.

    Examples
    --------
    >>> import trustlab as tl
    >>> session = tl.sessions.example("pilot")
    >>> session.metadata.synthetic
    True
    """
    paths = {path.stem: path for path in data_folder("sessions").glob("*.csv")}
    return read_session(paths[one_of("name", name, paths)])


def _only(sessions: list[Session], source: str, remedy: str) -> Session:
    """Return the only session of a log."""
    if len(sessions) != 1:
        raise SessionError(
            f"the recipe splits the log into {len(sessions)} sessions; {remedy}", source
        )
    return sessions[0]


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
    columns : sequence of str, optional
        Read only these columns of the sessions.
    resample : {"previous", "linear", "nearest"}, optional
        As for `read_session`.
    sample_time : float, optional
        Time between samples [s] after resampling.
    delimiter, decimal : str, optional
        As for `read_session`.

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
        If another argument is not valid.

    Warns
    -----
    UserWarning
        As for `read_session`, once for all files with the same doubt.

    Examples
    --------
    >>> import trustlab as tl
    >>> sessions = tl.read_sessions("data/sessions")
    >>> [session.metadata.participant for session in sessions]
    ['pilot', '1', '2', '3', '4', '5']
    """
    one_of("on_error", on_error, ("raise", "collect"))
    reader = Reader(recipe, columns, resample, sample_time, delimiter=delimiter, decimal=decimal)
    source = str(path_of("folder", folder))
    if not os.path.isdir(source):
        hint = "; read a single file with read_session" if os.path.exists(source) else ""
        raise SessionError(f"there is no such folder{hint}", source)
    pattern = reader.recipe.pattern
    paths = matching(source, pattern, reader.header) if pattern else logs_in(source)
    sessions, faults = [], []
    for path in paths:
        try:
            sessions.extend(reader.read(path))
        except SessionError as error:
            if on_error == "raise":
                raise
            faults.append((path, str(error)))
    reader.warn()

    def order(session: Session) -> list[tuple]:
        facts = session.metadata
        keys = (facts.participant, facts.more.get("trial"), facts.source, facts.more.get("part"))
        return [natural_key(key) for key in keys]

    return Sessions(sorted(sessions, key=order), pd.DataFrame(faults, columns=["file", "error"]))


class Reader:
    """The arguments of `read_session`, checked and put into the recipe, for one file or many."""

    def __init__(self, recipe, columns, resample, sample_time, **layout):
        # Without a recipe, the columns are those that a table turns out to have.
        self.plain = recipe is None
        self.recipe = PLAIN if self.plain else load_recipe(recipe)
        self.layout = {name: value for name, value in layout.items() if value is not None}
        if self.layout:
            table = parse(TableRule, self.layout, "delimiter and decimal")
            if not self.plain:
                raise RecipeError(
                    "delimiter and decimal are given beside a recipe: state them in its [table]",
                    self.recipe.source,
                )
            self.recipe = replace(self.recipe, table=table)
        if resample is not None or sample_time is not None:
            method: Any = one_of("resample", resample, get_args(Method))
            rule = Resampling(method=method, sample_time=sample_time)
            self.recipe = replace(self.recipe, resampling=rule)
        self.columns = None if columns is None else self._selected(columns)
        # The rules of the columns that come from the log, and of those that these need.
        rules = rules_of(self.recipe, self.columns or list(self.recipe.columns))
        self.rules = [rule for rule in rules if rule.kind in ("column", "topic")]
        self.header = Header(self.recipe.header) if self.recipe.header else None
        # What to doubt in values that could be read, and the files where that is so.
        self.doubts: dict[str, list[str]] = {}

    def _selected(self, columns: Sequence[str]) -> list[str]:
        """Return the columns of the session that are asked for."""
        names = [name for name in list_of("columns", columns) if name != "t"]
        if not names or not all(isinstance(name, str) for name in names):
            raise SessionError(f"columns must be a list of names besides t, got {shown(columns)}")
        for name in names:
            if name not in self.recipe.columns:
                known = alternatives(name, self.recipe.columns)
                raise SessionError(f"columns: there is no column {name!r}{known}")
        return [*dict.fromkeys(names)]

    def read(self, path: str | os.PathLike) -> list[Session]:
        """Return the sessions of one file or rosbag2 folder: one, unless the recipe splits it."""
        source = str(path_of("path", path))
        with source_named(source):
            try:
                return self._read(existing(Path(source)), source)
            except OSError as error:
                raise SessionError(f"cannot be read ({error.strerror or error})") from error

    def _read(self, path: Path, source: str) -> list[Session]:
        """Check that recipe and file go together; read the file; make sessions of what it holds."""
        suffix = suffix_of(path)
        bag = path.is_dir() or suffix in BAGS
        self._check_kind("bag" if bag else "table")
        if self.layout and suffix not in TEXTS:
            raise SessionError(f"delimiter and decimal do not apply to {suffix or 'a folder'}")
        match = self.recipe.pattern and self.recipe.pattern.match(source)
        values = {**match.fields} if match else {}
        if match and self.header:
            values |= self.header.row(match)
        if bag and not self.plain:
            log = read_bag(path, self.recipe, self.rules)
            return self._sessions(log, values, list(self.recipe.columns))
        if bag:
            table = read_written(path, self._chosen())
        elif suffix in TEXTS:
            texts = {rule.name for rule in self.rules if rule.map}
            if self.recipe.time.unit in ("iso", "clock"):
                texts.add("t")
            table = read_csv(path, self._chosen(), self.recipe.table, texts)
        else:
            table = read_parquet(path, self._chosen())
        return self._of_table(table, source, values)

    def read_frame(self, frame: pd.DataFrame, metadata: Mapping[str, object]) -> list[Session]:
        """Return the session in a data frame, or all that the recipe splits it into."""
        recipe = self.recipe
        with source_named("data frame"):
            self._check_kind("table")
            table = frame_table(frame, self._chosen())
            sessions = self._of_table(table, "data frame", metadata)
        # Fields of a path that no rule takes up are metadata like others.
        rules: list[Any] = [*recipe.columns.values(), *recipe.metadata.values()]
        used = {*recipe.metadata, *(rule.origin for rule in rules)}
        fields = used & {*(recipe.pattern.types if recipe.pattern else ())}
        more = {name: value for name, value in metadata.items() if name not in fields}
        for name in more:
            # "resampled" is what reading itself notes.
            for close in get_close_matches(name, [*ARGUMENTS, "resampled"], n=1, cutoff=0.85):
                if close in ARGUMENTS:
                    raise ValueError(
                        f"{name!r} looks like the argument {close!r}, not like metadata; correct it"
                    )
        return [session.with_metadata(**more) for session in sessions] if more else sessions

    def _check_kind(self, kind: str) -> None:
        recipe = self.recipe
        if not self.plain and recipe.kind != kind:
            raise RecipeError(f"recipe {recipe.name!r} reads a {recipe.kind}, but this is a {kind}")

    def _chosen(self) -> Chosen:
        """Return which columns of a table to read: the session's name of each, to the table's."""
        if self.plain and not self.columns:
            return None
        return {"t": self.recipe.time.column} | {rule.name: rule.column for rule in self.rules}

    def _of_table(self, table: Table, source: str, values: Mapping) -> list[Session]:
        """Return the sessions of a table."""
        if table.frame.empty:
            raise SessionError("nothing follows the column names; the log has no samples")
        recipe, names = self.recipe, [name for name in table.frame if name != "t"]
        rules = [recipe.columns[name] for name in names]
        t = times_of(table, recipe)
        stream = stream_of(table, t, rules, recipe)
        log = RawLog(source, [stream], table.metadata, table.notes)
        return self._sessions(log, values, names if self.plain else list(recipe.columns))

    def _sessions(
        self, log: RawLog, values: Mapping[str, Any], names: Sequence[str]
    ) -> list[Session]:
        """Return the sessions that a log makes, with columns of these names or those asked for."""
        values = derived_values(self.recipe, values)
        selection = self.columns or names
        parts = parts_of(log, self.recipe)
        sessions = [session_of(part, self.recipe, values, selection) for part in parts]
        for session in sessions:
            for doubt in doubts(session, log.notes, self.recipe.time):
                self.doubts.setdefault(doubt, []).append(log.source)
        return sessions

    def warn(self) -> None:
        """Warn of each doubt once, however many files it is about."""
        for doubt, files in self.doubts.items():
            count = len(set(files)) - 1
            more = f" (and {count} more of the files)" if count else ""
            warn(f"{files[0]}{more}: {doubt}")


# Names of arguments: what a caller of `read_frame` writes nearly so is a slip, not metadata.
ARGUMENTS = ("frame", "recipe", "columns", "resample", "sample_time", "delimiter", "decimal")

# The recipe of a log whose columns are those of the vocabulary, in SI units.
PLAIN = Recipe(
    kind="table",
    time=TimeRule(kind="table", unit="s"),
    columns={
        name: ColumnRule(name=name, kind="column", column=name, unit=column.unit)
        for name, column in VOCABULARY.items()
    },
)


def existing(path: Path) -> Path:
    """Return the path when something that can be read is there."""
    if path.is_dir():
        if not (path / "metadata.yaml").is_file():
            raise SessionError(
                "a folder without metadata.yaml is not a rosbag2 recording; use read_sessions for "
                "a folder of sessions, `ros2 bag reindex` for a recording"
            )
    elif not path.is_file():  # nor are devices and pipes, which never end
        looked = "" if path.is_absolute() else f" (looked in {path.parent.absolute()})"
        raise SessionError(f"there is no file at this path{looked}")
    elif suffix_of(path) not in SUFFIXES:
        hint = alternatives(path.suffix, [*SUFFIXES, "rosbag2 folders"])
        raise SessionError(
            f"cannot read {path.suffix or 'files without a suffix'}{hint}; read the file into a "
            "data frame, then trustlab.read_frame(frame)"
        )
    return path


# Units of stamps: how many make a second, and the longest step between samples that looks like the
# unit: nobody logs control more slowly than every 5 s, or, in small units, than every second.
STEPS = {"s": (1.0, 5.0), "ms": (1e3, 1e3), "us": (1e6, 1e6), "ns": (1e9, np.inf)}

# Performance above which a measure, in m/s or a share of 1, is no longer plausible.
MOST_PERFORMANCE = 10.0


def likely_unit(first: float, step: float) -> str:
    """Return the unit of numbers that are times: by the first, if since 1970, or by their step."""
    fitting = [unit for unit, (_, longest) in STEPS.items() if step < longest]
    for unit, (size, _) in STEPS.items():
        # From 2001 to 2286; the step tells them from smaller units since another day.
        if 1e9 <= first / size < 1e10 and step / size < 5.0:
            fitting = [unit]
    return [*fitting, "?"][0]


def doubts(session: Session, notes: Mapping[str, Any], time: Any) -> list[str]:
    """Return what is hardly meant as it was read: times, performance, a line cut short."""
    words = []
    first, step = notes.get("start_time", session.t[0]), session.sample_time
    if time.unit in STEPS and likely_unit(first, step) != "s":
        size = STEPS[time.unit][0]
        unit = likely_unit(first * size, step * size)
        remedy = f'if its times are in {unit}, a recipe says so: [time] unit = "{unit}"'
        words.append(f"samples are {step:g} s apart, from {first:g} s on; {remedy}")
    for name in [name for name in ("p_r", "p_h") if name in session]:
        if np.min(session[name]) < 0.0:
            words.append(
                f"column {name} has negative values, but performance is never negative; map the "
                "measure to one that is 0 at its worst (offset in a recipe's column)"
            )
        elif np.max(session[name]) > MOST_PERFORMANCE:
            words.append(
                f"column {name} goes beyond {MOST_PERFORMANCE:g}, but performance is in m/s or a "
                'share of 1; if it is in per cent, a recipe says so: unit = "%" in the column'
            )
    if "last line" in notes:
        words.append(f"the last line {notes['last line']}")
    return words
