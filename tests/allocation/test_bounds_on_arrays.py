"""
(2.2), (2.3), (2.9)-(2.21) and (2.33) on arrays of parameters, as the audit evaluates them.

Oracle: the equations written out here a second time, without the package.
"""

import numpy as np
import pytest

from trustlab.allocation.bounds import performance_as_printed, utilization_as_printed
from trustlab.allocation.limits import limits_as_printed
from trustlab.models.tsc import TscConstants, performance_weights


def gains(v):
    scale = v["P_r_max"] * v["P_h_max"] - v["P_r_min"] * v["P_h_min"]
    return (v["P_h_max"] + v["P_h_min"]) / scale, (v["P_r_max"] + v["P_r_min"]) / scale


def limits(v):
    """TSC_lb and TSC_ub, (2.9)-(2.10)."""
    a_t, b_t = gains(v)
    slack = b_t * v["delta_P_h"] / (1.0 - v["a_pr"])
    slope = a_t * v["b_pr"] / (1.0 - v["a_pr"]) - b_t
    lower = a_t * v["P_r_min"] + slack - b_t * v["P_h_min"]
    upper = a_t * v["P_r_min"] - slack + np.minimum(slope * v["P_h_max"], slope * v["P_h_min"])
    return lower, upper


def dwell(start, end, a):
    """⌊ln(end/start)/ln a⌋, infinite where the end is never reached."""
    with np.errstate(all="ignore"):
        steps = np.floor(np.log(np.where(end > 0.0, end, 1.0) / start) / np.log(a))
    return np.where(end > 0.0, steps, np.inf)


def bounds(v, c):
    """P_rl, P_ru (2.15), r_l and r_u (2.33) at a given c of (2.20)."""
    a_t, b_t = gains(v)
    low = np.maximum((v["TSC_l"] - v["delta_TSC"] + b_t * v["P_h_min"]) / a_t, v["P_r_min"])
    high = np.minimum((v["TSC_u"] + v["delta_TSC"] + b_t * v["P_h_max"]) / a_t, v["P_r_max"])
    rest = dwell(high - v["P_r_min"], low - v["P_r_min"], v["a_pr"])
    quick, slow = (
        dwell(v["P_r_min"] + rise - low, v["P_r_min"] + rise - high, v["a_pr"])
        for rise in (c, c * v["P_h_min"] / v["P_h_max"])
    )
    a = v["a_r"]
    with np.errstate(all="ignore"):
        r_low = (1.0 - a**quick) * a**rest / (1.0 - a ** (quick + rest))
        r_high = (1.0 - a**slow) / (1.0 - a ** (slow + rest))
    return low, high, r_low, r_high


@pytest.fixture(scope="module")
def parameters():
    """Random parameters about those of Table 2.1, with slopes of (2.10) of both signs."""
    rng = np.random.default_rng(4)
    ranges = {
        "P_r_min": (0.2, 0.25),
        "P_r_max": (0.3, 0.45),
        "P_h_min": (0.3, 0.38),
        "P_h_max": (0.39, 0.47),
        "a_pr": (0.99, 0.999),
        "a_r": (0.99, 0.9995),
        "b_pr": (2e-4, 3e-3),
        "delta_P_h": (0.0, 2e-4),
        "delta_TSC": (0.0, 0.01),
        "TSC_l": (-0.2, 0.05),
        "TSC_u": (0.1, 0.3),
    }
    return {name: rng.uniform(*ends, 5000) for name, ends in ranges.items()}


def constants(v):
    a_T, b_T = performance_weights(v["P_r_min"], v["P_r_max"], v["P_h_min"], v["P_h_max"])
    return TscConstants(
        a_r=v["a_r"],
        beta=np.nan,
        p_h_min=v["P_h_min"],
        p_h_max=v["P_h_max"],
        a_pr=v["a_pr"],
        b_pr=v["b_pr"],
        p_r_min=v["P_r_min"],
        p_r_max=v["P_r_max"],
        a_T=a_T,
        b_T=b_T,
    )


def test_limits_are_the_equations(parameters):
    found = limits_as_printed(constants(parameters), parameters["delta_P_h"])
    np.testing.assert_allclose(found, limits(parameters), rtol=1e-9, atol=1e-12)
    a_t, b_t = gains(parameters)
    slope = a_t * parameters["b_pr"] / (1.0 - parameters["a_pr"]) - b_t
    assert (slope > 0.0).any()
    assert (slope < 0.0).any()


@pytest.mark.parametrize("with_gain", [False, True])
def test_bounds_are_the_equations(parameters, with_gain):
    v = parameters
    rise = v["b_pr"] * v["P_h_max"] / (1.0 - v["a_pr"]) if with_gain else None
    p = performance_as_printed(constants(v), v["TSC_l"], v["TSC_u"], v["delta_TSC"], rise)
    r = utilization_as_printed(
        v["a_r"], p.dwell_manual_low, p.dwell_manual_high, p.dwell_autonomous_high
    )
    expected = bounds(v, rise if with_gain else v["P_r_max"] - v["P_r_min"])
    for ours, theirs in zip((p.p_r_low, p.p_r_high, *r), expected, strict=True):
        close = np.isclose(ours, theirs, rtol=1e-9, atol=1e-12, equal_nan=True)
        # A dwell time is rounded down, so that the last bit of its logarithm may decide; never for
        # more than a handful.
        assert close.mean() > 0.998
    assert (p.p_r_low < p.p_r_high).mean() > 0.9


def test_an_endless_dwell_time_stays_endless(parameters):
    """
    P_ru clipped to P_r,max is never reached, whatever P_r,min + (P_r,max − P_r,min) rounds to.
    """
    v = parameters
    p = performance_as_printed(constants(v), v["TSC_l"], np.full(5000, 0.99), v["delta_TSC"])
    assert (p.p_r_high == v["P_r_max"]).all()
    assert np.isinf(p.dwell_manual_low).all()
