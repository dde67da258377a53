"""
Whatever is put into an argument of the allocation room, a ValueError comes out or a sound answer,
never a bare error.
"""

import numpy as np
import pandas as pd
import pytest

import trustlab as tl
from tests.arguments import faults
from trustlab.allocation import (
    PerformanceRule,
    ThresholdRule,
    choose_thresholds,
    estimate_thresholds,
    followed_suggestions,
    relative_performance,
    simulate_allocation,
    steady_state_bounds,
    step_bounds,
    threshold_limits,
)
from trustlab.allocation.limits import check_thresholds
from trustlab.allocation.threshold_estimate import separation

NEVER = (np.nan, np.inf, "x", b"x", True, [], {}, object(), 1j, np.array(["a"]), tl)
"""What no argument of these takes."""

PERHAPS = (
    None,
    -np.inf,
    -1,
    0,
    2.5,
    1e300,
    10**400,
    (1, 2),
    np.array([1.0, np.nan]),
    np.array(3),
    [[1.0]],
    1e-320,
)
"""What some take; nothing but an answer or a ValueError may come out."""

MODEL = tl.TscModel(tl.RobotModel(0.98, 0.24, 0.39, 0.46), tl.HumanModel(0.99, 0.74, 0.391, 0.46))
LIMITS = threshold_limits(MODEL, 0.0)
FRAME = pd.DataFrame(
    {
        "mode": np.repeat([1.0, 0.0] * 4, 10),
        "suggested_mode": np.repeat([0.0, 1.0] * 4, 10),
        "tsc": np.sin(np.arange(80.0)),
        "p_r": 0.3,
        "p_h": 0.4,
    },
    index=pd.Index(np.arange(80) / 10, name="t"),
)
SESSION = tl.Session(FRAME, tl.Metadata(synthetic=True))
BARE = tl.Session(FRAME[["mode", "p_r", "p_h"]], tl.Metadata(synthetic=True))
PAIR = {"lower": 0.0, "upper": 0.3}

CALLS = {
    "threshold_limits": (threshold_limits, {"tsc": MODEL, "delta_p_h": 1e-4}),
    "ThresholdLimits.contains": (LIMITS.contains, dict(PAIR)),
    "check_thresholds": (check_thresholds, {"tsc": MODEL, **PAIR, "limits": LIMITS}),
    "step_bounds": (step_bounds, {"tsc": MODEL, "r_low": 0.1, "r_high": 0.9}),
    "steady_state_bounds": (steady_state_bounds, {"tsc": MODEL, **PAIR, "delta_tsc": 0.01}),
    "simulate_allocation": (
        simulate_allocation,
        {"tsc": MODEL, **PAIR, "steps": 50, "r0": 0.2, "p_r0": 0.3, "mode": 1},
    ),
    "choose_thresholds": (
        choose_thresholds,
        {"tsc": MODEL, "delta_p_h": 0.0, "margin": 0.2, "points": 4},
    ),
    "ThresholdRule": (ThresholdRule, {**PAIR, "mode": 1}),
    "ThresholdRule.step": (ThresholdRule(0.0, 0.3).step, {"tsc": 0.1, "p_r": 0.3}),
    "ThresholdRule.move": (ThresholdRule(0.0, 0.3).move, dict(PAIR)),
    "PerformanceRule": (PerformanceRule, {"p_min": 0.2, "p_max": 0.4, "tolerance": 0.05}),
    "PerformanceRule.step": (PerformanceRule(0.2, 0.4).step, {"p_r": 0.3, "tsc": 0.1}),
    "estimate_thresholds": (
        estimate_thresholds,
        {
            "sessions": SESSION,
            "model": MODEL,
            "within": 0.15,
            "resamples": 100,
            "seed": 0,
            "after": 1.0,
        },
    ),
    "estimate_thresholds, worked out": (estimate_thresholds, {"sessions": [BARE], "model": MODEL}),
    "separation": (
        separation,
        {"lower_mean": 0.0, "lower_sd": 0.1, "upper_mean": 0.4, "upper_sd": 0.1},
    ),
    "followed_suggestions": (followed_suggestions, {"session": SESSION, "deadline": 15.0}),
    "relative_performance": (relative_performance, {"p_r": 0.3, "p_min": 0.2, "p_max": 0.4}),
}


