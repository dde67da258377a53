"""
Trust that comes from what robots do: faults, the choice of a leader, and a loop that is stepped.
"""

import networkx as nx
import numpy as np
import pytest

import trustlab as tl
from tests.teams import simulate_team
from trustlab.teleoperation import (
    TeamOperator,
    TeamRobot,
    TeamSettings,
    TeamTrial,
)

CHAIN = nx.path_graph(4)
DEAF = TeamRobot(loss=1.0)


def faulty(robot, place=0, size=4, **change):
    """Settings of a team in which one robot has a fault."""
    robots = tuple(robot if i == place else TeamRobot() for i in range(size))
    return TeamSettings(robots=robots, **change)


def test_drift_is_a_source():
    """Negative control: with a robot that drifts V_T rises."""
    settings = faulty(TeamRobot(drift=0.1))
    run = simulate_team(CHAIN, settings=settings, duration=60.0, sample_time=0.01)
    assert np.diff(run.data["v_t"]).max() > 1e-6


@pytest.mark.parametrize("seeds", [3, pytest.param(100, marks=pytest.mark.long)])
def test_the_most_trusted_robot_is_sooner_at_the_goal(seeds):
    """One deaf robot of four. Negative control: with trust that comes from nothing it is not."""
    cases = [(policy, "motion") for policy in ("most_trusted", "sequence", "random")]
    cases.append(("most_trusted", "random"))
    times = np.empty((seeds, 4))
    for seed in range(seeds):
        deaf = int(np.random.default_rng([11, seed]).integers(4))
        arguments = {"seed": seed, "settings": faulty(DEAF, deaf), "duration": 200.0}
        arguments |= {"sample_time": 0.02, "record_every": 0.1}
        for column, (policy, performance) in enumerate(cases):
            run = simulate_team(nx.cycle_graph(4), policy, performance=performance, **arguments)
            times[seed, column] = run.time_to_goal if run.converged else 200.0
    sooner = times[:, 1:] - times[:, :1]
    assert (sooner.mean(axis=0) > 5.0).all()
    if seeds > 3:
        error = sooner.std(axis=0, ddof=1) / np.sqrt(seeds)
        assert (sooner.mean(axis=0) > 3.0 * error).all()


class TestLoop:
    @property
    def options(self):
        return {"seed": 3, "trial": TeamTrial(0.01), "settings": faulty(DEAF)}

    @pytest.mark.parametrize("policy", ["most_trusted", "random"])
    def test_stepped_as_run(self, policy):
        """Bit for bit, also in part stepped and in part run."""
        graph = {0.0: nx.cycle_graph(4), 4.0: CHAIN}
        whole = tl.simulate_team(graph, policy, duration=12.0, **self.options)
        loop = tl.TeamLoop(graph, policy, duration=12.0, **self.options)
        while loop.t < 7.0 - 1e-9:
            loop.step()
        assert loop.run(until=9.0).data.equals(whole.data[:9.0].iloc[:900])
        run = loop.run()
        assert run.data.equals(whole.data)
        np.testing.assert_array_equal(run.positions, whole.positions)
        np.testing.assert_array_equal(run.trust, whole.trust)
        assert run.facts == whole.facts
        with pytest.raises(ValueError, match="longer duration"):
            loop.step()

    def test_a_wish_waits_for_the_dwell_time(self):
        loop = tl.TeamLoop(CHAIN, duration=20.0, performance="random", trial=TeamTrial(0.01))
        first = loop.step(leader=2)
        assert loop.leader == 2
        assert first.number == 2.0
        loop.step(leader=1)
        run = loop.run()
        np.testing.assert_allclose(run.switches, [5.0])
        assert loop.leader == 1
        assert run.facts["waits"] == 49  # decisions at 0.1 … 4.9 s
        with pytest.raises(ValueError, match=r"leader must be one of \[0, 1, 2, 3\], got 9"):
            tl.TeamLoop(CHAIN).step(leader=9)

    def test_a_hand_leads_the_device(self):
        """The device is near where a still hand is, but for the force that it feels."""
        loop = tl.TeamLoop(
            CHAIN, duration=3.0, trial=TeamTrial(0.01), operator=TeamOperator(guarded=False)
        )
        for _ in range(300):
            state = loop.step(hand=(0.02, 0.0, 0.0))
        assert 0.005 < state.device[0] < 0.02
        np.testing.assert_allclose(state.device[1:], 0.0, atol=3e-3)
