"""Logs by topic: ROS 1 and ROS 2 bags, PX4 (ULog) and the lab streaming layer (XDF)."""

import dataclasses
import math
import struct
from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np

from trustlab.models.checks import shown
from trustlab.models.extras import extra
from trustlab.sessions.errors import RecipeError, SessionError, alternatives, damage_named, listed
from trustlab.sessions.metadata import metadata_from_json
from trustlab.sessions.patterns import Selector
from trustlab.sessions.readers.limits import Budget
from trustlab.sessions.recipe import ColumnRule, Recipe, mapped
from trustlab.sessions.resampling import MAX_SAMPLES, RawLog, Stream

# Of a ULog or XDF file: name of a topic to its times [ns], and its fields by name.
Topics = dict[str, tuple[np.ndarray, dict[str, Any]]]

# Where the topics of a bag stand that `write_session` wrote: t, metadata and one per column.
PREFIX = "/trustlab/"

_DAMAGED = "not a bag, or a damaged or truncated one"
_guard = partial(
    damage_named, _DAMAGED, "try `ros2 bag reindex` or `rosbag reindex`, or record it again"
)


def read_bag(
    path: Path, recipe: Recipe | None, selection: Sequence[str] | None, budget: Budget
) -> RawLog:
    """Return the log in a bag: topics of the recipe, or else what `write_session` wrote."""
    with _open(path, budget) as reader:
        if recipe is not None and recipe.messages is not None:
            _define(reader, Path(recipe.source).parent / recipe.messages.folder)
        if recipe is None:
            return _read_written(reader, selection, str(path))
        return _read_topics(reader, _topic_rules(recipe, selection), recipe, str(path))


def _topic_rules(recipe: Recipe, selection: Sequence[str] | None) -> list[ColumnRule]:
    rules = [recipe.columns[name] for name in selection or ()]
    return [rule for rule in rules if rule.kind == "topic"]


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


def check_sqlite_path(path: Path) -> None:
    """Raise where a path has one of ? # %: sqlite3 would read it as a URI with a query."""
    for mark in "?#%":
        if mark in str(path.absolute()):
            fault = f"a sqlite3 recording cannot be stored under a path that contains {mark!r}"
            raise SessionError(f"{fault}; rename the folder, or use .mcap", str(path))


def _types(reader) -> dict[str, str]:
    """Return the topics of an open bag and the types of their messages."""
    types: dict[str, str] = {}
    for connection in reader.connections:
        if not isinstance(connection.topic, str) or not isinstance(connection.msgtype, str):
            raise SessionError(
                f"{_DAMAGED} (a topic is called {shown(connection.topic)}); record it again"
            )
        known = types.setdefault(connection.topic, connection.msgtype)
        if known != connection.msgtype:
            types[connection.topic] = f"{known} and {connection.msgtype}"
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
def _open(path: Path, budget: Budget) -> Iterator[Any]:
    with extra("ros"):
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore

    for file in sorted(path.iterdir()) if path.is_dir() else [path]:
        if file.suffix == ".db3":
            check_sqlite_path(path)
            _check_sqlite_size(file)
        else:
            _check_file_size(file, budget)
    with _guard():
        reader = AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE))
        reader.open()
    try:
        with _guard():
            _check_block_sizes(reader.readers[0], path, budget)
        yield reader
    finally:
        with _guard():
            reader.close()


# The header of an MCAP record: its kind and length, and of a chunk its times and unpacked size.
_MCAP_RECORD = struct.Struct("<BQQQQ")
_MCAP_CHUNK = 6
_MCAP_KINDS = range(1, 16)


