"""Answers to a questionnaire, item by item: a wide or long table read into one row per subject and condition."""

from __future__ import annotations

import numbers
from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd

from trustlab.sessions.errors import nearest

__all__ = ["check_responses", "name_cell", "read_responses"]


def name_cell(subject: object, condition: object, item: object = None) -> str:
    """
    Return the words that name an answer in an error: subject, condition where there is one, item.

    Parameters
    ----------
    subject, condition, item : object
        Whose answer, under which condition (None where the table has none), to what.
    """
    subject, condition, item = (
        v.item() if isinstance(v, np.generic) else v for v in (subject, condition, item)
    )
    words = f"subject {subject!r}" + ("" if condition is None else f", condition {condition!r}")
    return words + ("" if item is None else f", item {item!r}")


def _column(frame: pd.DataFrame, argument: str, name: object) -> pd.Series:
    if isinstance(name, list | dict | set):
        raise ValueError(f"{argument} must be the name of one column, got {name!r}")
    if name not in frame.columns:
        there = ", ".join(map(str, frame.columns))
        raise ValueError(f"{argument}: no column {name!r}{nearest(name, frame.columns)} (there are {there})")
    found = frame[name]
    if isinstance(found, pd.DataFrame):
        raise ValueError(
            f"{argument}: column {name!r} is there {found.shape[1]} times; rename or remove all but one"
        )
    return found


def _mapping(wanted: Sequence[str], items: object) -> dict[str, object]:
    """Return which column (or label) of the table holds which item of the questionnaire."""
    if items is None:
        return {name: name for name in wanted}
    if isinstance(items, Mapping):
        unknown = [name for name in items if name not in wanted]
        if unknown:
            raise ValueError(
                f"items: {unknown[0]!r} is no item of this questionnaire{nearest(unknown[0], wanted)} "
                f"(its items are {', '.join(wanted)})"
            )
        lacking = [name for name in wanted if name not in items]
        if lacking:
            raise ValueError(f"items: no column is named for {', '.join(lacking)}; name one for every item")
        pairs = {name: items[name] for name in wanted}
    elif isinstance(items, Sequence) and not isinstance(items, str):
        if len(items) != len(wanted):
            raise ValueError(
                f"items lists {len(items)} columns, the questionnaire has {len(wanted)} items: {', '.join(wanted)}"
            )
        pairs = dict(zip(wanted, items, strict=True))
    else:
        raise ValueError(
            f"items must be a dict of item to column, or a list of columns in the questionnaire's order, got {items!r}"
        )
    if len(set(pairs.values())) != len(pairs):
        raise ValueError(f"items: a column stands for two items: {list(pairs.values())}")
    return pairs


def _number(value: object, where: str) -> float:
    if value is None or value is pd.NA or value is pd.NaT:
        return np.nan
    if isinstance(value, bool | np.bool_) or not isinstance(value, numbers.Real):
        raise ValueError(f"{where}: the answer is {value!r}; it must be a number")
    return float(value)


