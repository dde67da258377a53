"""
Chapter 4 in one loop: against a dense solver, Lemmas 6 and 7, V_T, Theorem 6, Remark 13, and guards
removed.
"""

import matplotlib
import networkx as nx
import numpy as np
import pytest

import trustlab as tl
from tests.teams import simulate_team
from trustlab.teleoperation import (
    DivergenceError,
    GivenSequence,
    GraphError,
    RandomLeaders,
    Scattering,
    TeamOperator,
    TeamRobot,
    TeamSettings,
    WaveFilter,
    corrected_filter,
    random_walk_delay,
    team_graph,
)

matplotlib.use("Agg")

ALONE = TeamOperator(push=0.0, drag=0.0)
NO_SCALING = TeamSettings(scattering=Scattering(2.0))


def random_graph(rng, robots):
    """A connected graph, from trees to complete ones."""
    while True:
        graph = nx.gnp_random_graph(robots, rng.uniform(0.1, 1.0), seed=int(rng.integers(1 << 30)))
        if nx.is_connected(graph):
            return graph


def random_team(seed):
    """
    A random team: graph, delay to 1.5 s, per-robot b and bounds, policy, τ_min = 5 T, filter, start
    and goal.
    """
    rng = np.random.default_rng([7, seed])
    robots = int(rng.integers(2, 13))
    graph = random_graph(rng, robots)
    lows = rng.uniform(0.2, 1.0, robots)
    ends = tuple(
        Scattering(10 ** rng.uniform(-0.3, 0.6), beta_min=low, beta_max=low + rng.uniform(0.0, 1.0))
        for low in lows
    )
    delay = rng.uniform(0.05, 1.5)
    return graph, {
        "policy": ("random", RandomLeaders(0.0), "sequence", "most_trusted", "hysteresis")[
            seed % 5
        ],
        "goal": rng.uniform(-5.0, 5.0, 3),
        "seed": seed,
        "duration": 1000.0,
        "sample_time": 0.02,
        "settings": TeamSettings(scattering=ends),
        "delay": delay,
        "min_dwell": 5.0 * delay,
        "filters": ("none", "corrected", "waves")[seed % 3],
        "start": rng.uniform(-5.0, 5.0, (robots, 3)),
        "record_every": 0.1,
    }


