"""Checks on arguments that all models share: each names the argument, what was found and what is allowed."""

from __future__ import annotations

import numpy as np

__all__ = ["finite_array", "finite_number", "mode_array", "open_unit"]


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
    try:
        number = float(value) if not isinstance(value, str | bytes) else None
    except (TypeError, ValueError):
        number = None
    if number is None:
        raise ValueError(f"{name} must be a number, got {value!r}")
    if not np.isfinite(number):
        raise ValueError(f"{name} must be finite, got {number}")
    return number


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
        array = np.ascontiguousarray(values, dtype=float)
    except (TypeError, ValueError):
        raise ValueError(f"{name} must be an array of numbers, got {type(values).__name__}") from None
    if array.ndim != 1 or array.size == 0:
        raise ValueError(f"{name} must be one-dimensional with at least one sample, got shape {array.shape}")
    if length is not None and array.size != length:
        raise ValueError(f"{name} must have {length} samples, got {array.size}")
    bad = ~np.isfinite(array)
    if bad.any():
        k = int(np.argmax(bad))
        raise ValueError(f"{name} must be finite, but sample {k} is {array[k]}")
    return array


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
