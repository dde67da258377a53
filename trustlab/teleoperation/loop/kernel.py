"""
The whole teleoperation loop (Fig. 3.1), compiled: `run_loop` is a plain loop over `loop_step`.

A step takes one record of INPUT, changes one record of STATE and fills one record of LOG. Whatever is delayed (pictures, waves,
performance that leaves its window) is looked up by `run_loop`, so that a step needs no history. Records are passed as plain
pointers, whereas every array that a compiled function is given costs two atomic reference counts a call: with arrays
as arguments this loop is three times slower.
"""

from typing import NamedTuple

import numpy as np

from trustlab.allocation.blending import best_share
from trustlab.models.compiled import njit
from trustlab.models.trust import logistic_scale, trust_step
from trustlab.teleoperation.loop.schemes import LOGISTIC, MANUAL, OPERATOR, OPTIMAL, STEP
from trustlab.teleoperation.ports import device as haptic, guidance, waves
from trustlab.teleoperation.ports.ledger import read_wave
from trustlab.teleoperation.records import columns_of, record

BLOCKS = ("haptic device", "channel", "robot")

LOG = record(
    vectors="reference robot velocity device device_velocity r_m f_h f_m r_s f_s u_h u_a u_i",
    numbers=(
        "alpha beta p_r p_h trust_hr trust_rh path_error port_share "
        "energy_operator energy_device energy_dissipated energy_channel energy_robot"
    ),
)
"""A row of the log: the state before the sample and the signals of the sample."""

COLUMNS = columns_of(LOG)

INPUT = record(vectors="reference reference_velocity motor pushed", numbers="alpha", flags="detected")
"""
What comes from outside in one sample: where the robot should be and how fast it should move, noise of the hand, a force
added to the hand's, α where it is given (NaN elsewhere), and whether the controller's camera finds its target.
"""

# The state proper: device, vehicle, lagging wish of the hand, integral of the controller, sums of performance over the
# window, trust as a share of its range, samples since the operator last moved α, energies.
KEPT = "device device_velocity wish integral position velocity acceleration command"
# What has arrived by now, set before each step: the error in the picture of operator and camera (and in the picture before),
# the command where no force comes back, waves, and the performance that leaves the window.
ARRIVED = "seen seen_before filmed filmed_before arrived v_l v_r"
# What the parts of a step tell each other and later samples.
SIGNALS = "error u_l u_r force free_output free_velocity port_velocity guiding"
STATE = record(
    vectors=f"{KEPT} {ARRIVED} {SIGNALS}",
    numbers=(
        "alpha beta p_r p_h sum_r sum_h trust_hr trust_rh good_r good_h leaving_r leaving_h "
        "energy_operator energy_dissipated energy_channel energy_robot"
    ),
    counts="waited samples",
    flags="sees finds found_before",
)
"""What a step reads and leaves."""

VEHICLE = np.dtype([("phi", float, (3, 3, 3)), ("gamma", float, (3, 3))])
"""Exact one-sample matrices of (position, velocity, acceleration) per axis."""


class ScaleNumbers(NamedTuple):
    """A scale as a function of trust, (3.5) or (3.6), trust being a share of its range."""

    low: float
    high: float
    steepness: float
    midpoint: float


class TrustNumbers(NamedTuple):
    """A `TrustModel` for one sample time; `start` is a share of the range of trust, `gain` is b/a."""

    decay: float
    gain: float
    start: float
    p_min: float
    p_max: float
    t_min: float
    t_max: float


class LoopNumbers(NamedTuple):
    """Device, channel, guidance, trust and scales as plain numbers; see `LoopSettings`."""

    sample_time: float
    mass: float
    damping: float
    stiffness: float
    weight: float
    force_scaling: float
    b: float
    gain: float
    guidance: float
    alpha: ScaleNumbers
    beta: ScaleNumbers
    trust_hr: TrustNumbers
    trust_rh: TrustNumbers
    window: int
    command_range: float
    error_range: float


