"""The steady motion under rule (2.8), sample by sample."""

import itertools
import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from trustlab.allocation.rules import simulate_allocation
from trustlab.models.checks import in_order, of_class
from trustlab.models.compiled import njit
from trustlab.models.display import Result, axes_or_new
from trustlab.models.tsc import (
    TscConstants,
    TscModel,
    advance,
    human_at,
    threshold_mode,
    tsc_at,
)

# Most samples that one model is simulated for: some seconds.
EFFORT = 100_000_000

# Rows of a motion, dwell times by mode last; each has its least and greatest value and its mean.
ROWS = "r", "p_r", "p_h", "tsc", "dwell_autonomous", "dwell_manual"
DWELL = 4
LOW, HIGH, MEAN = range(3)
COLUMNS = [column for row in ROWS for column in (f"{row}_low", f"{row}_high", f"mean_{row}")]
FIELDS = ["lower", "upper", *COLUMNS, "off_beta", "points"]
MOTION = np.dtype(
    [("model", int), ("p_switches", bool), ("p_encloses", bool)]
    + [(name, float) for name in FIELDS]
)

# Time constants of the slower process after which a phase counts as endless: e⁻⁵⁰ is left.
ENDLESS = 50.0

# Time constants that are left to settle, most cycles that are recorded then, and samples to the
# quicker time constant, to which the sample time is stretched: of one pair of thresholds, of many,
# and of many under many models, to be screened.
ALONE, EXACT, SCREEN = (30.0, 300, math.inf), (20.0, 100, math.inf), (7.0, 4, 50.0)

# How near utilization and robot performance must come to where they were for a motion to repeat.
SAME = 1e-9

# From which states motions begin: β where TSC meets TSC_l, and rest.
BOTH = False, True

# Difference of the ranges of utilization from which on two motions count as two.
COEXIST = 1e-3


@njit
def _seen(row, value):
    """Add a value to least, greatest and sum."""
    row[LOW] = min(row[LOW], value)
    row[HIGH] = max(row[HIGH], value)
    row[MEAN] += value


@njit
def steady_motion(c, lower, upper, rested, settle, cycles, most):
    """
    Follow (2.8) in the manual mode from rest, or from β where TSC meets TSC_l, and return the rows
    of its motion.

    After `settle` samples, cycles are recorded until the motion repeats, at most so many; rows are
    NaN where a mode stays for `most` samples.
    """
    r, p_r = c.beta, (lower + c.b_T * human_at(c.beta, c)) / c.a_T
    if rested:
        r, p_r = 0.0, c.p_r_min
    rows = np.zeros((6, 3))
    rows[:, LOW], rows[:, HIGH] = np.inf, -np.inf
    done, dwell, samples = 0, 0, 0
    recorded = -1  # whole cycles; −1 while the motion settles
    first_r, first_p_r = r, p_r  # where the first of them begins
    mode = 1
    while dwell <= most:
        p_h = human_at(r, c)
        tsc = tsc_at(p_r, p_h, c)
        before = mode
        mode = threshold_mode(tsc, lower, upper, mode)
        if mode != before:
            if recorded >= 0:
                _seen(rows[DWELL + before], dwell)
            dwell = 0
            if mode == 1 and done >= settle:
                recorded += 1
                if recorded == 0:
                    first_r, first_p_r = r, p_r
                elif recorded == cycles or max(abs(r - first_r), abs(p_r - first_p_r)) < SAME:
                    rows[:DWELL, MEAN] /= samples
                    rows[DWELL:, MEAN] /= recorded
                    return rows
        if recorded >= 0:
            for row, value in enumerate((r, p_r, p_h, tsc)):
                _seen(rows[row], value)
            samples += 1
        r, p_r = advance(r, p_r, p_h, float(mode), c)
        done += 1
        dwell += 1
    return np.full((6, 3), np.nan)


def slowest(c: TscConstants) -> float:
    """Return the time constant of the slower process, in samples."""
    return -1.0 / math.log(max(c.a_r, c.a_pr))


def longest_phase(c: TscConstants) -> int:
    """Return after how many samples a phase counts as endless."""
    if not ENDLESS * slowest(c) < EFFORT:
        raise ValueError(
            f"the model's time constant of {slowest(c):.3g} samples is too long: 50 of them are "
            f"simulated sample by sample, at most {EFFORT:.0e} samples; describe the model at a "
            "longer sample time (a^m for both a, and b_pr accordingly)"
        )
    return int(ENDLESS * slowest(c)) + 100


