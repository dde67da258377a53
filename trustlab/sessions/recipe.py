"""
Recipes: how a lab's logs become sessions, written down in a TOML file.

A recipe says for one kind of log where each column, the time and the metadata come from. This is a
list of every key, no recipe to be copied whole: keys that exclude each other stand side by side.
Any other key is an error. Nothing is guessed: time and columns with a dimension name their unit,
and resampling is asked for by name.

::

    name = "my_lab"                 # the recipe's name
    description = "..."             # one line, free
    performance_window = 100        # if p_r and p_h are moving means: over how many seconds
    kind = "table"                  # "table": CSV or Parquet; "bag": ROS 1 or ROS 2

    [files]                         # for read_sessions, and for metadata that come from paths
    pattern = "part{folder:int}/trial{trial:int}.csv"
                                    # fields {name}, {name:int}, {name:float}; * for anything

    [table]                         # kind = "table" only; these are the defaults
    header = true                   # false: no line of names, columns are numbered from 0
    delimiter = ","                 # in .tsv files a tab; " " is any number of spaces
    decimal = "."
    encoding = "utf-8"              # or "cp1252": text that Windows wrote, with umlauts
    skip_lines = 0                  # lines before the table

    [time]                          # kind = "table"
    column = "t"                    # name or index
    unit = "s"                      # "iso": 2026-03-01T12:00:00.5; "clock": 12:00:00.5,
                                    # also past midnight
    from_zero = false               # true: count from the first sample; its time becomes
                                    # metadata start_time
    sort = true                     # order the rows by time, where they are out of order
    jumps = "split"                 # begin a new session of read_sessions where time runs back
    repeated = "first"              # or "last", "mean": what to do with times that repeat;
                                    # of step_distance the sum

    [time]                          # kind = "bag": t counts from the first sample;
                                    # metadata start_time says when that was
    stamp = "receive"               # or "header": the message's own stamp
    topics = { "/cmd_vel" = "receive" }   # topics that use the other stamp
    sort = true                     # as above, like repeated

    [splitting]
    gap = 2.0                       # [s]: a longer gap begins a new session of read_sessions

    [resampling]                    # needed for topics with stamps of their own;
                                    # a caller's resample= overrides it
    method = "previous"             # or "linear", "nearest"
    sample_time = 0.1               # [s]

    [columns]                       # name of the vocabulary = exactly one of the following
    # a column of the table; also scale, offset, map, resample
    path_error = { column = "err", unit = "mm", absolute = true }
    # blank cells (empty, NaN, NA or "-") repeat the value before; "linear" interpolates
    p_r = { column = "speed", blank = "hold" }
    # 1 above this value (in the column's unit of the session), else 0; also for topics
    mode = { column = "pedal", above = 0.5 }
    # a field of a topic's messages, with the keys of a column, and hold
    robot_x = { topic = "/odom", field = "pose.pose.position.x", unit = "m" }
    mode = { topic = "/mode", field = "data", map = { MANUAL = 1, AUTO = 0 }, hold = true }
    # a constant
    beta = { value = 0.5 }
    # one value from the metadata for all samples
    r = { from = "header.share", unit = "%" }
    # the distance between two positions
    path_error = { distance = ["robot", "reference"], axes = ["y", "z"] }
    # the distance from the sample before; the first sample takes the second's
    step_distance = { travelled = "robot", axes = ["x", "y"] }

    [metadata]                      # participant, condition, synthetic or any other name
    participant = { from = "folder" }
    group = { from = "participant", map = { 1 = "A", 2 = "A", 3 = "B" } }
    # default: for values that are not in the map
    training = { from = "trial", map = { 1 = true, 2 = true }, default = false }
    site = { value = "north wing" }

    [header]                        # a table beside the sessions with one row for each
    file = "part{folder}/part{folder}_header.csv"
                                    # from the folder that files.pattern starts in
    keys = { trial = "trial_number" }   # path field = the column that names it

A column's value is (scale · raw + offset) in its unit; `absolute` takes its absolute value before
any resampling, so that a signed deviation becomes a distance. `map` turns texts or codes into
numbers. `blank` fills cells of a table that are empty, `hold` keeps each message of a topic until
the next one, and the last until the log ends (for topics published on change), and `method` of
[resampling] says what a value is between two samples. `from` names a field of the path pattern,
``header.<column>``, or a metadata entry above it. A field path leads to one number of a message
(``twist.twist.linear.x``, ``axes[1]``, ``buttons[4]``); ``yaw(pose.pose.orientation)`` is a
quaternion's heading. ``transforms[child_frame_id="turtle1"].transform.translation.x`` selects an
entry of a list of messages by one of its fields, ``position[name="wheel_left"]`` by the list of
names beside it; messages without that entry are passed over, and the session's notes say how many
have it.
"""

