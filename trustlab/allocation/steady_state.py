"""Steady-state bounds exactly as printed, (2.14)-(2.21) and (2.33)."""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from trustlab.allocation.cycle.limit_cycle import limit_cycle
from trustlab.allocation.cycle.phases import longest_phase
from trustlab.allocation.limits import (
    check_thresholds,
    ranges_table,
    ranges_text,
    step_bounds,
    threshold_limits,
)
from trustlab.allocation.simulation import simulate_allocation
from trustlab.models.axes import axes_or_new
from trustlab.models.checks import between
from trustlab.models.html import as_html
from trustlab.models.tsc import TscConstants, TscModel


@dataclass(frozen=True)
class SteadyStateBounds:
    """
    The dissertation's bounds on the switched system in steady state.

    The bounds on utilization do not hold in general. For the upper one the text inserts the longest
    autonomous dwell time where the shortest would be needed; for the lower one the shortest manual
    dwell time from P_rl to P_ru, where actual swings are narrower and phases shorter. `limit_cycle`
    and `invariant_bounds` give values and bounds that hold.

    Parameters
    ----------
    tsc_low, tsc_high : float
        TSC_l − δ_TSC and TSC_u + δ_TSC (2.14).
    p_r_low, p_r_high : float
        P_rl and P_ru (2.15).
    dwell_autonomous : float
        τ_da (2.16), in samples; infinite where P_rl is P_r,min.
    dwell_manual_low, dwell_manual_high : float
        τ_dml (2.20) and τ_dmu (2.21), in samples; infinite where P_ru cannot be reached.
    r_low, r_high : float
        r_l and r_u (2.33).
    delta_tsc : float
        δ_TSC that was used.
    model : TscModel
        The model.
    lower, upper : float
        Thresholds TSC_l and TSC_u.
    """

    tsc_low: float
    tsc_high: float
    p_r_low: float
    p_r_high: float
    dwell_autonomous: float
    dwell_manual_low: float
    dwell_manual_high: float
    r_low: float
    r_high: float
    delta_tsc: float
    model: TscModel | None = None
    lower: float = math.nan
    upper: float = math.nan

    def _repr_html_(self) -> str:
        return as_html(f"Bounds as printed, δ_TSC = {self.delta_tsc:.3g}", self.table())

    def __repr__(self) -> str:
        return f"SteadyStateBounds({ranges_text(self)}, delta_tsc={self.delta_tsc:.3g})"

    def table(self):
        """
        Return the bounds as a table.

        Returns
        -------
        pandas.DataFrame
            Index `quantity` (r, P_r, TSC, dwell time manual, dwell time autonomous); columns low,
            high.
        """
        manual = self.dwell_manual_low, self.dwell_manual_high
        return ranges_table(self, manual, (math.nan, self.dwell_autonomous))

    def plot(self, sample_time: float = 0.1):
        """
        Plot what the dwell times are derived from, and utilization in steady state, as in Figs.
        2.5, 2.6 and 2.7.

        Parameters
        ----------
        sample_time : float
            Time between samples [s].

        Returns
        -------
        numpy.ndarray of matplotlib.axes.Axes, shape (3,)
        """
        robot, human = self.model.robot, self.model.human
        dwells = (self.dwell_autonomous, self.dwell_manual_low, self.dwell_manual_high)
        steps = np.arange(2 * max((d for d in dwells if math.isfinite(d)), default=500.0))
        axes = axes_or_new(columns=3, figsize=(10, 3.4))

        def approach(axis, start, goal, dwell, color, label):
            axis.plot(
                steps * sample_time,
                goal + (start - goal) * robot.a**steps,
                color=color,
                label=label,
            )
            if math.isfinite(dwell):
                axis.axvline(dwell * sample_time, color=color, ls="--")

        approach(
            axes[0], self.p_r_high, robot.p_min, self.dwell_autonomous, "C0", r"$\tau_{da}$ dashed"
        )
        best, least = robot.steady_state(1.0, human.p_max), robot.steady_state(1.0, human.p_min)
        approach(
            axes[1],
            self.p_r_low,
            best,
            self.dwell_manual_low,
            "C0",
            r"greatest $P_h$, $\tau_{dml}$",
        )
        approach(
            axes[1], self.p_r_low, least, self.dwell_manual_high, "C1", r"least $P_h$, $\tau_{dmu}$"
        )
        for axis, title in zip(
            axes, ("autonomous, from $P_{ru}$", "manual, from $P_{rl}$"), strict=False
        ):
            for bound in (self.p_r_low, self.p_r_high):
                axis.axhline(bound, color="0.5", lw=0.8)
            axis.set(xlabel="dwell time [s]", ylabel="robot performance $P_r$", title=title)
        settled = longest_phase(self.model.constants())
        run = simulate_allocation(self.model, self.lower, self.upper, settled + 4000, r0=0.1)
        axes[2].plot(np.arange(4000) * sample_time, run["r"].iloc[settled:], label="r under (2.8)")
        # The bounds are those of two periodic motions, one of each dwell time in the manual mode.
        for bound, manual, low, label in (
            (self.r_low, self.dwell_manual_low, True, r"period $\tau_{dml} + \tau_{da}$, to $r_l$"),
            (
                self.r_high,
                self.dwell_manual_high,
                False,
                r"period $\tau_{dmu} + \tau_{da}$, to $r_u$",
            ),
        ):
            color = "C1" if low else "C2"
            axes[2].axhline(bound, color=color, ls="--", lw=0.8)
            if math.isfinite(manual) and math.isfinite(self.dwell_autonomous):
                mode = np.resize(
                    np.repeat([1.0, 0.0], [int(manual), int(self.dwell_autonomous)]), 4001
                )
                start = bound if low else bound * human.a**self.dwell_autonomous
                r, _ = human.simulate(mode, start)
                axes[2].plot(
                    np.arange(4000) * sample_time, r[:4000], color=color, lw=1, label=label
                )
        axes[2].axhline(human.beta, color="k", ls=":", lw=0.8, label="β")
        axes[2].set(xlabel="time [s]", ylabel="utilization r", title="utilization in steady state")
        for axis in axes:
            axis.legend(fontsize="small")
        return axes


