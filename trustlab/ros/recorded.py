"""What a run left: its bag, its decisions replayed, its measures beside those of a study."""

import json
import struct
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from trustlab.models.extras import extra
from trustlab.ros.decision import Decision
from trustlab.ros.feed import Feed
from trustlab.ros.journal import read_journal
from trustlab.ros.run import RUN, STATES, RunSettings
from trustlab.sessions.bags import PREFIX
from trustlab.sessions.errors import SessionError, damage_named
from trustlab.sessions.reading import read_session
from trustlab.sessions.session import Session
from trustlab.sessions.writing import write_recording, write_session
from trustlab.studies.planning.virtual_study import KEYS
from trustlab.testbeds.condition_run import condition_measures

JOURNAL = ".journal"


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
        Whether the replay has the session, and the commands and states sent, bit for bit.
    """

    path: Path
    run: RunSettings
    session: Session
    decisions: pd.DataFrame
    verified: bool

    @property
    def measures(self) -> dict[str, float]:
        """The outcome measures by name, those of `ConditionRun.measures` that a robot has."""
        return condition_measures(self.session, self.session.t, str(self.run.condition))

    def __repr__(self) -> str:
        words = "verified" if self.verified else "NOT verified"
        return f"RobotRun({self.path}: {self.session.duration:.1f} s, {words})"


def read_run(path: str | Path, run: RunSettings | None = None, own_rules: bool = False) -> RobotRun:
    """
    Read a run from its bag and replay it.

    Parameters
    ----------
    path : path-like
        The .mcap file; or the .journal that a killed run left, from which bag and session are
        written first.
    run : RunSettings, optional
        What it was set to, where a rule without a name took part; from the bag by default.
    own_rules : bool
        Whether the rule or share that the bag names may be imported and called. Say so only of
        bags that you trust.

    Returns
    -------
    RobotRun

    Raises
    ------
    SessionError
        If the file is damaged, fewer than two samples were logged, or the bag names a rule.
    """
    path = Path(path)
    if path.suffix == JOURNAL:
        return finish_run(path, run, interrupted=True, own_rules=own_rules)
    replay = Replay(recorded_messages(path), run, own_rules)
    session = read_session(path)
    log = replay.core.session()
    same = all(session[name].tobytes() == log[name].tobytes() for name in log)
    table = pd.DataFrame(replay.decisions).assign(time=replay.times)
    return RobotRun(path, replay.run, session, table, same and replay.same)


def finish_run(
    journal: Path, run: RunSettings | None, interrupted: bool, own_rules: bool = False
) -> RobotRun:
    """Write bag and session of a journal, which goes then, and read the run."""
    replay = Replay(read_journal(journal), run, own_rules)
    session = replay.core.session(**replay.run.facts, interrupted=interrupted)
    path = journal.with_suffix(".mcap")
    write_recording(session, path, replay.run.types(), read_journal(journal))
    write_session(session, journal.with_suffix(".csv"))
    result = read_run(path, replay.run)
    journal.unlink()
    return result


def recorded_messages(path: Path) -> Iterator[tuple[str, int, bytes]]:
    """Yield topic, time [ns] and data of every message that the bag of a run holds, in order."""
    with extra("ros"):
        from rosbags.highlevel import AnyReader

    with (
        damage_named(f"{path} is not the bag of a run", "read its journal, if there is one"),
        AnyReader([path]) as reader,
    ):
        connections = [c for c in reader.connections if not c.topic.startswith(PREFIX)]
        for connection, now, data in reader.messages(connections):
            yield connection.topic, now, data


class Replay:
    """A core that hears what was recorded, in its order, and steps where a command was sent."""

    def __init__(
        self,
        messages: Iterable[tuple[str, int, bytes]],
        run: RunSettings | None = None,
        own_rules: bool = False,
    ):
        with extra("ros"):
            from rosbags.typesys import Stores, get_typestore

        store = get_typestore(Stores.ROS2_HUMBLE)
        messages = iter(messages)
        topic, start, data = next(messages, ("", 0, b""))
        if topic != RUN:
            raise SessionError("no run is recorded here; remove the file")
        tables = json.loads(store.deserialize_cdr(data, "std_msgs/msg/String").data)
        named = tables.get("rule") or tables.get("share")
        if run is None and named and not own_rules:
            raise SessionError(f"a rule takes part, {named!r}; if you trust it, say own_rules=True")
        self.run = run or RunSettings.of(tables)
        self.core = self.run.core()
        self.decisions: list[Decision] = []
        self.times: list[float] = []
        self.same = True
        feed = Feed(self.run, self.core, start)
        types = self.run.types()
        for topic, now, data in messages:
            message = store.deserialize_cdr(data, types[topic])
            if topic == self.run.topics["command"].topic:
                decision = self.core.step(feed.seconds(now))
                self.decisions.append(decision)
                self.times.append(feed.seconds(now))
                sent = self.run.topics["command"].numbers(message)
                self.same = self.same and sent == (decision.v, decision.w)
            elif topic in STATES:
                state = getattr(self.decisions[-1], STATES[topic])
                self.same = self.same and data[4:] == struct.pack("<d", state)
            else:
                feed.hear(topic, message, now)


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
    count: Counter[Any] = Counter()
    for run in runs:
        meta = run.session.metadata
        count[meta.participant] += 1
        facts = (meta.participant, count[meta.participant], meta.condition, meta.synthetic)
        rows.append([*facts, *run.measures.values()])
    return pd.DataFrame(rows, columns=[*KEYS, *run.measures])
