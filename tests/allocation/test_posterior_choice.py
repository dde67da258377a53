"""
Thresholds and motions under a posterior.

Oracles: `limit_cycle` of single draws; the people that the logs were made of.
"""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from numpy.random import default_rng
from pandas.testing import assert_frame_equal

import trustlab as tl
from tests.allocation.cases import OPERATORS, PILOT, SECOND, encloses_beta, made, settled, warned
from tests.cases import refused
from tests.identification.posterior.simulated_logs import drawn_case, model_of, printed_case
from trustlab.allocation import thresholds
from trustlab.allocation.steady import SCREEN, survey
from trustlab.allocation.thresholds import choose_thresholds

parametrize = pytest.mark.parametrize


@pytest.fixture(scope="module")
def clear():
    session, _ = printed_case(default_rng(3), "white")
    return tl.sample_posterior(session, n=120)


@pytest.fixture(scope="module")
def unclear():
    session, _ = printed_case(default_rng(3), "slow", minutes=5.0)
    return tl.sample_posterior(session, n=120)


@pytest.fixture
def spy(monkeypatch):
    """Which pairs are followed with all draws; with the first of them every twelfth draw fails."""
    follow, seen = thresholds.survey, SimpleNamespace(tried=[], fails=0)

    def survey(models, pairs, *lengths, **starts):
        motions = follow(models, pairs, *lengths, **starts)
        if starts:
            seen.tried.append(tuple(pairs[0]))
            if len(seen.tried) <= seen.fails:
                motions["p_encloses"][motions["model"] % 12 == 0] = False
        return motions

    monkeypatch.setattr(thresholds, "survey", survey)
    return seen


def first(posterior, count, **changes):
    """The first draws of a posterior, or what they are changed to."""
    draws = posterior.draws[:count].assign(**changes)
    return replace(posterior, draws=draws, thetas=posterior.thetas[:count])


def of_one(posterior, tsc):
    """A posterior all of whose draws are one model."""
    names = [name for name in posterior.draws if name.startswith(("human_", "robot_"))]
    values = {}
    for part, name in (each.split("_", 1) for each in names):
        values[f"{part}_{name}"] = getattr(getattr(tsc, part), name)
    return first(posterior, 40, **values)


@parametrize("margin", [0.03, 0.1])
@parametrize("name", ["2", "4", "5"])
def test_a_probability_is_that_of_the_motion_itself(clear, name, margin):
    """Oracle: the person simulated. A coarse sample time overshoots beyond β too soon."""
    tsc = OPERATORS[name]
    choice = choose_thresholds(of_one(clear, tsc), margin=margin)
    assert encloses_beta(settled(tsc, choice.lower, choice.upper, r0=0.6), tsc)
    assert choice.probability == 1.0
    assert choose_thresholds(tsc, margin=margin, points=14).probability == 1.0


@parametrize(("name", "value"), [("points", 0), ("margin", 99.0), ("delta_p_h", -1.0)])
def test_of_a_posterior_too_arguments_out_of_range_are_refused(clear, name, value):
    with refused(f"{name} must"):
        choose_thresholds(clear, **{name: value})


def test_a_pair_is_judged_by_its_motion_sample_by_sample():
    """Screened coarsely utilization comes below β = .75; in truth it stays above .7506."""
    tsc, pair = OPERATORS["4"], (-0.11, 0.36)
    screened = survey([tsc], [pair], SCREEN)
    assert screened["p_encloses"].all()
    assert not encloses_beta(settled(tsc, *pair, r0=0.6), tsc)
    table = pd.DataFrame(screened)
    assert thresholds._followed([tsc] * 3, table, 0.95, "p_encloses") == (*pair, 0.0, 0.0)


def test_how_far_a_motion_keeps_from_beta():
    motions = survey([OPERATORS["4"]], [(-0.11, 0.36), (0.0, 0.1)], SCREEN)
    off = np.maximum(motions["r_low"] - 0.75, 0.75 - motions["r_high"])
    np.testing.assert_allclose(motions["off_beta"], off, atol=1e-12)
    assert (off > 0.0).tolist() == [False, True]


def test_a_clear_log_gets_thresholds_that_do_what_is_said(clear):
    choice = choose_thresholds(clear, confidence=0.95)
    assert choice.offered
    assert choice.probability >= 0.95
    cycle = tl.limit_cycle(PILOT, choice.lower, choice.upper)
    assert cycle.r_low <= PILOT.human.beta <= cycle.r_high
    row = choice.table().loc["P_r"]
    assert row["mean_ci_low"] - 1e-3 < cycle.mean_p_r < row["mean_ci_high"] + 1e-3
    mean = choose_thresholds(clear, objective="mean")
    assert mean.table().loc["P_r", "mean"] >= row["mean"]


def test_an_unclear_log_abstains_and_says_what_to_record(unclear, spy):
    says = "none of the pairs followed .* keeps switching around β with probability 0.99"
    with warned(says):
        choice = choose_thresholds(unclear, confidence=0.99)
    assert spy.tried == [(choice.lower, choice.upper)], "which takes most of the time"
    assert not choice.offered
    assert choice.probability < 0.99
    assert "minutes" in choice.reason
    assert choose_thresholds(unclear, confidence=0.01).offered
    with warned("does not enclose"):
        assert choose_thresholds(unclear, enclose_beta=False).offered


