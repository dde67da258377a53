"""
The whole teleoperation loop (Fig. 3.1), compiled.

`teleoperate` is a kernel of `Simulation`. A sample begins at its pause, when everything has
arrived: pictures, waves, trust in what was done before, and what the built-in controller and
operator propose. `obey` puts what was decided in their place; then hand, ports, books,
performance and motion follow, and `arrive` leads to the pause of the next sample. c: constants, s:
state, now: the row of the log.
"""

from typing import NamedTuple

import numpy as np

from trustlab.allocation.blending import DEGREE
from trustlab.models.compiled import njit
from trustlab.models.records import AXES, columns_of, record, step
from trustlab.models.trust import logistic_scale, trust_step
from trustlab.teleoperation import ports
from trustlab.teleoperation.ports import END, activation, copy, demanded, dot, read_waves

# A row of the log: the state before the sample and the signals of the sample.
LOGGED = record(
    vectors="reference robot velocity device device_velocity r_m f_h f_m r_s f_s u_h u_a u_i guide",
    numbers="alpha beta p_r p_h trust_hr trust_rh path_error port_share energy_operator "
    "energy_device energy_dissipated energy_channel energy_robot energy_port energy_target "
    "energy_guidance",
)
COLUMNS = columns_of(LOGGED)

# Beside it, what later samples look up.
SAMPLE = np.dtype([*LOGGED.descr, *record(vectors="error", numbers="good_r good_h").descr])

# Room that scheme OMI computes in: what lies ahead, the cost as a series in α.
BLENDING = record(ahead=(float, (3, 5)), series=(float, DEGREE + 1))

# The state: what the loop carries on, what has arrived, what the steps of a sample tell each other,
# and the sample. `account`: what the operator's port may spend [J].
STATE = record(
    vectors="reference_velocity acceleration wish integral picture picture_before seen seen_before "
    "v_l v_r arrived wanted force free_output stretch guiding pull middle command",
    numbers="t sample_time alpha_min alpha_max beta_min beta_max account effort square_m square_s "
    "sum_r sum_h",
    counts="waited",
    flags="sees finds found_before",
    now=SAMPLE,
    blending=BLENDING,
)

# What is decided in a sample; NaN leaves it to what is built in.
DECIDED = record(
    vectors="robot velocity u_a wanted guiding hand", numbers="alpha beta trust_hr trust_rh"
)
# What comes from outside in a sample: where the robot should be and how fast it should move, noise
# of the hand, a force added to the hand's, whether the controller's camera finds its target; and
# what is decided.
EXTERNAL = record(vectors="reference reference_velocity motor push", flags="detected")
INPUT = np.dtype([*EXTERNAL.descr, *DECIDED.descr])

# A `TrustModel` for one sample time; `gain` is b/a.
TRUST = record(numbers="decay gain p_min p_max t_min t_max")

# The simulated hand and eye: gains on the error seen, delay in samples, lag, impedance, and
# handling of α; `learned` is the share of what is new, per sample, in what an operator knows of the
# channel.
HAND = record(
    numbers="proportional derivative compensation crossover learned decay reach mass stiffness "
    "damping noise shift fatigue",
    counts="delay patience",
)

# The autonomous controller (PID on what the camera saw `delay` samples ago), and half its picture's
# width.
AUTONOMY = record(numbers="proportional integral derivative reach picture", counts="delay")

NUMBERS = record(
    numbers="sample_time force_scaling guidance steepness command_range error_range budget_energy "
    "budget_power admittance",
    counts="window rule law guard guided_at",
    trust_hr=TRUST,
    trust_rh=TRUST,
    hand=HAND,
    auto=AUTONOMY,
    device=ports.DEVICE,
    near=END,
    far=END,
    # per axis, the exact (position, velocity, acceleration) a sample later from these and a command
    flight=(float, (3, 3, 4)),
    blend=(float, (DEGREE + 1, 3, 5, 5)),  # the cost of Appendix A
)


