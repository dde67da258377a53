"""The steady motion under rule (2.8), sample by sample."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import overload

import numpy as np
import pandas as pd

from trustlab.allocation.limits import check_thresholds
from trustlab.allocation.ranges import QUANTITIES, RangeIntervals, SteadyRanges, over_draws
from trustlab.identification.posterior.result import Posterior
from trustlab.models.compiled import njit
from trustlab.models.display import axes_or_new
from trustlab.models.tsc import TscModel, advance, human_at, tsc_at

# Most samples that one model is simulated for: some seconds.
EFFORT = 100_000_000

# Rows of a motion; each has its least and greatest value and its mean.
R, P_R, P_H, TSC, AUTONOMOUS, MANUAL = range(6)
LOW, HIGH, MEAN = range(3)

# Time constants of the slower process after which a phase counts as endless: e⁻⁵⁰ is left.
ENDLESS = 50.0

# Time constants that are left to settle, and cycles that are recorded then: of one pair of
# thresholds, of many, and of many at a coarse sample time.
ALONE = 30.0, 300
EXACT = 20.0, 100
SCREEN = 7.0, 4

# Difference of the ranges of utilization from which on two motions count as two.
COEXIST = 1e-3

# Samples per time constant of the quicker process, at a coarse sample time.
QUICK = 25


# Numbers are written one by one: assignments to slices take a second longer to compile.
@njit
def _fill(row, low, high, mean):
    row[LOW] = low
    row[HIGH] = high
    row[MEAN] = mean


@njit
def _seen(row, value):
    """Add a value to least, greatest and sum."""
    row[LOW] = min(row[LOW], value)
    row[HIGH] = max(row[HIGH], value)
    row[MEAN] += value


@njit
def steady_motion(c, lower, upper, r, p_r, settle, cycles, most, rows):
    """
    Follow (2.8) from r and P_r in the manual mode, and fill the rows of its motion.

    After `settle` samples, as many `cycles` are recorded. Returns the mode that stays for `most`
    samples (rows are NaN then) or −1, and the r and P_r at the end.
    """
    for row in range(len(rows)):
        _fill(rows[row], np.inf, -np.inf, 0.0)
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
                    for row in range(len(rows)):
                        _fill(rows[row], np.nan, np.nan, np.nan)
                    return mode, r, p_r
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
    for row in range(len(rows)):
        rows[row, MEAN] /= samples if row < AUTONOMOUS else recorded
    return -1, r, p_r


@njit
def _survey(c, pairs, rested, settle, cycles, most, motions):
    """Fill the motion under every pair of thresholds, from β or from rest."""
    p_h = human_at(c.beta, c)
    for j in range(len(pairs)):
        lower, upper = pairs[j]
        r, p_r = c.beta, (lower + c.b_T * p_h) / c.a_T
        if rested:
            r, p_r = 0.0, c.p_r_min
        steady_motion(c, lower, upper, r, p_r, settle, cycles, most, motions[j])


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


def coarse(tsc: TscModel, ratio: float) -> tuple[TscModel, int]:
    """Return a model at a sample time about so many times as long, and how many times it is."""
    quick = min(tsc.robot.time_constant, tsc.human.time_constant)
    whole = max(1, int(min(quick / QUICK, ratio)))
    a = tsc.robot.a**whole
    b = tsc.robot.b * (1.0 - a) / (1.0 - tsc.robot.a)
    return TscModel(replace(tsc.robot, a=a, b=b), replace(tsc.human, a=tsc.human.a**whole)), whole


def survey(
    models: list[TscModel], pairs: np.ndarray, effort: float = np.inf, rested: bool = False
) -> np.ndarray:
    """
    Return the motions of models under pairs of thresholds, shape (models, pairs, 6, 3).

    Rows are r, P_r, P_h, TSC and the dwell times in either mode [samples], columns least, greatest
    and mean; NaN where a mode stays for ever. All begin in the manual mode, at β where TSC meets
    TSC_l, or `rested` at r = 0 and P_r,min. Where models times pairs times the slower time constant
    [samples] exceeds `effort`, the sample time is coarse.
    """
    from tqdm import tqdm

    pairs = np.ascontiguousarray(pairs, dtype=float)
    motions = np.empty((len(models), len(pairs), 6, 3))
    bar = tqdm(models, "steady motions", leave=False, delay=2.0, disable=None)
    for own, of_model in zip(bar, motions, strict=True):
        slow = max(own.robot.time_constant, own.human.time_constant)
        tsc, ratio = coarse(own, len(models) * len(pairs) * slow / effort)
        settling, cycles = SCREEN if ratio > 1 else EXACT
        system = rested, settling * slow / ratio, cycles, longest_phase(tsc)
        _survey(tsc.constants(), pairs, *system, of_model)
        of_model[:, AUTONOMOUS:] *= ratio
    return motions


def encloses_beta(motions: np.ndarray, models: list[TscModel]) -> np.ndarray:
    """Return whether steady utilization encloses β, by model and pair."""
    beta = np.array([tsc.human.beta for tsc in models])[:, None]
    return (motions[:, :, R, LOW] <= beta) & (beta <= motions[:, :, R, HIGH])


def points(motions: np.ndarray, models: list[TscModel], weight: float) -> np.ndarray:
    """
    Return weight · robot performance + (1 − weight) · human performance, by model and pair.

    Both are means over the motion, in points of (2.39): per cent of their ranges.
    """
    rows = [(m.robot.p_min, m.robot.p_max, m.human.p_min, m.human.p_max) for m in models]
    r_min, r_max, h_min, h_max = np.array(rows).T[:, :, None]
    of_robot = (motions[:, :, P_R, MEAN] - r_min) / (r_max - r_min)
    of_human = (motions[:, :, P_H, MEAN] - h_min) / (h_max - h_min)
    return 100.0 * (weight * of_robot + (1.0 - weight) * of_human)


def grid_of_pairs(low: float, high: float, count: int) -> np.ndarray:
    """Return every pair of a grid between two limits, lower below upper."""
    grid = np.linspace(low, high, count)
    first, second = np.triu_indices(count, 1)
    return np.column_stack([grid[first], grid[second]])


# --- one pair of thresholds -----------------------------------------------------------------------


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
    mean_r, mean_p_r, mean_p_h : float
        Long-run averages of utilization, robot and human performance; from β, where it goes on.
    """

    exists: bool
    always: bool = False
    encloses_beta: bool = False
    mean_r: float = math.nan
    mean_p_r: float = math.nan
    mean_p_h: float = math.nan

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

        model, robot = self.model, self.model.robot
        axes = axes_or_new(axes, figsize=(7, 4.2))
        r = np.linspace(0, 1, 300)
        p_r = np.linspace(robot.p_min, robot.p_max, 200)
        p_h = model.human.performance(r)
        value = model.value(p_r[:, None], p_h[None, :])
        levels = axes.contourf(r, p_r, value, np.linspace(-1, 1, 9), cmap="Greys", alpha=0.3)
        axes.figure.colorbar(levels, ax=axes, label="TSC")
        for threshold, label, height in (
            (self.lower, r"below $TSC_l$ = {:g}: manual, $M$ = 1", 0.04),
            (self.upper, r"above $TSC_u$ = {:g}: autonomous, $M$ = 0", 0.93),
        ):
            line = (threshold + model.b_T * p_h) / model.a_T
            (drawn,) = axes.plot(r, line, "--", lw=1.5)
            look = {"color": drawn.get_color(), "weight": "bold", "transform": axes.transAxes}
            axes.text(0.3, height, label.format(threshold), **look)
        settled = longest_phase(model)
        run = simulate_allocation(model, self.lower, self.upper, 2 * settled, r0=0.1)
        first, last = run.iloc[: settled // 2], run.iloc[settled:]
        axes.plot(first["r"], first["p_r"], lw=0.6, color="C2", label="from near rest")
        if self.exists:
            axes.plot(last["r"], last["p_r"], lw=2.5, color="k", label="steady cycle")
        axes.set(xlabel="utilization r", ylabel="robot performance $P_r$", ylim=(p_r[0], p_r[-1]))
        axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.14), ncols=2)
        return axes


