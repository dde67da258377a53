"""A long table of scores, checked and laid out as subjects × conditions."""

from __future__ import annotations

import decimal
import numbers
from collections.abc import Hashable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
import pandas as pd

from trustlab.sessions.errors import nearest

__all__ = ["ScoreTable", "complete_scores", "data_origin", "read_scores"]

_SHOWN = 5
"""Cells or rows that an error lists before it counts the rest."""


@dataclass(frozen=True, eq=False)
class ScoreTable:
    """
    Scores of every subject under every condition.

    Parameters
    ----------
    values : numpy.ndarray, shape (subjects, conditions)
        Scores; NaN for a missing cell.
    subjects : tuple
        Labels, sorted where they can be.
    conditions : tuple
        Labels in the order in which they are reported.
    dv, within, subject : hashable
        Names of the columns.
    origin : str
        What kind of data these are where they were not measured ("synthetic data", "reconstructed data"); else empty.
    """

    values: np.ndarray
    subjects: tuple
    conditions: tuple
    dv: Hashable
    within: Hashable
    subject: Hashable
    origin: str = ""

    def frame(self) -> pd.DataFrame:
        """Return the cells that are there, one per row; columns subject, condition, value."""
        i, j = np.nonzero(~np.isnan(self.values))
        columns = {
            "subject": pd.Index(self.subjects, tupleize_cols=False).take(i),
            "condition": pd.Index(self.conditions, tupleize_cols=False).take(j),
            "value": self.values[i, j],
        }
        return pd.DataFrame(columns)


def data_origin(frame: pd.DataFrame) -> str:
    """
    Return "reconstructed data", "synthetic data", the text of `frame.attrs["origin"]`, or "" for measured data.

    Parameters
    ----------
    frame : pandas.DataFrame
        A table whose `attrs` may hold reconstructed=True, synthetic=True or origin="…".
    """
    attrs = frame.attrs
    for kind in ("reconstructed", "synthetic"):
        if attrs.get(kind) is True:
            return f"{kind} data"
    origin = attrs.get("origin", "")
    return origin if isinstance(origin, str) else ""


def _some(texts: Sequence[str]) -> str:
    rest = len(texts) - _SHOWN
    return "; ".join(texts[:_SHOWN]) + (f"; and {rest} more" if rest > 0 else "")


def _column(frame: pd.DataFrame, argument: str, name: Hashable, remedy: str = "") -> pd.Series:
    if not isinstance(name, Hashable):
        raise ValueError(
            f"{argument} must be the name of one column, got {name!r}; one factor is analysed at a time"
        )
    if name not in frame.columns:
        if name is not None and name in frame.index.names:
            raise ValueError(f"{argument}: {name!r} is in the index, not a column; give frame.reset_index()")
        there = ", ".join(map(str, frame.columns))
        hint = nearest(name, frame.columns)
        raise ValueError(f"{argument}: no column {name!r}{hint} (there are {there}){'' if hint else remedy}")
    found = frame[name]
    if isinstance(found, pd.DataFrame):
        if isinstance(frame.columns, pd.MultiIndex):
            inside = ", ".join(repr(label) for label in frame.columns if label[0] == name)
            raise ValueError(f"{argument}: {name!r} has columns below it; give one of them in full, {inside}")
        raise ValueError(
            f"{argument}: column {name!r} is there {found.shape[1]} times; rename or remove all but one"
        )
    return found


def _melting(frame: pd.DataFrame, dv: Hashable, within: Hashable, subject: Hashable) -> str:
    """Return how to make a table with a column per condition long; nothing where score or condition has a column."""
    if any(not isinstance(name, Hashable) or name in frame.columns for name in (dv, within)):
        return ""
    own = f"frame.rename_axis({subject!r}).reset_index()"
    if not isinstance(subject, Hashable) or subject in frame.columns:
        own = "frame"
    elif subject in frame.index.names:
        own = "frame.reset_index()"
    return (
        "; if it has a column per condition, make it long: "
        f"{own}.melt(id_vars={subject!r}, var_name={within!r}, value_name={dv!r})"
    )


def _labels(series: pd.Series, argument: str, row: pd.Index) -> tuple[np.ndarray, list]:
    missing = series.isna().to_numpy()
    if missing.any():
        k = int(np.argmax(missing))
        raise ValueError(
            f"{argument}: column {series.name!r} has no label in row {row[k]!r}; every score needs one"
        )
    if isinstance(series.dtype, pd.CategoricalDtype):
        codes = series.cat.codes.to_numpy().astype(np.intp)
        present = np.unique(codes)
        return np.searchsorted(present, codes), series.cat.categories.take(present).tolist()
    try:
        codes, found = pd.factorize(series)
    except TypeError:
        raise ValueError(f"{argument}: column {series.name!r} holds labels that cannot be compared") from None
    return codes, pd.Index(found, tupleize_cols=False).tolist()


