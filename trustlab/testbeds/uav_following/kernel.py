"""
The loop of the UAV that follows a leader: one step of operator, allocation, autopilot and vehicle
every tenth of a second.
"""

from typing import NamedTuple

import numpy as np

from trustlab.models.compiled import njit
from trustlab.models.tsc import next_utilization
from trustlab.teleoperation.records import record
from trustlab.testbeds.deciding import COUNTS, FLAGS, NUMBERS, allocate, begin, measure, skill_now

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


@njit
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


@njit
def noise(before, keep, rng):
    """Return the next value of coloured noise of unit variance."""
    return keep * before + np.sqrt(1.0 - keep * keep) * rng.standard_normal()


@njit
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


@njit
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


@njit
def moved(flight, v, a, u):
    """Return velocity and acceleration on one axis one sample later, the command held."""
    return (
        flight.v_v * v + flight.v_a * a + flight.v_u * u,
        flight.a_v * v + flight.a_a * a + flight.a_u * u,
    )


@njit
def fly(flight, dt, row, state):
    """Move the vehicle by one sample under the operator's command or the autopilot's."""
    manual = state.mode == 1
    u_x = row.u_h_x if manual else row.u_i_x + flight.gain * state.drift_x
    u_y = row.u_h_y if manual else row.u_i_y + flight.gain * state.drift_y
    state.x, state.y = state.x + dt * state.v_x, state.y + dt * state.v_y
    state.v_x, state.a_x = moved(flight, state.v_x, state.a_x, u_x)
    state.v_y, state.a_y = moved(flight, state.v_y, state.a_y, u_y)


@njit(_nrt=False)
def follow(
    task,
    schedule,
    flight,
    position,
    velocity,
    person,
    sensing,
    hand,
    decision_rng,
    states,
    log,
    z_r,
    z_h,
):
    """
    Fill the records of `log` behind a leader at `position` with `velocity`, both of shape (N, 3).

    schedule, shape (N,): modes, used by the scheme SCHEDULE alone. person: numbers of an
    `Operator`. sensing, hand, decision_rng: generators of noise. states, shape (1,): a record of
    STATE. z_r, z_h, shape (N,): room for momentary performance.
    """
    dt, state = task.sample_time, states[0]
    delay = round(person.delay / dt)
    rates = LagShares(
        np.exp(-dt / flight.wander_time),
        np.exp(-dt / flight.shake_time),
        np.exp(-dt / person.hand_lag),
        np.exp(-dt / flight.drift_time),
        np.exp(-dt / flight.anchoring_time),
    )
    state.x = position[0, 0]
    state.y = position[0, 1]
    state.v_x = velocity[0, 0]
    state.v_y = velocity[0, 1]
    state.hand_x, state.hand_y = state.v_x, state.v_y
    state.wander_x, state.wander_y = hand.standard_normal(), hand.standard_normal()
    begin(task, person, state, decision_rng)
    for k in range(log.size):
        t, row = k * dt, log[k]
        row.robot_x = state.x
        row.robot_y = state.y
        row.reference_x = position[k, 0]
        row.reference_y = position[k, 1]
        off_x, off_y = row.reference_x - state.x, row.reference_y - state.y
        row.path_error = np.sqrt(off_x * off_x + off_y * off_y)
        row.u_i_x = velocity[k, 0] + flight.gain * off_x
        row.u_i_y = velocity[k, 1] + flight.gain * off_y
        operate(task, person, flight, rates, log[max(k - delay, 0)], row, state, hand)
        z_r[k] = 1.0 - row.path_error / task.e_max  # Section 2.4.2, P_r
        deviation = abs(row.u_i_x - row.u_h_x) + abs(row.u_i_y - row.u_h_y)
        z_h[k] = 1.0 - deviation / flight.u_max  # Section 2.4.2, P_h
        measure(task, k, z_r, z_h, state)
        allocate(task, person, schedule[k], t, state, decision_rng)
        row.mode = state.mode
        row.suggested_mode = state.suggested
        row.r = state.r
        row.p_r = state.p_r
        row.p_h = state.p_h
        row.tsc = state.tsc
        detect(flight, rates, state, sensing)
        fly(flight, dt, row, state)
        state.r = min(max(next_utilization(state.r, state.mode, person.a), 0.0), 1.0)  # (2.5)
