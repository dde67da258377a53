"""
The team of robots as a testbed of virtual studies, whose conditions are leader policies.

Oracles: `simulate_team` with the same arguments; a deaf robot that leads stops a team.
"""

import networkx as nx
import numpy as np
import pytest

import trustlab as tl
from trustlab.teleoperation import TeamOperator, TeamRobot, TeamSettings, TeamTrial
from trustlab.testbeds import RobotTeam


class Nearest:
    """The robot nearest to the goal leads."""

    title = "nearest"

    def leader(self, now):
        away = ((now.positions - [1.0, 2.0, 0.5]) ** 2).sum(axis=1)
        return int(away.argmin())


def test_a_policy_by_places_never_picks_who_has_left():
    """Robot 0 is the nearest until it leaves; argmin took its NaN for the least."""
    start = np.array([[1.0, 2.0, 0.5], [5.0, 2.0, 0.5], [9.0, 2.0, 0.5]])
    graph = {0.0: nx.complete_graph(3), 4.0: nx.complete_graph([1, 2])}
    run = tl.simulate_team(graph, Nearest(), duration=8.0, trial=TeamTrial(start=start))
    leaders = run.data["number"].to_numpy()
    assert leaders[0] == 0
    assert set(leaders[run.t >= 4.2]) <= {1, 2}


def test_an_assumption_is_checked_before_any_run():
    with pytest.raises(ValueError, match="push"):
        RobotTeam().people(3, {"push": -3.0})


def test_a_session_is_a_run_of_the_team():
    bed = RobotTeam(robots=(TeamRobot(),) * 4, duration=20.0)
    person = bed.people(3, seed=2).to_dict("records")[2]
    session = bed.run("sequence", person, 7)
    ring = nx.cycle_graph(4)
    run = tl.simulate_team(
        ring,
        "sequence",
        seed=np.random.SeedSequence(7).spawn(2)[1],
        duration=20.0,
        operator=TeamOperator(push=person["push"], reach=person["reach"], drag=person["drag"]),
        settings=TeamSettings.scaled(ring, 40.0),
        trial=TeamTrial(0.01, record_every=0.1, tolerance=0.1),
    )
    np.testing.assert_array_equal(session.positions, run.positions)
    measures = session.measures
    assert measures["switches"] == len(run.switches)
    assert measures["work"] == run.data["supply_hand"].iloc[-1]
    assert session.session.metadata.synthetic
    assert bed.next_session(person, session) is person


def test_a_study_tells_policies_apart():
    """Where one robot is deaf, who trusts robots by what they do lets it lead no more."""
    deaf = RobotTeam(robots=(TeamRobot(loss=1.0), *(TeamRobot(),) * 3), duration=60.0)
    policies = ["most_trusted", "sequence", Nearest()]
    study = tl.virtual_study(n=12, testbed=deaf, conditions=policies, seed=0)
    assert study.conditions == ("most_trusted", "sequence", "nearest")
    pairs = study.analysis("time").pairs().set_index(["a", "b"])
    first = pairs.loc[("most_trusted", "sequence")]
    assert first["p_holm"] < 0.05, pairs
    assert first["mean_difference"] < 0.0
