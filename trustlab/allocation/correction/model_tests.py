"""Tests of a correction on the model (2.1)-(2.6) itself, with operators of simple habits."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pandas as pd

from trustlab.allocation.correction.corrector import ThresholdCorrector
from trustlab.allocation.correction.incentive import within_range
from trustlab.allocation.correction.online import OnlineCorrection
from trustlab.allocation.correction.setting import CorrectionTest
from trustlab.models.checks import between, not_negative, positive, set_checked, whole_number
from trustlab.models.tsc import (
    TscConstants,
    next_performance,
    next_utilization,
    performance_at,
    threshold_mode,
    tsc_at,
)


@dataclass(frozen=True)
class ModelTests:
    """
    Tests on the model: each plan starts from the true utilization and performance.

    Parameters
    ----------
    duration : float
        Length of each test [s]; Section 2.5 does not state its own.
    lag : float
        How long a suggestion must stand before the habit "lagging" follows it [s].
    noise : float
        Standard deviation of a disturbance of robot performance at each step; performance stays
        within the model's range.
    r0 : float
        Utilization at the beginning of each test; 0 is a rested operator.
    p_r0 : float, optional
        Robot performance there; the robot's P_min when not given.
    sample_time : float
        Time between samples [s]; it converts durations to samples.

    Raises
    ------
    ValueError
        If an argument is of the wrong kind or out of range.
    """

    duration: float = 1800.0
    lag: float = 5.0
    noise: float = 0.0
    r0: float = 0.0
    p_r0: float | None = None
    sample_time: float = 0.1

    habits: ClassVar[tuple[str, ...]] = ("following", "lagging", "ignoring")
    source: ClassVar[str] = "simulated, model of (2.1)-(2.6)"

    def __post_init__(self):
        set_checked(self, positive, "duration", "sample_time")
        set_checked(self, not_negative, "lag", "noise")
        between("r0", self.r0, 0.0, 1.0)
        samples = round(min(self.duration / self.sample_time, 1e15))
        name = "the number of samples, duration/sample_time,"
        whole_number(name, samples, most=10_000_000)

    @property
    def samples(self) -> int:
        """How many samples a test has."""
        return round(self.duration / self.sample_time)

    def printed_thresholds(self) -> None:
        """Return nothing: the model belongs to no printed participant."""

    def streams(self, seed: int | np.random.SeedSequence, tests: int) -> list:
        """
        Return the random numbers of each test: those of one stream, one test after another.

        Parameters
        ----------
        seed : int or numpy.random.SeedSequence
            Of all that is random.
        tests : int
            How many tests.
        """
        if not isinstance(seed, np.random.SeedSequence):
            seed = whole_number("seed", seed, least=0)
        return [np.random.default_rng(seed)] * tests

    def run(
        self, corrector: ThresholdCorrector, test: CorrectionTest
    ) -> tuple[pd.DataFrame, tuple[float, float], None]:
        """
        Run one test in closed loop.

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
        session : None
        """
        robot = corrector.tsc.robot
        p_r0 = robot.p_min
        if self.p_r0 is not None:
            p_r0 = within_range("p_r0", self.p_r0, robot.p_min, robot.p_max)
        online = OnlineCorrection(corrector, test.thresholds, 1, self.r0, outside="nearest")
        wait = round(min(self.lag / self.sample_time, self.samples + 1))
        operator = Responder(test.habit, test.start, wait)
        disturbance = test.stream.standard_normal(self.samples) * self.noise
        constants = corrector.tsc.constants()
        truth = _closed_loop(online, operator, constants, self.r0, p_r0, disturbance)
        time = np.arange(self.samples) * self.sample_time
        return online.table().assign(t=time, **truth), (online.lower, online.upper), None


class Responder:
    """An operator who follows suggestions at once, after `wait` samples, or not at all."""

    def __init__(self, habit: str, start: tuple[float, float], wait: int):
        self.habit = habit
        self.start = start
        self.wait = wait
        self.mode = 1
        self._suggested = -1
        self._samples = 0  # for how many samples that suggestion has stood

    def decide(self, tsc: float, online: OnlineCorrection) -> int:
        """Return the operator's mode at this sample."""
        if self.habit != "lagging":
            ignores = self.habit == "ignoring"
            thresholds = self.start if ignores else (online.lower, online.upper)
            self.mode = threshold_mode.py_func(tsc, *thresholds, self.mode)
        elif self._suggested >= 0 and self._samples >= self.wait:
            self.mode = self._suggested
            self._suggested = -1
        return self.mode

    def hear(self, suggestion: int) -> None:
        """Count the samples of a suggestion, anew when it changes or agrees with the mode."""
        if suggestion == self.mode:
            self._suggested = -1
            self._samples = 0
        elif suggestion < 0 or suggestion == self._suggested:
            self._samples += 1
        else:
            self._suggested = suggestion
            self._samples = 1


def _closed_loop(
    online: OnlineCorrection,
    operator: Responder,
    c: TscConstants,
    r: float,
    p_r: float,
    disturbance: np.ndarray,
) -> dict[str, np.ndarray]:
    """Simulate one test in closed loop and return p_r, p_h and mode, sample by sample."""
    truth = {name: np.empty(disturbance.size) for name in ("p_r", "p_h", "mode")}
    for k, push in enumerate(disturbance):
        # Numbers one by one: a NamedTuple takes longer to hand over to compiled code than the
        # equation takes.
        p_h = performance_at(r, c.beta, c.p_h_min, c.p_h_max)
        mode = operator.decide(tsc_at.py_func(p_r, p_h, c), online)
        operator.hear(online.update(p_r, p_h, mode).suggestion)
        truth["p_r"][k] = p_r
        truth["p_h"][k] = p_h
        truth["mode"][k] = mode
        r = min(max(next_utilization(r, mode, c.a_r), 0.0), 1.0)
        p_r = next_performance(p_r, p_h, mode, c.a_pr, c.b_pr, c.p_r_min)
        if push:
            p_r = min(max(p_r + push, c.p_r_min), c.p_r_max)
    return truth
