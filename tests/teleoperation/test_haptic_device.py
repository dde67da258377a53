"""
(3.8)-(3.11) and Proposition 2: energy balance to rounding, passivity by the frequency response.
"""

import re

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.signal import freqresp

from trustlab.teleoperation import ports
from trustlab.teleoperation.ports import HapticDevice, PassivityError

PRELIMINARY = {"damping": 0.55, "stiffness": 100.0, "weight": 60.0}
MAIN = {"damping": 5.5, "stiffness": 20.0, "weight": 10.0}


@pytest.mark.parametrize("seed", range(20))
def test_steps_are_those_of_the_equations_and_balance_to_rounding(seed):
    """Oracles: (3.8) by the midpoint rule as a system, (3.9)-(3.10) as printed."""
    rng = np.random.default_rng([31, seed])
    m, w, k, scaling = rng.uniform([0.05, 0.5, 0.0, 0.3], [2.0, 20.0, 50.0, 3.0])
    b = rng.uniform(1.0, 2.0) * m * w
    device = HapticDevice(m, b, k, w, scaling)
    axis = ports.held_device(device, 0.01)
    a, whole = 0.005 * np.array([[0.0, 1.0], [-k / m, -b / m]]), np.eye(2)
    x, v = rng.normal(size=(2, 3))
    for _ in range(200):
        f_h, f_m = rng.normal(size=(2, 3))
        old, energy = np.array([x, v]), device.storage(x, v)
        x, v, supply = device.step(x, v, f_h, f_m, 0.01)
        pushed = np.array([0.0 * f_h, 0.01 * (f_h - scaling * f_m) / m])
        expected = np.linalg.solve(whole - a, (whole + a) @ old + pushed)
        assert_allclose([x, v], expected, rtol=1e-10, atol=1e-12)
        r = v + w * x
        assert_allclose(device.output(x, v), r, rtol=1e-12, atol=1e-14)
        stored = 0.5 * (m * r @ r + (k + w * b - w * m * w) * x @ x)
        assert device.storage(x, v) == pytest.approx(stored / scaling, rel=1e-12)
        dissipated = (b - m * w) * v @ v + w * k * x @ x
        assert device.dissipation(x, v) == pytest.approx(dissipated / scaling)
        middle = np.mean([old, (x, v)], axis=0)
        solved = ports.free_output(axis, *old, f_h - scaling * f_m)
        assert_allclose(solved, device.output(*middle), rtol=1e-9, atol=1e-12)
        lost = 0.01 * device.dissipation(*middle)
        balance = device.storage(x, v) - energy + lost - supply
        assert abs(balance) <= 1e-12 * (2.0 * energy + lost + abs(supply))


def test_heaviest_device_of_the_preliminary_study():
    assert HapticDevice(mass=0.001, **PRELIMINARY).largest_mass() == pytest.approx(0.55 / 60)
    counted = HapticDevice(mass=0.001, port_damping=0.2, **PRELIMINARY)
    assert counted.largest_mass() == pytest.approx(0.0125, rel=1e-12)
    with pytest.raises(PassivityError, match=r"up to 0.009166 kg only, and it has 1 kg"):
        HapticDevice(mass=1.0, **PRELIMINARY)


@pytest.mark.parametrize("share", [0.5, 0.98, 1.02, 3.0])
@pytest.mark.parametrize("port_damping", [0.0, 0.4])
@pytest.mark.parametrize("gains", [PRELIMINARY, MAIN], ids=["preliminary", "main"])
def test_a_device_is_passive_where_its_frequency_response_is_positive_real(
    gains, port_damping, share
):
    """With what the channel adds at the port: a damper that moves with r = v + w x."""
    scaled = gains | {"force_scaling": 1.5, "port_damping": port_damping}
    m = share * HapticDevice(mass=1e-3, **scaled).largest_mass()
    device = HapticDevice(mass=m, require_passive=False, **scaled)
    w, added = gains["weight"], 1.5 * port_damping
    d, k = gains["damping"] + added, gains["stiffness"] + added * w
    _, response = freqresp(([1.0, w], [m, d, k]), np.geomspace(1e-2, 1e5, 2000))
    assert device.is_passive == (share < 1.0) == (response.real.min() >= 0.0)


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
