"""
Checks on arguments that all rooms share: each names the argument, what was found, and what is
allowed.

Every check returns the value in the type that the caller works with, and raises `ValueError`
otherwise.
"""

import difflib
import math
import sys
import warnings
from collections.abc import Callable, Iterable, Mapping
from dataclasses import fields
from functools import cache, partial
from numbers import Integral, Real
from typing import Annotated, Any, TypeVar, get_args

import numpy as np

Kind = TypeVar("Kind")
# What random streams are spawned from.
Seed = int | np.random.SeedSequence


def shown(value: object) -> str:
    """Return the text of a value for an error message, shortened to 60 characters."""
    try:
        text = repr(value)
    except ValueError:  # Python refuses to print integers of more than 4,300 digits
        text = "a number of very many digits"
    return text if len(text) <= 60 else f"{text[:57]}…"


def warn(message: str, category: type[Warning] = UserWarning) -> None:
    """
    Warn at the user's line, the first outside trustlab, however deep inside it the reason was
    found.
    """
    frame, level = sys._getframe(1), 2
    # numpy.errstate calls what it decorates.
    inside = ("trustlab.", "contextlib", "numpy.")
    while frame and frame.f_globals.get("__name__", "").startswith(inside):
        frame, level = frame.f_back, level + 1
    warnings.warn(message, category, stacklevel=level)


def did_you_mean(name: object, known: Iterable[object]) -> str:
    """Return "; did you mean …?" for a misspelt name, or nothing when no known name is close."""
    words = {str(word).lower(): str(word) for word in known}
    meant = str(name)[:100].lower()
    close = [word for word in words if word.endswith(f"_{meant}")]
    close = close or difflib.get_close_matches(meant, list(words), n=1, cutoff=0.6)
    return (
        f"; did you mean {' or '.join(repr(words[word]) for word in close[:2])}?" if close else ""
    )


def rounded_down(value: float, digits: int = 3) -> float:
    """Return a number with few digits, not above it: for a remedy that says "at most"."""
    unit = 10.0 ** (math.floor(math.log10(abs(value))) + 1 - digits)
    return float(f"{math.floor(value / unit) * unit:.{digits}g}")


def rounded_up(value: float, digits: int = 3) -> float:
    """Return a number with few digits, not below it: for a remedy that says "at least"."""
    return -rounded_down(-value, digits)


def counted(count: int, noun: str) -> str:
    """Return "1 participant" or "2 participants"."""
    return f"{count} {noun}{'' if count == 1 else 's'}"


def finite_number(name: str, value: Any) -> float:
    """Return one finite real number as a float; text, booleans and arrays are refused."""
    if isinstance(value, float) and math.isfinite(value):  # nearly always; the rest takes longer
        return float(value)  # NumPy's floats are Python's, too
    if isinstance(value, np.ndarray):
        value = value[()]  # a scalar, where it has no dimensions
    try:
        if isinstance(value, bool | np.bool_ | str | bytes) or np.ndim(value) > 0:
            raise TypeError
        number = float(value)
    except (TypeError, ValueError, OverflowError, RuntimeError):
        raise ValueError(f"{name} must be a number, got {shown(value)}") from None
    if not math.isfinite(number):
        raise ValueError(f"{name} must be finite, got {number}")
    return number


def positive(name: str, value: Any) -> float:
    """Return a number above 0 as a float."""
    number = finite_number(name, value)
    if not number > 0.0:
        raise ValueError(f"{name} must be positive, got {number}")
    return number


def not_negative(name: str, value: Any) -> float:
    """Return a number of 0 or more as a float."""
    number = finite_number(name, value)
    if number < 0.0:
        raise ValueError(f"{name} must not be negative, got {number}")
    return number


def between(name: str, value: Any, low: float, high: float) -> float:
    """Return a number in the closed interval [low, high] as a float."""
    number = finite_number(name, value)
    if not low <= number <= high:
        raise ValueError(f"{name} must lie in [{low:g}, {high:g}], got {number}")
    return number


def in_order(low_name: str, low: Any, high_name: str, high: Any) -> tuple[float, float]:
    """Return two finite numbers as floats, the first below the second."""
    low, high = finite_number(low_name, low), finite_number(high_name, high)
    if not low < high:
        raise ValueError(
            f"{low_name} must be below {high_name}, got {low_name} = {low} and {high_name} = {high}"
        )
    return low, high


def open_unit(name: str, value: Any) -> float:
    """Return a number strictly between 0 and 1 as a float."""
    number = finite_number(name, value)
    if not 0.0 < number < 1.0:
        raise ValueError(f"{name} must lie strictly between 0 and 1, got {number}")
    return number


