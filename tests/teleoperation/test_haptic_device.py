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
def test_samples_are_those_of_the_equations_and_balance_to_rounding(seed):
    """Oracles: (3.8) by the midpoint rule as a system, (3.9)-(3.10) as printed."""
    rng = np.random.default_rng([31, seed])
    m, w, k = rng.uniform([0.05, 0.5, 0.0], [2.0, 20.0, 50.0])
    b = rng.uniform(1.0, 2.0) * m * w
    axis = ports.held_device(HapticDevice(m, b, k, w), 0.01)
    a, whole = 0.005 * np.array([[0.0, 1.0], [-k / m, -b / m]]), np.eye(2)
    x, v = rng.normal(size=2)
    for _ in range(200):
        f_h, f_m = rng.normal(size=2)
        old, energy = np.array([x, v]), ports.device_storage(axis, x, v)
        middle = ports.midpoint_velocity(axis, x, v, f_h, f_m)
        place = x + 0.005 * middle
        r = ports.free_output(axis, x, v, f_h - f_m)
        assert r == pytest.approx(middle + w * place, rel=1e-9, abs=1e-12)
        x, v = x + 0.01 * middle, 2.0 * middle - v
        pushed = np.array([0.0, 0.01 * (f_h - f_m) / m])
        expected = np.linalg.solve(whole - a, (whole + a) @ old + pushed)
        assert_allclose([x, v], expected, rtol=1e-10, atol=1e-12)
        r_after = v + w * x
        stored = 0.5 * (m * r_after**2 + (k + w * b - w * m * w) * x**2)
        assert ports.device_storage(axis, x, v) == pytest.approx(stored, rel=1e-12)
        lost = ports.device_loss(axis, place, middle)
        assert lost == pytest.approx((b - m * w) * middle**2 + w * k * place**2)
        supply = 0.01 * r * (f_h - f_m)
        balance = stored - energy + 0.01 * lost - supply
        assert abs(balance) <= 1e-12 * (2.0 * energy + 0.01 * lost + abs(supply))


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
    loaded = gains | {"port_damping": port_damping}
    m = share * HapticDevice(mass=1e-3, **loaded).largest_mass()
    held = HapticDevice(mass=m, require_passive=False, **loaded)
    w = gains["weight"]
    d, k = gains["damping"] + port_damping, gains["stiffness"] + port_damping * w
    _, response = freqresp(([1.0, w], [m, d, k]), np.geomspace(1e-2, 1e5, 2000))
    assert held.is_passive == (share < 1.0) == (response.real.min() >= 0.0)


NUMBER = r"([\d.]+(?:e[-+]?\d+)?)"


@pytest.mark.parametrize("seed", range(20))
def test_the_advised_mass_and_damping_of_a_device_are_passive(seed):
    rng = np.random.default_rng([98, seed])
    mass = rng.uniform(2.0, 3.0)
    settings = {"stiffness": rng.uniform(5.0, 50.0), "weight": rng.uniform(1.0, 3.0)}

    def made(mass, damping):
        return HapticDevice(mass=mass, damping=damping, **settings)

    with pytest.raises(PassivityError) as error:
        made(mass, 0.5)
    advice = f"up to {NUMBER} kg.*raise damping to {NUMBER} N s/m"
    most, least = map(float, re.search(advice, str(error.value)).groups())
    assert made(most, 0.5).is_passive
    assert made(mass, least).is_passive
    for weaker in ((1.01 * most, 0.5), (mass, 0.99 * least)):
        with pytest.raises(PassivityError):
            made(*weaker)
