"""
The whole teleoperation loop (Fig. 3.1), compiled: `advance` does one sample after another.

A sample changes one record of STATE, of which the first part is the row of the log. Whatever is
delayed (pictures, waves, performance that leaves its window) is looked up here, so that the parts
need no history. Records are passed as plain pointers, whereas every array that a compiled function
is given costs two atomic reference counts a call: with arrays as arguments this loop is three times
slower. `advance` and `read_wave`, which need arrays, do without counts (_nrt=False): they allocate
nothing, and their caller keeps what they are given.
"""

import numpy as np

from trustlab.models.compiled import njit
from trustlab.teleoperation.loop.guidance import DIRECT, PACKETS, SIGNALS, WAVES
from trustlab.teleoperation.loop.parts import call
from trustlab.teleoperation.loop.state import PORTS
from trustlab.teleoperation.ports import device as haptic
from trustlab.teleoperation.ports.ledger import read_wave

# How a run ends: well, a block diverged, or a part raised an error or returned what cannot be.
DONE, DEVICE, CHANNEL, ROBOT, SCHEME, TRUST, FEEDBACK, AUTONOMY, OPERATOR, VEHICLE = range(-1, 9)

# Names of the blocks and parts, by these numbers.
BLOCKS = ("haptic device", "channel", "robot", *PORTS)

SLACK = 1e-12


@njit(error_model="numpy", forceinline=True)
def finite(vector):
    """Return whether three numbers are finite."""
    return np.isfinite(vector[0]) and np.isfinite(vector[1]) and np.isfinite(vector[2])


@njit(error_model="numpy", forceinline=True)
def within(share, low, high):
    """Return whether a scale is within its bounds, up to rounding."""
    return low * (1.0 - SLACK) <= share <= high * (1.0 + SLACK)


@njit(error_model="numpy", forceinline=True)
def newest_packet(arrives, k, delay, account):
    """Return the number of the newest packet that has arrived by sample k, −1 before the first."""
    while account.unbooked <= k - delay:
        if arrives[account.unbooked]:
            account.latest = account.unbooked
        account.unbooked += 1
    return int(account.latest)


@njit(error_model="numpy", forceinline=True)
def receive(k, setup, delays, arrives, accounts, history, sent, log, state):
    """Set what comes out of the channel in sample k."""
    if setup.channel == DIRECT:
        return
    if setup.channel != SIGNALS:
        far = newest_packet(arrives[0], k, delays[0, k], accounts[2])
        near = newest_packet(arrives[1], k, delays[1, k], accounts[3])
        state.known_near = history[far].in_near if far >= 0 else 0.0
        state.known_far = history[near].in_far if near >= 0 else 0.0
    if setup.channel == WAVES:
        gain = setup.loop.gain
        read_out = setup.read_out
        T = state.sample_time
        read_wave(sent[0], arrives[0], k, delays[0, k], gain, read_out, T, accounts[0], state.v_r)
        read_wave(sent[1], arrives[1], k, delays[1, k], gain, read_out, T, accounts[1], state.v_l)
    elif setup.channel == PACKETS:
        for i in range(3):
            if far >= 0:
                state.arrived[i] = log[far].r_m[i]
            if near >= 0:
                state.packet_force[i] = log[near].f_s[i]
    else:
        where = k - delays[0, k]
        first = int(np.floor(where))
        for i in range(3):
            if first >= 0:
                value, later = log[first].r_m[i], log[min(first + 1, k - 1)].r_m[i]
                state.arrived[i] = value + (where - first) * (later - value)


@njit(error_model="numpy", forceinline=True)
def pictured(error, widest):
    """Return whether the target is in the camera's picture, x and y seen from above."""
    return abs(error[0]) <= widest and abs(error[1]) <= widest


