"""p-values in a fixed order of operations. Oracle: SciPy's distributions and special functions."""

import numpy as np
import pytest
from scipy import special, stats

from trustlab.models.portable import log_gamma
from trustlab.reproduction.reconstruction.p_values import (
    exponentials,
    log_p_of_f,
    log_p_of_t,
    logarithms,
)


def test_logarithms_and_exponentials_are_within_a_unit_in_the_last_place():
    rng = np.random.default_rng(0)
    x = 10.0 ** rng.uniform(-300, 300, 20_000)
    reference = np.log(x)
    assert np.abs((logarithms(x) - reference) / np.spacing(np.abs(reference))).max() <= 1.0
    y = rng.uniform(-700, 700, 20_000)
    assert np.abs((exponentials(y) - np.exp(y)) / np.spacing(np.exp(y))).max() <= 1.0
    assert logarithms(np.array([0.0, 1.0, np.inf])).tolist() == [-np.inf, 0.0, np.inf]
    assert np.isnan(logarithms(np.array([-1.0, np.nan]))).all()
    assert exponentials(np.array([-800.0, 0.0, 800.0])).tolist() == [0.0, 1.0, np.inf]


def test_log_gamma_agrees_with_scipy():
    for x in np.random.default_rng(1).uniform(0.01, 300.0, 2_000):
        assert log_gamma(x) == pytest.approx(special.gammaln(x), rel=2e-14, abs=2e-14)


@pytest.mark.parametrize("df", [1.0, 2.0, 17.0, 200.0])
def test_p_of_t_and_its_slope(df):
    t = np.concatenate([np.random.default_rng(2).normal(size=300) * 4.0, [0.0, -60.0]])
    log_p, slope = log_p_of_t(t, df)
    assert log_p == pytest.approx(np.log(2.0 * special.stdtr(df, -np.abs(t))), abs=2e-12)
    expected = -2.0 * np.sign(t) * stats.t.pdf(t, df) / (2.0 * special.stdtr(df, -np.abs(t)))
    assert slope == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("corrected", [False, True])
def test_p_of_f_and_its_slopes(corrected):
    rng = np.random.default_rng(3)
    f = 10.0 ** rng.uniform(-3.0, 1.5, 500)
    epsilon = rng.uniform(0.3, 0.99, 500)
    k, n = 5, 36

    def reference(f, epsilon):
        df1 = (epsilon if corrected else 1.0) * (k - 1)
        return stats.f.logsf(f, df1, df1 * (n - 1))

    log_p, by_f, by_epsilon = log_p_of_f(f, epsilon, k, n, corrected)
    assert log_p == pytest.approx(reference(f, epsilon), rel=1e-10, abs=1e-12)
    df1 = (epsilon if corrected else 1.0) * (k - 1)
    hazard = stats.f.pdf(f, df1, df1 * (n - 1)) / stats.f.sf(f, df1, df1 * (n - 1))
    assert by_f == pytest.approx(-hazard, rel=1e-9)
    step = 1e-5
    slope = (reference(f, epsilon + step) - reference(f, epsilon - step)) / (2.0 * step)
    assert by_epsilon == pytest.approx(slope, rel=1e-4, abs=1e-6)


def test_a_p_too_small_for_a_number_is_a_bound():
    assert log_p_of_t(np.array([1e12]), 80.0)[0] == pytest.approx([np.log(1e-300)])
