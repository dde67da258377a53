"""What a run is set to: model, condition, bounds and topics, from a TOML file or its tables."""

import tomllib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path
from pkgutil import resolve_name
from typing import Any

from trustlab.allocation.correction import ThresholdCorrector
from trustlab.allocation.limits import threshold_pair
from trustlab.allocation.rules import prepared_rule
from trustlab.live.condition import given_thresholds
from trustlab.models.checks import Checked, finite_array, list_of, of_class, one_of, shown, table_of
from trustlab.models.published import published_models
from trustlab.models.tsc import HumanModel, RobotModel, TscModel
from trustlab.ros.core import INPUTS, AllocationCore, CoreSettings, Watchdog
from trustlab.sessions.patterns import FieldPath
from trustlab.sessions.session import Metadata, metadata_to_json
from trustlab.testbeds.deciding import CONDITIONS


@dataclass(frozen=True)
class Topic(Checked):
    """
    A topic of a run.

    Parameters
    ----------
    topic : str
        Its name.
    type : str
        The type of its messages, for example "nav_msgs/msg/Odometry".
    fields : tuple of str
        Where the numbers stand in a message: "pose.pose.position.x", "axes[1]".
    scale : tuple of float
        What the numbers are multiplied with, one for each field; 1 where it is left out.
    stamp : {"header", "receive"}
        Time of measurement: that of the message's header, if it has one, or of its arrival.
    best_effort : bool
        Whether messages may be lost; a publisher that is set so is not heard otherwise.

    Raises
    ------
    ValueError
        If a field path cannot be read, the stamp is unknown, or a scale is no number.
    """

    topic: str
    type: str
    fields: tuple[str, ...] = ()
    scale: tuple[float, ...] = ()
    stamp: str = "header"
    best_effort: bool = False

    def __post_init__(self):
        super().__post_init__()
        of_class("topic", self.topic, str)
        one_of("stamp", self.stamp, ("header", "receive"))
        fields = tuple(list_of("fields", self.fields))
        if self.scale:
            finite_array("scale", self.scale, length=len(fields))
        self.__dict__.update(fields=fields, scale=tuple(self.scale))
        _ = self.places  # refuses a path that cannot be read

    @cached_property
    def places(self) -> list[tuple[list, float]]:
        """The steps that lead to each field, and its scale."""
        scales = self.scale or (1.0,) * len(self.fields)
        paths = [FieldPath(text) for text in self.fields]
        for path in paths:
            if path.yaw or path.selectors:
                raise ValueError(f"{path.text!r} is no plain field, like 'linear.x' or 'axes[1]'")
        return list(zip([path.steps for path in paths], scales, strict=True))

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
        try:
            return tuple(scale * float(_part(message, steps)) for steps, scale in self.places)
        except (AttributeError, IndexError, TypeError, ValueError) as error:
            raise ValueError(f"no number at {', '.join(self.fields)} ({error})") from None

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
        for ((*steps, name), scale), value in zip(self.places, values, strict=True):
            setattr(_part(message, steps), name, scale * value)


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
# What is published and recorded beside the command, as Float64: fields of a `Decision`.
STATES = {f"/allocation/{name}": name for name in ("mode", "tsc", "suggestion", "lower", "upper")}
FLOAT = "std_msgs/msg/Float64"
OWN_TYPES = {RUN: "std_msgs/msg/String", NOTE: "std_msgs/msg/String", CLOCK: "std_msgs/msg/Int64"}
OWN_TYPES |= dict.fromkeys(STATES, FLOAT)
_TWIST = ("geometry_msgs/msg/Twist", ("linear.x", "angular.z"))
_BOOL = ("std_msgs/msg/Bool", ("data",))
# By name, what a run listens to and where its command goes.
TOPICS = {
    "odometry": Topic(
        "/odom", "nav_msgs/msg/Odometry", ("pose.pose.position.x", "pose.pose.position.y")
    ),
    "operator": Topic("/operator/cmd_vel", *_TWIST),
    "autonomy": Topic("/autonomy/cmd_vel", *_TWIST),
    "path_error": Topic("/path_error", FLOAT, ("data",)),
    "button": Topic("/operator/manual", *_BOOL),
    "stop": Topic("/operator/stop", *_BOOL),
    "release": Topic("/operator/release", *_BOOL),
    "command": Topic("/cmd_vel", *_TWIST),
}


