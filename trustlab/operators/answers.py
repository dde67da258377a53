"""
Simulated answers to questionnaires: an explicit assumption about what a run feels like, not a model
of people.
"""

from collections.abc import Mapping

import numpy as np

from trustlab.models.checks import of_class, whole_number, whole_seed
from trustlab.models.compiled import njit
from trustlab.models.tsc import TscModel, threshold_mode
from trustlab.operators.ground_robot import Operator
from trustlab.sessions.session import Session
from trustlab.teleoperation.loop.settings import LoopSettings, described, study_named

# Standard deviations, as shares of a scale: of a person's way of answering, the same in all
# conditions, and of one answer.
TRAIT, MOOD = 0.10, 0.05


def experience(session: Session, study: str | LoopSettings = "main") -> dict[str, float]:
    """
    Return what an operator went through, as shares between 0 and 1.

    Parameters
    ----------
    session : Session
        A run of `simulate_teleoperation`.
    study : {"preliminary", "main"} or LoopSettings
        The settings of the run; others than it names are refused.

    Returns
    -------
    dict of str to float
        error: mean distance to the target over `error_range`, at most 1. effort: F/(F + F_0) with F
        the mean force of the hand and F_0 the force that holds the device, its spring and that of
        the channel, at a command of 1 m/s, (K + β_max b Λ)/Λ. agreement: 1 − mean |(α −
        α_min)/(α_max − α_min) − P_h/(P_h + P_r)|, how nearly the operator's share of the commands
        follows the operator's share of the performance.

    Raises
    ------
    ValueError
        If an argument is of the wrong kind; a SessionError if a column is missing.
    """
    of_class("session", session, Session)
    settings, said = study_named(study), session.metadata.more
    for name, word in described(settings).items():
        if said.get(name, word) != word:
            raise ValueError(
                f"the run has other settings than study: {name} {said[name]!r}, not {word!r}; pass "
                "study=, as it was simulated"
            )
    session.require("path_error", "f_h_x", "f_h_y", "f_h_z", "alpha", "p_r", "p_h")
    ends = settings.scattering
    force = np.sqrt(sum(session[f"f_h_{axis}"] ** 2 for axis in "xyz")).mean()
    holding = settings.stiffness / settings.weight + ends.beta_max * ends.b
    share = (session["alpha"] - ends.alpha_min) / max(ends.alpha_max - ends.alpha_min, 1e-12)
    p_h, total = session["p_h"], session["p_h"] + session["p_r"]
    skill = np.divide(p_h, total, out=np.full(len(session), 0.5), where=total > 0.0)
    return {
        "error": float(min(session["path_error"].mean() / settings.error_range, 1.0)),
        "effort": float(force / (force + holding)),
        "agreement": float(1.0 - np.abs(share - skill).mean()),
    }


def simulated_answers(
    session: Session,
    study: str | LoopSettings = "main",
    participant: int = 1,
    seed: int = 0,
    points: int = 7,
) -> dict[str, float]:
    """
    Return answers that follow, by assumption, from tracking error, effort, and agreement of α with
    own performance.

    Every answer is its drive, a share in [0, 1], plus a personal offset and a draw per answer, cut
    to [0, 1], put on its scale and rounded to its steps. Drives of the task load index: mental,
    temporal and performance: error; physical and effort: effort; frustration: 1 − agreement. Of
    satisfaction: satisfaction: 1 − error, comfort: 1 − effort, control: agreement. Of trust: ½(1 −
    error + agreement). All weights are one. People may answer by anything else, and no answer of
    people went into this.

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
        The six scales of the task load index (0 to 100, steps of 5), three items of satisfaction (1
        to `points`), and one of trust (1 to 7, in steps of one twelfth: the mean of twelve items).

    Raises
    ------
    ValueError
        If an argument is out of range.

    Examples
    --------
    >>> import trustlab as tl
    >>> run = tl.simulate_teleoperation("TMIG", seed=0, duration=10.0)
    >>> answers = tl.simulated_answers(run, seed=0)
    >>> answers["mental"], answers["satisfaction"]
    (10, 6)
    """
    participant = whole_number("participant", participant)
    seed = whole_seed(seed)
    if whole_number("points", points) not in (5, 7):
        raise ValueError(f"points must be 5 or 7, got {points!r}")
    error, effort, agreement = experience(session, study).values()
    drives = {
        "mental": error,
        "physical": effort,
        "temporal": error,
        "performance": error,
        "effort": effort,
        "frustration": 1.0 - agreement,
        "satisfaction": 1.0 - error,
        "comfort": 1.0 - effort,
        "control": agreement,
        "trust": 0.5 * (1.0 - error + agreement),
    }
    # the ends and the step of each scale
    scales = [(0, 100, 5)] * 6 + [(1, points, 1)] * 3 + [(1, 7, 1 / 12)]
    condition = list(str(session.metadata.condition).encode())
    person = np.random.default_rng([seed, participant]).normal(0.0, TRAIT, 3)
    mood = np.random.default_rng([seed, participant, *condition]).normal(0.0, MOOD, len(drives))
    offsets = np.repeat(person, (6, 3, 1)) + mood
    answers = {}
    for name, (low, high, step), offset in zip(drives, scales, offsets, strict=True):
        share = min(max(drives[name] + offset, 0.0), 1.0)
        answers[name] = low + step * round(share * (high - low) / step)
    return answers


def allocation_answers(
    mode: np.ndarray,
    tsc: np.ndarray,
    means: Mapping[str, float],
    judged: float,
    operator: Operator,
    model: TscModel,
) -> dict[str, float]:
    """
    Return answers after a run under C1–C5 that follow, by assumption, from utilization, switching,
    performance and agreement.

    Task load is load = load_utilization · mean r + load_switching · (switches or suggestions judged
    a minute), at most 1; relative performance p = (mean P_r − P_r,min)/(P_r,max − P_r,min), cut to
    [0, 1]; agreement the share of time in which the mode is the one that the operator's own
    thresholds, on TSC as perceived, would have chosen. Nothing is drawn and no answer of people
    went into this.

    Parameters
    ----------
    mode, tsc : numpy.ndarray, shape (N,)
        Of the run.
    means : mapping of str to float
        p_r, r and duration [s] of the run.
    judged : float
        How many decisions the operator made: switches in C1, suggestions in C2 and C4, none where
        they are forced.
    operator : Operator
        With load_utilization and load_switching.
    model : TscModel
        For P_r,min and P_r,max.

    Returns
    -------
    dict of str to float
        tlx, 100 load; satisfaction, 1 + 6 · ½(1 − load + p); trust, 1 + 6 · ½(p + agreement).
    """
    minutes, robot = means["duration"] / 60.0, model.robot
    load = operator.load_utilization * means["r"] + operator.load_switching * judged / minutes
    load = min(load, 1.0)
    relative = min(max((means["p_r"] - robot.p_min) / (robot.p_max - robot.p_min), 0.0), 1.0)
    agreement = agreeing(mode, tsc + operator.trust_bias, operator.lower, operator.upper)
    return {
        "tlx": 100.0 * load,
        "satisfaction": 1.0 + 3.0 * (1.0 - load + relative),
        "trust": 1.0 + 3.0 * (relative + agreement),
    }


@njit
def agreeing(mode, tsc, lower, upper):
    """
    Return the share of samples whose mode is that of rule (2.8) with these thresholds, begun in the
    same mode.
    """
    ruled, count = int(mode[0]), 0
    for k in range(mode.size):
        ruled = threshold_mode(tsc[k], lower, upper, ruled)
        count += ruled == mode[k]
    return count / mode.size
