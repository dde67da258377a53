"""What a run is set to: model, condition, bounds and topics, from a TOML file or its tables."""

import dataclasses
import tomllib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property, partial
from importlib import import_module
from pathlib import Path
from typing import Any

from trustlab.allocation.correction import ThresholdCorrector
from trustlab.models.checks import Checked, one_of
from trustlab.models.published import published_models
from trustlab.models.tsc import HumanModel, RobotModel, TscModel
from trustlab.ros.core import FIELDS, AllocationCore, CoreSettings, Watchdog
from trustlab.sessions.patterns import FieldPath


@dataclass(frozen=True)
class Topic:
    """
    A topic of a run.

    Parameters
    ----------
    topic : str
        Its name.
    type : str
        The type of its messages, for example "nav_msgs/msg/Odometry".
    fields : tuple of str
        Where the numbers stand in a message, as in a recipe: "pose.pose.position.x", "axes[1]".
    scale : tuple of float
        What the numbers are multiplied with, one for each field; 1 where it is left out.
    stamp : {"header", "receive"}
        Time of measurement: that of the message's header, if it has one, or of its arrival.
    best_effort : bool
        Whether messages may be lost; a publisher that is set so is not heard otherwise.

    Raises
    ------
    ValueError
        If a field path cannot be read, or the stamp is unknown.
    """

    topic: str
    type: str
    fields: tuple[str, ...] = ()
    scale: tuple[float, ...] = ()
    stamp: str = "header"
    best_effort: bool = False

    def __post_init__(self):
        one_of("stamp", self.stamp, ("header", "receive"))
        self.__dict__.update(fields=tuple(self.fields), scale=tuple(self.scale))
        if self.scale and len(self.scale) != len(self.fields):
            raise ValueError(f"{self.topic}: {len(self.fields)} fields, {len(self.scale)} scales")
        for text in self.fields:
            FieldPath(text)  # refuses one that cannot be read

    @cached_property
    def paths(self) -> list[list]:
        """The steps that lead to each field."""
        return [FieldPath(text).steps for text in self.fields]

    def numbers(self, message: Any) -> tuple[float, ...]:
        """
        Return the numbers of a message.

        Parameters
        ----------
        message : object
            As a ROS library hands it out.

        Raises
        ------
        ValueError
            If the message has no number there.
        """
        scales = self.scale or (1.0,) * len(self.fields)
        try:
            numbers = [float(_part(message, steps)) for steps in self.paths]
        except (AttributeError, IndexError, TypeError, ValueError) as error:
            raise ValueError(f"no number at {', '.join(self.fields)} ({error})") from None
        return tuple(scale * number for scale, number in zip(scales, numbers, strict=True))

    def fill(self, message: Any, values: tuple[float, ...]) -> None:
        """
        Set the numbers of a message.

        Parameters
        ----------
        message : object
            As a ROS library makes it.
        values : tuple of float
            One for each field.
        """
        for (*steps, name), value in zip(self.paths, values, strict=True):
            setattr(_part(message, steps), name, value)


def _part(message: Any, steps: Iterable) -> Any:
    """Return the part of a message to which the steps of a path lead."""
    for step in steps:
        message = getattr(message, step) if isinstance(step, str) else message[step]
    return message


# The first message of a recording: the run's tables, as JSON; then notes of the node, and by how
# much the computer's clock is ahead of the run's [ns].
RUN = "/allocation/run"
NOTE = "/allocation/note"
CLOCK = "/allocation/clock"
OWN_TYPES = {RUN: "std_msgs/msg/String", NOTE: "std_msgs/msg/String", CLOCK: "std_msgs/msg/Int64"}
# What is published and recorded beside the command, as Float64: fields of a `Decision`.
STATES = {f"/allocation/{name}": name for name in ("mode", "tsc", "suggestion", "lower", "upper")}
_TWIST = ("linear.x", "angular.z")
FLOAT = "std_msgs/msg/Float64"
# By name, what a run listens to and where its command goes.
TOPICS = {
    "odometry": Topic(
        "/odom", "nav_msgs/msg/Odometry", ("pose.pose.position.x", "pose.pose.position.y")
    ),
    "operator": Topic("/operator/cmd_vel", "geometry_msgs/msg/Twist", _TWIST),
    "autonomy": Topic("/autonomy/cmd_vel", "geometry_msgs/msg/Twist", _TWIST),
    "path_error": Topic("/path_error", FLOAT, ("data",)),
    "button": Topic("/operator/manual", "std_msgs/msg/Bool", ("data",)),
    "stop": Topic("/operator/stop", "std_msgs/msg/Bool", ("data",)),
    "release": Topic("/operator/release", "std_msgs/msg/Bool", ("data",)),
    "command": Topic("/cmd_vel", "geometry_msgs/msg/Twist", _TWIST),
}


