"""What a run of the ground robot hands back: the session, its measures and its figures."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from trustlab.models.tsc import TscModel
from trustlab.operators import Operator
from trustlab.sessions.session import Session
from trustlab.testbeds.course import Course
from trustlab.testbeds.driving import DEADLINE
from trustlab.testbeds.pioneer import Pioneer

__all__ = ["GroundRobotRun", "shown_suggestions"]

STATES = ("followed", "not followed", "withdrawn", "open")


def shown_suggestions(session: Session, deadline: float = DEADLINE) -> pd.DataFrame:
    """
    Return the suggestions that were shown, each from its first appearance.

    A suggestion is shown while `suggested_mode` is 0 or 1 and not the mode there is; one that comes back within the
    deadline, while the mode stayed and the aid did not agree with it, is the same suggestion.

    Parameters
    ----------
    session : Session
        With columns mode and suggested_mode.
    deadline : float
        A suggestion counts as followed when the mode changes to it within this time [s].

    Returns
    -------
    pandas.DataFrame
        Columns start [s], suggested_mode, delay [s] until the mode changed to it (NaN if it never did before the next
        suggestion), state: "followed", "not followed", "withdrawn" (before the deadline) or "open" (the session ended
        before the deadline).

    Raises
    ------
    SessionError
        If a column is missing.
    """
    session.require("mode", "suggested_mode")
    t, mode, suggested = session.t, session["mode"], session["suggested_mode"]
    before = np.r_[mode[0], mode[:-1]]
    # A new suggestion begins when the mode has changed, or the aid has agreed with it, since the last one was shown.
    breaks = np.cumsum((mode != before) | (suggested == before))
    episodes: list[list] = []
    for k in np.flatnonzero((suggested >= 0.0) & (suggested != before)):
        last = episodes[-1] if episodes else None
        same = last and last[1] == suggested[k] and t[k] - t[last[2]] <= deadline
        if same and breaks[k - 1] == breaks[last[2]]:
            last[2] = k
        else:
            episodes.append([k, suggested[k], k])
    rows = []
    for i, (first, wanted, last) in enumerate(episodes):
        stop = episodes[i + 1][0] if i + 1 < len(episodes) else t.size
        there = np.flatnonzero(mode[first:stop] == wanted)
        delay = t[first + there[0]] - t[first] if there.size else np.nan
        if delay <= deadline + 1e-9:
            state = "followed"
        elif t[last] - t[first] >= deadline - 1e-9:
            state = "not followed"
        else:
            state = "withdrawn" if t[-1] - t[first] >= deadline else "open"
        rows.append((t[first], wanted, delay, state))
    return pd.DataFrame(rows, columns=["start", "suggested_mode", "delay", "state"])


@dataclass(frozen=True, eq=False)
class GroundRobotRun:
    """
    One simulated run on the ground-robot testbed.

    Parameters
    ----------
    session : Session
        Everything logged at 10 Hz; its metadata say that it is synthetic.
    course : Course
        Where.
    operator : Operator
        Who.
    robot : Pioneer
        What.
    model : TscModel
        The model behind TSC and the suggestions.
    thresholds : (float, float) or None
        TSC_l and TSC_u, where given.
    lap_times : numpy.ndarray, shape (laps,)
        When each lap ended [s].
    """

    session: Session
    course: Course
    operator: Operator
    robot: Pioneer
    model: TscModel
    thresholds: tuple[float, float] | None
    lap_times: np.ndarray

    def laps(self) -> pd.DataFrame:
        """Return the laps: columns lap, start [s], end [s], duration [s], manual_share, p_r, path_error [m]."""
        start = np.r_[0.0, self.lap_times[:-1]]
        data = self.session.data
        which = np.searchsorted(self.lap_times, data.index.to_numpy(), side="right").clip(max=start.size - 1)
        means = data[["mode", "p_r", "path_error"]].groupby(which).mean()
        return pd.DataFrame(
            {
                "lap": np.arange(1, start.size + 1),
                "start": start,
                "end": self.lap_times,
                "duration": self.lap_times - start,
                "manual_share": means["mode"].to_numpy(),
                "p_r": means["p_r"].to_numpy(),
                "path_error": means["path_error"].to_numpy(),
            }
        )

    def suggestions(self) -> pd.DataFrame:
        """Return the suggestions shown: columns start [s], suggested_mode, delay [s], state (`shown_suggestions`)."""
        return shown_suggestions(self.session)

    def measures(self) -> dict[str, float]:
        """
        Return the outcome measures of the run.

        Returns
        -------
        dict of str to float
            p_r, p_h, r, tsc: means; path_error [m], speed [m/s], manual_share: means; switches, laps: numbers;
            duration, lap_time [s]: of the run, and the mean of its laps; suggestions: how many were to be followed or
            not; followed_percent: share of them followed within 15 s, NaN without any.
        """
        session = self.session
        states = self.suggestions()["state"]
        decided = int(states.isin(STATES[:2]).sum())
        followed = 100.0 * float((states == "followed").sum()) / decided if decided else np.nan
        means = {name: float(session[name].mean()) for name in ("p_r", "p_h", "r", "tsc", "path_error")}
        return means | {
            "speed": float(session["step_distance"].mean()) / session.sample_time,
            "manual_share": float(session["mode"].mean()),
            "switches": int(np.count_nonzero(np.diff(session["mode"]))),
            "laps": int(self.lap_times.size),
            "duration": session.duration,
            "lap_time": float(self.lap_times[-1] / self.lap_times.size),
            "suggestions": decided,
            "followed_percent": followed,
        }

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
        from trustlab.testbeds.plots import plot_run

        return plot_run(self, bounds)

    def plot_path(self, start: float = 0.0, stop: float | None = None, axes=None):
        """
        Plot the desired path and where the robot went under manual and autonomous control, as Fig. 2.2 does.

        Parameters
        ----------
        start, stop : float, optional
            The part of the run to show [s]; to its end when `stop` is not given.
        axes : matplotlib.axes.Axes, optional
            Where to plot; a new figure when not given.

        Returns
        -------
        matplotlib.axes.Axes
        """
        from trustlab.testbeds.plots import plot_path

        return plot_path(self.session, self.course, start, stop, axes)

    def _repr_html_(self) -> str:
        head = f"<b>Ground-robot run</b>: {self.session.label}; {self.session.metadata.more.get('note', '')}"
        return f"<p>{head}</p>{self.table().to_html(index=False, float_format='%.4g')}"

    def __repr__(self) -> str:
        return f"GroundRobotRun({self.session.label}: {self.lap_times.size} laps in {self.session.duration:.0f} s)"
