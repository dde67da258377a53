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
from trustlab.studies import clopper_pearson, graded_covariance, noncentral_f_power, noncentrality
from trustlab.studies.anova import orthonormal_contrasts, sphericity
from trustlab.studies.planning import power as simulation
from trustlab.studies.planning.conditions import Conditions

MEANS = [0.0, 0.1, 0.4, 0.5, 0.5]


# --- closed forms ---------------------------------------------------------------------------------


def conditions_from(mean, covariance):
    """The population with these means and covariance, its conditions numbered from 1."""
    return Conditions(
        range(1, len(mean) + 1), np.asarray(mean, dtype=float), np.asarray(covariance)
    )


@pytest.mark.parametrize("n", [3, 12, 36])
@pytest.mark.parametrize("k", [2, 3, 5])
@pytest.mark.parametrize("strength", [0.0, 2.0, 15.0])
def test_noncentral_f_is_scipys(n, k, strength):
    df1, df2 = k - 1, (k - 1) * (n - 1)
    critical = stats.f.isf(0.05, df1, df2)
    oracle = stats.ncf.sf(critical, df1, df2, strength) if strength else 0.05
    assert noncentral_f_power(n, k, strength) == pytest.approx(oracle, abs=1e-10)


@pytest.mark.parametrize(("n", "d_z", "alpha"), [(20, 0.5, 0.05), (36, 0.3, 0.005), (8, 1.2, 0.01)])
def test_two_conditions_are_the_paired_t_test_of_statsmodels(n, d_z, alpha):
    from statsmodels.stats.power import TTestPower

    oracle = TTestPower().power(d_z, n, alpha)
    assert noncentral_f_power(n, 2, n * d_z**2, alpha) == pytest.approx(oracle, abs=1e-8)


@given(st.integers(1, 300), st.data(), st.floats(0.5, 0.999))
@settings(max_examples=60, deadline=None, derandomize=True)
def test_clopper_pearson_is_scipys_exact_interval(total, data, level):
    count = data.draw(st.integers(0, total))
    oracle = stats.binomtest(count, total).proportion_ci(level, method="exact")
    low, high = clopper_pearson(np.array([count]), total, level)
    np.testing.assert_allclose([low[0], high[0]], [oracle.low, oracle.high], rtol=1e-9, atol=1e-12)


def test_noncentrality_is_n_s_over_error_variance():
    population = conditions_from(MEANS, graded_covariance(5, 0.3, 0.6, 2.0))
    effect = np.sum((np.array(MEANS) - np.mean(MEANS)) ** 2)
    error = np.trace(population.contrasts) / 4
    assert noncentrality(population.eta2_partial, 24, 5) == pytest.approx(
        24 * effect / error, rel=1e-12
    )
    assert error == pytest.approx(4.0 * 0.7, rel=1e-12)


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


def test_sphericity_is_compound_symmetry():
    expected = 4.0 * (0.3 * np.ones((5, 5)) + 0.7 * np.eye(5))
    np.testing.assert_allclose(graded_covariance(5, 0.3, 1.0, 2.0), expected, atol=1e-12)


@given(st.floats(0.001, 0.95), st.integers(0, 50))
@settings(max_examples=50, deadline=None, derandomize=True)
def test_an_effect_is_reached_and_its_pattern_kept(eta2, seed):
    rng = np.random.default_rng(seed)
    root = rng.standard_normal((4, 4))
    population = conditions_from(rng.normal(size=4), root @ root.T + 0.1 * np.eye(4))
    scaled = population.with_effect(eta2)
    assert scaled.eta2_partial == pytest.approx(eta2, rel=1e-9)
    assert scaled.mean.mean() == pytest.approx(population.mean.mean(), abs=1e-9)
    assert np.corrcoef(scaled.mean, population.mean)[0, 1] == pytest.approx(1.0, abs=1e-9)
    assert population.with_effect(0.0).eta2_partial == 0.0


def test_data_give_their_sample_moments_and_their_label():
    study = tl.published_studies()["uav.utilization"]
    data = tl.reconstruct(study, seed=0)
    found = settled(tl.power_analysis, data=data, n=36, replicates=200)
    wide = data.pivot_table("value", "subject", "condition")
    np.testing.assert_allclose(found.conditions.mean, wide.mean(), rtol=1e-12)
    np.testing.assert_allclose(found.conditions.covariance, np.cov(wide.to_numpy().T), rtol=1e-10)
    assert "reconstructed" in found.origin
    assert found.table().attrs["origin"] == found.origin
    assert "reconstructed" in found.plot().get_title()


