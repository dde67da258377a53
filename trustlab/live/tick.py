"""
One tenth of a second of a drive by a person: the testbed's own steps, the hand's command in place
of the operator.
"""

from typing import Any, NamedTuple

import numpy as np

from trustlab.models.compiled import njit
from trustlab.models.tsc import next_utilization, threshold_mode
from trustlab.teleoperation.records import record
from trustlab.testbeds.deciding import OWN, SCHEDULE, Task, suggest
from trustlab.testbeds.ground_robot.kernel import enter, locate, perform, place, roll
from trustlab.testbeds.ground_robot.pioneer import PioneerNumbers

SCORE = 5
"""A source of suggestions beside those of `deciding`: thresholds of a weighted sum of signals."""

SIGNALS = ("tsc", "p_r", "p_h", "r")
"""What is summed."""

WHOLE = ("scheme", "forced", "laps", "window", "first_mode")
TASK = np.dtype(
    [
        (name, np.int64 if name in WHOLE else float)
        for name in (*Task._fields, "settling", "notice", "a", *SIGNALS)
    ]
)
"""
A `Task` and what only live drives need: the time before which nobody switches and that between a
forced suggestion and its being carried out [s], a of (2.5), and the weights of a rule of one's own.
"""

ROBOT = record(numbers=" ".join((*PioneerNumbers._fields, "anchor")))
"""
A `Pioneer`, and the share by which its estimate is anchored in one sample while the person drives.
"""

FORCING = record(numbers="since")
"""Since when a forced suggestion stands that is not carried out yet [s]; −1 for none."""


class Command(NamedTuple):
    """What the person wants: speed [m/s], turn rate [rad/s], and a mode."""

    v: float
    w: float
    mode: float


class World(NamedTuple):
    """What a drive takes place in: records of TASK and ROBOT, the course, and a source of noise."""

    task: Any
    robot: Any
    course: Any
    source: Any


class Room(NamedTuple):
    """
    What a drive writes into: performances of each sample, posts that the scanner sees, and records
    of STATE and FORCING.
    """

    z_r: Any
    z_h: Any
    posts: Any
    state: Any
    forcing: Any


@njit
def begin_drive(task, robot, course, state, forcing):
    """Put a robot on the course, rolling, the person rested and the mode the first one."""
    place(course, robot, task.sample_time, state)
    state.r = task.r0
    state.mode = task.first_mode
    state.suggested = -1
    state.lower = task.lower
    state.upper = task.upper
    forcing.since = -1.0


@njit
def decide(task, t, mode, state, forcing):
    """
    Make the suggestion of the scheme; the mode that the person wants decides, or a forced
    suggestion, a notice later or as soon as accepted.
    """
    if t < task.settling:
        return
    if task.scheme == SCORE:
        score = task.tsc * state.tsc + task.p_r * state.p_r
        score += task.p_h * state.p_h + task.r * state.r
        standing = state.mode if state.suggested < 0 else state.suggested
        state.suggested = threshold_mode(score, state.lower, state.upper, standing)
    elif task.scheme != OWN and task.scheme != SCHEDULE:
        suggest(task, state)
    if not task.forced:
        state.mode = 1 if mode == 1.0 else 0
    elif state.suggested < 0 or state.suggested == state.mode:
        forcing.since = -1.0
    else:
        forcing.since = t if forcing.since < 0.0 else forcing.since
        if mode == state.suggested or t - forcing.since >= task.notice:
            state.mode, forcing.since = state.suggested, -1.0


@njit
def tick(k, command, world, room, row):
    """Fill the row of sample k under a command, then move; return whether all laps are done."""
    task = world.task
    robot = world.robot
    course = world.course
    state = room.state
    locate(course, k, row, state)
    state.v_hand = min(max(command.v, 0.0), robot.max_speed)
    state.w_hand = min(max(command.w, -robot.max_turn_rate), robot.max_turn_rate)
    perform(task, k, room.z_r, room.z_h, row, state)
    decide(task, k * task.sample_time, command.mode, state, room.forcing)
    enter(row, state)
    if 0 < task.laps <= state.laps:
        return 1
    roll(robot, robot.anchor, task.sample_time, course, room.posts, state, world.source)
    state.r = min(max(next_utilization(state.r, state.mode, task.a), 0.0), 1.0)
    return 0
