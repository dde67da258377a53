"""
What papers correct by ε is recognised, and a contradiction is never called consistent.

Oracle: p of F by SciPy at degrees of freedom written out here; the ε of a reading by `brentq`.
"""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy import optimize, stats

import trustlab as tl
from tests import textbook
from trustlab.reproduction import reconstruct_study
from trustlab.reproduction.reconstruction.constraints import BOTH, NEITHER, ONLY_DF, ONLY_P
from trustlab.reproduction.reconstruction.contradictions import contradictions, reading_of


def study(anova, epsilon="", n=18):
    return tl.PublishedStudy(
        "s",
        n=n,
        mean={"A": "2.31", "B": "3.05", "C": "3.40", "D": "2.90"},
        sd={"A": "0.84", "B": "0.79", "C": "0.95", "D": "1.02"},
        anova=anova,
        epsilon=epsilon,
        scale=(1, 7),
    )


def text_of_p(f, epsilon, decimals=3):
    return f"{stats.f.sf(f, 3 * epsilon, 51 * epsilon):.{decimals}f}"


PLAIN = {"F": "4.10", "df1": "3", "df2": "51"}
CORRECTED = {"F": "4.10", "df1": "1.65", "df2": "28.05"}
CASES = [
    (PLAIN, text_of_p(4.1, 1.0), "", NEITHER),
    (PLAIN, text_of_p(4.1, 1.0), "0.55", NEITHER),
    (CORRECTED, text_of_p(4.1, 0.55), "0.55", BOTH),
    (CORRECTED, text_of_p(4.1, 0.55), "", BOTH),
    (PLAIN, text_of_p(4.1, 0.55), "0.55", ONLY_P),
    (PLAIN, text_of_p(4.1, 0.55), "", ONLY_P),
    (PLAIN, ".03", "0.55", ONLY_P),
    (CORRECTED, text_of_p(4.1, 1.0), "0.55", ONLY_DF),
]


@pytest.mark.parametrize(("anova", "p", "epsilon", "reading"), CASES)
def test_what_was_corrected_is_recognised(anova, p, epsilon, reading):
    printed = study({**anova, "p": p}, epsilon)
    assert reading_of(printed) == reading
    answer = tl.feasibility(printed)
    assert answer.feasible
    assert answer.left_out == {}
    assert answer.reading == reading.words
    assert reading.words in answer.message
    table = reconstruct_study(printed).table()
    assert table["agrees"].all()
    assert {"anova.df1", "anova.df2", "anova.p"} <= set(table.index)
    # Oracle: the p of the reconstructed F at degrees of freedom with the reconstructed ε.
    if reading.words.startswith("corrected p, uncorrected"):
        uncorrected = stats.f.sf(float(anova["F"]), 3, 51)
        assert f"uncorrected, p would be {uncorrected:.3f}".replace("be 0", "be ") in answer.message
    if reading.p and epsilon:
        e = table.loc["epsilon", "reconstructed"]
        expected = stats.f.sf(table.loc["anova.F", "reconstructed"], 3 * e, 51 * e)
        assert table.loc["anova.p", "reconstructed"] == pytest.approx(expected, rel=1e-9)


def test_a_rounded_epsilon_is_recognised():
    printed = study({**CORRECTED, "p": text_of_p(4.1, 0.55)}, "0.554")
    answer = tl.feasibility(printed)
    assert answer.feasible
    assert answer.reading.endswith("ε rounded to 0.55")
    table = reconstruct_study(printed).table()
    assert table["agrees"].all()
    assert 0.5535 <= table.loc["epsilon", "reconstructed"] <= 0.5545
    assert table.loc["anova.df2", "reconstructed"] == pytest.approx(51 * 0.55)
    # Negative control: a third ε fits nothing.
    assert not tl.feasibility(study({**CORRECTED, "p": ".034"}, "0.614"), explain=False).feasible


def test_the_epsilon_that_would_fit_is_named():
    def miss(epsilon, p, f):
        return stats.f.sf(f, 3 * epsilon, 51 * epsilon) - p

    answer = tl.feasibility(study({**PLAIN, "p": ".03"}))
    # A larger ε gives a smaller p: the least ε belongs to the greatest p and the greatest F.
    least = optimize.brentq(miss, 1 / 3, 1.0, args=(0.035, 4.105))
    most = optimize.brentq(miss, 1 / 3, 1.0, args=(0.025, 4.095))
    np.testing.assert_allclose(answer.epsilon, (least, most), atol=4e-4)
    assert f"ε from {answer.epsilon[0]:.3f} to {answer.epsilon[1]:.3f}" in answer.message


def test_a_contradiction_is_never_consistent():
    """F(3, 57) with n = 18: degrees of freedom of 20 people."""
    answer = tl.feasibility(study({"F": "4.10", "df1": "3", "df2": "57", "p": ".03"}))
    assert not answer
    assert answer.feasible is False
    assert answer.rest_feasible
    assert "belong to 4 conditions, n = 20" in answer.left_out["anova.df2"]
    assert answer.left_out["anova.df2"] in answer.message
    assert answer.table().loc["anova.df2", "left_out"] == answer.left_out["anova.df2"]
    table = reconstruct_study(answer.study).table()
    assert table.loc["anova.df2", "printed"] == "57"
    assert table.loc["anova.df2", "reconstructed"] == 51.0
    assert list(table.index[~table["agrees"]]) == ["anova.df2"]
    # The n that the message names is consistent.
    assert tl.feasibility(study({"F": "4.10", "df1": "3", "df2": "57", "p": ".03"}, n=20)).feasible


def print_of(values, reading, decimals):
    """What a paper would print of data, by the textbook's sums of squares."""
    found = textbook.analysed(values)
    epsilon = found["epsilon"]
    df, p = (epsilon if corrected else 1.0 for corrected in (reading.df, reading.p))
    places = decimals if reading.df else 0
    return tl.PublishedStudy(
        "s",
        len(values),
        **textbook.printed_cells(found, 2),
        anova=textbook.printed_anova(found, values.shape, df, p, places),
        epsilon=f"{epsilon:.{decimals}f}",
    )


@settings(max_examples=60)
@given(
    st.integers(0, 2**32 - 1),
    st.sampled_from([3, 4, 5]),
    st.sampled_from([NEITHER, BOTH, ONLY_P, ONLY_DF]),
    st.integers(2, 3),
)
def test_no_reading_of_true_data_is_called_a_contradiction(seed, k, reading, decimals):
    rng = np.random.default_rng(seed)
    values = rng.normal(size=(k + 3 + seed % 30, k)) @ rng.normal(size=(k, k)) + rng.normal(size=k)
    printed = print_of(values, reading, decimals)
    assert contradictions(printed) == {}
    assert reading_of(printed).df == reading.df or printed.anova["df1"] == f"{k - 1:.{decimals}f}"
