"""
Trust (3.2)-(3.4) against an independent integrator; scalings (3.5)-(3.6) against their printed
expressions.
"""

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.integrate import solve_ivp

from trustlab.models.trust import LogisticScaling, StepScaling, TrustModel

unit = st.floats(0.01, 1.0)


def test_a_step_is_the_exact_solution_for_a_held_performance():
    trust = TrustModel(a=0.7, b=0.4, t_min=1.0, t_max=3.0, p_min=0.2, p_max=0.9)

    def rate(_, level):  # (3.2) as printed
        return -0.7 * (level - 1.0) / 2.0 + 0.4 * (0.55 - 0.2) / 0.7

    solved = solve_ivp(rate, (0.0, 0.3), [2.2], rtol=1e-12, atol=1e-14).y[0, -1]
    assert trust.step(2.2, 0.55, 0.3) == pytest.approx(solved, abs=1e-12)
    assert rate(0.0, trust.steady_state(0.55)) == pytest.approx(0.0, abs=1e-15)


def test_simulate_repeats_step():
    trust = TrustModel(a=0.3, b=0.2, t_min=-1.0, t_max=2.0, p_min=-0.5)
    performance = np.random.default_rng(0).uniform(-0.5, 1.0, 50)
    run, level = trust.simulate(performance, 0.1, trust0=0.5), 0.5
    for k in range(49):
        level = trust.step(level, performance[k], 0.1)
        assert run[k + 1] == pytest.approx(level, abs=1e-14)
    assert run.size == 50
    assert trust.simulate(performance, 0.1)[0] == -1.0


@given(unit, unit, st.integers(0, 1000), st.floats(0.001, 10.0))
def test_trust_stays_within_its_bounds(a, b, seed, sample_time):
    rng = np.random.default_rng(seed)
    trust = TrustModel(max(a, b), min(a, b), t_min=-0.5, t_max=1.5)
    performance = rng.integers(0, 2, 200).astype(float)
    run = trust.simulate(performance, sample_time, rng.uniform(-0.5, 1.5))
    assert run.min() >= -0.5 - 1e-12
    assert run.max() <= 1.5 + 1e-12


def test_with_b_above_a_trust_leaves_its_bounds():
    """Negative control of (3.4), which the model therefore refuses unless it is asked for."""
    with pytest.raises(ValueError, match=r"b = 0\.5 > a = 0\.2 .*allow_unbounded=True"):
        TrustModel(a=0.2, b=0.5)
    trust = TrustModel(a=0.2, b=0.5, allow_unbounded=True)
    assert trust.steady_state(1.0) == pytest.approx(2.5)
    assert trust.simulate(np.ones(500), 0.1).max() > 1.0


def test_logistic_scaling_is_the_printed_function_and_nearly_meets_its_bounds():
    scaling = LogisticScaling(low=0.05, high=1.0, steepness=12.0, t_min=0.2, t_max=0.8)
    trust = np.linspace(-0.5, 1.5, 41)
    printed = 1.0 - 0.95 / (1.0 + np.exp(-12.0 * (trust - 0.5) / 0.6))
    np.testing.assert_allclose(scaling.value(trust), printed, atol=1e-14)
    assert 1.0 - scaling.value(0.2) <= 0.95 / (1.0 + np.exp(6.0)) + 1e-15
    assert scaling.value([-1e9, 1e9]).tolist() == pytest.approx([1.0, 0.05])


@given(unit, unit, st.floats(10.0, 1e4), st.lists(st.floats(-2.0, 3.0), min_size=2, max_size=20))
def test_scalings_fall_with_trust_and_keep_their_bounds(low, high, steepness, trust):
    low, high = min(low, high), max(low, high) + 0.01
    for scaling in (LogisticScaling(low, high, steepness), StepScaling(low, high)):
        values = scaling.value(sorted(trust))
        assert (np.diff(values) <= 0.0).all()
        assert values.min() >= low * (1 - 1e-15)
        assert values.max() <= high * (1 + 1e-15)


def test_a_steep_logistic_scaling_is_the_step():
    step, steep = StepScaling(0.2, 1.0, 0.4), LogisticScaling(0.2, 1.0, 1e6, 0.4)
    trust = [0.0, 0.3999, 0.4001, 1.0]
    np.testing.assert_allclose(step.value(trust), steep.value(trust), atol=1e-12)
    assert step.value(0.4) == 0.2
    assert StepScaling(0.2, 1.0, t_min=-3.0).midpoint == -1.0


@pytest.mark.parametrize("scaling", [LogisticScaling, StepScaling])
def test_scalings_say_what_would_break_teleoperation(scaling):
    assert scaling(0.5, 0.5).value(0.3) == 0.5
    for arguments, words in [
        ((0.0, 1.0), r"got 0\.0: a scale of zero leaves one-way"),
        ((0.5, 0.2), "low must not exceed high"),
    ]:
        with pytest.raises(ValueError, match=words):
            scaling(*arguments)
    for midpoint in (0.0, 1.0):
        with pytest.raises(ValueError, match=r"strictly between t_min = 0\.0 and t_max"):
            scaling(0.1, 1.0, midpoint=midpoint)


def test_a_logistic_scaling_nearly_meets_its_bounds_or_is_refused():
    assert LogisticScaling(0.05, 1.0, 10).steepness == 10.0
    with pytest.raises(ValueError, match="steepness must be at least 10"):
        LogisticScaling(0.05, 1.0, 9.999)
