"""
Recipes: how a lab's logs become sessions, written down in a TOML file.

A recipe says of one kind of log where each column, time and the metadata come from. Every key is listed here; any
other is an error. Nothing is guessed: time and columns with a dimension name their unit, and resampling is asked for by name.

::

    name = "my_lab"                 # how the recipe calls itself
    description = "..."             # one line, free
    kind = "table"                  # "table": CSV or Parquet; "bag": ROS 1 or ROS 2

    [files]                         # needed by read_sessions and by metadata that come from paths
    pattern = "part{folder:int}/trial{trial:int}.csv"   # fields {name}, {name:int}, {name:float}; * for anything

    [table]                         # kind = "table" only; these are the defaults
    header = true                   # false: no line of names, columns are numbered from 0
    delimiter = ","
    decimal = "."
    skip_lines = 0                  # lines before the table

    [time]                          # kind = "table"
    column = "t"                    # name or index
    unit = "s"
    from_zero = false               # true: count from the first sample; its time becomes metadata start_time

    [time]                          # kind = "bag"; t counts from the first sample, metadata start_time says when
    stamp = "receive"               # or "header": the message's own stamp
    topics = { "/cmd_vel" = "receive" }   # topics that use the other one

    [resampling]                    # needed for topics with stamps of their own; a caller's resample= goes before it
    method = "previous"             # or "linear", "nearest"
    sample_time = 0.1               # [s]

    [columns]                       # name of the vocabulary = exactly one of
    path_error = { column = "err", unit = "mm", absolute = true }  # a column; also scale, offset, map, resample
    robot_x = { topic = "/odom", field = "pose.pose.position.x", unit = "m" }   # the same, and hold
    mode = { topic = "/mode", field = "data", map = { MANUAL = 1, AUTO = 0 }, hold = true }
    beta = { value = 0.5 }                                         # a constant
    r = { from = "header.share", unit = "%" }                      # one value from the metadata for all samples
    path_error = { distance = ["robot", "reference"], axes = ["y", "z"] }
    step_distance = { travelled = "robot", axes = ["x", "y"] }     # since the sample before; the first takes the second's

    [metadata]                      # participant, condition, synthetic or any other name = from or value
    participant = { from = "folder", map = { 25 = 8 }, keep = true }    # keep: what the map does not list stays
    training = { from = "block", map = { 0 = true }, default = false }  # default: what the map does not list
    block = { from = "trial", bins = [5, 10, 15] }                 # how many of these limits lie below the value
    site = { value = "north wing" }

    [header]                        # a table beside the sessions with one row for each
    file = "part{folder}/part{folder}_header.csv"       # from the folder that files.pattern starts in
    keys = { trial = "trial_number" }                   # path field = the column that names it

    [supersedes]                    # for read_sessions: sessions replaced by others, left out with a warning
    field = "folder"
    pairs = { 8 = 25 }              # those of folder 8 are left out where there are any of folder 25

A column's value is (scale · raw + offset) in its unit; `absolute` takes its size, so that a signed deviation becomes
a distance (before any resampling). `map` turns texts or codes into numbers. `hold` keeps each
message of a topic until the next, and the last until the log ends (for topics published when something changes). `from` names a field of
the path pattern, ``header.<column>``, or a metadata entry above it. A field path walks a message
(``twist.twist.linear.x``, ``axes[1]``, ``buttons[4]``); ``yaw(pose.pose.orientation)`` is a quaternion's heading.
"""

from __future__ import annotations

import os
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from trustlab.sessions.column_rules import ColumnRule
from trustlab.sessions.errors import RecipeError, nearest, nearest_file
from trustlab.sessions.patterns import PathPattern
from trustlab.sessions.rules import (
    HeaderRule,
    MetadataRule,
    TableRule,
    TimeRule,
    check_keys,
    check_resample,
    check_type,
    plain_key,
)
from trustlab.sessions.units import to_si

__all__ = ["Recipe", "list_recipes", "load_recipe", "table_rule"]

