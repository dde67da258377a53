"""ROS 1 and ROS 2 bags, read without ROS."""

from __future__ import annotations

import dataclasses
import math
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pandas as pd

from trustlab.sessions.checks import check_columns
from trustlab.sessions.column_rules import ColumnRule, FieldPath
from trustlab.sessions.errors import RecipeError, SessionError, nearest
from trustlab.sessions.log import MAX_SAMPLES, Log, check_sqlite_path, metadata_from_json
from trustlab.sessions.recipes import Recipe
from trustlab.sessions.resampling import interpolate, method_for, resampled_note, time_grid
from trustlab.sessions.rules import plain_key
from trustlab.sessions.tables import some

__all__ = ["PREFIX", "read_bag"]

PREFIX = "/trustlab/"
"""Where the topics of a bag stand that `write_session` wrote: t, metadata and one per column."""


@contextmanager
def _guard(source: str) -> Iterator[None]:
    # The bag reader meets damaged files with whatever its decoders raise: its own errors, struct.error, KeyError,
    # AssertionError, zlib and database errors, MemoryError … There is no common base, so that this one place, around
    # calls into it and nothing else of ours, takes every Exception and hands on the cause.
    try:
        yield
    except SessionError:
        raise
    except Exception as error:
        reason = (str(error) or "no reason given").splitlines()[0][:200]
        raise SessionError(
            f"not a bag, or a damaged or truncated one ({type(error).__name__}: {reason}); "
            "try `ros2 bag reindex` or `rosbag reindex` on it, or record it again",
            source,
        ) from error


class _Bag:
    """A bag that is open: its topics, and their messages one by one."""

    def __init__(self, reader, source: str):
        self.reader, self.source = reader, source
        self.types: dict[str, str] = {}
        for connection in reader.connections:
            known = self.types.setdefault(connection.topic, connection.msgtype)
            if known != connection.msgtype:
                self.types[connection.topic] = f"{known} and {connection.msgtype}"

    def messages(self, topics: Sequence[str]) -> Iterator[tuple[str, int, object]]:
        """Yield topic, time of receipt [ns] and message, in order of time."""
        chosen = [connection for connection in self.reader.connections if connection.topic in topics]
        expected, found = Counter(), Counter()
        for connection in chosen:
            expected[connection.topic] += connection.msgcount
        if sum(expected.values()) > MAX_SAMPLES:
            raise SessionError(
                f"the bag has more than {MAX_SAMPLES} messages on the topics read", self.source
            )
        stream = self.reader.messages(connections=chosen) if chosen else iter(())
        while True:
            with _guard(self.source):
                entry = next(stream, None)
                if entry is not None:
                    connection, stamp, data = entry
                    message = self.reader.deserialize(data, connection.msgtype)
            if entry is None:
                break
            found[connection.topic] += 1
            if not abs(stamp) < 2**62:
                raise SessionError(
                    f"topic {connection.topic!r}: a message has the time {stamp} ns", self.source
                )
            yield connection.topic, stamp, message
        for topic in topics:
            if found[topic] == 0:
                raise SessionError(f"topic {topic!r} has no messages; was it being published?", self.source)
            if expected[topic] and found[topic] != expected[topic]:
                raise SessionError(
                    f"topic {topic!r}: the bag's index counts {expected[topic]} messages, {found[topic]} are there; "
                    "the bag is damaged or truncated",
                    self.source,
                )


def _check_sqlite_size(database: Path, source: str) -> None:
    """Raise for a database that is shorter than it says; its missing pages would read as zeros."""
    with database.open("rb") as file:
        head = file.read(100)
    size = database.stat().st_size
    page = int.from_bytes(head[16:18], "big")
    said = int.from_bytes(head[28:32], "big") * (65536 if page == 1 else page)
    if len(head) < 100 or not head.startswith(b"SQLite format 3\0") or size < said:
        what = f"has {size} bytes of {said}" if size else "is empty"
        raise SessionError(
            f"not a bag, or a damaged or truncated one ({database.name} {what}); record it again", source
        )


@contextmanager
def _open(path: Path) -> Iterator[_Bag]:
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    source = str(path)
    for database in [path] if path.suffix == ".db3" else sorted(path.glob("*.db3")):
        check_sqlite_path(path)
        _check_sqlite_size(database, source)
    with _guard(source):
        reader = AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE))
        reader.open()
    try:
        with _guard(source):
            bag = _Bag(reader, source)
        yield bag
    finally:
        with _guard(source):
            reader.close()


