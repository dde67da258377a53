"""
Pairs of conditions and adjusted p. Oracles: SciPy, statsmodels, R's p.adjust; theorems. Factorial
pairs: test_factorial.py; with R: test_against_r.py.
"""

import numpy as np
import pytest
from scipy import stats
from statsmodels.stats.multitest import multipletests

import trustlab as tl
from tests.studies.scores import COLUMNS, drawn, long
from tests.studies.test_anova import draw
from trustlab.studies.pairs import bonferroni, condition_pairs, d_z_interval, holm


@pytest.mark.parametrize("size", [1, 2, 6, 45])
def test_adjusted_p_values_against_statsmodels(size):
    p = np.random.default_rng(size).beta(0.3, 1.0, (3, size))
    p[:, 0] = p[:, -1]  # ties
    adjusted = holm(p)
    for row, ours in zip(p, adjusted, strict=True):
        np.testing.assert_allclose(ours, multipletests(row, method="holm")[1], rtol=1e-12)
    assert ((p <= adjusted) & (adjusted <= bonferroni(p))).all()
    np.testing.assert_array_equal(bonferroni(p), np.minimum(size * p, 1.0))


def test_adjusted_p_values_leave_nan_out_of_the_family():
    """Oracle: R, p.adjust(c(0.01, NA, 0.04), "holm") is 0.02 NA 0.04; "bonferroni" 0.02 NA 0.08."""
    p = np.array([0.01, np.nan, 0.04])
    np.testing.assert_allclose(holm(p), [0.02, np.nan, 0.04])
    np.testing.assert_allclose(bonferroni(p), [0.02, np.nan, 0.08])


def test_a_pair_with_one_difference_has_no_t_test():
    array = draw(2, 8, 3)
    array[1, :, 1] = array[1, :, 0] + 0.1
    pairs = condition_pairs(array)
    assert np.isnan(pairs.t).tolist() == [[False] * 3, [True, False, False]]
    assert np.isnan(pairs.p_holm[1]).tolist() == [True, False, False]
    np.testing.assert_allclose(pairs.p_bonferroni[1, 1:], np.minimum(2.0 * pairs.p[1, 1:], 1.0))


@pytest.mark.parametrize(
    ("t", "n"), [(2.5, 12), (-0.3, 5), (0.0, 9), (8.0, 20), (-40.0, 36), (900.0, 6)]
)
def test_the_interval_of_d_z_inverts_the_noncentral_t(t, n):
    """Theorem: the data are 2.5 % unlikely at either limit; oracle, SciPy's noncentral t."""
    low, high = d_z_interval(np.array([t]), n - 1, n**-0.5)
    assert stats.nct.sf(t, n - 1, low * np.sqrt(n)) == pytest.approx([0.025], abs=1e-4)
    assert stats.nct.cdf(t, n - 1, high * np.sqrt(n)) == pytest.approx([0.025], abs=1e-4)
    assert low < t / np.sqrt(n) < high


def test_the_interval_of_d_z_goes_on_where_t_is_huge():
    near, far = (np.array(d_z_interval(np.array([t]), 9, 0.1)) / t for t in (999.0, 1001.0))
    np.testing.assert_allclose(near, far, rtol=1e-3)


def test_two_names_of_one_factor_are_refused():
    result = tl.repeated_measures(long(draw(1, 9, 4)[0]), **COLUMNS)
    with pytest.raises(ValueError, match="factor and at are both 'mode'; name two factors"):
        result.pairs("mode", at="mode")


def test_the_only_factor_within_subjects_is_compared_without_its_name():
    result = tl.repeated_measures(drawn(), **COLUMNS, between="group")
    assert result.pairs().equals(result.pairs("mode"))
