"""
One participant of a study: the events that say where they are, and what each request of their page,
and of the experimenter's, does to them.
"""

from __future__ import annotations

import secrets
import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from trustlab.live.fit import identified, stand_in
from trustlab.live.log import Log, LogError
from trustlab.live.study.pages import AnswerError, Item, Step
from trustlab.live.study.plan import (
    EVENTS,
    DeletedError,
    LiveStudy,
    drive_of,
    file_origin,
    is_deleted,
    note_link,
    read_links,
)
from trustlab.live.task import PERIOD, scripted_commands
from trustlab.live.trial import Record, Trial, read_record
from trustlab.sessions.session import Session

HIDDEN = ("condition", "seed", "scheme")
"""What pages are not told of a drive."""

PRIVATE = ("reversed", "expected")
"""What they are not told of an item."""


@dataclass
class Progress:
    """
    What a participant's events add up to.

    Parameters
    ----------
    done : dict of int to dict
        The event that finished each page.
    attempts : dict of int to int
        Number of the current attempt of each drive, from 0.
    model : dict or None
        Model and thresholds from the identification drive, or what stands in for them.
    ended : bool
        Whether the participation was ended.
    withdrawn : bool
        Whether the participant did that.
    completion : str
        The code that the last page shows who came by the link for joining.
    notes : list of dict
        What the experimenter has noted, and torn lines.
    """

    done: dict[int, dict] = field(default_factory=dict)
    attempts: dict[int, int] = field(default_factory=dict)
    model: dict | None = None
    ended: bool = False
    withdrawn: bool = False
    completion: str = ""
    notes: list[dict] = field(default_factory=list)

    def page(self, pages: int) -> int:
        """
        Return the page to show of so many: the first that is not done, and the last one at the end.
        """
        last = pages - 1
        if self.ended:
            return last
        return next((page for page in range(last) if page not in self.done), last)

    def answers(self, page: int) -> dict:
        """Return the answers of a page, if there are any: a damaged line may have lost them."""
        return self.done.get(page, {}).get("answers", {})

    def attempt(self, page: int) -> int:
        """Return the number of the current attempt of a drive."""
        return self.attempts.get(page, 0)


def progress_of(events: Iterable[Mapping]) -> Progress:
    """Return where a participant is, from all that has happened."""
    now = Progress()
    for event in events:
        match event["kind"]:
            case "page":
                now.done[event["page"]] = dict(event)
            case "restart":
                page = event["page"]
                old = now.done.pop(page, {})
                now.attempts[page] = now.attempt(page) + 1
                if old.get("name") == "drive":  # what was said of it is asked again
                    for number, done in [*now.done.items()]:
                        if number > page and done["position"] == old["position"]:
                            del now.done[number]
            case "model":
                now.model = dict(event)
            case "enrol":
                now.completion = event["completion"]
            case "end":
                now.ended = True
                now.withdrawn |= event.get("source") == "participant"
            case "note" | "torn":
                now.notes.append(dict(event))
    return now


class Attempt(NamedTuple):
    """An attempt at a drive of a study, numbered from 0."""

    plan: LiveStudy
    code: str
    step: Step
    number: int

    @property
    def path(self) -> Path:
        """The log."""
        again = f".{self.number + 1}" if self.number else ""
        return self.plan.folder / self.code / f"{self.step.name}{again}.jsonl"

    @property
    def origin(self) -> str:
        """What the log's first line is linked to."""
        return file_origin(self.plan.digest, self.code, self.path.stem)

    @property
    def seed(self) -> int:
        """A child of the study's seed by participant, page and attempt."""
        key = (list(self.plan.orders).index(self.code), self.step.index, self.number)
        child = np.random.SeedSequence(self.plan.content["seed"], spawn_key=key)
        return int(child.generate_state(1)[0])

    def settings(self, model: dict | None) -> dict:
        """Return what determines the drive but for the commands."""
        name = self.step.page.name
        condition = str(self.step.condition) if name == "drive" else name
        return drive_of(self.plan.content, condition, self.seed, model)

    def read(self, link: str | None = None) -> tuple[Record | None, str]:
        """
        Return what the log says, if anything, and what is wrong with it, "" for nothing: its rows
        are compared with a replay, its last link with the one that is known.
        """
        record, last, fault = read_record(self.path, self.origin)
        if record and not fault and (wrong := record.fault(self.plan.task)):
            fault = f"{self.path.name}: {wrong}"
        if not fault and link not in (None, last):
            fault = f"{self.path.name}: it does not end where the drive was finished"
        return record, fault

    def session(self, record: Record, fault: str) -> Session:
        """
        Return the logged rows; their metadata hold the verdict, the log period, pauses, and the
        delay with which pictures were seen.
        """
        config, facts = record.settings, record.facts(fault)
        late = config["late"] + max(config["sample_time"], PERIOD)
        return self.plan.task.session(
            config,
            record.rows,
            **facts,
            seen_late=facts["delay"] > late,
            position=self.step.position,
            page=self.step.index,
            attempt=self.number,
            thresholds_from=record.header["source"],
            participant=self.code,
            synthetic=self.plan.rehearsal,
        )


