"""What a run writes while it goes on: messages one after another, whole up to a kill."""

import fcntl
import os
import queue
import struct
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

from trustlab.sessions.errors import SessionError

# Ahead of a message: its time [ns] and the lengths of topic and data.
_HEAD = struct.Struct("<QHI")


class Journal:
    """
    Appends messages to a new file in a thread of its own, so that nobody waits for the disk.

    A fault of the disk ends the journal; `report` is called with it, in that thread.
    """

    def __init__(self, path: Path, report: Callable[[str], None]):
        self.path = path
        self.report = report
        self.handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666)
        fcntl.flock(self.handle, fcntl.LOCK_EX)  # until the process ends, whatever ends it
        self.queue: queue.SimpleQueue[bytes | None] = queue.SimpleQueue()
        self.thread = threading.Thread(target=self._write, name="journal", daemon=True)
        self.thread.start()

    def write(self, topic: str, now: int, data: bytes) -> None:
        """Append a message."""
        name = topic.encode()
        self.queue.put(_HEAD.pack(now, len(name), len(data)) + name + data)

    def _write(self) -> None:
        try:
            while record := self.queue.get():
                while record:
                    record = record[os.write(self.handle, record) :]
            os.fsync(self.handle)
        except OSError as error:
            self.report(f"{self.path}: recording ends here, {error.strerror}")
        os.close(self.handle)

    def close(self) -> None:
        """Wait until everything is on the disk."""
        self.queue.put(None)
        self.thread.join()


def read_journal(path: Path) -> Iterator[tuple[str, int, bytes]]:
    """Yield topic, time [ns] and data of every whole message; refuse a journal that goes on."""
    with path.open("rb") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            raise SessionError("the run goes on; end it first", str(path)) from None
        while len(head := file.read(_HEAD.size)) == _HEAD.size:
            now, name, length = _HEAD.unpack(head)
            topic = file.read(name).decode()
            data = file.read(length)
            if len(data) == length:
                yield topic, now, data
