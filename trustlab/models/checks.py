"""Checks on arguments that all models share: each names the argument, what was found and what is allowed."""

from __future__ import annotations

import math
from numbers import Integral, Real

import numpy as np

__all__ = [
    "finite_array",
    "finite_number",
    "mode_array",
    "of_class",
    "open_unit",
    "own_session",
    "whole_number",
]


def finite_number(name: str, value: float) -> float:
    """
    Return `value` as a float.

    Parameters
    ----------
    name : str
        The argument's name, for the error.
    value : float
        The value given.

    Raises
    ------
    ValueError
        If `value` is not one finite real number.
    """
    if isinstance(value, np.ndarray) and value.ndim == 0:
        value = value[()]
    if isinstance(value, bool | np.bool_ | str | bytes | np.ndarray) or not hasattr(value, "__float__"):
        raise ValueError(f"{name} must be a number, got {_shown(value)}")
    try:
        number = float(value)
    except (TypeError, ValueError, OverflowError, RuntimeError):
        raise ValueError(f"{name} must be a number, got {_shown(value)}") from None
    if not math.isfinite(number):
        raise ValueError(f"{name} must be finite, got {number}")
    return number


def whole_number(name: str, value: int, least: int = 1, most: int | None = None) -> int:
    """
    Return `value` as an int that is at least `least`.

    Parameters
    ----------
    name : str
        The argument's name, for the error.
    value : int
        The value given; a float counts only where it is whole and less than 2⁵³.
    least : int
        The smallest value allowed.
    most : int, optional
        The greatest value allowed, if there is one.

    Raises
    ------
    ValueError
        If `value` is not one whole number within these limits.
    """
    allowed = f"{least} or more" if most is None else f"from {least} to {most}"
    if isinstance(value, np.ndarray) and value.ndim == 0:
        value = value[()]
    whole = not isinstance(value, bool | np.bool_) and (
        isinstance(value, Integral)
        or (isinstance(value, Real) and math.isfinite(value) and abs(value) < 2.0**53 and value == int(value))
    )
    if not whole:
        raise ValueError(f"{name} must be a whole number, {allowed}, got {_shown(value)}")
    number = int(value)
    if number < least or (most is not None and number > most):
        raise ValueError(f"{name} must be a whole number, {allowed}, got {_shown(number)}")
    return number


def of_class(name: str, value: object, kind: type, remedy: str = "") -> object:
    """
    Return `value` if it is of a class.

    Parameters
    ----------
    name : str
        The argument's name, for the error.
    value : object
        The value given.
    kind : type
        The class wanted.
    remedy : str
        How to come by one, added to the error; for a `TscModel` it is there already.

    Raises
    ------
    ValueError
        If `value` is of another class.
    """
    if isinstance(value, kind):
        return value
    if kind.__name__ == "TscModel" and not remedy:
        remedy = "fit one with trustlab.fit_tsc(session) or build it with trustlab.TscModel(robot, human)"
    if kind.__name__ == "Session":
        remedy = own_session(value) or remedy
    hint = f"; {remedy}" if remedy else ""
    raise ValueError(f"{name} must be of class {kind.__name__}, got {type(value).__name__}{hint}")


def own_session(value: object) -> str:
    """
    Return "pass its .session" for a run that carries its session, else nothing.

    Parameters
    ----------
    value : object
        What was given where a session is wanted.
    """
    return "pass its .session" if type(getattr(value, "session", None)).__name__ == "Session" else ""


def _shown(value: object) -> str:
    """Return how a value reads in an error, cut short where it is long."""
    try:
        text = repr(value)
    except ValueError:
        text = "a number of very many digits"
    return text if len(text) <= 60 else f"{text[:57]}…"


def open_unit(name: str, value: float) -> float:
    """
    Return `value` as a float that lies strictly between 0 and 1.

    Parameters
    ----------
    name : str
        The argument's name, for the error.
    value : float
        The value given.

    Raises
    ------
    ValueError
        If `value` is not a number in (0, 1).
    """
    number = finite_number(name, value)
    if not 0.0 < number < 1.0:
        raise ValueError(f"{name} must lie strictly between 0 and 1, got {number}")
    return number


def finite_array(name: str, values: np.ndarray, *, length: int | None = None) -> np.ndarray:
    """
    Return `values` as a one-dimensional float array without gaps.

    Parameters
    ----------
    name : str
        The argument's name, for the error.
    values : array_like, shape (N,)
        The samples.
    length : int, optional
        The number of samples wanted.

    Raises
    ------
    ValueError
        If `values` is not one-dimensional, is empty, has another length or holds NaN or infinity.
    """
    try:
        given = np.asarray(values)
        if given.dtype.kind not in "biufO" or any(isinstance(x, str | bytes) for x in _objects(given)):
            raise TypeError
        array = np.asarray(given, dtype=float)
    except (TypeError, ValueError, OverflowError):
        raise ValueError(f"{name} must be an array of numbers, got {type(values).__name__}") from None
    if array.ndim != 1 or array.size == 0:
        raise ValueError(f"{name} must be one-dimensional with at least one sample, got shape {array.shape}")
    if length is not None and array.size != length:
        raise ValueError(f"{name} must have {length} samples, got {array.size}")
    bad = ~np.isfinite(array)
    if bad.any():
        k = int(np.argmax(bad))
        raise ValueError(f"{name} must be finite, but sample {k} is {array[k]}")
    return np.ascontiguousarray(array)


def _objects(array: np.ndarray) -> list:
    """Return what an array of objects holds; nothing for an array of numbers."""
    return array.ravel().tolist() if array.dtype.kind == "O" else []


def mode_array(mode: np.ndarray) -> np.ndarray:
    """
    Return `mode` as a float array of manual shares.

    Parameters
    ----------
    mode : array_like, shape (N,)
        1 manual, 0 autonomous, or a manual share between them, for every sample.

    Raises
    ------
    ValueError
        If a sample is not a number in [0, 1].
    """
    array = finite_array("mode", mode)
    outside = (array < 0.0) | (array > 1.0)
    if outside.any():
        k = int(np.argmax(outside))
        raise ValueError(
            f"mode must lie in [0, 1] (1 manual, 0 autonomous, or a share), but sample {k} is {array[k]}"
        )
    return array
