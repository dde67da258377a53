"""
How guidance reaches the operator: both ends of the channel are solved, each with the port behind it
and its controller.

`through_channel` as printed: the force is at the robot's port, where it drives the robot as well.
`tank`: the same, paid for by a tank of energy. `at_operator`: the force is rendered at the haptic
device. `two_port`: velocity and force are sent as they are, and both ports are kept passive in the
time domain. `one_way`: no force comes back.
"""

import numpy as np

from trustlab.models.compiled import njit
from trustlab.teleoperation.loop.parts import Part, call
from trustlab.teleoperation.ports import waves
from trustlab.teleoperation.ports.passivity import activation, demanded

# What the channel carries: nothing between the ends, waves, the device's output alone, or packets
# with their energy.
DIRECT = 0
WAVES = 1
SIGNALS = 2
PACKETS = 3

# Time in which `two_port` makes up for the velocity that its controller took [s].
DRIFT_TIME = 0.5


@njit(error_model="numpy", forceinline=True)
def feel(state, setup, stretch):
    """Set the guiding force that the error `stretch` gives."""
    for i in range(3):
        state.stretch[i] = stretch[i]
    call(setup.parts.feedback, state, setup)


@njit(error_model="numpy", forceinline=True)
def share_let_pass(guard, energy, velocity, force, gain, sample_time):
    """
    Return the share of a port's velocity that the passivity controller of Theorem 4 lets pass, 1
    where it rests.

    velocity, force, shape (3,): what the port would do without the controller. `gain` is the power
    that the velocity would cost against the port's own compliance.
    """
    power = 0.0
    for i in range(3):
        power += velocity[i] * force[i]
    demand = demanded(guard, energy, power, sample_time)
    if np.isnan(demand) or gain == 0.0:
        return 1.0
    return 1.0 / (1.0 + activation(power, gain, 1.0, demand)[0])


@njit(error_model="numpy", forceinline=True)
def share_paid_for(guard, energy, line, square, sample_time):
    """
    Return the greatest share σ ≤ 1 of a force whose power, line σ − square σ², leaves the energy
    that is demanded.
    """
    demand = demanded(guard, energy, line - square, sample_time)
    if np.isnan(demand):
        return 1.0
    spendable = max(-demand, 0.0)
    root = np.sqrt(line * line + 4.0 * square * spendable)
    if line > 0.0:
        return min((line + root) / (2.0 * square), 1.0)
    return min(2.0 * spendable / (root - line), 1.0) if root > line else 0.0


@njit(error_model="numpy", forceinline=True)
def open_ends(state, setup):
    """
    Set the robot's velocity r_s = α (free − compliance f_s): the free part arrives, and the port
    yields to the force.

    Without a channel in between, both ends are one system of equations, solved in closed form.
    """
    near, far = setup.near, setup.far
    for i in range(3):
        if setup.channel == DIRECT:
            loaded, echo = echoed(state, setup, i)
            state.compliance[i] = (
                1.0 - far.arriving * echo * far.sent / (1.0 + far.reflected * echo)
            ) / far.b
            straight = far.arriving * near.sent * state.free_output[i] / loaded
            state.free_velocity[i] = straight / (far.b * (1.0 + far.reflected * echo))
        else:
            state.compliance[i] = 1.0 / far.b
            state.free_velocity[i] = far.arriving * state.v_r[i] / far.b


@njit(error_model="numpy", forceinline=True)
def echoed(state, setup, i):
    """
    Return how the channel loads the device, and what of a wave sent back comes again without a
    channel in between.
    """
    near, admittance = setup.near, setup.admittance[i]
    loaded = 1.0 + admittance * state.beta * near.b
    return loaded, near.reflected - near.sent * (admittance * state.beta * near.arriving / loaded)


@njit(error_model="numpy", forceinline=True)
def close_ends(state, setup):
    """
    Set the waves and the operator's end for the robot's velocity and force: r_m = free_output −
    admittance f_m.
    """
    near, far = setup.near, setup.far
    for i in range(3):
        loaded, echo = echoed(state, setup, i)
        through = setup.admittance[i] * state.beta * near.arriving / loaded
        if setup.channel == DIRECT:
            straight = near.sent * state.free_output[i] / loaded + echo * far.sent * state.f_s[i]
            state.v_r[i] = straight / (1.0 + far.reflected * echo)
            state.v_l[i] = waves.robot_wave(far, state.f_s[i], state.v_r[i])
        state.r_m[i] = state.free_output[i] / loaded - through * state.v_l[i]
        state.f_m[i] = state.beta * waves.operator_force(near, state.r_m[i], state.v_l[i])
        state.u_l[i] = waves.operator_wave(near, state.r_m[i], state.v_l[i])
        state.u_r[i] = waves.robot_wave(far, state.f_s[i], state.v_r[i])
        state.guide[i] = state.f_m[i] - state.beta * near.b * state.r_m[i]


@Part
def through_channel(state, setup):
    """
    The guiding force at the robot's port, under the controller of Theorem 4: Chapter 3 as printed.
    """
    feel(state, setup, state.error)
    open_ends(state, setup)
    square = 0.0
    for i in range(3):
        state.pull[i] = state.f_s[i] = state.guiding[i]
        state.r_s[i] = state.alpha * (state.free_velocity[i] - state.compliance[i] * state.f_s[i])
        square += state.r_s[i] ** 2 * (state.compliance[0] / state.compliance[i])
    gain = square / (state.alpha * state.compliance[0])
    share = share_let_pass(
        setup.guard, state.energy_robot, state.r_s, state.f_s, gain, state.sample_time
    )
    if share < 1.0:
        for i in range(3):
            state.r_s[i] = share * state.r_s[i]
            state.f_s[i] = (state.free_velocity[i] - state.r_s[i] / state.alpha) / state.compliance[
                i
            ]
    close_ends(state, setup)
    state.port_share = share


