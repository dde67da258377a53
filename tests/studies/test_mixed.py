"""
Mixed models with a random intercept. Oracles: closed form (complete data), dense matrices and a
search without slopes, the ANOVA, lme4 on published data (reference/formula_model.R); nlme in
test_against_r.py.
"""

import re

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose
from pandas.testing import assert_frame_equal
from scipy import optimize, stats
from statsmodels.tools.numdiff import approx_fprime, approx_hess

import trustlab as tl
from tests.cases import refused
from tests.studies.scores import COLUMNS, approx, drawn, long, parametrize, reference

SETS = reference("formula_model")["sets"]
GROUPED = COLUMNS | {"between": "group"}
BOTH = tl.repeated_measures, tl.mixed_model


@parametrize(
    ("n", "k", "people", "studies"),
    [(8, 3, 0.3, 30), (24, 4, 1.0, 1), (12, 10, 1.0, 1), (24, 4, 300.0, 1), (8, 2, 2.0, 1)],
)
def test_complete_data_give_the_anova(n, k, people, studies):
    """
    Closed form: F and variances are the ANOVA's, or those of a one-way ANOVA where people vary no
    more than errors. A search that began at a ratio of variances of zero, where the slope by its
    root vanishes, stayed there.
    """
    rng = np.random.default_rng(0)
    positive = 0
    for _ in range(studies):
        values = rng.standard_normal((n, k)) + people * rng.standard_normal((n, 1))
        anova, found = (test(long(values), **COLUMNS) for test in BOTH)
        df1, df2, ss_subjects, ss_error = k - 1, anova.df2, anova.ss_subjects, anova.ss_error
        error = ss_error / df2
        variance = max(ss_subjects / (n - 1) - error, 0.0) / k
        positive += variance > 0.0
        residual = error if variance else (ss_subjects + ss_error) / (n - 1 + df2)
        f = anova.ss_effect / df1 / residual
        numbers = [found.F, found.p, found.residual_variance, found.subject_variance, found.icc]
        share = variance / (variance + residual)
        expected = [f, stats.f.sf(f, df1, df2), residual, variance, share]
        assert_allclose(numbers, expected, rtol=2e-5 if people > 100.0 else 1e-6)
        assert (found.df1, found.df2, found.singular) == (df1, df2, not variance)
        assert_allclose(found.means["mean"], values.mean(axis=0), rtol=1e-9, atol=1e-9)
    assert positive == studies or 0.3 * studies < positive < 0.85 * studies


def restricted(variances, x, frame):
    """
    Twice the negative restricted log-likelihood of scores by dense matrices, the coefficients by
    generalized least squares, and their covariance.
    """
    y, person = frame["score"].to_numpy(), frame["person"].to_numpy()
    v = variances[0] * (person[:, None] == person) + variances[1] * np.eye(y.size)
    covariance = np.linalg.inv(x.T @ np.linalg.solve(v, x))
    beta = covariance @ x.T @ np.linalg.solve(v, y)
    error = y - x @ beta
    deviance = np.linalg.slogdet(v)[1] - np.linalg.slogdet(covariance)[1]
    return deviance + error @ np.linalg.solve(v, error), beta, covariance


def test_groups_with_missing_cells_by_brute_force():
    """
    Oracle: the restricted likelihood with dense matrices, minimized over both variances;
    generalized least squares on effects that sum to zero; nlme's containment degrees of freedom.
    """
    frame = drawn(14, seed=3).drop(index=[4, 17, 40])
    model = tl.mixed_model(frame, **GROUPED)
    modes = np.vstack([np.eye(2), -np.ones(2)])
    cells = np.array([[1.0, g, *c, *(g * c)] for g in (1.0, -1.0) for c in modes])
    x = cells[3 * (frame["group"] == "novice") + pd.factorize(frame["mode"])[0]]
    best = optimize.fmin(
        lambda logs: restricted(np.exp(logs), x, frame)[0], [0.0, 0.0], xtol=1e-9, ftol=1e-13
    )
    variances = [model.subject_variance, model.residual_variance]
    assert_allclose(variances, np.exp(best), rtol=1e-5)
    _, beta, covariance = restricted(variances, x, frame)
    assert_allclose(model.means["mean"], cells @ beta, rtol=1e-7)
    assert_allclose(model.means["se"] ** 2, np.diag(cells @ covariance @ cells.T))
    table = model.table().set_index("effect")
    for effect, at in {"group": [1], "mode": [2, 3], "group × mode": [4, 5]}.items():
        chi2 = beta[at] @ np.linalg.solve(covariance[np.ix_(at, at)], beta[at])
        assert table.loc[effect, "chi2"] == approx(chi2, rel=1e-9)
    assert table["df2"].tolist() == [14 - 2, 39 - 14 - 4, 39 - 14 - 4]
    assert (model.n, model.cells, model.missing_cells) == (14, 39, 3)
    pair = model.pairs(at="group").set_index(["level", "a", "b"]).loc[("expert", "a", "c")]
    contrast = cells[0] - cells[2]
    difference, between, within = contrast @ beta, *variances
    spreads = (contrast @ covariance @ contrast, 2 * within, between + within)
    found = pair[["mean_difference", "t", "d_z", "d_av", "df"]].astype(float)
    assert_allclose(found, [difference, *(difference / np.sqrt(spreads)), 39 - 14 - 4])
    assert pair["d_z_low"] < pair["d_z"] < pair["d_z_high"]


