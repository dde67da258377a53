"""A robot on a course, an operator, and who drives: a simulated stand-in for the Stage testbed of Fig. 2.1."""

import numpy as np
import pandas as pd

from trustlab.allocation.correction.in_loop import no_correction
from trustlab.allocation.limits import check_thresholds, threshold_limits
from trustlab.models.checks import finite_array, finite_number, of_class, one_of, spawned, whole_number
from trustlab.models.tsc import TscModel
from trustlab.operators.ground_robot import Operator
from trustlab.operators.teleoperator import Teleoperator
from trustlab.sessions.session import Metadata, Session
from trustlab.teleoperation.records import log_of
from trustlab.testbeds.deciding import CONDITIONS, OWN, SAMPLE_TIME, SCHEDULE, SETTLING, TSC, WINDOW, task_of
from trustlab.testbeds.ground_robot import kernel
from trustlab.testbeds.ground_robot.course import Course
from trustlab.testbeds.ground_robot.participants import (
    participant_label,
    published_model,
    published_operator,
    published_thresholds,
)
from trustlab.testbeds.ground_robot.pioneer import Pioneer
from trustlab.testbeds.ground_robot.run import GroundRobotRun

E_MAX = 2.0
SLOWEST = 0.15
MOST_LAPS, MOST_STEPS, MOST_PHASES = 1000, 10_000_000, 10_000
"""Largest runs that are made: ten million samples, 1.2 GB, are nearly twelve days of driving."""

MAKE_OPERATOR = (
    "make one with trustlab.operators.operator(participant, model) or trustlab.testbeds.published_operator(1)"
)
NOTE = "simulated stand-in for the Stage testbed of Fig. 2.1"


def run_condition(
    condition: str,
    participant: int | str | Operator | None = None,
    model: TscModel | None = None,
    thresholds: tuple[float, float] | None = None,
    laps: int = 8,
    seed: int | np.random.SeedSequence = 0,
    robot: Pioneer | None = None,
    course: Course | None = None,
    r0: float | None = None,
    operator: Operator | None = None,
) -> GroundRobotRun:
    """
    Drive laps under one of the conditions C1–C5 of Section 2.4.1.2.

    C1: the operator allocates by thresholds of TSC of their own. C2, C3: suggestions by (2.8), free to follow and
    forced. C4, C5: suggestions by Algorithm 2, free and forced. TSC (2.1) and the suggestions come from performance as
    measured, (2.4) and (2.7) over 100 s, and the given model. The run begins in the manual mode, rolling on the path;
    nobody switches before that window is full.

    Parameters
    ----------
    condition : {"C1", "C2", "C3", "C4", "C5"}
        The condition.
    participant : int, str or Operator
        Who drives: the stand-in for a printed participant, 1 to 5, "1" to "5" or "pilot" (`published_operator`), or any
        `Operator`.
    model : TscModel, optional
        The model which TSC and P_max of Algorithm 2 are taken from: the operator's identified one. For a printed
        participant the printed one when not given; needed for an `Operator`.
    thresholds : (float, float), optional
        TSC_l and TSC_u of (2.8), in C2 and C3 only; for a printed participant those of Table 2.2 when not given. In C1
        the operator's own thresholds, `Operator.lower` and `.upper`, decide; in C4 and C5 Algorithm 2.
    laps : int
        How many laps; at least one, at most 1000.
    seed : int or numpy.random.SeedSequence
        Three streams are spawned from it: the robot's sensing, the operator's hand, and the operator's decisions.
    robot : Pioneer, optional
        The robot, if not the calibrated one.
    course : Course, optional
        The course, if not the default one.
    r0 : float, optional
        Utilization at the beginning, in [0, 1]; that of the operator when not given, 0 (rested) unless assumed otherwise.
    operator : Operator, optional
        The same as an `Operator` given as participant.

    Returns
    -------
    GroundRobotRun
        With `.session`, `.measures()`, `.laps()`, `.suggestions()`, `.plot()` and `.plot_path()`.

    Raises
    ------
    ValueError
        If an argument is not understood or would have no effect, thresholds lie outside the limits of Theorem 1 at
        δ_Ph = 0 (which are quoted), or the laps are not finished at 0.15 m/s on average.

    Notes
    -----
    Simulated: no person took part, and the robot's and the hand's parameters are calibrated, not measured.

    In C1 an operator whose threshold is passed within the first 100 s switches at their end, one reaction later, whatever
    TSC is by then: this first switch says nothing about the threshold. The metadata hold these 100 s as `settling`, and
    `estimate_thresholds` leaves such switches out with after=110.0. All switches come a reaction late, see there.

    Examples
    --------
    >>> run = run_condition("C3", participant=2, laps=1, seed=1)
    >>> run.session.metadata.synthetic
    True
    """
    scheme, forced = CONDITIONS[one_of("condition", condition, CONDITIONS)]
    operator, model, printed = _who(participant, operator, model)
    operator, robot, course = _checked(operator, robot, course)
    laps = whole_number("laps", laps, most=MOST_LAPS)
    if thresholds is not None and scheme != TSC:
        decides = (
            "the operator's own thresholds, Operator(lower=, upper=), decide"
            if scheme == OWN
            else "Algorithm 2 decides"
        )
        raise ValueError(f"thresholds have no effect in {condition}, where {decides}; leave them out")
    if scheme == TSC:
        if thresholds is None and printed is None:
            raise ValueError(
                f"{condition} needs thresholds=(TSC_l, TSC_u) for an Operator: take .lower and .upper of "
                "trustlab.choose_thresholds(model), or those of Table 2.2"
            )
        thresholds = check_thresholds(
            model, *_pair(printed if thresholds is None else thresholds), threshold_limits(model, 0.0)
        )
    lower, upper = (operator.lower, operator.upper) if scheme == OWN else thresholds or (0.0, 0.0)
    task = task_of(
        scheme,
        E_MAX,
        forced=forced,
        laps=laps,
        lower=lower,
        upper=upper,
        model=model,
        r0=operator.r0 if r0 is None else r0,
    )
    data, lap_times = _drive(task, _longest(laps, course), robot, course, operator, seed)
    facts = {"laps": laps, "settling": SETTLING} | ({"TSC_l": lower, "TSC_u": upper} if scheme == TSC else {})
    session = _session(data, operator, condition, seed, **facts)
    return GroundRobotRun(session, course, operator, robot, model, thresholds, lap_times)


