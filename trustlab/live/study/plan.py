"""
`LiveStudy`: a within-subject study in the browser, planned, frozen once, rehearsed and served; its
folder, and the files beside it.
"""

import json
import os
import re
import secrets
import shutil
import threading
from collections.abc import Mapping, Sequence, Set
from contextlib import closing
from dataclasses import asdict, replace
from numbers import Number
from pathlib import Path
from typing import Any, Self

import numpy as np
import pandas as pd

from trustlab.live.condition import LiveCondition
from trustlab.live.log import sync_folder
from trustlab.live.study.pages import (
    Step,
    StudyPage,
    read_pages,
    read_words,
    steps_of,
    task_pages,
)
from trustlab.live.task import LiveTask, task_named
from trustlab.live.tasks.ground_robot import warn_if_too_short
from trustlab.live.trial import made_by
from trustlab.models.checks import (
    flag,
    list_of,
    of_class,
    one_of,
    shown,
    spawned,
    whole_number,
    whole_seed,
)
from trustlab.models.digest import digest
from trustlab.models.display import Result
from trustlab.models.files import path_of, write_atomically
from trustlab.studies.designs import latin_square_design

FORMAT = 5
PLAN = "study.json"
EVENTS = "events"
EXPERIMENTER, JOIN = ".experimenter", ".join"
"""The names of the experimenter's link and of that for joining; no code has a full stop."""

TOMBSTONE = ".deleted"
"""The suffix of an empty file, which says that a participant was deleted."""


CODE = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,39}")


class DeletedError(ValueError):
    """What is asked for belongs to a participant who was deleted."""


