"""`LiveStudy`: a within-subject study in the browser, planned, rehearsed and served."""

import json
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from trustlab.live.condition import LiveCondition
from trustlab.live.study.drives import drive_of
from trustlab.live.study.pages import read_pages, read_words, task_pages
from trustlab.live.study.participant import Participant
from trustlab.live.study.plan import FORMAT, Plan, content_digest, delete_participant
from trustlab.live.study.rehearsal import rehearse
from trustlab.live.task import task_named
from trustlab.live.tasks.ground_robot import warn_if_too_short
from trustlab.live.trial import made_by
from trustlab.models.checks import flag, of_class, one_of, shown, spawned, whole_number
from trustlab.models.display import as_html
from trustlab.studies.designs import latin_square_design

CODE = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,39}")


class LiveStudy(Plan):
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
    LiveStudy('rehearsal': 4 participants, C1, C3)
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
        drives = replace(kind() if drives is None else of_class("drives", drives, kind), **settings)
        conditions = protocol.conditions if conditions is None else conditions
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
        if isinstance(pages, str | os.PathLike):
            pages = [pages]
        files = [*task_pages(task, language), *map(Path, pages)]
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
            one_of(f"group of the page {page['name']}", page["group"], ("", *groups))
        # What cannot be driven is refused now.
        for name in (*protocol.practice, *names):
            config = drive_of(content, name)
        if task == "ground_robot":
            warn_if_too_short(config)
        content = json.loads(json.dumps(content))  # as it will be read again
        super().__init__(Path(folder).absolute(), content | {"digest": content_digest(content)})
        self.freeze()

    def delete(self, code: str) -> None:
        """
        Delete a participant: folder, link, and reports made with their data. An empty file keeps
        the count.

        Parameters
        ----------
        code : str
            The participant.

        Raises
        ------
        ValueError
            If there is no such participant.
        """
        delete_participant(self.folder, one_of("participant", code, self.orders))

    def serve(
        self,
        address: str = "127.0.0.1",
        port: int = 8765,
        *,
        url: str = "",
        enrol: bool = False,
    ) -> None:
        """
        Serve the study until interrupted (Ctrl-C, or the stop button of a notebook).

        The experimenter's link is printed; everybody's links are on that page.

        Parameters
        ----------
        address : str
            Where to listen; anything but this machine itself needs `url`.
        port : int
            Port; 0 for any that is free.
        url : str, optional
            The address of the study for people, "https://study.example.org": that of a proxy which
            ends TLS and hands requests, WebSockets too, on to `address` and `port`.
        enrol : bool
            Whether anybody with the link for joining, on the experimenter's page, takes the next
            free place. The last page of who came so shows a completion code, which the table of
            participants holds.

        Raises
        ------
        ValueError
            If the address needs a proxy, the study is being served already, or the package is not
            the one it was frozen with.
        """
        from trustlab.live.study.server import StudyServer

        with StudyServer(self, address, port, url=url, enrol=enrol) as server:
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
            Of hands and answers.

        Raises
        ------
        ValueError
            If the plan was not made with rehearsal=True.
        """
        if not self.rehearsal:
            raise ValueError(
                "this study is for people; plan another one with rehearsal=True for scripted hands"
            )
        people = [Participant(self, code) for code in self.present()]
        rehearse(people, spawned(seed, len(people)))

    def table(self) -> pd.DataFrame:
        """Return everybody's order: a row per participant, a column per position."""
        table = pd.DataFrame.from_dict(self.orders, orient="index")
        table.columns = pd.RangeIndex(1, table.shape[1] + 1, name="position")
        return table.rename_axis(index="participant")

    def _repr_html_(self) -> str:
        kind = " Rehearsal by scripted hands." if self.rehearsal else ""
        words = (
            f"{len(self.orders)} participants, seed {self.content['seed']}, task "
            f"{self.content['task']}.{kind}"
        )
        return as_html(words, self.table(), title=f"Live study {self.folder.name}")

    def __repr__(self) -> str:
        return (
            f"LiveStudy({self.folder.name!r}: {len(self.orders)} participants, "
            f"{', '.join(self.content['conditions'])})"
        )


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
    if all(isinstance(value, int) for value in participants.values()):
        codes = _codes(len(codes))
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(len(codes),)))
        codes = rng.permutation(codes).tolist()
    dealt = iter(_codes(codes))  # refuses those that are the same
    return {group: sorted(next(dealt) for _ in part) for group, part in parts.items()}


def _codes(participants: int | Sequence[str]) -> list[str]:
    """Return the participants' codes: what they are given, or P01, P02 and so on."""
    if isinstance(participants, int):
        count = whole_number("participants", participants, most=999)
        return [f"P{number:02d}" for number in range(1, count + 1)]
    codes = list(participants)
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
