"""
Power. Oracles: the noncentral F of SciPy, a plain loop of tl.repeated_measures over the same draws,
sums of squares by hand, theorems.
"""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings, strategies as st
from pandas.testing import assert_frame_equal
from scipy import stats

import trustlab as tl
from tests.cases import refused
from tests.studies.scores import COLUMNS, approx, drawn, long, parametrize
from trustlab.studies import Conditions, Simulation, StudyColumns, graded_covariance

MEANS = [0.0, 0.1, 0.4, 0.5, 0.5]
SMALL = Simulation(replicates=100, seed=3)


def noncentral_f(n, k, strength, alpha=0.05):
    df1, df2 = k - 1, (k - 1) * (n - 1)
    return stats.ncf.sf(stats.f.isf(alpha, df1, df2), df1, df2, strength)


# --- populations ----------------------------------------------------------------------------------


@given(st.integers(2, 9), st.floats(0.0, 1.0), st.floats(0.02, 1.0), st.floats(0.01, 100.0))
@settings(max_examples=150)
def test_a_graded_covariance_has_what_was_asked_for(k, place, share, sd):
    d = k - 1
    rho = -1.0 / d + (1.0 / d + 0.99) * (0.001 + 0.998 * place)
    epsilon = 1.0 if d == 1 else 1.0 / d + (1.0 - 1.0 / d) * share
    matrix = graded_covariance(k, rho, epsilon, sd)
    assert np.trace(matrix) / k == approx(sd**2, rel=1e-9)
    assert matrix[~np.eye(k, dtype=bool)].mean() == approx(rho * sd**2, abs=1e-9 * sd**2)
    centre = np.eye(k) - 1.0 / k
    between = centre @ matrix @ centre
    found = np.trace(between) ** 2 / (d * (between**2).sum())
    assert found == approx(epsilon, abs=1e-7)
    assert np.linalg.eigvalsh(matrix)[0] > 0.0


@given(st.floats(0.001, 0.95), st.integers(0, 50))
@settings(max_examples=50)
def test_an_effect_is_reached_and_its_pattern_kept(eta2, seed):
    """Oracle: S/(S + tr M), the covariance of contrasts by centring rows and columns."""
    rng = np.random.default_rng(seed)
    root = rng.standard_normal((4, 4))
    population = Conditions(range(4), rng.normal(size=4), root @ root.T + 0.1 * np.eye(4))
    change, before = (m - m.mean() for m in (population.with_effect(eta2).mean, population.mean))
    trace = np.trace((np.eye(4) - 0.25) @ population.covariance)
    s = (change**2).sum()
    assert s / (s + trace) == approx(eta2, rel=1e-9)
    assert np.corrcoef(change, before)[0, 1] == approx(1.0, abs=1e-9)
    assert np.ptp(population.with_effect(0.0).mean) == 0.0


# --- simulation beside closed forms ---------------------------------------------------------------


def test_fifteen_cases_agree_with_the_noncentral_f():
    """36 × 5, 10,000 studies each; cases of one size share their draws."""
    of = {"n": [12, 36, 60], "effect_size": [0.01, 0.03, 0.05, 0.08, 0.12]}
    many = Simulation(replicates=10_000, seed=4)
    found = tl.power_analysis(MEANS, graded_covariance(5), **of, simulation=many)
    rows = found.table().query("test == 'none'")
    oracle = noncentral_f(rows["n"], 5, rows["n"] * 4 / (1.0 / rows["effect_size"] - 1.0))
    np.testing.assert_allclose(rows["closed_form"], oracle, atol=1e-10)
    z = (rows["power"] - oracle) / np.sqrt(oracle * (1.0 - oracle) / rows["replicates"])
    assert len(z) == 15
    assert z.abs().max() < 4.0
    assert rows["power"].between(rows["ci_low"], rows["ci_high"], inclusive="neither").all()


