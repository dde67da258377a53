"""
Tasks behind their protocol: what a run logs, its measures, and who may choose.

Oracle: `TeamLoop` and `TeleoperationLoop` stepped here by the logged commands, without the task's
code; plain loops; `cohens_kappa` of statsmodels.
"""

import numpy as np
import pandas as pd
import pytest
from statsmodels.stats.inter_rater import cohens_kappa

import trustlab as tl
from tests.cases import refused
from tests.live.cases import commands_for, configured, session_of
from trustlab.live.hands import ScriptedLeader
from trustlab.live.task import task_named
from trustlab.live.tasks.team import ABILITIES, occasions, policy_agreement
from trustlab.live.tasks.teleoperation import task_of
from trustlab.operators.teleoperator import REACH
from trustlab.sessions.session import Metadata, Session
from trustlab.teleoperation.team.settings import TeamOperator, TeamSettings, TeamTrial

SHORT = {"team": {"duration": 9.0, "goals": 2}, "teleoperation": {"duration": 3.0}}


def a_session(task, condition):
    """A run by random commands, each held for a second; its config and commands."""
    config = configured(task, condition, **SHORT[task])
    commands = commands_for(config, hold=20)
    return session_of(config, commands), config, np.array(commands)


class ByCommand:
    """A policy that leads as the commands say, written out."""

    title = "commands"

    def __init__(self, choices):
        self.choices = choices

    def leader(self, now):
        choice = int(self.choices[min(round(now.t / 0.05), len(self.choices) - 1)])
        return choice - 1 if choice else now.leader or 0


def test_commands_that_nobody_can_give_are_refused():
    task, config, nan = task_named("team"), configured("team"), float("nan")
    task.check(config, [1.0, -1, 4])
    bad = [[0.5, 0.5, 1.5], [1.01, 0, 1], [0.5, 0.5], [0.5, nan, 1], [True, "1", 1]]
    for command in (*bad, [10**400, 0, 1]):
        with refused(r"cannot be|a command is"):
            task.check(config, command)


def test_a_team_is_that_of_the_loop():
    session, config, commands = a_session("team", "by_hand")
    ring = np.array([[0, 1, 0, 1], [1, 0, 1, 0], [0, 1, 0, 1], [1, 0, 1, 0]], float)
    robots = tuple(type(ABILITIES[0])(**robot) for robot in config["robots"])
    settings = TeamSettings(robots=robots, min_dwell=5.0, **config["gains"])
    trial = TeamTrial(0.01, start=np.array(config["start"]))
    goal, operator = (*config["goals"][-1], 0.0), TeamOperator(guarded=False)
    loop = tl.TeamLoop(ring, ByCommand(commands[:, 2]), goal, 3, 9.05, operator, settings, trial)
    expected = []
    for x, y, _ in commands[: len(session)]:
        for _ in range(5):
            loop.step(hand=(0.12 * x, 0.12 * y, 0.0))
        expected.append([*loop.positions[:, :2].mean(axis=0), loop.leader + 1, *loop.trust])
    names = ["team_x", "team_y", "leader", *(f"trust_{i}" for i in range(1, 5))]
    np.testing.assert_array_equal(session.data[names], expected)
    assert len(set(session["leader"])) > 1, "the leader changed"
    scaled = TeamSettings.scaled(ring, 40.0)
    assert config["gains"]["coupling"] == pytest.approx(scaled.coupling)


def test_a_flight_is_that_of_the_loop():
    session, _, commands = a_session("teleoperation", "MMI")
    operator = tl.Teleoperator("live", reach=REACH["main"], noise=0.0)
    settings = tl.teleoperation.STUDIES["main"]
    ends = settings.scattering
    share = ends.alpha_min + commands[:, 2] * (ends.alpha_max - ends.alpha_min)
    signals = {"alpha": np.repeat(share, 5)}
    loop = tl.TeleoperationLoop("MMI", operator, "main", 3, 0.05 * len(share), signals=signals)
    reach = 2.0 * REACH["main"] / np.broadcast_to(settings.weight, 3)[:2]
    for x, y, _ in commands:
        for _ in range(5):
            loop.step(hand=(x * reach[0], y * reach[1], 0.0))
    rows = loop.session.data.iloc[4::5]
    np.testing.assert_allclose(session["alpha"], share)
    for name in ("alpha", "path_error", "f_m_x"):
        np.testing.assert_array_equal(session[name], rows[name])


def test_a_flight_that_fails_keeps_the_row_of_before():
    def fails(state):
        if state.t > 0.5:
            raise RuntimeError("no scale")
        return state.alpha_min, state.beta_max

    config = configured("teleoperation", "M", duration=2.0)
    flight = task_of(scheme=tl.Scheme("mine", fails)).begin(config)
    rows = np.array([flight.step(0.5, 0.2, -1.0) for _ in range(40)])
    assert "no scale" in flight.picture()["over"]
    assert np.flatnonzero((np.diff(rows, axis=0) != 0.0).any(axis=1)).max() == 8


def test_policies_lead_where_they_should_and_suggest_where_they_should():
    for condition in ("most_trusted", "hysteresis"):
        session, config, _ = a_session("team", condition)
        free = session["may_switch"] > 0
        assert (session["leader"] == session[f"leader_{condition}"])[free].all()
        assert not session["leader_suggested"].any()
    config = configured("team", "suggested", duration=25.0)
    session = session_of(config, [[1.0, 0.0, 3]] * config["samples"])
    suggested = session["leader_suggested"]
    assert set(session["leader"]) == {3}, "nothing was accepted"
    measures = task_named("team").measures(session.between(1.0, 25.0))
    assert (measures["suggestions"], measures["followed_percent"]) == (1, 0.0)
    pick = session["leader_hysteresis"]
    stands = (session["may_switch"] > 0) & (pick != session["leader"])
    assert (suggested[stands] == pick[stands]).all()
    assert not suggested[~stands].any()


