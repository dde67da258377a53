"""The ground robot as a live task: drives along a course under the conditions C1 to C5."""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from trustlab.allocation.limits import check_thresholds
from trustlab.live.condition import SCORE, SIGNALS, LiveCondition
from trustlab.live.hands import HumanHand
from trustlab.live.task import Delay, LiveTask, run_config
from trustlab.models.checks import Checked, Positive, positive, shown, warn, whole_number
from trustlab.models.compiled import njit
from trustlab.models.tsc import (
    HumanModel,
    RobotModel,
    TscModel,
    next_utilization,
    threshold_mode,
)
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
    suggest,
)
from trustlab.testbeds.ground_robot import kernel
from trustlab.testbeds.ground_robot.course import (
    Course,
    CourseNumbers,
    course_numbers,
    default_course,
)
from trustlab.testbeds.ground_robot.kernel import (
    COLUMNS,
    E_MAX,
    LOG,
    SLOWEST,
    Pioneer,
    PioneerNumbers,
    enter,
    locate,
    perform,
    place,
    roll,
)
from trustlab.testbeds.populations import printed_person

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

VIEW = {"range": 4.0, "field": 1.9, "delay": 0.2, "height": 0.6}
"""
What is seen of the course, from the robot: posts as far as the scanner sees them [m], within a
camera's field of view [rad], 0.2 s late, which is an everyday video link, from 0.6 m above the
ground.
"""

RAMP = {"rise": 2.5, "fall": 6.0}
"""
Keys move a lever and throw no switch: its speed towards full deflection and back to the middle
[1/s].
"""

LONGEST = 3600.0
"""The longest live drive [s]."""

IDENTIFICATION = ((1, 200.0), (0, 200.0), (1, 150.0), (0, 150.0), (1, 150.0), (0, 150.0))
"""
Modes of the identification drive and how long each lasts [s]: Section 2.2.2's manual, autonomous
and mixed phases, in 17 minutes.
"""

STAND_IN = "2"
"""
The printed participant whose model and thresholds stand in where an identification drive says too
little.
"""


STATE = np.dtype([*kernel.STATE.descr, ("since", float)])
"""
The robot and who drives, and since when a forced suggestion stands that is not carried out yet [s];
−1 for none.
"""


@dataclass(frozen=True)
class DriveSettings(Checked):
    """
    The drives of a live study: their length, the course, the robot, and the stand-in model.

    `LiveStudy` takes these settings as keywords, or a `DriveSettings` as `drives`.

    Parameters
    ----------
    laps : int
        Laps of each drive under a condition; 8 as printed.
    training : float
        Length of the training drive [s].
    identification : sequence of (int, float)
        Mode (1 manual, 0 autonomous) and length [s] of each phase of the identification drive.
    model : TscModel, optional
        What stands in for a participant's own model where the identification drive does not
        determine it; its samples are 0.1 s. That of the printed participant 2 by default.
    thresholds : (float, float), optional
        TSC_l and TSC_u that go with `model`; those of Table 2.2 by default.
    course : Course, optional
        The course; that of the ground robot's testbed by default.
    robot : Pioneer, optional
        The robot; by default that of the testbed, not faster than 0.5 m/s.
    least_delay : float
        How late pictures are shown at least [s], so that connections make no difference among
        people; the camera's delay counts where it is longer.

    Raises
    ------
    ValueError
        If a value is not understood.

    Examples
    --------
    >>> import tempfile
    >>> import trustlab as tl
    >>> drives = tl.DriveSettings(laps=4, training=60.0)
    >>> folder = tempfile.mkdtemp() + "/rehearsal"
    >>> tl.LiveStudy(folder, ["C1", "C3"], 4, drives=drives, rehearsal=True)
    <Live study rehearsal: 4 participants, C1, C3; rehearsal by scripted hands>
    """

    laps: int = 8
    training: Positive = 120.0
    identification: Sequence[tuple[int, float]] = IDENTIFICATION
    model: TscModel | None = None
    thresholds: tuple[float, float] | None = None
    course: Course | None = None
    robot: Pioneer | None = None
    least_delay: Delay = 0.0

    def __post_init__(self):
        super().__post_init__()
        self.__dict__["laps"] = whole_number("laps", self.laps, most=1000)
        if (self.model is None) != (self.thresholds is None):
            raise ValueError("model and thresholds belong together; give both or neither")
        self.as_json()

    def as_json(self) -> dict:
        """Return the settings as plain values for `study.json`."""
        _, model, pair = printed_person(STAND_IN)
        model, course = self.model or model, self.course
        pair = check_thresholds(model, self.thresholds or pair)
        return {
            "laps": self.laps,
            "training": self.training,
            "least_delay": self.least_delay,
            "identification": _schedule(self.identification),
            "stand_in": {"model": asdict(model), "thresholds": pair},
            "course": course and {"corners": course.corners, "radius": course.radius},
            "robot": self.robot and asdict(self.robot),
        }


