"""
ARX models and transfer functions.

Oracles: statsmodels OLS and its covariance; normal equations in exact fractions; python-control and
the responses written out.
"""

import re

import control
import numpy as np
import pytest
import statsmodels.api as sm
from hypothesis import given, settings, strategies as st

from trustlab.identification import IdentificationError, arx
from trustlab.identification.transfer_function import fit_transfer_function
from trustlab.models.uav import PRINTED_UAV

# --- ARX ------------------------------------------------------------------------------------------


def rows(y, u, na, nb, nk, intercept):
    """Return the regressors and targets of one run, written out equation by equation."""
    design, target = [], []
    for k in range(max(na, nk + nb - 1), len(y)):
        row = [-y[k - lag] for lag in range(1, na + 1)] + [u[k - nk - j] for j in range(nb)]
        design.append(row + [1.0] * intercept)
        target.append(y[k])
    return np.array(design), np.array(target)


def ols(runs, na, nb, nk, intercept):
    blocks = [rows(y, u, na, nb, nk, intercept) for y, u in runs]
    return sm.OLS(np.concatenate([b[1] for b in blocks]), np.vstack([b[0] for b in blocks])).fit()


def random_system(rng, na, nb, nk, samples, noise=0.05):
    """Simulate a stable random ARX system with a white input."""
    a = np.poly(rng.uniform(-0.9, 0.9, na))[1:]
    b = rng.normal(0.0, 1.0, nb)
    u = rng.normal(0.0, 1.0, samples)
    y = np.zeros(samples)
    for k in range(samples):
        y[k] = 0.3 + noise * rng.normal()
        y[k] -= sum(a[j] * y[k - 1 - j] for j in range(na) if k - 1 - j >= 0)
        y[k] += sum(b[j] * u[k - nk - j] for j in range(nb) if k - nk - j >= 0)
    return y, u


def assert_same(fit, oracle, rtol=1e-10):
    scale = np.abs(oracle.params).max()
    np.testing.assert_allclose(fit.coefficients, oracle.params, rtol=rtol, atol=rtol * scale)
    np.testing.assert_allclose(fit.stderr, oracle.bse, rtol=rtol)
    spread = np.outer(oracle.bse, oracle.bse)
    np.testing.assert_allclose(
        fit.covariance / spread, oracle.cov_params() / spread, rtol=rtol, atol=rtol
    )
    np.testing.assert_allclose(
        fit.residuals, oracle.resid, atol=rtol * np.abs(oracle.model.endog).max()
    )
    assert fit.sigma == pytest.approx(np.sqrt(oracle.mse_resid), rel=rtol)
    assert fit.degrees_of_freedom == oracle.df_resid
    for level in (0.9, 0.99):
        ends = fit.table(level)[["ci_low", "ci_high"]]
        np.testing.assert_allclose(ends, oracle.conf_int(1.0 - level), rtol=1e-7, atol=1e-9 * scale)


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
    rng = np.random.default_rng(seed)
    runs = [random_system(rng, na, nb, nk, length) for length in lengths]
    fit = arx([y for y, _ in runs], [u for _, u in runs], na, nb, nk, intercept)
    assert_same(fit, ols(runs, na, nb, nk, intercept))
    names = [f"a{j}" for j in range(1, na + 1)] + [f"b{j}" for j in range(1, nb + 1)]
    assert list(fit.names) == names + ["c"] * intercept


# --- regressors that nearly follow from one another: the branch of singular values ----------------


def test_nearly_collinear_lags_agree_with_ols():
    """
    An input that hardly moves, so that its lags differ by a thousandth: refinement wins back the
    digits that normal equations lose.
    """
    rng = np.random.default_rng(np.random.SeedSequence(9))
    u = 1.0 + 1e-3 * rng.normal(size=600)
    y = np.zeros(u.size)
    for k in range(2, u.size):
        y[k] = 0.5 * y[k - 1] + 2.0 * u[k - 1] - u[k - 2] + 0.1 * rng.normal()
    design, _ = rows(y, u, 1, 2, 1, False)
    condition = np.linalg.cond(design / np.linalg.norm(design, axis=0))
    assert condition**2 > 1e5
    fit, oracle = arx(y, u, 1, 2, 1), ols([(y, u)], 1, 2, 1, False)
    # Rounding grows with the condition number of the regressors, for the oracle as well.
    loss = max(1e-10, 100.0 * np.finfo(float).eps * condition)
    np.testing.assert_allclose(fit.coefficients, oracle.params, rtol=loss)
    np.testing.assert_allclose(fit.stderr, oracle.bse, rtol=1e-4)


