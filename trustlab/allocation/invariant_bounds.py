"""Bounds on the switched system that hold for every trajectory: sets of states carried round the cycle."""

from __future__ import annotations

import html
import math
from dataclasses import dataclass

import numpy as np

from trustlab.allocation.covers import narrow
from trustlab.allocation.intervals import ROUNDING, enclose, nest
from trustlab.allocation.limits import check_thresholds
from trustlab.allocation.phases import pack
from trustlab.models.checks import whole_number
from trustlab.models.tsc import TscModel

__all__ = ["InvariantBounds", "invariant_bounds"]

EFFORT = 3_000_000
"""Samples that polygons may be stepped through, or twenty of the longest phases if that is more."""


@dataclass(frozen=True)
class InvariantBounds:
    """
    Bounds for every trajectory under rule (2.8), whatever its start.

    They hold from the `cycles`-th return to manual control on, overshoot of the thresholds included.

    Parameters
    ----------
    guaranteed : bool
        Whether every trajectory is shown to keep switching; where not, the bounds are the trivial ones.
    reason : str
        What was shown.
    cycles : int
        After how many returns to manual control the bounds hold.
    r_low, r_high : float
        Utilization.
    p_r_low, p_r_high : float
        Robot performance.
    tsc_low, tsc_high : float
        TSC; beyond the thresholds by the overshoot of one step.
    dwell_manual_low, dwell_manual_high : float
        Samples in a row under manual control.
    dwell_autonomous_low, dwell_autonomous_high : float
        Samples in a row under autonomous control.
    """

    guaranteed: bool
    reason: str
    cycles: int
    r_low: float
    r_high: float
    p_r_low: float
    p_r_high: float
    tsc_low: float
    tsc_high: float
    dwell_manual_low: float
    dwell_manual_high: float
    dwell_autonomous_low: float
    dwell_autonomous_high: float

    def _repr_html_(self) -> str:
        return f"<p>{html.escape(self.reason)}</p>{self.table().to_html(float_format='%.4g')}"

    def __repr__(self) -> str:
        return (
            f"InvariantBounds(guaranteed={self.guaranteed}, r {self.r_low:.4g} to {self.r_high:.4g}, P_r {self.p_r_low:.4g} to "
            f"{self.p_r_high:.4g}, TSC {self.tsc_low:.4g} to {self.tsc_high:.4g}, cycles={self.cycles})"
        )

    def table(self):
        """
        Return the bounds as a table.

        Returns
        -------
        pandas.DataFrame
            Index `quantity`; columns low, high.
        """
        import pandas as pd

        rows = {
            "r": (self.r_low, self.r_high),
            "P_r": (self.p_r_low, self.p_r_high),
            "TSC": (self.tsc_low, self.tsc_high),
            "dwell time manual": (self.dwell_manual_low, self.dwell_manual_high),
            "dwell time autonomous": (self.dwell_autonomous_low, self.dwell_autonomous_high),
        }
        return pd.DataFrame.from_dict(rows, orient="index", columns=["low", "high"]).rename_axis("quantity")


def invariant_bounds(
    tsc: TscModel, lower: float, upper: float, cells: int = 32, cycles: int = 200
) -> InvariantBounds:
    """
    Bound utilization, robot performance and dwell times for every trajectory under rule (2.8).

    At a switch TSC equals its threshold up to the overshoot of one step, so that the state is an interval of r with an
    interval of TSC. Both are carried through a manual and an autonomous phase in interval arithmetic; beginning with
    r in [0, 1] the intervals nest, and what they nest to encloses every trajectory after as many cycles. Once they
    shrink no further they are cut into polygons of r and P_r, which keep account of how the two move together.

    Parameters
    ----------
    tsc : TscModel
        The model.
    lower, upper : float
        Thresholds TSC_l and TSC_u.
    cells : int
        Into how many parts an interval of r is cut; more give tighter bounds and take longer.
    cycles : int
        Most cycles to follow; fewer give valid but wider bounds that hold sooner.

    Returns
    -------
    InvariantBounds

    Raises
    ------
    ValueError
        If the thresholds are not finite or in the wrong order, or `cells` or `cycles` is not a whole
        number ≥ 1, or `tsc` is not a `TscModel`.
    """
    lower, upper = check_thresholds(tsc, lower, upper)
    cells, cycles = whole_number("cells", cells), whole_number("cycles", cycles)
    c = pack(tsc)
    most = int(60.0 / (1.0 - max(c[0], c[4]))) + 100
    manual, autonomous = np.empty(9), np.empty(9)
    done, more = nest(lower, upper, c, cells, (cycles + 1) // 2, most, 0.05, manual, autonomous), 0
    if 0 < done < cycles - 1:
        more, settled = _narrowed(lower, upper, c, cells, cycles - done - 1, most, manual, autonomous)
    if more:
        done += more + 1
    elif done > 0:
        done = nest(lower, upper, c, cells, cycles, most, 1e-3, manual, autonomous)
        settled = done < cycles
    if done < 0:
        phase = "a manual" if done == -1 else "an autonomous"
        ceiling = tsc.robot.p_min + tsc.robot.b * tsc.human.p_max / (1.0 - tsc.robot.a)
        return InvariantBounds(
            False,
            f"{phase} phase may never end from some utilization",
            0,
            0.0,
            1.0,
            tsc.robot.p_min,
            ceiling,
            -math.inf,
            math.inf,
            1.0,
            math.inf,
            1.0,
            math.inf,
        )
    worst = max(manual[4], autonomous[4]) * ROUNDING
    return InvariantBounds(
        True,
        f"every trajectory keeps switching; sets of states nested over {done} cycles"
        + ("" if settled else ", the limit, and were still shrinking: more cycles give tighter bounds"),
        done + 1,
        float(max(manual[0] - worst, 0.0)),
        float(min(autonomous[1] + worst, 1.0)),
        float(min(manual[5], autonomous[5]) - worst),
        float(max(manual[6], autonomous[6]) + worst),
        float(min(manual[7], lower - autonomous[2]) - worst),
        float(max(autonomous[8], upper + manual[2]) + worst),
        float(manual[3]),
        float(manual[4]),
        float(autonomous[3]),
        float(autonomous[4]),
    )


def _narrowed(lower, upper, c, cells, cycles, most, manual, autonomous):
    """Narrow what the intervals nested to; returns by how many cycles, and whether that was all there was to gain."""
    # A phase has at least one sample, and an autonomous one at most as many as the intervals leave room for.
    low = max(manual[0], (1.0 - c[0]) * c[0] ** autonomous[4] * (1.0 - 1e-9))
    high, over = min(manual[1], c[0] + 1e-12), autonomous[2]
    if low < 1e-100 or high >= 1.0 or high <= low:
        return 0, True
    budget = max(EFFORT, 20 * most)
    low, high, over, _, more = narrow(low, high, over, lower, upper, c, cells, cycles, most, budget)
    tighter, also = np.empty(9), np.empty(9)
    if not more or enclose(low, high, over, lower, upper, c, cells, most, tighter, also) < 0:
        return 0, True
    manual[:], autonomous[:] = tighter, also
    return more, more < cycles