class LiveStudy(Result):
    """
    A within-subject study that people take part in with a browser.

    The plan is frozen at once: the folder gets `study.json` (conditions, everybody's order, pages,
    the package's version), a folder per participant, and beside it a file with their links, which
    others on the machine cannot read. The same call later opens the study again; another plan
    for the same folder is refused.

    Parameters
    ----------
    folder : path-like
        Where the study is kept; made if it is not there.
    conditions : sequence of str or LiveCondition
        At least two conditions of the task; all when not given. Of the ground robot: "C1" to "C5",
        Section 2.4.1.2, and your own. Of teleoperation: the schemes "M", "MI", "MMI", "TMIG" and
        "OMI". Of a team: who chooses the leader, "by_hand", "most_trusted", "hysteresis" or
        "suggested". Participants do not see their names.
    participants : int, sequence of str, or dict
        How many, called P01, P02 …, or their codes (letters, digits, - and _). Codes only: never
        names. Groups between which people differ are a dict of group to either; numbers are dealt
        to groups at random, and each group fills squares of its own.
    seed : int
        Seed of the orders and of every drive.
    pages : path-like or sequence of path-like
        TOML files that change pages, leave some out, or add pages and questionnaires of your own.
    drives : DriveSettings, TeleoperationSettings or LeadingSettings, optional
        The drives' settings, of the task's class: their length, for example.
    task : {"ground_robot", "teleoperation", "team"}
        What people do; the server computes it.
    language : {"en", "de"}
        Language of everything that participants see.
    whole_squares : bool
        Whether to refuse a number of participants that does not fill whole Latin squares.
    rehearsal : bool
        Whether scripted hands drive, on an accelerated clock: for trying the study out. Everything
        is labelled synthetic.
    **settings : object
        Settings of `drives` by name: `laps=4`, for example.

    Raises
    ------
    ValueError
        If an argument is not understood, the participants do not fill whole squares, or the folder
        holds another plan or other files.

    Examples
    --------
    >>> import tempfile
    >>> import trustlab as tl
    >>> folder = tempfile.mkdtemp()
    >>> tl.LiveStudy(f"{folder}/rehearsal", ["C1", "C3"], participants=4, seed=0, rehearsal=True)
    <Live study rehearsal: 4 participants, C1, C3; rehearsal by scripted hands>
    """

    def __init__(
        self,
        folder: str | os.PathLike,
        conditions: Sequence[str | LiveCondition] | None = None,
        participants: int | Sequence[str] | Mapping[str, int | Sequence[str]] = 20,
        seed: int = 0,
        *,
        pages: str | os.PathLike | Sequence[str | os.PathLike] = (),
        task: str = "ground_robot",
        drives: Any = None,
        language: str = "en",
        whole_squares: bool = True,
        rehearsal: bool = False,
        **settings: Any,
    ):
        protocol = task_named(task)
        kind = protocol.settings
        for name in settings:
            one_of("a setting", name, vars(kind()))
        drives = replace(kind() if drives is None else of_class("drives", drives, kind), **settings)
        conditions = (
            protocol.conditions if conditions is None else list_of("conditions", conditions)
        )
        personal = {c.name: asdict(c) for c in conditions if isinstance(c, LiveCondition)}
        if personal and task != "ground_robot":
            raise ValueError(f"a LiveCondition belongs to the ground robot; {task} has its own")
        names = [c.name if isinstance(c, LiveCondition) else c for c in conditions]
        for name in names:
            one_of("condition", name, (*protocol.conditions, *personal))
        groups = _groups(participants, seed)
        orders: dict[str, list[str]] = {}
        for codes in groups.values():
            design = latin_square_design(names, codes, seed, whole_squares=whole_squares)
            orders |= {code: list(order) for code, *order in design.table().itertuples()}
        group_of = {code: group for group, codes in groups.items() for code in codes if group}
        given = pages if isinstance(pages, list | tuple) else [pages]
        files = [*task_pages(task, language), *(path_of("pages", path) for path in given)]
        content: dict = {
            "format": FORMAT,
            "task": task,
            "made_by": made_by(),
            "conditions": names,
            "own_conditions": personal,
            "seed": design.seed,
            "rehearsal": flag("rehearsal", rehearsal),
            **drives.as_json(),
            "orders": dict(sorted(orders.items())) if group_of else orders,
            "groups": group_of,
            "language": language,
            "words": read_words(language),
            "pages": [asdict(page) for page in read_pages(language, files)],
        }
        for page in content["pages"]:
            one_of(f"group of the page {page['name']}", page["group"], ("", *filter(None, groups)))
        # What cannot be driven is refused now.
        for name in (*protocol.practice, *names):
            config = drive_of(content, name)
        if task == "ground_robot":
            warn_if_too_short(config)
        content = json.loads(json.dumps(content))  # as it will be read again
        self._holds(folder, content | {"digest": content_digest(content)})
        self._freeze()

    def _holds(self, folder: str | os.PathLike, content: dict) -> None:
        self.folder, self.content = path_of("folder", folder).absolute(), content
        self.digest: str = content["digest"]  # every file of the study is linked to it
        self.orders: dict[str, list[str]] = content["orders"]
        self.groups: dict[str, str] = content["groups"]
        self.rehearsal: bool = content["rehearsal"]
        self.task: LiveTask = task_named(content["task"])
        self.pages = [StudyPage.read(page) for page in content["pages"]]

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
        plan._holds(folder, read_plan(path_of("folder", folder)))
        return plan

    def _freeze(self) -> None:
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
        if self.folder.is_file():
            raise ValueError(f"{self.folder} is a file; a study needs a folder of its own")
        self.folder.mkdir(parents=True, exist_ok=True)
        if {path.name for path in self.folder.iterdir()} - set(self.orders):
            raise ValueError(
                f"{self.folder} has other files in it; a study needs a folder of its own"
            )
        for code in self.orders:
            (self.folder / code).mkdir(exist_ok=True)
        tokens = {name: secrets.token_urlsafe(16) for name in (EXPERIMENTER, JOIN, *self.orders)}
        write_tokens(self.folder, tokens)
        links_path(self.folder).unlink(missing_ok=True)  # of a study that was removed
        sync_folder(self.folder.parent)
        sync_folder(self.folder)
        write_atomically(self.folder / PLAN, json.dumps(self.content, indent=1) + "\n")
        sync_folder(self.folder)

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

    def delete(self, code: str) -> None:
        """
        Delete a participant: folder, link, and reports made with their data. An empty file keeps
        the count. What was interrupted is finished by another call.

        Parameters
        ----------
        code : str
            The participant.

        Raises
        ------
        ValueError
            If there is no such participant.
        """
        one_of("participant", code, self.orders)
        home, gone = self.folder / code, self.folder / f".{code}.going"
        # First of all: a server that runs meanwhile turns this participant away from now on.
        (self.folder / f"{code}{TOMBSTONE}").touch()
        if home.exists():
            home.rename(gone)  # no row arrives in a folder that is half gone
        sync_folder(self.folder)
        if tokens_path(self.folder).exists():
            tokens = read_tokens(self.folder)
            tokens.pop(code, None)
            write_tokens(self.folder, tokens)
        note_link(self.folder, code, None)
        if gone.exists():
            shutil.rmtree(gone)
        # They show this participant's numbers.
        for report in (*self.folder.glob("report*.html"), *self.folder.glob("report*.zip")):
            report.unlink()
        sync_folder(self.folder)

    def serve(self, port: int = 8765, *, url: str = "", enrol: bool = False) -> None:
        """
        Serve the study to this machine until interrupted (Ctrl-C, or the stop button of a
        notebook).

        The experimenter's link is printed; everybody's links are on that page.

        Parameters
        ----------
        port : int
            Port; 0 for any that is free.
        url : str, optional
            The address of the study for people, "https://study.example.org": that of a proxy which
            ends TLS on this machine and hands requests, WebSockets too, on to `port`.
        enrol : bool
            Whether anybody with the link for joining, on the experimenter's page, takes the next
            free place. The last page of who came so shows a completion code, which the table of
            participants holds.

        Raises
        ------
        ValueError
            If the study is being served already, the port is taken, or the package is not the one
            it was frozen with.
        """
        from trustlab.live.study.server import StudyServer

        with StudyServer(self, port, url=url, enrol=enrol) as server:
            print(f"The experimenter's page: {server.experimenter}\nEnd with Ctrl-C.", flush=True)
            server.wait()

    def rehearse(self, seed: int = 0) -> None:
        """
        Let scripted hands go through the whole study, without browsers: so that files and report
        are seen before people come.

        The hands have a person's limits (trustlab/live/hands.py); answers are drawn at random and
        mean nothing. Everything is labelled synthetic.

        Parameters
        ----------
        seed : int
            Of the answers; that of the drives is the plan's.

        Raises
        ------
        ValueError
            If the plan was not made with rehearsal=True.
        """
        if not self.rehearsal:
            raise ValueError(
                "this study is for people; plan another one with rehearsal=True for scripted hands"
            )
        from trustlab.live.study.participant import Participant, rehearse

        codes = self.present()
        for code, child in zip(codes, spawned(seed, len(codes)), strict=True):
            # A notebook keeps what an interrupted call held: logs must not stay open with it.
            with closing(Participant(self, code, scripted=True)) as participant:
                rehearse(participant, np.random.default_rng(child))

    def table(self) -> pd.DataFrame:
        """Return everybody's order: a row per participant, a column per position."""
        table = pd.DataFrame.from_dict(self.orders, orient="index")
        table.columns = pd.RangeIndex(1, table.shape[1] + 1, name="position")
        return table.rename_axis(index="participant")

    @property
    def title(self) -> str:
        """Which study."""
        return f"Live study {self.folder.name}"

    @property
    def message(self) -> str:
        """How many take part under which conditions, and whether it is a rehearsal."""
        kind = "; rehearsal by scripted hands" if self.rehearsal else ""
        return f"{len(self.orders)} participants, {', '.join(self.content['conditions'])}{kind}"


