"""Errors of the allocation room say what to do."""

import numpy as np
import pytest

import trustlab as tl
from tests import cases
from trustlab.allocation import step_bounds


def test_thresholds_assigned_while_a_rule_runs_are_checked():
    rule = tl.ThresholdRule(0.0, 0.3)
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
        tl.ThresholdRule(0.0, 0.3).step(tsc=0.5, p_r=np.nan)
    with pytest.raises(ValueError, match=r"tsc .unused.*finite, got nan"):
        tl.PerformanceRule(0.2, 0.4).step(p_r=0.3, tsc=np.nan)


def test_wrong_models_are_told_how_to_make_one():
    model = cases.model()
    for function in (tl.threshold_limits, step_bounds, tl.choose_thresholds):
        with pytest.raises(ValueError, match=r"tsc must be of class TscModel.*fit_tsc"):
            function(model.robot)


def test_a_huge_step_has_no_bounds():
    with pytest.raises(ValueError, match=r"delta_tsc must lie in \[0, 2\], got 5"):
        tl.steady_state_bounds(cases.model(), 0.0, 0.3, delta_tsc=5.0)
