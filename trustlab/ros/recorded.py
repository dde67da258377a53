"""
From messages to decisions, the same on a robot and in a replay; and what a run left: its bag, its
decisions, its measures beside those of a study.
"""

import json
import math
from base64 import b64decode, b64encode
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from trustlab.live.log import Log, LogError, linked
from trustlab.models.extras import extra
from trustlab.ros.core import AHEAD, AllocationCore
from trustlab.ros.run import CLOCK, NOTE, OWN_TYPES, RUN, STATES, RunSettings
from trustlab.sessions.bags import PREFIX
from trustlab.sessions.errors import SessionError, damage_named, source_named
from trustlab.sessions.reading import existing, read_session
from trustlab.sessions.session import Session
from trustlab.sessions.writing import write_recording, write_session
from trustlab.testbeds.condition_run import condition_measures

LOG = ".jsonl"

# What the node notes last: a run without it was cut off.
END = "the run ends"

Message = tuple[str, int, bytes]
"""Topic, time by the run's clock [ns], and data as CDR."""


@dataclass(frozen=True, eq=False)
class RobotRun:
    """
    A run on a robot, from its bag.

    Parameters
    ----------
    path : Path
        The bag.
    run : RunSettings
        What it was set to.
    session : Session
        As logged; `metadata.more` has `notes` of all faults, and whether it was `interrupted`.
    decisions : pandas.DataFrame
        Every step's time [s] and the fields of its `Decision`, from a replay.
    verified : bool
        Whether all messages are there in their order, settings of the run included, and the replay
        has the session, with its metadata, and the commands and states sent, bit for bit.
    """

    path: Path
    run: RunSettings
    session: Session
    decisions: pd.DataFrame
    verified: bool

    @property
    def measures(self) -> dict[str, float]:
        """The outcome measures by name, those of `ConditionRun.measures` that a robot has."""
        return condition_measures(self.session, self.session.t)

    def __repr__(self) -> str:
        words = "verified" if self.verified else "NOT verified"
        return f"RobotRun({self.path}: {self.session.duration:.1f} s, {words})"


def read_run(path: str | Path, run: RunSettings | None = None, own_rules: bool = False) -> RobotRun:
    """
    Read a run from its bag and replay it.

    Parameters
    ----------
    path : path-like
        The .mcap file; or the .jsonl log that a killed run left, from which bag and session are
        written first.
    run : RunSettings, optional
        What it was set to, where a rule without a name took part; from the bag by default.
    own_rules : bool
        Whether the rule that the bag names may be imported and called. Say so only of
        bags that you trust.

    Returns
    -------
    RobotRun

    Raises
    ------
    SessionError
        If the file is missing or damaged, fewer than two samples were logged, or the bag names a
        rule.
    """
    path = Path(path)
    if path.suffix == LOG and path.is_file():
        return finish_run(path, run, own_rules)
    with source_named(str(path)):
        existing(path)
    with damage_named(f"{path} is not the whole bag of a run", "read its log, if there is one"):
        replay = Replay(recorded_messages(path), run, own_rules)
        logged = replay.session()
    session = read_session(path)
    table = pd.DataFrame(replay.decisions).assign(time=replay.times)
    metadata = logged.metadata.changed(source=session.metadata.source)
    same = replay.same and session == logged and session.metadata == metadata
    return RobotRun(path, replay.run, session, table, same)


def finish_run(path: Path, run: RunSettings | None, own_rules: bool = False) -> RobotRun:
    """Write bag and session of a log, which goes then, and read the run."""
    bag = path.with_suffix(".mcap")
    try:
        log = Log(path)
    except LogError as error:
        raise SessionError(f"the run goes on, or its log is damaged: {error}") from error
    messages = [(topic, now, b64decode(data)) for topic, now, data in log.entries]
    log.close()
    replay = Replay(messages, run, own_rules)
    session, fault = None, ""
    try:
        session = replay.session()
        write_session(session, path.with_suffix(".csv"))
    except SessionError as error:
        fault = f"{error}; the messages are in {bag}"
    write_recording(session, bag, replay.run.types(), messages)
    path.unlink()
    if fault:
        raise SessionError(fault)
    return read_run(bag, replay.run)


def log_entry(topic: str, now: int, data: bytes) -> list[Any]:
    """Return a message as an entry of a log."""
    return [topic, now, b64encode(data).decode()]


def typestore() -> Any:
    """Return the types of messages that a run can be replayed with."""
    with extra("ros"):
        from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.ROS2_HUMBLE)


def recorded_messages(path: Path) -> list[Message]:
    """Return every message that the bag of a run holds, in order."""
    with extra("ros"):
        from rosbags.highlevel import AnyReader

    with AnyReader([path]) as reader:
        connections = [c for c in reader.connections if not c.topic.startswith(PREFIX)]
        return [(c.topic, now, data) for c, now, data in reader.messages(connections)]