_SHIPPED = Path(__file__).parent / "recipes"
_KEYS = (
    "name description kind files table time resampling columns metadata header supersedes".split()  # noqa: SIM905
)


@dataclass(frozen=True)
class Recipe:
    """
    A recipe, checked.

    Parameters
    ----------
    name : str
        What it is called.
    kind : {"table", "bag"}
        What kind of log it reads.
    columns : mapping
        Session column to its rule.
    description : str
        One line.
    pattern : PathPattern, optional
        Which files it reads, and what their paths say.
    table : TableRule
        How a table is written.
    time : TimeRule
        Where time comes from.
    method : str, optional
        How to resample.
    sample_time : float, optional
        To which sample time [s].
    metadata : mapping
        Metadata name to its rule, in the order they are worked out.
    header : HeaderRule, optional
        The table with one row per session.
    superseded : mapping
        Values of a path field that others replace.
    superseded_field : str, optional
        That field.
    source : str, optional
        The file it was read from.
    """

    name: str
    kind: str
    columns: Mapping[str, ColumnRule]
    description: str = ""
    pattern: PathPattern | None = None
    table: TableRule = field(default_factory=TableRule)
    time: TimeRule = field(default_factory=TimeRule)
    method: str | None = None
    sample_time: float | None = None
    metadata: Mapping[str, MetadataRule] = field(default_factory=dict)
    header: HeaderRule | None = None
    superseded: Mapping[str, str] = field(default_factory=dict)
    superseded_field: str | None = None
    source: str | None = None

    @classmethod
    def from_toml(cls, text: str, source: str = "recipe") -> Recipe:
        """
        Return the recipe that a TOML text spells.

        Parameters
        ----------
        text : str
            The text; see the module's documentation.
        source : str
            What to call it in errors.

        Raises
        ------
        RecipeError
            If the text is not TOML, or any key, name, unit or value in it cannot be followed.
        """
        try:
            top = tomllib.loads(text)
        except (ValueError, RecursionError) as error:
            raise RecipeError(
                f"not a TOML file ({error}; texts need quotes); help(trustlab.sessions.recipes) has every key",
                source,
            ) from error
        top = check_keys(top, _KEYS, "recipe", source)
        for key in ("name", "description"):
            check_type(top.get(key, ""), str, "a text", key, source)
        kind = top.get("kind")
        if kind not in ("table", "bag"):
            raise RecipeError(f'kind must be "table" or "bag", got {kind!r}', source)
        columns = check_keys(top.get("columns", {}), top.get("columns", {}), "[columns]", source)
        if not columns:
            raise RecipeError("[columns] is missing or empty; a session needs at least one column", source)
        columns = {key: ColumnRule.parse(key, value, source) for key, value in columns.items()}
        metadata = check_keys(top.get("metadata", {}), top.get("metadata", {}), "[metadata]", source)
        metadata = {key: MetadataRule.parse(key, value, source) for key, value in metadata.items()}
        files = check_keys(top.get("files", {}), ("pattern",), "[files]", source)
        pattern = PathPattern(files["pattern"], source) if files else None
        header = _header(top.get("header"), pattern, source)
        if kind == "bag" and "table" in top:
            raise RecipeError('[table] is for kind = "table"', source)
        table = table_rule(top.get("table", {}), source)
        method, sample_time = _resampling(top.get("resampling"), source)
        superseded_field, superseded = _supersedes(top.get("supersedes"), pattern, source)
        recipe = cls(
            name=top.get("name", source),
            kind=kind,
            columns=columns,
            description=top.get("description", ""),
            pattern=pattern,
            table=table,
            time=(_table_time if kind == "table" else _bag_time)(top.get("time", {}), source),
            method=method,
            sample_time=sample_time,
            metadata=metadata,
            header=header,
            superseded=superseded,
            superseded_field=superseded_field,
            source=source,
        )
        recipe._check_columns()
        recipe._check_origins()
        return recipe

    def _check_columns(self) -> None:
        wrong = "topic" if self.kind == "table" else "column"
        named = {name: rule.key for name, rule in self.columns.items() if rule.kind == "column"}
        if self.kind == "table":
            named = {"time": self.time.column, **named}
        for name, rule in self.columns.items():
            if rule.kind == wrong:
                raise RecipeError(
                    f'[columns] {name}: {wrong} does not go with kind = "{self.kind}"', self.source
                )
            missing = [need for need in rule.needs if need not in self.columns]
            if missing:
                raise RecipeError(
                    f"[columns] {name}: needs column {missing[0]!r}, which has no rule", self.source
                )
        if not any(rule.kind in ("column", "topic") for rule in self.columns.values()):
            raise RecipeError("[columns]: at least one column must come from the log", self.source)
        for name, key in named.items():
            if isinstance(key, int) == self.table.header:
                how = "name" if self.table.header else "index (a number), as the table has no header line"
                raise RecipeError(f"{name}: columns of this table go by {how}, got {key!r}", self.source)

    def _check_origins(self) -> None:
        known = list(self.pattern.fields) if self.pattern else []
        origins = [(f"[metadata] {name}", rule.origin, name) for name, rule in self.metadata.items()]
        origins += [
            (f"[columns] {name}", rule.key, None)
            for name, rule in self.columns.items()
            if rule.kind == "from"
        ]
        for where, origin, defines in origins:
            by_header = self.header is not None and str(origin).startswith("header.")
            if origin is not None and origin not in known and not by_header:
                hint = (
                    "; add a [header] table" if str(origin).startswith("header.") else nearest(origin, known)
                )
                there = ", ".join(known) or "nothing; fields of the path come from [files] pattern"
                raise RecipeError(
                    f"{where}: nothing is called {origin!r}{hint} (there is: {there})", self.source
                )
            if defines:
                known.append(defines)


