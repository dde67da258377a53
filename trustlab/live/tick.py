"""
One tenth of a second of a drive by a person: the testbed's own steps, the hand's command in place
of the operator.
"""

from typing import Any, NamedTuple

import numpy as np

from trustlab.models.compiled import njit
from trustlab.models.tsc import next_utilization, threshold_mode
from trustlab.testbeds.deciding import OWN, SCHEDULE, Task, suggest
from trustlab.testbeds.ground_robot import kernel
from trustlab.testbeds.ground_robot.course import CourseNumbers
from trustlab.testbeds.ground_robot.kernel import enter, locate, perform, place, roll

SCORE = 5
"""A source of suggestions beside those of `deciding`: thresholds of a weighted sum of signals."""

SIGNALS = ("tsc", "p_r", "p_h", "r")
"""What is summed."""

STATE = np.dtype([*kernel.STATE.descr, ("since", float)])
"""
The robot and who drives, and since when a forced suggestion stands that is not carried out yet [s];
−1 for none.
"""


class Switching(NamedTuple):
    """
    What only live drives need: the time before which nobody switches and that between a forced
    suggestion and its being carried out [s], a of (2.5), and the weights of a rule of one's own.
    """

    settling: float
    notice: float
    a: float
    tsc: float
    p_r: float
    p_h: float
    r: float


class World(NamedTuple):
    """
    What a drive takes place in: the task, a `Pioneer` and the share by which its estimate is
    anchored in one sample while the person drives; and room for the performance of each sample.
    """

    task: Task
    switching: Switching
    robot: Any
    anchor: float
    course: CourseNumbers
    z_r: np.ndarray
    z_h: np.ndarray


@njit
def begin_drive(world, state):
    """Put a robot on the course, rolling, the person rested and the mode the first one."""
    task = world.task
    place(world.course, world.robot, task.sample_time, state)
    state.r = task.r0
    state.mode = task.first_mode
    state.suggested = -1
    state.lower = task.lower
    state.upper = task.upper
    state.since = -1.0


@njit
def decide(task, switching, t, mode, state):
    """
    Make the suggestion of the scheme; the mode that the person wants decides, or a forced
    suggestion, a notice later or as soon as accepted.
    """
    if t < switching.settling:
        return
    if task.scheme == SCORE:
        score = switching.tsc * state.tsc + switching.p_r * state.p_r + switching.p_h * state.p_h
        score += switching.r * state.r
        standing = state.mode if state.suggested < 0 else state.suggested
        state.suggested = threshold_mode(score, state.lower, state.upper, standing)
    elif task.scheme != OWN and task.scheme != SCHEDULE:
        suggest(task, state)
    if not task.forced:
        state.mode = 1 if mode == 1.0 else 0
    elif state.suggested < 0 or state.suggested == state.mode:
        state.since = -1.0
    else:
        state.since = t if state.since < 0.0 else state.since
        if mode == state.suggested or t - state.since >= switching.notice:
            state.mode, state.since = state.suggested, -1.0


@njit
def tick(k, v, w, mode, world, sensing, state, row):
    """
    Fill the row of sample k under what the person wants, a speed [m/s], a turn rate [rad/s] and a
    mode, then move, with a generator of the noise of sensing; return whether all laps are done.
    """
    # A generator within the world would make every call 0.1 ms longer: its type is found in Python.
    task, robot = world.task, world.robot
    locate(world.course, k, row, state)
    state.v_hand = min(max(v, 0.0), robot.max_speed)
    state.w_hand = min(max(w, -robot.max_turn_rate), robot.max_turn_rate)
    perform(task, k, world.z_r, world.z_h, row, state)
    decide(task, world.switching, k * task.sample_time, mode, state)
    enter(row, state)
    if 0 < task.laps <= state.laps:
        return True
    roll(robot, world.anchor, task.sample_time, world.course, state, sensing)
    state.r = min(max(next_utilization(state.r, state.mode, world.switching.a), 0.0), 1.0)  # (2.5)
    return False
