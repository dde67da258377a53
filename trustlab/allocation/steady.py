"""The steady motion under rule (2.8), sample by sample."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd

from trustlab.models.checks import in_order, of_class
from trustlab.models.compiled import njit
from trustlab.models.display import Result, axes_or_new
from trustlab.models.tsc import TscConstants, TscModel, advance, human_at, tsc_at

# Most samples that one model is simulated for: some seconds.
EFFORT = 100_000_000

# Rows of a motion; each has its least and greatest value and its mean.
R, P_R, P_H, TSC, AUTONOMOUS, MANUAL = range(6)
LOW, HIGH, MEAN = range(3)

# Time constants of the slower process after which a phase counts as endless: e⁻⁵⁰ is left.
ENDLESS = 50.0

# Time constants that are left to settle, and cycles that are recorded then: of one pair of
# thresholds, of many, and of many under many models, to be screened.
ALONE = 30.0, 300
EXACT = 20.0, 100
SCREEN = 7.0, 4

# Samples per time constant of the quicker process that screening keeps.
QUICK = 50

# Difference of the ranges of utilization from which on two motions count as two.
COEXIST = 1e-3


@njit
def _seen(row, value):
    """Add a value to least, greatest and sum."""
    row[LOW] = min(row[LOW], value)
    row[HIGH] = max(row[HIGH], value)
    row[MEAN] += value


@njit
def steady_motion(c, lower, upper, rested, settle, cycles, most, rows):
    """
    Follow (2.8) in the manual mode from rest, or from β where TSC meets TSC_l, and fill the rows of
    its motion.

    After `settle` samples, as many `cycles` are recorded; rows are NaN where a mode stays for
    `most` samples.
    """
    r, p_r = c.beta, (lower + c.b_T * human_at(c.beta, c)) / c.a_T
    if rested:
        r, p_r = 0.0, c.p_r_min
    rows[:, LOW], rows[:, HIGH] = np.inf, -np.inf
    rows[:, MEAN] = 0.0
    done = 0
    samples = 0
    recorded = 0
    while recorded < cycles:
        recording = done >= settle
        for mode in (1, 0):
            dwell = 0
            while True:
                p_h = human_at(r, c)
                tsc = tsc_at(p_r, p_h, c)
                # A phase that begins lasts a sample; the run itself may begin beyond TSC_u.
                if (dwell > 0 or done == 0) and (tsc >= upper if mode == 1 else tsc <= lower):
                    break
                if dwell == most:
                    rows[:] = np.nan
                    return
                if recording:
                    _seen(rows[R], r)
                    _seen(rows[P_R], p_r)
                    _seen(rows[P_H], p_h)
                    _seen(rows[TSC], tsc)
                    samples += 1
                r, p_r = advance(r, p_r, p_h, float(mode), c)
                dwell += 1
            done += dwell
            if recording:
                _seen(rows[AUTONOMOUS + mode], dwell)
        recorded += recording
    rows[:AUTONOMOUS, MEAN] /= samples
    rows[AUTONOMOUS:, MEAN] /= recorded


def longest_phase(tsc: TscModel) -> int:
    """Return after how many samples a phase counts as endless."""
    slowest = max(tsc.robot.time_constant, tsc.human.time_constant)
    if not ENDLESS * slowest < EFFORT:
        raise ValueError(
            f"the model's time constant of {slowest:.3g} samples is too long: 50 of them are "
            f"simulated sample by sample, at most {EFFORT:.0e} samples; describe the model at a "
            "longer sample time (a^m for both a, and b_pr accordingly)"
        )
    return int(ENDLESS * slowest) + 100


def coarse(models: list[TscModel]) -> list[TscModel]:
    """Return models at sample times as many times as long as QUICK allows."""
    longer = []
    for tsc in models:
        times = max(1, int(min(tsc.robot.time_constant, tsc.human.time_constant) / QUICK))
        a = tsc.robot.a**times
        robot = replace(tsc.robot, a=a, b=tsc.robot.b * (1.0 - a) / (1.0 - tsc.robot.a))
        longer.append(TscModel(robot, replace(tsc.human, a=tsc.human.a**times)))
    return longer


def survey(
    models: list[TscModel],
    pairs: np.ndarray,
    lengths: tuple[float, int] = EXACT,
    rested: bool = False,
) -> np.ndarray:
    """
    Return the motions of models under pairs of thresholds, shape (models, pairs, 6, 3).

    Rows are r, P_r, P_h, TSC and the dwell times in either mode [samples], columns least, greatest
    and mean; NaN where a mode stays for ever. All begin in the manual mode, at β where TSC meets
    TSC_l, or `rested` at r = 0 and P_r,min. `lengths` are time constants left to settle, and cycles
    recorded.
    """
    motions = np.empty((len(models), len(pairs), 6, 3))
    for tsc, rows in zip(models, motions, strict=True):
        most = longest_phase(tsc)
        settle = lengths[0] * max(tsc.robot.time_constant, tsc.human.time_constant)
        for pair, motion in zip(pairs.tolist(), rows, strict=True):
            steady_motion(tsc.constants(), *pair, rested, settle, lengths[1], most, motion)
    return motions


def from_both_starts(
    models: list[TscModel], pair: tuple[float, float], lengths: tuple[float, int] = EXACT
) -> np.ndarray:
    """Return the motions of models under one pair, from β and from rest: (2, models, 1, 6, 3)."""
    pairs = np.array([pair])
    return np.array([survey(models, pairs, lengths, rested) for rested in (False, True)])


def stacked(models: list[TscModel]) -> TscConstants:
    """Return the constants of models, each an array of shape (models, 1)."""
    return TscConstants(*np.transpose([tsc.constants() for tsc in models])[:, :, None])


def encloses_beta(motions: np.ndarray, models: list[TscModel]) -> np.ndarray:
    """Return whether steady utilization encloses β, by model and pair."""
    beta = stacked(models).beta
    return (motions[..., R, LOW] <= beta) & (beta <= motions[..., R, HIGH])


def points(motions: np.ndarray, models: list[TscModel], weight: float) -> np.ndarray:
    """
    Return weight · robot performance + (1 − weight) · human performance, by model and pair.

    Both are means over the motion, in points of (2.39): per cent of their ranges.
    """
    c = stacked(models)
    of_robot = (motions[..., P_R, MEAN] - c.p_r_min) / (c.p_r_max - c.p_r_min)
    of_human = (motions[..., P_H, MEAN] - c.p_h_min) / (c.p_h_max - c.p_h_min)
    return 100.0 * (weight * of_robot + (1.0 - weight) * of_human)


def grid_of_pairs(low: float, high: float, count: int) -> np.ndarray:
    """Return every pair of a grid between two limits, lower below upper."""
    grid = np.linspace(low, high, count)
    first, second = np.triu_indices(count, 1)
    return np.column_stack([grid[first], grid[second]])


# --- one pair of thresholds -----------------------------------------------------------------------

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
            end: [getattr(self, f"{name}_{end}") for name in QUANTITIES.values()]
            for end in ("low", "high")
        }
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

    title = "Steady cycle"

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
        from trustlab.allocation.simulation import simulate_allocation

        model = self.model
        axes = axes_or_new(figsize=(7, 4.2))
        r = np.linspace(0.0, 1.0, 300)
        for threshold, label in (
            (self.lower, "manual below $TSC_l$"),
            (self.upper, "autonomous above $TSC_u$"),
        ):
            p_r = (threshold + model.b_T * model.human.performance(r)) / model.a_T
            axes.plot(r, p_r, "--", label=f"{label} = {threshold:g}")
        settled = longest_phase(model)
        run = simulate_allocation(model, self.lower, self.upper, 2 * settled, r0=0.1)
        axes.plot("r", "p_r", data=run.iloc[: settled // 2], lw=0.6, label="from near rest")
        if self.exists:
            last = run.iloc[settled:]
            axes.plot("r", "p_r", data=last, lw=2.5, color="k", label="steady cycle")
        ends = model.robot.p_min, model.robot.p_max
        axes.set(xlabel="utilization r", ylabel="robot performance $P_r$", ylim=ends)
        axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.14), ncols=2)
        return axes


def limit_cycle(tsc: TscModel, lower: float, upper: float) -> LimitCycle:
    """
    Find the steady cycle of rule (2.8).

    The system is simulated, from β and from rest, until transients have decayed, and then over 300
    cycles.

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
    motions = from_both_starts([tsc], (lower, upper), ALONE)[:, 0, 0]
    motions = motions[~np.isnan(motions[:, R, LOW])]
    endless = endless_phase(tsc, lower, upper)
    pair: Any = {"model": tsc, "lower": lower, "upper": upper}
    if len(motions) == 0:
        return LimitCycle(exists=False, reason=endless, **pair)
    reason = "keeps switching" + (f"; but {endless}" if endless else "")
    if np.ptp(motions[:, R, :MEAN], axis=0).max() > COEXIST:
        reason += "; from rest it settles to another motion than from β, and ranges enclose both"
    rows = np.column_stack([motions[:, :, LOW].min(axis=0), motions[:, :, HIGH].max(axis=0)])
    return LimitCycle(
        exists=True,
        always=len(motions) == 2 and not endless,
        reason=reason,
        encloses_beta=bool(encloses_beta(motions, [tsc]).all()),
        mean_r=float(motions[0, R, MEAN]),
        mean_p_r=float(motions[0, P_R, MEAN]),
        **pair,
        **ends(
            r=rows[R],
            p_r=rows[P_R],
            tsc=rows[TSC],
            dwell_manual=rows[MANUAL],
            dwell_autonomous=rows[AUTONOMOUS],
        ),
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
