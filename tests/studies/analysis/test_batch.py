"""
The batch engine. Oracles: pingouin, SciPy and statsmodels study by study; sums of squares by brute
force; theorems.
"""

import warnings

import numpy as np
import pandas as pd
import pingouin
import pytest
from hypothesis import given, settings, strategies as st
from scipy import stats
from statsmodels.stats.anova import AnovaRM
from statsmodels.stats.multitest import multipletests

import trustlab as tl
from trustlab.studies.analysis import anova as engine
from trustlab.studies.analysis.batch import bonferroni, holm

OMNIBUS = [
    "F",
    "p",
    "p_gg",
    "p_hf",
    "epsilon_gg",
    "epsilon_hf",
    "epsilon_hf_untruncated",
    "eta2_partial",
    "eta2_generalized",
]
OMNIBUS += ["mauchly_w", "mauchly_chi2", "mauchly_p", "mauchly_p_first_order"]


def draw(studies, n, k, seed=0, effect=0.3, subjects=1.0):
    rng = np.random.default_rng(seed)
    scores = rng.standard_normal((studies, n, k)) * np.linspace(1.0, 2.0, k)
    return scores + subjects * rng.standard_normal((studies, n, 1)) + effect * np.arange(k)


def long_table(scores):
    n, k = scores.shape
    return pd.DataFrame(
        {"s": np.repeat(np.arange(n), k), "c": np.tile(np.arange(k), n), "y": scores.ravel()}
    )


@pytest.mark.parametrize(("n", "k"), [(36, 5), (12, 3), (24, 4), (15, 10)])
def test_equals_a_pingouin_loop(n, k):
    array = draw(8, n, k)
    batch = tl.repeated_measures_batch(array)
    columns = {"dv": "y", "within": "c", "subject": "s"}
    for s, scores in enumerate(array):
        frame = long_table(scores)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # pandas' own, from inside pingouin
            row = pingouin.rm_anova(frame, correction=True, **columns).iloc[0]
            partial = pingouin.rm_anova(frame, effsize="np2", **columns).iloc[0]["np2"]
            epsilon = pingouin.epsilon(frame, correction="hf", **columns)
            sphericity = pingouin.sphericity(frame, **columns)
            pairs = pingouin.pairwise_tests(frame, padjust="holm", **columns)
        ours = [
            getattr(batch, name)[s] for name in ["F", "p", "p_gg", "epsilon_gg", "eta2_generalized"]
        ]
        theirs = row[["F", "p_unc", "p_GG_corr", "eps", "ng2"]].to_numpy(dtype=float)
        np.testing.assert_allclose(ours, theirs, rtol=1e-10)
        ours = [
            batch.eta2_partial[s],
            batch.epsilon_hf[s],
            batch.mauchly_w[s],
            batch.mauchly_chi2[s],
            batch.mauchly_p[s],
        ]
        np.testing.assert_allclose(
            ours, [partial, epsilon, sphericity.W, sphericity.chi2, sphericity.pval], rtol=1e-10
        )
        assert batch.mauchly_df == sphericity.dof
        np.testing.assert_allclose(batch.pairwise.t[s], pairs["T"], rtol=1e-10)
        np.testing.assert_allclose(batch.pairwise.p[s], pairs["p_unc"], rtol=1e-10)
        np.testing.assert_allclose(batch.pairwise.p_holm[s], pairs["p_corr"], rtol=1e-10)


def test_equals_statsmodels_and_scipy():
    scores = draw(1, 14, 4)[0]
    batch = tl.repeated_measures_batch(scores[None])
    table = AnovaRM(long_table(scores), "y", "s", within=["c"]).fit().anova_table
    assert batch.F[0] == pytest.approx(table["F Value"].iloc[0], rel=1e-11)
    assert batch.p[0] == pytest.approx(table["Pr > F"].iloc[0], rel=1e-10)
    assert (batch.df1, batch.df2) == (3, 39)
    for pair, (i, j) in enumerate(zip(batch.pairwise.a, batch.pairwise.b, strict=True)):
        found = stats.ttest_rel(scores[:, i], scores[:, j])
        interval = found.confidence_interval(0.95)
        ours = batch.pairwise
        np.testing.assert_allclose(
            [ours.t[0, pair], ours.p[0, pair], ours.ci_low[0, pair], ours.ci_high[0, pair]],
            [found.statistic, found.pvalue, interval.low, interval.high],
            rtol=1e-11,
        )


