"""The drives of a study: what determines one, and what becomes of its rows: a verified session, and after the first a model."""

from collections.abc import Iterable, Mapping
from dataclasses import asdict
from typing import Any

import numpy as np
import pandas as pd

from trustlab.live.study.pages import Step
from trustlab.live.study.plan import LiveStudy, model_of
from trustlab.live.study.store import Participant
from trustlab.models.tsc import TscModel
from trustlab.sessions.session import Session

UNDETERMINED = ("weak", "at bound")
"""What a fit says of a parameter that the data do not determine."""

FROM_FIT, FROM_STAND_IN = "own drive", "stand-in"
"""Where a participant's model and thresholds come from."""


def attempt_name(step: Step, attempt: int) -> str:
    """Return the name of an attempt's files."""
    return f"{step.name}.{attempt}"


def drive_seed(plan: LiveStudy, code: str, step: Step, attempt: int) -> int:
    """Return the seed of an attempt: a child of the study's seed by participant, page and attempt."""
    who = list(plan.orders).index(code)
    child = np.random.SeedSequence(plan.content["seed"], spawn_key=(who, step.index, attempt))
    return int(child.generate_state(1)[0])


def stand_in(plan: LiveStudy, why: str, detail: str = "") -> dict[str, Any]:
    """Return the plan's own model and thresholds, with the reason why they stand in."""
    return {"source": FROM_STAND_IN, "why": why, "detail": detail, **plan.content["stand_in"]}


def identified(plan: LiveStudy, session: Session) -> dict[str, Any]:
    """
    Return a participant's model and thresholds from the identifying drive, or the plan's where the drive says too little.

    Too little: the search fails or does not converge, a parameter is weak or at its bound, or no thresholds keep switching. In a
    study everybody must go on, so that this is no error; it is recorded, shown to the experimenter, and said in the report.
    """
    # Only here: a server that comes back after a crash must not compile what it does not need yet.
    from trustlab.allocation.threshold_choice import choose_thresholds
    from trustlab.identification.structure import IdentificationError
    from trustlab.identification.tsc import fit_tsc

    try:
        fit = fit_tsc(session)
        weak = fit.parameters.index[fit.parameters["status"].isin(UNDETERMINED)]
        if not fit.success or len(weak):
            what = f"the drive does not determine {', '.join(weak)}" if len(weak) else "the fit did not converge"
            return stand_in(plan, what, fit.message)
        assert isinstance(fit.model, TscModel)
        chosen = choose_thresholds(fit.model)
    except (IdentificationError, ValueError) as error:
        return stand_in(plan, "no model fits, or none with thresholds", str(error))
    percent = pd.Series(fit.fit_percent).astype(float).to_dict()
    found = {"model": asdict(fit.model), "thresholds": [chosen.lower, chosen.upper], "fit_percent": percent}
    return {"source": FROM_FIT, "why": "", "detail": fit.message, **found}


def drive_settings(
    plan: LiveStudy, code: str, step: Step, attempt: int, model: Mapping[str, Any] | None
) -> dict[str, Any]:
    """Return the first line of an attempt's file: what determines the drive but for the commands, and where its model comes from."""
    from trustlab.live.runs import drive_config

    known = stand_in(plan, "no identifying drive") if model is None else dict(model)
    condition = step.condition or step.page.name
    lengths: dict[str, Any] = {"laps": plan.content["laps"]}
    if step.page.name == "training":
        lengths = {"seconds": plan.content["training"]}
    elif step.page.name == "identification":
        lengths = {"schedule": [tuple(phase) for phase in plan.content["identification"]]}
    config = drive_config(
        condition,
        model=model_of(known["model"]),
        thresholds=tuple(known["thresholds"]),
        seed=drive_seed(plan, code, step, attempt),
        **lengths,
    )
    if plan.rehearsal:
        config |= {"clock": "accelerated", "hand": {}}
    return {"condition": condition, "source": known["source"], "why": known["why"], "config": config}


def shown_config(config: Mapping[str, Any]) -> dict[str, Any]:
    """Return what a browser needs of a drive's settings: nothing that names the condition."""
    return {name: value for name, value in config.items() if name not in ("condition", "participant")}


def session_of_attempt(
    plan: LiveStudy, participant: Participant, step: Step, attempt: int, notes: Iterable[Mapping[str, Any]]
) -> Session:
    """Return an attempt's session, replayed from its commands; its metadata hold the verdict, the log period and the pauses."""
    from trustlab.live.runs import replay, session_of

    name = attempt_name(step, attempt)
    header, table = participant.header(name), np.array(participant.rows(name), dtype=float)
    assert header is not None
    stamps, values = table[:, 1], table[:, 2:]
    period = np.diff(stamps) / 1000.0
    facts = {
        "position": step.position,
        "page": step.index,
        "attempt": attempt,
        "verified": replay(header["config"], values) is True,
        "kernel": plan.content["kernel"],
        "thresholds_from": header["source"],
        "period_median": float(np.median(period)),
        "period_max": float(period.max()),
        "pauses": [f"row {note['row']}: {note['text']}" for note in notes],
    }
    who = {"participant": participant.code, "condition": header["condition"], "synthetic": plan.rehearsal}
    return session_of(header["config"], values, **who, **facts)
