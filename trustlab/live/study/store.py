"""
What a live study keeps on the disk: one folder per participant, with files of linked lines that
only grow; beside the study, the links of its pages.

What a writer that died left of a line is cut off when the folder is next opened, and the cut is
noted among the participant's events.
"""

import json
import secrets
import shutil
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from trustlab.live.chain import Chain, sync_folder
from trustlab.models.digest import digest
from trustlab.models.files import write_atomically

EVENTS = "events"
PLAN = "study.json"
TOMBSTONE = ".deleted"
TOKENS = ".tokens.json"
EXPERIMENTER = "experimenter"
JOIN, PREVIEW = ".join", ".preview"
"""Names of links that belong to no participant; no code has a full stop."""

PRIVATE = 0o600


class DeletedError(ValueError):
    """What is asked for belongs to a participant who was deleted."""


class Participant:
    """
    One participant's folder: the events, which are all there is to know, and a file of rows per
    attempt of a drive.

    Parameters
    ----------
    folder : pathlib.Path
        The participant's folder in the study's folder; it is made when the plan is frozen.
    origin : str
        The digest of the plan, which the first line of every file is linked to.
    """

    def __init__(self, folder: Path, origin: str):
        self.folder = folder
        self.code = folder.name
        self.origin = origin
        paths = sorted(folder.glob("*.jsonl")) if folder.is_dir() else []
        self.chains = {path.stem: self._chain(path.stem) for path in paths}
        torn = {chain.path.name: chain.torn for chain in self.chains.values() if chain.torn}
        self.events = [] if EVENTS not in self.chains else self.chains[EVENTS].read().entries
        for name, cut in torn.items():
            self.add("torn", file=name, bytes=cut)

    @property
    def deleted(self) -> bool:
        """Whether this participant was deleted, by this process or another."""
        return self.folder.with_name(f"{self.code}{TOMBSTONE}").exists()

    def add(self, kind: str, **facts: Any) -> None:
        """Append an event; it is on the disk when this returns."""
        event = {"at": round(time.time(), 3), "kind": kind, **facts}
        self._append(EVENTS, [event])
        self.events.append(event)

    def _chain(self, name: str) -> Chain:
        return Chain(self.folder / f"{name}.jsonl", file_origin(self.origin, self.code, name))

    def _append(self, name: str, entries: list[Any]) -> None:
        if name not in self.chains:
            self.chains[name] = self._chain(name)
        try:
            self.chains[name].append(entries)
        except FileNotFoundError:
            raise DeletedError(f"participant {self.code} has no folder any more") from None

    def rows(self, name: str) -> list[list[float]]:
        """Return the rows of an attempt; the file's first line is its header."""
        return self.chains[name].read().entries[1:]

    def header(self, name: str) -> dict[str, Any] | None:
        """
        Return the first line of an attempt's file, what determines the drive but for the commands;
        None before it begins.
        """
        if name not in self.chains:
            return None
        with self.chains[name].path.open("rb") as file:
            first = file.readline()
        return json.loads(first)[1] if first else None

    def open_attempt(self, name: str, header: dict[str, Any]) -> None:
        """Begin the file of an attempt."""
        self._append(name, [header])

    def count(self, name: str) -> int:
        """Return how many rows of an attempt are on the disk."""
        return max(self.chains[name].count - 1, 0) if name in self.chains else 0

    def link(self, name: str) -> str:
        """Return the link that stands for all rows of an attempt so far."""
        return self.chains[name].link

    def take(self, name: str, rows: list[list[float]]) -> int:
        """Append those rows that come next in order, and return how many are on the disk then."""
        have, entries = self.count(name), []
        for row in rows:
            number, *_ = row
            if number == have + len(entries):
                entries.append(row)
        self._append(name, entries)
        return self.count(name)


def file_origin(plan: str, code: str, name: str) -> str:
    """Return what the first line of a participant's file is linked to."""
    return digest(plan, code, name)


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
    names = (EXPERIMENTER, JOIN, PREVIEW, *codes)
    tokens = {name: known.get(name) or secrets.token_urlsafe(16) for name in names}
    write_atomically(path, json.dumps(tokens, indent=1), mode=PRIVATE)
    sync_folder(path.parent)


def delete_participant(folder: Path, code: str) -> None:
    """
    Delete folder and token of a participant, and what was made from them; an empty file says that
    there was someone.
    """
    home = folder / code
    # The tombstone first: a server that runs meanwhile turns this participant away from now on.
    home.with_name(f"{code}{TOMBSTONE}").touch()
    sync_folder(folder)
    if tokens_path(folder).exists():
        left = {name: token for name, token in read_tokens(folder).items() if name != code}
        write_atomically(tokens_path(folder), json.dumps(left, indent=1), mode=PRIVATE)
    if home.exists():
        # Renamed first, so that no row arrives in a folder that is half gone.
        home.rename(gone := folder / f".{code}.going")
        shutil.rmtree(gone)
    # They show this participant's numbers.
    for report in (*folder.glob("report*.html"), *folder.glob("report*.zip")):
        report.unlink()
    sync_folder(folder)


def deleted_codes(folder: Path) -> list[str]:
    """Return the codes of the participants who were deleted."""
    return sorted(path.name.removesuffix(TOMBSTONE) for path in folder.glob(f"*{TOMBSTONE}"))
