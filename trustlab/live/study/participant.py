"""
One participant of a study: the events that say where they are, and what each request of their page,
and of the experimenter's, does to them.
"""

from __future__ import annotations

import json
import secrets
import threading
import time
from collections.abc import Mapping
from functools import cached_property
from typing import Any

import numpy as np

from trustlab.live.log import Log
from trustlab.live.study.drives import (
    drive_settings,
    identified,
    item_order,
    log_path,
    planned_minutes,
    read_drive,
    session_of_drive,
    stand_in,
)
from trustlab.live.study.pages import LONGEST_ANSWER, AnswerError, Step, storable
from trustlab.live.study.plan import EVENTS, DeletedError, Plan, file_origin, note_link
from trustlab.live.study.progress import Progress, progress_of
from trustlab.live.task import is_number, task_of
from trustlab.live.trial import Trial

MOST_NOTES = 500
"""Notes of one participant."""

HIDDEN = ("condition", "seed", "scheme")
"""What pages are not told of a drive."""


class RefusedError(ValueError):
    """A request that came too late; `facts` tell the page what holds."""

    def __init__(self, why: str, **facts: Any):
        super().__init__(why)
        self.facts = facts


def _whole(body: Mapping[str, Any], name: str, most: int = 10**6) -> int:
    value = body.get(name)
    if type(value) is not int or not 0 <= value <= most:
        raise AnswerError(f"{name} must be a whole number")
    return value


def _words(body: Mapping[str, Any], name: str, most: int = LONGEST_ANSWER) -> str:
    value = body.get(name)
    if not isinstance(value, str) or not value.strip() or len(value) > most or not storable(value):
        raise AnswerError(f"{name} must be text of at most {most} characters")
    return value