class HandNumbers(NamedTuple):
    """The simulated hand and eye: gains on the error seen, delay in samples, lag, impedance, and handling of α."""

    proportional: float
    derivative: float
    delay: int
    decay: float
    reach: float
    stiffness: float
    damping: float
    noise: float
    shift: float
    patience: int


class AutonomyNumbers(NamedTuple):
    """The autonomous controller (PID on what the camera saw `delay` samples ago) and the ideal one."""

    proportional: float
    integral: float
    derivative: float
    delay: int
    reach: float
    ideal: float


class Setup(NamedTuple):
    """The scheme and the variants of the channel, as the constants of `schemes`, `ledger` and `passivity`."""

    allocation: int
    bilateral: bool
    direct: bool
    read_out: int
    guard: int


class Blocks(NamedTuple):
    """The ports, with the coefficients of their equations."""

    device: haptic.Device
    operator: waves.OperatorEnd
    robot: waves.RobotEnd


@njit(error_model="numpy", forceinline=True)
def scale(numbers, trust, step):
    """Return (3.5), or (3.6) where `step`, at a trust that is a share of its range."""
    if step:
        return numbers.low if trust >= numbers.midpoint else numbers.high
    return logistic_scale(numbers.low, numbers.high, numbers.steepness, numbers.midpoint, trust)


@njit(error_model="numpy", forceinline=True)
def clip(value, reach):
    """Return value within ± reach."""
    return min(max(value, -reach), reach)


@njit(error_model="numpy", forceinline=True)
def steer(n, auto, now, state, row):
    """Set the tracking error, the ideal command u_i and the autonomous one u_a."""
    for i in range(3):
        state.error[i] = now.reference[i] - state.position[i]
        row.u_i[i] = now.reference_velocity[i] + auto.ideal * state.error[i]
        row.u_a[i] = 0.0  # a vehicle that has lost its target hovers
        if state.finds:
            rate = 0.0
            if state.found_before:
                rate = (state.filmed[i] - state.filmed_before[i]) / n.sample_time
            wanted = auto.proportional * state.filmed[i] + auto.derivative * rate
            summed = state.integral[i] + n.sample_time * state.filmed[i]
            # anti-windup: the integral rests while the command is at its limit
            if abs(wanted + auto.integral * summed) < auto.reach:
                state.integral[i] = summed
            row.u_a[i] = clip(wanted + auto.integral * state.integral[i], auto.reach)


@njit(error_model="numpy", forceinline=True)
def allocate(setup, n, hand, now, blend, state, row):
    """Set the scales α and β from what was measured up to the sample before."""
    allocation = setup.allocation
    if not np.isnan(now.alpha):
        state.alpha = now.alpha
    elif allocation == MANUAL:
        state.alpha = n.alpha.high
    elif allocation == OPERATOR:
        state.waited += 1
        if state.waited >= hand.patience:
            state.waited = 0
            state.alpha += hand.shift if state.p_h > state.p_r else -hand.shift
            state.alpha = min(max(state.alpha, n.alpha.low), n.alpha.high)
    elif allocation == OPTIMAL:
        ahead = np.empty((3, 5))
        for i in range(3):
            ahead[i] = (
                state.command[i] / state.alpha,
                row.u_a[i],
                state.error[i],
                now.reference_velocity[i] - state.velocity[i],
                -state.acceleration[i],
            )
        state.alpha = best_share(blend, ahead, n.alpha.low, n.alpha.high)[0]
    else:
        state.alpha = scale(n.alpha, state.trust_hr, allocation == STEP)
    state.beta = n.beta.high
    if allocation in (LOGISTIC, STEP):
        state.beta = scale(n.beta, state.trust_rh, allocation == STEP)


@njit(error_model="numpy", forceinline=True)
def reach_out(n, hand, device, now, state):
    """Set the hand's force from what it sees, and the output that the device would have without feedback."""
    for i in range(3):
        wanted = 0.0
        if state.sees:
            rate = (state.seen[i] - state.seen_before[i]) / n.sample_time
            wanted = clip(hand.proportional * state.seen[i] + hand.derivative * rate, hand.reach)
        state.wish[i] = hand.decay * state.wish[i] + (1.0 - hand.decay) * wanted
        goal = state.wish[i] / n.weight  # where the device's output is the wish, r_m = Λ x
        shaking = hand.noise * now.motor[i] * (1.0 + abs(state.wish[i]))
        state.force[i] = device.held_stiffness * goal + shaking + now.pushed[i]
        state.free_output[i] = haptic.free_output(device, state.device[i], state.device_velocity[i], state.force[i])


