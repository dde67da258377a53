"""The ground robot as a live task; browsers compute it, from the kernel that numba compiles."""

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np

from trustlab.live.condition import LiveCondition
from trustlab.live.hand import HumanHand, scripted_drive
from trustlab.live.runs import Drive, drive_config, replay, session_of
from trustlab.live.study.settings import DriveSettings, model_of
from trustlab.live.tasks.task import LiveTask
from trustlab.sessions.session import Session
from trustlab.testbeds.condition_run import condition_measures
from trustlab.testbeds.deciding import CONDITIONS
from trustlab.testbeds.ground_robot.course import Course
from trustlab.testbeds.ground_robot.pioneer import Pioneer


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

    def begin(self, config: Mapping[str, Any]) -> Any:
        """Return a drive at its beginning; in a study, browsers step it."""
        return Drive(config)

    def scripted_rows(self, config: Mapping[str, Any], rng: np.random.Generator) -> np.ndarray:
        """Return what a page would send of a drive by a hand with a person's limits."""
        return scripted_drive(config, HumanHand(config, int(rng.integers(2**32))))[0]

    def minutes(self, config: Mapping[str, Any]) -> float:
        """Return how long a drive takes, its laps at two thirds of the largest speed [min]."""
        speed = config["robot"]["max_speed"] * 2.0 / 3.0
        laps = config["task"]["laps"] * config["path"][-1][2] / speed
        return laps / 60.0 if laps else super().minutes(config)

    def at_end(self, config: Mapping[str, Any], session: Session) -> bool:
        """Whether a drive is complete: all its laps, or the time it may last."""
        laps = session.metadata.more.get("laps")
        driven = laps is not None and len(session.metadata.more["lap_times"]) >= laps
        return driven or super().at_end(config, session)

    def replay(self, config: Mapping[str, Any], rows: Any) -> bool | int:
        """Return whether rows are what numba computes from their commands, or the first not so."""
        return replay(config, rows)

    def session(self, config: Mapping[str, Any], rows: Any, **metadata: Any) -> Session:
        """Return the session of a drive."""
        return session_of(config, rows, **metadata)

    def measures(self, session: Session) -> dict[str, float]:
        """Return the measures of `run_condition`."""
        laps = np.asarray(session.metadata.more["lap_times"], dtype=float)
        condition = str(session.metadata.condition)
        return condition_measures(session, session.t, condition, lap_times=laps)


TASK = GroundRobotTask()
