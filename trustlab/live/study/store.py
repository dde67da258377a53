"""
What a live study keeps on the disk: one folder per participant, files that only grow, nothing
acknowledged before fsync.

A file ends with a whole line, or its writer died in the middle of one: what follows the last line
end is cut off when the folder is next opened, and the cut is noted among the participant's events.
"""

import json
import os
import secrets
import shutil
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any

EVENTS = "events.jsonl"
PLAN = "study.json"
TOMBSTONE = ".deleted"
TOKENS = ".tokens.json"
EXPERIMENTER = "experimenter"


class DeletedError(ValueError):
    """What is asked for belongs to a participant who was deleted."""


def sync_folder(folder: Path) -> None:
    """Return when the names in a folder are on the disk, not only what the files hold."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


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


def write_whole(path: Path, text: str, mode: int = 0o644) -> None:
    """
    Write a file at once, on the disk when this returns: whoever reads it sees the old one or the
    new one.
    """
    written = path.with_name(f".{path.name}.partial")
    written.unlink(missing_ok=True)
    with os.fdopen(os.open(written, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode), "wb") as file:
        file.write(text.encode())
        file.flush()
        os.fsync(file.fileno())
    os.replace(written, path)
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


def read_lines(path: Path) -> list[Any]:
    """
    Return what the whole lines of a file hold; a torn last line is left out, a damaged one in the
    middle refused.
    """
    if not path.exists():
        return []
    *whole, _ = path.read_bytes().split(b"\n")
    found = []
    for number, line in enumerate(whole, 1):
        try:
            found.append(json.loads(line))
        except ValueError:
            raise ValueError(
                f"{path.name}, line {number}: {line[:40]!r} is no JSON; this line was changed "
                "after it was written: restore the file from a copy, or take the line out by "
                "hand and say so in the report"
            ) from None
    return found


class Participant:
    """
    One participant's folder: the events, which are all there is to know, and a file of rows per
    attempt of a drive.

    Parameters
    ----------
    folder : pathlib.Path
        The participant's folder in the study's folder; it is made when the plan is frozen.
    """

    def __init__(self, folder: Path):
        self.folder, self.code = folder, folder.name
        self.counts: dict[str, int] = {}
        self.torn = {}
        if folder.is_dir():
            self.torn = {
                path.name: cut
                for path in sorted(folder.glob("*.jsonl"))
                if (cut := cut_torn_line(path))
            }
        self.events = read_lines(folder / EVENTS)
        for name, cut in self.torn.items():
            self.add("torn", file=name, bytes=cut)

    @property
    def deleted(self) -> bool:
        """Whether this participant was deleted, by this process or another."""
        return self.folder.with_name(f"{self.code}{TOMBSTONE}").exists()

    def add(self, kind: str, **facts: Any) -> None:
        """Append an event; it is on the disk when this returns."""
        event = {"at": round(time.time(), 3), "kind": kind, **facts}
        self._append(EVENTS, [json.dumps(event)])
        self.events.append(event)

    def _append(self, name: str, lines: list[str]) -> None:
        try:
            append(self.folder / name, lines)
        except FileNotFoundError:
            raise DeletedError(f"participant {self.code} has no folder any more") from None

    def rows(self, name: str) -> list[list[float]]:
        """Return the rows of an attempt; the file's first line is its header."""
        return read_lines(self.folder / f"{name}.jsonl")[1:]

    def header(self, name: str) -> dict[str, Any] | None:
        """
        Return the first line of an attempt's file, what determines the drive but for the commands;
        None before it begins.
        """
        path = self.folder / f"{name}.jsonl"
        if not path.exists():
            return None
        with path.open("rb") as file:
            first = file.readline()
        return json.loads(first) if first else None

    def open_attempt(self, name: str, header: dict[str, Any]) -> None:
        """Begin the file of an attempt."""
        self._append(f"{name}.jsonl", [json.dumps(header)])
        self.counts[name] = 0

    def count(self, name: str) -> int:
        """Return how many rows of an attempt are on the disk."""
        if name not in self.counts:
            self.counts[name] = len(self.rows(name))
        return self.counts[name]

    def take(self, name: str, rows: list[list[float]]) -> int:
        """Append those rows that come next in order, and return how many are on the disk then."""
        have, lines = self.count(name), []
        for row in rows:
            number, *_ = row
            if number == have + len(lines):
                lines.append(json.dumps(row))
        if lines:
            self._append(f"{name}.jsonl", lines)
            self.counts[name] = have + len(lines)
        return self.counts[name]


def tokens_path(folder: Path) -> Path:
    """Return where the tokens are kept: beside the data, not with them."""
    return folder.with_name(f"{folder.name}{TOKENS}")


def read_tokens(folder: Path) -> dict[str, str]:
    """Return the token of every participant, by code, and that of the experimenter."""
    path = tokens_path(folder)
    if not path.exists():
        raise ValueError(
            f"there is no {path}: the links of this study are not on this machine; the plan's "
            "owner has them"
        )
    if path.stat().st_mode & 0o077:
        raise ValueError(f"{path} can be read by others on this machine; run: chmod 600 {path}")
    return dict(json.loads(path.read_text(encoding="utf-8")))


def make_tokens(folder: Path, codes: Iterable[str]) -> None:
    """
    Draw a token of 128 bits for each participant and for the experimenter; those that are there
    stay.
    """
    path = tokens_path(folder)
    known = read_tokens(folder) if path.exists() else {}
    tokens = {name: known.get(name) or secrets.token_urlsafe(16) for name in (EXPERIMENTER, *codes)}
    write_whole(path, json.dumps(tokens, indent=1), 0o600)


def delete_participant(folder: Path, code: str) -> None:
    """
    Delete folder and token of a participant, and what was made from them; an empty file says that
    there was someone.
    """
    own = folder / code
    # The tombstone first: a server that runs meanwhile turns this participant away from now on.
    own.with_name(f"{code}{TOMBSTONE}").touch()
    sync_folder(folder)
    if tokens_path(folder).exists():
        left = {name: token for name, token in read_tokens(folder).items() if name != code}
        write_whole(tokens_path(folder), json.dumps(left, indent=1), 0o600)
    if own.exists():
        # Renamed first, so that no row arrives in a folder that is half gone.
        own.rename(gone := folder / f".{code}.going")
        shutil.rmtree(gone)
    for report in folder.glob("report*.html"):  # it shows this participant's numbers
        report.unlink()
    sync_folder(folder)


def deleted_codes(folder: Path) -> list[str]:
    """Return the codes of the participants who were deleted."""
    return sorted(path.name.removesuffix(TOMBSTONE) for path in folder.glob(f"*{TOMBSTONE}"))
