"""
A simulated team in motion: an HTML page with its data and script inside, and for reports an SVG
that needs no script.
"""

import base64
import hashlib
import html
import json
from collections.abc import Iterable
from pathlib import Path
from string import Template

import numpy as np
import pandas as pd

from trustlab.models.checks import finite_number, positive

# What a page may do: show what it brings, and fetch nothing.
POLICY = (
    "default-src 'none'; img-src data:; style-src 'unsafe-inline'; form-action 'none'; "
    "base-uri 'none'"
)

# Frames at most, and coordinates in a page at most.
FRAMES, NUMBERS = 1500, 150_000

PAGE, SCRIPT = (
    Path(__file__).with_name("team_animation.html"),
    Path(__file__).with_name("team_animation.js"),
)

# What does not move in the SVG, with places for what does; the frame and the dial there are those
# of the next lines.
PICTURE = Path(__file__).with_name("team_picture.svg")
PICTURE_FRAMES = 160

SIDE = 340
TOP = 40
LEFT = 30
DIAL_X = 505
DIAL_Y = 170
DIAL = 90
LEADER, FOLLOWER = "#d55e00", "#0072b2"
DISCRETE = 'calcMode="discrete"'  # from colour to colour, nothing between


class AnimationPage(str):
    """An animation as one HTML page: text to write to a file, shown in a frame by a notebook."""

    __slots__ = ()

    def _repr_html_(self) -> str:
        framed = html.escape(self, quote=True)
        return (
            f'<iframe sandbox="allow-scripts" srcdoc="{framed}" width="100%" height="900" '
            'style="border:0"></iframe>'
        )

    def __repr__(self) -> str:
        return f"AnimationPage({len(self)} characters of HTML; write it with run.animate(path))"


def policy(*scripts: str) -> str:
    """
    Return the element of a page's head that lets it run these scripts, to the letter, and fetch
    nothing.
    """
    hashes = [
        base64.b64encode(hashlib.sha256(script.encode()).digest()).decode() for script in scripts
    ]
    allowed = "".join(f" 'sha256-{part}'" for part in hashes)
    more = f"; script-src{allowed}" if scripts else ""
    return f'<meta http-equiv="Content-Security-Policy" content="{POLICY}{more}">'


