"""
The loop that drives the ground robot: one step of operator, allocation and robot every tenth of a
second.

`drive` is a plain loop over the parts of a step, which share one record of STATE and fill one
record of LOG. Those that hold no operator (`place`, `locate`, `perform`, `enter` and `roll`) are
the steps of live drives as well: they get their bits from +, −, ×, ÷ and √ alone. Who decides when
is in trustlab/testbeds/deciding.py.

No reference is counted in the loop nor in what it calls with arrays (_nrt=False): the counts are
atomic and would take a third of its time. It allocates nothing, and its caller keeps what it is
given.
"""

from typing import NamedTuple

import numpy as np

from trustlab.allocation.correction import correct_thresholds
from trustlab.allocation.correction_path import LOWER, UPPER
from trustlab.models.compiled import njit
from trustlab.models.portable import cos_sin, direction, wrapped
from trustlab.models.tsc import next_utilization, threshold_mode
from trustlab.operators.ground_robot import driving_style, joystick
from trustlab.teleoperation.records import record
from trustlab.testbeds.deciding import (
    COUNTS,
    FLAGS,
    NUMBERS,
    SCHEDULE,
    SETTLING,
    TSC,
    allocate,
    begin,
    measure,
    skill_now,
)
from trustlab.testbeds.ground_robot.course import nearest_of, point_ahead
from trustlab.testbeds.ground_robot.pioneer import scan

# Correlation time of the hand's shaking [s].
SHAKING = 0.25

# What is logged of each sample.
LOG = record(
    numbers=(
        "mode suggested_mode robot_x robot_y yaw reference_x reference_y path_error "
        "step_distance v_command w_command r p_r p_h tsc"
    )
)

COLUMNS = LOG.names

# The robot and its estimate of where it is, the hand, and progress along the course.
MOVING = "x y yaw v w moved est_x est_y heading_error wander shaking v_hand w_hand arc progress"
# What a step reads and leaves.
STATE = record(numbers=f"{MOVING} {NUMBERS}", counts=f"{COUNTS} laps", flags=FLAGS)


class Rates(NamedTuple):
    """Shares by which first-order lags move on in one sample, the same in all samples."""

    stays: float
    shakes: float
    new_wander: float
    new_shaking: float
    grip: float
    anchor: float


@njit(inline="always")
def rates_of(person, robot, dt):
    """Return the shares for an operator and a robot."""
    stays, shakes = np.exp(-dt / person.wander_time), np.exp(-dt / SHAKING)
    new_wander, new_shaking = np.sqrt(1.0 - stays**2), np.sqrt(1.0 - shakes**2)
    grip, anchor = 1.0 - np.exp(-dt / person.hand_lag), 1.0 - np.exp(-dt / robot.anchoring_time)
    return Rates(stays, shakes, new_wander, new_shaking, grip, anchor)


@njit
def limited(command, now, largest, step):
    """
    Return the speed that follows `now`, at most `step` away from it and at most `largest` in size.
    """
    change = min(max(command - now, -step), step)
    return min(max(now + change, -largest), largest)


@njit(inline="always")
def operate(task, person, robot, rates, before, arc, course, state, hand):
    """
    Move the operator's hand: it acts on where the robot was a delay ago (`before`, a row of the
    log, at arc length `arc`).

    Skill follows utilization, (2.5)-(2.6); wander about the path and shaking of the hand are
    coloured noise.
    """
    skill = skill_now(task, person, state)
    speed, spread, activity = driving_style(skill, person.robot_floor, person.robot_gain)
    state.wander = rates.stays * state.wander + rates.new_wander * hand.standard_normal()
    state.shaking = rates.shakes * state.shaking + rates.new_shaking * hand.standard_normal()
    if arc >= 0.0:
        px, py, tx, ty = point_ahead(arc + person.look_ahead, course)
        aside = person.noise * spread * state.wander
        dx, dy = px - aside * ty - before.robot_x, py + aside * tx - before.robot_y
        bearing = wrapped(direction(dy, dx) - before.yaw)
        v_want, w_want = joystick(bearing, speed, person.steering_gain, person.easing)
        state.v_hand += rates.grip * (v_want - state.v_hand)
        w_want += person.noise * activity * state.shaking
        state.w_hand += rates.grip * (
            w_want * (1.0 if state.mode == 1 else person.idle_share) - state.w_hand
        )
    state.v_hand = min(max(state.v_hand, 0.0), robot.max_speed)
    state.w_hand = min(max(state.w_hand, -robot.max_turn_rate), robot.max_turn_rate)


