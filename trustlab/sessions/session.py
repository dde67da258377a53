"""One logged run: its metadata, the table that everything else reads, and the checks of both."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from numbers import Real
from types import NoneType
from typing import Any

import numpy as np
import pandas as pd

from trustlab.models.checks import of_class, shown
from trustlab.models.display import Result, as_html
from trustlab.sessions.errors import SessionError, alternatives, source_named
from trustlab.sessions.vocabulary import known_column

# Metadata with a name of their own, and the types that a file may give them; all else goes to
# `more`.
FIELDS = {
    "participant": (str, int, float, NoneType),
    "condition": (str, int, float, NoneType),
    "source": (str, NoneType),
    "synthetic": (bool,),
}

# How far a time step may differ from the median step, as a share of it, before sampling counts as
# irregular.
STEP_TOLERANCE = 0.01

# Times that do not rise, and what to do about them.
BACKWARDS = (
    "runs backwards",
    "if the rows are out of order, a recipe sorts them ([time] sort = true); if the clock was set "
    'back, it splits the log there ([time] jumps = "split")',
)
REPEATS = ("repeats", 'a recipe merges such rows ([time] repeated = "first", "last" or "mean")')

# What to do about a missing column, by the beginning of its name.
REMEDIES = {
    "p_": "; where the log has performance under another name, its recipe says so; "
    "session.with_performance(…) computes p_r and p_h from the motion",
    "step_": '; other measures: "uav_tracking", "mixed_initiative"; add one of your own by '
    "with_columns",
    "u_": "; where positions are commanded, they are the commands: "
    "session.with_columns(u_h_x=session['human_x'], …)",
}


@dataclass(frozen=True)
class Metadata:
    """
    What a session says about itself.

    Parameters
    ----------
    participant : str, int or None
        Who took part.
    condition : str, int, float or None
        The experimental condition, for example "C1".
    source : str or None
        The file or the generator that the session came from.
    synthetic : bool
        True when the data were simulated; every figure and table made from them says so.
    more : mapping
        Whatever else the log names (trial, block, autonomy …): names to plain values.

    Examples
    --------
    >>> import trustlab as tl
    >>> metadata = tl.Metadata(participant=3, condition="C1", more={"trial": 2})
    >>> metadata.changed(condition="C2", site="north wing").more
    {'trial': 2, 'site': 'north wing'}
    """

    participant: str | int | None = None
    condition: str | int | float | None = None
    source: str | None = None
    synthetic: bool = False
    more: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self):
        for name, kinds in FIELDS.items():
            value = getattr(self, name)
            value = value.item() if isinstance(value, np.generic) else value
            if not isinstance(value, kinds) or value != value:
                words = " or ".join("None" if kind is NoneType else kind.__name__ for kind in kinds)
                raise SessionError(f"{name} must be {words}, got {shown(value)}")
            object.__setattr__(self, name, value)
        if not isinstance(self.more, Mapping):
            raise SessionError(f"more must be a mapping of names to values, got {shown(self.more)}")
        object.__setattr__(self, "more", dict(self.more))

    def changed(self, **changes: Any) -> Metadata:
        """
        Return metadata with entries added or replaced.

        Parameters
        ----------
        **changes : object
            participant, condition, source, synthetic, or any other name, which goes to `more`.
        """
        fields = {name: changes.pop(name) for name in FIELDS if name in changes}
        return replace(self, **fields, more={**self.more, **changes})

    def as_dict(self) -> dict[str, object]:
        """Return everything in one flat dictionary."""
        return {name: getattr(self, name) for name in FIELDS} | dict(self.more)


def metadata_to_json(metadata: Metadata, **extra: object) -> str:
    """Return metadata (but the source) and extra entries as JSON that reads back the same."""
    content = {name: getattr(metadata, name) for name in FIELDS if name != "source"}
    for name, value in [*content.items(), *metadata.more.items()]:
        try:
            again = json.loads(json.dumps({name: value}, default=np.generic.item))
            if again != {name: value}:
                raise ValueError
        except (TypeError, ValueError, RecursionError):  # ValueError also where != gives an array
            raise SessionError(
                f"metadata {name!r} would not read back the same: {shown(value)}; use plain "
                "numbers, texts, lists or dictionaries with text keys"
            ) from None
    return json.dumps(content | {"more": metadata.more} | extra, default=np.generic.item)


def metadata_from_json(text: str) -> tuple[Metadata, dict]:
    """Return the metadata written by `metadata_to_json`, and what else was written there."""
    try:
        content = json.loads(text)
        facts = {name: content.pop(name) for name in FIELDS if name in content}
        return Metadata(**facts, more=content.pop("more", {})), content
    except (AttributeError, TypeError, ValueError, RecursionError) as error:
        raise SessionError(
            f"the trustlab metadata are damaged ({error}); write the file again"
        ) from error


@dataclass(frozen=True, eq=False, repr=False)
class Session(Result):
    """
    One logged run on a uniform time axis.

    Parameters
    ----------
    data : pandas.DataFrame
        One row per sample, indexed by time t [s]; columns from `trustlab.sessions.vocabulary()`, in
        SI units.
    metadata : Metadata, optional
        Participant, condition, source, synthetic or not, and whatever else is known.

    Raises
    ------
    SessionError
        If time is not uniform, a column is unknown, or a value is missing or out of range; the
        error names column, row and time.

    Examples
    --------
    >>> import trustlab as tl
    >>> import pandas as pd
    >>> frame = pd.DataFrame({"mode": [1, 1, 0], "p_r": [0.30, 0.31, 0.31]}, index=[0.0, 0.1, 0.2])
    >>> tl.Session(frame).sample_time
    0.1
    """

    how_to_get = (
        "read one with trustlab.read_session(path) or make one with trustlab.Session(frame)"
    )

    data: pd.DataFrame
    metadata: Metadata = field(default_factory=Metadata)

    def __post_init__(self):
        example = "for example trustlab.Metadata(participant=3, condition='C1', more={'trial': 2})"
        of_class("metadata", self.metadata, Metadata, example)
        of_class("data", self.data, pd.DataFrame)
        with source_named(self.metadata.source):
            t, columns = _checked(self.data)
        object.__setattr__(
            self, "data", pd.DataFrame(columns, index=pd.Index(t, name="t"), copy=True)
        )
        # A part of a session has facts of its own to add to.
        object.__setattr__(self, "metadata", replace(self.metadata))

    def __eq__(self, other):
        if not isinstance(other, Session):
            return NotImplemented
        first, second = self.metadata.as_dict(), other.metadata.as_dict()
        first.pop("source")
        second.pop("source")
        columns = self.data.sort_index(axis=1)
        return first == second and columns.equals(other.data.sort_index(axis=1))

    __hash__ = None

    # As for a DataFrame, `in`, iteration and keys() are about the names of the columns, and len()
    # about the samples.

    def __len__(self) -> int:
        return len(self.data)

    def __contains__(self, name: object) -> bool:
        return name in self.keys()

    def __iter__(self) -> Iterator[str]:
        return iter(self.keys())

    def keys(self) -> list[str]:
        """Return the names that `session[name]` accepts: "t" and the columns."""
        return ["t", *self.columns]

    def __getitem__(self, name: str) -> np.ndarray:
        """Return one column, or "t", as an array of shape (N,)."""
        if not isinstance(name, str):
            raise SessionError(
                f"a session is indexed by a column's name, got {shown(name)}; its table is .data"
            )
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
        """The names of the columns."""
        return list(self.data.columns)

    @property
    def label(self) -> str:
        """Participant (operator where data are synthetic), condition and trial, for captions."""
        meta = self.metadata
        facts = {
            "operator" if meta.synthetic else "participant": meta.participant,
            "" if isinstance(meta.condition, str) else "condition": meta.condition,
            "trial": meta.more.get("trial"),
        }
        parts = [f"{name} {value}".strip() for name, value in facts.items() if value is not None]
        parts += ["synthetic"] * meta.synthetic
        return ", ".join(parts) or meta.source or "session"

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
            It names the missing column, the nearest existing one, and all columns of the session.
        """
        for name in map(str, names):
            if name not in self.keys():
                source = self.metadata.source
                title = "the session" if self.label == source else self.label
                needed = f"needed: {', '.join(map(str, names))}; it has"
                hint = alternatives(name, self.columns, needed)
                remedies = [words for start, words in REMEDIES.items() if name.startswith(start)]
                raise SessionError(
                    f"{title} has no column {name!r}{hint}{''.join(remedies)}", source
                )

    def with_columns(self, **columns: np.ndarray) -> Session:
        """
        Return a session with columns added or replaced.

        Metadata stay: where other p_r and p_h are no means over a window as the old ones were, say
        so by ``with_metadata(performance_window=0.0)``.

        Parameters
        ----------
        **columns : array_like, shape (N,)
            Names of the vocabulary and their samples.

        Raises
        ------
        SessionError
            If a column has another number of samples than the session, or does not fit it.
        """
        # By place: a Series with an index of its own would be ordered by that.
        arrays = {name: np.asarray(values) for name, values in columns.items()}
        for name, values in arrays.items():
            if values.shape not in ((), (len(self),)):
                raise SessionError(
                    f"column {name!r} is of shape {values.shape}, but the session has {len(self)} "
                    "samples",
                    self.metadata.source,
                )
        return Session(self.data.assign(**arrays), self.metadata)

    def with_metadata(self, **changes: Any) -> Session:
        """
        Return a session with metadata added or replaced.

        Parameters
        ----------
        **changes : object
            participant, condition, source, synthetic, or any other name, which goes to
            `metadata.more`.
        """
        return Session(self.data, self.metadata.changed(**changes))

    def between(self, start: float, stop: float) -> Session:
        """
        Return the part of the session with start ≤ t ≤ stop.

        Parameters
        ----------
        start, stop : float
            Times [s].

        Raises
        ------
        SessionError
            If start is not before stop, or fewer than two samples lie between.
        """
        if not (isinstance(start, Real) and isinstance(stop, Real) and start < stop):
            raise SessionError(
                f"start and stop must be times [s], start first, got {shown(start)} and "
                f"{shown(stop)}"
            )
        first, last = self.t[[0, -1]].tolist()
        slack = 1e-6 * self.sample_time  # rounding of times that were computed
        part = self.data.loc[max(start, first) - slack : min(stop, last) + slack]
        if len(part) < 2:
            raise SessionError(
                f"no two samples lie between {start} s and {stop} s; the session runs from "
                f"{first:g} s to {last:g} s",
                self.metadata.source,
            )
        cut = Session(part, self.metadata)
        # A window mean needs what lies before it: fits must know that these do not begin where the
        # averaging did.
        averaged = "performance_window" in self.metadata.more and {"p_r", "p_h"} & {*self.columns}
        late = averaged and part.index[0] > self.data.index[0]
        return cut.with_metadata(performance_cut=True) if late else cut

    def with_performance(
        self, window: float = 100.0, measure: str = "ground_robot", **scales: Any
    ) -> Session:
        """
        Return the session with measured performance p_r and p_h, as moving means.

        Parameters
        ----------
        window : float
            Length W of the window [s]; at the beginning, and in a shorter session, the mean is over
            the samples so far.
        measure : {"ground_robot", "uav_tracking", "mixed_initiative"}
            (2.4) and (2.7); the UAV variants of Section 2.4.2; or (3.26)-(3.27).
        **scales : float or str
            e_max, the deviation from the path that counts as 0 [m] (2 m for "ground_robot"), u_max,
            that of a command, and axes, for example "yz"; see `trustlab.sessions.metrics` for these
            and for the columns that each measure needs.

        Raises
        ------
        SessionError
            If a column that the measure needs is missing.
        """
        from trustlab.sessions.metrics import with_performance

        return with_performance(self, window=window, measure=measure, **scales)

    def table(self) -> pd.DataFrame:
        """Return the data with time as a column."""
        return self.data.reset_index()

    def plot(self, columns: str | list[str] | None = None):
        """
        Plot columns against time, manual phases shaded.

        Parameters
        ----------
        columns : str or list of str, optional
            What to plot, one panel each; by default p_r, p_h and r, or all columns if there is none
            of these.

        Returns
        -------
        numpy.ndarray of matplotlib.axes.Axes
        """
        from trustlab.sessions.plots import plot_session

        return plot_session(self, columns)

    title = "Session"

    @property
    def message(self) -> str:
        """Whose session it is, how it was sampled, and what it holds."""
        more = ", ".join(map(str, self.metadata.more))
        return (
            f"{self.label}; {len(self)} samples at {self.sample_time:g} s; columns "
            f"{', '.join(self.columns)}{'; metadata.more: ' * bool(more)}{more}"
        )

    def _repr_html_(self) -> str:
        # Thousands of rows say less than their summary.
        return as_html(self.message, self.data.describe().T, title=self.title)


