"""
What a live study and a widget know of a task: config, begin, step, replay, measures and view.

A task's configuration is plain JSON and determines a run but for the commands of the person. A run
is stepped by commands, a row at a time, in a browser or by the study's server; replayed from the
commands of its rows it must give the same bits.
"""

from collections.abc import Mapping
from dataclasses import asdict
from importlib import import_module
from typing import Any, ClassVar, Protocol

import numpy as np
import pandas as pd

from trustlab.models.checks import of_class, one_of, shown
from trustlab.sessions.session import Metadata, Session
from trustlab.trust.driving import TrustInLoop
from trustlab.trust.dynamics import MODELS

TASKS = ("ground_robot", "teleoperation", "team")
"""Names of the tasks; each is `TASK` of the module of that name beside this one."""

PERIOD = 0.05
"""How long a command holds in flights and teams [s]."""

LEAST_ROWS = 2


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
    """Return the model of trust that a plan or a configuration holds."""
    stored = content.get("trust")
    if stored is None:
        return None
    model = MODELS[stored["model"]](**stored["parameters"])
    return TrustInLoop(model, stored["every"], stored["start"])


class LiveRun(Protocol):
    """A run that was begun, stepped by commands."""

    @property
    def done(self) -> bool:
        """Whether it is at its end."""

    def step(self, *command: float) -> list[float]:
        """Do one period under a command; return the row of the log, which begins with it."""

    def picture(self) -> dict[str, Any]:
        """Return what the page draws, as plain JSON."""


class LiveTask:
    """
    A task that people do live.

    This class has what tasks share whose configurations say so by "served": they are computed where
    their rows are kept, by the server or a notebook's kernel; others by browsers. `practice` are
    drives besides those under a condition, `reported` the measures that a report analyses,
    `settings` the class of a study's settings.
    """

    name: ClassVar[str]
    conditions: ClassVar[tuple[str, ...]]
    practice: ClassVar[tuple[str, ...]] = ("training",)
    reported: ClassVar[tuple[str, ...]]
    settings: ClassVar[type]

    def config(
        self, content: Mapping[str, Any], condition: str, known: Mapping[str, Any], seed: int
    ) -> dict[str, Any]:
        """
        Return all that determines a run but the commands, as plain JSON.

        `content` is what a study's plan holds, `known` what is known of the participant.
        """
        raise NotImplementedError

    def begin(self, config: Mapping[str, Any]) -> LiveRun:
        """Return a run at its beginning."""
        raise NotImplementedError

    def hand(self, config: Mapping[str, Any], rng: np.random.Generator) -> Any:
        """Return a scripted person for rehearsals: a function from picture to command."""
        raise NotImplementedError

    def scripted_rows(self, config: Mapping[str, Any], rng: np.random.Generator) -> np.ndarray:
        """Return what a scripted person's page would send of a whole run, a row per period."""
        run, hand = self.begin(config), self.hand(config, rng)
        rows = []
        while not run.done:
            rows.append(run.step(*hand(run.picture())))
        return np.array(rows)[:, : len(sent_columns(config))]

    def memory(self, config: Mapping[str, Any]) -> dict[str, Any] | None:
        """Return what a browser needs beside the settings to compute a run; None if it does not."""
        return None

    def measures(self, session: Session) -> dict[str, float]:
        """Return the outcome measures of a run."""
        raise NotImplementedError

    def minutes(self, config: Mapping[str, Any]) -> float:
        """Return how long a run takes [min]."""
        return config["samples"] * config["sample_time"] / 60.0

    def at_end(self, config: Mapping[str, Any], session: Session) -> bool:
        """Whether a run is complete."""
        return len(session) >= config["samples"]

    def replay(self, config: Mapping[str, Any], rows: Any) -> bool | int:
        """
        Return whether rows are, bit for bit, what their commands lead to, or the first that is not.
        """
        run = self.begin(config)
        count = len(config["commands"])
        for k, row in enumerate(checked_rows(config, rows)):
            if run.done or not np.array_equal(run.step(*row[:count].tolist()), row):
                return k
        return True

    def session(self, config: Mapping[str, Any], rows: Any, **metadata: Any) -> Session:
        """Return the session of a run's rows, at least two."""
        table = checked_rows(config, rows)
        if len(table) < LEAST_ROWS:
            least = LEAST_ROWS * config["sample_time"]
            raise ValueError(f"a session has at least two samples; wait until {least:g} s are done")
        index = pd.Index(np.round(config["sample_time"] * np.arange(len(table)), 9), name="t")
        facts = {"seed": config["seed"], "task": self.name}
        about = Metadata(condition=config["condition"], source="trustlab.live", more=facts)
        frame = pd.DataFrame(table, index, config["columns"])
        return Session(frame, about.changed(**metadata))


def task_named(name: str) -> LiveTask:
    """Return a task by its name."""
    return import_module(f"trustlab.live.tasks.{one_of('task', name, TASKS)}").TASK


def task_of(config: Mapping[str, Any]) -> LiveTask:
    """Return the task of a run's configuration."""
    return task_named(config["live_task"])


def sent_columns(config: Mapping[str, Any]) -> list[str]:
    """Return the columns that a page sends: all, or commands where the server computes the rest."""
    return config["commands"] if config.get("served") else config["columns"]


def checked_rows(config: Mapping[str, Any], rows: Any) -> np.ndarray:
    """Return the rows of a run as a table; refuse what cannot be one."""
    columns, most = config["columns"], config["samples"]
    try:
        table = np.ascontiguousarray(rows, dtype=float)
    except (TypeError, ValueError):
        raise ValueError(f"rows must be numbers, got {shown(rows)}") from None
    if table.ndim != 2 or table.shape[1] != len(columns) or not 1 <= len(table) <= most:
        raise ValueError(f"rows must have shape (1 to {most}, {len(columns)}), got {table.shape}")
    return table


class ServedRun:
    """
    A run that is computed where its rows are kept: rows of commands become rows of the log.

    A row is computed once; one that is sent again, because it could not be kept, comes out the
    same.
    """

    def __init__(self, config: Mapping[str, Any], rows: list[list[float]]):
        self.run = task_of(config).begin(config)
        self.count = len(config["commands"])
        self.rows: list[list[float]] = []
        self.complete(rows)

    def complete(self, rows: list[list[float]]) -> list[list[float]]:
        """
        Return rows, [number, ms, commands …], with all columns of the log; what lies beyond the end
        is left out.
        """
        completed = []
        for first, stamp, *values in rows:
            number = int(first)
            if number == len(self.rows) and not self.run.done:
                self.rows.append([number, stamp, *self.run.step(*values[: self.count])])
            if number < len(self.rows):
                completed.append(self.rows[number])
        return completed

    def picture(self) -> dict[str, Any]:
        """Return what the page draws, and how many rows that is behind."""
        return {"k": len(self.rows), "done": self.run.done, **self.run.picture()}
