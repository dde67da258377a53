"""What identification reads from sessions: columns as arrays, checked once."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from trustlab.identification.structure import IdentificationError
from trustlab.models.checks import not_negative, of_class, warn
from trustlab.sessions.session import Session

HOW_TO_GET = (
    "pass a session or a list of them; read a file with trustlab.read_session(path), or make one of a table: "
    'trustlab.Session(frame.set_index("t"))'
)


@dataclass(frozen=True, eq=False)
class Run:
    """
    One session, or block means of one: columns of shape (N,) by name, and what messages say of it.
    """

    label: str
    t: np.ndarray
    columns: Mapping[str, np.ndarray]
    synthetic: bool = False
    participant: object = None
    window: int = 1
    stamp_error: float = 0.0
    kept: dict[tuple, np.ndarray] = field(default_factory=dict)

    def __getitem__(self, name: str) -> np.ndarray:
        return self.columns[name]

    @property
    def size(self) -> int:
        """Number of samples."""
        return next(iter(self.columns.values())).size

    @property
    def sample_time(self) -> float:
        """Time between samples [s]."""
        return float(self.t[-1] - self.t[0]) / (self.size - 1)

    def scratch(self, what: str, kind: np.dtype | type = float) -> np.ndarray:
        """Return an array of shape (N,) to simulate into, the same at every call."""
        # The system hands out memory page by page: fresh arrays would take longer than the
        # simulation that fills them.
        if (what, kind) not in self.kept:
            self.kept[what, kind] = np.empty(self.size, kind)
        return self.kept[what, kind]


class HowLogged(NamedTuple):
    """
    How a log shows a model, as the user states it: see `fit`; None for what each session says.
    """

    window: float | None = None
    step: float | None = None
    mode_delay: bool = False
    stamp_error: float | None = None
    robust: bool = True


def read_runs(
    sessions: Session | Iterable[Session], *needed: str, how: HowLogged | None = None
) -> list[Run]:
    """
    Take the columns that a fit needs out of one or several sessions with the same sample time.

    What `how` leaves open each session says: the window, 0 for none; and how exact its stamps of
    mode are.
    """
    how = how or HowLogged()
    # A table, a mapping or a path can be iterated over too, but what comes out says nothing of the
    # mistake.
    several = isinstance(sessions, Iterable) and not isinstance(
        sessions, (Session, str, bytes, Mapping)
    )
    given: list = list(sessions) if several and not hasattr(sessions, "columns") else [sessions]
    if not given:
        raise IdentificationError("no session was given; pass one or a list of them")
    for session in given:
        of_class("sessions", session, Session, HOW_TO_GET)
        session.require(*needed)
        if abs(session.sample_time - given[0].sample_time) > 1e-6 * given[0].sample_time:
            raise IdentificationError(
                f"the parameters belong to one sample time, but {given[0].label} has "
                f"{given[0].sample_time:g} s and {session.label} has {session.sample_time:g} s; "
                "resample by name when reading"
            )
    return [
        Run(
            session.label,
            session.t,
            {name: session[name].copy() for name in needed},
            session.metadata.synthetic,
            session.metadata.participant,
            own,
            _stamp_error(session, how.stamp_error),
        )
        for session, own in zip(given, _windows(given, how.window, needed), strict=True)
    ]


def _stamp_error(session: Session, given: float | None) -> float:
    """Return the standard deviation of the mode's time stamps [s]."""
    known = session.metadata.more
    given = known.get("stamp_error") if given is None else given
    if given is not None:
        return not_negative("stamp_error", given)
    # People switch at any time between two samples, simulations on one.
    exact = session.metadata.synthetic and "resampled" not in known
    return 0.0 if exact else session.sample_time / np.sqrt(12.0)


def _windows(sessions: list[Session], window: float | None, needed: tuple[str, ...]) -> list[int]:
    """
    Return the window of each session's performance columns in samples, 1 for none; warn where
    nothing is said of it.
    """
    stated = [
        session.metadata.more.get("performance_window") if window is None else window
        for session in sessions
    ]
    unsaid = [
        s
        for s, own in zip(sessions, stated, strict=True)
        if own is None and not s.metadata.synthetic
    ]
    if unsaid and {"p_r", "p_h"} & set(needed):
        warn(
            f"{unsaid[0].label}: nothing says whether p_r and p_h are means over a moving window, "
            "as (2.4) and (2.7) are, and a fit that takes means for the values themselves is "
            "wrong: state window=… [s], or window=0 if they are no means (in a recipe: "
            "performance_window = …; Session.with_performance notes its own)"
        )
    for session, own in zip(sessions, stated, strict=True):
        if own and session.metadata.more.get("performance_cut"):
            raise IdentificationError(
                f"{session.label} was cut after its performance was averaged, so that its first "
                "means hold what is no longer there; cut the log first, then call "
                "with_performance"
            )
    widths = [not_negative("window", own or 0.0) for own in stated]
    return [
        max(1, round(own / session.sample_time))
        for own, session in zip(widths, sessions, strict=True)
    ]


def joined(runs: list[Run], name: str) -> np.ndarray:
    """Return one column of all runs, one after the other."""
    return np.concatenate([run[name] for run in runs])


def as_columns(records: np.ndarray) -> np.ndarray:
    """Return records of numbers as a matrix, shape (N, fields)."""
    return records.view(float).reshape(records.size, -1)


def block_means(runs: list[Run], budget: int = 500) -> tuple[list[Run], int]:
    """
    Return block means of all columns and the block length; about `budget` blocks in all, at least
    eight per run.
    """
    total, shortest = sum(run.size for run in runs), min(run.size for run in runs)
    length = max(1, min(total // budget, shortest // 8))
    means = []
    for run in runs:
        size = run.size // length * length
        columns = {
            name: values[:size].reshape(-1, length).mean(axis=1)
            for name, values in run.columns.items()
        }
        means.append(Run(run.label, run.t[:size:length], columns))
    return means, length