@pytest.mark.parametrize("name", CALLS)
def test_the_good_call_is_good(name):
    call, good = CALLS[name]
    call(**good)


@pytest.mark.parametrize("name", CALLS)
def test_what_is_never_good_is_refused(name):
    assert not faults(*CALLS[name], NEVER, never=True)


@pytest.mark.parametrize("name", CALLS)
def test_nothing_but_an_answer_or_a_clear_error(name):
    assert not faults(*CALLS[name], PERHAPS)


def test_the_walk_finds_what_is_wrong():
    def call(x):
        if x == 2:
            raise ValueError("no")
        if x == 3:
            raise ValueError("x must not be 3, which is odd")
        return 1 / x

    assert faults(call, {"x": 1}, (1, 0, 2, 3)) == [
        "x = 0 raises ZeroDivisionError('division by zero')",
        "x = 2 is refused without a reason: ValueError('no')",
    ]
    assert faults(call, {"x": 1}, (1, 3), never=True) == ["x = 1 is taken"]
    assert not faults(call, {"x": 1}, ("a",), free=[("x", str)])


@pytest.mark.parametrize("counts", ["steps", "points", "resamples"])
@pytest.mark.parametrize(
    "value", [np.nan, np.inf, None, "3", True, 10.5, -4, 0, 10**400, 1e300, np.array([4])]
)
def test_counts_are_whole_numbers(counts, value):
    name = {
        "steps": "simulate_allocation",
        "points": "choose_thresholds",
        "resamples": "estimate_thresholds",
    }[counts]
    if (counts, value) == ("points", None):
        pytest.skip("None is the default: as many points as suit a model or a posterior")
    call, good = CALLS[name]
    with pytest.raises(ValueError, match=f"{counts} must be a whole number"):
        call(**good | {counts: value})


def test_thresholds_assigned_while_a_rule_runs_are_checked():
    rule = ThresholdRule(0.0, 0.3)
    rule.step(tsc=0.4)
    for name, value, says in (
        ("lower", 0.5, "below"),
        ("upper", -0.1, "below"),
        ("upper", np.nan, "finite"),
        ("lower", None, "number"),
        ("mode", 2, "from 0 to 1"),
        ("mode", np.nan, "whole"),
        ("treshold", 0.1, "no 'treshold'"),
    ):
        with pytest.raises(ValueError, match=says):
            setattr(rule, name, value)
    with pytest.raises(ValueError, match="below"):
        rule.move(0.6, 0.5)
    assert (rule.lower, rule.upper, rule.mode) == (0.0, 0.3, 0)
    rule.upper = 0.5
    rule.move(0.6, 0.9)
    assert (rule.lower, rule.upper, rule.mode) == (0.6, 0.9, 0)
    assert rule.step(tsc=0.55) == 1


def test_a_nan_in_the_unused_argument_is_seen():
    with pytest.raises(ValueError, match=r"p_r .unused.*finite, got nan, so the mode stays 1"):
        ThresholdRule(0.0, 0.3).step(tsc=0.5, p_r=np.nan)
    with pytest.raises(ValueError, match=r"tsc .unused.*finite, got nan"):
        PerformanceRule(0.2, 0.4).step(p_r=0.3, tsc=np.nan)


def test_wrong_models_are_told_how_to_make_one():
    for name in (
        "threshold_limits",
        "step_bounds",
        "steady_state_bounds",
        "simulate_allocation",
        "choose_thresholds",
    ):
        call, good = CALLS[name]
        for wrong in (MODEL.robot, "x", None):
            with pytest.raises(ValueError, match=r"tsc must be of class TscModel.*fit_tsc"):
                call(**good | {"tsc": wrong})


def test_a_huge_step_has_no_bounds():
    with pytest.raises(ValueError, match=r"delta_tsc must lie in \[0, 2\], got 5"):
        steady_state_bounds(MODEL, 0.0, 0.3, delta_tsc=5.0)
