"""Tables, diagnostics and plots of a fit; statsmodels is the oracle of the residual tests."""

import matplotlib.pyplot as plt
import numpy as np
import pytest
from numpy.random import default_rng
from numpy.testing import assert_allclose
from pytest import approx
from statsmodels.stats.diagnostic import acorr_ljungbox
from statsmodels.stats.sandwich_covariance import S_hac_simple
from statsmodels.tsa.stattools import acf

import trustlab as tl
from tests.identification import cases
from trustlab import fit_robot
from trustlab.identification.log import Noise, fitted_noise, hac_matrix, pooled_correlation


@pytest.fixture(scope="module")
def session():
    return cases.session(seed=11)


@pytest.fixture(scope="module")
def fits(session):
    return fit_robot(session), tl.fit_human(session), tl.fit_tsc(session)


def test_a_table_has_intervals_of_any_level(fits):
    table, wider = (fits[1].table(level)[["ci_low", "ci_high"]] for level in (0.95, 0.99))
    assert_allclose(np.ptp(wider, axis=1) / np.ptp(table, axis=1), 1.3142, atol=1e-3)


def percent(y, fit, kept):
    """The printed formula, on the samples that were kept."""
    y, e = y[kept], fit.residuals()[0][kept]
    return 100 * (1 - np.linalg.norm(e) / np.linalg.norm(y - y.mean()))


def test_dropouts_that_are_left_out_do_not_count_in_the_percentage(session, fits):
    robot, p_r = fits[0], session["p_r"].copy()
    kept = default_rng(0).random(p_r.size) > 0.01
    assert robot.fit_percent == approx(percent(p_r, robot, p_r > 0.0), abs=1e-12)
    p_r[~kept] = 0.0
    fit = fit_robot(session.with_columns(p_r=p_r))
    assert "dropouts?" in fit.message
    assert fit.fit_percent == approx(percent(p_r, fit, kept), abs=0.1)
    assert fit.fit_percent == approx(robot.fit_percent, abs=0.5)


def test_correlations_and_whiteness(fits):
    fit = fits[1]
    correlations = fit.correlations()
    assert_allclose(np.diag(correlations), 1.0)
    assert np.linalg.eigvalsh(correlations).min() > 0.0
    residuals = fit.residuals()[0]
    oracle = acorr_ljungbox(residuals, lags=[25]).iloc[0]
    assert_allclose(fit.whiteness().loc["p_h", ["statistic", "p"]], oracle, rtol=1e-8)
    frame = fit.residual_correlations(lags=10)
    assert_allclose(frame["autocorrelation"][10:], acf(residuals, nlags=10), atol=1e-12)
    assert frame["band"][0] == approx(2.5758293 / np.sqrt(20_000))


def test_cross_correlation_has_its_lag_the_right_way_round():
    u = default_rng(0).standard_normal(4000)
    e = np.r_[np.zeros(3), u[:-3]]
    rho = pooled_correlation([e], [u], 5)
    assert np.argmax(np.abs(rho)) == 3
    assert rho[3] == approx(1.0, abs=0.01)
    assert np.abs(pooled_correlation([u], [e], 5)).max() < 0.1


def test_no_product_crosses_from_run_to_run():
    runs = [np.r_[1.0, -1.0, 1.0, -1.0], np.r_[-1.0, 1.0, -1.0, 1.0]]
    rho = pooled_correlation(runs, runs, 5)
    assert_allclose(rho[[1, 4, 5]], [-6.0 / 8.0, 0.0, 0.0])


def test_the_noise_is_where_its_likelihood_is_greatest():
    def products(noise):
        off = np.log((1.0 - noise.memory) / 0.05) ** 2 + (noise.share - 0.3) ** 2
        return np.diag([np.exp(off), 1.0]), 0.0

    found = fitted_noise(products, 1000.0, Noise())
    assert (found.memory, found.share) == approx((0.95, 0.3), abs=0.01)


def test_hac_matrix_is_newey_west():
    scores = default_rng(1).standard_normal((200, 3))
    assert_allclose(hac_matrix(scores, 5), S_hac_simple(scores, nlags=5))


def test_plots_and_html_say_that_data_are_synthetic(fits):
    fit = fits[2]
    axes = fit.plot_residuals()
    assert "synthetic" in fit.plot()[0, 0].get_title()
    assert "99 % bands, synthetic" in axes[0, 0].figure.get_suptitle()
    assert axes[0, 0].get_legend() is None  # which would cover residuals
    plt.close("all")
    html = fit._repr_html_()
    assert "synthetic data" in html
    assert "robot_a" in html
    assert repr(fit).startswith("<TscModel, 1 run, 20000 samples")
