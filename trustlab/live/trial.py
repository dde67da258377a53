"""A person's run of a task: nothing but a fold over its log."""

import threading
import time
from collections.abc import Iterable, Iterator
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from trustlab.live.log import Log, LogError, read_log
from trustlab.live.task import LiveTask, is_number
from trustlab.models.digest import room_digest
from trustlab.sessions.session import Session

STILL = 0.4
"""A longer time between two messages of a page is a pause [s]."""

SAME = 1e-9
"""How far a signal of a replay may lie from the logged one; decisions are equal."""


@cache
def made_by() -> dict[str, str]:
    """Return the version of the package and a digest of the sources that compute drives."""
    return {"version": version("trustlab"), "sources": room_digest("live")[:16]}


class Record:
    """
    What the entries of a log say, without any physics.

    The first entry holds the settings and what made them; each other entry has the time `at` [s]
    and some of: window, a page that drives from now on; note; commands, with the time of the
    picture that was `seen` [periods]; the rows that earlier commands made; end, and why.
    """

    def __init__(self, header: dict, entries: Iterable[dict] = ()):
        self.header = header
        self.settings: dict = header["settings"]
        self.commands = []
        self.rows = []
        self.window = self.end = ""
        self.pauses = []
        self.periods = []
        self.delays = []
        self._heard = 0.0
        self._noted = []
        for entry in entries:
            self.take(entry)

    def take(self, entry: dict) -> None:
        """Take an entry over."""
        if "window" in entry:
            self.window = entry["window"]
            self._noted += ["begun again"] if self.commands else []
        if "note" in entry:
            self._noted.append(entry["note"])
        self.rows += entry.get("rows", [])
        self.end = entry.get("end", self.end)
        commands = entry.get("commands", [])
        if not commands:
            return
        gap = max(entry["at"] - self._heard, 0.0)  # the clock may have been set back
        if self.commands and (self._noted or gap > STILL):
            why = "; ".join(self._noted) or "nothing was heard"
            row = len(self.commands)
            self.pauses.append({"row": row, "seconds": round(gap, 2), "why": why})
        elif self.commands:
            self.periods += [gap / len(commands)] * len(commands)
        late = len(self.commands) - entry["seen"]
        self.delays.append(late * self.settings["sample_time"])
        self.commands += commands
        self._heard, self._noted = entry["at"], []

    def facts(self, fault: str) -> dict:
        """Return what a session's metadata say; `fault` is what is wrong, "" for nothing."""
        facts = {"verified": not fault, "finished": bool(self.end), "pauses": self.pauses}
        facts |= {"not_verified": fault} if fault else {}
        if self.periods:
            facts["period_median"] = float(np.median(self.periods))
            facts["period_max"] = max(self.periods)
        facts["delay"] = float(np.percentile(self.delays or [0.0], 97.0))
        return facts

    @property
    def other_maker(self) -> str:
        """What else than this package made the log, "" for nothing."""
        made = {name: self.header.get(name) for name in made_by()}
        return "" if made == made_by() else "trustlab {version} (sources {sources})".format(**made)

    def fault(self, task: LiveTask) -> str:
        """Return why the rows are not verified: made elsewhere or otherwise; "" if they are."""
        if self.other_maker:
            return f"made by {self.other_maker}, not verified here"
        try:
            rows = list(stepped(task.begin(self.settings), self.commands))
        except Exception as error:  # of a user's own part, or settings that nobody wrote
            return f"a replay fails: {type(error).__name__}: {error}"
        return difference(task, self.settings, self.rows, rows)


def stepped(run: Any, commands: list) -> Iterator[list]:
    """Step a run by commands, up to its end, and yield each row as it is done."""
    for command in commands:
        if not run.done:
            yield run.step(*command)


def difference(task: LiveTask, settings: dict, rows: list, again: list) -> str:
    """Return which logged row a replay does not give, "" for none: the last may not be logged."""
    if len(rows) > len(again):
        return f"row {len(again)} has no command"
    exact = np.isin(settings["columns"], (*task.decisions, *settings["commands"]))
    try:
        logged = np.array(rows, dtype=float).reshape(len(rows), exact.size)
    except (TypeError, ValueError):
        return "its rows are not those of the task"
    made = np.array(again[: len(rows)], dtype=float).reshape(logged.shape)
    near = np.isclose(logged, made, rtol=SAME, atol=SAME, equal_nan=True)
    same = (near & (~exact | (logged == made))).all(axis=1)
    return "" if same.all() else f"row {int(np.argmin(same))} is not what its commands lead to"


def read_record(path: Path, origin: str = "") -> tuple[Record | None, str, str]:
    """Return what a log says, its last link, and what is wrong with the file ("" if nothing)."""
    reading = read_log(path, origin)
    try:
        header, *entries = reading.entries
        return Record(header, entries), reading.links[-1], reading.fault
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        fault = reading.fault or f"{path.name}: it does not hold a drive ({error})"
        return None, reading.links[-1], fault