@njit(error_model="numpy", forceinline=True)
def look_up(k, setup, inputs, history, state):
    """
    Set what sample k begins with: the target, the pictures of camera and operator, and the
    performance that leaves.
    """
    now = inputs[k]
    state.t = k * state.sample_time
    view, camera = k - setup.hand.delay, k - setup.auto.delay
    widest = setup.auto.picture
    state.sees = view >= 1 and pictured(history[view].error, widest)
    state.finds = (
        camera >= 1 and inputs[camera].detected and pictured(history[camera].error, widest)
    )
    before = camera - 1
    state.found_before = (
        state.finds and inputs[before].detected and pictured(history[before].error, widest)
    )
    square = 0.0
    for i in range(3):
        state.reference[i], state.reference_velocity[i] = (
            now.reference[i],
            now.reference_velocity[i],
        )
        state.pushed[i] = now.pushed[i]
        state.motor[i] = now.motor[i]
        state.hand[i] = now.hand[i]
        state.error[i] = now.reference[i] - state.robot[i]
        square += state.error[i] ** 2
        history[k].error[i] = state.error[i]
        if state.sees:  # else the operator remembers where the target was last seen
            state.seen[i] = history[view].error[i] + inputs[view].ahead[i]
            state.seen_before[i] = history[view - 1].error[i] + inputs[view - 1].ahead[i]
        if camera >= 1:
            state.picture[i], state.picture_before[i] = (
                history[camera].error[i],
                history[camera - 1].error[i],
            )
    state.path_error = np.sqrt(square)
    state.samples = min(k + 1, setup.loop.window)
    if k >= setup.loop.window:
        old = history[k - setup.loop.window]
        state.leaving_r, state.leaving_h = old.good_r, old.good_h


@njit(error_model="numpy", forceinline=True)
def reach_out(setup, state):
    """Set the hand's force, and the output that the device would have without feedback."""
    hand, given = setup.hand, not np.isnan(state.hand[0])
    for i in range(3):
        device = axis(setup.device, i)
        if given:
            state.wish[i] = device.weight * state.hand[i]
        else:
            state.wish[i] = hand.decay * state.wish[i] + (1.0 - hand.decay) * state.wanted[i]
        goal = state.wish[i] / device.weight  # where the device's output is the wish, r_m = Λ x
        shaking = hand.noise * state.motor[i] * (1.0 + abs(state.wish[i]))
        state.force[i] = device.held_stiffness * goal + shaking + state.pushed[i]
        state.free_output[i] = haptic.free_output(
            device, state.device[i], state.device_velocity[i], state.force[i]
        )


@njit(error_model="numpy", forceinline=True)
def axis(d, i):
    """Return one axis of the device."""
    return haptic.Device(
        d.sample_time[i],
        d.mass[i],
        d.damping[i],
        d.stiffness[i],
        d.weight[i],
        d.held_stiffness[i],
        d.inertia[i],
        d.lever[i],
        d.spare[i],
    )


@njit(error_model="numpy", forceinline=True)
def book(setup, state):
    """
    Book the energy of every port and set the robot's command; return whether device and channel are
    bounded.
    """
    T = state.sample_time
    scaling = setup.loop.force_scaling
    near = 0.0
    state.energy_device = 0.0
    for i in range(3):
        device = axis(setup.device, i)
        x = state.device[i]
        v = state.device_velocity[i]
        v_middle = haptic.midpoint_velocity(device, x, v, state.force[i], scaling * state.f_m[i])
        x_middle = x + 0.5 * T * v_middle
        state.middle[i] = v_middle
        state.f_h[i] = (
            state.force[i] - setup.hand.stiffness * x_middle - setup.hand.damping * v_middle
        )
        state.energy_operator += T * state.r_m[i] * state.f_h[i] / scaling
        state.energy_port += T * state.r_m[i] * state.f_m[i]
        state.energy_channel += T * (state.r_m[i] * state.f_m[i] - state.r_s[i] * state.f_s[i])
        state.energy_robot += T * state.r_s[i] * state.f_s[i]
        state.energy_target -= T * state.pull[i] * state.reference_velocity[i]
        state.energy_dissipated += T / scaling * haptic.device_loss(device, x_middle, v_middle)
        after_x, after_v = x + T * v_middle, 2.0 * v_middle - v
        state.energy_device += haptic.device_storage(device, after_x, after_v) / scaling
        state.u_h[i] = state.r_s[i] / state.alpha
        state.command[i] = state.r_s[i] + (1.0 - state.alpha) * state.u_a[i]
        near += state.r_m[i] ** 2 + state.f_m[i] ** 2
    return near


@njit(error_model="numpy", forceinline=True)
def performance(n, miss, share, size):
    """
    Return (3.27) of one partner: its command's distance from the ideal one, and its share of the
    tracking error.
    """
    return max(1.0 - miss / n.command_range, 0.0) * max(1.0 - share * size / n.error_range, 0.0)


