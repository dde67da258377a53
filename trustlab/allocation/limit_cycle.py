"""The exact steady cycle of the switched system, found from its return map."""

from __future__ import annotations

import html
import math
from dataclasses import dataclass

import numpy as np

from trustlab.allocation.limits import check_thresholds
from trustlab.allocation.motions import Motions
from trustlab.allocation.phases import crossing_map, human_at, pack
from trustlab.models.checks import whole_number
from trustlab.models.tsc import TscModel

__all__ = ["LimitCycle", "human_at", "limit_cycle", "pack"]

EFFORT = 3_000_000
"""Samples that the search for further motions may step through, or twenty of the longest phases if that is more."""


@dataclass(frozen=True)
class LimitCycle:
    """
    The steady motion under rule (2.8).

    With switching at whole samples TSC overshoots a threshold by a part of a step, so that the motion may repeat only
    after several cycles or never exactly; extremes and dwell times are then those of the whole attractor.

    Parameters
    ----------
    exists : bool
        Whether the rule keeps switching, from some start at least.
    always : bool
        Whether it keeps switching from every start that was followed; where `exhaustive`, from every trajectory that has
        once begun a manual phase.
    reason : str
        What happens where it does not; else how the cycle was found.
    r_low, r_high : float
        Range of utilization; NaN without a cycle, as all below.
    p_r_low, p_r_high : float
        Range of robot performance.
    tsc_low, tsc_high : float
        Range of TSC, overshoot included.
    dwell_manual, dwell_autonomous : tuple of int
        Least and greatest number of samples in a row in each mode.
    period : int or None
        After how many cycles the motion repeats; None where it does not within the cycles followed, or where motions
        of different period coexist.
    motions : int
        How many motions coexist, told apart by the overshoot they lock to.
    exhaustive : bool
        Whether the search came to its end: every trajectory tends to the motions found or stays in the ranges given.
        Arithmetic is rounded, so that this is shown up to sets of states of the size of the rounding.
    unique : bool
        Whether the return map of r has exactly one fixed point on a grid of [0, 1].
    slope : float
        Slope of the return map there; below 1 in size the cycle attracts.
    mean_r, mean_p_r : float
        Time averages of utilization and robot performance.
    """

    exists: bool
    reason: str
    r_low: float = math.nan
    r_high: float = math.nan
    p_r_low: float = math.nan
    p_r_high: float = math.nan
    tsc_low: float = math.nan
    tsc_high: float = math.nan
    dwell_manual: tuple[int, int] | None = None
    dwell_autonomous: tuple[int, int] | None = None
    period: int | None = None
    motions: int = 0
    unique: bool = False
    slope: float = math.nan
    mean_r: float = math.nan
    mean_p_r: float = math.nan
    always: bool = False
    exhaustive: bool = False

    @property
    def stable(self) -> bool:
        """Whether the slope of the return map is below 1 in size."""
        return abs(self.slope) < 1.0

    def _repr_html_(self) -> str:
        return f"<p>{html.escape(self.reason)}</p>{self.table().to_html(float_format='%.4g')}"

    def __repr__(self) -> str:
        if not self.exists:
            return f"LimitCycle(exists=False, reason={self.reason!r})"
        return (
            f"LimitCycle(r {self.r_low:.4g} to {self.r_high:.4g}, P_r {self.p_r_low:.4g} to {self.p_r_high:.4g}, "
            f"TSC {self.tsc_low:.4g} to {self.tsc_high:.4g}, always={self.always}, exhaustive={self.exhaustive})"
        )

    def table(self):
        """
        Return ranges and means.

        Returns
        -------
        pandas.DataFrame
            Index `quantity`; columns low, high, mean.
        """
        import pandas as pd

        manual, autonomous = (
            pair or (math.nan, math.nan) for pair in (self.dwell_manual, self.dwell_autonomous)
        )
        rows = {
            "r": (self.r_low, self.r_high, self.mean_r),
            "P_r": (self.p_r_low, self.p_r_high, self.mean_p_r),
            "TSC": (self.tsc_low, self.tsc_high, math.nan),
            "dwell time manual": (*manual, math.nan),
            "dwell time autonomous": (*autonomous, math.nan),
        }
        return pd.DataFrame.from_dict(rows, orient="index", columns=["low", "high", "mean"]).rename_axis(
            "quantity"
        )