def read_responses(
    frame: pd.DataFrame,
    wanted: Sequence[str],
    *,
    subject: str,
    condition: str | None,
    items: Mapping[str, str] | Sequence[str] | None = None,
    item: str | None = None,
    response: str | None = None,
) -> pd.DataFrame:
    """
    Return one row per subject and condition and one column per item; what was not answered is NaN.

    Parameters
    ----------
    frame : pandas.DataFrame
        Wide (a column per item) or, with `item` and `response`, long (a row per answer).
    wanted : sequence of str
        The questionnaire's items.
    subject, condition : str
        Columns that say whose answers these are and under which condition; `condition` may be None.
    items : dict or list, optional
        Item of the questionnaire → column (wide) or label in column `item` (long); or those in the questionnaire's
        order. By default they have the questionnaire's own names.
    item, response : str, optional
        For a long table: the column that names the item and the one that holds the answer.

    Returns
    -------
    pandas.DataFrame
        Indexed by subject (and condition), named as in `frame`.

    Raises
    ------
    ValueError
        If a column is missing or unknown, a subject or condition is missing, a row or an answer is there twice, or an
        answer is no number.
    """
    if not isinstance(frame, pd.DataFrame):
        raise ValueError(f"the answers must be a DataFrame, got {type(frame).__name__}")
    if frame.empty:
        raise ValueError("the table of answers is empty")
    if (item is None) != (response is None):
        raise ValueError("a long table needs both item= and response=; for a wide one leave both out")
    keys = [subject] if condition is None else [subject, condition]
    for argument, name in zip(("subject", "condition"), keys, strict=False):
        column = _column(frame, argument, name)
        if column.isna().any():
            row = frame.index[column.isna().to_numpy()][0]
            raise ValueError(f"column {name!r}, row {row}: the {argument} is missing; every row needs one")
    if len(set(keys)) < len(keys):
        raise ValueError(f"subject and condition are the same column, {subject!r}")
    pairs = _mapping(wanted, items)

    def where(row, name=None):
        labels = [row] if condition is None else list(row)
        return name_cell(*(labels + [None] * (2 - len(labels))), name)

    if item is None:
        for name, column in pairs.items():
            _column(frame, f"item {name!r}", column)
        index = pd.MultiIndex.from_frame(frame[keys]) if condition is not None else pd.Index(frame[subject])
        hint = ", or say condition= if they are answers under two conditions" if condition is None else ""
        if index.has_duplicates:
            raise ValueError(f"{where(index[index.duplicated()][0])}: there are two rows; keep one{hint}")
        values = [
            [_number(value, where(row, name)) for row, value in zip(index, frame[column].array, strict=True)]
            for name, column in pairs.items()
        ]
        return pd.DataFrame(dict(zip(pairs, values, strict=True)), index=index)

    labels = {label: name for name, label in pairs.items()}
    found, answers = _column(frame, "item", item), _column(frame, "response", response)
    cells, rows = {}, {}
    for row, label, value in zip(
        frame[keys].itertuples(index=False, name=None), found.array, answers.array, strict=True
    ):
        row = row if condition is not None else row[0]
        if label not in labels:
            raise ValueError(
                f"{where(row)}: {label!r} in column {item!r} is no item of this questionnaire{nearest(label, labels)}; "
                "name it in items=, or leave rows of other questionnaires out"
            )
        if (row, labels[label]) in cells:
            raise ValueError(f"{where(row, labels[label])}: there are two answers; keep one")
        cells[row, labels[label]] = _number(value, where(row, labels[label]))
        rows[row] = None
    index = (
        pd.MultiIndex.from_tuples(rows, names=keys) if condition is not None else pd.Index(rows, name=subject)
    )
    table = [[cells.get((row, name), np.nan) for name in wanted] for row in rows]
    return pd.DataFrame(table, index=index, columns=list(wanted), dtype=float)


def check_responses(
    responses: pd.DataFrame, low: float, high: float, step: float | None, hint: str = ""
) -> None:
    """
    Refuse answers outside the scale or between its steps; what was not answered passes.

    Parameters
    ----------
    responses : pandas.DataFrame
        A row per subject (and condition), a column per item.
    low, high, step : float
        The scale's ends and its step; None for a continuous scale.
    hint : str
        What may help, put at the end of the error.

    Raises
    ------
    ValueError
        Naming subject, condition, item, the answer and what is allowed.
    """
    values = responses.to_numpy(dtype=float)
    with np.errstate(invalid="ignore"):
        outside = (values < low) | (values > high)
        between = np.zeros_like(outside)
        if step is not None:
            steps = (values - low) / step
            between = np.isfinite(steps) & (np.abs(steps - np.round(steps)) > 1e-9)
    for bad, why in (
        (outside, f"lies outside {low:g} to {high:g}"),
        (between, f"is not a step of {step or 0:g} from {low:g} to {high:g}"),
    ):
        if bad.any():
            i, j = (int(k) for k in np.argwhere(bad)[0])
            row = responses.index[i]
            labels = list(row) if isinstance(responses.index, pd.MultiIndex) else [row, None]
            more = f" ({int(bad.sum())} such answers)" if bad.sum() > 1 else ""
            raise ValueError(
                f"{name_cell(*labels, responses.columns[j])}: {values[i, j]:g} {why}{more}{hint}"
            )
