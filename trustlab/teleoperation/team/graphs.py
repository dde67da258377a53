"""
Who sees whom in a team of robots: graphs as adjacency matrices, how they change during a run, and
one step on them.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from trustlab.models.checks import finite_number


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

    @property
    def directed(self) -> bool:
        """Whether some robot sees another that does not see it as well."""
        return bool((self.adjacency != self.adjacency.T).any())


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
    names, matrix = _matrix(graph)
    if len(names) < 2:
        raise GraphError(f"a team needs two robots or more, got {len(names)}")
    for i, j in np.argwhere(~(np.isfinite(matrix) & (matrix >= 0.0))):
        raise GraphError(
            f"a_ij must be finite and 0 or more; from {names[i]!r} to {names[j]!r} it is "
            f"{matrix[i, j]}"
        )
    for i in np.flatnonzero(np.diag(matrix)):
        raise GraphError(f"robot {names[i]!r} has a self-loop; remove it")
    if require_connected:
        _check_connected(names, matrix)
    return names, matrix


def _matrix(graph) -> tuple[tuple, np.ndarray]:
    """Return names and adjacency as a user gives them."""
    if hasattr(graph, "is_directed") and hasattr(graph, "adjacency"):
        import networkx

        if graph.is_multigraph():
            raise GraphError(
                "the graph has parallel edges (a multigraph); pass networkx.Graph(graph)"
            )
        try:
            return tuple(graph.nodes), networkx.to_numpy_array(graph)
        except (TypeError, ValueError):
            raise GraphError("an edge of the graph has a weight that is not a number") from None
    try:
        matrix = np.asarray(graph)
        if matrix.dtype.kind not in "biuf" or matrix.ndim != 2 or len(set(matrix.shape)) > 1:
            raise TypeError
    except (TypeError, ValueError):
        raise GraphError(
            "graph must be a networkx.Graph, a square matrix of weights, or a dict from time to "
            f"graph, got {type(graph).__name__}"
        ) from None
    return tuple(range(len(matrix))), matrix.astype(float)


def roots(adjacency: np.ndarray) -> np.ndarray:
    """
    Return the robots whom all others see, directly or through others; shape (N,), True where one
    is.
    """
    from scipy.sparse.csgraph import connected_components

    count, part = connected_components(adjacency, directed=True, connection="strong")
    sees_other_part = np.zeros(count, bool)
    i, j = np.nonzero(adjacency)
    sees_other_part[part[i[part[i] != part[j]]]] = True
    # what one sees leads to a part that sees no other; all see it only if there is no second one of
    # the kind
    last = np.flatnonzero(~sees_other_part)
    return part == last[0] if last.size == 1 else np.zeros(len(adjacency), bool)


def _check_connected(names: tuple, matrix: np.ndarray) -> None:
    """Refuse a graph on which no robot can lead all others."""
    from scipy.sparse.csgraph import connected_components

    count, label = connected_components(matrix, directed=True, connection="weak")
    if count > 1:
        parts = [[repr(names[i]) for i in np.flatnonzero(label == part)] for part in range(count)]
        listed = "; ".join("{" + ", ".join(part) + "}" for part in parts)
        raise GraphError(
            f"the graph is not connected, it has {count} parts: {listed}; robots of different "
            "parts never meet: add edges, or pass require_connected=False (in a TeamTrial to "
            "simulate_team) to see it"
        )
    if not roots(matrix).any():
        raise GraphError(
            "the directed graph has no spanning tree: there is no robot whom all others see, "
            "directly or through others, so that nobody can lead them all; add edges, or pass "
            "require_connected=False (in a TeamTrial to simulate_team) to see it"
        )


def graphs_in_time(graph, require_connected: bool) -> tuple[tuple, list[TeamGraph]]:
    """
    Return the names of all robots that are ever in the team, and the graph from 0 and from each
    change on.

    A graph that changes is a dict from time [s] to graph.
    """
    graphs = graph if isinstance(graph, Mapping) else {0.0: graph}
    times = [finite_number("a time of the graph", t) for t in graphs]
    if 0.0 not in times or min(times) < 0.0:
        raise ValueError(f"times of the graph must be 0 and others after 0, got {times}")
    parts = []
    for t, later in sorted(zip(times, graphs.values(), strict=True), key=lambda pair: pair[0]):
        try:
            parts.append((t, *team_graph(later, require_connected)))
        except GraphError as error:
            if t == 0.0:
                raise
            raise GraphError(f"the graph from t = {t:g} s on: {error}") from None
    names = tuple(dict.fromkeys(name for _, members, _ in parts for name in members))
    return names, [_on_all(names, *part, require_connected) for part in parts]


def _on_all(
    names: tuple, t: float, members: tuple, adjacency: np.ndarray, connected: bool
) -> TeamGraph:
    """
    Return a graph of some robots as one of all: those that are absent see nobody and are seen by
    nobody.
    """
    place = {name: i for i, name in enumerate(names)}
    at = np.array([place[name] for name in members])
    whole = np.zeros((len(names), len(names)))
    present, may_lead = np.zeros((2, len(names)), bool)
    whole[np.ix_(at, at)], present[at] = adjacency, True
    may_lead[at] = roots(adjacency) if connected else True
    return TeamGraph(t, whole, present, may_lead)


def laplacian(adjacency: np.ndarray) -> np.ndarray:
    """Return L = D − A, every row of which sums to zero."""
    return np.diag(adjacency.sum(axis=1)) - adjacency


def algebraic_connectivity(graph) -> float:
    """
    Return λ_2 of the Laplacian: how fast the team's differences die out [1/s].

    Parameters
    ----------
    graph : networkx.Graph, networkx.DiGraph or array_like, shape (N, N)
        As in `team_graph`; 0 where it is not connected. On a directed graph the least real part of
        an eigenvalue but the first.
    """
    matrix = laplacian(team_graph(graph, require_connected=False)[1])
    symmetric = (matrix == matrix.T).all()
    values = np.linalg.eigvalsh(matrix) if symmetric else np.sort(np.linalg.eigvals(matrix).real)
    return float(max(values[1], 0.0))


def formation_on(
    graph: TeamGraph, coupling: float, h: float, speeds: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """
    Return what one step of the midpoint rule of length 2h needs of a graph and its robots' speeds,
    shape (N,), 1 by default; a directed graph must damp its differences.

    Returns R, h R Lᵀ and L, shape (3, N, N), for q = R (q₀ + hLᵀζ₀ + h g D r_s) with R = (I + hL +
    h²LᵀL)⁻¹, and what the team does to a leader's push, shape (N,). Robots of speeds S, (4.22) with
    S before every right side, are such a team as well: in q/√S and ζ/√S, with √S L √S for L and √S
    D for D.
    """
    size = len(graph.adjacency)
    root = np.ones(size) if speeds is None else np.sqrt(speeds)
    L = root[:, None] * (coupling * laplacian(graph.adjacency)) * root
    if graph.directed:
        growth = np.linalg.eigvals(np.block([[-L, L.T], [-L, np.zeros_like(L)]])).real.max()
        if growth > 1e-7 * np.abs(L).max():
            raise GraphError(
                f"on the directed graph from t = {graph.since:g} s on differences grow by "
                f"{growth:.2g} 1/s, whoever leads: the weights in and out of robots are too "
                "different; balance them, or add the edges' opposites"
            )
    solved = np.linalg.inv(np.eye(size) + h * L + h * h * L.T @ L)
    return np.array([solved, h * solved @ L.T, L]), h * root**2 * (L @ solved).diagonal()
