"""
Mauchly's test, ε and corrections, by hand and by SciPy; p of Mauchly's test as programs print it.
"""

import numpy as np
import pytest
from scipy import stats

from trustlab.studies.analysis.sphericity import (
    choose_correction,
    corrected_tests,
    greenhouse_geisser,
    huynh_feldt,
    mauchly,
    mauchly_p_value,
    orthonormal_contrasts,
    why_no_mauchly,
)


def test_mauchly_second_order_term_by_hand():
    covariance = np.diag([1.0, 2.0, 4.0])
    found = mauchly(covariance, n=10)
    w = 8.0 / (7.0 / 3.0) ** 3
    rho = 1.0 - (18.0 + 3.0 + 2.0) / (6.0 * 3.0 * 9.0)
    chi2 = -9.0 * rho * np.log(w)
    w2 = 5.0 * 2.0 * 1.0 * (54.0 + 54.0 + 3.0 * 4.0 + 2.0) / (288.0 * (9.0 * 3.0 * rho) ** 2)
    first, second = stats.chi2.sf(chi2, 5), stats.chi2.sf(chi2, 9)
    assert (found.w, found.chi2, found.df) == (pytest.approx(w), pytest.approx(chi2), 5)
    assert found.p == pytest.approx(first + w2 * (second - first), rel=1e-12)
    assert found.p_first_order == pytest.approx(first, rel=1e-12)
    assert found.p != pytest.approx(first, rel=1e-3)  # the term is there


@pytest.mark.parametrize(
    ("chi2", "n", "k", "printed"),
    [
        (10.695, 36, 5, 0.298),  # 0.297 without the second-order term
        (15.030, 36, 5, 0.090),
        (12.085, 36, 5, 0.209),
        (28.304, 36, 5, 0.001),
        (22.655, 36, 5, 0.007),
        (5.14, 30, 4, 0.399),
        (7.785, 30, 4, 0.169),
    ],
)
def test_printed_p_of_mauchly(chi2, n, k, printed):
    """
    Oracle: the dissertation's Sections 2.4.2.4 and 3.9.4, χ² and p as its statistics program
    printed them.
    """
    assert mauchly_p_value(chi2, n, k) == pytest.approx(printed, abs=6e-4)


def test_the_second_order_term_shows_in_the_printed_p():
    assert round(float(mauchly_p_value(10.695, 36, 5)), 3) == 0.298
    assert round(stats.chi2.sf(10.695, 9), 3) == 0.297


def test_mauchly_counts_subjects_itself():
    """
    A full-rank covariance cannot come from so few subjects: rounding does not make it testable.
    """
    assert np.isnan(mauchly(np.diag([1.0, 2.0, 3.0, 4.0]), n=4).p)
    assert np.isfinite(mauchly(np.diag([1.0, 2.0, 3.0, 4.0]), n=5).p)


@pytest.mark.parametrize(
    ("least", "floor", "defined"),
    [
        (1e-15, 0.0, False),  # rounding
        (2.9e-14, 0.0, False),
        (3.1e-14, 0.0, True),
        (1e-3, 1.1e-3, False),  # no more than rounding of the scores can cause
        (1e-3, 0.9e-3, True),
    ],
)
def test_which_eigenvalues_count_as_zero(least, floor, defined):
    result = mauchly(np.diag([1.0, 1.0, least])[None], n=10, floor=floor)
    assert np.isfinite(result.w).tolist() == [defined]
    if defined:
        assert result.w == pytest.approx(least / ((2.0 + least) / 3.0) ** 3, rel=1e-9)


def test_a_p_value_is_at_most_1():
    """The expansion exceeds 1 where subjects are as few as conditions, ten of either here."""
    n, k, chi2 = 10, 10, 26.8
    factor = 9.0 - (2.0 * 81.0 + 9.0 + 2.0) / 54.0
    w2 = 11.0 * 8.0 * 7.0 * (1458.0 + 486.0 + 30.0 + 2.0) / (288.0 * (9.0 * factor) ** 2)
    first, second = stats.chi2.sf(chi2, [44, 48])
    assert first + w2 * (second - first) > 1.0
    assert mauchly_p_value(chi2, n, k) == 1.0


@pytest.mark.parametrize(
    ("n", "k", "w", "words"),
    [
        (9, 2, np.nan, "two conditions"),
        (3, 4, np.nan, "3 subjects are too few for 4 conditions (at least 4 are needed)"),
        (4, 4, np.nan, "singular"),
        (9, 4, np.nan, "singular"),
        (4, 4, 0.5, ""),
    ],
)
def test_why_mauchly_is_not_defined(n, k, w, words):
    reason = why_no_mauchly(n, k, w)
    assert words in reason
    assert bool(reason) == bool(words)


