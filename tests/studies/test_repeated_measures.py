"""
The front: what it accepts, what it decides, what it says. Oracles: R (test_against_r.py), closed
forms, theorems.
"""

import re
import warnings
from itertools import combinations

import matplotlib as mpl
import numpy as np
import pandas as pd
import pytest
from scipy import stats

import trustlab as tl
from trustlab.sessions import external_data

mpl.use("Agg")

FIXED = (
    "F df1 df2 p mauchly_w mauchly_chi2 mauchly_df mauchly_p epsilon_gg epsilon_hf "
    "epsilon_hf_untruncated p_gg p_hf"
)
FIXED += " eta2_partial eta2_generalized"


def table(n=12, k=4, seed=0, labels=None, effect=0.5):
    rng = np.random.default_rng(seed)
    scores = rng.standard_normal((n, k)) + rng.standard_normal((n, 1)) + effect * np.arange(k)
    labels = [f"C{j + 1}" for j in range(k)] if labels is None else labels
    return pd.DataFrame(
        {
            "pid": np.repeat(np.arange(1, n + 1), k),
            "condition": labels * n,
            "score": scores.ravel(),
            "note": "extra",
        }
    )


def analysed(frame, **options):
    return tl.repeated_measures(frame, dv="score", within="condition", subject="pid", **options)


def same(a, b):
    pd.testing.assert_frame_equal(
        a.table().drop(columns=["dv", "within", "effect"]),
        b.table().drop(columns=["dv", "within", "effect"]),
        rtol=1e-12,
    )
    pd.testing.assert_frame_equal(a.pairs().iloc[:, 2:], b.pairs().iloc[:, 2:], rtol=1e-10)


# ---- what it accepts


def test_order_of_conditions():
    frame = table(labels=["b", "d", "a", "c"])
    assert analysed(frame).conditions == ("a", "b", "c", "d")
    numbers = table(labels=[10, 2, 1, 0.5])
    assert analysed(numbers).conditions == (0.5, 1.0, 2.0, 10.0)
    category = frame.assign(
        condition=pd.Categorical(frame["condition"], categories=["d", "never", "c", "b", "a"])
    )
    result = analysed(category)
    assert result.conditions == ("d", "c", "b", "a")
    assert result.pairs()[["a", "b"]].to_numpy().tolist()[0] == ["d", "c"]
    assert analysed(frame, order=["c", "a", "d", "b"]).conditions == ("c", "a", "d", "b")
    assert analysed(table(k=2, labels=[True, False])).conditions == (False, True)
    mixed = table(labels=["a", 1, 2, 3])
    assert analysed(mixed, order=[1, 2, 3, "a"]).conditions == (1, 2, 3, "a")
    first, second = analysed(frame), analysed(frame, order=["d", "c", "b", "a"])
    forward = {(row.a, row.b): row.t for row in first.pairs().itertuples()}
    backward = {(row.b, row.a): -row.t for row in second.pairs().itertuples()}
    assert forward.keys() == backward.keys()
    for pair, t in forward.items():
        assert t == pytest.approx(backward[pair], rel=1e-11)


def test_no_warning_leaves_it():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for frame in (table(), table(k=2), table(n=4, k=6)):
            result = analysed(frame)
            (
                result.table(),
                result.pairs(),
                result.friedman(),
                result.normality(),
                result.mixed_model(),
                result.apa(),
            )


# ---- missing cells


def test_missing_cells_as_rows_not_there_or_as_nan():
    frame = table()
    absent = frame.drop(index=[5, 18])
    empty = frame.assign(score=frame["score"].mask(frame.index.isin([5, 18])))
    for gaps in (absent, empty, empty.assign(score=empty["score"].astype("Float64"))):
        with pytest.raises(
            ValueError,
            match=r"subject 2 has no score in condition 'C2'; subject 5 .* 'C3'.*listwise",
        ):
            analysed(gaps)
        result = analysed(gaps, missing="listwise")
        assert result.excluded == (2, 5)
        assert result.n == 10
        assert 2 not in result.scores.subjects
        assert "2, 5" in result.apa()
        assert "2, 5" in result._repr_html_()
        complete = analysed(frame[~frame["pid"].isin([2, 5])])
        np.testing.assert_allclose(result.F, complete.F, rtol=1e-12)
        model = result.mixed_model()  # takes the cells that are there
        assert (model.n, model.missing_cells, model.df2) == (12, 2, 31)