@njit(error_model="numpy", forceinline=True)
def judge(n, state):
    """Take performance (3.26)-(3.27) over the window."""
    size = miss_h = miss_r = 0.0
    for i in range(3):
        size += abs(state.error[i])
        miss_h += abs(state.u_h[i] - state.u_i[i])
        miss_r += abs(state.u_a[i] - state.u_i[i])
    state.good_r = performance(n, miss_r, 1.0 - state.alpha, size)
    state.good_h = performance(n, miss_h, state.alpha, size)
    state.sum_r += state.good_r
    state.sum_h += state.good_h
    state.sum_r -= state.leaving_r
    state.sum_h -= state.leaving_h
    # sums of differences may end a rounding error below zero
    state.p_r, state.p_h = (
        max(state.sum_r / state.samples, 0.0),
        max(state.sum_h / state.samples, 0.0),
    )


@njit(error_model="numpy", forceinline=True)
def decide(setup, alpha, state):
    """
    Let autonomy, scheme and operator decide; return the part that failed, DONE where none did. α
    may be given.
    """
    parts = setup.parts
    for i in range(3):
        state.u_i[i] = (
            state.reference_velocity[i] + state.error[i]
        )  # the ideal controller has the gain 1/s
    call(parts.autonomy, state, setup)
    if state.raised or not finite(state.u_a):
        return AUTONOMY
    call(parts.scheme, state, setup)
    if not np.isnan(alpha):
        state.alpha = alpha
    bounded = within(state.alpha, state.alpha_min, state.alpha_max)
    if state.raised or not (bounded and within(state.beta, state.beta_min, state.beta_max)):
        return SCHEME
    call(parts.operator, state, setup)
    if state.raised or not finite(state.wanted):
        return OPERATOR
    return DONE


@njit(error_model="numpy", forceinline=True)
def keep(k, state, history, sent):
    """Keep what later samples look up."""
    old = history[k]
    old.good_r = state.good_r
    old.good_h = state.good_h
    old.in_near = state.in_near
    old.in_far = state.in_far
    for i in range(3):
        sent[0, k, i], sent[1, k, i] = state.u_l[i], state.u_r[i]


@njit(error_model="numpy", forceinline=True)
def act(setup, state):
    """Step device, vehicle and trust; return the block or part that failed, DONE where none did."""
    for i in range(3):
        state.device[i] += state.sample_time * state.middle[i]
        state.device_velocity[i] = 2.0 * state.middle[i] - state.device_velocity[i]
    call(setup.parts.vehicle, state, setup)
    far = 0.0
    for i in range(3):
        far += abs(state.robot[i]) + abs(state.velocity[i])
    if state.raised or not np.isfinite(far):
        return VEHICLE
    if far >= 1e9:
        return ROBOT
    call(setup.parts.trust, state, setup)
    if state.raised or not np.isfinite(state.trust_hr + state.trust_rh):
        return TRUST
    return DONE


@njit(error_model="numpy", _nrt=False)
def advance(
    start, stop, setups, states, row, inputs, delays, arrives, accounts, history, sent, log, table
):
    """
    Do the samples from `start` to before `stop`; return the samples done and how the run ended.

    setups, states, shape (1,): records of SETUP and STATE. row: the state's part that is logged, as
    numbers. inputs, history, log, shape (N,): records of INPUT, HISTORY and LOG. sent, shape (2, N,
    3): waves by the sample that they were sent in, to the robot and back. table: the log as
    numbers. delays, arrives, shape (2, N): delay in samples, and whether what is sent in a sample
    arrives at all. accounts: `ledger.accounts()` for waves, and again for packets of energy.
    """
    setup, state = setups[0], states[0]
    if start == 0:
        for i in range(3):
            state.robot[i] = inputs[0].reference[i]
    for k in range(start, stop):
        look_up(k, setup, inputs, history, state)
        receive(k, setup, delays, arrives, accounts, history, sent, log, state)
        failed = decide(setup, inputs[k].alpha, state)
        if failed != DONE:
            return k, failed
        reach_out(setup, state)
        call(setup.parts.guidance, state, setup)
        if state.raised or not finite(state.guiding):
            return k, FEEDBACK
        near = book(setup, state)
        judge(setup.loop, state)
        for i in range(row.size):
            table[k, i] = row[i]
        keep(k, state, history, sent)
        # written as "not <", so that NaN counts as diverged
        if not state.energy_device < 1e9:
            return k + 1, DEVICE
        if not near < 1e18:
            return k + 1, CHANNEL
        failed = act(setup, state)
        if failed != DONE:
            return k + 1, failed
    return stop, DONE
