"""
Runs of the UAV that follows a leader under conditions C1–C5: a simulated stand-in for the testbed
of Fig. 2.10.
"""

from collections.abc import Callable
from functools import cache

import numpy as np

from trustlab.models.checks import spawned
from trustlab.models.simulation import Simulation
from trustlab.operators.ground_robot import Operator
from trustlab.teleoperation.records import filled
from trustlab.testbeds import deciding
from trustlab.testbeds.populations import P_R_MIN
from trustlab.testbeds.uav_following import kernel
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
MEASURED = f"Section 2.4.2, e_max {E_MAX:g} m, Δu_max {U_MAX:g} m/s"


@cache
def flight() -> np.void:
    """
    Return the testbed's constants; left alone, the autopilot settles at the robot performance
    P_R_MIN.
    """
    ((v_v, v_a), (a_v, a_a)), (v_u, a_u) = tracking_vehicle()[0].discrete(deciding.SAMPLE_TIME)
    # Share of the drift's variance that the vehicle follows.
    followed = GAIN * DRIFT_TIME / (1.0 + GAIN * DRIFT_TIME)
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


def flown(
    task: deciding.Task,
    operator: Operator,
    seed: int | np.random.SeedSequence,
    decide: Callable | None = None,
) -> np.ndarray:
    """Return the log of one test."""
    log = np.empty(SAMPLES, kernel.LOG)
    sensing, hand, choices, start = map(np.random.default_rng, spawned(seed, 4))
    leader = LEADER.path(deciding.sample_times(SAMPLES), 0.0, start.uniform(0.0, 2.0 * np.pi))
    rates = kernel.rates_of(operator, flight(), task.sample_time)
    setup = kernel.FlightSetup(task, flight(), *leader, operator.numbers, rates)
    z_r, z_h = np.empty((2, SAMPLES))
    state = kernel.FlightState(np.zeros(1, kernel.STATE), sensing, hand, choices, z_r, z_h)
    run = Simulation(kernel.follow, setup, state, deciding.no_inputs(SAMPLES), log, decide)
    run.advance(SAMPLES)
    return log