def dense(graph, run, ends, n, leads, delay, vision, kind, start, goal, count, trust0=0.5):
    """
    The same equations, every sample one dense linear system per axis in all midpoint unknowns;
    returns what the run logs.

    n: dict of device, operator and filter numbers. kind: "none", "two-port" or "waves".
    """
    names, adjacency = team_graph(graph)
    size, T = len(names), n["T"]
    L = n.get("coupling", 1.0) * (np.diag(adjacency.sum(1)) - adjacency)
    q = start - goal
    zeta = np.zeros((size, 3))
    x = np.zeros(3)
    v = np.zeros(3)
    fil = np.zeros((4, 3))
    wave = np.zeros((2, 3))
    held = []
    u_l, u_r, sent, seen = (np.zeros((count, 3)) for _ in range(4))
    far = np.linalg.norm(q, axis=1).max()
    trust = np.full(size, trust0)
    rows = []
    w = n["cutoff"]
    Z, Q, V, RM, FM, RH, FH, RS, FS, R, F = (
        slice(0, size),
        slice(size, 2 * size),
        *(2 * size + i for i in range(9)),
    )
    for k in range(count):
        lead, late = leads[k], k - vision
        error = -seen[late] if late >= 0 else np.zeros(3)
        good = max(1.0 - np.linalg.norm(error) / far, 0.0) if late >= 0 else 0.0
        end = ends[lead]
        beta = end.beta_min + (end.beta_max - end.beta_min) * (
            1.0 - 1.0 / (1.0 + np.exp(-10.0 * (trust[lead] - 0.5)))
        )
        trust = trust + (1.0 - n["keep"]) * (good - trust)
        v_r = u_l[k - delay] if k >= delay else np.zeros(3)
        v_l = u_r[k - delay] if k >= delay else np.zeros(3)
        if kind == "waves":
            middle = (wave + 0.5 * T * w * np.array([v_r, v_l])) / (1.0 + 0.5 * T * w)
            wave, (v_r, v_l) = 2.0 * middle - wave, middle
        row = np.zeros((7, 3))
        held.append((n["k21"] * (fil[[0, 2]] ** 2).sum() + n["k12"] * (fil[[1, 3]] ** 2).sum()) / w)
        for i in range(3):
            A, y = np.zeros((2 * size + 9, 2 * size + 9)), np.zeros(2 * size + 9)
            h = 0.5 * T
            b = end.b
            port = kind == "two-port"
            A[Z, Z] = np.eye(size)
            A[Z, Q] = h * L
            y[Z] = zeta[:, i]
            A[Q, Q] = np.eye(size) + h * L
            A[Q, Z] = -h * L.T
            y[Q] = q[:, i]
            A[size + lead, R] = -h * n.get("lead", 1.0)
            push, drag = (
                n["push"] * error[i],
                n["drag"],
            )  # M (v_mid − v)/h = push − d r_m − f_m − B v_mid − K x_mid
            A[V, V] = n["M"] / h + n["B"] + n["K"] * h
            A[V, RM] = drag
            A[V, FM] = 1.0
            y[V] = n["M"] * v[i] / h + push - n["K"] * x[i]
            A[RM, RM] = 1.0
            A[RM, V] = -(1.0 + n["Lam"] * h)
            y[RM] = n["Lam"] * x[i]
            k12, k21 = (n["k12"], n["k21"]) if port else (0.0, 0.0)
            p1, p2, p3, p4 = fil[:, i] / (1 + h * w) if port else np.zeros(4)
            g = h * w / (1 + h * w) if port else 1.0
            A[FM, FM] = 1.0
            A[FM, RM] = -k21
            A[FM, FH] = -g
            y[FM] = p2
            A[RH, RH] = 1.0
            A[RH, RM] = -g
            A[RH, FH] = k12
            y[RH] = p1
            A[FH, FH] = 1.0
            A[FH, RH] = -beta * b
            y[FH] = beta * np.sqrt(2 * b / end.beta_max) * v_l[i]
            A[RS, RS] = b
            A[RS, FS] = 1.0
            y[RS] = np.sqrt(2 * b) * v_r[i]
            A[R, R] = 1.0
            A[R, RS] = -g
            A[R, F] = k12
            y[R] = p3
            A[FS, FS] = 1.0
            A[FS, RS] = -k21
            A[FS, F] = -g
            y[FS] = p4
            A[F, F] = 1.0
            A[F, Q] = -n.get("felt", 1.0) * L[lead]
            y[F] = 0.0
            s = np.linalg.solve(A, y)
            zeta[:, i], q[:, i] = 2 * s[Z] - zeta[:, i], 2 * s[Q] - q[:, i]
            row[:, i] = s[Q][lead] + goal[i], x[i], s[RM], push - drag * s[RM], s[FM], s[R], s[F]
            u_l[k, i] = np.sqrt(end.beta_min / (2 * b)) * (s[FH] / beta + b * s[RH])
            u_r[k, i] = (s[FS] - b * s[RS]) / np.sqrt(2 * b)
            x[i], v[i] = x[i] + T * s[V], 2 * s[V] - v[i]
            inputs = np.array([s[RM], s[FH], s[RS], s[F]])
            fil[:, i] = fil[:, i] + T * w * (inputs - (fil[:, i] + h * w * inputs) / (1 + h * w))
            sent[k, i], seen[k, i] = s[R], s[Q][lead]
        rows.append(row.ravel())
    return np.array(rows), q + goal, np.array(held)


PLAIN = nx.Graph([(0, 1), (1, 2), (2, 3), (1, 3)])
WEIGHTED = np.array([[0, 2.0, 0, 0], [2.0, 0, 0.3, 1], [0, 0.3, 0, 0.7], [0, 1, 0.7, 0]])
DIRECTED = np.array([[0, 2.0, 0, 0], [0, 0, 0.3, 1], [0.5, 0, 0, 0.7], [0, 1, 0, 0]])


