"""What identification reads from sessions: columns as arrays, and how the log shows the model."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from trustlab.identification.structure import IdentificationError
from trustlab.models.checks import flag, not_negative, of_class, positive, warn
from trustlab.sessions.session import Session

HOW_TO_GET = (
    "pass a session or a list of them; read a file with trustlab.read_session(path), or make one "
    'of a table: trustlab.Session(frame.set_index("t"))'
)


@dataclass(frozen=True)
class LogSettings:
    """
    How a log shows the model: averaging, time step, errors of the time stamps, outliers.

    Every fit takes these settings as keywords, or a `LogSettings` as `log`.

    Parameters
    ----------
    window : float, optional
        Length W [s] of the moving window over which the outputs were averaged, as
        `with_performance` does; 0 if they were not averaged. By default each session's metadata
        decide.
    step : float, optional
        Time step of the model [s], to which its rates refer, if it is shorter than the log's sample
        time; a sample must hold a whole number of steps.
    mode_delay : bool
        Whether to estimate the delay between the logged time of a change of mode and its effect
        [s], as a further parameter `mode_delay`.
    stamp_error : float, optional
        Standard deviation of the errors in the logged times of switches [s], independent from
        switch to switch. They widen the intervals, and so does an error that all switches share, as
        far as the residuals allow for one. By default the session's metadata decide
        (`stamp_error`); else 0.29 samples, the error of a time that is rounded to a sample, and 0
        for simulated sessions that were not resampled.
    robust : bool
        Whether to leave out samples that lie far from the model, such as dropouts; the message
        counts them.

    Raises
    ------
    ValueError
        If a value is not understood.

    Examples
    --------
    >>> import trustlab as tl
    >>> session = tl.read_session("data/sessions/pilot.csv")
    >>> log = tl.LogSettings(window=0.0, stamp_error=0.05)
    >>> tl.fit_human(session, log=log).success
    True
    """

    window: float | None = None
    step: float | None = None
    mode_delay: bool = False
    stamp_error: float | None = None
    robust: bool = True

    def __post_init__(self):
        checks = {"window": not_negative, "step": positive, "stamp_error": not_negative}
        for name, check in checks.items():
            if getattr(self, name) is not None:
                check(name, getattr(self, name))
        flag("mode_delay", self.mode_delay)
        flag("robust", self.robust)


def log_settings(log: LogSettings | None, changes: Mapping[str, Any]) -> LogSettings:
    """Return a user's settings of the log: an object, keywords, or an object changed by them."""
    return replace(LogSettings() if log is None else of_class("log", log, LogSettings), **changes)


@dataclass(frozen=True, eq=False)
class Run:
    """One session as arrays: columns of shape (N,) by name, and facts that messages need."""

    label: str
    t: np.ndarray
    columns: Mapping[str, np.ndarray]
    synthetic: bool = False
    participant: object = None
    window: int = 1
    stamp_error: float = 0.0
    model_step: float | None = None
    buffers: dict[tuple, np.ndarray] = field(default_factory=dict, init=False, repr=False)

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

    def changed(self, columns: Mapping[str, np.ndarray], **fields: Any) -> "Run":
        """Return the run with some columns, and perhaps fields, changed."""
        return replace(self, columns={**self.columns, **columns}, **fields)

    def scratch(self, name: str, dtype: np.dtype | type = float) -> np.ndarray:
        """Return an array of shape (N,) to simulate into, the same at every call."""
        # The system hands out memory page by page: fresh arrays would take longer than the
        # simulation that fills them.
        if (name, dtype) not in self.buffers:
            self.buffers[name, dtype] = np.empty(self.size, dtype)
        return self.buffers[name, dtype]


def read_runs(
    sessions: Session | Iterable[Session], *columns: str, log: LogSettings | None = None
) -> list[Run]:
    """
    Take the columns that a fit needs out of one or several sessions with the same sample time.

    Where `log` leaves the window or the error of the stamps open, each session's metadata decide.
    """
    log = log or LogSettings()
    sessions = _as_list(sessions)
    for session in sessions:
        of_class("sessions", session, Session, HOW_TO_GET)
        session.require(*columns)
        if abs(session.sample_time - sessions[0].sample_time) > 1e-6 * sessions[0].sample_time:
            raise IdentificationError(
                f"the parameters belong to one sample time, but {sessions[0].label} has "
                f"{sessions[0].sample_time:g} s and {session.label} has {session.sample_time:g} s; "
                "resample by name when reading"
            )
    windows = _windows(sessions, log.window, columns)
    return [
        Run(
            session.label,
            session.t,
            {name: session[name].copy() for name in columns},
            session.metadata.synthetic,
            session.metadata.participant,
            window,
            _stamp_error(session, log.stamp_error),
            log.step,
        )
        for session, window in zip(sessions, windows, strict=True)
    ]


def _as_list(sessions: Any) -> list:
    """Return one or several sessions as a list."""
    # A table, a mapping or a path can be iterated over too, but what comes out says nothing of the
    # mistake.
    single = (
        not isinstance(sessions, Iterable)
        or isinstance(sessions, (Session, str, bytes, Mapping))
        or hasattr(sessions, "columns")
    )
    if single:
        return [sessions]
    sessions = list(sessions)
    if not sessions:
        raise IdentificationError("no session was given; pass one or a list of them")
    return sessions


def _stamp_error(session: Session, stated: float | None) -> float:
    """Return the standard deviation of the mode's time stamps [s]."""
    metadata = session.metadata
    error = metadata.more.get("stamp_error") if stated is None else stated
    if error is not None:
        return not_negative("stamp_error", error)
    # People switch at any time between two samples, simulations on one.
    exact = metadata.synthetic and "resampled" not in metadata.more
    return 0.0 if exact else session.sample_time / np.sqrt(12.0)


def _windows(sessions: list[Session], stated: float | None, columns: tuple[str, ...]) -> list[int]:
    """Return each session's window in samples, 1 for none; warn where none is stated."""
    windows = [
        session.metadata.more.get("performance_window") if stated is None else stated
        for session in sessions
    ]
    pairs = list(zip(sessions, windows, strict=True))
    unstated = [s for s, window in pairs if window is None and not s.metadata.synthetic]
    if unstated and {"p_r", "p_h"} & set(columns):
        warn(
            f"{unstated[0].label}: nothing says whether p_r and p_h are means over a moving "
            "window, as (2.4) and (2.7) are, and a fit that takes means for the values themselves "
            "is wrong: state window=… [s], or window=0 if they are no means (in a recipe: "
            "performance_window = …; Session.with_performance notes its own)"
        )
    for session, window in pairs:
        if window and session.metadata.more.get("performance_cut"):
            raise IdentificationError(
                f"{session.label} was cut after its performance was averaged, so that its first "
                "means hold what is no longer there; cut the log first, then call "
                "with_performance"
            )
    seconds = [not_negative("window", window or 0.0) for window in windows]
    return [max(1, round(w / s.sample_time)) for w, s in zip(seconds, sessions, strict=True)]


def joined(runs: list[Run], name: str) -> np.ndarray:
    """Return one column of all runs, one after the other."""
    return np.concatenate([run[name] for run in runs])


def as_columns(records: np.ndarray) -> np.ndarray:
    """Return records of numbers as a matrix, shape (N, fields)."""
    return records.view(float).reshape(records.size, -1)


def block_means(runs: list[Run], budget: int = 500) -> tuple[list[Run], int]:
    """
    Return block means of all columns, and the block length.

    There are about `budget` blocks in all, and at least eight per run.
    """
    total = sum(run.size for run in runs)
    shortest = min(run.size for run in runs)
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
