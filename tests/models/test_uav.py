"""(A.1) against python-control, and what its printed controller does with it."""

from pathlib import Path

import control
import numpy as np
import pandas as pd
import pytest

from trustlab.models.uav import PRINTED_UAV, three_axes

PRINTED = pd.read_csv(
    Path(__file__).parents[2] / "data" / "published" / "statements.csv", index_col="id"
)["printed"].filter(like="appendix_a/model/")


def test_the_numbers_are_those_printed():
    numbers = {}
    for axis, model in PRINTED_UAV.items():
        names = ("damping", "stiffness")[: model.order]
        numbers[f"{axis}_gain"] = model.gain
        numbers |= {
            f"{axis}_{name}": value for name, value in zip(names, model.denominator, strict=True)
        }
    assert numbers == {name.split("/")[-1]: float(text) for name, text in PRINTED.items()}


@pytest.mark.parametrize("axis", "xyz")
def test_discrete_form_is_that_of_python_control(axis):
    """Velocity at samples, under a command that changes at each, is the transfer function's."""
    model = PRINTED_UAV[axis]
    phi, gamma = model.discrete(0.01)
    plant = control.c2d(control.tf([model.gain], [1.0, *model.denominator]), 0.01, method="zoh")
    command = np.random.default_rng(0).standard_normal(400)
    expected = control.forced_response(plant, U=command).outputs
    state = np.zeros(model.order)
    velocity = []
    for u in command:
        velocity.append(state[0])
        state = phi @ state + gamma * u
    np.testing.assert_allclose(velocity, expected, atol=1e-10)


def test_a_vehicle_has_three_axes():
    axes = [PRINTED_UAV[name] for name in "xyz"]
    assert three_axes(axes) == tuple(axes)
    for wrong in (axes[:2], [1.0, *axes[:2]]):
        with pytest.raises(ValueError, match="three transfer functions, for x, y and z, got list"):
            three_axes(wrong)


@pytest.mark.parametrize("axis", "xyz")
def test_poles(axis):
    model = PRINTED_UAV[axis]
    plant = control.tf([model.gain], [1.0, *model.denominator])
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
