"""
The paired t-test, equivalence and Bayes factors. Oracles: R (t.test, BayesFactor;
reference/paired_t_test.R, reference/evidence.R), mpmath.
"""

from functools import partial

import numpy as np

import trustlab as tl
from tests.cases import refused
from tests.studies.scores import COLUMNS, approx, long, parametrize, reference
from trustlab.studies.paired import log_jzs_bayes_factor

REFERENCE = reference("paired_t_test")["sets"]
SETS = reference("evidence")["sets"]
SAME = ["mean_difference", "sd_difference", "ci_low", "ci_high", "t", "df", "p", "d_z", "d_av"]
SAME += ["correlation"]


def pair_of(a, b):
    return long(np.column_stack([a, b]))


def run(a, b, **more):
    return tl.paired_t_test(pair_of(a, b), **COLUMNS, **more)


def ranked(a, b):
    return run(a, b).analysis.pairs(method="wilcoxon").loc[0]


@parametrize("name", REFERENCE)
def test_agrees_with_r(name):
    own = REFERENCE[name]
    found = run(own["a"], own["b"])
    for key in SAME:
        assert getattr(found, key) == approx(own[key], rel=1e-9, abs=1e-13), key
    assert found.shapiro_w == approx(own["shapiro_w"], rel=1e-7)
    assert found.shapiro_p == approx(own["shapiro_p"], rel=1e-6)
    ranks = ranked(own["a"], own["b"])
    oracle = [own["wilcoxon_v"], own["wilcoxon_p"]]
    assert [ranks["V"], ranks["p"]] == approx(oracle, rel=1e-9)
    assert ("exact" in ranks["method"]) == ("exact" in own["wilcoxon_method"])
    narrow = run(own["a"], own["b"], confidence=0.9)
    limits = [own["ci90_low"], own["ci90_high"]]
    assert [narrow.ci_low, narrow.ci_high] == approx(limits, rel=1e-9, abs=1e-12)


def test_ties_do_not_depend_on_the_unit():
    """
    0.3 − 0.2 and 0.2 − 0.1 differ in floating point, and are a tie; so are their tenfolds. Oracle:
    whole numbers, whose ranks are 2 (−), 2, 4, 5.5, 2, 5.5 and 7.
    """
    a, b = np.array([2, 2, 4, 7, 9, 11, 20]), np.array([3, 1, 1, 3, 8, 7, 14])
    whole = ranked(a, b)
    assert whole["rank_biserial"] == approx((26 - 2) / 28)
    for unit in (0.1, 0.01, 1e-20, 0.7e5):
        found = ranked(a * unit, b * unit)
        assert found["p"] == approx(whole["p"], rel=1e-12)
        assert found["V"] == whole["V"] == 26


def test_tables_and_sentence():
    frame = pair_of(REFERENCE["followed"]["a"], REFERENCE["followed"]["b"])
    frame.attrs["reconstructed"] = True
    found = tl.paired_t_test(frame, **COLUMNS)
    a, b = found.descriptives().to_dict("records")
    # As many decimals as a standard deviation of some tens needs.
    start = f"between a (M = {a['mean']:.1f}, SD = {a['sd']:.1f}) and b (M = {b['mean']:.1f}, SD = "
    interval = f"[{found.d_z_low:.2f}, {found.d_z_high:.2f}]".replace("-", "−")
    end = f"d_z = {found.d_z:.2f}, 95% CI {interval}."
    for words in ("[reconstructed data] score", start, f"t(35) = {found.t:.2f}, p ", end):
        assert words in found.apa()
    assert "t(35)" in found._repr_html_()


@parametrize("name", SETS)
def test_equivalence_and_bayes_factors_agree_with_r(name):
    own = SETS[name]
    frame = pair_of(own["a"], own["b"])
    row = tl.equivalence(frame, **COLUMNS, bound=0.5).iloc[0]
    for number in ("t_low", "p_low", "t_high", "p_high", "ci_low", "ci_high"):
        assert row[number] == approx(own[number], rel=1e-9, abs=1e-14), number
    assert (row["low"], row["high"], row["df"]) == (-0.5, 0.5, row["n"] - 1)
    assert row["p"] == max(row["p_low"], row["p_high"])
    assert row["equivalent"] == (row["ci_low"] > -0.5 and row["ci_high"] < 0.5)
    for scale, name in ((2**-0.5, "bf10"), (1.0, "bf10_wide")):
        found = tl.bayes_factor(frame, **COLUMNS, scale=scale).iloc[0]
        factors = [found["bf10"], 1.0 / found["bf01"]]
        assert factors == approx([own[name]] * 2, rel=1e-6)


@parametrize(
    ("t", "n", "scale", "expected"),
    [
        (0.0, 10, 2**-0.5, -1.1750823266311887),
        (0.5, 3, 2**-0.5, -0.6576984390669531),
        (-4.2, 36, 2**-0.5, 5.015231518611739),
        (80.0, 1000, 2**-0.5, 995.2161017634046),
        (500.0, 10, 2**-0.5, 39.42762053607319),
        (1e6, 5, 0.2, 37.237967534704296),
        (3.0, 2, 5.0, -0.13969377894660898),
    ],
)
def test_bayes_factors_of_any_t(t, n, scale, expected):
    """Oracle: the integral with 40 digits, by adaptive quadrature (mpmath)."""
    assert log_jzs_bayes_factor(t, n, scale) == approx(expected, rel=1e-12, abs=1e-12)


def test_shapiro_is_not_defined_beyond_five_thousand_subjects():
    a, b = np.random.default_rng(0).normal(size=(2, 5001))
    assert np.isnan(run(a, b).shapiro_p)


def test_small_differences_between_people_who_differ_are_not_rounded_away():
    """Their mean was printed as 0, with the interval from −1 to 0."""
    people, differences = np.random.default_rng(3).normal(size=(2, 20))
    found = run(150.0 * people + 0.2 * differences, 150.0 * people)
    numbers = (found.mean_difference, found.ci_low, found.ci_high)
    mean, *ends = (f"{number:.2f}".replace("-", "−") for number in numbers)
    assert f"mean difference {mean}, 95% CI [{', '.join(ends)}]" in found.apa()


def test_the_sentence_judges_at_the_level_of_its_intervals():
    """It said "significant" at .05 beside a 99 % interval that has zero in it."""
    x = np.random.default_rng(0).normal(size=10)
    x = (x - x.mean()) / x.std(ddof=1) + 0.8  # p = .03
    for confidence, verdict in (
        (0.99, "did not differ significantly (α = 0.01)"),
        (0.95, "differed significantly between"),
        (0.9, "differed significantly (α = 0.1)"),
    ):
        assert f"score {verdict}" in run(x, np.zeros(10), confidence=confidence).apa()


@parametrize("test", [partial(tl.equivalence, bound=1.0), tl.bayes_factor])
def test_a_pair_with_one_difference_is_refused(test):
    """Its Bayes factor was NaN, without a word."""
    frame = long([[1, 2, 1], [3, 4, 9], [2, 3, 4], [5, 6, 25]])
    with refused("the same difference between 'a' and 'b'; leave one out"):
        test(frame, **COLUMNS)