def test_the_call_that_an_error_recommends_works_as_typed():
    frame = drawn(14, seed=3).drop(index=[4, 17, 40])
    with refused("missing cells") as error:
        tl.repeated_measures(frame, **GROUPED, correction="none", alpha=0.01)
    call = re.search(r"tl\.mixed_model\(.*\)(?=, which)", str(error.value)).group()
    model = eval(call, {"tl": tl, "frame": frame})
    assert "(N = 14, 3 cells missing): group was not significant, F(1, 12)" in model.apa()
    with pytest.raises(AttributeError, match="a row per effect"):
        _ = model.F


def test_who_has_no_score_is_named():
    """They were dropped in silence; a variance of zero was not in the sentence either."""
    frame = drawn(14, seed=3).assign(score=lambda f: f["score"].where(f["person"] != 5))
    model = tl.mixed_model(frame, **COLUMNS)
    assert model.apa().endswith("Left out for missing scores: 1 participant (5).")
    alike = tl.mixed_model(drawn(14, people=0.0, seed=1), **COLUMNS)
    for each in (model, alike):
        said = "The variance between subjects is estimated as zero." in each.apa()
        assert said == each.singular == (each is alike)


@parametrize("at", ["mode", "task"])
def test_groups_at_one_level_have_the_degrees_of_freedom_of_satterthwaite(at):
    """
    They had those of the group's mean. Oracle: the restricted likelihood of both variances with
    dense matrices, and its second derivatives.
    """
    frame = drawn(11, seed=4, mode="abc", task="xy")
    model = tl.mixed_model(frame, **GROUPED | {"within": ["mode", "task"]})
    groups = frame.groupby(["group", "mode", "task"])
    x, cells = np.eye(12)[groups.ngroup()], groups.size().index.to_frame()
    contrast = np.where(cells["group"] == "expert", 1.0, -1.0) * (cells[at] == cells[at].iloc[0])
    contrast /= contrast.abs().sum() / 2.0

    def variance(variances):
        return contrast @ restricted(variances, x, frame)[2] @ contrast

    best = np.array([model.subject_variance, model.residual_variance])
    information = 0.5 * approx_hess(best, lambda variances: restricted(variances, x, frame)[0])
    slope = approx_fprime(best, variance, centered=True)
    expected = 2.0 * variance(best) ** 2 / (slope @ np.linalg.solve(information, slope))
    pair = model.pairs("group", at=at).iloc[0]
    assert (pair["mean_difference"] / pair["t"]) ** 2 == approx(variance(best))
    assert pair["df"] == approx(expected, rel=1e-4)


def test_effects_and_groups_without_missing_cells_are_those_of_the_anova():
    """With groups intervals took another number of scores for the noncentrality."""
    frame = drawn(11, seed=4)
    anova = tl.repeated_measures(frame, **GROUPED, correction="none")
    model = tl.mixed_model(frame, **GROUPED)
    names = ["effect", "df1", "df2", "F", "eta2_partial", "eta2_partial_low", "eta2_partial_high"]
    assert_frame_equal(model.table()[names], anova.table()[names], check_dtype=False)
    of_groups = anova.pairs("group").drop(columns="level")
    assert_frame_equal(model.pairs("group")[of_groups.columns], of_groups)


def test_scores_without_an_error_are_refused():
    exact = long(0.1 * np.arange(6)[:, None] + 0.7 * np.arange(3)).drop(index=7)
    with refused("dv or formula: the scores leave no error variance"):
        tl.mixed_model(exact, **COLUMNS)
    with refused("subject or groups: 2 groups with scores"):
        tl.mixed_model(exact[:6], **COLUMNS)


# Models by formula.


