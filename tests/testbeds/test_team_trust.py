"""
Trust that comes from what robots do: faults, what is measured of them, the choice of a leader, and
a loop that is stepped.
"""

import networkx as nx
import numpy as np
import pytest

import trustlab as tl
from tests.teams import simulate_team
from trustlab.teleoperation import (
    TeamChannel,
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


def own_loop(start, goal, robots, duration, T=4e-3, delay=0.2):
    """
    The closed loop written out: an explicit rule of second order on the ordinary differential
    equations, waves in a queue, trust and the most trusted leader by plain loops.
    """
    size, count, late = len(start), round(duration / T), round(delay / T)
    speed = np.array([robot.speed for robot in robots])[:, None]
    deaf = np.array([robot.loss == 1.0 for robot in robots])
    rated = (2.0 * speed / (1.0 + speed))[:, 0].round(3)
    L = nx.laplacian_matrix(CHAIN).toarray()
    b, low, high = 2.0, 0.5, 1.0
    M, B, K, weight, drag = 0.5, 5.5, 20.0, 10.0, 1.0
    push = 4.0 / (1.0 + 2.0 * delay)
    far = np.linalg.norm(start - goal, axis=1).max()
    parts = [start - goal, np.zeros_like(start), np.zeros(3), np.zeros(3)]
    trust_in, trust_of = np.full(size, 0.5), np.full(size, 0.5)
    # what arrives, at the robot and back, and what is seen
    to_robot, to_hand, seen = np.zeros((3, count + late, 3))
    leader, since = 0, 0.0
    places, leaders, levels = [], [], []
    for k in range(count):
        if k and k % round(0.1 / T) == 0:
            heard = np.where((np.arange(size) == leader) & deaf, 0.0, rated)
            trust_in = heard + np.exp(-0.1 * 0.1) * (trust_in - heard)
            best = int(np.argmax(trust_in))
            if trust_in[best] > trust_in[leader] and k * T - since >= 5.0 - 1e-9:
                leader, since = best, k * T
        places.append(parts[0] + goal)
        leaders.append(leader)
        levels.append(trust_in)
        error = -seen[k]
        good = max(1.0 - np.linalg.norm(error) / far, 0.0) if k >= late else 0.0
        beta = low + (high - low) / (1.0 + np.exp(10.0 * (trust_of[leader] - 0.5)))
        trust_of = good + np.exp(-0.1 * T) * (trust_of - good)
        lead = (np.arange(size) == leader)[:, None]
        force = min(push, 6.0 / max(np.linalg.norm(error), 1e-12)) * error

        def slope(q, zeta, x, v, k=k, leader=leader, beta=beta, lead=lead, force=force):
            r_m = v + weight * x
            f_m = beta * (b * r_m + np.sqrt(2.0 * b / high) * to_hand[k])
            apart = speed * (L @ q)
            f_s = apart[leader]
            r_s = (np.sqrt(2.0 * b) * to_robot[k] - f_s) / b
            moves = speed * (L @ zeta - L @ q + lead * r_s)
            pull = force - drag * r_m - f_m
            return (moves, -apart, v, (pull - B * v - K * x) / M), (r_m, f_m, r_s, f_s)

        middle = [p + 0.5 * T * d for p, d in zip(parts, slope(*parts)[0], strict=True)]
        change, (r_m, f_m, r_s, f_s) = slope(*middle)
        seen[k + late] = middle[0][leader]
        if not deaf[leader]:
            to_robot[k + late] = np.sqrt(low / (2.0 * b)) * (f_m / beta + b * r_m)
            to_hand[k + late] = (f_s - b * r_s) / np.sqrt(2.0 * b)
        parts = [p + T * d for p, d in zip(parts, change, strict=True)]
    return np.array(places), np.array(leaders), np.array(levels)


def test_the_whole_loop_against_an_own_integrator():
    """A deaf robot that leads at first, and a slow one; leaders equal, places within 1 mm."""
    robots = (DEAF, TeamRobot(speed=0.4), TeamRobot(), TeamRobot())
    start, goal = np.random.default_rng(5).uniform(-2.0, 2.0, (4, 3)), np.array([0.5, -1.0, 0.2])
    run = tl.simulate_team(
        CHAIN,
        goal=goal,
        duration=24.0,
        operator=TeamOperator(guarded=False),
        settings=TeamSettings(robots=robots, channel=TeamChannel(filters="none", read_out="hold")),
        trial=TeamTrial(4e-3, record_every=4e-3, start=start),
    )
    places, leaders, levels = own_loop(start, goal, robots, 24.0)
    np.testing.assert_array_equal(run.data["number"], leaders)
    assert set(leaders) == {0, 2}
    np.testing.assert_allclose(run.trust, levels, atol=1e-9)
    np.testing.assert_allclose(run.positions, places, atol=1e-3)


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
