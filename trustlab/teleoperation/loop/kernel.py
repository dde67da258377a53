"""
The whole teleoperation loop (Fig. 3.1), compiled: `advance` does one sample after another.

The file follows a sample: what arrives, the built-in parts (autonomy, operator's law, feedback,
vehicle, trust), the hand, the two ways in which guidance reaches the operator, the books of
energy, performance, and `advance`. A sample changes one record of STATE, of which the first part is
the row of the log. Whatever is delayed (pictures, waves, performance that leaves its window) is
looked up here, so that the parts need no history. Records are passed as plain pointers, whereas
every array that a compiled function is given costs two atomic reference counts a call: with arrays
as arguments this loop is three times slower. `advance` and `read_waves`, which need arrays, do
without counts (_nrt=False): they allocate nothing, and their caller keeps what they are given.
"""

import numpy as np

from trustlab.models.compiled import njit
from trustlab.models.trust import trust_step
from trustlab.teleoperation.loop.parts import PORTS, Part, call
from trustlab.teleoperation.ports import device as haptic, waves
from trustlab.teleoperation.ports.ledger import read_waves
from trustlab.teleoperation.ports.passivity import activation, demanded
from trustlab.teleoperation.records import dot

# How a run ends: well, a block diverged, or a part raised an error or returned what cannot be.
DONE, DEVICE, CHANNEL, ROBOT, SCHEME, TRUST, FEEDBACK, AUTONOMY, OPERATOR, VEHICLE = range(-1, 9)

# Names of the blocks and parts, by these numbers.
BLOCKS = ("haptic device", "channel", "robot", *PORTS)

SLACK = 1e-12
# What the channel carries: nothing between the ends, waves, or the device's output alone.
DIRECT = 0
WAVES = 1
SIGNALS = 2

# Speed of the hand [m/s] above which an operator notices what the channel makes of it.
FLOOR = 0.05


# What a sample begins with.


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
    state.t = k * setup.sample_time
    view, camera = k - setup.hand.delay, k - setup.auto.delay
    widest = setup.auto.picture
    state.sees = view >= 1 and pictured(history[view].error, widest)
    shown = camera >= 1 and pictured(history[camera].error, widest)
    state.finds = shown and inputs[camera].detected
    before = camera - 1
    state.found_before = (
        state.finds and inputs[before].detected and pictured(history[before].error, widest)
    )
    for i in range(3):
        state.reference[i] = now.reference[i]
        state.reference_velocity[i] = now.reference_velocity[i]
        state.pushed[i] = now.pushed[i]
        state.motor[i] = now.motor[i]
        state.hand[i] = now.hand[i]
        state.error[i] = now.reference[i] - state.robot[i]
        history[k].error[i] = state.error[i]
        if state.sees:  # else the operator remembers where the target was last seen
            state.seen[i] = history[view].error[i] + inputs[view].ahead[i]
            state.seen_before[i] = history[view - 1].error[i] + inputs[view - 1].ahead[i]
        state.picture[i] = state.picture_before[i] = 0.0  # no force towards what nobody sees
        if shown:
            state.picture[i] = history[camera].error[i]
            state.picture_before[i] = history[camera - 1].error[i]
    state.path_error = np.sqrt(dot(state.error, state.error))
    state.samples = min(k + 1, setup.loop.window)
    if k >= setup.loop.window:
        old = history[k - setup.loop.window]
        state.leaving_r, state.leaving_h = old.good_r, old.good_h


@njit(error_model="numpy", forceinline=True)
def receive(k, setup, delays, arrives, accounts, sent, log, state):
    """Set what comes out of the channel in sample k."""
    if setup.channel == DIRECT:
        return
    if setup.channel == WAVES:
        n, T = setup.loop, setup.sample_time
        kind = setup.read_out
        v_l, v_r = state.v_l, state.v_r
        read_waves(sent[0], sent[1], arrives, k, delays, n.gain, kind, T, accounts, v_l, v_r)
    else:
        where = k - delays[0, k]
        first = int(np.floor(where))
        for i in range(3):
            if first >= 0:
                value, later = log[first].r_m[i], log[min(first + 1, k - 1)].r_m[i]
                state.arrived[i] = value + (where - first) * (later - value)