def drive_modes(
    mode: np.ndarray,
    operator: Operator,
    seed: int | np.random.SeedSequence = 0,
    robot: Pioneer | None = None,
    course: Course | None = None,
    r0: float = 0.0,
    condition: str = "given modes",
) -> Session:
    """
    Drive with a given sequence of modes.

    Parameters
    ----------
    mode : array_like, shape (N,)
        1 manual or 0 autonomous, every 0.1 s; at least two samples.
    operator : Operator
        Who drives.
    seed : int or numpy.random.SeedSequence
        As for `run_condition`.
    robot : Pioneer, optional
        The robot, if not the calibrated one.
    course : Course, optional
        The course, if not the default one.
    r0 : float
        Utilization at the beginning, in [0, 1].
    condition : str
        What the session's metadata call this.

    Returns
    -------
    Session
        At 10 Hz, without tsc and suggested_mode.

    Raises
    ------
    ValueError
        If a mode is neither 0 nor 1, or another argument is not understood.
    """
    operator, robot, course = _checked(operator, robot, course)
    if not isinstance(condition, str):
        raise ValueError(f"condition must be a name for the metadata, got {condition!r:.60}")
    modes = finite_array("mode", mode)
    odd = (modes != 0.0) & (modes != 1.0)
    if odd.any():
        k = int(np.argmax(odd))
        raise ValueError(f"mode must be zeros and ones, but sample {k} is {modes[k]:g}")
    if modes.size < 2:
        raise ValueError(f"mode must have at least two samples, zeros and ones, got {modes.size}")
    _steps(modes.size * SAMPLE_TIME, "mode")
    task = task_of(SCHEDULE, E_MAX, first_mode=int(modes[0]), r0=r0)
    data, _ = _drive(task, modes.size, robot, course, operator, seed, modes.astype(np.int64))
    return _session(data.drop(columns=["tsc", "suggested_mode"]), operator, condition, seed)


def identification_session(
    operator: Operator,
    seed: int | np.random.SeedSequence = 0,
    manual: float = 800.0,
    autonomous: float = 800.0,
    mixed: int = 4,
    phase: tuple[float, float] = (300.0, 500.0),
    robot: Pioneer | None = None,
    course: Course | None = None,
) -> Session:
    """
    Drive what Section 2.2.2 identifies a model from: manual up to the maximum, autonomous down to the minimum, mixed.

    Parameters
    ----------
    operator : Operator
        Who drives.
    seed : int or numpy.random.SeedSequence
        As for `run_condition`; the lengths of the mixed phases are drawn from a fourth stream.
    manual, autonomous : float
        Lengths of the first two phases [s].
    mixed : int
        Number of phases after them, manual and autonomous in turn.
    phase : (float, float)
        Shortest and longest mixed phase [s]. Phases shorter than the window of (2.4), 100 s, blur into each other.
    robot : Pioneer, optional
        The robot, if not the calibrated one.
    course : Course, optional
        The course, if not the default one.

    Returns
    -------
    Session
        For `fit_robot`, `fit_human` and `fit_tsc`.

    Raises
    ------
    ValueError
        If a length is not positive, or another argument is not understood.
    """
    lengths = [finite_number("manual", manual), finite_number("autonomous", autonomous), *_pair(phase, "phase", True)]
    if min(lengths) < SAMPLE_TIME:
        raise ValueError(f"phases must last at least {SAMPLE_TIME} s, got {min(lengths)} s")
    mixed = whole_number("mixed", mixed, least=0, most=MOST_PHASES)
    _steps(lengths[0] + lengths[1] + mixed * lengths[3], "all phases together")
    stream = np.random.default_rng(spawned(seed, 4)[3])
    lengths = np.r_[lengths[:2], stream.uniform(lengths[2], lengths[3], size=mixed)]
    steps = np.maximum(np.round(lengths / SAMPLE_TIME).astype(int), 1)
    mode = np.repeat(1 - np.arange(steps.size) % 2, steps)
    return drive_modes(mode, operator, seed, robot, course, condition="identification")


