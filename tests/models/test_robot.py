"""(2.3) against its closed form; guards by what they refuse."""

import numpy as np
import pytest
from hypothesis import given, strategies as st

import trustlab as tl

rates = st.floats(0.5, 0.9999)
shares = st.floats(0.0, 1.0)


def robots(draw):
    p_min = draw(st.floats(-0.5, 0.5))
    return tl.RobotModel(
        a=draw(rates),
        p_min=p_min,
        p_max=p_min + draw(st.floats(0.01, 1.0)),
        p_h_max=draw(st.floats(0.1, 2.0)),
    )


@given(st.data(), shares, st.floats(0.0, 1.0))
def test_constant_input_follows_the_closed_form(data, mode, part):
    robot = data.draw(st.composite(robots)())
    p_h, k = part * robot.p_h_max, np.arange(300)
    p_r = robot.simulate(np.full(300, mode), np.full(300, p_h), p_r0=robot.p_max)
    settled = robot.p_min + mode * robot.b * p_h / (1.0 - robot.a)
    expected = settled + (robot.p_max - settled) * robot.a**k
    np.testing.assert_allclose(p_r, expected, rtol=0, atol=1e-12)
    assert robot.steady_state(mode, p_h) == pytest.approx(settled, abs=1e-14)


@given(st.data())
def test_performance_stays_between_its_bounds(data):
    robot = data.draw(st.composite(robots)())
    seed = data.draw(st.integers(0, 2**32 - 1))
    rng = np.random.default_rng(seed)
    p_r = robot.simulate(
        rng.random(500),
        rng.random(500) * robot.p_h_max,
        p_r0=robot.p_min + rng.random() * (robot.p_max - robot.p_min),
    )
    assert p_r.min() >= robot.p_min - 1e-12
    assert p_r.max() <= robot.p_max + 1e-12


def test_bounds_need_b_of_2_3():
    # Negative control: a larger gain than (2.3) gives lifts performance above p_max.
    robot = tl.RobotModel(a=0.99, p_min=0.2, p_max=0.4, p_h_max=0.5, b=0.01)
    assert robot.simulate(np.ones(2000), np.full(2000, 0.5))[-1] > 0.4


def test_gain_of_the_pilot_is_the_printed_one():
    robot = tl.RobotModel(a=0.996, p_min=0.24, p_max=0.39, p_h_max=0.4602)
    assert round(robot.b, 4) == 0.0013
    assert robot.time_constant == pytest.approx(249.5, abs=0.01)
    assert tl.RobotModel(a=0.996, p_min=0.24, p_max=0.39, p_h_max=0.4602, b=0.0013).b == 0.0013


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"a": 1.0}, "a must lie strictly between 0 and 1, got 1.0"),
        ({"a": 0.0}, "a must lie strictly"),
        ({"a": float("nan")}, "a must be finite"),
        ({"a": "fast"}, "a must be a number, got 'fast'"),
        ({"p_min": 0.39}, "p_min must be below p_max"),
        ({"p_h_max": 0.0}, "p_h_max must be positive"),
        ({"b": -0.1}, "b must be positive"),
    ],
)
def test_refuses(change, says):
    good = {"a": 0.996, "p_min": 0.24, "p_max": 0.39, "p_h_max": 0.4602}
    with pytest.raises(ValueError, match=says):
        tl.RobotModel(**(good | change))


@pytest.mark.parametrize(
    ("mode", "p_h", "says"),
    [
        ([1, 2], [0.4, 0.4], r"mode must lie in \[0, 1\].*sample 1 is 2.0"),
        ([1, 0], [0.4], "p_h must have 2 samples, got 1"),
        ([1, 0], [0.4, np.nan], "p_h must be finite, but sample 1 is nan"),
        ([], [], "at least one sample"),
        ([[1, 0]], [0.4], "one-dimensional"),
    ],
)
def test_simulation_refuses(mode, p_h, says):
    robot = tl.RobotModel(a=0.996, p_min=0.24, p_max=0.39, p_h_max=0.4602)
    with pytest.raises(ValueError, match=says):
        robot.simulate(mode, p_h)
