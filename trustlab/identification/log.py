"""
What identification reads from sessions, and how a log shows a model.

Columns become arrays; outputs may be means over a window, and the mode may act later than its stamp
says.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pandas as pd

from trustlab.identification.model import IdentificationError, Model
from trustlab.models.checks import (
    Checked,
    NotNegative,
    did_you_mean,
    not_negative,
    of_class,
    warn,
)
from trustlab.sessions.session import Session

HOW_TO_GET = (
    "pass a session or a list of them; read a file with trustlab.read_session(path), or make one "
    'of a table: trustlab.Session(frame.set_index("t"))'
)


@dataclass(frozen=True)
class LogSettings(Checked):
    """
    How a log shows the model: averaging, errors of the time stamps, outliers.

    Every fit takes these settings as keywords, or a `LogSettings` as `log`.

    Parameters
    ----------
    window : float, optional
        Length W [s] of the moving window over which p_r and p_h were averaged, as
        `with_performance` does, a whole number of samples; 0 if they were not averaged. By default
        each session's metadata decide. Other columns are no means.
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

    window: NotNegative | None = None
    mode_delay: bool = False
    stamp_error: NotNegative | None = None
    robust: bool = True


def log_settings(log: LogSettings | None, changes: Mapping[str, Any]) -> LogSettings:
    """Return a user's settings of the log: an object, keywords, or an object changed by them."""
    known = LogSettings.__dataclass_fields__
    for name in changes:
        if name not in known:
            hint = did_you_mean(name, known)
            raise TypeError(f"{name!r} is no argument, nor a setting ({', '.join(known)}){hint}")
    return replace(LogSettings() if log is None else of_class("log", log, LogSettings), **changes)


@dataclass(frozen=True, eq=False)
class Run:
    """
    One session as arrays: columns of shape (N,) by name, and facts that messages need.

    Outputs that are performance are means over `window` samples; where these are undone, they were
    over `undone`.
    """

    label: str
    t: np.ndarray
    columns: Mapping[str, np.ndarray]
    synthetic: bool = False
    participant: object = None
    window: int = 1
    undone: int = 1
    stamp_error: float = 0.0
    buffers: dict[tuple, np.ndarray] = field(default_factory=dict, init=False, repr=False)

    def __getitem__(self, name: str) -> np.ndarray:
        column = self.columns[name].view()
        column.flags.writeable = False  # no simulation changes what it is compared with
        return column

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

    def mapped(self, names: Iterable[str], change: Callable) -> "Run":
        """Return the run with some columns changed by `change(values, window)`."""
        return self.changed({name: change(self[name], self.window) for name in names})

    def scratch(self, name: str, lanes: int) -> np.ndarray:
        """Return an array of shape (N, lanes) to write into, the same at every call."""
        # The system hands out memory page by page: fresh arrays would take longer than the
        # simulation that fills them.
        if (name, lanes) not in self.buffers:
            self.buffers[name, lanes] = np.empty((self.size, lanes))
        return self.buffers[name, lanes]


def read_runs(
    sessions: Session | Iterable[Session], *columns: str, log: LogSettings | None = None
) -> list[Run]:
    """
    Take the columns that a fit needs out of one or several sessions with the same sample time.

    Where `log` leaves the window or the error of the stamps open, each session's metadata decide.
    """
    log = log or LogSettings()
    sessions = each_once(as_list(sessions))
    for session in sessions:
        session.require(*columns)
        if abs(session.sample_time - sessions[0].sample_time) > 1e-6 * sessions[0].sample_time:
            raise IdentificationError(
                f"the parameters belong to one sample time, but {sessions[0].label} has "
                f"{sessions[0].sample_time:g} s and {session.label} has {session.sample_time:g} s; "
                "resample by name when reading"
            )
    means = averaged(columns)
    if log.window is not None and not means:
        raise ValueError("window is that of p_r and p_h, which this model lacks; leave it out")
    windows = [_window(session, log.window) if means else 1 for session in sessions]
    if None in windows:
        warn(
            f"{sessions[windows.index(None)].label}: nothing says whether p_r and p_h are means "
            "over a moving window, as (2.4) and (2.7) are, and a fit that takes means for the "
            "values themselves is wrong: state window=… [s], or window=0 if they are no means (in "
            "a recipe: performance_window = …; Session.with_performance notes its own)"
        )
    return [
        Run(
            session.label,
            session.t,
            {name: session[name].copy() for name in columns},
            session.metadata.synthetic,
            session.metadata.participant,
            window or 1,
            stamp_error=_stamp_error(session, log.stamp_error),
        )
        for session, window in zip(sessions, windows, strict=True)
    ]


def as_list(sessions: Any) -> list:
    """Return one or several sessions as a list."""
    if isinstance(sessions, Session | Mapping | pd.DataFrame) or not isinstance(sessions, Iterable):
        return [sessions]
    sessions = list(sessions)
    if not sessions:
        raise IdentificationError("no session was given; pass one or a list of them")
    return sessions


def each_once(sessions: list) -> list[Session]:
    """Return a list of sessions; refuse what is none, and the same samples twice."""
    seen: dict[str, list[Session]] = {}
    for session in sessions:
        of_class("sessions", session, Session, HOW_TO_GET)
        others = seen.setdefault(session.label, [])
        if any(session.data.equals(other.data) for other in others):
            raise IdentificationError(
                f"{session.label} occurs twice, with equal samples: they would count as twice the "
                "data; pass every run once"
            )
        others.append(session)
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