@dataclass
class Feed:
    """
    Hands messages on topics to a core.

    The run's own clock starts at `start` [ns] of the computer's and goes on with its processor, so
    that it never steps; what the computer's clock is ahead of it stands on a topic of the run.
    """

    run: RunSettings
    core: AllocationCore
    start: int
    ahead: int = 0
    ended: bool = False
    apart: bool = False
    down: dict[str, bool] = field(default_factory=dict)
    frames: dict[str, str] = field(default_factory=dict)

    def seconds(self, now: int) -> float:
        """Return a time of the run's clock since the start [s]."""
        return (now - self.start) / 1e9

    def hear(self, topic: str, message: Any, now: int) -> list[str]:
        """Hand a message on and return the names of the inputs that took it over."""
        if topic == CLOCK:
            step = (message.data - self.ahead) / 1e9
            if abs(step) > AHEAD:
                self.core.rest(f"the computer's clock steps by {step:.3g} s")
            self.ahead = message.data
        elif topic == NOTE:
            self.ended = message.data == END
            if not self.ended:
                self.core.note(message.data)
        return [
            name
            for name, source in self.run.topics.items()
            if source.topic == topic and self._taken(name, message, now)
        ]

    def _taken(self, name: str, message: Any, now: int) -> bool:
        source = self.run.topics[name]
        try:
            numbers = source.numbers(message)
        except ValueError as error:
            self.core.note(f"{name}: {error}")
            return False
        if name not in self.core.inputs:
            self._press(name, numbers[0] >= 0.5)
            return False
        frame = getattr(getattr(message, "header", None), "frame_id", "")
        if frame != self.frames.setdefault(name, frame):
            self.core.note(f"{name}: in frame {frame!r}, before in {self.frames[name]!r}")
            self.frames[name] = frame
        if name == "path_error" and len(numbers) == 2:  # of a reference: its distance
            place = self.core.inputs["odometry"].values
            if place is None:
                return False
            other = self.frames["odometry"]
            if frame and other and frame != other and not self.apart:
                self.apart = True
                self.core.note(f"{name}: in frame {frame!r}, odometry in {other!r}")
            numbers = (math.dist(place, numbers),)
        return self.core.hear(name, self.stamp(name, message, now), numbers, self.seconds(now))

    def stamp(self, name: str, message: Any, now: int) -> float:
        """Return when an input's message was measured, by its header or its arrival [s]."""
        header = getattr(message, "header", None)
        if header is not None and self.run.topics[name].stamp == "header":
            now = header.stamp.sec * 10**9 + header.stamp.nanosec - self.ahead
        return self.seconds(now)

    def _press(self, name: str, down: bool) -> None:
        """Act when a button is pressed or, of the one that chooses the mode, moved."""
        before = self.down.get(name)
        self.down[name] = down
        if down == before:
            return
        if name == "button":
            self.core.press(int(down))
        elif down and name == "stop":
            self.core.stop()
        elif down and not self.down.get("stop"):  # a stop that is held down is not released
            self.core.release()


class Replay:
    """A core that hears what was recorded, in its order, and steps where a command was sent."""

    def __init__(
        self, messages: list[Message], run: RunSettings | None = None, own_rules: bool = False
    ):
        self.store = store = typestore()
        if not messages or messages[0][0] != RUN:
            raise SessionError("no run is recorded here; remove the file")
        _, start, data = messages[0]
        tables = json.loads(store.deserialize_cdr(data, OWN_TYPES[RUN]).data)
        named = tables.get("rule")
        if run is None and named and not own_rules:
            raise SessionError(f"a rule takes part, {named!r}; if you trust it, say own_rules=True")
        self.run = run or RunSettings.of(tables)
        self.core = self.run.core()
        self.feed = Feed(self.run, self.core, start)
        self.decisions = []
        self.times = []
        self.same = True
        self.link = ""
        types = self.run.types()
        for topic, now, data in messages:
            self.link, _ = linked(self.link, log_entry(topic, now, data))
            if topic != RUN:
                self._take(topic, now, store.deserialize_cdr(data, types[topic]))

    def _take(self, topic: str, now: int, message: Any) -> None:
        command = self.run.topics["command"]
        if topic == command.topic:
            self.times.append(self.feed.seconds(now))
            self.decisions.append(self.core.step(self.times[-1]))
            sent = self.store.serialize_cdr(message, command.type)
            command.fill(message, self.core.command)
            self.same &= sent == self.store.serialize_cdr(message, command.type)
        elif topic in STATES:
            state = getattr(self.decisions[-1], STATES[topic])
            self.same &= np.array_equal(message.data, state, equal_nan=True)
        else:
            self.feed.hear(topic, message, now)

    def session(self) -> Session:
        """Return the session of what was heard, with the link of the last message."""
        end = self.feed.ended
        return self.core.session(**self.run.facts, interrupted=not end, log=self.link)


def measures_table(runs: Iterable[RobotRun]) -> pd.DataFrame:
    """
    Return the measures of runs, a row each, with the columns that a virtual study has.

    Parameters
    ----------
    runs : iterable of RobotRun
        Each participant's in the order in which they were made.

    Returns
    -------
    pandas.DataFrame
        participant, position (from 1), condition, synthetic, and every measure.
    """
    rows = []
    count: Counter = Counter()
    for run in runs:
        about = run.session.metadata.as_dict()
        count[about["participant"]] += 1
        about["position"] = count[about["participant"]]
        facts = ("participant", "position", "condition", "synthetic")
        rows.append({name: about[name] for name in facts} | run.measures)
    return pd.DataFrame(rows)