class Trial:
    """
    A run, stepped by the commands of its log.

    Commands are kept first and done then, so that a kill between the two loses nothing; the row
    that a command made goes to the disk with the next command. The same log gives the same run
    again: a restart is a replay.

    Parameters
    ----------
    path : pathlib.Path
        The log.
    task : LiveTask
        What is done.
    settings : mapping
        All that determines the run but the commands; of a log that has begun, its own hold.
    origin : str
        What the log's first line is linked to.
    **facts : object
        What else the first line holds.

    Attributes
    ----------
    record : Record
        What the log holds.
    rows : list of list of float
        What was done, the last row included.

    Raises
    ------
    LogError
        If another process writes the log, a line was changed, or another version began the run.
    """

    def __init__(
        self,
        path: Path,
        task: LiveTask,
        settings: dict,
        origin: str = "",
        **facts: Any,
    ):
        self.log, self.task = Log(path, origin), task
        if not self.log.entries:
            header = {"settings": settings, **made_by(), **facts}
            self.log.append([header])
            self.log.entries.append(header)
        self.record = Record(self.log.entries[0], self.log.entries[1:])
        self.settings = self.record.settings
        # A notebook's kernel may answer in one thread and show a session in another.
        self.lock = threading.RLock()
        self.clock = time.time() - time.monotonic()
        self.rows = []
        try:
            self.run = task.begin(self.settings)
            if self.record.other_maker and not self.done:
                raise LogError(
                    f"{path}: begun by {self.record.other_maker}; a drive in progress is continued "
                    "by the version that began it alone: begin another one"
                )
            self.rows.extend(stepped(self.run, self.record.commands))
            fault = difference(task, self.settings, self.record.rows, self.rows)
            if fault:
                raise LogError(f"{path}: {fault}, so that the drive cannot go on")
        except Exception:  # of a user's own part, too: a notebook keeps it, and with it the log
            self.log.close()
            raise

    @property
    def done(self) -> bool:
        """Whether the run is at its end."""
        return bool(self.record.end)

    def _keep(self, **entry: Any) -> None:
        """Append an entry, with the rows that are not on the disk yet."""
        if rows := self.rows[len(self.record.rows) :]:
            entry["rows"] = rows
        entry["at"] = round(self.clock + time.monotonic(), 3)
        self.log.append([entry])
        self.record.take(entry)

    def take(self, message: dict) -> dict:
        """
        Answer a message of a page.

        Parameters
        ----------
        message : mapping
            Its "window", and one of: {"begin": True}; {"note": text}; {"k", "commands", "seen"},
            commands from number k on and the time of the picture on the screen [periods].

        Returns
        -------
        dict
            "k", how many commands are done; "done", whether the run is at its end; "picture", what
            the page draws. Or "other_window", if another one drives by now.

        Raises
        ------
        ValueError
            If a command cannot be one.
        OSError
            If the disk does not take the commands, which are not done then.
        """
        window = str(message.get("window", ""))[:40].encode("ascii", "replace").decode()
        with self.lock:
            if self.done:
                pass
            elif "begin" in message:
                self._keep(window=window)
            elif window != self.record.window:
                return {"other_window": True}
            elif "note" in message:
                self._keep(note=str(message["note"])[:200])
            elif "commands" in message:
                self._take(message)
            return {"k": len(self.rows), "done": self.done, "picture": self.run.picture()}

    def _take(self, message: dict) -> None:
        have, most = len(self.rows), self.settings["samples"]
        first, commands, seen = (message.get(name) for name in ("k", "commands", "seen"))
        if type(first) is not int or not isinstance(commands, list) or not is_number(seen):
            raise ValueError("a message has k, commands, and the time of the picture seen")
        if not 0 <= first <= have:
            return  # what is missing comes again: the answer says how many are here
        commands = commands[have - first : most - first]
        for command in commands:
            self.task.check(self.settings, command)
        if commands:
            self._keep(commands=commands, seen=min(float(seen), float(have)))
            try:
                self.rows.extend(stepped(self.run, commands))
            except Exception as error:  # of a user's own part: the commands would be kept again
                self.finish(f"stopped: {error}")
                raise
        if self.run.done or len(self.rows) >= most:
            self.finish("complete")

    def finish(self, why: str) -> None:
        """End the run, for a reason."""
        with self.lock:
            if not self.done:
                self._keep(end=why)
                self.log.close()

    @property
    def fault(self) -> str:
        """What is wrong with the log or its rows; "" for nothing."""
        with self.lock:
            return read_log(self.log.path, self.log.origin).fault or self.record.fault(self.task)

    def session(self, **facts: Any) -> Session:
        """Return what has been done so far, also what is not logged yet."""
        with self.lock:
            known = self.record.facts(self.fault)
            return self.task.session(self.settings, self.rows, **known, **facts)