@overload
def limit_cycle(tsc: TscModel, lower: float, upper: float) -> LimitCycle: ...


@overload
def limit_cycle(tsc: Posterior, lower: float, upper: float) -> RangeIntervals: ...


def limit_cycle(tsc, lower, upper):
    """
    Find the steady cycle of rule (2.8).

    The system is simulated, from β and from rest, until transients have decayed, and then over 300
    cycles.

    Parameters
    ----------
    tsc : TscModel or Posterior
        The model; or a posterior (`sample_posterior`), of which 200 draws are followed.
    lower, upper : float
        Thresholds TSC_l and TSC_u.

    Returns
    -------
    LimitCycle or, for a posterior, RangeIntervals
        With `exists` False where the rule stops switching from both starts, and why.

    Raises
    ------
    ValueError
        If `tsc` is neither, the thresholds are not finite or in the wrong order, or a time constant
        exceeds two million samples.

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
    if isinstance(tsc, Posterior):
        return over_draws(tsc.models, lambda each: limit_cycle(each, lower, upper), "exists")
    lower, upper = check_thresholds(tsc, lower, upper)
    settling, cycles = ALONE
    settle = settling * max(tsc.robot.time_constant, tsc.human.time_constant)
    best = tsc.human.beta
    at_best = (lower + tsc.b_T * tsc.human.p_max) / tsc.a_T
    motions = []
    stays = ""
    for r, p_r in ((best, at_best), (0.0, tsc.robot.p_min)):
        rows = np.empty((6, 3))
        system = tsc.constants(), lower, upper, r, p_r
        mode, r, p_r = steady_motion(*system, settle, cycles, longest_phase(tsc), rows)
        if mode < 0:
            motions.append(rows)
        else:
            stays = stays or _stays(tsc, lower, upper, mode, r, p_r)
    pair = {"model": tsc, "lower": lower, "upper": upper}
    if not motions:
        return LimitCycle(exists=False, reason=stays, **pair)
    less = f"from one of the starts it {stays}" if stays else endless_phase(tsc, lower, upper)
    reason = "keeps switching" + (f"; but {less}" if less else "")
    low, high = np.min(motions, axis=0)[:, LOW], np.max(motions, axis=0)[:, HIGH]
    if np.ptp([rows[R, :MEAN] for rows in motions], axis=0).max() > COEXIST:
        reason += "; from rest it settles to another motion than from β, and ranges enclose both"
    mean = motions[0][:, MEAN]
    around = all(rows[R, LOW] <= best <= rows[R, HIGH] for rows in motions)
    ranges = {}
    for name, row in zip(QUANTITIES.values(), (R, P_R, TSC, MANUAL, AUTONOMOUS), strict=True):
        ranges |= {f"{name}_low": float(low[row]), f"{name}_high": float(high[row])}
    return LimitCycle(
        exists=True,
        reason=reason,
        always=not less,
        encloses_beta=around,
        mean_r=float(mean[R]),
        mean_p_r=float(mean[P_R]),
        mean_p_h=float(mean[P_H]),
        **pair,
        **ranges,
    )


def _stays(tsc: TscModel, lower: float, upper: float, mode: int, r: float, p_r: float) -> str:
    """Say which mode stays, and why."""
    settled = tsc.value(p_r, tsc.human.performance(min(max(r, 0.0), 1.0)))
    if mode == 1:
        return f"stays manual: TSC settles at {settled:.4f} without rising to TSC_u = {upper:.4f}"
    return f"stays autonomous: TSC settles at {settled:.4f} without falling to TSC_l = {lower:.4f}"


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
