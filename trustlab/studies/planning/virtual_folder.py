"""The folder of a virtual study: laid out like a lab's, and checked to be whole."""

from __future__ import annotations

import os
from pathlib import Path

from trustlab.studies.designs import LatinSquareDesign
from trustlab.studies.planning.virtual_participant import session_file

__all__ = ["Folder"]

FILES = ("participants.csv", "orders.csv", "measures.csv", "about.txt")


class Folder:
    """
    Where a virtual study is written.

    Parameters
    ----------
    path : path-like
        The folder; made if it is not there.

    Raises
    ------
    ValueError
        If it is no path, a file is in its place, it cannot be written to, or it holds other things.
    """

    def __init__(self, path: str | os.PathLike):
        if not isinstance(path, str | os.PathLike) or not os.fspath(path):
            raise ValueError(f"out must be the path of a folder, got {path!r:.60}")
        self.path = Path(path)
        self.sessions, self.campaign = self.path / "sessions", self.path / "campaign"
        if self.path.exists() and not self.path.is_dir():
            raise ValueError(f"out must be a folder, but {self.path} is a file; give another name")
        own = {"sessions", "campaign", *FILES}
        if self.path.is_dir():
            other = sorted(item.name for item in self.path.iterdir() if item.name not in own)
            if other:
                raise ValueError(
                    f"{self.path} holds other things ({', '.join(other[:3])}{' …' if len(other) > 3 else ''}); give a new or empty "
                    "folder"
                )

    def prepare(self, design: LatinSquareDesign) -> None:
        """
        Make the folders, and refuse sessions that are not of this study.

        Parameters
        ----------
        design : LatinSquareDesign
            Its design.

        Raises
        ------
        ValueError
            If the folder cannot be written to or holds other sessions.
        """
        try:
            self.sessions.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise ValueError(
                f"cannot write in {self.path}: {error.strerror or error}; choose a folder that you may write to"
            ) from error
        present = {item.name for item in self.sessions.iterdir() if not item.name.startswith(".")}
        other = sorted(present - self._expected(design))
        known = (self.campaign / "campaign.json").is_file()
        if other or (present and not known):
            name = other[0] if other else sorted(present)[0]
            raise ValueError(
                f"{self.sessions} holds sessions that are not known to be of this study ({name} first); give a new or empty folder"
            )

    @staticmethod
    def _expected(design: LatinSquareDesign) -> set[str]:
        return {session_file(*row) for row in design.orders().itertuples(index=False)}

    def finish(self, study) -> None:
        """
        Check that every session is there, and write the tables beside them.

        Parameters
        ----------
        study : VirtualStudy
            The study.

        Raises
        ------
        ValueError
            If sessions are missing or a file cannot be written.
        """
        failed = set(study.failures["participant"])
        rows = study.design.orders().itertuples(index=False)
        wanted = [session_file(*row) for row in rows if row[0] not in failed]
        missing = [name for name in wanted if not (self.sessions / name).is_file()]
        if missing:
            raise ValueError(
                f"{len(missing)} of {len(wanted)} sessions are missing from {self.sessions} ({missing[0]} first), although the "
                "campaign beside it says that they were run; remove the folder and run the study again"
            )
        try:
            study.participants.to_csv(self.path / FILES[0], index=False)
            study.design.orders().to_csv(self.path / FILES[1], index=False)
            study.measures.to_csv(self.path / FILES[2], index=False)
            (self.path / FILES[3]).write_text(
                f"SIMULATED. {study.summary}\nOne file per session in sessions/: trustlab.read_sessions reads them.\n",
                encoding="utf-8",
            )
        except OSError as error:
            raise ValueError(f"cannot write in {self.path}: {error.strerror or error}") from error
