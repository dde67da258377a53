"""(A.1) against python-control, and what its printed controller does with it."""

import control
import numpy as np
import pytest

from trustlab.models.uav import PRINTED_UAV, TransferFunction


@pytest.mark.parametrize("axis", "xyz")
def test_discrete_form_is_that_of_python_control(axis):
    model = PRINTED_UAV[axis]
    phi, gamma = model.discrete(0.01)
    a, b = model.matrices()
    other = control.c2d(
        control.ss(a, b[:, None], np.eye(model.order), np.zeros((model.order, 1))),
        0.01,
        method="zoh",
    )
    np.testing.assert_allclose(phi, other.A, atol=1e-14)
    np.testing.assert_allclose(gamma, other.B[:, 0], atol=1e-14)


@pytest.mark.parametrize("axis", "xyz")
def test_static_gain_and_poles(axis):
    model = PRINTED_UAV[axis]
    plant = control.tf([model.gain], [1.0, *model.denominator])
    assert model.static_gain == pytest.approx(float(plant(0).real), rel=1e-12)
    np.testing.assert_allclose(np.sort(model.poles()), np.sort(plant.poles()), atol=1e-12)


def test_the_printed_controller_does_not_stabilise_the_printed_model():
    # u_a = 0.5 e + 0.02 de/dt on x and y, 1.5 e on z (Appendix A), with position the integral of
    # velocity
    for axis, (proportional, derivative) in {
        "x": (0.5, 0.02),
        "y": (0.5, 0.02),
        "z": (1.5, 0.0),
    }.items():
        model = PRINTED_UAV[axis]
        loop = np.array([1.0, *model.denominator, 0.0])
        loop[-2] += model.gain * derivative
        loop[-1] += model.gain * proportional
        worst = np.roots(loop).real.max()
        assert (worst > 0.1) == (axis in "xy")


@pytest.mark.parametrize(
    ("gain", "denominator", "words"),
    [
        (0.0, (1.0,), "gain must not be zero"),
        (1.0, (), "at least one sample"),
        (1.0, (1.0, 2.0, 3.0), "one or two coefficients"),
        (1.0, (np.nan,), "must be finite"),
    ],
)
def test_bad_input_is_refused(gain, denominator, words):
    with pytest.raises(ValueError, match=words):
        TransferFunction(gain, denominator)