def test_more_data_are_considered_at_the_sample_time_of_the_log(unclear, monkeypatch):
    """As many data as there are leave the draws, here as of a log at 2 Hz, as they are."""
    seen = []
    monkeypatch.setattr(thresholds, "LONGER", (1,))
    monkeypatch.setattr(thresholds, "survey", lambda models, *_: seen.extend(models) or motions)
    target = unclear.target
    slow = replace(unclear, target=target._replace(blocks=target.blocks._replace(step=0.5)))
    motions = survey([SECOND], [(0.0, 0.35)], SCREEN)
    thresholds._what_would_help(slow, pd.DataFrame(motions), 0.9, "p_switches")
    expected = [tsc.robot.a**5 for tsc in unclear.models]
    assert [tsc.robot.a for tsc in seen] == pytest.approx(expected, rel=1e-9)


def test_without_room_no_recording_can_help(clear):
    """Theorem 1 leaves none where the operator's performance moves much and the robot's little."""
    human = SECOND.human
    narrow = made((human.a, human.beta, 0.1, 0.409), (SECOND.robot.a, 0.30, 0.31))
    says = "Theorem 1 leaves no room.*no recording .* can help.*widen the range of robot perf"
    for tsc in (narrow, of_one(clear, narrow)):
        with warned(says):
            choice = choose_thresholds(tsc)
        assert np.isnan([choice.lower, choice.upper, choice.probability]).all()
        assert (choice.encloses_beta, len(choice.table())) == (False, 0)
        assert "<table" in choice._repr_html_()


def test_a_table_over_draws_is_of_each_of_them(clear):
    choice = choose_thresholds(first(clear, 4))
    table = choice.table()
    values = [tl.limit_cycle(tsc, choice.lower, choice.upper).r_low for tsc in choice.tsc.models]
    assert len(values) == 4
    ends = table.loc["r", ["low", "low_ci_low", "low_ci_high"]].tolist()
    assert ends == pytest.approx(np.quantile(values, [0.5, 0.025, 0.975]))
    never = replace(choice, lower=-9.0, upper=9.0).table()
    assert never.index.tolist() == table.index.tolist()
    assert never.isna().all().all()


def test_a_choice_of_no_single_model_has_no_single_motion(clear):
    choice = choose_thresholds(clear)
    with pytest.raises(AttributeError, match=r"has a table\(\).*one of the posterior's models"):
        _ = choice.cycle
    with pytest.raises(AttributeError, match="there are no thresholds: no room"):
        _ = replace(choice, lower=np.nan, upper=np.nan, reason="no room").bounds


def test_objectives_of_a_model():
    choices = [choose_thresholds(SECOND, objective=each) for each in ("peak", "mean", 1.0)]
    peak, mean, weighted = (choice.cycle for choice in choices)
    assert mean.mean_p_r > peak.mean_p_r
    assert peak.p_r_high > mean.p_r_high
    assert_frame_equal(*(choice.candidates for choice in choices[1:]))  # one question
    assert mean.mean_p_r == weighted.mean_p_r
    robot, table = SECOND.robot, choices[2].candidates
    points = tl.relative_performance(table["mean_p_r"][:1], robot.p_min, robot.p_max)
    assert table["objective"][0] == pytest.approx(points)


def switches_around_beta(tsc, lower, upper):
    """Whether a person does so from r = .6, once 100 time constants have passed."""
    count = round(100.0 / (1.0 - max(tsc.human.a, tsc.robot.a)))
    run = settled(tsc, lower, upper, 2 * count, r0=0.6)
    return run["mode"].nunique() == 2 and encloses_beta(run, tsc)


@pytest.mark.long
@pytest.mark.filterwarnings("ignore::UserWarning")
def test_200_people_keep_switching_as_often_as_is_stated():
    """People drawn from the prior, each known by ten minutes, whether or not a pair is offered."""
    stated, kept = [], []
    for number in range(200):
        session, theta = drawn_case(default_rng([45, number]), "white")
        posterior = tl.sample_posterior(session, n=120)
        choice = choose_thresholds(posterior, points=8)
        if not np.isnan(choice.probability):
            stated.append(choice.probability)
            person = model_of(theta)[0]
            kept.append(switches_around_beta(person, choice.lower, choice.upper))
    assert len(kept) > 100
    assert np.mean(kept) >= np.mean(stated) - 0.03


def test_where_the_best_fail_narrowly_the_most_probable_are_followed_too(clear, spy):
    """The best of many pairs lie at the edge of what the screening finds probable enough."""
    spy.fails = thresholds.FOLLOWED
    choice = choose_thresholds(clear)
    rest = choice.candidates[spy.fails :]
    likely = rest.loc[rest["p_encloses"].idxmax(), ["lower", "upper"]]
    assert choice.offered
    assert spy.tried[spy.fails :] == [(choice.lower, choice.upper)] == [tuple(likely)]
    spy.fails = np.inf
    with warned(r"none of the pairs followed .* does with 0\.917\."):
        choose_thresholds(clear)