# Built-in parts.


@njit(error_model="numpy", forceinline=True)
def clip(value, reach):
    """Return value within ± reach."""
    return min(max(value, -reach), reach)


@Part
def controller(state, setup):
    """
    Set u_a by a PID controller on the camera's picture; a vehicle that has lost its target hovers.
    """
    auto = setup.auto
    for i in range(3):
        state.u_a[i] = 0.0
        if state.finds:
            rate = 0.0
            if state.found_before:
                rate = (state.picture[i] - state.picture_before[i]) / setup.sample_time
            command = auto.proportional * state.picture[i] + auto.derivative * rate
            summed = state.integral[i] + setup.sample_time * state.picture[i]
            # anti-windup: the integral rests while the command is at its limit
            if abs(command + auto.integral * summed) < auto.reach:
                state.integral[i] = summed
            state.u_a[i] = clip(command + auto.integral * state.integral[i], auto.reach)


@Part
def proportional_law(state, setup):
    """
    Set the command that the operator wants, in proportion to the error seen and its rate.

    While the target is out of the picture it is looked for where it was last seen.
    """
    hand = setup.hand
    for i in range(3):
        command = hand.proportional * state.seen[i]
        if state.sees:
            command += hand.derivative * (
                (state.seen[i] - state.seen_before[i]) / setup.sample_time
            )
        state.wanted[i] = hand.compensation * clip(command, hand.reach)


@Part
def crossover_law(state, setup):
    """
    Set the command wanted by an operator who keeps the crossover of the whole loop where it was,
    whatever the channel's scale.

    The scale is the ratio of the root mean squares of what the channel gives and takes, which
    delays do not change.
    """
    hand = setup.hand
    memory = state.operator_memory
    memory[0] += hand.learned * (dot(state.r_m, state.r_m) - memory[0])
    memory[1] += hand.learned * (dot(state.r_s, state.r_s) - memory[1])
    scale = np.sqrt((memory[1] + FLOOR**2) / (memory[0] + FLOOR**2))  # 1 until the hand has moved
    for i in range(3):
        state.wanted[i] = (
            hand.compensation * clip(hand.crossover * state.seen[i], hand.reach) / scale
        )


@Part
def spring(state, setup):
    """Set the guiding force −k_ffa e."""
    for i in range(3):
        state.guiding[i] = -setup.loop.guidance * state.stretch[i]


@Part
def linear_vehicle(state, setup):
    """Step the vehicle by its exact matrices, the command being held over the sample."""
    phi, gamma = setup.vehicle.phi, setup.vehicle.gamma
    for i in range(3):
        s = state.robot[i]
        w = state.velocity[i]
        a = state.acceleration[i]
        command = state.command[i]
        state.robot[i] = (
            phi[i, 0, 0] * s + phi[i, 0, 1] * w + phi[i, 0, 2] * a + gamma[i, 0] * command
        )
        state.velocity[i] = (
            phi[i, 1, 0] * s + phi[i, 1, 1] * w + phi[i, 1, 2] * a + gamma[i, 1] * command
        )
        state.acceleration[i] = (
            phi[i, 2, 0] * s + phi[i, 2, 1] * w + phi[i, 2, 2] * a + gamma[i, 2] * command
        )


@Part
def two_way_trust(state, setup):
    """Step trust (3.2)-(3.3), in the units of its models."""
    state.trust_hr = next_trust(state.trust_hr, setup.loop.trust_hr, state.p_r)  # (3.2)
    state.trust_rh = next_trust(state.trust_rh, setup.loop.trust_rh, state.p_h)  # (3.3)


