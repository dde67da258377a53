"""Write sessions: CSV, Parquet, ROS 1 and ROS 2 bags that read back the same."""

import os
import shutil
import sqlite3
import tempfile
from collections.abc import Iterable, Mapping
from pathlib import Path
from types import MappingProxyType

import numpy as np

from trustlab.models.checks import of_class, one_of
from trustlab.models.extras import extra
from trustlab.models.files import write_atomically
from trustlab.sessions.errors import SessionError, alternatives, source_named
from trustlab.sessions.metadata import metadata_to_json
from trustlab.sessions.readers.bags import PREFIX, check_sqlite_path
from trustlab.sessions.readers.csv_files import COMMENT
from trustlab.sessions.readers.file import TEMPORARY
from trustlab.sessions.session import Session

# Formats by name, and the suffix that chooses each; a rosbag2 folder (sqlite3) has none.
FORMATS = {"csv": ".csv", "parquet": ".parquet", "bag": ".bag", "mcap": ".mcap", "rosbag2": ""}


def write_session(session: Session, path: str | os.PathLike, format: str | None = None) -> Path:
    """
    Write a session so that `read_session` returns an equal one, every number bit for bit.

    The metadata go along, but for the source, which will be the new file: in a CSV as a first line
    ``# trustlab {…}``, in Parquet as schema metadata, in bags as a std_msgs/String on
    /trustlab/metadata beside one std_msgs/Float64 topic per column and one for t. What is there
    already is replaced at once, at the end.

    Parameters
    ----------
    session : Session
        What to write.
    path : path-like
        Where; its folder must exist.
    format : {"csv", "parquet", "bag", "mcap", "rosbag2"}, optional
        By the path's suffix when not given: ``.csv``, ``.parquet``, ``.bag`` (ROS 1), ``.mcap``
        (ROS 2), and none for a rosbag2 folder with sqlite3 storage.

    Returns
    -------
    Path
        The file or folder.

    Raises
    ------
    SessionError
        If the format is unknown, the place cannot be written to, or metadata would not read back
        the same.

    Examples
    --------
    >>> import tempfile
    >>> import trustlab as tl
    >>> session = tl.read_session("data/sessions/pilot.csv")
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     again = tl.read_session(tl.write_session(session, f"{folder}/pilot.parquet"))
    >>> again == session
    True
    """
    of_class("session", session, Session)
    path = Path(path)
    with source_named(str(path)):
        if format is None:
            by_suffix = {suffix: name for name, suffix in FORMATS.items()}
            format = by_suffix.get(path.suffix.lower())
            if format is None:
                hint = alternatives(path.suffix, filter(None, by_suffix))
                raise SessionError(
                    f"cannot tell the format from {path.suffix!r}{hint}; name it with format="
                )
        one_of("format", format, FORMATS)
        _check_target(path, format)
        try:
            _write(session, path, format)
        except (OSError, sqlite3.Error) as error:
            raise SessionError(
                f"cannot be written ({getattr(error, 'strerror', None) or error})"
            ) from error
    return path


def _write(session: Session, path: Path, format: str) -> None:
    """Make the file or folder beside its place, and move it there when it is complete."""
    if format == "csv":
        write_atomically(path, _csv(session))
    elif format == "parquet":
        write_atomically(path, _parquet(session))
    else:
        with tempfile.TemporaryDirectory(
            prefix=TEMPORARY, dir=path.parent, ignore_cleanup_errors=True
        ) as folder:
            # A recording names its database after itself; the new one must not have the old name.
            name = f"{path.name}-{folder[-8:]}" if path.is_dir() else path.name
            bag = _write_bag(session, Path(folder) / name, format)
            if path.is_dir():
                _replace(path, bag)
            else:
                os.replace(bag, path)


def _replace(path: Path, bag: Path) -> None:
    """Replace a rosbag2 recording; until metadata.yaml is replaced, it names the old database."""
    files = sorted(bag.iterdir(), key=lambda file: file.name == "metadata.yaml")
    for file in files:
        os.replace(file, path / file.name)
    for old in path.iterdir():
        if old.name not in {file.name for file in files}:
            shutil.rmtree(old) if old.is_dir() else old.unlink()


