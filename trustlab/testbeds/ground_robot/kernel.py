"""
The loop that drives the ground robot: one step of operator, allocation and robot every tenth of a second.

`drive` is a plain loop over the parts of a step, which share one record of STATE and fill one record of LOG.
"""

from typing import NamedTuple

import numpy as np

from trustlab.allocation.correction.in_loop import correct_thresholds
from trustlab.allocation.correction.plan import LOWER, UPPER
from trustlab.allocation.rules import performance_suggestion
from trustlab.models.compiled import njit
from trustlab.models.human import next_utilization, performance_at
from trustlab.models.tsc import threshold_mode
from trustlab.operators.ground_robot import driving_style, joystick
from trustlab.teleoperation.records import record
from trustlab.testbeds.ground_robot.course import nearest_point, path_point
from trustlab.testbeds.ground_robot.pioneer import scan, wrapped

SCHEDULE, OWN, TSC, PERFORMANCE = 0, 1, 2, 3
"""Who allocates: a given sequence of modes, the operator, suggestions by (2.8), suggestions by Algorithm 2."""

DEADLINE = 15.0
"""A suggestion counts as followed when the operator complies within this time [s]."""

SETTLING = 100.0
"""Nobody switches before this time [s], when the window of (2.4) and (2.7) is full for the first time: means of the first
few samples, of a robot that has just been put on the path, are far above what they become."""

SHAKING = 0.25
"""Correlation time of the hand's shaking [s]."""

LOG = record(
    numbers=(
        "mode suggested_mode robot_x robot_y yaw reference_x reference_y path_error step_distance v_command w_command r "
        "p_r p_h tsc"
    )
)
"""What is logged of each sample."""

COLUMNS = LOG.names

# The robot and its estimate of where it is, the hand, performance summed over the window, and progress along the course.
MOVING = "x y yaw v w moved est_x est_y heading_error wander shaking v_hand w_hand sum_r sum_h p_r p_h tsc progress r"
# Who drives: own or suggested thresholds, how far a correction has moved own ones, and when a decision takes effect.
DECIDING = "lower upper shift_l shift_u due episode_seen"
STATE = record(numbers=f"{MOVING} {DECIDING}", counts="mode suggested decided episode laps", flags="willing")
"""What a step reads and leaves; −1 stands for no suggestion, no decision under way and no suggestion being considered."""


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


@njit
def reaction(person, mind):
    """Return the time between a decision and the hand's doing it [s]; its logarithm is normal."""
    return person.reaction_lag * np.exp(person.reaction_spread * mind.standard_normal())


@njit
def limited(command, now, largest, step):
    """Return the speed that follows `now`, at most `step` away from it and at most `largest` in size."""
    change = min(max(command - now, -step), step)
    return min(max(now + change, -largest), largest)


@njit
def operate(person, robot, dt, before, arc, path, state, hand):
    """
    Move the operator's hand: it acts on where the robot was a delay ago (`before`, a row of the log, at arc length `arc`).

    Skill follows utilization, (2.5)-(2.6); wander about the path and shaking of the hand are coloured noise.
    """
    skill = performance_at(state.r, person.beta, person.p_min, person.p_max)
    speed, spread, activity = driving_style(skill, person.robot_floor, person.robot_gain)
    stays, shakes = np.exp(-dt / person.wander_time), np.exp(-dt / SHAKING)
    state.wander = stays * state.wander + np.sqrt(1.0 - stays**2) * hand.standard_normal()
    state.shaking = shakes * state.shaking + np.sqrt(1.0 - shakes**2) * hand.standard_normal()
    if arc >= 0.0:
        px, py, tx, ty = path_point(arc + person.look_ahead, path)
        aside = person.noise * spread * state.wander
        dx, dy = px - aside * ty - before.robot_x, py + aside * tx - before.robot_y
        bearing = wrapped(np.arctan2(dy, dx) - before.yaw)
        v_want, w_want = joystick(bearing, speed, person.steering_gain, person.easing)
        grip = 1.0 - np.exp(-dt / person.hand_lag)
        state.v_hand += grip * (v_want - state.v_hand)
        w_want += person.noise * activity * state.shaking
        state.w_hand += grip * (w_want * (1.0 if state.mode == 1 else person.idle_share) - state.w_hand)
    state.v_hand = min(max(state.v_hand, 0.0), robot.max_speed)
    state.w_hand = min(max(state.w_hand, -robot.max_turn_rate), robot.max_turn_rate)


