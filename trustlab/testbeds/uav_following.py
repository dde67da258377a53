"""
A UAV that follows a leader under conditions C1–C5 (Section 2.4.2): a simulated stand-in for the
testbed of Fig. 2.10.

One step of operator, allocation, autopilot and vehicle every tenth of a second.
"""

from collections import namedtuple
from collections.abc import Callable
from functools import cache

import numpy as np

from trustlab.models.checks import Seed, spawned
from trustlab.models.compiled import inner, njit
from trustlab.models.records import record
from trustlab.models.simulation import Simulation, filled
from trustlab.operators.ground_robot import Operator
from trustlab.testbeds import deciding
from trustlab.testbeds.deciding import COUNTS, FLAGS, NUMBERS, SAMPLE_TIME, Task
from trustlab.testbeds.ground_robot.course import size
from trustlab.testbeds.populations import P_R_MIN
from trustlab.testbeds.uav_tracking import TrackingTask, tracking_vehicle

# Length of a test, as printed [s], and in samples.
DURATION = 360.0
SAMPLES = round(DURATION / SAMPLE_TIME)

# Deviations that count as performance 0, from the leader [m] and of the command [m/s]; not printed.
E_MAX, U_MAX = 1.0, 3.0

# Of the ideal command, the leader's velocity + gain · error [1/s].
GAIN = 0.35

# How long wander and shaking of the hand and the autopilot's belief of where the leader is are
# remembered, and how soon the belief is right again while the operator flies [s].
WANDER_TIME, SHAKE_TIME = 6.0, 0.1
DRIFT_TIME, ANCHORING_TIME = 40.0, 2.0

LEADER = TrackingTask(size_x=6.0, size_y=4.0, speed=0.3)
FACTS = {
    "note": "simulated stand-in for the UAV testbed of Fig. 2.10",
    "performance": f"Section 2.4.2, e_max {E_MAX:g} m, Δu_max {U_MAX:g} m/s",
}

# Means of |x| + |y| and of √(x² + y²) for x and y normal with unit variance.
MEAN_1, MEAN_2 = 2.0 * np.sqrt(2.0 / np.pi), np.sqrt(np.pi / 2.0)

# By how much the delays of eye, hand and vehicle stretch the distance from the leader; found by
# simulating.
STRETCH = 1.2


# What is logged of each sample; points and vectors of the plane are complex numbers.
LOG = record(
    planar="robot reference u_h u_i", numbers="mode suggested_mode path_error r p_r p_h tsc"
)

# What a step reads and leaves. Of the hand what it has made of what it saw, where it wanders and
# how it shakes; drift: how far beside the leader the autopilot believes it to be, in units of
# FLIGHT's drift.
STATE = record(
    planar="position velocity acceleration hand wander shake drift",
    numbers=NUMBERS,
    counts=COUNTS,
    flags=FLAGS,
)

# Shares that first-order lags keep over one sample, what the drift comes to [m], and the vehicle's
# exact matrices over one sample, the same on x and y.
FLIGHT = record(
    numbers="keeps_wander keeps_shake keeps_hand keeps_drift keeps_anchor drift",
    moves=(float, (2, 2)),
    driven=(float, 2),
)


# What stays the same in all samples; `flight` is a record of FLIGHT, `person` an operator's
# numbers, the leader's position and velocity have shape (N,).
FlightSetup = namedtuple("FlightSetup", "task flight person position velocity")

# What samples hand on: one record of STATE, the noise of sensing, of the hand and of decisions, and
# performance in each sample.
FlightState = namedtuple("FlightState", "now sensing hand choices z_r z_h")


@inner
def imperfection(performance, person):
    """
    Return the standard deviations per axis of wander [m] and shaking [m/s] of a hand that performs
    so well.

    A command u_i + gain · wander + shaking has the quality `performance` (mean 1-norm of the
    deviation), and flies, the vehicle taken as an integrator and delays by STRETCH, at the mean
    distance e_max (1 − (robot_floor + robot_gain · performance)) from the leader; both as far as
    one of them can be met with the other.
    """
    command = ((1.0 - performance) * U_MAX / MEAN_1) ** 2
    share = 1.0 - person.robot_floor - person.robot_gain * performance
    error = (E_MAX * share / (STRETCH * MEAN_2)) ** 2
    slow, fast = GAIN * WANDER_TIME, GAIN * SHAKE_TIME
    by_wander, by_shaking = slow / (1.0 + slow), fast / (1.0 + fast) / GAIN**2
    wander = (error - by_shaking * command) / (by_wander - by_shaking * GAIN**2)
    wander = min(max(wander, 0.0), command / GAIN**2)
    shaking = max(command - GAIN**2 * wander, 0.0)
    return person.noise * np.sqrt(wander), person.noise * np.sqrt(shaking)


@inner
def noise(before, keep, rng):
    """Return the next value of coloured noise of unit variance on x and y."""
    fresh = complex(rng.standard_normal(), rng.standard_normal())
    return keep * before + np.sqrt(1.0 - keep * keep) * fresh


