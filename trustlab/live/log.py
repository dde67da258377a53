"""
A file that only grows: an entry is on the disk before it is acknowledged, and none can be changed
unseen.

Each line is a JSON array of a link and an entry. The link is a digest of the entry's text and of
the link before it, so that it stands for everything up to its line. A line that was changed, taken
out or put in is found by its number. Links show changes, not who made them: someone who writes all
lines anew can link them anew, and the last lines can be cut off, unless the last link was written
down elsewhere.

A file ends with a whole line, or its writer died in the middle of one: what follows the last line
end is left out, and cut off when a writer opens the file again.
"""

import fcntl
import io
import json
import os
import weakref
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

from trustlab.models.digest import digest

DIGITS = 16
"""Hexadecimal digits of a link."""


class LogError(ValueError):
    """A log whose lines were changed."""


class BusyError(LogError):
    """A log that another handle writes."""


class LogReading(NamedTuple):
    """
    A log's entries, its links (the origin, then one of each entry), the bytes of its whole lines,
    those of a torn line behind them, and its first fault or "".
    """

    entries: list[Any]
    links: list[str]
    size: int
    torn: int
    fault: str


def linked(link: str, entry: Any) -> tuple[str, str]:
    """Return the link of an entry behind another link, and its line."""
    text = json.dumps(entry)
    link = digest(link, text)[:DIGITS]
    return link, f'["{link}", {text}]\n'


def read_log(path: Path, origin: str = "") -> LogReading:
    """
    Return what a log holds.

    Parameters
    ----------
    path : pathlib.Path
        The file.
    origin : str
        What its first line is linked to: what the log belongs to.

    Returns
    -------
    LogReading
        Up to the first line that is no entry with its link, which the fault names.
    """
    entries: list[Any] = []
    links, size, torn, fault = [origin], 0, 0, ""
    if not path.exists():
        return LogReading(entries, links, size, torn, f"{path.name} is missing")
    for number, line in enumerate(io.BytesIO(path.read_bytes()), 1):  # only \n ends a line
        if not line.endswith(b"\n"):
            torn, fault = len(line), f"{path.name}: its last line is torn"
            break
        try:
            _, entry = json.loads(line)
        except (ValueError, TypeError):
            entry = None
        link, expected = linked(links[-1], entry)
        if line != expected.encode():
            fault = f"{path.name}, line {number}: it was changed, or lines before it were"
            break
        entries.append(entry)
        links.append(link)
        size += len(line)
    return LogReading(entries, links, size, torn, fault)


def sync_folder(folder: Path) -> None:
    """Return when the names in a folder are on the disk, not only what the files hold."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


class Log:
    """
    The one writer of a log.

    Parameters
    ----------
    path : pathlib.Path
        The file, which is made where it is missing.
    origin : str
        What its first line is linked to: what the log belongs to.

    Attributes
    ----------
    entries : list
        What the file held when it was opened.
    links : list of str
        The links that the file held when it was opened.
    link : str
        The link of the last line, or the origin.
    torn : int
        Bytes of a torn line that were cut off.

    Raises
    ------
    LogError
        If a line was changed, or, a `BusyError`, another handle writes the log.
    """

    def __init__(self, path: Path, origin: str = ""):
        self.path, self.origin = path, origin
        self.handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND, 0o666)
        self.close = weakref.finalize(self, os.close, self.handle)
        try:
            fcntl.flock(self.handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            self.close()
            raise BusyError(f"{path} is being written; end that first") from None
        reading = read_log(path, origin)
        self.entries, self.links, self.torn = reading.entries, reading.links, reading.torn
        self.link = self.links[-1]
        if reading.fault and not self.torn:
            self.close()
            # A study goes by what its events say of its logs: none can be done without.
            away = "" if origin else ", or move it away"
            raise LogError(f"{path}: {reading.fault}; restore it from a copy{away}")
        os.ftruncate(self.handle, reading.size)
        if not self.entries:  # new, or left by who was killed before this
            sync_folder(path.parent)

    def append(self, entries: Iterable[Any]) -> None:
        """
        Append entries; they are on the disk when this returns, or not at all.

        Parameters
        ----------
        entries : iterable
            What JSON can express.

        Raises
        ------
        OSError
            If the disk does not take them.
        """
        link, lines = self.link, []
        for entry in entries:
            link, line = linked(link, entry)
            lines.append(line)
        data = "".join(lines).encode()
        size = os.fstat(self.handle).st_size
        try:
            if os.write(self.handle, data) < len(data):
                raise OSError(f"{self.path.name}: only a part was written; is the disk full?")
            os.fsync(self.handle)
        except OSError:
            os.ftruncate(self.handle, size)  # half a line must not stand in front of the next one
            raise
        self.link = link