# ---- what it decides


def test_the_correction_and_its_reason():
    rng = np.random.default_rng(1)
    scores = rng.standard_normal((24, 4)) * [1, 2, 4, 8]
    violated = table(24).assign(score=scores.ravel())
    result = analysed(violated, correction="auto")
    assert result.mauchly_p < 0.05
    assert result.correction == "greenhouse-geisser"
    assert "rejects sphericity" in result.reason
    assert result.p_corrected == result.p_gg
    assert (result.df1_corrected, result.df2_corrected) == (result.df1_gg, result.df2_gg)
    assert result.df1_gg == pytest.approx(3 * result.epsilon_gg)
    met = analysed(table(24, seed=2), correction="auto")
    assert met.mauchly_p > 0.05
    assert (met.correction, met.p_corrected, met.df1_corrected) == ("none", met.p, 3)
    assert "does not reject" in met.reason
    asked = analysed(violated, correction="huynh-feldt")
    assert (asked.correction, asked.p_corrected) == ("huynh-feldt", asked.p_hf)
    assert "whatever Mauchly's test says" in asked.reason
    for frame in (violated, table(24, seed=2)):  # the default, as in afex
        usual = analysed(frame)
        assert (usual.correction, usual.p_corrected) == ("greenhouse-geisser", usual.p_gg)
    assert analysed(violated, correction="none").p_corrected == result.p


@pytest.mark.parametrize(("n", "k"), [(3, 4), (5, 6), (4, 10)])
def test_mauchly_is_refused_for_too_few_subjects(n, k):
    result = analysed(table(n, k), correction="auto")
    assert np.isnan([result.mauchly_w, result.mauchly_chi2, result.mauchly_p]).all()
    assert f"{n} subjects are too few for {k} conditions" in result.mauchly_reason
    assert result.correction == "greenhouse-geisser"
    assert "cannot be tested" in result.reason
    assert np.isfinite(
        [result.F, result.p, result.p_gg, result.p_hf, result.epsilon_gg, result.epsilon_hf]
    ).all()
    assert f"{n} subjects are too few" in result.apa()
    assert np.isfinite(analysed(table(k, k)).mauchly_p)  # one more subject is enough


def test_a_pair_without_spread_is_said():
    frame = table(12, 3)
    scores = frame["score"].to_numpy().reshape(12, 3).copy()
    scores[:, 1] = scores[:, 0] + 2.0
    result = analysed(frame.assign(score=scores.ravel()))
    assert np.isnan(result.pairs()["t"]).tolist() == [True, False, False]
    assert np.isnan(result.normality()["W"]).tolist() == [True, False, False]
    assert "'C1' and 'C2' first" in result.notes[0]
    assert "no test" in result.apa()


@pytest.mark.parametrize("k", [2, 3])
def test_a_condition_with_one_score_for_all_is_said(k):
    frame = table(12, k)
    same = frame.assign(score=frame["score"].mask(frame["condition"] == "C2", 7.1))
    result = analysed(same)
    assert result.notes[0].startswith("Every subject has the same score (SD = 0) in 'C2'")
    assert "Every subject had the same score in C2 (SD = 0)." in result.apa()
    assert analysed(frame).notes == ()
    assert "SD = 0)" not in analysed(frame).apa()


# ---- intervals