def _groups(
    participants: int | Sequence[str] | Mapping[str, int | Sequence[str]], seed: int
) -> dict[str, list[str]]:
    """Return the participants' codes by group; one without a name where there are no groups."""
    if not isinstance(participants, Mapping):
        return {"": _codes(participants)}
    if len(participants) < 2 or not all(participants):
        raise ValueError(f"groups must be two or more with names, got {shown(participants)}")
    parts = {group: _codes(value) for group, value in participants.items()}
    codes = [code for part in parts.values() for code in part]
    if all(isinstance(value, Number) for value in participants.values()):
        codes = _codes(len(codes))
        entropy = np.random.SeedSequence(whole_seed(seed), spawn_key=(len(codes),))
        rng = np.random.default_rng(entropy)
        codes = rng.permutation(codes).tolist()
    dealt = iter(_codes(codes))  # refuses those that are the same
    return {group: sorted(next(dealt) for _ in part) for group, part in parts.items()}


def _codes(participants: int | Sequence[str]) -> list[str]:
    """Return the participants' codes: what they are given, or P01, P02 and so on."""
    if isinstance(participants, str | int | Number | None):
        name = "participants, where they are no list of codes,"
        count = whole_number(name, participants, most=999)
        return [f"P{number:02d}" for number in range(1, count + 1)]
    if isinstance(participants, Set):
        raise ValueError(f"participants must be in an order, a list, got {shown(participants)}")
    codes = list_of("participants", participants)
    for code in codes:
        if not isinstance(code, str) or not CODE.fullmatch(code):
            raise ValueError(
                "a participant's code has letters, digits, - and _ only, at most 40, and begins "
                f"with a letter or digit; got {shown(code)}"
            )
    # One folder each, also where names ignore case.
    if len({code.lower() for code in codes}) < len(codes):
        raise ValueError("participants: two codes are the same but for upper and lower case")
    return codes


def drive_of(content: dict, condition: str, seed: int = 0, known: dict | None = None) -> dict:
    """
    Return the settings of a drive of a study with this content, as a log will hold them; a known
    model and thresholds take the place of the stand-in's.
    """
    config = task_named(content["task"]).config(content, condition, seed, known)
    config["late"] = max(config["late"], content["least_delay"])
    if content["rehearsal"]:
        config["clock"] = "accelerated"
    return json.loads(json.dumps(config))


# files
# --------------------------------------------------------------------------------------------------


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
