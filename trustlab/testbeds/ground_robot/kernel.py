"""
The loop that drives the ground robot, a simulated stand-in for the Stage testbed of Fig. 2.1: one
step of operator, allocation and robot every tenth of a second; and what is driven by it.

A sample begins at its pause: the robot has been located, the hand has moved and performance has
been measured. `drive` then lets somebody decide who drives, logs the sample, moves the robot and
comes to the next pause. The parts that hold no operator (`place`, `locate`, `perform`, `enter` and
`roll`) are the steps of live drives as well. Who decides when is in trustlab/testbeds/deciding.py.

No reference is counted in the loop nor in what it calls with arrays (_nrt=False): the counts are
atomic and would take a third of its time. It allocates nothing, and its caller keeps what it is
given.
"""

import math
from collections import namedtuple
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from trustlab.models.checks import (
    Checked,
    NotNegative,
    Positive,
    Seed,
    Share,
    of_class,
    spawned,
)
from trustlab.models.compiled import inner, njit
from trustlab.models.records import record
from trustlab.models.simulation import END, Simulation
from trustlab.operators.ground_robot import Operator, driving_style, joystick
from trustlab.sessions.session import Session
from trustlab.testbeds.deciding import (
    COUNTS,
    FLAGS,
    NUMBERS,
    SAMPLE_TIME,
    SCHEDULE,
    Task,
    allocate,
    begin,
    framed,
    log_decision,
    measure,
    metadata_of,
    skill_now,
    tire,
)
from trustlab.testbeds.ground_robot.course import (
    Course,
    angle_of,
    default_course,
    direction,
    nearest_point,
    path_point,
    size,
)

# Deviation that counts as performance 0 [m], and the least mean speed of a run [m/s].
E_MAX, SLOWEST = 2.0, 0.15
# Largest runs that are made: 1.2 GB are nearly twelve days of driving [s].
MOST_LAPS, MOST_SECONDS = 1000, 1e6

MAKE_OPERATOR = (
    "make one with trustlab.operators.operator(participant, model) or "
    "trustlab.testbeds.published_operator(1)"
)
FACTS = {
    "note": "simulated stand-in for the Stage testbed of Fig. 2.1",
    "performance": "(2.4), (2.7)",
}

# --- the robot ------------------------------------------------------------------------------------


@inner
def wrapped(angle):
    """Return the angle in (−π, π]."""
    return angle - 2.0 * np.pi * np.ceil(angle / (2.0 * np.pi) - 0.5)


@inner(_nrt=False)
def scan(posts, robot, state, sensing):
    """
    Compare posts seen with where the estimate has them: mean offset, turn of the pattern, number
    seen.

    While the operator drives, nothing is compared, but the noise is drawn all the same.
    """
    # Sums over posts seen: their ways from the robot, how far the estimate has them from there, and
    # products of both, dot and cross product in one.
    ways = offs = products = 0j
    seen = 0
    heading, half = direction(state.yaw), 0.5 * robot.field_of_view
    edge = np.cos(half) if half < np.pi else -2.0
    for post in posts:
        way = post - state.place
        square = way.real**2 + way.imag**2
        if square > robot.scan_range**2:
            continue
        distance = np.sqrt(square)
        # how far ahead a post stands tells whether it is in view without an angle
        if heading.real * way.real + heading.imag * way.imag < edge * distance:
            continue
        if sensing.random() > robot.detection:
            continue
        far = robot.range_noise * sensing.standard_normal()
        aside = robot.bearing_noise * sensing.standard_normal()
        if state.mode == 1:
            continue
        # Where the estimate has the post: what was seen, turned by the errors of bearing and of the
        # estimated heading.
        longer = 1.0 + far / max(distance, 1e-9)
        shown = longer * (direction(state.heading_error + aside) * way)
        ways += way
        offs += shown - way
        products += shown * way.conjugate()
        seen += 1
    if seen == 0:
        return 0j, 0.0, 0
    off = offs / seen
    # products of what lies beside the mean
    products -= (ways / seen + off) * ways.conjugate()
    turn = angle_of(products) if seen > 1 else 0.0
    return state.est - state.place + off, turn, seen


