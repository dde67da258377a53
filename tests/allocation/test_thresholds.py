"""
Choosing thresholds (Algorithm 1), and reading them off an operator's own switches (Tables 2.3 and
2.6).
"""

import warnings
from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import pytest

import trustlab as tl
from tests.allocation.cases import drawn_model, encloses_beta, settled
from trustlab.allocation import (
    choose_thresholds,
    estimate_thresholds,
    followed_suggestions,
    relative_performance,
)
from trustlab.allocation.estimates import _apart
from trustlab.reproduction import published_table


def test_choice_encloses_beta_and_comes_near_the_best_performance(operators):
    choice = choose_thresholds(operators["2"], points=12)
    cycle = choice.cycle
    assert cycle.r_low <= operators["2"].human.beta <= cycle.r_high
    assert choice.probability == 1.0
    inside = choice.candidates[choice.candidates["p_encloses"] == 1.0]
    assert cycle.p_r_high == pytest.approx(inside["p_r_high"].max(), abs=1e-4)
    span = choice.limits.upper - choice.limits.lower
    assert choice.lower >= choice.limits.lower + 0.1 * span - 1e-12
    assert choice.upper <= choice.limits.upper - 0.1 * span + 1e-12
    pd.testing.assert_frame_equal(choice.table(), cycle.table())
    assert len(choice.plot()) == 2
    plt.close("all")


@pytest.mark.filterwarnings("error")
def test_a_fit_is_taken_and_warned_of_where_it_is_unsure(operators, make_session, switching):
    fit = tl.fit_tsc(make_session(operators["2"], switching))
    unsure = replace(fit, success=False, message="beta is weakly determined: record longer phases")
    assert fit.success
    choice = choose_thresholds(fit, points=12)
    assert choice.tsc is fit.model
    assert np.isnan(choice.probability)
    assert "of the estimate alone" not in choice.message
    assert "for the estimate alone (trustlab.sample_posterior" in choice.message
    with pytest.warns(
        UserWarning, match="success = False: beta is weakly determined: record longer phases"
    ) as caught:
        again = choose_thresholds(unsure, points=12)
    assert [one.filename for one in caught] == [__file__]
    assert (again.lower, again.upper) == (choice.lower, choice.upper)
    assert again.message.endswith(choice.message)
    # Advice about a model that is not to be used would mislead: the fit is named first.
    with pytest.warns(UserWarning, match=r"beta is weakly.*sample_posterior.*leaves no room"):
        choose_thresholds(unsure, delta_p_h=0.01, points=4)
    with pytest.raises(ValueError, match=r"TscModel, got RobotModel; fit one with"):
        choose_thresholds(tl.fit_robot(make_session(operators["2"], switching)))


def test_no_pair_that_encloses_beta_is_said(operators):
    with pytest.warns(UserWarning, match=r"keeps switching around β = 0\.95"):
        choice = choose_thresholds(operators["1"], points=8)
    assert not choice.encloses_beta
    assert choice.probability == 0.0
    assert not choice.offered
    cycle = choice.cycle
    assert f"stays within {cycle.r_low:.3f} to {cycle.r_high:.3f}" in choice.reason
    with pytest.warns(UserWarning, match=r"keeps switching for exactly.* does not enclose β"):
        switching = choose_thresholds(operators["1"], points=8, enclose_beta=False)
    assert (switching.offered, switching.probability, switching.encloses_beta) == (True, 1.0, False)


def test_a_pair_that_does_not_enclose_beta_is_never_offered_in_silence():
    """
    For β = .57 a pair was returned whose r stays at .831 to .834, without a word. Oracle: a run of
    each of 30 people.
    """
    rng = np.random.default_rng(57)
    quiet = 0
    for beta in np.r_[0.57, rng.uniform(0.2, 0.95, 29)]:
        model = drawn_model(rng, (-3.0, -2.0), (-2.5, -1.5), (beta, beta))
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            choice = choose_thresholds(model, points=8)
        if np.isnan(choice.lower):
            assert caught
            continue
        around = encloses_beta(settled(model, choice.lower, choice.upper), model)
        assert (choice.offered, choice.encloses_beta, not caught) == (around, around, around)
        quiet += around
    assert 5 < quiet < 30


@pytest.mark.filterwarnings("ignore")
def test_a_pair_does_what_is_said_from_rest_as_well():
    """Here a motion from β encloses β, and that from rest does not."""
    human = tl.HumanModel(0.9943798717128215, 0.98, 1.0016270911300817, 1.1535137779291924)
    ends = 0.8699032225204257, 1.0808661362278686, human.p_max
    model = tl.TscModel(tl.RobotModel(0.9650311638417988, *ends), human)
    choice = choose_thresholds(model, points=19, margin=0.001)
    run = settled(model, choice.lower, choice.upper)
    assert choice.probability == float(encloses_beta(run, model))


