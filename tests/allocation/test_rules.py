"""Rule (2.8) and Algorithm 2, step by step and in the simulation."""

import itertools

import numpy as np
import pytest
from hypothesis import given, strategies as st

from tests.allocation.cases import written_out
from trustlab.allocation import PerformanceRule, ThresholdRule, simulate_allocation


class Copied:
    """Rule (2.8) written out, with a memory of its own."""

    def __init__(self, lower, upper, mode=1):
        self.lower = lower
        self.upper = upper
        self.mode = mode

    def step(self, *, tsc, p_r):
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
        return self.answers.pop(0)


@given(st.lists(st.floats(-1, 1), min_size=1, max_size=60), st.sampled_from([0, 1]))
def test_threshold_rule_is_the_printed_case_distinction(values, first):
    rule, printed = (kind(-0.2, 0.3, first) for kind in (ThresholdRule, Copied))
    for tsc in values:
        assert rule.step(tsc=tsc, p_r=0.3) == printed.step(tsc=tsc, p_r=0.3) == rule.mode


def test_simulation_is_the_rule_with_the_model(operators):
    """Oracle: (2.1)-(2.8) written out."""
    run = simulate_allocation(operators["pilot"], 0.02, 0.45, 9000, r0=0.2, p_r0=0.3, mode=0)
    motion = written_out(operators["pilot"], (0.02, 0.45), 0.2, 0.3, 0)
    expected = list(itertools.islice(motion, 9000))
    np.testing.assert_allclose(run[["r", "p_r", "tsc", "mode"]], expected, atol=1e-12)
    p_h = operators["pilot"].human.performance(run["r"])
    np.testing.assert_allclose(run["p_h"], p_h, atol=1e-12)
    assert run["mode"].nunique() == 2


def test_performance_rule_is_algorithm_2():
    """Between 0.9 and 1 − tolerance of the range it says nothing."""
    rule = PerformanceRule(p_min=0.24, p_max=0.39, tolerance=0.0)
    assert rule.step(p_r=0.39) == 0
    assert rule.step(p_r=0.3899) is None
    assert rule.step(p_r=0.24 + 0.9 * 0.15) == 1
    assert rule.step(p_r=0.376, tsc=0.1) is None
    assert rule.step(p_r=0.1) == 1
    # Arguments come in the same order for every rule.
    assert PerformanceRule(0.24, 0.39).step(0.1, 0.384) == 0
    assert ThresholdRule(-0.1, 0.1).step(0.1, 0.39) == 0


def test_a_step_checks_again_only_what_was_assigned(monkeypatch):
    """A robot asks at every sample."""
    rule, again = ThresholdRule(-0.1, 0.1), []
    monkeypatch.setattr(ThresholdRule, "__post_init__", lambda _: again.append(1))
    assert [rule.step(tsc) for tsc in (0.2, 0.0, -0.1)] == [0, 0, 1]
    assert not again
    rule.upper = np.inf
    rule.step(0.2)
    assert again


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
            assert copied.mode == built_in.mode == first, "a run works on a copy of the rule"
        own_mode = own | {"mode": 1 if mode is None else mode}
        assert run.equals(simulate_allocation(model, lower, upper, **own_mode))
        numbers = model.robot.p_min, 0.5 * (model.robot.p_min + model.robot.p_max), 0.05
        run = simulate_allocation(model, rule=PerformanceRule(*numbers), **own)
        assert run.equals(simulate_allocation(model, rule=Algorithm2(*numbers), **own))
        assert run["mode"].nunique() == 2


def test_a_rule_that_switches_at_every_sample(operators):
    modes = np.arange(1000) % 2
    run = simulate_allocation(operators["2"], rule=Says(*modes.tolist()), steps=1000, mode=1)
    np.testing.assert_array_equal(run["mode"], modes)
    truths = simulate_allocation(operators["2"], rule=Says(*(modes == 1)), steps=1000, mode=1)
    assert truths.equals(run), "True and False are 1 and 0"
    np.testing.assert_allclose(run["r"], operators["2"].simulate(modes)["r"], atol=1e-15)
    keeps = simulate_allocation(operators["2"], rule=Says(None), steps=1)
    assert keeps["mode"].tolist() == [1], "a run begins in the manual mode"


def test_what_cannot_be_used_is_named(operators):
    for rule, says in (
        (3, r"rule must have a method step.*got 3"),
        (Copied, r"as objects of .* have; got <class"),
        (Says(2), "from 0 to 1, got 2"),
        (Copied(0.0, 0.4, mode=-1), r"rule\.mode must be"),
    ):
        with pytest.raises(ValueError, match=says):
            simulate_allocation(operators["2"], rule=rule, steps=100)
    with pytest.raises(ValueError, match="and not both"):
        simulate_allocation(operators["2"], 0.0, 0.4, steps=10, rule=Says(1))
    with pytest.raises(ValueError, match=r"below 0\.1"):
        PerformanceRule(0.24, 0.39, tolerance=0.1)


def test_what_is_assigned_to_a_rule_is_checked():
    rule = ThresholdRule(0.0, 0.4)
    rule.lower = 0.9
    with pytest.raises(ValueError, match="lower must be below upper"):
        rule.step(tsc=0.2)
    with pytest.raises(AttributeError, match="lowr"):
        rule.lowr = 0.1
