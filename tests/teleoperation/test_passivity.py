"""
Theorem 4 in discrete time: observed energy, force and deficit of both controllers; closed forms of
the yielding port.
"""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.optimize import minimize_scalar

from trustlab.teleoperation.ports.passivity import (
    CANCEL,
    OFF,
    REPAY,
    PassivityController,
    activation,
    demanded,
)

T = 0.01
SETTINGS = settings(max_examples=80, deadline=None, derandomize=True)


def stream(seed, count=400, n=3):
    rng = np.random.default_rng([41, seed])
    v = np.repeat(rng.normal(size=(count // 5, n)), 5, axis=0) * 10 ** rng.uniform(-2, 1)
    return v, rng.normal(size=v.shape) - rng.uniform(-1, 1) * v


@SETTINGS
@given(st.integers(0, 10_000))
def test_cancelling_keeps_energy_above_one_sample_and_never_raises_the_force(seed):
    v, f = stream(seed)
    out = PassivityController(T).run(v, f)
    power = (v * f).sum(axis=1)
    assert out["energy"].min() >= -T * np.abs(np.minimum(power, 0.0)).max() - 1e-12
    force = out[["force_0", "force_1", "force_2"]].to_numpy()
    assert (np.linalg.norm(force, axis=1) <= np.linalg.norm(f, axis=1) * (1 + 1e-12)).all()
    np.testing.assert_allclose(out["energy"], T * np.cumsum((v * force).sum(axis=1)), atol=1e-9)


@SETTINGS
@given(st.integers(0, 10_000))
def test_repaying_keeps_energy_at_zero_or_above(seed):
    v, f = stream(seed)
    out = PassivityController(T, "repay").run(v, f)
    assert out["energy"].min() >= -1e-12 * T * np.abs(v * f).sum()
    assert out["deficit"].max() <= 1e-12 * T * np.abs(v * f).sum()


def test_without_the_controller_the_energy_falls_for_ever():
    v, f = np.ones((500, 1)), -np.ones((500, 1))
    assert T * (v * f).sum() == pytest.approx(-5.0)
    assert PassivityController(T).run(v, f)["energy"].iloc[-1] == 0.0


def test_cap_and_floor_leave_a_visible_deficit_that_is_repaid():
    v = np.full((60, 1), 0.1)
    f = np.r_[np.full((20, 1), -5.0), np.full((40, 1), 0.2)]
    out = PassivityController(T, "repay", cap=1.0).run(v, f)
    assert (np.abs(out["force_0"] - f[:, 0]) <= 1.0 + 1e-12).all()
    assert out["deficit"].iloc[19] > 0.05
    assert out["deficit"].iloc[-1] < out["deficit"].iloc[19]
    still = PassivityController(T, velocity_floor=0.2).run(v, f)
    assert (still["z"] == 0.0).all()
    assert still["deficit"].max() > 0.0


@SETTINGS
@given(st.floats(-5, 5), st.floats(0.01, 5), st.floats(0.05, 5), st.floats(-2, 3))
def test_damping_of_a_yielding_port_takes_the_power_demanded(power, square, compliance, demand):
    w, met = activation(power, square, compliance, demand)
    assert w >= 0.0

    def taken(w):
        return ((1 + w) * power + w / compliance * square) / (1 + w) ** 2

    if met and np.isfinite(w):
        assert taken(w) >= demand - 1e-9 * (1 + abs(power) + square / compliance)
        if w > 0.0:
            assert taken(w) == pytest.approx(
                demand, abs=1e-9 * (1 + abs(power) + square / compliance)
            )
            assert all(taken(share * w) <= demand + 1e-9 for share in (0.0, 0.3, 0.9))
    elif np.isinf(w):
        assert power + square / compliance <= 0.0
    else:
        best = minimize_scalar(lambda x: -taken(np.exp(x)), bounds=(-20, 20), method="bounded")
        assert max(-best.fun, taken(0.0)) <= demand + 1e-9
        assert taken(w) >= max(-best.fun, taken(0.0)) - 1e-6 * (
            1 + abs(power) + square / compliance
        )


@pytest.mark.parametrize(
    ("method", "energy", "power", "demand"),
    [
        (OFF, -1.0, -1.0, None),
        (CANCEL, -1.0, -1.0, 0.0),
        (CANCEL, 0.0, -1.0, 0.0),  # printed: for ≤ 0
        (CANCEL, 0.5, -100.0, None),  # what is in hand may be spent, even in one sample
        (CANCEL, -1.0, 0.0, None),
        (CANCEL, -1.0, 1.0, None),
        (REPAY, -1.0, -1.0, 100.0),
        (REPAY, -1.0, 99.0, 100.0),
        (REPAY, -1.0, 101.0, None),
        (REPAY, 0.5, -40.0, None),
        (REPAY, 0.5, -60.0, -50.0),  # all that is in hand, in this sample
        (REPAY, 0.0, 0.0, None),
    ],
)
def test_when_a_controller_acts_and_what_it_demands(method, energy, power, demand):
    assert demanded(method, energy, power, T) == pytest.approx(
        np.nan if demand is None else demand, nan_ok=True
    )


@pytest.mark.parametrize(
    ("power", "square", "demand", "expected"),
    [
        (-2.0, 1.0, -2.0, (0.0, True)),  # as it is, although a stop would not do
        (-2.0, 1.0, 0.0, (np.inf, True)),  # stopped, it takes nothing
        (-2.0, 1.0, 0.5, (np.inf, False)),
        (-1.0, 1.0, 0.0, (np.inf, True)),
        (-1.0, 2.0, 0.0, (1.0, True)),
        (1.0, 1.0, 5.0, (0.0, False)),  # no damping takes more
        (0.0, 9.0, 1.0, (pytest.approx(3.5 - 1.25**0.5 * 3.0), True)),  # (1 + w)² = 9 w
    ],
)
def test_ports_that_cannot_take_what_is_demanded_are_stopped(power, square, demand, expected):
    assert activation(power, square, 1.0, demand) == expected


def test_the_first_sample_at_the_floor_of_velocity_is_not_damped():
    controller = PassivityController(T, velocity_floor=0.5)
    assert controller.step([0.5], [-1.0]).z == 0.0
    assert controller.step([0.5000001], [-1.0]).z > 0.0


def test_energy_in_hand_is_no_deficit():
    controller = PassivityController(T)
    done = controller.step([2.0], [3.0])
    assert (done.energy, done.deficit, controller.deficit) == (6.0 * T, 0.0, 0.0)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: PassivityController(0.0), "sample_time must be positive"),
        (lambda: PassivityController(T, "guess"), "method must be"),
        (lambda: PassivityController(T, cap=-1.0), "cap must not be negative"),
        (lambda: PassivityController(T).step([1.0], [np.nan]), "must be finite"),
        (lambda: PassivityController(T).step([1.0], [1.0, 2.0]), "one shape"),
        (lambda: PassivityController(T).run([[1.0], [1.0]], [[1.0], [np.inf]]), "sample 1"),
        (lambda: PassivityController(T).run(np.ones((3, 2)), np.ones((3, 1))), "same shape"),
    ],
)
def test_bad_input_is_refused(make, words):
    with pytest.raises(ValueError, match=words):
        make()