class PerformanceRange(NamedTuple):
    """
    P_rl and P_ru (2.15), and the dwell times between them (2.16), (2.20) and (2.21), in samples.
    """

    p_r_low: np.ndarray
    p_r_high: np.ndarray
    dwell_autonomous: np.ndarray
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
        of its steady cycle when not given.

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
    lower, upper = check_thresholds(tsc, lower, upper, threshold_limits(tsc, 0.0))
    if delta_tsc is None:
        cycle = limit_cycle(tsc, lower, upper, starts=1)
        visited = (cycle.r_low, cycle.r_high) if cycle.exists else ()
        delta_tsc = step_bounds(tsc, *visited).delta_tsc
    delta_tsc = between("delta_tsc", delta_tsc, 0.0, 2.0)  # TSC lies in [−1, 1]
    robot = tsc.robot
    found = performance_as_printed(tsc.constants(), lower, upper, delta_tsc)
    numbers = {name: float(value) for name, value in found._asdict().items()}
    p_low, p_high = numbers["p_r_low"], numbers["p_r_high"]
    if not p_low < p_high:
        raise ValueError(
            f"the thresholds ({lower:g}, {upper:g}) leave no range of robot performance: (2.15) "
            f"gives P_rl = {p_low:.4g} and P_ru = {p_high:.4g} within [{robot.p_min}, "
            f"{robot.p_max}]; move them towards each other's middle"
        )
    dwells = found.dwell_manual_low, found.dwell_manual_high, found.dwell_autonomous
    r_low, r_high = utilization_as_printed(tsc.human.a, *dwells)
    return SteadyStateBounds(
        tsc_low=lower - delta_tsc,
        tsc_high=upper + delta_tsc,
        **numbers,
        r_low=float(r_low),
        r_high=float(r_high),
        delta_tsc=delta_tsc,
        model=tsc,
        lower=lower,
        upper=upper,
    )
