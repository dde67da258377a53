"""
What a trial, a live study and a widget know of a task: settings, run, scripted person, measures.

A task's settings are plain JSON and determine a run but for the commands of the person. A run is
stepped by commands where its log is, a row at a time; the same commands give the same rows.
"""

from collections import deque
from collections.abc import Mapping
from dataclasses import asdict
from importlib import import_module
from typing import Any, ClassVar, Protocol

import numpy as np
import pandas as pd

from trustlab.models.checks import between, of_class, one_of, shown
from trustlab.sessions.session import Metadata, Session
from trustlab.trust.driving import TrustInLoop
from trustlab.trust.dynamics import MODELS

TASKS = ("ground_robot", "teleoperation", "team")
"""Names of the tasks; each is `TASK` of the module of that name in `tasks`."""

PERIOD = 0.05
"""How long a command holds in flights and teams [s]."""

MOST_DELAY = 2.0
"""The longest least delay of pictures in a study [s]."""

LEAST_ROWS = 2
LARGEST = 1e15
"""Size of a number in a message from a page that no measure has."""

WHOLE = ("mode", "leader_choice")
"""Commands that are whole numbers."""


def is_number(x: Any) -> bool:
    """
    Whether a value is a finite number of a size that any measure has; a whole number in JSON may
    have any number of digits.
    """
    return type(x) in (int, float) and -LARGEST <= x <= LARGEST


def trust_as_json(trust: Any) -> dict[str, Any] | None:
    """
    Return a model of trust that drives as plain values for `study.json`; None for the printed one.
    """
    if trust is None:
        return None
    driver = of_class("trust", TrustInLoop.of(trust), TrustInLoop, "see trustlab.trust.MODELS")
    names = {kind: name for name, kind in MODELS.items()}
    if type(driver.model) not in names:
        raise ValueError(
            f"trust must be one of trustlab.trust.MODELS ({', '.join(MODELS)}), got "
            f"{type(driver.model).__name__}: what is not in the package cannot be replayed from a "
            "study's plan"
        )
    values = asdict(driver)
    return values | {"model": names[type(driver.model)], "parameters": values["model"]}


def trust_of(content: Mapping[str, Any]) -> TrustInLoop | None:
    """Return the model of trust that a plan or a run's settings hold."""
    stored = content.get("trust")
    if stored is None:
        return None
    model = MODELS[stored["model"]](**stored["parameters"])
    return TrustInLoop(model, stored["every"], stored["start"])


class HandSettings:
    """
    What the settings of flights and of a team's runs have in common: lengths [s], the least delay
    [s], and a model of trust.
    """

    duration: float
    training: float
    least_delay: float
    trust: Any

    def __post_init__(self):
        trust_as_json(self.trust)
        between("duration", self.duration, 1.0, 3600.0)
        between("training", self.training, 1.0, 3600.0)
        between("least_delay", self.least_delay, 0.0, MOST_DELAY)

    def as_json(self) -> dict[str, Any]:
        """Return the settings as plain values for `study.json`."""
        return {**vars(self), "trust": trust_as_json(self.trust)}


class LiveRun(Protocol):
    """A run that was begun, stepped by commands."""

    @property
    def done(self) -> bool:
        """Whether it is at its end."""

    def step(self, *command: float) -> list[float]:
        """Do one period under a command; return the row of the log."""

    def picture(self) -> dict[str, Any]:
        """Return what the page draws, as plain JSON."""


