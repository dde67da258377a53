"""A simulated team as a moving picture without a script: an SVG whose robots, links and force are animated by the SVG itself."""

from __future__ import annotations

import html

import numpy as np

from trustlab.models.checks import finite_number, positive

__all__ = ["animated_svg", "view"]

FRAMES = 160
SIDE, TOP, LEFT = 340, 40, 30
DIAL_X, DIAL_Y, DIAL = 505, 170, 90


def animated_svg(run, until: float | None = None, lasting: float = 20.0) -> str:
    """Return the team from above, and the horizontal force that the operator feels, as an SVG that repeats."""
    lasting = positive("lasting", lasting)
    until = float(run.t[-1]) if until is None else finite_number("until", until)
    if not run.t[0] < until <= run.t[-1]:
        raise ValueError(f"until must be after {run.t[0]:g} s and at most {run.t[-1]:g} s, got {until:g}")
    at = np.searchsorted(run.t, np.linspace(run.t[0], until, FRAMES) - 1e-9)
    points, number = run.positions[at], run.data["number"].to_numpy()[at].astype(int)
    force = -run.data[["f_m_x", "f_m_y"]].to_numpy()[at]  # what the device does to the hand
    middle, span = view(points[..., :2], run.goal[:2])
    x, y = _on_picture(points, middle, span)
    goal_x, goal_y = _on_picture(run.goal, middle, span)
    most = max(float(np.linalg.norm(force, axis=1).max()), 1e-9)
    tip = np.array([DIAL_X, DIAL_Y]) + DIAL * force / most * np.array([1.0, -1.0])

    parts = _frame(html.escape(run.label), span, most)
    for i, j in np.argwhere(np.triu(run.adjacency)):
        ends = "".join(
            _moving(name, values[:, k], lasting)
            for name, values, k in (("x1", x, i), ("y1", y, i), ("x2", x, j), ("y2", y, j))
        )
        parts.append(f'<line stroke="#aaa">{ends}</line>')
    parts.append(
        f'<circle cx="{goal_x:.1f}" cy="{goal_y:.1f}" r="10" fill="none" stroke="#009e73" stroke-width="2"/>'
    )
    changes = np.concatenate([[0], np.flatnonzero(np.diff(number)) + 1])
    moments = ";".join(f"{change / (FRAMES - 1):.4f}" for change in changes)
    for i in range(len(run.robots)):
        colours = ";".join("#d55e00" if number[change] == i else "#0072b2" for change in changes)
        turn = (
            f'<animate attributeName="fill" values="{colours}" keyTimes="{moments}" calcMode="discrete" dur="{lasting:g}s" '
            'repeatCount="indefinite"/>'
        )
        first = colours.split(";", 1)[0]
        parts.append(
            f'<circle cx="{x[0, i]:.1f}" cy="{y[0, i]:.1f}" r="6" stroke="#fff" fill="{first}">'
            f"{_moving('cx', x[:, i], lasting)}{_moving('cy', y[:, i], lasting)}{turn}</circle>"
        )
    parts += _force(tip, lasting) + _clock(until, lasting)
    return "".join([*parts, "</svg>"])


def view(positions: np.ndarray, goal: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the middle of a square or cube that shows robots and goal at all times, and how wide it is."""
    seen = np.concatenate([positions.reshape(-1, goal.size), goal[None]])
    low, high = seen.min(axis=0), seen.max(axis=0)
    return 0.5 * (low + high), 1.1 * max(float((high - low).max()), 0.1)


def _on_picture(points: np.ndarray, middle: np.ndarray, span: float) -> tuple[np.ndarray, np.ndarray]:
    """Return where points, seen from above, are on the picture; its y grows downwards."""
    x = LEFT + SIDE * (0.5 + (points[..., 0] - middle[0]) / span)
    y = TOP + SIDE * (0.5 - (points[..., 1] - middle[1]) / span)
    return x, y


def _moving(name: str, values: np.ndarray, lasting: float) -> str:
    """Return an animation of one attribute that runs through the values."""
    told = ";".join(f"{value:.1f}" for value in values)
    return f'<animate attributeName="{name}" values="{told}" dur="{lasting:g}s" repeatCount="indefinite"/>'


def _frame(label: str, span: float, most: float) -> list[str]:
    """Return title, frame and dial, and the key to the colours."""
    return [
        '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 640 430" width="640" height="430" font-family="sans-serif" font-size="12">',
        f"<title>{label}: from above, and the force that the operator feels</title>",
        '<rect width="640" height="430" fill="#fff"/>',
        f'<text x="{LEFT}" y="18" font-size="13">{label}</text>',
        f'<rect x="{LEFT}" y="{TOP}" width="{SIDE}" height="{SIDE}" fill="none" stroke="#ccc"/>',
        f'<text x="{LEFT}" y="{TOP - 6}" fill="#555">from above, {span:.1f} m wide</text>',
        f'<text x="{DIAL_X - DIAL}" y="{TOP - 6}" fill="#555">force felt in x and y, rim: {most:.2g} N</text>',
        f'<circle cx="{DIAL_X}" cy="{DIAL_Y}" r="{DIAL}" fill="none" stroke="#ccc"/>',
        f'<text x="{DIAL_X - DIAL}" y="300" fill="#0072b2">● robot</text>',
        f'<text x="{DIAL_X - DIAL}" y="320" fill="#d55e00">● leader</text>',
        f'<text x="{DIAL_X - DIAL}" y="340" fill="#009e73">○ goal</text>',
    ]


def _force(tip: np.ndarray, lasting: float) -> list[str]:
    """Return the force as a line from the middle of the dial."""
    x, y = tip.T
    line = _moving("x2", x, lasting) + _moving("y2", y, lasting)
    point = _moving("cx", x, lasting) + _moving("cy", y, lasting)
    return [
        f'<line x1="{DIAL_X}" y1="{DIAL_Y}" stroke="#d55e00" stroke-width="3">{line}</line>',
        f'<circle r="5" fill="#d55e00">{point}</circle>',
    ]


def _clock(until: float, lasting: float) -> list[str]:
    """Return a bar that grows with time."""
    growing = _moving("width", np.linspace(0.0, SIDE, 2), lasting)
    return [
        f'<rect x="{LEFT}" y="398" width="{SIDE}" height="5" fill="#eee"/>',
        f'<rect x="{LEFT}" y="398" height="5" fill="#444">{growing}</rect>',
        f'<text x="{LEFT}" y="420" fill="#555">0 s</text>',
        f'<text x="{LEFT + SIDE}" y="420" fill="#555" text-anchor="end">{until:g} s</text>',
    ]
