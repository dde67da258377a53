"""ROS 1 and ROS 2 bags: a table for each topic, as its messages have it."""

import dataclasses
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
from trustlab.sessions.columns import Table, stream_of
from trustlab.sessions.errors import RecipeError, SessionError, alternatives, damage_named
from trustlab.sessions.patterns import Selector
from trustlab.sessions.recipe import ColumnRule, Recipe
from trustlab.sessions.resampling import MAX_SAMPLES, Log, Stream
from trustlab.sessions.session import metadata_from_json
from trustlab.sessions.tables import Chosen, positions

# Where the topics of a bag stand that `write_session` wrote: t, metadata and one per column.
PREFIX = "/trustlab/"

DAMAGED = "not a bag, or a damaged or truncated one"
_guard = partial(
    damage_named, DAMAGED, "try `ros2 bag reindex` or `rosbag reindex`, or record it again"
)


def read_bag(path: Path, recipe: Recipe, rules: Sequence[ColumnRule]) -> Log:
    """Return the log in a bag: a stream for each topic that rules name."""
    with _open(path) as reader:
        if recipe.messages is not None:
            _define(reader, Path(recipe.source).parent / recipe.messages.folder)
        return _read_topics(reader, rules, recipe, str(path))


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


def _define(reader, folder: Path) -> None:
    """Add the message definitions in .msg files of a folder; those of the bag come first."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    files = sorted(folder.rglob("*.msg"))
    if not files:
        raise RecipeError(f"[messages] folder: there are no .msg files in {folder}")
    types = dict(get_typestore(Stores.ROS2_HUMBLE).fielddefs)
    for file in files:
        package = file.parent.parent.name if file.parent.name == "msg" else file.parent.name
        with damage_named(f"{file} is not a message definition", "correct it"):
            types |= get_types_from_msg(
                file.read_text(encoding="utf-8"), f"{package}/msg/{file.stem}"
            )
    with damage_named(f"the message definitions in {folder} do not go together", "correct them"):
        known = reader.typestore.fielddefs
        reader.typestore.register({name: type for name, type in types.items() if name not in known})


def _types(reader) -> dict[str, str]:
    """Return the topics of an open bag and the types of their messages."""
    types: dict[str, str] = {}
    for connection in reader.connections:
        topic, kind = str(connection.topic), str(connection.msgtype)
        known = types.setdefault(topic, kind)
        types[topic] = kind if known == kind else f"{known} and {kind}"
    return types


def _messages(reader, topics: Collection[str]) -> Iterator[tuple[str, int, Any]]:
    """Yield topic, time of receipt [ns] and message, in order of time; all must be there."""
    chosen = [connection for connection in reader.connections if connection.topic in topics]
    expected: Counter[str] = Counter()
    count: Counter[str] = Counter()
    with _guard():
        for connection in chosen:
            expected[connection.topic] += int(connection.msgcount)
    if expected.total() > MAX_SAMPLES:
        raise SessionError(f"the bag has more than {MAX_SAMPLES} messages on the topics read")
    for topic, stamp, message in _decoded(reader, chosen):
        count[topic] += 1
        # Differences of stamps must not overflow.
        if not isinstance(stamp, int) or not abs(stamp) < 2**62:
            raise SessionError(f"topic {topic!r}: a message has the time {stamp} ns")
        yield topic, stamp, message
    for topic in topics:
        if count[topic] == 0:
            raise SessionError(f"topic {topic!r} has no messages; was it being published?")
        if expected[topic] and count[topic] != expected[topic]:
            raise SessionError(
                f"topic {topic!r}: the bag's index counts {expected[topic]} messages, "
                f"but {count[topic]} are there; the bag is damaged or truncated"
            )


def _decoded(reader, connections) -> Iterator[tuple[str, int, Any]]:
    with _guard():  # of what is done with a message, nothing happens in here
        for connection, stamp, data in reader.messages(connections=connections):
            yield connection.topic, stamp, reader.deserialize(data, connection.msgtype)


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
    if {*"?#%"} & {*str(file.absolute())}:  # sqlite3 would read the path as a URI with a query
        raise SessionError("a .db3 file cannot be read where its path has ? # or %; rename it")


def _read_topics(reader, rules: Sequence[ColumnRule], recipe: Recipe, source: str) -> Log:
    """Return a stream per topic, timed from the last of the topics' first stamps."""
    types = _types(reader)
    # A message that lacks the entry a rule selects is no sample of it, so that each selection is a
    # stream of its own.
    groups: dict[tuple[str, str], list[ColumnRule]] = {}
    for rule in rules:
        if rule.topic not in types:
            hint = alternatives(rule.topic, types, "it has")
            raise SessionError(f"topic {rule.topic!r} (for {rule.name}) is not in the bag{hint}")
        _check_type(reader, rule.topic, types[rule.topic])
        groups.setdefault((rule.topic, rule.path.selectors), []).append(rule)
    if not groups:
        raise SessionError("none of the columns to read comes from a topic; add one that does")
    samples: dict[tuple[str, str], list[tuple]] = {group: [] for group in groups}
    count: Counter[str] = Counter()
    frames: dict[str, object] = {}
    for topic, stamp, message in _messages(reader, {topic for topic, _ in groups}):
        row = count[topic]
        count[topic] += 1
        where = f"topic {topic!r}, message {row} (from 0)"
        if recipe.time.of(topic) == "header":
            stamp = _header_stamp(message, types[topic], where)
        for group, members in groups.items():
            if group[0] == topic:
                values = [_value(message, rule, types[topic], where, frames) for rule in members]
                if None not in values:
                    samples[group].append((row, stamp, *values))
    for (topic, entry), rows in samples.items():
        if not rows:
            fault = f"none of its {count[topic]} messages has an entry {entry}"
            raise SessionError(f"topic {topic!r}: {fault}")
    start = max(rows[0][1] for rows in samples.values())
    log = Log(source, [], notes={"start_time": start / 1e9})
    for (topic, entry), rows in samples.items():
        if len(rows) < count[topic]:
            words = f"{len(rows)} of {count[topic]} messages have the entry"
            log.notes[f"selected {topic}{entry}"] = words
        members = groups[topic, entry]
        log.streams.append(_stream(topic, entry, members, rows, start, log.notes))
    return log


