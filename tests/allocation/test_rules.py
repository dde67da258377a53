"""Rule (2.8) and Algorithm 2, step by step and in the simulation."""

import numpy as np
import pytest
from hypothesis import given, strategies as st

from trustlab.allocation import PerformanceRule, ThresholdRule, simulate_allocation


class Calls:
    """A count that copies of a rule share."""

    def __init__(self):
        self.count = 0

    def __deepcopy__(self, memo):
        return self


class Copied:
    """Rule (2.8) written out, with a memory of its own."""

    def __init__(self, lower, upper, mode=1):
        self.lower = lower
        self.upper = upper
        self.mode = mode
        self.calls = Calls()

    def step(self, *, tsc, p_r):
        self.calls.count += 1
        if tsc >= self.upper:
            self.mode = 0
        elif tsc <= self.lower:
            self.mode = 1
        return self.mode


class Algorithm2:
    """Algorithm 2 written out; None where nothing is suggested."""

    def __init__(self, p_min, p_max, tolerance):
        self.most, self.some = p_max - tolerance * (p_max - p_min), p_min + 0.9 * (p_max - p_min)

    def step(self, tsc, p_r):
        return 0 if p_r >= self.most else 1 if p_r <= self.some else None


class Says:
    def __init__(self, *answers):
        self.answers = list(answers)

    def step(self, tsc, p_r):
        answer = self.answers.pop(0)
        if isinstance(answer, Exception):
            raise answer
        return answer


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
    rule = ThresholdRule(0.02, 0.45, mode=0)
    r = 0.2
    p_r = 0.3
    for k in range(9000):
        p_h = model.human.performance(r)
        tsc = model.value(p_r, p_h)
        mode = rule.step(tsc=tsc)
        if k % 250 == 0:
            np.testing.assert_allclose(
                run.loc[k, ["r", "p_r", "p_h", "tsc"]], [r, p_r, p_h, tsc], atol=1e-12
            )
            assert run.loc[k, "mode"] == mode
        p_r = (
            model.robot.a * p_r
            + (1 - model.robot.a) * model.robot.p_min
            + mode * model.robot.b * p_h
        )
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
    for wrong, says in (
        ((0.4, 0.0), "below"),
        ((0.0, float("nan")), "finite"),
        ((0.0, "high"), "number"),
    ):
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


@pytest.mark.parametrize("mode", [None, 0, 1])
def test_a_copy_of_a_rule_gives_the_same_bits(random_model, mode):
    """A rule in Python is called sample by sample; the built-in rules run compiled."""
    for seed in range(12):
        model, lower, upper = random_model(np.random.default_rng(seed))
        own = {"mode": mode, "steps": 3001 + seed, "r0": 0.3}
        for first in (0, 1):
            built_in = ThresholdRule(lower, upper, mode=first)
            run = simulate_allocation(model, rule=built_in, **own)
            copied = Copied(lower, upper, first)
            assert run.equals(simulate_allocation(model, rule=copied, **own))
            assert copied.calls.count == len(run)
            assert copied.mode == first, "a run works on a copy of the rule"
            assert built_in == ThresholdRule(lower, upper, mode=first), (
                "a built-in rule is left as it is"
            )
        assert run.equals(
            simulate_allocation(
                model, lower, upper, **own | {"mode": first if mode is None else mode}
            )
        )
        numbers = model.robot.p_min, 0.5 * (model.robot.p_min + model.robot.p_max), 0.05
        run = simulate_allocation(model, rule=PerformanceRule(*numbers), **own)
        assert run.equals(simulate_allocation(model, rule=Algorithm2(*numbers), **own))
        assert run["mode"].nunique() == 2


def test_a_rule_that_switches_at_every_sample(operators):
    modes = np.arange(1000) % 2
    run = simulate_allocation(operators["2"], rule=Says(*modes.tolist()), steps=1000, mode=1)
    np.testing.assert_array_equal(run["mode"], modes)
    truths = simulate_allocation(
        operators["2"], rule=Says(*(modes == 1).tolist()), steps=1000, mode=1
    )
    assert truths.equals(run), "True and False are 1 and 0"
    np.testing.assert_allclose(run["r"], operators["2"].simulate(modes)["r"], atol=1e-15)


@pytest.mark.parametrize(
    ("rule", "says"),
    [
        (3, "rule must have a method step.*got 3"),
        (Says(2), "from 0 to 1, got 2"),
        (Copied(0.0, 0.4, mode=-1), r"rule\.mode must be"),
    ],
)
def test_rules_that_cannot_be_used_are_named(operators, rule, says):
    with pytest.raises(ValueError, match=says):
        simulate_allocation(operators["2"], rule=rule, steps=100)


def test_arguments_come_in_the_same_order_for_every_rule():
    assert (
        PerformanceRule(0.24, 0.39).step(0.1, 0.39) == ThresholdRule(-0.1, 0.1).step(0.1, 0.39) == 0
    )


def test_ends_of_arguments_of_rules(operators):
    """Modes are 0 or 1, a tolerance stays below 0.1, and a run begins in the manual mode."""
    for mode in (-1, 2):
        with pytest.raises(ValueError, match="mode must"):
            ThresholdRule(0.0, 0.3, mode=mode)
        with pytest.raises(ValueError, match="mode must"):
            simulate_allocation(operators["2"], rule=Says(1), steps=1, mode=mode)
    with pytest.raises(ValueError, match=r"below 0\.1"):
        PerformanceRule(0.24, 0.39, tolerance=0.1)
    assert ThresholdRule(0.0, 0.3).mode == 1
    keeps = simulate_allocation(operators["2"], rule=Says(None), steps=1)
    assert keeps["mode"].tolist() == [1]
    # Between 0.9 and 1 − tolerance of the range, Algorithm 2 says nothing: the mode is kept.
    assert PerformanceRule(0.0, 1.0, tolerance=0.01).step(tsc=0.0, p_r=0.95) is None