@inner
def operate(setup, seen, row, now, hand):
    """
    Move the operator's hand: it acts on the ideal command of a delay ago (`seen`, a row of the
    log).
    """
    flight, person = setup.flight, setup.person
    wander, shaking = imperfection(deciding.skill_now(setup.task, person, now), person)
    now.wander = noise(now.wander, flight.keeps_wander, hand)
    now.shake = noise(now.shake, flight.keeps_shake, hand)
    now.hand = seen.u_i + flight.keeps_hand * (now.hand - seen.u_i)
    row.u_h = now.hand + GAIN * wander * now.wander + shaking * now.shake


@inner
def fly(flight, row, now, sensing):
    """
    Move the vehicle by one sample, under the operator's command or the autopilot's, whose belief of
    where the leader is drifts away and is anchored anew while the operator flies.
    """
    if now.mode == 1:
        now.drift = flight.keeps_anchor * now.drift
        u = row.u_h
    else:
        now.drift = noise(now.drift, flight.keeps_drift, sensing)
        u = row.u_i + GAIN * flight.drift * now.drift
    v, a = now.velocity, now.acceleration
    moves, driven = flight.moves, flight.driven
    now.position += SAMPLE_TIME * v
    now.velocity = moves[0, 0] * v + moves[0, 1] * a + driven[0] * u
    now.acceleration = moves[1, 0] * v + moves[1, 1] * a + driven[1] * u


@inner(_nrt=False)
def sense(k, setup, state, log):
    """Come to the pause of sample k: see the leader, move the hand, measure performance."""
    now, row = state.now[0], log[k]
    row.robot, row.reference = now.position, setup.position[k]
    off = row.reference - row.robot
    row.u_i = setup.velocity[k] + GAIN * off
    row.path_error = size(off)
    seen = log[max(k - round(setup.person.delay / SAMPLE_TIME), 0)]
    operate(setup, seen, row, now, state.hand)
    deviation = row.u_i - row.u_h
    state.z_r[k] = 1.0 - row.path_error / E_MAX  # Section 2.4.2, P_r
    state.z_h[k] = 1.0 - (abs(deviation.real) + abs(deviation.imag)) / U_MAX  # Section 2.4.2, P_h
    deciding.measure(setup.task, k, state.z_r, state.z_h, now)


@njit(_nrt=False)
def follow(first, stop, setup, state, inputs, log):
    """
    Follow the leader, as a kernel of `Simulation`.

    setup: a `FlightSetup`. state: a `FlightState`. inputs: modes, or NaN. log: records of LOG.
    """
    task, person = setup.task, setup.person
    now = state.now[0]
    if stop == 0:
        now.position = setup.position[0]
        now.velocity = now.hand = setup.velocity[0]
        now.wander = complex(state.hand.standard_normal(), state.hand.standard_normal())
        deciding.begin(task, person, now, state.choices)
        sense(0, setup, state, log)
    for k in range(first, stop):
        deciding.allocate(task, person, inputs[k], k * SAMPLE_TIME, now, state.choices)
        deciding.log_decision(log[k], now)
        fly(setup.flight, log[k], now, state.sensing)
        deciding.tire(person, now)
        if k + 1 < log.size:
            sense(k + 1, setup, state, log)
    return stop, -1


@cache
def flight_of(hand_lag: float) -> np.void:
    """Return constants; left alone, the autopilot settles at the robot performance P_R_MIN."""
    lags = {"wander": WANDER_TIME, "shake": SHAKE_TIME, "hand": hand_lag}
    lags |= {"drift": DRIFT_TIME, "anchor": ANCHORING_TIME}
    moves, driven = tracking_vehicle()[0].discrete(SAMPLE_TIME)
    # Share of the drift's variance that the vehicle follows.
    followed = GAIN * DRIFT_TIME / (1.0 + GAIN * DRIFT_TIME)
    drift = E_MAX * (1.0 - P_R_MIN) / (MEAN_2 * np.sqrt(followed))
    keeps = {f"keeps_{name}": np.exp(-SAMPLE_TIME / time) for name, time in lags.items()}
    return filled(FLIGHT, moves=moves, driven=driven, drift=drift, **keeps)


def flown(
    task: Task,
    operator: Operator,
    seed: Seed,
    decide: Callable | None = None,
) -> np.ndarray:
    """Return the log of one test."""
    log, (z_r, z_h) = np.empty(SAMPLES, LOG), np.empty((2, SAMPLES))
    sensing, hand, choices, start = map(np.random.default_rng, spawned(seed, 4))
    phase = start.uniform(0.0, 2.0 * np.pi)
    leader = np.array(LEADER.path(deciding.sample_times(SAMPLES), 0.0, phase)) @ (1.0, 1j, 0.0)
    setup = FlightSetup(task, flight_of(operator.hand_lag), operator.numbers, *leader)
    state = FlightState(np.zeros(1, STATE), sensing, hand, choices, z_r, z_h)
    run = Simulation(follow, setup, state, np.full(SAMPLES, np.nan), log, decide)
    run.advance(SAMPLES)
    return log