def test_within_interval_is_the_paired_one_for_two_conditions():
    """
    Closed form: for k = 2 the Cousineau–Morey half-width is that of the paired difference over √2.
    """
    result = analysed(table(k=2))
    stat, pair = result.descriptives(), result.pairs()
    half = (stat["ci_high_within"] - stat["mean"]).to_numpy()
    np.testing.assert_allclose(
        half, (pair["ci_high"] - pair["mean_difference"])[0] / np.sqrt(2.0), rtol=1e-11
    )


# ---- what it says


def test_apa_sentence():
    text = analysed(table(24, effect=0.6), correction="none").apa()
    assert re.search(
        r"F\(3, 69\) = \d+\.\d\d, p < \.001, ηp² = \.\d\d, 90% CI \[\.\d\d, \.\d\d\], ηG² = \.\d\d",
        text,
    )
    assert re.search(r"Mauchly's W = \.\d\d, χ²\(5\) = \d+\.\d\d, p = \.\d{3}", text)
    assert "Holm-adjusted" in text
    assert "C1 < C4" in text
    assert "Bonferroni-adjusted" in analysed(table()).apa(adjust="bonferroni")
    none = analysed(table(seed=1, effect=0.0)).apa()
    assert "did not differ significantly" in none
    assert "found no significant difference" in none
    with pytest.raises(ValueError, match="'fdr'"):
        analysed(table()).apa(adjust="fdr")


@pytest.mark.parametrize("kind", ["means", "raincloud", "paired"])
@pytest.mark.parametrize("interval", ["between", "within"])
def test_plots(kind, interval):
    import matplotlib.pyplot as plt

    result = analysed(table())
    axes = result.plot(kind, interval=interval)
    assert [label.get_text() for label in axes.get_xticklabels()] == ["C1", "C2", "C3", "C4"]
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("condition", "score")
    if kind == "means":
        stat, end = result.descriptives(), "" if interval == "between" else "_within"
        segments = np.array(axes.containers[0][2][0].get_segments())
        np.testing.assert_allclose(segments[:, 0, 1], stat[f"ci_low{end}"])
        np.testing.assert_allclose(segments[:, 1, 1], stat[f"ci_high{end}"])
    plt.close("all")
    _, given = plt.subplots()
    assert result.plot(kind, axes=given) is given
    plt.close("all")


def test_the_label_survives_tables_put_together():
    first, second = table(), table()
    second["pid"] = second["pid"].astype(str) + "b"
    first["pid"] = first["pid"].astype(str)
    simulated = pd.concat([first.assign(synthetic=True), second.assign(synthetic=True)])
    assert analysed(simulated).table()["origin"].tolist() == ["synthetic data"]
    mixed = pd.concat([first.assign(synthetic=True), second])  # no mark: NaN
    assert analysed(mixed).table()["origin"].tolist() == ["partly synthetic data"]
    people = analysed(first.assign(synthetic=False))
    assert people.table()["origin"].tolist() == [""]


@pytest.mark.parametrize(
    ("attrs", "said"),
    [
        ({"synthetic": True}, "synthetic data"),
        ({"reconstructed": True}, "reconstructed data"),
        ({"origin": "a simulation"}, "a simulation"),
    ],
)
def test_data_that_were_not_measured_say_so_everywhere(attrs, said):
    import matplotlib.pyplot as plt

    frame = table()
    frame.attrs.update(attrs)
    result = analysed(frame)
    assert result.table()["origin"].tolist() == [said]
    for view in (result.pairs(), result.descriptives(), result.normality()):
        assert view.attrs["origin"] == said
    for text in (
        result.apa(),
        repr(result),
        result._repr_html_(),
        result.mixed_model()._repr_html_(),
    ):
        assert said in text
    assert said in result.plot().get_title()
    plt.close("all")
    measured = analysed(table())
    assert measured.table()["origin"].tolist() == [""]
    assert said not in measured.apa()


