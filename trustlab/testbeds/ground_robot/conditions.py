"""
A robot on a course, an operator, and who drives: a simulated stand-in for the Stage testbed of Fig.
2.1.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pandas as pd

from trustlab.models.checks import (
    did_you_mean,
    finite_array,
    finite_number,
    of_class,
    spawned,
    whole_number,
)
from trustlab.models.display import axes_or_new
from trustlab.models.published import published_models, published_table
from trustlab.models.simulation import Simulation
from trustlab.models.tsc import TscModel
from trustlab.operators.ground_robot import Operator, operator
from trustlab.operators.teleoperator import Teleoperator
from trustlab.sessions.session import Metadata, Session
from trustlab.teleoperation.records import log_of
from trustlab.testbeds import deciding
from trustlab.testbeds.condition_run import ConditionRun
from trustlab.testbeds.ground_robot import kernel
from trustlab.testbeds.ground_robot.course import Course, default_course
from trustlab.testbeds.ground_robot.pioneer import Pioneer

E_MAX = 2.0
SLOWEST = 0.15
# Largest runs that are made: ten million samples, 1.2 GB, are nearly twelve days of driving.
MOST_LAPS = 1000
MOST_STEPS = 10_000_000
MOST_PHASES = 10_000

MAKE_OPERATOR = (
    "make one with trustlab.operators.operator(participant, model) or "
    "trustlab.testbeds.published_operator(1)"
)
NOTE = "simulated stand-in for the Stage testbed of Fig. 2.1"


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class GroundRobotRun(ConditionRun):
    """
    One simulated run on the ground-robot testbed.

    Parameters
    ----------
    log, metadata, operator, model, thresholds : object
        As for a `ConditionRun`.
    course : Course
        Where.
    robot : Pioneer
        What.
    lap_times : numpy.ndarray, shape (laps,)
        When each lap ended [s].
    """

    title = "Ground-robot run"

    course: Course
    robot: Pioneer
    lap_times: np.ndarray

    def laps(self) -> pd.DataFrame:
        """
        Return the laps: columns lap, start [s], end [s], duration [s], manual_share, p_r,
        path_error [m].
        """
        start = np.r_[0.0, self.lap_times[:-1]]
        data = self.session.data
        which = np.searchsorted(self.lap_times, data.index.to_numpy(), side="right").clip(
            max=start.size - 1
        )
        means = (
            data[["mode", "p_r", "path_error"]]
            .groupby(which)
            .mean()
            .rename(columns={"mode": "manual_share"})
        )
        laps = pd.DataFrame(
            {"lap": np.arange(1, start.size + 1), "start": start, "end": self.lap_times}
        )
        return laps.assign(duration=laps["end"] - laps["start"]).join(means)

    def plot_path(self, start: float = 0.0, stop: float | None = None, axes=None):
        """
        Plot the desired path and where the robot went under manual and autonomous control, as Fig.
        2.2 does.

        Parameters
        ----------
        start, stop : float, optional
            The part of the run to show [s]; to its end when `stop` is not given.
        axes : matplotlib.axes.Axes, optional
            Where to plot; a new figure when not given.

        Returns
        -------
        matplotlib.axes.Axes
        """
        return plot_path(self.session, self.course, start, stop, axes)


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
    operator, robot, course = checked(operator, robot, course)
    if not isinstance(condition, str):
        raise ValueError(f"condition must be a name for the metadata, got {condition!r:.60}")
    modes = finite_array("mode", mode)
    odd = (modes != 0.0) & (modes != 1.0)
    if odd.any():
        k = int(np.argmax(odd))
        raise ValueError(f"mode must be zeros and ones, but sample {k} is {modes[k]:g}")
    if modes.size < 2:
        raise ValueError(f"mode must have at least two samples, zeros and ones, got {modes.size}")
    _steps(modes.size * deciding.SAMPLE_TIME, "mode")
    task = deciding.task_of(deciding.SCHEDULE, E_MAX, first_mode=int(modes[0]), r0=r0)
    data, _ = driven(task, robot, course, operator, seed, modes)
    return session_of(
        deciding.framed(data).drop(columns=["tsc", "suggested_mode"]), operator, condition, seed
    )


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
    Drive what Section 2.2.2 identifies a model from: manual up to the maximum, autonomous down to
    the minimum, mixed.

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
        Shortest and longest mixed phase [s]. Phases shorter than the window of (2.4), 100 s, blur
        into each other.
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
    lengths = [
        finite_number("manual", manual),
        finite_number("autonomous", autonomous),
        *finite_array("phase", phase, length=2),
    ]
    if min(lengths) < deciding.SAMPLE_TIME or lengths[2] > lengths[3]:
        raise ValueError(
            f"phases, (shortest, longest), must last at least {deciding.SAMPLE_TIME} s, got "
            f"{min(lengths):g} s"
        )
    mixed = whole_number("mixed", mixed, least=0, most=MOST_PHASES)
    _steps(lengths[0] + lengths[1] + mixed * lengths[3], "all phases together")
    stream = np.random.default_rng(spawned(seed, 4)[3])
    lengths = np.r_[lengths[:2], stream.uniform(lengths[2], lengths[3], size=mixed)]
    steps = np.maximum(np.round(lengths / deciding.SAMPLE_TIME).astype(int), 1)
    mode = np.repeat(1 - np.arange(steps.size) % 2, steps)
    return drive_modes(mode, operator, seed, robot, course, condition="identification")


def who_drives(
    participant, operator, model
) -> tuple[Operator, TscModel, tuple[float, float] | None]:
    """Return the operator, the model, and the printed thresholds of a printed participant."""
    remedy = "who drives? give participant=, 1 to 5 or 'pilot', or an Operator with model="
    person = deciding.participant_or_operator(participant, operator, remedy)
    if isinstance(person, Teleoperator):
        raise ValueError(
            "operator must be of class Operator, got Teleoperator, who flies a UAV "
            "(simulate_teleoperation); for the ground robot " + MAKE_OPERATOR
        )
    if operator is not None or isinstance(person, Operator):
        of_class("operator", person, Operator, MAKE_OPERATOR)
        return person, of_class("model", model, TscModel), None
    label = participant_label(person)
    model = published_model(label) if model is None else of_class("model", model, TscModel)
    return published_operator(label), model, published_thresholds(label)


def _steps(seconds: float, what: str) -> int:
    """Return how many samples so many seconds are, unless they are too many."""
    if seconds / deciding.SAMPLE_TIME > MOST_STEPS:
        raise ValueError(
            f"{what} would take up to {seconds:.3g} s, more than the "
            f"{MOST_STEPS * deciding.SAMPLE_TIME:.0f} s that one run may last; split it into "
            "several runs"
        )
    return int(np.ceil(seconds / deciding.SAMPLE_TIME))


def checked(operator, robot, course) -> tuple[Operator, Pioneer, Course]:
    """Return operator, robot and course, checked; the last two by default where they are None."""
    robot, course = (
        Pioneer() if robot is None else robot,
        default_course() if course is None else course,
    )
    of_class("operator", operator, Operator, MAKE_OPERATOR)
    of_class("robot", robot, Pioneer)
    of_class("course", course, Course)
    return operator, robot, course


def longest(laps: int, course: Course) -> int:
    """Return how many samples laps may take."""
    return _steps(laps * course.length / SLOWEST, f"{laps} laps of {course.length:.3g} m") + 1


def driven(
    task: deciding.Task,
    robot: Pioneer,
    course: Course,
    operator: Operator,
    seed: int | np.random.SeedSequence,
    modes: np.ndarray | None = None,
    decide: Callable | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """
    Return the log of a run, and when laps ended; all that are wanted must be done in time.

    Without laps a run has as many samples as `modes`.
    """
    size = longest(task.laps, course) if modes is None else modes.size
    numbers = course.numbers
    rates = kernel.rates_of(operator, robot, task.sample_time)
    setup = kernel.DriveSetup(task, numbers, robot.numbers, operator.numbers, rates)
    sensing, hand, choices = map(np.random.default_rng, spawned(seed, 3))
    arc, z_r, z_h = np.empty((3, size))
    state = kernel.DriveState(
        now=np.zeros(1, kernel.STATE),
        sensing=sensing,
        hand=hand,
        choices=choices,
        arc=arc,
        z_r=z_r,
        z_h=z_h,
        found=np.empty((len(numbers.posts), 4)),
        lap_times=np.empty(task.laps),
    )
    inputs = deciding.no_inputs(size)
    if modes is not None:
        inputs["mode"] = modes
    _, log = log_of(kernel.LOG, size)
    run = Simulation(kernel.drive, setup, state, inputs, log, decide)
    run.advance(size)
    done = int(state.now["laps"][0])
    if done < task.laps:
        raise ValueError(
            f"only {done} of {task.laps} laps were done in {size * deciding.SAMPLE_TIME:.0f} s "
            f"(an average of {SLOWEST} m/s would do): this robot or operator does not keep to the "
            "course; check their parameters"
        )
    return log[: run.done], state.lap_times


def metadata_of(operator, condition, seed, **facts) -> Metadata:
    """Return metadata that say how a run was made."""
    facts |= deciding.seed_facts(seed) | {"note": NOTE} | deciding.measured("(2.4), (2.7)")
    return Metadata(operator.participant, condition, "trustlab.testbeds.ground_robot", True, facts)


def session_of(data, operator, condition, seed, **facts) -> Session:
    """Return a run as a session that says how it was made."""
    return Session(data, metadata_of(operator, condition, seed, **facts))


def plot_path(
    session: Session, course: Course, start: float = 0.0, stop: float | None = None, axes=None
):
    """
    Plot the desired path, the guide posts, and the robot's track under manual and autonomous
    control.

    Parameters
    ----------
    session : Session
        With columns robot_x, robot_y and mode.
    course : Course
        The course.
    start, stop : float, optional
        The part of the session to show [s]; to its end when `stop` is not given.
    axes : matplotlib.axes.Axes, optional
        Where to plot; a new figure when not given.

    Returns
    -------
    matplotlib.axes.Axes

    Raises
    ------
    SessionError
        If a column is missing.
    ValueError
        If an argument is not understood.
    """
    of_class("session", session, Session)
    of_class("course", course, Course)
    session.require("robot_x", "robot_y", "mode")
    stop = session.t[-1] if stop is None else finite_number("stop", stop)
    part = session.between(finite_number("start", start), stop)
    axes = axes_or_new(axes, figsize=(8.0, 5.6))
    axes.plot(
        *course.posts.T, ls="", marker="o", ms=4, mfc="none", color="0.55", label="guide posts"
    )
    for manual, style, label in ((1, "-", "manual"), (0, ":", "autonomous")):
        here = part["mode"] == manual
        shown = here | np.r_[False, here[:-1]]
        x, y = np.where(shown, part["robot_x"], np.nan), np.where(shown, part["robot_y"], np.nan)
        width = 0.9 if manual else 1.3
        if here.any():
            axes.plot(x, y, ls=style, lw=width, color="black" if manual else "#0072b2", label=label)
    axes.plot(*course.path[:, :2].T, ls="--", lw=2.0, color="#d62728", label="desired")
    axes.set(aspect="equal", xlabel="x [m]", ylabel="y [m]")
    axes.set_title(session.label, fontsize="medium")
    axes.legend(
        fontsize="small", ncols=4, loc="upper center", bbox_to_anchor=(0.5, -0.12), frameon=False
    )
    return axes


# TSC_l(0) and TSC_u(0) of the pilot operator, as printed in Section 2.5; Table 2.2 has no column
# for the pilot.
PILOT_THRESHOLDS = ("0.02", "0.45")


def participant_label(participant: int | str) -> str:
    """
    Return how a participant is called in the printed tables.

    Parameters
    ----------
    participant : int or str
        1 to 5, "1" to "5", or "pilot".

    Raises
    ------
    ValueError
        If there is no such participant; the error lists those there are, the nearest first where
        one is near.
    """
    known = list(published_models())
    if isinstance(participant, str):
        label = participant.strip().lower()
    else:
        try:
            label = str(whole_number("participant", participant, most=10**6))
        except ValueError:
            label = ""
    if label in known:
        return label
    meant = did_you_mean(label, known)
    raise ValueError(
        f"there is no participant {participant!r:.60} among the printed ones: "
        f"{', '.join(known)}{meant}. For anyone else give an Operator as participant, with model="
    )


def published_model(participant: int | str) -> TscModel:
    """
    Return a participant's printed model, of Table 2.1 (the pilot's of Section 2.2).

    Parameters
    ----------
    participant : int or str
        1 to 5, "1" to "5", or "pilot".

    Raises
    ------
    ValueError
        If there is no such participant.
    """
    return published_models()[participant_label(participant)]


def published_operator(participant: int | str) -> Operator:
    """
    Return the simulated stand-in for a participant, made of what is printed of them.

    Utilization and performance are those of Table 2.1, own thresholds (mean and SD) those of Table
    2.3, and the shares of suggestions followed those of Table 2.6. Of the pilot operator only the
    model is printed (Sections 2.2.2 and 2.2.3): own thresholds have the means printed as decision
    thresholds in Section 2.5, their spread and the shares are the defaults of `Operator`. How the
    hand drives and reacts is not printed of anyone and is that of `Operator`.

    Parameters
    ----------
    participant : int or str
        1 to 5, "1" to "5", or "pilot".

    Raises
    ------
    ValueError
        If there is no such participant.
    """
    label = participant_label(participant)
    model = published_models()[label]
    if label == "pilot":
        lower, upper = published_thresholds(label)
        return operator(label, model, lower=(lower, 0.1), upper=(upper, 0.1))
    own, shares = (
        published_table("2.3")[label].astype(float),
        published_table("2.6")[label].astype(float),
    )
    return operator(
        label,
        model,
        lower=(own["TSC_l", "mean"], own["TSC_l", "sd"]),
        upper=(own["TSC_u", "mean"], own["TSC_u", "sd"]),
        follow=(shares["C2"] / 100.0, shares["C4"] / 100.0),
    )


def published_thresholds(participant: int | str) -> tuple[float, float]:
    """
    Return the decision thresholds TSC_l and TSC_u of Table 2.2 (the pilot's of Section 2.5).

    Parameters
    ----------
    participant : int or str
        1 to 5, "1" to "5", or "pilot".

    Raises
    ------
    ValueError
        If there is no such participant.
    """
    label = participant_label(participant)
    printed = (
        PILOT_THRESHOLDS
        if label == "pilot"
        else published_table("2.2").loc[["TSC_l", "TSC_u"], label]
    )
    lower, upper = map(float, printed)
    return lower, upper
