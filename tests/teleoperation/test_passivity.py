"""
Theorem 4 in discrete time: observed energy, force and deficit of both controllers; closed forms of
the yielding port.
"""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.optimize import minimize_scalar

from trustlab.teleoperation.ports.device import (
    PassivityController,
    activation,
)

T = 0.01
SETTINGS = settings(max_examples=80, deadline=None, derandomize=True)


def controlled(controller, v, f):
    """Return force, damping, energy and deficit in every sample."""
    steps = [controller.step(*sample) for sample in zip(v, f, strict=True)]
    return [np.array(column) for column in zip(*steps, strict=True)]


def stream(seed, count=400, n=3):
    rng = np.random.default_rng([41, seed])
    v = np.repeat(rng.normal(size=(count // 5, n)), 5, axis=0) * 10 ** rng.uniform(-2, 1)
    return v, rng.normal(size=v.shape) - rng.uniform(-1, 1) * v


@SETTINGS
@given(st.integers(0, 10_000))
def test_cancelling_keeps_energy_above_one_sample_and_never_raises_the_force(seed):
    v, f = stream(seed)
    force, _, energy, deficit = controlled(PassivityController(T), v, f)
    power = (v * f).sum(axis=1)
    assert energy.min() >= -T * np.abs(np.minimum(power, 0.0)).max() - 1e-12
    assert (np.linalg.norm(force, axis=1) <= np.linalg.norm(f, axis=1) * (1 + 1e-12)).all()
    np.testing.assert_allclose(energy, T * np.cumsum((v * force).sum(axis=1)), atol=1e-9)
    np.testing.assert_array_equal(deficit, np.maximum(-energy, 0.0))


@SETTINGS
@given(st.integers(0, 10_000))
def test_repaying_keeps_energy_at_zero_or_above(seed):
    v, f = stream(seed)
    _, _, energy, deficit = controlled(PassivityController(T, "repay"), v, f)
    rounding = 1e-12 * T * np.abs(v * f).sum()
    assert energy.min() >= -rounding
    assert deficit.max() <= rounding


@SETTINGS
@given(st.floats(-5, 5), st.floats(0.01, 50), st.floats(-2, 3))
def test_damping_of_a_yielding_port_takes_the_power_demanded(power, gain, demand):
    w, met = activation(power, gain, demand)
    size = 1.0 + abs(power) + gain
    assert w >= 0.0

    def taken(w):
        return ((1 + w) * power + w * gain) / (1 + w) ** 2

    if np.isinf(w):
        assert power + gain <= 0.0
    elif met:
        assert taken(w) >= demand - 1e-9 * size
        if w > 0.0:
            assert taken(w) <= demand + 1e-9 * size
            assert all(taken(share * w) <= demand + 1e-9 for share in (0.0, 0.3, 0.9))
    else:
        best = minimize_scalar(lambda x: -taken(np.exp(x)), bounds=(-20, 20), method="bounded")
        most = max(-best.fun, taken(0.0))
        assert most <= demand + 1e-9
        assert taken(w) >= most - 1e-6 * size


@pytest.mark.parametrize("method", ["cancel", "repay"])
def test_a_port_that_stands_still_is_not_damped(method):
    controller = PassivityController(T, method)
    controller.step([1.0], [-1.0])
    done = controller.step([0.0], [-3.0])
    assert (done.force.tolist(), done.z, controller.energy) == ([-3.0], 0.0, done.energy)
