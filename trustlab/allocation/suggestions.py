"""Which suggestions were shown, and which were followed (Table 2.6)."""

import numpy as np
import pandas as pd

from trustlab.models.checks import of_class, positive
from trustlab.sessions.errors import SessionError
from trustlab.sessions.session import Session


def followed_suggestions(session: Session, deadline: float = 15.0) -> pd.DataFrame:
    """
    Return the suggestions that were shown, each from its first appearance, and whether they were followed (Table 2.6).

    A suggestion is shown while `suggested_mode` is 0 or 1 and not the mode there is; one that comes back within the
    deadline, while the mode stayed and the aid did not agree with it, is the same suggestion.

    Parameters
    ----------
    session : Session
        With columns mode and suggested_mode.
    deadline : float
        A suggestion counts as followed when the mode changes to it within this time [s].

    Returns
    -------
    pandas.DataFrame
        Columns start [s], suggested_mode, delay [s] until the mode changed to it (NaN if it never did before the next
        suggestion), followed (bool), state: "followed", "not followed", "withdrawn" (before the deadline) or "open" (the session ended
        before the deadline).

    Raises
    ------
    SessionError
        If a column is missing or holds a share.
    ValueError
        If `session` is not a `Session`, or the deadline is not positive.
    """
    of_class("session", session, Session, "trustlab.read_session(path) reads one")
    deadline = positive("deadline", deadline)
    session.require("mode", "suggested_mode")
    for name, allowed in (("mode", (0.0, 1.0)), ("suggested_mode", (-1.0, 0.0, 1.0))):
        odd = ~np.isin(session[name], allowed)
        if odd.any():
            k = int(np.argmax(odd))
            raise SessionError(f"column {name!r}, t = {session.t[k]:g} s: {session[name][k]} is not one of {allowed}")
    t, mode, suggested = session.t, session["mode"], session["suggested_mode"]
    before = np.r_[mode[0], mode[:-1]]
    # A new suggestion begins when the mode has changed, or the aid has agreed with it, since the last one was shown.
    breaks = np.cumsum((mode != before) | (suggested == before))
    episodes: list[list] = []
    for k in np.flatnonzero((suggested >= 0.0) & (suggested != before)).tolist():
        last = episodes[-1] if episodes else None
        same = last and last[1] == suggested[k] and t[k] - t[last[2]] <= deadline
        if same and breaks[k - 1] == breaks[last[2]]:
            last[2] = k
        else:
            episodes.append([k, suggested[k], k])
    rows = []
    for i, (first, wanted, last) in enumerate(episodes):
        stop = episodes[i + 1][0] if i + 1 < len(episodes) else t.size
        there = np.flatnonzero(mode[first:stop] == wanted)
        delay = t[first + there[0]] - t[first] if there.size else np.nan
        if delay <= deadline + 1e-9:
            state = "followed"
        elif t[last] - t[first] >= deadline - 1e-9:
            state = "not followed"
        else:
            state = "withdrawn" if t[-1] - t[first] >= deadline else "open"
        rows.append((t[first], wanted, delay, state == "followed", state))
    return pd.DataFrame(rows, columns=["start", "suggested_mode", "delay", "followed", "state"])
