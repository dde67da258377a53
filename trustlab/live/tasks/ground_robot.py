"""The ground robot as a live task: drives along a course under the conditions C1 to C5."""

import math
from collections.abc import Iterable, Mapping
from typing import Any, ClassVar

import numpy as np

from trustlab.live.condition import NOTICE, LiveCondition
from trustlab.live.hands import Driver, HumanHand
from trustlab.live.noise import HASHED
from trustlab.live.study.settings import DriveSettings, model_of
from trustlab.live.task import LiveTask
from trustlab.live.tick import (
    FORCING,
    ROBOT,
    SCORE,
    SIGNALS,
    TASK as NUMBERS,
    Command,
    Room,
    World,
    begin_drive,
    tick,
)
from trustlab.models.checks import of_class, one_of, positive, warn, whole_number
from trustlab.models.tsc import TscModel
from trustlab.sessions.session import Session
from trustlab.testbeds.condition_run import condition_measures
from trustlab.testbeds.deciding import (
    CONDITIONS,
    OWN,
    SAMPLE_TIME,
    SCHEDULE,
    SETTLING,
    TSC,
    task_of,
)
from trustlab.testbeds.ground_robot.conditions import E_MAX, SLOWEST
from trustlab.testbeds.ground_robot.course import Course, CourseNumbers, default_course
from trustlab.testbeds.ground_robot.kernel import COLUMNS, LOG, STATE
from trustlab.testbeds.ground_robot.pioneer import Pioneer

COMMANDS = ("v_command", "w_command", "mode")

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
    course = of_class("course", course or default_course(), Course)
    phases = None
    if schedule is not None:
        phases = [[whole_number("mode", m, 0, 1), positive("length", s)] for m, s in schedule]
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
    task |= {"settling": 0.0 if free else SETTLING, "notice": notice, **weights}
    task["a"] = model.human.a if model else 0.9991
    return {
        "live_task": "ground_robot",
        "condition": name,
        "columns": [*COLUMNS, "laps"],
        "commands": list(COMMANDS),
        "limits": {
            "v_command": [0.0, robot.max_speed],
            "w_command": [-robot.max_turn_rate, robot.max_turn_rate],
            "mode": [0, 1],
        },
        "sample_time": SAMPLE_TIME,
        "samples": _samples(laps, seconds, phases, course),
        "seed": whole_number("seed", seed, least=0, most=MOST_SEED),
        "schedule": phases,
        "task": {
            name: int(value) if NUMBERS[name].kind == "i" else float(value)
            for name, value in task.items()
        },
        "robot": _robot_numbers(robot),
        "path": course.path.tolist(),
        "posts": course.posts.tolist(),
        "ramp": dict(RAMP),
        "view": VIEW | view,
        "late": (VIEW | view)["delay"],
        "clock": "real",
    }


def _robot_numbers(robot: Pioneer) -> dict[str, float]:
    """Return the numbers of a robot; its estimate is anchored while the person drives."""
    anchor = 1.0 - math.exp(-SAMPLE_TIME / robot.anchoring_time)
    return robot.numbers._asdict() | {"anchor": anchor}


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
    """A drive, stepped by what the person commands: speed, turn rate, and the mode wanted."""

    def __init__(self, config: Mapping[str, Any]):
        self.config = config
        self.k = 0
        self.done = False
        task, robot = (
            np.array([tuple(config[name][field] for field in kind.names)], kind)[0]
            for name, kind in (("task", NUMBERS), ("robot", ROBOT))
        )
        path, posts = (np.array(config[name], dtype=float) for name in ("path", "posts"))
        source = np.array([(config["seed"], 0)], HASHED)[0]
        self.world = World(task, robot, CourseNumbers(path, posts), source)
        self.state, forcing = np.zeros(1, STATE)[0], np.zeros(1, FORCING)[0]
        z_r, z_h = np.empty((2, config["samples"]))
        self.room = Room(z_r, z_h, np.empty((len(posts), 4)), self.state, forcing)
        self.row: list[float] = []
        self._log = np.zeros(1, LOG)[0]
        self.ends = np.cumsum([length for _, length in config["schedule"] or ()]) / SAMPLE_TIME
        begin_drive(task, robot, self.world.course, self.state, forcing)

    def step(self, *command: float) -> list[float]:
        """Drive for one sample; where modes are scheduled, the one that is wanted has no effect."""
        v, w, mode = command
        if self.ends.size:
            phase = min(int(np.searchsorted(self.ends, self.k, side="right")), self.ends.size - 1)
            mode = self.config["schedule"][phase][0]
        # a float also where the mode is whole: else all would be compiled once more
        done = tick(self.k, Command(v, w, float(mode)), self.world, self.room, self._log)
        self.k += 1
        self.done = bool(done) or self.k >= self.config["samples"]
        self.row = [*self._log.tolist(), float(self.state["laps"])]
        return self.row

    def picture(self) -> dict[str, Any]:
        """Return the pose, the way along the course [m], the laps and the last row."""
        state = self.state
        pose = {name: round(float(state[name]), 5) for name in ("x", "y", "yaw", "arc")}
        row = [round(value, 4) for value in self.row] or None
        return {**pose, "laps": int(state["laps"]), "row": row}


