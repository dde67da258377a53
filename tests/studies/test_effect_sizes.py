"""
The interval of partial η². Oracles: SciPy's noncentral F, tests by simulation; R in
test_against_r.py.
"""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy import stats

import trustlab as tl
from tests.studies.scores import COLUMNS, long
from trustlab.studies import partial_eta_interval

fs = st.floats(1e-3, 1e4)
dfs = st.tuples(st.integers(1, 12), st.integers(2, 300))


@settings(max_examples=80, deadline=None, derandomize=True)
@given(fs, dfs)
def test_limits_invert_the_noncentral_f(f, df):
    """
    Theorem: the data are 5 % unlikely at either limit, or the limit is 0 where even no effect makes
    them likelier.
    """
    found = partial_eta_interval(f, *df)
    for limit, tail in (
        (found.noncentrality_low, stats.ncf.sf),
        (found.noncentrality_high, stats.ncf.cdf),
    ):
        if limit > 0.0:
            assert tail(f, *df, limit) == pytest.approx(0.05, abs=1e-8)
    assert (found.noncentrality_low > 0.0) == (stats.f.sf(f, *df) < 0.05)
    assert (found.noncentrality_high > 0.0) == (stats.f.cdf(f, *df) > 0.05)
    assert 0.0 <= found.low <= found.high < 1.0
    assert found.high == pytest.approx(
        found.noncentrality_high / (found.noncentrality_high + sum(df))
    )


@pytest.mark.parametrize("eta2", [0.1, 0.5])
def test_coverage_of_eta2_in_small_studies(eta2):
    """
    Theorem: with two conditions F is noncentral with λ = n η²/(1 − η²), so that the interval covers
    η² in 90 %.
    """
    n, rng = 5, np.random.default_rng(8)
    t = stats.nct.rvs(n - 1, np.sqrt(n * eta2 / (1.0 - eta2)), size=1000, random_state=rng)
    found = [partial_eta_interval(f, 1, n - 1) for f in t**2]
    share = np.mean([x.low <= eta2 <= x.high for x in found])
    assert abs(share - 0.90) < 4.0 * np.sqrt(0.09 / len(found))


def test_the_interval_is_that_of_the_test_with_its_correction():
    """
    Without sphericity the 90 % interval excludes 0 where the corrected p is below .05, and only
    there.
    """
    rng = np.random.default_rng(5)
    excluded = 0
    for _ in range(80):
        scores = rng.standard_normal((8, 5)) * [1.0, 1.0, 2.0, 4.0, 8.0]
        scores[:, 3] += 5.0
        result = tl.repeated_measures(long(scores), **COLUMNS)
        assert (result.eta2_partial_low > 0.0) == (result.p_corrected < 0.05)
        excluded += result.eta2_partial_low > 0.0
    assert 20 < excluded < 60


@pytest.mark.parametrize("df", [(3, 60), (1, 4), (4.2, 77.7)])
def test_large_f(df):
    """
    1 − η² is inversely proportional to a large F; oracle, the noncentral F of SciPy where it is
    still good.
    """
    low = [1.0 - partial_eta_interval(f, *df).low for f in (1e7, 1e9, 1e12)]
    np.testing.assert_allclose([low[0] / 1e2, low[1]], [low[1], low[1]], rtol=1e-5)
    assert low[2] == pytest.approx(low[1] / 1e3, rel=1e-2)  # the digits that 1 − η² has left
    assert partial_eta_interval(1e200, *df).high == 1.0