def _who(participant, operator, model) -> tuple[Operator, TscModel, tuple[float, float] | None]:
    """Return the operator, the model, and the printed thresholds of a printed participant."""
    if operator is not None and participant is not None:
        raise ValueError("give either participant= or operator=, not both")
    someone = operator if participant is None else participant
    if someone is None:
        raise ValueError("who drives? give participant=, 1 to 5 or 'pilot', or an Operator with model=")
    if isinstance(someone, Teleoperator):
        raise ValueError(
            "operator must be of class Operator, got Teleoperator, who flies a UAV (simulate_teleoperation); for the ground robot "
            + MAKE_OPERATOR
        )
    if operator is not None or isinstance(someone, Operator):
        of_class("operator", someone, Operator, MAKE_OPERATOR)
        return someone, of_class("model", model, TscModel), None
    label = participant_label(someone)
    model = published_model(label) if model is None else of_class("model", model, TscModel)
    return published_operator(label), model, published_thresholds(label)


def _steps(seconds: float, what: str) -> int:
    """Return how many samples so many seconds are, unless they are too many."""
    if seconds / SAMPLE_TIME > MOST_STEPS:
        raise ValueError(
            f"{what} would take up to {seconds:.3g} s, more than the {MOST_STEPS * SAMPLE_TIME:.0f} s that one run may last; "
            "split it into several runs"
        )
    return int(np.ceil(seconds / SAMPLE_TIME))


def _checked(operator, robot, course) -> tuple[Operator, Pioneer, Course]:
    robot, course = Pioneer() if robot is None else robot, Course() if course is None else course
    of_class("operator", operator, Operator, MAKE_OPERATOR)
    of_class("robot", robot, Pioneer)
    of_class("course", course, Course)
    return operator, robot, course


def _pair(pair, name: str = "thresholds", equal: bool = False) -> tuple[float, float]:
    try:
        low, high = pair
    except (TypeError, ValueError):
        raise ValueError(f"{name} must be two numbers, lower and upper, got {pair!r}") from None
    low, high = finite_number(f"the lower of {name}", low), finite_number(f"the upper of {name}", high)
    if low > high or (low == high and not equal):
        raise ValueError(f"{name} must be in order, lower then upper, got {low} and {high}")
    return low, high


def _longest(laps: int, course: Course) -> int:
    """Return how many samples laps may take."""
    return _steps(laps * course.length / SLOWEST, f"{laps} laps of {course.length:.3g} m") + 1


def _drive(
    task, most, robot, course, operator, seed, schedule=None, correction=None
) -> tuple[pd.DataFrame, np.ndarray]:
    """Return the log of at most `most` samples, and when laps ended; all that are wanted must be done by then."""
    table, log = log_of(kernel.LOG, most)
    lap_times = np.empty(task.laps)
    streams = [np.random.default_rng(child) for child in spawned(seed, 3)]
    rows, done = kernel.drive(
        task,
        np.ones(1, np.int64) if schedule is None else schedule,
        course.numbers,
        robot.numbers,
        operator.numbers,
        *streams,
        np.zeros(1, kernel.STATE),
        log,
        lap_times,
        correction or no_correction(),
    )
    if done < task.laps:
        raise ValueError(
            f"only {done} of {task.laps} laps were done in {most * SAMPLE_TIME:.0f} s (an average of {SLOWEST} m/s would "
            "do): this robot or operator does not keep to the course; check their parameters"
        )
    t = pd.Index(np.round(np.arange(rows) * task.sample_time, 6), name="t")
    return pd.DataFrame(table[:rows], index=t, columns=kernel.COLUMNS), lap_times[:done]


def _session(data, operator, condition, seed, **facts) -> Session:
    if isinstance(seed, np.random.SeedSequence):
        facts |= {"seed": str(seed.entropy), "spawn_key": ".".join(map(str, seed.spawn_key))}
    else:
        facts |= {"seed": int(seed)}
    facts |= {"note": NOTE, "performance": f"(2.4), (2.7), window {WINDOW:g} s"}
    return Session(data, Metadata(operator.participant, condition, "trustlab.testbeds.ground_robot", True, facts))