@dataclass(frozen=True)
class Pioneer(Checked):
    """
    A Pioneer-like robot (a unicycle) that finds its way by a laser scanner, guide posts and
    odometry.

    The autonomous controller is two proportional laws, on heading, w = steering_gain · (angle to
    the path point look_ahead ahead), and on speed, v = cruise_speed − speed_gain · (how far posts
    stand from where they are expected). Both work from an estimate of the pose that odometry
    carries on with a heading that is a little off, so that it drifts with distance, and that every
    post seen pulls back by a small share of the mismatch. While the operator drives between the
    posts the estimate is anchored anew.

    Parameters
    ----------
    max_speed, max_turn_rate : float
        Limits of speed [m/s] and turn rate [rad/s], for the operator's commands too.
    max_acceleration, max_turn_acceleration : float
        Limits of their rates of change [m/s², rad/s²].
    scan_range, field_of_view : float
        How far [m] and in how wide an angle ahead [rad] the scanner sees posts.
    detection : float
        Probability that a post in view is found in a scan; ten scans a second.
    range_noise, bearing_noise : float
        Standard deviations of measured range [m] and bearing [rad].
    heading_drift : float
        How much the odometry's heading goes wrong per metre [rad/m], positive to the left (wheels
        of unequal size).
    heading_noise : float
        Its random part [rad/√m].
    position_gain, heading_gain : float
        Share of the mismatch in place, and in direction, by which a scan corrects the estimate for
        every post seen (for every post but one).
    anchoring_time : float
        Time constant with which the estimate is anchored while the operator drives [s].
    look_ahead : float
        How far ahead on the path the heading law aims [m].
    steering_gain : float
        Turn rate per angle to that point [1/s].
    cruise_speed, search_speed : float
        Speed when posts stand where they are expected, and when none is seen [m/s].
    speed_gain : float
        Speed given up per metre of mismatch [1/s].

    Raises
    ------
    ValueError
        If a number is not finite, negative, or a share above 1.

    Notes
    -----
    A simulated stand-in for the robot of the Stage testbed (Fig. 2.1). The defaults are calibrated
    so that performance (2.4), left alone for long, has the size of Remark 7; they are not
    measurements of a robot.
    """

    max_speed: Positive = 0.7
    max_turn_rate: Positive = 1.0
    max_acceleration: Positive = 0.5
    max_turn_acceleration: Positive = 3.0
    scan_range: NotNegative = 4.0
    field_of_view: NotNegative = np.pi
    detection: Share = 0.8
    range_noise: NotNegative = 0.05
    bearing_noise: NotNegative = 0.02
    heading_drift: float = -0.042
    heading_noise: NotNegative = 0.01
    position_gain: Share = 0.003
    heading_gain: Share = 0.0016
    anchoring_time: Positive = 2.0
    look_ahead: Positive = 1.2
    steering_gain: Positive = 1.2
    cruise_speed: Positive = 0.425
    speed_gain: NotNegative = 0.03
    search_speed: NotNegative = 0.3

    @property
    def numbers(self) -> Any:
        """The robot as plain numbers for compiled loops, by the names that they have here."""
        return PioneerNumbers(**vars(self))


PioneerNumbers = namedtuple("PioneerNumbers", Pioneer.__match_args__)  # type: ignore[misc]


# --- a sample -------------------------------------------------------------------------------------

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
MOVING = "yaw v w moved heading_error wander shaking v_hand w_hand arc est_arc progress"
# What a step reads and leaves.
STATE = record(
    planar="place est", numbers=f"{MOVING} {NUMBERS}", counts=f"{COUNTS} laps", flags=FLAGS
)


