"""Statistics of moments against pingouin on data; gradients against central differences."""

import numpy as np
import pandas as pd
import pytest

from trustlab.reproduction.reconstruction.constraints import Constraint
from trustlab.reproduction.reconstruction.moment_search import MomentProblem
from trustlab.reproduction.reconstruction.moment_statistics import MomentStatistics
from trustlab.reproduction.reconstruction.reconstruction import adjusted
from trustlab.studies.anova import mauchly_p_value


def data(k, n, seed=0):
    rng = np.random.default_rng(seed)
    return rng.normal(size=(n, k)) @ rng.normal(size=(k, k)) + rng.normal(size=k)


def moments(x, corrected=True):
    return MomentStatistics(x.mean(axis=0)[None], np.cov(x.T)[None], len(x), corrected)


@pytest.mark.parametrize("k", [3, 4, 5])
def test_statistics_are_those_of_pingouin(k):
    import pingouin

    x = data(k, 25)
    long = pd.DataFrame(x).melt(ignore_index=False, var_name="c", value_name="v").reset_index()
    table = pingouin.rm_anova(
        long, dv="v", within="c", subject="index", correction=True, effsize="np2"
    ).iloc[0]
    sphericity = pingouin.sphericity(pd.DataFrame(x))
    ours = moments(x)
    assert ours.f_ratio[0] == pytest.approx(table["F"], rel=1e-10)
    assert ours.epsilon[0] == pytest.approx(table["eps"], rel=1e-10)
    assert np.exp(ours.log_anova_p[0]) == pytest.approx(table["p_GG_corr"], rel=1e-8)
    assert ours.chi2[0] == pytest.approx(sphericity.chi2, rel=1e-10)
    assert mauchly_p_value(ours.chi2[0], 25, k) == pytest.approx(sphericity.pval, rel=1e-9)
    t = pingouin.ttest(x[:, 0], x[:, 2], paired=True).iloc[0]
    assert ours.t[0, 1] == pytest.approx(t["T"], rel=1e-10)
    assert np.exp(ours.log_p[0, 1]) == pytest.approx(t["p_val"], rel=1e-10)


@pytest.mark.parametrize(
    "kind", ["mean", "sd", "f_ratio", "epsilon", "chi2", "log_p", "log_anova_p"]
)
def test_gradients_are_those_of_central_differences(kind):
    k = 4
    n = 20
    h = 1e-6
    x = data(k, n, 1)
    mean, covariance = x.mean(axis=0), np.cov(x.T)

    def value(m, s):
        return np.atleast_1d(getattr(MomentStatistics(m[None], s[None], n, True), kind)[0])

    by_mean, by_covariance = getattr(moments(x), f"gradient_{kind}")
    for i in range(k):
        e = h * np.eye(k)[i]
        numeric = (value(mean + e, covariance) - value(mean - e, covariance)) / (2 * h)
        np.testing.assert_allclose(by_mean[0, :, i], numeric, rtol=1e-5, atol=1e-7)
        for j in range(i, k):
            change = np.zeros((k, k))
            change[i, j] = change[j, i] = h
            numeric = (value(mean, covariance + change) - value(mean, covariance - change)) / (
                2 * h
            )
            ours = by_covariance[0, :, i, j] * (1 if i == j else 2)
            np.testing.assert_allclose(ours, numeric, rtol=1e-5, atol=1e-6)


def test_holm_in_the_search_is_holm_by_definition():
    x = data(4, 20, 2)
    rows = [Constraint("p", "log_adjusted_p", q, -1.0, 0.0, "") for q in range(6)]
    problem = MomentProblem(rows, 20, 4, "holm")
    ours = np.exp(problem.values(moments(x))[0][0])
    p = np.exp(moments(x).log_p[0])
    np.testing.assert_allclose(np.minimum(ours, 1.0), adjusted(p, "holm"), rtol=1e-12)
    statsmodels = pytest.importorskip("statsmodels.stats.multitest")
    for ours_name, theirs in (("holm", "holm"), ("bonferroni", "bonferroni"), ("sidak", "sidak")):
        np.testing.assert_allclose(
            adjusted(p, ours_name), statsmodels.multipletests(p, method=theirs)[1], rtol=1e-10
        )