@parametrize(("n", "k"), [(12, 4), (3, 5)])
def test_counts_are_those_of_repeated_measures_study_by_study(n, k):
    claims = [(k, 1), (2, k)]
    matrix, mean = graded_covariance(k, 0.4, 0.5, 1.0), np.linspace(0.0, 1.5, k)
    found = tl.power_analysis(mean, matrix, n=n, simulation=SMALL, claims=claims)
    rng = np.random.default_rng(np.random.SeedSequence(3, spawn_key=(n,)))
    scores = rng.standard_normal((100, n, k)) @ np.linalg.cholesky(matrix).T + mean
    hits = []
    for study in scores:
        result = tl.repeated_measures(long(study, range(1, k + 1)), **COLUMNS)
        pairs = result.pairs().set_index(["a", "b"]).loc[[(1, k), (2, k)]]
        right = (pairs["p_holm"] < 0.05) & (pairs["mean_difference"] < 0)  # means rise
        p = np.array([result.p, result.p_gg, result.p_hf])
        hits.append([*(p < 0.05), right.all() and result.p_gg < 0.05])
    *powers, together = np.sum(hits, axis=0)
    assert (found.table()["power"] * 100).round().tolist() == powers
    claimed = found.claims().set_index("adjust").loc["holm"]
    assert (round(claimed["power"] * 100), claimed["claims"]) == (together, 2)


CELLS = pd.MultiIndex.from_product([["low", "high"], ["easy", "medium", "hard"]])
TWO_WAY = pd.Series([0.0, 0.3, 0.1, 0.2, 0.6, 0.7], CELLS)
MIXED = pd.Series({("g", 0.0): 0.0, ("g", 1.0): 0.3, ("h", 0.0): 0.0, ("h", 1.0): 0.8})
FACTORS = StudyColumns(within=["autonomy", "difficulty"])


@parametrize(
    ("mean", "covariance", "columns"),
    [
        (TWO_WAY, graded_covariance(6), FACTORS),
        (MIXED, graded_covariance(2, 0.4), StudyColumns(within="test", between="group")),
    ],
)
def test_several_factors_agree_with_the_closed_form(mean, covariance, columns):
    simulation = Simulation(replicates=4000)
    power = tl.power_analysis(mean, covariance, columns=columns, n=[12, 24], simulation=simulation)
    closed = power.table().dropna(subset="closed_form")
    assert {*closed["effect"]} == {*power.table()["effect"]}
    exact = closed["closed_form"]
    error = np.sqrt(exact * (1.0 - exact) / 4000)
    assert ((closed["power"] - exact).abs() < 4.0 * error + 1e-12).all()


def test_a_grid_is_drawn():
    grid = {"n": [5, 9], "effect_size": [0.1, 0.3], "simulation": SMALL}
    axes = tl.power_analysis([0, 1], graded_covariance(2), **grid).plot()
    assert axes.get_xlabel() == "participants n"
    assert len(axes.get_legend().get_texts()) == 2
    assert "simulated studies" in axes.get_title()


# --- pilot studies --------------------------------------------------------------------------------


def test_a_pilot_study_is_the_population():
    """Oracle: means and pooled covariance of the groups, given as such."""
    order = {"autonomy": ["low", "high"], "difficulty": ["easy", "medium", "hard"]}
    frame = drawn(20, **order)
    frame.attrs["synthetic"] = True
    columns = StudyColumns("score", [*order], "person", "group", order)
    with pytest.warns(UserWarning, match="covariance is that of synthetic data"):
        found = tl.power_analysis(data=frame, n=8, columns=columns, simulation=SMALL)
    people = frame.sort_values("group", kind="stable")
    cells = people.groupby(["group", *order], sort=False)["score"]
    residual = (people["score"] - cells.transform("mean")).to_numpy().reshape(20, 6)
    population = cells.mean(), residual.T @ residual / 18
    factors = StudyColumns(within=[*order], between="group")
    given = tl.power_analysis(*population, n=8, columns=factors, simulation=SMALL)
    assert_frame_equal(found.table(), given.table(), rtol=1e-9)
    assert "synthetic data" in found.plot().get_title()


