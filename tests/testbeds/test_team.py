"""
Teams whose graphs change, whose trust is another model, and as a testbed of virtual studies.

Oracles: `simulate_team` with the same arguments; energy balances; a deaf leader stops a team.
"""

import networkx as nx
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import trustlab as tl
from tests.cases import refused
from tests.loops import simulate_team, team_loop
from trustlab.teleoperation import (
    GivenSequence,
    PartError,
    TeamOperator,
    TeamRobot,
    TeamSettings,
    TeamTrial,
)
from trustlab.teleoperation.team import kernel
from trustlab.teleoperation.team.decisions import POLICIES
from trustlab.testbeds import RobotTeam

CHAIN, RING = nx.path_graph(4), nx.cycle_graph(4)
SOUND = (TeamRobot(),) * 3
DEAF = TeamRobot(loss=1.0), *SOUND


def test_on_a_directed_graph_a_spanning_tree_is_enough():
    graph = nx.DiGraph([(1, 0), (2, 1), (3, 2), (3, 0)])  # robot 0 sees nobody and is seen by all
    run = simulate_team(graph, GivenSequence([0], times=[0.0]), seed=1, duration=300.0)
    assert run.converged
    data = run.data
    assert data[["v_fs", "v_t"]].isna().all(axis=None)
    # an identity on any graph
    assert np.ptp(data["v_e"] - data["supply_error"] + data["lost_error"]) <= 1e-11 * max(
        data["v_e"]
    )


@pytest.mark.parametrize("graph", [nx.cycle_graph(50), nx.complete_graph(20), nx.star_graph(30)])
def test_scaled_gains_keep_the_guarantees_in_large_teams(graph):
    scaled = TeamSettings.scaled(graph)
    run = simulate_team(graph, "random", seed=5, settings=scaled, duration=200.0)
    assert run.converged
    assert run.operator_passive
    assert np.diff(run.data["v_t"]).max() <= 1e-11 * run.data["v_t"].max()


# --- the loop -------------------------------------------------------------------------------------


def test_drift_is_a_source():
    """Negative control: with a robot that drifts V_T rises."""
    run = simulate_team(CHAIN, robots=(TeamRobot(drift=0.1), *SOUND), duration=60.0)
    assert np.diff(run.data["v_t"]).max() > 1e-6


def test_a_wish_waits_for_the_dwell_time():
    loop = team_loop(CHAIN, duration=20.0)
    first = loop.step(leader=2)
    assert (loop.leader, first.number) == (2, 2.0)
    loop.step(leader=1)
    run = loop.run()
    assert_allclose(run.switches, [5.0])
    assert loop.leader == 1
    with refused(r"leader must be one of \[0, 1, 2, 3\], got 9"):
        tl.TeamLoop(CHAIN).step(leader=9)


def test_a_hand_leads_the_device():
    """The device is near where a still hand is, but for the force that it feels."""
    loop = team_loop(CHAIN, duration=3.0, operator=TeamOperator(guarded=False))
    for _ in range(300):
        state = loop.step(hand=(0.02, 0.0, 0.0))
    assert 0.005 < state.device[0] < 0.02
    assert_allclose(state.device[1:], 0.0, atol=3e-3)


def test_the_state_of_a_team_is_the_row_of_its_last_sample():
    """Oracle: the table of a run that records every sample."""
    same = {"graph": CHAIN, "seed": 3, "duration": 5.0, "robots": (TeamRobot(speed=0.4), *SOUND)}
    state = team_loop(**same).step(samples=207)
    last = np.hstack([state[name] for name in kernel.LOG.names])
    assert_array_equal(last, simulate_team(**same).data.iloc[206])


def test_budgets_are_in_units_of_v_e_in_which_slow_robots_count_more():
    robots = TeamRobot(speed=0.05), *SOUND
    run = simulate_team(CHAIN, robots=robots, lead_gain=0.5, duration=1.0)
    assert run.budget == pytest.approx(4.0 * (1.0 + run.data["v_e"].iloc[0]), rel=1e-12)


def test_switches_are_counted_between_recorded_rows_too():
    same = {"policy": "sequence", "duration": 100.0, "min_dwell": 5.0}
    fine, coarse = (simulate_team(CHAIN, record_every=every, **same) for every in (0.01, 40.0))
    assert_allclose(fine.switches, 10.0 * np.arange(1, 10))
    assert_array_equal(coarse.switches, fine.switches)


@pytest.mark.parametrize("policy", sorted(POLICIES))
def test_policies_choose_among_those_who_may_lead(policy):
    star = nx.DiGraph([(0, 2), (1, 2), (3, 2)])
    assert (simulate_team(star, policy, duration=30.0).data["number"] == 2).all()
    leaving = {0.0: nx.cycle_graph("abcd"), 3.0: nx.path_graph("bcd")}
    assert (simulate_team(leaving, policy, duration=30.0).data["number"][3.0:] > 0).all()


