"""
What a trial, a live study and a widget know of a task: settings, run, scripted person, measures.

A task's settings are plain JSON and determine a run but for the commands of the person. A run is
stepped by commands where its log is, a row at a time; the same commands give the same rows.
"""

from collections import deque
from collections.abc import Callable
from dataclasses import asdict, dataclass
from importlib import import_module
from typing import Annotated, Any

import numpy as np
import pandas as pd

from trustlab.models.checks import Checked, of_class, one_of, shown
from trustlab.sessions.session import Metadata, Session
from trustlab.trust.driving import TrustInLoop
from trustlab.trust.dynamics import MODELS

TASKS = ("ground_robot", "teleoperation", "team")
"""Names of the tasks; each is `TASK` of the module of that name in `tasks`."""

PERIOD = 0.05
"""How long a command holds in flights and teams [s]."""

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


def trust_as_json(trust: Any) -> dict | None:
    """
    Return a model of trust that drives as plain values for `study.json`; None for the printed one.
    """
    if trust is None:
        return None
    driver = of_class("trust", TrustInLoop.of(trust), TrustInLoop, "see trustlab.trust.MODELS")
    values = asdict(driver)
    for name, kind in MODELS.items():
        if type(driver.model) is kind:
            return values | {"model": name, "parameters": values["model"]}
    raise ValueError(
        f"trust must be one of trustlab.trust.MODELS ({', '.join(MODELS)}), got "
        f"{type(driver.model).__name__}: what is not in the package cannot be replayed from a "
        "study's plan"
    )


def trust_of(content: dict) -> TrustInLoop | None:
    """Return the model of trust that a plan or a run's settings hold."""
    if (stored := content["trust"]) is None:
        return None
    model = MODELS[stored["model"]](**stored["parameters"])
    return TrustInLoop(model, stored["every"], stored["start"])


Length = Annotated[float, (1.0, 3600.0)]
"""Of a run [s]."""

Delay = Annotated[float, (0.0, 2.0)]
"""How late pictures are shown at least in a study [s]."""


@dataclass(frozen=True, kw_only=True)
class HandSettings(Checked):
    """
    What the settings of flights and of a team's runs have in common: lengths [s], the least delay
    [s], and a model of trust.
    """

    duration: Length = 120.0
    training: Length = 60.0
    least_delay: Delay = 0.0
    trust: Any = None

    def __post_init__(self):
        trust_as_json(self.trust)
        super().__post_init__()

    def as_json(self) -> dict:
        """Return the settings as plain values for `study.json`."""
        return {**vars(self), "trust": trust_as_json(self.trust)}


def run_config(
    condition: str, seed: int, seconds: float, limits: dict[str, list[float]], **more: Any
) -> dict:
    """
    Return what the settings of every run hold, with the limits of each command, and what else those
    of a task do: its name as live_task, sample_time [s], columns, and how late the camera is [s].
    """
    return {
        "condition": condition,
        "seed": seed,
        "samples": round(seconds / more["sample_time"]),
        "commands": list(limits),
        "limits": limits,
        "clock": "real",
        "facts": {},
        **more,
    }


def hand_config(
    content: dict, condition: str, seed: int, choices: list[float], **more: Any
) -> dict:
    """
    Return the settings of a run that is commanded by a hand in its square and a choice, which is
    the third of the columns and has these limits.
    """
    square = [-1.0, 1.0]
    seconds = content["training" if condition == "training" else "duration"]
    limits = dict(zip(more["columns"], (square, square, choices), strict=False))
    more |= {"sample_time": PERIOD, "trust": content["trust"]}
    return run_config(condition, seed, seconds, limits, **more)


@dataclass(frozen=True)
class LiveTask:
    """
    A task that people do live.

    Parameters
    ----------
    name : str
        One of `TASKS`.
    conditions : tuple of str
        The conditions of a study; `practice` are the drives besides.
    reported : tuple of str
        The measures that a report analyses.
    settings : type
        The class of a study's settings.
    config : callable
        All that determines a run but the commands, as plain JSON, from what a study's plan holds,
        the condition, a seed, and what is known of the participant, if anything: see `run_config`.
    begin : callable
        A run by its config: `step(*command)` does a period and returns the row of the log,
        `picture()` is what the page draws, as plain JSON, `done` whether it is at its end.
    hand : callable
        A scripted person by the config and a random generator: a function from picture to command.
    measures : callable
        The outcome measures of a session.
    facts : callable
        What the metadata of a session say besides the config's "facts", by its table, off which it
        may take columns that are no signals.
    decisions : tuple of str
        The columns that a replay must give exactly.
    """

    name: str
    conditions: tuple[str, ...]
    reported: tuple[str, ...]
    settings: type
    config: Callable
    begin: Callable
    hand: Callable
    measures: Callable
    facts: Callable = lambda table: {}
    decisions: tuple[str, ...] = ()
    practice: tuple[str, ...] = ("training",)

    def check(self, config: dict, command: Any) -> None:
        """Refuse a command that no page sends."""
        names = config["commands"]
        numbers = isinstance(command, list) and all(map(is_number, command))
        if not numbers or len(command) != len(names):
            raise ValueError(f"a command is {', '.join(names)}, got {shown(command)}")
        for name, value in zip(names, command, strict=True):
            low, high = config["limits"][name]
            if not low <= value <= high or (name in WHOLE and value != round(value)):
                raise ValueError(f"{name} cannot be {value!r}")

    def session(self, config: dict, rows: Any, **metadata: Any) -> Session:
        """Return the session of a run's rows, at least two."""
        if len(rows) < LEAST_ROWS:
            least = LEAST_ROWS * config["sample_time"]
            raise ValueError(f"a session has at least two samples; wait until {least:g} s are done")
        index = pd.Index(np.round(config["sample_time"] * np.arange(len(rows)), 9), name="t")
        table = pd.DataFrame(np.array(rows, float), index, config["columns"])
        facts = {"seed": config["seed"], "task": self.name, **config["facts"]}
        facts |= self.facts(table)
        about = Metadata(condition=config["condition"], source="trustlab.live", more=facts)
        return Session(table, about.changed(**metadata))


def force_shown(session: Session) -> float:
    """Return the root mean square of the force that was shown [N]."""
    return float(np.sqrt((session["f_m_x"] ** 2 + session["f_m_y"] ** 2).mean()))


def task_named(name: str) -> LiveTask:
    """Return a task by its name."""
    return import_module(f"trustlab.live.tasks.{one_of('task', name, TASKS)}").TASK


def prepare(task: LiveTask, config: dict) -> None:
    """Compile what a run calls, and refuse what only a step can refuse, before anybody drives."""
    task.begin(config).step(*(config["limits"][name][0] for name in config["commands"]))


def scripted_commands(task: LiveTask, config: dict, hand: Callable) -> tuple[list, list]:
    """
    Return the commands and rows of a whole run by a scripted person, who sees each picture as late
    as the camera is.
    """
    run = task.begin(config)
    late = round(config["late"] / config["sample_time"])
    pictures = deque([run.picture()], late + 1)
    commands, rows = [], []
    while not run.done:
        commands.append([float(value) for value in hand(pictures[0])])
        rows.append(run.step(*commands[-1]))
        pictures.append(run.picture())
    return commands, rows