def test_units_of_the_regressors_do_not_matter():
    """Columns are scaled, so micrometres beside kilometres are no near collinearity."""
    y, u = random_system(np.random.default_rng(10), 2, 1, 1, 300)
    plain, units = arx(y, u, 2), arx(1e-9 * y, 1e9 * u, 2)
    scale = np.array([1.0, 1.0, 1e18])
    np.testing.assert_allclose(units.coefficients * scale, plain.coefficients, rtol=1e-10)
    np.testing.assert_allclose(units.stderr * scale, plain.stderr, rtol=1e-10)


# --- refusals -------------------------------------------------------------------------------------

Y, U = random_system(np.random.default_rng(3), 2, 1, 1, 200)


@pytest.mark.parametrize(
    ("change", "names", "says"),
    [
        ({"u": 0.0 * U}, {"b1"}, "b1 is not identifiable: its regressor is identically zero"),
        ({"u": np.ones_like(U), "intercept": True}, {"b1", "c"}, "is a linear combination of"),
        ({"u": np.ones_like(U), "nb": 2}, {"b1", "b2"}, "is a linear combination of"),
        ({"y": Y[:4], "u": U[:4], "nk": 5}, set(), "a run of 4 samples is too short for lags up"),
    ],
)
def test_data_that_identify_no_coefficient_are_refused(change, names, says):
    with pytest.raises(IdentificationError, match=says) as caught:
        arx(**{"y": Y, "u": U} | change)
    assert len(caught.value.parameters) == min(1, len(names))
    assert names.issuperset(caught.value.parameters)


def test_an_input_that_moves_once_is_told():
    """Negative control: one sample that differs is enough to tell two lags apart."""
    u = np.ones_like(U)
    u[100] += 1.0
    assert_same(arx(Y, u, nb=2), ols([(Y, u)], 1, 2, 1, False), rtol=1e-9)


# --- transfer functions ---------------------------------------------------------------------------


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
    for seed in range(12):
        noisy = v + np.random.default_rng([52, seed]).normal(0.0, 0.05, v.size)
        table = fit_transfer_function(u, noisy, T, order=model.order, noise="white").table()
        z.append((table["value"] - [model.gain, *model.denominator]) / table["stderr"])
    # Twelve leave a root mean square of one 20 % uncertain.
    assert (np.mean(np.square(z), axis=0) ** 0.5 < 1.5).all()
    assert 0.7 < np.mean(np.square(z)) ** 0.5 < 1.3


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


def test_remedies_for_a_transfer_function_are_arguments_that_it_has():
    """Values to hold and robust= were advised, which the function does not take."""
    u = np.repeat(np.random.default_rng(0).choice([-1.0, 1.0], 40), 50)
    with pytest.raises(IdentificationError, match=r"that move the model more$"):
        fit_transfer_function(u, 0.5 * u, 0.02, order=1)
    v = np.convolve(u, 0.02 * np.exp(-0.02 * np.arange(500)))[: u.size]
    v += 0.01 * np.random.default_rng(1).normal(size=u.size)
    v[::97] = 5.0
    for velocity, words in ((v, "they are left out."), (0.1 * v[::-1], "weakly determined")):
        message = fit_transfer_function(u, velocity, 0.02, order=1).message
        assert words in message
        assert not re.search(r"robust|fix", message)


def test_a_velocity_that_does_not_follow_the_command_is_no_success():
    u, v = flight("x", 0)
    fit = fit_transfer_function(u, np.random.default_rng(0).normal(0.0, 0.1, v.size), T, order=1)
    assert not fit.success
    assert fit.parameters.loc["gain", "status"] == "weak"