@njit(error_model="numpy", forceinline=True)
def send_one_way(setup, state, row):
    """Send the device's output to a robot from which no force comes back."""
    for i in range(3):
        row.r_m[i], row.f_m[i], row.f_s[i] = state.free_output[i], 0.0, 0.0
        row.r_s[i] = state.alpha * (row.r_m[i] if setup.direct else state.arrived[i])
    row.port_share = 1.0


@njit(error_model="numpy", forceinline=True)
def exchange(setup, n, blocks, state, row):
    """
    Solve both ends of the channel, each with the port behind it.

    The robot's velocity is r_s = α (free − compliance f_s): the free part is what arrives, and the port yields to the
    force. Without a channel in between (`direct`), both ends are one system of equations, solved in closed form.
    """
    operator, robot, b = blocks.operator, blocks.robot, blocks.operator.b
    alpha, beta = state.alpha, state.beta
    # the device's port: r_m = free_output − admittance f_m with f_m = β (b r_m + arriving v_l)
    admittance = n.force_scaling * blocks.device.lever / blocks.device.inertia
    loaded = 1.0 + admittance * beta * b
    through = admittance * beta * operator.arriving / loaded
    compliance = 1.0 / b
    echo = 0.0  # what of a wave sent back comes again, without a channel in between
    if setup.direct:
        echo = operator.reflected - operator.sent * through
        compliance = (1.0 - robot.arriving * echo * robot.sent / (1.0 + robot.reflected * echo)) / b
        for i in range(3):
            straight = robot.arriving * operator.sent * state.free_output[i] / loaded
            state.free_velocity[i] = straight / (b * (1.0 + robot.reflected * echo))
    else:
        for i in range(3):
            state.free_velocity[i] = robot.arriving * state.v_r[i] / b
    for i in range(3):
        state.guiding[i] = guidance.guiding_force(n.guidance, state.error[i])
        state.port_velocity[i] = alpha * (state.free_velocity[i] - compliance * state.guiding[i])
    share = guidance.velocity_share(
        setup.guard, state.energy_robot, state.port_velocity, state.guiding, alpha * compliance, n.sample_time
    )
    for i in range(3):
        row.r_s[i], row.f_s[i] = state.port_velocity[i], state.guiding[i]
        if share < 1.0:
            row.r_s[i] = share * state.port_velocity[i]
            row.f_s[i] = (state.free_velocity[i] - row.r_s[i] / alpha) / compliance
        if setup.direct:
            straight = operator.sent * state.free_output[i] / loaded + echo * robot.sent * row.f_s[i]
            state.v_r[i] = straight / (1.0 + robot.reflected * echo)
            state.v_l[i] = waves.robot_wave(robot, row.f_s[i], state.v_r[i])
        row.r_m[i] = state.free_output[i] / loaded - through * state.v_l[i]
        row.f_m[i] = beta * waves.operator_force(operator, row.r_m[i], state.v_l[i])
        state.u_l[i] = waves.operator_wave(operator, row.r_m[i], state.v_l[i])
        state.u_r[i] = waves.robot_wave(robot, row.f_s[i], state.v_r[i])
    row.port_share = share


