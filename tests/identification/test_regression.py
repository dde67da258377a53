"""
ARX models and transfer functions.

Oracles: statsmodels OLS and its covariance; python-control.
"""

import re

import control
import numpy as np
import statsmodels.api as sm
from hypothesis import given, settings, strategies as st
from numpy.random import default_rng
from numpy.testing import assert_allclose
from pytest import mark
from scipy.signal import lfilter

from tests.identification.cases import undetermined
from trustlab.identification import arx
from trustlab.identification.transfer_function import fit_transfer_function
from trustlab.models.uav import PRINTED_UAV

# --- ARX ------------------------------------------------------------------------------------------


def ols(runs, na, nb, nk, intercept):
    """The regressors and targets of runs, written out equation by equation."""
    design, target = [], []
    for y, u in runs:
        for k in range(max(na, nk + nb - 1), len(y)):
            row = [-y[k - lag] for lag in range(1, na + 1)] + [u[k - nk - j] for j in range(nb)]
            design.append(row + [1.0] * intercept)
            target.append(y[k])
    return sm.OLS(target, design).fit()


def random_system(rng, na, nb, nk, samples):
    """Simulate a stable random ARX system with a white input."""
    a, b = np.poly(rng.uniform(-0.9, 0.9, na)), rng.normal(size=nb)
    u, noise = rng.normal(size=(2, samples))
    return lfilter(np.r_[np.zeros(nk), b], a, u) + lfilter([1.0], a, 0.3 + 0.05 * noise), u


def assert_same(fit, oracle, rtol=1e-10):
    scale = abs(oracle.params).max()
    assert_allclose(fit.coefficients, oracle.params, rtol=rtol, atol=rtol * scale)
    spread = np.outer(oracle.bse, oracle.bse)
    assert_allclose(fit.covariance / spread, oracle.cov_params() / spread, rtol=rtol, atol=rtol)
    assert_allclose(fit.residuals, oracle.resid, atol=rtol * abs(oracle.model.endog).max())
    assert fit.degrees_of_freedom == oracle.df_resid
    ends = fit.table(0.9)[["ci_low", "ci_high"]]
    assert_allclose(ends, oracle.conf_int(0.1), rtol=1e-7, atol=1e-9 * scale)


@given(
    seed=st.integers(0, 2**32 - 1),
    na=st.integers(1, 4),
    nb=st.integers(1, 3),
    nk=st.integers(0, 3),
    intercept=st.booleans(),
    lengths=st.lists(st.integers(60, 300), min_size=1, max_size=3),
)
@settings(max_examples=100, deadline=None)
def test_random_systems_agree_with_ols(seed, na, nb, nk, intercept, lengths):
    rng = default_rng(seed)
    runs = [random_system(rng, na, nb, nk, length) for length in lengths]
    outputs, inputs = zip(*runs, strict=True)
    fit = arx([*outputs], [*inputs], na, nb, nk, intercept)
    assert_same(fit, ols(runs, na, nb, nk, intercept))


# --- regressors that nearly follow from one another: the branch of singular values ----------------


def test_nearly_collinear_lags_agree_with_ols():
    """
    An input that hardly moves, so that its lags differ by a thousandth: refinement wins back the
    digits that normal equations lose.
    """
    rng = default_rng(9)
    u = 1.0 + 1e-3 * rng.normal(size=600)
    y = lfilter([0.0, 2.0, -1.0], [1.0, -0.5], u)
    y += lfilter([1.0], [1.0, -0.5], 0.1 * rng.normal(size=600))
    fit, oracle = arx(y, u, 1, 2, 1), ols([(y, u)], 1, 2, 1, False)
    assert_allclose(fit.coefficients, oracle.params, rtol=1e-10)
    assert_allclose(fit.stderr, oracle.bse, rtol=1e-4)


def test_units_of_the_regressors_do_not_matter():
    """Columns are scaled, so micrometres beside kilometres are no near collinearity."""
    y, u = random_system(default_rng(10), 2, 1, 1, 300)
    plain, units = arx(y, u, 2), arx(1e-9 * y, 1e9 * u, 2)
    scale = np.array([1.0, 1.0, 1e18])
    assert_allclose(units.coefficients * scale, plain.coefficients, rtol=1e-10)
    assert_allclose(units.stderr * scale, plain.stderr, rtol=1e-10)


# --- refusals -------------------------------------------------------------------------------------

Y, U = random_system(default_rng(3), 2, 1, 1, 200)


@mark.parametrize(
    ("change", "names", "says"),
    [
        ({"u": 0.0 * U}, {"b1"}, "b1 is not identifiable: its regressor is identically zero"),
        ({"u": U**0, "intercept": True}, {"b1", "c"}, "is a linear combination of"),
        ({"u": U**0, "nb": 2}, {"b1", "b2"}, "is a linear combination of"),
    ],
)
def test_data_that_identify_no_coefficient_are_refused(change, names, says):
    with undetermined(says) as caught:
        arx(**{"y": Y, "u": U} | change)
    (name,) = caught.value.parameters
    assert name in names


def test_a_run_that_is_too_short_for_lags_is_refused():
    with undetermined("a run of 4 samples is too short for lags up"):
        arx(Y[:4], U[:4], nk=5)


# --- transfer functions ---------------------------------------------------------------------------


T = 0.02


def flight(axis, seed):
    """Held commands like a pilot's, and the velocity that python-control makes of them."""
    rng, model = default_rng([51, seed]), PRINTED_UAV[axis]
    command = np.repeat(rng.uniform(-0.2, 0.2, 60), 50)
    plant = control.ss(control.tf([model.gain], [1.0, *model.denominator]))
    plant, t = control.c2d(plant, T, method="zoh"), T * np.arange(command.size)
    begin = rng.normal(size=model.order) * 0.1
    return command, control.forced_response(plant, t, command, begin).outputs


@mark.parametrize("axis", "xyz")
def test_printed_model_is_recovered_without_noise(axis):
    commands, velocities = zip(*(flight(axis, seed) for seed in range(3)), strict=True)
    model = PRINTED_UAV[axis]
    fit = fit_transfer_function([*commands], [*velocities], T, order=model.order)
    assert_allclose(fit.parameters["value"], [model.gain, *model.denominator], rtol=1e-7)
    assert fit.fit_percent > 99.9999


@mark.parametrize(
    ("command", "words"), [(np.ones(200), "never changes"), ([0.0, 1.0, 0.0], "too few")]
)
def test_logs_that_say_too_little_are_refused(command, words):
    with undetermined(words):
        fit_transfer_function(command, flight("x", 0)[1][: len(command)], T)


def test_remedies_for_a_transfer_function_are_arguments_that_it_has():
    """Values to hold and robust= were advised, which the function does not take."""
    u = np.repeat(default_rng(0).choice([-1.0, 1.0], 40), 50)
    with undetermined("that move the model more$"):
        fit_transfer_function(u, 0.5 * u, T, order=1)
    v = lfilter([0.02], [1.0, -0.98], u) + 0.01 * default_rng(1).normal(size=u.size)
    v[::97] = 5.0
    for velocity, words in ((v, "they are left out."), (0.1 * v[::-1], "weakly determined")):
        message = fit_transfer_function(u, velocity, T, order=1).message
        assert words in message
        assert not re.search(r"robust|fix", message)


def test_a_velocity_that_does_not_follow_the_command_is_no_success():
    u, v = flight("x", 0)
    fit = fit_transfer_function(u, default_rng(0).normal(0.0, 0.1, v.size), T, order=1)
    assert not fit.success
    assert fit.parameters.loc["gain", "status"] == "weak"
