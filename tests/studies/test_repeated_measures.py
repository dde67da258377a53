"""
The front: what it accepts, what it decides, what it says, what it refuses, by subject, condition,
column or row. Oracles: R (test_against_r.py), closed forms, theorems.
"""

import re
import warnings
from itertools import combinations

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings, strategies as st
from numpy.testing import assert_allclose
from pandas.testing import assert_frame_equal
from statsmodels.stats.multitest import multipletests

import trustlab as tl
from tests.cases import refused
from tests.studies.scores import COLUMNS, approx, drawn, long, parametrize, reference
from trustlab.sessions import external_data
from trustlab.studies.table import complete_scores
from trustlab.studies.words import apa_number


def analysed(frame, **options):
    return tl.repeated_measures(frame, **COLUMNS | options)


# ---- what it accepts


def test_order_of_conditions():
    frame = drawn(mode="bdac")
    categories = pd.Categorical(frame["mode"], categories=["d", "never", "c", "b", "a"])
    for ordered, options, order in (
        (frame, {}, tuple("abcd")),
        (frame, {"order": np.array([*"cadb"])}, tuple("cadb")),
        (frame.assign(mode=categories), {}, tuple("dcba")),
        (drawn(mode=[10, 2, 1, 0.5]), {}, (0.5, 1.0, 2.0, 10.0)),
        (drawn(mode=["a", 1, 2, 3]), {"order": [1, 2, 3, "a"]}, (1, 2, 3, "a")),
    ):
        result = analysed(ordered, **options)
        assert result.conditions == order
        pairs = result.pairs()
        assert [*zip(pairs["a"], pairs["b"], strict=True)] == [*combinations(order, 2)]


@parametrize(("n", "k"), [(12, 4), (12, 2), (4, 6)])
def test_no_warning_leaves_it(n, k):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        result = analysed(drawn(n, mode="abcdef"[:k]))
        result.assumptions()
        undefined = "Mauchly's test of sphericity is not defined." in result.apa()
    assert undefined == (k > n)


def test_missing_cells_as_rows_not_there_or_as_nan():
    frame = drawn(mode="abcd")
    complete = analysed(frame[~frame["person"].isin([1, 4])])
    empty = frame.assign(score=frame["score"].mask(frame.index.isin([5, 18])))
    missing = "subject 1 has no score in condition 'b'; subject 4 .* 'c'.*listwise.*mixed_model"
    for gaps in (frame.drop(index=[5, 18]), empty, empty.astype({"score": "Float64"})):
        with refused(missing):
            analysed(gaps)
        result = analysed(gaps, missing="listwise")
        assert result.excluded == (1, 4)
        assert result.apa().endswith("Left out for missing scores: 2 participants (1, 4).")
        assert_frame_equal(result.pairs(), complete.pairs())


# ---- what it decides


def test_the_correction():
    """By default that of afex; two conditions need none."""
    frame = drawn(24, seed=2, mode="abcd")
    for correction, end in {"greenhouse-geisser": "_gg", "huynh-feldt": "_hf", "none": ""}.items():
        found = analysed(frame, correction=correction)
        epsilon = getattr(found, f"epsilon{end}", 1.0) if end else 1.0
        assert found.p_corrected == getattr(found, f"p{end}")
        assert (found.df1_corrected, found.df2_corrected) == (3 * epsilon, 69 * epsilon)
    assert analysed(frame).correction == "greenhouse-geisser"
    two = analysed(drawn(mode="ab"), correction="huynh-feldt")
    assert (two.correction, two.p_corrected) == ("none", two.p)
    assert "(N = 12): " in two.apa()


def test_what_has_no_spread_is_said():
    wide = drawn()["score"].to_numpy().reshape(12, 3).copy()
    wide[:, :2] = 0.0
    ranks = analysed(long(wide)).pairs(method="wilcoxon")
    assert ranks["method"].tolist() == ["not defined", "exact", "exact"]
    wide[:, 0] = wide[:, 2] ** 2
    wide[:, 1] = wide[:, 0] + 2.0
    result = analysed(long(wide))
    assert np.isnan(result.pairs()["t"]).tolist() == [True, False, False]
    assert np.isnan(result.normality()["W"]).tolist() == [True, False, False]
    assert "no test" in result.apa()


