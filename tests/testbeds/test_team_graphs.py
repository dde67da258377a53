"""
Teams past Chapter 4: weights, directed graphs, links and robots that come and go, live policies,
and large teams.
"""

import networkx as nx
import numpy as np
import pytest
from PIL import Image

from tests.teams import simulate_team
from trustlab.teleoperation import (
    GivenSequence,
    TeamSettings,
)


def changing_team(seed):
    """
    A weighted graph of six robots that twice loses or gains links, loses a robot and gains a new
    one.
    """
    rng = np.random.default_rng([15, seed])

    def some(names):
        graph = nx.relabel_nodes(
            nx.random_labeled_tree(len(names), seed=int(rng.integers(1 << 30))),
            dict(enumerate(names)),
        )
        for _ in range(3):
            graph.add_edge(*(names[i] for i in rng.choice(len(names), 2, replace=False)))
        for one, other in graph.edges:
            graph[one][other]["weight"] = rng.uniform(0.3, 3.0)
        return graph

    graphs = {0.0: some(list("abcdef"))}
    graphs |= {rng.uniform(5, 30): some(list("abcdef")), 40.0: some(list("abdfg"))}
    return graphs, {
        "policy": ("random", "most_trusted", "hysteresis")[seed % 3],
        "goal": rng.uniform(-5.0, 5.0, 3),
        "seed": seed,
        "sample_time": 0.02,
        "settings": TeamSettings(
            coupling=rng.uniform(0.5, 3.0),
            lead_gain=rng.uniform(0.5, 3.0),
            force_gain=rng.uniform(0.3, 2.0),
        ),
        "filters": ("none", "corrected", "waves")[seed % 3],
    }


@pytest.mark.parametrize("seed", range(6))
def test_energy_balances_through_changes(seed):
    """
    Lemmas 6 and 7 hold between changes, V_e through them; what V_fs jumps by is booked, and V_T
    without it never rises.
    """
    graph, arguments = changing_team(seed)
    data = simulate_team(graph, **arguments, duration=60.0, record_every=0.02).data
    team = data["v_fs"] - data["supply_team"] + data["lost_team"] - data["supply_links"]
    error = data["v_e"] - data["supply_error"] + data["lost_error"]
    assert np.ptp(team) <= 1e-11 * max(data["v_fs"].max(), data["lost_team"].max())
    assert np.ptp(error) <= 1e-11 * max(data["v_e"].max(), data["lost_error"].max())
    assert np.diff(data["v_t"] - data["supply_links"]).max() <= 1e-11 * data["v_t"].max()
    assert data["supply_links"].any()  # else the bookkeeping would not be tried
    # negative control: links that appear
    assert np.diff(data["v_t"]).max() > 1e-6 or data["supply_links"].max() <= 0.0


@pytest.mark.parametrize("seed", range(4))
def test_robots_that_come_and_go_arrive(seed, tmp_path):
    graph, arguments = changing_team(seed)
    run = simulate_team(graph, **arguments, duration=600.0, record_every=0.1)
    assert run.robots == tuple("abcdefg")
    assert run.converged, run.farthest[-1]
    here = np.isfinite(run.positions[:, :, 0])
    late = run.t >= 40.0
    np.testing.assert_array_equal(here[~late], np.tile([1, 1, 1, 1, 1, 1, 0], (np.sum(~late), 1)))
    np.testing.assert_array_equal(here[late], np.tile([1, 1, 0, 1, 0, 1, 1], (np.sum(late), 1)))
    leaders = run.data["number"].to_numpy().astype(int)
    assert here[np.arange(len(leaders)), leaders].all()
    assert len(run.graphs) == 3
    with Image.open(run.animate(tmp_path / "team.gif", rate=50.0)) as film:
        assert film.n_frames > 20


class TestDirected:
    CHAIN = nx.DiGraph([(1, 0), (2, 1), (3, 2), (3, 0)])  # robot 0 sees nobody and is seen by all

    def test_a_spanning_tree_is_enough(self):
        run = simulate_team(
            self.CHAIN, GivenSequence([0], times=[0.0]), duration=300.0, sample_time=0.01, seed=1
        )
        assert run.converged
        assert run.data[["v_fs", "v_t"]].isna().all(axis=None)
        error = (
            run.data["v_e"] - run.data["supply_error"] + run.data["lost_error"]
        )  # an identity on any graph
        assert np.ptp(error) <= 1e-11 * run.data["v_e"].max()


class TestLargeTeams:
    @pytest.mark.parametrize(
        "graph", [nx.cycle_graph(50), nx.complete_graph(20), nx.star_graph(30)]
    )
    def test_scaled_gains_keep_the_guarantees(self, graph):
        run = simulate_team(
            graph,
            "random",
            settings=TeamSettings.scaled(graph),
            duration=200.0,
            sample_time=0.01,
            record_every=0.01,
            seed=5,
        )
        assert run.converged
        assert run.operator_passive
        assert np.diff(run.data["v_t"]).max() <= 1e-11 * run.data["v_t"].max()