Place = Callable[[int], str]
ROW = "row {}".format


def keep_table(data: pd.DataFrame, metadata: Metadata, place: Place = ROW) -> Session:
    """Return the session of a table that nobody else holds: checked, and not copied."""
    _checked(data, place)
    session = object.__new__(Session)
    vars(session).update(data=data, metadata=metadata)
    return session


def _checked(data: pd.DataFrame, place: Place = ROW) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Return the times and the columns of a session's table, every value checked."""
    if data.index.name != "t" and "t" in data.columns:
        data = data.set_index("t")
    if isinstance(data.index, pd.RangeIndex) and data.index.name != "t":
        raise SessionError(
            "the rows are numbered, not timed; name the column of times [s] 't', or set it as the "
            'index: frame.set_index("t")'
        )
    if data.index.dtype.kind not in "fiu":
        raise SessionError(f"the index must be time in seconds, found {data.index.dtype}")
    t = data.index.to_numpy(dtype=float)
    check_uniform(t, place)
    if data.shape[1] == 0:
        raise SessionError("a session needs at least one column besides t")
    if data.columns.has_duplicates:
        twice = data.columns[data.columns.duplicated()][0]
        raise SessionError(f"column {twice!r} occurs twice; rename or remove one")
    return t, {name: check_column(name, data[name].to_numpy(), t, place) for name in data.columns}