def model_of(content: dict) -> TscModel:
    """Return a model from what `asdict` made of it."""
    return TscModel(RobotModel(**content["robot"]), HumanModel(**content["human"]))


def _schedule(phases: Any) -> list[list[float]]:
    """Return the phases of the identification drive, checked: each of the modes must be driven."""
    try:
        pairs = [(mode, seconds) for mode, seconds in phases]
    except (TypeError, ValueError):
        raise ValueError(
            f"identification must be a list of (mode, seconds), got {shown(phases)}"
        ) from None
    checked = [
        [whole_number("a mode of identification", mode, 0, 1), positive("its seconds", seconds)]
        for mode, seconds in pairs
    ]
    if {mode for mode, _ in checked} != {0, 1}:
        raise ValueError("identification must have phases of both modes, 1 manual and 0 autonomous")
    return checked


def drive_config(content: dict, condition: str, seed: int, known: dict | None = None) -> dict:
    """
    Return the settings of a drive: under C1 to C5 or a condition of the study's own; "training", in
    which the person switches at will; or "identification", in which modes are scheduled.

    TSC (2.1), suggestions and a of (2.5) come from the known model, or else from the stand-in.
    """
    known = known or content["stand_in"]
    model, (lower, upper) = model_of(known["model"]), known["thresholds"]
    robot = Pioneer(**content["robot"] or {"max_speed": LIVE_SPEED})
    course = Course(**content["course"]) if content["course"] else default_course()
    schedule, laps, settling = [], 0, 0.0
    if condition == "training":
        seconds = content["training"]
    elif condition == "identification":
        schedule = content["identification"]
        seconds = sum(length for _, length in schedule)
    else:
        laps, settling = content["laps"], SETTLING
        seconds = laps * course.length / SLOWEST
    if not 0.2 <= seconds <= LONGEST:
        raise ValueError(
            f"a live drive lasts from 0.2 s to {LONGEST:g} s, got up to {seconds:g} s; split it"
        )
    own = content.get("own_conditions", {}).get(condition)
    rule = LiveCondition(**own) if own else LiveCondition("unnamed")
    scheme, forced = (rule.scheme, rule.forced) if own else DRIVES[condition]
    lower, upper = rule.thresholds or (lower, upper)
    first = int(schedule[0][0]) if schedule else 1
    task = Task(scheme, E_MAX, forced, laps, float(lower), float(upper), first).suggesting(model)
    switching = Switching(settling, float(rule.notice), model.human.a, **rule.weights)
    return run_config(
        condition,
        seed,
        seconds,
        {
            "v_command": [0.0, robot.max_speed],
            "w_command": [-robot.max_turn_rate, robot.max_turn_rate],
            "mode": [0, 1],
        },
        live_task="ground_robot",
        sample_time=SAMPLE_TIME,
        columns=[*COLUMNS, "laps"],
        late=VIEW["delay"],
        facts=_facts(task, switching),
        schedule=schedule or None,
        task=task._asdict(),
        switching=switching._asdict(),
        robot=robot.numbers._asdict(),
        path=course.path.tolist(),
        posts=course.posts.tolist(),
        ramp=RAMP,
        view=VIEW,
    )


def warn_if_too_short(config: dict) -> None:
    """Warn where a drive's laps can be over before anybody may switch."""
    laps = config["task"]["laps"]
    lap = config["path"][-1][2] / config["robot"]["max_speed"]
    if laps and laps * lap <= SETTLING:
        warn(
            f"nobody may switch in the first {SETTLING:g} s, when the window of measured "
            f"performance fills, and laps={laps} can take {laps * lap:.0f} s: "
            f"conditions would hardly differ; take laps={int(SETTLING // lap) + 1} or more"
        )


