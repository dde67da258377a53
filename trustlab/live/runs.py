"""A drive's settings as JSON, and what becomes of its rows: the replay by numba and the session."""

import math
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
import pandas as pd

from trustlab.live.condition import NOTICE, LiveCondition
from trustlab.live.noise import HASHED
from trustlab.live.tasks.task import checked_rows
from trustlab.live.tick import (
    FORCING,
    LOG,
    ROBOT,
    SCORE,
    SIGNALS,
    STATE,
    TASK,
    Command,
    Room,
    World,
    begin_drive,
    drive_commands,
    tick,
)
from trustlab.models.checks import of_class, one_of, positive, warn, whole_number
from trustlab.models.tsc import TscModel
from trustlab.sessions.session import Metadata, Session
from trustlab.testbeds.deciding import (
    CONDITIONS,
    OWN,
    SAMPLE_TIME,
    SCHEDULE,
    SETTLING,
    TSC,
    sample_times,
    task_of,
)
from trustlab.testbeds.ground_robot.conditions import E_MAX, SLOWEST
from trustlab.testbeds.ground_robot.course import Course, CourseNumbers, default_course
from trustlab.testbeds.ground_robot.kernel import COLUMNS
from trustlab.testbeds.ground_robot.pioneer import Pioneer

DRIVES = {**CONDITIONS, "training": (OWN, False), "identification": (SCHEDULE, False)}
"""
Conditions that a person can drive, and two drives without suggestions: free, and by a given
sequence of modes.
"""

LIVE_SPEED = 0.5
"""
Largest speed of the robot in live drives [m/s].

The printed people reach P_r = 0.35–0.40 and P_h up to 0.465 (Table 2.1), which a robot of the
calibrated 0.7 m/s makes too easy: a hand that sees everything reaches 0.67 there. At 0.5 m/s the
best that (2.4) allows is just above the best person printed.
"""

VIEW = {"range": 4.0, "field": 1.9, "delay": 0.2, "height": 0.6, "map": False}
"""
What is seen of the course, from the robot: posts as far as the scanner sees them [m], within a
camera's field of view [rad], 0.2 s late, which is an everyday video link, from 0.6 m above the
ground. The map is for experimenters.
"""

RAMP = {"rise": 2.5, "fall": 6.0}
"""
Keys move a lever and throw no switch: its speed towards full deflection and back to the middle
[1/s].
"""

MOST_SAMPLES = 36_000
"""An hour: the longest live drive."""

MOST_SEED = 2**53 - 1
"""Largest seed that JSON keeps in every language."""


def layout(kind: np.dtype) -> dict[str, Any]:
    """
    Return where a record's fields stand, for a program in another language: offset and kind (f, i
    or b), and the size.
    """
    return {
        "size": kind.itemsize,
        "fields": {name: [kind.fields[name][1], kind[name].kind] for name in kind.names},
    }


RECORDS = {
    "task": TASK,
    "robot": ROBOT,
    "state": STATE,
    "source": HASHED,
    "forcing": FORCING,
    "row": LOG,
}


