"""The ground robot as a live task: drives along a course under the conditions C1 to C5."""

import math
from collections.abc import Iterable, Mapping
from typing import Any, ClassVar

import numpy as np

from trustlab.live.condition import NOTICE, LiveCondition
from trustlab.live.hands import HumanHand
from trustlab.live.study.settings import DriveSettings, model_of
from trustlab.live.task import LiveTask
from trustlab.live.tick import SCORE, SIGNALS, STATE, Switching, World, begin_drive, tick
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
    Task,
)
from trustlab.testbeds.ground_robot.conditions import E_MAX, SLOWEST
from trustlab.testbeds.ground_robot.course import Course, CourseNumbers, default_course
from trustlab.testbeds.ground_robot.kernel import COLUMNS, LOG
from trustlab.testbeds.ground_robot.pioneer import Pioneer, PioneerNumbers

DRIVES = {**CONDITIONS, "training": (OWN, False), "identification": (SCHEDULE, False)}
"""
Conditions that a person can drive, and two drives without suggestions: free, and by a given
sequence of modes.
"""

LIVE_SPEED = 0.5
"""
Largest speed of the robot in live drives [m/s].

The printed people reach P_r = 0.35–0.40 and P_h up to 0.465 (Table 2.1), which a robot of the
calibrated 0.7 m/s makes too easy: a hand that sees everything reached 0.67 there. At 0.5 m/s the
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

PILOT_A = 0.9991
"""a of (2.5) where there is no model of the person: that of the pilot operator."""

WHOLE = ("scheme", "forced", "laps", "window", "first_mode")
"""Numbers of a task that are whole."""


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
    own = condition if isinstance(condition, LiveCondition) else None
    name = own.name if own else one_of("condition", condition, DRIVES)
    scheme, forced = (own.scheme, own.forced) if own else DRIVES[name]
    if own and own.thresholds:
        thresholds = own.thresholds
    if scheme == TSC and thresholds is None:
        raise ValueError(
            f"{name} needs thresholds=(TSC_l, TSC_u); take them from "
            "trustlab.choose_thresholds(model)"
        )
    robot = of_class("robot", Pioneer(max_speed=LIVE_SPEED) if robot is None else robot, Pioneer)
    course = of_class("course", course or default_course(), Course)
    phases = None
    if schedule is not None:
        phases = [[whole_number("mode", m, 0, 1), positive("length", s)] for m, s in schedule]
    if (scheme == SCHEDULE) != (phases is not None):
        raise ValueError(
            "a schedule of modes goes with the condition 'identification', and only with it"
        )
    for setting in view:
        one_of("a setting of the view", setting, VIEW)
    first = int(phases[0][0]) if phases else 1
    laps = whole_number("laps", laps, most=100) if laps is not None else 0
    lower, upper = thresholds or (0.0, 0.0)
    task = Task(scheme, E_MAX, forced, laps, lower, upper, first)
    task = task if model is None else task.suggesting(model)
    anchor = 1.0 - math.exp(-SAMPLE_TIME / robot.anchoring_time)
    return {
        "live_task": "ground_robot",
        "condition": name,
        "columns": [*COLUMNS, "laps"],
        "commands": ["v_command", "w_command", "mode"],
        "limits": {
            "v_command": [0.0, robot.max_speed],
            "w_command": [-robot.max_turn_rate, robot.max_turn_rate],
            "mode": [0, 1],
        },
        "sample_time": SAMPLE_TIME,
        "samples": _samples(laps, seconds, phases, course),
        "seed": whole_number("seed", seed, least=0, most=MOST_SEED),
        "schedule": phases,
        "task": _numbers(task, own, name in ("training", "identification"), model),
        "robot": robot.numbers._asdict() | {"anchor": anchor},
        "path": course.path.tolist(),
        "posts": course.posts.tolist(),
        "ramp": dict(RAMP),
        "view": VIEW | view,
        "late": (VIEW | view)["delay"],
        "clock": "real",
    }


def _numbers(
    task: Task, own: LiveCondition | None, free: bool, model: TscModel | None
) -> dict[str, float]:
    """Return a task and when its mode may change as plain numbers by name."""
    switching = Switching(
        0.0 if free else SETTLING,
        own.notice if own else NOTICE,
        model.human.a if model else PILOT_A,
        **(own.weights if own else dict.fromkeys(SIGNALS, 0.0)),
    )
    both = {**task._asdict(), **switching._asdict()}
    return {name: int(value) if name in WHOLE else float(value) for name, value in both.items()}


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
    lap = config["path"][-1][2] / config["robot"]["max_speed"]
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
        self.row: list[float] = []
        robot = dict(config["robot"])
        anchor = robot.pop("anchor")
        course = CourseNumbers(*(np.array(config[name], float) for name in ("path", "posts")))
        self.world = World(
            Task(**{name: config["task"][name] for name in Task._fields}),
            Switching(**{name: config["task"][name] for name in Switching._fields}),
            PioneerNumbers(**robot),
            anchor,
            course,
            np.empty(config["samples"]),
            np.empty(config["samples"]),
        )
        self.sensing = np.random.default_rng(config["seed"])
        self.state, self._log = np.zeros(1, STATE)[0], np.zeros(1, LOG)[0]
        self.ends = np.cumsum([length for _, length in config["schedule"] or ()]) / SAMPLE_TIME
        begin_drive(self.world, self.state)

    def step(self, *command: float) -> list[float]:
        """Drive for one sample; where modes are scheduled, the one that is wanted has no effect."""
        v, w, mode = map(float, command)  # whole numbers would compile all once more
        if self.ends.size:
            phase = min(int(np.searchsorted(self.ends, self.k, side="right")), self.ends.size - 1)
            mode = float(self.config["schedule"][phase][0])
        done = tick(self.k, v, w, mode, self.world, self.sensing, self.state, self._log)
        self.k += 1
        self.done = done or self.k >= self.config["samples"]
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

    def hand(self, config: Mapping[str, Any], rng: np.random.Generator) -> HumanHand:
        """Return a hand with a person's limits, which follows suggestions."""
        return HumanHand(config, int(rng.integers(2**32)))

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
