"""Which suggestions were shown, and which were followed (Table 2.6)."""

import numpy as np
import pandas as pd

from trustlab.models.checks import of_class, positive
from trustlab.models.compiled import njit
from trustlab.sessions.errors import SessionError
from trustlab.sessions.session import Session

STATES = ("followed", "not followed", "withdrawn", "open")
FOLLOWED, NOT_FOLLOWED, WITHDRAWN, OPEN = range(4)


def followed_suggestions(session: Session, deadline: float = 15.0) -> pd.DataFrame:
    """
    Return the suggestions that were shown, and whether they were followed (Table 2.6).

    Each counts from its first appearance.

    A suggestion is shown while `suggested_mode` is 0 or 1 and not the mode there is; one that comes
    back within the deadline, while the mode stayed and the aid did not agree with it, is the same
    suggestion.

    Parameters
    ----------
    session : Session
        With columns mode and suggested_mode.
    deadline : float
        A suggestion counts as followed when the mode changes to it within this time [s].

    Returns
    -------
    pandas.DataFrame
        Columns start [s], suggested_mode, delay [s] until the mode changed to it (NaN if it never
        did before the next suggestion), followed (bool), state: "followed", "not followed",
        "withdrawn" (before the deadline) or "open" (the session ended before the deadline).

    Raises
    ------
    SessionError
        If a column is missing or holds a share.
    ValueError
        If `session` is not a `Session`, or the deadline is not positive.

    Examples
    --------
    >>> import trustlab as tl
    >>> run = tl.run_condition("C2", participant=2, laps=4, seed=0)
    >>> tl.followed_suggestions(run.session).columns.tolist()
    ['start', 'suggested_mode', 'delay', 'followed', 'state']
    """
    of_class("session", session, Session, "trustlab.read_session(path) reads one")
    deadline = positive("deadline", deadline)
    session.require("mode", "suggested_mode")
    for name, allowed in (("mode", (0.0, 1.0)), ("suggested_mode", (-1.0, 0.0, 1.0))):
        odd = ~np.isin(session[name], allowed)
        if odd.any():
            k = int(np.argmax(odd))
            raise SessionError(
                f"column {name!r}, t = {session.t[k]:g} s: {session[name][k]} is not one of "
                f"{allowed}"
            )
    episodes = suggestion_episodes(session.t, session["mode"], session["suggested_mode"], deadline)
    rows = [
        (start, float(to), delay, state == FOLLOWED, STATES[state])
        for start, to, delay, state in episodes
    ]
    return pd.DataFrame(rows, columns=["start", "suggested_mode", "delay", "followed", "state"])


@njit
def suggestion_episodes(t, mode, suggested, deadline):
    """
    Return start, mode, delay until it was taken (or NaN) and state of every suggestion.

    States are those of `followed_suggestions`.
    """
    first = list(range(0))
    last = list(range(0))
    # Whether none was shown yet, or the mode has changed, or the aid has agreed with it, since the
    # last one was
    broken = True
    for k in range(t.size):
        before = mode[max(k - 1, 0)]
        if suggested[k] >= 0.0 and suggested[k] != before:
            same = (
                not broken
                and suggested[first[-1]] == suggested[k]
                and t[k] - t[last[-1]] <= deadline
            )
            if same:
                last[-1] = k
            else:
                first.append(k)
                last.append(k)
            broken = False
        elif mode[k] != before or suggested[k] == before:
            broken = True
    rows = []
    for i in range(len(first)):
        start = first[i]
        suggestion = suggested[start]
        delay = np.nan
        stop = first[i + 1] if i + 1 < len(first) else t.size
        for k in range(start, stop):
            if mode[k] == suggestion:
                delay = t[k] - t[start]
                break
        if delay <= deadline + 1e-9:
            state = FOLLOWED
        elif t[last[i]] - t[start] >= deadline - 1e-9:
            state = NOT_FOLLOWED
        else:
            state = WITHDRAWN if t[-1] - t[start] >= deadline else OPEN
        rows.append((t[start], suggestion, delay, state))
    return rows