def read_bag(
    path: Path,
    recipe: Recipe | None,
    wanted: Sequence[str] | None,
    method: str | None = None,
    sample_time: float | None = None,
) -> Log:
    """
    Return what a bag holds, its topics brought to one time axis.

    Parameters
    ----------
    path : Path
        A ``.bag``, ``.mcap`` or ``.db3`` file, or a rosbag2 folder.
    recipe : Recipe, optional
        Which topics are which; without, the bag must be one that `write_session` wrote.
    wanted : sequence of str, optional
        Session columns to read; all when not given, which only a bag without a recipe may leave.
    method : str, optional
        How to resample topics of a recipe.
    sample_time : float, optional
        To which sample time [s].

    Raises
    ------
    SessionError
        If the bag is damaged, a topic is missing, empty or of another type than the recipe's field needs, or topics
        have stamps of their own and no resampling was asked for.
    """
    with _open(path) as bag:
        if recipe is None:
            return _read_own(bag, wanted)
        rules = [recipe.columns[name] for name in wanted if recipe.columns[name].kind == "topic"]
        return _align(*_collect(bag, rules, recipe), rules, method, sample_time, bag.source)


def _read_own(bag: _Bag, wanted: Sequence[str] | None) -> Log:
    names = [topic.removeprefix(PREFIX) for topic in bag.types if topic.startswith(PREFIX)]
    if "t" not in names or "metadata" not in names:
        raise SessionError(
            f"this bag was not written by trustlab, so that it needs a recipe (its topics: {some(list(bag.types))})",
            bag.source,
        )
    names = [name for name in names if name not in ("t", "metadata")]
    for name in wanted or ():
        if name not in names:
            raise SessionError(
                f"column {name!r} is missing{nearest(name, names)} (the bag has: {some(names)})", bag.source
            )
    topics = {PREFIX + name: [] for name in ["metadata", "t", *(wanted or names)]}
    for topic, _, message in bag.messages(list(topics)):
        value = getattr(message, "data", None)
        if not isinstance(value, str if topic == f"{PREFIX}metadata" else float):
            raise SessionError(
                f"topic {topic!r} holds {bag.types[topic]}, not what trustlab writes", bag.source
            )
        topics[topic].append(value)
    metadata, extra = metadata_from_json(topics.pop(f"{PREFIX}metadata")[0], bag.source)
    for topic, values in topics.items():
        if len(values) != extra.get("samples"):
            raise SessionError(
                f"topic {topic!r} has {len(values)} messages where the metadata say {extra.get('samples')}; "
                "the bag is damaged or truncated",
                bag.source,
            )
    columns = {topic.removeprefix(PREFIX): np.array(values) for topic, values in topics.items()}
    return Log(bag.source, columns.pop("t"), columns, lambda k: f"message {k} (from 0)", metadata)


def _collect(bag: _Bag, rules: Sequence[ColumnRule], recipe: Recipe):
    """Return per topic the stamps [ns] and per column the values."""
    by_topic: dict[str, list[ColumnRule]] = {}
    for rule in rules:
        if rule.key not in bag.types:
            raise SessionError(
                f"topic {rule.key!r} (for {rule.name}) is not in the bag{nearest(rule.key, bag.types)} "
                f"(it has: {some(list(bag.types))})",
                bag.source,
            )
        by_topic.setdefault(rule.key, []).append(rule)
    for topic in by_topic:
        if " and " in bag.types[topic]:
            raise SessionError(f"topic {topic!r} has messages of two types: {bag.types[topic]}", bag.source)
    stamps: dict[str, list[int]] = {topic: [] for topic in by_topic}
    values: dict[str, list[float]] = {rule.name: [] for rule in rules}
    for topic, received, message in bag.messages(list(by_topic)):
        kind, where = bag.types[topic], f"topic {topic!r}, message {len(stamps[topic])} (from 0)"
        stamp = received
        if recipe.time.topics.get(topic, recipe.time.stamp) == "header":
            stamp = _header_stamp(message, kind, where, bag.source)
        stamps[topic].append(stamp)
        for rule in by_topic[topic]:
            values[rule.name].append(_value(message, rule, kind, where, bag.source))
    return (
        {topic: np.array(each, dtype=np.int64) for topic, each in stamps.items()},
        {rule.name: rule.convert(values[rule.name]) for rule in rules},
    )


def _header_stamp(message, kind: str, where: str, source: str) -> int:
    stamp = getattr(getattr(message, "header", None), "stamp", None)
    if stamp is None:
        raise RecipeError(
            f'{where}: {kind} has no header stamp; say "receive" for this topic under [time] topics', source
        )
    return int(stamp.sec) * 10**9 + int(stamp.nanosec)


