"""A long table of scores, checked and arranged as subjects × conditions."""

from collections.abc import Callable, Hashable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from trustlab.models.checks import of_class, one_of, shown
from trustlab.studies.columns import column_of, number_or_nan, origin_of, refuse_missing_labels

# Cells or rows that an error lists before it counts the rest.
_SHOWN = 5


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
        What kind of data these are where they were not measured ("synthetic data", "reconstructed
        data"); else empty.
    """

    values: np.ndarray
    subjects: tuple
    conditions: tuple
    dv: Hashable
    within: Hashable
    subject: Hashable
    origin: str = ""


def labelled(frame: pd.DataFrame, origin: str, **more: object) -> pd.DataFrame:
    """
    Record the origin of data that were not measured, and further facts, in a table's attrs.
    """
    frame.attrs |= more | ({"origin": origin} if origin else {})
    return frame


def _how_to_melt(frame: pd.DataFrame, dv: Hashable, within: Hashable, subject: Hashable) -> str:
    """Return how to make a table with a column per condition long; empty where it is long."""
    if any(not isinstance(name, Hashable) or name in frame.columns for name in (dv, within)):
        return ""
    wide = f"frame.rename_axis({subject!r}).reset_index()"
    if not isinstance(subject, Hashable) or subject in frame.columns:
        wide = "frame"
    elif subject in frame.index.names:
        wide = "frame.reset_index()"
    return (
        "; if it has a column per condition, make it long: "
        f"{wide}.melt(id_vars={subject!r}, var_name={within!r}, value_name={dv!r})"
    )


def _labels(series: pd.Series, argument: str) -> list:
    """
    Return each label of a column once, in the order of its categories, else of appearance.
    """
    refuse_missing_labels(series, argument)
    if isinstance(series.dtype, pd.CategoricalDtype):
        return series.cat.remove_unused_categories().cat.categories.tolist()
    return list(dict.fromkeys(series.tolist()))


def _codes(series: pd.Series, labels: list) -> np.ndarray:
    """Return the position of every row's label."""
    place = {label: i for i, label in enumerate(labels)}
    return np.array([place[label] for label in series.tolist()], dtype=np.intp)


def levels_of(series: pd.Series, argument: str, order: Sequence | None = None) -> list:
    """
    Return each label of a column once, in the given order, else that of its categories, else
    sorted.
    """
    labels = _labels(series, argument)
    if order is not None:
        listed = list(order) if isinstance(order, Iterable) and not isinstance(order, str) else []
        if len(listed) != len(labels) or any(label not in listed for label in labels):
            raise ValueError(
                f"order must list every condition in column {series.name!r} once, {labels}, got "
                f"{order!r}; leave conditions out by selecting rows"
            )
        return sorted(labels, key=listed.index)
    if isinstance(series.dtype, pd.CategoricalDtype):
        return labels
    try:
        return sorted(labels)
    except TypeError:
        kinds = " and ".join(sorted({type(label).__name__ for label in labels}))
        raise ValueError(
            f"within: column {series.name!r} mixes {kinds}, without a common order; make them one "
            "type, or give order=[…]"
        ) from None


def _scores(series: pd.Series, where: Callable[[int], str]) -> np.ndarray:
    """
    Return the scores as floats, NaN where missing; anything but real, finite numbers is refused.
    """
    start = f"dv: column {series.name!r}"
    if isinstance(series.dtype, pd.CategoricalDtype):
        raise ValueError(
            f"{start} is categorical; scores must be numbers (pandas.to_numeric makes them)"
        )
    values = np.empty(len(series))
    for k, value in enumerate(series.tolist()):
        try:
            values[k] = number_or_nan(value)
        except TypeError:
            remedy = "(text that stands for numbers: convert it with pandas.to_numeric)"
            raise ValueError(
                f"{start} holds {shown(value)} for {where(k)}; scores must be numbers {remedy}"
            ) from None
    infinite = np.isinf(values)
    if infinite.any():
        k = int(np.argmax(infinite))
        raise ValueError(f"{start} is {values[k]} for {where(k)}; scores must be finite")
    return values


def read_scores(
    frame: pd.DataFrame,
    dv: Hashable,
    within: Hashable,
    subject: Hashable,
    *,
    order: Sequence | None = None,
) -> ScoreTable:
    """
    Check a long table and arrange its scores as subjects × conditions, missing cells as NaN.

    By default a categorical column keeps the order of its categories (those that occur); any other
    is sorted.
    """
    of_class("frame", frame, pd.DataFrame, "with a row per subject and condition")
    columns = {"dv": dv, "within": within, "subject": subject}
    remedy = _how_to_melt(frame, dv, within, subject)
    series = {
        argument: column_of(frame, argument, name, remedy) for argument, name in columns.items()
    }
    if len(set(columns.values())) < 3:
        raise ValueError(
            f"dv, within and subject must be three columns, got {dv!r}, {within!r}, {subject!r}"
        )
    if len(frame) == 0:
        raise ValueError("frame has no rows")
    conditions = levels_of(series["within"], "within", order)
    subjects = _labels(series["subject"], "subject")
    with suppress(TypeError):  # labels of several types stay in order of appearance
        subjects = sorted(subjects)
    k = len(conditions)
    cell = _codes(series["subject"], subjects) * k + _codes(series["within"], conditions)
    row = frame.index.astype(object)  # plain Python labels for the errors

    def cell_name(c: int) -> str:
        return f"subject {subjects[c // k]!r}, condition {conditions[c % k]!r}"

    scores = _scores(series["dv"], lambda i: f"{cell_name(cell[i])} (row {row[i]!r})")
    if k < 2:
        raise ValueError(
            f"within: column {within!r} has one condition only, {conditions[0]!r}; two are needed"
        )
    counts = np.bincount(cell, minlength=len(subjects) * k)
    if (counts > 1).any():
        repeated = np.flatnonzero(counts > 1)
        texts = []
        for c in repeated[:_SHOWN]:
            rows = ", ".join(repr(row[i]) for i in np.flatnonzero(cell == c)[:_SHOWN])
            texts.append(f"{cell_name(c)} has {counts[c]} rows ({rows})")
        raise ValueError(
            f"{repeated.size} cell(s) with more than one row: {'; '.join(texts)}; average the "
            f"trials of a cell first: frame.groupby([{subject!r}, {within!r}], as_index=False)"
            f"[{dv!r}].mean()"
        )
    values = np.full(counts.size, np.nan)
    values[cell] = scores
    return ScoreTable(
        values=values.reshape(len(subjects), k),
        subjects=tuple(subjects),
        conditions=tuple(conditions),
        dv=dv,
        within=within,
        subject=subject,
        origin=origin_of(frame),
    )


def _missing_cells(table: ScoreTable) -> str:
    texts = []
    for subject, scores in zip(table.subjects, table.values, strict=True):
        absent = [
            repr(c) for c, score in zip(table.conditions, scores, strict=True) if np.isnan(score)
        ]
        if len(absent) == len(table.conditions):
            texts.append(f"subject {subject!r} has no score at all")
        elif absent:
            texts.append(f"subject {subject!r} has no score in condition {', '.join(absent)}")
    rest = len(texts) - _SHOWN
    return "; ".join(texts[:_SHOWN]) + (f"; and {rest} more" if rest > 0 else "")


def _similar_labels(labels: tuple) -> str:
    """Return a hint where two labels may be spellings of one condition."""
    plain: dict[str, Hashable] = {}
    for label in labels:
        first = plain.setdefault(str(label).strip().casefold(), label)
        if first is not label:
            return (
                f" (conditions {first!r} and {label!r} differ by spaces, case or type alone: "
                "are they the same?)"
            )
    return ""


def same_for_all(table: ScoreTable) -> list:
    """Return the conditions of a complete table in which every subject has the same score."""
    spread = np.ptp(table.values, axis=0)
    return [
        condition
        for condition, range_ in zip(table.conditions, spread, strict=True)
        if range_ == 0.0
    ]


def complete_scores(table: ScoreTable, missing: str = "raise") -> tuple[ScoreTable, tuple]:
    """
    Return a table without missing cells, and the subjects left out (missing="listwise").
    """
    one_of("missing", missing, ("raise", "listwise"))
    gone = np.isnan(table.values).any(axis=1)
    if gone.any() and missing == "raise":
        raise ValueError(
            f"missing cells in {table.dv!r}: {_missing_cells(table)}"
            f"{_similar_labels(table.conditions)}. Complete them; or leave these subjects out with "
            "missing='listwise'; or call tl.mixed_model with the same arguments: it takes missing "
            "cells"
        )
    excluded = tuple(s for s, out in zip(table.subjects, gone, strict=True) if out)
    complete = tuple(s for s, out in zip(table.subjects, gone, strict=True) if not out)
    if len(complete) < 3:
        without = (
            f" (left out: {_missing_cells(table)}){_similar_labels(table.conditions)}"
            if excluded
            else ""
        )
        named = f" ({', '.join(map(repr, complete))})" if complete else ""
        raise ValueError(
            f"subject: {len(complete)} complete subject(s){named} in column {table.subject!r}"
            f"{without}; at least three are needed"
        )
    return replace(table, values=table.values[~gone], subjects=complete), excluded
