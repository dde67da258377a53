"""A model of trust that drives a simulated loop or team, trial by trial."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from trustlab.models.checks import Checked, Positive, Share, finite_number
from trustlab.models.simulation import asked
from trustlab.models.trust import TrustModel
from trustlab.trust.interface import Event, TrustDynamics


@dataclass(frozen=True)
class TrustInLoop(Checked):
    """
    A model of trust in place of (3.2) in `TeleoperationLoop(trust=…)`, or of (4.1) in a team.

    Models are fitted to trials. In a loop a trial lasts `every` seconds, and its performance is the
    mean of the robot's over it; trust stays the same in between. However long it lasts, it counts
    as one (`Event.dt` is 1). No one rates: trust is the mean one. In a team every robot has a
    course of its own.

    Parameters
    ----------
    model : TrustDynamics
        The model, of one person.
    every : float
        Length of a trial [s].
    start : float
        Trust at the start, as a share of its range.

    Examples
    --------
    >>> import trustlab as tl
    >>> beta = tl.trust.MODELS["beta"](success=2.0, failure=3.0)
    >>> loop = tl.TeleoperationLoop("TMIG", trust=tl.trust.TrustInLoop(beta, every=2.0))
    >>> loop.step().trust_hr
    0.5
    """

    model: TrustDynamics
    every: Positive = 1.0
    start: Share = 0.5

    @classmethod
    def of(cls, trust: Any) -> Any:
        """
        Return a model as one that drives, a trial a second; whatever else is passed, as it is.

        Parameters
        ----------
        trust : TrustDynamics, TrustInLoop, callable or None
            An argument `trust`.
        """
        return cls(trust) if isinstance(trust, TrustDynamics) else trust

    def part(self, hr: TrustModel, rh: TrustModel, sample_time: float) -> Callable:
        """
        Return a part f(state) → (T_hr, T_rh) that remembers one run.

        Parameters
        ----------
        hr, rh : TrustModel
            Ranges of the model's trust and performance; robot-to-human trust (3.3).
        sample_time : float
            Of the loop [s].
        """
        course = TrustCourse(self, sample_time)

        def trust(state):
            p_r = min(max(state.p_r, hr.p_min), hr.p_max)
            share = course.step((p_r - hr.p_min) / (hr.p_max - hr.p_min))
            p_h = min(max(state.p_h, rh.p_min), rh.p_max)
            t_hr = hr.t_min + (hr.t_max - hr.t_min) * share
            return t_hr, rh.step(state.trust_rh, p_h, sample_time)

        return trust


class TrustCourse:
    """
    The course of trust in one robot along one run.

    Parameters
    ----------
    driver : TrustInLoop
        The model, the length of a trial and the start.
    sample_time : float
        Time between performances [s].

    Attributes
    ----------
    share : float
        Trust now, as a share of its range.
    """

    def __init__(self, driver: TrustInLoop, sample_time: float):
        self.share = driver.start
        self._model = driver.model
        self._samples = max(round(driver.every / sample_time), 1)
        self._belief = asked(
            "the trust model, at t = 0 s", driver.model.start, np.array([driver.start])
        )
        self._trial: list[float] = []

    def step(self, performance: float) -> float:
        """
        Return trust after a sample; at the end of a trial it changes.

        Parameters
        ----------
        performance : float
            From 0 to 1, or NaN where there is nothing to judge by: a trial of nothing else is none.
        """
        self._trial.append(performance)
        if len(self._trial) == self._samples:
            judged = [each for each in self._trial if np.isfinite(each)]
            self._trial.clear()
            if judged:
                event = Event(p_r=np.array([sum(judged) / len(judged)]))
                self._belief = self._model.step(self._belief, event)
                mean = np.squeeze(self._model.rating(self._belief).mean)
                expected = finite_number("the mean of one person's rating", mean)
                self.share = min(max(expected, 0.0), 1.0)
        return self.share