@njit
def correct(correction, task, k, t, state):
    """Move the thresholds of the suggestions by one step of (2.40), and the operator's own ones with them if adopted."""
    corrected_l, corrected_u = correction.thresholds[LOWER], correction.thresholds[UPPER]
    if task.scheme == TSC:
        state.lower, state.upper = corrected_l, corrected_u
    else:
        standing = state.mode if state.suggested < 0 else state.suggested
        state.suggested = threshold_mode(state.tsc, corrected_l, corrected_u, standing)
    if t < SETTLING:
        correction.log[k].lower, correction.log[k].upper = corrected_l, corrected_u
        return
    c_l, c_u = correct_thresholds(correction, k, state.r, state.p_r, state.mode)
    if correction.adopted:
        state.lower, state.upper = state.lower + c_l, state.upper + c_u
        state.shift_l, state.shift_u = state.shift_l + c_l, state.shift_u + c_u


@njit
def own_decision(person, t, state, mind):
    """Let the operator decide by thresholds of TSC of their own (C1)."""
    if state.decided < 0 and threshold_mode(state.tsc, state.lower, state.upper, state.mode) != state.mode:
        state.decided, state.willing = 1 - state.mode, True
        state.due = t + reaction(person, mind)


@njit
def consider(task, person, t, state, mind):
    """Make the suggestion of the scheme (C2–C5), and let the operator decide once per suggestion whether to follow."""
    if task.scheme == TSC:
        standing = state.mode if state.suggested < 0 else state.suggested
        state.suggested = threshold_mode(state.tsc, state.lower, state.upper, standing)
        follow = person.follow_tsc
    else:
        state.suggested = performance_suggestion(state.p_r, task.p_min, task.p_max)
        follow = person.follow_performance
    if state.suggested == state.mode:
        state.decided, state.episode = -1, -1
    elif state.suggested >= 0:
        if state.suggested != state.episode or t - state.episode_seen > DEADLINE:
            state.willing = task.forced or mind.random() < follow
            late = reaction(person, mind)
            if not state.willing:
                late += DEADLINE + person.ignoring_time * mind.standard_exponential()
            state.episode, state.decided, state.due = state.suggested, state.suggested, t + late
        state.episode_seen = t


@njit
def allocate(task, person, scheduled, t, state, mind):
    """Set who drives in this sample."""
    before = state.mode
    if task.scheme == SCHEDULE:
        state.mode = scheduled
    elif t < SETTLING:
        pass
    elif task.scheme == OWN:
        own_decision(person, t, state, mind)
    else:
        consider(task, person, t, state, mind)
    if state.decided >= 0 and t >= state.due:
        if state.willing or state.suggested == state.decided:
            state.mode = state.decided
        state.decided = -1
    if state.mode != before:
        state.episode = -1
        if task.scheme == OWN:  # own thresholds are drawn anew at every switch
            state.lower = task.lower + state.shift_l + person.lower_spread * mind.standard_normal()
            state.upper = task.upper + state.shift_u + person.upper_spread * mind.standard_normal()


@njit
def roll(robot, dt, path, posts, found, state, sensing):
    """Let the robot scan, follow the hand or its own controller, and move; its odometry drifts with distance."""
    est_yaw = state.yaw + state.heading_error
    off_x, off_y, turn, seen = scan(
        state.x, state.y, state.yaw, state.est_x, state.est_y, est_yaw, posts, robot, sensing, found
    )
    if state.mode == 1:
        v_want, w_want = state.v_hand, state.w_hand
        # while the operator drives between the posts, the estimate is anchored anew
        share = 1.0 - np.exp(-dt / robot.anchoring_time)
        state.est_x += share * (state.x - state.est_x)
        state.est_y += share * (state.y - state.est_y)
        state.heading_error -= share * state.heading_error
    else:
        est_arc = nearest_point(state.est_x, state.est_y, path)[2]
        px, py, _, _ = path_point(est_arc + robot.look_ahead, path)
        w_want = robot.steering_gain * wrapped(np.arctan2(py - state.est_y, px - state.est_x) - est_yaw)
        v_want = robot.search_speed
        if seen > 0:
            v_want = max(robot.cruise_speed - robot.speed_gain * np.hypot(off_x, off_y), 0.0)
            share = min(robot.position_gain * seen, 1.0)
            state.est_x -= share * off_x
            state.est_y -= share * off_y
            state.heading_error -= min(robot.heading_gain * (seen - 1), 1.0) * turn
    state.v = max(limited(v_want, state.v, robot.max_speed, robot.max_acceleration * dt), 0.0)
    state.w = limited(w_want, state.w, robot.max_turn_rate, robot.max_turn_acceleration * dt)
    # a unicycle over one sample, by the heading at its middle
    old_x, old_y, middle, step = state.x, state.y, state.yaw + 0.5 * state.w * dt, state.v * dt
    state.x, state.y = old_x + step * np.cos(middle), old_y + step * np.sin(middle)
    state.yaw = wrapped(state.yaw + state.w * dt)
    state.moved = np.hypot(state.x - old_x, state.y - old_y)
    state.est_x += step * np.cos(middle + state.heading_error)
    state.est_y += step * np.sin(middle + state.heading_error)
    state.heading_error += robot.heading_drift * state.v * dt
    state.heading_error += robot.heading_noise * np.sqrt(step) * sensing.standard_normal()