def test_names_come_from_mappings_and_frames():
    names = ["a", "b", "c"]
    frame = pd.DataFrame(graded_covariance(3), index=names, columns=names)
    found = settled(tl.power_analysis, {"a": 0.0, "b": 1.0, "c": 2.0}, frame, n=8, replicates=100)
    assert found.conditions.labels == ("a", "b", "c")
    assert set(found.pairs()["b"]) == {"b", "c"}


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
    z = deviations(rows, rows["closed_form"])
    assert len(z) == 20
    assert z.abs().max() < 4.0
    assert (z**2).sum() < stats.chi2.isf(1e-3, 20)
    assert rows["power"].between(rows["ci_low"], rows["ci_high"]).all()


def test_the_comparison_would_see_one_subject_less(grid):
    rows = grid.table().query("test == 'none'")
    wrong = np.array([noncentral_f_power(35, 5, v * 35 / 36) for v in rows["noncentrality"]])
    assert (deviations(rows, wrong) ** 2).sum() > stats.chi2.isf(1e-6, 20)


def test_pairs_agree_with_the_noncentral_t(grid):
    rows = grid.pairs().query("adjust != 'holm'")
    for _, part in rows.groupby("adjust"):
        some = part[part["closed_form"].between(0.002, 0.998)]
        assert len(some) > 100
        assert deviations(some, some["closed_form"]).abs().max() < 4.5
    holm = grid.pairs().query("adjust == 'holm'")["power"].to_numpy()
    raw = grid.pairs().query("adjust == 'none'")["power"].to_numpy()
    bonferroni = grid.pairs().query("adjust == 'bonferroni'")["power"].to_numpy()
    assert ((bonferroni <= holm) & (holm <= raw)).all()


def weighted_chi_squares(population, n, draws, seed):
    """
    Draw F of Box's representation: eigenvalues of the contrasts' covariance times χ², no analysis
    of scores.
    """
    rng = np.random.default_rng(seed)
    values, vectors = np.linalg.eigh(population.contrasts)
    c = orthonormal_contrasts(len(population.mean))
    shift = np.sqrt(n) * (vectors.T @ (c.T @ population.mean)) / np.sqrt(values)
    effect = (values * (rng.standard_normal((draws, values.size)) + shift) ** 2).sum(axis=1)
    error = (values * rng.chisquare(n - 1, (draws, values.size))).sum(axis=1) / (n - 1)
    return effect / error


@pytest.mark.parametrize("eta2", [0.0, 0.06])
def test_without_sphericity_f_is_a_ratio_of_weighted_chi_squares(eta2):
    found = settled(
        tl.power_analysis,
        MEANS,
        graded_covariance(5),
        n=15,
        effect_size=eta2,
        epsilon=0.4,
        replicates=10_000,
        seed=1,
    )
    population = conditions_from(MEANS, graded_covariance(5, 0.5, 0.4)).with_effect(eta2)
    f = weighted_chi_squares(population, 15, 400_000, 2)
    oracle = (f > stats.f.isf(0.05, 4, 56)).mean()
    rows = found.table().set_index("test")
    assert abs(deviations(rows.loc["none"], oracle)) < 4.0
    assert np.isnan(rows["closed_form"]).all()
    if eta2 == 0.0:  # uncorrected F rejects too often, Greenhouse–Geisser's does not
        assert rows.loc["none", "ci_low"] > 0.06
        assert rows.loc["greenhouse-geisser", "ci_high"] < 0.06


def test_a_cell_does_not_depend_on_its_place_in_the_grid():
    arguments = {"mean": MEANS, "covariance": graded_covariance(5), "replicates": 200, "seed": 4}
    alone = settled(tl.power_analysis, **arguments, n=12, effect_size=0.1).table()
    grid = settled(tl.power_analysis, **arguments, n=[8, 12], effect_size=[0.05, 0.1]).table()
    same = grid[(grid["n"] == 12) & np.isclose(grid["effect_size"], 0.1)].reset_index(drop=True)
    pd.testing.assert_frame_equal(same, alone)
    assert (
        grid.groupby(["n", "effect_size"])["power"].first().nunique() == 4
    )  # no two cells share their draws