@njit(error_model="numpy", forceinline=True)
def next_trust(trust, model, p):
    """
    Return trust one sample later for a performance in its own unit; performance beyond its range
    counts as at its end.
    """
    share = min(max((p - model.p_min) / (model.p_max - model.p_min), 0.0), 1.0)
    span = model.t_max - model.t_min
    return model.t_min + span * trust_step(
        (trust - model.t_min) / span, share, model.decay, model.gain
    )


# How operators act on the error that they see, by name; and the parts of a loop by port.
LAWS = {"proportional": proportional_law, "crossover": crossover_law}
DEFAULTS = {"trust": two_way_trust, "feedback": spring, "autonomy": controller}


# Decisions, and the hand.


@njit(error_model="numpy", forceinline=True)
def finite(vector):
    """Return whether three numbers are finite."""
    return np.isfinite(vector[0]) and np.isfinite(vector[1]) and np.isfinite(vector[2])


@njit(error_model="numpy", forceinline=True)
def within(share, low, high):
    """Return whether a scale is within its bounds, up to rounding."""
    return low * (1.0 - SLACK) <= share <= high * (1.0 + SLACK)


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
    # (3.1)
    bounded = within(state.alpha, state.alpha_min, state.alpha_max)
    if state.raised or not (bounded and within(state.beta, state.beta_min, state.beta_max)):
        return SCHEME
    call(parts.operator, state, setup)
    if state.raised or not finite(state.wanted):
        return OPERATOR
    if setup.hand.fatigue > 0.0:
        tire(setup, state)
    return DONE


@njit(error_model="numpy", forceinline=True)
def tire(setup, state):
    """Weaken the command by what the hand has pushed so far [N s]."""
    state.effort += setup.sample_time * np.sqrt(dot(state.f_h, state.f_h))
    for i in range(3):
        state.wanted[i] = state.wanted[i] / (1.0 + setup.hand.fatigue * state.effort)


@njit(error_model="numpy", forceinline=True)
def set_hand_force(setup, state):
    """Set the hand's force, and the output that the device would have without feedback."""
    hand, recorded = setup.hand, not np.isnan(state.hand[0])
    for i in range(3):
        device = setup.device[i]
        if recorded:
            state.wish[i] = device.weight * state.hand[i]
        else:
            state.wish[i] = hand.decay * state.wish[i] + (1.0 - hand.decay) * state.wanted[i]
        goal = state.wish[i] / device.weight  # where the device's output is the wish, r_m = Λ x
        shaking = hand.noise * state.motor[i] * (1.0 + abs(state.wish[i]))
        state.force[i] = device.held_stiffness * goal + shaking + state.pushed[i]
        state.free_output[i] = haptic.free_output(
            device, state.device[i], state.device_velocity[i], state.force[i]
        )


# How guidance reaches the operator: both ends of the channel are solved, each with the port behind
# it and its controller.


@njit(error_model="numpy", forceinline=True)
def set_guiding_force(state, setup, stretch):
    """Set the guiding force that the error `stretch` gives."""
    for i in range(3):
        state.stretch[i] = stretch[i]
    call(setup.parts.feedback, state, setup)


@njit(error_model="numpy", forceinline=True)
def passivity_share(guard, energy, velocity, force, gain, sample_time):
    """
    Return the share of a port's velocity that the passivity controller of Theorem 4 lets pass, 1
    where it rests.

    velocity, force, shape (3,): what the port would do without the controller. `gain` is the power
    that the velocity would cost against the port's own compliance.
    """
    power = dot(velocity, force)
    demand = demanded(guard, energy, power, sample_time)  # (3.19)
    if np.isnan(demand) or gain == 0.0:
        return 1.0
    return 1.0 / (1.0 + activation(power, gain, 1.0, demand)[0])