import os
import re
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import MISSING, dataclass, field, fields, is_dataclass
from pathlib import Path
from types import NoneType
from typing import Any, Literal, get_args, get_origin, get_type_hints

import numpy as np

from trustlab.models.checks import (
    Checked,
    Positive,
    did_you_mean,
    finite_number,
    not_negative,
    one_of,
    shown,
    whole_number,
)
from trustlab.models.files import path_of
from trustlab.sessions.errors import RecipeError, alternatives, source_named
from trustlab.sessions.patterns import FieldPath, PathPattern
from trustlab.sessions.vocabulary import UNITS, VOCABULARY, to_si

Method = Literal["previous", "linear", "nearest"]
Stamp = Literal["receive", "header"]
Axis = Literal["x", "y", "z"]
Plain = str | bool | float

# Columns that name a state or a robot; "linear" holds their previous value, as the log never was in
# half a state.
STATES = (
    *("mode", "suggested_mode", "alpha_choice", "may_switch", "goals_reached"),
    *("leader", "leader_choice", "leader_suggested", "leader_most_trusted", "leader_hysteresis"),
)

# How a number is written in a table.
NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?", re.ASCII)

# Keys that Python or a method has a use for, by the fields that hold them.
SPELT = {"origin": "from", "path": "field"}


# The schema: every table of the file is a dataclass below, whose fields are the table's keys, and
# whose annotations say which values they take.


def parse(rule: Any, table: Any, where: str, allowed: Sequence[str] = (), **more: object) -> Any:
    """Return the rule that a table states, or raise its first fault; `more` are further fields."""
    if not isinstance(table, Mapping):
        raise RecipeError(f"{where} must be a table, got {shown(table)}")
    kinds = get_type_hints(rule)
    known = {SPELT.get(each.name, each.name): each for each in fields(rule) if each.init}
    keys = allowed or [key for key in known if key not in more]
    values = {}
    try:
        for key, value in table.items():
            if key not in keys:
                raise ValueError(f"unknown key {key!r}{alternatives(key, keys)}")
            name = known[key].name
            values[name] = _checked(kinds[name], key, value)
        for key, each in known.items():
            required = each.default is each.default_factory is MISSING
            if required and each.name not in values | more:
                raise ValueError(f"needs {key}; help(trustlab.sessions.recipe) shows how")
        return rule(**values, **more)
    except RecipeError:  # of a table inside this one, which names itself
        raise
    except ValueError as error:
        raise RecipeError(f"{where}: {error}") from None


def _checked(kind: Any, name: str, value: Any) -> Any:
    """Return a value as its annotation asks for; raise ValueError otherwise."""
    parts = [part for part in get_args(kind) if part is not NoneType]
    if get_origin(kind) is Literal:
        return one_of(name, value, parts)
    if get_origin(kind) is tuple:
        if not isinstance(value, list) or len({*map(str, value)}) < max(1, len(value)):
            raise ValueError(f"{name} must be a list without repeats, got {shown(value)}")
        return tuple(_checked(parts[0], name, each) for each in value)
    if get_origin(kind) is dict:
        return _entries(parts[1], name, value)
    if len(parts) == 1:  # what may be left out
        return _checked(parts[0], name, value)
    if kind in (PathPattern, FieldPath):
        return kind(value)
    if is_dataclass(kind):
        return parse(kind, value, f"[{name}]")
    plain = {kind, *parts}
    if kind is Any or type(value) in plain & {str, bool}:
        return value
    if float in plain:
        number = finite_number(name, value)
        return value if str in plain else number  # metadata stay whole numbers
    if int in plain:
        return whole_number(name, value, least=0, most=999_999)
    words = "a text" if kind is str else "true or false"
    raise ValueError(f"{name} must be {words}, got {shown(value)}")


def _entries(kind: Any, name: str, value: object) -> dict[str, Any]:
    """Return a table of any keys: rules that know their name, or what a map makes of words."""
    if not isinstance(value, Mapping) or not value:
        raise ValueError(f"{name} must be a table with entries, got {shown(value)}")
    if kind is ColumnRule:
        return {title: _column_rule(title, each) for title, each in value.items()}
    if kind is MetadataRule:
        return {title: parse(kind, each, f"[{name}] {title}") for title, each in value.items()}
    entries = {
        plain_key(word): _checked(kind, f"{name} entry {word!r}", each)
        for word, each in value.items()
    }
    if len(entries) < len(value):
        raise ValueError(f"two keys of the {name} mean the same value")
    return entries