# a tenth of a second: the testbed's own steps, the hand's command in place of the operator
# --------------------------------------------------------------------------------------------------


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
    state.v_hand, state.w_hand = v, w
    perform(task, k, world.z_r, world.z_h, row, state)
    decide(task, world.switching, k * task.sample_time, mode, state)
    enter(row, state)
    if 0 < task.laps <= state.laps:
        return True
    roll(robot, world.anchor, task.sample_time, world.course, state, sensing)
    state.r = min(max(next_utilization(state.r, state.mode, world.switching.a), 0.0), 1.0)  # (2.5)
    return False


class Drive:
    """A drive, stepped by what the person commands: speed, turn rate, and the mode wanted."""

    def __init__(self, config: dict):
        self.k = 0
        self.done = False
        self.row = []
        self.samples = config["samples"]
        self.world = World(
            Task(**config["task"]),
            Switching(**config["switching"]),
            PioneerNumbers(**config["robot"]),
            1.0 - math.exp(-SAMPLE_TIME / config["robot"]["anchoring_time"]),
            course_numbers(config["path"], config["posts"]),
            np.empty(self.samples),
            np.empty(self.samples),
        )
        self.sensing = np.random.default_rng(config["seed"])
        self.state, self._log = np.zeros(1, STATE)[0], np.zeros(1, LOG)[0]
        phases = np.array(config["schedule"] or ()).reshape(-1, 2)
        self.modes, self.ends = phases[:, 0], np.cumsum(phases[:, 1]) / SAMPLE_TIME
        begin_drive(self.world, self.state)

    def step(self, *command: float) -> list[float]:
        """Drive for one sample; where modes are scheduled, the one that is wanted has no effect."""
        v, w, mode = map(float, command)  # whole numbers would compile all once more
        if self.ends.size:
            phase = np.searchsorted(self.ends[:-1], self.k, side="right")
            mode = float(self.modes[phase])
        done = tick(self.k, v, w, mode, self.world, self.sensing, self.state, self._log)
        self.k += 1
        self.done = done or self.k >= self.samples
        self.row = [*self._log.tolist(), float(self.state["laps"])]
        return self.row

    def picture(self) -> dict:
        """Return the pose, the laps and the last row."""
        place, yaw = self.state["place"], self.state["yaw"]
        pose = {"x": place.real, "y": place.imag, "yaw": yaw}
        pose = {name: round(float(value), 5) for name, value in pose.items()}
        row = [round(value, 4) for value in self.row] or None
        return {**pose, "laps": int(self.state["laps"]), "row": row}


def _facts(task: Task, switching: Switching) -> dict:
    """Return what metadata say of a drive by its settings."""
    facts: dict = {
        "settling": switching.settling,
        "performance_window": task.window * SAMPLE_TIME,
        "stamp_error": 0.0,  # the drive switches on a sample
    }
    if task.laps:
        facts["laps"] = task.laps
    if task.scheme == TSC:
        facts |= {"TSC_l": task.lower, "TSC_u": task.upper}
    if task.scheme == SCORE:
        weights = switching._asdict()
        facts["rule"] = {signal: weights[signal] for signal in SIGNALS if weights[signal]}
        facts["rule_thresholds"] = [task.lower, task.upper]
    return facts


def lap_times(table: pd.DataFrame) -> dict:
    """Return when each lap was over; how many are done is no signal of the session."""
    ends = np.flatnonzero(np.diff(table.pop("laps")) > 0.0) + 1
    return {"lap_times": (SAMPLE_TIME * ends).tolist()}


def drive_measures(session: Session) -> dict[str, float]:
    """Return the measures of `run_condition`."""
    about = session.metadata
    laps = np.asarray(about.more["lap_times"], dtype=float)
    return condition_measures(session, session.t, laps)


TASK = LiveTask(
    name="ground_robot",
    conditions=tuple(CONDITIONS),
    practice=("training", "identification"),
    reported=("p_r", "p_h", "r", "path_error", "manual_share", "switches", "lap_time"),
    settings=DriveSettings,
    config=drive_config,
    begin=Drive,
    hand=HumanHand,
    measures=drive_measures,
    facts=lap_times,
    decisions=("mode", "suggested_mode", "laps"),
)
