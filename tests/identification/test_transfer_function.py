"""
(A.1) recovered: exactly without noise, within its standard errors with noise; python-control as the
simulator.
"""

import control
import numpy as np
import pytest

from trustlab.identification.model import IdentificationError
from trustlab.identification.transfer_function import fit_transfer_function
from trustlab.models.uav import PRINTED_UAV

T = 0.02


def flight(axis, seed, count=3000, start=True):
    """Held commands like a pilot's, and the velocity that python-control makes of them."""
    rng = np.random.default_rng([51, seed])
    command = np.repeat(rng.uniform(-0.2, 0.2, count // 50), 50)
    model = PRINTED_UAV[axis]
    plant = control.c2d(
        control.ss(control.tf([model.gain], [1.0, *model.denominator])), T, method="zoh"
    )
    begin = rng.normal(size=model.order) * 0.1 if start else np.zeros(model.order)
    return command, control.forced_response(plant, T * np.arange(count), command, begin).outputs


@pytest.mark.parametrize("axis", "xyz")
def test_printed_model_is_recovered_without_noise(axis):
    runs = [flight(axis, seed) for seed in range(3)]
    model = PRINTED_UAV[axis]
    fit = fit_transfer_function([u for u, _ in runs], [v for _, v in runs], T, order=model.order)
    np.testing.assert_allclose(fit.parameters["value"], [model.gain, *model.denominator], rtol=1e-7)
    assert fit.fit_percent > 99.9999


@pytest.mark.slow
@pytest.mark.parametrize("axis", "xyz")
def test_errors_are_as_large_as_the_standard_errors_say(axis):
    model, z = PRINTED_UAV[axis], []
    u, v = flight(axis, 7, count=1500)
    for seed in range(20):
        noisy = v + np.random.default_rng([52, seed]).normal(0.0, 0.05, v.size)
        table = fit_transfer_function(u, noisy, T, order=model.order, noise="white").table()
        z.append((table["value"] - [model.gain, *model.denominator]) / table["stderr"])
    # Twenty leave a root mean square of one 16 % uncertain.
    assert (np.mean(np.square(z), axis=0) ** 0.5 < 1.4).all()
    assert 0.75 < np.mean(np.square(z)) ** 0.5 < 1.25


def test_coloured_noise_gets_wider_errors():
    u, v = flight("z", 3)
    rng = np.random.default_rng(4)
    slow = np.convolve(rng.normal(0.0, 0.02, v.size), np.ones(20), mode="same")
    fit = fit_transfer_function(u, v + slow, T, order=1)
    white = fit_transfer_function(u, v + slow, T, order=1, noise="white")
    assert fit.noise == "correlated"
    assert fit.parameters["stderr"]["gain"] > 1.5 * white.parameters["stderr"]["gain"]
    assert fit_transfer_function(u, v + rng.normal(0.0, 0.05, v.size), T, order=1).noise == "white"


def test_first_order_does_not_fit_a_second_order_axis():
    u, v = flight("y", 1)
    assert (
        fit_transfer_function(u, v, T, order=1).fit_percent
        < 80.0
        < fit_transfer_function(u, v, T).fit_percent
    )


@pytest.mark.parametrize(
    ("size", "command", "words"),
    [(200, np.ones(200), "never changes"), (3, np.r_[0.0, 1.0, 0.0], "too few")],
)
def test_logs_that_say_too_little_are_refused(size, command, words):
    with pytest.raises(IdentificationError, match=words):
        fit_transfer_function(command, flight("x", 0)[1][:size], T)


def test_a_velocity_that_does_not_follow_the_command_is_no_success():
    u, v = flight("x", 0)
    fit = fit_transfer_function(u, np.random.default_rng(0).normal(0.0, 0.1, v.size), T, order=1)
    assert not fit.success
    assert fit.parameters.loc["gain", "status"] == "weak"