@njit(inline="always")
def correct(correction, task, k, t, state):
    """
    Move the thresholds of the suggestions by one step of (2.40), and the operator's own ones with
    them if adopted.
    """
    corrected_l, corrected_u = correction.thresholds[LOWER], correction.thresholds[UPPER]
    if task.scheme == TSC:
        state.lower, state.upper = corrected_l, corrected_u
    else:
        standing = state.mode if state.suggested < 0 else state.suggested
        state.suggested = threshold_mode(state.tsc, corrected_l, corrected_u, standing)  # (2.8)
    if t < SETTLING:
        correction.log[k].lower, correction.log[k].upper = corrected_l, corrected_u
        return
    c_l, c_u = correct_thresholds(correction, k, state.r, state.p_r, state.mode)  # (2.40)
    if correction.adopted:
        state.lower, state.upper = state.lower + c_l, state.upper + c_u
        state.shift_l, state.shift_u = state.shift_l + c_l, state.shift_u + c_u


@njit
def place(course, robot, dt, state):
    """Put the robot on the path, rolling."""
    state.x, state.y, tx, ty = point_ahead(0.0, course)
    state.yaw = direction(ty, tx)
    state.v = robot.cruise_speed
    state.v_hand = robot.cruise_speed
    state.est_x = state.x
    state.est_y = state.y
    state.moved = state.v * dt


@njit(inline="always")
def locate(course, k, row, state):
    """
    Log where the robot is beside the path, and move progress along the course on; return whether
    this ends a lap.
    """
    row.robot_x = state.x
    row.robot_y = state.y
    row.yaw = state.yaw
    row.reference_x, row.reference_y, arc, row.path_error = nearest_of(state.x, state.y, course)
    lap, ahead = course.path[-1, 2], arc - state.arc if k > 0 else 0.0
    state.arc, state.progress = arc, state.progress + (ahead - lap * np.floor(ahead / lap + 0.5))
    ended = state.progress >= (state.laps + 1) * lap
    if ended:
        state.laps += 1
    return ended


@njit(inline="always")
def perform(task, k, z_r, z_h, row, state):
    """Measure performance of robot and hand, (2.4) and (2.7), and TSC (2.1)."""
    near = 1.0 - row.path_error / task.e_max
    z_r[k] = state.moved / task.sample_time * near  # (2.4)
    z_h[k] = state.v_hand * near + abs(state.w_hand) * (1.0 - near)  # (2.7)
    measure(task, k, z_r, z_h, state)


@njit(inline="always")
def enter(row, state):
    """Log all that is not logged yet of this sample."""
    row.mode = state.mode
    row.suggested_mode = state.suggested
    row.step_distance = state.moved
    row.v_command = state.v_hand
    row.w_command = state.w_hand
    row.r = state.r
    row.p_r = state.p_r
    row.p_h = state.p_h
    row.tsc = state.tsc


