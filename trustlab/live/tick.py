"""
One tenth of a second of a drive by a person: the testbed's own steps, the hand's command in place
of the operator.

`tick` is compiled by numba for replays and, from the same LLVM IR, to WebAssembly for browsers
(trustlab/live/build.py). Records that it shares with a browser consist of 8-byte fields alone.
"""

from typing import Any, NamedTuple

import numpy as np
from numba import carray, from_dtype, types

from trustlab.live.noise import HASHED
from trustlab.models.compiled import njit
from trustlab.models.tsc import next_utilization, threshold_mode
from trustlab.teleoperation.records import record
from trustlab.testbeds.deciding import OWN, SCHEDULE, Task, suggest
from trustlab.testbeds.ground_robot.course import CourseNumbers
from trustlab.testbeds.ground_robot.kernel import LOG, STATE, enter, locate, perform, place, roll
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


@njit
def drive_commands(commands, world, room, rows, lap_times):
    """
    Drive on from the beginning by commands, shape (N, 3): v, w and mode; fill N records of LOG and
    the times of laps, return how many of each there are.
    """
    state = room.state
    for k in range(rows.size):
        before = state.laps
        command = Command(commands[k, 0], commands[k, 1], commands[k, 2])
        done = tick(k, command, world, room, rows[k])
        if before < state.laps <= lap_times.size:
            lap_times[before] = k * world.task.sample_time
        if done:
            return k + 1, state.laps
    return rows.size, state.laps


# What a browser calls: the same with pointers into the WebAssembly module's memory. Arrays are made
# of pointers, because memory cannot be allocated there.
def begin_there(task, robot, path, pieces, posts, count, state, forcing):
    """Begin a drive in a browser's memory."""
    course = course_there(path, pieces, posts, count)
    begin_drive(
        carray(task, 1)[0], carray(robot, 1)[0], course, carray(state, 1)[0], carray(forcing, 1)[0]
    )


def tick_there(
    k,
    v,
    w,
    mode,
    task,
    robot,
    path,
    pieces,
    posts,
    count,
    source,
    z_r,
    z_h,
    seen,
    state,
    forcing,
    row,
):
    """Make one step in a browser's memory; return whether all laps are done."""
    course = course_there(path, pieces, posts, count)
    world = World(carray(task, 1)[0], carray(robot, 1)[0], course, carray(source, 1)[0])
    sums = carray(z_r, k + 1), carray(z_h, k + 1)
    room = Room(*sums, carray(seen, (count, 4)), carray(state, 1)[0], carray(forcing, 1)[0])
    return tick(k, Command(v, w, mode), world, room, carray(row, 1)[0])


def many_there(
    count,
    commands,
    task,
    robot,
    path,
    pieces,
    posts,
    gates,
    source,
    z_r,
    z_h,
    seen,
    state,
    forcing,
    rows,
):
    """
    Make steps by commands, shape (count, 3), in a browser's memory; return how many rows there are
    then.
    """
    course = course_there(path, pieces, posts, gates)
    commands = carray(commands, (count, 3))
    log = carray(rows, count)
    world = World(carray(task, 1)[0], carray(robot, 1)[0], course, carray(source, 1)[0])
    sums = carray(z_r, count), carray(z_h, count)
    room = Room(*sums, carray(seen, (gates, 4)), carray(state, 1)[0], carray(forcing, 1)[0])
    for k in range(count):
        command = Command(commands[k, 0], commands[k, 1], commands[k, 2])
        if tick(k, command, world, room, log[k]):
            return k + 1
    return count


@njit
def course_there(path, pieces, posts, count):
    """Return the course at pointers."""
    return CourseNumbers(carray(path, (pieces, 3)), carray(posts, (count, 2)))


def _pointers(*kinds):
    return tuple(
        types.CPointer(from_dtype(kind) if isinstance(kind, np.dtype) else kind) for kind in kinds
    )


_world = _pointers(TASK, ROBOT)
_course = (*_pointers(types.float64), types.int32, *_pointers(types.float64), types.int32)
_numbers = types.int32, types.float64, types.float64, types.float64
_room = _pointers(HASHED, types.float64, types.float64, types.float64, STATE, FORCING, LOG)
ENTRIES = {
    "begin": (begin_there, types.void(*_world, *_course, *_pointers(STATE, FORCING))),
    "tick": (tick_there, types.int32(*_numbers, *_world, *_course, *_room)),
    "many": (
        many_there,
        types.int32(types.int32, *_pointers(types.float64), *_world, *_course, *_room),
    ),
}
"""The functions that the WebAssembly module exports, and numba's signatures."""
