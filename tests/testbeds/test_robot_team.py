"""
Chapter 4 in one loop: against a dense solver, Lemmas 6 and 7, V_T, Theorem 6, Remark 13, and guards
removed.
"""

import networkx as nx
import numpy as np
import pytest
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal

from tests.loops import simulate_team, team_loop
from trustlab.teleoperation import (
    DivergenceError,
    GivenSequence,
    RandomLeaders,
    Scattering,
    TeamOperator,
    TeamRobot,
    random_walk_delay,
    team_graph,
)
from trustlab.testbeds import robot_team

ALONE = TeamOperator(push=0.0, drag=0.0)
CHAIN = nx.path_graph(4)
FILTERS = ("none", "corrected", "waves")


def random_graph(rng, robots):
    """A connected graph, from trees to complete ones."""
    while True:
        graph = nx.gnp_random_graph(robots, rng.uniform(0.1, 1.0), seed=int(rng.integers(1 << 30)))
        if nx.is_connected(graph):
            return graph


def options(rng, seed):
    policies = "random", RandomLeaders(0.0), "sequence", "most_trusted", "hysteresis"
    return {
        "policy": policies[seed % 5],
        "goal": rng.uniform(-5.0, 5.0, 3),
        "seed": seed,
        "filters": FILTERS[seed % 3],
    }


def random_team(seed):
    """
    A random team: graph, delay to 1.5 s, per-robot b and bounds, policy, τ_min = 5 T, filter, start
    and goal.
    """
    rng = default_rng([7, seed])
    robots = int(rng.integers(2, 13))
    graph = random_graph(rng, robots)
    lows = rng.uniform(0.2, 1.0, robots)
    ends = tuple(
        Scattering(10 ** rng.uniform(-0.3, 0.6), beta_min=low, beta_max=low + rng.uniform(0.0, 1.0))
        for low in lows
    )
    delay = rng.uniform(0.05, 1.5)
    return options(rng, seed) | {
        "graph": graph,
        "scattering": ends,
        "delay": delay,
        "min_dwell": 5.0 * delay,
        "start": rng.uniform(-5.0, 5.0, (robots, 3)),
    }


def changing_team(seed):
    """
    A weighted graph of six robots that twice loses or gains links, loses a robot and gains a new
    one.
    """
    rng = default_rng([15, seed])

    def some(names):
        tree = nx.random_labeled_tree(len(names), seed=int(rng.integers(1 << 30)))
        graph = nx.relabel_nodes(tree, dict(enumerate(names)))
        for _ in range(3):
            graph.add_edge(*rng.choice([*names], 2, replace=False))
        for edge in graph.edges.values():
            edge["weight"] = rng.uniform(0.3, 3.0)
        return graph

    return options(rng, seed) | {
        "graph": {0.0: some("abcdef"), rng.uniform(5, 30): some("abcdef"), 40.0: some("abdfg")},
        "sample_time": 0.02,
        "coupling": rng.uniform(0.5, 3.0),
        "lead_gain": rng.uniform(0.5, 3.0),
        "force_gain": rng.uniform(0.3, 2.0),
    }


T, COUNT = 0.02, 400
DELAY, DWELL = 10, 75  # samples
MASS, DAMPING, STIFFNESS, WEIGHT = 0.5, 5.5, 20.0, 10.0
PUSH, REACH, DRAG, CUTOFF = 2.0, 3.0, 1.0, 10.0
PLAIN = nx.Graph([(0, 1), (1, 2), (2, 3), (1, 3)])
WEIGHTED = np.array([[0, 2.0, 0, 0], [2.0, 0, 0.3, 1], [0, 0.3, 0, 0.7], [0, 1, 0.7, 0]])
DIRECTED = np.array([[0, 2.0, 0, 0], [0, 0, 0.3, 1], [0.5, 0, 0, 0.7], [0, 1, 0, 0]])