@pytest.mark.parametrize(("n", "k"), [(12, 4), (3, 5)])
def test_counts_are_those_of_repeated_measures_study_by_study(n, k):
    replicates = 100
    seed = 3
    claims = [(k, 1), (2, k)]
    matrix, mean = graded_covariance(k, 0.4, 0.5, 1.0), np.linspace(0.0, 1.5, k)
    found = settled(
        tl.power_analysis, mean, matrix, n=n, replicates=replicates, seed=seed, claims=claims
    )
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(n,)))
    scores = rng.standard_normal((replicates, n, k)) @ np.linalg.cholesky(matrix).T + mean
    hits = dict.fromkeys(simulation.TESTS, 0)
    pairs, together = 0, 0
    for study in scores:
        frame = pd.DataFrame(study, columns=range(1, k + 1)).rename_axis("s").reset_index()
        frame = frame.melt("s", var_name="c", value_name="v").astype({"c": int})
        for test in hits:
            hits[test] += (
                tl.repeated_measures(frame, "v", "c", "s", correction=test).p_corrected < 0.05
            )
        result = tl.repeated_measures(frame, "v", "c", "s")
        table = result.pairs().set_index(["a", "b"])
        pairs = pairs + (table["p_holm"] < 0.05)
        right = (table["p_holm"] < 0.05) & (table["mean_difference"] < 0)  # means rise
        together += bool(right[(1, k)] and right[(2, k)] and result.p_corrected < 0.05)
    rows = found.table().set_index("test")["power"]
    assert {test: round(rows[test] * replicates) for test in hits} == hits
    holm = found.pairs().query("adjust == 'holm'").set_index(["a", "b"])["power"] * replicates
    assert holm.round().astype(int).to_dict() == pairs.to_dict()
    claimed = found.claims().set_index("adjust").loc["holm"]
    assert round(claimed["power"] * replicates) == together
    assert claimed["expected_found"] <= claimed["claims"] == 2


def test_draws_do_not_depend_on_how_many_are_in_memory(monkeypatch):
    arguments = {"n": 10, "replicates": 300, "seed": 5, "claims": [(1, 3)]}
    whole = settled(tl.power_analysis, [0, 0, 1], graded_covariance(3), **arguments)
    monkeypatch.setattr("trustlab.studies.anova._CHUNK", 500)
    for name in ("table", "pairs", "claims"):
        pd.testing.assert_frame_equal(
            getattr(
                settled(tl.power_analysis, [0, 0, 1], graded_covariance(3), **arguments), name
            )(),
            getattr(whole, name)(),
        )


def test_a_grid_has_a_row_per_cell_and_test_and_draws_itself():
    found = settled(
        tl.power_analysis,
        [0, 1],
        graded_covariance(2),
        n=[5, 9],
        effect_size=[0.1, 0.3],
        correlation=[0.0, 0.5],
        replicates=100,
    )
    assert len(found.table()) == 2 * 2 * 2 * len(simulation.TESTS)
    assert set(found.table()["epsilon"]) == {1.0}
    axes = found.plot()
    assert axes.get_xlabel() == "participants n"
    assert len(axes.get_legend().get_texts()) == 4
    assert "simulated studies" in found._repr_html_()
    with pytest.raises(ValueError, match="against must be one of 'n', 'effect_size'"):
        found.plot("m")
    with pytest.raises(ValueError, match="test must be one of 'none'"):
        found.plot(test="wilks")


def test_epsilon_of_two_conditions_is_one():
    population = conditions_from([0, 1], [[1.0, 0.2], [0.2, 2.0]])
    assert population.epsilon == 1.0
    assert sphericity(population.contrasts, 9)["epsilon_gg"] == 1.0


# --- the smallest n -------------------------------------------------------------------------------


def test_the_smallest_n_is_that_of_the_noncentral_f():
    found = settled(
        tl.smallest_n,
        0.8,
        MEANS,
        graded_covariance(5),
        effect_size=0.1,
        test="none",
        replicates=4000,
        seed=2,
    )
    exact = next(
        n for n in range(3, 200) if noncentral_f_power(n, 5, noncentrality(0.1, n, 5)) >= 0.8
    )
    assert abs(found.n - exact) <= 2
    assert (
        found.ci_low
        <= noncentral_f_power(found.n, 5, noncentrality(0.1, found.n, 5))
        <= found.ci_high
    )
    tried = found.evaluations.set_index("n")["power"]
    assert tried[found.n] == found.power >= 0.8 > tried[found.n - 1]
    assert found.whole_squares % 10 == 0
    assert found.whole_squares >= found.n


