"""Several logs of one run, joined by time."""

from collections import Counter
from collections.abc import Sequence

from trustlab.models.checks import of_class
from trustlab.sessions.errors import RecipeError, SessionError
from trustlab.sessions.metadata import Metadata
from trustlab.sessions.readers.assembly import assemble_session
from trustlab.sessions.recipe import asked_resampling
from trustlab.sessions.resampling import RawLog, Stream
from trustlab.sessions.session import Session


def join_sessions(
    sessions: Sequence[Session], resample: str | None = None, sample_time: float | None = None
) -> Session:
    """
    Join sessions that log one run, as one file per sensor, on one time axis.

    Their times must count from the same instant. Where the times differ, resampling is asked for by name, and the result
    spans the time that all of them cover.

    Parameters
    ----------
    sessions : sequence of Session
        With different columns each; metadata that several of them give must agree.
    resample : {"previous", "linear", "nearest"}, optional
        As for `read_session`.
    sample_time : float, optional
        Time between samples [s] after resampling.

    Returns
    -------
    Session
        Its metadata `joined` name the sources.

    Raises
    ------
    SessionError
        If two sessions have the same column, differ in their metadata, or share no time.
    RecipeError
        If their times differ and no resampling is asked for.

    Examples
    --------
    >>> import trustlab as tl
    >>> session = tl.read_session("data/sessions/pilot.csv")
    >>> one, other = (tl.Session(session.data[names]) for names in (["mode"], ["p_r", "p_h"]))
    >>> tl.join_sessions([one, other]).columns
    ['mode', 'p_r', 'p_h']
    """
    sessions = [of_class("each session", session, Session) for session in sessions]
    counts = Counter(name for session in sessions for name in session.columns)
    twice = [name for name, count in counts.items() if count > 1]
    if twice or not sessions:
        raise SessionError(
            f"column {twice[0]!r} is in two of the sessions" if twice else "there are no sessions to join"
        )
    known: dict[str, object] = {}
    for session in sessions:
        for name, value in session.metadata.as_dict().items():
            # What a file says about its own start and mending is not the others' as well.
            if name not in ("source", "resampled") and value is not None and known.setdefault(name, value) != value:
                what = f"metadata {name!r} are {known[name]!r} in one session and {value!r} in another"
                raise SessionError(f"{what}; these are not of one run, or say so with session.with_metadata")
    streams = [
        Stream(session.t, {name: session[name] for name in session.columns}, "sample {}".format, session.label)
        for session in sessions
    ]
    resampling = asked_resampling(resample, sample_time)
    metadata = Metadata().changed(**known, joined=[str(session.metadata.source) for session in sessions])
    try:
        return assemble_session(RawLog("joined", streams, metadata), None, {}, None, resampling)
    except RecipeError as error:
        how = 'join_sessions(sessions, resample="linear", sample_time=0.1)'
        raise RecipeError(f"the sessions have times of their own; name how to bring them together: {how}") from error
