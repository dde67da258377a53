"""Held-out scores by plain loops, pairs by SciPy's paired t test, and models told apart."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy import stats

import trustlab as tl
from tests.cases import refused
from trustlab.trust.comparison import recover_trust_models
from trustlab.trust.dynamics import MODELS
from trustlab.trust.likelihood import predict, simulate_ratings
from trustlab.trust.panel import panel_until

FAST = ["performance", "asymmetric", "persistence", "habit"]


def test_pairs_are_paired():
    compared = tl.compare_trust_models(tl.read_people("hybrid_vr"), FAST, folds=3)
    scores = compared.scores[compared.scores["split"] == "people"]
    wide = scores.pivot_table("free_error", "person", "model")
    test = stats.ttest_rel(wide["asymmetric"], wide["performance"])
    row = compared.paired().query(
        "split == 'people' and measure == 'free_error' and model == 'asymmetric'"
    )
    interval = test.confidence_interval(0.95)
    assert row["difference"].item() / row["se"].item() == pytest.approx(test.statistic)
    assert row[["ci_low", "ci_high"]].to_numpy()[0] == pytest.approx([interval.low, interval.high])
    back = compared.paired(against="asymmetric").query(
        "split == 'people' and measure == 'free_error' and model == 'performance'"
    )
    assert back["difference"].item() == pytest.approx(-row["difference"].item())
    with refused("did you mean 'performance'"):
        compared.paired(against="perfomance")


def test_coverage_of_the_true_model_is_nominal():
    panel = tl.read_people("hybrid_vr")
    truth = MODELS["performance"](a=0.2, gain=0.8, process_sd=0.05, rating_sd=0.05)
    drawn = simulate_ratings(truth, panel, np.random.default_rng(0))
    table = tl.compare_trust_models(drawn, ["performance", "constant"], folds=2).table()
    row = table.query("split == 'people' and model == 'performance'")
    assert row["coverage"].item() == pytest.approx(0.9, abs=0.04)


def test_coverage_at_the_ends_of_the_scale_is_that_of_what_is_rounded_to_them():
    """
    A third of these answers is an end of the scale: by itself an end lies outside of most of Beta's
    intervals (coverage .625), and what is rounded to it inside.
    """
    table = tl.compare_trust_models(tl.read_people("trust_transfer"), ["beta"]).table()
    assert 0.9 < table["coverage"].item() < 0.98


def test_models_that_differ_are_told_apart_and_models_that_nest_less():
    panel = tl.read_people("hybrid_vr")
    shares = recover_trust_models(panel, ["performance", "persistence"], n=2)
    assert np.diag(shares).tolist() == [1.0, 1.0]


def test_a_model_of_ones_own_is_compared():
    class Sticky(tl.trust.LinearTrust):
        def transition(self, event):
            return 0.9, 0.1 * event.p_r

    table = tl.compare_trust_models(
        tl.read_people("hybrid_vr"), {"sticky": Sticky, "walk": "persistence"}, folds=2
    ).table()
    assert set(table["model"]) == {"sticky", "walk"}
    assert np.isfinite(table["log_score"]).all()


def test_the_last_third_is_each_persons_own():
    """Who had six trials has two in the last third; they had none where others had fifteen."""
    rng = np.random.default_rng(0)
    rows = [(i, k, rng.random(), rng.random()) for i in range(8) for k in range(7 if i % 2 else 16)]
    table = pd.DataFrame(rows, columns=["person", "trial", "rating", "p_r"])
    panel = tl.read_people(table, {"resolution": 0.01})
    scores = tl.compare_trust_models(panel, ["beta"], folds=2).scores
    scores = scores.query("split == 'last third'").set_index("person")
    model = tl.fit_trust(panel_until(panel, np.array([10, 4] * 4)), "beta").model
    known = replace(panel, ratings=panel.ratings.copy())
    known.ratings[1, 5:] = np.nan
    mean = predict(model, known).mean[1, 4:6]
    expected = np.square(mean - panel.ratings[1, 5:7]).mean()
    assert scores.loc[1, "free_error"] == pytest.approx(expected, abs=1e-3)
    assert scores["free_error"].notna().all()


def test_bad_input_is_named():
    panel = tl.read_people("hybrid_vr")
    with refused("folds=3"):
        tl.compare_trust_models(panel.of(range(3)), FAST)
    with refused("and there is one;"):
        tl.compare_trust_models(panel.of([0]), FAST)
    for models in ("beta", []):
        with refused(r"models must be several, or \[one\]"):
            tl.compare_trust_models(panel, models)
    ratings = panel.ratings.copy()
    ratings[:, 1:] = np.nan
    with refused("no rating after an event"):
        tl.fit_trust(replace(panel, ratings=ratings))


def rated(*rows):
    """Return a panel of people rated after each of four events."""
    table = pd.DataFrame(rows, columns=range(4)).stack().rename("rating")  # noqa: PD013
    table = table.rename_axis(["person", "trial"]).reset_index()
    table["p_r"] = [0.1, 0.8, 0.4, 0.9] * len(rows)
    return tl.read_people(table, {"resolution": 0.1})


def test_pairs_of_a_split_that_few_people_are_rated_in_are_left_out():
    """A third of three events is one: one person rated it, or nobody."""
    for last in (0.5, np.nan):
        panel = rated(*([0.5, 0.6, 0.4 + 0.1 * k, np.nan] for k in range(3)), [0.4, 0.5, 0.7, last])
        result = tl.compare_trust_models(panel, ["persistence", "constant"], folds=2)
        assert result.paired()["split"].unique().tolist() == ["people"]


def test_one_model_has_no_pairs():
    panel = rated([0.5, 0.6, 0.4, 0.5], [0.4, 0.5, 0.7, 0.6])
    pairs = tl.compare_trust_models(panel, ["constant"], folds=2).paired()
    assert pairs.empty
    assert {"split", "measure", "model", "ci_high", "people"} < set(pairs)


def test_ratings_before_and_after_all_events_are_compared_between_people():
    panel = tl.read_people("hybrid_vr")
    ratings = panel.ratings.copy()
    ratings[:, 1:-1] = np.nan
    compared = tl.compare_trust_models(replace(panel, ratings=ratings), FAST[:3:2], folds=2)
    assert set(compared.scores["split"]) == {"people"}
