"""
The drives of a study: what determines one, and what becomes of its rows: a verified session, and
after the first a model.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from trustlab.live.chain import read_chain
from trustlab.live.study.pages import Item, Step
from trustlab.live.study.plan import Plan
from trustlab.live.study.settings import model_of
from trustlab.live.study.store import file_origin
from trustlab.live.tasks.task import task_named, task_of
from trustlab.models.checks import of_class
from trustlab.models.digest import digest
from trustlab.models.tsc import TscModel
from trustlab.sessions.session import Session

FROM_FIT = "own drive"
FROM_PART = "own drive in part"
FROM_STAND_IN = "stand-in"
"""Where a participant's model and thresholds come from."""


KERNEL = Path(__file__).parents[1] / "static" / "kernel.wasm"


def kernel_digest() -> str:
    """Return the digest of the physics that browsers run."""
    return digest(KERNEL.read_bytes()) if KERNEL.exists() else "none"


def attempt_name(step: Step, attempt: int) -> str:
    """Return the name of an attempt's files."""
    return f"{step.name}.{attempt}"


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
    if content["rehearsal"]:
        speed, wobble = np.random.default_rng(seed).uniform([0.7, 0.05], [1.0, 0.3]).tolist()
        config |= {"clock": "accelerated", "hand": {"speed": speed, "wobble": wobble}}
    return config


def prepare(plan: Plan) -> None:
    """Compile what the server computes of drives, before anybody drives."""
    config = drive_of(plan.content, "training", stand_in(plan, ""), seed=0)
    if "commands" in config:
        command = [config["limits"][name][0] for name in config["commands"]]
        task_of(config).begin(config).step(*command)


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


def shown_config(plan: Plan, config: Mapping[str, Any]) -> dict[str, Any]:
    """
    Return what a browser needs of a drive: its settings without the condition's name, and words.
    """
    settings = {name: value for name, value in config.items() if name != "condition"}
    return settings | {"words": plan.content["words"]}


class Driven(NamedTuple):
    """An attempt as its file of rows holds it, and what is wrong with the file: "" if nothing."""

    header: dict[str, Any]
    stamps: np.ndarray
    values: np.ndarray
    links: list[str]
    fault: str


def read_attempt(plan: Plan, code: str, name: str) -> Driven:
    """Return an attempt, its rows compared with a replay of their commands."""
    path = plan.folder / code / f"{name}.jsonl"
    reading = read_chain(path, file_origin(plan.digest, code, name))
    if not reading.entries:
        return Driven({}, np.empty(0), np.empty((0, 0)), reading.links, reading.fault)
    header, *rows = reading.entries
    try:
        table = np.array(rows, dtype=float).reshape(len(rows), 2 + len(header["config"]["columns"]))
    except (TypeError, ValueError, KeyError):
        damage = reading.fault or f"{path.name}: it does not hold a drive"
        return Driven({}, np.empty(0), np.empty((0, 0)), reading.links, damage)
    fault = reading.fault
    if rows and not fault:  # a changed file is not worth a replay
        same = task_of(header["config"]).replay(header["config"], table[:, 2:])
        if same is not True:
            fault = f"{path.name}: row {same} is not what its commands lead to"
    return Driven(header, table[:, 1], table[:, 2:], reading.links, fault)


def session_of_attempt(
    plan: Plan, code: str, step: Step, attempt: int, notes: Iterable[Mapping[str, Any]]
) -> Session:
    """
    Return an attempt's session, replayed from its commands; its metadata hold the verdict, the log
    period and the pauses.
    """
    driven = read_attempt(plan, code, attempt_name(step, attempt))
    period = np.diff(driven.stamps) / 1000.0
    facts = {
        "position": step.position,
        "page": step.index,
        "attempt": attempt,
        "verified": driven.fault == "",
        "kernel": plan.content["kernel"],
        "thresholds_from": driven.header["source"],
        "period_median": float(np.median(period)),
        "period_max": float(period.max()),
        "pauses": [f"row {note['row']}: {note['text']}" for note in notes],
        "participant": code,
        "condition": driven.header["condition"],
        "synthetic": plan.rehearsal,
    }
    config = driven.header["config"]
    return task_of(config).session(config, driven.values, **facts)