PILOT = drawn(30, mode=["C1", "C2", "C3"]).assign(score=lambda f: 2.0 + 0.3 * f["score"])


def planned(*population, level=0.95, **more):
    columns = StudyColumns(**COLUMNS) if "data" in more else StudyColumns()
    simulation = replace(SMALL, level=level)
    return tl.smallest_n(0.8, *population, **more, columns=columns, simulation=simulation)


def test_means_beside_data_take_the_spread_of_the_pilot():
    covariance = np.cov(PILOT["score"].to_numpy().reshape(30, 3)[:, [2, 0]].T)
    plan, expected = planned({"C3": 2.1, "C1": 2.0}, data=PILOT), planned([2.1, 2.0], covariance)
    assert (plan.n, plan.power) == (expected.n, expected.power)
    assert plan.population.labels == ("C3", "C1")
    with refused(r"mean names \['C9'\], but the covariance is that of"):
        planned({"C1": 2.0, "C9": 2.1}, data=PILOT)


def test_people_whose_scores_do_not_depend_on_each_other_are_a_population():
    """Rounding leaves covariances of some 1e-16 that are not symmetric."""
    for k in range(2, 9):
        people = Conditions(range(k), np.arange(k), graded_covariance(k, 0.0, sd=7.0))
        assert people.with_epsilon(1.0).correlation == approx(0.0, abs=1e-12)


def test_the_search_ends_at_most():
    with refused(r"power: 100 subjects reach .* Raise most="):
        planned([0.0, 0.05, 0.1], graded_covariance(3), most=100)


def test_a_plan_says_what_it_assumes():
    pilot = PILOT.assign(synthetic=True)
    with pytest.warns(UserWarning, match="covariance is that of synthetic data"):
        plan = planned({"C1": 2.0, "C3": 2.1}, data=pilot, level=0.8)
    start, seed = f"A sample of {plan.n} participants", "100 simulated studies (seed 3)"
    for words in (start, seed, "80% CI [", "C1 2 (", "that of synthetic data"):
        assert words in plan.apa()