class LoopSetup(NamedTuple):
    """
    What stays the same in a run of K samples.

    numbers, shape (1,): a record of NUMBERS. delays, shape (2, K + 1): delay in samples, to the
    robot and back. arrives, shape (2, K): whether what is sent in a sample arrives at all.
    """

    numbers: np.ndarray
    delays: np.ndarray
    arrives: np.ndarray


class LoopState(NamedTuple):
    """
    What samples hand on; changed in place.

    whole, shape (1,): a record of STATE. sent, shape (2, K, 3): waves by the sample that they were
    sent in, to the robot and back. accounts: `ports.accounts()`.
    """

    whole: np.ndarray
    sent: np.ndarray
    accounts: np.ndarray


BLOCKS = ("the haptic device", "the channel", "the robot")
DEVICE, CHANNEL, ROBOT = range(3)

# Who sets the scales: nobody (both at their upper bounds), trust by (3.5) and (3.6), the operator
# by hand. Functions decide over "manual".
MANUAL, LOGISTIC, STEPS, BY_HAND = range(4)
# How operators act on the error that they see.
LAWS = ("proportional", "crossover")
CROSSOVER = 1
# Where the guiding force is rendered; nowhere, if the channel carries the device's output alone.
GUIDANCE = ("at_operator", "through_channel")
AT_OPERATOR, THROUGH_CHANNEL, NOWHERE = range(3)

# Speed of the hand [m/s] above which an operator notices what the channel makes of it.
FLOOR = 0.05


# What has arrived at the pause.


@step
def visible(error, widest):
    """Return whether the target is in the camera's picture, x and y seen from above."""
    return abs(error[0]) <= widest and abs(error[1]) <= widest


@step
def measure_error(now):
    """Set how far the robot is from where it should be."""
    for i in AXES:
        now.error[i] = now.reference[i] - now.robot[i]
    now.path_error = np.sqrt(dot(now.error, now.error))


@step
def look(k, c, s, inputs, log):
    """Set the target, and what camera and operator see of it."""
    now, external = s.now, inputs[k]
    s.t = k * c.sample_time
    eye, camera = k - c.hand.delay, k - c.auto.delay
    widest = c.auto.picture
    copy(external.reference, now.reference)
    copy(external.reference_velocity, s.reference_velocity)
    measure_error(now)
    s.sees = eye >= 1 and visible(log[eye].error, widest)
    shown = camera >= 1 and visible(log[camera].error, widest)
    s.finds = shown and inputs[camera].detected
    before = camera - 1
    s.found_before = s.finds and inputs[before].detected and visible(log[before].error, widest)
    if s.sees:  # else the operator remembers where the target was last seen
        copy(log[eye].error, s.seen)
        copy(log[eye - 1].error, s.seen_before)
    for i in AXES:  # no force towards what nobody sees
        s.picture[i] = log[camera].error[i] if shown else 0.0
        s.picture_before[i] = log[before].error[i] if shown else 0.0
    copy(s.picture if c.guided_at == AT_OPERATOR else now.error, s.stretch)


@step
def receive(k, setup, c, s, state, log):
    """Set what comes out of the channel."""
    if c.guided_at != NOWHERE:
        sent, late = state.sent, setup.delays
        how = c.sample_time, state.accounts
        read_waves(sent[0], sent[1], setup.arrives, k, late, *how, s.v_l, s.v_r)
    else:
        where = k - setup.delays[0, k]
        first = int(np.floor(where))
        if first >= 0:
            for i in AXES:
                value, later = log[first].r_m[i], log[min(first + 1, k - 1)].r_m[i]
                s.arrived[i] = value + (where - first) * (later - value)


# What the built-in controller and operator propose.


@step
def clip(value, reach):
    """Return a value within ± reach."""
    return min(max(value, -reach), reach)