REAL = {  # file, column: F, W, p of W, Greenhouse–Geisser ε, generalized η² by R 4.2.2, afex 1.2-1
    ("traj_err", "traj_err"): (
        123.665488185,
        0.179747962818,
        5.49266853186e-07,
        0.563853200965,
        0.73678136574,
    ),
    ("tlx", "tlx_ave"): (
        35.2180725249,
        0.306632530858,
        0.000105225304857,
        0.564771171622,
        0.324236420429,
    ),
    ("p_trust", "p_trust"): (
        29.1782829794,
        0.359531665113,
        0.000483040901719,
        0.58735260211,
        0.248899583309,
    ),
    ("mdmt", "mdmt_ave"): (
        33.564337297,
        0.260416935581,
        2.1501531877e-05,
        0.607009432645,
        0.276134177462,
    ),
    ("p_auto", "p_auto"): (
        38.4605017624,
        0.626256441415,
        0.0709346418865,
        0.801945250816,
        0.340587564577,
    ),
    ("pupil", "pupil_diameter"): (
        5.11895681872,
        0.280350476403,
        4.41527811108e-05,
        0.561420620466,
        0.00601321075954,
    ),
    ("tapping_err", "tapping_err_ave"): (
        1.17992422606,
        0.530668885921,
        0.0172966159188,
        0.744347680945,
        0.0219796535225,
    ),
    ("traj_err_all_levels", "traj_err"): (
        43.2695299103,
        0.0332710490509,
        5.08290901773e-12,
        0.431669954944,
        0.516324105137,
    ),
}


@pytest.mark.skipif(
    external_data("autonomy_cl_trust") is None,
    reason="needs the sessions of AutonomyCLTrust (docs/reports.md): TRUSTLAB_DATA=folder",
)
@pytest.mark.parametrize("measure", REAL, ids=lambda measure: measure[0])
def test_real_measures(measure):
    """Pan et al. (2024), 24 participants."""
    file, column = measure
    frame = pd.read_csv(external_data("autonomy_cl_trust") / "measures" / f"{file}.csv")
    result = tl.repeated_measures(frame, dv=column, within="autonomy", subject="pid")
    ours = [
        result.F,
        result.mauchly_w,
        result.mauchly_p,
        result.epsilon_gg,
        result.eta2_generalized,
    ]
    np.testing.assert_allclose(ours, REAL[measure], rtol=1e-9)
    assert (result.n, result.k) == (24, 5 if "all" in file else 4)
    np.testing.assert_allclose(result.mixed_model().F, result.F, rtol=1e-6)


def test_assumptions_are_those_of_the_single_tests():
    """Oracle: SciPy's Shapiro–Wilk and Friedman tests, and pingouin's Holm adjustment."""
    import pingouin

    result = analysed(table(seed=4).assign(score=lambda f: np.exp(2.0 * f["score"])))
    (found,) = result.assumptions().to_dict("records")
    values = result.scores.values
    p = [stats.shapiro(values[:, a] - values[:, b]).pvalue for a, b in combinations(range(4), 2)]
    assert found["p_shapiro_least"] == pytest.approx(min(p))
    assert found["pairs_not_normal"] == pingouin.multicomp(p, method="holm")[0].sum() > 0
    assert found["p_friedman"] == pytest.approx(stats.friedmanchisquare(*values.T).pvalue)
    assert found["p_anova"] == result.p_corrected
    assert found["mixed_F"] == pytest.approx(result.F, rel=1e-6)


# ---- by ranks


def test_wilcoxon_pairs_are_those_of_scipy():
    frame = table(14, 3, seed=3)
    found = analysed(frame).pairs(method="wilcoxon")
    wide = frame.pivot_table(index="pid", columns="condition", values="score")
    for row in found.itertuples():
        oracle = stats.wilcoxon(wide[row.a], wide[row.b], method="exact")
        assert row.p == pytest.approx(oracle.pvalue)
        assert row.median_difference == pytest.approx((wide[row.a] - wide[row.b]).median())
        assert row.method == "exact"
    order = found["p"].sort_values()
    assert found["p_holm"][order.index[0]] == pytest.approx(min(3 * order.iloc[0], 1.0))
