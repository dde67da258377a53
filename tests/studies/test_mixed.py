"""
Mixed models with a random intercept. Oracles: closed form (complete data), statsmodels' own
search, brute force, the ANOVA, lme4 on published data (reference/formula_model.R); nlme in
test_against_r.py.
"""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy import optimize

import trustlab as tl
from trustlab.studies import mixed_model
from trustlab.studies.mixed import RandomIntercepts, fit_mixed_model
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
    found, batch = fit_mixed_model(laid_out(values)), tl.repeated_measures_batch(values[None])
    batch = batch.iloc[0]
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
    found, batch = fit_mixed_model(laid_out(values)), tl.repeated_measures_batch(values[None])
    batch = batch.iloc[0]
    assert batch.ss_subjects / 11 < batch.ss_error / batch.df2
    assert found.singular
    assert found.subject_variance == found.icc == 0.0
    pooled = (batch.ss_subjects + batch.ss_error) / (11 + batch.df2)  # closed form: a one-way ANOVA
    np.testing.assert_allclose(found.F, batch.ss_effect / 3 / pooled, rtol=1e-10)


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


def test_bad_tables():
    values = draw(6, 3)
    with pytest.raises(ValueError, match=r"subject: column 's' has 2 groups with scores"):
        fit_mixed_model(laid_out(values[:2]))
    alone = np.full((6, 3), np.nan)
    alone[np.arange(6), np.arange(6) % 3] = 1.0 + np.arange(6)
    with pytest.raises(ValueError, match="no error variance"):
        fit_mixed_model(laid_out(alone))
    with pytest.raises(ValueError, match="no error variance"):
        fit_mixed_model(laid_out(np.full((6, 3), 2.0)))
    exact = 0.1 * np.arange(6)[:, None] + 0.7 * np.arange(3)
    exact[2, 1] = np.nan
    with pytest.raises(ValueError, match="dv or formula: the scores have no error variance"):
        fit_mixed_model(laid_out(exact))
    frame = pd.DataFrame({"s": [1, 1], "c": ["a", "b"], "y": ["1", "2"]})
    with pytest.raises(ValueError, match="holds '1' for subject 1, condition 'a'"):
        mixed_model(frame, "y", "c", "s")


def grouped(sizes=(6, 8), seed=3, within=("condition",)):
    """Scores of two groups in all cells of within-subject factors with levels a, b, c."""
    rng = np.random.default_rng(seed)
    n = sum(sizes)
    levels = [range(n), *[list("abc")] * len(within)]
    frame = pd.MultiIndex.from_product(levels, names=["person", *within]).to_frame(index=False)
    frame["group"] = np.where(frame["person"] < sizes[0], "novice", "expert")
    people = 2.0 * rng.standard_normal(n)[frame["person"]]
    frame["score"] = people + rng.standard_normal(len(frame)) + (frame[within[0]] == "c")
    return frame


GROUPED = {"dv": "score", "within": "condition", "subject": "person", "between": "group"}


def test_groups_with_missing_cells_by_brute_force():
    """
    Oracle: dense generalized least squares on effects that sum to zero, at the model's variances;
    nlme's containment degrees of freedom.
    """
    frame = grouped().drop(index=[4, 17, 40])
    model = tl.mixed_model(frame, **GROUPED)
    condition = np.vstack([np.eye(2), -np.ones(2)])[pd.factorize(frame["condition"])[0]]
    group = np.where(frame["group"] == "expert", 1.0, -1.0)[:, None]
    x = np.column_stack([np.ones(len(frame)), group, condition, group * condition])
    same = (frame["person"].to_numpy()[:, None] == frame["person"].to_numpy()) * 1.0
    v = model.subject_variance * same + model.residual_variance * np.eye(len(frame))
    covariance = np.linalg.inv(x.T @ np.linalg.solve(v, x))
    beta = covariance @ x.T @ np.linalg.solve(v, frame["score"].to_numpy())
    table = model.table().set_index("effect")
    columns = {"group": [1], "condition": [2, 3], "group × condition": [4, 5]}
    for effect, at in columns.items():
        chi2 = beta[at] @ np.linalg.solve(covariance[np.ix_(at, at)], beta[at])
        assert table.loc[effect, "chi2"] == pytest.approx(chi2, rel=1e-9)
    assert table["df2"].tolist() == [14 - 2, 39 - 14 - 4, 39 - 14 - 4]
    eta = table["F"] * table["df1"] / (table["F"] * table["df1"] + table["df2"])
    np.testing.assert_allclose(table["eta2_partial"], eta)
    low, high = table.loc["condition", ["eta2_partial_low", "eta2_partial_high"]]
    assert low < eta["condition"] < high
    # a − c, at experts: over the interaction's coding.
    pair = model.pairs(at="group").set_index(["level", "a", "b"]).loc[("expert", "a", "c")]
    contrast = np.array([0.0, 0.0, 2.0, 1.0, 2.0, 1.0])
    assert pair["mean_difference"] == pytest.approx(contrast @ beta)
    assert pair["t"] == pytest.approx(contrast @ beta / np.sqrt(contrast @ covariance @ contrast))
    assert pair["d_z"] == pytest.approx(contrast @ beta / np.sqrt(2 * model.residual_variance))