@step
def steer(c, s):
    """
    Set u_a by a PID controller on the camera's picture; a vehicle that has lost its target hovers.
    """
    auto, now = c.auto, s.now
    for i in AXES:
        now.u_a[i] = 0.0
        if s.finds:
            rate = 0.0
            if s.found_before:
                rate = (s.picture[i] - s.picture_before[i]) / c.sample_time
            command = auto.proportional * s.picture[i] + auto.derivative * rate
            summed = s.integral[i] + c.sample_time * s.picture[i]
            # anti-windup: the integral rests while the command is at its limit
            if abs(command + auto.integral * summed) < auto.reach:
                s.integral[i] = summed
            now.u_a[i] = clip(command + auto.integral * s.integral[i], auto.reach)


@step
def want(c, s):
    """Set the command that the operator wants, by a law on the error seen; see `Teleoperator`."""
    hand, now = c.hand, s.now
    scale = 1.0
    if c.law == CROSSOVER:
        # The channel's scale is the ratio of the root mean squares of what it gives and takes,
        # which delays do not change; 1 until the hand has moved.
        s.square_m += hand.learned * (dot(now.r_m, now.r_m) - s.square_m)
        s.square_s += hand.learned * (dot(now.r_s, now.r_s) - s.square_s)
        scale = np.sqrt((s.square_s + FLOOR**2) / (s.square_m + FLOOR**2))
    for i in AXES:
        if c.law == CROSSOVER:
            command = hand.crossover * s.seen[i]
        else:
            command = hand.proportional * s.seen[i]
            if s.sees:
                command += hand.derivative * ((s.seen[i] - s.seen_before[i]) / c.sample_time)
        s.wanted[i] = hand.compensation * clip(command, hand.reach) / scale


@step
def arrive(k, setup, c, state, inputs, log):
    """Come to the pause of sample k."""
    s = state.whole[0]
    look(k, c, s, inputs, log)
    receive(k, setup, c, s, state, log)
    steer(c, s)
    want(c, s)


# Decisions.


@step
def chosen(value, proposal):
    """Return what was decided, the proposal where that is NaN."""
    return proposal if np.isnan(value) else value


@step
def put(decided, proposal):
    """Put what was decided of a vector in the place of what is proposed."""
    for i in AXES:
        proposal[i] = chosen(decided[i], proposal[i])


@step
def share_of_range(trust, model):
    """
    Return trust as a share of its range; the scales (3.5) and (3.6) have their midpoint at half of
    it.
    """
    return (trust - model.t_min) / (model.t_max - model.t_min)


@step
def set_scales(c, s):
    """Set α and β by the built-in rule."""
    now, alpha = s.now, s.alpha_max
    beta = s.beta_max
    hr, rh = share_of_range(now.trust_hr, c.trust_hr), share_of_range(now.trust_rh, c.trust_rh)
    if c.rule == LOGISTIC:  # (3.5)
        alpha = logistic_scale(s.alpha_min, s.alpha_max, c.steepness, 0.5, hr)
        beta = logistic_scale(s.beta_min, s.beta_max, c.steepness, 0.5, rh)
    elif c.rule == STEPS:  # (3.6)
        alpha = s.alpha_min if hr >= 0.5 else s.alpha_max
        beta = s.beta_min if rh >= 0.5 else s.beta_max
    elif c.rule == BY_HAND:  # now and then towards the partner that performs better
        alpha = now.alpha
        s.waited += 1
        if s.waited >= c.hand.patience:
            s.waited = 0
            alpha += c.hand.shift if now.p_h > now.p_r else -c.hand.shift
            alpha = min(max(alpha, s.alpha_min), s.alpha_max)
    now.alpha, now.beta = alpha, beta