def table_rule(table: Mapping[str, object], source: str | None) -> TableRule:
    """
    Return how a table is written, checked.

    Parameters
    ----------
    table : mapping
        The keys of [table].
    source : str, optional
        The recipe, for errors.
    """
    table = check_keys(table, ("header", "delimiter", "decimal", "skip_lines"), "[table]", source)
    check_type(table.get("header", True), bool, "true or false", "[table] header", source)
    delimiter, decimal = table.get("delimiter", ","), table.get("decimal", ".")
    if not isinstance(delimiter, str) or delimiter not in tuple(",;\t| "):
        raise RecipeError(f"[table] delimiter must be one of , ; | tab or space, got {delimiter!r}", source)
    if decimal not in (".", ",") or decimal == delimiter:
        raise RecipeError(f"[table] decimal must be . or , and not the delimiter, got {decimal!r}", source)
    skip = table.get("skip_lines", 0)
    check_type(skip, int, "a count of lines", "[table] skip_lines", source)
    if skip < 0:
        raise RecipeError(f"[table] skip_lines must not be negative, got {skip}", source)
    return TableRule(**table)


def _table_time(table, source) -> TimeRule:
    table = check_keys(table, ("column", "unit", "from_zero"), "[time]", source)
    check_type(table.get("column", "t"), (str, int), "a column name or index", "[time] column", source)
    check_type(table.get("from_zero", False), bool, "true or false", "[time] from_zero", source)
    if "unit" not in table:
        raise RecipeError(
            '[time]: needs unit, the unit of its column, for example unit = "s" or "ms"', source
        )
    factor = to_si(table["unit"], "s", "[time]", source)
    return TimeRule(table.get("column", "t"), factor, table.get("from_zero", False))


def _bag_time(table, source) -> TimeRule:
    table = check_keys(table, ("stamp", "topics"), "[time]", source)
    topics = check_keys(table.get("topics", {}), table.get("topics", {}), "[time] topics", source)
    for where, stamp in [("stamp", table.get("stamp", "receive")), *topics.items()]:
        if stamp not in ("receive", "header"):
            raise RecipeError(f'[time] {where}: must be "receive" or "header", got {stamp!r}', source)
    return TimeRule(None, 1.0, True, table.get("stamp", "receive"), topics)