@parametrize("name", SETS)
def test_formula_model_agrees_with_lme4(name):
    own = SETS[name]
    fit = tl.formula_model(own["formula"], pd.DataFrame(own["data"]), groups=own["groups"])
    assert fit.log_likelihood == approx(own["log_likelihood"], abs=1e-9)
    assert fit.singular == own["singular"]
    table = fit.table().set_index("term")
    for test in own["tests"]:
        row = table.loc[test["term"]]
        assert row["df"] == test["df"]
        assert row["chi2"] == approx(test["chi2"], abs=1e-7)
        assert row["p_chi2"] == approx(test["p"], rel=1e-7)
    coefficients = fit.coefficients_table()
    assert_allclose(coefficients["estimate"], own["estimate"], rtol=1e-8)
    assert_allclose(coefficients["se"], own["se"], rtol=1e-6)
    assert_allclose(fit.random_effects()["variance"], own["variances"], rtol=1e-5)


@parametrize("kind", [object, "category", "str", "string"])
def test_a_missing_label_is_not_the_reference_level(kind):
    """72 trials, 11 without the label of their mode."""
    frame = drawn(12, mode="ab", trial="xyz").assign(rating=[0, 1, 2, 1] * 18)
    frame.loc[frame.index[frame["mode"] == "b"][:11], "mode"] = None
    frame = frame.astype({"mode": kind})
    with refused(r"data: 11 rows have a missing .* row 3 first"):
        tl.formula_model("score ~ mode", frame, "person")
    with refused("within: column 'mode' has nothing in row 3"):
        tl.ordinal_model(frame, "rating", "mode", "person")


@parametrize("formula", ["y ~ a * b", "y ~ I(a**2)", "I(a * b) ~ y", "y ~ C(a)"])
def test_numbers_of_any_type_are_numbers(formula):
    """Products of small integers overflowed, and numbers in a column of objects were labels."""
    a, b = np.random.default_rng(0).integers(40, 60, (2, 36))
    frame = drawn(12).rename(columns={"score": "y"}).assign(a=a, b=b)
    found = tl.formula_model(formula, frame.astype({"a": float}), "person")
    for kind in ("int64", "uint8", "Int8", object):
        same = tl.formula_model(formula, frame.astype({"a": kind, "b": kind}), "person")
        assert_frame_equal(same.coefficients_table(), found.coefficients_table())


@parametrize(
    ("formula", "columns", "message"),
    [
        ("a ~ b ~ c", {}, "formula must be “score ~ terms”"),
        ("score ~ mode", {"mode": pd.Timestamp("2026-01-01")}, "^formula 'score ~ mode': "),
        ("score ~ mode", {"mode": "a"}, "an effect is not estimable"),
        # One called score was taken for the score, which is finite.
        ("y ~ score", {"score": np.inf}, "33 rows have a missing or infinite value, row 3 first"),
        # It had the codes of a terminal's colours.
        ("score ~ mode + (1|person)", {}, "^[^\x1b]*is incorrectly used[^\x1b]*$"),
    ],
)
def test_what_no_formula_takes_is_named(formula, columns, message):
    frame = drawn().assign(y=np.arange(36.0), **columns)[3:]
    with refused(message):
        tl.formula_model(formula, frame, "person")


def test_a_column_twice_is_named():
    frame = drawn()
    with refused("^data: 2 columns are named 'mode'"):
        tl.formula_model("score ~ mode", pd.concat([frame, frame["mode"]], axis=1), "person")


def test_a_formula_without_effects_says_so():
    found = tl.formula_model("score ~ 1", drawn(), "person")
    assert found.apa().endswith("observations) has no effects to test.")
    assert not hasattr(found, "chi2")


def test_a_category_without_rows_is_no_level_and_durations_are_left_alone():
    """Rows selected from a categorical column made the effect "not estimable"."""
    frame = drawn().astype({"mode": "category"}).query("mode != 'c'")
    frame["took"] = pd.to_timedelta(frame.index, unit="s")
    plain = frame.drop(columns="took").astype({"mode": str})
    tables = [tl.formula_model("score ~ mode", f, "person").table() for f in (frame, plain)]
    assert_frame_equal(*tables)


def test_people_who_differ_too_much_are_refused():
    """F was 2e-11, as if people did not differ at all; that of repeated_measures was 20."""
    frame = drawn(people=1e4)
    anova, found = (test(frame, **COLUMNS).F for test in BOTH)
    assert found == approx(anova)
    with refused("differ between subjects 100,000 times"):
        tl.mixed_model(drawn(people=1e7), **COLUMNS)


def test_conditions_without_a_subject_in_common():
    """Within people only a and b are compared, in two of them: one degree of freedom is left."""
    frame = pd.DataFrame({"s": list("112234"), "c": list("ababcd"), "y": [1, 2, 1.5, 2.2, 3, 4]})
    model = tl.mixed_model(frame, "y", "c", "s")
    assert (model.df1, model.df2) == (3, 1)