def _stream(topic: str, entry: str, rules: Sequence[ColumnRule], rows, start: int, notes) -> Stream:
    """Return the stream of a topic's samples: row, stamp [ns] and a value for each rule."""
    numbers, stamps, *values = zip(*rows, strict=True)
    # Differences of whole nanoseconds are exact; as floats the stamps would be 0.2 µs apart at
    # best.
    t = (np.array(stamps, dtype=np.int64) - start) / 1e9
    frame = pd.DataFrame({rule.name: each for rule, each in zip(rules, values, strict=True)})
    place = lambda k: f"topic {topic!r}, message {numbers[k]} (from 0)"  # noqa: E731
    return stream_of(Table(frame, place, notes=notes), t, rules, topic + entry)


def _check_type(reader, topic: str, kind: str) -> None:
    """Raise where messages are of two types, or nothing says how they are made up."""
    if " and " in kind:
        raise SessionError(f"topic {topic!r} has messages of two types: {kind}")
    if kind not in reader.typestore.fielddefs:
        remedy = (
            "put its .msg files in a folder package/msg/ and name the folder above: "
            '[messages] folder = "…"'
        )
        raise SessionError(f"topic {topic!r}: the bag has no definition of {kind}; {remedy}")


def _header_stamp(message, kind: str, where: str) -> int:
    """Return the time of measurement [ns]."""
    stamp = getattr(getattr(message, "header", None), "stamp", None)
    if stamp is None:
        raise RecipeError(
            f'{where}: {kind} has no header stamp; say "receive" for it under [time] topics'
        )
    return int(stamp.sec) * 10**9 + int(stamp.nanosec)


def _value(message, rule: ColumnRule, kind: str, where: str, frames: dict[str, object]) -> Any:
    """Return the number, or the text of a map, of a message; None without the selected entry."""
    here = f"{where}, field {rule.path.text!r} ({rule.name})"
    value = _walk(message, rule, kind, here, frames)
    if value is None:
        return None
    if rule.path.yaw:
        return _yaw(value, kind, here)
    text = isinstance(value, str)
    if not isinstance(value, bool | int | float | np.bool_ | np.number) and not (rule.map and text):
        hint = "give it a map" if text else "name one number in it"
        raise RecipeError(f"{here}: holds {type(value).__name__} in {kind}, not a number; {hint}")
    return value


def _walk(value, rule: ColumnRule, kind: str, here: str, frames: dict[str, object]):
    """Follow a rule's field path into a message; `frames` stay the same for each rule."""
    parent = None
    for step in rule.path.steps:
        if not isinstance(step, str) and not isinstance(value, list | tuple | np.ndarray):
            raise RecipeError(f"{here}: [{step}] needs a list, but {kind} has none there")
        if isinstance(step, Selector):
            value = _selected(value, parent, step, here)
            if value is None:
                return None
        elif isinstance(step, int):
            if step >= len(value):
                raise SessionError(
                    f"{here}: the list has {len(value)} entries, [{step}] is not among them"
                )
            value = value[step]
            frame = getattr(value, "child_frame_id", None)
            if frames.setdefault(rule.name, frame) != frame:
                raise SessionError(
                    f"{here}: the entry [{step}] is of frame {frame!r} here, and of "
                    f'{frames[rule.name]!r} before; select one: [child_frame_id="{frame}"]'
                )
        else:
            parent, value = value, _field(value, step, kind, here)
    return value


def _field(value, name: str, kind: str, here: str):
    fields = []
    if dataclasses.is_dataclass(value):
        fields = [entry.name for entry in dataclasses.fields(value)]
    fields = [title for title in fields if not title.startswith("__")]  # rosbags adds these
    if name not in fields:
        hint = alternatives(name, fields or ["a plain value"], "it has")
        raise RecipeError(f"{here}: {kind} has no field {name!r} there{hint}")
    return getattr(value, name)


def _selected(entries, parent, selector: Selector, here: str):
    """Return the entry of a list that a selector names; None where there is none."""
    # As in JointState, whose positions stand beside the joints' names.
    names = getattr(parent, selector.key, None)
    if names is None:
        try:
            names = [attrgetter(selector.key)(entry) for entry in entries]
        except AttributeError:
            fault = f"neither the list's entries nor a list beside it are called {selector.key!r}"
            raise RecipeError(f"{here}: {fault}") from None
    chosen = [
        entry for name, entry in zip(names, entries, strict=False) if str(name) == selector.value
    ]
    if len(chosen) > 1:
        raise SessionError(
            f"{here}: {len(chosen)} entries are {selector}, so that it names none of them"
        )
    return chosen[0] if chosen else None


def _yaw(value, kind: str, here: str) -> float:
    """Return the heading [rad] of a quaternion: its rotation about the vertical axis."""
    try:
        x, y, z, w = (float(getattr(value, name)) for name in "xyzw")
    except (AttributeError, TypeError, ValueError):
        raise RecipeError(f"{here}: yaw needs a quaternion, which {kind} has not there") from None
    norm = math.hypot(x, y, z, w)
    if not abs(norm - 1.0) <= 0.01:
        raise SessionError(f"{here}: the quaternion has norm {norm:.6g}, but a rotation has norm 1")
    return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
