"""What identification reads from sessions: plain arrays, checked once."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from trustlab.identification.errors import IdentificationError
from trustlab.models.checks import of_class
from trustlab.sessions.session import Session

__all__ = ["Trace", "blocks", "traces"]


@dataclass(frozen=True, eq=False)
class Trace:
    """
    One session as arrays of shape (N,).

    Parameters
    ----------
    label : str
        The session in a few words.
    synthetic : bool
        Whether the session was simulated.
    notes : tuple
        Participant, and how performance was measured.
    t, mode : numpy.ndarray
        Time [s] and manual share.
    p_h, p_r, r : numpy.ndarray or None
        Measured performances and logged utilization; None when the fit has no use for them.
    """

    label: str
    synthetic: bool
    t: np.ndarray
    mode: np.ndarray
    p_h: np.ndarray | None = None
    p_r: np.ndarray | None = None
    r: np.ndarray | None = None
    notes: tuple = (None, None)


def traces(sessions: Session | Iterable[Session], *needed: str) -> tuple[list[Trace], float]:
    """
    Take the columns a fit needs out of sessions.

    Parameters
    ----------
    sessions : Session or iterable of Session
        One or several runs with the same sample time.
    *needed : str
        Columns of p_h, p_r, r that must be there, besides mode.

    Returns
    -------
    list of Trace, float
        The runs and their sample time [s].

    Raises
    ------
    IdentificationError
        If there is no session, or sample times differ.
    SessionError
        If a column is missing.
    """
    if isinstance(sessions, Session):
        sessions = [sessions]
    if (
        not isinstance(sessions, Iterable)
        or isinstance(sessions, (str, bytes, Mapping))
        or hasattr(sessions, "columns")
    ):
        of_class(
            "sessions",
            sessions,
            Session,
            "pass a session or a list of them; read a file with trustlab.read_session(path), or make one of a table: "
            'trustlab.Session(frame.set_index("t"))',
        )
    runs = list(sessions)
    if not runs:
        raise IdentificationError("no session was given; pass one or a list of them")
    for run in runs:
        of_class("each session", run, Session, "read one with trustlab.read_session(path)")
        run.require("mode", *needed)
        if abs(run.sample_time - runs[0].sample_time) > 1e-6 * runs[0].sample_time:
            raise IdentificationError(
                f"the parameters belong to one sample time, but {runs[0].label} has {runs[0].sample_time:g} s and "
                f"{run.label} has {run.sample_time:g} s; resample by name when reading"
            )
    out = [
        Trace(
            run.label,
            run.metadata.synthetic,
            run.t,
            run["mode"].copy(),
            **{name: run[name].copy() for name in needed},
            notes=(run.metadata.participant, run.metadata.more.get("performance")),
        )
        for run in runs
    ]
    return out, runs[0].sample_time


def blocks(runs: list[Trace], budget: int = 500) -> tuple[list[dict[str, np.ndarray]], int]:
    """
    Return block means of all columns, for cheap searches of starting values.

    Parameters
    ----------
    runs : list of Trace
        The runs.
    budget : int
        About how many blocks there may be in all; every run keeps at least eight.

    Returns
    -------
    list of dict, int
        Columns by name and run, and the block length [samples].
    """
    total = sum(run.mode.size for run in runs)
    shortest = min(run.mode.size for run in runs)
    length = max(1, min(total // budget, shortest // 8))
    out = []
    for run in runs:
        size = run.mode.size // length * length
        columns = {name: getattr(run, name) for name in ("mode", "p_h", "p_r")}
        out.append(
            {n: v[:size].reshape(-1, length).mean(axis=1) for n, v in columns.items() if v is not None}
        )
    return out, length
