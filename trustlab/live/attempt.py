"""
Rows of one drive on their way from a browser to a file: appended and on the disk before they are
acknowledged.
"""

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from trustlab.live.runs import replay, session_of
from trustlab.live.study.store import append, cut_torn_line, read_lines
from trustlab.models.checks import shown
from trustlab.sessions.session import Session


class Attempt:
    """
    One attempt at a drive: a file whose first line holds the settings, and then one line per row or
    note.

    A drive that was cut off goes on in its file; where the last attempt was finished, another one
    begins.
    """

    def __init__(self, folder: str | Path, participant: str, config: Mapping[str, Any]):
        self.participant, self.config = participant, config
        text = json.dumps({"participant": participant, "config": config}, sort_keys=True)
        self.digest = hashlib.sha256(text.encode()).hexdigest()[:12]
        number = 1
        while not self._open(
            Path(folder) / f"{config['condition']}-{self.digest}-{number}.jsonl", text
        ):
            number += 1
        self.key = f"notebook/{self.digest}/{number}"

    def _open(self, path: Path, header: str) -> bool:
        """Read a file, if there is one, and return whether its drive can go on."""
        self.path = path
        self.rows = []
        self.stamps = []
        self.notes = []
        self.finished = False
        if not path.exists():
            path.parent.mkdir(parents=True, exist_ok=True)
            append(path, [header])
            return True
        cut_torn_line(path)  # a line torn by a crash was never acknowledged
        for entry in read_lines(path)[1:]:
            self._take(entry)
        return not self.finished

    def _take(self, entry: Any) -> None:
        if isinstance(entry, list):
            self.stamps.append(entry[1])
            self.rows.append(entry[2:])
        elif "note" in entry:
            self.notes.append(f"row {entry['row']}: {entry['note']}")
        else:
            self.finished = True

    def answer(self, said: Mapping[str, Any]) -> dict[str, Any]:
        """
        Return the answer to a message of the browser: rows to keep, a note, the beginning or the
        end of the drive.
        """
        if said.get("rows"):
            new = []
            for row in said["rows"]:
                number, *_ = self._checked(row)
                if number == len(self.rows) + len(new):
                    new.append(row)
            append(self.path, [json.dumps(row) for row in new])
        else:
            new = (
                [{"note": str(said["note"])[:200], "row": len(self.rows)}] if "note" in said else []
            )
            new += [{"end": said["end"]}] if "end" in said and not self.finished else []
            append(self.path, [json.dumps(entry) for entry in new])
        for entry in new:
            self._take(entry)
        return {"have": len(self.rows)} | ({"rows": self.rows} if said.get("begin") else {})

    def _checked(self, row: Any) -> list:
        if (
            not isinstance(row, list)
            or len(row) != 2 + len(self.config["columns"])
            or not all(type(x) in (int, float) for x in row)
        ):
            raise ValueError(
                f"a row is {2 + len(self.config['columns'])} numbers, got {shown(row)}"
            )
        return row

    @property
    def verified(self) -> bool:
        """Whether all rows so far are, bit for bit, what numba computes from their commands."""
        return bool(self.rows) and replay(self.config, np.array(self.rows, dtype=float)) is True

    @property
    def session(self) -> Session:
        """What has been driven so far."""
        period = np.diff(self.stamps) / 1000.0
        facts = {
            "verified": self.verified,
            "finished": self.finished,
            "file": self.path.name,
            "pauses": list(self.notes),
        }
        facts |= (
            {"period_median": float(np.median(period)), "period_max": float(period.max())}
            if period.size
            else {}
        )
        return session_of(
            self.config,
            np.array(self.rows, dtype=float).reshape(-1, len(self.config["columns"])),
            participant=self.participant,
            **facts,
        )
