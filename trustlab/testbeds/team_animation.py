"""A simulated team in motion: a film, from above and from the side."""

from pathlib import Path

import numpy as np
from matplotlib.animation import FuncAnimation, PillowWriter
from matplotlib.figure import Figure

# Pictures at most.
PICTURES = 200
# Pictures a second, where that makes fewer.
PER_SECOND = 20


def write_film(run, path: Path, rate: float) -> None:
    """Write the film of a `TeamRun`: the robots, their links and their leader, and the goal."""
    end = len(run.t) - 1
    if run.converged:  # what comes after is rest
        end = min(int(np.searchsorted(run.t, 1.1 * run.time_to_goal)) + 1, end)
    seconds = run.t[end] / rate
    count = int(np.clip(PER_SECOND * seconds, 2, min(PICTURES, end + 1)))
    leads = run.data["number"].to_numpy().astype(int)
    force = np.linalg.norm(run.data[["f_m_x", "f_m_y", "f_m_z"]].to_numpy(), axis=1)
    figure = Figure(figsize=(8.0, 4.6), dpi=90)
    views = []
    for axis, seen in zip(figure.subplots(1, 2), ([0, 1], [0, 2]), strict=True):
        axis.update_datalim(run.positions[..., seen].reshape(-1, 2))
        axis.plot(*run.goal[seen], "C2o", ms=14, mfc="none")
        axis.set(xlabel="x [m]", ylabel=f"{'xyz'[seen[1]]} [m]")
        axis.set_aspect("equal", "datalim")
        views.append((seen, axis.plot([], [], "C7-", [], [], "C0o", [], [], "C3o")))

    def show(k: int) -> None:
        graph = [graph for since, graph in run.graphs if since <= run.t[k]][-1]
        place, pairs = run.positions[k], np.argwhere(np.triu(graph + graph.T))
        ways = np.full((len(pairs), 3, 3), np.nan)  # a gap after each link
        ways[:, :2] = place[pairs]
        for seen, lines in views:
            shown = ways.reshape(-1, 3), place, place[[leads[k]]]
            for line, points in zip(lines, shown, strict=True):
                line.set_data(*points[:, seen].T)
        text = f"{run.title}\n{run.t[k]:.1f} s, the operator feels {force[k]:.2f} N"
        figure.suptitle(text, fontsize=11, parse_math=False)

    film = FuncAnimation(figure, show, np.linspace(0, end, count).astype(int))
    film.save(path, PillowWriter(fps=count / seconds))