def _check_file_size(path: Path, budget: Budget) -> None:
    """Raise for an .mcap or a compressed .db3 file that unpacks to too much."""
    with _guard(), path.open("rb") as file:
        if path.suffix == ".zstd":
            from rosbags.rosbag2.reader import zstd

            # Such a file need not state its size, and is unpacked to disk: count it piece by piece.
            with zstd.open(file, "rb") as unpacked:
                while piece := unpacked.read(2**20):
                    budget.take(len(piece))
        elif path.suffix == ".mcap":
            position = 8
            while position + _MCAP_RECORD.size <= path.stat().st_size:
                file.seek(position)
                head = file.read(_MCAP_RECORD.size)
                kind, length, _, _, size = _MCAP_RECORD.unpack(head)
                if kind not in _MCAP_KINDS:
                    return  # damage, which rosbags describes
                if kind == _MCAP_CHUNK:
                    budget.take(size)
                position += 9 + length


def _check_block_sizes(reader, path: Path, budget: Budget) -> None:
    """Raise where a chunk of a ROS 1 bag, or a compressed message, unpacks to too much."""
    if path.is_dir():
        from rosbags.rosbag2.reader import zstd

        packed = reader.storage.storages if reader.compression_mode == "message" else ()
        for storage in packed:
            for _, _, data in storage.messages(storage.connections):
                budget.check(zstd.get_frame_info(data).decompressed_size or 0)
    elif path.suffix == ".bag":
        from rosbags.rosbag1.reader import Header, RecordType

        with path.open("rb") as file:
            for chunk in reader.chunk_infos:
                file.seek(chunk.pos)
                budget.check(Header.read(file, RecordType.CHUNK).get_uint32("size"))


def _check_sqlite_size(database: Path) -> None:
    """Raise for a truncated database; its missing pages would read as zeros."""
    with database.open("rb") as file:
        head = file.read(100)
    size = database.stat().st_size
    page = int.from_bytes(head[16:18], "big")  # the format writes a page of 65536 bytes as 1
    stated = int.from_bytes(head[28:32], "big") * (65536 if page == 1 else page)
    if len(head) < 100 or not head.startswith(b"SQLite format 3\0") or size < stated:
        fault = f"has {size} bytes of {stated}" if size else "is empty"
        raise SessionError(f"{_DAMAGED} ({database.name} {fault}); record it again")


def _read_written(reader, selection: Sequence[str] | None, source: str) -> RawLog:
    """Return the log in a bag that `write_session` wrote."""
    types = _types(reader)
    names = [topic.removeprefix(PREFIX) for topic in types if topic.startswith(PREFIX)]
    if "t" not in names or "metadata" not in names:
        raise SessionError(
            f"not written by trustlab, so it needs a recipe (topics: {listed(types)})"
        )
    names = [name for name in names if name not in ("t", "metadata")]
    for name in selection or ():
        if name not in names:
            raise SessionError(
                f"column {name!r} is missing{alternatives(name, names, 'the bag has')}"
            )
    topics: dict[str, list] = {
        PREFIX + name: [] for name in ["metadata", "t", *(selection or names)]
    }
    for topic, _, message in _messages(reader, topics):
        value = getattr(message, "data", None)
        if not isinstance(value, str if topic == f"{PREFIX}metadata" else float):
            raise SessionError(f"topic {topic!r} holds {types[topic]}, not what trustlab writes")
        topics[topic].append(value)
    metadata, extra = metadata_from_json(topics.pop(f"{PREFIX}metadata")[0])
    for topic, values in topics.items():
        if len(values) != extra.get("samples"):
            raise SessionError(
                f"topic {topic!r} has {len(values)} messages where the metadata say "
                f"{extra.get('samples')}; the bag is damaged or truncated"
            )
    columns = {topic.removeprefix(PREFIX): np.array(values) for topic, values in topics.items()}
    stream = Stream(columns.pop("t"), columns, "message {} (from 0)".format)
    return RawLog(source, [stream], metadata, digests=extra["digests"])


@dataclass
class TopicSeries:
    """The samples of one topic: times [ns], the messages' numbers, and values by column."""

    topic: str
    selectors: str = ""
    rules: list[ColumnRule] = field(default_factory=list)
    stamps: Any = field(default_factory=list)
    rows: Any = field(default_factory=list)
    values: dict[str, Any] = field(default_factory=dict)