def dense(adjacency, ends, robots, leads, kind, start, goal, gains):
    """
    The same equations, every sample one dense linear system in all midpoint unknowns; returns what
    the run logs, the robots' places, and the energy held by the filter. kind: the filter. gains: of
    coupling, lead and force.
    """
    coupling, lead_gain, force_gain = gains
    laplacian = coupling * (np.diag(adjacency.sum(axis=1)) - adjacency)
    size, h = len(start), 0.5 * T
    Z, Q = slice(0, size), slice(size, 2 * size)
    V, RM, FM, RH, FH, RS, FS, R, F = range(2 * size, 2 * size + 9)
    pole = h * CUTOFF
    speed = np.array([robot.speed for robot in robots])[:, None]
    k12, k21, through = 0.0, 0.0, 1.0
    if kind == "corrected":
        impedance = np.mean([end.b for end in ends])
        k12, k21, through = 0.5 / impedance, 0.5 * impedance, pole / (1.0 + pole)
    q, zeta, x, v = start - goal, np.zeros_like(start), np.zeros(3), np.zeros(3)
    filters, wave = np.zeros((4, 3)), np.zeros((2, 3))
    u_l, u_r, seen = np.zeros((3, COUNT, 3))
    far = np.linalg.norm(q, axis=1).max()
    trust = np.full(size, 0.5)
    rows, places, held = [], [], []
    for k, lead in enumerate(leads):
        error, good = np.zeros(3), 0.0
        if k >= DELAY:
            error = -seen[k - DELAY]
            good = max(1.0 - np.linalg.norm(error) / far, 0.0)
        force = min(PUSH, REACH / max(np.linalg.norm(error), 1e-9)) * error
        end, b = ends[lead], ends[lead].b
        share = 1.0 / (1.0 + np.exp(10.0 * (trust[lead] - 0.5)))
        beta = end.beta_min + (end.beta_max - end.beta_min) * share
        trust = trust + (1.0 - np.exp(-0.1 * T)) * (good - trust)
        arrived = np.zeros((2, 3)) if k < DELAY else np.array([u_l[k - DELAY], u_r[k - DELAY]])
        if kind == "waves":
            middle = (wave + pole * arrived) / (1.0 + pole)
            wave, arrived = 2.0 * middle - wave, middle
        v_r, v_l = arrived
        stored = k21 * filters[[0, 2]] ** 2 + k12 * filters[[1, 3]] ** 2
        held.append(stored.sum() / CUTOFF)
        places.append(q + goal)

        A, y = np.eye(2 * size + 9), np.zeros((2 * size + 9, 3))
        A[Z, Q] = h * speed * laplacian
        A[Q, Q] += h * speed * laplacian
        A[Q, Z] = -h * speed * laplacian.T
        A[size + lead, R] = -h * lead_gain * speed[lead, 0]
        # M (v_mid − v)/h = push − d r_m − f_m − B v_mid − K x_mid
        A[V, [V, RM, FM]] = MASS / h + DAMPING + STIFFNESS * h, DRAG, 1.0
        A[RM, V] = -(1.0 + WEIGHT * h)
        A[FM, [RM, FH]] = -k21, -through
        A[RH, [RM, FH]] = -through, k12
        A[FH, RH] = -beta * b
        A[RS, [RS, FS]] = b, 1.0
        A[R, [RS, F]] = -through, k12
        A[FS, [RS, F]] = -k21, -through
        A[F, Q] = -force_gain * speed[lead] * laplacian[lead]
        y[Z], y[Q], y[RM] = zeta, q, WEIGHT * x
        y[V] = MASS * v / h + force - STIFFNESS * x
        y[[RH, FM, R, FS]] = filters / (1.0 + pole)
        y[FH] = beta * np.sqrt(2.0 * b / end.beta_max) * v_l
        y[RS] = np.sqrt(2.0 * b) * v_r
        s = np.linalg.solve(A, y)

        pushed = force - DRAG * s[RM]
        rows.append([s[Q][lead] + goal, x, s[RM], pushed, s[FM], s[R], s[F]])
        seen[k] = s[Q][lead]
        if robots[lead].loss < 1.0:
            u_l[k] = np.sqrt(end.beta_min / (2.0 * b)) * (s[FH] / beta + b * s[RH])
            u_r[k] = (s[FS] - b * s[RS]) / np.sqrt(2.0 * b)
        zeta, q = 2.0 * s[Z] - zeta, 2.0 * s[Q] - q
        x, v = x + T * s[V], 2.0 * s[V] - v
        if kind == "corrected":
            middle = (filters + pole * s[[RM, FH, RS, F]]) / (1.0 + pole)
            filters = 2.0 * middle - filters
    return np.reshape(rows, (COUNT, 21)), np.array(places), np.array(held)