def test_pairs():
    """Without missing cells they are t-tests with the pooled error of the ANOVA."""
    frame = grouped()
    model = tl.mixed_model(frame, **GROUPED)
    pairs = model.pairs()
    means = frame.groupby(["group", "condition"])["score"].mean().groupby("condition").mean()
    np.testing.assert_allclose(pairs["mean_difference"][0], means["a"] - means["b"])
    se = np.sqrt(2.0 * model.residual_variance * (1 / 6 + 1 / 8) / 4)
    np.testing.assert_allclose(pairs["mean_difference"] / pairs["t"], se)
    assert pairs["df"].unique().tolist() == [24]
    assert pairs["p_holm"].to_numpy() == pytest.approx(tl.studies.holm(pairs["p"].to_numpy()))
    between = model.pairs("group")
    assert between["df"].item() == 12
    assert np.isnan(between["d_z"].item())
    assert np.isfinite(between["d_av"].item())
    with pytest.raises(ValueError, match="'task' is not a factor of this design"):
        model.pairs("task")
    with pytest.raises(ValueError, match="factor and at are both"):
        model.pairs("group", at="group")


def test_intervals_of_d_z_are_those_of_the_analysis_of_variance():
    """Oracle: pooled pairs of complete scores without groups, where both models are the same."""
    frame = grouped()
    columns = {"dv": "score", "within": "condition", "subject": "person"}
    ours = tl.mixed_model(frame, **columns).pairs()
    other = tl.repeated_measures(frame, **columns).pairs(error="pooled")
    for name in ("d_z", "d_z_low", "d_z_high"):
        np.testing.assert_allclose(ours[name], other[name], rtol=1e-5)
    between = tl.mixed_model(frame, **GROUPED).pairs("group")
    assert between[["d_z", "d_z_low", "d_z_high"]].isna().all(axis=None)


def test_the_call_that_an_error_recommends_works_as_typed():
    frame = grouped().drop(index=[4, 17, 40])
    with pytest.raises(ValueError, match=r"missing cells.*tl\.mixed_model with the same arguments"):
        tl.repeated_measures(frame, **GROUPED)
    model = tl.mixed_model(frame, **GROUPED)
    assert model.missing_cells == 3
    assert model.table()["effect"].tolist() == ["group", "condition", "group × condition"]
    assert "(N = 14, 3 cells missing): group was not significant, F(1, 12)" in model.apa()
    one = tl.mixed_model(grouped().drop(index=[4]), **GROUPED)
    assert "(N = 14, 1 cell missing)" in one.apa()
    assert model.apa() in tl.report(model).message
    with pytest.raises(AttributeError, match="a row per effect"):
        _ = model.F


# Models by formula.

SETS = json.loads((Path(__file__).parents[0] / "reference" / "formula_model.json").read_text())[
    "sets"
]


def trials(seed=0, n=8, effect=0.0):
    rng = np.random.default_rng(seed)
    frame = pd.DataFrame(
        {
            "who": np.repeat(range(n), 6),
            "mode": ["A", "B", "C"] * (2 * n),
            "trial": np.tile(range(6), n) * 1.0,
        }
    )
    score = (
        rng.standard_normal(len(frame))
        + rng.standard_normal(n).repeat(6)
        + effect * (frame["mode"] == "C")
    )
    return frame.assign(error=score)


@pytest.mark.parametrize("name", SETS)
def test_formula_model_agrees_with_lme4(name):
    reference = SETS[name]
    fit = tl.formula_model(
        reference["formula"],
        pd.DataFrame(reference["data"]),
        groups=reference["groups"],
    )
    assert fit.log_likelihood == pytest.approx(reference["log_likelihood"], abs=1e-9)
    assert fit.singular == reference["singular"]
    table = fit.table().set_index("term")
    for test in reference["tests"]:
        row = table.loc[test["term"]]
        assert row["df"] == test["df"]
        assert row["chi2"] == pytest.approx(test["chi2"], abs=1e-7)
        assert row["p_chi2"] == pytest.approx(test["p"], rel=1e-7)
    coefficients = fit.coefficients_table()
    np.testing.assert_allclose(coefficients["estimate"], reference["estimate"], rtol=1e-8)
    np.testing.assert_allclose(coefficients["se"], reference["se"], rtol=1e-6)
    np.testing.assert_allclose(fit.random_effects()["variance"], reference["variances"], rtol=1e-5)