# What a run itself writes into the metadata of its session.
WRITTEN = {
    "condition",
    "source",
    "notes",
    "performance",
    "performance_window",
    "interrupted",
    "log",
}


@dataclass(frozen=True)
class RunSettings(Checked):
    """
    What a run is set to.

    Parameters
    ----------
    model : TscModel
        Of the person who drives, for example `fit_tsc(session).model`.
    condition : {"C1", "C2", "C3", "C4", "C5"}, optional
        Who allocates: the button alone (C1), suggestions by (2.8) or Algorithm 2 that the button
        may follow (C2, C4), or these rules at once (C3, C5).
    thresholds : tuple of float, optional
        TSC_l and TSC_u; needed in C2 and C3, refused elsewhere.
    rule : object or str, optional
        A rule of your own, which allocates at once; takes the place of `condition`. Where its
        `step` returns a share between 0 and 1, the operator's, the robot gets
        α u_h + (1 − α) u_a. Or "module:name" of what makes it: a run whose rule has such a name
        can be replayed from its bag.
    correction : mapping, optional
        Arguments of `ThresholdCorrector`, which moves the thresholds of C2 or C3 towards its
        target, step by step (2.40)-(2.44): target, horizon, c_b.
    settings : CoreSettings
        Bounds, rates, watchdogs, window.
    topics : mapping of str to Topic
        Those that differ from `TOPICS`, by name.
    facts : mapping
        Metadata of the session: participant, synthetic, and any name that the run does not write.

    Raises
    ------
    ValueError
        If not exactly one of condition and rule is present, thresholds or a correction are missing
        or unused, a topic is unknown or taken, or a fact cannot be written.

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
        if (self.condition is None) == (self.rule is None):
            raise ValueError("a run needs one of these: a condition, C1 to C5, or a rule")
        if self.rule is None:
            one_of("condition", self.condition, CONDITIONS)
        elif not isinstance(self.rule, str):
            prepared_rule(self.rule)
        if given_thresholds(self.condition or "a rule of your own", self.thresholds) is not None:
            self.__dict__["thresholds"] = threshold_pair("threshold", self.thresholds)
        if self.correction is not None:
            table_of("correction", self.correction)
            if self.thresholds is None:
                raise ValueError("a correction starts from thresholds; use it with C2 or C3")
        for name, topic in table_of("topics", self.topics).items():
            of_class(f"topics[{name!r}]", topic, Topic)
        # Refuses what a file cannot hold.
        metadata_to_json(_made(Metadata().changed, "facts", self.facts))
        for name in WRITTEN & set(self.facts):
            raise ValueError(f"facts: {name!r} is written by the run itself; choose another name")
        self.__dict__["topics"] = {**TOPICS, **self.topics}
        taken = dict.fromkeys(OWN_TYPES)
        for name, topic in self.topics.items():
            usual = len(TOPICS[one_of("topics", name, TOPICS)].fields)
            most = 2 if name == "path_error" else usual
            if not usual <= len(topic.fields) <= most:
                raise ValueError(f"{name} needs {usual} fields, got {topic.fields}")
            use = name == "command", topic.type, topic.best_effort
            if taken.setdefault(topic.topic, use) != use:
                raise ValueError(
                    f"{name}: {topic.topic} is taken; inputs of one type and best_effort alone "
                    "share a topic"
                )
        if topic.best_effort or topic.stamp != "header":  # of the command, the last one
            raise ValueError("command: best_effort and stamp have no effect; leave them out")

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
        for name in ("model", "settings", "topics"):
            values[name] = _made(dict, name, values.get(name, {}))
        settings, topics = values["settings"], values["topics"]
        watchdogs = _made(dict, "settings.watchdogs", settings.get("watchdogs", {}))
        for name, table in watchdogs.items():
            watchdogs[name] = _made(Watchdog, f"settings.watchdogs.{name}", table)
        values["model"], fitted = _model_of(values["model"], folder)
        for name, table in topics.items():
            changed = partial(replace, TOPICS[one_of("[topics]", name, TOPICS)])
            topics[name] = _made(changed, f"topics.{name}", table)
        settings = fitted | settings | {"watchdogs": watchdogs}
        values["settings"] = _made(CoreSettings, "settings", settings)
        return _made(cls, "the run", values)

    def tables(self) -> dict:
        """Return the run as plain tables; of a rule without a name nothing is left."""
        return asdict(self) | {"rule": self.rule if isinstance(self.rule, str) else None}

    def types(self) -> dict[str, str]:
        """Return the types of the messages of every topic recorded."""
        return OWN_TYPES | {topic.topic: topic.type for topic in self.topics.values()}

    def core(self) -> AllocationCore:
        """Return a decision core for one run, with everything compiled that it will call."""
        rule, correction = self.rule, self.correction
        if correction is not None:
            correction = _made(partial(ThresholdCorrector, self.model), "correction", correction)
        if isinstance(rule, str):
            rule = _made(_imported(rule), "rule", {})
        allocation = self.model, self.condition, self.thresholds, rule, correction
        trial = AllocationCore(*allocation, replace(self.settings, wait=0.0))
        for name in INPUTS:
            trial.hear(name, 0.0, (0.0,) * len(TOPICS[name].fields), 0.0)
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
        If it is no TOML, a table is not understood, or no core can be made of it; the error names
        the file.
    """
    path = Path(path)
    try:
        run = RunSettings.of(tomllib.loads(path.read_text(encoding="utf-8")), path.parent)
        run.core()
        return run
    except (ValueError, OSError, TypeError, AttributeError) as error:
        raise ValueError(f"{path}: {getattr(error, 'strerror', error)}") from error


