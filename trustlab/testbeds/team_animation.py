"""A simulated team in motion, as a film."""

from pathlib import Path

import numpy as np
from matplotlib.animation import PillowWriter
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

# Pictures at most.
PICTURES = 100
# Pictures a second, where that makes fewer.
PER_SECOND = 20


def save_film(run, path: Path, rate: float) -> None:
    """
    Write a film of a `TeamRun` at simulated seconds per second: the team from above and from the
    side, its links and its leader.
    """
    end = len(run.t) - 1
    if run.converged:  # what comes after is rest
        end = min(int(np.searchsorted(run.t, 1.1 * run.time_to_goal)) + 1, end)
    seconds = float(run.t[end] - run.t[0]) / rate
    count = int(np.clip(PER_SECOND * seconds, 2, min(PICTURES, end + 1)))
    figure = Figure(figsize=(8.0, 4.4))
    FigureCanvasAgg(figure)
    figure.suptitle(run.title, fontsize="medium", parse_math=False)
    views = figure.subplots(1, 2)
    low, high = (
        f([f(run.positions, axis=(0, 1)), run.goal], axis=0) for f in (np.nanmin, np.nanmax)
    )
    half = 0.55 * max(float((high - low).max()), 0.1)
    leads = run.data["number"].to_numpy().astype(int)
    force = np.linalg.norm(run.data[["f_m_x", "f_m_y", "f_m_z"]].to_numpy(), axis=1)
    writer = PillowWriter(count / seconds)
    with writer.saving(figure, path, 90):
        for k in np.linspace(0, end, count).astype(int):
            graph = [graph for since, graph in run.graphs if since <= run.t[k]][-1]
            place, pairs = run.positions[k], np.argwhere(np.triu(graph + graph.T))
            for axis, seen in zip(views, ([0, 1], [0, 2]), strict=True):
                x, y = 0.5 * (low + high)[seen]
                axis.clear()
                axis.plot(*place[pairs][:, :, seen].T, "C7-")
                axis.plot(*run.goal[seen], "C2o", ms=14, mfc="none")
                axis.plot(*place[:, seen].T, "C0o")
                axis.plot(*place[leads[k], seen], "C3o")
                axis.set(xlim=(x - half, x + half), ylim=(y - half, y + half), aspect="equal")
                axis.set(xlabel="x [m]", ylabel=f"{'xyz'[seen[1]]} [m]")
            views[0].set_title(f"{run.t[k]:.1f} s, the operator feels {force[k]:.2f} N")
            writer.grab_frame()
