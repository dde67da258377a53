"""Steady-state bounds exactly as printed, (2.14)-(2.21) and (2.33)."""

from __future__ import annotations

import math
from dataclasses import dataclass

from trustlab.allocation.limit_cycle import limit_cycle
from trustlab.allocation.limits import check_thresholds, threshold_limits
from trustlab.allocation.step_bounds import step_bounds
from trustlab.models.checks import finite_number, open_unit
from trustlab.models.tsc import TscModel

__all__ = ["SteadyStateBounds", "steady_state_bounds", "utilization_bounds"]


@dataclass(frozen=True)
class SteadyStateBounds:
    """
    The dissertation's bounds on the switched system in steady state.

    The bounds on utilization do not hold in general. For the upper one the text inserts the longest autonomous dwell
    time where the shortest would be needed; for the lower one the shortest manual dwell time from P_rl to P_ru, where
    actual swings are narrower and phases shorter. `limit_cycle` and `invariant_bounds` give values and bounds that hold.

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

    def _repr_html_(self) -> str:
        return f"<p>Bounds as printed, δ_TSC = {self.delta_tsc:.3g}</p>{self.table().to_html(float_format='%.4g')}"

    def __repr__(self) -> str:
        return (
            f"SteadyStateBounds(r {self.r_low:.4g} to {self.r_high:.4g}, P_r {self.p_r_low:.4g} to {self.p_r_high:.4g}, "
            f"TSC {self.tsc_low:.4g} to {self.tsc_high:.4g}, delta_tsc={self.delta_tsc:.3g})"
        )

    def table(self):
        """
        Return the bounds as a table.

        Returns
        -------
        pandas.DataFrame
            Index `quantity` (P_r, r, TSC, dwell time manual, dwell time autonomous); columns low, high.
        """
        import pandas as pd

        rows = {
            "TSC": (self.tsc_low, self.tsc_high),
            "P_r": (self.p_r_low, self.p_r_high),
            "r": (self.r_low, self.r_high),
            "dwell time manual": (self.dwell_manual_low, self.dwell_manual_high),
            "dwell time autonomous": (math.nan, self.dwell_autonomous),
        }
        return pd.DataFrame.from_dict(rows, orient="index", columns=["low", "high"]).rename_axis("quantity")


def _dwell(numerator: float, denominator: float, a: float) -> float:
    """Return ⌊ln(numerator/denominator)/ln a⌋, infinite where the target is never reached."""
    return (
        math.inf if numerator <= 0.0 else float(math.floor(math.log(numerator / denominator) / math.log(a)))
    )


def utilization_bounds(a: float, dwell_manual_low: float, dwell_manual_high: float, dwell_autonomous: float):
    """
    Return r_l and r_u of (2.33), with their limits where a dwell time is infinite.

    r_l = (1 − a^τ_dml) a^τ_da/(1 − a^(τ_dml + τ_da)), r_u = (1 − a^τ_dmu)/(1 − a^(τ_dmu + τ_da)).

    Parameters
    ----------
    a : float
        a_r of (2.5).
    dwell_manual_low, dwell_manual_high, dwell_autonomous : float
        τ_dml, τ_dmu and τ_da, in samples; may be infinite.

    Returns
    -------
    r_low, r_high : float
        NaN where both dwell times are 0.

    Raises
    ------
    ValueError
        If a is outside (0, 1), or a dwell time is negative or not a number.
    """
    a = open_unit("a", a)
    dwells = []
    for name, dwell in (
        ("dwell_manual_low", dwell_manual_low),
        ("dwell_manual_high", dwell_manual_high),
        ("dwell_autonomous", dwell_autonomous),
    ):
        endless = isinstance(dwell, float) and dwell == math.inf
        dwells.append(math.inf if endless else finite_number(name, dwell))
        if dwells[-1] < 0.0:
            raise ValueError(f"{name} is a number of samples and cannot be negative, got {dwell}")
    low, high, rest = (a**dwell for dwell in dwells)
    r_low = (1.0 - low) * rest / (1.0 - low * rest) if low * rest < 1.0 else math.nan
    r_high = (1.0 - high) / (1.0 - high * rest) if high * rest < 1.0 else math.nan
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
        If the thresholds are in the wrong order or outside the limits of Theorem 1 at δ_Ph = 0 (which are quoted), δ_TSC
        is negative, above 2 or not finite, or the thresholds leave no range of robot performance.

    Notes
    -----
    Saeidi, *Trust-based control of (semi)autonomous mobile robotic systems*, Sections 2.3.1-2.3.3.
    """
    lower, upper = check_thresholds(tsc, lower, upper, threshold_limits(tsc, 0.0))
    if delta_tsc is None:
        cycle = limit_cycle(tsc, lower, upper, starts=1)
        delta_tsc = (
            step_bounds(tsc, cycle.r_low, cycle.r_high) if cycle.exists else step_bounds(tsc)
        ).delta_tsc
    delta_tsc = finite_number("delta_tsc", delta_tsc)
    if delta_tsc < 0.0:
        raise ValueError(f"delta_tsc is a largest change and cannot be negative, got {delta_tsc}")
    if delta_tsc > 2.0:
        raise ValueError(f"delta_tsc cannot exceed 2, as TSC lies in [-1, 1]; got {delta_tsc:g}")
    robot, human = tsc.robot, tsc.human
    tsc_low, tsc_high = lower - delta_tsc, upper + delta_tsc
    p_low = max((tsc_low + tsc.b_T * human.p_min) / tsc.a_T, robot.p_min)
    p_high = min((tsc_high + tsc.b_T * human.p_max) / tsc.a_T, robot.p_max)
    if not p_low < p_high:
        raise ValueError(
            f"the thresholds ({lower:g}, {upper:g}) leave no range of robot performance: (2.15) gives P_rl = {p_low:.4g} "
            f"and P_ru = {p_high:.4g} within [{robot.p_min}, {robot.p_max}]; move them towards each other's middle"
        )
    best, worst = robot.p_max, robot.p_min + human.p_min * (robot.p_max - robot.p_min) / human.p_max
    autonomous = _dwell(p_low - robot.p_min, p_high - robot.p_min, robot.a)
    manual_low = _dwell(best - p_high, best - p_low, robot.a)
    manual_high = _dwell(worst - p_high, worst - p_low, robot.a)
    r_low, r_high = utilization_bounds(human.a, manual_low, manual_high, autonomous)
    return SteadyStateBounds(
        tsc_low, tsc_high, p_low, p_high, autonomous, manual_low, manual_high, r_low, r_high, delta_tsc
    )
