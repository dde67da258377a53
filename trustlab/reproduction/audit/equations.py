"""The equations behind Tables 2.1 and 2.2, as functions of arrays of printed parameters."""

import numpy as np

from trustlab.allocation.bounds import performance_as_printed, utilization_as_printed
from trustlab.allocation.limits import limits_as_printed
from trustlab.models.tsc import TscConstants, gain_of_human_performance, performance_weights

PERFORMANCE = ("P_r_min", "P_r_max", "P_h_min", "P_h_max")
LIMIT_INPUTS = (*PERFORMANCE, "a_pr", "delta_P_h")
RANGE_INPUTS = (*PERFORMANCE, "delta_TSC", "TSC_l", "TSC_u")
RATE_INPUTS = (*PERFORMANCE, "a_pr", "a_r", "delta_TSC", "TSC_l", "TSC_u")


def robot_gain(v: dict) -> np.ndarray:
    """Return b_pr of (2.3) from a_pr, P_r_min, P_r_max and P_h_max."""
    return gain_of_human_performance(v["a_pr"], v["P_r_min"], v["P_r_max"], v["P_h_max"])


def constants(v: dict) -> TscConstants:
    """Return the constants at printed parameters; b_pr of (2.3) where it is not among them."""
    a_T, b_T = performance_weights(*(v[name] for name in PERFORMANCE))
    return TscConstants(
        a_r=v.get("a_r", np.nan),
        beta=np.nan,  # no limit and no bound depends on it
        p_h_min=v["P_h_min"],
        p_h_max=v["P_h_max"],
        a_pr=v["a_pr"],
        b_pr=v.get("b_pr", robot_gain(v)),
        p_r_min=v["P_r_min"],
        p_r_max=v["P_r_max"],
        a_T=a_T,
        b_T=b_T,
    )


def limits(v: dict) -> dict[str, np.ndarray]:
    """Return TSC_lb and TSC_ub, (2.9)-(2.10), and b_pr of (2.3)."""
    lower, upper = limits_as_printed(constants(v), v["delta_P_h"])
    return {"TSC_lb": lower, "TSC_ub": upper, "b_pr": robot_gain(v)}


def bounds(v: dict) -> dict[str, np.ndarray]:
    """
    Return P_rl, P_ru (2.15) and r_l, r_u (2.33).

    With b_pr among the parameters, c of (2.20) is b_pr P_h/(1 − a_pr); P_rl and P_ru need neither
    a_pr nor a_r.
    """
    v = {"a_pr": np.nan, "a_r": np.nan} | v
    rise = v["b_pr"] * v["P_h_max"] / (1.0 - v["a_pr"]) if "b_pr" in v else None
    p = performance_as_printed(constants(v), v["TSC_l"], v["TSC_u"], v["delta_TSC"], rise)
    r = utilization_as_printed(
        v["a_r"], p.dwell_manual_low, p.dwell_manual_high, p.dwell_autonomous_high
    )
    r_low, r_high = (np.where(p.p_r_low < p.p_r_high, x, np.nan) for x in r)
    return {"P_rl": p.p_r_low, "P_ru": p.p_r_high, "r_l": r_low, "r_u": r_high}


def largest_step(v: dict) -> np.ndarray:
    """Return |a_T δ_Pr + b_T δ_Ph| (Remark 3) of the ranges of performance, δ_Pr and δ_Ph."""
    a_T, b_T = performance_weights(*(v[name] for name in PERFORMANCE))
    return np.abs(a_T * v["delta_P_r"] + b_T * v["delta_P_h"])
