"""
The drives of a study: what determines one, and what becomes of its rows: a verified session, and
after the first a model.
"""

from __future__ import annotations

import json
import math
import warnings
from dataclasses import asdict
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from trustlab.live.study.pages import Step
from trustlab.live.study.plan import Plan, file_origin
from trustlab.live.task import PERIOD, task_named
from trustlab.live.tasks.ground_robot import model_of
from trustlab.live.trial import Record, read_record
from trustlab.sessions.session import Session

FROM_FIT = "own drive"
FROM_PART = "own drive in part"
FROM_STAND_IN = "stand-in"
"""Where a participant's model and thresholds come from."""


class Attempt(NamedTuple):
    """An attempt at a drive of a study, numbered from 0."""

    plan: Plan
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

    def settings(self, model: dict | None) -> tuple[dict, dict]:
        """
        Return what determines the drive but for the commands, and what else the log begins with:
        the condition, and where the participant's model comes from.
        """
        known = model or stand_in(self.plan, "no identification drive")
        condition = self.step.condition or self.step.page.name
        config = drive_of(self.plan.content, condition, self.seed, model)
        return config, {"condition": condition, "source": known["source"], "why": known["why"]}

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
            condition=record.header["condition"],
            synthetic=self.plan.rehearsal,
        )


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


def stand_in(plan: Plan, why: str) -> dict:
    """Return the plan's own model and thresholds, with the reason why they stand in."""
    known = plan.content.get("stand_in")
    if known is None:  # a task whose drives need no model of the person
        return {"source": "", "why": ""}
    return {"source": FROM_STAND_IN, "why": why, **known}


def identified(plan: Plan, session: Session) -> dict:
    """
    Return a participant's model and thresholds from the identification drive, as far as the drive
    determines them.

    The fit is `fit_holding`, with the stand-in model's values; where it fails, or no thresholds
    keep switching, model and thresholds are the stand-in's. In a study everybody must go on, so
    that none of this is an error; it is recorded, shown to the experimenter, and said in the
    report.
    """
    # Only here: a server that comes back after a crash must not compile what it does not need yet.
    from trustlab.allocation.steady import limit_cycle
    from trustlab.allocation.thresholds import choose_thresholds
    from trustlab.identification.model import IdentificationError
    from trustlab.live.fit import fit_holding

    try:
        fit = fit_holding(session, model_of(plan.content["stand_in"]["model"]))
        model: Any = fit.model
        with warnings.catch_warnings():  # what it warns of is recorded
            warnings.simplefilter("ignore")
            chosen = choose_thresholds(model)
        if math.isnan(chosen.lower) or not limit_cycle(model, chosen.lower, chosen.upper).exists:
            raise ValueError(chosen.reason)
    except IdentificationError as error:
        return stand_in(plan, f"no model: {str(error)[:160].rpartition(' ')[0]} …")
    except ValueError:
        return stand_in(plan, "the model that fits has no thresholds")
    names = ", ".join(fit.parameters.index[fit.parameters["status"] == "fixed"])
    return {
        "source": FROM_PART if names else FROM_FIT,
        "why": f"held at the stand-in's value: {names}" if names else "",
        "model": asdict(model),
        "thresholds": [chosen.lower, chosen.upper],
    }