@pytest.mark.parametrize(
    ("kind", "graph", "scales"),
    [
        ("none", PLAIN, {}),
        ("two-port", PLAIN, {}),
        ("waves", PLAIN, {}),
        ("two-port", WEIGHTED, {}),
        ("waves", DIRECTED, {}),
        ("two-port", WEIGHTED, {"coupling": 3.0, "lead": 4.0, "felt": 0.2}),
        ("none", DIRECTED, {"coupling": 0.5, "lead": 0.3, "felt": 2.0}),
    ],
)
def test_kernel_against_a_dense_solver(kind, graph, scales):
    """Oracle: all unknowns of a step in one linear system, no eigenbasis and no closed form."""
    T, count = 0.02, 400
    rng = np.random.default_rng(8)
    start, goal = rng.normal(size=(4, 3)), np.array([1.0, -2.0, 0.5])
    ends = tuple(
        Scattering(b, beta_min=low, beta_max=low + 0.7)
        for b, low in ((1, 0.3), (2, 0.5), (0.5, 1), (3, 0.2))
    )
    filters = {"none": "none", "two-port": corrected_filter(8.0, 1.5), "waves": WaveFilter(8.0)}[
        kind
    ]
    run = simulate_team(
        graph,
        GivenSequence([2, 0, 3], times=[0.0, 2.0, 5.0]),
        goal,
        duration=count * T,
        sample_time=T,
        settings=TeamSettings(
            scattering=ends,
            coupling=scales.get("coupling", 1.0),
            lead_gain=scales.get("lead", 1.0),
            force_gain=scales.get("felt", 1.0),
        ),
        operator=TeamOperator(reach=1e9, guarded=False, slow_down=False, push=2.0),
        delay=0.2,
        vision_delay=0.3,
        min_dwell=1.5,
        filters=filters,
        start=start,
        record_every=T,
    )
    n = scales | {
        "T": T,
        "M": 0.5,
        "B": 5.5,
        "K": 20.0,
        "Lam": 10.0,
        "push": 2.0,
        "drag": 1.0,
        "cutoff": 8.0,
    }
    n |= {"k12": 0.5 / 1.5, "k21": 0.5 * 1.5, "keep": np.exp(-0.1 * T)}
    leads = run.data["number"].to_numpy().astype(int)
    assert len(run.switches) == 2
    wanted, _, held = dense(graph, run, ends, n, leads, 10, 15, kind, start, goal, count)
    found = run.data[run.data.columns[:21]].to_numpy()
    assert len(wanted) == len(found) == count
    np.testing.assert_allclose(found, wanted, rtol=1e-8, atol=1e-9 * np.abs(wanted).max())
    np.testing.assert_allclose(
        run.data["v_filter"], held if kind == "two-port" else 0.0, rtol=1e-8, atol=1e-9
    )


def energies(seed, **change):
    graph, arguments = random_team(seed)
    arguments |= {"duration": 60.0, "sample_time": 0.01, "record_every": 0.01} | change
    return simulate_team(graph, **arguments)


@pytest.mark.parametrize("seed", range(12))
def test_lemmas_6_and_7_balance_at_every_sample(seed):
    """V(k + 1) − V(k) = supply − dissipation, (4.25) and (4.33), relative to the storage."""
    data = energies(
        seed, inner=np.random.default_rng(seed).normal(size=energies(seed).positions.shape[1:])
    ).data
    for storage, supply, lost in (
        ("v_fs", "supply_team", "lost_team"),
        ("v_e", "supply_error", "lost_error"),
    ):
        balance = data[storage] - data[supply] + data[lost]
        assert np.ptp(balance) <= 1e-12 * len(data) ** 0.5 * data[storage].max()
        step = np.abs(np.diff(balance)).max()
        assert step <= 1e-12 * data[storage].max()
        assert (np.diff(data[lost]) >= 0.0).all()
    device = data["v_hd"] - data["supply_device"] + data["lost_device"]
    assert np.ptp(device) <= 1e-11 * max(data["v_hd"].max(), data["supply_device"].abs().max())


@pytest.mark.parametrize("seed", range(15))
def test_v_t_never_rises(seed):
    """
    (4.32)-(4.35) with corrected filters, at every sample and to rounding, whatever the leader;
    (4.15) beside it.
    """
    data = energies(seed).data
    assert np.diff(data["v_t"]).max() <= 1e-12 * data["v_t"].max()
    assert data["v_ch"].min() >= -1e-12 * data["v_ch"].max()
    assert (data[["v_hd", "v_fs", "v_e", "v_filter"]].to_numpy() >= 0.0).all()