@njit(error_model="numpy", forceinline=True)
def solve_robot_end(state, setup):
    """
    Set the robot's velocity r_s = α (free − compliance f_s): the free part arrives, and the port
    yields to the force.

    Without a channel in between, both ends are one system of equations, solved in closed form.
    """
    near, far = setup.near, setup.far
    for i in range(3):
        if setup.channel == DIRECT:
            loaded, echo = loading_and_echo(state, setup, i)
            state.compliance[i] = (
                1.0 - far.arriving * echo * far.sent / (1.0 + far.reflected * echo)
            ) / far.b
            straight = far.arriving * near.sent * state.free_output[i] / loaded
            state.free_velocity[i] = straight / (far.b * (1.0 + far.reflected * echo))
        else:
            state.compliance[i] = 1.0 / far.b
            state.free_velocity[i] = far.arriving * state.v_r[i] / far.b


@njit(error_model="numpy", forceinline=True)
def loading_and_echo(state, setup, i):
    """
    Return how the channel loads the device, and what of a wave sent back comes again without a
    channel in between.
    """
    near, admittance = setup.near, setup.admittance[i]
    loaded = 1.0 + admittance * state.beta * near.b
    return loaded, near.reflected - near.sent * (admittance * state.beta * near.arriving / loaded)


@njit(error_model="numpy", forceinline=True)
def solve_operator_end(state, setup):
    """
    Set the waves and the operator's end for the robot's velocity and force: r_m = free_output −
    admittance f_m.
    """
    near, far = setup.near, setup.far
    for i in range(3):
        loaded, echo = loading_and_echo(state, setup, i)
        through = setup.admittance[i] * state.beta * near.arriving / loaded
        if setup.channel == DIRECT:
            straight = near.sent * state.free_output[i] / loaded + echo * far.sent * state.f_s[i]
            state.v_r[i] = straight / (1.0 + far.reflected * echo)
            state.v_l[i] = waves.robot_wave(far, state.f_s[i], state.v_r[i])
        state.r_m[i] = state.free_output[i] / loaded - through * state.v_l[i]
        # (3.12), (3.22)
        state.f_m[i] = state.beta * waves.operator_force(near, state.r_m[i], state.v_l[i])
        state.u_l[i] = waves.operator_wave(near, state.r_m[i], state.v_l[i])
        state.u_r[i] = waves.robot_wave(far, state.f_s[i], state.v_r[i])
        state.guide[i] = state.f_m[i] - state.beta * near.b * state.r_m[i]


@Part
def through_channel(state, setup):
    """
    The guiding force at the robot's port, under the controller of Theorem 4: Chapter 3 as printed.
    """
    set_guiding_force(state, setup, state.error)
    solve_robot_end(state, setup)
    square = 0.0
    for i in range(3):
        state.pull[i] = state.f_s[i] = state.guiding[i]
        # (3.12), (3.22)
        state.r_s[i] = state.alpha * (state.free_velocity[i] - state.compliance[i] * state.f_s[i])
        square += state.r_s[i] ** 2 * (state.compliance[0] / state.compliance[i])
    gain = square / (state.alpha * state.compliance[0])
    share = passivity_share(
        setup.guard, state.ledger.robot, state.r_s, state.f_s, gain, setup.sample_time
    )
    if share < 1.0:
        for i in range(3):
            state.r_s[i] = share * state.r_s[i]
            state.f_s[i] = (state.free_velocity[i] - state.r_s[i] / state.alpha) / state.compliance[
                i
            ]
    solve_operator_end(state, setup)
    state.port_share = share


