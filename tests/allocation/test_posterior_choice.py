"""
Thresholds and motions under a posterior.

Oracles: `limit_cycle` of single draws; the people that the logs were made of.
"""

from dataclasses import replace

import numpy as np
import pytest

import trustlab as tl
from tests.allocation.cases import encloses_beta, settled
from tests.identification.posterior import simulated_logs
from trustlab.allocation import thresholds


@pytest.fixture(scope="module")
def clear():
    session, _ = simulated_logs.printed_case(np.random.default_rng(3), "white")
    return tl.sample_posterior(session, n=120)


@pytest.fixture(scope="module")
def unclear():
    session, _ = simulated_logs.printed_case(np.random.default_rng(3), "slow", minutes=5.0)
    return tl.sample_posterior(session, n=120)


def of_one(posterior, tsc, count=40):
    """A posterior all of whose draws are one model."""
    table = posterior.draws.iloc[:count].assign(
        human_a=tsc.human.a,
        human_beta=tsc.human.beta,
        human_p_min=tsc.human.p_min,
        human_p_max=tsc.human.p_max,
        robot_a=tsc.robot.a,
        robot_p_min=tsc.robot.p_min,
        robot_p_max=tsc.robot.p_max,
    )
    return replace(posterior, draws=table, thetas=posterior.thetas[:count])


@pytest.mark.parametrize("margin", [0.03, 0.1])
@pytest.mark.parametrize("name", ["2", "4", "5"])
def test_a_probability_is_that_of_the_motion_itself(clear, operators, name, margin):
    """Oracle: the person simulated. A coarse sample time overshoots beyond β too soon."""
    tsc = operators[name]
    person = of_one(clear, tsc)
    choice = tl.choose_thresholds(person, margin=margin)
    assert encloses_beta(settled(tsc, choice.lower, choice.upper, r0=0.6), tsc)
    assert choice.probability == 1.0
    assert tl.choose_thresholds(tsc, margin=margin, points=14).probability == 1.0


def test_where_no_pair_is_probable_one_alone_is_followed_with_all_draws(unclear, monkeypatch):
    """That is most of the time that a posterior takes."""
    follow, followed = thresholds.survey, []

    def survey(models, pairs, *lengths, **starts):
        if starts:
            followed.extend(map(tuple, pairs))
        return follow(models, pairs, *lengths, **starts)

    monkeypatch.setattr(thresholds, "survey", survey)
    with pytest.warns(UserWarning, match="No thresholds"):
        choice = tl.choose_thresholds(unclear, points=8, confidence=0.999)
    assert followed == [(choice.lower, choice.upper)]


def test_a_clear_log_gets_thresholds_that_do_what_is_said(clear, operators):
    choice = tl.choose_thresholds(clear, confidence=0.95)
    assert choice.offered
    assert choice.probability >= 0.95
    cycle = tl.limit_cycle(operators["pilot"], choice.lower, choice.upper)
    assert cycle.exists
    assert cycle.r_low <= operators["pilot"].human.beta <= cycle.r_high
    row = choice.table().loc["P_r"]
    assert row["mean_ci_low"] - 1e-3 < cycle.mean_p_r < row["mean_ci_high"] + 1e-3
    mean = tl.choose_thresholds(clear, objective="mean")
    assert mean.table().loc["P_r", "mean"] >= row["mean"]


def test_an_unclear_log_abstains_and_says_what_to_record(unclear):
    with pytest.warns(
        UserWarning,
        match="none of the pairs followed .* keeps switching around β with probability 0.99",
    ):
        choice = tl.choose_thresholds(unclear, confidence=0.99)
    assert not choice.offered
    assert choice.probability < 0.99
    assert choice.message == f"No thresholds: {choice.reason}"
    assert "minutes" in choice.reason
    assert tl.choose_thresholds(unclear, confidence=0.01).offered


