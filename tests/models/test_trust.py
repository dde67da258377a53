"""
Trust (3.2)-(3.4) against an independent integrator; scalings (3.5)-(3.6) against their printed
ends.
"""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.integrate import solve_ivp

from trustlab.models.trust import LogisticScaling, StepScaling, TrustModel

SETTINGS = settings(max_examples=60, deadline=None, derandomize=True)
unit = st.floats(0.01, 1.0)


def test_step_is_the_exact_solution_for_a_held_performance():
    trust = TrustModel(a=0.7, b=0.4, t_min=1.0, t_max=3.0, p_min=0.2, p_max=0.9)

    def rate(_, level):  # (3.2) as printed
        return -0.7 * (level - 1.0) / 2.0 + 0.4 * (0.55 - 0.2) / 0.7

    solved = solve_ivp(rate, (0.0, 0.3), [2.2], rtol=1e-12, atol=1e-14).y[0, -1]
    assert trust.step(2.2, 0.55, 0.3) == pytest.approx(solved, abs=1e-12)


def test_two_half_steps_are_one_step():
    trust = TrustModel(a=0.3, b=0.2)
    half = trust.step(trust.step(0.4, 0.8, 0.5), 0.8, 0.5)
    assert half == pytest.approx(trust.step(0.4, 0.8, 1.0), abs=1e-15)


def test_simulate_repeats_step():
    trust = TrustModel(a=0.3, b=0.2, t_min=-1.0, t_max=2.0)
    performance = np.random.default_rng(0).uniform(size=50)
    run, level = trust.simulate(performance, 0.1, trust0=0.5), 0.5
    for k in range(49):
        level = trust.step(level, performance[k], 0.1)
        assert run[k + 1] == pytest.approx(level, abs=1e-14)
    assert run.size == 50


@SETTINGS
@given(unit, unit, st.integers(0, 1000), st.floats(0.001, 10.0))
def test_trust_stays_within_its_bounds(one, other, seed, sample_time):
    a, b = max(one, other), min(one, other)
    trust = TrustModel(a, b, t_min=-0.5, t_max=1.5)
    performance = np.random.default_rng(seed).integers(0, 2, 200).astype(float)
    start = np.random.default_rng(seed).uniform(-0.5, 1.5)
    run = trust.simulate(performance, sample_time, start)
    assert run.min() >= -0.5 - 1e-12
    assert run.max() <= 1.5 + 1e-12


def test_with_b_above_a_trust_leaves_its_bounds():
    with pytest.raises(ValueError, match=r"b = 0.5 > a = 0.2"):
        TrustModel(a=0.2, b=0.5)
    trust = TrustModel(a=0.2, b=0.5, allow_unbounded=True)
    assert trust.steady_state(1.0) == pytest.approx(2.5)
    assert trust.simulate(np.ones(500), 0.1).max() > 1.0


def test_full_trust_is_reached_when_a_equals_b():
    assert TrustModel(a=0.4, b=0.4, t_min=0.2, t_max=0.8).steady_state(1.0) == pytest.approx(
        0.8, abs=1e-15
    )


def test_logistic_scaling_is_the_printed_function_and_nearly_meets_its_bounds():
    scaling = LogisticScaling(low=0.05, high=1.0, steepness=12.0, t_min=0.2, t_max=0.8)
    trust = np.linspace(-0.5, 1.5, 41)
    printed = 1.0 - 0.95 / (1.0 + np.exp(-12.0 * (trust - 0.5) / 0.6))
    np.testing.assert_allclose(scaling.value(trust), printed, atol=1e-14)
    assert scaling.value(0.5) == pytest.approx(0.525, abs=1e-15)
    assert 1.0 - scaling.value(0.2) <= 0.95 / (1.0 + np.exp(6.0)) + 1e-15
    assert np.isfinite(scaling.value(np.array([-1e9, 1e9]))).all()


@SETTINGS
@given(unit, unit, st.floats(10.0, 1e4), st.lists(st.floats(-2.0, 3.0), min_size=2, max_size=20))
def test_scalings_fall_with_trust_and_keep_their_bounds(one, other, steepness, trust):
    low, high = min(one, other), max(one, other) + 0.01
    trust = np.sort(trust)
    for scaling in (LogisticScaling(low, high, steepness), StepScaling(low, high)):
        values = scaling.value(trust)
        assert (np.diff(values) <= 0.0).all()
        assert values.min() >= low * (1 - 1e-15)
        assert values.max() <= high * (1 + 1e-15)


def test_steep_logistic_scaling_is_the_step():
    step, steep = StepScaling(0.2, 1.0, 0.4), LogisticScaling(0.2, 1.0, 1e6, 0.4)
    trust = np.array([0.0, 0.3999, 0.4001, 1.0])
    np.testing.assert_allclose(step.value(trust), steep.value(trust), atol=1e-12)
    assert step.value(0.4) == 0.2


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: TrustModel(0.0, 0.1), "a must lie in"),
        (lambda: TrustModel(0.5, 1.5), "b must lie in"),
        (lambda: TrustModel(0.5, np.nan), "b must be finite"),
        (lambda: TrustModel(0.5, 0.5, t_min=1.0), "t_min must be below t_max"),
        (lambda: TrustModel(0.5, 0.5, p_max=0.0), "p_min must be below p_max"),
        (lambda: TrustModel(0.5, 0.5).step(0.5, 1.2, 0.1), "performance must lie in"),
        (lambda: TrustModel(0.5, 0.5).step(0.5, 0.2, 0.0), "sample_time must be positive"),
        (lambda: TrustModel(0.5, 0.5).simulate([0.5, 2.0], 0.1), "sample 1 is 2.0"),
        (lambda: TrustModel(0.5, 0.5).simulate([0.5, np.nan], 0.1), "sample 1 is nan"),
        (lambda: LogisticScaling(0.0, 1.0), "one-way teleoperation"),
        (lambda: LogisticScaling(0.5, 0.2), "low must not exceed high"),
        (lambda: LogisticScaling(0.1, 1.0, steepness=3.0), "at least 10"),
        (lambda: StepScaling(0.1, 1.0, midpoint=1.0), "strictly between"),
        (lambda: StepScaling(0.1, 1.0).value("high"), "trust must be a number"),
    ],
)
def test_bad_input_is_refused(make, words):
    with pytest.raises(ValueError, match=words):
        make()


def test_the_least_steepness_of_a_logistic_scale():
    assert LogisticScaling(0.05, 1.0).steepness == LogisticScaling(0.05, 1.0, 10.0).steepness == 10
    with pytest.raises(ValueError, match="at least 10"):
        LogisticScaling(0.05, 1.0, 9.999)


def test_ends_of_sensitivities_and_kinds_of_values():
    assert TrustModel(1.0, 1.0).a == 1.0
    for scaling in (LogisticScaling(0.1, 1.0), StepScaling(0.1, 1.0)):
        assert isinstance(scaling.value(0.3), float)
        assert scaling.value([0.3]).shape == (1,)