def test_the_smallest_n_is_the_same_at_every_call_and_what_power_analysis_finds():
    arguments = {"effect_size": 0.2, "replicates": 2000, "seed": 9}
    first, again = (
        settled(tl.smallest_n, 0.9, MEANS, graded_covariance(5, 0.5, 0.6), **arguments)
        for _ in range(2)
    )
    pd.testing.assert_frame_equal(first.evaluations, again.evaluations)
    rows = settled(
        tl.power_analysis,
        MEANS,
        graded_covariance(5, 0.5, 0.6),
        n=first.n,
        effect_size=0.2,
        replicates=10_000,
    ).table()
    usual = rows.set_index("test").loc["greenhouse-geisser"]
    assert first.ci_low <= usual["ci_high"]
    assert usual["ci_low"] <= first.ci_high


def test_the_smallest_n_of_a_pair():
    found = settled(
        tl.smallest_n,
        0.8,
        MEANS,
        graded_covariance(5),
        pair=(5, 1),
        test="bonferroni",
        replicates=2000,
        seed=2,
    )
    exact = next(n for n in range(3, 400) if noncentral_f_power(n, 2, n * 0.5**2, 0.005) >= 0.8)
    assert abs(found.n - exact) <= 0.05 * exact
    assert found.table()["test"].item() == "5 – 1, bonferroni"
    assert "simulated" in found._repr_html_()


def test_a_huge_effect_needs_three_subjects():
    assert (
        settled(tl.smallest_n, 0.8, [0, 50.0, 100.0], graded_covariance(3), replicates=100).n == 3
    )


# --- where studies are simulated ------------------------------------------------------------------


def test_results_do_not_depend_on_where_studies_are_simulated():
    """In this process, or in two workers."""
    grid = {
        "n": [5, 9],
        "effect_size": [0.1, 0.3],
        "replicates": 200,
        "seed": 3,
        "claims": [(1, 5)],
    }
    search = {"effect_size": 0.2, "replicates": 300, "seed": 9}
    matrix = graded_covariance(5, 0.5, 0.4)
    here, n_here = (
        settled(tl.power_analysis, MEANS, matrix, **grid),
        settled(tl.smallest_n, 0.9, MEANS, matrix, **search),
    )
    there = settled(tl.power_analysis, MEANS, matrix, **grid, n_jobs=2)
    n_there = settled(tl.smallest_n, 0.9, MEANS, matrix, **search, n_jobs=2)
    for name in ("table", "pairs", "claims"):
        pd.testing.assert_frame_equal(
            getattr(here, name)(), getattr(there, name)(), check_exact=True
        )
    pd.testing.assert_frame_equal(n_here.evaluations, n_there.evaluations, check_exact=True)
    pd.testing.assert_frame_equal(n_here.table(), n_there.table(), check_exact=True)


# --- refusals -------------------------------------------------------------------------------------

