"""What makes a table a session: uniform time, known columns, no gaps, values in range."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pandas as pd

from trustlab.sessions.errors import SessionError, nearest
from trustlab.sessions.vocabulary import VOCABULARY

__all__ = ["STEP_TOLERANCE", "check_columns", "check_time"]

STEP_TOLERANCE = 0.01
"""How far a time step may lie from the median step, as a share of it, before sampling counts as irregular."""


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
            if column.unit == "m" and low == 0.0:
                why += "; a signed deviation becomes a distance with absolute = true in the recipe's column"
        if bad.any():
            k = int(np.argmax(bad))
            raise SessionError(
                f"{place(k)}, column {name!r}, t = {data.index[k]:.6g} s: {values[k]} {why}", source, row=k
            )
