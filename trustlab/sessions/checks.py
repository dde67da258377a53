"""What makes a table a session: uniform time, columns of the vocabulary, no gaps, values in range."""

from collections.abc import Callable

import numpy as np

from trustlab.models.checks import did_you_mean
from trustlab.sessions.errors import SessionError
from trustlab.sessions.vocabulary import VOCABULARY

# How far a time step may differ from the median step, as a share of it, before sampling counts as irregular.
STEP_TOLERANCE = 0.01


def check_rising(t: np.ndarray, place: Callable[[int], str] = "row {}".format, remedy: str = "") -> np.ndarray:
    """Return the steps of a time axis [s]; raise at the first time that is not finite, repeats or runs backwards."""
    if not np.isfinite(t).all():
        k = int(np.argmax(~np.isfinite(t)))
        raise SessionError(f"{place(k)}, column t: time is {t[k]}; every row needs a time", row=k)
    with np.errstate(over="ignore"):
        steps = np.diff(t)
    if not (steps > 0.0).all():
        k = int(np.argmax(steps <= 0.0)) + 1
        what = "repeats" if steps[k - 1] == 0.0 else "runs backwards"
        found = f"{place(k)}, column t: time {what} ({t[k - 1]} s, then {t[k]} s)"
        raise SessionError(f"{found}; {remedy}sort or split the log where this happens", row=k)
    return steps


def check_time(t: np.ndarray, place: Callable[[int], str] = "row {}".format, remedy: str = "") -> None:
    """Raise where a time axis does not rise uniformly, within STEP_TOLERANCE."""
    t = np.asarray(t, dtype=float)
    if t.ndim != 1 or t.size < 2:
        raise SessionError(f"a session needs at least two samples, found {t.size}")
    steps = check_rising(t, place, remedy)
    with np.errstate(over="ignore", invalid="ignore"):
        # Where the longest and the shortest step are as near as that, no step is off, and a long log needs no median.
        if steps.max() - steps.min() <= STEP_TOLERANCE * steps.min():
            return
        step = float(np.median(steps))
        off = np.abs(steps - step) > STEP_TOLERANCE * step
    if not np.isfinite(step) or off.any():
        k = int(np.argmax(off)) + 1
        raise SessionError(
            f"{place(k)}, column t: sampling is irregular (a step of {steps[k - 1]:.6g} s at t = {t[k]:.6g} s, "
            f"the median step is {step:.6g} s; {int(off.sum())} of {steps.size} steps are off by more than "
            f"{STEP_TOLERANCE:.0%}); ask for resampling by name, for example "
            f'read_session(..., resample="linear", sample_time={step:.3g})',
            row=k,
        )


def check_column(
    name: str, values: np.ndarray, t: np.ndarray, place: Callable[[int], str] = "row {}".format
) -> np.ndarray:
    """Return a column as floats; raise if its name is unknown, or at its first value that is missing or out of range."""
    if name not in VOCABULARY:
        remedy = "map it with a recipe, leave it out, or see trustlab.sessions.vocabulary()"
        hint = did_you_mean(name, VOCABULARY)
        raise SessionError(f"column {name!r} is not in the vocabulary{hint} ({remedy})")
    values = np.asarray(values)
    if values.dtype.kind not in "fiub":
        raise SessionError(f"column {name!r} must hold numbers, found {values.dtype}")
    values = np.asarray(values, dtype=float)
    column = VOCABULARY[name]
    low = -np.inf if column.low is None else column.low
    high = np.inf if column.high is None else column.high
    least, most = (values.min(), values.max()) if values.size else (0.0, 0.0)  # both NaN where any value is
    if np.isfinite([least, most]).all() and low <= least and most <= high:
        return values
    bad = ~np.isfinite(values)
    why = "is missing or not finite; fill it or cut it out before reading, by a rule that you state"
    if not bad.any():
        bad = (values < low) | (values > high)
        why = f"lies outside [{low:g}, {high:g}] ({column.meaning}); correct it, or scale it with a recipe"
        if column.unit == "m" and low == 0.0:
            why += "; a signed deviation becomes a distance with absolute = true in the recipe's column"
    k = int(np.argmax(bad))
    raise SessionError(f"{place(k)}, column {name!r}, t = {t[k]:.6g} s: {values[k]} {why}", row=k)