@Part
def at_operator(state, setup):
    """
    The guiding force β f at the haptic device, from the picture that the operator sees; the channel
    carries the command.

    The device feels f_m = offset + resistance r_m, the channel's end with no force at the robot's,
    and the guiding force. The controller works on (r_m, f_m): guidance spends what the operator's
    port has earned, or its budget.
    """
    set_guiding_force(state, setup, state.picture)
    near, far = setup.near, setup.far
    back = 0.0  # of a wave sent, what returns at once without a channel in between
    if setup.channel == DIRECT:
        back = -far.reflected * near.sent / (1.0 + near.reflected * far.reflected)
    gain, resistance = 0.0, state.beta * (near.b + near.arriving * back)
    for i in range(3):
        arrived = 0.0 if setup.channel == DIRECT else state.beta * near.arriving * state.v_l[i]
        state.pull[i] = state.beta * state.guiding[i]
        force, admittance = arrived + state.pull[i], setup.admittance[i]
        state.r_m[i] = (state.free_output[i] - admittance * force) / (1.0 + admittance * resistance)
        state.f_m[i] = force + resistance * state.r_m[i]
        gain += state.r_m[i] ** 2 / admittance
    share = passivity_share(
        setup.guard, state.ledger.account, state.r_m, state.f_m, gain, setup.sample_time
    )
    for i in range(3):
        if share < 1.0:
            state.r_m[i] = share * state.r_m[i]
            state.f_m[i] = (state.free_output[i] - state.r_m[i]) / setup.admittance[i]
        if setup.channel == DIRECT:
            state.v_l[i] = back * state.r_m[i]
            state.v_r[i] = waves.operator_wave(near, state.r_m[i], state.v_l[i])
        state.guide[i] = state.f_m[i] - state.beta * near.b * state.r_m[i]
        state.f_s[i] = 0.0
        # (3.12), (3.22)
        state.r_s[i] = state.alpha * waves.robot_velocity(far, state.f_s[i], state.v_r[i])
        state.u_l[i] = waves.operator_wave(near, state.r_m[i], state.v_l[i])
        state.u_r[i] = waves.robot_wave(far, state.f_s[i], state.v_r[i])
    state.port_share = share


@Part
def no_feedback(state, setup):
    """The device's output to the robot, from which no force comes back."""
    set_guiding_force(state, setup, state.error)
    for i in range(3):
        state.r_m[i] = state.free_output[i]
        state.f_m[i] = 0.0
        state.f_s[i] = 0.0
        state.pull[i] = 0.0
        state.r_s[i] = state.alpha * (state.r_m[i] if setup.channel == DIRECT else state.arrived[i])
    state.port_share = 1.0


GUIDANCE = {
    "at_operator": at_operator,
    "through_channel": through_channel,
}


# Energy, performance, and the step to the next sample.


@njit(error_model="numpy", forceinline=True)
def account_energy(setup, state):
    """
    Book the energy of every port and set the robot's command; return |r_m|² + |f_m|², by which
    `advance` sees that device or channel diverge.
    """
    T = setup.sample_time
    scaling = setup.loop.force_scaling
    ledger = state.ledger
    magnitude = 0.0
    state.energy_device = 0.0
    for i in range(3):
        device = setup.device[i]
        x = state.device[i]
        v = state.device_velocity[i]
        # (3.8)
        v_middle = haptic.midpoint_velocity(device, x, v, state.force[i], scaling * state.f_m[i])
        x_middle = x + 0.5 * T * v_middle
        state.middle[i] = v_middle
        state.f_h[i] = (
            state.force[i] - setup.hand.stiffness * x_middle - setup.hand.damping * v_middle
        )
        ledger.operator += T * state.r_m[i] * state.f_h[i] / scaling  # (3.25)
        ledger.port += T * state.r_m[i] * state.f_m[i]
        ledger.account += T * state.r_m[i] * state.f_m[i]
        ledger.channel += T * (state.r_m[i] * state.f_m[i] - state.r_s[i] * state.f_s[i])
        ledger.robot += T * state.r_s[i] * state.f_s[i]
        ledger.target -= T * state.pull[i] * state.reference_velocity[i]
        ledger.dissipated += T / scaling * haptic.device_loss(device, x_middle, v_middle)  # (3.10)
        after_x, after_v = x + T * v_middle, 2.0 * v_middle - v
        # (3.9)
        state.energy_device += haptic.device_storage(device, after_x, after_v) / scaling
        # What the vehicle is told: α u_h + (1 − α) u_a, the operator's share being r_s = α u_h.
        state.u_h[i] = state.r_s[i] / state.alpha
        state.command[i] = state.r_s[i] + (1.0 - state.alpha) * state.u_a[i]
        magnitude += state.r_m[i] ** 2 + state.f_m[i] ** 2
    # see ports/budget.py; without a budget the account is the port's energy
    ledger.account = min(ledger.account, setup.budget_energy) + T * setup.budget_power
    state.energy_operator = ledger.operator
    state.energy_dissipated = ledger.dissipated
    state.energy_channel = ledger.channel
    state.energy_robot = ledger.robot
    state.energy_port = ledger.port
    state.energy_target = ledger.target
    return magnitude