@dataclass(frozen=True)
class RunSettings(Checked):
    """
    What a run is set to.

    Parameters
    ----------
    model : TscModel
        Of the person who drives.
    condition, thresholds : object
        As for `AllocationCore`.
    rule : object or str
        As for `AllocationCore`; or "module:name" of what makes it. A run whose rule has such a name
        can be replayed from its bag.
    correction : mapping, optional
        Arguments of `ThresholdCorrector`: target, horizon, c_b.
    settings : CoreSettings
        Bounds, rates, watchdogs, window.
    topics : mapping of str to Topic
        Those that differ from `TOPICS`, by name.
    facts : mapping
        Metadata of the session: participant, synthetic, and any other name.

    Raises
    ------
    ValueError
        If a topic is unknown.

    Examples
    --------
    >>> import trustlab as tl
    >>> run = tl.ros.RunSettings(tl.published_models()["1"], "C3", thresholds=(0.02, 0.45))
    >>> tl.ros.RunSettings.of(run.tables()) == run
    True
    """

    model: TscModel
    condition: str | None = None
    thresholds: tuple[float, float] | None = None
    rule: Any = None
    correction: Mapping | None = None
    settings: CoreSettings = field(default_factory=CoreSettings)
    topics: Mapping[str, Topic] = field(default_factory=dict)
    facts: Mapping = field(default_factory=dict)

    def __post_init__(self):
        super().__post_init__()
        for name, topic in self.topics.items():
            one_of("topics", name, TOPICS)
            usual = len(TOPICS[name].fields)
            counts = (1, 2) if name == "path_error" else (usual,)
            if len(topic.fields) not in counts:
                raise ValueError(f"{name} needs {usual} fields, got {len(topic.fields)}")
        self.__dict__["topics"] = {**TOPICS, **self.topics}

    @classmethod
    def of(cls, tables: Mapping, folder: Path = Path()) -> "RunSettings":
        """
        Return the run that tables state, as in a TOML file.

        Parameters
        ----------
        tables : mapping
            model, and any other parameter of this class by name. The model is one of
            {published: "1"}, {session: "pilot.csv"}, which is fitted now, or {human: {…}, robot:
            {…}}.
        folder : Path
            Where a session's path starts.

        Raises
        ------
        ValueError
            If a name or a value is not understood.
        """
        values = {name: value for name, value in tables.items() if value is not None}
        settings = dict(values.pop("settings", {}))
        settings["watchdogs"] = {
            name: _made(Watchdog, f"settings.watchdogs.{name}", table)
            for name, table in settings.pop("watchdogs", {}).items()
        }
        model, sample_time = _model_of(values.pop("model", {}), folder)
        if sample_time is not None:
            settings.setdefault("model_sample_time", sample_time)
        topics = {}
        for name, table in values.pop("topics", {}).items():
            changed = partial(dataclasses.replace, TOPICS[one_of("[topics]", name, TOPICS)])
            topics[name] = _made(changed, f"topics.{name}", table)
        if "thresholds" in values:
            values["thresholds"] = tuple(values["thresholds"])
        core = _made(CoreSettings, "settings", settings)
        return _made(cls, "the run", values | {"model": model, "topics": topics, "settings": core})

    def tables(self) -> dict:
        """Return the run as plain tables; of a rule without a name nothing is left."""
        name = self.rule if isinstance(self.rule, str) else None
        return dataclasses.asdict(dataclasses.replace(self, rule=name))

    def types(self) -> dict[str, str]:
        """Return the types of the messages of every topic recorded."""
        named = {topic.topic: topic.type for topic in self.topics.values()}
        return OWN_TYPES | dict.fromkeys(STATES, FLOAT) | named

    def core(self) -> AllocationCore:
        """Return a decision core for one run, with everything compiled that it will call."""
        correction = None
        if self.correction is not None:
            corrector = partial(ThresholdCorrector, self.model)
            correction = _made(corrector, "correction", self.correction)
        rule = _imported(self.rule)() if isinstance(self.rule, str) else self.rule
        allocation = self.model, self.condition, self.thresholds, rule, correction
        trial = AllocationCore(*allocation, dataclasses.replace(self.settings, wait=0.0))
        for name, fields in FIELDS.items():
            trial.hear(name, 0.0, (0.0,) * len(fields), 0.0)
        trial.step(0.0)
        if trial.stopped:
            raise ValueError(trial.notes[-1][1])
        return AllocationCore(*allocation, self.settings)


def read_toml(path: str | Path) -> RunSettings:
    """
    Read a run from a TOML file.

    Parameters
    ----------
    path : path-like
        The file; its tables are those of `RunSettings.of`.

    Returns
    -------
    RunSettings

    Raises
    ------
    ValueError
        If it is no TOML, or a table is not understood; the error names the file.
    """
    path = Path(path)
    try:
        return RunSettings.of(tomllib.loads(path.read_text(encoding="utf-8")), path.parent)
    except (ValueError, OSError) as error:
        raise ValueError(f"{path}: {getattr(error, 'strerror', error)}") from error


def _model_of(table: Mapping, folder: Path) -> tuple[Any, float | None]:
    """Return the model of a run, and its sample time where it is fitted to a session."""
    if set(table) == {"published"}:
        models = published_models()
        return models[one_of("model.published", str(table["published"]), models)], None
    if set(table) == {"session"}:
        from trustlab.identification.tsc import fit_tsc
        from trustlab.sessions.reading import read_session

        session = read_session(folder / table["session"])
        fit = fit_tsc(session)
        if not fit.success:
            raise ValueError(f"{table['session']} gives no model: {fit.message}")
        return fit.model, session.sample_time
    if set(table) != {"human", "robot"}:
        raise ValueError(
            "model needs published, session, or human and robot; got "
            f"{', '.join(table) or 'nothing'}"
        )
    robot = _made(RobotModel, "model.robot", table["robot"])
    return TscModel(robot, _made(HumanModel, "model.human", table["human"])), None


def _made(kind: Callable, where: str, table: Mapping) -> Any:
    """Return an object from a table of its arguments, of which none is unknown or missing."""
    try:
        return kind(**table)
    except TypeError as error:
        raise ValueError(f"[{where}] {error}") from None


def _imported(name: str) -> Any:
    """Return what "module:name" names."""
    module, _, attribute = name.partition(":")
    try:
        return getattr(import_module(module), attribute)
    except (ImportError, AttributeError, ValueError) as error:
        raise ValueError(f"{name!r} must be module:name of something to import: {error}") from None