@njit(error_model="numpy", forceinline=True)
def move(n, hand, blocks, vehicle, now, state, row):
    """Step device and vehicle, and book the energy of every port; return storage and sizes that show divergence."""
    T, device, phi, gamma = n.sample_time, blocks.device, vehicle.phi, vehicle.gamma
    stored = near = far = 0.0
    for i in range(3):
        x, v = state.device[i], state.device_velocity[i]
        v_middle = haptic.midpoint_velocity(device, x, v, state.force[i], n.force_scaling * row.f_m[i])
        x_middle = x + 0.5 * T * v_middle
        row.f_h[i] = state.force[i] - hand.stiffness * x_middle - hand.damping * v_middle
        state.energy_operator += T * row.r_m[i] * row.f_h[i] / n.force_scaling
        state.energy_channel += T * (row.r_m[i] * row.f_m[i] - row.r_s[i] * row.f_s[i])
        state.energy_robot += T * row.r_s[i] * row.f_s[i]
        state.energy_dissipated += T / n.force_scaling * haptic.device_loss(device, x_middle, v_middle)
        row.u_h[i] = row.r_s[i] / state.alpha
        row.reference[i] = now.reference[i]
        row.robot[i], row.velocity[i] = state.position[i], state.velocity[i]
        row.device[i], row.device_velocity[i] = x, v
        state.device[i] = x + T * v_middle
        state.device_velocity[i] = 2.0 * v_middle - v
        stored += haptic.device_storage(device, state.device[i], state.device_velocity[i]) / n.force_scaling
        command = row.r_s[i] + (1.0 - state.alpha) * row.u_a[i]
        s, w, a = state.position[i], state.velocity[i], state.acceleration[i]
        state.position[i] = phi[i, 0, 0] * s + phi[i, 0, 1] * w + phi[i, 0, 2] * a + gamma[i, 0] * command
        state.velocity[i] = phi[i, 1, 0] * s + phi[i, 1, 1] * w + phi[i, 1, 2] * a + gamma[i, 1] * command
        state.acceleration[i] = phi[i, 2, 0] * s + phi[i, 2, 1] * w + phi[i, 2, 2] * a + gamma[i, 2] * command
        state.command[i] = row.r_s[i]
        near += row.r_m[i] ** 2 + row.f_m[i] ** 2
        far += abs(state.position[i]) + abs(state.velocity[i])
    return stored, near, far


@njit(error_model="numpy", forceinline=True)
def performance(n, miss, share, size):
    """Return (3.27) of one partner: its command's distance from the ideal one, and its share of the tracking error."""
    return max(1.0 - miss / n.command_range, 0.0) * max(1.0 - share * size / n.error_range, 0.0)


@njit(error_model="numpy", forceinline=True)
def next_trust(trust, model, p):
    """Return trust one sample later for a performance in its own unit; performance beyond its range counts as at its end."""
    share = min(max((p - model.p_min) / (model.p_max - model.p_min), 0.0), 1.0)
    return trust_step(trust, share, model.decay, model.gain)


@njit(error_model="numpy", forceinline=True)
def judge(n, state, row):
    """Take performance (3.26)-(3.27) over the window, log it with the trust that it found, and update trust (3.2)-(3.3)."""
    size = miss_h = miss_r = square = 0.0
    for i in range(3):
        size += abs(state.error[i])
        square += state.error[i] ** 2
        miss_h += abs(row.u_h[i] - row.u_i[i])
        miss_r += abs(row.u_a[i] - row.u_i[i])
    state.good_r = performance(n, miss_r, 1.0 - state.alpha, size)
    state.good_h = performance(n, miss_h, state.alpha, size)
    state.sum_r += state.good_r
    state.sum_h += state.good_h
    state.sum_r -= state.leaving_r
    state.sum_h -= state.leaving_h
    # sums of differences may end a rounding error below zero
    state.p_r, state.p_h = max(state.sum_r / state.samples, 0.0), max(state.sum_h / state.samples, 0.0)
    row.alpha, row.beta, row.p_r, row.p_h = state.alpha, state.beta, state.p_r, state.p_h
    row.trust_hr = n.trust_hr.t_min + (n.trust_hr.t_max - n.trust_hr.t_min) * state.trust_hr
    row.trust_rh = n.trust_rh.t_min + (n.trust_rh.t_max - n.trust_rh.t_min) * state.trust_rh
    row.path_error = np.sqrt(square)
    state.trust_hr = next_trust(state.trust_hr, n.trust_hr, state.p_r)
    state.trust_rh = next_trust(state.trust_rh, n.trust_rh, state.p_h)