# ---- intervals


def test_within_interval_is_the_paired_one_for_two_conditions():
    """
    Closed form: for k = 2 the Cousineau–Morey half-width is that of the paired difference over √2.
    """
    result = analysed(drawn(mode="ab"))
    stat, pair = result.descriptives(), result.pairs().loc[0]
    half = (stat["ci_high_within"] - stat["mean"]).to_numpy()
    expected = (pair["ci_high"] - pair["mean_difference"]) / np.sqrt(2.0)
    assert_allclose(half, expected, rtol=1e-11)


# ---- what it says


def test_apa_sentence():
    frame = drawn(24, mode="abcd")
    frame["score"] += 0.6 * pd.factorize(frame["mode"])[0]
    result = analysed(frame, correction="none")
    assert re.search(r"F\(3, 69\) = \d+\.\d\d, p < \.001, ηp² = \.\d\d", result.apa())
    assert re.search(r"Mauchly's W = \.\d\d, χ²\(5\) = \d+\.\d\d, p = \.\d{3}", result.apa())
    assert "lower in a than in d, t(23)" in result.apa()
    pair = result.pairs().set_index(["a", "b"]).loc[("a", "d")]
    d_z, low, high = map(apa_number, pair[["d_z", "d_z_low", "d_z_high"]])
    assert f"d_z = {d_z}, 95% CI [{low}, {high}]" in result.apa()
    assert "(N = 24, α = 0.001, correction" in analysed(frame, alpha=0.001).apa()
    assert "Bonferroni-adjusted" in result.apa(adjust="bonferroni")
    none = analysed(drawn(seed=1, mode="abcd")).apa()
    assert "mode was not significant" in none
    assert "Paired t-tests (Holm-adjusted p): No significant difference between a and b" in none


def test_plot():
    result = analysed(drawn())
    _, given = plt.subplots()
    assert result.plot(axes=given) is given
    assert [label.get_text() for label in given.get_xticklabels()] == ["a", "b", "c"]
    assert (given.get_xlabel(), given.get_ylabel()) == ("mode", "score")
    ends = np.array(given.containers[0][2][0].get_segments())[:, :, 1]
    assert_allclose(ends, result.descriptives()[["ci_low", "ci_high"]])


@parametrize(
    ("marks", "attrs", "said"),
    [
        ([True], {}, "synthetic data"),
        ([True, np.nan], {}, "partly synthetic data"),  # tables put together; no mark is NaN
        ([False], {"reconstructed": True}, "reconstructed data"),
        ([False], {"origin": "a simulation"}, "a simulation"),
    ],
)
def test_data_that_were_not_measured_say_so_everywhere(marks, attrs, said):
    frame = drawn().assign(synthetic=np.resize(marks, 36))
    frame.attrs.update(attrs)
    result = analysed(frame)
    assert result.table()["origin"].tolist() == [said]
    for view in (result.pairs(), result.descriptives(), result.normality()):
        assert view.attrs["origin"] == said
    for text in (result._repr_html_(), result.apa(), repr(result), result.plot().get_title()):
        assert said in text
    assert said not in analysed(drawn().assign(synthetic=False)).apa()


def test_scores_and_reliability_say_that_data_were_not_measured():
    items = pd.DataFrame({"a": [1, 2, 5], "b": [2, 2, 4]})
    items.attrs["origin"] = "synthetic data"
    assert tl.cronbach_alpha(items).origin == "synthetic data"
    scores = tl.score(items.assign(subject=range(3)), tl.satisfaction_scale(7, ["a", "b"]))
    assert scores.reliability().attrs["origin"] == "synthetic data"


REAL = reference("real_measures")["sets"]


@pytest.mark.skipif(
    external_data("autonomy_cl_trust") is None,
    reason="needs the sessions of AutonomyCLTrust (docs/reports.md): TRUSTLAB_DATA=folder",
)
@parametrize("name", REAL)
def test_real_measures(name):
    """Pan et al. (2024), 24 participants."""
    frame = pd.read_csv(external_data("autonomy_cl_trust") / "measures" / f"{name}.csv")
    result = tl.repeated_measures(frame, REAL[name]["column"], "autonomy", "pid")
    for number, theirs in REAL[name]["numbers"].items():
        assert getattr(result, number) == approx(theirs, rel=1e-9), number