def _check_target(path: Path, format: str) -> None:
    """Raise where the session must not be written, or could not be read back."""
    if not path.parent.is_dir():
        raise SessionError("its folder does not exist; create it first")
    if path.is_dir() and not (format == "rosbag2" and (path / "metadata.yaml").is_file()):
        raise SessionError("there is a folder at this path; choose another name")
    if path.is_file() and format == "rosbag2":
        raise SessionError("there is a file at this path, but a rosbag2 recording is a folder")
    if format == "rosbag2":
        check_sqlite_path(path)
    elif path.suffix.lower() != FORMATS[format]:  # read_session chooses the reader by the suffix
        raise SessionError(
            f"a {format} file is read by its suffix; call it {path.stem}{FORMATS[format]}"
        )


def _csv(session: Session) -> str:
    table = session.table().to_csv(index=False, lineterminator="\n")  # repr: bit for bit
    return f"{COMMENT}{metadata_to_json(session.metadata, session)}\n{table}"


def _parquet(session: Session) -> bytes:
    import pyarrow as pa
    import pyarrow.parquet

    table = pa.table({name: np.ascontiguousarray(session[name]) for name in session})
    table = table.replace_schema_metadata({"trustlab": metadata_to_json(session.metadata, session)})
    content = pa.BufferOutputStream()
    pyarrow.parquet.write_table(table, content)
    return content.getvalue().to_pybytes()


def write_recording(
    session: Session,
    path: Path,
    types: Mapping[str, str],
    messages: Iterable[tuple[str, int, bytes]],
) -> None:
    """
    Write an MCAP bag of a session and of the messages that it was made from: topic, time [ns] and
    data as CDR, of standard types by topic.
    """
    with tempfile.TemporaryDirectory(prefix=TEMPORARY, dir=path.parent) as folder:
        os.replace(_write_bag(session, Path(folder) / path.name, "mcap", types, messages), path)


def _write_bag(
    session: Session,
    place: Path,
    format: str,
    types: Mapping[str, str] = MappingProxyType({}),
    messages: Iterable[tuple[str, int, bytes]] = (),
) -> Path:
    with extra("ros"):
        from rosbags import rosbag1, rosbag2
        from rosbags.typesys import Stores, get_typestore

    ros1 = format == "bag"
    typestore = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    serialize = typestore.serialize_ros1 if ros1 else typestore.serialize_cdr
    plugin = rosbag2.StoragePlugin.MCAP if format == "mcap" else rosbag2.StoragePlugin.SQLITE3
    writer = (
        rosbag1.Writer(place) if ros1 else rosbag2.Writer(place, version=8, storage_plugin=plugin)
    )
    if types:  # covariances are mostly zeros
        writer.set_compression(rosbag2.CompressionMode.STORAGE, rosbag2.CompressionFormat.ZSTD)
    text, number = "std_msgs/msg/String", "std_msgs/msg/Float64"
    as_text, as_number = typestore.types[text], typestore.types[number]
    with writer:
        recorded = {
            topic: writer.add_connection(topic, kind, typestore=typestore)
            for topic, kind in types.items()
        }
        start = 0
        for topic, stamp, data in messages:
            start = start or stamp
            writer.write(recorded[topic], stamp, data)
        topic = writer.add_connection(f"{PREFIX}metadata", text, typestore=typestore)
        metadata = metadata_to_json(session.metadata, session, samples=len(session))
        writer.write(topic, start, serialize(as_text(metadata), text))
        topics = [
            writer.add_connection(PREFIX + name, number, typestore=typestore) for name in session
        ]
        for stamp, *row in zip(
            _stamps(session.t), *(session[name].tolist() for name in session), strict=True
        ):
            for topic, value in zip(topics, row, strict=True):
                writer.write(topic, start + stamp, serialize(as_number(value), number))
    return next(place.glob("*.mcap")) if format == "mcap" else place


def _stamps(t: np.ndarray) -> list[int]:
    """Return rising stamps [ns] from 0; the exact times are on /trustlab/t."""
    with np.errstate(over="ignore", invalid="ignore"):
        nanoseconds = np.round((t - t[0]) * 1e9)
    # 4e18 ns fit both kinds of bag: ROS 1 has 32 bits for the seconds, ROS 2 has 63 for the
    # nanoseconds.
    if (
        np.isfinite(nanoseconds).all()
        and nanoseconds[-1] < 4e18
        and (np.diff(nanoseconds) >= 1.0).all()
    ):
        return nanoseconds.astype(np.int64).tolist()
    return [k * 1_000_000 for k in range(t.size)]
