"""
The mixed model. Oracles: closed form (complete data), statsmodels' own search, brute force; nlme in
test_against_r.py.
"""

import warnings

import numpy as np
import pandas as pd
import pytest
from scipy import optimize
from statsmodels.regression.mixed_linear_model import MixedLM

import trustlab as tl
from trustlab.studies import mixed_model
from trustlab.studies.analysis.mixed_model import fit_mixed_model
from trustlab.studies.table import ScoreTable


def laid_out(values):
    n, k = values.shape
    return ScoreTable(values, tuple(range(n)), tuple(range(k)), "y", "c", "s")


def draw(n, k, subjects=1.0, seed=0):
    rng = np.random.default_rng(seed)
    return rng.standard_normal((n, k)) + subjects * rng.standard_normal((n, 1)) + 0.3 * np.arange(k)


@pytest.mark.parametrize(
    ("n", "k", "subjects"),
    [(24, 4, 1.0), (36, 5, 3.0), (12, 10, 1.0), (24, 4, 20.0), (24, 4, 300.0), (8, 2, 2.0)],
)
def test_complete_data_give_the_anova(n, k, subjects):
    """
    Closed form: with complete data and MS_subjects > MS_error, F, variances and df are the ANOVA's.
    """
    values = draw(n, k, subjects)
    found, batch = (
        fit_mixed_model(laid_out(values)),
        tl.repeated_measures_batch(values[None]).iloc[0],
    )
    error, between = batch.ss_error / batch.df2, batch.ss_subjects / (n - 1)
    assert between > error
    np.testing.assert_allclose([found.F, found.residual_variance], [batch.F, error], rtol=1e-6)
    np.testing.assert_allclose(found.subject_variance, (between - error) / k, rtol=2e-5)
    np.testing.assert_allclose(found.p, batch.p, rtol=1e-5)
    assert (found.df1, found.df2, found.singular, found.missing_cells) == (
        batch.df1,
        batch.df2,
        False,
        0,
    )
    np.testing.assert_allclose(found.means["mean"], values.mean(axis=0), rtol=1e-9, atol=1e-9)


def test_a_variance_of_zero_is_said():
    values = draw(12, 4, 0.0)
    values += (
        2.0 * (values.mean() - values.mean(axis=1, keepdims=True)) * 0.5
    )  # subjects' means nearly equal
    found, batch = (
        fit_mixed_model(laid_out(values)),
        tl.repeated_measures_batch(values[None]).iloc[0],
    )
    assert batch.ss_subjects / 11 < batch.ss_error / batch.df2
    assert found.singular
    assert found.subject_variance == found.icc == 0.0
    pooled = (batch.ss_subjects + batch.ss_error) / (11 + batch.df2)  # closed form: a one-way ANOVA
    np.testing.assert_allclose(found.F, batch.ss_effect / 3 / pooled, rtol=1e-10)


def test_statsmodels_own_search_finds_the_same():
    values = draw(15, 4)
    values[np.random.default_rng(1).random((15, 4)) < 0.2] = np.nan
    found = fit_mixed_model(laid_out(values))
    i, j = np.nonzero(~np.isnan(values))
    design = (j[:, None] == np.arange(4)).astype(float)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        fit = MixedLM(values[i, j], design, groups=i).fit(reml=True, method=["powell", "bfgs"])
    np.testing.assert_allclose(found.means["mean"], fit.fe_params, rtol=1e-5)
    np.testing.assert_allclose(
        [found.subject_variance, found.residual_variance], [fit.cov_re[0, 0], fit.scale], rtol=1e-4
    )


