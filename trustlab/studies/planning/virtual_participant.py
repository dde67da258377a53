"""One simulated participant of a virtual study: every condition in their order, measured and, if asked for, written."""

from functools import cache
from pathlib import Path

import numpy as np

from trustlab.sessions.writers import write_session
from trustlab.studies.planning.populations import GroundRobotPopulation, TeleoperatorPopulation
from trustlab.testbeds.ground_robot.conditions import SAMPLE_TIME, run_condition
from trustlab.testbeds.ground_robot.course import Course
from trustlab.testbeds.teleoperation_measures import teleoperation_measures
from trustlab.testbeds.uav_tracking import simulate_teleoperation


@cache
def _course() -> Course:
    """Return the default course, made once per process."""
    return Course()


def session_file(participant: int, position: int, condition: str) -> str:
    """Return the name of the file that holds one session; participants and positions count from 1."""
    return f"participant_{participant:05d}_trial_{position}_{condition}.parquet"


def run_participant(
    testbed: str,
    participant: int,
    order: str,
    settings: dict,
    folder: str | None,
    seed: np.random.SeedSequence,
    **operator: float,
) -> dict[str, float]:
    """
    Run all conditions for one simulated operator, and return measures as "condition/measure": a task of `run_campaign`.

    `order` holds the conditions in their order, separated by blanks; `settings` laps and rest of the ground robot (rest is the
    pause between sessions [s], or None where each begins with r = 0), or study and duration [s] of the UAV; `operator` is a
    row of the population's draw.
    """
    conditions = order.split()
    # Each condition has a seed by its place in the alphabet, so that the order has no effect on its noise.
    streams = dict(zip(sorted(conditions), seed.spawn(len(conditions)), strict=True))
    values, r0, found = operator | {"participant": participant}, 0.0, {}
    for position, condition in enumerate(conditions, start=1):
        if testbed == "ground_robot":
            someone, model, thresholds = GroundRobotPopulation.person(values)
            run = run_condition(
                condition,
                someone,
                model,
                thresholds if condition in ("C2", "C3") else None,
                laps=settings["laps"],
                seed=streams[condition],
                course=_course(),
                r0=r0,
            )
            session, measures = run.session, run.measures()
            if settings["rest"] is not None:
                r0 = float(session["r"][-1]) * model.human.a ** (settings["rest"] / SAMPLE_TIME)
        else:
            session = simulate_teleoperation(
                condition,
                TeleoperatorPopulation.person(values),
                settings["study"],
                seed=streams[condition],
                duration=settings["duration"],
            )
            measures = teleoperation_measures(session).iloc[0].drop(["participant", "scheme"])
        if folder is not None:
            named = session.with_metadata(trial=position, testbed=testbed)
            write_session(named, Path(folder) / session_file(participant, position, condition))
        found |= {f"{condition}/{name}": float(value) for name, value in measures.items()}
    return found