class Picking:
    """Who leads by a number, which is no robot's after two seconds."""

    title = "picking"

    def leader(self, now):
        return 0 if now.t < 2.0 else 7


def test_a_policy_that_picks_nobody_is_named_and_the_run_so_far_is_kept():
    loop = team_loop(CHAIN, Picking(), duration=10.0)
    words = "the leader policy 'picking', at t = 2 s: .* from 0 to 3, got 7"
    for _ in range(2):
        with pytest.raises(PartError, match=words) as caught:
            loop.run()
    assert caught.value.session.t[-1] == 1.99


@pytest.mark.parametrize("performance", ["motion", "random"])
def test_a_longer_run_begins_as_the_shorter_one(performance):
    robots = TeamRobot(drift=0.05, loss=0.3), TeamRobot(), TeamRobot(loss=0.5), TeamRobot(drift=0.1)
    same = {"robots": robots, "performance": performance}
    short, long = (simulate_team(CHAIN, duration=s, **same) for s in (12.0, 20.0))
    assert_array_equal(short.data, long.data[:11.995])
    assert_array_equal(short.trust, long.trust[:1200])


# --- a testbed ------------------------------------------------------------------------------------


class Nearest:
    """The robot nearest to the goal leads; it keeps what it was told."""

    title = "nearest"

    def __init__(self):
        self.told = []

    def leader(self, now):
        self.told.append(now)
        away = ((now.positions - [1.0, 2.0, 0.5]) ** 2).sum(axis=1)
        return int(away.argmin())


def test_a_policy_by_places_never_picks_who_has_left_and_may_keep_what_it_was_told():
    """Robot 0 is the nearest until it leaves; argmin took its NaN for the least."""
    start = np.array([[1.0, 2.0, 0.5], [5.0, 2.0, 0.5], [9.0, 2.0, 0.5]])
    graph = {0.0: nx.MultiGraph(nx.complete_graph(3)), 4.0: nx.complete_graph([1, 2])}
    policy = Nearest()
    run = simulate_team(graph, policy, duration=8.0, start=start)
    leaders = run.data["number"].to_numpy()
    assert leaders[0] == 0
    assert set(leaders[run.t >= 4.2]) <= {1, 2}
    times = [now.t for now in policy.told]
    assert_allclose(times, 0.1 * np.arange(len(times)), atol=1e-9)


def test_an_assumption_is_checked_before_any_run():
    with refused("push"):
        RobotTeam().people(3, {"push": -3.0})


def test_a_session_is_a_run_of_the_team():
    bed = RobotTeam(robots=(TeamRobot(), *SOUND), duration=20.0)
    person = bed.people(3, seed=2).to_dict("records")[2]
    session = bed.run("sequence", person, 7)
    run = tl.simulate_team(
        RING,
        "sequence",
        seed=np.random.SeedSequence(7).spawn(2)[1],
        duration=20.0,
        operator=TeamOperator(**{name: person[name] for name in ("push", "reach", "drag")}),
        settings=TeamSettings.scaled(RING, 40.0),
        trial=TeamTrial(0.01, record_every=0.1, tolerance=0.1),
    )
    assert_array_equal(session.positions, run.positions)
    measures = session.measures
    assert measures["switches"] == len(run.switches)
    assert measures["work"] == run.data["supply_hand"].iloc[-1]
    assert session.session.metadata.synthetic
    assert bed.next_session(person, session) is person


def test_robots_of_a_testbed_are_given_once_and_fit_their_graph():
    with refused("robots of blocks would do nothing: give robots="):
        RobotTeam(blocks=TeamSettings(robots=DEAF))
    with refused("robots has 4 entries for 5 robots"):
        RobotTeam(graph=nx.cycle_graph(5))
    two = RobotTeam(robots=SOUND[:2], blocks=TeamSettings())
    assert_array_equal(two.graph, [[0.0, 1.0], [1.0, 0.0]])


def test_a_study_tells_policies_apart():
    """Where one robot is deaf, who trusts robots by what they do lets it lead no more."""
    deaf = RobotTeam(robots=DEAF, duration=60.0)
    policies = ["most_trusted", "sequence", Nearest()]
    study = tl.virtual_study(n=12, testbed=deaf, conditions=policies, seed=0)
    assert study.conditions == ("most_trusted", "sequence", "nearest")
    pairs = study.analysis("time").pairs().set_index(["a", "b"])
    first = pairs.loc[("most_trusted", "sequence")]
    assert first["p_holm"] < 0.05, pairs
    assert first["mean_difference"] < 0.0
