"""The loop that drives the ground robot: one step of robot, operator and allocation every tenth of a second."""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np

from trustlab.allocation.correction.in_loop import correct_thresholds
from trustlab.allocation.correction.plan import LOWER, UPPER
from trustlab.allocation.rules import performance_suggestion
from trustlab.models.human import yerkes_dodson
from trustlab.models.tsc import threshold_mode
from trustlab.operators.ground_robot import driving_style, joystick
from trustlab.testbeds.course import nearest_point, path_point
from trustlab.testbeds.pioneer import scan, wrapped

__all__ = ["COLUMNS", "DEADLINE", "OWN", "PERFORMANCE", "SCHEDULE", "SETTLING", "TSC", "Task", "drive"]

SCHEDULE, OWN, TSC, PERFORMANCE = 0, 1, 2, 3
"""Who allocates: a given sequence of modes, the operator, suggestions by (2.8), suggestions by Algorithm 2."""

DEADLINE = 15.0
"""A suggestion counts as followed when the operator complies within this time [s]."""

SETTLING = 100.0
"""Nobody switches before this time [s], when the window of (2.4) and (2.7) is full for the first time: means of the first
few samples, of a robot that has just been put on the path, are far above what they become."""

COLUMNS = (
    "mode",
    "suggested_mode",
    "robot_x",
    "robot_y",
    "yaw",
    "reference_x",
    "reference_y",
    "path_error",
    "step_distance",
    "v_command",
    "w_command",
    "r",
    "p_r",
    "p_h",
    "tsc",
)
"""What is logged, in this order."""


class Task(NamedTuple):
    """What is to be done, for the compiled loop; scheme is one of SCHEDULE, OWN, TSC and PERFORMANCE."""

    scheme: int
    forced: bool
    laps: int
    lower: float
    upper: float
    a_T: float  # noqa: N815
    b_T: float  # noqa: N815
    p_min: float
    p_max: float
    e_max: float
    window: int
    sample_time: float
    first_mode: int
    r0: float


@numba.njit(cache=True)
def reaction(person, mind):
    """Return the time between a decision and the hand's doing it [s]; its logarithm is normal."""
    return person.reaction_lag * np.exp(person.reaction_spread * mind.standard_normal())


@numba.njit(cache=True)
def limited(command, now, largest, step):
    """Return the speed that follows `now`, at most `step` away from it and at most `largest` in size."""
    change = min(max(command - now, -step), step)
    return min(max(now + change, -largest), largest)