@njit(error_model="numpy", forceinline=True)
def performance(settings, command_error, share, tracking_error):
    """
    Return (3.27) of one partner: its command's distance from the ideal one, and its share of the
    tracking error.
    """
    command = max(1.0 - command_error / settings.command_range, 0.0)
    return command * max(1.0 - share * tracking_error / settings.error_range, 0.0)


@njit(error_model="numpy", forceinline=True)
def measure_performance(settings, state):
    """Take performance (3.26)-(3.27) over the window."""
    tracking = command_h = command_r = 0.0
    for i in range(3):
        tracking += abs(state.error[i])
        command_h += abs(state.u_h[i] - state.u_i[i])
        command_r += abs(state.u_a[i] - state.u_i[i])
    state.good_r = performance(settings, command_r, 1.0 - state.alpha, tracking)  # (3.27)
    state.good_h = performance(settings, command_h, state.alpha, tracking)
    state.sum_r += state.good_r
    state.sum_h += state.good_h
    state.sum_r -= state.leaving_r
    state.sum_h -= state.leaving_h
    # (3.26); sums of differences may end a rounding error below zero
    state.p_r = max(state.sum_r / state.samples, 0.0)
    state.p_h = max(state.sum_h / state.samples, 0.0)


@njit(error_model="numpy", forceinline=True)
def store_history(k, state, history, sent):
    """Keep what later samples look up."""
    old = history[k]
    old.good_r = state.good_r
    old.good_h = state.good_h
    for i in range(3):
        sent[0, k, i], sent[1, k, i] = state.u_l[i], state.u_r[i]


@njit(error_model="numpy", forceinline=True)
def step_motion(setup, state):
    """Step device, vehicle and trust; return the block or part that failed, DONE where none did."""
    for i in range(3):
        state.device[i] += setup.sample_time * state.middle[i]
        state.device_velocity[i] = 2.0 * state.middle[i] - state.device_velocity[i]
    call(setup.parts.vehicle, state, setup)
    distance = 0.0
    for i in range(3):
        distance += abs(state.robot[i]) + abs(state.velocity[i])
    if state.raised or not np.isfinite(distance):
        return VEHICLE
    if distance >= 1e9:
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
    arrives at all. accounts: `ledger.accounts()`.
    """
    setup, state = setups[0], states[0]
    if start == 0:
        for i in range(3):
            state.robot[i] = inputs[0].reference[i]
    for k in range(start, stop):
        look_up(k, setup, inputs, history, state)
        receive(k, setup, delays, arrives, accounts, sent, log, state)
        failed = decide(setup, inputs[k].alpha, state)
        if failed != DONE:
            return k, failed
        set_hand_force(setup, state)
        call(setup.parts.guidance, state, setup)
        if state.raised or not finite(state.guiding):
            return k, FEEDBACK
        near = account_energy(setup, state)
        measure_performance(setup.loop, state)
        for i in range(row.size):
            table[k, i] = row[i]
        store_history(k, state, history, sent)
        # written as "not <", so that NaN counts as diverged
        if not state.energy_device < 1e9:
            return k + 1, DEVICE
        if not near < 1e18:
            return k + 1, CHANNEL
        failed = step_motion(setup, state)
        if failed != DONE:
            return k + 1, failed
    return stop, DONE
