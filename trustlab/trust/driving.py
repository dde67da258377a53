"""A model of trust that drives a simulated loop, trial by trial."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from trustlab.models.checks import between, of_class, positive
from trustlab.models.trust import TrustModel
from trustlab.trust.interface import Event, TrustDynamics


@dataclass(frozen=True)
class TrustInLoop:
    """
    A model of trust in place of (3.2) in `TeleoperationLoop(trust=…)`.

    Models are fitted to trials. In a loop a trial lasts `every` seconds, and its performance is the
    mean of the robot's over it; trust stays the same in between. No one rates: trust is the
    expected one.

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
    every: float = 1.0
    start: float = 0.5

    def __post_init__(self):
        of_class("model", self.model, TrustDynamics, "see trustlab.trust.MODELS")
        positive("every", self.every)
        between("start", self.start, 0.0, 1.0)

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
        samples = max(round(self.every / sample_time), 1)
        belief: Any = self.model.start(np.array([self.start]))
        total = 0.0
        count = 0

        def trust(state):
            nonlocal belief, total, count
            performance = min(max(state.p_r, hr.p_min), hr.p_max)
            total += (performance - hr.p_min) / (hr.p_max - hr.p_min)
            count += 1
            if count == samples:
                belief = self.model.step(belief, Event(p_r=np.array([total / samples])))
                total = 0.0
                count = 0
            share = float(self.model.rating(belief).mean[0])
            p_h = min(max(state.p_h, rh.p_min), rh.p_max)
            ours = hr.t_min + (hr.t_max - hr.t_min) * min(max(share, 0.0), 1.0)
            return ours, rh.step(state.trust_rh, p_h, sample_time)

        return trust