def _sorted(codes: np.ndarray, labels: list) -> tuple[np.ndarray, list]:
    order = sorted(range(len(labels)), key=labels.__getitem__)
    place = np.empty(len(labels), dtype=np.intp)
    place[order] = np.arange(len(labels))
    return place[codes], [labels[i] for i in order]


def _arranged(
    codes: np.ndarray, labels: list, series: pd.Series, order: Sequence | None
) -> tuple[np.ndarray, list]:
    if order is not None:
        wanted = list(order) if isinstance(order, Iterable) and not isinstance(order, str) else []
        if len(wanted) != len(labels) or any(label not in wanted for label in labels):
            raise ValueError(
                f"order must list every condition in column {series.name!r} once, {labels}, got {order!r}; "
                "leave conditions out by selecting rows"
            )
        place = np.array([wanted.index(label) for label in labels], dtype=np.intp)
        return place[codes], [labels[i] for i in np.argsort(place)]
    if isinstance(series.dtype, pd.CategoricalDtype):
        return codes, labels
    try:
        return _sorted(codes, labels)
    except TypeError:
        kinds = sorted({type(label).__name__ for label in labels})
        raise ValueError(
            f"within: column {series.name!r} mixes {' and '.join(kinds)}, which have no common order; "
            "make them one type, or give order=[…]"
        ) from None


def _scores(series: pd.Series, where) -> np.ndarray:
    dtype = series.dtype
    if isinstance(dtype, pd.CategoricalDtype):
        raise ValueError(
            f"dv: column {series.name!r} is categorical; scores must be numbers (convert it with pandas.to_numeric)"
        )
    if pd.api.types.is_bool_dtype(dtype):
        raise ValueError(f"dv: column {series.name!r} holds True and False; scores must be numbers")
    if pd.api.types.is_numeric_dtype(dtype) and not pd.api.types.is_complex_dtype(dtype):
        return series.to_numpy(dtype=float, na_value=np.nan)
    if not (pd.api.types.is_object_dtype(dtype) or pd.api.types.is_string_dtype(dtype)):
        raise ValueError(f"dv: column {series.name!r} is of type {dtype}; scores must be numbers")
    values = np.empty(len(series))
    for k, value in enumerate(series.array):
        if value is None or value is pd.NA or value is pd.NaT:
            values[k] = np.nan
        elif isinstance(value, numbers.Real | decimal.Decimal) and not isinstance(value, bool | np.bool_):
            values[k] = float(value)
        elif isinstance(value, float) and np.isnan(value):
            values[k] = np.nan
        else:
            raise ValueError(
                f"dv: column {series.name!r} holds {value!r} for {where(k)}; scores must be numbers "
                "(text that stands for numbers: convert it with pandas.to_numeric)"
            )
    return values


def read_scores(
    frame: pd.DataFrame, dv: Hashable, within: Hashable, subject: Hashable, *, order: Sequence | None = None
) -> ScoreTable:
    """
    Check a long table and lay its scores out as subjects × conditions, missing cells as NaN.

    Parameters
    ----------
    frame : pandas.DataFrame
        One row per subject and condition; other columns are not looked at.
    dv, within, subject : hashable
        Columns with the score, the condition and the subject.
    order : sequence, optional
        Conditions in the order wanted. By default a categorical column keeps the order of its categories (those that
        occur); any other is sorted.

    Returns
    -------
    ScoreTable

    Raises
    ------
    ValueError
        If a column is unknown or there twice, a label is missing, a score is infinite or no number, a cell has more
        than one row, or there is only one condition; subject, condition and row are named.
    """
    if not isinstance(frame, pd.DataFrame):
        raise ValueError(f"frame must be a pandas.DataFrame in long form, got {type(frame).__name__}")
    columns = {"dv": dv, "within": within, "subject": subject}
    remedy = _melting(frame, dv, within, subject)
    series = {argument: _column(frame, argument, name, remedy) for argument, name in columns.items()}
    if len(set(columns.values())) < 3:
        raise ValueError(
            f"dv, within and subject must be three columns, got {dv!r}, {within!r} and {subject!r}"
        )
    if len(frame) == 0:
        raise ValueError("frame has no rows")
    row = frame.index.astype(object)  # plain Python labels for the errors
    condition, conditions = _labels(series["within"], "within", row)
    condition, conditions = _arranged(condition, conditions, series["within"], order)
    person, subjects = _labels(series["subject"], "subject", row)
    with suppress(TypeError):  # labels of several types stay in order of appearance: nothing depends on it
        person, subjects = _sorted(person, subjects)

    def where(k: int) -> str:
        return f"subject {subjects[person[k]]!r}, condition {conditions[condition[k]]!r} (row {row[k]!r})"

    scores = _scores(series["dv"], where)
    infinite = np.isinf(scores)
    if infinite.any():
        k = int(np.argmax(infinite))
        raise ValueError(f"dv: column {dv!r} is {scores[k]} for {where(k)}; scores must be finite")
    if len(conditions) < 2:
        raise ValueError(
            f"within: column {within!r} has one condition only, {conditions[0]!r}; at least two are compared"
        )
    cell = person * len(conditions) + condition
    counts = np.bincount(cell, minlength=len(subjects) * len(conditions))
    if counts.max() > 1:
        texts = []
        for c in np.flatnonzero(counts > 1):
            rows = [row[k] for k in np.flatnonzero(cell == c)[:_SHOWN]]
            i, j = divmod(int(c), len(conditions))
            texts.append(
                f"subject {subjects[i]!r}, condition {conditions[j]!r} has {counts[c]} rows ({', '.join(map(repr, rows))})"
            )
            if len(texts) > _SHOWN:
                break
        raise ValueError(
            f"{(counts > 1).sum()} cell(s) with more than one row: {'; '.join(texts[:_SHOWN])}; "
            f"average the trials of a cell first: frame.groupby([{subject!r}, {within!r}], as_index=False)[{dv!r}].mean()"
        )
    values = np.full(len(subjects) * len(conditions), np.nan)
    values[cell] = scores
    return ScoreTable(
        values.reshape(len(subjects), -1),
        tuple(subjects),
        tuple(conditions),
        dv,
        within,
        subject,
        data_origin(frame),
    )


