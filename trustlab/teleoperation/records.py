"""Records of compiled loops: named columns that a kernel fills and a table shows."""

import numpy as np

from trustlab.models.checks import finite_array


def record(vectors: str = "", numbers: str = "", counts: str = "", flags: str = "") -> np.dtype:
    """
    Return a record of three-vectors, numbers, whole numbers and flags, each named in a text of
    words.
    """
    kinds = (vectors, (float, 3)), (numbers, float), (counts, np.int64), (flags, np.bool_)
    return np.dtype([(name, kind) for names, kind in kinds for name in names.split()])


def columns_of(log: np.dtype) -> tuple[str, ...]:
    """Return the column names of a log record, vectors spelt out by axis."""
    names = []
    for name in log.names:
        axes = "xyz"[: sum(log[name].shape)]
        names += [f"{name}_{axis}" for axis in axes] or [name]
    return tuple(names)


def signal(
    name: str, values, rows: int | None = None, columns: int | None = None, least: int = 1
) -> np.ndarray:
    """Return a signal as a finite array of shape (N, n); one number per sample counts as (N, 1)."""
    try:
        array = np.ascontiguousarray(values).astype(float, casting="same_kind")
    except (TypeError, ValueError):
        raise ValueError(
            f"{name} must be an array of numbers, got {type(values).__name__}"
        ) from None
    if array.ndim == 1 and columns is None:
        array = array[:, None]
    if array.ndim != 2 or array.shape != (rows or len(array), columns or array.shape[1]):
        shape = f"({rows or 'N'}, {columns or 'n'})"
        raise ValueError(f"{name} must have shape {shape}, got {np.shape(values)}")
    if len(array) < least or not array.size:
        raise ValueError(f"{name} must have at least {least} rows, got shape {array.shape}")
    for column in array.T:
        finite_array(name, column)
    return array


def signals(least: int = 1, **pair) -> list[np.ndarray]:
    """Return two signals by name as finite arrays of the same shape (N, n)."""
    first, second = (signal(name, values, least=least) for name, values in pair.items())
    if first.shape != second.shape:
        raise ValueError(
            f"{' and '.join(pair)} must have the same shape (N, n), got {first.shape} and "
            f"{second.shape}"
        )
    return [first, second]


def robot_numbers(name: str, values, count: int, robots: int) -> np.ndarray:
    """Return `count` numbers of robots, each from 0 to `robots` − 1."""
    array = np.asarray(values)
    if array.shape != (count,) or array.dtype.kind not in "iu":
        raise ValueError(f"{name} must be {count} whole numbers, got {array.dtype} {array.shape}")
    absent = (array < 0) | (array >= robots)
    if absent.any():
        raise ValueError(
            f"{name} names robot {array[absent][0]}, which does not exist; there are {robots} "
            "robots"
        )
    return array.astype(np.int64)
