"""Rule (2.8) and Algorithm 2, step by step and in the simulation."""

import itertools
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from tests.allocation.cases import PILOT, SECOND, random_case, written_out
from tests.cases import refused
from trustlab.allocation import PerformanceRule, ThresholdRule, simulate_allocation

parametrize = pytest.mark.parametrize


class Own(ThresholdRule):
    """A rule that the package does not know to be its own."""


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


def test_simulation_is_the_rule_with_the_model():
    """Oracle: (2.1)-(2.8) written out."""
    run = simulate_allocation(PILOT, 0.02, 0.45, 9000, r0=0.2, p_r0=0.3, mode=0)
    expected = list(itertools.islice(written_out(PILOT, (0.02, 0.45), 0.2, 0.3, 0), 9000))
    assert list(run) == ["r", "p_r", "p_h", "tsc", "mode"]
    assert_allclose(run, expected, atol=1e-12)
    assert run["mode"].nunique() == 2


def test_performance_rule_is_algorithm_2_to_the_bit():
    """Between 0.9 and 1 − tolerance of the range it says nothing."""
    rule = PerformanceRule(p_min=0.24, p_max=0.39, tolerance=0.0)
    says = [rule.step(0.1, p_r) for p_r in (0.39, 0.3899, 0.376, 0.24 + 0.9 * 0.15)]
    assert says == [0, None, None, 1]


@parametrize("mode", [None, 0, 1])
def test_a_rule_in_python_gives_the_same_bits(mode):
    """It is called sample by sample; the built-in rules run compiled."""
    for seed in range(12):
        model, *pair = random_case(np.random.default_rng(seed))
        middle = 0.5 * (model.robot.p_min + model.robot.p_max)
        options = {"mode": mode, "steps": 3001 + seed, "r0": 0.3, "p_r0": middle}
        for first in (0, 1):
            rule, built_in = (kind(*pair, mode=first) for kind in (Own, ThresholdRule))
            run = simulate_allocation(model, rule=built_in, **options)
            assert run.equals(simulate_allocation(model, rule=rule, **options))
            assert rule.mode == built_in.mode == first, "a run works on a copy of the rule"
        options["mode"] = 1 if mode is None else mode
        assert run.equals(simulate_allocation(model, *pair, **options))
        numbers = model.robot.p_min, middle, 0.05
        run = simulate_allocation(model, rule=PerformanceRule(*numbers), **options)
        assert run.equals(simulate_allocation(model, rule=Algorithm2(*numbers), **options))
        assert run["mode"].nunique() == 2


def test_a_rule_that_switches_at_every_sample():
    modes = np.arange(1000) % 2
    for said in (modes, modes == 1):  # True and False are 1 and 0
        run = simulate_allocation(SECOND, rule=Says(*said.tolist()), steps=1000, mode=1)
        assert_array_equal(run["mode"], modes)
    assert_allclose(run["r"], SECOND.simulate(modes)["r"], atol=1e-15)
    keeps = simulate_allocation(SECOND, rule=Says(None), steps=1)
    assert keeps["mode"].tolist() == [1], "a run begins in the manual mode"


def test_what_cannot_be_used_is_named():
    for rule, says in (
        (3, r"rule must have a method step.*got 3"),
        (ThresholdRule, r"as objects of .* have; got <class"),
        (Says(2), "from 0 to 1, got 2"),
        (SimpleNamespace(step=abs, mode=-1), r"rule\.mode must be"),
    ):
        with refused(says):
            simulate_allocation(SECOND, rule=rule, steps=100)
    with refused("and not both"):
        simulate_allocation(SECOND, 0.0, 0.4, steps=10, rule=Says(1))


@parametrize(("name", "value"), [("lower", 0.9), ("upper", np.inf), ("mode", 2), ("mode", -1)])
def test_what_is_assigned_to_a_rule_is_checked(name, value):
    rule = ThresholdRule(0.0, 0.4)
    setattr(rule, name, value)
    with refused(f"{name} must be"):
        rule.step(tsc=0.2)
    with pytest.raises(AttributeError, match="lowr"):
        rule.lowr = 0.1