def drive_config(
    condition: str | LiveCondition,
    model: TscModel | None = None,
    thresholds: tuple[float, float] | None = None,
    laps: int | None = None,
    seed: int = 0,
    seconds: float | None = None,
    schedule: Iterable[tuple[int, float]] | None = None,
    robot: Pioneer | None = None,
    course: Course | None = None,
    **view: Any,
) -> dict[str, Any]:
    """
    Return everything that determines a live drive but the commands, as plain JSON.

    Parameters
    ----------
    condition : str or LiveCondition
        "C1" to "C5", "training" (the person switches at will), "identification" (modes by
        `schedule`), or one of your own.
    model : TscModel, optional
        What TSC (2.1) and suggestions come from, and a of (2.5); without one TSC is 0 and a that of
        the pilot operator.
    thresholds : (float, float), optional
        TSC_l and TSC_u of (2.8), where TSC decides on suggestions.
    laps, seconds, schedule : int, float, sequence of (int, float), optional
        When the drive ends: after so many laps, so many seconds, or the last of the phases (mode,
        length [s]).
    seed : int
        Of the robot's sensing; below 2⁵³.
    robot : Pioneer, optional
        The robot; not faster than 0.5 m/s when not given.
    course : Course, optional
        The course, if not the default one.
    **view : float or bool
        What is seen, in place of `VIEW`.
    """
    name, scheme, forced, notice = _rule_of(condition)
    weights, pair = _own_rule(condition)
    thresholds = pair or thresholds
    robot = of_class("robot", Pioneer(max_speed=LIVE_SPEED) if robot is None else robot, Pioneer)
    course = of_class("course", default_course() if course is None else course, Course)
    phases = (
        None
        if schedule is None
        else [[whole_number("mode", m, 0, 1), positive("length", s)] for m, s in schedule]
    )
    if (scheme == SCHEDULE) != (phases is not None):
        raise ValueError(
            "a schedule of modes goes with the condition 'identification', and only with it"
        )
    lower, upper = thresholds or (0.0, 0.0)
    if scheme == TSC and thresholds is None:
        raise ValueError(
            f"{name} needs thresholds=(TSC_l, TSC_u); take them from "
            "trustlab.choose_thresholds(model)"
        )
    for setting in view:
        one_of("a setting of the view", setting, VIEW)
    first = int(phases[0][0]) if phases else 1
    laps = whole_number("laps", laps, most=100) if laps is not None else 0
    task = task_of(scheme, E_MAX, forced, laps, lower, upper, model, first)._asdict()
    free = name in ("training", "identification")
    task |= {"settling": 0.0 if free else SETTLING, "notice": notice}
    task |= {"a": model.human.a if model else 0.9991} | weights
    numbers = robot.numbers._asdict()
    return {
        "live_task": "ground_robot",
        "condition": name,
        "columns": list(COLUMNS),
        "limits": {
            "v_command": [0.0, robot.max_speed],
            "w_command": [-robot.max_turn_rate, robot.max_turn_rate],
        },
        "sample_time": SAMPLE_TIME,
        "samples": _samples(laps, seconds, phases, course),
        "seed": whole_number("seed", seed, least=0, most=MOST_SEED),
        "schedule": phases,
        "task": {
            name: int(value) if TASK[name].kind == "i" else float(value)
            for name, value in task.items()
        },
        "robot": numbers | {"anchor": 1.0 - math.exp(-SAMPLE_TIME / robot.anchoring_time)},
        "path": course.path.tolist(),
        "posts": course.posts.tolist(),
        "records": {name: layout(kind) for name, kind in RECORDS.items()},
        "ramp": dict(RAMP),
        "view": VIEW | view,
        "clock": "real",
        "hand": None,
    }


def _rule_of(condition: str | LiveCondition) -> tuple[str, int, bool, float]:
    """Return a drive's name, who suggests, whether that must be followed, and after what time."""
    if isinstance(condition, LiveCondition):
        return condition.name, condition.scheme, condition.forced, condition.notice
    scheme, forced = DRIVES[one_of("condition", condition, DRIVES)]
    return condition, scheme, forced, NOTICE


def _own_rule(
    condition: str | LiveCondition,
) -> tuple[dict[str, float], tuple[float, float] | None]:
    """Return the weights and thresholds of a rule of one's own, zeros and None without one."""
    if isinstance(condition, LiveCondition):
        return condition.weights, condition.thresholds
    return dict.fromkeys(SIGNALS, 0.0), None


def _samples(
    laps: int, seconds: float | None, phases: list[list[float]] | None, course: Course
) -> int:
    """Return after how many samples a drive ends at the latest."""
    if (laps > 0) + (seconds is not None) + (phases is not None) != 1:
        raise ValueError("say when the drive ends: give one of laps=, seconds= and schedule=")
    if phases is not None:
        seconds = sum(length for _, length in phases)
    elif seconds is None:
        seconds = laps * course.length / SLOWEST
    samples = round(positive("seconds", seconds) / SAMPLE_TIME)
    if not 2 <= samples <= MOST_SAMPLES:
        raise ValueError(
            f"a live drive lasts from 0.2 s to {MOST_SAMPLES * SAMPLE_TIME:g} s, got up to "
            f"{seconds:g} s; split it"
        )
    return samples


def warn_if_too_short(config: Mapping[str, Any]) -> None:
    """Warn where a drive's laps can be over before anybody may switch."""
    task = config["task"]
    length = config["path"][-1][2]
    lap = length / config["robot"]["max_speed"]
    if task["laps"] and task["laps"] * lap <= task["settling"]:
        warn(
            f"nobody may switch in the first {task['settling']:g} s, when the window of measured "
            f"performance fills, and laps={task['laps']} can take {task['laps'] * lap:.0f} s: "
            f"conditions would hardly differ; take laps={int(task['settling'] // lap) + 1} or more"
        )


