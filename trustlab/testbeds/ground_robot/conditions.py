"""
A robot on a course, an operator, and who drives: a simulated stand-in for the Stage testbed of Fig.
2.1.
"""

from collections.abc import Callable

import numpy as np

from trustlab.models.checks import Seed, of_class, spawned
from trustlab.models.simulation import Simulation
from trustlab.operators.ground_robot import Operator
from trustlab.sessions.session import Session
from trustlab.testbeds import deciding
from trustlab.testbeds.ground_robot import kernel
from trustlab.testbeds.ground_robot.course import Course, default_course
from trustlab.testbeds.ground_robot.pioneer import Pioneer

E_MAX = 2.0
SLOWEST = 0.15
# Largest runs that are made: 1.2 GB are nearly twelve days of driving [s].
MOST_LAPS = 1000
MOST_SECONDS = 1e6

MAKE_OPERATOR = (
    "make one with trustlab.operators.operator(participant, model) or "
    "trustlab.testbeds.published_operator(1)"
)
NOTE = "simulated stand-in for the Stage testbed of Fig. 2.1"
MEASURED = "(2.4), (2.7)"


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
    task = deciding.Task(deciding.SCHEDULE, E_MAX, first_mode=int(mode[0]), r0=r0)
    inputs = deciding.no_inputs(mode.size)
    inputs["mode"] = mode
    log, _ = driven(task, robot or Pioneer(), default_course(), operator, seed, inputs)
    metadata = deciding.metadata_of("ground_robot", operator, condition, seed, NOTE, MEASURED)
    return Session(deciding.framed(log).drop(columns=["tsc", "suggested_mode"]), metadata)


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
    samples = np.round(lengths / deciding.SAMPLE_TIME).astype(int)
    mode = np.repeat(1 - np.arange(samples.size) % 2, samples)
    return drive_modes(mode, operator, seed, condition="identification")


def driven(
    task: deciding.Task,
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
        inputs = deciding.no_inputs(int(np.ceil(seconds / deciding.SAMPLE_TIME)) + 1)
    size = inputs.size
    rates = kernel.rates_of(operator, robot, task.sample_time)
    setup = kernel.DriveSetup(task, course.numbers, robot.numbers, operator.numbers, rates)
    sensing, hand, choices = map(np.random.default_rng, spawned(seed, 3))
    arc, z_r, z_h = np.empty((3, size))
    now, lap_times = np.zeros(1, kernel.STATE), np.empty(task.laps)
    state = kernel.DriveState(now, sensing, hand, choices, arc, z_r, z_h, lap_times)
    log = np.empty(size, kernel.LOG)
    run = Simulation(kernel.drive, setup, state, inputs, log, decide)
    run.advance(size)
    done = int(now["laps"][0])
    if done < task.laps:
        raise ValueError(
            f"only {done} of {task.laps} laps were done in {size * deciding.SAMPLE_TIME:.0f} s "
            f"(an average of {SLOWEST} m/s would do): this robot or operator does not keep to the "
            "course; check their parameters"
        )
    return log[: run.done], lap_times