@njit(inline="always")
def roll(robot, anchor, dt, course, found, state, sensing):
    """
    Let the robot scan, follow the hand or its own controller, and move; its odometry drifts with
    distance.
    """
    off_x, off_y, turn, seen = scan(course.posts, robot, state, sensing, found)
    if state.mode == 1:
        v_want, w_want = state.v_hand, state.w_hand
        # while the operator drives between the posts, the estimate is anchored anew
        state.est_x += anchor * (state.x - state.est_x)
        state.est_y += anchor * (state.y - state.est_y)
        state.heading_error -= anchor * state.heading_error
    else:
        est_arc = nearest_of(state.est_x, state.est_y, course)[2]
        px, py, _, _ = point_ahead(est_arc + robot.look_ahead, course)
        bearing = direction(py - state.est_y, px - state.est_x) - (state.yaw + state.heading_error)
        v_want, w_want = robot.search_speed, robot.steering_gain * wrapped(bearing)
        if seen > 0:
            v_want = max(
                robot.cruise_speed - robot.speed_gain * np.sqrt(off_x * off_x + off_y * off_y), 0.0
            )
            share = min(robot.position_gain * seen, 1.0)
            state.est_x -= share * off_x
            state.est_y -= share * off_y
            state.heading_error -= min(robot.heading_gain * (seen - 1), 1.0) * turn
    state.v = max(limited(v_want, state.v, robot.max_speed, robot.max_acceleration * dt), 0.0)
    state.w = limited(w_want, state.w, robot.max_turn_rate, robot.max_turn_acceleration * dt)
    # a unicycle over one sample, by the heading at its middle
    old_x = state.x
    old_y = state.y
    middle = state.yaw + 0.5 * state.w * dt
    step = state.v * dt
    cos, sin = cos_sin(middle)
    state.x = old_x + step * cos
    state.y = old_y + step * sin
    state.yaw = wrapped(state.yaw + state.w * dt)
    state.moved = np.sqrt((state.x - old_x) ** 2 + (state.y - old_y) ** 2)
    cos, sin = cos_sin(middle + state.heading_error)
    state.est_x += step * cos
    state.est_y += step * sin
    state.heading_error += robot.heading_drift * state.v * dt
    state.heading_error += robot.heading_noise * np.sqrt(step) * sensing.standard_normal()


class Scratch(NamedTuple):
    """
    What the compiled loop needs to remember of each sample, and room for the posts that a scan
    finds.
    """

    arc: np.ndarray
    z_r: np.ndarray
    z_h: np.ndarray
    found: np.ndarray


def scratch(size, course):
    """Return room for so many samples on a course."""
    return Scratch(
        np.empty(size), np.empty(size), np.empty(size), np.empty((course.posts.shape[0], 4))
    )


@njit(_nrt=False)
def drive(
    task,
    schedule,
    course,
    robot,
    person,
    sensing,
    hand,
    decision_rng,
    states,
    log,
    lap_times,
    correction,
    kept,
):
    """
    Fill the records of `log`, the times at which laps end and the correction's log; return rows and
    laps done.

    course: the numbers of a `Course`. robot, person: numbers of a `Pioneer` and an `Operator`.
    sensing, hand, decision_rng: generators of their noise. schedule, shape (N,): modes, used by the
    scheme SCHEDULE alone. states, shape (1,): a record of STATE. correction: a `LoopCorrection`, or
    None, which leaves the engine out of what is compiled.
    """
    dt, state = task.sample_time, states[0]
    delay, (arc, z_r, z_h, found) = round(person.delay / dt), kept
    rates = rates_of(person, robot, dt)
    place(course, robot, dt, state)
    state.wander, state.shaking = hand.standard_normal(), hand.standard_normal()
    begin(task, person, state, decision_rng)
    for k in range(log.size):
        t, row = k * dt, log[k]
        if locate(course, k, row, state) and state.laps <= lap_times.size:
            lap_times[state.laps - 1] = t
        arc[k] = state.arc
        seen = max(k - delay, 0)
        # at first nothing has been seen yet
        operate(
            task,
            person,
            robot,
            rates,
            log[seen],
            arc[seen] if k >= delay else -1.0,
            course,
            state,
            hand,
        )
        perform(task, k, z_r, z_h, row, state)
        if correction is not None:
            correct(correction, task, k, t, state)
        allocate(
            task, person, schedule[k] if task.scheme == SCHEDULE else 0, t, state, decision_rng
        )
        enter(row, state)
        if 0 < task.laps <= state.laps:
            return k + 1, state.laps
        roll(robot, rates.anchor, dt, course, found, state, sensing)
        state.r = min(max(next_utilization(state.r, state.mode, person.a), 0.0), 1.0)  # (2.5)
    return log.size, state.laps
