"""Errors of the allocation room say what to do."""

import numpy as np
import pytest

import trustlab as tl


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