@step
def obey(c, s, external):
    """Put what was decided in the place of what is proposed, and set the scales."""
    now = s.now
    put(external.robot, now.robot)
    put(external.velocity, now.velocity)
    put(external.u_a, now.u_a)
    put(external.wanted, s.wanted)
    measure_error(now)
    if c.guided_at != AT_OPERATOR:  # the vehicle may have been moved from outside
        copy(now.error, s.stretch)
    for i in AXES:
        # the ideal controller has the gain 1/s
        now.u_i[i] = external.reference_velocity[i] + now.error[i]
        s.guiding[i] = -c.guidance * s.stretch[i]  # (3.17)
    put(external.guiding, s.guiding)
    now.trust_hr = chosen(external.trust_hr, now.trust_hr)
    now.trust_rh = chosen(external.trust_rh, now.trust_rh)
    set_scales(c, s)
    now.alpha, now.beta = chosen(external.alpha, now.alpha), chosen(external.beta, now.beta)


# The hand.


@step
def push(c, s, external):
    """Set the hand's force, and the output that the device would have without feedback."""
    hand, device = c.hand, c.device
    now = s.now
    if hand.fatigue > 0.0:  # weakened by what the hand has pushed so far [N s]
        s.effort += c.sample_time * np.sqrt(dot(now.f_h, now.f_h))
    for i in AXES:
        if np.isnan(external.hand[i]):
            wanted = s.wanted[i] / (1.0 + hand.fatigue * s.effort)
            s.wish[i] = hand.decay * s.wish[i] + (1.0 - hand.decay) * wanted
        else:
            s.wish[i] = device.weight * external.hand[i]
        goal = s.wish[i] / device.weight  # where the device's output is the wish, r_m = Λ x
        shaking = hand.noise * external.motor[i] * (1.0 + abs(s.wish[i]))
        s.force[i] = device.held_stiffness * goal + shaking + external.push[i]
        x, v = now.device[i], now.device_velocity[i]
        s.free_output[i] = ports.free_output(device, x, v, s.force[i])


# How guidance reaches the operator: both ends of the channel are solved, each with the port behind
# it and its controller.


@step
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
    return 1.0 / (1.0 + activation(power, gain, demand))  # (3.20)


@step
def solve_operator_end(c, s):
    """
    Set the operator's end of the channel, the guiding force there included.

    Two equations hold at once on an axis, Y being the device's admittance: r_m = free − Y f_m, the
    device; f_m = guiding + β (b r_m + arriving v_l), (3.12) and (3.22).
    """
    near, now = c.near, s.now
    loaded = 1.0 + c.admittance * now.beta * near.b
    through = c.admittance * now.beta * near.arriving / loaded
    for i in AXES:
        guiding = s.pull[i] if c.guided_at == AT_OPERATOR else 0.0
        free = s.free_output[i] - c.admittance * guiding
        now.r_m[i] = free / loaded - through * s.v_l[i]
        # (3.12), (3.22)
        now.f_m[i] = guiding + now.beta * ports.operator_force(near, now.r_m[i], s.v_l[i])


@step
def guide_through_channel(c, s):
    """
    The guiding force at the robot's port, under the controller of Theorem 4: Chapter 3 as printed.
    """
    now, far = s.now, c.far
    for i in AXES:
        s.pull[i] = now.f_s[i] = s.guiding[i]
        now.r_s[i] = now.alpha * ports.robot_velocity(far, now.f_s[i], s.v_r[i])  # (3.12), (3.22)
    gain = dot(now.r_s, now.r_s) * far.b / now.alpha
    share = passivity_share(c.guard, now.energy_robot, now.r_s, now.f_s, gain, c.sample_time)
    if share < 1.0:
        for i in AXES:
            now.r_s[i] = share * now.r_s[i]
            now.f_s[i] = far.arriving * s.v_r[i] - far.b * now.r_s[i] / now.alpha
    solve_operator_end(c, s)
    now.port_share = share


