"""One step after another of the whole teleoperation loop (Fig. 3.1), compiled."""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np

from trustlab.allocation.blending import best_share
from trustlab.teleoperation.channel import read_wave
from trustlab.teleoperation.passivity import activation, demanded
from trustlab.teleoperation.schemes import LOGISTIC, MANUAL, OPERATOR, OPTIMAL, STEP

__all__ = ["BLOCKS", "COLUMNS", "AutonomyNumbers", "HandNumbers", "LoopNumbers", "run_loop"]

BLOCKS = ("haptic device", "channel", "robot")
AXES = "xyz"


def _axes(stem: str) -> tuple[str, ...]:
    return tuple(f"{stem}_{axis}" for axis in AXES)


COLUMNS = (
    *_axes("reference"),
    *_axes("robot"),
    *_axes("velocity"),
    *_axes("device"),
    *_axes("device_velocity"),
    *_axes("r_m"),
    *_axes("f_h"),
    *_axes("f_m"),
    *_axes("r_s"),
    *_axes("f_s"),
    *_axes("u_h"),
    *_axes("u_a"),
    *_axes("u_i"),
    "mode",
    "beta",
    "p_r",
    "p_h",
    "trust_hr",
    "trust_rh",
    "path_error",
    "port_share",
    "energy_operator",
    "energy_device",
    "energy_dissipated",
    "energy_channel",
    "energy_robot",
)


class LoopNumbers(NamedTuple):
    """Device, channel, force feedback, trust and scales as plain numbers; see `LoopSettings`."""

    sample_time: float
    mass: float
    damping: float
    stiffness: float
    weight: float
    force_scaling: float
    b: float
    alpha_min: float
    alpha_max: float
    beta_min: float
    beta_max: float
    gain: float
    feedback: float
    steepness_alpha: float
    steepness_beta: float
    midpoint_alpha: float
    midpoint_beta: float
    keep_hr: float
    gain_hr: float
    keep_rh: float
    gain_rh: float
    trust0_hr: float
    trust0_rh: float
    window: int
    command_range: float
    error_range: float
    p_min: float
    p_max: float


class HandNumbers(NamedTuple):
    """The simulated hand and eye: gains on the error seen, delay in samples, lag, impedance, and handling of α."""

    proportional: float
    derivative: float
    delay: int
    keep: float
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


@numba.njit(cache=True)
def scale(low, high, steepness, trust, midpoint, step):
    """Return (3.5), or (3.6) where `step`, at a trust that is a share of its range."""
    if step:
        return low if trust >= midpoint else high
    return low + (high - low) * 0.5 * (1.0 - np.tanh(0.5 * steepness * (trust - midpoint)))


@numba.njit(cache=True)
def clip(value, reach):
    """Return value within ± reach."""
    return min(max(value, -reach), reach)


