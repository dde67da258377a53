"""
Runs of the UAV that follows a leader under conditions C1–C5: a simulated stand-in for the testbed
of Fig. 2.10.
"""

from functools import cache, partial
from typing import Any

import numpy as np

from trustlab.models.checks import of_class, spawned
from trustlab.models.tsc import TscModel
from trustlab.operators.ground_robot import Operator
from trustlab.sessions.session import Metadata, Session
from trustlab.teleoperation.records import filled, log_of
from trustlab.testbeds import deciding
from trustlab.testbeds.condition_run import ConditionRun, condition_measures
from trustlab.testbeds.uav_following import kernel
from trustlab.testbeds.uav_following.people import P_R_MIN, following_operator
from trustlab.testbeds.uav_tracking import TrackingTask, tracking_vehicle

# Length of a test, as printed [s], and in samples.
DURATION = 360.0
SAMPLES = round(DURATION / deciding.SAMPLE_TIME)

# Deviations that count as performance 0, from the leader [m] and of the command [m/s]; not printed.
E_MAX, U_MAX = 1.0, 3.0

# Of the ideal command, the leader's velocity + gain · error [1/s].
GAIN = 0.35

# Correlation time of the autopilot's belief of where the leader is [s].
DRIFT_TIME = 40.0

LEADER = TrackingTask(size_x=6.0, size_y=4.0, speed=0.3)
NOTE = "simulated stand-in for the UAV testbed of Fig. 2.10"


@cache
def flight() -> np.void:
    """
    Return the testbed's constants; left alone, the autopilot settles at the robot performance
    P_R_MIN.
    """
    ((v_v, v_a), (a_v, a_a)), (v_u, a_u) = tracking_vehicle()[0].discrete(deciding.SAMPLE_TIME)
    followed = (
        GAIN * DRIFT_TIME / (1.0 + GAIN * DRIFT_TIME)
    )  # share of the drift's variance that the vehicle follows
    return filled(
        kernel.FLIGHT,
        u_max=U_MAX,
        gain=GAIN,
        wander_time=6.0,
        shake_time=0.1,
        drift=E_MAX * (1.0 - P_R_MIN) / (kernel.MEAN_2 * np.sqrt(followed)),
        drift_time=DRIFT_TIME,
        anchoring_time=2.0,
        v_v=v_v,
        v_a=v_a,
        v_u=v_u,
        a_v=a_v,
        a_a=a_a,
        a_u=a_u,
    )


def fly_condition(
    condition: str | None = None,
    participant: int | str | Operator | None = None,
    model: TscModel | None = None,
    thresholds: tuple[float, float] | None = None,
    seed: int | np.random.SeedSequence = 0,
    r0: float | None = None,
    operator: Operator | None = None,
    rule: Any = None,
    mode: int | None = None,
) -> ConditionRun:
    """
    Fly after a leader for six minutes under one of the conditions C1–C5: `run_condition` with
    testbed="uav".

    Performance is the window mean over 100 s of (e_max − e)/e_max and of 1 − ‖u_i − u_h‖₁/Δu_max
    (Section 2.4.2, where the deviation itself is printed). While the operator flies, the autopilot
    knows where the leader is; left alone, it drifts away.

    Parameters
    ----------
    condition, participant, model, thresholds, seed, r0, operator, rule, mode
        As for `run_condition`; model and thresholds of a seeded operator are their own when not
        given.

    Returns
    -------
    ConditionRun

    Raises
    ------
    ValueError
        If an argument is not understood or would have no effect.

    Notes
    -----
    Simulated: no person took part. What is not printed (e_max, Δu_max, the leader's path, ranges of
    performance) is plausible, not measured.
    """
    own = None
    remedy = "who flies? give participant=, 1 to 20, or an Operator with model="
    someone = deciding.someone(participant, operator, remedy)
    if not isinstance(someone, Operator):
        someone, own_model, own = following_operator(someone)
        model = own_model if model is None else model
    model = of_class("model", model, TscModel)
    who = someone, model, E_MAX, 0, r0
    rule, task, thresholds, condition = deciding.task_for(
        condition, rule, mode, thresholds, own, *who
    )
    (log,) = deciding.decided_by(rule, task, SAMPLES, partial(_fly, task, someone, seed))
    facts: dict[str, Any] = {
        "duration": DURATION,
        "settling": deciding.SETTLING,
    } | deciding.tsc_facts(thresholds)
    facts |= deciding.seed_facts(seed) | {"note": NOTE}
    facts |= deciding.measured(f"Section 2.4.2, e_max {E_MAX:g} m, Δu_max {U_MAX:g} m/s")
    about = Metadata(someone.participant, condition, "trustlab.testbeds.uav_following", True, facts)
    return ConditionRun(
        session=Session(deciding.framed(log), about),
        operator=someone,
        model=model,
        thresholds=thresholds,
    )


def measured_flight(
    condition: str,
    operator: Operator,
    model: TscModel,
    thresholds: tuple[float, float],
    seed: np.random.SeedSequence,
    r0: float | None,
) -> tuple[dict[str, float], float]:
    """
    Return the measures of `fly_condition`, and the last utilization, without making a session.
    """
    who = operator, model, E_MAX, 0, r0
    _, task, _, _ = deciding.task_for(condition, None, None, None, thresholds, *who)
    (log,) = _fly(task, operator, seed)
    return condition_measures(
        log, deciding.sample_times(log.size), condition, operator, model
    ), float(log["r"][-1])


def _fly(
    task: deciding.Task,
    operator: Operator,
    seed: int | np.random.SeedSequence,
    modes: np.ndarray | None = None,
) -> tuple[np.ndarray]:
    """Return the log of one test, with the modes of a schedule where one is given."""
    _, log = log_of(kernel.LOG, SAMPLES)
    *streams, start = (np.random.default_rng(child) for child in spawned(seed, 4))
    position, velocity = LEADER.path(
        deciding.sample_times(log.size), 0.0, start.uniform(0.0, 2.0 * np.pi)
    )
    schedule = np.ones(SAMPLES, np.int64) if modes is None else modes
    states = np.zeros(1, kernel.STATE)
    room = np.empty((2, SAMPLES))
    kernel.follow(
        task, schedule, flight(), position, velocity, operator.numbers, *streams, states, log, *room
    )
    return (log,)