def plain_key(value: object) -> str:
    """Return the key of a value in a map: "1", 1 and 1.0 are the same, "MANUAL" stays a text."""
    written = str(value).strip()
    if written in ("True", "False"):
        return written.lower()
    if NUMBER.fullmatch(written):
        number = float(written)
        return str(int(number)) if number.is_integer() and abs(number) < 1e15 else str(number)
    return written


def looked_up(entries: Mapping[str, Any], value: object, default: object = None) -> Any:
    """Return what a map of the recipe makes of a value; `default` of one that is not in it."""
    entry = plain_key(value)
    if entry in entries or default is not None:
        return entries.get(entry, default)
    if not entry:
        raise ValueError('the cell is empty; fill it, or add blank = "hold" beside the map')
    hint = alternatives(str(value).strip(), entries)
    raise ValueError(f"{str(value)[:60]!r} is not in the recipe's map{hint}")


# Where a column can come from, and which keys may stand beside the one that says it.
SCALING = ("unit", "scale", "offset", "map", "above")
COLUMN_KINDS = {
    "column": (*SCALING, "absolute", "resample", "blank"),
    "topic": (*SCALING, "absolute", "resample", "field", "hold"),
    "value": ("unit",),
    "from": SCALING,
    "distance": ("axes",),
    "travelled": ("axes",),
}


@dataclass(kw_only=True)
class ColumnRule:
    """
    Where one column of the session comes from: `kind` is one of COLUMN_KINDS.

    A measured value is (scale · raw + offset) in its unit, or the absolute value of this.
    """

    name: str
    kind: str
    column: str | int = ""
    topic: str = ""
    value: float = 0.0
    origin: str = ""
    distance: tuple[str, ...] = ()
    travelled: str = ""
    unit: str | None = None
    scale: float = 1.0
    offset: float = 0.0
    map: dict[str, float] | None = None
    absolute: bool = False
    above: float | None = None
    resample: Method | None = None
    blank: Literal["hold", "linear"] | None = None
    path: FieldPath | None = None
    hold: bool = False
    axes: tuple[Axis, ...] = ()
    size: float = field(init=False, default=1.0)  # of its unit, in the session's

    def __post_init__(self):
        if self.kind in ("distance", "travelled"):
            if not self.axes:
                raise ValueError('needs axes, the axes that count, some of ["x", "y", "z"]')
            if self.kind == "distance" and len(self.distance) != 2:
                raise ValueError(f"distance is between two positions, got {len(self.distance)}")
            return
        if self.kind == "topic" and self.path is None:
            raise ValueError("needs field, the place in the message, such as 'axes[1]'")
        if self.hold and self.resample not in (None, "previous"):
            raise ValueError(f"hold keeps the previous value, but resample is {self.resample!r}")
        if self.blank == "linear" and self.above is None and self.name in (*STATES, "yaw"):
            raise ValueError(
                f'{self.name} has no value between two others; fill it with blank = "hold"'
            )
        needed = VOCABULARY[self.name].unit
        unit = self.unit or ("rad" if self.path and self.path.yaw else None)
        if unit is None and needed not in ("1", "measure"):
            raise ValueError(f"needs its unit (the session holds {needed})")
        if unit not in (None, needed):
            self.size = to_si(unit, needed)

    @property
    def needs(self) -> tuple[str, ...]:
        """The session columns that this one is computed from: the axes of each position."""
        stems = (*self.distance, self.travelled) if self.axes else ()
        return tuple(f"{stem}_{axis}" for stem in stems if stem for axis in self.axes)

    @property
    def label(self) -> str:
        """The column as errors name it."""
        if self.path:
            return f"field {self.path.text!r} ({self.name})"
        return f"column {self.column!r}" + ("" if self.column == self.name else f" ({self.name})")

    def convert(self, values: Any) -> np.ndarray:
        """Return raw numbers in the session's unit."""
        values = np.asarray(values, dtype=float)
        with np.errstate(over="ignore", invalid="ignore"):
            if (self.scale, self.offset) != (1.0, 0.0):
                values = self.scale * values + self.offset
            if self.absolute:
                values = np.abs(values)
            if self.size != 1.0:
                values = values * self.size
            if self.above is not None:
                values = np.where(np.isnan(values), values, values > self.above)
        return values


