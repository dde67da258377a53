"""
Pairs of conditions and effect sizes with their intervals.

Oracles: R's p.adjust, theorems, SciPy's noncentral distributions. Factorial pairs:
test_factorial.py; with R: test_against_r.py.
"""

from itertools import product

import numpy as np
from hypothesis import given, settings, strategies as st
from numpy.testing import assert_allclose
from scipy import stats

import trustlab as tl
from tests.cases import refused
from tests.studies.scores import COLUMNS, approx, drawn, parametrize
from trustlab.studies import partial_eta_interval
from trustlab.studies.pairs import bonferroni, d_z_interval, holm

# --- pairs ----------------------------------------------------------------------------------------


def test_adjusted_p_values_leave_nan_out_of_the_family():
    """Oracle: R, p.adjust(c(0.01, NA, 0.04), "holm") is 0.02 NA 0.04; "bonferroni" 0.02 NA 0.08."""
    p = np.array([[0.01, np.nan, 0.04], [0.7, 0.6, 0.3]])
    assert_allclose(holm(p), [[0.02, np.nan, 0.04], [1.0, 1.0, 0.9]])
    assert_allclose(bonferroni(p), [[0.02, np.nan, 0.08], [1.0, 1.0, 0.9]])


FAR = [(2.5, 12, 0.95), (8.0, 20, 0.95), (-40.0, 36, 0.95), (900.0, 6, 0.95)]
NEAR = product([0.0, 0.01, -0.05, 0.3], [10], [0.8, 0.99, 0.9999])


@parametrize(("t", "n", "level"), [*FAR, *NEAR])
def test_the_interval_of_d_z_inverts_the_noncentral_t(t, n, level):
    """
    Theorem: the data are as unlikely at either limit as the level says; near no difference the
    interval was that of t = 0. Oracle: SciPy's noncentral t.
    """
    low, high = d_z_interval(np.array([t]), n - 1, n**-0.5, level)
    assert low < t / np.sqrt(n) < high
    tails = stats.nct.sf(t, n - 1, low * np.sqrt(n)), stats.nct.cdf(t, n - 1, high * np.sqrt(n))
    assert_allclose(np.ravel(tails), 0.5 - 0.5 * level, rtol=1e-6)


def test_the_interval_of_d_z_goes_on_where_t_is_huge():
    near, far = (np.array(d_z_interval(np.array([t]), 9, 0.1)) / t for t in (999.0, 1001.0))
    assert_allclose(near, far, rtol=1e-3)


def test_the_only_factor_within_subjects_is_compared_without_its_name():
    result = tl.repeated_measures(drawn(), **COLUMNS, between="group")
    assert result.pairs().equals(result.pairs("mode"))
    with refused("factor and at are both 'mode'; name two factors"):
        result.pairs("mode", "mode")
    with refused("have no effect on ranks"):
        tl.repeated_measures(drawn(), **COLUMNS).pairs(method="wilcoxon", confidence=0.9)


# --- effect sizes ---------------------------------------------------------------------------------


fs = st.floats(1e-3, 1e4)
dfs = st.tuples(st.integers(1, 12), st.integers(2, 300))


@settings(max_examples=80)
@given(fs, dfs)
def test_limits_invert_the_noncentral_f(f, df):
    """
    Theorem: the data are 5 % unlikely at either limit, or the limit is 0 where even no effect makes
    them likelier.
    """
    low, high, *limits = partial_eta_interval(f, *df)
    for limit, tail, above in zip(
        limits,
        (stats.ncf.sf, stats.ncf.cdf),
        (stats.f.sf(f, *df) < 0.05, stats.f.cdf(f, *df) > 0.05),
        strict=True,
    ):
        assert (limit > 0.0) == above
        if above:
            assert tail(f, *df, limit) == approx(0.05, abs=1e-8)
    assert 0.0 <= low <= high < 1.0
    # λ = n η²/(1 − η²) in the population, with n = 1 + df2 where there are two conditions.
    assert [low, high] == approx([limit / (limit + sum(df)) for limit in limits])


@parametrize("df", [(3, 60), (1, 2), (4.2, 77.7)])
def test_large_f(df):
    """
    1 − η² is inversely proportional to a large F; oracle, the noncentral F of SciPy where it is
    still good.
    """
    low = [1.0 - partial_eta_interval(f, *df).low for f in (1e7, 1e9, 1e12)]
    assert_allclose([low[0] / 1e2, low[1]], [low[1], low[1]], rtol=1e-5)
    assert low[2] == approx(low[1] / 1e3, rel=1e-2)  # the digits that 1 − η² has left
    assert partial_eta_interval(1e200, *df).high == 1.0
    assert 0.99 < partial_eta_interval(1e11, 1, 1).low < 1.0