def _read_topics(reader, rules: Sequence[ColumnRule], recipe: Recipe, source: str) -> RawLog:
    """Return a stream per topic, timed from the last of the topics' first stamps."""
    types = _types(reader)
    # A message that lacks the entry a rule selects is no sample of it, so that each selection is a
    # stream of its own.
    groups: dict[tuple[str, str], TopicSeries] = {}
    for rule in rules:
        topic, selectors = rule.topic, rule.path.selectors
        if topic not in types:
            hint = alternatives(topic, types, "it has")
            raise SessionError(f"topic {topic!r} (for {rule.name}) is not in the bag{hint}")
        if " and " in types[topic]:
            raise SessionError(f"topic {topic!r} has messages of two types: {types[topic]}")
        _check_defined(reader, topic, types[topic])
        series = groups.setdefault((topic, selectors), TopicSeries(topic, selectors))
        series.rules.append(rule)
        series.values[rule.name] = []
    count: Counter[str] = Counter()
    frames: dict[str, object] = {}
    for topic, received, message in _messages(reader, {topic for topic, _ in groups}):
        kind, row = types[topic], count[topic]
        where = f"topic {topic!r}, message {row} (from 0)"
        count[topic] += 1
        stamp = received
        if recipe.time.of(topic) == "header":
            stamp = _header_stamp(message, kind, where)
        for series in groups.values():
            if series.topic == topic:
                _add_sample(series, stamp, row, message, kind, where, frames)
    notes: dict[str, object] = {}
    for series in groups.values():
        total, entry = count[series.topic], series.selectors
        if not series.rows:
            raise SessionError(
                f"topic {series.topic!r}: none of its {total} messages has an entry {entry}"
            )
        if len(series.rows) < total:
            words = f"{len(series.rows)} of {total} messages have the entry"
            notes[f"selected {series.topic}{entry}"] = words
    return series_log(source, list(groups.values()), notes)


def _add_sample(series: TopicSeries, stamp: int, row: int, message, kind, where, frames) -> None:
    """Add the numbers of a message to a series, unless it lacks an entry that they select."""
    numbers = [_value(message, rule, kind, where, frames) for rule in series.rules]
    if None in numbers:
        return
    series.stamps.append(stamp)
    series.rows.append(row)
    for rule, number in zip(series.rules, numbers, strict=True):
        series.values[rule.name].append(number)


def series_log(source: str, groups: Sequence[TopicSeries], notes: dict[str, object]) -> RawLog:
    """Return the log that topics make, timed from the last of their first stamps."""
    if not groups:
        raise SessionError("none of the columns to read comes from a topic; add one that does")
    start = max(int(series.stamps[0]) for series in groups)
    streams = [
        Stream(
            # Differences of whole nanoseconds are exact; as floats the stamps would be 0.2 µs apart
            # at best.
            t=(np.array(series.stamps, dtype=np.int64) - start) / 1e9,
            columns={rule.name: rule.convert(series.values[rule.name]) for rule in series.rules},
            place=partial(_place, series.topic, series.rows),
            topic=series.topic + series.selectors,
            holds=any(rule.hold for rule in series.rules),
            remedy="choose the other stamp under [time], or ",
        )
        for series in groups
    ]
    return RawLog(source, streams, notes={"start_time": start / 1e9} | notes)


def _place(topic: str, rows: Sequence[int] | np.ndarray, k: int) -> str:
    return f"topic {topic!r}, message {rows[k]} (from 0)"


def _check_defined(reader, topic: str, kind: str) -> None:
    """Raise where neither the bag nor the recipe says how messages of a type are made up."""
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


def _value(
    message, rule: ColumnRule, kind: str, where: str, frames: dict[str, object]
) -> float | None:
    """Return the number that a rule takes from a message; None without the selected entry."""
    here = f"{where}, field {rule.path.text!r} ({rule.name})"
    value = _walk(message, rule, kind, here, frames)
    if value is None:
        return None
    if rule.map is not None:
        return float(mapped(rule.map, value, here))
    if rule.path.yaw:
        return _yaw(value, kind, here)
    if not isinstance(value, bool | int | float | np.bool_ | np.number):
        hint = "give it a map" if isinstance(value, str) else "name one number in it"
        raise RecipeError(f"{here}: holds {type(value).__name__} in {kind}, not a number; {hint}")
    return float(value)


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