def _model_of(table: Mapping, folder: Path) -> tuple[Any, dict]:
    """Return the model of a run, and the setting that goes with one fitted to a session."""
    if set(table) == {"published"}:
        models = published_models()
        return models[one_of("model.published", str(table["published"]), models)], {}
    if set(table) == {"session"}:
        from trustlab.identification.tsc import fit_tsc
        from trustlab.sessions.reading import read_session

        session = read_session(folder / str(table["session"]))
        fit = fit_tsc(session)
        if not fit.success:
            raise ValueError(f"{table['session']} gives no model: {fit.message}")
        return fit.model, {"model_sample_time": session.sample_time}
    if set(table) != {"human", "robot"}:
        raise ValueError(
            "model needs published, session, or human and robot; got "
            f"{', '.join(table) or 'nothing'}"
        )
    robot = _made(RobotModel, "model.robot", table["robot"])
    return TscModel(robot, _made(HumanModel, "model.human", table["human"])), {}


def _made(kind: Callable, where: str, table: Mapping) -> Any:
    """Return an object from a table of its arguments, of which none is unknown or missing."""
    if not isinstance(table, Mapping):
        raise ValueError(f"[{where}] must be a table, got {shown(table)}")
    try:
        return kind(**table)
    except (TypeError, ValueError) as error:
        raise ValueError(f"[{where}] {error}") from None


def _imported(name: str) -> Any:
    """Return what "module:name" names."""
    try:
        return resolve_name(name)
    except (ImportError, AttributeError, ValueError) as error:
        raise ValueError(
            f"rule = {name!r} must be module:name of something to import, from the folder where "
            f"Python was started for example: {error}"
        ) from None