def test_missing_cells_by_brute_force():
    """
    Oracle: the restricted likelihood with dense matrices, minimized over both variances;
    generalized least squares.
    """
    values = draw(10, 3, seed=3)
    values[[0, 0, 4, 7], [0, 1, 2, 1]] = np.nan
    found = fit_mixed_model(laid_out(values))
    i, j = np.nonzero(~np.isnan(values))
    y, x = values[i, j], (j[:, None] == np.arange(3)).astype(float)
    same = (i[:, None] == i).astype(float)

    def restricted(log_variances):
        v = np.exp(log_variances[0]) * same + np.exp(log_variances[1]) * np.eye(y.size)
        inverse = np.linalg.inv(v)
        information = x.T @ inverse @ x
        error = y - x @ np.linalg.solve(information, x.T @ inverse @ y)
        return np.linalg.slogdet(v)[1] + np.linalg.slogdet(information)[1] + error @ inverse @ error

    best = optimize.minimize(
        restricted,
        [0.0, 0.0],
        method="Nelder-Mead",
        options={"xatol": 1e-9, "fatol": 1e-13, "maxiter": 4000},
    )
    np.testing.assert_allclose(
        [found.subject_variance, found.residual_variance], np.exp(best.x), rtol=1e-5
    )
    v = found.subject_variance * same + found.residual_variance * np.eye(y.size)
    covariance = np.linalg.inv(x.T @ np.linalg.solve(v, x))
    beta = covariance @ x.T @ np.linalg.solve(v, y)
    contrast = np.array([[1.0, -1.0, 0.0], [0.0, 1.0, -1.0]])
    effect = contrast @ beta
    chi2 = effect @ np.linalg.solve(contrast @ covariance @ contrast.T, effect)
    np.testing.assert_allclose(found.chi2, chi2, rtol=1e-6)
    np.testing.assert_allclose(found.means["mean"], beta, rtol=1e-7)
    np.testing.assert_allclose(found.means["se"], np.sqrt(np.diag(covariance)), rtol=1e-6)
    assert (found.n, found.cells, found.missing_cells, found.df2) == (10, 26, 4, 14)


def test_unit_and_offset_do_not_matter():
    values = draw(12, 4)
    values[3, 2] = np.nan
    one, two = fit_mixed_model(laid_out(values)), fit_mixed_model(laid_out(1e4 + 1e-3 * values))
    np.testing.assert_allclose([two.F, two.p, two.icc], [one.F, one.p, one.icc], rtol=1e-5)
    np.testing.assert_allclose(two.means["mean"], 1e4 + 1e-3 * one.means["mean"], rtol=1e-12)


def test_a_subject_without_any_score_does_not_count():
    values = draw(8, 3)
    more = np.vstack([values, np.full((1, 3), np.nan)])
    one, two = fit_mixed_model(laid_out(values)), fit_mixed_model(laid_out(more))
    assert (two.n, two.missing_cells, two.df2) == (8, 0, one.df2)
    np.testing.assert_allclose(two.F, one.F, rtol=1e-9)


def test_from_a_long_table():
    values = draw(6, 3)
    frame = (
        pd.DataFrame(values)
        .rename_axis("subject")
        .reset_index()
        .melt("subject", var_name="condition")
    )
    frame = frame.drop(index=[4])
    found = mixed_model(frame, dv="value", within="condition", subject="subject")
    assert found.missing_cells == 1
    assert found.means.index.tolist() == [0, 1, 2]
    assert found.table()["F"].item() == found.F
    assert "Mixed model" in found._repr_html_()


def test_bad_tables():
    values = draw(6, 3)
    one = values.copy()
    one[1:, 2] = np.nan
    with pytest.raises(ValueError, match=r"condition 2 has 1 score"):
        fit_mixed_model(laid_out(one))
    with pytest.raises(ValueError, match=r"2 subject\(s\) in column 's' have a score"):
        fit_mixed_model(laid_out(values[:2]))
    alone = np.full((6, 3), np.nan)
    alone[np.arange(6), np.arange(6) % 3] = 1.0 + np.arange(6)
    with pytest.raises(ValueError, match="leave nothing to estimate"):
        fit_mixed_model(laid_out(alone))
    with pytest.raises(ValueError, match="no error variance"):
        fit_mixed_model(laid_out(np.full((6, 3), 2.0)))
    exact = 0.1 * np.arange(6)[:, None] + 0.7 * np.arange(3)
    exact[2, 1] = np.nan
    with pytest.raises(ValueError, match="column 'y' has no error variance"):
        fit_mixed_model(laid_out(exact))
    frame = pd.DataFrame({"s": [1, 1], "c": ["a", "b"], "y": ["1", "2"]})
    with pytest.raises(ValueError, match="holds '1' for subject 1, condition 'a'"):
        mixed_model(frame, "y", "c", "s")
