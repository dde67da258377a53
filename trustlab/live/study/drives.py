"""
The drives of a study: what determines one, and what becomes of its rows: a verified session, and
after the first a model.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from trustlab.live.study.pages import Item, Step
from trustlab.live.study.plan import Plan, file_origin
from trustlab.live.study.settings import model_of
from trustlab.live.task import PERIOD, task_named, task_of
from trustlab.live.trial import Record, read_record
from trustlab.models.checks import of_class
from trustlab.models.tsc import TscModel
from trustlab.sessions.session import Session

FROM_FIT = "own drive"
FROM_PART = "own drive in part"
FROM_STAND_IN = "stand-in"
"""Where a participant's model and thresholds come from."""


def log_path(folder: Path, step: Step, attempt: int) -> Path:
    """Return the log of an attempt at a drive."""
    again = f".{attempt + 1}" if attempt else ""
    return folder / f"{step.name}{again}.jsonl"


def drive_seed(plan: Plan, code: str, step: Step, attempt: int) -> int:
    """
    Return the seed of an attempt: a child of the study's seed by participant, page and attempt.
    """
    key = (list(plan.orders).index(code), step.index, attempt)
    child = np.random.SeedSequence(plan.content["seed"], spawn_key=key)
    return int(child.generate_state(1)[0])


def item_order(plan: Plan, code: str, step: Step) -> list[Item]:
    """Return a page's items as a participant sees them: in an order of their own if shuffled."""
    items = list(step.page.items)
    if step.page.shuffled:
        rng = np.random.default_rng(drive_seed(plan, code, step, 0))
        items = [items[i] for i in rng.permutation(len(items))]
    return items


FORM_MINUTES = 0.5
ITEM_MINUTES = 0.1
"""Time that people need for a page and for an item on it [min]."""


def planned_minutes(plan: Plan) -> int:
    """Return how long a participation takes, with drives at two thirds of the largest speed."""
    minutes = 0.0
    for step in plan.steps(next(iter(plan.orders))):
        minutes += FORM_MINUTES + ITEM_MINUTES * len(step.page.items)
        if step.page.kind == "drive":
            condition = step.condition or step.page.name
            config = drive_of(plan.content, condition, stand_in(plan, ""), seed=0)
            minutes += task_of(config).minutes(config)
    return 5 * math.ceil(minutes / 5.0)


def stand_in(plan: Plan, why: str, detail: str = "") -> dict[str, Any]:
    """Return the plan's own model and thresholds, with the reason why they stand in."""
    if "stand_in" not in plan.content:  # a task whose drives need no model of the person
        return {"source": "", "why": ""}
    return {"source": FROM_STAND_IN, "why": why, "detail": detail, **plan.content["stand_in"]}


def identified(plan: Plan, session: Session) -> dict[str, Any]:
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
        model = of_class("model", fit.model, TscModel)
        with warnings.catch_warnings():  # what it warns of is recorded
            warnings.simplefilter("ignore")
            chosen = choose_thresholds(model)
        if math.isnan(chosen.lower) or not limit_cycle(model, chosen.lower, chosen.upper).exists:
            raise ValueError(chosen.reason)
    except IdentificationError as error:
        return stand_in(plan, f"no model: {str(error)[:160].rpartition(' ')[0]} …", str(error))
    except ValueError as error:
        return stand_in(plan, "the model that fits has no thresholds", str(error))
    names = ", ".join(fit.parameters.index[fit.parameters["status"] == "fixed"])
    return {
        "source": FROM_PART if names else FROM_FIT,
        "why": f"held at the stand-in's value: {names}" if names else "",
        "detail": fit.message,
        "model": asdict(model),
        "thresholds": [chosen.lower, chosen.upper],
        "fit_percent": pd.Series(fit.fit_percent).astype(float).to_dict(),
    }


def drive_of(
    content: Mapping[str, Any], condition: str, known: Mapping[str, Any], seed: int
) -> dict[str, Any]:
    """
    Return the settings of a drive of a study with this content, with a known model and thresholds.
    """
    config = task_named(content["task"]).config(content, condition, known, seed)
    config["late"] = max(config["late"], content["least_delay"])
    if content["rehearsal"]:
        config["clock"] = "accelerated"
    return config


def drive_settings(
    plan: Plan, code: str, step: Step, attempt: int, model: Mapping[str, Any] | None
) -> dict[str, Any]:
    """
    Return the first line of an attempt's file: what determines the drive but for the commands, and
    where its model comes from.
    """
    known = stand_in(plan, "no identification drive") if model is None else dict(model)
    condition = step.condition or step.page.name
    config = drive_of(plan.content, condition, known, drive_seed(plan, code, step, attempt))
    return {
        "condition": condition,
        "source": known["source"],
        "why": known["why"],
        "config": config,
    }


class DriveReading(NamedTuple):
    """What the log of a drive says, if anything; its last link; what is wrong with it, or ""."""

    record: Record | None
    link: str
    fault: str


def read_drive(plan: Plan, code: str, step: Step, attempt: int) -> DriveReading:
    """Return an attempt at a drive, its rows compared with a replay of their commands."""
    path = log_path(plan.folder / code, step, attempt)
    record, link, fault = read_record(path, file_origin(plan.digest, code, path.stem))
    if record is not None and not fault:
        fault = record.fault(task_of(record.settings))
        fault = f"{path.name}: {fault}" if fault else ""
    return DriveReading(record, link, fault)


def session_of_drive(
    plan: Plan, code: str, step: Step, attempt: int, drive: DriveReading, fault: str = ""
) -> Session:
    """
    Return the session of an attempt at a drive: the logged rows; its metadata hold the verdict, the
    log period, pauses, and the delay with which pictures were seen.
    """
    record = drive.record
    if record is None:
        raise ValueError(drive.fault)
    facts = {
        "position": step.position,
        "page": step.index,
        "attempt": attempt,
        "thresholds_from": record.header["source"],
        "participant": code,
        "condition": record.header["condition"],
        "synthetic": plan.rehearsal,
    }
    late = record.settings["late"] + max(record.settings["sample_time"], PERIOD)
    session = record.session(task_of(record.settings), fault or drive.fault, **facts)
    return session.with_metadata(seen_late=session.metadata.more["delay"] > late)
