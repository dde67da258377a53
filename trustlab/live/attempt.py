"""
Rows of one drive on their way from a browser to a file: appended and on the disk before they are
acknowledged, by one writer.
"""

import json
import os
import threading
import weakref
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np

from trustlab.live.chain import Chain, hold
from trustlab.live.rows import check_row
from trustlab.live.tasks.task import ServedRun, task_of
from trustlab.models.digest import digest
from trustlab.sessions.session import Session

LATE = "This drive goes on in another window. Close this one, or start it again here."
FULL = (
    "The rows cannot be saved ({error}). Nothing is lost: they wait in this browser, which goes on "
    "sending them."
)


class Attempt:
    """
    One attempt at a drive: a file whose first line holds the settings, and then one line per row,
    window, or note.

    A drive that was cut off goes on in its file; where the last attempt was finished, another one
    begins. The window that began last drives: what others send is refused.

    Raises
    ------
    ValueError
        If another kernel writes this drive.
    """

    _open: ClassVar[weakref.WeakValueDictionary] = weakref.WeakValueDictionary()

    def __init__(self, folder: str | Path, participant: str, config: Mapping[str, Any]):
        self.participant = participant
        self.config = config
        # A notebook's kernel may answer in one thread and show a session in another.
        self.lock = threading.RLock()
        header = {"participant": participant, "config": config}
        self.digest = digest(json.dumps(header, sort_keys=True))[:12]
        Path(folder).mkdir(parents=True, exist_ok=True)
        number = 1
        while not self._read(
            Path(folder).absolute() / f"{config['condition']}-{self.digest}-{number}.jsonl", header
        ):
            number += 1
        self.key = f"notebook/{self.digest}/{number}"
        Attempt._open[self.path] = self

    @classmethod
    def of(cls, folder: str | Path, participant: str, config: Mapping[str, Any]) -> Self:
        """Return the attempt at a drive that this kernel has open, or open it."""
        header = {"participant": participant, "config": config}
        text = digest(json.dumps(header, sort_keys=True))[:12]
        prefix = str(Path(folder).absolute() / f"{config['condition']}-{text}-")
        for path, attempt in cls._open.items():
            if str(path).startswith(prefix) and not attempt.finished:
                return attempt
        return cls(folder, participant, config)

    def _read(self, path: Path, header: Mapping[str, Any]) -> bool:
        """Open a file, or make it, and return whether its drive can go on."""
        self.path = path
        self.rows = []
        self.stamps = []
        self.notes = []
        self.window = ""
        self.finished = False
        self._served: ServedRun | None = None
        path.touch()
        handle = hold(path)
        if handle is None:
            raise ValueError(
                f"{path.name} is being driven in another kernel or notebook; shut that kernel "
                "down, or drive with another participant= or folder="
            )
        self._release = weakref.finalize(self, os.close, handle)
        self.chain = Chain(path, self.digest)
        if self.chain.count == 0:
            self.chain.append([header])
            return True
        for entry in self.chain.read().entries[1:]:
            self._take(entry)
        return not self.finished

    def close(self) -> None:
        """Let another writer have the file."""
        self._release()

    def _take(self, entry: Any) -> None:
        if isinstance(entry, list):
            self.stamps.append(entry[1])
            self.rows.append(entry[2:])
        elif "window" in entry:
            self.window = entry["window"]
        elif "note" in entry:
            self.notes.append(f"row {entry['row']}: {entry['note']}")
        else:
            self.finished = True
            self.close()

    def answer(self, message: Mapping[str, Any]) -> dict[str, Any]:
        """
        Return the answer to a message of a window: {"begin": …}, {"rows": …}, {"note": …} or
        {"end": …}, each with its "window".

        "have" says how many rows are on the disk; "refused" that this window must not go on, and
        "trouble" that it should try again, both in words.
        """
        window = str(message.get("window", ""))[:40]
        if "begin" not in message and window != self.window:
            return {"refused": LATE}
        with self.lock:
            try:
                new = self._entries(message, window)
                self.chain.append(new)
            except ValueError as error:
                return {"refused": f"A row cannot be taken: {error}."}
            except OSError as error:
                return {"trouble": FULL.format(error=error.strerror or error)}
            for entry in new:
                self._take(entry)
            rows = {"rows": list(self.rows)} if "begin" in message else {}
            seen = {"picture": self.served.picture()} if self.config.get("served") else {}
            return {"have": len(self.rows), **rows, **seen}

    @property
    def served(self) -> ServedRun:
        """The run of a task that is computed here, behind the rows that are kept."""
        if self._served is None:
            stamped = zip(self.stamps, self.rows, strict=True)
            rows = [[k, stamp, *row] for k, (stamp, row) in enumerate(stamped)]
            self._served = ServedRun(self.config, rows)
        return self._served

    def _entries(self, message: Mapping[str, Any], window: str) -> list[Any]:
        """Return what a message adds to the file."""
        have = len(self.rows)
        if "begin" in message:
            return [{"window": window, "row": have}]
        if "note" in message:
            return [{"note": str(message["note"])[:200], "row": have}]
        if "end" in message:
            return [] if self.finished else [{"end": message["end"]}]
        rows = message.get("rows", [])
        for row in rows:
            check_row(self.config, row)
        if self.config.get("served"):
            rows = self.served.complete(rows)
        new = []
        for row in rows:
            number, *_ = row
            if number == have + len(new):
                new.append(row)
        if new and self.finished:
            raise ValueError("the drive is over")
        return new

    @property
    def verified(self) -> bool:
        """
        Whether all rows so far are, bit for bit, what numba computes from their commands, and the
        file is as it was written.
        """
        with self.lock:
            rows = np.array(self.rows, dtype=float)
            if not self.rows or self.chain.read().fault:
                return False
        return task_of(self.config).replay(self.config, rows) is True

    @property
    def session(self) -> Session:
        """What has been driven so far."""
        with self.lock:
            period = np.diff(self.stamps) / 1000.0
            rows = np.array(self.rows, dtype=float)
            facts = {
                "verified": self.verified,
                "finished": self.finished,
                "file": self.path.name,
                "pauses": list(self.notes),
            }
        if period.size:
            facts["period_median"] = float(np.median(period))
            facts["period_max"] = float(period.max())
        return task_of(self.config).session(
            self.config,
            rows.reshape(-1, len(self.config["columns"])),
            participant=self.participant,
            **facts,
        )