@numba.njit(cache=True)
def drive(task, schedule, path, posts, robot, person, sensing, hand, mind, log, lap_times, correction):
    """Fill the rows of `log` (COLUMNS), the times at which laps end and the correction's log; return rows and laps done."""
    dt, lap_length = task.sample_time, path[-1, 2]
    delay = round(person.delay / dt)
    x, y, tx, ty = path_point(0.0, path)
    yaw, v, w = np.arctan2(ty, tx), robot.cruise_speed, 0.0
    est_x, est_y = x, y
    heading_error, found = 0.0, np.empty((posts.shape[0], 4))
    stays = np.exp(-dt / person.wander_time)
    wander, shaking = hand.standard_normal(), hand.standard_normal()
    shakes = np.exp(-dt / 0.25)
    grip = 1.0 - np.exp(-dt / person.hand_lag)
    v_hand, w_hand = v, 0.0
    r, mode, moved = task.r0, task.first_mode, v * dt
    arc = np.empty(log.shape[0])
    z = np.empty((log.shape[0], 2))
    sum_r, sum_h, progress, done = 0.0, 0.0, 0.0, 0
    suggested, decided, due = -1, -1, 0.0
    episode, episode_seen, willing = -1, -1e9, False
    lower = task.lower + person.lower_spread * mind.standard_normal() if task.scheme == OWN else task.lower
    upper = task.upper + person.upper_spread * mind.standard_normal() if task.scheme == OWN else task.upper
    shift_l, shift_u = 0.0, 0.0
    for k in range(log.shape[0]):
        t = k * dt
        ref_x, ref_y, arc[k], error = nearest_point(x, y, path)
        if k > 0:
            ahead = arc[k] - arc[k - 1]
            progress += ahead - lap_length * np.round(ahead / lap_length)
            if progress >= (done + 1) * lap_length:
                if done < lap_times.size:
                    lap_times[done] = t
                done += 1

        # The operator: looks ahead from where the robot was a delay ago; skill follows utilization, (2.5)-(2.6).
        skill = (person.p_max - person.p_min) * yerkes_dodson(r, person.beta) + person.p_min
        speed, spread, activity = driving_style(skill, person.robot_floor, person.robot_gain)
        wander = stays * wander + np.sqrt(1.0 - stays**2) * hand.standard_normal()
        shaking = shakes * shaking + np.sqrt(1.0 - shakes**2) * hand.standard_normal()
        if k >= delay:
            seen_x, seen_y, seen_yaw, seen_arc = x, y, yaw, arc[k - delay]
            if delay > 0:
                seen_x, seen_y, seen_yaw = log[k - delay, 2], log[k - delay, 3], log[k - delay, 4]
            px, py, tx, ty = path_point(seen_arc + person.look_ahead, path)
            aside = person.noise * spread * wander
            bearing = wrapped(np.arctan2(py + aside * tx - seen_y, px - aside * ty - seen_x) - seen_yaw)
            v_want, w_want = joystick(bearing, speed, person.steering_gain, person.easing)
            v_hand += grip * (v_want - v_hand)
            w_want += person.noise * activity * shaking
            w_hand += grip * (w_want * (1.0 if mode == 1 else person.idle_share) - w_hand)
        v_hand = min(max(v_hand, 0.0), robot.max_speed)
        w_hand = min(max(w_hand, -robot.max_turn_rate), robot.max_turn_rate)

        # Performance as measured, (2.4) and (2.7), and TSC (2.1).
        near = 1.0 - error / task.e_max
        z[k, 0], z[k, 1] = moved / dt * near, v_hand * near + abs(w_hand) * (1.0 - near)
        sum_r, sum_h = sum_r + z[k, 0], sum_h + z[k, 1]
        if k >= task.window:
            sum_r, sum_h = sum_r - z[k - task.window, 0], sum_h - z[k - task.window, 1]
        p_r, p_h = sum_r / min(k + 1, task.window), sum_h / min(k + 1, task.window)
        tsc = task.a_T * p_r - task.b_T * p_h

        # Suggestions by thresholds that are being corrected (2.40); own ones may move along.
        if correction.active:
            corrected_l, corrected_u = correction.thresholds[LOWER], correction.thresholds[UPPER]
            if task.scheme == TSC:
                lower, upper = corrected_l, corrected_u
            else:
                standing = mode if suggested < 0 else suggested
                suggested = threshold_mode(tsc, corrected_l, corrected_u, standing)
            if t < SETTLING:
                correction.log[k].lower, correction.log[k].upper = corrected_l, corrected_u
            else:
                c_l, c_u = correct_thresholds(correction, k, r, p_r, mode)
                if correction.adopted:
                    lower, upper, shift_l, shift_u = lower + c_l, upper + c_u, shift_l + c_l, shift_u + c_u

        # Who drives.
        before = mode
        if task.scheme == SCHEDULE:
            mode = schedule[k]
        elif t < SETTLING:
            pass
        elif task.scheme == OWN:
            if decided < 0 and threshold_mode(tsc, lower, upper, mode) != mode:
                decided, due, willing = 1 - mode, t + reaction(person, mind), True
        else:
            if task.scheme == TSC:
                suggested = threshold_mode(tsc, lower, upper, mode if suggested < 0 else suggested)
                follow = person.follow_tsc
            else:
                suggested = performance_suggestion(p_r, task.p_min, task.p_max)
                follow = person.follow_performance
            if suggested == mode:
                decided, episode = -1, -1
            elif suggested >= 0:
                if suggested != episode or t - episode_seen > DEADLINE:
                    willing = task.forced or mind.random() < follow
                    late = reaction(person, mind)
                    if not willing:
                        late += DEADLINE + person.ignoring_time * mind.standard_exponential()
                    episode, decided, due = suggested, suggested, t + late
                episode_seen = t
        if decided >= 0 and t >= due:
            if willing or suggested == decided:
                mode = decided
            decided = -1
        if mode != before:
            episode = -1
            if task.scheme == OWN:
                lower = task.lower + shift_l + person.lower_spread * mind.standard_normal()
                upper = task.upper + shift_u + person.upper_spread * mind.standard_normal()

        log[k, 0], log[k, 1] = mode, suggested
        log[k, 2], log[k, 3], log[k, 4] = x, y, yaw
        log[k, 5], log[k, 6], log[k, 7], log[k, 8] = ref_x, ref_y, error, moved
        log[k, 9], log[k, 10], log[k, 11] = v_hand, w_hand, r
        log[k, 12], log[k, 13], log[k, 14] = p_r, p_h, tsc
        if task.laps > 0 and done >= task.laps:
            return k + 1, done

        # The robot: what it sees, what it would do, what it does.
        est_yaw = yaw + heading_error
        off_x, off_y, turn, seen = scan(x, y, yaw, est_x, est_y, est_yaw, posts, robot, sensing, found)
        if mode == 1:
            v_want, w_want = v_hand, w_hand
            share = 1.0 - np.exp(-dt / robot.anchoring_time)
            est_x, est_y = est_x + share * (x - est_x), est_y + share * (y - est_y)
            heading_error -= share * heading_error
        else:
            est_arc = nearest_point(est_x, est_y, path)[2]
            px, py, tx, ty = path_point(est_arc + robot.look_ahead, path)
            w_want = robot.steering_gain * wrapped(np.arctan2(py - est_y, px - est_x) - est_yaw)
            v_want = robot.search_speed
            if seen > 0:
                v_want = max(robot.cruise_speed - robot.speed_gain * np.hypot(off_x, off_y), 0.0)
                share = min(robot.position_gain * seen, 1.0)
                est_x, est_y = est_x - share * off_x, est_y - share * off_y
                heading_error -= min(robot.heading_gain * (seen - 1), 1.0) * turn
        v = max(limited(v_want, v, robot.max_speed, robot.max_acceleration * dt), 0.0)
        w = limited(w_want, w, robot.max_turn_rate, robot.max_turn_acceleration * dt)
        old_x, old_y, middle = x, y, yaw + 0.5 * w * dt
        x, y, yaw = x + v * dt * np.cos(middle), y + v * dt * np.sin(middle), wrapped(yaw + w * dt)
        moved = np.hypot(x - old_x, y - old_y)
        est_x, est_y = (
            est_x + v * dt * np.cos(middle + heading_error),
            est_y + v * dt * np.sin(middle + heading_error),
        )
        heading_error += robot.heading_drift * v * dt
        heading_error += robot.heading_noise * np.sqrt(v * dt) * sensing.standard_normal()
        r = min(max(person.a * r + (1.0 - person.a) * mode, 0.0), 1.0)
    return log.shape[0], done