def test_bootstrap():
    """Same seed, same p; an effect is found; the p is a share of draws."""
    first, again = (
        tl.formula_model("error ~ mode", trials(effect=1.5), groups="who", bootstrap=19, seed=3)
        for _ in range(2)
    )
    pd.testing.assert_frame_equal(first.table(), again.table())
    assert first.table()["p_bootstrap"].item() == pytest.approx(0.05)
    none = tl.formula_model("error ~ mode", trials(1), groups="who", bootstrap=19, seed=3).table()
    assert none["p_bootstrap"].item() > 0.05
    assert "19 simulated data sets" in first._repr_html_()


@pytest.mark.parametrize(
    ("change", "arguments", "message"),
    [
        (lambda f: f, {"formula": "error ~ modes"}, "formula 'error ~ modes'.*modes"),
        (lambda f: f, {"groups": "whom"}, "groups: no column 'whom'; did you mean 'who'"),
        (lambda f: f.assign(error=1.0), {}, "no error variance"),
        (lambda f: None, {}, "data must be of class DataFrame"),
    ],
)
def test_bad_models_are_refused(change, arguments, message):
    options = {"formula": "error ~ mode", "groups": "who"} | arguments
    with pytest.raises(ValueError, match=message):
        tl.formula_model(options.pop("formula"), change(trials()), **options)


def test_drawn_scores_have_the_fitted_variances():
    model = RandomIntercepts("subject", pd.Series(np.repeat(np.arange(4000), 3)))
    x = np.tile(np.eye(3), (4000, 1))
    rng = np.random.default_rng(0)
    y = x @ [1.0, 2.0, 3.0] + rng.standard_normal(4000).repeat(3) + 2.0 * rng.standard_normal(12000)
    drawn = model.fit(model.draw(model.fit(y, x), x, rng), x)
    np.testing.assert_allclose(drawn.beta, [1.0, 2.0, 3.0], atol=0.15)
    assert drawn.residual == pytest.approx(4.0, abs=0.3)
    assert drawn.ratio == pytest.approx(0.25, abs=0.06)


def labels_missing():
    """72 trials, 11 without the label of their condition."""
    rng = np.random.default_rng(0)
    frame = pd.DataFrame({"who": np.repeat(range(12), 6), "c": ["A", "B"] * 36})
    frame["y"] = rng.standard_normal(72) + 0.9 * (frame["c"] == "B")
    frame.loc[frame.index[frame["c"] == "B"][:11], "c"] = None
    return frame


@pytest.mark.parametrize("kind", [object, "category", "str"])
def test_a_missing_label_is_not_the_reference_level(kind):
    frame = labels_missing().astype({"c": kind})
    with pytest.raises(ValueError, match=r"data: 11 rows have a missing .* row 1 first"):
        tl.formula_model("y ~ c", frame, groups="who")
    complete = frame.dropna()
    tl.formula_model("y ~ c", complete, groups="who")
    ratings = frame.assign(y=np.digitize(frame["y"], [0.0, 1.0]))
    with pytest.raises(ValueError, match="within: column 'c' has no label in row 1"):
        tl.ordinal_model(ratings, "y", "c", "who")


def test_a_positive_variance_is_not_reported_as_zero():
    """
    Balanced data: the restricted likelihood's variance is the ANOVA's, in closed form. A search
    that began at a ratio of variances of zero, where the slope by its root vanishes, stayed there.
    """
    rng = np.random.default_rng(0)
    n, k = 8, 3
    frame = pd.DataFrame({"who": np.repeat(range(n), k), "c": np.tile(list("abc"), n)})
    positive = 0
    for _ in range(300):
        scores = rng.standard_normal((n, k)) + 0.3 * rng.standard_normal((n, 1))
        people = k * scores.mean(axis=1).var(ddof=1)
        rest = scores - scores.mean(axis=1, keepdims=True) - scores.mean(axis=0) + scores.mean()
        error = (rest**2).sum() / (n - 1) / (k - 1)
        model = tl.formula_model("y ~ c", frame.assign(y=scores.ravel()), groups="who")
        variance = model.random_effects()["variance"][0]
        expected = max(people - error, 0.0) / k
        positive += expected > 0.0
        assert model.singular == (expected == 0.0)
        assert variance == pytest.approx(expected, rel=1e-7, abs=1e-12)
    assert 100 < positive < 250