def test_assumptions_are_those_of_the_single_tests():
    """Which agree with R. Oracle of those rejected by Holm's adjustment: statsmodels."""
    frame = drawn(seed=4, mode="abcd")
    result = analysed(frame.assign(score=np.exp(2.0 * frame["score"])))
    (found,) = result.assumptions().to_dict("records")
    p = result.normality()["p"]
    assert found["p_shapiro_least"] == p.min()
    assert found["pairs_not_normal"] == multipletests(p, method="holm")[0].sum() > 0
    assert found["p_friedman"] == result.friedman()["p"].item()
    assert found["p_anova"] == result.p_corrected


# ---- what it refuses


def put(value, column="score"):
    """A table with a value in row 7, which is that of person 2 in b."""
    frame = drawn(5)
    frame[column] = pd.Series([*frame[column][:7], value, *frame[column][8:]], dtype=object)
    return frame


@parametrize("kind", range(6))
def test_what_is_no_number_is_named(kind):
    """In one row, or in all, so that the column has the value's own type."""
    value = ["1.0", True, [1.0], pd.Timedelta("1s"), -np.inf, 10**5000][kind]
    for frame, row in ((put(value), 7), (drawn(5).assign(score=pd.Series([value] * 15)), 0)):
        with refused(f"column 'score' holds .* in row {row};"):
            analysed(frame)


WIDE = drawn().pivot_table(index="person", columns="mode", values="score").reset_index()


@parametrize(
    ("frame", "options", "message"),
    [
        (put(pd.NaT), {}, "subject 2 has no score in condition 'b'"),
        (put(3, "mode"), {}, "mixes types of labels"),
        (put([1], "mode"), {}, r"within: \[1\] in row 7 of 'mode' is no label"),
        (drawn(mode="a"), {}, "'mode' has one condition only"),
        (WIDE, {}, r"no column 'score'; frame\.melt"),
        (drawn(), {"dv": "scores"}, r"did you mean 'score'\? \(there are person, mode"),
        (drawn(), {"order": [["a"], "b", "c"]}, "order must list"),
    ],
)
def test_tables_that_are_refused(frame, options, message):
    with refused(message):
        analysed(frame, **options)


@settings(max_examples=60)
@given(st.integers(3, 8), st.integers(2, 5), st.data())
def test_whatever_is_missing_is_named_or_left_out(n, k, data):
    """Property: no analysis ever has a NaN in it, or lacks anybody who is complete."""
    gone = data.draw(st.lists(st.booleans(), min_size=n * k, max_size=n * k))
    gone = np.reshape(gone, (n, k))
    read = pd.DataFrame(np.where(gone, np.nan, 1.0))
    excluded = np.flatnonzero(gone.any(axis=1))
    if gone.any():
        with refused(r"missing cells|complete subject"):
            complete_scores(read, "score")
    if n - len(excluded) < 3:
        with refused("complete subject"):
            complete_scores(read, "score", "listwise")
    else:
        kept, others = complete_scores(read, "score", "listwise")
        assert others == (*excluded,)
        assert_frame_equal(kept, read.drop(index=excluded))


def test_an_adjustment_of_pairs_that_are_not_reported_is_refused():
    """It had no effect with several factors."""
    with refused(r"apa\(adjust='none'\) is for one factor"):
        analysed(drawn(), between="group").apa("none")


def test_a_factor_named_like_a_statistic_is_refused_with_its_name():
    """pandas said that columns overlap."""
    result = analysed(drawn().rename(columns={"group": "n"}), between="n")
    with refused("'n' is the name of a factor and of a statistic; rename"):
        result.descriptives()


def test_trials_are_averaged_as_the_error_says():
    frame = drawn(trial=range(2), mode="abc")
    means = frame.groupby(["person", "mode"])["score"].mean()
    with refused("such as row 3; average the trials") as error:
        analysed(frame, between="group")
    averaging, dropping = str(error.value).partition("first: ")[2].split(", then ")
    exec(averaging, {"frame": frame})
    once = analysed(eval(dropping, {"frame": frame}), between="group")
    assert_allclose(once.scores.to_numpy().ravel(), means)