def check_rising(t: np.ndarray, place: Place = ROW) -> np.ndarray:
    """Return the time steps [s]; raise where a time is not finite, repeats or runs backwards."""
    if not np.isfinite(t).all():
        k = int(np.argmax(~np.isfinite(t)))
        raise SessionError(f"{place(k)}, column t: time is {t[k]}; every row needs a time")
    with np.errstate(over="ignore"):
        steps = np.diff(t)
    if not (steps > 0.0).all():
        k = int(np.argmax(steps <= 0.0)) + 1
        fault, remedy = BACKWARDS if steps[k - 1] < 0.0 else REPEATS
        raise SessionError(
            f"{place(k)}, column t: time {fault} ({t[k - 1]} s, then {t[k]} s); {remedy}"
        )
    return steps


def check_uniform(t: np.ndarray, place: Place = ROW) -> None:
    """Raise where a time axis does not rise uniformly, within STEP_TOLERANCE."""
    if t.size < 2:
        raise SessionError(f"a session needs at least two samples, found {t.size}")
    steps = check_rising(t, place)
    least = steps.min()
    if steps.max() - least <= STEP_TOLERANCE * least:  # then none is farther from the median
        return
    with np.errstate(over="ignore", invalid="ignore"):
        step = float(np.median(steps))
        off = np.abs(steps - step) > STEP_TOLERANCE * step
    if not np.isfinite(step) or off.any():
        k = int(np.argmax(off)) + 1
        raise SessionError(
            f"{place(k)}, column t: sampling is irregular "
            f"(a step of {steps[k - 1]:.6g} s at t = {t[k]:.6g} s, "
            f"the median step is {step:.6g} s; "
            f"{int(off.sum())} of {steps.size} steps are off by more than {STEP_TOLERANCE:.0%}); "
            "ask for resampling by name, for example "
            f'read_session(..., resample="linear", sample_time={step:.3g}), or by the lines '
            f'[resampling], method = "linear" and sample_time = {step:.3g} of a recipe'
        )