def _column_rule(name: str, table: Any) -> ColumnRule:
    where = f"[columns] {name}"
    if name not in VOCABULARY:
        remedy = 'write ours = { column = "theirs" } (ours: trustlab.sessions.vocabulary())'
        if name == "t":
            remedy = "time goes under [time]"
        elif name in Recipe.__dataclass_fields__:
            remedy = f"{name} goes above the first [table]"
        hint = did_you_mean(name, VOCABULARY)
        raise RecipeError(f"{where}: not in the vocabulary{hint}; {remedy}")
    kinds = [kind for kind in COLUMN_KINDS if isinstance(table, Mapping) and kind in table]
    if len(kinds) != 1:
        known = ", ".join(COLUMN_KINDS)
        raise RecipeError(f"{where}: needs exactly one of {known}, got {shown(table)}")
    allowed = (kinds[0], *COLUMN_KINDS[kinds[0]])
    return parse(ColumnRule, table, where, allowed, name=name, kind=kinds[0])


@dataclass(frozen=True, kw_only=True)
class MetadataRule:
    """Where one entry of the metadata comes from."""

    origin: str = ""
    value: Plain | None = None
    map: dict[str, Plain] | None = None
    default: Plain | None = None

    def __post_init__(self):
        constant, mapped = self.value is not None, self.map is not None
        if (
            bool(self.origin) == constant
            or mapped < (self.default is not None)
            or constant & mapped
        ):
            raise ValueError("needs either from or value; from may have a map, and this a default")


@dataclass(frozen=True, kw_only=True)
class TableRule:
    """How a table is written; without a header line its columns are numbered from 0."""

    header: bool = True
    delimiter: Literal[",", ";", "\t", "|", " "] | None = None
    decimal: Literal[".", ","] = "."
    skip_lines: int = 0
    encoding: Literal["utf-8", "cp1252"] = "utf-8"

    def __post_init__(self):
        if self.decimal == self.delimiter:
            raise RecipeError(
                f"decimal and delimiter of a table must differ, both are {self.decimal!r}; if "
                'cells are quoted, trustlab.read_frame(pandas.read_csv(path, decimal=","))'
            )


# The keys of [time], by the kind of log.
TIME_KEYS = {
    "table": ("unit", "column", "from_zero", "repeated", "sort", "jumps"),
    "bag": ("stamp", "topics", "repeated", "sort"),
}


