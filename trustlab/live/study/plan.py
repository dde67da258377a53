"""The plan of a live study: what is planned, as its folder holds it, frozen once."""

from __future__ import annotations

import json
import os
import secrets
import shutil
import threading
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Self

from trustlab.live.log import sync_folder
from trustlab.live.study.pages import Step, StudyPage, steps_of
from trustlab.live.task import LiveTask, task_named
from trustlab.models.checks import one_of
from trustlab.models.digest import digest
from trustlab.models.files import write_atomically

FORMAT = 5
PLAN = "study.json"
EVENTS = "events"
EXPERIMENTER = "experimenter"
JOIN = ".join"
"""The name of the link for joining; no code has a full stop."""

TOMBSTONE = ".deleted"
"""The suffix of an empty file, which says that a participant was deleted."""


class DeletedError(ValueError):
    """What is asked for belongs to a participant who was deleted."""


@dataclass(frozen=True, eq=False, repr=False)
class Plan:
    """
    What is planned: conditions, everybody's order, pages, drives and the digest of the physics.

    Parameters
    ----------
    folder : pathlib.Path
        The study's folder.
    content : dict
        What `study.json` holds.
    """

    folder: Path
    content: dict

    @classmethod
    def open(cls, folder: str | os.PathLike) -> Self:
        """
        Return the study that a folder holds.

        Parameters
        ----------
        folder : path-like
            The study's folder.

        Raises
        ------
        ValueError
            If there is no plan in it, or one that was changed or is of another version.
        """
        plan = cls.__new__(cls)
        Plan.__init__(plan, Path(folder).absolute(), read_plan(Path(folder)))
        return plan

    def freeze(self) -> None:
        """Write the plan where there is none; compare it with the one that is there."""
        if (self.folder / PLAN).exists():
            frozen = read_plan(self.folder)
            changed = [name for name in self.content if frozen.get(name) != self.content[name]]
            if changed:
                changed.remove("digest")
                raise ValueError(
                    f"{self.folder} holds a frozen plan with other {', '.join(changed)}; open it "
                    "with trustlab.LiveStudy.open, or choose another folder: a plan does not "
                    "change once it is made"
                )
            return
        self.folder.mkdir(parents=True, exist_ok=True)
        if {path.name for path in self.folder.iterdir()} - set(self.orders):
            raise ValueError(
                f"{self.folder} has other files in it; a study needs a folder of its own"
            )
        for code in self.orders:
            (self.folder / code).mkdir(exist_ok=True)
        tokens = {name: secrets.token_urlsafe(16) for name in (EXPERIMENTER, JOIN, *self.orders)}
        write_tokens(self.folder, tokens)
        sync_folder(self.folder.parent)
        sync_folder(self.folder)
        write_atomically(self.folder / PLAN, json.dumps(self.content, indent=1) + "\n")
        sync_folder(self.folder)

    @property
    def digest(self) -> str:
        """The digest that the plan was frozen with; every file of the study is linked to it."""
        return self.content["digest"]

    @property
    def orders(self) -> dict[str, list[str]]:
        """The order of conditions of each participant, by code."""
        return self.content["orders"]

    @property
    def groups(self) -> dict[str, str]:
        """The group of each participant, by code; empty where there are none."""
        return self.content["groups"]

    @property
    def rehearsal(self) -> bool:
        """Whether scripted hands drive, so that everything is synthetic."""
        return self.content["rehearsal"]

    @property
    def task(self) -> LiveTask:
        """What people do."""
        return task_named(self.content["task"])

    @cached_property
    def pages(self) -> list[StudyPage]:
        """The pages in their order, each once."""
        return [StudyPage.read(page) for page in self.content["pages"]]

    def steps(self, code: str) -> list[Step]:
        """
        Return a participant's way through the study, page by page.

        Parameters
        ----------
        code : str
            The participant.
        """
        order = self.orders[one_of("participant", code, self.orders)]
        return steps_of(self.pages, order, self.groups.get(code, ""))

    def deleted(self) -> list[str]:
        """Return the codes of the participants who were deleted."""
        return [code for code in self.orders if is_deleted(self.folder, code)]

    def present(self) -> list[str]:
        """Return the codes of all who were not deleted."""
        return [code for code in self.orders if not is_deleted(self.folder, code)]


_links_lock = threading.Lock()


def content_digest(content: dict) -> str:
    """Return the digest of all that a plan holds."""
    rest = {name: value for name, value in content.items() if name != "digest"}
    return digest(json.dumps(rest, sort_keys=True))


def read_plan(folder: Path) -> dict:
    """Return what the plan in a folder holds; one that is not as it was frozen is refused."""
    file = folder.absolute() / PLAN
    if not file.is_file():
        raise ValueError(
            f"there is no {PLAN} in {folder}: no live study was planned there; make one with "
            "trustlab.LiveStudy"
        )
    try:
        content = json.loads(file.read_text(encoding="utf-8"))
        whole = content["digest"] == content_digest(content) and content["format"] == FORMAT
    except (ValueError, AttributeError, TypeError, KeyError):
        whole = False
    if not whole:
        raise ValueError(
            f"{file} was changed after it was frozen, or is of another version of trustlab; "
            "restore it from a copy"
        )
    return content


def file_origin(plan: str, code: str, name: str) -> str:
    """Return what the first line of a participant's file is linked to."""
    return digest(plan, code, name)


# beside the data, not with them
# --------------------------------------------------------------------------------------------------


def _content(path: Path) -> dict[str, str]:
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise ValueError(f"{path} was damaged ({error}); restore it from a copy") from None


def links_path(folder: Path) -> Path:
    """Return where the last links of events are kept."""
    return folder.with_name(f"{folder.name}.links.json")


def read_links(folder: Path) -> dict[str, str]:
    """Return the last link of each participant's events, as it was written down."""
    path = links_path(folder)
    return _content(path) if path.exists() else {}


def note_link(folder: Path, code: str, link: str | None) -> None:
    """Write down the last link of a participant's events; None forgets it."""
    with _links_lock:
        links = read_links(folder)
        links.pop(code, None)
        links |= {code: link} if link else {}
        write_atomically(links_path(folder), json.dumps(links, indent=1) + "\n")


def tokens_path(folder: Path) -> Path:
    """Return where the tokens are kept, of 128 bits each."""
    return folder.with_name(f"{folder.name}.tokens.json")


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
    return _content(path)


def write_tokens(folder: Path, tokens: dict[str, str]) -> None:
    """Write tokens by name, for nobody else on this machine."""
    write_atomically(tokens_path(folder), json.dumps(tokens, indent=1), mode=0o600)


def is_deleted(folder: Path, code: str) -> bool:
    """Return whether a participant was deleted."""
    return (folder / f"{code}{TOMBSTONE}").exists()


def delete_participant(folder: Path, code: str) -> None:
    """
    Delete folder and token of a participant, and what was made from them; an empty file says that
    there was someone. What was interrupted is finished by another call.
    """
    home, gone = folder / code, folder / f".{code}.going"
    # First of all: a server that runs meanwhile turns this participant away from now on.
    (folder / f"{code}{TOMBSTONE}").touch()
    if home.exists():
        home.rename(gone)  # no row arrives in a folder that is half gone
    sync_folder(folder)
    if tokens_path(folder).exists():
        tokens = read_tokens(folder)
        tokens.pop(code, None)
        write_tokens(folder, tokens)
    note_link(folder, code, None)
    if gone.exists():
        shutil.rmtree(gone)
    # They show this participant's numbers.
    for report in (*folder.glob("report*.html"), *folder.glob("report*.zip")):
        report.unlink()
    sync_folder(folder)