def _missing_cells(table: ScoreTable) -> str:
    gone = np.isnan(table.values)
    k = len(table.conditions)
    texts = []
    for i in np.flatnonzero(gone.any(axis=1)):
        there = [c for c, absent in zip(table.conditions, gone[i], strict=True) if not absent]
        name = f"subject {table.subjects[i]!r}"
        if not there:
            texts.append(f"{name} has no score at all")
        elif len(there) == 1 and k > 2:
            texts.append(f"{name} has a score in one condition only, {there[0]!r}")
        else:
            absent = [repr(c) for c in table.conditions if c not in there]
            texts.append(f"{name} has no score in condition {', '.join(absent)}")
    return _some(texts)


def _alike(labels: tuple) -> str:
    plain: dict[str, Hashable] = {}
    for label in labels:
        other = plain.setdefault(str(label).strip().casefold(), label)
        if other is not label:
            return f" (conditions {other!r} and {label!r} differ by spaces, case or type alone: are they the same?)"
    return ""


def same_for_all(table: ScoreTable) -> list:
    """
    Return the conditions in which every subject has the same score.

    Parameters
    ----------
    table : ScoreTable
        Without missing cells.
    """
    spread = np.ptp(table.values, axis=0)
    return [condition for condition, range_ in zip(table.conditions, spread, strict=True) if range_ == 0.0]


def complete_scores(table: ScoreTable, missing: str = "raise") -> tuple[ScoreTable, tuple]:
    """
    Return a table without missing cells and the subjects that were left out for it.

    Parameters
    ----------
    table : ScoreTable
        What was read.
    missing : {"raise", "listwise"}
        Whether a missing cell is an error, or its subject is left out.

    Returns
    -------
    table : ScoreTable
        Complete.
    excluded : tuple
        Subjects left out.

    Raises
    ------
    ValueError
        If cells are missing and `missing` is "raise", or fewer than three complete subjects are there.
    """
    if missing not in ("raise", "listwise"):
        raise ValueError(f"missing must be 'raise' or 'listwise', got {missing!r}")
    gone = np.isnan(table.values).any(axis=1)
    if gone.any() and missing == "raise":
        raise ValueError(
            f"missing cells in {table.dv!r}: {_missing_cells(table)}{_alike(table.conditions)}. Complete them; or leave "
            "these subjects out with missing='listwise'; or use trustlab.studies.mixed_model, which takes missing cells"
        )
    excluded = tuple(s for s, out in zip(table.subjects, gone, strict=True) if out)
    kept = tuple(s for s, out in zip(table.subjects, gone, strict=True) if not out)
    if len(kept) < 3:
        without = f" (left out: {_missing_cells(table)}){_alike(table.conditions)}" if excluded else ""
        named = f" ({', '.join(map(repr, kept))})" if kept else ""
        raise ValueError(
            f"subject: {len(kept)} complete subject(s){named} in column {table.subject!r}{without}; at least three are needed"
        )
    complete = ScoreTable(
        table.values[~gone], kept, table.conditions, table.dv, table.within, table.subject, table.origin
    )
    return complete, excluded