class Rates(NamedTuple):
    """Shares by which first-order lags move on in one sample, the same in all samples."""

    stays: float
    shakes: float
    new_wander: float
    new_shaking: float
    grip: float
    anchor: float


def rates_of(person: Any, robot: Any, dt: float) -> Rates:
    """Return the shares for an operator and a robot."""
    times = person.wander_time, SHAKING, person.hand_lag, robot.anchoring_time
    stays, shakes, lags, drifts = (float(np.exp(-dt / time)) for time in times)
    new_wander, new_shaking = math.sqrt(1.0 - stays**2), math.sqrt(1.0 - shakes**2)
    return Rates(stays, shakes, new_wander, new_shaking, grip=1.0 - lags, anchor=1.0 - drifts)


# What stays the same in all samples; robot and person are numbers of theirs.
DriveSetup = namedtuple("DriveSetup", "task course robot person rates")

# What samples hand on: one record of STATE, the noise of sensing, of the hand and of decisions,
# what is kept of each sample, and when laps ended [s].
DriveState = namedtuple("DriveState", "now sensing hand choices arc z_r z_h lap_times")


@inner
def limited(command, now, largest, step):
    """
    Return the speed that follows `now`, at most `step` away from it and at most `largest` in size.
    """
    change = min(max(command - now, -step), step)
    return min(max(now + change, -largest), largest)


@inner
def operate(setup, before, arc, state, hand):
    """
    Move the operator's hand: it acts on where the robot was a delay ago (`before`, a row of the
    log, at arc length `arc`).

    Skill follows utilization, (2.5)-(2.6); wander about the path and shaking of the hand are
    coloured noise.
    """
    person, robot, rates = setup.person, setup.robot, setup.rates
    skill = skill_now(setup.task, person, state)
    speed, spread, activity = driving_style(skill, person.robot_floor, person.robot_gain)
    state.wander = rates.stays * state.wander + rates.new_wander * hand.standard_normal()
    state.shaking = rates.shakes * state.shaking + rates.new_shaking * hand.standard_normal()
    if arc >= 0.0:
        point, tangent = path_point(arc + person.look_ahead, setup.course)
        aside = person.noise * spread * state.wander
        aim = point + 1j * aside * tangent - complex(before.robot_x, before.robot_y)
        bearing = wrapped(angle_of(aim) - before.yaw)
        v_want, w_want = joystick(bearing, speed, person.steering_gain, person.easing)
        state.v_hand += rates.grip * (v_want - state.v_hand)
        w_want += person.noise * activity * state.shaking
        state.w_hand += rates.grip * (
            w_want * (1.0 if state.mode == 1 else person.idle_share) - state.w_hand
        )
    state.v_hand = min(max(state.v_hand, 0.0), robot.max_speed)
    state.w_hand = min(max(state.w_hand, -robot.max_turn_rate), robot.max_turn_rate)


@inner
def place(course, robot, dt, state):
    """Put the robot on the path, rolling."""
    start, tangent = path_point(0.0, course)
    state.place = state.est = start
    state.yaw = angle_of(tangent)
    state.v = state.v_hand = robot.cruise_speed
    state.moved = state.v * dt


@inner
def locate(course, k, row, state):
    """
    Log where the robot is beside the path, and move progress along the course on; return whether
    this ends a lap.
    """
    row.robot_x, row.robot_y, row.yaw = state.place.real, state.place.imag, state.yaw
    point, arc, row.path_error = nearest_point(state.place, state.arc, course)
    row.reference_x, row.reference_y = point.real, point.imag
    lap, ahead = course.arcs[-1], arc - state.arc if k > 0 else 0.0
    state.arc, state.progress = arc, state.progress + (ahead - lap * np.floor(ahead / lap + 0.5))
    # a corner where the path closes may be nearest for some samples: there rounding must not decide
    ended = state.progress >= (state.laps + 1) * lap - 1e-9
    if ended:
        state.laps += 1
    return ended


