"""
Records of compiled loops, named columns that a kernel fills and a table shows; and coloured noise.
"""

from functools import partial
from typing import Any

import numpy as np

from trustlab.models.checks import finite_numbers
from trustlab.models.compiled import inner, njit

# What loops are made of: blocks, which others call as well, and steps, which a kernel alone calls.
# Steps allocate nothing and do without reference counts (_nrt=False): counts are atomic and would
# take half of the time.
block = partial(njit, error_model="numpy", forceinline=True)
step = partial(inner, error_model="numpy", forceinline=True, _nrt=False)

AXES = (0, 1, 2)


def record(
    vectors: str = "",
    planar: str = "",
    numbers: str = "",
    counts: str = "",
    flags: str = "",
    **parts: Any,
) -> np.dtype:
    """
    Return a record of three-vectors, vectors of the plane as complex numbers, numbers, whole
    numbers and flags, each named in a text of words, and of parts by name: other records, or
    arrays, as (float, shape).
    """
    names_of = vectors, planar, numbers, counts, flags
    kinds = zip(names_of, ((float, 3), complex, float, np.int64, np.bool_), strict=True)
    fields = [(name, kind) for names, kind in kinds for name in names.split()]
    return np.dtype([*parts.items(), *fields])  # flags last, so that all else is aligned


def columns_of(log: np.dtype) -> tuple[str, ...]:
    """Return the column names of a log record, vectors spelt out by axis."""
    names = []
    for name in log.names:
        size = log[name].itemsize // 8
        axes = "xyz"[: size if size > 1 else 0]
        names += [f"{name}_{axis}" for axis in axes] or [name]
    return tuple(names)


def signals(least: int = 1, **pair) -> list[np.ndarray]:
    """
    Return two signals by name as finite arrays of the same shape (N, n); one number per sample
    counts as (N, 1).
    """
    arrays = [finite_numbers(name, values) for name, values in pair.items()]
    first, second = arrays
    if first.shape != second.shape or first.ndim not in (1, 2) or len(first) < least:
        raise ValueError(
            f"{' and '.join(pair)} must have the same shape (N, n), with at least {least} rows, "
            f"got {first.shape} and {second.shape}"
        )
    return [array.reshape(len(array), -1) for array in arrays]


def coloured(count: int, columns: int, time: float, step: float, rng) -> np.ndarray:
    """Return noise of unit variance with this correlation time, shape (count, columns)."""
    keep = np.exp(-step / time)
    fresh, white = np.sqrt(1.0 - keep**2), rng.normal(size=(count, columns))
    white[0] /= fresh  # as large at the start as later
    return first_order(white, fresh, keep)


@njit
def first_order(u, gain, keep):
    """Return y(k) = keep y(k − 1) + gain u(k) of every column, from rest."""
    y = np.empty_like(u)
    for i in range(u.shape[1]):
        now = 0.0
        for k in range(u.shape[0]):
            y[k, i] = now = keep * now + gain * u[k, i]
    return y