def test_no_room_between_the_limits_is_remark_4(operators):
    with pytest.warns(UserWarning, match=r"TSC_ub = .* does not exceed TSC_lb .*\(Remark 4\)"):
        choice = choose_thresholds(operators["pilot"], delta_p_h=0.01)
    assert "a smaller δ_Ph than 0.01" in choice.reason
    with pytest.raises(ValueError, match=r"confidence = 0\.9 would do nothing"):
        choose_thresholds(operators["pilot"], confidence=0.9)


def switched(lower, upper, sd, count, rng):
    """A session that switches at every sample, where TSC lies about the thresholds in turn."""
    mode = np.arange(count + 1) % 2.0
    tsc = rng.normal(np.where(mode == 1.0, lower, upper), sd)
    time = pd.Index(np.arange(count + 1.0), name="t")
    return tl.Session(pd.DataFrame({"mode": mode, "tsc": tsc}, time))


def test_thresholds_are_read_off_the_switches():
    rng = np.random.default_rng(0)
    runs = [switched(-0.2, 0.5, 0.05, 11, rng) for _ in range(6)]
    estimate = estimate_thresholds(runs)
    assert estimate.lower == pytest.approx(-0.2, abs=0.04)
    assert estimate.upper == pytest.approx(0.5, abs=0.04)
    assert estimate.distinguishable
    row = estimate.table().loc["upper"]
    assert row["ci_low"] < 0.5 < row["ci_high"]
    assert row["sd"] == pytest.approx(0.05, abs=0.02)
    assert row["share_within"] > 0.95
    assert estimate.summary["n"].sum() == len(estimate.switches) == 66
    with pytest.raises(ValueError, match="occurs twice"):
        estimate_thresholds(runs + runs[:1])


def test_switches_before_a_time_are_left_out():
    run = switched(-0.2, 0.5, 0.05, 11, np.random.default_rng(1))
    everything = estimate_thresholds(run)
    first = everything.switches["t"].iloc[0]
    later = estimate_thresholds(run, after=first + 0.05)
    pd.testing.assert_frame_equal(
        later.switches, everything.switches.iloc[1:].reset_index(drop=True)
    )
    pd.testing.assert_frame_equal(
        estimate_thresholds(run, after=first).switches, everything.switches
    )
    with pytest.raises(tl.SessionError, match="at 1000 s or later"):
        estimate_thresholds(run, after=1000.0)


@pytest.mark.filterwarnings("ignore:.*does not enclose β")
def test_choices_say_which_limits_they_keep(operators):
    for name in ("pilot", "2", "3", "4", "5"):
        model = operators[name]
        choice = choose_thresholds(model, points=6)
        own = tl.threshold_limits(model, None)
        assert choice.limits == tl.threshold_limits(model)
        assert choice.limits.delta_p_h == 0.0
        assert choice.limits.contains(choice.lower, choice.upper)
        assert not own.contains(choice.lower, choice.upper)
        assert f"does not cover the pair at the model's own δ_Ph: {own.message}" in choice.message
        within = choose_thresholds(model, delta_p_h=own.delta_p_h, points=6, enclose_beta=False)
        assert own.contains(within.lower, within.upper)
        assert "does not cover" not in within.message


def exactly(mean, sd, n):
    """A sample of this size with exactly this mean and SD."""
    values = np.sin(np.arange(1.0, n + 1.0))
    return mean + sd * (values - values.mean()) / values.std(ddof=1)


def test_switches_at_exactly_one_tsc_each_are_the_clearest_case():
    """Not infinitely far apart, and not told apart, where both are the same."""
    levels = {"lower": np.full(5, 0.1), "upper": np.full(6, 0.5)}
    assert _apart(levels, np.random.default_rng(0)) == (np.inf, 0.0)
    same = dict.fromkeys(levels, np.full(4, 0.25))
    separation, p = _apart(same, np.random.default_rng(0))
    assert not separation > 1.0
    assert p == 1.0


