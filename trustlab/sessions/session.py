"""One logged run: the table that everything else reads."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType

import numpy as np
import pandas as pd

from trustlab.sessions.errors import SessionError, nearest
from trustlab.sessions.vocabulary import VOCABULARY

__all__ = ["STEP_TOLERANCE", "Metadata", "Session"]

STEP_TOLERANCE = 0.01
"""How far a time step may lie from the median step, as a share of it, before sampling counts as irregular."""


@dataclass(frozen=True)
class Metadata:
    """
    What a session says of itself.

    Parameters
    ----------
    participant : str, int or None
        Who took part.
    condition : str, int, float or None
        The experimental condition, for example "C1".
    source : str or None
        The file or the generator that the session came from.
    synthetic : bool
        True when the data were simulated; said in every figure and table made from them.
    more : mapping
        Whatever else the log names (trial, block, autonomy …): names to plain values.
    """

    participant: str | int | None = None
    condition: str | int | float | None = None
    source: str | None = None
    synthetic: bool = False
    more: Mapping[str, object] = field(default_factory=dict)

    def __post_init__(self):
        object.__setattr__(self, "more", MappingProxyType(dict(self.more)))

    def __reduce__(self):
        return (Metadata, (self.participant, self.condition, self.source, self.synthetic, dict(self.more)))

    def as_dict(self) -> dict[str, object]:
        """Return everything in one flat dictionary."""
        flat = {name: getattr(self, name) for name in ("participant", "condition", "source", "synthetic")}
        return flat | dict(self.more)


def _row(k: int) -> str:
    return f"row {k}"


def check_time(
    t: np.ndarray, source: str | None = None, place: Callable[[int], str] = _row, uniform: bool = True
) -> float:
    """
    Return the sample time of a uniform time axis.

    Parameters
    ----------
    t : array_like, shape (N,)
        Times [s]; at least two.
    source : str, optional
        The file, for the error.
    place : callable
        Names the place of sample k in the file ("line 7"), for the error.
    uniform : bool
        Whether irregular sampling is a fault, which it is not before resampling.

    Raises
    ------
    SessionError
        If a time is not finite, repeats, runs backwards, or a step differs from the median step by more than
        STEP_TOLERANCE of it.
    """
    t = np.asarray(t, dtype=float)
    if t.ndim != 1 or t.size < 2:
        raise SessionError(f"a session needs at least two samples, found {t.size}", source)
    if not np.isfinite(t).all():
        k = int(np.argmax(~np.isfinite(t)))
        raise SessionError(f"{place(k)}, column t: time is {t[k]}; every row needs a time", source, row=k)
    with np.errstate(over="ignore"):
        steps = np.diff(t)
    if not (steps > 0.0).all():
        k = int(np.argmax(steps <= 0.0)) + 1
        what = "repeats" if steps[k - 1] == 0.0 else "runs backwards"
        raise SessionError(
            f"{place(k)}, column t: time {what} ({t[k - 1]} s, then {t[k]} s); "
            "sort or split the log where this happens",
            source,
            row=k,
        )
    step = float(np.median(steps))
    if not uniform:
        return step
    with np.errstate(over="ignore", invalid="ignore"):
        off = np.abs(steps - step) > STEP_TOLERANCE * step
    if not np.isfinite(step) or off.any():
        k = int(np.argmax(off)) + 1
        raise SessionError(
            f"{place(k)}, column t: sampling is irregular (a step of {steps[k - 1]:.6g} s at t = {t[k]:.6g} s, "
            f"the median step is {step:.6g} s; {int(off.sum())} of {steps.size} steps are off by more than "
            f"{STEP_TOLERANCE:.0%}); ask for resampling by name, for example "
            f'read_session(..., resample="linear", sample_time={step:.3g})',
            source,
            row=k,
        )
    return step


def check_columns(data: pd.DataFrame, source: str | None = None, place: Callable[[int], str] = _row) -> None:
    """
    Check names, types, gaps and ranges of a session's columns.

    Parameters
    ----------
    data : pandas.DataFrame
        The columns, indexed by time.
    source : str, optional
        The file, for the error.
    place : callable
        Names the place of sample k in the file ("line 7"), for the error.

    Raises
    ------
    SessionError
        Naming column, row and time of the first fault.
    """
    if data.columns.has_duplicates:
        twice = data.columns[data.columns.duplicated()][0]
        raise SessionError(f"column {twice!r} is there twice; rename or remove one", source)
    for name in data.columns:
        if name not in VOCABULARY:
            raise SessionError(
                f"column {name!r} is not in the vocabulary{nearest(name, VOCABULARY) or '.'} "
                "Map it with a recipe, leave it out, or see trustlab.sessions.vocabulary()",
                source,
            )
        values = data[name].to_numpy()
        if values.dtype.kind not in "fiub":
            raise SessionError(f"column {name!r} must hold numbers, found {values.dtype}", source)
        values = values.astype(float)
        column = VOCABULARY[name]
        bad = ~np.isfinite(values)
        why = "is missing or not finite; fill or cut it before reading, by a rule you can name"
        if not bad.any():
            low = -np.inf if column.low is None else column.low
            high = np.inf if column.high is None else column.high
            bad = (values < low) | (values > high)
            why = (
                f"lies outside [{low:g}, {high:g}] ({column.meaning}); correct it, or scale it with a recipe"
            )
        if bad.any():
            k = int(np.argmax(bad))
            raise SessionError(
                f"{place(k)}, column {name!r}, t = {data.index[k]:.6g} s: {values[k]} {why}", source, row=k
            )


@dataclass(frozen=True, eq=False)
class Session:
    """
    One logged run on a uniform time axis.

    Parameters
    ----------
    data : pandas.DataFrame
        One row per sample, indexed by time t [s]; columns from `trustlab.sessions.vocabulary()`, in SI units.
    metadata : Metadata, optional
        Participant, condition, source, synthetic or not, and whatever else is known.

    Raises
    ------
    SessionError
        If time is not uniform, a column is unknown, or a value is missing or out of range; the error names
        column, row and time.

    Examples
    --------
    >>> import pandas as pd
    >>> frame = pd.DataFrame({"mode": [1, 1, 0], "p_r": [0.30, 0.31, 0.31]}, index=[0.0, 0.1, 0.2])
    >>> Session(frame).sample_time
    0.1
    """

    data: pd.DataFrame
    metadata: Metadata = field(default_factory=Metadata)

    def __post_init__(self):
        source = self.metadata.source
        data = self.data
        if not isinstance(data, pd.DataFrame):
            raise SessionError(
                f"data must be a pandas DataFrame indexed by time, got {type(data).__name__}", source
            )
        if data.index.name != "t" and "t" in data.columns:
            data = data.set_index("t")
        if data.index.dtype.kind not in "fiu":
            raise SessionError(f"the index must be time in seconds, found {data.index.dtype}", source)
        check_time(data.index.to_numpy(), source)
        if data.shape[1] == 0:
            raise SessionError("a session needs at least one column besides t", source)
        check_columns(data, source)
        data = data.astype(float)
        data.index = pd.Index(data.index.to_numpy(dtype=float), name="t")
        data.columns.name = None
        object.__setattr__(self, "data", data)

    def __eq__(self, other):
        if not isinstance(other, Session):
            return NotImplemented
        mine, theirs = self.metadata.as_dict(), other.metadata.as_dict()
        mine.pop("source"), theirs.pop("source")
        return mine == theirs and self.data.sort_index(axis=1).equals(other.data.sort_index(axis=1))

    __hash__ = None

    def __len__(self) -> int:
        return len(self.data)

    def __contains__(self, name: str) -> bool:
        return name in self.data.columns

    def __getitem__(self, name: str) -> np.ndarray:
        """Return one column, or "t", as an array of shape (N,)."""
        if name == "t":
            return self.t
        self.require(name)
        return self.data[name].to_numpy()

    @property
    def t(self) -> np.ndarray:
        """Time [s], shape (N,)."""
        return self.data.index.to_numpy()

    @property
    def sample_time(self) -> float:
        """Time between samples [s], to the nanosecond."""
        return round(float((self.t[-1] - self.t[0]) / (len(self) - 1)), 9)

    @property
    def duration(self) -> float:
        """Time from the first sample to the last [s]."""
        return float(self.t[-1] - self.t[0])

    @property
    def columns(self) -> list[str]:
        """The columns there are."""
        return list(self.data.columns)

    @property
    def label(self) -> str:
        """Who, what and whether synthetic, in a few words, for captions."""
        meta = self.metadata
        parts = [f"participant {meta.participant}" if meta.participant is not None else ""]
        parts.append(str(meta.condition) if meta.condition is not None else "")
        parts.append("synthetic" if meta.synthetic else "")
        return ", ".join(part for part in parts if part) or (meta.source or "session")

    def require(self, *names: str) -> None:
        """
        Raise unless every named column is there.

        Parameters
        ----------
        *names : str
            Columns of the vocabulary.

        Raises
        ------
        SessionError
            Naming what is missing, the nearest column there is, and what there is.
        """
        missing = [name for name in names if name not in self.data.columns]
        if missing:
            raise SessionError(
                f"{self.label} has no column {missing[0]!r}{nearest(missing[0], self.columns)} "
                f"(it has: {', '.join(self.columns)}; needed: {', '.join(names)})",
                self.metadata.source,
            )

    def with_columns(self, **columns: np.ndarray) -> Session:
        """
        Return a session with columns added or replaced.

        Parameters
        ----------
        **columns : array_like, shape (N,)
            Names of the vocabulary and their samples.
        """
        return Session(self.data.assign(**columns), self.metadata)

    def with_metadata(self, **changes: object) -> Session:
        """
        Return a session with metadata added or replaced.

        Parameters
        ----------
        **changes : object
            participant, condition, source, synthetic, or any other name, which goes to `metadata.more`.
        """
        own = {
            name: changes.pop(name)
            for name in ("participant", "condition", "source", "synthetic")
            if name in changes
        }
        return Session(self.data, replace(self.metadata, **own, more={**self.metadata.more, **changes}))

    def between(self, start: float, stop: float) -> Session:
        """
        Return the part of the session with start ≤ t ≤ stop.

        Parameters
        ----------
        start, stop : float
            Times [s].
        """
        return Session(self.data.loc[start:stop], self.metadata)

    def with_performance(
        self, window: float = 100.0, measure: str = "ground_robot", **scales: float
    ) -> Session:
        """
        Return the session with measured performance, columns p_r and p_h, as means over a moving window.

        Parameters
        ----------
        window : float
            Length W of the window [s]; a session shorter than it, and its beginning, use what there is.
        measure : {"ground_robot", "uav_tracking", "mixed_initiative"}
            (2.4) and (2.7); the UAV variants of Section 2.4.2; or (3.26)-(3.27).
        **scales : float
            The normalising constants of the measure; see `trustlab.sessions.metrics`.

        Raises
        ------
        SessionError
            If a column the measure needs is missing.
        """
        from trustlab.sessions.metrics import with_performance

        return with_performance(self, window=window, measure=measure, **scales)

    def table(self) -> pd.DataFrame:
        """Return the data with time as a column."""
        return self.data.reset_index()

    def plot(self, columns: list[str] | None = None):
        """
        Plot columns against time, manual phases shaded.

        Parameters
        ----------
        columns : list of str, optional
            What to plot, one panel each; the performances, or all there is, when not given.

        Returns
        -------
        numpy.ndarray of matplotlib.axes.Axes
        """
        from trustlab.sessions.plots import plot_session

        return plot_session(self, columns)

    def _repr_html_(self) -> str:
        head = f"<b>Session</b>: {self.label}; {len(self)} samples at {self.sample_time:g} s"
        return f"<p>{head}</p>{self.data.describe().T.to_html(float_format='%.4g')}"

    def __repr__(self) -> str:
        return f"Session({self.label}: {len(self)} samples at {self.sample_time:g} s, columns {', '.join(self.columns)})"
