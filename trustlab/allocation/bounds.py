"""Steady-state bounds exactly as printed, (2.14)-(2.21) and (2.33)."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from trustlab.allocation.limits import check_thresholds, step_bounds
from trustlab.allocation.rules import simulate_allocation
from trustlab.allocation.steady import SteadyRanges, limit_cycle, longest_phase
from trustlab.models.checks import between
from trustlab.models.display import axes_or_new
from trustlab.models.tsc import TscConstants, TscModel


@dataclass(frozen=True, kw_only=True, repr=False)
class SteadyStateBounds(SteadyRanges):
    """
    The dissertation's bounds on the switched system in steady state.

    TSC is bounded by TSC_l − δ_TSC and TSC_u + δ_TSC (2.14), robot performance by P_rl and P_ru
    (2.15), utilization by r_l and r_u (2.33). Dwell times in the manual mode lie between τ_dml
    (2.20) and τ_dmu (2.21), infinite where P_ru cannot be reached; in the autonomous mode they are
    at most τ_da (2.16), infinite where P_rl is P_r,min; all in samples.

    The bounds on utilization do not hold in general. For the upper one the text inserts the longest
    autonomous dwell time where the shortest would be needed; for the lower one the shortest manual
    dwell time from P_rl to P_ru, where actual swings are narrower and phases shorter. `limit_cycle`
    and `invariant_bounds` give values and bounds that hold.

    Parameters
    ----------
    delta_tsc : float
        δ_TSC that was used.
    """

    title = "Bounds as printed"

    delta_tsc: float

    def plot(self):
        """
        Plot dwell times and utilization in steady state at 10 Hz, as in Figs. 2.5, 2.6 and 2.7.

        Returns
        -------
        numpy.ndarray of matplotlib.axes.Axes, shape (2,)
        """
        axes = axes_or_new(columns=2, figsize=(8.0, 3.6))
        robot, human = self.model.robot, self.model.human
        steps = np.arange(8.0 * robot.time_constant)
        best, worst = (robot.steady_state(1.0, p_h) for p_h in (human.p_max, human.p_min))
        short, long = self.dwell_manual
        for start, goal, dwell, label in (
            (self.p_r_high, robot.p_min, self.dwell_autonomous_high, r"autonomous, $\tau_{da}$"),
            (self.p_r_low, best, short, r"manual, greatest $P_h$, $\tau_{dml}$"),
            (self.p_r_low, worst, long, r"manual, least $P_h$, $\tau_{dmu}$"),
        ):
            curve = goal + (start - goal) * robot.a**steps
            axes[0].plot(0.1 * steps, curve, "o-", markevery=steps == dwell, label=label)
        settled = longest_phase(self.model.constants())
        run = simulate_allocation(self.model, self.lower, self.upper, settled + 4000, r0=0.1)
        axes[1].plot(0.1 * np.arange(4000), run["r"].iloc[settled:], label="r under (2.8)")
        axes[1].axhline(human.beta, color="k", ls=":", lw=0.8, label="β")
        for axis, bounds, name in (
            (axes[0], (self.p_r_low, self.p_r_high), "robot performance $P_r$"),
            (axes[1], (self.r_low, self.r_high), "utilization r"),
        ):
            for bound in bounds:
                axis.axhline(bound, color="0.5", ls="--", lw=0.8)
            axis.set(xlabel="time [s]", ylabel=name)
            axis.legend(fontsize="small")
        return axes


class PerformanceRange(NamedTuple):
    """
    P_rl and P_ru (2.15), and the dwell times between them (2.16), (2.20) and (2.21), in samples.
    """

    p_r_low: np.ndarray
    p_r_high: np.ndarray
    dwell_autonomous_high: np.ndarray
    dwell_manual_low: np.ndarray
    dwell_manual_high: np.ndarray


def _dwell(numerator, denominator, a):
    """Return ⌊ln(numerator/denominator)/ln a⌋, infinite where the target is never reached."""
    reached = numerator > 0.0
    steps = np.floor(np.log(np.where(reached, numerator, 1.0) / denominator) / np.log(a))
    return np.where(reached, steps, np.inf)


def performance_as_printed(
    c: TscConstants, lower: float, upper: float, delta_tsc: float, rise: float | None = None
) -> PerformanceRange:
    """
    Evaluate (2.14)-(2.16), (2.20) and (2.21); the constants and arguments may be arrays.

    `rise` is c of (2.20), how far robot performance rises above P_r,min under the operator's best
    performance: P_r,max − P_r,min unless given, or b_pr P_h,max/(1 − a_pr) for a printed, rounded
    b_pr.
    """
    p_low = np.maximum((lower - delta_tsc + c.b_T * c.p_h_min) / c.a_T, c.p_r_min)
    p_high = np.minimum((upper + delta_tsc + c.b_T * c.p_h_max) / c.a_T, c.p_r_max)
    # P_r,max itself where it is the goal: P_r,min + (P_r,max − P_r,min) can round above it, which
    # would make an endless dwell time finite.
    best = c.p_r_max if rise is None else c.p_r_min + rise
    worst = c.p_r_min + c.p_h_min * (c.p_r_max - c.p_r_min if rise is None else rise) / c.p_h_max
    with np.errstate(all="ignore"):  # impossible constants give NaN, which the caller sees
        return PerformanceRange(
            p_low,
            p_high,
            _dwell(p_low - c.p_r_min, p_high - c.p_r_min, c.a_pr),
            _dwell(best - p_high, best - p_low, c.a_pr),
            _dwell(worst - p_high, worst - p_low, c.a_pr),
        )


def utilization_as_printed(a, dwell_manual_low, dwell_manual_high, dwell_autonomous):
    """Evaluate (2.33), NaN where both dwell times are 0; takes numbers or arrays."""
    a = np.asarray(a, dtype=float)  # a number's own power refuses what an array's gives as NaN
    low = a**dwell_manual_low
    high = a**dwell_manual_high
    rest = a**dwell_autonomous
    with np.errstate(all="ignore"):
        r_low = np.where(low * rest < 1.0, (1.0 - low) * rest / (1.0 - low * rest), np.nan)
        r_high = np.where(high * rest < 1.0, (1.0 - high) / (1.0 - high * rest), np.nan)
    return r_low, r_high


def steady_state_bounds(
    tsc: TscModel, lower: float, upper: float, delta_tsc: float | None = None
) -> SteadyStateBounds:
    """
    Return the steady-state bounds as printed, (2.14)-(2.16), (2.20), (2.21) and (2.33).

    Parameters
    ----------
    tsc : TscModel
        The model.
    lower, upper : float
        Thresholds TSC_l and TSC_u.
    delta_tsc : float, optional
        δ_TSC, largest one-step change of TSC; from the model over the utilizations
        of its limit cycle when not given.

    Returns
    -------
    SteadyStateBounds

    Raises
    ------
    ValueError
        If the thresholds are in the wrong order or outside the limits of Theorem 1 at δ_Ph = 0
        (which are quoted), δ_TSC is negative, above 2 or not finite, or the thresholds leave no
        range of robot performance.

    Notes
    -----
    Saeidi, *Trust-based control of (semi)autonomous mobile robotic systems*, Sections 2.3.1-2.3.3.

    Examples
    --------
    >>> import trustlab as tl
    >>> tl.steady_state_bounds(tl.published_models()["2"], lower=0.0, upper=0.35).table().round(3)
                               low     high
    quantity
    r                        0.612    0.819
    P_r                      0.278    0.336
    TSC                     -0.007    0.357
    dwell time manual      353.000  701.000
    dwell time autonomous      NaN  195.000
    """
    lower, upper = check_thresholds(tsc, (lower, upper))
    if delta_tsc is None:
        cycle = limit_cycle(tsc, lower, upper)
        visited = (cycle.r_low, cycle.r_high) if cycle.exists else ()
        delta_tsc = step_bounds(tsc, *visited).delta_tsc
    delta_tsc = between("delta_tsc", delta_tsc, 0.0, 2.0)  # TSC lies in [−1, 1]
    robot = tsc.robot
    bounds = performance_as_printed(tsc.constants(), lower, upper, delta_tsc)
    if not bounds.p_r_low < bounds.p_r_high:
        raise ValueError(
            f"the thresholds ({lower:g}, {upper:g}) leave no range of robot performance: (2.15) "
            f"gives P_rl = {bounds.p_r_low:.4g} and P_ru = {bounds.p_r_high:.4g} within "
            f"[{robot.p_min}, {robot.p_max}]; move them towards each other's middle"
        )
    dwells = bounds.dwell_manual_low, bounds.dwell_manual_high, bounds.dwell_autonomous_high
    r_low, r_high = utilization_as_printed(tsc.human.a, *dwells)
    return SteadyStateBounds(
        model=tsc,
        lower=lower,
        upper=upper,
        reason=f"δ_TSC = {delta_tsc:.3g}",
        delta_tsc=delta_tsc,
        r_low=float(r_low),
        r_high=float(r_high),
        tsc_low=lower - delta_tsc,
        tsc_high=upper + delta_tsc,
        **{name: float(value) for name, value in bounds._asdict().items()},
    )
