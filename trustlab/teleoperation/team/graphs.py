"""
Who sees whom in a team of robots: graphs as adjacency matrices, how they change during a run, and
one step on them.
"""

from collections.abc import Iterable, Mapping
from numbers import Integral
from typing import NamedTuple

import numpy as np

from trustlab.models.checks import finite_number, flag


class GraphError(ValueError):
    """
    A graph that cannot describe a team: a self-loop, a negative weight, robots that nobody sees, or
    a single robot.
    """


class TeamGraph(NamedTuple):
    """
    The graph from a time on: `adjacency`, shape (N, N); which robots are in the team, and which of
    them may lead, shape (N,).

    Who leads must be seen by all who are present, directly or through others.
    """

    since: float
    adjacency: np.ndarray
    present: np.ndarray
    may_lead: np.ndarray


def team_graph(graph, require_connected: bool = True) -> tuple[tuple, np.ndarray]:
    """
    Return the robots' names and the adjacency matrix of Section 4.2: a_ij > 0 where robot i sees
    robot j.

    Section 4.2 has undirected graphs with a_ij of 0 or 1; weights and directed graphs go past it.

    Parameters
    ----------
    graph : networkx.Graph, networkx.DiGraph or array_like, shape (N, N)
        Without self-loops, edges from who sees to who is seen; a_ij is the edge's `weight`, 1 where
        there is none. Connected, or, if directed, with a spanning tree: a robot whom all others
        see, directly or through others. Robots of a matrix are named 0 … N − 1.
    require_connected : bool
        Refuse a graph in several parts, or without a spanning tree.

    Raises
    ------
    GraphError
        If the graph is none of that; parts, loops and edges are named.
    """
    require_connected = flag("require_connected", require_connected)
    names, matrix = _matrix(graph)
    if hasattr(graph, "edges") and len(set(graph.edges())) < graph.number_of_edges():
        raise GraphError("the graph has parallel edges; pass networkx.Graph(graph)")
    if len(names) < 2:
        raise GraphError(f"a team needs two robots or more, got {len(names)}")
    wrong = ~(np.isfinite(matrix) & (matrix >= 0.0)) | np.diag(matrix.diagonal() != 0.0)
    for i, j in np.argwhere(wrong):
        raise GraphError(
            "a_ij must be finite, 0 or more, and 0 from a robot to itself; from "
            f"{names[i]!r} to {names[j]!r} it is {matrix[i, j]}"
        )
    if require_connected and not _linked(matrix).all(axis=0).any():
        parts = np.unique(_linked(matrix + matrix.T), axis=0)[::-1]
        groups = "; ".join(str([names[i] for i in np.flatnonzero(part)]) for part in parts)
        cause = f"its parts are {groups}" if len(parts) > 1 else "it has no spanning tree"
        raise GraphError(
            "the graph has no robot whom all others see, directly or through others, so nobody "
            f"can lead them all: {cause}; add edges, or pass require_connected=False (in a "
            "TeamTrial to simulate_team) to see it"
        )
    return names, matrix


def _matrix(graph) -> tuple[tuple, np.ndarray]:
    """Return names and adjacency as a user gives them."""
    try:
        if hasattr(graph, "nodes"):
            import networkx

            names = _in_order(graph.nodes)
            return names, networkx.to_numpy_array(graph, names)
        matrix = np.asarray(graph)
        if matrix.dtype.kind in "biuf" and matrix.ndim == 2 and len(set(matrix.shape)) == 1:
            return tuple(range(len(matrix))), matrix.astype(float)
    except (TypeError, ValueError):
        pass
    raise GraphError(
        "graph must be a networkx.Graph, a square matrix of weights, or a dict from time to "
        f"graph, with numbers as weights, got {type(graph).__name__}"
    )


def _in_order(names: Iterable) -> tuple:
    """Return names in their order; numbers as they count, however edges were listed."""
    return tuple(sorted(names) if all(isinstance(name, Integral) for name in names) else names)


def _linked(adjacency: np.ndarray) -> np.ndarray:
    """Return whom each robot sees, directly or through others, itself included; shape (N, N)."""
    linked = np.eye(len(adjacency)) + (adjacency > 0.0)
    for _ in range(len(adjacency).bit_length()):
        linked = np.minimum(linked @ linked, 1.0)
    return linked > 0.0


def graphs_in_time(graph, require_connected: bool) -> tuple[tuple, list[TeamGraph]]:
    """
    Return the names of all robots that are ever in the team, and the graph from 0 and from each
    change on.

    A graph that changes is a dict from time [s] to graph. Robots that are absent see nobody and are
    seen by nobody.
    """
    graphs = graph if isinstance(graph, Mapping) else {0.0: graph}
    times = [finite_number("a time of the graph", t) for t in graphs]
    if 0.0 not in times or min(times) < 0.0:
        raise ValueError(f"times of the graph must be 0 and others after 0, got {times}")
    parts = []
    for t in sorted(graphs):
        try:
            parts.append(team_graph(graphs[t], require_connected))
        except GraphError as error:
            raise GraphError(f"from t = {t:g} s on: {error}" if t else str(error)) from None
    names = _in_order(dict.fromkeys(name for members, _ in parts for name in members))
    changes = []
    for t, (members, part) in zip(sorted(times), parts, strict=True):
        places = [names.index(name) for name in members]
        present = np.isin(np.arange(len(names)), places)
        adjacency = np.zeros((len(names), len(names)))
        adjacency[np.ix_(places, places)] = part
        may_lead = present
        if require_connected:
            may_lead = np.logical_and.reduce(_linked(adjacency)[present])
        for flags in (present, may_lead):  # policies read them
            flags.setflags(write=False)
        changes.append(TeamGraph(t, adjacency, present, may_lead))
    return names, changes


def laplacian(adjacency: np.ndarray) -> np.ndarray:
    """Return L = D − A, every row of which sums to zero."""
    return np.diag(adjacency.sum(axis=1)) - adjacency


def formation_on(
    graph: TeamGraph, coupling: float, h: float, root: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """
    Return what one step of the midpoint rule of length 2h needs of a graph, and of the square roots
    of its robots' speeds, shape (N,).

    These are R, h R Lᵀ and L, shape (3, N, N), for q = R (q₀ + hLᵀζ₀ + h g D r_s) with R = (I + hL
    + h²LᵀL)⁻¹, and what the team does to a leader's push, shape (N,). Robots of speeds S, (4.22)
    with S before every right side, are such a team as well: in q/√S and ζ/√S, with √S L √S for L
    and √S D for D.
    """
    L = root[:, None] * (coupling * laplacian(graph.adjacency)) * root
    solved = np.linalg.inv(np.eye(root.size) + h * L + h * h * L.T @ L)
    return np.array([solved, h * solved @ L.T, L]), h * root**2 * (L @ solved).diagonal()