@pytest.mark.parametrize("n", [4, 8, 16, 100])
def test_samples_like_those_of_table_2_3_are_told_apart_or_not(n):
    """Mean ± SD overlap for participant 3 alone, 0.414/0.42: not told apart by any n switches."""
    printed, rng = published_table("2.3").astype(float), np.random.default_rng(0)
    p = {}
    for name in printed.columns:
        groups = {
            key: exactly(printed.loc[(side, "mean"), name], printed.loc[(side, "sd"), name], n)
            for key, side in (("lower", "TSC_l"), ("upper", "TSC_u"))
        }
        separation, p[name] = _apart(groups, rng)
        assert (separation < 1.0) == (name == "3")
        assert name != "3" or separation == pytest.approx(0.414 / 0.42)
    assert max(p["1"], p["2"]) < 0.01
    assert p["3"] > 0.4
    assert p["5"] < (0.05 if n > 16 else 1.0)
    assert p["4"] < (0.01 if n >= 8 else 1.0)


@pytest.mark.parametrize("sizes", [(3, 3), (4, 12), (20, 20)])
def test_the_test_keeps_its_level_with_few_switches(sizes):
    """Normal switches whose mean ± SD just touch: rejected in at most 5 % of samples."""
    rng, rejected = np.random.default_rng(1), 0
    for _ in range(1500):
        groups = {
            "lower": rng.normal(0.0, 0.1, sizes[0]),
            "upper": rng.normal(0.3, 0.2, sizes[1]),
        }
        rejected += _apart(groups, rng)[1] < 0.05
    assert 0.01 < rejected / 1500 < 0.065


def test_tsc_is_worked_out_from_performance_by_the_model_that_is_given(operators):
    time = np.arange(20_000) * 0.1
    run = tl.simulate_allocation(operators["2"], 0.0, 0.35, 20_000).set_index(time)
    whole, bare = tl.Session(run), tl.Session(run[["mode", "p_r", "p_h"]])
    own = estimate_thresholds(bare, operators["2"])
    assert (own.lower, own.upper) == pytest.approx((0.0, 0.35), abs=0.01)
    # Beside a column tsc as well.
    others = [estimate_thresholds(each, operators["5"]).table() for each in (whole, bare)]
    pd.testing.assert_frame_equal(*others)
    assert others[0]["mean"].tolist() != own.table()["mean"].tolist()
    for session, words in (
        (bare, "give model="),
        (tl.Session(run.iloc[:50]), "never changes"),
        (tl.Session(run.assign(mode=0.5)), "not shares"),
    ):
        with pytest.raises(tl.SessionError, match=words):
            estimate_thresholds(session)


@pytest.mark.parametrize("n", [2, 3, 6])
def test_the_interval_of_a_threshold_covers_with_few_switches(n):
    """A bootstrap of two switches covered in half of the cases."""
    rng, covered = np.random.default_rng(2), []
    for _ in range(400):
        row = estimate_thresholds(switched(-0.3, 0.3, 0.1, 2 * n, rng)).table().loc["upper"]
        covered.append(row["ci_low"] <= 0.3 <= row["ci_high"])
    assert 0.92 < np.mean(covered) < 0.98


def test_suggestions_are_followed_in_time_or_not():
    mode, suggested = np.ones(1000), np.full(1000, -1.0)
    suggested[100:300], mode[180:] = 0.0, 0.0  # followed after 8 s
    suggested[400:640], mode[600:] = 1.0, 1.0  # too late: 20 s
    suggested[700:720] = 0.0  # never
    time = pd.Index(np.arange(1000) * 0.1, name="t")
    session = tl.Session(pd.DataFrame({"mode": mode, "suggested_mode": suggested}, time))
    table = followed_suggestions(session)
    assert table["followed"].tolist() == [True, False, False]
    assert table["delay"].iloc[0] == pytest.approx(8.0)
    assert followed_suggestions(session, deadline=25.0)["followed"].tolist() == [True, True, False]
    with pytest.raises(tl.SessionError, match="'suggested_mode' holds shares"):
        followed_suggestions(tl.Session(session.data.assign(suggested_mode=0.5)))


def test_relative_performance_of_remark_7():
    """
    (2.39) on Table 2.5: C2 over C1 by 8.75 points, C5 over C3 by 11.86, as printed, with the range
    0.24 to 0.4.
    """
    table = published_table("2.5")["P_r_mean"].astype(float)
    percent = {name: relative_performance(value, 0.24, 0.4) for name, value in table.items()}
    assert percent["C2"] - percent["C1"] == pytest.approx(8.75, abs=1e-9)
    assert percent["C5"] - percent["C3"] == pytest.approx(11.86, abs=0.02)
    for values in ([0.24, 0.4], np.array(0.32), np.array([[0.24], [0.4]])):
        assert relative_performance(values, 0.24, 0.4) == pytest.approx(50.0)
