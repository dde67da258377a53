"""
One participant of a study: the events that say where they are, and what each request of their page,
and of the experimenter's, does to them.
"""

from __future__ import annotations

import secrets
import time
from typing import Any

import numpy as np

from trustlab.live.log import Log, LogError
from trustlab.live.study.drives import Attempt, identified, stand_in
from trustlab.live.study.pages import AnswerError, Item, Step
from trustlab.live.study.plan import (
    EVENTS,
    DeletedError,
    Plan,
    file_origin,
    is_deleted,
    note_link,
    read_links,
)
from trustlab.live.study.progress import Progress, progress_of
from trustlab.live.trial import Trial

HIDDEN = ("condition", "seed", "scheme")
"""What pages are not told of a drive."""

PRIVATE = ("reversed", "expected")
"""What they are not told of an item."""


class RefusedError(AnswerError):
    """A request that came too late."""

    status = 409


class Participant:
    """
    A participant in a study that is being served or rehearsed.

    The folder has the events, which are all there is to know, and a log per drive. If they are
    `scripted`, a scripted person's commands take the place of those that their page sends.
    """

    def __init__(self, plan: Plan, code: str, scripted: bool = False):
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
        self.hand: Any = None
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
        content = self.plan.content
        shown = {name: getattr(step.page, name) for name in ("kind", "title", "text")}
        if progress.withdrawn:
            words = content["words"]
            shown |= {"title": words["withdrawn_title"], "text": words["withdrawn"]}
        return {
            "code": self.code,
            "page": step.index,
            "pages": len(self.steps) - 1,
            "rehearsal": self.plan.rehearsal,
            "language": content["language"],
            "words": content["words"],
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
        if not self.progress.ended:
            self._end("participant")
        return self.state()

    def drive(self, message: dict) -> dict:
        """Answer a message of a page that drives; see `Trial.take`."""
        self.last_request = time.time()
        step = self.step
        if step.page.kind != "drive" or message.get("page") != step.index:
            return {"done": True}
        if "begin" not in message and self.trial is None:
            return {"done": True}  # what this window drove is over, or was begun again
        attempt = self.attempt(step)
        trial = self._trial(attempt)
        if self.scripted and message.get("commands"):
            command = [float(value) for value in self.hand(trial.run.picture())]
            message = {**message, "commands": [command]}
        answer = trial.take(message)
        if "begin" in message:
            shown = {k: x for k, x in trial.settings.items() if k not in HIDDEN}
            answer["config"] = shown | {"words": self.plan.content["words"]}
        if trial.done:
            self._add_done(step, attempt=attempt.number, rows=len(trial.rows), link=trial.log.link)
            self.trial = None
        return answer

    def _trial(self, attempt: Attempt) -> Trial:
        """Return the run of an attempt at a drive, begun where it was not."""
        if self.trial is None or self.trial.log.path != attempt.path:
            config, facts = attempt.settings(self.progress.model)
            trial = Trial(attempt.path, self.plan.task, config, attempt.origin, **facts)
            if not trial.record.commands:
                self.add("begin", page=attempt.step.index, attempt=attempt.number)
            self._note_torn(trial.log)
            self.trial = trial  # only now: what could not be told of is begun again
            rng = np.random.default_rng(trial.settings["seed"])
            self.hand = self.plan.task.hand(trial.settings, rng)
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
                model = identified(self.plan, attempt.session(record, fault))
            except ValueError:  # everybody must go on
                model = stand_in(self.plan, "the drive cannot be read")
            self.add("model", page=step.index, attempt=attempt.number, **model)

    def _end(self, source: str) -> None:
        self.add("end", source=source, page=self.step.index)
        if self.trial is not None:
            self.trial.finish("the participation ended")

    def enrol(self, body: dict) -> bool:
        """Take this place for somebody who came by the link for joining, if it is free."""
        if self.events:
            return False
        self.add("enrol", completion=secrets.token_hex(4))
        return True

    # the experimenter's
    # ----------------------------------------------------------------------------------------------

    def _begun(self) -> list[Attempt]:
        """Return the current attempt of each drive that was begun."""
        drives = [self.attempt(step) for step in self.steps if step.page.kind == "drive"]
        return [attempt for attempt in drives if attempt.path.exists()]

    def experimenter_restart(self, body: dict) -> None:
        """Let a drive be driven again; what was driven stays where it is."""
        page = body.get("page")
        attempt = next((each for each in self._begun() if each.step.index == page), None)
        if attempt is None:
            raise AnswerError("this page is no drive that was begun")
        # First of all: a drive that is over and not begun again would count.
        self.add("restart", page=attempt.step.index, attempt=attempt.number)
        if self.trial is not None and self.trial.log.path == attempt.path:
            self.trial.finish("the experimenter let it be driven again")
            self.trial = None

    def experimenter_note(self, body: dict) -> None:
        """Add a note of the experimenter's."""
        Item("note", "", "text", required=True).check(body.get("text"))
        self.add("note", page=self.step.index, text=body["text"])

    def experimenter_end(self, body: dict) -> None:
        """End the participation: the page shows the debriefing."""
        self._end("experimenter")

    def overview(self) -> dict:
        """Return what the experimenter sees of this participant."""
        progress, step = self.progress, self.step
        trial = self.trial
        drives = [
            {"page": each.step.index, "title": each.step.page.title} for each in self._begun()
        ]
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
            "drives": drives,
            "notes": progress.notes[-5:],
            "pauses": 0 if trial is None else len(trial.record.pauses),
            "delay": trial.record.delays[-1] if trial and trial.record.delays else None,
        }