@inner
def perform(task, k, z_r, z_h, row, state):
    """Measure performance of robot and hand, (2.4) and (2.7), and TSC (2.1)."""
    near = 1.0 - row.path_error / task.e_max
    z_r[k] = state.moved / task.sample_time * near  # (2.4)
    z_h[k] = state.v_hand * near + abs(state.w_hand) * (1.0 - near)  # (2.7)
    measure(task, k, z_r, z_h, state)


@inner
def enter(row, state):
    """Log all that is not logged yet of this sample."""
    log_decision(row, state)
    row.step_distance = state.moved
    row.v_command = state.v_hand
    row.w_command = state.w_hand


@inner
def roll(robot, anchor, dt, course, state, sensing):
    """
    Let the robot scan, follow the hand or its own controller, and move; its odometry drifts with
    distance.
    """
    off, turn, seen = scan(course.posts, robot, state, sensing)
    if state.mode == 1:
        v_want, w_want = state.v_hand, state.w_hand
        # while the operator drives between the posts, the estimate is anchored anew
        state.est += anchor * (state.place - state.est)
        state.heading_error -= anchor * state.heading_error
        state.est_arc = state.arc
    else:
        state.est_arc = nearest_point(state.est, state.est_arc, course)[1]
        aim = path_point(state.est_arc + robot.look_ahead, course)[0] - state.est
        bearing = angle_of(aim) - (state.yaw + state.heading_error)
        v_want, w_want = robot.search_speed, robot.steering_gain * wrapped(bearing)
        if seen > 0:
            v_want = max(robot.cruise_speed - robot.speed_gain * size(off), 0.0)
            state.est -= min(robot.position_gain * seen, 1.0) * off
            state.heading_error -= min(robot.heading_gain * (seen - 1), 1.0) * turn
    state.v = max(limited(v_want, state.v, robot.max_speed, robot.max_acceleration * dt), 0.0)
    state.w = limited(w_want, state.w, robot.max_turn_rate, robot.max_turn_acceleration * dt)
    # a unicycle over one sample, by the heading at its middle
    before, step = state.place, state.v * dt
    middle = state.yaw + 0.5 * state.w * dt
    state.place += step * direction(middle)
    state.yaw = wrapped(state.yaw + state.w * dt)
    state.moved = size(state.place - before)
    state.est += step * direction(middle + state.heading_error)
    state.heading_error += robot.heading_drift * state.v * dt
    state.heading_error += robot.heading_noise * np.sqrt(step) * sensing.standard_normal()


@inner(_nrt=False)
def sense(k, setup, state, log):
    """Come to the pause of sample k: locate the robot, move the hand, measure performance."""
    task, now, row = setup.task, state.now[0], log[k]
    dt = task.sample_time
    if locate(setup.course, k, row, now) and now.laps <= state.lap_times.size:
        state.lap_times[now.laps - 1] = k * dt
    state.arc[k] = now.arc
    delay = round(setup.person.delay / dt)
    seen = max(k - delay, 0)
    # at first nothing has been seen yet
    arc = state.arc[seen] if k >= delay else -1.0
    operate(setup, log[seen], arc, now, state.hand)
    perform(task, k, state.z_r, state.z_h, row, now)


@njit(_nrt=False)
def drive(first, stop, setup, state, inputs, log):
    """
    Drive, as a kernel of `Simulation`, until `stop` or until all laps are done.

    setup: a `DriveSetup`. state: a `DriveState`. inputs: modes, or NaN. log: records of LOG.
    """
    task, person = setup.task, setup.person
    now, dt = state.now[0], task.sample_time
    if stop == 0:
        place(setup.course, setup.robot, dt, now)
        now.wander, now.shaking = state.hand.standard_normal(), state.hand.standard_normal()
        begin(task, person, now, state.choices)
        sense(0, setup, state, log)
    for k in range(first, stop):
        allocate(task, person, inputs[k], k * dt, now, state.choices)
        enter(log[k], now)
        if 0 < task.laps <= now.laps:
            return k + 1, END
        roll(setup.robot, setup.rates.anchor, dt, setup.course, now, state.sensing)
        tire(person, now)
        if k + 1 < log.size:
            sense(k + 1, setup, state, log)
    return stop, -1


