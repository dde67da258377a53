"""What a run of the ground robot hands back: the session, its measures and its figures."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pandas as pd

from trustlab.testbeds.condition_run import ConditionRun
from trustlab.testbeds.ground_robot.course import Course
from trustlab.testbeds.ground_robot.pioneer import Pioneer


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class GroundRobotRun(ConditionRun):
    """
    One simulated run on the ground-robot testbed.

    Parameters
    ----------
    session, operator, model, thresholds : Session, Operator, TscModel, (float, float) or None
        As for a `ConditionRun`.
    course : Course
        Where.
    robot : Pioneer
        What.
    lap_times : numpy.ndarray, shape (laps,)
        When each lap ended [s].
    """

    title: ClassVar[str] = "Ground-robot run"

    course: Course
    robot: Pioneer
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

    def __repr__(self) -> str:
        return f"GroundRobotRun({self.session.label}: {self.lap_times.size} laps in {self.session.duration:.0f} s)"
