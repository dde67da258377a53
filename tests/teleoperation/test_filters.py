"""
Filters of the channel, and what it makes transparent.

Oracles: python-control; the channel written out as transfer functions.
"""

import numpy as np
import pytest
from hypothesis import given, strategies as st
from numpy.testing import assert_allclose

from tests.loops import random_signals
from trustlab.teleoperation.filters import (
    TwoPortFilter,
    corrected_filter,
    passivity_margin,
    printed_filter,
    sinusoid_energy,
)
from trustlab.teleoperation.ports import Scattering

# --- filters --------------------------------------------------------------------------------------


T = 1e-3


def signals(seed, count=2000):
    return random_signals(np.random.default_rng([71, seed]), T * np.arange(count), fastest=3.0)


@given(st.integers(0, 10_000))
def test_margin_against_a_grid_of_frequencies(seed):
    """Oracle: (Im H)² on a dense grid."""
    rng = np.random.default_rng([72, seed])
    order = int(rng.integers(1, 4))
    poles = -(10 ** rng.uniform(-1, 1, order)) + 0j
    if order > 1 and rng.random() < 0.5:
        poles[1] = np.conj(poles[0] + 1j * rng.uniform(0, 5))
        poles[0] = np.conj(poles[1])
    bottom = np.real(np.poly(poles))
    top = rng.normal(size=int(rng.integers(1, order + 2)))
    found = passivity_margin(top, bottom)
    # A pole near the axis makes a narrow peak: the grid is fine there too.
    near = [w * (1.0 + np.linspace(-0.3, 0.3, 20_001)) for w in np.abs(poles)]
    omega = np.concatenate([[0.0], np.logspace(-4, 4, 80_001), *near])
    response = np.polyval(top, 1j * omega) / np.polyval(bottom, 1j * omega)
    heights = response.imag**2
    assert found.least_product == pytest.approx(heights.max(), rel=1e-5, abs=1e-14)
    assert found.least_product >= heights.max() * (1 - 1e-9)
    assert found.frequency == pytest.approx(omega[heights.argmax()], rel=1e-3)


def test_printed_choice_makes_half_a_unit_per_second_for_ever():
    """Closed form: u_1ᵀLP[u_2] − u_2ᵀLP[u_1] = −½ once the start has died out."""
    run = sinusoid_energy(printed_filter(4.0), 60.0)
    late = run.t > 10.0
    slope = np.polyfit(run.t[late], run.generated[late], 1)[0]
    assert slope == pytest.approx(0.5, rel=1e-5)
    assert run.generated[-1] > 29.0


@given(st.integers(0, 10_000), st.floats(0.25, 2.0), st.floats(-2.0, 2.0), st.floats(-1.0, 3.0))
def test_corrected_filter_never_generates(seed, product, impedance, cutoff):
    root = np.sqrt(product)
    two_port = TwoPortFilter(10**cutoff, root / 10**impedance, root * 10**impedance)
    run = two_port.run(*signals(seed), T)
    before = np.concatenate([[0.0], run.generated[:-1]])
    scale = np.abs(run.supply).max() + run.storage.max()
    assert (run.generated - before).max() <= 1e-12 * scale  # at every sample, not only in the end


@pytest.mark.parametrize("product", [0.2, 0.1, 0.0])
def test_less_than_a_quarter_generates(product):
    """Negative control: at ω_c with the phase that the eigenvector asks for."""
    root = np.sqrt(product)
    two_port = TwoPortFilter(5.0, root, root, require_passive=False)
    assert sinusoid_energy(two_port, 60.0).generated[-1] > 1.0
    assert sinusoid_energy(corrected_filter(5.0, 1.0), 60.0).generated.max() <= 0.0


def test_signals_and_storage_of_one_sample():
    """
    Oracle: the midpoint rule by hand; storage (k_21 ‖a‖² + k_12 ‖c‖²)/ω_c with k_21 = 1 and
    k_12 = ¼.
    """
    run = corrected_filter(3.0, 2.0).run([[1.0, 0.0]], [[0.0, 2.0]], T)
    g = 0.5 * T * 3.0
    a, c = np.array([[1.0, 0.0], [0.0, 2.0]]) * 2.0 * g / (1.0 + g)
    stored = (a @ a + 0.25 * c @ c) / 3.0
    assert run.storage[0] == pytest.approx(stored, rel=1e-12)
    assert_allclose(run.y_1[0], 0.5 * a - [0.0, 0.5])
    assert_allclose(run.y_2[0], 0.5 * c + [1.0, 0.0])


# --- transparency ---------------------------------------------------------------------------------


def test_dominance_is_the_ratio_of_the_coefficients_of_3_22():
    """Oracle: the closed forms of its docstring."""
    b, alpha, beta = 1.7, 0.9, 0.4
    expected = {
        "force_operator": np.sqrt(2.0 / (b * beta)),
        "force_robot": np.sqrt(2.0 * alpha / b),
        "velocity_robot": np.sqrt(2.0 * b / alpha),
        "velocity_operator": np.sqrt(2.0 * b * beta),
    }
    channel = Scattering(b, 0.2, alpha, 0.1, beta)
    assert channel.dominance() == pytest.approx(expected, rel=1e-12)