# agreement
# --------------------------------------------------------------------------------------------------


def a_run(leader, picks, free, participant="P01", dwell=0.2):
    columns = {"leader": leader, "leader_most_trusted": picks, "leader_hysteresis": picks}
    data = pd.DataFrame({**columns, "may_switch": free}, dtype=float)
    data.index = pd.Index(np.round(0.05 * np.arange(len(data)), 9), name="t")
    about = Metadata(participant, "by_hand", more={"min_dwell": dwell})
    return Session(data, about)


def test_an_occasion_lasts_until_the_leader_changes_or_a_dwell_time_has_passed():
    config = configured("team", "by_hand", duration=40.0)
    # switches at 8 s; at 13 s, the end of the dwell time, by a wish made before; and at 27 s
    wishes = [0] * 160 + [2] * 2 + [3] * 378 + [4] * 260
    session = session_of(config, [[0.5, 0.0, wish] for wish in wishes])
    switched = 1 + np.flatnonzero(np.diff(session["leader"]))
    assert switched.tolist() == [160, 260, 540]
    table = occasions(session, config["min_dwell"])
    assert table["t"].tolist() == [5.0, 13.0, 18.0, 23.0, 32.0]
    assert table["chosen"].tolist() == [2, 3, 3, 4, 4]
    picks = session["leader_most_trusted"][[100, 260, 360, 460, 640]]
    assert table["most_trusted"].tolist() == picks.tolist()


def test_agreement_is_cohens_kappa():
    rng = np.random.default_rng(1)
    runs, pooled = [], np.zeros(3)
    for person in range(5):
        picks = rng.integers(1, 5, 300)
        leader = np.where(rng.random(300) < 0.6, picks, rng.integers(1, 5, 300))
        run = a_run(leader, picks, np.ones(300), f"P{person}")
        runs.append(run)
        table = occasions(run, 0.2)
        square = pd.crosstab(table["chosen"], table["most_trusted"])
        square = square.reindex(index=range(1, 5), columns=range(1, 5), fill_value=0)
        oracle = cohens_kappa(square.to_numpy())
        single = policy_agreement([run]).loc["most_trusted"]
        assert single["kappa"] == pytest.approx(oracle.kappa)
        assert np.isnan(single["low"])
        pooled += len(table) * np.array([1.0, single["agreement"], single["chance"]])
    result = policy_agreement(runs).loc["most_trusted"]
    count, agreed, chance = pooled
    assert result["kappa"] == pytest.approx((agreed - chance) / (count - chance))
    assert 0.2 < result["low"] < result["kappa"] < result["high"] < 0.9


# studies
# --------------------------------------------------------------------------------------------------


class Own(tl.trust.TrustDynamics):
    """A model of one's own, which a plan cannot hold."""


@pytest.mark.parametrize(("task", "column"), [("team", "trust_1"), ("teleoperation", "trust_hr")])
def test_studies_of_another_model_of_trust_are_rehearsed_and_read(tmp_path, task, column):
    """Trust stays over a trial of half a second, ten rows."""

    def planned(trust):
        settings = {"training": 1.0, **SHORT[task], "duration": 2.0, "rehearsal": True}
        conditions = task_named(task).conditions[:2]
        return tl.LiveStudy(tmp_path / "a", conditions, 2, task=task, trust=trust, **settings)

    with refused("cannot be replayed from a study's plan"):
        planned(Own())
    beta = tl.trust.MODELS["beta"](success=2.0, failure=3.0)
    plan = planned(tl.trust.TrustInLoop(beta, every=0.5))
    plan.rehearse(1)
    study = tl.read_live_study(plan.folder)
    assert study.measures["verified"].tolist() == [True] * 4
    assert np.isfinite(study.measures[list(study.task.reported)].to_numpy(float)).all()
    assert study.participants["complete"].all()
    assert study.faults().empty
    session = study.sessions()[0]
    assert session.sample_time == 0.05
    changes = np.flatnonzero(np.diff(session[column]))
    assert set(np.diff(changes) % 10) == {0}


def test_a_scripted_leader_pulls_the_robot_that_leads_to_the_goal():
    hand = ScriptedLeader({"condition": "suggested"}, np.random.default_rng(0))
    picture = {"robots": [[0, 0], [5, 5]], "goal": [0.4, -0.4], "leader": 1, "suggested": 0}
    assert hand(picture)[:2] == pytest.approx((0.4, -0.4), abs=0.3)


def test_a_page_draws_all_goals_and_how_long_a_leader_stays():
    config = configured("team", "by_hand", duration=12.0)
    run, courses = task_named("team").begin(config), []
    for command in commands_for(config, hold=20):
        run.step(*command)
        courses.append((run.leader, run.picture()["wait"]))
    leaders, waits = np.array(courses).T
    switched = 1 + np.flatnonzero(np.diff(leaders))
    assert switched[-1] > 100
    np.testing.assert_allclose(waits[switched + 2], config["min_dwell"], atol=0.1)
    assert np.abs(config["goals"]).max() < config["field"]