def test_sums_of_squares_by_brute_force():
    scores = draw(1, 7, 3, seed=4)[0]
    n, k = scores.shape
    batch = tl.repeated_measures_batch(scores[None])
    grand = scores.mean()
    effect = sum(n * (scores[:, j].mean() - grand) ** 2 for j in range(k))
    subjects = sum(k * (scores[i].mean() - grand) ** 2 for i in range(n))
    error = sum(
        (scores[i, j] - scores[i].mean() - scores[:, j].mean() + grand) ** 2
        for i in range(n)
        for j in range(k)
    )
    np.testing.assert_allclose(
        [batch.ss_effect[0], batch.ss_subjects[0], batch.ss_error[0]],
        [effect, subjects, error],
        rtol=1e-12,
    )
    assert batch.eta2_generalized[0] == pytest.approx(
        effect / ((scores - grand) ** 2).sum(), rel=1e-12
    )


def test_two_conditions_are_a_paired_t_test():
    array = draw(50, 9, 2)
    batch = tl.repeated_measures_batch(array)
    np.testing.assert_allclose(batch.F, batch.pairwise.t[:, 0] ** 2, rtol=1e-11)
    np.testing.assert_allclose(batch.p, batch.pairwise.p[:, 0], rtol=1e-10)
    for name in ("epsilon_gg", "epsilon_hf", "epsilon_hf_untruncated"):
        assert (getattr(batch, name) == 1.0).all()
    for name in ("mauchly_w", "mauchly_chi2", "mauchly_p", "mauchly_p_first_order"):
        assert np.isnan(getattr(batch, name)).all()
    assert batch.mauchly_df == 0
    np.testing.assert_array_equal(batch.p_gg, batch.p)


@pytest.mark.parametrize(
    ("n", "k", "defined"),
    [(3, 3, True), (3, 4, False), (5, 5, True), (5, 6, False), (4, 10, False)],
)
def test_mauchly_needs_n_above_k_less_one(n, k, defined):
    batch = tl.repeated_measures_batch(draw(20, n, k))
    assert (np.isfinite(batch.mauchly_w) == defined).all()
    assert (np.isfinite(batch.mauchly_p) == defined).all()
    for name in ("F", "p", "epsilon_gg", "epsilon_hf", "p_gg", "p_hf"):
        assert np.isfinite(getattr(batch, name)).all()


def test_mauchly_is_refused_where_a_condition_is_the_mean_of_two_others():
    array = draw(300, 12, 4)
    array[::2, :, 3] = 0.5 * (
        array[::2, :, 0] + array[::2, :, 1]
    )  # eigenvalues of ± 1e-17: both signs occur
    batch = tl.repeated_measures_batch(array)
    assert np.isnan(batch.mauchly_w).tolist() == [True, False] * 150
    assert np.isfinite(batch.p_gg).all()


def test_nearly_singular_is_not_singular():
    array = draw(1, 12, 4)
    array[0, :, 3] = 0.5 * (array[0, :, 0] + array[0, :, 1]) + 1e-5 * array[0, :, 2]
    assert 0.0 < tl.repeated_measures_batch(array).mauchly_w[0] < 1e-9


shapes = st.tuples(st.integers(3, 12), st.integers(2, 6), st.integers(0, 2**32 - 1))


@settings(max_examples=60, deadline=None, derandomize=True)
@given(shapes)
def test_bounds(shape):
    n, k, seed = shape
    batch = tl.repeated_measures_batch(draw(3, n, k, seed=seed))
    d = k - 1
    assert ((batch.epsilon_gg >= 1.0 / d) & (batch.epsilon_gg <= 1.0)).all()
    assert (batch.epsilon_hf_untruncated >= batch.epsilon_gg * (1.0 - 1e-12)).all()
    assert ((batch.epsilon_hf <= 1.0) & (batch.epsilon_hf <= batch.epsilon_hf_untruncated)).all()
    for name in ("p", "p_gg", "p_hf", "mauchly_p", "mauchly_w", "eta2_partial", "eta2_generalized"):
        value = getattr(batch, name)
        assert (np.isnan(value) | ((value >= 0.0) & (value <= 1.0))).all(), name
    assert (batch.eta2_generalized <= batch.eta2_partial * (1.0 + 1e-12)).all()
    pairs = batch.pairwise
    assert ((pairs.p <= pairs.p_holm) & (pairs.p_holm <= pairs.p_bonferroni)).all()


