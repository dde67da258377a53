"""Columns of a user's table: looked up by name, without missing labels, numbers as floats."""

import decimal
import numbers
from collections.abc import Hashable, Sequence

import numpy as np
import pandas as pd

from trustlab.models.checks import did_you_mean, shown


def column_of(frame: pd.DataFrame, argument: str, name: Hashable, remedy: str = "") -> pd.Series:
    """
    Return the one column that an argument names; `remedy` is appended to the error if no name is
    similar.
    """
    if not isinstance(name, Hashable):
        raise ValueError(
            f"{argument} must be the name of one column, got {name!r}; one factor at a time"
        )
    if name not in frame.columns:
        if name is not None and name in frame.index.names:
            raise ValueError(
                f"{argument}: {name!r} is in the index, not a column; give frame.reset_index()"
            )
        there = ", ".join(map(str, frame.columns))
        hint = did_you_mean(name, frame.columns)
        raise ValueError(
            f"{argument}: no column {name!r}{hint} (there are {there}){'' if hint else remedy}"
        )
    column = frame[name]
    if isinstance(column, pd.Series):
        return column
    if isinstance(frame.columns, pd.MultiIndex):
        inside = ", ".join(repr(label) for label in frame.columns if label[0] == name)
        raise ValueError(
            f"{argument}: {name!r} has columns below it; give one of them in full, {inside}"
        )
    raise ValueError(
        f"{argument}: column {name!r} occurs {column.shape[1]} times; keep or rename all but one"
    )


def refuse_missing_labels(column: pd.Series, argument: str) -> None:
    """Refuse a column with a missing or unhashable label, and name its row."""
    rows = column.index.astype(object)  # plain Python labels, for the errors
    for row, label in zip(rows, column.tolist(), strict=True):
        try:
            hash(label)
        except TypeError:  # a list, a dictionary, a signalling NaN
            raise ValueError(
                f"{argument}: column {column.name!r} holds {shown(label)} in row {row!r}, which "
                "is no label"
            ) from None
    missing = column.isna().to_numpy()
    if missing.any():
        row = rows[int(np.argmax(missing))]
        raise ValueError(
            f"{argument}: column {column.name!r} has no label in row {row!r}; each row needs one"
        )


def number_or_nan(value: object) -> float:
    """
    Return a real number as a float, a missing value as NaN; raise TypeError for anything else.
    """
    if value is None or value is pd.NA or value is pd.NaT:
        return np.nan
    if isinstance(value, bool | np.bool_) or not isinstance(value, numbers.Real | decimal.Decimal):
        raise TypeError
    try:
        return float(value)
    except (OverflowError, ValueError):  # beyond the range of floats, or a signalling NaN
        raise TypeError from None


def labels_of(name: str, values: object, least: int) -> tuple[Hashable, ...]:
    """Return at least `least` labels, all different and none missing."""
    if isinstance(values, str | bytes) or not isinstance(
        values, Sequence | np.ndarray | pd.Series | pd.Index
    ):
        raise ValueError(f"{name} must be a list of labels, got {values!r}")
    labels = tuple(value.item() if isinstance(value, np.generic) else value for value in values)
    for k, label in enumerate(labels):
        blank = isinstance(label, str) and not label.strip()
        if (
            not isinstance(label, Hashable)
            or isinstance(label, bool)
            or pd.isna([label]).any()
            or blank
        ):
            raise ValueError(
                f"{name}[{k}] is {label!r}; a label must be a number or a text that is not empty"
            )
    if len(labels) < least:
        raise ValueError(f"{name} must have at least {least} labels, got {len(labels)}")
    twice = [label for k, label in enumerate(labels) if label in labels[:k]]
    if twice:
        raise ValueError(f"{name} must differ from one another, but {twice[0]!r} occurs twice")
    return labels


def origin_of(frame: pd.DataFrame) -> str:
    """
    Return what kind of data a table holds where they were not measured; "" for measured ones.

    Its attrs say so ("reconstructed" or "synthetic" is True, or "origin" is a text), or a column
    `synthetic`, which is left when tables are put together and attrs are lost.
    """
    for kind in ("reconstructed", "synthetic"):
        if frame.attrs.get(kind) is True:
            return f"{kind} data"
    origin = frame.attrs.get("origin", "")
    if origin and isinstance(origin, str):
        return origin
    if "synthetic" not in frame.columns:
        return ""
    marked = frame["synthetic"] == True  # noqa: E712, a cell without a mark is no mark
    if marked.all() and len(frame):
        return "synthetic data"
    return "partly synthetic data" if marked.any() else ""