def test_v_t_never_rises_with_delays_that_vary():
    for seed in range(5):
        walk = random_walk_delay(0.1, 1.0, 0.5, seed=seed)
        data = energies(seed, delay=walk, vision_delay=0.7, min_dwell=1.5).data
        assert np.diff(data["v_t"]).max() <= 1e-12 * data["v_t"].max()
        assert data["v_ch"].min() >= -1e-12 * data["v_ch"].max()


@pytest.mark.parametrize("teams", [50, pytest.param(200, marks=pytest.mark.long)])
def test_theorem_6_in_random_teams(teams):
    """
    Every robot within 1 mm of the goal after 1000 s, no case left out; and (4.30) held in each.
    """
    for seed in range(teams):
        graph, arguments = random_team(seed)
        run = simulate_team(graph, **arguments)
        assert run.operator_passive, seed
        assert run.converged, (seed, run.distances[-1].max())


def test_free_team_meets_at_a_point_of_its_own():
    """
    Remark 13. Closed form for one leader, no scaling and ζ = 0: the mean of the start, whatever the
    goal.

    ∫ f_s dτ = ζ_i(0) − mean ζ(0) = 0, and ∫ r_s dτ is a multiple of it; Σ q grows by ∫ r_s dτ.
    """
    for seed in range(4):
        rng = np.random.default_rng([9, seed])
        graph = random_graph(rng, int(rng.integers(2, 9)))
        start = rng.uniform(-5.0, 5.0, (len(graph), 3))
        shared = {
            "policy": GivenSequence([0]),
            "operator": ALONE,
            "sample_time": 0.02,
            "duration": 400.0,
            "start": start,
            "delay": 0.4,
            "settings": NO_SCALING,
        }
        for filters in ("corrected", "waves"):
            run, other = (
                simulate_team(graph, goal=goal, filters=filters, **shared)
                for goal in ((1, 2, 0.5), (9, -9, 3))
            )
            assert run.synchronised
            assert not run.converged
            np.testing.assert_allclose(
                run.positions[-1], np.tile(start.mean(axis=0), (len(graph), 1)), atol=1e-8
            )
            np.testing.assert_allclose(run.positions[-1], other.positions[-1], atol=1e-8)


def test_v_h_falls_although_the_hand_does_nothing():
    """
    (4.30) is no property of the hand alone: the team drags its leader from the goal while f_h = 0.
    """
    graph, goal = nx.path_graph(3), np.array([1.0, 2.0, 0.5])
    start = np.vstack([goal, goal + 4.0, goal + 4.0])
    run = simulate_team(
        graph,
        GivenSequence([0]),
        goal,
        start=start,
        operator=ALONE,
        duration=20.0,
        sample_time=0.01,
    )
    assert run.data["supply_hand"].abs().max() == 0.0
    assert run.data["v_h"].min() < -1.0


class TestGuardsRemoved:
    def test_printed_filter_makes_the_free_team_diverge(self):
        """
        Proposition 3 inside the loop: with nobody at the device, at 10 rad/s and half a second of
        delay.
        """
        shared = {"operator": ALONE, "delay": 0.5, "sample_time": 0.01, "duration": 200.0}
        with pytest.raises(DivergenceError, match="passive"):
            simulate_team(nx.path_graph(4), filters="printed", **shared)
        for filters in ("corrected", "waves", "none"):
            assert simulate_team(nx.path_graph(4), filters=filters, **shared).synchronised

    def test_scattering_not_switched_with_the_leader(self):
        """
        The operator's end keeps the first leader's bounds: the channel pays for what the operator
        does not.
        """
        ends = (Scattering(2.0, beta_min=10.0, beta_max=20.0),) + (
            Scattering(2.0, beta_min=0.2, beta_max=0.4),
        ) * 3
        shared = {
            "policy": GivenSequence(range(4), times=[0, 10, 200, 400]),
            "settings": TeamSettings(scattering=ends),
            "delay": 0.5,
            "start": np.tile([-10.0, 0.0, 0.0], (4, 1)),
            "sample_time": 0.01,
            "duration": 600.0,
            "filters": "waves",
            "operator": TeamOperator(guarded=False),
        }
        right, wrong = (
            simulate_team(nx.path_graph(4), switch_scattering=switched, **shared)
            for switched in (True, False)
        )
        assert right.converged
        assert right.data["v_ch"].min() >= 0.0
        assert not wrong.converged
        assert wrong.data["v_ch"].iloc[-1] < -1000.0
        assert not wrong.operator_passive

    def test_active_operator(self):
        """A hand that pushes hard on old pictures gives energy for ever; its budget stops it."""
        shared = {"delay": 1.0, "sample_time": 0.01, "duration": 200.0}
        eager = {"push": 40.0, "reach": 50.0, "slow_down": False}
        active = simulate_team(
            nx.path_graph(4), operator=TeamOperator(guarded=False, **eager), **shared
        )
        passive = simulate_team(nx.path_graph(4), operator=TeamOperator(**eager), **shared)
        assert not active.operator_passive
        assert not active.converged
        assert active.data["v_h"].iloc[-1] < -100.0 * active.budget
        assert passive.operator_passive
        assert passive.data["push"].min() < 1.0
        assert passive.distances[-1].max() < 0.01 < active.distances[-1].max()


