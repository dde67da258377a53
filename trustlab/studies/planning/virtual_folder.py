"""The folder of a virtual study: laid out like a lab's, and checked to be whole."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

from trustlab.studies.designs import LatinSquareDesign
from trustlab.studies.planning.virtual_participant import session_file

if TYPE_CHECKING:
    from trustlab.studies.planning.virtual_report import VirtualStudy

__all__ = ["Folder"]

FILES = ("participants.csv", "orders.csv", "measures.csv", "about.txt")


class Folder:
    """Where a virtual study is written; refused if it holds other things, or sessions not known to be of this study."""

    def __init__(self, path: str | os.PathLike, design: LatinSquareDesign):
        if not isinstance(path, str | os.PathLike) or not os.fspath(path):
            raise ValueError(f"out must be the path of a folder, got {path!r:.60}")
        self.path = Path(path)
        self.sessions, self.campaign = self.path / "sessions", self.path / "campaign"
        if self.path.exists() and not self.path.is_dir():
            raise ValueError(f"out must be a folder, but {self.path} is a file; give another name")
        try:
            present = sorted(item.name for item in self.path.iterdir()) if self.path.exists() else []
            self._refuse(self.path, "other things", set(present) - {"sessions", "campaign", *FILES})
            self.sessions.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise ValueError(
                f"cannot write in {self.path}: {error.strerror or error}; choose a folder that you may write to"
            ) from error
        held = {item.name for item in self.sessions.iterdir() if not item.name.startswith(".")}
        if (self.campaign / "campaign.json").is_file():
            held -= {session_file(*row) for row in design.orders().itertuples(index=False)}
        self._refuse(self.sessions, "sessions that are not known to be of this study", held)

    @staticmethod
    def _refuse(place: Path, what: str, names: set[str]) -> None:
        if names:
            more = " …" if len(names) > 3 else ""
            raise ValueError(
                f"{place} holds {what} ({', '.join(sorted(names)[:3])}{more}); give a new or empty folder"
            )

    def finish(self, study: VirtualStudy) -> None:
        """Check that every session is there, and write the tables beside them."""
        failed = set(study.failures["participant"])
        orders = study.design.orders()
        rows = orders[~orders["participant"].isin(failed)].itertuples(index=False)
        wanted = [session_file(*row) for row in rows]
        missing = [name for name in wanted if not (self.sessions / name).is_file()]
        if missing:
            raise ValueError(
                f"{len(missing)} of {len(wanted)} sessions are missing from {self.sessions} ({missing[0]} first), although the "
                "campaign beside it says that they were run; remove the folder and run the study again"
            )
        about = f"SIMULATED. {study.summary}\nOne file per session in sessions/: trustlab.read_sessions reads them.\n"
        try:
            study.participants.to_csv(self.path / "participants.csv", index=False)
            study.design.orders().to_csv(self.path / "orders.csv", index=False)
            study.measures.to_csv(self.path / "measures.csv", index=False)
            (self.path / "about.txt").write_text(about, encoding="utf-8")
        except OSError as error:
            raise ValueError(f"cannot write in {self.path}: {error.strerror or error}") from error
