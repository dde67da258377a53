"""What a run of the ground robot hands back: the session, its measures and its figures."""

from dataclasses import dataclass

import numpy as np
import pandas as pd

from trustlab.allocation.suggestions import followed_suggestions
from trustlab.models.html import as_html
from trustlab.models.tsc import TscModel
from trustlab.operators.ground_robot import Operator
from trustlab.sessions.session import Session
from trustlab.testbeds.deciding import DEADLINE
from trustlab.testbeds.ground_robot.course import Course
from trustlab.testbeds.ground_robot.pioneer import Pioneer

STATES = ("followed", "not followed", "withdrawn", "open")


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
        """Return the suggestions shown: columns start [s], suggested_mode, delay [s], followed, state (`followed_suggestions`)."""
        return followed_suggestions(self.session, DEADLINE)

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
        from trustlab.testbeds.ground_robot.plots import plot_run

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
        from trustlab.testbeds.ground_robot.plots import plot_path

        return plot_path(self.session, self.course, start, stop, axes)

    def _repr_html_(self) -> str:
        words = f"{self.session.label}; {self.session.metadata.more.get('note', '')}"
        return as_html(words, self.table(), title="Ground-robot run")

    def __repr__(self) -> str:
        return f"GroundRobotRun({self.session.label}: {self.lap_times.size} laps in {self.session.duration:.0f} s)"