def whole_number(name: str, value: Any, least: int = 1, most: int | None = None) -> int:
    """
    Return a whole number from `least` to `most` as an int; a float counts where it is whole and
    below 2⁵³.
    """
    if type(value) is int and least <= value <= (value if most is None else most):
        return value  # nearly always; the rest takes longer
    if isinstance(value, np.ndarray):
        value = value[()]
    whole = not isinstance(value, bool | np.bool_) and (
        isinstance(value, Integral)
        or (isinstance(value, Real) and abs(float(value)) < 2.0**53 and float(value).is_integer())
    )
    if not whole or value < least or (most is not None and value > most):
        allowed = f"{least} or more" if most is None else f"from {least} to {most}"
        raise ValueError(f"{name} must be a whole number, {allowed}, got {shown(value)}")
    return int(value)


def whole_seed(value: Any, most: int | None = None) -> int:
    """Return a seed as an int; None, which other numbers would follow each time, is refused."""
    if value is None:
        raise ValueError("seed must be a whole number, 0 or more, got None; pass seed=0")
    return whole_number("seed", value, 0, most)


def flag(name: str, value: Any) -> bool:
    """Return True or False; nothing else counts as either."""
    if not isinstance(value, bool | np.bool_):
        raise ValueError(f"{name} must be True or False, got {shown(value)}")
    return bool(value)


def function(name: str, value: Any) -> Callable:
    """Return a function, or an object that can be called; a class makes objects only."""
    if not callable(value) or isinstance(value, type):
        raise ValueError(f"{name} must be a function, got {shown(value)}")
    return value


def text_of(name: str, value: Any) -> str:
    """Return a text."""
    if not isinstance(value, str):
        raise ValueError(f"{name} must be a text, got {shown(value)}")
    return value


def list_of(name: str, values: Any) -> list:
    """Return what a user gives in a list, or in another order, as a list."""
    if isinstance(values, str) or not np.iterable(values):
        raise ValueError(f"{name} must be a list, got {shown(values)}")
    return list(values)


def table_of(name: str, value: Any) -> Mapping:
    """Return a mapping, such as a dict."""
    if not isinstance(value, Mapping):
        raise ValueError(f"{name} must be a mapping, got {shown(value)}")
    return value


def one_of(name: str, value: Any, allowed: Iterable[str], also: str = "") -> str:
    """
    Return a word that is among those allowed; the error names `also` as well, what else an argument
    may be.
    """
    allowed = list(allowed)
    if isinstance(value, str) and value in allowed:
        return value
    words = ", ".join(map(repr, allowed)) + (f", or {also}" if also else "")
    hint = did_you_mean(value, allowed) if isinstance(value, str) else ""
    raise ValueError(f"{name} must be one of {words}, got {shown(value)}{hint}")


def named(name: str, value: Any, kind: type[Kind], table: Mapping[str, Kind]) -> Kind:
    """Return an object by its name in a table, or one of one's own as it is."""
    if isinstance(value, kind):
        return value
    return table[one_of(name, value, table, also=f"of class {kind.__name__}")]


def of_class(name: str, value: object, kind: type[Kind], remedy: str = "") -> Kind:
    """
    Return a value that is an instance of `kind`.

    The error says how to obtain one: `remedy`, or the class's own attribute `how_to_get`; and where
    the value carries what is wanted as `.session` or `.model`, it says so.
    """
    if isinstance(value, kind):
        return value
    remedy = remedy or getattr(kind, "how_to_get", "")
    for part in ("session", "model"):
        if isinstance(getattr(value, part, None), kind):
            remedy = f"pass its .{part}"
    hint = f"; {remedy}" if remedy else ""
    raise ValueError(f"{name} must be of class {kind.__name__}, got {type(value).__name__}{hint}")


def spawned(seed: Seed, count: int) -> list[np.random.SeedSequence]:
    """Return `count` independent children of a seed, the same at every call."""
    if not isinstance(seed, np.random.SeedSequence):
        seed = np.random.SeedSequence(whole_seed(seed))
    # seed.spawn would count its children, and return others at the second call.
    keys = ((*seed.spawn_key, i) for i in range(count))
    return [np.random.SeedSequence(seed.entropy, spawn_key=key) for key in keys]


def set_checked(record: Any, check: Callable[[str, Any], Any], *names: str) -> None:
    """Replace fields of a frozen dataclass by what a check makes of them."""
    record.__dict__.update({name: check(name, getattr(record, name)) for name in names})


def set_in_order(record: Any, low: str, high: str) -> None:
    """Replace two fields of a frozen dataclass by finite floats, the first below the second."""
    pair = in_order(low, getattr(record, low), high, getattr(record, high))
    record.__dict__.update(zip((low, high), pair, strict=True))