def most_trusted(robots):
    """
    Whom a team trusts most in every sample, and how much it trusts each, by plain loops: of a robot
    that can be led it sees 2 s/(1 + s).
    """
    trust, leader, since = np.full(len(robots), 0.5), 0, 0
    leads, levels = [], []
    for k in range(COUNT):
        if k and k % round(0.1 / T) == 0:
            for i, robot in enumerate(robots):
                heard = i != leader or robot.loss < 1.0
                rated = round(2.0 * robot.speed / (1.0 + robot.speed), 3) * heard
                trust[i] += (1.0 - np.exp(-0.1 * 0.1)) * (rated - trust[i])
            best = int(np.argmax(trust))
            if trust[best] > trust[leader] and k - since >= DWELL:
                leader, since = best, k
        leads.append(leader)
        levels.append(trust.copy())
    return leads, levels


ALIKE = (TeamRobot(),) * 4
FAULTY = (TeamRobot(loss=1.0), TeamRobot(speed=0.4), TeamRobot(speed=0.8), TeamRobot())


@pytest.mark.parametrize(
    ("kind", "graph", "robots", "gains"),
    [
        ("corrected", PLAIN, ALIKE, (1.0, 1.0, 1.0)),
        ("waves", DIRECTED, ALIKE, (1.0, 1.0, 1.0)),
        ("corrected", WEIGHTED, ALIKE, (3.0, 4.0, 0.2)),
        ("none", DIRECTED, ALIKE, (0.5, 0.3, 2.0)),
        ("none", WEIGHTED, FAULTY, (1.0, 1.0, 1.0)),
    ],
)
def test_kernel_against_a_dense_solver(kind, graph, robots, gains):
    """Oracle: all unknowns of a step in one linear system, no eigenbasis and no closed form."""
    start, goal = default_rng(8).normal(size=(4, 3)), np.array([1.0, -2.0, 0.5])
    bounds = ((1, 0.3), (2, 0.5), (0.5, 1), (3, 0.2))
    ends = tuple(Scattering(b, beta_min=low, beta_max=low + 0.7) for b, low in bounds)
    given = GivenSequence([2, 0, 3], times=[0.0, 2.0, 5.0])
    cautious = PUSH * (1.0 + 2.0 * DELAY * T)  # which over this delay comes to PUSH
    run = simulate_team(
        graph,
        given if robots == ALIKE else "most_trusted",
        goal,
        duration=COUNT * T,
        sample_time=T,
        scattering=ends,
        robots=robots,
        **dict(zip(("coupling", "lead_gain", "force_gain"), gains, strict=True)),
        operator=TeamOperator(cautious, REACH, guarded=False),
        delay=DELAY * T,
        min_dwell=DWELL * T,
        filters=kind,
        start=start,
        record_every=T,
        performance="motion",
    )
    leads = run.data["number"].to_numpy().astype(int)
    if robots == FAULTY:
        expected, levels = most_trusted(robots)
        assert set(expected) == {0, 3}
        assert_array_equal(leads, expected)
        assert_allclose(run.trust, levels, atol=1e-9)
    else:
        assert len(run.switches) == 2
    adjacency = team_graph(graph)[1]
    expected, places, held = dense(adjacency, ends, robots, leads, kind, start, goal, gains)
    logged = run.data[run.data.columns[:21]].to_numpy()
    assert_allclose(logged, expected, rtol=1e-8, atol=1e-9 * np.abs(expected).max())
    assert_allclose(run.positions, places, rtol=1e-8, atol=1e-9)
    assert_allclose(run.data["v_filter"], held, rtol=1e-8, atol=1e-9)


