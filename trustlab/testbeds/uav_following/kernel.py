"""
The loop of the UAV that follows a leader: one step of operator, allocation, autopilot and vehicle
every tenth of a second.
"""

from typing import Any, NamedTuple

import numpy as np

from trustlab.models.compiled import inner, njit
from trustlab.models.tsc import next_utilization
from trustlab.teleoperation.records import record
from trustlab.testbeds.deciding import (
    COUNTS,
    FLAGS,
    NUMBERS,
    Task,
    allocate,
    begin,
    measure,
    skill_now,
)

# What is logged of each sample.
LOG = record(
    numbers=(
        "mode suggested_mode robot_x robot_y reference_x reference_y path_error u_h_x u_h_y "
        "u_i_x u_i_y r p_r p_h tsc"
    )
)

# Of the vehicle velocity and acceleration, of the hand what it has made of what it saw, where it
# wanders and how it shakes; drift: how far beside the leader the autopilot believes it to be.
MOVING = "x y v_x v_y a_x a_y hand_x hand_y wander_x wander_y shake_x shake_y drift_x drift_y"
# What a step reads and leaves.
STATE = record(numbers=f"{MOVING} {NUMBERS}", counts=COUNTS, flags=FLAGS)

# Means of |x| + |y| and of √(x² + y²) for x and y normal with unit variance.
MEAN_1, MEAN_2 = 2.0 * np.sqrt(2.0 / np.pi), np.sqrt(np.pi / 2.0)

# By how much the delays of eye, hand and vehicle stretch the distance from the leader; found by
# simulating.
STRETCH = 1.2


# The testbed's constants for the compiled loop, and the vehicle's exact matrices over one sample,
# the same on x and y.
FLIGHT = record(
    numbers="u_max gain wander_time shake_time drift drift_time anchoring_time v_v v_a v_u a_v "
    "a_a a_u"
)


class LagShares(NamedTuple):
    """Shares that first-order lags keep over one sample, the same in all samples."""

    wander: float
    shake: float
    hand: float
    drift: float
    anchor: float


@inner
def imperfection(performance, person, flight, e_max):
    """
    Return the standard deviations per axis of wander [m] and shaking [m/s] of a hand that performs
    so well.

    A command u_i + gain · wander + shaking has the quality `performance` (mean 1-norm of the
    deviation), and flies, the vehicle taken as an integrator and delays by STRETCH, at the mean
    distance e_max (1 − (robot_floor + robot_gain · performance)) from the leader; both as far as
    one of them can be met with the other.
    """
    command = ((1.0 - performance) * flight.u_max / MEAN_1) ** 2
    error = (
        e_max * (1.0 - person.robot_floor - person.robot_gain * performance) / (STRETCH * MEAN_2)
    ) ** 2
    slow, fast = flight.gain * flight.wander_time, flight.gain * flight.shake_time
    by_wander, by_shaking = slow / (1.0 + slow), fast / (1.0 + fast) / flight.gain**2
    wander = (error - by_shaking * command) / (by_wander - by_shaking * flight.gain**2)
    wander = min(max(wander, 0.0), command / flight.gain**2)
    shaking = max(command - flight.gain**2 * wander, 0.0)
    return person.noise * np.sqrt(wander), person.noise * np.sqrt(shaking)


@inner
def noise(before, keep, rng):
    """Return the next value of coloured noise of unit variance."""
    return keep * before + np.sqrt(1.0 - keep * keep) * rng.standard_normal()


@inner
def operate(task, person, flight, rates, seen, row, state, hand):
    """
    Move the operator's hand: it acts on the ideal command of a delay ago (`seen`, a row of the
    log).
    """
    wander, shaking = imperfection(skill_now(task, person, state), person, flight, task.e_max)
    state.wander_x = noise(state.wander_x, rates.wander, hand)
    state.wander_y = noise(state.wander_y, rates.wander, hand)
    state.shake_x, state.shake_y = (
        noise(state.shake_x, rates.shake, hand),
        noise(state.shake_y, rates.shake, hand),
    )
    state.hand_x = seen.u_i_x + rates.hand * (state.hand_x - seen.u_i_x)
    state.hand_y = seen.u_i_y + rates.hand * (state.hand_y - seen.u_i_y)
    row.u_h_x = state.hand_x + flight.gain * wander * state.wander_x + shaking * state.shake_x
    row.u_h_y = state.hand_y + flight.gain * wander * state.wander_y + shaking * state.shake_y


@inner
def detect(flight, rates, state, sensing):
    """
    Let the autopilot's belief of where the leader is drift away, or be anchored anew while the
    operator flies.
    """
    if state.mode == 1:
        state.drift_x, state.drift_y = rates.anchor * state.drift_x, rates.anchor * state.drift_y
        return
    spread = flight.drift * np.sqrt(1.0 - rates.drift**2)
    state.drift_x = rates.drift * state.drift_x + spread * sensing.standard_normal()
    state.drift_y = rates.drift * state.drift_y + spread * sensing.standard_normal()


