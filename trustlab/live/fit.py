"""
A person's model from minutes of driving: `fit_tsc`, with what the drive does not determine held at
another model's values; and thresholds that go with it.
"""

import math
import warnings
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from trustlab.identification.model import IdentificationError
from trustlab.identification.result import FitResult
from trustlab.live.tasks.ground_robot import model_of
from trustlab.models.tsc import TscModel
from trustlab.sessions.session import Session

FROM_FIT = "own drive"
FROM_PART = "own drive in part"
FROM_STAND_IN = "stand-in"
"""Where a participant's model and thresholds come from."""

UNDETERMINED = ("weak", "at bound")
"""What a fit says of a parameter that the data do not determine."""

UNUSABLE = "do not use the numbers"
"""What a fit says whose search did not end at a minimum."""

LEVELS = ("human_p_min", "human_p_max", "robot_p_min", "robot_p_max")


def fit_holding(session: Session, reference: TscModel) -> FitResult:
    """
    Identify a person's model from a drive, with what it leaves undetermined held at another model's
    values.

    Utilization is 0 at the beginning by definition. What the fit then calls weak or at its bound
    (mostly time constants, which are minutes long, and β) is held, levels of performance last, and
    the rest fitted again; held parameters have the status "fixed".

    Parameters
    ----------
    session : Session
        The drive.
    reference : TscModel
        Whose values are held.

    Raises
    ------
    IdentificationError
        If no level of performance remains that is the person's own.
    """
    known = {
        f"{part}_{name}": value
        for part, parameters in asdict(reference).items()
        for name, value in parameters.items()
    }
    fixed = {"r0": 0.0}
    fit, weak, said = _fit(session, fixed)
    while weak := [name for name in weak if name in known and name not in fixed]:
        slow = [name for name in weak if name not in LEVELS]
        fixed |= {name: known[name] for name in slow or weak}
        fit, weak, said = _fit(session, fixed)
    if fit is None or UNUSABLE in said or set(LEVELS) <= set(fixed):
        raise IdentificationError(
            f"{session.duration:.0f} s of this drive determine no level of performance, even with "
            "all else held at another model's values; drive longer (laps=8, as printed), in both "
            f"modes: {said}",
            tuple(fixed)[1:],
        )
    return fit


def _fit(session: Session, fixed: dict[str, float]) -> tuple[FitResult | None, Sequence[str], str]:
    """
    Return a fit with some parameters fixed, the parameters that the drive does not determine even
    so, and what the fit says.
    """
    from trustlab.identification.tsc import fit_tsc

    try:
        fit = fit_tsc(session, fixed=fixed)
    except IdentificationError as error:
        return None, error.parameters, str(error)
    table = fit.parameters
    return fit, table.index[table["status"].isin(UNDETERMINED)], fit.message


def stand_in(content: dict, why: str = "") -> dict:
    """Return a study's own model and thresholds, with the reason why they stand in."""
    if "stand_in" not in content:  # a task whose drives need no model of the person
        return {"source": "", "why": ""}
    return {"source": FROM_STAND_IN, "why": why, **content["stand_in"]}


def identified(content: dict, session: Session) -> dict:
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

    try:
        fit = fit_holding(session, model_of(content["stand_in"]["model"]))
    except ValueError as error:
        # What stands behind it is what an analyst can do.
        return stand_in(content, f"no model: {str(error).partition(';')[0]}")
    model: Any = fit.model
    try:
        with warnings.catch_warnings():  # what it warns of is recorded
            warnings.simplefilter("ignore")
            chosen = choose_thresholds(model)
        if math.isnan(chosen.lower) or not limit_cycle(model, chosen.lower, chosen.upper).exists:
            raise ValueError(chosen.reason)
    except ValueError:
        return stand_in(content, "the model that fits has no thresholds")
    names = ", ".join(fit.parameters.index[fit.parameters["status"] == "fixed"])
    return {
        "source": FROM_PART if names else FROM_FIT,
        "why": f"held at the stand-in's value: {names}" if names else "",
        "model": asdict(model),
        "thresholds": [chosen.lower, chosen.upper],
    }