def energy_case(seed):
    """
    A random team whose inner states do not start at zero; every fourth has delays that vary, every
    fifth slow robots; from the fifteenth on a team that changes.
    """
    if seed >= 15:
        return team_loop(**changing_team(seed), duration=60.0)
    arguments, rng = random_team(seed), default_rng(seed)
    if seed % 4 == 3:
        arguments |= {"delay": random_walk_delay(0.1, 1.0, 0.5, seed=seed), "min_dwell": 1.5}
    if seed % 5 == 4:
        speeds = rng.uniform(0.2, 1.0, len(arguments["graph"]))
        slow = tuple(TeamRobot(speed=speed) for speed in speeds)
        arguments |= {"coupling": 2.0, "lead_gain": 3.0, "robots": slow}
    loop = team_loop(**arguments, duration=60.0)
    loop.simulation.state.zeta[:] = rng.normal(size=arguments["start"].shape)
    return loop


@pytest.mark.parametrize("seed", range(21))
def test_energies_balance_at_every_sample_and_v_t_never_rises(seed):
    """
    V(k + 1) − V(k) = supply − dissipation, (4.25) and (4.33), relative to the storage; V_T by
    (4.32)-(4.35), whatever the leader, to rounding; (4.15) beside it. What a change of links adds
    to V_fs is booked.
    """
    data = energy_case(seed).run().data
    links = data["supply_links"]
    parts = ("v_fs", "team", links), ("v_e", "error", 0.0), ("v_hd", "device", 0.0)
    for storage, part, booked in parts:
        lost = data[f"lost_{part}"]
        balance = data[storage] - data[f"supply_{part}"] + lost - booked
        most = max(data[storage].max(), lost.max())
        assert np.ptp(balance) <= 1e-11 * most
        assert np.abs(np.diff(balance)).max() <= 1e-12 * most
        assert (np.diff(lost) >= 0.0).all()
    assert np.diff(data["v_t"] - links).max() <= 1e-12 * data["v_t"].max()
    assert data["v_ch"].min() >= -1e-12 * data["v_ch"].max()
    assert (data[["v_hd", "v_fs", "v_e", "v_filter"]].to_numpy() >= 0.0).all()
    assert links.any() == (seed >= 15)
    # Negative control: links that appear.
    assert links.max() <= 0.0 or np.diff(data["v_t"]).max() > 1e-6


@pytest.mark.parametrize("teams", [8, pytest.param(200, marks=pytest.mark.long)])
def test_theorem_6_in_random_teams(teams):
    """
    Every robot within 1 mm of the goal after 1000 s, no case left out; and (4.30) held in each.
    """
    for seed in range(teams):
        slow = {"duration": 1000.0, "sample_time": 0.02, "record_every": 0.1}
        run = simulate_team(**random_team(seed), **slow)
        assert run.operator_passive, seed
        assert run.converged, (seed, run.distances[-1].max())


@pytest.mark.parametrize("seed", range(4))
def test_robots_that_come_and_go_arrive(seed):
    run = simulate_team(**changing_team(seed), duration=600.0, record_every=0.1)
    assert run.robots == tuple("abcdefg")
    assert run.converged, run.farthest[-1]
    here = np.isfinite(run.positions[:, :, 0])
    late = run.t[:, None] >= 40.0
    assert_array_equal(here, np.where(late, [1, 1, 0, 1, 0, 1, 1], [1, 1, 1, 1, 1, 1, 0]))
    leaders = run.data["number"].to_numpy().astype(int)
    assert here[np.arange(len(leaders)), leaders].all()


