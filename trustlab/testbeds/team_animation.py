"""A simulated team in motion, picture by picture."""

from collections.abc import Iterator

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

# Pictures at most.
PICTURES = 200
# Pictures a second, where that makes fewer.
PER_SECOND = 20


def samples_shown(run, rate: float) -> np.ndarray:
    """Return which samples of a `TeamRun` are shown, at simulated seconds per second."""
    end = len(run.t) - 1
    if run.converged:  # what comes after is rest
        end = min(int(np.searchsorted(run.t, 1.1 * run.time_to_goal)) + 1, end)
    seconds = float(run.t[end] - run.t[0]) / rate
    count = int(np.clip(PER_SECOND * seconds, 2, min(PICTURES, end + 1)))
    return np.linspace(0, end, count).astype(int)


def pictures(run, samples: np.ndarray) -> Iterator[Image.Image]:
    """
    Yield pictures of a `TeamRun`: the team from above and from the side, its links and its leader.
    """
    figure = Figure(figsize=(8.0, 4.6), dpi=90)
    canvas = FigureCanvasAgg(figure)
    figure.suptitle(run.title, fontsize=11, parse_math=False)
    words = figure.text(0.5, 0.9, "", ha="center", animated=True)
    places = np.concatenate([run.positions.reshape(-1, 3), run.goal[None]])
    low, high = np.nanmin(places, axis=0), np.nanmax(places, axis=0)
    half = 0.55 * max(float((high - low).max()), 0.1)
    views = []
    for axis, seen in zip(figure.subplots(1, 2), ([0, 1], [0, 2]), strict=True):
        x, y = 0.5 * (low + high)[seen]
        limits = {"xlim": (x - half, x + half), "ylim": (y - half, y + half)}
        axis.set(xlabel="x [m]", ylabel=f"{'xyz'[seen[1]]} [m]", aspect="equal", **limits)
        axis.plot(*run.goal[seen], "C2o", ms=14, mfc="none")
        links, robots = ([], [], "C7-"), ([], [], "C0o")
        leader = ([], [], "C3o")
        views.append((seen, axis.plot(*links, *robots, *leader, animated=True)))
    canvas.draw()
    background = canvas.copy_from_bbox(figure.bbox)
    leads = run.data["number"].to_numpy().astype(int)
    force = np.linalg.norm(run.data[["f_m_x", "f_m_y", "f_m_z"]].to_numpy(), axis=1)
    for k in samples:
        canvas.restore_region(background)
        graph = [graph for since, graph in run.graphs if since <= run.t[k]][-1]
        place, pairs = run.positions[k], np.argwhere(np.triu(graph + graph.T))
        ways = np.full((len(pairs), 3, 3), np.nan)  # a gap after each link
        ways[:, :2] = place[pairs]
        for seen, lines in views:
            for line, shown in zip(
                lines, (ways.reshape(-1, 3), place, place[[leads[k]]]), strict=True
            ):
                line.set_data(*shown[:, seen].T)
                figure.draw_artist(line)
        words.set_text(f"{run.t[k]:.1f} s, the operator feels {force[k]:.2f} N")
        figure.draw_artist(words)
        picture = Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3])
        yield picture.quantize(64, method=Image.Quantize.FASTOCTREE)
