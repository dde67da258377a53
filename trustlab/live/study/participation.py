"""
One participant's way through a study: what each request of their page, and of the experimenter's,
does to it.
"""

from __future__ import annotations

import secrets
import time
from functools import cached_property
from typing import Any

from trustlab.live.rows import check_row, is_number
from trustlab.live.study.drives import (
    attempt_name,
    drive_settings,
    identified,
    item_order,
    planned_minutes,
    session_of_attempt,
    shown_config,
)
from trustlab.live.study.pages import LONGEST_ANSWER, AnswerError, Step
from trustlab.live.study.plan import Plan
from trustlab.live.study.progress import Progress, progress_of
from trustlab.live.tasks.task import ServedRun, task_of
from trustlab.models.digest import digest
from trustlab.sessions.errors import SessionError
from trustlab.sessions.writing import write_session

MOST_NOTES = 500
"""Notes of one participant."""


class RefusedError(ValueError):
    """
    A request that came too late, or from a window that no longer drives; `facts` tell the page what
    holds.
    """

    def __init__(self, why: str, **facts: Any):
        super().__init__(why)
        self.facts = facts


def _whole(body: dict[str, Any], name: str, most: int = 10**6) -> int:
    value = body.get(name)
    if type(value) is not int or not 0 <= value <= most:
        raise AnswerError(f"{name} must be a whole number")
    return value


def _words(body: dict[str, Any], name: str, most: int = LONGEST_ANSWER) -> str:
    value = body.get(name)
    if not isinstance(value, str) or not value.strip() or len(value) > most or "\0" in value:
        raise AnswerError(f"{name} must be text of at most {most} characters")
    return value