class Participant:
    """
    A participant in a study that is being served or rehearsed.

    The folder has the events, which are all there is to know, and a log per drive. Everything that
    changes them waits for `lock`. If they are `scripted`, a scripted person's commands take the
    place of those that their page sends.
    """

    def __init__(self, plan: Plan, code: str, scripted: bool = False):
        self.plan, self.code = plan, code
        self.folder = plan.folder / code
        self.steps = plan.steps(code)
        if not self.folder.is_dir():
            raise DeletedError(f"participant {code} has no folder any more")
        self.log = Log(self.folder / f"{EVENTS}.jsonl", file_origin(plan.digest, code, EVENTS))
        self.events: list[dict[str, Any]] = self.log.entries
        self.lock = threading.RLock()
        self.trial: Trial | None = None
        self.scripted = scripted
        self.hand: Any = None
        self.last_request: float | None = None
        self.telemetry: dict[str, float] = {}
        if self.log.torn:
            self.add("torn", file=self.log.path.name, bytes=self.log.torn)

    def close(self) -> None:
        """Let another process write."""
        self.log.close()
        if self.trial is not None:
            self.trial.log.close()

    def add(self, kind: str, **facts: Any) -> None:
        """Append an event; it is on the disk when this returns."""
        if not self.folder.is_dir():
            raise DeletedError(f"participant {self.code} has no folder any more")
        event = {"at": round(time.time(), 3), "kind": kind, **facts}
        self.log.append([event])
        self.events.append(event)
        note_link(self.plan.folder, self.code, self.log.link)

    @cached_property
    def minutes(self) -> int:
        """How long the participation takes [min]."""
        return planned_minutes(self.plan)

    @property
    def progress(self) -> Progress:
        """Where the participant is: nothing but the events decides."""
        return progress_of(self.events)

    @property
    def step(self) -> Step:
        """The page to show."""
        return self.steps[self.progress.page(len(self.steps))]

    def state(self) -> dict[str, Any]:
        """Return the page to show; no word of it names a condition."""
        with self.lock:
            self._identify()
            return self._state()

    def _state(self) -> dict[str, Any]:
        self.last_request = time.time()
        progress, step = self.progress, self.step
        page, content = step.page, self.plan.content
        items = [
            {key: value for key, value in vars(item).items() if key not in ("reversed", "expected")}
            for item in item_order(self.plan, self.code, step)
        ]
        names = ("kind", "title", "text", "picture", "seconds")
        words = {name: getattr(page, name) for name in names} | {"items": items}
        if page.kind == "end" and progress.completion:
            words["completion"] = progress.completion
        if progress.withdrawn:
            messages = content["words"]
            words |= {"title": messages["withdrawn_title"], "text": messages["withdrawn"]}
        return {
            "code": self.code,
            "page": step.index,
            "pages": len(self.steps) - 1,
            "rehearsal": self.plan.rehearsal,
            "language": content["language"],
            "words": content["words"],
            "minutes": self.minutes,
            **words,
        }

    def answers(self, body: Mapping[str, Any]) -> dict[str, Any]:
        """Take the answers to a form."""
        with self.lock:
            step = self.step
            if _whole(body, "page") != step.index or step.page.kind != "form":
                raise RefusedError("this page is done", page=step.index)
            answers = step.page.check(body.get("answers"), late=body.get("late") is True)
            facts = {"condition": step.condition, "position": step.position, "answers": answers}
            self.add("page", page=step.index, name=step.page.name, **facts)
            return self._state()

    def drive(self, message: Mapping[str, Any]) -> dict[str, Any]:
        """Answer a message of a page that drives; see `Trial.take`."""
        with self.lock:
            self.last_request = time.time()
            step = self.step
            if step.page.kind != "drive" or message.get("page") != step.index:
                return {"done": True}
            if "begin" not in message and self.trial is None:
                return {"done": True}  # what this window drove is over, or was begun again
            trial = self._trial(step)
            if self.scripted and message.get("commands"):
                command = [float(value) for value in self.hand(trial.run.picture())]
                message = {**message, "commands": [command]}
            answer = trial.take(message)
            if isinstance(message.get("telemetry"), dict):
                numbers = list(message["telemetry"].items())[:10]
                self.telemetry = {str(k)[:20]: float(x) for k, x in numbers if is_number(x)}
            if "begin" in message:
                shown = {k: x for k, x in trial.settings.items() if k not in HIDDEN}
                answer["config"] = shown | {"words": self.plan.content["words"]}
            if trial.done:
                self._finish(step, trial)
            return answer

    def _trial(self, step: Step) -> Trial:
        """Return the drive of a page, begun where it was not."""
        attempt = self.progress.attempt(step.index)
        path = log_path(self.folder, step, attempt)
        if self.trial is None or self.trial.log.path != path:
            facts = drive_settings(self.plan, self.code, step, attempt, self.progress.model)
            config = facts.pop("config")
            origin = file_origin(self.plan.digest, self.code, path.stem)
            trial = Trial(path, task_of(config), json.loads(json.dumps(config)), origin, **facts)
            if not trial.record.commands:
                self.add("begin", page=step.index, attempt=attempt)
            if trial.log.torn:
                self.add("torn", file=path.name, bytes=trial.log.torn)
            self.trial = trial
            rng = np.random.default_rng(trial.settings["seed"])
            self.hand = trial.task.hand(trial.settings, rng)
        return self.trial

    def _finish(self, step: Step, trial: Trial) -> None:
        """Note that a drive is at its end."""
        facts = {"condition": step.condition, "position": step.position, "link": trial.log.link}
        attempt = self.progress.attempt(step.index)
        rows = len(trial.rows)
        self.add("page", page=step.index, name=step.page.name, attempt=attempt, rows=rows, **facts)
        self.trial = None

    def _identify(self) -> None:
        """Identify the participant's model from a drive that is done for that."""
        progress = self.progress
        for step in self.steps:
            if step.page.name == "identification" and step.index in progress.done:
                attempt = progress.attempt(step.index)
                if (progress.model or {}).get("attempt") != attempt:
                    try:
                        drive = read_drive(self.plan, self.code, step, attempt)
                        session = session_of_drive(self.plan, self.code, step, attempt, drive)
                        model = identified(self.plan, session)
                    except ValueError as error:  # everybody must go on
                        model = stand_in(self.plan, "the drive cannot be read", str(error))
                    self.add("model", page=step.index, attempt=attempt, **model)

    def withdraw(self, body: Mapping[str, Any]) -> dict[str, Any]:
        """End the participation at the participant's own wish: before it begins, or later."""
        with self.lock:
            if not self.progress.ended:
                self._end("participant")
            return self._state()

    def _end(self, source: str) -> None:
        if self.trial is not None:
            self.trial.finish("the participation ended")
        self.add("end", source=source, page=self.step.index)

    def enrol(self) -> bool:
        """Take this place for somebody who came by the link for joining, if it is free."""
        with self.lock:
            if self.events:
                return False
            self.add("enrol", completion=secrets.token_hex(4))
            return True

    # the experimenter's
    # ----------------------------------------------------------------------------------------------

    def experimenter_restart(self, body: Mapping[str, Any]) -> None:
        """Let a drive be driven again; what was driven stays where it is."""
        with self.lock:
            page = _whole(body, "page", len(self.steps) - 1)
            step, attempt = self.steps[page], self.progress.attempt(page)
            if step.page.kind != "drive" or not log_path(self.folder, step, attempt).exists():
                raise AnswerError(f"page {page} is no drive that was begun")
            if self.trial is not None and self.step.index == page:
                self.trial.finish("the experimenter let it be driven again")
                self.trial = None
            self.add("restart", page=page, attempt=attempt)

    def experimenter_note(self, body: Mapping[str, Any]) -> None:
        """Add a note of the experimenter's."""
        with self.lock:
            if len(self.progress.notes) < MOST_NOTES:
                self.add("note", page=self.step.index, text=_words(body, "text"))

    def experimenter_end(self, body: Mapping[str, Any]) -> None:
        """End the participation: the page shows the debriefing."""
        with self.lock:
            self._end("experimenter")

    def overview(self) -> dict[str, Any]:
        """Return what the experimenter sees of this participant."""
        progress, step = self.progress, self.step
        trial = self.trial
        begun = [
            s
            for s in self.steps
            if s.page.kind == "drive"
            and (s.index in progress.done or (trial is not None and s.index == step.index))
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
            "telemetry": {} if trial is None else self.telemetry,
            "model": model.get("source", ""),
            "why": model.get("why", ""),
            "drives": [{"page": s.index, "title": s.page.title} for s in begun],
            "notes": progress.notes[-5:],
            "pauses": 0 if trial is None else len(trial.record.pauses),
        }
