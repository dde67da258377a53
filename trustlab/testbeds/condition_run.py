"""
What a run under one of the conditions C1–C5 hands back, on whichever testbed: session, measures,
suggestions, answers.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd

from trustlab.allocation.estimates import (
    FOLLOWED,
    NOT_FOLLOWED,
    followed_suggestions,
    suggestion_episodes,
)
from trustlab.models.display import Result
from trustlab.models.tsc import TscModel
from trustlab.operators.answers import allocation_answers
from trustlab.operators.ground_robot import Operator
from trustlab.sessions.session import Metadata, Session
from trustlab.testbeds.deciding import (
    DEADLINE,
    KNOWN,
    OWN,
    SAMPLE_TIME,
    SCHEDULE,
    framed,
    sample_times,
)

# Panels of the figure of a run, by column.
PANELS = {
    "p_r": "robot performance\n$P_r$",
    "r": "human utilization\n$r$",
    "p_h": "human performance\n$P_h$",
    "tsc": "TSC",
}
MEANS = ("p_r", "p_h", "r", "tsc", "path_error")


def suggestions_followed(t: np.ndarray, choice: Any, suggested: Any) -> dict[str, float]:
    """
    Return how many suggestions of a choice, −1 for none, were followed or not, and the percentage
    that was followed within 15 s, NaN without any.
    """
    states = [state for *_, state in suggestion_episodes(t, choice, suggested, DEADLINE)]
    followed = states.count(FOLLOWED)
    decided = followed + states.count(NOT_FOLLOWED)
    share = 100.0 * followed / decided if decided else np.nan
    return {"suggestions": decided, "followed_percent": share}


def condition_measures(log: Any, t: np.ndarray, lap_times: Any = None) -> dict[str, float]:
    """
    Return the outcome measures of a run from its log, anything with columns by name, as
    `ConditionRun.measures`; answers, which people give themselves, are not among them.
    """
    mode = log["mode"]
    measures: dict[str, float] = {name: float(log[name].mean()) for name in MEANS} | {
        "manual_share": float(mode.mean()),
        "switches": int(np.count_nonzero(np.diff(mode))),
        "duration": float(t[-1] - t[0]),
    }
    if lap_times is not None:
        measures["speed"] = float(log["step_distance"].mean()) / SAMPLE_TIME
        measures["laps"] = int(lap_times.size)
        measures["lap_time"] = float(lap_times[-1] / lap_times.size) if lap_times.size else np.nan
    return measures | suggestions_followed(t, mode, log["suggested_mode"])


@dataclass(frozen=True, eq=False, repr=False)
class ConditionRun(Result):
    """
    One simulated run under one of the conditions C1–C5.

    Parameters
    ----------
    log : numpy.ndarray, shape (N,)
        Everything logged at 10 Hz, a record per sample.
    metadata : Metadata
        Of the session; they say that it is synthetic.
    operator : Operator
        Who.
    model : TscModel
        The model behind TSC and the suggestions.
    thresholds : (float, float) or None
        TSC_l and TSC_u, where given.
    lap_times : numpy.ndarray, shape (laps,), or None
        When each lap of the ground robot ended [s].
    """

    log: np.ndarray
    metadata: Metadata
    operator: Operator
    model: TscModel
    thresholds: tuple[float, float] | None
    lap_times: np.ndarray | None = None

    @property
    def title(self) -> str:
        """Which testbed."""
        return "UAV that follows a leader" if self.lap_times is None else "Ground-robot run"

    @cached_property
    def session(self) -> Session:
        """The log as a session."""
        return Session(framed(self.log), self.metadata)

    def suggestions(self) -> pd.DataFrame:
        """
        Return the suggestions shown: columns start [s], suggested_mode, delay [s], followed, state
        (`followed_suggestions`).
        """
        return followed_suggestions(self.session, DEADLINE)

    @property
    def measures(self) -> dict[str, float]:
        """
        The outcome measures of the run, by name.

        p_r, p_h, r, tsc: means; path_error [m], speed [m/s] (ground robot), manual_share: means;
        switches, laps (ground robot): numbers; duration, lap_time [s] (ground robot): of the run,
        and the mean of its laps; suggestions: how many were to be followed or not;
        followed_percent: share of them followed within 15 s, NaN without any; tlx, satisfaction,
        trust where the operator answers (`allocation_answers`).
        """
        log, who = self.log, self.operator
        measures = condition_measures(log, sample_times(log.size), self.lap_times)
        if who.load_utilization or who.load_switching:
            # Nobody judges a user's rule.
            scheme, forced = KNOWN.get(str(self.metadata.condition), (SCHEDULE, True))
            judged = 0 if forced else measures["switches" if scheme == OWN else "suggestions"]
            measures |= allocation_answers(
                log["mode"], log["tsc"], measures, judged, who, self.model
            )
        return measures

    @property
    def message(self) -> str:
        """Which run it is, and what it stands for."""
        note = self.metadata.more.get("note", "")
        return f"{self.session.label}, {self.session.duration:.0f} s; {note}"

    def table(self) -> pd.DataFrame:
        """Return participant, condition, synthetic and the measures in one row."""
        names = ("participant", "condition", "synthetic")
        facts = {name: getattr(self.metadata, name) for name in names}
        return pd.DataFrame([facts | self.measures])

    def plot(self) -> np.ndarray:
        """
        Plot P_r, r, P_h and TSC against time, with the thresholds and manual phases shaded, as Fig.
        2.9 does.

        Returns
        -------
        numpy.ndarray of matplotlib.axes.Axes, shape (4,)
        """
        axes = self.session.plot([*PANELS])
        unit = "" if self.lap_times is None else " [m/s]"  # performance of the UAV is a share
        for panel, (name, label) in zip(axes, PANELS.items(), strict=True):
            panel.set_ylabel(label + unit * name.startswith("p_"))
        for threshold in self.thresholds or ():
            axes[-1].axhline(threshold, ls="--", lw=1.0, color="C1")
        return axes