class Participation:
    """A participant in a study that is being served."""

    def __init__(self, plan: Plan, code: str):
        self.plan, self.code = plan, code
        self.participant = plan.participant(code)
        self.steps = plan.steps(code)
        self.configs: dict[str, dict[str, Any]] = {}
        self.runs: dict[str, ServedRun] = {}
        self.last_request: float | None = None
        self.telemetry: dict[str, float] = {}

    @cached_property
    def minutes(self) -> int:
        """How long the participation takes [min]."""
        return planned_minutes(self.plan)

    @property
    def progress(self) -> Progress:
        """Where the participant is: nothing but the events decides."""
        return progress_of(self.participant.events)

    def state(self) -> dict[str, Any]:
        """Return the page to show; no word of it names a condition."""
        self.last_request = time.time()
        page = self.progress.page(len(self.steps))
        shown = self.steps[page].page
        items = [
            {key: value for key, value in vars(item).items() if key not in ("reversed", "expected")}
            for item in item_order(self.plan, self.code, self.steps[page])
        ]
        names = ("kind", "title", "text", "picture", "seconds")
        words = {name: getattr(shown, name) for name in names} | {"items": items}
        if shown.kind == "end" and self.progress.completion:
            words["completion"] = self.progress.completion
        if self.progress.withdrawn:
            messages = self.plan.content["words"]
            words |= {"title": messages["withdrawn_title"], "text": messages["withdrawn"]}
        return {
            "code": self.code,
            "page": page,
            "pages": len(self.steps) - 1,
            "rehearsal": self.plan.rehearsal,
            "language": self.plan.content["language"],
            "words": self.plan.content["words"],
            "minutes": self.minutes,
            **words,
        }

    def _current(self, body: dict[str, Any], kind: str) -> tuple[Progress, Step]:
        """
        Return the page that a request is about, if it is the one to be shown: else another window,
        or a second click, was there.
        """
        progress = self.progress
        page = progress.page(len(self.steps))
        if _whole(body, "page") != page or self.steps[page].page.kind != kind:
            raise RefusedError("this page is done", page=page)
        return progress, self.steps[page]

    def answers(self, body: dict[str, Any]) -> dict[str, Any]:
        """Take the answers to a form."""
        _, step = self._current(body, "form")
        answers = step.page.check(body.get("answers"), late=body.get("late") is True)
        facts = {"condition": step.condition, "position": step.position}
        self.participant.add("page", page=step.index, name=step.page.name, answers=answers, **facts)
        return self.state()

    def begin(self, body: dict[str, Any]) -> dict[str, Any]:
        """Begin a drive, or go on with it: this window drives from now on, and no other."""
        progress, step = self._current(body, "drive")
        tab = _words(body, "tab", 40)
        attempt = progress.attempt(step.index)
        name = attempt_name(step, attempt)
        header = self.participant.header(name)
        if header is None:
            header = drive_settings(self.plan, self.code, step, attempt, progress.model)
            self.participant.open_attempt(name, header)
        rows = self.participant.rows(name)
        self.runs.clear()  # a cached run may hold rows that never reached the disk
        facts = {"rows": len(rows), "link": self.participant.link(name)}
        self.participant.add("begin", page=step.index, attempt=attempt, tab=tab, **facts)
        return {
            "attempt": attempt,
            "config": shown_config(self.plan, header["config"]),
            "memory": task_of(header["config"]).memory(header["config"]),
            "rows": [values for _, _, *values in rows],
        }

    def _attempt(self, body: dict[str, Any]) -> tuple[Progress, Step, int, str]:
        """Return the attempt that a request of a driving window is about."""
        page, attempt = _whole(body, "page", len(self.steps) - 1), _whole(body, "attempt")
        progress, step = self.progress, self.steps[page]
        if progress.tabs.get((page, attempt)) != _words(body, "tab", 40):
            raise RefusedError("another window drives", window=True)
        return progress, step, attempt, attempt_name(step, attempt)

    def rows(self, body: dict[str, Any]) -> dict[str, Any]:
        """Take rows of a drive; also those of an attempt that was restarted meanwhile."""
        self.last_request = time.time()
        progress, step, attempt, name = self._attempt(body)
        rows = self._checked(name, body.get("rows"))
        have = self.participant.count(name)
        if step.index in progress.done and progress.attempt(step.index) == attempt:
            if any(number >= have for number, *_ in rows):
                raise RefusedError("this drive is over", page=progress.page(len(self.steps)))
            return {"have": have, "current": False}
        picture = {}
        if self.configs[name].get("served"):
            run = self._run(name)
            rows = run.complete(rows)
            picture = {"picture": run.picture()}
        have = self.participant.take(name, rows)
        self.telemetry = _numbers(body.get("telemetry"))
        current = (
            progress.page(len(self.steps)) == step.index and progress.attempt(step.index) == attempt
        )
        return {"have": have, "current": current, **picture}

    def _run(self, name: str) -> ServedRun:
        """Return the run that is computed here, behind the rows that are kept."""
        if name not in self.runs:
            self.runs[name] = ServedRun(self.configs[name], self.participant.rows(name))
        return self.runs[name]

    def _checked(self, name: str, rows: Any) -> list[list[float]]:
        """Return rows that a drive may have: a number, a time in ms, and each column's value."""
        if not isinstance(rows, list):
            raise AnswerError("rows must be a list")
        if name not in self.configs:
            self.configs[name] = (self.participant.header(name) or {})["config"]
        try:
            for row in rows:
                check_row(self.configs[name], row)
        except ValueError as error:
            raise AnswerError(str(error)) from None
        return rows

    def note(self, body: dict[str, Any]) -> dict[str, Any]:
        """Take a note of the page: a pause, the focus lost."""
        _, step, attempt, _ = self._attempt(body)
        if len(self.progress.notes) < MOST_NOTES:
            row = _whole(body, "row")
            self.participant.add(
                "note",
                source="page",
                page=step.index,
                attempt=attempt,
                row=row,
                text=_words(body, "text", 200),
            )
        return {}

    def done(self, body: dict[str, Any]) -> dict[str, Any]:
        """Finish a drive: all its rows are here; they become a session, replayed and verified."""
        progress, step = self._current(body, "drive")
        _, _, attempt, name = self._attempt(body)
        if attempt != progress.attempt(step.index):
            raise RefusedError("this drive was begun again", page=step.index)
        have = self.participant.count(name)
        if have < 2 or have != _whole(body, "rows"):
            raise RefusedError("rows are missing", have=have)
        notes = [
            note
            for note in progress.notes
            if note.get("page") == step.index and note.get("attempt") == attempt
        ]
        session = session_of_attempt(self.plan, self.code, step, attempt, notes)
        config = self.participant.header(name)["config"]
        if not task_of(config).at_end(config, session):
            raise RefusedError("this drive is not at its end", have=have)
        table = self.participant.folder / f"{name}.csv"
        try:
            write_session(session, table)
        except SessionError as error:
            raise error.__cause__ or error from None
        if step.page.name == "identification":
            self.participant.add(
                "model", page=step.index, attempt=attempt, **identified(self.plan, session)
            )
        facts = {
            "condition": step.condition,
            "position": step.position,
            "verified": session.metadata.more["verified"],
            "telemetry": _numbers(body.get("telemetry")),
            "link": self.participant.link(name),
            "csv": digest(table.read_bytes()),
        }
        self.participant.add(
            "page", page=step.index, name=step.page.name, attempt=attempt, rows=have, **facts
        )
        self.runs.clear()
        return self.state()

    def withdraw(self, body: dict[str, Any]) -> dict[str, Any]:
        """End the participation at the participant's own wish: before it begins, or later."""
        if not self.progress.ended:
            page = self.progress.page(len(self.steps))
            self.participant.add("end", source="participant", page=page)
        return self.state()

    def enrol(self) -> bool:
        """Take this place for somebody who came by the link for joining, if it is free."""
        if self.participant.events:
            return False
        self.participant.add("enrol", completion=secrets.token_hex(4))
        return True

    # the experimenter's
    # ----------------------------------------------------------------------------------------------

    def experimenter_restart(self, body: dict[str, Any]) -> None:
        """Let a drive be driven again; what was driven stays where it is."""
        page = _whole(body, "page", len(self.steps) - 1)
        step, progress = self.steps[page], self.progress
        name = attempt_name(step, progress.attempt(page))
        if step.page.kind != "drive" or self.participant.header(name) is None:
            raise AnswerError(f"page {page} is no drive that was begun")
        self.participant.add(
            "restart",
            page=page,
            attempt=progress.attempt(page),
            link=self.participant.link(name),
        )

    def experimenter_note(self, body: dict[str, Any]) -> None:
        """Add a note of the experimenter's."""
        self.participant.add(
            "note",
            source="experimenter",
            page=self.progress.page(len(self.steps)),
            text=_words(body, "text"),
        )

    def experimenter_end(self, body: dict[str, Any]) -> None:
        """End the participation: the page shows the debriefing."""
        self.participant.add("end")

    def overview(self) -> dict[str, Any]:
        """Return what the experimenter sees of this participant."""
        progress = self.progress
        page = progress.page(len(self.steps))
        step = self.steps[page]
        name = attempt_name(step, progress.attempt(page))
        driving = (
            step.page.kind == "drive" and (step.index, progress.attempt(page)) in progress.tabs
        )
        begun = [
            s
            for s in self.steps
            if s.page.kind == "drive"
            and (s.index in progress.done or (driving and s.index == page))
        ]
        model = progress.model or {}
        return {
            "code": self.code,
            "order": self.plan.orders[self.code],
            "page": page,
            "pages": len(self.steps) - 1,  # the last step is the end, where nothing is done
            "title": step.page.title,
            "condition": step.condition,
            "rows": self.participant.count(name) if driving else None,
            "seconds_ago": None
            if self.last_request is None
            else round(time.time() - self.last_request, 1),
            "ended": progress.ended,
            "withdrawn": progress.withdrawn,
            "telemetry": self.telemetry if driving else {},
            "model": model.get("source", ""),
            "why": model.get("why", ""),
            "drives": [
                {"page": s.index, "title": s.page.title, "attempt": progress.attempt(s.index)}
                for s in begun
            ],
            "unverified": [
                s.page.title
                for s in begun
                if progress.done.get(s.index, {}).get("verified") is False
            ],
            "notes": [note for note in progress.notes if note.get("source") != "page"][-5:],
            "pauses": sum(note.get("source") == "page" for note in progress.notes),
        }


def _numbers(telemetry: Any) -> dict[str, float]:
    """Return what a page tells of its own speed: at most ten finite numbers."""
    if not isinstance(telemetry, dict):
        return {}
    numbers = {name: x for name, x in list(telemetry.items())[:10] if is_number(x)}
    return {name[:20]: float(x) for name, x in numbers.items()}