class GroundRobotTask(LiveTask):
    """Drives along a course under the conditions C1 to C5."""

    name: ClassVar[str] = "ground_robot"
    conditions: ClassVar[tuple[str, ...]] = tuple(CONDITIONS)
    practice: ClassVar[tuple[str, ...]] = ("training", "identification")
    reported: ClassVar[tuple[str, ...]] = (
        "p_r",
        "p_h",
        "r",
        "path_error",
        "manual_share",
        "switches",
        "lap_time",
    )
    settings: ClassVar[type] = DriveSettings
    decisions: ClassVar[tuple[str, ...]] = ("mode", "suggested_mode", "laps")

    def config(
        self, content: Mapping[str, Any], condition: str, known: Mapping[str, Any], seed: int
    ) -> dict[str, Any]:
        """Return the settings of a drive, of `drive_config`."""
        length: dict[str, Any] = {"laps": content["laps"]}
        course, robot = content["course"], content["robot"]
        place: dict[str, Any] = {
            "course": None if course is None else Course(**course),
            "robot": None if robot is None else Pioneer(**robot),
        }
        if condition == "training":
            length = {"seconds": content["training"]}
        elif condition == "identification":
            length = {"schedule": [tuple(phase) for phase in content["identification"]]}
        model, thresholds = model_of(known["model"]), tuple(known["thresholds"])
        personal = content["own_conditions"].get(condition)
        rule = condition if personal is None else LiveCondition(**personal)
        return drive_config(rule, model=model, thresholds=thresholds, seed=seed, **length, **place)

    def begin(self, config: Mapping[str, Any]) -> Drive:
        """Return a drive at its beginning."""
        return Drive(config)

    def hand(self, config: Mapping[str, Any], rng: np.random.Generator) -> Driver:
        """Return a hand with a person's limits, which follows suggestions."""
        return Driver(config, HumanHand(config, int(rng.integers(2**32))))

    def minutes(self, config: Mapping[str, Any]) -> float:
        """Return how long a drive takes, its laps at two thirds of the largest speed [min]."""
        speed = config["robot"]["max_speed"] * 2.0 / 3.0
        laps = config["task"]["laps"] * config["path"][-1][2] / speed
        return laps / 60.0 if laps else super().minutes(config)

    def session(self, config: Mapping[str, Any], rows: Any, **metadata: Any) -> Session:
        """Return the session of a drive."""
        task = config["task"]
        facts: dict[str, Any] = {
            "settling": task["settling"],
            "performance_window": task["window"] * SAMPLE_TIME,
        }
        facts |= {"laps": task["laps"]} if task["laps"] else {}
        if task["scheme"] == TSC:
            facts |= {"TSC_l": task["lower"], "TSC_u": task["upper"]}
        if task["scheme"] == SCORE:
            facts |= {"rule": {signal: task[signal] for signal in SIGNALS if task[signal]}}
            facts |= {"rule_thresholds": [task["lower"], task["upper"]]}
        facts |= {"stamp_error": 0.0}  # the drive switches on a sample
        table = np.array(rows, dtype=float).reshape(len(rows), len(config["columns"]))
        laps = table[:, -1]  # no signal of the session
        facts["lap_times"] = (SAMPLE_TIME * (np.flatnonzero(np.diff(laps) > 0.0) + 1)).tolist()
        signals = {**config, "columns": config["columns"][:-1]}
        return super().session(signals, table[:, :-1], **facts, **metadata)

    def measures(self, session: Session) -> dict[str, float]:
        """Return the measures of `run_condition`."""
        laps = np.asarray(session.metadata.more["lap_times"], dtype=float)
        condition = str(session.metadata.condition)
        return condition_measures(session, session.t, condition, lap_times=laps)


TASK = GroundRobotTask()
