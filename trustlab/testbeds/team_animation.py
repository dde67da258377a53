"""A simulated team in motion: an HTML page with its data and script inside."""

import base64
import hashlib
import html
import json
from pathlib import Path
from string import Template

import numpy as np

# What a page may do: show what it brings, and fetch nothing.
POLICY = (
    "default-src 'none'; img-src data:; style-src 'unsafe-inline'; form-action 'none'; "
    "base-uri 'none'"
)
# Frames at most, and coordinates in a page at most.
FRAMES = 1500
COORDINATES = 150_000
PAGE = Path(__file__).with_name("team_animation.html")
SCRIPT = Path(__file__).with_name("team_animation.js")


def policy(*scripts: str) -> str:
    """
    Return the element of a page's head that lets it run these scripts, to the letter, and fetch
    nothing.
    """
    hashes = [hashlib.sha256(script.encode()).digest() for script in scripts]
    allowed = "".join(f" 'sha256-{base64.b64encode(part).decode()}'" for part in hashes)
    more = f"; script-src{allowed}" if scripts else ""
    return f'<meta http-equiv="Content-Security-Policy" content="{POLICY}{more}">'


def animation_page(run, rate: float) -> str:
    """Return an animation of a `TeamRun` as one HTML page, at simulated seconds per second."""
    end = len(run.t)
    if run.converged:  # what comes after is rest
        end = min(int(np.searchsorted(run.t, 1.1 * run.time_to_goal)) + 2, end)
    frames = min(FRAMES, max(COORDINATES // (3 * len(run.robots)), 50))
    part = slice(0, end, max(-(-end // frames), 1))
    t, q = run.t[part], run.positions[part]
    # what the device does to the hand
    force = -run.data[["f_m_x", "f_m_y", "f_m_z"]].to_numpy()[part]
    seen = np.concatenate([q.reshape(-1, 3), run.goal[None]])
    low, high = np.nanmin(seen, axis=0), np.nanmax(seen, axis=0)
    span = 1.1 * max(float((high - low).max()), 0.1)
    data = {
        "t": t.round(3).tolist(),
        "step": float(t[1] - t[0]) if len(t) > 1 else 1.0,
        # null: not in the team then
        "q": [[None if np.isnan(at[0]) else at for at in row] for row in q.round(4).tolist()],
        "f": force.round(4).tolist(),
        "most": max(float(np.linalg.norm(force, axis=1).max()), 1e-6),
        "lead": run.data["number"].to_numpy()[part].astype(int).tolist(),
        "far": [float(f"{value:.3g}") for value in np.maximum(run.farthest[part], 1e-12)],
        "names": [str(name) for name in run.robots],
        "links": [[since, pairs.tolist()] for since, pairs in run.links],
        "goal": run.goal.tolist(),
        "low": (0.5 * (low + high - span)).tolist(),
        "span": span,
        "tolerance": run.tolerance,
    }
    script = SCRIPT.read_text(encoding="utf-8")
    return Template(PAGE.read_text(encoding="utf-8")).substitute(
        TITLE=html.escape(run.title),
        NOTE=html.escape(f"Synthetic: simulated robots, channel and operator; {run.message}."),
        RATE=f"{rate:g}",
        POLICY=policy(script),
        # no tag, no comment begins in what names bring
        DATA=json.dumps(data, separators=(",", ":")).replace("<", "\\u003c"),
        SCRIPT=script,
    )