def _resampling(table, source) -> tuple[str | None, float | None]:
    if table is None:
        return None, None
    table = check_keys(table, ("method", "sample_time"), "[resampling]", source)
    if len(table) != 2:
        raise RecipeError("[resampling] needs method and sample_time [s]", source)
    check_resample(table["method"], "[resampling] method", source)
    check_type(table["sample_time"], (int, float), "a number of seconds", "[resampling] sample_time", source)
    if table["sample_time"] <= 0:
        raise RecipeError(f"[resampling] sample_time must be positive, got {table['sample_time']}", source)
    return table["method"], float(table["sample_time"])


def _header(table, pattern, source) -> HeaderRule | None:
    if table is None:
        return None
    table = check_keys(table, ("file", "keys"), "[header]", source)
    if len(table) != 2 or pattern is None:
        raise RecipeError("[header] needs file and keys, and a [files] pattern to go with", source)
    keys = check_keys(table["keys"], pattern.fields, "[header] keys", source)
    for column in keys.values():
        check_type(column, str, "a column name", "[header] keys", source)
    if not keys:
        raise RecipeError("[header] keys is empty; say which path field its rows are found by", source)
    for name in PathPattern(table["file"], source).fields:
        if name not in pattern.fields:
            raise RecipeError(
                f"[header] file: {name!r} is not a field of the files pattern{nearest(name, pattern.fields)}",
                source,
            )
    return HeaderRule(table["file"], keys)


def _supersedes(table, pattern, source) -> tuple[str | None, dict[str, str]]:
    if table is None:
        return None, {}
    table = check_keys(table, ("field", "pairs"), "[supersedes]", source)
    fields = pattern.fields if pattern else {}
    if table.get("field") not in list(fields):
        raise RecipeError(f"[supersedes] field must be one of the path fields {list(fields)}", source)
    pairs = check_keys(table.get("pairs", {}), table.get("pairs", {}), "[supersedes] pairs", source)
    for value in pairs.values():
        check_type(value, (str, int, float), "a plain value", "[supersedes] pairs", source)
    return table["field"], {plain_key(old): plain_key(new) for old, new in pairs.items()}


def list_recipes() -> dict[str, str]:
    """
    Return the recipes that come with the package: names and descriptions.

    Returns
    -------
    dict of str to str
    """
    return {name: load_recipe(name).description for name in _shipped()}


def _shipped() -> dict[str, Path]:
    return {path.stem: path for path in sorted(_SHIPPED.glob("*.toml"))}


def load_recipe(recipe: str | os.PathLike | Recipe) -> Recipe:
    """
    Return a recipe by name or from a file.

    Parameters
    ----------
    recipe : str, path-like or Recipe
        The name of a recipe that comes with the package (see `list_recipes`), the path of a TOML file, or a recipe,
        which is returned as it is.

    Raises
    ------
    RecipeError
        If there is no such recipe (the nearest name is suggested) or the file cannot be followed.
    """
    if isinstance(recipe, Recipe):
        return recipe
    if not isinstance(recipe, str | os.PathLike):
        raise RecipeError(f"a recipe is a name, a path or a Recipe, got {type(recipe).__name__}")
    shipped = _shipped()
    path = shipped.get(str(recipe)) if isinstance(recipe, str) else None
    if path is None:
        path = Path(recipe)
        try:
            there = path.is_file()
        except (OSError, ValueError):
            there = False
        if not there:
            hint = nearest(path.stem, shipped) or nearest_file(path, ".toml")
            raise RecipeError(
                f"there is no recipe {str(recipe)!r}, neither as a file nor by name{hint} "
                f"(known: {', '.join(shipped)})"
            )
    try:
        text = path.read_bytes().decode("utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise RecipeError(f"cannot be read as UTF-8 text ({error})", str(path)) from error
    return Recipe.from_toml(text, str(path))