def read_topics(path: Path, recipe: Recipe | None, selection: Sequence[str] | None) -> RawLog:
    """Return a stream per topic of a ULog or XDF file; XDF fields may be channel[0] and so on."""
    with extra("formats"):
        import pyulog
        import pyxdf
    ulog = path.suffix.lower() == ".ulg"
    kind = "ULog" if ulog else "XDF"
    with damage_named(f"not a {kind} file, or a damaged or truncated one", "copy it again"):
        if ulog:
            topics = _ulog_topics(pyulog.ULog(str(path)).data_list)
        else:
            # Clocks are brought together by the offsets in the file, as its recorder means it;
            # times are not smoothed.
            topics = _xdf_topics(pyxdf.load_xdf(str(path), dejitter_timestamps=False)[0])
    if recipe is None:
        raise SessionError(f"a {path.suffix} file needs a recipe (topics: {listed(topics)})")
    groups: dict[str, TopicSeries] = {}
    for rule in _topic_rules(recipe, selection):
        topic = rule.topic
        if topic not in topics:
            hint = alternatives(topic, topics, "it has")
            raise SessionError(f"topic {topic!r} (for {rule.name}) is not in the file{hint}")
        stamps, fields = topics[topic]
        if not len(stamps):
            raise RecipeError(f"topic {topic!r} has no messages")
        if recipe.time.of(topic) == "header":
            raise RecipeError(f"topic {topic!r} has one time only, that of receipt")
        rows = np.arange(len(stamps))
        series = groups.setdefault(topic, TopicSeries(topic, stamps=stamps, rows=rows))
        series.rules.append(rule)
        series.values[rule.name] = _column_of(topic, rule, fields)
    notes: dict[str, object] = {}
    if not ulog:
        notes["clocks"] = "brought together by the offsets in the file"
    return series_log(str(path), list(groups.values()), notes)


def _column_of(topic: str, rule: ColumnRule, fields: dict[str, Any]) -> np.ndarray:
    where = f"topic {topic!r}, field {rule.path.text!r} ({rule.name})"
    if rule.path.text not in fields:
        raise RecipeError(
            f"{where}: there is no such field{alternatives(rule.path.text, fields, 'it has')}"
        )
    values = fields[rule.path.text]
    if rule.map:
        return np.array(
            [
                mapped(rule.map, value, f"{where}, message {k} (from 0)")
                for k, value in enumerate(values)
            ]
        )
    if np.asarray(values).dtype.kind not in "biuf":
        raise RecipeError(f"{where}: holds texts, not numbers; give it a map")
    return np.asarray(values, dtype=float)


def _ulog_topics(data_list) -> Topics:
    topics = {}
    for data in data_list:
        name = data.name if data.multi_id == 0 else f"{data.name}:{data.multi_id}"
        topics[name] = (data.data["timestamp"].astype(np.int64) * 1000, dict(data.data))
    return topics


def _xdf_topics(streams) -> Topics:
    topics: Topics = {}
    for stream in streams:
        info, series = stream["info"], stream["time_series"]
        columns = list(np.asarray(series).T) if len(series) else []
        fields = {f"channel[{k}]": column for k, column in enumerate(columns)}
        described = (info.get("desc") or [None])[0] or {}
        channels = (described.get("channels") or [None])[0] or {}
        labels = [(channel.get("label") or [""])[0] for channel in channels.get("channel", [])]
        fields |= {
            str(label): column for label, column in zip(labels, columns, strict=False) if label
        }
        name = info["name"][0]
        if name in topics:
            raise SessionError(
                f"two streams are called {name!r}, so that neither can be named in a recipe"
            )
        topics[name] = (
            np.round(np.asarray(stream["time_stamps"], dtype=float) * 1e9).astype(np.int64),
            fields,
        )
    return topics
