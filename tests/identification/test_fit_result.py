"""Tables, diagnostics and plots of a fit; statsmodels is the oracle of the residual tests."""

import matplotlib.pyplot as plt
import numpy as np
import pytest
from statsmodels.stats.diagnostic import acorr_ljungbox
from statsmodels.stats.sandwich_covariance import S_hac_simple
from statsmodels.tsa.stattools import acf

import trustlab as tl
from tests.identification import cases
from trustlab.identification.noise import Noise, fitted_noise, hac_matrix, pooled_correlation


@pytest.fixture(scope="module")
def session():
    return cases.session(seed=11)


@pytest.fixture(scope="module")
def fits(session):
    return tl.fit_robot(session), tl.fit_human(session), tl.fit_tsc(session)


def test_table_has_fixed_columns_and_named_rows(fits):
    for fit in fits:
        table = fit.table()
        assert list(table.columns) == ["value", "stderr", "ci_low", "ci_high", "unit", "status"]
        assert table.index.name == "parameter"
    assert list(fits[0].table().index) == ["a", "p_min", "p_max", "p_h_max", "b", "time_constant"]
    assert list(fits[1].table().index) == ["a", "beta", "p_min", "p_max", "b", "time_constant"]
    narrow, wide = (np.ptp(fits[1].table(x)[["ci_low", "ci_high"]], axis=1) for x in (0.95, 0.99))
    np.testing.assert_allclose(wide / narrow, 1.3142, atol=1e-3)


def test_fit_percent_is_the_printed_formula(session, fits):
    robot, _, joint = fits
    y, e = session["p_r"], robot.residuals()[0]
    assert robot.fit_percent == pytest.approx(
        100 * (1 - np.linalg.norm(e) / np.linalg.norm(y - y.mean())), abs=1e-12
    )
    assert robot.cost == pytest.approx(0.5 * np.sum(e**2), rel=1e-12)
    assert set(joint.fit_percent.index) == {"p_h", "p_r"}


def test_dropouts_that_are_left_out_do_not_count_in_the_percentage(session, fits):
    """Oracle: the printed formula on the samples that were kept."""
    p_r = session["p_r"].copy()
    lost = np.random.default_rng(0).choice(p_r.size, p_r.size // 100, replace=False)
    p_r[lost] = 0.0
    fit = tl.fit_robot(session.with_columns(p_r=p_r))
    y, e = (np.delete(values, lost) for values in (p_r, fit.residuals()[0]))
    percent = 100 * (1 - np.linalg.norm(e) / np.linalg.norm(y - y.mean()))
    assert fit.fit_percent == pytest.approx(percent, abs=0.1)
    assert fit.fit_percent == pytest.approx(fits[0].fit_percent, abs=0.5)


def test_fitted_output_is_the_model_simulated(session, fits):
    robot, human, joint = fits
    r0, p_r0 = human.initial_states["r0"].iloc[0], robot.initial_states["p_r0"].iloc[0]
    p_h = human.model.simulate(session["mode"], r0)[1]
    np.testing.assert_allclose(human.runs[0].fitted["p_h"], p_h, atol=1e-13)
    # The fitted operator drives the robot.
    p_r = robot.model.simulate(session["mode"], joint.runs[0].fitted["p_h"], p_r0)
    np.testing.assert_allclose(robot.runs[0].fitted["p_r"], p_r, atol=1e-9)


def test_correlations_and_whiteness(fits):
    fit = fits[1]
    correlations = fit.correlations()
    assert np.allclose(np.diag(correlations), 1.0)
    assert np.abs(correlations.to_numpy()).max() <= 1.0 + 1e-12
    residuals = fit.residuals()[0]
    oracle = acorr_ljungbox(residuals, lags=[25]).iloc[0]
    np.testing.assert_allclose(fit.whiteness().loc["p_h", ["statistic", "p"]], oracle, rtol=1e-8)
    frame = fit.residual_correlations(lags=10)
    assert list(frame.columns) == ["autocorrelation", "cross_correlation", "band"]
    np.testing.assert_allclose(
        frame.loc[0:, "autocorrelation"], acf(residuals, nlags=10), atol=1e-12
    )
    assert frame["band"].iloc[0] == pytest.approx(2.5758293 / np.sqrt(20_000))


def test_cross_correlation_has_its_lag_the_right_way_round():
    u = np.random.default_rng(0).standard_normal(4000)
    e = np.r_[np.zeros(3), u[:-3]]
    rho = pooled_correlation([e], [u], 5)
    assert np.argmax(np.abs(rho)) == 3
    assert rho[3] == pytest.approx(1.0, abs=0.01)
    assert np.abs(pooled_correlation([u], [e], 5)).max() < 0.1


def test_no_product_crosses_from_run_to_run():
    runs = [np.r_[1.0, -1.0, 1.0, -1.0], np.r_[-1.0, 1.0, -1.0, 1.0]]
    rho = pooled_correlation(runs, runs, 5)
    np.testing.assert_allclose(rho[[1, 4, 5]], [-6.0 / 8.0, 0.0, 0.0])


def test_the_noise_is_where_its_likelihood_is_greatest():
    def products(noise):
        off = np.log((1.0 - noise.memory) / 0.05) ** 2 + (noise.share - 0.3) ** 2
        return np.diag([np.exp(off), 1.0]), 0.0

    found = fitted_noise(products, 1000.0, Noise())
    assert (found.memory, found.share) == pytest.approx((0.95, 0.3), abs=0.01)


def test_hac_matrix_is_newey_west():
    scores = np.random.default_rng(1).standard_normal((200, 3))
    np.testing.assert_allclose(hac_matrix(scores, 5), S_hac_simple(scores, nlags=5))


def test_plots_and_html_say_that_data_are_synthetic(fits):
    fit = fits[2]
    axes, residual_axes = fit.plot(), fit.plot_residuals()
    assert axes.shape == (2, 1)
    assert "synthetic" in axes[0, 0].get_title()
    assert residual_axes.shape == (2, 2)
    assert "99 % bands, synthetic" in residual_axes[0, 0].figure.get_suptitle()
    assert residual_axes[0, 0].get_legend() is None  # which would cover residuals
    plt.close("all")
    html = fit._repr_html_()
    assert "synthetic data" in html
    assert "robot_a" in html
    assert repr(fit).startswith("<TscModel, 1 run, 20000 samples")
