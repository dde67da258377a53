"""The folder of a virtual study: laid out like a lab's, and checked to be whole."""

from __future__ import annotations

import os
from fnmatch import fnmatchcase
from typing import TYPE_CHECKING

from trustlab.campaign.folder import folder_path, refuse, writing_in
from trustlab.studies.designs import LatinSquareDesign
from trustlab.studies.planning.virtual_participant import session_file

if TYPE_CHECKING:
    from trustlab.studies.planning.virtual_report import VirtualStudy

FILES = ("participants.csv", "orders.csv", "measures.csv", "about.txt")


class Folder:
    """Where a virtual study is written; refused if it holds other things, or sessions not known to be of this study."""

    def __init__(self, path: str | os.PathLike, design: LatinSquareDesign, fresh: bool = False):
        self.path = folder_path(path)
        self.sessions, self.campaign = self.path / "sessions", self.path / "campaign"
        with writing_in(self.path):
            present = {item.name for item in self.path.iterdir()} if self.path.exists() else set()
            refuse(self.path, "other things", present - {"sessions", "campaign", *FILES})
            self.sessions.mkdir(parents=True, exist_ok=True)
        held = {item.name for item in self.sessions.iterdir() if not item.name.startswith(".")}
        known = set()
        if (self.campaign / "campaign.json").is_file():
            known = {session_file(*row) for row in design.orders().itertuples(index=False)}
            if fresh:
                known = {name for name in held if fnmatchcase(name, "participant_*_trial_*.parquet")}
        refuse(self.sessions, "sessions that are not known to be of this study", held - known)
        if fresh:
            for name in known & held:
                (self.sessions / name).unlink()

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
        with writing_in(self.path):
            study.participants.to_csv(self.path / "participants.csv", index=False)
            orders.to_csv(self.path / "orders.csv", index=False)
            study.measures.to_csv(self.path / "measures.csv", index=False)
            (self.path / "about.txt").write_text(about, encoding="utf-8")