class LiveTask:
    """
    A task that people do live.

    `practice` are drives besides those under a condition, `reported` the measures that a report
    analyses, `settings` the class of a study's settings, `decisions` the columns that a replay must
    give exactly.
    """

    name: ClassVar[str]
    conditions: ClassVar[tuple[str, ...]]
    practice: ClassVar[tuple[str, ...]] = ("training",)
    reported: ClassVar[tuple[str, ...]]
    settings: ClassVar[type]
    decisions: ClassVar[tuple[str, ...]] = ()

    def config(
        self, content: Mapping[str, Any], condition: str, known: Mapping[str, Any], seed: int
    ) -> dict[str, Any]:
        """
        Return all that determines a run but the commands, as plain JSON.

        `content` is what a study's plan holds, `known` what is known of the participant. Every task
        has live_task, condition, seed, sample_time [s], samples, columns, commands, limits (of each
        command), late (the camera's delay [s]) and clock.
        """
        raise NotImplementedError

    def hand_config(
        self,
        content: Mapping[str, Any],
        condition: str,
        seed: int,
        choice: tuple[str, float, float],
        **more: Any,
    ) -> dict[str, Any]:
        """
        Return such settings of a task that is commanded by a hand in its square and a choice, given
        by its name and limits, and what else they hold.
        """
        duration = content["training" if condition == "training" else "duration"]
        name, least, most = choice
        limits = {"pointer_x": [-1.0, 1.0], "pointer_y": [-1.0, 1.0], name: [least, most]}
        return {
            "live_task": self.name,
            "condition": condition,
            "trust": content.get("trust"),
            "seed": seed,
            "sample_time": PERIOD,
            "samples": round(duration / PERIOD),
            "duration": duration,
            "commands": list(limits),
            "limits": limits,
            "clock": "real",
            **more,
        }

    def begin(self, config: Mapping[str, Any]) -> LiveRun:
        """Return a run at its beginning."""
        raise NotImplementedError

    def hand(self, config: Mapping[str, Any], rng: np.random.Generator) -> Any:
        """Return a scripted person: a function from picture to command."""
        raise NotImplementedError

    def measures(self, session: Session) -> dict[str, float]:
        """Return the outcome measures of a run."""
        raise NotImplementedError

    def minutes(self, config: Mapping[str, Any]) -> float:
        """Return how long a run takes [min]."""
        return config["samples"] * config["sample_time"] / 60.0

    def check(self, config: Mapping[str, Any], command: Any) -> None:
        """Refuse a command that no page sends."""
        names = config["commands"]
        numbers = isinstance(command, list) and all(map(is_number, command))
        if not numbers or len(command) != len(names):
            raise ValueError(f"a command is {', '.join(names)}, got {shown(command)}")
        for name, value in zip(names, command, strict=True):
            low, high = config["limits"][name]
            if not low <= value <= high or (name in WHOLE and value != round(value)):
                raise ValueError(f"{name} cannot be {value!r}")

    def session(self, config: Mapping[str, Any], rows: Any, **metadata: Any) -> Session:
        """Return the session of a run's rows, at least two."""
        table = np.array(rows, dtype=float).reshape(len(rows), len(config["columns"]))
        if len(table) < LEAST_ROWS:
            least = LEAST_ROWS * config["sample_time"]
            raise ValueError(f"a session has at least two samples; wait until {least:g} s are done")
        index = pd.Index(np.round(config["sample_time"] * np.arange(len(table)), 9), name="t")
        facts = {"seed": config["seed"], "task": self.name}
        about = Metadata(condition=config["condition"], source="trustlab.live", more=facts)
        frame = pd.DataFrame(table, index, config["columns"])
        return Session(frame, about.changed(**metadata))


def force_shown(session: Session) -> float:
    """Return the root mean square of the force that was shown [N]."""
    return float(np.sqrt((session["f_m_x"] ** 2 + session["f_m_y"] ** 2).mean()))


def task_named(name: str) -> LiveTask:
    """Return a task by its name."""
    return import_module(f"trustlab.live.tasks.{one_of('task', name, TASKS)}").TASK


def task_of(config: Mapping[str, Any]) -> LiveTask:
    """Return the task of a run's settings."""
    return task_named(config["live_task"])


def prepare(task: LiveTask, config: Mapping[str, Any]) -> None:
    """Compile what a run calls, and refuse what only a step can refuse, before anybody drives."""
    task.begin(config).step(*(config["limits"][name][0] for name in config["commands"]))


def scripted_commands(
    task: LiveTask, config: Mapping[str, Any], hand: Any
) -> tuple[list[list[float]], list[list[float]]]:
    """
    Return the commands and rows of a whole run by a scripted person, who sees each picture as late
    as the camera is.
    """
    run = task.begin(config)
    late = round(config["late"] / config["sample_time"])
    pictures = deque([run.picture()], late + 1)
    commands: list[list[float]] = []
    rows: list[list[float]] = []
    while not run.done:
        commands.append([float(value) for value in hand(pictures[0])])
        rows.append(run.step(*commands[-1]))
        pictures.append(run.picture())
    return commands, rows