@step
def guide_at_operator(c, s):
    """
    The guiding force β f at the haptic device, from the picture that the operator sees; the channel
    carries the command.

    The controller works on (r_m, f_m), of which the guiding force is a part: guidance spends what
    the operator's port has earned, or its budget.
    """
    now = s.now
    for i in AXES:
        s.pull[i], now.f_s[i] = now.beta * s.guiding[i], 0.0
    solve_operator_end(c, s)
    gain = dot(now.r_m, now.r_m) / c.admittance
    share = passivity_share(c.guard, s.account, now.r_m, now.f_m, gain, c.sample_time)
    for i in AXES:
        if share < 1.0:
            now.r_m[i] = share * now.r_m[i]
            now.f_m[i] = (s.free_output[i] - now.r_m[i]) / c.admittance
        now.r_s[i] = now.alpha * ports.robot_velocity(c.far, now.f_s[i], s.v_r[i])  # (3.12), (3.22)
    now.port_share = share


@step
def send_output(c, s):
    """Send the device's output to the robot, from which no force comes back."""
    now = s.now
    for i in AXES:
        now.r_m[i] = s.free_output[i]
        now.r_s[i] = now.alpha * s.arrived[i]
    now.port_share = 1.0


# Books, performance and motion.


@step
def account(k, c, s, external, sent):
    """Send the waves, book the energy of every port and set the robot's command."""
    T, scaling = c.sample_time, c.force_scaling
    hand, device = c.hand, c.device
    now = s.now
    bilateral = c.guided_at != NOWHERE
    now.energy_device = 0.0
    for i in AXES:
        x, v = now.device[i], now.device_velocity[i]
        r_m, f_m = now.r_m[i], now.f_m[i]
        r_s, f_s = now.r_s[i], now.f_s[i]
        sent[0, k, i] = ports.operator_wave(c.near, r_m, s.v_l[i])  # (3.22)
        sent[1, k, i] = ports.robot_wave(c.far, f_s, s.v_r[i])  # (3.22)
        # (3.8)
        v_middle = ports.midpoint_velocity(device, x, v, s.force[i], scaling * f_m)
        s.middle[i], x_middle = v_middle, x + 0.5 * T * v_middle
        held = s.force[i] - hand.stiffness * x_middle - hand.damping * v_middle
        now.f_h[i] = held - hand.mass * (2.0 * (v_middle - v) / T)
        # what the channel's end gives, (3.12) and (3.22); guidance and its guard give the rest
        end = now.beta * ports.operator_force(c.near, r_m, s.v_l[i]) if bilateral else 0.0
        now.guide[i] = f_m - now.beta * c.near.b * r_m if bilateral else 0.0
        now.energy_operator += T * r_m * now.f_h[i] / scaling  # (3.25)
        now.energy_port += T * r_m * f_m
        s.account += T * r_m * f_m
        now.energy_channel += T * (r_m * end - r_s * f_s)
        now.energy_guidance += T * r_m * (f_m - end)
        now.energy_robot += T * r_s * f_s
        now.energy_target -= T * s.pull[i] * external.reference_velocity[i]
        now.energy_dissipated += T / scaling * ports.device_loss(device, x_middle, v_middle)
        after = x + T * v_middle, 2.0 * v_middle - v
        now.energy_device += ports.device_storage(device, *after) / scaling  # (3.9)
        # What the vehicle is told: α u_h + (1 − α) u_a, the operator's share being r_s = α u_h.
        now.u_h[i] = r_s / now.alpha
        s.command[i] = r_s + (1.0 - now.alpha) * now.u_a[i]
    # see `GuidanceBudget`; without a budget the account is the port's energy
    s.account = min(s.account, c.budget_energy) + T * c.budget_power


@step
def performance(c, command_error, share, tracking_error):
    """
    Return (3.27) of one partner: its command's distance from the ideal one, and its share of the
    tracking error.
    """
    command = max(1.0 - command_error / c.command_range, 0.0)
    return command * max(1.0 - share * tracking_error / c.error_range, 0.0)


