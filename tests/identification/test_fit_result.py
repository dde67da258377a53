"""Tables, diagnostics and plots of a fit; statsmodels is the oracle of the residual tests."""

import numpy as np
import pandas as pd
import pytest
from statsmodels.stats.diagnostic import acorr_ljungbox
from statsmodels.stats.sandwich_covariance import S_hac_simple
from statsmodels.tsa.stattools import acf

import trustlab as tl
from trustlab.identification.problem import (
    autocorrelation,
    hac_matrix,
    pooled_correlation,
)


@pytest.fixture(scope="module")
def session(operators, make_session, switching):
    return make_session(operators["pilot"], switching, noise=0.003, seed=11)


def test_table_has_fixed_columns_and_named_rows(session):
    robot, human = tl.fit_robot(session).table(), tl.fit_human(session).table()
    for table in (
        robot,
        human,
        tl.fit_tsc(session).table(),
    ):
        assert list(table.columns) == ["value", "stderr", "ci_low", "ci_high", "unit", "status"]
        assert table.index.name == "parameter"
        assert table[["value", "stderr", "ci_low", "ci_high"]].dtypes.eq(float).all()
    assert list(robot.index) == ["a", "p_min", "p_max", "p_h_max", "b", "time_constant"]
    assert list(human.index) == ["a", "beta", "p_min", "p_max", "b", "time_constant"]
    wide = tl.fit_human(session).table(level=0.99)
    assert (
        (wide["ci_high"] - wide["ci_low"]) / (human["ci_high"] - human["ci_low"])
    ).to_numpy() == pytest.approx(1.3142, abs=1e-3)
    with pytest.raises(ValueError, match="level"):
        tl.fit_human(session).table(level=95)


def test_fit_percent_is_the_printed_formula(session):
    fit = tl.fit_robot(session)
    y, e = session["p_r"], fit.residuals()[0]
    assert fit.fit_percent == pytest.approx(
        100 * (1 - np.linalg.norm(e) / np.linalg.norm(y - y.mean())), abs=1e-12
    )
    assert fit.cost == pytest.approx(0.5 * np.sum(e**2), rel=1e-12)
    assert set(tl.fit_tsc(session).fit_percent.index) == {"p_h", "p_r"}


def test_fitted_output_is_the_model_simulated(session):
    fit = tl.fit_human(session)
    r0 = fit.initial_states["r0"].iloc[0]
    np.testing.assert_allclose(
        fit.runs[0].fitted["p_h"], fit.model.simulate(session["mode"], r0)[1], atol=1e-13
    )
    fit = tl.fit_robot(session)
    joint = tl.fit_tsc(session)
    p_h = joint.runs[0].fitted["p_h"]  # the fitted operator drives the robot
    p_r = fit.model.simulate(session["mode"], p_h, fit.initial_states["p_r0"].iloc[0])
    np.testing.assert_allclose(fit.runs[0].fitted["p_r"], p_r, atol=1e-9)


def test_correlations_and_whiteness(session):
    fit = tl.fit_human(session)
    correlations = fit.correlations()
    assert np.allclose(np.diag(correlations), 1.0)
    assert np.abs(correlations.to_numpy()).max() <= 1.0 + 1e-12
    oracle = acorr_ljungbox(fit.residuals()[0], lags=[25])
    assert fit.whiteness().loc["p_h", "statistic"] == pytest.approx(
        oracle["lb_stat"].iloc[0], rel=1e-10
    )
    assert fit.whiteness().loc["p_h", "p"] == pytest.approx(oracle["lb_pvalue"].iloc[0], rel=1e-8)
    frame = fit.residual_correlations(lags=10)
    assert list(frame.columns) == ["autocorrelation", "cross_correlation", "band"]
    np.testing.assert_allclose(
        frame.loc[0:, "autocorrelation"], acf(fit.residuals()[0], nlags=10), atol=1e-12
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
    alternating, opposite = np.r_[1.0, -1.0, 1.0, -1.0], np.r_[-1.0, 1.0, -1.0, 1.0]
    assert autocorrelation([alternating, opposite], 1)[1] == pytest.approx(-6.0 / 8.0)


def test_hac_matrix_is_newey_west():
    scores = np.random.default_rng(1).standard_normal((200, 3))
    np.testing.assert_allclose(hac_matrix(scores, 5), S_hac_simple(scores, nlags=5))
    by_hand = scores.T @ scores
    for lag in range(1, 6):
        term = scores[lag:].T @ scores[:-lag]
        by_hand += (1 - lag / 6) * (term + term.T)
    np.testing.assert_allclose(hac_matrix(scores, 5), by_hand, rtol=1e-10)


def test_plots_and_html_say_that_data_are_synthetic(session):
    import matplotlib.pyplot as plt

    fit = tl.fit_tsc(session)
    axes = fit.plot()
    assert axes.shape == (2, 1)
    assert "synthetic" in axes[0, 0].get_title()
    residual_axes = fit.plot_residuals()
    assert residual_axes.shape == (2, 2)
    assert "synthetic" in residual_axes[0, 0].figure.get_suptitle()
    plt.close("all")
    html = fit._repr_html_()
    assert "synthetic data" in html
    assert "robot_a" in html
    assert repr(fit).startswith("<TscModel, 1 run, 20000 samples")
    assert isinstance(fit.initial_states, pd.DataFrame)


@pytest.mark.parametrize(
    ("seeds", "margin"), [(50, 0.3), pytest.param(150, 0.2, marks=pytest.mark.long)]
)
def test_noise_of_the_measured_input_is_allowed_for(
    operators, make_session, switching, seeds, margin
):
    # The spread of estimates over seeds is what the standard errors say, input noise ten times that
    # of the output.
    model = operators["pilot"]
    z = []
    for seed in range(seeds):
        session = make_session(model, switching, noise=0.002, seed=seed)
        rng = np.random.default_rng(1000 + seed)
        noisy = session.with_columns(p_h=session["p_h"] + 0.03 * rng.standard_normal(len(session)))
        row = tl.fit_robot(noisy, p_h_max=model.robot.p_h_max, noise="white").table().loc["p_max"]
        z.append((row["value"] - model.robot.p_max) / row["stderr"])
    assert (
        abs(np.std(z) - 1.0) < margin
    )  # three sd of a standard deviation of so few, 1/√(2 seeds) each
    assert abs(np.mean(z)) < 0.5