def survey(
    models: Iterable[TscModel],
    pairs: np.ndarray | list,
    lengths: tuple[float, int, float] = EXACT,
    weight: float = 1.0,
    starts: tuple[bool, ...] = (False,),
) -> np.ndarray:
    """
    Return the motions of models under pairs of thresholds: a record for each model, pair and start.

    Fields are the number of the `model`, the thresholds, COLUMNS (NaN where a mode stays for ever;
    dwell times in samples), whether the rule keeps switching, `p_switches`, and utilization
    encloses β, `p_encloses`, probabilities once they are averaged over models, `off_beta`, how far
    utilization stays from β, and `points`, mean performance in per cent of its range, (2.39), of
    which `weight` is the robot's.
    """
    settle, cycles, quick = lengths

    def motions() -> Iterator[tuple]:
        for number, tsc in enumerate(models):
            c = tsc.constants()
            times = max(1, int(-1.0 / math.log(min(c.a_r, c.a_pr)) / quick))
            kept = c.a_pr**times
            gain = c.b_pr * ((1.0 - kept) / (1.0 - c.a_pr))
            c = c._replace(a_r=c.a_r**times, a_pr=kept, b_pr=gain)
            follow = settle * slowest(c), cycles, longest_phase(c)
            for pair, rested in itertools.product(np.asarray(pairs).tolist(), starts):
                motion = steady_motion(c, *pair, rested, *follow)
                motion[DWELL:] *= times  # in samples, however long
                (low, high, _), (*_, p_r), (*_, p_h) = motion[:3].tolist()
                robot_points = 100.0 * ((p_r - c.p_r_min) / (c.p_r_max - c.p_r_min))
                human_points = 100.0 * ((p_h - c.p_h_min) / (c.p_h_max - c.p_h_min))
                points = weight * robot_points + (1.0 - weight) * human_points
                verdicts = low <= high, low <= c.beta <= high
                off_beta = max(low - c.beta, c.beta - high)
                yield (number, *verdicts, *pair, *motion.ravel().tolist(), off_beta, points)

    return np.fromiter(motions(), MOTION)


def grid_of_pairs(low: float, high: float, count: int) -> np.ndarray:
    """Return every pair of a grid between two limits, lower below upper."""
    grid = np.linspace(low, high, count)
    return np.column_stack([grid[side] for side in np.triu_indices(count, 1)])


# --- one pair of thresholds -----------------------------------------------------------------------

# Rows of tables of ranges, and how the names of their ends begin.
QUANTITIES = {
    "r": "r",
    "P_r": "p_r",
    "TSC": "tsc",
    "dwell time manual": "dwell_manual",
    "dwell time autonomous": "dwell_autonomous",
}


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
        names = QUANTITIES.values()
        ends = {end: [getattr(self, f"{name}_{end}") for name in names] for end in ("low", "high")}
        return pd.DataFrame(ends, index=pd.Index(QUANTITIES, name="quantity"))


@dataclass(frozen=True, kw_only=True, repr=False)
class LimitCycle(SteadyRanges):
    """
    The steady motion under rule (2.8), its overshoot of the thresholds included.

    Parameters
    ----------
    exists : bool
        Whether the rule keeps switching; where not, ranges are NaN and `reason` says which mode
        stays.
    always : bool
        Whether it does from every start; where not, `reason` says from which it does not.
    encloses_beta : bool
        Whether utilization encloses β, at which the operator performs best, from both starts.
    mean_r, mean_p_r : float
        Long-run averages of utilization and robot performance; from β, where it goes on.
    """

    title = "Limit cycle"

    exists: bool
    always: bool = False
    encloses_beta: bool = False
    mean_r: float = math.nan
    mean_p_r: float = math.nan

    def table(self) -> pd.DataFrame:
        """
        Return ranges and means.

        Returns
        -------
        pandas.DataFrame
            Index `quantity`; columns low, high, mean.
        """
        means = pd.Series({"r": self.mean_r, "P_r": self.mean_p_r})
        return super().table().assign(mean=means)

    def plot(self):
        """
        Plot rule (2.8) over utilization and robot performance, with a run, as in Fig. 2.4.

        Returns
        -------
        matplotlib.axes.Axes
        """
        model = self.model
        axes = axes_or_new(figsize=(7, 4.2))
        r = np.linspace(0.0, 1.0, 300)
        for threshold, label in (
            (self.lower, "manual below $TSC_l$"),
            (self.upper, "autonomous above $TSC_u$"),
        ):
            p_r = (threshold + model.b_T * model.human.performance(r)) / model.a_T
            axes.plot(r, p_r, "--", label=f"{label} = {threshold:g}")
        settled = longest_phase(model.constants())
        run = simulate_allocation(model, self.lower, self.upper, 2 * settled, r0=0.1)
        axes.plot("r", "p_r", data=run.iloc[: settled // 2], lw=0.6, label="from near rest")
        if self.exists:
            last = run.iloc[settled:]
            axes.plot("r", "p_r", data=last, lw=2.5, color="k", label="limit cycle")
        ends = model.robot.p_min, model.robot.p_max
        axes.set(xlabel="utilization r", ylabel="robot performance $P_r$", ylim=ends)
        axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.14), ncols=2)
        return axes


