"""Records of compiled loops: named columns that a kernel fills and a table shows."""

from __future__ import annotations

import numpy as np

__all__ = ["columns_of", "log_of", "record"]


def record(vectors: str = "", numbers: str = "", counts: str = "", flags: str = "") -> np.dtype:
    """Return a record of three-vectors, numbers, whole numbers and flags, each named in a text of words."""
    fields: list[tuple] = [(name, float, 3) for name in vectors.split()]
    for names, kind in ((numbers, float), (counts, np.int64), (flags, np.bool_)):
        fields += [(name, kind) for name in names.split()]
    return np.dtype(fields)


def columns_of(log: np.dtype) -> tuple[str, ...]:
    """Return the column names of a log record, vectors spelt out by axis."""
    names = []
    for name in log.names:
        names += [name] if log[name].shape == () else [f"{name}_{axis}" for axis in "xyz"]
    return tuple(names)


def log_of(log: np.dtype, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return an empty log twice, over the same memory: as a table, shape (count, columns), and as records, shape (count,)."""
    table = np.empty((count, len(columns_of(log))))
    return table, table.view(log)[:, 0]