GOOD = graded_covariance(3)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"n": 2}, "n = 2 is too small for the design: repeated measures need at least 3"),
        ({"n": 12.5}, "n must be a whole number"),
        ({"n": []}, "n is empty"),
        ({"n": "36"}, "n must be a whole number"),
        ({"n": True}, "n must be a whole number"),
        ({"alpha": 1.0}, "alpha must lie strictly between 0 and 1"),
        ({"alpha": 0.0}, "alpha must lie strictly between 0 and 1"),
        ({"level": 95}, "level must lie strictly between 0 and 1"),
        ({"replicates": 99}, "replicates must be a whole number, from 100"),
        ({"seed": -1}, "seed must be a whole number"),
        ({"effect_size": 1.0}, r"effect_size is a population partial η², in \[0, 1\)"),
        ({"effect_size": -0.1}, "effect_size is a population partial"),
        ({"effect_size": np.nan}, "effect_size must be finite"),
        ({"mean": [1.0, 1.0, 1.0], "effect_size": 0.1}, "all means are the same"),
        ({"epsilon": 0.5}, r"epsilon must lie above 1/\(k − 1\) = 0.5"),
        ({"epsilon": 1.1}, "epsilon must lie above"),
        ({"correlation": 1.0}, "correlation must lie between"),
        ({"correlation": -0.5}, "correlation must lie between"),
        ({"mean": [0.0, 1.0]}, "covariance must be 2 × 2, got 3 × 3"),
        ({"mean": [0.0, np.nan, 1.0]}, "mean must be finite, but sample 1"),
        ({"mean": [0.0], "covariance": [[1.0]]}, "at least two conditions"),
        ({"mean": None}, "power needs mean= and covariance="),
        ({"covariance": None}, "power needs mean= and covariance="),
        (
            {"covariance": [[1, 0.9, 0.0], [0.9, 1, 0.9], [0.0, 0.9, 1]]},
            "least eigenvalue is -0.272792",
        ),
        (
            {"covariance": np.ones((3, 3))},
            "covariance is not positive definite: its least eigenvalue",
        ),
        ({"covariance": np.zeros((3, 3))}, "covariance is not positive definite"),
        ({"covariance": [[1, 0.2, 0], [0.5, 1, 0], [0, 0, 1]]}, r"symmetric, but \[0, 1\] is 0.2"),
        (
            {"covariance": [[1, 0, 0], [0, np.inf, 0], [0, 0, 1]]},
            "covariance must be finite, but sample 4 is inf",
        ),
        ({"covariance": np.ones(3)}, "covariance must be 3 × 3, got 3"),
        ({"covariance": "large"}, "covariance must be an array of numbers, got str"),
        ({"covariance": [["1", 0], [0, 1]]}, "covariance must be an array of numbers"),
        ({"claims": [(1, 9)]}, "unknown condition 9"),
        ({"claims": [(1, 2), (2, 1)]}, "claimed twice"),
        ({"claims": ["12"]}, "a comparison is a pair of two conditions"),
        ({"claims": 5}, "claims must be a list of pairs"),
        ({"claims": []}, "claims is empty"),
        (
            {"claims": [("M", "TMIGG")], "mean": {"M": 0.0, "OMI": 0.5, "TMIG": 1.0}},
            "unknown condition 'TMIGG'; did you mean 'TMIG'",
        ),
        ({"data": pd.DataFrame()}, "give either data= or covariance="),
    ],
)
def test_power_analysis_refuses(arguments, message):
    given_ = {"mean": [0.0, 0.5, 1.0], "covariance": GOOD, "replicates": 100} | arguments
    with pytest.raises(ValueError, match=message):
        settled(tl.power_analysis, **given_)


@pytest.mark.parametrize(
    ("labels", "message"),
    [
        (["a", "b"], "labels must have at least 3"),
        (["a", "b", "a"], "labels must differ"),
        ("abc", "labels must be a list"),
        (5, "labels must be a list"),
    ],
)
def test_labels_of_conditions_are_checked(labels, message):
    with pytest.raises(ValueError, match=message):
        Conditions(labels, [0.0, 0.5, 1.0], GOOD)


def test_settings_are_of_their_class():
    with pytest.raises(ValueError, match="simulation must be of class Simulation"):
        tl.power_analysis([0, 1], np.eye(2), simulation=200)
    with pytest.raises(ValueError, match="columns must be of class StudyColumns"):
        tl.smallest_n(0.8, [0, 1], np.eye(2), columns="subject")


def pilot(**more):
    rng = np.random.default_rng(3)
    people = rng.normal(size=(30, 1))
    scores = 2.0 + 0.3 * (people + rng.normal(size=(30, 3)))
    frame = pd.DataFrame(scores, columns=["C1", "C2", "C3"]).rename_axis("subject").reset_index()
    return frame.melt("subject", var_name="condition").assign(**more)


def test_means_beside_data_take_the_spread_of_the_pilot():
    wide = pilot().pivot_table(index="subject", columns="condition", values="value")[["C3", "C1"]]
    means = {"C3": 2.1, "C1": 2.0}
    spread = np.cov(wide.to_numpy().T)
    simulation = tl.studies.Simulation(replicates=400)
    plan = tl.smallest_n(0.8, means, data=pilot(), simulation=simulation)
    expected = tl.smallest_n(0.8, [2.1, 2.0], spread, simulation=simulation)
    assert (plan.n, plan.power) == (expected.n, expected.power)
    assert plan.population.labels == ("C3", "C1")
    with pytest.raises(ValueError, match=r"mean names \['C9'\], but data hold"):
        tl.smallest_n(0.8, {"C1": 2.0, "C9": 2.1}, data=pilot(), simulation=simulation)