@Part
def tank(state, setup):
    """
    The guiding force at the robot's port, as far as a tank of energy there pays for the wave that
    it sends (Franken et al.).

    Waves fill the tank by ½ ‖v_r‖² and drain it by ½ ‖u_r‖²; packets add what else came in at the
    operator's end, where waves carry less than the port takes, ½ ∫ (β/β_min − 1) ‖u_l‖² dt. So the
    operator's port, ½ ∫ β (‖u_l‖²/β_min − ‖v_l‖²/β_max) dt, gives out no more than the tank held at
    first.
    """
    feel(state, setup, state.error)
    open_ends(state, setup)
    far, T = setup.far, state.sample_time
    line = square = spare = 0.0
    for i in range(3):
        line += far.sent * state.guiding[i] * far.reflected * state.v_r[i]
        square += 0.5 * (far.sent * state.guiding[i]) ** 2
        spare += 0.5 * T * (1.0 - far.reflected**2) * state.v_r[i] ** 2
    held = setup.tank + state.known_near - state.out_far + spare
    state.port_share = share_paid_for(setup.guard, held, line, square, T)
    for i in range(3):
        state.pull[i] = state.f_s[i] = state.port_share * state.guiding[i]
        state.r_s[i] = state.alpha * (state.free_velocity[i] - state.compliance[i] * state.f_s[i])
    close_ends(state, setup)
    for i in range(3):
        state.out_far += 0.5 * T * (state.u_r[i] ** 2 - state.v_r[i] ** 2)
        state.in_near += 0.5 * T * (state.beta / state.beta_min - 1.0) * state.u_l[i] ** 2


@Part
def at_operator(state, setup):
    """
    The guiding force β f at the haptic device, from the picture that the operator sees; the channel
    carries the command.

    The device feels f_m = offset + resistance r_m, the channel's end with no force at the robot's,
    and the guiding force. The controller works on (r_m, f_m): guidance spends what the operator's
    port has earned.
    """
    feel(state, setup, state.picture)
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
    share = share_let_pass(
        setup.guard, state.energy_port, state.r_m, state.f_m, gain, state.sample_time
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
        state.r_s[i] = state.alpha * waves.robot_velocity(far, state.f_s[i], state.v_r[i])
        state.u_l[i] = waves.operator_wave(near, state.r_m[i], state.v_l[i])
        state.u_r[i] = waves.robot_wave(far, state.f_s[i], state.v_r[i])
    state.port_share = share


@Part
def two_port(state, setup):
    """
    Velocity and force as they are, both ports passive in the time domain, the robot's drift made up
    for (Artigas et al.).

    A packet carries the energy that has come in at its sender's port so far, and no port gives out
    more than it knows has come in at the other. The moving target's energy does not count: the
    guiding force spends what the robot's port has taken.
    """
    feel(state, setup, state.error)
    T = state.sample_time
    power = 0.0
    square = 0.0
    for i in range(3):
        asked = state.alpha * state.arrived[i]
        state.free_velocity[i] = asked
        state.r_s[i] = asked + state.drift[i] / DRIFT_TIME
        power += state.r_s[i] * state.guiding[i]
        square += state.guiding[i] ** 2
    share = 1.0
    excess = 0.0
    given = 0.0
    if power < 0.0:
        share = share_paid_for(setup.guard, state.energy_robot, power, 0.0, T)
    elif power > 0.0:
        demand = demanded(setup.guard, state.known_near - state.out_far, -power, T)
        excess = 0.0 if np.isnan(demand) else (power + demand) / square
    for i in range(3):
        state.r_s[i] -= excess * state.guiding[i]
        state.pull[i] = state.f_s[i] = share * state.guiding[i]
        state.drift[i] += T * (state.free_velocity[i] - state.r_s[i])
        given += T * state.r_s[i] * state.f_s[i]
    state.out_far += max(given, 0.0)
    state.in_far += max(-given, 0.0)
    gain = 0.0
    for i in range(3):
        state.f_m[i] = state.beta * state.packet_force[i]
        state.r_m[i] = state.free_output[i] - setup.admittance[i] * state.f_m[i]
        gain += state.r_m[i] ** 2 / setup.admittance[i]
    state.port_share = share_let_pass(
        setup.guard, state.known_far - state.out_near, state.r_m, state.f_m, gain, T
    )
    came = 0.0
    for i in range(3):
        if state.port_share < 1.0:
            state.r_m[i] = state.port_share * state.r_m[i]
            state.f_m[i] = (state.free_output[i] - state.r_m[i]) / setup.admittance[i]
        state.guide[i] = state.f_m[i]
        came += T * state.r_m[i] * state.f_m[i]
    state.in_near += max(came, 0.0)
    state.out_near += max(-came, 0.0)


@Part
def one_way(state, setup):
    """The device's output to the robot, from which no force comes back."""
    feel(state, setup, state.error)
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
    "tank": tank,
    "two_port": two_port,
}
