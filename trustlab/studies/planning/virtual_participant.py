"""One simulated participant of a virtual study: every condition in their order, measured and, if asked for, written."""

from dataclasses import replace
from pathlib import Path

from numpy.random import SeedSequence

from trustlab.sessions.writers import write_session
from trustlab.studies.planning.populations import GroundRobotPopulation, TeleoperatorPopulation
from trustlab.testbeds.deciding import SAMPLE_TIME, suggested_by_tsc
from trustlab.testbeds.ground_robot.conditions import measured_condition, run_condition
from trustlab.testbeds.teleoperation_measures import teleoperation_measures
from trustlab.testbeds.uav_following.people import FollowingPopulation
from trustlab.testbeds.uav_following.run import measured_flight
from trustlab.testbeds.uav_tracking import simulate_teleoperation

# What makes an operator of a row of the population's draw, by testbed.
PERSONS = {"ground_robot": GroundRobotPopulation.person, "uav_following": FollowingPopulation.person}


def session_file(participant: int, position: int, condition: str) -> str:
    """Return the name of the file that holds one session; participants and positions count from 1."""
    return f"participant_{participant:05d}_trial_{position}_{condition}.parquet"


def run_participant(
    testbed: str,
    participant: int,
    order: str,
    settings: dict,
    folder: str | None,
    seed: SeedSequence,
    **operator: float,
) -> dict[str, float]:
    """
    Run all conditions for one simulated operator, and return measures as "condition/measure": a task of `run_campaign`.

    `order` holds the conditions in their order, separated by blanks; `settings` assumptions of C1–C5, laps of the ground robot and
    rest [s] (the pause between sessions, or None where each begins with the operator's r0), or study and duration [s] of
    teleoperation; `operator` is a row of the population's draw.
    """
    conditions = order.split()
    # Each condition has a seed by its place in the alphabet, so that the order has no effect on its noise.
    streams = dict(zip(sorted(conditions), seed.spawn(len(conditions)), strict=True))
    values, found = operator | {"participant": participant}, {}
    run = _Allocated(testbed, values, settings) if testbed in PERSONS else _Teleoperated(values, settings)
    for position, condition in enumerate(conditions, start=1):
        if folder is None:
            measures = run.measures(condition, position, streams[condition])
        else:
            session, measures = run.session(condition, position, streams[condition])
            named = session.with_metadata(trial=position, testbed=testbed)
            write_session(named, Path(folder) / session_file(participant, position, condition))
        found |= {f"{condition}/{name}": float(value) for name, value in measures.items()}
    return found


class _Teleoperated:
    """A teleoperator's runs."""

    def __init__(self, values: dict[str, float], settings: dict):
        self.person, self.settings = TeleoperatorPopulation.person(values), settings

    def session(self, scheme: str, position: int, seed: SeedSequence):
        study, duration = self.settings["study"], self.settings["duration"]
        session = simulate_teleoperation(scheme, self.person, study, seed=seed, duration=duration)
        measures = teleoperation_measures(session).iloc[0].drop(["participant", "scheme"]).to_dict()
        return session, measures

    def measures(self, scheme: str, position: int, seed: SeedSequence) -> dict[str, float]:
        return self.session(scheme, position, seed)[1]


class _Allocated:
    """An operator's runs under C1–C5; utilization is carried over where sessions have a rest between them."""

    def __init__(self, testbed: str, values: dict[str, float], settings: dict):
        self.testbed, self.settings, self.carried = testbed, settings, None
        someone, self.model, self.thresholds = PERSONS[testbed](values)
        self.person = replace(someone, **settings.get("assumptions", {}))

    def _arguments(self, condition: str, position: int) -> dict:
        person = replace(self.person, sessions=position - 1)
        return {"condition": condition, "operator": person, "model": self.model, "r0": self.carried}

    def _rested(self, last: float) -> None:
        if self.settings["rest"] is not None:
            self.carried = last * self.model.human.a ** (self.settings["rest"] / SAMPLE_TIME)

    def session(self, condition: str, position: int, seed: SeedSequence):
        own = {} if self.testbed != "ground_robot" else {"laps": self.settings["laps"]}
        if suggested_by_tsc(condition):
            own["thresholds"] = self.thresholds
        run = run_condition(**self._arguments(condition, position), seed=seed, testbed=self.testbed, **own)
        self._rested(float(run.session["r"][-1]))
        return run.session, run.measures()

    def measures(self, condition: str, position: int, seed: SeedSequence) -> dict[str, float]:
        arguments = self._arguments(condition, position) | {"thresholds": self.thresholds, "seed": seed}
        if self.testbed == "ground_robot":
            measures, last = measured_condition(**arguments, laps=self.settings["laps"])
        else:
            measures, last = measured_flight(**arguments)
        self._rested(last)
        return measures
