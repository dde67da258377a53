"""
The parts that a loop has where the user gives no other: autonomy, operator's law, force feedback,
vehicle and trust.
"""

import numpy as np

from trustlab.models.compiled import njit
from trustlab.models.trust import trust_step
from trustlab.teleoperation.loop.parts import Part


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
                rate = (state.picture[i] - state.picture_before[i]) / state.sample_time
            wanted = auto.proportional * state.picture[i] + auto.derivative * rate
            summed = state.integral[i] + state.sample_time * state.picture[i]
            # anti-windup: the integral rests while the command is at its limit
            if abs(wanted + auto.integral * summed) < auto.reach:
                state.integral[i] = summed
            state.u_a[i] = clip(wanted + auto.integral * state.integral[i], auto.reach)


@Part
def proportional_law(state, setup):
    """
    Set the command that the operator wants, in proportion to the error seen and its rate.

    While the target is out of the picture it is looked for where it was last seen.
    """
    hand = setup.hand
    for i in range(3):
        wanted = hand.proportional * state.seen[i]
        if state.sees:
            wanted += hand.derivative * ((state.seen[i] - state.seen_before[i]) / state.sample_time)
        state.wanted[i] = hand.compensation * clip(wanted, hand.reach)


# Speed of the hand [m/s] above which an operator notices what the channel makes of it.
FLOOR = 0.05


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
    taken = 0.0
    given = 0.0
    for i in range(3):
        taken += state.r_m[i] ** 2
        given += state.r_s[i] ** 2
    memory[0] += hand.learned * (taken - memory[0])
    memory[1] += hand.learned * (given - memory[1])
    scale = np.sqrt((memory[1] + FLOOR**2) / (memory[0] + FLOOR**2))  # 1 until the hand has moved
    for i in range(3):
        state.wanted[i] = (
            hand.compensation * clip(hand.crossover * state.seen[i], hand.reach) / scale
        )


# How operators act on the error that they see, by name.
LAWS = {"proportional": proportional_law, "crossover": crossover_law}


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
    state.trust_hr = next_trust(state.trust_hr, setup.loop.trust_hr, state.p_r)
    state.trust_rh = next_trust(state.trust_rh, setup.loop.trust_rh, state.p_h)


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


# By the port that each of them serves.
DEFAULTS = {"trust": two_way_trust, "feedback": spring, "autonomy": controller}