@step
def judge(k, c, s, log):
    """Set performance (3.26)-(3.27) over the window."""
    now = s.now
    tracking = command_h = command_r = 0.0
    for i in AXES:
        tracking += abs(now.error[i])
        command_h += abs(now.u_h[i] - now.u_i[i])
        command_r += abs(now.u_a[i] - now.u_i[i])
    now.good_r = performance(c, command_r, 1.0 - now.alpha, tracking)  # (3.27)
    now.good_h = performance(c, command_h, now.alpha, tracking)  # (3.27)
    s.sum_r += now.good_r
    s.sum_h += now.good_h
    if k >= c.window:
        s.sum_r -= log[k - c.window].good_r
        s.sum_h -= log[k - c.window].good_h
    samples = min(k + 1, c.window)
    # (3.26); sums of differences may end a rounding error below zero
    now.p_r, now.p_h = max(s.sum_r / samples, 0.0), max(s.sum_h / samples, 0.0)


@step
def next_trust(trust, model, p):
    """
    Return trust one sample later for a performance in its own unit; performance beyond its range
    counts as at its end.
    """
    share = min(max((p - model.p_min) / (model.p_max - model.p_min), 0.0), 1.0)
    after = trust_step(share_of_range(trust, model), share, model.decay, model.gain)
    return model.t_min + (model.t_max - model.t_min) * after


@step
def advanced(row, x, v, a, u):
    """Return x, v or a of an axis one sample later: a row of its exact matrix, u being held."""
    return row[0] * x + row[1] * v + row[2] * a + row[3] * u


@step
def move(c, s):
    """Move device and vehicle, and step trust."""
    now = s.now
    for i in AXES:
        now.device[i] += c.sample_time * s.middle[i]
        now.device_velocity[i] = 2.0 * s.middle[i] - now.device_velocity[i]
        x, v, a, u = now.robot[i], now.velocity[i], s.acceleration[i], s.command[i]
        now.robot[i] = advanced(c.flight[i, 0], x, v, a, u)
        now.velocity[i] = advanced(c.flight[i, 1], x, v, a, u)
        s.acceleration[i] = advanced(c.flight[i, 2], x, v, a, u)
    now.trust_hr = next_trust(now.trust_hr, c.trust_hr, now.p_r)  # (3.2)
    now.trust_rh = next_trust(now.trust_rh, c.trust_rh, now.p_h)  # (3.3)


@njit(error_model="numpy", _nrt=False)
def teleoperate(first, stop, setup, state, inputs, log):
    """
    Do the samples, as a kernel of `Simulation`.

    setup: a `LoopSetup`. state: a `LoopState`. inputs: records of INPUT, one more than the log.
    log: records of SAMPLE.
    """
    c, s = setup.numbers[0], state.whole[0]
    now = s.now
    if stop == 0:
        for i in AXES:
            now.robot[i] = inputs[0].reference[i]
        arrive(0, setup, c, state, inputs, log)
    for k in range(first, stop):
        external = inputs[k]
        obey(c, s, external)
        # written as "not <", so that NaN counts as diverged
        if not dot(now.robot, now.robot) + dot(now.velocity, now.velocity) < 1e18:
            return k, ROBOT
        push(c, s, external)
        if c.guided_at == AT_OPERATOR:
            guide_at_operator(c, s)
        elif c.guided_at == THROUGH_CHANNEL:
            guide_through_channel(c, s)
        else:
            send_output(c, s)
        account(k, c, s, external, state.sent)
        judge(k, c, s, log)
        log[k] = now
        if not now.energy_device < 1e9:
            return k + 1, DEVICE
        if not dot(now.r_m, now.r_m) + dot(now.f_m, now.f_m) < 1e18:
            return k + 1, CHANNEL
        move(c, s)
        arrive(k + 1, setup, c, state, inputs, log)
    return stop, -1
