"""
(3.8)-(3.11) and Proposition 2: energy balance to rounding, python-control as oracle of passivity.
"""

import re

import control
import numpy as np
import pytest
from numpy.random import default_rng
from numpy.testing import assert_allclose

from trustlab.teleoperation.ports.device import HapticDevice, PassivityError

PRELIMINARY = {"damping": 0.55, "stiffness": 100.0, "weight": 60.0}
MAIN = {"damping": 5.5, "stiffness": 20.0, "weight": 10.0}


def random_device(rng, share):
    """A device with so many times the damping that its mass needs."""
    mass, weight = rng.uniform(0.05, 2.0), rng.uniform(0.5, 20.0)
    gains = mass, share * mass * weight, rng.uniform(0.0, 50.0), weight
    return HapticDevice(*gains, rng.uniform(0.3, 3.0), require_passive=share >= 1.0)


def follow(device, rng):
    """Random steps: before, after, forces, supply and loss of each."""
    x, v = rng.normal(size=(2, 3))
    for _ in range(200):
        f_h, f_m = rng.normal(size=(2, 3))
        x1, v1, supply = device.step(x, v, f_h, f_m, 0.01)
        lost = 0.01 * device.dissipation((x + x1) / 2, (v + v1) / 2)
        yield (x, v), (x1, v1), (f_h, f_m), supply, lost
        x, v = x1, v1


@pytest.mark.parametrize("seed", range(20))
def test_steps_are_those_of_the_equations_and_balance_to_rounding(seed):
    """Oracles: (3.8) by the midpoint rule as a system, (3.9)-(3.10) as printed."""
    rng = default_rng([31, seed])
    device = random_device(rng, rng.uniform(1.0, 2.0))
    m, b, k, w = device.mass, device.damping, device.stiffness, device.weight
    a, whole = 0.005 * np.array([[0.0, 1.0], [-k / m, -b / m]]), np.eye(2)
    for before, after, (f_h, f_m), supply, lost in follow(device, rng):
        pushed = np.array([0.0 * f_h, 0.01 * (f_h - device.force_scaling * f_m) / m])
        expected = np.linalg.solve(whole - a, (whole + a) @ np.array(before) + pushed)
        assert_allclose(after, expected, rtol=1e-10, atol=1e-12)
        x, v = after
        r = v + w * x
        assert_allclose(device.output(x, v), r, rtol=1e-12, atol=1e-14)
        stored = 0.5 * (m * r @ r + (k + w * b - w * m * w) * x @ x)
        assert device.storage(x, v) == pytest.approx(stored / device.force_scaling, rel=1e-12)
        dissipated = (b - m * w) * v @ v + w * k * x @ x
        assert device.dissipation(x, v) == pytest.approx(dissipated / device.force_scaling)
        energies = device.storage(*before), device.storage(*after), lost
        assert min(energies) >= 0.0
        gained = energies[1] - energies[0] + lost
        assert abs(gained - supply) <= 1e-12 * (sum(energies) + abs(supply))
        r = device.output(*np.mean([before, after], axis=0))
        again = 0.01 * (r @ f_h / device.force_scaling - r @ f_m)  # the supply r''·f_h − r·f''_m
        assert supply == pytest.approx(again, rel=1e-10, abs=1e-14)


def test_an_active_device_shows_negative_dissipation():
    rng = default_rng(5)
    assert min(lost for *_, lost in follow(random_device(rng, 0.1), rng)) < 0.0


def test_heaviest_device_of_the_preliminary_study():
    assert HapticDevice(mass=0.001, **PRELIMINARY).largest_mass() == pytest.approx(0.55 / 60)
    counted = HapticDevice(mass=0.001, port_damping=0.2, **PRELIMINARY)
    assert counted.largest_mass() == pytest.approx(0.0125, rel=1e-12)
    with pytest.raises(PassivityError, match=r"up to 0.009166 kg only, and it has 1 kg"):
        HapticDevice(mass=1.0, **PRELIMINARY)


@pytest.mark.parametrize("share", [0.5, 0.98, 1.02, 3.0])
@pytest.mark.parametrize("port_damping", [0.0, 0.4])
@pytest.mark.parametrize("gains", [PRELIMINARY, MAIN], ids=["preliminary", "main"])
def test_python_control_agrees_on_passivity(gains, port_damping, share):
    """With what the channel adds at the port: a damper that moves with r = v + w x."""
    scaled = gains | {"force_scaling": 1.5, "port_damping": port_damping}
    m = share * HapticDevice(mass=1e-3, **scaled).largest_mass()
    device = HapticDevice(mass=m, require_passive=False, **scaled)
    w, added = gains["weight"], 1.5 * port_damping
    d, k = gains["damping"] + added, gains["stiffness"] + added * w
    a, b, c = [[0.0, 1.0], [-k / m, -d / m]], [[0.0], [1.0 / m]], [[w, 1.0]]
    assert device.is_passive == (share < 1.0)
    assert bool(control.ispassive(control.ss(a, b, c, np.zeros((1, 1))))) == device.is_passive


NUMBER = r"([\d.]+(?:e[-+]?\d+)?)"


@pytest.mark.parametrize("seed", range(20))
def test_the_advised_mass_and_damping_of_a_device_are_passive(seed):
    rng = np.random.default_rng([98, seed])
    mass = rng.uniform(2.0, 3.0)
    settings = {"stiffness": rng.uniform(5.0, 50.0), "weight": rng.uniform(1.0, 3.0)}

    def device(mass, damping):
        return HapticDevice(mass=mass, damping=damping, **settings)

    with pytest.raises(PassivityError) as error:
        device(mass, 0.5)
    advice = f"up to {NUMBER} kg.*raise damping to {NUMBER} N s/m"
    most, least = map(float, re.search(advice, str(error.value)).groups())
    assert device(most, 0.5).is_passive
    assert device(mass, least).is_passive
    for weaker in ((1.01 * most, 0.5), (mass, 0.99 * least)):
        with pytest.raises(PassivityError):
            device(*weaker)
