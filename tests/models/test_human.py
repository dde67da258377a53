"""(2.5) against its closed form, (2.6) against its defining properties."""

import numpy as np
import pytest
from hypothesis import given, strategies as st

import trustlab as tl
from trustlab.models.tsc import performance_range, yerkes_dodson

betas = st.floats(0.02, 0.98)


@given(st.floats(0.5, 0.9999), st.floats(0, 1), st.floats(0, 1))
def test_utilization_follows_the_closed_form(a, r0, mode):
    human = tl.HumanModel(a, 0.7, 0.3, 0.5)
    r, _ = human.simulate(np.full(300, mode), r0)
    np.testing.assert_allclose(r, mode + (r0 - mode) * a ** np.arange(300), rtol=0, atol=1e-12)


@given(betas, st.floats(0, 1))
def test_performance_is_the_printed_expression(beta, r):
    human = tl.HumanModel(0.999, beta, 0.3, 0.5)
    printed = (0.5 - 0.3) * (r / beta) ** beta * ((1 - r) / (1 - beta)) ** (1 - beta) + 0.3
    assert human.performance(r) == pytest.approx(printed, abs=1e-14)


@given(betas)
def test_performance_is_greatest_at_beta_and_least_at_the_ends(beta):
    human = tl.HumanModel(0.999, beta, 0.3, 0.5)
    curve = human.performance(np.linspace(0.0, 1.0, 1001))
    assert human.performance(beta) == pytest.approx(0.5, abs=1e-15)
    assert curve.max() <= 0.5 + 1e-15
    assert curve[0] == curve[-1] == 0.3
    rising = np.linspace(0.0, 1.0, 1001)[1:] <= beta
    assert (np.diff(curve)[rising] > 0).all()


def test_simulation_evaluates_the_curve_at_every_sample():
    human = tl.HumanModel(0.9991, 0.74, 0.391, 0.4602)
    r, p_h = human.simulate(np.repeat([1.0, 0.3, 0.0], 500), 0.1)
    np.testing.assert_array_equal(p_h, human.performance(r))
    assert human.performance(np.zeros((2, 3))).shape == (2, 3)
    assert human.b == pytest.approx(0.0009)
    assert human.b == pytest.approx(1.0 - human.a)


def test_time_constants_of_both_models_share_one_definition():
    human, robot = (
        tl.HumanModel(0.9991, 0.74, 0.391, 0.4602),
        tl.RobotModel(0.9991, 0.24, 0.39, 0.4602),
    )
    decay = human.simulate(np.zeros(2000), 1.0)[0]
    assert np.interp(human.time_constant, np.arange(2000), decay) == pytest.approx(
        np.exp(-1.0), rel=1e-6
    )
    assert robot.time_constant == human.time_constant


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"a": 1.2}, "a must lie strictly"),
        ({"beta": 1.0}, "beta must lie strictly between 0 and 1"),
        ({"beta": 0.0}, "beta must lie strictly"),
        ({"p_max": 0.1}, "p_min must be below p_max"),
        ({"p_min": None}, "p_min must be a number"),
    ],
)
def test_refuses(change, says):
    with pytest.raises(ValueError, match=says):
        tl.HumanModel(**({"a": 0.999, "beta": 0.7, "p_min": 0.3, "p_max": 0.5} | change))


def test_utilization_outside_the_unit_interval_is_refused():
    human = tl.HumanModel(0.999, 0.7, 0.3, 0.5)
    with pytest.raises(ValueError, match=r"r0 must lie in \[0, 1\], got -0.1"):
        human.simulate([1.0], r0=-0.1)
    with pytest.raises(ValueError, match=r"got 1\.01"):
        human.performance([0.2, 1.01])
    with pytest.raises(ValueError, match=r"got -0\.5"):
        human.performance(-0.5)
    with pytest.raises(ValueError, match="must lie"):
        human.performance(float("nan"))


def test_values_at_and_beyond_the_ends():
    """The compiled curve is flat at and beyond the ends; the method refuses and names the first."""
    for r in (-0.5, 0.0, 1.0, 1.5):
        assert yerkes_dodson(r, 0.7) == 0.0
    human = tl.HumanModel(0.999, 0.7, 0.39, 0.46)
    assert isinstance(human.performance(0.7), float)
    assert human.performance(np.array([[0.7, 0.2]])).shape == (1, 2)
    with pytest.raises(ValueError, match=r"got 1\.25$"):
        human.performance([0.5, 1.25, -3.0])


@given(
    st.floats(0.0, 1.0, exclude_min=True, exclude_max=True),
    st.lists(st.floats(0, 1), min_size=20, max_size=20),
    st.sampled_from([0.0, 1e-300, 0.5, 1.0 - 2.0**-53, 1.0]),
)
def test_rounding_never_takes_utilization_out_of_the_unit_interval(a, mode, r0):
    human = tl.HumanModel(a, 0.7, 0.39, 0.46)
    for modes in (mode, np.round(mode), np.ones(20), np.zeros(20)):
        r, _ = human.simulate(modes, r0)
        assert r.min() >= 0.0
        assert r.max() <= 1.0


def test_a_range_that_ends_at_beta_has_the_printed_maximum_to_the_bit():
    """(P_max − P_min) + P_min rounds; P_max itself does not."""
    rng = np.random.default_rng(99)
    rounded = 0
    for _ in range(200):
        p_min, beta = rng.uniform(-1.0, 0.0), rng.uniform(0.1, 0.9)
        p_max = rng.uniform(0.01, 1.0)
        rounded += (p_max - p_min) + p_min != p_max
        assert performance_range(0.0, beta, beta, p_min, p_max)[1] == p_max
        assert performance_range(beta, 1.0, beta, p_min, p_max)[1] == p_max
    assert rounded > 10


def test_an_operator_begins_rested():
    human = tl.HumanModel(0.999, 0.7, 0.39, 0.46)
    r, _ = human.simulate(np.zeros(3))
    np.testing.assert_array_equal(r, 0.0)
