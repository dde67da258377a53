"""The plan of a live study: what is planned, as its folder holds it, frozen once."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Self

from trustlab.live.chain import sync_folder
from trustlab.live.study.pages import Step, StudyPage, steps_of
from trustlab.live.study.store import (
    PLAN,
    Participant,
    deleted_codes,
    make_tokens,
)
from trustlab.models.checks import one_of
from trustlab.models.digest import digest
from trustlab.models.files import write_atomically

FORMAT = 3


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
    content: dict[str, Any]

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
            If there is no plan in it, or one of another version of this package.
        """
        plan = cls.__new__(cls)
        Plan.__init__(plan, Path(folder).absolute(), read_plan(Path(folder)))
        try:
            for code in plan.orders:
                plan.steps(code)
        except (KeyError, TypeError, AttributeError) as error:
            raise ValueError(
                f"{plan.folder / PLAN} was changed after it was frozen, and does not hold a plan "
                f"any more ({error!r}); restore it from a copy"
            ) from None
        return plan

    def freeze(self) -> None:
        """Write the plan where there is none; compare it with the one that is there."""
        if (self.folder / PLAN).exists():
            frozen = read_plan(self.folder)
            changed = [key for key in self.content if frozen.get(key) != self.content[key]]
            if changed and changed != ["digest"]:
                changed.remove("digest")
            if changed:
                raise ValueError(
                    f"{self.folder} holds a frozen plan with other {', '.join(changed)}; open it "
                    "with trustlab.LiveStudy.open, or choose another folder: a plan does not "
                    "change once it is made"
                )
            return
        if self.folder.exists() and any(
            path.name not in self.orders for path in self.folder.iterdir()
        ):
            raise ValueError(
                f"{self.folder} has other files in it; a study needs a folder of its own"
            )
        for code in self.orders:
            (self.folder / code).mkdir(parents=True, exist_ok=True)
        make_tokens(self.folder, self.orders)
        sync_folder(self.folder)
        write_atomically(self.folder / PLAN, json.dumps(self.content, indent=1) + "\n")
        sync_folder(self.folder)

    @property
    def digest(self) -> str:
        """The digest that the plan was frozen with; every file of the study is linked to it."""
        return self.content["digest"]

    @property
    def fault(self) -> str:
        """What is wrong with `study.json`: "" if it is as it was frozen."""
        return "" if self.digest == content_digest(self.content) else f"{PLAN}: it was changed"

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

    @cached_property
    def _pages(self) -> list[StudyPage]:
        return [StudyPage.read(page) for page in self.content["pages"]]

    @property
    def pages(self) -> list[StudyPage]:
        """The pages in their order, each once."""
        return list(self._pages)

    def steps(self, code: str) -> list[Step]:
        """
        Return a participant's way through the study, page by page.

        Parameters
        ----------
        code : str
            The participant.
        """
        order = self.orders[one_of("participant", code, self.orders)]
        return steps_of(self._pages, order, self.groups.get(code, ""))

    def participant(self, code: str) -> Participant:
        """
        Return a participant's folder with its events, repaired where a write was cut off.

        Parameters
        ----------
        code : str
            The participant.
        """
        return Participant(self.folder / one_of("participant", code, self.orders), self.digest)

    def deleted(self) -> list[str]:
        """Return the codes of the participants who were deleted."""
        return deleted_codes(self.folder)


def content_digest(content: Mapping[str, Any]) -> str:
    """Return the digest of all that a plan holds."""
    rest = {name: value for name, value in content.items() if name != "digest"}
    return digest(json.dumps(rest, sort_keys=True))


def read_plan(folder: Path) -> dict[str, Any]:
    """Return what the plan in a folder holds."""
    file = folder.absolute() / PLAN
    if not file.is_file():
        raise ValueError(
            f"there is no {PLAN} in {folder}: no live study was planned there; make one with "
            "trustlab.LiveStudy"
        )
    try:
        content = json.loads(file.read_text(encoding="utf-8"))
        version = content.get("format")
    except (ValueError, AttributeError) as error:
        raise ValueError(f"{file} was damaged: {error}; restore it from a copy") from None
    if version != FORMAT or "digest" not in content:
        raise ValueError(
            f"{file} has format {version!r}; this version of trustlab reads format {FORMAT}"
        )
    return content