@numba.njit(cache=True, error_model="numpy")
def run_loop(
    allocation, bilateral, direct, read_out, guard, n, hand, auto, phi, gamma,
    reference, reference_velocity, detected, delays, got, motor, pushed, shares, blend, log,
):  # fmt: skip
    """
    Run the loop and write one row of `log` per sample.

    reference, reference_velocity, motor, pushed, shape (N, 3): where the robot should be and how fast it moves, noise of
    the hand, and a force that is added to the hand's. phi, shape (3, 3, 3), gamma, shape (3, 3): the vehicle's exact
    one-sample matrices of (position, velocity, acceleration) per axis. shares, shape (N,): α where it is given from
    outside (NaN elsewhere). blend, shape (3, M, 5, 5): `OptimalBlending.weights`, which set α in scheme OMI from the operator's
    command of the sample before and from the error, its rate and its acceleration now. Returns the samples done, the block that diverged (−1: none) and its energy.
    """
    count = log.shape[0]
    T, b = n.sample_time, n.b
    u_l, u_r = np.zeros((count, 3)), np.zeros((count, 3))
    seen, sent = np.zeros((count, 3)), np.zeros((count, 3))
    parts = np.zeros((2, count))
    v_l, v_r, v_m = np.zeros(3), np.zeros(3), np.zeros(3)
    state, x, v = np.zeros((3, 3)), np.zeros(3), np.zeros(3)
    want, total, u_a, u_i = np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3)
    open_device, open_robot, robot_v = np.zeros(3), np.zeros(3), np.zeros(3)
    force, f_m, f_s, r_m, r_s, spring = (
        np.zeros(3),
        np.zeros(3),
        np.zeros(3),
        np.zeros(3),
        np.zeros(3),
        np.zeros(3),
    )
    accounts, ahead = np.zeros((2, 3)), np.zeros((3, 5))
    accounts[:, 2] = -1.0
    p, q = np.sqrt(2.0 * b * n.beta_min), np.sqrt(n.beta_min / n.beta_max)
    s, w = np.sqrt(2.0 * n.alpha_min / b), np.sqrt(n.alpha_min / n.alpha_max)
    into_master, into_robot = np.sqrt(2.0 * b / n.beta_max), np.sqrt(2.0 * b / n.alpha_max)
    stiff, damp = n.stiffness + hand.stiffness, n.damping + hand.damping
    left = 2.0 * n.mass / T + damp + 0.5 * T * stiff
    tip = 1.0 + 0.5 * T * n.weight
    admittance = n.force_scaling * tip / left
    spare = n.stiffness + n.weight * n.damping - n.weight * n.mass * n.weight
    trust_hr, trust_rh = n.trust0_hr, n.trust0_rh
    p_r = p_h = sum_r = sum_h = 0.0
    energy_operator = energy_lost = energy_channel = energy_robot = 0.0
    alpha, beta, waited = n.alpha_max, n.beta_max, 0
    for i in range(3):
        state[i, 0], state[i, 1] = reference[0, i], 0.0
    for k in range(count):
        size = 0.0
        for i in range(3):
            seen[k, i] = reference[k, i] - state[i, 0]
            size += abs(seen[k, i])
            u_i[i] = reference_velocity[k, i] + auto.ideal * seen[k, i]
        camera = k - auto.delay
        for i in range(3):
            u_a[i] = 0.0  # a vehicle that has lost its target hovers
            if camera >= 1 and detected[camera]:
                rate = (seen[camera, i] - seen[camera - 1, i]) / T if detected[camera - 1] else 0.0
                wanted = auto.proportional * seen[camera, i] + auto.derivative * rate
                if abs(wanted + auto.integral * (total[i] + T * seen[camera, i])) < auto.reach:
                    total[i] += T * seen[camera, i]
                u_a[i] = clip(wanted + auto.integral * total[i], auto.reach)
        # scales, set by what was measured up to the sample before
        if shares[k] == shares[k]:
            alpha = shares[k]
        elif allocation == MANUAL:
            alpha = n.alpha_max
        elif allocation == OPERATOR:
            waited += 1
            if waited >= hand.patience:
                waited = 0
                alpha += hand.shift if p_h > p_r else -hand.shift
                alpha = min(max(alpha, n.alpha_min), n.alpha_max)
        elif allocation == OPTIMAL:
            for i in range(3):
                ahead[i, 0], ahead[i, 1], ahead[i, 2] = r_s[i] / alpha, u_a[i], seen[k, i]
                ahead[i, 3], ahead[i, 4] = reference_velocity[k, i] - state[i, 1], -state[i, 2]
            alpha = best_share(blend, ahead, n.alpha_min, n.alpha_max)[0]
        else:
            step = allocation == STEP
            alpha = scale(n.alpha_min, n.alpha_max, n.steepness_alpha, trust_hr, n.midpoint_alpha, step)
        beta = n.beta_max
        if allocation in (LOGISTIC, STEP):
            step = allocation == STEP
            beta = scale(n.beta_min, n.beta_max, n.steepness_beta, trust_rh, n.midpoint_beta, step)
        # the hand: what it wants, from what it saw; its springs and dampers are solved with the device's
        view = k - hand.delay
        for i in range(3):
            wanted = 0.0
            if view >= 1:
                rate = (seen[view, i] - seen[view - 1, i]) / T
                wanted = clip(hand.proportional * seen[view, i] + hand.derivative * rate, hand.reach)
            want[i] = hand.keep * want[i] + (1.0 - hand.keep) * wanted
            goal = want[i] / n.weight
            force[i] = stiff * goal + hand.noise * motor[k, i] * (1.0 + abs(want[i])) + pushed[k, i]
            open_device[i] = (
                tip * (2.0 * n.mass * v[i] / T - stiff * x[i] + force[i]) / left + n.weight * x[i]
            )
            spring[i] = -n.feedback * seen[k, i]
        # both ends of the channel, in closed form: r_s = α (open_robot − yielding f_s)
        stir = 1.0 + admittance * beta * b
        through = admittance * beta * into_master / stir
        yielding, shrink = 1.0 / b, 1.0
        if not bilateral:
            where = k - delays[0, k]
            first = int(np.floor(where))
            for i in range(3):
                r_m[i] = open_device[i]
                f_m[i] = 0.0
                sent[k, i] = r_m[i]
                v_m[i] = 0.0
                if direct:
                    v_m[i] = r_m[i]
                elif first >= 0:
                    v_m[i] = sent[first, i] + (where - first) * (sent[min(first + 1, k), i] - sent[first, i])
                r_s[i], f_s[i] = alpha * v_m[i], 0.0
        else:
            if direct:
                loop = q - p * through
                yielding = (1.0 - into_robot * loop * s / (1.0 + w * loop)) / b
                for i in range(3):
                    open_robot[i] = into_robot * p * open_device[i] / stir / (b * (1.0 + w * loop))
            else:
                read_wave(u_l, got[0], k, delays[0, k], n.gain, read_out, T, accounts[0], v_r)
                read_wave(u_r, got[1], k, delays[1, k], n.gain, read_out, T, accounts[1], v_l)
                for i in range(3):
                    open_robot[i] = into_robot * v_r[i] / b
            power = square = 0.0
            for i in range(3):
                robot_v[i] = alpha * (open_robot[i] - yielding * spring[i])
                power += robot_v[i] * spring[i]
                square += robot_v[i] ** 2
            demand = demanded(guard, energy_robot, power, T)
            if demand == demand and square > 0.0:
                shrink = 1.0 / (1.0 + activation(power, square, alpha * yielding, demand)[0])
            for i in range(3):
                f_s[i], r_s[i] = spring[i], robot_v[i]
                if shrink < 1.0:
                    r_s[i] = shrink * robot_v[i]
                    f_s[i] = (open_robot[i] - r_s[i] / alpha) / yielding
                if direct:
                    v_r[i] = (p * open_device[i] / stir + loop * s * f_s[i]) / (1.0 + w * loop)
                    v_l[i] = s * f_s[i] - w * v_r[i]
                r_m[i] = open_device[i] / stir - through * v_l[i]
                f_m[i] = beta * (b * r_m[i] + into_master * v_l[i])
                u_l[k, i] = p * r_m[i] + q * v_l[i]
                u_r[k, i] = s * f_s[i] - w * v_r[i]
        stored = near = far = 0.0
        error_h = error_r = 0.0
        row = log[k]
        for i in range(3):
            middle = (2.0 * n.mass * v[i] / T - stiff * x[i] + force[i] - n.force_scaling * f_m[i]) / left
            x_middle = x[i] + 0.5 * T * middle
            f_h = force[i] - hand.stiffness * x_middle - hand.damping * middle
            energy_operator += T * r_m[i] * f_h / n.force_scaling
            energy_channel += T * (r_m[i] * f_m[i] - r_s[i] * f_s[i])
            energy_robot += T * r_s[i] * f_s[i]
            energy_lost += (
                T / n.force_scaling
                * ((n.damping - n.mass * n.weight) * middle**2 + n.weight * n.stiffness * x_middle**2)
            )  # fmt: skip
            u_h = r_s[i] / alpha
            error_h += abs(u_h - u_i[i])
            error_r += abs(u_a[i] - u_i[i])
            row[i], row[3 + i], row[6 + i] = reference[k, i], state[i, 0], state[i, 1]
            row[9 + i], row[12 + i], row[15 + i], row[18 + i] = x[i], v[i], r_m[i], f_h
            row[21 + i], row[24 + i], row[27 + i] = f_m[i], r_s[i], f_s[i]
            row[30 + i], row[33 + i], row[36 + i] = u_h, u_a[i], u_i[i]
            x[i] += T * middle
            v[i] = 2.0 * middle - v[i]
            r = v[i] + n.weight * x[i]
            stored += 0.5 * (n.mass * r * r + spare * x[i] * x[i]) / n.force_scaling
            command = r_s[i] + (1.0 - alpha) * u_a[i]
            a0, a1, a2 = state[i, 0], state[i, 1], state[i, 2]
            for j in range(3):
                state[i, j] = (
                    phi[i, j, 0] * a0 + phi[i, j, 1] * a1 + phi[i, j, 2] * a2 + gamma[i, j] * command
                )
            near += r_m[i] ** 2 + f_m[i] ** 2
            far += abs(state[i, 0]) + abs(state[i, 1])
        # (3.26)-(3.27) over the window, trust (3.2)-(3.3) after it
        good_r = max(1.0 - error_r / n.command_range, 0.0) * max(
            1.0 - (1.0 - alpha) * size / n.error_range, 0.0
        )
        good_h = max(1.0 - error_h / n.command_range, 0.0) * max(1.0 - alpha * size / n.error_range, 0.0)
        parts[0, k], parts[1, k] = good_r, good_h
        sum_r += good_r
        sum_h += good_h
        used = k + 1
        if k >= n.window:
            sum_r -= parts[0, k - n.window]
            sum_h -= parts[1, k - n.window]
            used = n.window
        p_r, p_h = max(sum_r / used, 0.0), max(sum_h / used, 0.0)
        row[39], row[40], row[41], row[42] = alpha, beta, p_r, p_h
        row[43], row[44], row[45] = (
            trust_hr,
            trust_rh,
            np.sqrt(seen[k, 0] ** 2 + seen[k, 1] ** 2 + seen[k, 2] ** 2),
        )
        row[46] = shrink
        row[47], row[48], row[49] = energy_operator, stored, energy_lost
        row[50], row[51] = energy_channel, energy_robot
        share_r = min(max((p_r - n.p_min) / (n.p_max - n.p_min), 0.0), 1.0)
        share_h = min(max((p_h - n.p_min) / (n.p_max - n.p_min), 0.0), 1.0)
        trust_hr = n.keep_hr * trust_hr + (1.0 - n.keep_hr) * n.gain_hr * share_r
        trust_rh = n.keep_rh * trust_rh + (1.0 - n.keep_rh) * n.gain_rh * share_h
        if not stored < 1e9:
            return k + 1, 0, stored
        if not near < 1e18:
            return k + 1, 1, energy_channel
        if not far < 1e9:
            return k + 1, 2, energy_robot
    return count, -1, 0.0
