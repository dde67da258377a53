"""ROS 1 and ROS 2 bags: a table for each topic, as its messages have it."""

import math
from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from trustlab.models.extras import extra
from trustlab.sessions.columns import RawLog, Table, stream_of
from trustlab.sessions.errors import RecipeError, SessionError, alternatives, damage_named
from trustlab.sessions.patterns import Selector
from trustlab.sessions.recipe import ColumnRule, Recipe
from trustlab.sessions.session import Place, metadata_from_json
from trustlab.sessions.tables import Chosen, positions

# Where the topics of a bag stand that `write_session` wrote: t, metadata and one per column.
PREFIX = "/trustlab/"

DAMAGED = "not a bag, or a damaged or truncated one"
_guard = partial(
    damage_named, DAMAGED, "try `ros2 bag reindex` or `rosbag reindex`, or record it again"
)


def read_bag(path: Path, recipe: Recipe, rules: Sequence[ColumnRule]) -> RawLog:
    """Return the log in a bag: a stream for each topic, timed from the last of the first stamps."""
    # A message that lacks the entry a rule selects is no sample of it, so that each selection is a
    # stream of its own.
    groups = {}
    for rule in rules:
        groups.setdefault((rule.topic, rule.path.selectors), []).append(rule)
    if not groups:
        raise SessionError("none of the columns to read comes from a topic; add one that does")
    samples = {group: [] for group in groups}
    count = Counter()
    frames = {}
    with _open(path) as reader:
        _check_topics(reader, rules)
        for topic, stamp, message in _messages(reader, {topic for topic, _ in groups}):
            if recipe.time.stamp_of(topic) == "header":
                stamp = _header_stamp(message, topic)
            for (source, entry), members in groups.items():
                if source == topic:
                    values = [_value(message, count[topic], rule, frames) for rule in members]
                    if None not in values:
                        samples[topic, entry].append((count[topic], stamp, *values))
            count[topic] += 1
    for (topic, entry), rows in samples.items():
        if not rows:
            raise SessionError(
                f"topic {topic!r}: none of its {count[topic]} messages has an entry {entry}"
            )
    start = max(rows[0][1] for rows in samples.values())
    log = RawLog(str(path), [], notes={"start_time": start / 1e9})
    for (topic, entry), members in groups.items():
        rows = samples[topic, entry]
        if len(rows) < count[topic]:
            words = f"{len(rows)} of {count[topic]} messages have the entry"
            log.notes[f"selected {topic}{entry}"] = words
        frame = pd.DataFrame(rows, columns=["row", "stamp", *(rule.name for rule in members)])
        # Differences of whole nanoseconds are exact; as floats the stamps would be 0.2 µs apart at
        # best.
        t = (frame["stamp"].to_numpy(dtype=np.int64) - start) / 1e9
        table = Table(frame, _place(topic, frame["row"]), notes=log.notes)
        log.streams.append(stream_of(table, t, members, recipe, topic + entry))
    return log


def _place(topic: str, rows: pd.Series) -> Place:
    return lambda k: f"topic {topic!r}, message {rows[k]} (from 0)"


def _check_topics(reader, rules: Sequence[ColumnRule]) -> None:
    """Raise where a topic is not there, or its messages cannot be read."""
    types = _types(reader)
    for rule in rules:
        topic = rule.topic
        if topic not in types:
            hint = alternatives(topic, types, "it has")
            raise SessionError(f"topic {topic!r} (for {rule.name}) is not in the bag{hint}")
        if " and " in types[topic]:
            raise SessionError(f"topic {topic!r} has messages of two types: {types[topic]}")
        if types[topic] not in reader.typestore.fielddefs:
            raise SessionError(
                f"topic {topic!r}: the bag has no definition of {types[topic]}; record or "
                "convert it (`ros2 bag convert`) as MCAP, which keeps definitions"
            )


def read_written(path: Path, chosen: Chosen) -> Table:
    """Return the table in a bag that `write_session` wrote."""
    with _open(path) as reader:
        types = _types(reader)
        names = [topic.removeprefix(PREFIX) for topic in types if topic.startswith(PREFIX)]
        if "metadata" not in names:
            known = ", ".join(list(types)[:30])
            raise SessionError(f"not written by trustlab, so it needs a recipe (topics: {known})")
        names.remove("metadata")
        places = positions(chosen, names)
        topics = {PREFIX + name: [] for name in ("metadata", *places)}
        for topic, _, message in _messages(reader, topics):
            topics[topic].append(getattr(message, "data", None))
    with _guard():
        metadata, more = metadata_from_json(topics.pop(f"{PREFIX}metadata")[0])
        frame = pd.DataFrame({name: topics[PREFIX + name] for name in places}, dtype=float)
    if len(frame) != more.get("samples"):
        fault = f"has {len(frame)} samples where its metadata say {more.get('samples')}"
        raise SessionError(f"{DAMAGED} (it {fault}); write it again")
    return Table(frame, "message {} (from 0)".format, metadata)


def _types(reader) -> dict[str, str]:
    """Return the topics of an open bag and the types of their messages."""
    types = {}
    for connection in reader.connections:
        types.setdefault(str(connection.topic), set()).add(str(connection.msgtype))
    return {topic: " and ".join(sorted(kinds)) for topic, kinds in types.items()}