@settings(max_examples=40, deadline=None, derandomize=True)
@given(shapes, st.floats(-1e3, 1e3), st.floats(1e-3, 1e3))
def test_unit_and_subjects_levels_do_not_matter(shape, offset, unit):
    n, k, seed = shape
    array = draw(2, n, k, seed=seed)
    level = np.random.default_rng(seed).standard_normal((1, n, 1)) * 10.0
    first, second = (
        tl.repeated_measures_batch(x) for x in (array, offset + unit * (array + level))
    )
    for name in OMNIBUS:
        if name not in (
            "eta2_generalized",
            "epsilon_hf_untruncated",
        ):  # the one has the subjects' variance, the other a pole
            np.testing.assert_allclose(
                getattr(second, name), getattr(first, name), rtol=1e-5, atol=1e-8, err_msg=name
            )
    np.testing.assert_allclose(second.pairwise.t, first.pairwise.t, rtol=1e-6, atol=1e-7)
    np.testing.assert_allclose(second.pairwise.d_z, first.pairwise.d_z, rtol=1e-6, atol=1e-7)


@settings(max_examples=40, deadline=None, derandomize=True)
@given(shapes, st.randoms(use_true_random=False))
def test_order_of_subjects_and_conditions_does_not_matter(shape, random):
    n, k, seed = shape
    array = draw(2, n, k, seed=seed)
    rows, columns = list(range(n)), list(range(k))
    random.shuffle(rows)
    random.shuffle(columns)
    first, second = (tl.repeated_measures_batch(x) for x in (array, array[:, rows][:, :, columns]))
    for name in OMNIBUS:
        np.testing.assert_allclose(
            getattr(second, name), getattr(first, name), rtol=1e-6, atol=1e-9, err_msg=name
        )


def test_a_large_offset_costs_only_the_scores_own_digits():
    array = np.round(draw(5, 20, 4), 3)
    near, far = tl.repeated_measures_batch(array), tl.repeated_measures_batch(array + 1e9)
    np.testing.assert_allclose(far.F, near.F, rtol=1e-5)
    np.testing.assert_allclose(far.mauchly_p, near.mauchly_p, rtol=1e-4)


def test_false_positives_at_the_level():
    """Theorem: under sphericity and no effect, p is uniform; so is Mauchly's, nearly."""
    rng = np.random.default_rng(7)
    batch = tl.repeated_measures_batch(
        rng.standard_normal((20_000, 20, 4)) + 2.0 * rng.standard_normal((20_000, 20, 1))
    )
    for name in ("p", "mauchly_p"):
        assert stats.kstest(getattr(batch, name), "uniform").pvalue > 0.01, name
    assert stats.kstest(batch.mauchly_p_first_order, "uniform").statistic < 0.03


def test_chunks_do_not_matter(monkeypatch):
    array = draw(11, 8, 3)
    whole = tl.repeated_measures_batch(array)
    monkeypatch.setattr(engine, "_CHUNK", 50)
    parts = tl.repeated_measures_batch(array)
    for name in OMNIBUS:
        np.testing.assert_allclose(getattr(parts, name), getattr(whole, name), rtol=1e-12)
    np.testing.assert_allclose(parts.pairwise.p_holm, whole.pairwise.p_holm, rtol=1e-12)
    array[7] = 3.0
    with pytest.raises(ValueError, match="study 7: every score is 3"):
        tl.repeated_measures_batch(array)


@pytest.mark.parametrize("size", [1, 2, 6, 45])
def test_adjusted_p_values_against_statsmodels(size):
    p = np.random.default_rng(size).beta(0.3, 1.0, (3, size))
    p[:, 0] = p[:, -1]  # ties
    for row, adjusted in zip(p, holm(p), strict=True):
        np.testing.assert_allclose(adjusted, multipletests(row, method="holm")[1], rtol=1e-12)
    np.testing.assert_array_equal(bonferroni(p), np.minimum(size * p, 1.0))


