"""Rule (2.8) and Algorithm 2, step by step and in the simulation."""

import numpy as np
import pytest
from hypothesis import given, strategies as st

from trustlab.allocation import PerformanceRule, ThresholdRule, simulate_allocation


@given(st.lists(st.floats(-1, 1), min_size=1, max_size=60), st.sampled_from([0, 1]))
def test_threshold_rule_is_the_printed_case_distinction(values, first):
    rule, mode = ThresholdRule(-0.2, 0.3, mode=first), first
    for tsc in values:
        mode = 0 if tsc >= 0.3 else 1 if tsc <= -0.2 else mode
        assert rule.step(tsc=tsc, p_r=0.3) == mode
        assert rule.mode == mode


def test_simulation_is_the_rule_with_the_model(operators):
    model = operators["pilot"]
    run = simulate_allocation(model, 0.02, 0.45, 9000, r0=0.2, p_r0=0.3, mode=0)
    rule, r, p_r = ThresholdRule(0.02, 0.45, mode=0), 0.2, 0.3
    for k in range(9000):
        p_h = model.human.performance(r)
        tsc = model.value(p_r, p_h)
        mode = rule.step(tsc=tsc)
        if k % 250 == 0:
            np.testing.assert_allclose(run.loc[k, ["r", "p_r", "p_h", "tsc"]], [r, p_r, p_h, tsc], atol=1e-12)
            assert run.loc[k, "mode"] == mode
        p_r = model.robot.a * p_r + (1 - model.robot.a) * model.robot.p_min + mode * model.robot.b * p_h
        r = model.human.a * r + model.human.b * mode
    assert run["mode"].nunique() == 2


def test_performance_rule_is_algorithm_2():
    rule = PerformanceRule(p_min=0.24, p_max=0.39, tolerance=0.0)
    assert rule.step(p_r=0.39) == 0
    assert rule.step(p_r=0.3899) is None
    assert rule.step(p_r=0.24 + 0.9 * 0.15) == 1
    assert rule.step(p_r=0.376, tsc=0.1) is None
    assert rule.step(p_r=0.1) == 1
    assert PerformanceRule(0.24, 0.39).step(p_r=0.384) == 0


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_a_rule_driven_with_nan_says_so_and_stays(value):
    rule = ThresholdRule(0.0, 0.4)
    rule.step(tsc=0.5)
    with pytest.raises(ValueError, match="mode stays 0"):
        rule.step(tsc=value)
    assert rule.mode == 0
    with pytest.raises(ValueError, match="finite"):
        PerformanceRule(0.2, 0.4).step(p_r=value)


def test_refuses(operators):
    model = operators["pilot"]
    for wrong, says in (((0.4, 0.0), "below"), ((0.0, float("nan")), "finite"), ((0.0, "high"), "number")):
        with pytest.raises(ValueError, match=says):
            ThresholdRule(*wrong)
        with pytest.raises(ValueError, match=says):
            simulate_allocation(model, *wrong, steps=10)
    with pytest.raises(ValueError, match="mode must be"):
        ThresholdRule(0.0, 0.4, mode=2)
    with pytest.raises(ValueError, match="steps"):
        simulate_allocation(model, 0.0, 0.4, steps=0)
    with pytest.raises(ValueError, match="r0"):
        simulate_allocation(model, 0.0, 0.4, steps=10, r0=1.5)
    with pytest.raises(ValueError, match="tolerance"):
        PerformanceRule(0.2, 0.4, tolerance=0.2)
