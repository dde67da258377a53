"""The animation of a simulated team: one HTML page with its data and script inside, nothing fetched."""

import html
import json
from pathlib import Path
from string import Template

import numpy as np

from trustlab.models.checks import positive
from trustlab.models.html import policy
from trustlab.testbeds.team_svg import view

# Frames at most, and coordinates in a page at most.
FRAMES, NUMBERS = 1500, 150_000

PAGE, SCRIPT = Path(__file__).with_name("team_animation.html"), Path(__file__).with_name("team_animation.js")


class AnimationPage(str):
    """An animation as one HTML page: text to write to a file, shown in a frame by a notebook."""

    __slots__ = ()

    def _repr_html_(self) -> str:
        framed = html.escape(self, quote=True)
        return f'<iframe sandbox="allow-scripts" srcdoc="{framed}" width="100%" height="900" style="border:0"></iframe>'

    def __repr__(self) -> str:
        return f"AnimationPage({len(self)} characters of HTML; write it with run.animate(path))"


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
    force = -run.data[["f_m_x", "f_m_y", "f_m_z"]].to_numpy()[part]  # what the device does to the hand
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
        f"all within {run.tolerance:g} m after {run.time_to_goal:.1f} s" if run.converged else "not all at the goal"
    )
    note = f"Synthetic: simulated robots, channel and operator; {arrived}."
    script = SCRIPT.read_text(encoding="utf-8")
    return Template(PAGE.read_text(encoding="utf-8")).substitute(
        TITLE=html.escape(run.label),
        NOTE=html.escape(note),
        RATE=f"{rate:g}",
        POLICY=policy(script),
        DATA=json.dumps(data, separators=(",", ":")).replace("<", "\\u003c"),  # no tag, no comment begins there
        SCRIPT=script,
    )


def _short(values: np.ndarray, digits: int) -> list:
    return np.round(values, digits).tolist()