@njit(error_model="numpy", forceinline=True)
def loop_step(setup, n, hand, auto, blocks, vehicle, blend, now, state, row):
    """Do one sample: change `state`, fill `row`, and return the block that diverged, −1 when none did."""
    steer(n, auto, now, state, row)
    allocate(setup, n, hand, now, blend, state, row)
    reach_out(n, hand, blocks.device, now, state)
    if setup.bilateral:
        exchange(setup, n, blocks, state, row)
    else:
        send_one_way(setup, state, row)
    stored, near, far = move(n, hand, blocks, vehicle, now, state, row)
    judge(n, state, row)
    row.energy_operator, row.energy_device = state.energy_operator, stored
    row.energy_dissipated, row.energy_channel = state.energy_dissipated, state.energy_channel
    row.energy_robot = state.energy_robot
    # written as "not <", so that NaN counts as diverged
    if not stored < 1e9:
        return 0
    if not near < 1e18:
        return 1
    if not far < 1e9:
        return 2
    return -1


@njit(error_model="numpy")
def run_loop(setup, n, hand, auto, vehicle, blend, inputs, delays, arrives, accounts, states, log):
    """
    Run the loop over all inputs, one record of `log` per sample.

    inputs, shape (N,): records of INPUT. delays, arrives, shape (2, N): delay in samples, and whether the wave sent in a sample
    arrives at all. vehicle, states, shape (1,): a record of VEHICLE, and one of STATE, zero at the start. blend, shape
    (3, M, 5, 5): `OptimalBlending.weights`, which set α in scheme OMI. accounts: `ledger.accounts()`. Returns the samples done
    and the block that diverged (−1: none).
    """
    count, state, T = log.shape[0], states[0], n.sample_time
    device = haptic.held_device(n.mass, n.damping, n.stiffness, n.weight, hand.stiffness, hand.damping, T)
    blocks = Blocks(
        device, waves.operator_end(n.b, n.beta.low, n.beta.high), waves.robot_end(n.b, n.alpha.low, n.alpha.high)
    )
    error, sent = np.zeros((count, 3)), np.zeros((count, 3))
    u_l, u_r = np.zeros((count, 3)), np.zeros((count, 3))
    good_r, good_h = np.zeros(count), np.zeros(count)
    state.alpha, state.beta = n.alpha.high, n.beta.high
    state.trust_hr, state.trust_rh = n.trust_hr.start, n.trust_rh.start
    for i in range(3):
        state.position[i] = inputs[0].reference[i]
    for k in range(count):
        view, camera = k - hand.delay, k - auto.delay
        state.sees, state.finds = view >= 1, camera >= 1 and inputs[camera].detected
        state.found_before = state.finds and inputs[camera - 1].detected
        for i in range(3):
            if state.sees:
                state.seen[i], state.seen_before[i] = error[view, i], error[view - 1, i]
            if state.finds:
                state.filmed[i], state.filmed_before[i] = error[camera, i], error[camera - 1, i]
        if not setup.direct and setup.bilateral:
            read_wave(u_l, arrives[0], k, delays[0, k], n.gain, setup.read_out, T, accounts[0], state.v_r)
            read_wave(u_r, arrives[1], k, delays[1, k], n.gain, setup.read_out, T, accounts[1], state.v_l)
        elif not setup.direct:
            where = k - delays[0, k]
            first = int(np.floor(where))
            for i in range(3):
                if first >= 0:
                    later = sent[min(first + 1, k - 1), i]
                    state.arrived[i] = sent[first, i] + (where - first) * (later - sent[first, i])
        state.samples = min(k + 1, n.window)
        if k >= n.window:
            state.leaving_r, state.leaving_h = good_r[k - n.window], good_h[k - n.window]
        fault = loop_step(setup, n, hand, auto, blocks, vehicle[0], blend, inputs[k], state, log[k])
        good_r[k], good_h[k] = state.good_r, state.good_h
        for i in range(3):
            error[k, i], sent[k, i] = state.error[i], log[k].r_m[i]
            u_l[k, i], u_r[k, i] = state.u_l[i], state.u_r[i]
        if fault >= 0:
            return k + 1, fault
    return count, -1