def test_adjusted_p_values_leave_nan_out_of_the_family():
    """Oracle: R, p.adjust(c(0.01, NA, 0.04), "holm") is 0.02 NA 0.04; "bonferroni" 0.02 NA 0.08."""
    p = np.array([0.01, np.nan, 0.04])
    np.testing.assert_allclose(holm(p), [0.02, np.nan, 0.04])
    np.testing.assert_allclose(bonferroni(p), [0.02, np.nan, 0.08])


def test_a_pair_with_one_difference_has_no_t_test():
    array = draw(2, 8, 3)
    array[1, :, 1] = array[1, :, 0] + 0.1
    pairs = tl.repeated_measures_batch(array).pairwise
    assert np.isnan(pairs.t).tolist() == [[False] * 3, [True, False, False]]
    assert np.isnan(pairs.p_holm[1]).tolist() == [True, False, False]
    np.testing.assert_allclose(pairs.p_bonferroni[1, 1:], np.minimum(2.0 * pairs.p[1, 1:], 1.0))


def test_tables():
    batch = tl.repeated_measures_batch(draw(4, 9, 3))
    assert batch.table().shape[0] == len(batch) == 4
    assert batch.table()["F"].tolist() == batch.F.tolist()
    pairs = batch.pairs()
    wanted = "study a b mean_difference ci_low ci_high t df p p_bonferroni p_holm d_z d_av"
    assert pairs.columns.tolist() == wanted.split()
    assert len(pairs) == 12
    assert pairs.query("study == 2 and a == 0 and b == 2")["t"].item() == batch.pairwise.t[2, 1]
    assert "4 studies" in batch._repr_html_()


BAD = {
    "two axes": (np.zeros((4, 3)), r"three axes .* array\[None\]"),
    "no study": (np.zeros((0, 4, 3)), "no study"),
    "two subjects": (np.zeros((1, 2, 3)), r"at least 3 subjects and 2 conditions, got 2 subject"),
    "one condition": (np.zeros((1, 4, 1)), r"got 4 subject\(s\) and 1 condition"),
    "text": (np.array([[["a", "b"]] * 3]), "real numbers"),
    "booleans": (np.ones((1, 4, 3), dtype=bool), "real numbers"),
    "complex": (np.ones((1, 4, 3), dtype=complex), "real numbers"),
    "objects": (np.ones((1, 4, 3), dtype=object), "real numbers"),
    "None": (None, "real numbers"),
    "ragged": ([[[1.0, 2.0], [1.0]]], "real numbers"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_arrays(name):
    array, message = BAD[name]
    with pytest.raises(ValueError, match=message):
        tl.repeated_measures_batch(array)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_a_score_that_is_no_number_is_named(value):
    array = draw(3, 5, 4)
    array[2, 1, 3] = value
    with pytest.raises(ValueError, match=r"study 2, subject 1, condition 3\) is (nan|inf|-inf)"):
        tl.repeated_measures_batch(array)


def test_studies_without_error_variance_are_named():
    array = draw(3, 5, 4)
    array[1] = 0.1 + 0.2 * np.arange(5)[:, None] + 0.7 * np.arange(4)
    with pytest.raises(
        ValueError, match=r"study 1: the error variance is zero \(all subjects differ"
    ):
        tl.repeated_measures_batch(array)
    array[1] = 0.1 * np.arange(5)[:, None] * np.ones(4)
    with pytest.raises(ValueError, match=r"study 1: the error variance is zero \(no subject"):
        tl.repeated_measures_batch(array)


def test_units_beyond_double_precision_are_refused():
    array = draw(1, 5, 4)
    with pytest.raises(ValueError, match="another unit"):
        tl.repeated_measures_batch(array * 1e160)
    with pytest.raises(ValueError, match="another unit"):
        tl.repeated_measures_batch(array * 1e-150)
    usual = tl.repeated_measures_batch(array)
    for unit in (1e-95, 1e-20, 1e130):
        found = tl.repeated_measures_batch(array * unit)
        for name in OMNIBUS:
            np.testing.assert_allclose(
                getattr(found, name), getattr(usual, name), rtol=1e-9, err_msg=name
            )
