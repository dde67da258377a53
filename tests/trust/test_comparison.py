"""Held-out scores by plain loops, pairs by SciPy's paired t test, and models told apart."""

import numpy as np
import pandas as pd
import pytest
from numpy.random import default_rng
from scipy import stats

import trustlab as tl
from tests.cases import panel as few_people, refused
from trustlab import compare_trust_models
from trustlab.trust import Event, NormalRating, Panel, comparison, read_people
from trustlab.trust.comparison import recover_trust_models
from trustlab.trust.dynamics import MODELS
from trustlab.trust.likelihood import predict, simulate_ratings
from trustlab.trust.panel import panel_until

approx = pytest.approx

FAST = ["performance", "asymmetric", "persistence", "habit"]


def test_pairs_are_paired():
    compared = compare_trust_models(read_people("hybrid_vr").of(range(20)), FAST, folds=2)
    wide = compared.scores.pivot_table("free_error", "person", ["split", "model"])["people"]
    test = stats.ttest_rel(wide["asymmetric"], wide["performance"])
    place = ("people", "free_error")
    pairs = compared.paired().set_index(["split", "measure", "model"])
    row = pairs.loc[*place, "asymmetric"]
    assert row["difference"] / row["se"] == approx(test.statistic)
    assert row[["ci_low", "ci_high"]].tolist() == approx([*test.confidence_interval(0.95)])
    back = compared.paired("asymmetric").set_index(["split", "measure", "model"])
    assert back.loc[*place, "performance"]["difference"] == approx(-row["difference"])


def test_the_middle_of_a_distribution_has_nine_tenths_of_it():
    rating = NormalRating(np.full(4, 0.5), np.full(4, 0.1))
    actual = 0.5 + 0.1 * stats.norm.ppf([0.04, 0.06, 0.94, 0.96])
    inside = comparison._in_central_interval(rating, actual, 0.0)
    assert inside.tolist() == [False, True, True, False]


def test_coverage_of_the_true_model_is_nominal():
    truth = MODELS["performance"](a=0.2, gain=0.8, process_sd=0.05, rating_sd=0.05)
    drawn = simulate_ratings(truth, read_people("hybrid_vr"), default_rng(0))
    table = compare_trust_models(drawn, ["performance", "constant"], folds=2).table()
    rows = table.set_index(["split", "model"])
    assert rows.loc[("people", "performance"), "coverage"] == approx(0.9, abs=0.04)


def test_coverage_at_the_ends_of_the_scale_is_that_of_what_is_rounded_to_them():
    """
    A third of these answers is an end of the scale: by itself an end lies outside of most of Beta's
    intervals (coverage .625), and what is rounded to it inside.
    """
    table = compare_trust_models(read_people("trust_transfer"), ["beta"]).table()
    assert 0.9 < table["coverage"].item() < 0.98


def test_models_that_differ_are_told_apart_and_models_that_nest_less():
    shares = recover_trust_models(
        read_people("hybrid_vr").of(range(40)), ["performance", "persistence"], n=2
    )
    assert np.diag(shares).tolist() == [1.0, 1.0]


def test_a_model_of_ones_own_is_compared():
    class Sticky(tl.trust.LinearTrust):
        def transition(self, event):
            return 0.9, 0.1 * event.p_r

    table = compare_trust_models(
        few_people(), {"sticky": Sticky, "walk": "persistence"}, folds=2
    ).table()
    assert set(table["model"]) == {"sticky", "walk"}
    assert np.isfinite(table["log_score"]).all()


def test_the_last_third_is_each_persons_own():
    """Who had six trials has two in the last third; they had none where others had fifteen."""
    rng = default_rng(0)
    rows = [(i, k, rng.random(), rng.random()) for i in range(8) for k in range(7 if i % 2 else 16)]
    table = pd.DataFrame(rows, columns=["person", "trial", "rating", "p_r"])
    panel = read_people(table, {"resolution": 0.01})
    scores = compare_trust_models(panel, ["beta"], folds=2).scores
    errors = scores.pivot_table("free_error", "person", "split", dropna=False)["last third"]
    known = panel_until(panel, np.array([10, 4] * 4))
    mean = predict(tl.fit_trust(known, "beta").model, known).mean[1, 4:6]
    expected = np.square(mean - panel.ratings[1, 5:7]).mean()
    assert errors[1] == approx(expected, abs=1e-3)
    assert errors.notna().all()


def test_bad_input_is_named():
    with refused("5 folds need as many, got 3; take fewer"):
        compare_trust_models(few_people().of(range(3)), FAST)
    for models, says in (("beta", "must be a list"), ([], r"must be several, or \[one\]")):
        with refused(f"models {says}"):
            compare_trust_models(few_people(), models)
    with refused("no rating after an event"):
        tl.fit_trust(panel_until(few_people(), 0))


def rated(*rows):
    """Return a panel of people rated before and after each of three events."""
    events = Event(*(np.full((len(rows), 3), usual) for usual in Event()))
    return Panel(tuple(range(len(rows))), events, np.array(rows), 0.1)


def test_pairs_of_a_split_that_few_people_are_rated_in_are_left_out():
    """A third of three events is one: one person rated it, or nobody."""
    for last in (0.5, np.nan):
        panel = rated(*([0.5, 0.6, 0.4 + 0.1 * k, np.nan] for k in range(3)), [0.4, 0.5, 0.7, last])
        result = compare_trust_models(panel, ["persistence", "constant"], folds=2)
        assert result.paired()["split"].unique().tolist() == ["people"]


def test_one_model_has_no_pairs():
    panel = rated([0.5, 0.6, 0.4, 0.5], [0.4, 0.5, 0.7, 0.6])
    pairs = compare_trust_models(panel, ["constant"], folds=2).paired()
    assert pairs.empty
    assert {"split", "measure", "model", "ci_high", "people"} < set(pairs)


def test_ratings_before_and_after_all_events_are_compared_between_people():
    panel = rated(*([0.1 * k, np.nan, np.nan, 0.9 - 0.1 * k] for k in range(4)))
    compared = compare_trust_models(panel, FAST[:3:2], folds=2)
    assert set(compared.scores["split"]) == {"people"}
