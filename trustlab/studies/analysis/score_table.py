"""A long table of scores, checked and laid out as subjects × conditions."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from trustlab.models.checks import one_of
from trustlab.studies.columns import column_of, number_or_nan, refuse_missing_labels

__all__ = ["ScoreTable", "complete_scores", "read_scores", "same_for_all"]

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


def _origin(attrs: dict) -> str:
    """Return "reconstructed data", "synthetic data", the text of attrs["origin"], or "" for measured data."""
    for kind in ("reconstructed", "synthetic"):
        if attrs.get(kind) is True:
            return f"{kind} data"
    origin = attrs.get("origin", "")
    return origin if isinstance(origin, str) else ""


def _first_of(texts: Sequence[str]) -> str:
    rest = len(texts) - _SHOWN
    return "; ".join(texts[:_SHOWN]) + (f"; and {rest} more" if rest > 0 else "")


def _how_to_melt(frame: pd.DataFrame, dv: Hashable, within: Hashable, subject: Hashable) -> str:
    """Return how to turn a table with a column per condition into a long one; nothing where the table is long."""
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


def _labels(series: pd.Series, argument: str) -> tuple[np.ndarray, list]:
    """Return each row's label as a number, and the labels: those of a categorical column in its own order."""
    refuse_missing_labels(series, argument)
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
    return np.argsort(order)[codes], [labels[i] for i in order]


def _arranged(
    codes: np.ndarray, labels: list, series: pd.Series, order: Sequence | None
) -> tuple[np.ndarray, list]:
    """Put the conditions into the order asked for, else that of the categories, else sort them."""
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


def _scores(series: pd.Series, where: Callable[[int], str]) -> np.ndarray:
    """Return the scores as floats, NaN where missing; text, booleans, dates and infinities are refused."""
    dtype = series.dtype
    start = f"dv: column {series.name!r}"
    if isinstance(dtype, pd.CategoricalDtype):
        raise ValueError(
            f"{start} is categorical; scores must be numbers (convert it with pandas.to_numeric)"
        )
    if pd.api.types.is_bool_dtype(dtype):
        raise ValueError(f"{start} holds True and False; scores must be numbers")
    if pd.api.types.is_numeric_dtype(dtype) and not pd.api.types.is_complex_dtype(dtype):
        values = series.to_numpy(dtype=float, na_value=np.nan)
    elif pd.api.types.is_object_dtype(dtype) or pd.api.types.is_string_dtype(dtype):
        values = np.empty(len(series))
        for k, value in enumerate(series.array):
            try:
                values[k] = number_or_nan(value)
            except TypeError:
                raise ValueError(
                    f"{start} holds {value!r} for {where(k)}; scores must be numbers "
                    "(text that stands for numbers: convert it with pandas.to_numeric)"
                ) from None
    else:
        raise ValueError(f"{start} is of type {dtype}; scores must be numbers")
    infinite = np.isinf(values)
    if infinite.any():
        k = int(np.argmax(infinite))
        raise ValueError(f"{start} is {values[k]} for {where(k)}; scores must be finite")
    return values


def _refuse_repeated_cells(
    cell: np.ndarray, counts: np.ndarray, name: Callable[[int], str], row: pd.Index, remedy: str
) -> None:
    """Refuse a table with several rows for one subject and condition."""
    repeated = np.flatnonzero(counts > 1)
    if repeated.size == 0:
        return
    texts = []
    for c in repeated[:_SHOWN]:
        rows = ", ".join(repr(row[k]) for k in np.flatnonzero(cell == c)[:_SHOWN])
        texts.append(f"{name(c)} has {counts[c]} rows ({rows})")
    raise ValueError(
        f"{repeated.size} cell(s) with more than one row: {'; '.join(texts)}; average the trials of a cell first: {remedy}"
    )


