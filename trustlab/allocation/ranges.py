"""Ranges of a steady motion under rule (2.8): printed bounds, exact cycles and proved bounds."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from trustlab.models.checks import open_unit
from trustlab.models.display import Result, as_html
from trustlab.models.tsc import TscModel

# Rows of tables of ranges, and how the names of their ends begin.
QUANTITIES = {
    "r": "r",
    "P_r": "p_r",
    "TSC": "tsc",
    "dwell time manual": "dwell_manual",
    "dwell time autonomous": "dwell_autonomous",
}


@dataclass(frozen=True, kw_only=True, repr=False)
class SteadyRanges:
    """
    Ranges of a steady motion; NaN where there is none.

    Parameters
    ----------
    model : TscModel
        The model.
    lower, upper : float
        Thresholds TSC_l and TSC_u.
    reason : str
        Where the ranges come from, or why there are none.
    r_low, r_high : float
        Utilization.
    p_r_low, p_r_high : float
        Robot performance.
    tsc_low, tsc_high : float
        TSC; it passes the thresholds by the overshoot of a step.
    dwell_manual_low, dwell_manual_high : float
        Consecutive samples in the manual mode.
    dwell_autonomous_low, dwell_autonomous_high : float
        Consecutive samples in the autonomous mode.
    """

    model: TscModel
    lower: float
    upper: float
    reason: str
    r_low: float = math.nan
    r_high: float = math.nan
    p_r_low: float = math.nan
    p_r_high: float = math.nan
    tsc_low: float = math.nan
    tsc_high: float = math.nan
    dwell_manual_low: float = math.nan
    dwell_manual_high: float = math.nan
    dwell_autonomous_low: float = math.nan
    dwell_autonomous_high: float = math.nan

    @property
    def dwell_manual(self) -> tuple[float, float]:
        """Least and greatest number of consecutive samples in the manual mode."""
        return self.dwell_manual_low, self.dwell_manual_high

    @property
    def dwell_autonomous(self) -> tuple[float, float]:
        """Least and greatest number of consecutive samples in the autonomous mode."""
        return self.dwell_autonomous_low, self.dwell_autonomous_high

    def table(self) -> pd.DataFrame:
        """
        Return the ranges.

        Returns
        -------
        pandas.DataFrame
            Index `quantity` (r, P_r, TSC, dwell time manual, dwell time autonomous); columns low,
            high.
        """
        ends = {
            quantity: (getattr(self, f"{name}_low"), getattr(self, f"{name}_high"))
            for quantity, name in QUANTITIES.items()
        }
        table = pd.DataFrame.from_dict(ends, orient="index", columns=["low", "high"])
        return table.rename_axis("quantity")

    def _repr_html_(self) -> str:
        return as_html(self.reason, self.table())

    def __repr__(self) -> str:
        ends = (
            f"r {self.r_low:.4g} to {self.r_high:.4g}, P_r {self.p_r_low:.4g} to "
            f"{self.p_r_high:.4g}, TSC {self.tsc_low:.4g} to {self.tsc_high:.4g}"
        )
        return f"{type(self).__name__}({ends}, {self._qualified()})"

    def _qualified(self) -> str:
        """Return what else a class of ranges says of itself in a line."""
        return f"reason={self.reason!r}"


# --- over the draws of a posterior ---------------------------------------------------------------

# Draws of a posterior that are followed.
DRAWS = 200


@dataclass(frozen=True, eq=False, repr=False)
class RangeIntervals(Result):
    """
    Ranges of a motion under one pair of thresholds, over the draws of a posterior.

    Parameters
    ----------
    results : list
        A `LimitCycle` or `InvariantBounds` of each draw that was followed.
    holds : numpy.ndarray of bool
        For which draws the rule keeps switching, or the bounds are guaranteed.
    """

    title = "Ranges over draws"

    results: list
    holds: np.ndarray

    @property
    def probability(self) -> float:
        """Share of the draws for which the rule keeps switching, or bounds are guaranteed."""
        return float(self.holds.mean())

    @property
    def message(self) -> str:
        """How probable the motion is, and over how many draws."""
        words = f"exists with probability {self.probability:.2f}; medians and 95 % intervals"
        return f"{words} over {len(self.results)} draws"

    def table(self, level: float = 0.95) -> pd.DataFrame:
        """
        Return intervals of every quantity, over the draws for which the motion exists.

        Parameters
        ----------
        level : float
            Level of the intervals, in (0, 1).

        Returns
        -------
        pandas.DataFrame
            Index `quantity`; for each column of a single result its median and its ends ci_low and
            ci_high, as in `low`, `low_ci_low`, `low_ci_high`; NaN without a motion.

        Raises
        ------
        ValueError
            If `level` is outside (0, 1).
        """
        level = open_unit("level", level)
        ends = [0.5, 0.5 - 0.5 * level, 0.5 + 0.5 * level]
        pairs = zip(self.results, self.holds, strict=True)
        tables = [result.table() for result, holds in pairs if holds]
        template = self.results[0].table()
        columns = {}
        for column in template.columns:
            values = np.array([table[column] for table in tables])
            shape = (3, len(template))
            found = np.quantile(values, ends, axis=0) if len(tables) else np.full(shape, np.nan)
            columns |= dict(
                zip((column, f"{column}_ci_low", f"{column}_ci_high"), found, strict=True)
            )
        return pd.DataFrame(columns, index=template.index)


def over_draws(models: list, result: Any, condition: str) -> RangeIntervals:
    """Return the result of every draw, and for which the named condition holds."""
    results = [result(tsc) for tsc in models[:DRAWS]]
    return RangeIntervals(results, np.array([bool(getattr(each, condition)) for each in results]))