@dataclass(frozen=True, kw_only=True)
class TimeRule:
    """
    How rows or messages are timed.

    A table has a column of times, which `from_zero` counts from the first sample; a message is
    timed by its receipt or by its header's stamp, and `topics` may differ.
    """

    kind: str
    unit: str | None = None
    column: str | int = "t"
    from_zero: bool = False
    stamp: Stamp = "receive"
    topics: dict[str, Stamp] | None = None
    repeated: Literal["first", "last", "mean"] | None = None
    sort: bool = False
    jumps: Literal["split"] | None = None

    def __post_init__(self):
        units = [unit for unit, (base, _) in UNITS.items() if base == "s"]
        if self.kind == "table" and self.unit not in units:  # as nearly always
            one_of("unit", self.unit, ("iso", "clock", *units))
        if self.sort and self.jumps:
            raise ValueError("sort orders all rows by time, which leaves no jumps to split at")

    def seconds(self, value: Any) -> Any:
        """Return times in seconds; dates come as whole nanoseconds since 1970."""
        if self.unit == "iso":
            # Below 2⁵³ ns floats are exact; of later times the parts are, and their sum is rounded.
            late = abs(value) >= 2**53
            return np.where(late, value // 10**9 + value % 10**9 / 1e9, value / 1e9)
        return value if self.unit in ("s", "clock") else value * to_si(self.unit, "s")

    def stamp_of(self, topic: str) -> str:
        """Return "receive" or "header" for one topic."""
        return (self.topics or {}).get(plain_key(topic), self.stamp)


@dataclass(frozen=True, kw_only=True)
class HeaderRule:
    """The table beside the sessions: its path, and path fields to the columns that name them."""

    file: PathPattern
    keys: dict[str, str]


@dataclass(frozen=True, kw_only=True)
class FilesRule:
    """Which files a recipe reads."""

    pattern: PathPattern


@dataclass(frozen=True, kw_only=True)
class Resampling(Checked):
    """How logs come to a uniform time axis, and its sample time [s]."""

    method: Method
    sample_time: Positive


@dataclass(frozen=True, kw_only=True)
class Splitting(Checked):
    """The gap [s] at which a log is split into several sessions."""

    gap: Positive


@dataclass(kw_only=True)
class Recipe:
    """
    A recipe, checked.

    Parameters
    ----------
    kind : {"table", "bag"}
        Which kind of log it reads.
    columns : mapping
        Session column to its rule.
    name, description : str
        The recipe's own name, and one line about it.
    files : FilesRule, optional
        Which files it reads, and what their paths say.
    table : TableRule
        How a table is written.
    time : mapping
        The entries of [time]; kept as a TimeRule.
    resampling : Resampling, optional
        How to resample, and to which sample time [s].
    metadata : mapping
        Metadata name to its rule, in the order of evaluation.
    performance_window : float, optional
        Length of the moving mean that the columns p_r and p_h are [s]; 0 if they are no means.
    header : HeaderRule, optional
        The table with one row per session.
    splitting : Splitting, optional
        The gap at which a log is split into several sessions.
    source : str
        The file it was read from.
    """

    kind: Literal["table", "bag"]
    columns: dict[str, ColumnRule]
    name: str = ""
    description: str = ""
    files: FilesRule | None = None
    table: TableRule = field(default_factory=TableRule)
    time: Any = None
    resampling: Resampling | None = None
    metadata: dict[str, MetadataRule] = field(default_factory=dict)
    performance_window: float | None = None
    header: HeaderRule | None = None
    splitting: Splitting | None = None
    source: str = "recipe"

    def __post_init__(self):
        if self.kind == "bag" and self.table != TableRule():
            raise ValueError('[table] is for kind = "table"')
        if self.time is None or isinstance(self.time, Mapping):
            keys = TIME_KEYS[self.kind]
            self.time = parse(TimeRule, self.time or {}, "[time]", keys, kind=self.kind)
        if self.performance_window is not None:
            window = not_negative("performance_window", self.performance_window)
            self.metadata = self.metadata | {"performance_window": MetadataRule(value=window)}
        if "source" in self.metadata:
            raise ValueError("[metadata] source: this name is taken; choose another")
        self.name = self.name or self.source
        foreign = "topic" if self.kind == "table" else "column"
        for title, rule in self.columns.items():
            where = f"[columns] {title}"
            if rule.kind == foreign:
                raise RecipeError(f'{where}: {foreign} does not go with kind = "{self.kind}"')
            for need in rule.needs:
                if need not in self.columns or self.columns[need].needs:
                    raise RecipeError(f"{where}: needs column {need!r} from the log")
        fields = self.pattern.types if self.pattern else {}
        for name in [*self.header.keys, *self.header.file.types] if self.header else ():
            if name not in fields:
                known = alternatives(name, fields, "its fields")
                raise RecipeError(f"[header]: {name!r} is no field of the files pattern{known}")

    @property
    def gap(self) -> float:
        """The longest gap [s] at which a log is not split."""
        return self.splitting.gap if self.splitting else np.inf

    @property
    def pattern(self) -> PathPattern | None:
        """Which files it reads, and what their paths say."""
        return self.files.pattern if self.files else None

    @classmethod
    def from_toml(cls, text: str, source: str = "recipe") -> "Recipe":
        """
        Return the recipe stated by a TOML text.

        Parameters
        ----------
        text : str
            The text; see the module's documentation.
        source : str
            The name of the recipe in errors.

        Raises
        ------
        RecipeError
            If the text is not TOML, or a key, name, unit or value in it cannot be followed; the
            error names the first, with its table and key.
        """
        with source_named(source):
            try:
                document = tomllib.loads(text)
            except (ValueError, RecursionError) as error:
                raise RecipeError(
                    f"not a TOML file ({error}); texts need quotes; help(trustlab.sessions.recipe) "
                    "has every key"
                ) from error
            return parse(cls, document, "recipe", source=source)


def load_recipe(recipe: str | os.PathLike | Recipe) -> Recipe:
    """
    Return a recipe by name or from a file.

    Parameters
    ----------
    recipe : str, path-like or Recipe
        The name of a recipe that comes with the package, the path of a TOML file, or a recipe,
        which is returned as it is.

    Raises
    ------
    RecipeError
        If there is no such recipe (the nearest name is suggested) or the file cannot be followed.
    """
    if isinstance(recipe, Recipe):
        return recipe
    path = path_of("recipe", recipe)
    shipped = {each.stem: each for each in (Path(__file__).parent / "recipes").glob("*.toml")}
    path = shipped.get(str(recipe), path)
    if not os.path.isfile(path):
        known = alternatives(path.stem, sorted(shipped))
        raise RecipeError(
            f"there is no recipe {str(recipe)!r}, neither as a file nor by name{known}"
        )
    try:
        text = path.read_bytes().decode("utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise RecipeError(f"cannot be read as UTF-8 text ({error})", str(path)) from error
    return Recipe.from_toml(text, str(path))