@pytest.mark.parametrize("filters", ["corrected", "waves"])
def test_free_team_meets_at_a_point_of_its_own(filters):
    """
    Remark 13. Closed form for one leader, no scaling and ζ = 0: the mean of the start, whatever the
    goal.

    ∫ f_s dτ = ζ_i(0) − mean ζ(0) = 0, and ∫ r_s dτ is a multiple of it; Σ q grows by ∫ r_s dτ.
    """
    rng = default_rng(9)
    graph = random_graph(rng, 7)
    start = rng.uniform(-5.0, 5.0, (7, 3))
    run = simulate_team(
        graph,
        GivenSequence([0]),
        (9, -9, 3),
        operator=ALONE,
        sample_time=0.02,
        duration=400.0,
        start=start,
        delay=0.4,
        scattering=Scattering(2.0),
        filters=filters,
    )
    assert run.synchronised
    assert not run.converged
    assert_allclose(run.positions[-1] - start.mean(axis=0), 0.0, atol=1e-8)


# Guards removed


def test_printed_filter_makes_the_free_team_diverge():
    """
    Proposition 3 inside the loop: with nobody at the device, at 10 rad/s and half a second of
    delay.
    """
    shared = {"operator": ALONE, "delay": 0.5, "duration": 200.0}
    with pytest.raises(DivergenceError, match="passive"):
        simulate_team(CHAIN, filters="printed", **shared)
    for filters in FILTERS:
        assert simulate_team(CHAIN, filters=filters, **shared).synchronised


def test_scattering_not_switched_with_the_leader():
    """
    The operator's end keeps the first leader's bounds: the channel pays for what the operator does
    not.
    """
    bounds = [(10.0, 20.0)] + [(0.2, 0.4)] * 3
    ends = tuple(Scattering(2.0, beta_min=low, beta_max=high) for low, high in bounds)
    right, wrong = (
        simulate_team(
            CHAIN,
            GivenSequence(range(4), times=[0, 10, 200, 400]),
            scattering=ends,
            delay=0.5,
            start=np.tile([-10.0, 0.0, 0.0], (4, 1)),
            duration=600.0,
            filters="waves",
            operator=TeamOperator(guarded=False),
            switch_scattering=switched,
        )
        for switched in (True, False)
    )
    assert right.converged
    assert right.data["v_ch"].min() >= 0.0
    assert not wrong.converged
    assert wrong.data["v_ch"].iloc[-1] < -1000.0
    assert not wrong.operator_passive


def test_active_operator():
    """A hand that pushes hard on old pictures gives energy for ever; its budget stops it."""
    active, passive = (
        simulate_team(
            CHAIN,
            operator=TeamOperator(guarded=guarded, push=40.0, reach=50.0, cautious=0.0),
            seed=1,
            delay=1.0,
            duration=200.0,
        )
        for guarded in (False, True)
    )
    assert not active.operator_passive
    assert not active.converged
    assert active.data["v_h"].iloc[-1] < -100.0 * active.budget
    assert passive.operator_passive
    assert passive.data["push"].min() < 1.0
    assert passive.distances[-1].max() < 0.01 < active.distances[-1].max()


def test_robots_are_numbered_as_they_count_however_edges_are_listed():
    """The slow robot was another one for each order of the same edges."""
    robots = (TeamRobot(speed=0.01), TeamRobot(), TeamRobot())
    graphs = [nx.path_graph([1, 0, 2]), nx.Graph([(2, 0), (0, 1)]), nx.Graph([(0, 2), (0, 1)])]
    runs = [simulate_team(graph, robots=robots, duration=2.0) for graph in graphs]
    for run in runs:
        assert run.robots == (0, 1, 2)
        assert_array_equal(run.positions, runs[0].positions)


def test_where_drawn_trust_starts_does_not_follow_the_first_performance():
    performance, start = robot_team._drawn(3, 400, 0.1, default_rng(0))
    assert abs(np.corrcoef(performance[0], start)[0, 1]) < 0.2