def test_without_room_no_recording_can_help(clear, operators):
    """Theorem 1 leaves none where the operator's performance moves much and the robot's little."""
    robot = replace(operators["2"].robot, p_min=0.30, p_max=0.31)
    human = replace(operators["2"].human, p_min=0.1, p_max=0.409)
    narrow = tl.TscModel(tl.RobotModel(robot.a, 0.30, 0.31, human.p_max), human)
    assert not tl.threshold_limits(narrow).feasible
    for tsc in (narrow, of_one(clear, narrow)):
        with pytest.warns(UserWarning, match="Theorem 1 leaves no room"):
            choice = tl.choose_thresholds(tsc)
        assert "no recording of this robot and operator can help" in choice.reason
        assert "widen the range of robot performance" in choice.reason
        assert np.isnan([choice.lower, choice.upper]).all()
        assert np.isnan(choice.probability)
        assert (choice.encloses_beta, len(choice.table())) == (False, 0)
        assert "<table" in choice._repr_html_()


@pytest.mark.parametrize(
    ("name", "value"), [("points", 0), ("margin", 99.0), ("delta_p_h", -1.0), ("confidence", 7.0)]
)
def test_what_is_out_of_range_is_refused(clear, name, value):
    with pytest.raises(ValueError, match=name):
        tl.choose_thresholds(clear, **{name: value})


def test_a_table_over_draws_is_of_each_of_them(clear):
    choice = tl.choose_thresholds(replace(clear, draws=clear.draws[:4], thetas=clear.thetas[:4]))
    table = choice.table()
    values = [tl.limit_cycle(tsc, choice.lower, choice.upper).r_low for tsc in choice.tsc.models]
    assert len(values) == 4
    ends = table.loc["r", ["low", "low_ci_low", "low_ci_high"]].tolist()
    assert ends == pytest.approx(np.quantile(values, [0.5, 0.025, 0.975]))
    never = replace(choice, lower=-9.0, upper=9.0).table()
    assert never.index.tolist() == table.index.tolist()
    assert never.isna().all().all()


def test_a_choice_of_no_single_model_has_no_single_motion(clear):
    choice = tl.choose_thresholds(clear)
    with pytest.raises(AttributeError, match=r"has a table\(\).*one of the posterior's models"):
        _ = choice.cycle
    with pytest.raises(AttributeError, match="there are no thresholds: no room"):
        _ = replace(choice, lower=np.nan, upper=np.nan, reason="no room").bounds


def test_objectives_of_a_model(operators):
    choices = {
        each: tl.choose_thresholds(operators["2"], objective=each) for each in ("peak", "mean", 1.0)
    }
    assert choices["mean"].cycle.mean_p_r > choices["peak"].cycle.mean_p_r
    assert choices["peak"].cycle.p_r_high > choices["mean"].cycle.p_r_high
    assert choices["mean"].cycle.mean_p_r == choices[1.0].cycle.mean_p_r  # one question
    robot, table = operators["2"].robot, choices[1.0].candidates
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
        session, theta = simulated_logs.drawn_case(np.random.default_rng([45, number]), "white")
        posterior = tl.sample_posterior(session, n=120)
        choice = tl.choose_thresholds(posterior, points=8)
        if not np.isnan(choice.probability):
            stated.append(choice.probability)
            person = simulated_logs.model_of(theta)[0]
            kept.append(switches_around_beta(person, choice.lower, choice.upper))
    assert len(kept) > 100
    assert np.mean(kept) >= np.mean(stated) - 0.03


def test_where_the_best_fail_narrowly_the_most_probable_are_followed_too(clear, monkeypatch):
    """The best of many pairs lie at the edge of what the screening finds probable enough."""
    follow, tried = thresholds.survey, []

    def survey(models, pairs, *lengths, **starts):
        motions = follow(models, pairs, *lengths, **starts)
        if starts:
            tried.append(tuple(pairs[0]))
            if len(tried) <= fails:
                motions.loc[motions["model"] % 12 == 0, "p_encloses"] = False
        return motions

    monkeypatch.setattr(thresholds, "survey", survey)
    fails = thresholds.FOLLOWED
    choice = tl.choose_thresholds(clear)
    rest = choice.candidates[fails:]
    likely = rest.loc[rest["p_encloses"].idxmax(), ["lower", "upper"]]
    assert choice.offered
    assert tried[fails:] == [(choice.lower, choice.upper)] == [tuple(likely)]
    fails, tried[:] = np.inf, []
    with pytest.warns(UserWarning, match=r"none of the pairs followed .* does with 0\.917\."):
        tl.choose_thresholds(clear)