def test_same_seed_same_run_and_trust_drives_the_leader():
    graph = nx.cycle_graph(5)
    one, two, three = (
        simulate_team(graph, seed=s, duration=60.0, sample_time=0.01) for s in (4, 4, 5)
    )
    assert one.data.equals(two.data)
    assert not one.data.equals(three.data)
    assert ((one.trust >= 0.0) & (one.trust <= 1.0)).all()
    for at in one.switches:
        k = int(np.searchsorted(one.t, at))
        assert one.data["number"].iloc[k] == one.trust[k].argmax()
    assert (np.diff(one.switches) >= 5.0 - 1e-9).all()
    assert len(one.switches) > 2


def test_a_run_is_a_session(tmp_path):
    run = simulate_team(nx.path_graph(3), duration=5.0)
    session = run.session()
    assert session.metadata.synthetic
    tl.write_session(session, tmp_path / "team.csv")
    again = tl.read_session(tmp_path / "team.csv")
    np.testing.assert_allclose(again["f_m_x"], run.data["f_m_x"])
    k = 100
    assert session["trust_hr"][k] == run.trust[k, int(run.data["number"].iloc[k])]


class TestBadInput:
    @pytest.mark.parametrize(
        ("graph", "words"),
        [
            (nx.Graph([("a", "b"), ("c", "d")]), "not connected.*{'a', 'b'}; {'c', 'd'}"),
            (nx.MultiGraph([(0, 1), (0, 1)]), "parallel"),
            (nx.Graph(), "two robots"),
            (None, "networkx"),
        ],
    )
    def test_graph(self, graph, words):
        with pytest.raises(GraphError, match=words):
            simulate_team(graph)

    @pytest.mark.parametrize(
        ("change", "words"),
        [
            ({"goal": (1.0, 2.0)}, "goal must have 3"),
            ({"policy": "sequense"}, "did you mean 'sequence'"),
            ({"delay_back": 1e9}, "longer than the run"),
            ({"push": np.zeros((5, 3))}, "push must have shape"),
            ({"read_out": "x"}, "read_out"),
            ({"duration": 1e5, "sample_time": 1e-3}, "duration must lie in"),
        ],
    )
    def test_arguments(self, change, words):
        with pytest.raises(ValueError, match=words):
            simulate_team(nx.path_graph(3), **({"duration": 10.0} | change))


def test_a_run_is_repeated_from_its_inputs_without_python():
    """Packets that get lost and robots that drift included; another leader makes another run."""
    robots = (TeamRobot(), TeamRobot(speed=0.4), TeamRobot(loss=0.5), TeamRobot(drift=0.05))
    arguments = {"seed": 3, "duration": 20.0, "settings": TeamSettings(robots=robots)}
    graphs = {0.0: nx.cycle_graph(4), 8.0: nx.path_graph(4)}
    first, again, other = (tl.TeamLoop(graphs, "random", **arguments) for _ in range(3))
    run = first.run()
    for loop in (again, other):
        loop.simulation.decide = None
        loop.simulation.inputs[:] = first.simulation.inputs
    other.simulation.inputs["lead"] = 0
    for loop in (again, other):
        loop.simulation.advance(len(loop.simulation.inputs))
    assert len(run.switches) > 0
    np.testing.assert_array_equal(again.simulation.log.table, first.simulation.log.table)
    np.testing.assert_array_equal(again.simulation.log.places, first.simulation.log.places)
    assert (other.simulation.log.places != first.simulation.log.places).any()