def _value(message, rule: ColumnRule, kind: str, where: str, source: str) -> float:
    here = f"{where}, field {rule.field.text!r} ({rule.name})"
    value = _walk(message, rule.field, kind, here, source)
    if rule.map is not None:
        found = rule.map.get(plain_key(value))
        if found is None:
            raise SessionError(
                f"{here}: {str(value)[:60]!r} is not in the recipe's map (known: {some(list(rule.map))})",
                source,
            )
        return float(found)
    if rule.field.yaw:
        return _yaw(value, kind, here, source)
    if not isinstance(value, bool | int | float | np.bool_ | np.number):
        hint = "; give it a map" if isinstance(value, str) else "; name one number in it"
        raise RecipeError(f"{here}: holds {type(value).__name__} in {kind}, not a number{hint}", source)
    return float(value)


def _walk(value, path: FieldPath, kind: str, here: str, source: str):
    for step in path.steps:
        if isinstance(step, int):
            if not isinstance(value, list | tuple | np.ndarray):
                raise RecipeError(f"{here}: [{step}] needs a list, but {kind} has none there", source)
            if step >= len(value):
                raise SessionError(
                    f"{here}: the list has {len(value)} entries, [{step}] is not among them", source
                )
            value = value[step]
            continue
        fields = [each.name for each in dataclasses.fields(value)] if dataclasses.is_dataclass(value) else []
        if step not in fields:
            raise RecipeError(
                f"{here}: {kind} has no field {step!r} there{nearest(step, fields)} "
                f"(it has: {some(fields) or 'a plain value'})",
                source,
            )
        value = getattr(value, step)
    return value


def _yaw(value, kind: str, here: str, source: str) -> float:
    try:
        x, y, z, w = (float(getattr(value, name)) for name in "xyzw")
    except (AttributeError, TypeError, ValueError):
        raise RecipeError(f"{here}: yaw needs a quaternion, which {kind} has not there", source) from None
    norm = math.hypot(x, y, z, w)
    if not abs(norm - 1.0) <= 0.01:
        raise SessionError(f"{here}: the quaternion has norm {norm:.6g}, so that it is no rotation", source)
    return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


def _align(stamps, values, rules, method, sample_time, source) -> Log:
    start = max(each[0] for each in stamps.values())
    times = {topic: (each - start) / 1e9 for topic, each in stamps.items()}
    _check(stamps, times, values, rules, source)
    first = next(iter(stamps))
    odd = [topic for topic in stamps if not np.array_equal(stamps[topic], stamps[first])]
    if method is None:
        if odd:
            raise RecipeError(
                f"topics {first!r} and {odd[0]!r} have stamps of their own; name how to bring them together: "
                '[resampling] in the recipe, or read_session(..., resample="previous", sample_time=0.1)',
                source,
            )
        columns = {rule.name: values[rule.name] for rule in rules}
        place = lambda k: f"message {k} (from 0)"  # noqa: E731
        return Log(source, times[first], columns, place, notes={"start_time": float(start) / 1e9})
    held = {rule.key for rule in rules if rule.hold}
    ends = {topic: each[-1] for topic, each in times.items() if topic not in held}
    stop = min(ends.values()) if ends else max(each[-1] for each in times.values())
    if stop <= 0.0:
        late = max(stamps, key=lambda topic: stamps[topic][0])
        early = min(ends or times, key=lambda topic: times[topic][-1])
        raise SessionError(
            f"topics do not overlap: {early!r} ends {-stop:.6g} s before {late!r} starts "
            "(say hold = true for a topic whose last message holds to the end)",
            source,
        )
    grid = time_grid(0.0, stop, sample_time, source)
    columns = {}
    for rule in rules:
        how = method_for(rule.name, method, rule)
        columns[rule.name] = interpolate(times[rule.key], values[rule.name], grid, how, rule.name == "yaw")
    gap = max((float(np.diff(times[topic]).max()) for topic in ends if times[topic].size > 1), default=0.0)
    notes = {"start_time": float(start) / 1e9, "resampled": resampled_note(method, sample_time, gap)}
    return Log(source, grid, columns, lambda k: f"sample {k} after resampling", notes=notes)


def _check(stamps, times, values, rules, source) -> None:
    """Raise the earliest fault of any topic."""
    faults = []
    for topic, each in stamps.items():
        steps = np.diff(each)
        if (steps <= 0).any():
            k = int(np.argmax(steps <= 0)) + 1
            what = "repeats" if steps[k - 1] == 0 else "runs backwards"
            message = (
                f"topic {topic!r}, message {k} (from 0): time {what} ({each[k - 1]} ns, then {each[k]} ns); "
                "choose the other stamp under [time], or sort or split the log where this happens"
            )
            faults.append((each[k - 1], SessionError(message, source)))
    for rule in rules:
        try:
            check_columns(
                pd.DataFrame({rule.name: values[rule.name]}, index=times[rule.key]),
                source,
                lambda k, topic=rule.key: f"topic {topic!r}, message {k} (from 0)",
            )
        except SessionError as error:
            faults.append((stamps[rule.key][error.row or 0], error))
    if faults:
        raise min(faults, key=lambda fault: fault[0])[1]