def limit_cycle(tsc: TscModel, lower: float, upper: float) -> LimitCycle:
    """
    Find the limit cycle of rule (2.8).

    The system is simulated, from β and from rest, until transients have decayed, and then until the
    motion repeats, over at most 300 cycles.

    Parameters
    ----------
    tsc : TscModel
        The model.
    lower, upper : float
        Thresholds TSC_l and TSC_u.

    Returns
    -------
    LimitCycle
        With `exists` False where the rule stops switching from both starts, and why.

    Raises
    ------
    ValueError
        If `tsc` is not a `TscModel`, the thresholds are not finite or in the wrong order, or a time
        constant exceeds two million samples.

    Notes
    -----
    Several motions can coexist, some steps of overshoot apart; ranges enclose those reached from
    both starts, and `reason` says so where they differ. Of a motion that never repeats they are
    those of 300 cycles. For every trajectory, whatever its start, there is `invariant_bounds`.

    Examples
    --------
    >>> import trustlab as tl
    >>> cycle = tl.limit_cycle(tl.published_models()["2"], lower=0.0, upper=0.35)
    >>> cycle.exists, round(cycle.mean_p_r, 3)
    (True, 0.325)
    """
    of_class("tsc", tsc, TscModel)
    lower, upper = in_order("lower", lower, "upper", upper)
    both = survey([tsc], [(lower, upper)], ALONE, starts=BOTH)
    going = both[both["p_switches"]]
    endless = endless_phase(tsc, lower, upper)
    ranges: Any = {"model": tsc, "lower": lower, "upper": upper}
    if going.size == 0:
        return LimitCycle(exists=False, reason=endless, **ranges)
    reason = "keeps switching" + (f"; but {endless}" if endless else "")
    if max(np.ptp(going["r_low"]), np.ptp(going["r_high"])) > COEXIST:
        reason += "; from rest it settles to another motion than from β, and ranges enclose both"
    for name in QUANTITIES.values():
        ranges[f"{name}_low"] = float(going[f"{name}_low"].min())
        ranges[f"{name}_high"] = float(going[f"{name}_high"].max())
    return LimitCycle(
        exists=True,
        always=going.size == 2 and not endless,
        reason=reason,
        encloses_beta=bool(both["p_encloses"].all()),
        mean_r=float(going["mean_r"][0]),
        mean_p_r=float(going["mean_p_r"][0]),
        **ranges,
    )


def endless_phase(tsc: TscModel, lower: float, upper: float) -> str:
    """
    Return from where one mode stays for ever under rule (2.8); nothing where none does.

    In the autonomous mode r → 0 and P_r → P_r,min, so that TSC tends to a limit. Where TSC_l lies
    above it, TSC falls to TSC_l from everywhere. Where TSC_l lies at it or below, TSC never does
    from r = 0 and P_r ≥ P_r,min. In the manual mode likewise, with r → 1.
    """
    robot, human = tsc.robot, tsc.human
    slack = 1e-12 / (1.0 - robot.a)  # rounding stalls P_r so near its limit
    rest = float(tsc.value(robot.p_min, human.p_min))
    if lower <= rest + slack:
        return (
            f"from rest (r = 0) the mode stays autonomous: TSC settles at {rest:.6g} without "
            f"falling to TSC_l = {lower:.6g}"
        )
    # Rounding stalls r below 1 by about 2⁻⁵²/b_r, where (2.6) can be far above its value at 1.
    ends = [float(human.performance(r)) for r in (1.0, max(1.0 - 2.0**-52 / human.b, human.beta))]
    load, stalled = (float(tsc.value(robot.steady_state(1.0, p_h), p_h)) for p_h in ends)
    if upper >= load - slack:
        return (
            f"from full load (r = 1) the mode stays manual: TSC settles at {load:.6g} without "
            f"rising to TSC_u = {upper:.6g}"
        )
    if upper >= stalled - slack:
        return (
            f"the mode may stay manual: as r tends to 1, TSC passes {stalled:.6g} only within "
            f"rounding, and TSC_u = {upper:.6g} is above"
        )
    return ""
