"""Simulated answers to questionnaires: an explicit assumption about what a run feels like, not a model of people."""

import numpy as np

from trustlab.models.checks import of_class, whole_number
from trustlab.sessions.session import Session
from trustlab.teleoperation.loop.settings import LoopSettings, study_named

TRAIT, MOOD = 0.10, 0.05
"""Standard deviations, as shares of a scale: of a person's way of answering, the same in all conditions, and of one answer."""


def experience(session: Session, study: str | LoopSettings = "main") -> dict[str, float]:
    """
    Return what an operator went through, as shares between 0 and 1.

    Parameters
    ----------
    session : Session
        A run of `simulate_teleoperation`.
    study : {"preliminary", "main"} or LoopSettings
        The settings of the run.

    Returns
    -------
    dict of str to float
        error: mean distance to the target over `error_range`, at most 1. effort: F/(F + F_0) with F the mean force of the hand and
        F_0 the force that holds the device, its spring and that of the channel, at a command of 1 m/s, (K + β_max b Λ)/Λ.
        agreement: 1 − mean |(α − α_min)/(α_max − α_min) − P_h/(P_h + P_r)|, how nearly the operator's share of the commands
        follows the operator's share of the performance.

    Raises
    ------
    ValueError
        If an argument is of the wrong kind; a SessionError if a column is missing.
    """
    of_class("session", session, Session)
    settings = study_named(study)
    session.require("path_error", "f_h_x", "f_h_y", "f_h_z", "alpha", "p_r", "p_h")
    ends = settings.scattering
    force = np.sqrt(sum(session[f"f_h_{axis}"] ** 2 for axis in "xyz")).mean()
    holding = float(np.mean(np.divide(settings.stiffness, settings.weight))) + ends.beta_max * ends.b
    share = (session["alpha"] - ends.alpha_min) / max(ends.alpha_max - ends.alpha_min, 1e-12)
    total = session["p_h"] + session["p_r"]
    own = np.divide(session["p_h"], total, out=np.full(len(session), 0.5), where=total > 0.0)
    return {
        "error": float(min(session["path_error"].mean() / settings.error_range, 1.0)),
        "effort": float(force / (force + holding)),
        "agreement": float(1.0 - np.abs(share - own).mean()),
    }


def simulated_answers(
    session: Session, study: str | LoopSettings = "main", participant: int = 1, seed: int = 0, points: int = 7
) -> dict[str, float]:
    """
    Return answers that follow, by assumption, from tracking error, effort, and agreement of α with own performance.

    Every answer is its drive, a share in [0, 1], plus a personal offset and a draw per answer, cut to [0, 1], put on its scale and
    rounded to its steps. Drives of the task load index: mental, temporal and performance: error; physical and effort: effort;
    frustration: 1 − agreement. Of satisfaction: satisfaction: 1 − error, comfort: 1 − effort, control: agreement. Of trust:
    ½(1 − error + agreement). All weights are one. People may answer by anything else, and no answer of people went into this.

    Parameters
    ----------
    session : Session
        A run of `simulate_teleoperation`.
    study : {"preliminary", "main"} or LoopSettings
        The settings of the run.
    participant : int
        Who answers: sets the personal offsets.
    seed : int
        Seed of all draws; those of one answer also depend on the condition.
    points : {5, 7}
        Satisfaction is answered from 1 to this.

    Returns
    -------
    dict of str to float
        The six scales of the task load index (0 to 100, steps of 5), three items of satisfaction (1 to `points`), and one of
        trust (1 to 7, in steps of one twelfth: the mean of twelve items).

    Raises
    ------
    ValueError
        If an argument is out of range.
    """
    participant, seed = whole_number("participant", participant), whole_number("seed", seed, least=0)
    if isinstance(points, bool) or points not in (5, 7):
        raise ValueError(f"points must be 5 or 7, got {points!r}")
    felt = experience(session, study)
    error, effort, agreement = felt["error"], felt["effort"], felt["agreement"]
    drives = {
        "mental": (error, 0, 100, 5),
        "physical": (effort, 0, 100, 5),
        "temporal": (error, 0, 100, 5),
        "performance": (error, 0, 100, 5),
        "effort": (effort, 0, 100, 5),
        "frustration": (1.0 - agreement, 0, 100, 5),
        "satisfaction": (1.0 - error, 1, points, 1),
        "comfort": (1.0 - effort, 1, points, 1),
        "control": (agreement, 1, points, 1),
        "trust": (0.5 * (1.0 - error + agreement), 1, 7, 1 / 12),
    }
    condition = list(str(session.metadata.condition).encode())
    person = np.random.default_rng([seed, participant]).normal(0.0, TRAIT, 3)
    mood = np.random.default_rng([seed, participant, *condition]).normal(0.0, MOOD, len(drives))
    offsets = np.repeat(person, (6, 3, 1))
    answers = {}
    for (name, (drive, low, high, step)), offset in zip(drives.items(), offsets + mood, strict=True):
        share = min(max(drive + offset, 0.0), 1.0)
        answers[name] = low + step * round(share * (high - low) / step)
    return answers