def check_column(name: str, values: np.ndarray, t: np.ndarray, place: Place = ROW) -> np.ndarray:
    """Return a column as floats; raise at its first value that is missing or out of range."""
    column = known_column(name)
    if values.dtype.kind not in "fiub":
        raise SessionError(f"column {name!r} must hold numbers, found {values.dtype}")
    values = np.asarray(values, dtype=float)
    low = -np.inf if column.low is None else column.low
    high = np.inf if column.high is None else column.high
    # Both are NaN where any value is.
    least, most = values.min(), values.max()
    if np.isfinite([least, most]).all() and low <= least and most <= high:
        return values
    bad = ~np.isfinite(values)
    why = (
        "is missing or not finite; fill it, cut it out, or let a rule of a recipe fill it "
        '(blank = "hold" or "linear")'
    )
    if not bad.any():
        bad = (values < low) | (values > high)
        why = (
            f"lies outside [{low:g}, {high:g}] ({column.meaning}); correct it, or let a recipe "
            "scale it or divide it in two (scale, above)"
        )
        if column.unit == "m":
            why += "; a signed deviation becomes a distance with absolute = true in its column"
    k = int(np.argmax(bad))
    raise SessionError(f"{place(k)}, column {name!r}, t = {t[k]:.6g} s: {values[k]} {why}")