def finite_numbers(name: str, values: Any) -> np.ndarray:
    """Return a number, or numbers of any shape, as a float array without gaps."""
    try:
        array = np.asarray(
            values.astype(float).filled(np.nan) if np.ma.is_masked(values) else values
        )
        text = array.dtype.kind == "O" and any(isinstance(x, str | bytes) for x in array.flat)
        if text or array.dtype.kind not in "biufO":
            raise TypeError
        array = np.ascontiguousarray(array, dtype=float)
    except (TypeError, ValueError, OverflowError):
        raise ValueError(
            f"{name} must be an array of numbers, got {type(values).__name__}"
        ) from None
    finite = np.isfinite(array)
    if not finite.all():
        place = tuple(np.argwhere(~finite)[0])
        raise ValueError(f"{name} must be finite, but sample {place[0]} is {array[place]}")
    return array.reshape(np.shape(values))


def finite_array(name: str, values: Any, *, length: int | None = None) -> np.ndarray:
    """
    Return a one-dimensional float array without gaps, of `length` samples where that is stated.
    """
    array = finite_numbers(name, values)
    if array.ndim != 1 or array.size == 0:
        raise ValueError(
            f"{name} must be one-dimensional with at least one sample, got shape {array.shape}"
        )
    if length is not None and array.size != length:
        raise ValueError(f"{name} must have {length} samples, got {array.size}")
    return array


def array_between(name: str, values: Any, low: float, high: float, meaning: str) -> np.ndarray:
    """
    Return a float array, as `finite_array`, within [low, high]; the error explains them by
    `meaning`.
    """
    array = finite_array(name, values)
    outside = (array < low) | (array > high)
    if outside.any():
        k = int(np.argmax(outside))
        raise ValueError(
            f"{name} must lie in [{low:g}, {high:g}] ({meaning}), but sample {k} is {array[k]}"
        )
    return array


def mode_array(mode: Any) -> np.ndarray:
    """
    Return a float array of manual shares in [0, 1]: 1 manual, 0 autonomous, or a share between
    them.
    """
    return array_between("mode", mode, 0.0, 1.0, "1 manual, 0 autonomous, or a share")


def check_participant(participant: str | int) -> None:
    """Refuse a participant that is neither a name nor a whole number."""
    if isinstance(participant, str) and participant.strip():
        return
    if isinstance(participant, bool) or not isinstance(participant, int | np.integer):
        raise ValueError(f"participant must be a name or a whole number, got {shown(participant)}")


# --- settings that check themselves -------------------------------------------------------------

# Texts, or the least and the most: so they are legible in a signature.
Positive = Annotated[float, "positive"]
NotNegative = Annotated[float, "not negative"]
Share = Annotated[float, (0.0, 1.0)]
MEANT = {"positive": positive, "not negative": not_negative}


class Checked:
    """
    A frozen dataclass whose fields are checked by their annotations: `Positive`, `NotNegative`, a
    range, float (finite), bool, Callable, or a class of trustlab; None passes where the annotation
    has it. All else is left to the class.
    """

    def __post_init__(self):
        for name, check in field_checks(type(self)).items():  # type: ignore[arg-type]
            self.__dict__[name] = check(name, getattr(self, name))


@cache
def field_checks(kind: type) -> dict[str, Callable[[str, Any], Any]]:
    """Return what checks the fields of a dataclass, by name."""
    known = {field.name: _check_of(field.type) for field in fields(kind) if field.init}
    return {name: check for name, check in known.items() if check}


def refuse_changed(record: Any, own: Any, what: str, *names: str) -> None:
    """Refuse fields that are not as usual where a function of one's own takes their place."""
    for name in names if callable(own) else ():
        if getattr(record, name) != getattr(type(record), name):
            raise ValueError(f"{name} would do nothing beside {what} of one's own")


def changes(record: Any, usual: Any) -> str:
    """Return "name = value, …" of the fields in which a record is not as usual."""
    pairs = {field.name: getattr(record, field.name) for field in fields(record)}
    told = [
        f"{name} = {'a function' if callable(value) else shown(value)}"
        for name, value in pairs.items()
        if repr(value) != repr(getattr(usual, name))
    ]
    return ", ".join(told) or "as usual"


def _check_of(hint: Any) -> Callable[[str, Any], Any] | None:
    """Return what checks values of an annotation; None where it says nothing."""
    first, *others = get_args(hint) or (hint,)
    if type(None) in others:
        check = _check_of(first)
        return check and (lambda name, value: None if value is None else check(name, value))
    if hasattr(hint, "__metadata__"):
        return MEANT.get(others[0]) or (lambda name, value: between(name, value, *others[0]))
    if getattr(hint, "__module__", "").startswith("trustlab."):
        return partial(of_class, kind=hint)
    return {float: finite_number, bool: flag, Callable: function}.get(hint)