def animation_page(run, rate: float = 5.0) -> str:
    """
    Return an animation of a run as one HTML page.

    Parameters
    ----------
    run : TeamRun
        What to show.
    rate : float
        Simulated seconds per second at the start.

    Raises
    ------
    ValueError
        If the rate is not positive.
    """
    rate = positive("rate", rate)
    end = len(run.t)
    if run.converged:  # what comes after is rest
        end = min(int(np.searchsorted(run.t, 1.1 * run.time_to_goal)) + 2, end)
    frames = min(FRAMES, max(NUMBERS // (3 * len(run.robots)), 50))
    part = slice(0, end, max(-(-end // frames), 1))
    t, q = run.t[part], run.positions[part]
    force = -run.data[["f_m_x", "f_m_y", "f_m_z"]].to_numpy()[
        part
    ]  # what the device does to the hand
    middle, span = view(q, run.goal)
    data = {
        "t": _short(t, 3),
        "step": float(t[1] - t[0]) if len(t) > 1 else 1.0,
        "q": [
            [None if np.isnan(at[0]) else at for at in frame] for frame in _short(q, 4)
        ],  # null: not in the team then
        "f": _short(force, 4),
        "most": max(float(np.linalg.norm(force, axis=1).max()), 1e-6),
        "lead": run.data["number"].to_numpy()[part].astype(int).tolist(),
        "far": [float(f"{value:.3g}") for value in np.maximum(run.farthest[part], 1e-12)],
        "names": [str(name) for name in run.robots],
        "links": [[since, pairs.tolist()] for since, pairs in run.links],
        "goal": run.goal.tolist(),
        "low": (middle - 0.5 * span).tolist(),
        "span": span,
        "tolerance": run.tolerance,
    }
    arrived = (
        f"all within {run.tolerance:g} m after {run.time_to_goal:.1f} s"
        if run.converged
        else "not all at the goal"
    )
    note = f"Synthetic: simulated robots, channel and operator; {arrived}."
    script = SCRIPT.read_text(encoding="utf-8")
    return Template(PAGE.read_text(encoding="utf-8")).substitute(
        TITLE=html.escape(run.label),
        NOTE=html.escape(note),
        RATE=f"{rate:g}",
        POLICY=policy(script),
        DATA=json.dumps(data, separators=(",", ":")).replace(
            "<", "\\u003c"
        ),  # no tag, no comment begins there
        SCRIPT=script,
    )


def _short(values: np.ndarray, digits: int) -> list:
    return np.round(values, digits).tolist()


def view(positions: np.ndarray, goal: np.ndarray) -> tuple[np.ndarray, float]:
    """
    Return the middle of a square or cube that shows robots and goal at all times, and how wide it
    is.
    """
    seen = np.concatenate([positions.reshape(-1, goal.size), goal[None]])
    low, high = np.nanmin(seen, axis=0), np.nanmax(seen, axis=0)
    return 0.5 * (low + high), 1.1 * max(float((high - low).max()), 0.1)


def animated_svg(run, until: float | None = None, lasting: float = 20.0) -> str:
    """
    Return the team from above, and the horizontal force that the operator feels, as an SVG that
    repeats.
    """
    lasting = positive("lasting", lasting)
    until = float(run.t[-1]) if until is None else finite_number("until", until)
    if not run.t[0] < until <= run.t[-1]:
        raise ValueError(
            f"until must be after {run.t[0]:g} s and at most {run.t[-1]:g} s, got {until:g}"
        )
    at = np.searchsorted(run.t, np.linspace(run.t[0], until, PICTURE_FRAMES) - 1e-9)
    number = run.data["number"].to_numpy()[at].astype(int)
    # a robot that joins or leaves waits out of sight where it is first or last seen
    points = np.stack(
        [pd.DataFrame(axis).ffill().bfill() for axis in run.positions[at].transpose(2, 0, 1)],
        axis=-1,
    )
    seen = np.isfinite(run.positions[at, :, 0])
    since = [since for since, _ in run.links]
    graph = np.searchsorted(since, run.t[at], side="right") - 1
    linked = [{tuple(pair) for pair in pairs.tolist()} for _, pairs in run.links]
    force = -run.data[["f_m_x", "f_m_y"]].to_numpy()[at]  # what the device does to the hand
    middle, span = view(points[..., :2], run.goal[:2])
    x, y = _on_picture(points, middle, span)
    goal_x, goal_y = _on_picture(run.goal, middle, span)
    most = max(float(np.linalg.norm(force, axis=1).max()), 1e-9)
    tip = np.array([DIAL_X, DIAL_Y]) + DIAL * force / most * np.array([1.0, -1.0])

    colours = np.where(number[:, None] == np.arange(len(run.robots)), LEADER, FOLLOWER)
    links = [
        f'<line stroke="#aaa">{_moving(lasting, x1=x[:, i], y1=y[:, i], x2=x[:, j], y2=y[:, j])}'
        f"{_shown(np.array([(i, j) in pairs for pairs in linked])[graph], lasting)}</line>"
        for i, j in sorted(set().union(*linked))
    ]
    robots = [
        f'<circle cx="{x[0, i]:.1f}" cy="{y[0, i]:.1f}" r="6" stroke="#fff" fill="{colours[0, i]}">'
        f"{_moving(lasting, cx=x[:, i], cy=y[:, i])}"
        f"{_animation('fill', colours[:, i], lasting, DISCRETE)}"
        f"{_shown(seen[:, i], lasting)}</circle>"
        for i in range(len(run.robots))
    ]
    return Template(PICTURE.read_text(encoding="utf-8")).substitute(
        LABEL=html.escape(run.label),
        SPAN=f"{span:.1f}",
        MOST=f"{most:.2g}",
        LINKS="".join(links),
        GOAL_X=f"{goal_x:.1f}",
        GOAL_Y=f"{goal_y:.1f}",
        ROBOTS="".join(robots),
        FORCE=_moving(lasting, x2=tip[:, 0], y2=tip[:, 1]),
        TIP=_moving(lasting, cx=tip[:, 0], cy=tip[:, 1]),
        CLOCK=_moving(lasting, width=np.linspace(0.0, SIDE, 2)),
        UNTIL=f"{until:g}",
    )


def _on_picture(
    points: np.ndarray, middle: np.ndarray, span: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return where points, seen from above, are on the picture; its y grows downwards."""
    x = LEFT + SIDE * (0.5 + (points[..., 0] - middle[0]) / span)
    y = TOP + SIDE * (0.5 - (points[..., 1] - middle[1]) / span)
    return x, y


def _moving(lasting: float, **attributes: np.ndarray) -> str:
    """Return animations of attributes that run through their values."""
    return "".join(
        _animation(name, [f"{v:.1f}" for v in values], lasting)
        for name, values in attributes.items()
    )


def _shown(when: np.ndarray, lasting: float) -> str:
    """Return an animation that hides what is not there all the time."""
    return (
        "" if when.all() else _animation("opacity", when.astype(int).astype(str), lasting, DISCRETE)
    )


def _animation(name: str, values: Iterable[str], lasting: float, more: str = "") -> str:
    """Return an animation of one attribute, without end."""
    told = ";".join(values)
    return (
        f'<animate attributeName="{name}" values="{told}" dur="{lasting:g}s" '
        f'repeatCount="indefinite" {more}/>'
    )