def read_scores(
    frame: pd.DataFrame, dv: Hashable, within: Hashable, subject: Hashable, *, order: Sequence | None = None
) -> ScoreTable:
    """
    Check a long table and lay its scores out as subjects × conditions, missing cells as NaN.

    By default a categorical column keeps the order of its categories (those that occur); any other is sorted.
    """
    if not isinstance(frame, pd.DataFrame):
        raise ValueError(f"frame must be a pandas.DataFrame in long form, got {type(frame).__name__}")
    columns = {"dv": dv, "within": within, "subject": subject}
    remedy = _how_to_melt(frame, dv, within, subject)
    series = {argument: column_of(frame, argument, name, remedy) for argument, name in columns.items()}
    if len(set(columns.values())) < 3:
        raise ValueError(
            f"dv, within and subject must be three columns, got {dv!r}, {within!r} and {subject!r}"
        )
    if len(frame) == 0:
        raise ValueError("frame has no rows")
    condition, conditions = _labels(series["within"], "within")
    condition, conditions = _arranged(condition, conditions, series["within"], order)
    person, subjects = _labels(series["subject"], "subject")
    with suppress(TypeError):  # labels of several types stay in order of appearance: nothing depends on it
        person, subjects = _sorted(person, subjects)
    k = len(conditions)
    cell = person * k + condition
    row = frame.index.astype(object)  # plain Python labels for the errors

    def cell_name(c: int) -> str:
        return f"subject {subjects[c // k]!r}, condition {conditions[c % k]!r}"

    scores = _scores(series["dv"], lambda i: f"{cell_name(cell[i])} (row {row[i]!r})")
    if k < 2:
        raise ValueError(
            f"within: column {within!r} has one condition only, {conditions[0]!r}; at least two are compared"
        )
    counts = np.bincount(cell, minlength=len(subjects) * k)
    average = f"frame.groupby([{subject!r}, {within!r}], as_index=False)[{dv!r}].mean()"
    _refuse_repeated_cells(cell, counts, cell_name, row, average)
    values = np.full(counts.size, np.nan)
    values[cell] = scores
    return ScoreTable(
        values=values.reshape(len(subjects), k),
        subjects=tuple(subjects),
        conditions=tuple(conditions),
        dv=dv,
        within=within,
        subject=subject,
        origin=_origin(frame.attrs),
    )


def _missing_cells(table: ScoreTable) -> str:
    texts = []
    for subject, scores in zip(table.subjects, table.values, strict=True):
        absent = [repr(c) for c, score in zip(table.conditions, scores, strict=True) if np.isnan(score)]
        there = [repr(c) for c in table.conditions if repr(c) not in absent]
        if not absent:
            continue
        if not there:
            texts.append(f"subject {subject!r} has no score at all")
        elif len(there) == 1 and len(table.conditions) > 2:
            texts.append(f"subject {subject!r} has a score in one condition only, {there[0]}")
        else:
            texts.append(f"subject {subject!r} has no score in condition {', '.join(absent)}")
    return _first_of(texts)


def _alike(labels: tuple) -> str:
    """Return a hint where two conditions may be one that was written in two ways."""
    plain: dict[str, Hashable] = {}
    for label in labels:
        other = plain.setdefault(str(label).strip().casefold(), label)
        if other is not label:
            return f" (conditions {other!r} and {label!r} differ by spaces, case or type alone: are they the same?)"
    return ""


def same_for_all(table: ScoreTable) -> list:
    """Return the conditions of a complete table in which every subject has the same score."""
    spread = np.ptp(table.values, axis=0)
    return [condition for condition, range_ in zip(table.conditions, spread, strict=True) if range_ == 0.0]


def complete_scores(table: ScoreTable, missing: str = "raise") -> tuple[ScoreTable, tuple]:
    """Return a table without missing cells, and the subjects that were left out for it (missing="listwise")."""
    one_of("missing", missing, ("raise", "listwise"))
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
    return replace(table, values=table.values[~gone], subjects=kept), excluded