class RefusedError(AnswerError):
    """A request that came too late."""

    status = 409


class Participant:
    """
    A participant in a study that is being served or rehearsed.

    The folder has the events, which are all there is to know, and a log per drive. If they are
    `scripted`, a scripted person's commands take the place of those that come.
    """

    def __init__(self, plan: LiveStudy, code: str, scripted: bool = False):
        self.plan, self.code = plan, code
        self.scripted = scripted
        self.folder = plan.folder / code
        self.steps = plan.steps(code)
        self.folder.mkdir(exist_ok=True)  # some copies leave empty folders out
        self.log = Log(self.folder / f"{EVENTS}.jsonl", file_origin(plan.digest, code, EVENTS))
        known = read_links(plan.folder).get(code)
        if known not in (None, *self.log.links):
            # Another event would be noted in place of the last one, and nobody could see the loss.
            self.log.close()
            raise LogError(
                f"{self.log.path}: its last lines are missing; restore it from a copy, or delete "
                f"{code}"
            )
        self.events: list[dict] = self.log.entries
        self.trial: Trial | None = None
        self.script: list[list[float]] = []
        self.last_request: float | None = None
        self._note_torn(self.log)

    def close(self) -> None:
        """Let another process write."""
        self.log.close()
        if self.trial is not None:
            self.trial.log.close()

    def add(self, kind: str, **facts: Any) -> None:
        """Append an event; it is on the disk when this returns."""
        if is_deleted(self.plan.folder, self.code):
            raise DeletedError(f"participant {self.code} was deleted")
        event = {"at": round(time.time(), 3), "kind": kind, **facts}
        self.log.append([event])
        self.events.append(event)
        note_link(self.plan.folder, self.code, self.log.link)

    def _note_torn(self, log: Log) -> None:
        if log.torn:
            self.add("torn", file=log.path.name, bytes=log.torn)

    def _add_done(self, step: Step, **facts: Any) -> None:
        """Append that a page is done."""
        place = {"condition": step.condition, "position": step.position}
        self.add("page", page=step.index, name=step.page.name, **facts, **place)

    @property
    def progress(self) -> Progress:
        """Where the participant is: nothing but the events decides."""
        return progress_of(self.events)

    @property
    def step(self) -> Step:
        """The page to show."""
        return self.steps[self.progress.page(len(self.steps))]

    def attempt(self, step: Step) -> Attempt:
        """Return the current attempt at a drive."""
        return Attempt(self.plan, self.code, step, self.progress.attempt(step.index))

    # the page's
    # ----------------------------------------------------------------------------------------------

    def state(self, body: Any = None) -> dict:
        """Return the page to show; no word of it names a condition."""
        self.last_request = time.time()
        self._identify()
        progress, step = self.progress, self.step
        shown = {name: getattr(step.page, name) for name in ("kind", "title", "text")}
        if progress.withdrawn:
            words = self.plan.content["words"]
            shown |= {"title": words["withdrawn_title"], "text": words["withdrawn"]}
        return {
            "code": self.code,
            "page": step.index,
            "pages": len(self.steps) - 1,
            "rehearsal": self.plan.rehearsal,
            **shown,
            "completion": progress.completion if step.page.kind == "end" else "",
            "items": [
                {name: value for name, value in vars(item).items() if name not in PRIVATE}
                for item in step.page.items
            ],
        }

    def answers(self, body: dict) -> dict:
        """Take the answers to a form."""
        step = self.step
        if body.get("page") != step.index or step.page.kind != "form":
            raise RefusedError("this page is done")
        answers = step.page.check(body.get("answers"))
        self._add_done(step, answers=answers)
        return self.state()

    def withdraw(self, body: dict) -> dict:
        """End the participation at the participant's own wish: before it begins, or later."""
        self._end("participant")
        return self.state()

    def drive(self, message: dict) -> dict:
        """Answer a message of a page that drives; see `Trial.take`."""
        self.last_request = time.time()
        step = self.step
        # What this window drove is over, or was begun again.
        over = self.trial is None and "begin" not in message
        if over or step.page.kind != "drive" or message.get("page") != step.index:
            return {"done": True}
        attempt = self.attempt(step)
        trial = self._trial(attempt)
        if self.scripted and isinstance(message.get("commands"), list):
            k = len(trial.rows)
            late = trial.settings["late"] / trial.settings["sample_time"]
            commands = self.script[k : k + len(message["commands"])]
            message = message | {"k": k, "commands": commands, "seen": max(k - late, 0.0)}
        answer = trial.take(message)
        if "begin" in message:
            shown = {k: x for k, x in trial.settings.items() if k not in HIDDEN}
            shown |= {"attempt": attempt.number, "words": self.plan.content["words"]}
            answer["config"] = shown
        if trial.done:
            self._add_done(step, attempt=attempt.number, rows=len(trial.rows), link=trial.log.link)
            self.trial = None
        return answer

    def _trial(self, attempt: Attempt) -> Trial:
        """Return the run of an attempt at a drive, begun where it was not."""
        if self.trial is None or self.trial.log.path != attempt.path:
            model = self.progress.model
            settings = attempt.settings(model)
            source = (model or stand_in(self.plan.content))["source"]
            trial = Trial(attempt.path, self.plan.task, settings, attempt.origin, source=source)
            if not trial.record.commands:
                self.add("begin", page=attempt.step.index, attempt=attempt.number)
            self._note_torn(trial.log)
            self.trial = trial  # only now: what could not be told of is begun again
            if self.scripted:
                rng = np.random.default_rng([attempt.seed, 1])  # not the noise of the robot
                hand = trial.task.hand(trial.settings, rng)
                self.script, _ = scripted_commands(trial.task, trial.settings, hand)
        return self.trial

    def _identify(self) -> None:
        """Identify the participant's model from a drive that is done for that."""
        progress = self.progress
        for step in self.steps:
            if step.page.name != "identification" or step.index not in progress.done:
                continue
            attempt = self.attempt(step)
            if (progress.model or {}).get("attempt") == attempt.number:
                continue
            record, fault = attempt.read()
            try:
                if record is None:
                    raise ValueError(fault)
                model = identified(self.plan.content, attempt.session(record, fault))
            except ValueError:  # everybody must go on
                model = stand_in(self.plan.content, "the drive cannot be read")
            self.add("model", page=step.index, attempt=attempt.number, **model)

    def _end(self, source: str) -> None:
        if self.step.page.kind != "end":
            self.add("end", source=source, page=self.step.index)
        self._finish("the participation ended")

    def _finish(self, why: str) -> None:
        """End the run of a drive, if there is one."""
        if self.trial is not None:
            self.trial.finish(why)
            self.trial = None

    def enrol(self, body: dict) -> bool:
        """Take this place for somebody who came by the link for joining, if it is free."""
        if self.events or self.last_request is not None:  # who reads the first page is no event
            return False
        self.add("enrol", completion=secrets.token_hex(4))
        return True

    # the experimenter's
    # ----------------------------------------------------------------------------------------------

    def _begun(self) -> list[Attempt]:
        """Return the current attempt of each drive that was begun and can be begun again."""
        if self.progress.ended:
            return []
        drives = [self.attempt(step) for step in self.steps if step.page.kind == "drive"]
        return [attempt for attempt in drives if attempt.path.exists()]

    def experimenter_restart(self, body: dict) -> None:
        """Let a drive be driven again; what was driven stays where it is."""
        page = body.get("page")
        attempt = next((each for each in self._begun() if each.step.index == page), None)
        if attempt is None:
            raise AnswerError("this page is no drive that can be begun again")
        # First of all: a drive that is over and not begun again would count.
        self.add("restart", page=attempt.step.index, attempt=attempt.number)
        if self.trial is not None and self.trial.log.path == attempt.path:
            self._finish("the experimenter let it be driven again")

    def experimenter_note(self, body: dict) -> None:
        """Add a note of the experimenter's."""
        Item("note", "Note", "text", required=True).check(body.get("text"))
        self.add("note", page=self.step.index, text=body["text"])

    def experimenter_end(self, body: dict) -> None:
        """End the participation: the page shows the debriefing."""
        self._end("experimenter")

    def overview(self) -> dict:
        """Return what the experimenter sees of this participant."""
        progress, step = self.progress, self.step
        trial = self.trial
        model = progress.model or {}
        ago = None if self.last_request is None else round(time.time() - self.last_request, 1)
        return {
            "code": self.code,
            "order": self.plan.orders[self.code],
            "page": step.index,
            "pages": len(self.steps) - 1,  # the last step is the end, where nothing is done
            "title": step.page.title,
            "condition": step.condition,
            "rows": None if trial is None else len(trial.rows),
            "seconds_ago": ago,
            "ended": progress.ended,
            "withdrawn": progress.withdrawn,
            "model": model.get("source", ""),
            "why": model.get("why", ""),
            "drives": [
                {"page": each.step.index, "title": each.step.page.title} for each in self._begun()
            ],
            "notes": progress.notes[-5:],
            "pauses": 0 if trial is None else len(trial.record.pauses),
            "delay": trial.record.delays[-1] if trial and trial.record.delays else None,
        }


SENT_AT_ONCE = 600


def rehearse(participant: Participant, rng: np.random.Generator) -> None:
    """
    Go with a scripted participant from where they are to the end, as their page would, without a
    browser.
    """
    while (now := participant.state())["kind"] != "end":
        about = {"page": now["page"], "window": "rehearsal"}
        if now["kind"] == "form":
            items = participant.step.page.items
            participant.answers(about | {"answers": {i.name: _answer(i, rng) for i in items}})
            continue
        participant.drive(about | {"begin": True})
        while not participant.drive(about | {"commands": [None] * SENT_AT_ONCE})["done"]:
            pass


def _answer(item: Item, rng: np.random.Generator) -> Any:
    """Return an answer drawn from all that are allowed: it means nothing."""
    if item.kind == "scale":
        return int(rng.choice(np.arange(item.low, item.high + 1, item.step)))
    if item.kind == "choice":
        return item.choices[rng.integers(len(item.choices))]
    if item.kind == "check":
        return True
    return "words" if item.required else ""