def test_a_plan_says_what_it_assumes():
    simulation = tl.studies.Simulation(replicates=400, seed=4)
    with pytest.warns(UserWarning, match="covariance is that of synthetic data"):
        plan = tl.smallest_n(
            0.8, {"C1": 2.0, "C3": 2.1}, data=pilot(synthetic=True), simulation=simulation
        )
    text = plan.apa()
    assert f"A sample of {plan.n} participants" in text
    assert "400 simulated studies (seed 4)" in text
    assert "C1 2 (" in text
    assert "The covariance is that of synthetic data" in text
    # The noncentral t of a paired comparison, n searched one by one. Oracle: SciPy.
    d_z = abs(plan.population.d_z[0])
    for name, scale in (("half", 0.5), ("twice", 2.0)):
        n = next(
            n
            for n in range(3, 10_000)
            if stats.nct.sf(stats.t.ppf(0.975, n - 1), n - 1, np.sqrt(n) * d_z / scale)
            + stats.nct.cdf(stats.t.ppf(0.025, n - 1), n - 1, np.sqrt(n) * d_z / scale)
            >= 0.8
        )
        assert plan.n_by_spread[name] == n
        assert str(n) in text


def test_a_plan_out_of_reach_names_what_drives_it():
    covariance = graded_covariance(2)  # the difference has a variance of 1
    with pytest.raises(ValueError, match=r"at most 0\.05 standard deviations") as caught:
        tl.smallest_n(
            0.8,
            [0.0, 0.05],
            covariance,
            most=1000,
            simulation=tl.studies.Simulation(replicates=200),
        )
    n = int(str(caught.value).split("n is ")[1].split(".")[0])
    plan = tl.smallest_n(
        0.8, [0.0, 0.1], covariance, most=n + 100, simulation=tl.studies.Simulation(replicates=2000)
    )
    assert abs(plan.n - n) < 0.1 * n


def test_data_too_few_for_a_covariance_are_refused():
    rng = np.random.default_rng(0)
    data = pd.DataFrame(
        [(s, c, rng.normal()) for s in range(4) for c in range(4)],
        columns=["subject", "condition", "value"],
    )
    with pytest.raises(ValueError, match=r"4 subjects in 4 conditions: .* at least 5"):
        settled(tl.power_analysis, data=data)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"power": 1.0}, "power must lie strictly"),
        ({"power": 0.04}, "power = 0.04 must exceed alpha"),
        ({"test": "greenhouse-geiser"}, "did you mean 'greenhouse-geisser'"),
        ({"pair": (1, 2), "test": "holmes"}, "did you mean 'holm'"),
        ({"pair": (1, 7)}, "unknown condition 7"),
        ({"pair": 5}, "a comparison is a pair of two conditions"),
        ({"most": 2}, "most must be a whole number, from 3"),
        ({"effect_size": 0.001, "most": 50}, "50 subjects reach a power of .* only"),
        ({"effect_size": 0.0, "most": 20}, "20 subjects reach"),
        ({"covariance": np.ones((3, 3))}, "not positive definite"),
    ],
)
def test_smallest_n_refuses(arguments, message):
    with pytest.raises(ValueError, match=message):
        settled(
            tl.smallest_n,
            **({"mean": [0, 0.5, 1], "covariance": GOOD, "replicates": 100} | arguments),
        )


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: noncentral_f_power(36, 5, -1.0), "noncentrality must not be negative"),
        (
            lambda: noncentral_f_power(36, 5, 1.0, epsilon=0.2),
            r"epsilon must lie in \[1/\(k − 1\), 1\]",
        ),
        (lambda: noncentral_f_power(1, 5, 1.0), "n must be a whole number, 2 or more"),
        (lambda: noncentrality(1.0, 36, 5), r"eta2_partial must lie in \[0, 1\)"),
        (lambda: clopper_pearson(np.array([5]), 4), "whole numbers from 0 to 4"),
        (lambda: clopper_pearson(np.array([0.5]), 4), "whole numbers from 0 to 4"),
        (lambda: graded_covariance(3, sd=0.0), "sd must be positive"),
        (lambda: graded_covariance(1), "k must be a whole number"),
    ],
)
def test_closed_forms_refuse(call, message):
    with pytest.raises(ValueError, match=message):
        call()