def limit_cycle(tsc: TscModel, lower: float, upper: float, starts: int = 64) -> LimitCycle:
    """
    Find the steady cycle of rule (2.8).

    At a switch TSC equals its threshold up to one step, which fixes P_r, so that one cycle is a map of r alone. The
    motions from β and from rest are followed sample by sample until transients have died away, then over many cycles.
    Then all states at which manual phases can begin are carried round the cycle as sets that are cut wherever dwell
    times change, until each is drawn to a known motion, is followed to a new one, or has shrunk to a point of what does
    not repeat. The return map without overshoot tells whether there is one cycle and whether it attracts.

    Parameters
    ----------
    tsc : TscModel
        The model.
    lower, upper : float
        Thresholds TSC_l and TSC_u.
    starts : int
        How many starts to follow, spread over utilization and overshoot, where the search does not come to its end.
        1 is the quick setting: β and rest are followed, and nothing is searched.

    Returns
    -------
    LimitCycle
        With `exists` False where the rule stops switching from every start, and why; `always` False where it does from
        some.

    Raises
    ------
    ValueError
        If `tsc` is not a TscModel, the thresholds are not finite or in the wrong order, or `starts` is not a whole
        number ≥ 1.
    """
    lower, upper = check_thresholds(tsc, lower, upper)
    starts = whole_number("starts", starts)
    c = pack(tsc)
    motions = Motions(c, lower, upper)
    step = tsc.a_T * (1.0 - tsc.robot.a) * (tsc.robot.p_max - tsc.robot.p_min)

    def begin(j):
        r = tsc.human.beta if j == 0 else (j - 1) / starts
        tsc_then = lower - (j * 0.6180339887498949 % 1.0) * step
        p_r = (tsc_then + tsc.b_T * tsc.human.performance(r)) / tsc.a_T if j != 1 else tsc.robot.p_min
        motions.follow(r, p_r)

    begin(0)
    begin(1)
    followed = 2
    if starts > 1 and not motions.stopped:
        motions.search(max(EFFORT, 20 * motions.most))
        if not motions.exhaustive:
            for j in range(2, starts + 1):
                begin(j)
            followed = starts + 1
    elif starts > 1:
        for j in range(2, starts + 1):
            begin(j)
        followed = starts + 1
    found, stopped = motions.found, motions.stopped
    stays = ""
    if stopped:
        state, r, p_r = stopped[0]
        mode, target, side = (
            ("manual", upper, "rising to TSC_u") if state == -1 else ("autonomous", lower, "falling to TSC_l")
        )
        settled = tsc.value(p_r, tsc.human.performance(min(max(r, 0.0), 1.0)))
        stays = f"stays {mode}: TSC settles at {settled:.4f} without {side} = {target:.4f}"
    if not found:
        return LimitCycle(False, stays)
    rows = np.concatenate([motion.rows for motion in found])
    traces = np.array([motion.trace for motion in found])
    periods = {motion.period for motion in found}
    period = periods.pop() if len(periods) == 1 else None
    slope, unique = _return_map(float(rows[:, 0].mean()), lower, upper, c, motions.most)
    how = _how(motions, rows, period)
    if stopped:
        how += f"; but from {len(stopped)} of {followed} starts it {stays}"
    mean_r, mean_p_r = (float(np.mean(traces[:, k] / traces[:, 6])) for k in (4, 5))
    if motions.rest is not None:
        rows = np.concatenate([rows, motions.rest.rows])
        traces = np.vstack([traces, motions.rest.trace])
    return LimitCycle(
        exists=True,
        reason=how,
        always=not stopped,
        exhaustive=motions.exhaustive,
        r_low=float(rows[:, 0].min()),
        r_high=float(rows[:, 4].max()),
        p_r_low=float(traces[:, 0].min()),
        p_r_high=float(traces[:, 1].max()),
        tsc_low=float(traces[:, 2].min()),
        tsc_high=float(traces[:, 3].max()),
        dwell_manual=(int(rows[:, 2].min()), int(rows[:, 2].max())),
        dwell_autonomous=(int(rows[:, 3].min()), int(rows[:, 3].max())),
        period=period,
        motions=len(found),
        unique=unique,
        slope=slope,
        mean_r=mean_r,
        mean_p_r=mean_p_r,
    )


def _how(motions: Motions, rows: np.ndarray, period: int | None) -> str:
    """Say how the motions were found."""
    found = motions.found
    if len(found) > 1:
        listed = ", ".join("without" if motion.period is None else str(motion.period) for motion in found)
        how = f"{len(found)} motions coexist, one overshoot apart (periods {listed}); ranges enclose all of them"
    else:
        how = f"repeats after {period} cycle(s)" if period else f"does not repeat within {len(rows)} cycles"
    if not motions.exhaustive:
        return how + "; the search for further motions was left out or did not come to its end"
    if motions.rest is not None:
        return (
            how + f"; every other trajectory stays in the ranges, enclosed in {motions.left} sets of states"
        )
    return how + "; no other motion exists"


def _return_map(middle: float, lower: float, upper: float, c: np.ndarray, most: int) -> tuple[float, bool]:
    """Return the slope of the return map without overshoot about `middle`, and whether it has one fixed point."""
    ends = np.geomspace(1e-15, 0.015, 16)
    grid = np.r_[ends, np.linspace(0.0, 1.0, 65)[1:-1], 1.0 - ends[::-1]]
    gap = np.array([crossing_map(x, lower, upper, c, most) for x in grid]) - grid
    # The map leads from rest upwards or nowhere, and from full load downwards or nowhere.
    signs = np.r_[1.0, np.sign(gap[np.isfinite(gap)]), -1.0]
    signs = signs[signs != 0.0]
    reach = max(1e-4 * min(middle, 1.0 - middle), 1e-12)
    around = (max(middle - reach, 0.0), min(middle + reach, 1.0))
    after = [crossing_map(x, lower, upper, c, most) for x in around]
    slope = float((after[1] - after[0]) / (around[1] - around[0]))
    return slope, bool(np.count_nonzero(np.diff(signs)) == 1)