@njit
def start(task, path, robot, person, state, hand, mind):
    """Put the robot on the path, rolling, and draw the operator's first thresholds."""
    state.x, state.y, tx, ty = path_point(0.0, path)
    state.yaw, state.v, state.v_hand = np.arctan2(ty, tx), robot.cruise_speed, robot.cruise_speed
    state.est_x, state.est_y, state.moved = state.x, state.y, state.v * task.sample_time
    state.wander, state.shaking = hand.standard_normal(), hand.standard_normal()
    state.r, state.mode, state.episode_seen = task.r0, task.first_mode, -1e9
    state.suggested, state.decided, state.episode = -1, -1, -1
    state.lower, state.upper = task.lower, task.upper
    if task.scheme == OWN:
        state.lower += person.lower_spread * mind.standard_normal()
        state.upper += person.upper_spread * mind.standard_normal()


@njit
def drive(
    task, schedule, path, posts, robot, person, sensing, hand, mind, states, log, lap_times, correction
):  # fmt: skip
    """
    Fill the records of `log`, the times at which laps end and the correction's log; return rows and laps done.

    path, posts: of a `Course`. robot, person: numbers of a `Pioneer` and an `Operator`. sensing, hand, mind: generators of
    their noise. schedule, shape (N,): modes, used by the scheme SCHEDULE alone. states, shape (1,): a record of STATE.
    """
    dt, lap_length, state = task.sample_time, path[-1, 2], states[0]
    delay, found = round(person.delay / dt), np.empty((posts.shape[0], 4))
    arc, z_r, z_h = np.empty(log.size), np.empty(log.size), np.empty(log.size)
    start(task, path, robot, person, state, hand, mind)
    for k in range(log.size):
        t, row = k * dt, log[k]
        row.robot_x, row.robot_y, row.yaw = state.x, state.y, state.yaw
        row.reference_x, row.reference_y, arc[k], row.path_error = nearest_point(state.x, state.y, path)
        if k > 0:
            ahead = arc[k] - arc[k - 1]
            state.progress += ahead - lap_length * np.round(ahead / lap_length)
            if state.progress >= (state.laps + 1) * lap_length:
                if state.laps < lap_times.size:
                    lap_times[state.laps] = t
                state.laps += 1
        if k >= delay:
            operate(person, robot, dt, log[k - delay], arc[k - delay], path, state, hand)
        else:
            operate(person, robot, dt, row, -1.0, path, state, hand)  # nothing has been seen yet
        # performance as measured, (2.4) and (2.7), over the window, and TSC (2.1)
        near = 1.0 - row.path_error / task.e_max
        z_r[k] = state.moved / dt * near
        z_h[k] = state.v_hand * near + abs(state.w_hand) * (1.0 - near)
        state.sum_r, state.sum_h = state.sum_r + z_r[k], state.sum_h + z_h[k]
        if k >= task.window:
            state.sum_r, state.sum_h = state.sum_r - z_r[k - task.window], state.sum_h - z_h[k - task.window]
        used = min(k + 1, task.window)
        state.p_r, state.p_h = state.sum_r / used, state.sum_h / used
        state.tsc = task.a_T * state.p_r - task.b_T * state.p_h
        if correction.active:
            correct(correction, task, k, t, state)
        allocate(task, person, schedule[k] if task.scheme == SCHEDULE else 0, t, state, mind)
        row.mode, row.suggested_mode, row.step_distance = state.mode, state.suggested, state.moved
        row.v_command, row.w_command, row.r = state.v_hand, state.w_hand, state.r
        row.p_r, row.p_h, row.tsc = state.p_r, state.p_h, state.tsc
        if 0 < task.laps <= state.laps:
            return k + 1, state.laps
        roll(robot, dt, path, posts, found, state, sensing)
        state.r = min(max(next_utilization(state.r, state.mode, person.a), 0.0), 1.0)
    return log.size, state.laps
