"""
Choosing thresholds (Algorithm 1), and reading them off an operator's own switches (Tables 2.3 and
2.6).
"""

import warnings
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from numpy.random import default_rng
from pandas.testing import assert_frame_equal
from scipy import stats

import trustlab as tl
from tests.allocation.cases import (
    OPERATORS,
    PILOT,
    SECOND,
    drawn_model,
    encloses_beta,
    made,
    settled,
    warned,
)
from tests.cases import refused
from trustlab.allocation import (
    choose_thresholds,
    estimate_thresholds,
    followed_suggestions,
    relative_performance,
)
from trustlab.allocation.estimates import _apart
from trustlab.reproduction import published_table

approx = pytest.approx
parametrize = pytest.mark.parametrize


def test_choice_encloses_beta_and_comes_near_the_best_performance():
    choice = choose_thresholds(SECOND, points=12)
    cycle, limits = choice.cycle, choice.limits
    assert cycle.r_low <= SECOND.human.beta <= cycle.r_high
    assert choice.probability == 1.0
    inside = choice.candidates[choice.candidates["p_encloses"] == 1.0]
    assert cycle.p_r_high == approx(inside["p_r_high"].max(), abs=1e-4)
    margin = 0.1 * (limits.upper - limits.lower) - 1e-12
    assert limits.lower + margin <= choice.lower < choice.upper <= limits.upper - margin
    assert_frame_equal(choice.table(), cycle.table())


@pytest.mark.filterwarnings("error")
def test_a_fit_is_taken_and_warned_of_where_it_is_unsure(make_session, switching):
    session = make_session(SECOND, switching)
    fit = tl.fit_tsc(session)
    choice = choose_thresholds(fit, points=12)
    assert choice.tsc is fit.model
    assert np.isnan(choice.probability)
    assert "for the estimate alone (trustlab.sample_posterior" in choice.message
    unsure = replace(fit, success=False, message="beta is weakly determined")
    with warned("success = False: beta is weakly determined"):
        again = choose_thresholds(unsure, points=12)
    assert (again.lower, again.upper) == (choice.lower, choice.upper)
    assert again.message.endswith(choice.message)
    # Advice about a model that is not to be used would mislead: the fit is named first.
    with warned(r"beta is weakly.*sample_posterior.*leaves no room"):
        choose_thresholds(unsure, delta_p_h=0.01, points=4)
    with refused(r"TscModel, got RobotModel; fit one with"):
        choose_thresholds(tl.fit_robot(session))


def outcome(choice):
    return choice.offered, choice.probability, choice.encloses_beta


def test_no_pair_that_encloses_beta_is_said():
    with warned(r"keeps switching around β = 0\.95"):
        choice = choose_thresholds(OPERATORS["1"], points=8)
    assert outcome(choice) == (False, 0.0, False)
    cycle = choice.cycle
    assert f"stays within {cycle.r_low:.3f} to {cycle.r_high:.3f}" in choice.reason
    with warned(r"keeps switching for exactly.* does not enclose β"):
        choice = choose_thresholds(OPERATORS["1"], points=8, enclose_beta=False)
    assert outcome(choice) == (True, 1.0, False)


def test_a_pair_that_does_not_enclose_beta_is_never_offered_in_silence():
    """
    For β = .57 a pair was returned whose r stays at .831 to .834, without a word. Oracle: a run of
    each of 30 people.
    """
    rng = default_rng(57)
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
    model = made(
        (0.9943798717128215, 0.98, 1.0016270911300817, 1.1535137779291924),
        (0.9650311638417988, 0.8699032225204257, 1.0808661362278686),
    )
    choice = choose_thresholds(model, points=19, margin=0.001)
    run = settled(model, choice.lower, choice.upper)
    assert choice.probability == float(encloses_beta(run, model))


def test_no_room_between_the_limits_is_remark_4():
    says = r"TSC_ub = .* at δ_Ph = 0\.01, .*\(Remark 4\).*a smaller δ_Ph than 0\.01"
    with warned(says):
        choose_thresholds(PILOT, delta_p_h=0.01)


def test_a_confidence_is_for_posteriors():
    with refused(r"confidence = 0\.9 would do nothing"):
        choose_thresholds(PILOT, confidence=0.9)


@parametrize(("after", "first"), [(None, 1), (4.0, 4), (4.05, 5)])
def test_thresholds_are_read_off_the_switches(after, first):
    """Of runs that switch at every second. Oracle: SciPy's interval, down to two switches."""
    k = np.arange(7)
    tsc = default_rng(0).normal(np.where(k % 2, -0.2, 0.5), 0.1, (2, 7))
    runs = [tl.Session(pd.DataFrame({"mode": k % 2, "tsc": row}, 1.0 * k)) for row in tsc]
    estimate = estimate_thresholds(runs, after=after)
    for side, mode in (("lower", 1), ("upper", 0)):
        own = tsc[:, (k >= first) & (k % 2 == mode)].ravel()
        ends = stats.ttest_1samp(own, 0.0).confidence_interval()
        within = np.mean(np.abs(own - own.mean()) <= 0.15)
        expected = own.size, own.mean(), own.std(ddof=1), *ends, within
        assert estimate.table().loc[side].tolist() == approx(expected)
    assert estimate.switches["t"].tolist() == [*range(first, 7)] * 2
    with refused("occurs twice"):
        estimate_thresholds(runs + runs[:1])
    with pytest.raises(tl.SessionError, match="at 1000 s or later"):
        estimate_thresholds(runs, after=1000.0)