class Drive:
    """A drive in Python, step by step: what a browser does, by numba."""

    def __init__(self, config: Mapping[str, Any]):
        self.config = config
        self.k = 0
        self.done = False
        task, robot = (
            np.array([tuple(config[name][field] for field in kind.names)], kind)[0]
            for name, kind in (("task", TASK), ("robot", ROBOT))
        )
        path, posts = (np.array(config[name], dtype=float) for name in ("path", "posts"))
        source = np.array([(config["seed"], 0)], HASHED)[0]
        self.world = World(task, robot, CourseNumbers(path, posts), source)
        self.state, forcing = np.zeros(1, STATE)[0], np.zeros(1, FORCING)[0]
        z_r, z_h = np.empty((2, config["samples"]))
        self.room = Room(z_r, z_h, np.empty((len(posts), 4)), self.state, forcing)
        self.rows = np.empty((config["samples"], len(COLUMNS)))
        self._log = self.rows.view(LOG)[:, 0]
        begin_drive(task, robot, self.world.course, self.state, forcing)

    def step(self, v: float, w: float, mode: float) -> np.void:
        """Drive for one sample under a command and a mode that is wanted; return its row."""
        row = self._log[self.k]
        # a float also where the mode is whole: else all would be compiled once more
        done = tick(self.k, Command(v, w, float(mode)), self.world, self.room, row)
        self.k += 1
        self.done = bool(done) or self.k >= self.config["samples"]
        return row


def driven(config: Mapping[str, Any], commands: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """
    Return the rows that commands, shape (N, 3), v, w and mode, lead to, and when laps ended [s].
    """
    drive = Drive(config)
    rows = np.empty((len(commands), len(COLUMNS)))
    lap_times = np.empty(max(config["task"]["laps"], 1000))
    log = rows.view(LOG)[:, 0]
    count, laps = drive_commands(commands, drive.world, drive.room, log, lap_times)
    return rows[:count], lap_times[:laps]


def commands_of(rows: np.ndarray) -> np.ndarray:
    """Return the commands that rows hold: v, w and the mode."""
    return np.ascontiguousarray(
        rows[:, [COLUMNS.index(name) for name in ("v_command", "w_command", "mode")]]
    )


def replay(config: Mapping[str, Any], rows: np.ndarray) -> bool | int:
    """
    Return whether rows are, bit for bit, what numba computes from their commands.

    Parameters
    ----------
    config : mapping
        The drive's settings, of `drive_config`.
    rows : array_like, shape (N, 15)
        What was logged.

    Returns
    -------
    bool or int
        True, or the number of the first row that differs.
    """
    table = checked_rows(config, rows)
    made, _ = driven(config, commands_of(table))
    if len(made) < len(table):
        return len(made)  # rows go on where all laps are done
    same = (made == table).all(axis=1)
    return True if same.all() else int(np.argmin(same))


def session_of(config: Mapping[str, Any], rows: np.ndarray, **metadata: Any) -> Session:
    """
    Return the session of a live drive.

    Parameters
    ----------
    config : mapping
        The drive's settings, of `drive_config`.
    rows : array_like, shape (N, 15)
        What was logged, at least two rows.
    **metadata : object
        participant, synthetic and whatever else the metadata are to hold.
    """
    table = checked_rows(config, rows)
    if len(table) < 2:
        raise ValueError("a session has at least two samples; wait until 0.2 s are driven")
    task = config["task"]
    facts = {
        "seed": config["seed"],
        "settling": task["settling"],
        "performance_window": task["window"] * SAMPLE_TIME,
    }
    facts |= {"laps": task["laps"]} if task["laps"] else {}
    facts |= {"TSC_l": task["lower"], "TSC_u": task["upper"]} if task["scheme"] == TSC else {}
    if task["scheme"] == SCORE:
        facts |= {"rule": {signal: task[signal] for signal in SIGNALS if task[signal]}}
        facts |= {"rule_thresholds": [task["lower"], task["upper"]]}
    facts |= {"stamp_error": 0.0}  # the drive switches on a sample
    facts |= {"lap_times": driven(config, commands_of(table))[1].tolist()}
    frame = pd.DataFrame(table, columns=COLUMNS, index=pd.Index(sample_times(len(table)), name="t"))
    about = Metadata(condition=config["condition"], source="trustlab.live", more=facts)
    return Session(frame, about.changed(**metadata))
