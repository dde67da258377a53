"""
Answers to a questionnaire: a wide or long table becomes a row per subject and condition, a column
per item.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from trustlab.models.checks import did_you_mean, of_class, shown
from trustlab.studies.table import column_of, number_or_nan, refuse_missing_labels


def answer_name(row: object, item: object = None) -> str:
    """
    Return how an error refers to an answer: subject, condition where the label of the row has one,
    item.
    """
    subject, *condition = row if isinstance(row, tuple) else (row,)
    labels = {"subject": subject}
    if condition:
        labels["condition"] = condition[0]
    if item is not None:
        labels["item"] = item
    plain = {name: v.item() if isinstance(v, np.generic) else v for name, v in labels.items()}
    return ", ".join(f"{name} {label!r}" for name, label in plain.items())


def _columns_of_items(wanted: Sequence[str], items: object) -> dict[str, object]:
    """
    Return which column (or, in a long table, which label) holds each item of the questionnaire.
    """
    if items is None:
        return {name: name for name in wanted}
    if isinstance(items, Mapping):
        unknown = [name for name in items if name not in wanted]
        if unknown:
            hint = f"{did_you_mean(unknown[0], wanted)} (its items are {', '.join(wanted)})"
            raise ValueError(f"items: {unknown[0]!r} is not an item of this questionnaire{hint}")
        lacking = [name for name in wanted if name not in items]
        if lacking:
            raise ValueError(
                f"items: no column is named for {', '.join(lacking)}; name one for every item"
            )
        columns = {name: items[name] for name in wanted}
    elif isinstance(items, Sequence) and not isinstance(items, str):
        if len(items) != len(wanted):
            need = f"{len(wanted)} items: {', '.join(wanted)}"
            raise ValueError(f"items lists {len(items)} columns, the questionnaire has {need}")
        columns = dict(zip(wanted, items, strict=True))
    else:
        need = "a dict of item to column, or a list of columns in the questionnaire's order"
        raise ValueError(f"items must be {need}, got {items!r}")
    if len(set(columns.values())) != len(columns):
        raise ValueError(f"items: two items are given the same column: {list(columns.values())}")
    return columns


def _check_table(frame: pd.DataFrame, keys: list[str]) -> None:
    """Refuse a table that is empty, or that does not say in every row whose answers these are."""
    of_class("the answers", frame, pd.DataFrame)
    if frame.empty:
        raise ValueError("the table of answers is empty")
    for argument, name in zip(("subject", "condition"), keys, strict=False):
        refuse_missing_labels(column_of(frame, argument, name), argument)
    if len(set(keys)) < len(keys):
        raise ValueError(f"subject and condition are the same column, {keys[0]!r}")


def _answered(
    frame: pd.DataFrame, rows: list, columns: Mapping, item: Any, response: Any
) -> Iterator[tuple]:
    """Yield row, item and answer of every cell of a wide table, or of every row of a long one."""
    if item is None:
        found = {
            name: column_of(frame, f"item {name!r}", column) for name, column in columns.items()
        }
        for name, column in found.items():
            yield from zip(rows, [name] * len(rows), column.array, strict=True)
        return
    items = {label: name for name, label in columns.items()}
    labels, answers = column_of(frame, "item", item), column_of(frame, "response", response)
    refuse_missing_labels(labels, "item")
    for row, label, value in zip(rows, labels.array, answers.array, strict=True):
        if label not in items:
            hint = (
                f"{did_you_mean(label, items)}; name it in items=, or leave out the rows of "
                "other questionnaires"
            )
            raise ValueError(
                f"{answer_name(row)}: {label!r} in column {item!r} is no item of this "
                f"questionnaire{hint}"
            )
        yield row, items[label], value


def read_answers(
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
    Return a column per item and a row per subject (and condition), which the index names; NaN where
    not answered.

    The arguments are those of `score_likert`; `wanted` are the questionnaire's items.
    """
    keys = [subject] if condition is None else [subject, condition]
    _check_table(frame, keys)
    if (item is None) != (response is None):
        raise ValueError(
            "a long table needs both item= and response=; for a wide one leave both out"
        )
    columns = _columns_of_items(wanted, items)
    own = list(frame[keys].itertuples(index=False, name=None))
    rows = own if condition is not None else [label for (label,) in own]
    answers = {}
    for row, name, value in _answered(frame, rows, columns, item, response):
        if (row, name) in answers:
            hint = (
                ", or say condition= if they were given under two conditions"
                if condition is None
                else ""
            )
            raise ValueError(f"{answer_name(row, name)} occurs twice; keep one{hint}")
        try:
            answers[row, name] = number_or_nan(value)
        except TypeError:
            raise ValueError(
                f"{answer_name(row, name)}: the answer is {shown(value)}, not a number"
            ) from None
    # One row each, in order of appearance, with the types of the columns.
    labels = frame[keys].drop_duplicates()
    index = pd.Index(labels[subject]) if condition is None else pd.MultiIndex.from_frame(labels)
    table = [[answers.get((row, name), np.nan) for name in wanted] for row in dict.fromkeys(rows)]
    return pd.DataFrame(table, index=index, columns=list(wanted), dtype=float)


def check_answers(
    answers: pd.DataFrame, low: float, high: float, step: float | None, hint: str = ""
) -> None:
    """
    Refuse answers outside the scale or between its steps; missing ones pass.

    `step` is None for a continuous scale; `hint` goes to the end of the error.
    """
    values = answers.to_numpy(dtype=float)

    def refuse(bad: np.ndarray, why: str) -> None:
        if bad.any():
            i, j = (int(k) for k in np.argwhere(bad)[0])
            more = f" ({int(bad.sum())} such answers)" if bad.sum() > 1 else ""
            name = answer_name(answers.index[i], answers.columns[j])
            raise ValueError(f"{name}: {values[i, j]:g} {why}{more}{hint}")

    refuse((values < low) | (values > high), f"lies outside {low:g} to {high:g}")
    if step is not None:
        steps = (values - low) / step
        # NaN compares as False: a missing answer is on no step and between none.
        refuse(
            np.abs(steps - np.round(steps)) > 1e-9,
            f"is not a step of {step:g} from {low:g} to {high:g}",
        )