@inner
def moved(flight, v, a, u):
    """Return velocity and acceleration on one axis one sample later, the command held."""
    return (
        flight.v_v * v + flight.v_a * a + flight.v_u * u,
        flight.a_v * v + flight.a_a * a + flight.a_u * u,
    )


@inner
def fly(flight, dt, row, state):
    """Move the vehicle by one sample under the operator's command or the autopilot's."""
    manual = state.mode == 1
    u_x = row.u_h_x if manual else row.u_i_x + flight.gain * state.drift_x
    u_y = row.u_h_y if manual else row.u_i_y + flight.gain * state.drift_y
    state.x, state.y = state.x + dt * state.v_x, state.y + dt * state.v_y
    state.v_x, state.a_x = moved(flight, state.v_x, state.a_x, u_x)
    state.v_y, state.a_y = moved(flight, state.v_y, state.a_y, u_y)


def rates_of(person: Any, flight: Any, dt: float) -> LagShares:
    """Return the shares for an operator and a testbed's constants."""
    lags = flight["wander_time"], flight["shake_time"], person.hand_lag
    drifts = flight["drift_time"], flight["anchoring_time"]
    return LagShares(*(float(np.exp(-dt / time)) for time in (*lags, *drifts)))


class FlightSetup(NamedTuple):
    """
    What stays the same in all samples; `flight` is a record of FLIGHT, `person` an operator's
    numbers, the leader's position and velocity have shape (N, 3).
    """

    task: Task
    flight: np.void
    position: np.ndarray
    velocity: np.ndarray
    person: Any
    rates: LagShares


class FlightState(NamedTuple):
    """
    What samples hand on: one record of STATE, the noise of sensing, of the hand and of decisions,
    and performance in each sample.
    """

    now: np.ndarray
    sensing: np.random.Generator
    hand: np.random.Generator
    choices: np.random.Generator
    z_r: np.ndarray
    z_h: np.ndarray


@inner(_nrt=False)
def sense(k, setup, state, log):
    """Come to the pause of sample k: see the leader, move the hand, measure performance."""
    task, flight = setup.task, setup.flight
    now, row = state.now[0], log[k]
    row.robot_x = now.x
    row.robot_y = now.y
    row.reference_x = setup.position[k, 0]
    row.reference_y = setup.position[k, 1]
    off_x, off_y = row.reference_x - now.x, row.reference_y - now.y
    row.path_error = np.sqrt(off_x * off_x + off_y * off_y)
    row.u_i_x = setup.velocity[k, 0] + flight.gain * off_x
    row.u_i_y = setup.velocity[k, 1] + flight.gain * off_y
    seen = log[max(k - round(setup.person.delay / task.sample_time), 0)]
    operate(task, setup.person, flight, setup.rates, seen, row, now, state.hand)
    state.z_r[k] = 1.0 - row.path_error / task.e_max  # Section 2.4.2, P_r
    deviation = abs(row.u_i_x - row.u_h_x) + abs(row.u_i_y - row.u_h_y)
    state.z_h[k] = 1.0 - deviation / flight.u_max  # Section 2.4.2, P_h
    measure(task, k, state.z_r, state.z_h, now)


@njit(_nrt=False)
def follow(first, stop, setup, state, inputs, log):
    """
    Follow the leader, as a kernel of `Simulation`.

    setup: a `FlightSetup`. state: a `FlightState`. inputs, log: records of INPUT and of LOG.
    """
    task, person = setup.task, setup.person
    now, dt = state.now[0], task.sample_time
    if stop == 0:
        now.x = setup.position[0, 0]
        now.y = setup.position[0, 1]
        now.v_x = setup.velocity[0, 0]
        now.v_y = setup.velocity[0, 1]
        now.hand_x, now.hand_y = now.v_x, now.v_y
        now.wander_x, now.wander_y = state.hand.standard_normal(), state.hand.standard_normal()
        begin(task, person, now, state.choices)
        sense(0, setup, state, log)
    for k in range(first, stop):
        allocate(task, person, inputs[k], k * dt, now, state.choices)
        row = log[k]
        row.mode = now.mode
        row.suggested_mode = now.suggested
        row.r = now.r
        row.p_r = now.p_r
        row.p_h = now.p_h
        row.tsc = now.tsc
        detect(setup.flight, setup.rates, now, state.sensing)
        fly(setup.flight, dt, row, now)
        now.r = min(max(next_utilization(now.r, now.mode, person.a), 0.0), 1.0)  # (2.5)
        if k + 1 < log.size:
            sense(k + 1, setup, state, log)
    return stop, -1
