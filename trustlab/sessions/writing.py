"""Write sessions: CSV, Parquet and MCAP bags that read back the same."""

import os
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from types import MappingProxyType

import numpy as np

from trustlab.models.checks import of_class, one_of
from trustlab.models.extras import extra
from trustlab.models.files import path_of, write_atomically
from trustlab.sessions.bags import PREFIX
from trustlab.sessions.errors import SessionError, source_named
from trustlab.sessions.session import Session, metadata_to_json
from trustlab.sessions.tables import COMMENT

FORMATS = (".csv", ".parquet", ".mcap")


def write_session(session: Session, path: str | os.PathLike) -> Path:
    """
    Write a session so that `read_session` returns an equal one, every number bit for bit.

    The metadata go along, but for the source, which will be the new file: in a CSV as a first line
    ``# trustlab {…}``, in Parquet as schema metadata, in a bag as a std_msgs/String on
    /trustlab/metadata beside one std_msgs/Float64 topic per column and one for t. What is there
    already is replaced at once, at the end.

    Parameters
    ----------
    session : Session
        What to write.
    path : path-like
        Where; its suffix is the format: ``.csv``, ``.parquet`` or ``.mcap`` (ROS 2). Its folder
        must exist.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    SessionError
        If the format is unknown, the place cannot be written to, or data or metadata would not
        read back the same.

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
    session = Session(session.data, session.metadata)  # checks what was done to its table
    path = path_of("path", path)
    suffix = one_of(f"the suffix of path {str(path)!r}", path.suffix.lower(), FORMATS)
    with source_named(str(path)):
        try:
            if suffix == ".mcap":
                write_recording(session, path)
            else:
                write_atomically(path, _csv(session) if suffix == ".csv" else _parquet(session))
        except OSError as error:
            raise SessionError(f"cannot be written ({error.strerror or error})") from error
    return path


def _csv(session: Session) -> str:
    table = session.table().to_csv(index=False, lineterminator="\n")  # repr: bit for bit
    return f"{COMMENT}{metadata_to_json(session.metadata)}\n{table}"


def _parquet(session: Session) -> bytes:
    import pyarrow as pa
    import pyarrow.parquet

    table = pa.table({name: np.ascontiguousarray(session[name]) for name in session})
    table = table.replace_schema_metadata({"trustlab": metadata_to_json(session.metadata)})
    content = pa.BufferOutputStream()
    pyarrow.parquet.write_table(table, content)
    return content.getvalue().to_pybytes()


def write_recording(
    session: Session | None,
    path: Path,
    types: Mapping[str, str] = MappingProxyType({}),
    messages: Iterable[tuple[str, int, bytes]] = (),
) -> None:
    """
    Write an MCAP bag of a session, if there is one, and of the messages that it was made from:
    topic, time [ns] and data as CDR, of standard types by topic.
    """
    with extra("ros"):
        from rosbags import rosbag2
        from rosbags.typesys import Stores, get_typestore

    typestore = get_typestore(Stores.ROS2_HUMBLE)
    messages = list(messages)
    start = messages[0][1] if messages else 0
    kinds = dict(types)
    for topic, kind, time, value in _session_messages(session, start) if session else ():
        kinds[topic] = kind
        data = typestore.serialize_cdr(typestore.types[kind](value), kind)
        messages.append((topic, time, data))

    # A name that no reader of the folder takes for a log.
    with tempfile.TemporaryDirectory(prefix=".trustlab-", dir=path.parent) as folder:
        place = Path(folder) / path.name
        writer = rosbag2.Writer(place, version=8, storage_plugin=rosbag2.StoragePlugin.MCAP)
        if types:  # covariances are mostly zeros
            writer.set_compression(rosbag2.CompressionMode.STORAGE, rosbag2.CompressionFormat.ZSTD)
        with writer:
            connections = {
                topic: writer.add_connection(topic, kind, typestore=typestore)
                for topic, kind in kinds.items()
            }
            for topic, time, data in messages:
                writer.write(connections[topic], time, data)
        os.replace(next(place.glob("*.mcap")), path)


def _session_messages(session: Session, start: int) -> Iterator[tuple[str, str, int, object]]:
    """Yield topic, type, time [ns] and value of every message of a session."""
    metadata = metadata_to_json(session.metadata, samples=len(session))
    yield f"{PREFIX}metadata", "std_msgs/msg/String", start, metadata
    # Rising stamps of receipt; the exact times are on /trustlab/t.
    step = max(1, min(round(1e9 * session.sample_time), 2**62 // len(session)))
    for name in session:
        for k, value in enumerate(session[name].tolist()):
            yield PREFIX + name, "std_msgs/msg/Float64", start + k * step, value
