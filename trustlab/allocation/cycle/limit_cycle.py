"""The exact steady cycle of the switched system, found from its return map."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import overload

import numpy as np
import pandas as pd

from trustlab.allocation.cycle import phases
from trustlab.allocation.cycle.intervals import RangeIntervals, over_draws
from trustlab.allocation.limits import check_thresholds
from trustlab.allocation.steady_ranges import SteadyRanges
from trustlab.identification.posterior.result import Posterior
from trustlab.models.checks import whole_number
from trustlab.models.display import axes_or_new
from trustlab.models.tsc import TscModel

# Cycles that are recorded of a motion that does not repeat, if they are no more than EFFORT
# samples.
MOST_CYCLES = 2000

# Cycles that are recorded first.
FEWEST_CYCLES = 24

# How near, in r and P_r, a trajectory must come to a motion that repeats to count as drawn to it.
REPEATED = 1e-9

# Multiples of this point, modulo 1, fill the unit square evenly, however many there are (the
# plastic number's sequence).
EVEN = (0.7548776662466927, 0.5698402909980532)


@dataclass(frozen=True, kw_only=True, repr=False)
class LimitCycle(SteadyRanges):
    """
    The steady motion under rule (2.8).

    With switching at whole samples TSC overshoots a threshold by a part of a step, so that the
    motion may repeat only after several cycles or never exactly; ranges are then those of all the
    cycles recorded, NaN without a cycle.

    Parameters
    ----------
    exists : bool
        Whether the rule keeps switching, from some start at least; where not, `reason` says what
        happens.
    always : bool
        Whether it keeps switching from every start: false where there are states from which a mode
        stays for ever, which the limits of TSC in either mode tell exactly, and where a simulated
        start stopped.
    period : int or None
        After how many cycles the motion repeats; None where it does not within the cycles followed,
        or where motions of different period coexist.
    motions : int
        How many motions were found to coexist, told apart by the overshoot they lock to. There can
        be more, see `limit_cycle`.
    r_manual : float
        Mean utilization as manual phases begin.
    mean_r, mean_p_r : float
        Time averages of utilization and robot performance.
    """

    exists: bool
    always: bool = False
    period: int | None = None
    motions: int = 0
    r_manual: float = math.nan
    mean_r: float = math.nan
    mean_p_r: float = math.nan

    @functools.cached_property
    def slope(self) -> float:
        """Slope of the return map of r without overshoot; below 1 in size the cycle attracts."""
        reach = max(1e-4 * min(self.r_manual, 1.0 - self.r_manual), 1e-12)
        around = np.array([max(self.r_manual - reach, 0.0), min(self.r_manual + reach, 1.0)])
        after = self._returned(around)
        return float((after[1] - after[0]) / (around[1] - around[0]))

    @functools.cached_property
    def unique(self) -> bool:
        """Whether the return map of r without overshoot has one fixed point on a grid of [0, 1]."""
        ends = np.geomspace(1e-15, 0.015, 16)
        grid = np.r_[ends, np.linspace(0.0, 1.0, 65)[1:-1], 1.0 - ends[::-1]]
        gap = self._returned(grid) - grid
        # From rest the map leads upwards or nowhere, and from full load downwards or nowhere.
        signs = np.r_[1.0, np.sign(gap[np.isfinite(gap)]), -1.0]
        return bool(self.exists and np.count_nonzero(np.diff(signs[signs != 0.0])) == 1)

    def _returned(self, grid: np.ndarray) -> np.ndarray:
        """Return utilization one cycle later, from each of the grid; NaN without a cycle."""
        if not self.exists:
            return np.full(grid.size, np.nan)
        c = phases.resampled(self.model).constants()
        return np.array(
            [phases.return_map(r, self.lower, self.upper, c, phases.longest_phase(c)) for r in grid]
        )

    @property
    def stable(self) -> bool:
        """Whether the slope of the return map is below 1 in size."""
        return abs(self.slope) < 1.0

    def __repr__(self) -> str:
        if not self.exists:
            return f"LimitCycle(exists=False, reason={self.reason!r})"
        return super().__repr__()

    def _qualified(self) -> str:
        return f"always={self.always}"

    def table(self) -> pd.DataFrame:
        """
        Return ranges and means.

        Returns
        -------
        pandas.DataFrame
            Index `quantity`; columns low, high, mean.
        """
        table = super().table()
        means = {"r": self.mean_r, "P_r": self.mean_p_r}
        return table.assign(mean=table.index.map(means).astype(float))

    def plot(self, axes=None):
        """
        Plot rule (2.8) over utilization and robot performance, with a run, as in Fig. 2.4.

        Parameters
        ----------
        axes : matplotlib.axes.Axes, optional
            Where to plot; a new figure when not given.

        Returns
        -------
        matplotlib.axes.Axes
        """
        from trustlab.allocation.simulation import simulate_allocation

        model = self.model
        robot = self.model.robot
        axes = axes_or_new(axes, figsize=(7, 4.2))
        margin = 0.2 * (robot.p_max - robot.p_min)
        r = np.linspace(0, 1, 300)
        p_r = np.linspace(robot.p_min - margin, robot.p_max + margin, 200)
        p_h = model.human.performance(r)
        levels = axes.contourf(
            r, p_r, model.value(p_r[:, None], p_h[None, :]), 12, cmap="Greys", alpha=0.5
        )
        axes.figure.colorbar(levels, ax=axes, label="TSC")
        for value, label in ((self.lower, "$TSC_l$"), (self.upper, "$TSC_u$")):
            line = (value + model.b_T * p_h) / model.a_T
            axes.plot(r, line, "--", lw=1.5, label=f"{label} = {value:g}")
        settled = phases.longest_phase(model.constants())
        run = simulate_allocation(model, self.lower, self.upper, 2 * settled, r0=0.1)
        first = run.iloc[: settled // 2]
        last = run.iloc[settled:]
        axes.plot(first["r"], first["p_r"], lw=0.6, color="C2", label="from near rest")
        if self.exists:
            axes.plot(last["r"], last["p_r"], lw=2, color="C3", label="steady cycle")
        axes.set(xlabel="utilization r", ylabel="robot performance $P_r$", ylim=(p_r[0], p_r[-1]))
        axes.legend(fontsize="small")
        return axes


@overload
def limit_cycle(tsc: TscModel, lower: float, upper: float, starts: int = ...) -> LimitCycle: ...


@overload
def limit_cycle(
    tsc: Posterior, lower: float, upper: float, starts: int = ...
) -> RangeIntervals: ...


def limit_cycle(tsc, lower, upper, starts=48):
    """
    Find the steady cycle of rule (2.8).

    At a switch TSC equals its threshold up to one step, which fixes P_r, so that one cycle is a map
    of r alone. The system is simulated from β, from rest, and from further starts until transients
    have decayed, then over many cycles; what they settle to is told apart by the overshoot it locks
    to. The return map without overshoot tells whether there is one cycle and whether it attracts.

    Parameters
    ----------
    tsc : TscModel or Posterior
        The model; or a posterior (`sample_posterior`), of which 200 draws are followed, each from β
        and from rest.
    lower, upper : float
        Thresholds TSC_l and TSC_u.
    starts : int
        How many initial states to simulate from, besides rest. 1 is the quick setting: β and rest
        only.

    Returns
    -------
    LimitCycle or, for a posterior, RangeIntervals
        With `exists` False where the rule stops switching from every start, and why; `always` False
        where it does from some, and `reason` says from which.

    Raises
    ------
    ValueError
        If `tsc` is not a TscModel, the thresholds are not finite or in the wrong order, `starts` is
        not a whole number ≥ 1, or a time constant exceeds two million samples.

    Notes
    -----
    But for `always`, the result rests on the starts that were simulated, within EFFORT samples.
    Which of several coexisting motions a trajectory settles to depends on fractions of a step, so
    that one with a small basin can be missed. For every trajectory, whatever its start, there is
    `invariant_bounds`, whose ranges hold for motions that are missed here as well.

    Examples
    --------
    >>> import trustlab as tl
    >>> cycle = tl.limit_cycle(tl.published_models()["2"], lower=0.0, upper=0.35)
    >>> cycle.exists, round(cycle.mean_p_r, 3)
    (True, 0.325)
    """
    if isinstance(tsc, Posterior):
        return over_draws(tsc.models, lambda each: limit_cycle(each, lower, upper, 1), "exists")
    lower, upper = check_thresholds(tsc, lower, upper)
    starts = whole_number("starts", starts)
    search = MotionSearch(tsc, lower, upper)
    followed = 0
    states = _initial_states(tsc, lower, starts, search)
    for r, p_r in phases.watched(states, "limit cycle", starts + 1):
        if search.spent > phases.EFFORT:
            break
        search.follow(r, p_r)
        followed += 1
    if not search.motions:
        return LimitCycle(exists=False, reason=search.stays(), model=tsc, lower=lower, upper=upper)
    endless = phases.endless_phase(tsc, lower, upper)
    reason = search.summary()
    if search.stopped:
        reason += f"; but from {len(search.stopped)} of {followed} starts it {search.stays()}"
    elif endless:
        reason += f"; but {endless}"
    if followed < starts + 1:
        reason += (
            f"; {followed} of {starts + 1} starts were simulated, in about {phases.EFFORT:.0e} "
            "samples"
        )
    rows = np.concatenate([motion.rows for motion in search.motions])
    extremes = [motion.extremes for motion in search.motions]
    return LimitCycle(
        exists=True,
        reason=reason,
        always=not search.stopped and not endless,
        r_low=float(rows["r"].min()),
        r_high=float(rows["r_switch"].max()),
        p_r_low=min(ends.p_r_low for ends in extremes),
        p_r_high=max(ends.p_r_high for ends in extremes),
        tsc_low=min(ends.tsc_low for ends in extremes),
        tsc_high=max(ends.tsc_high for ends in extremes),
        dwell_manual_low=int(rows["manual"].min()),
        dwell_manual_high=int(rows["manual"].max()),
        dwell_autonomous_low=int(rows["autonomous"].min()),
        dwell_autonomous_high=int(rows["autonomous"].max()),
        period=search.period,
        motions=len(search.motions),
        r_manual=float(rows["r"].mean()),
        mean_r=float(np.mean([ends.sum_r / ends.samples for ends in extremes])),
        mean_p_r=float(np.mean([ends.sum_p_r / ends.samples for ends in extremes])),
        model=tsc,
        lower=lower,
        upper=upper,
    )


def _initial_states(tsc: TscModel, lower: float, starts: int, search: MotionSearch):
    """
    Yield r and P_r as manual phases begin.

    They are at β, at rest, spread over [0, 1], and then near the motions found by then.
    """
    human = tsc.human
    spread = starts // 8
    step = tsc.a_T * (1.0 - tsc.robot.a) * (tsc.robot.p_max - tsc.robot.p_min)

    def at(r, below):
        return r, (lower - below + tsc.b_T * human.performance(r)) / tsc.a_T

    yield at(human.beta, 0.0)
    yield 0.0, tsc.robot.p_min
    for j in range(2, starts + 1):
        along_r, along_tsc = (j * part % 1.0 for part in EVEN)
        if j <= spread or not search.motions or search.stopped:
            yield at(along_r, along_tsc * step)
            continue
        # Coexisting motions differ by a step or less in r and in overshoot, so that starts from all
        # over [0, 1] hardly ever tell them apart: after a transient these are all at the same few
        # states.
        r = np.concatenate([motion.rows["r"] for motion in search.motions])
        deepest = min(motion.extremes.tsc_low for motion in search.motions)
        over = max(lower - deepest, 0.2 * step)
        low = max(r.min() - human.b, 0.0)
        high = min(r.max() + human.b, 1.0)
        yield at(low + along_r * (high - low), along_tsc * 1.2 * over)


@dataclass(frozen=True, eq=False)
class CycleMotion:
    """A steady motion: rows of `CYCLE`, extremes and sums, and its period in cycles, if any."""

    rows: np.ndarray
    extremes: phases.Seen
    period: int | None

    def same(self, motion: CycleMotion) -> bool:
        """Return whether two motions that repeat are the same."""
        if self.period is None or self.period != motion.period:
            return False
        return abs(self.rows["r"].min() - motion.rows["r"].min()) < 1e-8

    def passes(self, r: float, p_r: float) -> bool:
        """Return whether a motion comes near a state, in r and P_r, as a manual phase begins."""
        distance = np.maximum(abs(self.rows["r"] - r), abs(self.rows["p_r"] - p_r))
        return bool((distance < 2e-5).any())


class MotionSearch:
    """The steady motions under one pair of thresholds, and the starts from which a mode stays."""

    def __init__(self, tsc: TscModel, lower: float, upper: float):
        self.motions: list[CycleMotion] = []
        self.stopped: list[tuple[int, float, float]] = []
        self.spent = 0.0
        self._tsc = tsc
        self._system = lower, upper, tsc.constants()
        self._longest = phases.longest_phase(tsc.constants())
        self._repeating = np.empty(0, phases.CYCLE)

    def follow(self, r: float, p_r: float) -> None:
        """Simulate until transients have decayed, and keep the motion if it is new."""
        states = [np.ascontiguousarray(self._repeating[name]) for name in ("r", "p_r")]
        code, r, p_r, samples = phases.settle(
            r, p_r, *self._system, self._longest, self._longest, *states, REPEATED
        )
        self.spent += samples
        if code < 0:
            self.stopped.append((code, r, p_r))
        # In 2,000 cycles a motion that does not repeat comes near all of its own states.
        endless = [motion for motion in self.motions if motion.period is None]
        if code != 0 or any(motion.passes(r, p_r) for motion in endless):
            return
        motion = self._recorded(r, p_r)
        if not any(earlier.same(motion) for earlier in self.motions):
            self.motions.append(motion)
            if motion.period is not None:
                self._repeating = np.concatenate([self._repeating, motion.rows])

    def _recorded(self, r: float, p_r: float) -> CycleMotion:
        """Record a motion from one of its states: a period, or as many cycles as may be."""
        rows, extremes = phases.record(r, p_r, *self._system, FEWEST_CYCLES, self._longest)
        period = _period(rows)
        if period is None:
            affordable = int(phases.EFFORT / extremes.samples * FEWEST_CYCLES)
            cycles = min(MOST_CYCLES, max(FEWEST_CYCLES, affordable))
            rows, extremes = phases.record(r, p_r, *self._system, cycles, self._longest)
            period = _period(rows)
            self.spent += extremes.samples
        if period is not None:
            rows, extremes = phases.record(r, p_r, *self._system, period, self._longest)
        return CycleMotion(rows, extremes, period)

    @property
    def period(self) -> int | None:
        """After how many cycles the motions repeat, if it is the same for all of them."""
        periods = {motion.period for motion in self.motions}
        return periods.pop() if len(periods) == 1 else None

    def stays(self) -> str:
        """Return which mode stays from the first start from which one does, and why."""
        lower, upper, _ = self._system
        code, r, p_r = self.stopped[0]
        settled = self._tsc.value(p_r, self._tsc.human.performance(min(max(r, 0.0), 1.0)))
        if code == -1:
            return (
                f"stays manual: TSC settles at {settled:.4f} without rising to TSC_u = {upper:.4f}"
            )
        return (
            f"stays autonomous: TSC settles at {settled:.4f} without falling to TSC_l = {lower:.4f}"
        )

    def summary(self) -> str:
        """Return a sentence on what the starts settle to."""
        if len(self.motions) > 1:
            periods = ", ".join(str(motion.period or "without") for motion in self.motions)
            return (
                f"{len(self.motions)} motions coexist, one overshoot apart (periods {periods}); "
                "ranges enclose all of them"
            )
        if self.period:
            return f"repeats after {self.period} cycle(s)"
        return f"does not repeat within {len(self.motions[0].rows)} cycles"


def _period(rows: np.ndarray) -> int | None:
    """Return after how many cycles the recorded motion repeats."""
    r = rows["r"]
    dwell = rows[["manual", "autonomous"]]
    # Of a quick operator r repeats within a few samples, long before P_r does.
    p_r = rows["p_r"]
    for period in range(1, len(rows) // 3 + 1):
        same = abs(r[period] - r[0]) < REPEATED and (dwell[period:] == dwell[:-period]).all()
        change = max(np.abs(x[period:] - x[:-period]).max() for x in (r, p_r)) if same else np.inf
        if change < REPEATED:
            return period
    return None
