"""
Files that only grow: a line is on the disk before it is acknowledged, and none can be changed
unseen.

Each line is a JSON array of a link and an entry. The link is a digest of the entry's text and of
the link before it, so that it stands for everything up to its line. A line that was changed, taken
out or put in is found by its number. Links show changes, not who made them: someone who writes all
lines anew can link them anew, unless the last link was written down elsewhere.

A file ends with a whole line, or its writer died in the middle of one: what follows the last line
end is cut off when a writer opens the file again.
"""

import fcntl
import json
import os
import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

from trustlab.models.digest import digest

DIGITS = 16
"""Hexadecimal digits of a link."""

PREFIX = len('["') + DIGITS + len('", ')


class ChainReading(NamedTuple):
    """
    Entries of a file, their links, what is wrong with it ("" if nothing is), and whether a line
    could not be read.
    """

    entries: list[Any]
    links: list[str]
    fault: str
    damaged: bool = False


def link_of(before: str, text: str | bytes) -> str:
    """Return the link of an entry's text behind another link, or behind a chain's origin."""
    return digest(before, text)[:DIGITS]


def sync_folder(folder: Path) -> None:
    """Return when the names in a folder are on the disk, not only what the files hold."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def hold(path: Path) -> int | None:
    """
    Return a handle that locks a file or folder until it is closed, or None if another handle does.
    """
    handle = os.open(path, os.O_RDONLY)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(handle)
        return None
    return handle


def check_writable(folder: Path) -> None:
    """Refuse a folder in which nothing can be written."""
    try:
        with tempfile.TemporaryFile(dir=folder) as file:
            file.write(b"\n")
            file.flush()
            os.fsync(file.fileno())
    except OSError as error:
        raise ValueError(
            f"nothing can be written in {folder} ({error.strerror}): make it writable and see that "
            "its disk has room before people come"
        ) from None


def append(path: Path, lines: Iterable[str]) -> None:
    """Append lines and return when they are on the disk; the folder must be there."""
    new = not path.exists()
    with path.open("ab", buffering=0) as file:
        before = file.tell()
        try:
            data = "".join(f"{line}\n" for line in lines).encode()
            if file.write(data) < len(data):
                raise OSError(f"{path.name}: only a part was written; is the disk full?")
            os.fsync(file.fileno())
        except OSError:
            file.truncate(before)  # half a line must not stand in front of the next one
            raise
    if new:
        sync_folder(path.parent)


def cut_torn_line(path: Path) -> int:
    """Cut off what follows the last line end, and return how many bytes that were."""
    data = path.read_bytes()
    torn = len(data) - (data.rfind(b"\n") + 1)
    if torn:
        with path.open("r+b") as file:
            file.truncate(len(data) - torn)
            os.fsync(file.fileno())
    return torn


def read_chain(path: Path, origin: str) -> ChainReading:
    """
    Return what a file holds, with its first fault.

    A line that is no JSON ends the reading there; a torn last line is left out.
    """
    if not path.exists():
        return ChainReading([], [], f"{path.name} is missing")
    *whole, torn = path.read_bytes().split(b"\n")
    entries: list[Any] = []
    links: list[str] = []
    fault = ""
    before = origin
    for number, line in enumerate(whole, 1):
        try:
            link, entry = json.loads(line)
        except (ValueError, TypeError):
            damage = f"{path.name}, line {number}: {line[:40]!r} is no entry with its link"
            return ChainReading(entries, links, fault or damage, damaged=True)
        text = line[PREFIX:-1]
        expected = link_of(before, text)
        if line != f'["{expected}", '.encode() + text + b"]" and not fault:
            fault = f"{path.name}, line {number}: it was changed, or lines before it were"
        entries.append(entry)
        links.append(str(link))
        before = links[-1]
    if torn and not fault:
        fault = f"{path.name}: its last line is torn"
    return ChainReading(entries, links, fault)


class Chain:
    """
    The one writer of a file of linked lines.

    Parameters
    ----------
    path : pathlib.Path
        The file; it is made with its first line.
    origin : str
        What the first line is linked to: what the file belongs to.

    Attributes
    ----------
    count : int
        Entries on the disk.
    link : str
        The link of the last one.
    torn : int
        Bytes of a torn line that were cut off when the file was opened.

    """

    def __init__(self, path: Path, origin: str):
        self.path = path
        self.origin = origin
        self.torn = cut_torn_line(path) if path.exists() else 0
        lines = path.read_bytes().splitlines() if path.exists() else []
        self.count = len(lines)
        self.link = lines[-1][2 : 2 + DIGITS].decode("ascii", "replace") if lines else origin

    def read(self) -> ChainReading:
        """Return what the file holds; changed lines are named, damaged ones are refused."""
        reading = read_chain(self.path, self.origin)
        if reading.damaged:
            raise ValueError(
                f"{reading.fault}; a line was changed after it was written: restore the file "
                "from a copy, or take the line out by hand and say so in the report"
            )
        return reading

    def append(self, entries: Iterable[Any]) -> None:
        """Append entries; they are on the disk when this returns, or not at all."""
        link = self.link
        lines = []
        for entry in entries:
            text = json.dumps(entry)
            link = link_of(link, text)
            lines.append(f'["{link}", {text}]')
        if lines:
            append(self.path, lines)
            self.link = link
            self.count += len(lines)