@parametrize(
    ("chosen", "test", "closed"),
    [
        ({"effect_size": 0.1, "test": "none"}, "F, none", lambda n: noncentral_f(n, 5, n * 4 / 9)),
        (
            {"pair": (5, 1), "test": "bonferroni"},
            "5 – 1, bonferroni",
            lambda n: noncentral_f(n, 2, n * 0.5**2, 0.005),
        ),
    ],
)
def test_the_smallest_n_is_that_of_the_closed_form(chosen, test, closed):
    many = Simulation(replicates=4000, seed=2)
    found = tl.smallest_n(0.8, MEANS, graded_covariance(5), **chosen, simulation=many)
    exact = next(n for n in range(3, 400) if closed(n) >= 0.8)
    assert abs(found.n - exact) <= 0.05 * exact
    assert found.ci_low <= closed(found.n) <= found.ci_high
    assert found.test == test
    assert found.whole_squares == 10 * -(-found.n // 10)
    if "pair" not in chosen:
        of = {"n": [found.n - 1, found.n], "effect_size": 0.1, "simulation": many}
        power = tl.power_analysis(MEANS, graded_covariance(5), **of).table()
        less, enough = power.query("test == 'none'")["power"]
        assert less < 0.8 <= enough == found.power


# --- refusals -------------------------------------------------------------------------------------


SHUFFLED = TWO_WAY.iloc[[3, 0, 1, 2, 4, 5]]
TURNED = TWO_WAY.rename_axis(index=["difficulty", "autonomy"])


@parametrize(
    ("arguments", "message"),
    [
        ({"covariance": np.ones((3, 3))}, "positive definite; its least eigenvalue"),
        (
            {"mean": [1, 2], "covariance": pd.DataFrame(np.eye(2), [1, 2], [*"XY"])},
            r"mean names \[1, 2\], but the covariance is that of \[\]",
        ),
        ({"claims": [(1, 2), (2, 1)]}, r"claims: .* different pairs \(a, b\) of \[1, 2, 3\]"),
        ({"claims": [(1, 2)], "mean": [1, 1, 2]}, r"claims: \[\(1, 2\)\] is no .* means differ"),
        (
            {"mean": TWO_WAY, "covariance": np.eye(6), "columns": FACTORS, "epsilon": 0.8},
            "effect_size, epsilon and claims are for one factor",
        ),
        # These had no effect, or another one than they say, or an error of pandas.
        ({"columns": StudyColumns(order=[3, 2, 1])}, "dv, subject and order are of data="),
        ({"columns": StudyColumns(subject="pid")}, "dv, subject and order are of data="),
        ({"columns": StudyColumns(within=[], between="group")}, "within must name a factor"),
        ({"mean": TWO_WAY.iloc[:-1], "columns": FACTORS}, r"each .* \('high', 'hard'\)\], got "),
        ({"mean": SHUFFLED, "columns": FACTORS}, "with the last factor varying fastest: "),
        ({"mean": TURNED, "columns": FACTORS}, "must be indexed by autonomy, difficulty, in this"),
    ],
)
def test_what_cannot_be_simulated_is_refused(arguments, message):
    population = {"mean": [0.0, 0.5, 1.0], "covariance": graded_covariance(3)}
    with refused(message):
        tl.power_analysis(**population | arguments, simulation=SMALL)


def test_conditions_may_be_pairs_and_no_effect_is_exactly_none():
    """Rounding gave 1e-32."""
    means = {("M", level): 0.1 for level in range(4)}
    power = tl.power_analysis(means, graded_covariance(4), n=20, simulation=SMALL)
    assert power.population.labels == (*means,)
    assert (power.table()[["effect_size", "noncentrality"]] == 0.0).all(axis=None)


@parametrize(
    ("means", "columns", "names"),
    [
        ({"A": 1.0, "B": 2.0, "C": 5.0}, StudyColumns(), list("ABC")),
        (TWO_WAY, StudyColumns(within="difficulty", between="autonomy"), CELLS.unique(1)),
    ],
)
def test_names_of_a_covariance_are_those_of_the_means(means, columns, names):
    """They were taken by position: C's variance went to A."""
    named = pd.DataFrame(np.diag(np.arange(1.0, 1.0 + len(names))), names, names)
    of = {"columns": columns, "n": 5, "simulation": SMALL}
    found = tl.power_analysis(means, named.iloc[::-1, ::-1], **of).table()
    same = tl.power_analysis(means, named.to_numpy(), **of).table()
    assert_frame_equal(found, same)


def test_the_only_effect_has_the_name_of_its_factor_and_whole_numbers_may_be_floats():
    """It was called condition; numbers passed the check, and the simulation failed."""
    columns, same = StudyColumns(within="dose"), Simulation(replicates=100.0, seed=np.array(3))
    assert same == SMALL
    given = {"covariance": np.eye(2), "columns": columns, "simulation": same}
    found = tl.power_analysis([0.0, 1.0], **given, n=9).table()
    assert {*found["effect"]} == {"dose"}
    assert tl.smallest_n(0.8, [0.0, 1.0], **given).power >= 0.8


@parametrize("name", ["pairs", "claims"])
def test_the_power_of_f_does_not_depend_on_what_its_factor_is_called(name):
    """Under these names rejections of F and of claimed pairs were added."""
    of = {"n": 8, "claims": [(1, 3)], "simulation": SMALL}
    found, usual = (
        tl.power_analysis([0.0, 0.2, 0.5], np.eye(3), columns=StudyColumns(within=within), **of)
        for within in (name, "condition")
    )
    assert_frame_equal(found.table().assign(effect="condition"), usual.table())
    assert_frame_equal(found.claims(), usual.claims())


def test_an_epsilon_that_leaves_no_variance_is_named():
    with refused(r"epsilon = 0\.145 is too near 0\.1429"):
        graded_covariance(8, epsilon=0.145)