def _messages(reader, topics: Collection[str]) -> Iterator[tuple[str, int, Any]]:
    """Yield topic, time of receipt [ns] and message, by time; all must be there."""
    expected, count = Counter(), Counter()
    with _guard():  # what is done with a message happens outside
        chosen = [connection for connection in reader.connections if connection.topic in topics]
        for connection in chosen:
            expected[connection.topic] += int(connection.msgcount)
        for connection, stamp, data in reader.messages(connections=chosen):
            topic = connection.topic
            # Differences of stamps must not overflow.
            if not isinstance(stamp, int) or not abs(stamp) < 2**62:
                raise SessionError(f"topic {topic!r}: a message has the time {stamp} ns")
            count[topic] += 1
            yield topic, stamp, reader.deserialize(data, connection.msgtype)
    for topic in topics:
        if count[topic] == 0:
            raise SessionError(f"topic {topic!r} has no messages; was it being published?")
        if expected[topic] and count[topic] != expected[topic]:
            raise SessionError(
                f"topic {topic!r}: the bag's index counts {expected[topic]} messages, "
                f"but {count[topic]} are there; the bag is damaged or truncated"
            )


@contextmanager
def _open(path: Path) -> Iterator[Any]:
    """Open a bag for reading."""
    with extra("ros"):
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore

    for file in sorted(path.iterdir()) if path.is_dir() else [path]:
        if file.suffix == ".db3":
            _check_database(file)
    with _guard():
        reader = AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE))
        reader.open()
    try:
        yield reader
    finally:
        with _guard():
            reader.close()


def _check_database(file: Path) -> None:
    """Raise for a truncated database, whose missing pages would read as zeros."""
    with file.open("rb") as content:
        head = content.read(100)
    page = int.from_bytes(head[16:18], "big")  # the format writes a page of 65536 bytes as 1
    stated = int.from_bytes(head[28:32], "big") * (65536 if page == 1 else page)
    if not head.startswith(b"SQLite format 3\0") or file.stat().st_size < stated:
        fault = f"{file.name} has {file.stat().st_size} bytes of {stated}"
        raise SessionError(f"{DAMAGED} ({fault}); record it again")
    if {*"?#"} & {*str(file.absolute())}:  # sqlite3 would read the path as a URI with a query
        raise SessionError("a .db3 file cannot be read where its path has ? or #; rename it")


def _header_stamp(message, topic: str) -> int:
    """Return the time of measurement [ns]."""
    stamp = getattr(getattr(message, "header", None), "stamp", None)
    if stamp is None:
        raise RecipeError(
            f"topic {topic!r}: {message.__msgtype__} has no header stamp; say "
            '"receive" for it under [time] topics'
        )
    return int(stamp.sec) * 10**9 + int(stamp.nanosec)


def _value(message, row: int, rule: ColumnRule, frames: dict[str, object]) -> Any:
    """Return the number, or the text of a map, of a message; None without the selected entry."""
    try:
        value = _walk(message, rule, frames)
        return _yaw(value) if rule.path.yaw and value is not None else value
    except SessionError as error:
        place = f"topic {rule.topic!r}, message {row} (from 0), {rule.label}"
        raise type(error)(f"{place} of {message.__msgtype__}: {error}") from None


def _walk(message, rule: ColumnRule, frames: dict[str, object]) -> Any:
    """Follow a rule's field path into a message; `frames` stay the same for each rule."""
    parent, value = None, message
    for step in rule.path.steps:
        if isinstance(step, str):
            parent, value = value, _field(value, step)
        elif not isinstance(value, list | tuple | np.ndarray):
            raise RecipeError(f"[{step}] needs a list, but there is none")
        elif isinstance(step, Selector):
            value = _selected(value, parent, step)
            if value is None:
                return None
        elif step >= len(value):
            raise SessionError(f"the list has {len(value)} entries, [{step}] is not among them")
        else:
            value = value[step]
            frame = getattr(value, "child_frame_id", None)
            if frames.setdefault(rule.name, frame) != frame:
                raise SessionError(
                    f"the entry [{step}] is of frame {frame!r} here, and of "
                    f'{frames[rule.name]!r} before; select one: [child_frame_id="{frame}"]'
                )
    text = isinstance(value, str)
    number = isinstance(value, bool | int | float | np.bool_ | np.number)
    if not (number or rule.path.yaw or (text and rule.map)):
        hint = "give it a map" if text else "name one number in it"
        raise RecipeError(f"holds {type(value).__name__}, not a number; {hint}")
    return value


def _field(value, name: str) -> Any:
    fields = getattr(value, "__dataclass_fields__", ())
    fields = [title for title in fields if not title.startswith("__")]  # rosbags adds these
    if name not in fields:
        hint = alternatives(name, fields or ["a plain value"], "it has")
        raise RecipeError(f"has no field {name!r} there{hint}")
    return getattr(value, name)


def _selected(entries, parent, selector: Selector) -> Any:
    """Return the entry of a list that a selector names; None where there is none."""
    # As in JointState, whose positions stand beside the joints' names.
    names = getattr(parent, selector.key, None)
    if names is None:
        try:
            names = [attrgetter(selector.key)(entry) for entry in entries]
        except AttributeError:
            raise RecipeError(
                f"neither the list's entries nor a list beside it are called {selector.key!r}"
            ) from None
    chosen = [
        entry for name, entry in zip(names, entries, strict=False) if str(name) == selector.value
    ]
    if len(chosen) > 1:
        raise SessionError(f"{len(chosen)} entries are {selector}, so that it names none of them")
    return chosen[0] if chosen else None


def _yaw(value) -> float:
    """Return the heading [rad] of a quaternion: its rotation about the vertical axis."""
    try:
        x, y, z, w = (float(getattr(value, name)) for name in "xyzw")
    except (AttributeError, TypeError, ValueError):
        raise RecipeError("yaw needs a quaternion, which is not there") from None
    norm = math.hypot(x, y, z, w)
    if not abs(norm - 1.0) <= 0.01:
        raise SessionError(f"the quaternion has norm {norm:.6g}, but a rotation has norm 1")
    return math.atan2(2.0 * (w * z + x * y), w * w + x * x - y * y - z * z)