@pytest.mark.parametrize(
    ("correction", "conditions", "p", "epsilon", "applied", "words", "factor"),
    [
        ("auto", 4, 0.05, 0.6, "none", "does not reject", 1.0),
        ("auto", 4, 0.0499, 0.6, "greenhouse-geisser", "p = 0.0499 < 0.05).", 0.6),
        ("auto", 4, 0.01, 0.75, "greenhouse-geisser", "p = 0.01 < 0.05).", 0.75),
        ("auto", 4, 0.01, 0.76, "greenhouse-geisser", "less conservative.", 0.76),
        ("auto", 4, np.nan, 0.6, "greenhouse-geisser", "cannot be tested", 0.6),
        ("auto", 2, np.nan, 1.0, "none", "two conditions", 1.0),
        ("huynh-feldt", 2, np.nan, 1.0, "none", "two conditions", 1.0),
        ("huynh-feldt", 4, 0.9, 0.6, "huynh-feldt", "whatever Mauchly's test says.", 0.7),
        ("none", 4, 0.01, 0.6, "none", "whatever Mauchly's test says.", 1.0),
    ],
)
def test_which_correction_applies(correction, conditions, p, epsilon, applied, words, factor):
    test = {"mauchly_w": p, "mauchly_p": p, "epsilon_gg": epsilon, "epsilon_hf": 0.7}
    test |= {"p": 0.1, "p_gg": 0.2, "p_hf": 0.3}
    d = conditions - 1
    chosen = choose_correction(test, 2 * d, 9 * d, 9, correction, 0.05)
    assert chosen["correction"] == applied
    assert words in chosen["reason"]
    assert ("Huynh–Feldt's is less" in chosen["reason"]) == (words == "less conservative.")
    assert chosen["df1_corrected"] == pytest.approx(2 * d * factor)
    assert chosen["df2_corrected"] == pytest.approx(9 * d * factor)
    p_of = {"none": 0.1, "greenhouse-geisser": 0.2, "huynh-feldt": 0.3}
    assert chosen["p_corrected"] == p_of[applied]


def test_tests_of_an_effect_by_hand():
    """Two columns of groups, three contrasts; F, ε and p by their definitions and SciPy's F."""
    covariance = np.array([[[2.0, 0.3, 0.1], [0.3, 1.0, 0.2], [0.1, 0.2, 0.5]]])
    result = corrected_tests(np.array([12.0]), np.array([30.0]), covariance, 2, 10)
    f = (12.0 / 6.0) / (30.0 / 30.0)
    gg = 3.5**2 / (3.0 * (covariance**2).sum())
    hf = (11.0 * 3.0 * gg - 2.0) / (3.0 * (10.0 - 3.0 * gg))
    expected = {
        "F": f,
        "p": stats.f.sf(f, 6, 30),
        "eta2_partial": 12.0 / 42.0,
        "epsilon_gg": gg,
        "epsilon_hf": min(hf, 1.0),
        "epsilon_hf_untruncated": hf,
        "p_gg": stats.f.sf(f, 6 * gg, 30 * gg),
        "p_hf": stats.f.sf(f, 6 * min(hf, 1.0), 30 * min(hf, 1.0)),
    }
    for name, value in expected.items():
        assert result[name] == pytest.approx([value], rel=1e-12), name
    assert hf < 1.0
    # A Huynh–Feldt ε that has no finite value, or exceeds 1, is cut.
    assert huynh_feldt(np.array([1.0]), 4, 3) == np.inf
    sphere = corrected_tests(np.array([12.0]), np.array([30.0]), np.eye(3)[None], 2, 10)
    assert sphere["epsilon_hf"] == 1.0
    assert sphere["epsilon_hf_untruncated"] == pytest.approx(31.0 / 21.0)
    assert sphere["p_hf"] == pytest.approx(sphere["p"])


@pytest.mark.parametrize("k", [2, 3, 7])
def test_contrasts_are_orthonormal(k):
    contrasts = orthonormal_contrasts(k)
    np.testing.assert_allclose(contrasts.T @ contrasts, np.eye(k - 1), atol=1e-15)
    np.testing.assert_allclose(contrasts.sum(axis=0), 0.0, atol=1e-15)


def test_epsilon_is_one_for_a_sphere_and_least_for_a_line():
    assert greenhouse_geisser(np.eye(4)) == 1.0
    assert greenhouse_geisser(np.diag([1.0, 0.0, 0.0, 0.0])) == 0.25
