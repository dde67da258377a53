"""Tests of a correction on the ground-robot testbed, as in Fig. 2.18."""

import itertools
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
import pandas as pd

from trustlab.allocation.correction import ThresholdCorrector
from trustlab.allocation.correction_run import UNSETTLED, CorrectionTest, OnlineCorrection
from trustlab.models.checks import between, not_negative, set_checked, spawned, whole_number
from trustlab.operators.ground_robot import Operator
from trustlab.sessions.session import Session
from trustlab.testbeds.deciding import OWN, SAMPLE_TIME, SETTLING, TSC, framed, task_of
from trustlab.testbeds.ground_robot import conditions as bed
from trustlab.testbeds.ground_robot.course import Course
from trustlab.testbeds.ground_robot.pioneer import Pioneer

# For each habit: scheme of the testbed, whether all suggestions are followed, whether the
# operator's thresholds move along.
SCHEMES = {
    "following": (TSC, True, False),
    "lagging": (TSC, True, False),
    "ignoring": (OWN, False, False),
    "free": (TSC, False, False),
    "adopting": (OWN, False, True),
}


@dataclass(frozen=True)
class GroundRobotTests:
    """
    Tests on the ground-robot testbed.

    TSC comes from performance as measured, (2.4) and (2.7) over 100 s. Thresholds are held until
    that window is full. Where measured performance lies outside the model's range, plans take its
    nearest end; the message says so.

    Parameters
    ----------
    participant : int, str or Operator
        Who drives, as for `run_condition`.
    laps : int
        How many laps each test has.
    lag : float
        Median reaction of the habit "lagging" [s].
    r0 : float
        Utilization at the beginning of each test; 0 is a rested operator.
    robot : Pioneer, optional
        The robot, if not the calibrated one.
    course : Course, optional
        The course, if not the default one.

    Raises
    ------
    ValueError
        If an argument is not understood or out of range; and, from a run, if laps are not finished
        at 0.15 m/s on average.
    """

    participant: int | str | Operator
    laps: int = 8
    lag: float = 10.0
    r0: float = 0.0
    robot: Pioneer | None = None
    course: Course | None = None

    habits: ClassVar[tuple[str, ...]] = tuple(SCHEMES)
    source: ClassVar[str] = "simulated stand-in for the Stage testbed (synthetic)"

    def __post_init__(self):
        whole_number("laps", self.laps, most=bed.MOST_LAPS)
        set_checked(self, not_negative, "lag")
        between("r0", self.r0, 0.0, 1.0)

    def printed_thresholds(self) -> tuple[float, float] | None:
        """Return the printed thresholds of a printed participant."""
        if isinstance(self.participant, Operator):
            return None
        return bed.published_thresholds(bed.participant_label(self.participant))

    def streams(self, seed: int | np.random.SeedSequence, tests: int) -> list:
        """
        Return a child of the seed for each test.

        Parameters
        ----------
        seed : int or numpy.random.SeedSequence
            Of all that is random.
        tests : int
            How many tests.
        """
        return spawned(seed, tests)

    def run(
        self, corrector: ThresholdCorrector, test: CorrectionTest
    ) -> tuple[pd.DataFrame, tuple[float, float], Session]:
        """
        Run one test.

        Parameters
        ----------
        corrector : ThresholdCorrector
            What plans the corrections.
        test : CorrectionTest
            How the test begins.

        Returns
        -------
        data : pandas.DataFrame
        thresholds : (float, float)
        session : Session
        """
        operator, model, _ = bed.who_drives(self.participant, None, corrector.tsc)
        operator, robot, course = bed.checked(operator, self.robot, self.course)
        if test.habit == "lagging":
            operator = replace(operator, reaction_lag=self.lag)
        scheme, forced, adopted = SCHEMES[test.habit]
        lower, upper = (operator.lower, operator.upper) if scheme == OWN else test.thresholds
        if adopted:
            lower = lower + test.thresholds[0] - test.start[0]
            upper = upper + test.thresholds[1] - test.start[1]
        task = task_of(
            scheme,
            bed.E_MAX,
            forced=forced,
            laps=self.laps,
            lower=lower,
            upper=upper,
            model=model,
            r0=self.r0,
        )
        online = OnlineCorrection(corrector, test.thresholds, 1, self.r0, outside="nearest")
        decide = _correcting(online, adopted)
        log, _ = bed.driven(task, robot, course, operator, test.stream, decide=decide)
        data = framed(log)
        facts = {
            "laps": self.laps,
            "habit": test.habit,
            "test": test.number,
            "TSC_ld": corrector.target[0],
            "TSC_ud": corrector.target[1],
        }
        session = bed.session_of(data, operator, f"correction, {test.habit}", test.stream, **facts)
        return _samples(data, online), (online.lower, online.upper), session


def _correcting(online: OnlineCorrection, adopted: bool) -> Callable:
    """
    Return what corrects the thresholds of the suggestions at each sample, and moves the operator's
    own ones along where they are adopted.
    """
    start = online.lower, online.upper
    samples = itertools.count()

    def decide(state: Any, inputs: np.ndarray) -> None:
        (now,) = state.now
        inputs["lower"], inputs["upper"] = online.lower, online.upper
        online.r = float(now["r"])
        settled = next(samples) * SAMPLE_TIME >= SETTLING
        measured = (float(now["p_r"]), float(now["p_h"])) if settled else (None, None)
        online.update(*measured, int(now["mode"]))
        if adopted:
            inputs["shift_l"] = online.lower - start[0]
            inputs["shift_u"] = online.upper - start[1]

    return decide


def _samples(data: pd.DataFrame, online: OnlineCorrection) -> pd.DataFrame:
    """Return the samples of a test beside its corrections."""
    frame = data[["r", "p_r", "p_h", "tsc", "mode"]].reset_index()
    frame["suggestion"] = data["suggested_mode"].to_numpy().astype(int)
    names = ["lower", "upper", "c_l", "c_u", "cost", "cost_lower_bound"]
    names += ["status", "message", "latency"]
    frame[names] = online.table()[names]
    frame.loc[frame["t"] < SETTLING, "message"] = UNSETTLED
    return frame