# --- what is driven -------------------------------------------------------------------------------


def drive_modes(
    mode: np.ndarray,
    operator: Operator,
    seed: Seed = 0,
    robot: Pioneer | None = None,
    r0: float = 0.0,
    condition: str = "given modes",
) -> Session:
    """
    Return the session of a drive with these modes, 1 manual or 0 autonomous, every 0.1 s, without
    tsc and suggested_mode; it begins at the utilization r0.
    """
    of_class("operator", operator, Operator, MAKE_OPERATOR)
    task = Task(SCHEDULE, E_MAX, first_mode=int(mode[0]), r0=r0)
    log, _ = driven(task, robot or Pioneer(), default_course(), operator, seed, mode.astype(float))
    metadata = metadata_of("ground_robot", operator, condition, seed, **FACTS)
    return Session(framed(log).drop(columns=["tsc", "suggested_mode"]), metadata)


def identification_session(operator: Operator, seed: Seed = 0) -> Session:
    """
    Drive what Section 2.2.2 identifies a model from: manual up to the maximum and autonomous down
    to the minimum, 800 s each, then four mixed phases of 300 to 500 s, manual and autonomous in
    turn.

    Parameters
    ----------
    operator : Operator
        Who drives.
    seed : int or numpy.random.SeedSequence
        As for `run_condition`; the lengths of the mixed phases are drawn from a fourth stream.

    Returns
    -------
    Session
        At 10 Hz, for `fit_robot`, `fit_human` and `fit_tsc`.

    Raises
    ------
    ValueError
        If an argument is not understood.
    """
    stream = np.random.default_rng(spawned(seed, 4)[3])
    lengths = np.r_[800.0, 800.0, stream.uniform(300.0, 500.0, size=4)]
    samples = np.round(lengths / SAMPLE_TIME).astype(int)
    mode = np.repeat(1 - np.arange(samples.size) % 2, samples)
    return drive_modes(mode, operator, seed, condition="identification")


def driven(
    task: Task,
    robot: Pioneer,
    course: Course,
    operator: Operator,
    seed: Seed,
    inputs: np.ndarray | None = None,
    decide: Callable | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """
    Return the log of a run, and when laps ended; all that are wanted must be done in time.

    Without laps a run has as many samples as `inputs`.
    """
    if inputs is None:
        seconds = task.laps * course.length / SLOWEST
        if seconds > MOST_SECONDS:
            raise ValueError(
                f"{task.laps} laps of {course.length:.3g} m would take up to {seconds:.3g} s, more "
                f"than the {MOST_SECONDS:g} s that one run may last; split it into several runs"
            )
        inputs = np.full(int(np.ceil(seconds / SAMPLE_TIME)) + 1, np.nan)
    count = inputs.size
    rates = rates_of(operator, robot, task.sample_time)
    setup = DriveSetup(task, course.numbers, robot.numbers, operator.numbers, rates)
    sensing, hand, choices = map(np.random.default_rng, spawned(seed, 3))
    arc, z_r, z_h = np.empty((3, count))
    now, lap_times = np.zeros(1, STATE), np.empty(task.laps)
    state = DriveState(now, sensing, hand, choices, arc, z_r, z_h, lap_times)
    log = np.empty(count, LOG)
    run = Simulation(drive, setup, state, inputs, log, decide)
    run.advance(count)
    done = int(now["laps"][0])
    if done < task.laps:
        raise ValueError(
            f"only {done} of {task.laps} laps were done in {count * SAMPLE_TIME:.0f} s "
            f"(an average of {SLOWEST} m/s would do): this robot or operator does not keep to the "
            "course; check their parameters"
        )
    return log[: run.done], lap_times
