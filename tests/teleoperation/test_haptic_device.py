"""
(3.8)-(3.11) and Proposition 2: energy balance to rounding, python-control as oracle of passivity.
"""

import control
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from trustlab.teleoperation.ports.device import HapticDevice, PassivityError

PRELIMINARY = {"damping": 0.55, "stiffness": 100.0, "weight": 60.0}
MAIN = {"damping": 5.5, "stiffness": 20.0, "weight": 10.0}
SETTINGS = settings(max_examples=60, deadline=None, derandomize=True)


def random_device(rng, n=3, passive=True):
    mass, weight = rng.uniform(0.05, 2.0, n), rng.uniform(0.5, 20.0, n)
    share = rng.uniform(1.0, 2.0, n) if passive else np.full(n, 0.1)
    return HapticDevice(
        mass,
        share * mass * weight,
        rng.uniform(0.0, 50.0, n),
        weight,
        force_scaling=rng.uniform(0.3, 3.0),
        require_passive=passive,
    )


def midpoint(gains, x, v, force, sample_time):
    """Oracle: the implicit midpoint rule for M dv/dt = force − B v − K x, solved as a system."""
    mass, damping, stiffness = (np.diag(gain) for gain in gains)
    zero, unit = np.zeros_like(mass), np.eye(len(mass))
    inverse = np.linalg.inv(mass)
    a = np.block([[zero, unit], [-inverse @ stiffness, -inverse @ damping]])
    u = np.concatenate([np.zeros_like(force), inverse @ force])
    before, whole = np.concatenate([x, v]), np.eye(2 * len(mass))
    half = 0.5 * sample_time
    after = np.linalg.solve(whole - half * a, (whole + half * a) @ before + 2.0 * half * u)
    return np.split(after, 2)


def follow(device, rng, steps=200, sample_time=0.01):
    x, v = rng.normal(size=3), rng.normal(size=3)
    for _ in range(steps):
        f_h, f_m = rng.normal(size=3), rng.normal(size=3)
        x1, v1, supply = device.step(x, v, f_h, f_m, sample_time)
        yield x, v, x1, v1, f_h, f_m, supply
        x, v = x1, v1


@pytest.mark.parametrize("seed", range(20))
def test_storage_dissipation_and_supply_balance_to_rounding(seed):
    rng = np.random.default_rng([31, seed])
    device = random_device(rng)
    for x, v, x1, v1, f_h, f_m, supply in follow(device, rng):
        before, after = device.storage(x, v), device.storage(x1, v1)
        lost = 0.01 * device.dissipation((x + x1) / 2, (v + v1) / 2)
        assert min(before, after, lost) >= 0.0
        assert abs(after - before + lost - supply) <= 1e-12 * (before + after + lost + abs(supply))
        r = device.output((x + x1) / 2, (v + v1) / 2)
        again = 0.01 * (r @ f_h / device.force_scaling - r @ f_m)  # the supply r''·f_h − r·f''_m
        assert supply == pytest.approx(again, rel=1e-10, abs=1e-14)


@pytest.mark.parametrize("n", [1, 2, 3, 6])
def test_steps_storage_and_dissipation_are_those_of_the_equations(n):
    """Oracles: (3.8) by a system of equations, and the matrix forms (3.9)-(3.10) as printed."""
    rng = np.random.default_rng([33, n])
    device = random_device(rng, n)
    x, v, f_h, f_m = rng.normal(size=(4, n))
    gains, scaling = (device.mass, device.damping, device.stiffness), device.force_scaling
    x1, v1, _ = device.step(x, v, f_h, f_m, 0.01)
    expected = midpoint(gains, x, v, f_h - scaling * f_m, 0.01)
    np.testing.assert_allclose([x1, v1], expected, rtol=1e-10, atol=1e-12)
    m, b, k = (np.diag(gain) for gain in gains)
    w, r = np.diag(device.weight), device.output(x, v)
    np.testing.assert_allclose(r, v + w @ x, rtol=1e-12)
    stored = 0.5 * (r @ m @ r + x @ (k + w @ b - w @ m @ w) @ x)
    lost = v @ (b - 0.5 * (m @ w + w @ m)) @ v + x @ w @ k @ x
    assert device.storage(x, v) == pytest.approx(stored / scaling, rel=1e-12)
    assert device.dissipation(x, v) == pytest.approx(lost / scaling, rel=1e-12)


def test_an_active_device_shows_negative_dissipation():
    rng = np.random.default_rng(5)
    device = random_device(rng, passive=False)
    lost = [
        device.dissipation((x + x1) / 2, (v + v1) / 2) for x, v, x1, v1, *_ in follow(device, rng)
    ]
    assert min(lost) < 0.0


def test_heaviest_device_of_the_preliminary_study():
    assert HapticDevice(mass=0.001, **PRELIMINARY).largest_mass() == pytest.approx(
        0.55 / 60, rel=1e-12
    )
    counted = HapticDevice(mass=0.001, port_damping=0.2, **PRELIMINARY)
    assert counted.largest_mass() == pytest.approx(0.0125, rel=1e-12)
    with pytest.raises(PassivityError, match=r"up to 0.009166 kg only, and it has 1 kg"):
        HapticDevice(mass=1.0, **PRELIMINARY)


@pytest.mark.parametrize("share", [0.5, 0.98, 1.02, 3.0])
@pytest.mark.parametrize("gains", [PRELIMINARY, MAIN], ids=["preliminary", "main"])
def test_python_control_agrees_on_passivity(gains, share):
    most = HapticDevice(mass=[1e-3], **gains).largest_mass()
    device = HapticDevice(mass=[share * most], require_passive=False, **gains)
    m, d, k, w = share * most, gains["damping"], gains["stiffness"], gains["weight"]
    a, b, c = [[0.0, 1.0], [-k / m, -d / m]], [[0.0], [1.0 / m]], [[w, 1.0]]
    assert device.is_passive == (share < 1.0)
    assert bool(control.ispassive(control.ss(a, b, c, np.zeros((1, 1))))) == device.is_passive


@SETTINGS
@given(st.integers(0, 10_000), st.floats(0.2, 0.999))
def test_largest_mass_is_the_edge(seed, share):
    device = random_device(np.random.default_rng(seed))
    scale = device.largest_mass() / device.mass.max()
    gains = [device.damping, device.stiffness, device.weight]
    inside = HapticDevice(device.mass * scale * share, *gains)
    assert inside.is_passive
    with pytest.raises(PassivityError):
        HapticDevice(device.mass * scale / share, *gains)


@SETTINGS
@given(st.integers(0, 10_000), st.floats(0.0, 2.0))
def test_passive_exactly_where_storage_and_loss_are_positive(seed, port_damping):
    """Oracle: both conditions (3.9)-(3.10), with what the channel adds at the port."""
    rng = np.random.default_rng([34, seed])
    mass, damping, stiffness, weight = rng.uniform(0.05, 3.0, (4, 3))
    device = HapticDevice(
        mass, damping, stiffness, weight, 1.5, port_damping=port_damping, require_passive=False
    )
    b, k = damping + 1.5 * port_damping, stiffness + 1.5 * port_damping * weight
    conditions = [b - mass * weight, k + weight * b - weight * mass * weight]
    assert device.is_passive == (np.min(conditions) >= 0.0)
