"""Ranges of a steady motion under rule (2.8): printed bounds, exact cycles and proved bounds."""

import math
from dataclasses import dataclass
from typing import Any

import pandas as pd

from trustlab.models.display import Result
from trustlab.models.tsc import TscModel

# Rows of tables of ranges, and how the names of their ends begin.
QUANTITIES = {
    "r": "r",
    "P_r": "p_r",
    "TSC": "tsc",
    "dwell time manual": "dwell_manual",
    "dwell time autonomous": "dwell_autonomous",
}


def ends(**ranges: Any) -> dict[str, Any]:
    """Return the fields of `SteadyRanges` from the ranges by name."""
    fields: dict[str, Any] = {}
    for name, (low, high) in ranges.items():
        fields |= {f"{name}_low": float(low), f"{name}_high": float(high)}
    return fields


@dataclass(frozen=True, kw_only=True, repr=False)
class SteadyRanges(Result):
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
    def message(self) -> str:
        """Where the ranges come from, or why there are none."""
        return self.reason

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
