"""
Power: closed forms beside scipy and statsmodels, simulation beside closed forms and brute force,
refusals.
"""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings, strategies as st
from scipy import stats

import trustlab as tl
from tests.studies.planning.settings import settled
from tests.studies.scores import COLUMNS, drawn, long
from trustlab.studies import graded_covariance
from trustlab.studies.planning.conditions import Conditions
from trustlab.studies.planning.power import TESTS

MEANS = [0.0, 0.1, 0.4, 0.5, 0.5]


# --- closed forms ---------------------------------------------------------------------------------


def noncentral_f(n, k, strength, alpha=0.05):
    df1, df2 = k - 1, (k - 1) * (n - 1)
    return stats.ncf.sf(stats.f.isf(alpha, df1, df2), df1, df2, strength)


# --- covariances ----------------------------------------------------------------------------------


@given(st.integers(2, 9), st.floats(0.0, 1.0), st.floats(0.02, 1.0), st.floats(0.01, 100.0))
@settings(max_examples=150, deadline=None, derandomize=True)
def test_a_graded_covariance_has_what_was_asked_for(k, place, share, sd):
    d = k - 1
    rho = -1.0 / d + (1.0 / d + 0.99) * (0.001 + 0.998 * place)
    epsilon = 1.0 if d == 1 else 1.0 / d + (1.0 - 1.0 / d) * share
    matrix = graded_covariance(k, rho, epsilon, sd)
    population = Conditions(tuple(range(k)), np.arange(float(k)), matrix)
    assert np.trace(matrix) / k == pytest.approx(sd**2, rel=1e-9)
    assert population.correlation == pytest.approx(rho, abs=1e-9)
    assert population.epsilon == pytest.approx(epsilon, abs=1e-7)
    assert np.linalg.eigvalsh(matrix)[0] > 0.0


@given(st.floats(0.001, 0.95), st.integers(0, 50))
@settings(max_examples=50, deadline=None, derandomize=True)
def test_an_effect_is_reached_and_its_pattern_kept(eta2, seed):
    rng = np.random.default_rng(seed)
    root = rng.standard_normal((4, 4))
    population = Conditions(range(4), rng.normal(size=4), root @ root.T + 0.1 * np.eye(4))
    scaled = population.with_effect(eta2)
    assert scaled.eta2_partial == pytest.approx(eta2, rel=1e-9)
    assert scaled.mean.mean() == pytest.approx(population.mean.mean(), abs=1e-9)
    assert np.corrcoef(scaled.mean, population.mean)[0, 1] == pytest.approx(1.0, abs=1e-9)
    assert population.with_effect(0.0).eta2_partial == 0.0


# --- simulation beside closed forms ---------------------------------------------------------------


@pytest.fixture(scope="module")
def grid():
    """36 × 5, twenty cases with sphericity, 10,000 studies each."""
    return settled(
        tl.power_analysis,
        MEANS,
        graded_covariance(5),
        n=36,
        effect_size=[0.01, 0.03, 0.05, 0.08, 0.12],
        correlation=[-0.1, 0.2, 0.5, 0.8],
        replicates=10_000,
        seed=4,
    )


def deviations(rows, closed):
    return (rows["power"] - closed) / np.sqrt(closed * (1.0 - closed) / rows["replicates"])


def test_twenty_cases_agree_with_the_noncentral_f(grid):
    rows = grid.table().query("test == 'none'")
    oracle = noncentral_f(36, 5, 36 * 4 / (1.0 / rows["effect_size"] - 1.0))
    np.testing.assert_allclose(rows["closed_form"], oracle, atol=1e-10)
    z = deviations(rows, oracle)
    assert len(z) == 20
    assert z.abs().max() < 4.0
    assert (z**2).sum() < stats.chi2.isf(1e-3, 20)
    assert rows["power"].between(rows["ci_low"], rows["ci_high"]).all()


@pytest.mark.parametrize(("n", "k"), [(12, 4), (3, 5)])
def test_counts_are_those_of_repeated_measures_study_by_study(n, k):
    replicates, claims = 100, [(k, 1), (2, k)]
    matrix, mean = graded_covariance(k, 0.4, 0.5, 1.0), np.linspace(0.0, 1.5, k)
    found = settled(
        tl.power_analysis, mean, matrix, n=n, replicates=replicates, seed=3, claims=claims
    )
    rng = np.random.default_rng(np.random.SeedSequence(3, spawn_key=(n,)))
    scores = rng.standard_normal((replicates, n, k)) @ np.linalg.cholesky(matrix).T + mean
    hits, together = 0, 0
    for study in scores:
        result = tl.repeated_measures(long(study, range(1, k + 1)), **COLUMNS, correction="auto")
        p = [result.p, result.p_gg, result.p_hf, result.p_corrected]
        hits = hits + (pd.Series(p, TESTS) < 0.05)
        table = result.pairs().set_index(["a", "b"])
        right = (table["p_holm"] < 0.05) & (table["mean_difference"] < 0)  # means rise
        together += bool(right[(1, k)] and right[(2, k)] and result.p_gg < 0.05)
    rows = found.table().set_index("test")["power"] * replicates
    assert rows.round().to_dict() == hits.to_dict()
    claimed = found.claims().set_index("adjust").loc["holm"]
    assert round(claimed["power"] * replicates) == together
    assert claimed["expected_found"] <= claimed["claims"] == 2


