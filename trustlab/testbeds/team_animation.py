"""A simulated team in motion, picture by picture."""

from collections.abc import Iterator

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from PIL import Image

# Pictures at most.
PICTURES = 200
# Pictures a second, where that makes fewer.
PER_SECOND = 20
# For how many recorded samples the way of a robot is seen.
TRAIL = 150
ROBOT = "#0072b2"
LEADER = "#d55e00"
GOAL = "#009e73"


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
    axes = figure.subplots(1, 2)
    figure.suptitle(run.title, fontsize=11, parse_math=False)
    words = figure.text(0.5, 0.9, "", ha="center", parse_math=False)
    places = np.concatenate([run.positions.reshape(-1, 3), run.goal[None]])
    low, high = np.nanmin(places, axis=0), np.nanmax(places, axis=0)
    half = 0.55 * max(float((high - low).max()), 0.1)
    moving = [words]
    views = []
    for axis, number in zip(axes, (1, 2), strict=True):
        seen = [0, number]
        x, y = 0.5 * (low + high)[seen]
        limits = {"xlim": (x - half, x + half), "ylim": (y - half, y + half)}
        axis.set(xlabel="x [m]", ylabel=f"{'xyz'[number]} [m]", aspect="equal", **limits)
        axis.plot(*run.goal[seen], "o", ms=14, mfc="none", mec=GOAL)
        links = axis.add_collection(LineCollection([], colors="0.7", lw=0.8))
        trails = axis.add_collection(LineCollection([], colors=ROBOT, alpha=0.5, lw=1.0))
        (robots,) = axis.plot([], [], "o", ms=6, color=ROBOT)
        (leader,) = axis.plot([], [], "o", ms=9, color=LEADER)
        views.append((seen, links, trails, robots, leader))
        moving += [links, trails, robots, leader]
    for artist in moving:
        artist.set_animated(True)
    canvas.draw()
    background = canvas.copy_from_bbox(figure.bbox)
    leads = run.data["number"].to_numpy().astype(int)
    force = np.linalg.norm(run.data[["f_m_x", "f_m_y", "f_m_z"]].to_numpy(), axis=1)
    for k in samples:
        pairs = [each for since, each in run.links if since <= run.t[k]][-1]
        way = np.moveaxis(run.positions[max(k - TRAIL, 0) : k + 1], 1, 0)
        for seen, links, trails, robots, leader in views:
            place = run.positions[k][:, seen]
            links.set_segments(place[np.asarray(pairs, dtype=int).reshape(-1, 2)])
            trails.set_segments(list(way[..., seen]))
            robots.set_data(*place.T)
            leader.set_data(*place[[leads[k]]].T)
        words.set_text(
            f"{run.t[k]:.1f} s, leader {run.robots[leads[k]]}, {run.farthest[k]:.3g} m to the goal "
            f"at most, the operator feels {force[k]:.2f} N"
        )
        canvas.restore_region(background)
        for artist in moving:
            figure.draw_artist(artist)
        picture = Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3])
        yield picture.quantize(64, method=Image.Quantize.FASTOCTREE)
