"""Mean P_r against mean utilization times human performance: (2.3) and (2.5) tie them."""

from dataclasses import dataclass

import numpy as np
import pandas as pd

from trustlab.models.checks import one_of
from trustlab.models.display import as_html, axes_or_new
from trustlab.reproduction.published import published_table
from trustlab.reproduction.published_study import published_studies

SUGGESTED = ["C2", "C3", "C4", "C5"]
UAV = {"p_r": "uav.robot_performance", "p_h": "uav.human_performance", "r": "uav.utilization"}


@dataclass(frozen=True, eq=False)
class PerformanceLine:
    """
    The line P_r = intercept + slope · r P_h through C2 to C5, and how far off C1 lies.

    In the steady cycle of (2.3) and (2.5) mean P_r = P_r,min + (P_r,max − P_r,min)/P_h,max · mean
    of M P_h with mean M = mean r, so that no pair of thresholds can raise mean P_r at equal r P_h.

    Parameters
    ----------
    title : str
        Whose means.
    means : pandas.DataFrame
        p_r, p_h and r by condition, C1 to C5.
    slope, intercept : float
        Of the line, by least squares through C2 to C5.
    """

    title: str
    means: pd.DataFrame
    slope: float
    intercept: float

    def table(self) -> pd.DataFrame:
        """Return condition, r_p_h, p_r, and distance, P_r minus the line."""
        table = (
            self.means.set_axis(self.means.index.astype(str)).rename_axis("condition").reset_index()
        )
        table["r_p_h"] = table["r"] * table["p_h"]
        table["distance"] = table["p_r"] - self.intercept - self.slope * table["r_p_h"]
        return table[["condition", "r_p_h", "p_r", "distance"]]

    def plot(self, axes=None):
        """
        Plot the conditions and the line.

        Parameters
        ----------
        axes : matplotlib.axes.Axes, optional
            Where to draw; a new figure by default.

        Returns
        -------
        matplotlib.axes.Axes
        """
        axis = axes_or_new(axes)
        table = self.table()
        ends = table["r_p_h"].agg(["min", "max"])
        axis.plot(ends, self.intercept + self.slope * ends, color="black", lw=1.0)
        axis.plot(table["r_p_h"], table["p_r"], "o")
        for row in table.itertuples():
            aside = (
                (-6, 5) if row.distance > 0 else (6, -6)
            )  # away from the line, as neighbours may nearly coincide
            axis.annotate(
                row.condition, (row.r_p_h, row.p_r), xytext=aside, textcoords="offset points"
            )
        axis.set(
            xlabel="utilization × human performance", ylabel="robot performance", title=self.title
        )
        return axis

    def _repr_html_(self) -> str:
        line = f"P_r = {self.intercept:.3f} + {self.slope:.3f} r P_h through C2 to C5"
        return as_html(f"{self.title}: {line}", self.table())


def performance_line(means: str | pd.DataFrame, title: str | None = None) -> PerformanceLine:
    """
    Return the line through C2 to C5 of mean robot performance against r P_h.

    Parameters
    ----------
    means : {"ground_robot", "uav"} or pandas.DataFrame
        The printed means of Table 2.5 or of Section 2.4.2.4; or the measures of a virtual study,
        columns condition, p_r, p_h, r.
    title : str, optional
        Whose means; "printed" or "simulated" by default.

    Returns
    -------
    PerformanceLine

    Raises
    ------
    ValueError
        If a column or a condition is missing.
    """
    if isinstance(means, pd.DataFrame):
        title = "simulated operators" if title is None else title
        absent = [name for name in ("condition", *UAV) if name not in means]
        if absent:
            raise ValueError(
                f"means must have the columns condition, {', '.join(UAV)}; there is no {absent[0]}"
            )
        by_condition = means.groupby(means["condition"].astype(str))[list(UAV)].mean()
    elif one_of("means", means, ["ground_robot", "uav"], "a DataFrame of measures") == "uav":
        by_condition = pd.DataFrame(
            {name: dict(published_studies()[study].mean) for name, study in UAV.items()}
        ).astype(float)
    else:
        table = published_table("2.5").astype(float)
        by_condition = table[["P_r_mean", "P_h_mean", "r_mean"]].set_axis(list(UAV), axis=1)
    absent = [condition for condition in ("C1", *SUGGESTED) if condition not in by_condition.index]
    if absent:
        raise ValueError(f"the line needs conditions C1 to C5; there is no {absent[0]}")
    by_condition = by_condition.loc[["C1", *SUGGESTED]]
    through = by_condition.loc[SUGGESTED]
    slope, intercept = np.polyfit(through["r"] * through["p_h"], through["p_r"], 1)
    return PerformanceLine(
        f"{means}, printed" if title is None else title,
        by_condition,
        float(slope),
        float(intercept),
    )