def test_a_grid_has_a_row_per_cell_and_test_and_draws_itself():
    grid = {"n": [5, 9], "effect_size": [0.1, 0.3], "correlation": [0.0, 0.5]}
    found = settled(tl.power_analysis, [0, 1], graded_covariance(2), **grid, replicates=100)
    assert len(found.table()) == 2 * 2 * 2 * len(TESTS)
    assert set(found.table()["epsilon"]) == {1.0}
    axes = found.plot()
    assert axes.get_xlabel() == "participants n"
    assert len(axes.get_legend().get_texts()) == 4
    assert "simulated studies" in found._repr_html_()


# --- the smallest n -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("chosen", "closed"),
    [
        (
            {"effect_size": 0.1, "test": "none", "replicates": 4000},
            lambda n: noncentral_f(n, 5, n * 4 / 9),
        ),
        (
            {"pair": (5, 1), "test": "bonferroni", "replicates": 2000},
            lambda n: noncentral_f(n, 2, n * 0.5**2, 0.005),
        ),
    ],
)
def test_the_smallest_n_is_that_of_the_closed_form(chosen, closed):
    found = settled(tl.smallest_n, 0.8, MEANS, graded_covariance(5), **chosen, seed=2)
    exact = next(n for n in range(3, 400) if closed(n) >= 0.8)
    assert abs(found.n - exact) <= 0.05 * exact
    assert found.ci_low <= closed(found.n) <= found.ci_high
    tried = found.evaluations.set_index("n")["power"]
    assert tried[found.n] == found.power >= 0.8 > tried[found.n - 1]
    assert found.whole_squares % 10 == 0
    assert found.whole_squares >= found.n
    name = "5 – 1" if "pair" in chosen else "F"
    assert found.table()["test"].item() == f"{name}, {chosen['test']}"
    assert "simulated" in found._repr_html_()


# --- refusals -------------------------------------------------------------------------------------

POPULATION = {"mean": [0.0, 0.5, 1.0], "covariance": graded_covariance(3), "replicates": 100}


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"covariance": np.eye(3) + np.eye(3, k=1)}, r"symmetric, but \[0, 1\]"),
        ({"covariance": np.ones((3, 3))}, "not positive definite"),
        ({"claims": [(1, 2), (2, 1)]}, "claimed twice"),
        ({"claims": [(1, 1)]}, r"claims must be pairs \(a, b\) of \[1, 2, 3\]"),
        ({"correlation": 1.0}, "correlation must lie between"),
        ({"data": pd.DataFrame()}, "give either data= or covariance="),
    ],
)
def test_what_cannot_be_simulated_is_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        settled(tl.power_analysis, **POPULATION | arguments)


def pilot():
    """Scores of 30 people in C1 to C3 around 2, whose spread is 0.3 of that of `drawn`."""
    frame = drawn(30, mode=["C1", "C2", "C3"])
    return frame.assign(score=2.0 + 0.3 * frame["score"])


def planned(*population, **more):
    """The smallest n for a power of 0.8 by few simulated studies."""
    columns = tl.studies.StudyColumns(**COLUMNS) if "data" in more else tl.studies.StudyColumns()
    simulation = tl.studies.Simulation(replicates=400, seed=4)
    return tl.smallest_n(0.8, *population, **more, columns=columns, simulation=simulation)


def test_means_beside_data_take_the_spread_of_the_pilot():
    wide = pilot().pivot_table(index="person", columns="mode", values="score")[["C3", "C1"]]
    plan = planned({"C3": 2.1, "C1": 2.0}, data=pilot())
    expected = planned([2.1, 2.0], np.cov(wide.to_numpy().T))
    assert (plan.n, plan.power) == (expected.n, expected.power)
    assert plan.population.labels == ("C3", "C1")
    with pytest.raises(ValueError, match=r"mean names \['C9'\], but data hold"):
        planned({"C1": 2.0, "C9": 2.1}, data=pilot())


def test_a_plan_says_what_it_assumes():
    with pytest.warns(UserWarning, match="covariance is that of synthetic data"):
        plan = planned({"C1": 2.0, "C3": 2.1}, data=pilot().assign(synthetic=True))
    text = plan.apa()
    assert f"A sample of {plan.n} participants" in text
    assert "400 simulated studies (seed 4)" in text
    assert "C1 2 (" in text
    assert "The covariance is that of synthetic data" in text
    # The noncentral t of a paired comparison, n searched one by one. Oracle: SciPy.
    d_z = abs(plan.population.d_z[0])
    for name, scale in (("half", 0.5), ("twice", 2.0)):
        n = np.arange(3, 10_000)
        strength, critical = np.sqrt(n) * d_z / scale, stats.t.ppf(0.975, n - 1)
        power = stats.nct.sf(critical, n - 1, strength) + stats.nct.cdf(-critical, n - 1, strength)
        assert plan.n_by_spread[name] == n[np.argmax(power >= 0.8)]
        assert str(plan.n_by_spread[name]) in text
