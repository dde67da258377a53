"""What runs under conditions C1–C5 hand back, on whichever testbed: the session, its measures and its suggestions."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from trustlab.allocation.suggestions import NOT_FOLLOWED, FOLLOWED, followed_suggestions, suggestion_episodes
from trustlab.models.tsc import TscModel
from trustlab.operators.ground_robot import Operator
from trustlab.sessions.session import Session
from trustlab.testbeds.deciding import DEADLINE

MEANS = ("p_r", "p_h", "r", "tsc", "path_error")


def share_followed(t: np.ndarray, columns: Any) -> dict[str, float]:
    """Return how many suggestions were to be followed or not, and the percentage followed within 15 s (NaN without any)."""
    found = suggestion_episodes(t, columns["mode"], columns["suggested_mode"], DEADLINE)
    decided = [state for _, _, _, state in found if state in (FOLLOWED, NOT_FOLLOWED)]
    percent = 100.0 * float(decided.count(FOLLOWED)) / len(decided) if decided else np.nan
    return {"suggestions": len(decided), "followed_percent": percent}


@dataclass(frozen=True, eq=False)
class AllocatedRun:
    """
    One simulated run under one of the conditions C1–C5.

    Parameters
    ----------
    session : Session
        Everything logged at 10 Hz; its metadata say that it is synthetic.
    operator : Operator
        Who.
    model : TscModel
        The model behind TSC and the suggestions.
    thresholds : (float, float) or None
        TSC_l and TSC_u, where given.
    """

    session: Session
    operator: Operator
    model: TscModel
    thresholds: tuple[float, float] | None

    def suggestions(self) -> pd.DataFrame:
        """Return the suggestions shown: columns start [s], suggested_mode, delay [s], followed, state (`followed_suggestions`)."""
        return followed_suggestions(self.session, DEADLINE)

    def measures(self) -> dict[str, float]:
        """Return the outcome measures of the run by name."""
        raise NotImplementedError

    def table(self) -> pd.DataFrame:
        """Return participant, condition, synthetic and the measures in one row."""
        meta = self.session.metadata
        who = {"participant": meta.participant, "condition": meta.condition, "synthetic": meta.synthetic}
        return pd.DataFrame([who | self.measures()])

    def plot(self, bounds: dict[str, tuple[float, float]] | None = None):
        """
        Plot P_r, r, P_h and TSC against time, as Fig. 2.9 does.

        Parameters
        ----------
        bounds : dict of str to (float, float), optional
            Lower and upper bounds to draw, by column: p_r, r, p_h or tsc; for tsc the thresholds when not given.

        Returns
        -------
        numpy.ndarray of matplotlib.axes.Axes, shape (4,)
        """
        from trustlab.testbeds.ground_robot.plots import plot_run

        return plot_run(self, bounds)