@pytest.mark.filterwarnings("ignore:.*does not enclose β")
def test_choices_say_which_limits_they_keep():
    """Those of an operator whose utilization moves slowly are hardly narrower at their own δ_Ph."""
    slow = made((0.9995, 0.5, 0.4, 0.45), (0.99, 0.2, 0.4))
    for model, covered in ((PILOT, False), (SECOND, False), (OPERATORS["4"], False), (slow, True)):
        own = tl.threshold_limits(model, None)
        for delta in (0.0, own.delta_p_h):
            choice = choose_thresholds(model, delta, points=6, enclose_beta=False)
            assert choice.limits == tl.threshold_limits(model, delta)
            covers = own.contains(choice.lower, choice.upper)
            assert covers == (covered or delta > 0.0)
            text = f"does not cover the pair at the model's own δ_Ph: {own.message}"
            assert (text in choice.message) != covers


def test_switches_at_exactly_one_tsc_each_are_the_clearest_case():
    """Not infinitely far apart, and not told apart, where both are the same."""
    rng = default_rng(0)
    assert _apart(np.array([(5, 0.1, 0.0), (6, 0.5, 0.0)]), rng) == (np.inf, 0.0)
    separation, p = _apart(np.array([(4, 0.25, 0.0)] * 2), rng)
    assert not separation > 1.0
    assert p == 1.0


@parametrize(("n", "told"), [(4, "12"), (8, "124"), (16, "124"), (100, "1245")])
def test_samples_like_those_of_table_2_3_are_told_apart_or_not(n, told):
    """Mean ± SD overlap for participant 3 alone, 0.414/0.42: not told apart by any n switches."""
    rng, sides = default_rng(0), ("TSC_l", "TSC_u")
    for name, known in published_table("2.3").astype(float).items():
        groups = [(n, known[side, "mean"], known[side, "sd"]) for side in sides]
        separation, p = _apart(np.array(groups), rng)
        assert (separation < 1.0) == (name == "3")
        assert (p < 0.01) == (name in told)


@parametrize("sizes", [(3, 3), (4, 12), (20, 20)])
def test_the_test_keeps_its_level_with_few_switches(sizes):
    """Normal switches whose mean ± SD just touch: rejected in at most 5 % of samples."""
    rng, rejected = default_rng(1), 0
    for _ in range(1500):
        low, high = rng.normal(0.0, 0.1, sizes[0]), rng.normal(0.3, 0.2, sizes[1])
        groups = [(each.size, each.mean(), each.std(ddof=1)) for each in (low, high)]
        rejected += _apart(np.array(groups), rng)[1] < 0.05
    assert 0.01 < rejected / 1500 < 0.065


def test_tsc_is_worked_out_from_performance_by_the_model_that_is_given():
    run = tl.simulate_allocation(SECOND, 0.0, 0.35, 20_000).set_index(np.arange(20_000) * 0.1)
    whole, bare = tl.Session(run), tl.Session(run[["mode", "p_r", "p_h"]])
    own = estimate_thresholds(bare, SECOND)
    assert own.distinguishable
    assert (own.lower, own.upper) == approx((0.0, 0.35), abs=0.01)
    # Beside a column tsc as well.
    first, other = (estimate_thresholds(each, OPERATORS["5"]) for each in (whole, bare))
    assert_frame_equal(first.table(), other.table())
    assert first.lower != own.lower
    for session, words in (
        (bare, "give model="),
        (tl.Session(run.iloc[:50]), "never changes"),
        (tl.Session(run.assign(mode=0.5)), "not shares"),
    ):
        with pytest.raises(tl.SessionError, match=words):
            estimate_thresholds(session)


def test_suggestions_are_followed_in_time_or_not():
    mode, suggested = np.ones(1000), np.full(1000, -1.0)
    suggested[100:300], mode[180:] = 0.0, 0.0  # followed after 8 s
    suggested[400:640], mode[600:] = 1.0, 1.0  # too late: 20 s
    suggested[700:720] = 0.0  # never
    time = pd.Index(np.arange(1000) * 0.1, name="t")
    session = tl.Session(pd.DataFrame({"mode": mode, "suggested_mode": suggested}, time))
    table = followed_suggestions(session)
    assert table["followed"].tolist() == [True, False, False]
    assert table["delay"].iloc[0] == approx(8.0)
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
    assert percent["C2"] - percent["C1"] == approx(8.75, abs=1e-9)
    assert percent["C5"] - percent["C3"] == approx(11.86, abs=0.02)
    assert relative_performance([[0.24], [0.4]], 0.24, 0.4) == approx(50.0)