def _window(session: Session, stated: float | None) -> int | None:
    """Return the window of a session's means in samples, 1 for none; None where nobody says."""
    more = session.metadata.more
    window = more.get("performance_window") if stated is None else stated
    if window and more.get("performance_cut"):
        raise IdentificationError(
            f"{session.label} was cut after its performance was averaged, so that its first means "
            "hold what is no longer there; cut the log first, then call with_performance"
        )
    if window is None and not session.metadata.synthetic:
        return None
    step, window = session.sample_time, not_negative("window", window or 0.0)
    samples = round(window / step)
    if abs(samples * step - window) > 0.01 * window:
        raise ValueError(
            f"window = {window:g} s is no whole number of samples of {session.label} (of {step:g} "
            f"s); state {max(1, samples) * step:g} s, or 0 if p_r and p_h are no means"
        )
    return max(1, samples)


def joined(runs: list[Run], name: str) -> np.ndarray:
    """Return one column of all runs, one after the other."""
    return np.concatenate([run[name] for run in runs])


def never_switches(runs: list[Run]) -> bool:
    """Return whether there is a mode, and it never changes within any run."""
    return all(np.ptp(run.columns.get("mode", [0.0, 1.0])) == 0.0 for run in runs)


def in_rows(values: np.ndarray, length: int) -> np.ndarray:
    """Return values in rows of so many; what does not fill a row is left out."""
    return values[: values.size // length * length].reshape(-1, length)


# Block means that a rough search looks at.
BLOCKS = 500


def block_means(runs: list[Run]) -> tuple[list[Run], int]:
    """
    Return block means of all columns, and the block length.

    There are about `BLOCKS` in all, and at least eight per run.
    """
    sizes = [run.size for run in runs]
    length = max(1, min(sum(sizes) // BLOCKS, min(sizes) // 8))
    means = []
    for run in runs:
        columns = {n: in_rows(values, length).mean(axis=1) for n, values in run.columns.items()}
        means.append(Run(run.label, in_rows(run.t, length)[:, 0], columns))
    return means, length


# --- means over a window -------------------------------------------------------------------------


def averaged(names: Iterable[str]) -> list[str]:
    """Return those of some columns that a window may average: performance."""
    return [name for name in names if name in ("p_r", "p_h")]


def counts(size: int, window: int) -> np.ndarray:
    """Return each window's sample count; windows at the start are shorter."""
    return np.minimum(np.arange(1.0, size + 1.0), window)


def window_means(values: np.ndarray, window: int) -> np.ndarray:
    """Return the means over the last `window` samples, down the columns."""
    sums = np.cumsum(values, axis=0)
    sums[window:] -= sums[:-window].copy()
    return (sums.T / counts(len(values), window)).T


def undo_window(means: np.ndarray, window: int) -> np.ndarray:
    """Return the values that `window_means` was made of."""
    sums = means * counts(means.size, window)
    # Each sample the window gains the new value and loses the oldest: z(k) = Δs(k) + z(k − W).
    gained = np.pad(np.diff(sums, prepend=0.0), (0, -means.size % window))
    return gained.reshape(-1, window).cumsum(axis=0).ravel()[: means.size]


def undone(run: Run, names: Iterable[str]) -> Run:
    """Return a run with the values that the means in these columns were made of."""
    return run.mapped(averaged(names), undo_window).changed({}, window=1, undone=run.window)


# --- a mode that acts late ------------------------------------------------------------------------


def delayed(model: Model) -> Model:
    """Return a model with one more unknown: how much later [s] the mode acts than it is stamped."""

    def simulate(run: Run, mode_delay, **values):
        outputs = model.outputs_of(late(run, mode_delay[0]), values)
        moved = np.flatnonzero(mode_delay != mode_delay[0])
        if moved.size == 0:
            return tuple(outputs)
        # Simulations bend where a delay takes in another sample: the slope over a whole sample
        # takes the place of that at a point.
        of_moved = {name: column[moved] for name, column in values.items()}
        halves = mode_delay[0] + run.sample_time * np.array([0.5, -0.5])
        ends = [model.outputs_of(late(run, delay), of_moved) for delay in halves]
        for out, high, low in zip(outputs, *ends, strict=True):
            out[:, moved] += (high - low) / run.sample_time * (mode_delay[moved] - mode_delay[0])
        return tuple(outputs)

    def starts(runs: list[Run], limits: Mapping):
        own = model.starts(runs, limits) if model.starts else [{}]
        return [{**values, "mode_delay": 0.0} for values in own]

    count = len(model.names)
    return replace(
        model,
        names=(*model.names, "mode_delay"),
        low=(*model.low[:count], -np.inf, *model.low[count:]),
        high=(*model.high[:count], np.inf, *model.high[count:]),
        size=model.useful,
        simulate=simulate,
        starts=starts,
        lanes=True,
    )


def late(run: Run, delay: float) -> Run:
    """Return a run whose mode acts later by `delay` [s]; part of a sample becomes a share of it."""
    if delay == 0.0 or "mode" not in run.columns:
        return run
    at = np.arange(run.size, dtype=float)
    return run.changed({"mode": np.interp(at - delay / run.sample_time, at, run["mode"])})
