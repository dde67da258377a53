"""The one reader of tables: columns by name, labels, numbers, scores as subjects × conditions."""

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, replace
from decimal import Decimal
from itertools import compress, product
from numbers import Real
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from trustlab.models.checks import counted, did_you_mean, of_class, one_of, shown
from trustlab.models.display import Result

# Cells or subjects that an error lists before it counts the rest.
_SHOWN = 5


def column_of(frame: pd.DataFrame, argument: str, name: Hashable) -> pd.Series:
    """Return the one column that an argument names."""
    if not isinstance(name, Hashable) or name not in frame.columns:
        there = ", ".join(map(str, frame.columns))
        remedy = did_you_mean(name, frame.columns)
        if argument in ("dv", "within"):
            remedy = remedy or "; frame.melt(…) makes a table with a column per condition long"
        raise ValueError(f"{argument}: no column {shown(name)}{remedy} (there are {there})")
    column = frame[name]
    if isinstance(column, pd.DataFrame):
        raise ValueError(f"{argument}: {column.shape[1]} columns are named {name!r}; rename them")
    return column


def refuse_missing_labels(column: pd.Series, argument: str) -> None:
    """Refuse a column with a missing label, and name its row."""
    for row in column.index[column.isna()]:
        raise ValueError(f"{argument}: column {column.name!r} has no label in row {row!r}")


def numbers_of(column: pd.Series, argument: str) -> np.ndarray:
    """Return a column as floats, NaN where it has nothing; what is no number is refused."""
    numbers = np.full(len(column), np.nan)
    for place, value in enumerate(column.tolist()):
        if pd.api.types.is_scalar(value) and pd.isna(value):
            continue
        real = isinstance(value, Real | Decimal) and not isinstance(value, bool)
        try:
            numbers[place] = float(value) if real else np.inf
        except OverflowError:
            numbers[place] = np.inf
        if np.isinf(numbers[place]):
            raise ValueError(
                f"{argument}: column {column.name!r} holds {shown(value)} in row "
                f"{column.index[place]!r}; it must hold finite numbers (pandas.to_numeric converts "
                "text)"
            )
    return numbers


def labels_of(name: str, values: object, least: int) -> tuple[Hashable, ...]:
    """Return at least `least` labels, all different and none missing."""
    if isinstance(values, str | bytes) or not isinstance(
        values, Sequence | np.ndarray | pd.Series | pd.Index
    ):
        raise ValueError(f"{name} must be a list of labels, got {values!r}")
    labels = tuple(value.item() if isinstance(value, np.generic) else value for value in values)
    for label in labels:
        usable = isinstance(label, Hashable) and not isinstance(label, bool)
        if not usable or pd.isna([label]).any() or not str(label).strip():
            raise ValueError(f"{name}: {label!r} is no label, a number or a text that is not empty")
        if labels.count(label) > 1:
            raise ValueError(f"{name} must differ from one another, but {label!r} occurs twice")
    if len(labels) < least:
        raise ValueError(f"{name} must have at least {least} labels, got {len(labels)}")
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
    marked = frame.get("synthetic", pd.Series(dtype=bool)) == True  # noqa: E712, no mark is NaN
    if not marked.any():
        return ""
    return "synthetic data" if marked.all() else "partly synthetic data"


def mark(origin: str) -> str:
    """Return what sentences about data begin with: their origin, where they were not measured."""
    return f"[{origin}] " if origin else ""


def labelled(frame: pd.DataFrame, origin: str, **more: object) -> pd.DataFrame:
    """
    Record the origin of data that were not measured, and further facts, in a table's attrs.
    """
    frame.attrs |= more | ({"origin": origin} if origin else {})
    return frame


def levels_of(series: pd.Series, argument: str, order: Any = None) -> tuple:
    """
    Return each label of a column once, in the given order, else that of its categories, else
    sorted.
    """
    refuse_missing_labels(series, argument)
    labels = tuple(dict.fromkeys(series.tolist()))
    if order is not None:
        listed = list(order) if np.iterable(order) and not isinstance(order, str) else []
        if len(listed) != len(labels) or any(label not in listed for label in labels):
            raise ValueError(
                f"order must list every condition in column {series.name!r} once, {[*labels]}, got "
                f"{order!r}; leave conditions out by selecting rows"
            )
        return tuple(listed)
    if isinstance(series.dtype, pd.CategoricalDtype):
        return tuple(series.cat.remove_unused_categories().cat.categories.tolist())
    try:
        return tuple(sorted(labels))
    except TypeError:
        if argument == "subject":  # such as simulated and recorded people in one table
            return labels
        raise ValueError(
            f"{argument}: column {series.name!r} mixes types of labels, without a common order; "
            "make them one type, or give order=[…]"
        ) from None


class Tested(Result):
    """
    A result whose `tests` are a row for each effect; columns in which all rows agree are attributes
    too. Where it is displayed it says what `apa` says.
    """

    if TYPE_CHECKING:
        tests: pd.DataFrame

        def apa(self) -> str:
            """Return the sentences for a paper."""

    def __getattr__(self, name: str) -> Any:
        # Python calls this only for names that are no field or method.
        if name.startswith("_") or name == "tests" or name not in self.tests:
            raise AttributeError(f"{type(self).__name__} has no attribute {name!r}")
        values = self.tests[name].drop_duplicates().tolist()
        if len(values) > 1:
            raise AttributeError(
                f"there are {len(self.tests)} effects, each with its {name!r}: table() has a row "
                "per effect"
            )
        return values[0]

    def __dir__(self) -> list[str]:
        return [*super().__dir__(), *self.tests]

    def table(self) -> pd.DataFrame:
        """Return the tests, a row for each effect; nothing is rounded."""
        return self.tests.copy()

    @property
    def message(self) -> str:
        """The sentences for a paper."""
        return self.apa()


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
        Labels in the order in which they are reported; of several factors, tuples of their levels.
    dv, within, subject : hashable
        Names of the columns; `within` of several factors is "A × B".
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


def read_scores(
    frame: pd.DataFrame, dv: Hashable, within: Any, subject: Hashable, *, order: Any = None
) -> ScoreTable:
    """
    Check a long table and arrange its scores as subjects × conditions, missing cells as NaN.

    By default a categorical column keeps the order of its categories (those that occur); any other
    is sorted. `within` is a column, `order` its levels.
    """
    return read_cells(
        frame, dv, read_factors(frame, dv, [within], subject, order=order)[0], subject
    )


def names_of(names: Any) -> list[Hashable]:
    """Return a list of columns; one name alone or None is a list of one or none."""
    if isinstance(names, list):
        return names
    return [] if names is None else [names]


def read_factors(
    frame: pd.DataFrame,
    dv: Hashable,
    within: Any,
    subject: Hashable,
    between: Any = None,
    order: Any = None,
) -> tuple[dict[Hashable, tuple], dict[Hashable, tuple]]:
    """
    Return the levels of every factor within and between subjects of a long table, whose columns are
    checked. `order` has the levels of a single factor (that within), or of several by name.
    """
    of_class("frame", frame, pd.DataFrame, "with a row per subject and condition")
    within, between = names_of(within), names_of(between)
    factors = within + between
    if not factors or frame.empty:
        raise ValueError("within and between name no factor, or frame has no rows")
    parts = {"dv": [dv], "within": within, "between": between, "subject": [subject]}
    for argument, names in parts.items():
        for name in names:
            column_of(frame, argument, name)
    if len({dv, subject, *factors}) < 2 + len(factors):
        raise ValueError(f"dv, within, between and subject must be different columns: {parts}")
    people = frame[subject]
    refuse_missing_labels(people, "subject")
    if order is not None and not isinstance(order, dict):
        single = len(within or between) == 1
        order = {factors[0]: order} if single else of_class("order", order, dict)
    if unknown := [name for name in order or {} if name not in factors]:
        raise ValueError(f"order: {unknown[0]!r} is not a factor of this design: {factors}")
    levels = {}
    for name in factors:
        argument = "within" if name in within else "between"
        levels[name] = levels_of(frame[name], argument, (order or {}).get(name))
        if len(levels[name]) < 2:
            raise ValueError(f"{argument}: column {name!r} has one condition only, {levels[name]}")
        if name in within and frame[name].groupby(people).nunique().max() == 1:
            raise ValueError(
                f"within: column {name!r} has one label for every person; give between={name!r}"
            )
    for name in between:
        count = frame[name].groupby(people).nunique()
        for person in count.index[count > 1]:
            raise ValueError(f"between: subject {person!r} has several labels in column {name!r}")
    return {name: levels[name] for name in within}, {name: levels[name] for name in between}


def read_cells(
    frame: pd.DataFrame, dv: Hashable, levels: Mapping[Hashable, tuple], subject: Hashable
) -> ScoreTable:
    """Return the scores in all cells of the factors; the last varies fastest."""
    scores = numbers_of(frame[dv], "dv")
    columns = [subject, *levels]
    for row in frame.index[frame.duplicated(columns)]:
        raise ValueError(
            f"frame has more than one row for a cell, such as row {row!r}; average the trials of a "
            f"cell first: frame.groupby({columns}, as_index=False)[{dv!r}].mean()"
        )
    subjects = levels_of(frame[subject], "subject")
    cells = tuple(product(*levels.values()))
    labels = {subject: subjects, **levels}
    places = [[*map(labels[name].index, frame[name].tolist())] for name in columns]
    values = np.full([len(labels[name]) for name in columns], np.nan)
    values[tuple(places)] = scores
    return ScoreTable(
        values=values.reshape(len(subjects), -1),
        subjects=subjects,
        conditions=cells if len(levels) > 1 else tuple(cell for (cell,) in cells),
        dv=dv,
        within=next(iter(levels)) if len(levels) == 1 else " × ".join(map(str, levels)),
        subject=subject,
        origin=origin_of(frame),
    )


def complete_scores(table: ScoreTable, missing: str = "raise") -> tuple[ScoreTable, tuple]:
    """
    Return a table without missing cells, and the subjects left out (missing="listwise").
    """
    one_of("missing", missing, ("raise", "listwise"))
    absent = np.isnan(table.values)
    gaps = [
        f"subject {subject!r} has no score in condition "
        f"{', '.join(map(repr, compress(table.conditions, cells)))}"
        for subject, cells in zip(table.subjects, absent, strict=True)
        if cells.any()
    ]
    more = f"; and {len(gaps) - _SHOWN} more" if len(gaps) > _SHOWN else ""
    shown_gaps = "; ".join(gaps[:_SHOWN]) + more
    if gaps and missing == "raise":
        raise ValueError(
            f"missing cells in {table.dv!r}: {shown_gaps}. Complete them; or leave these subjects "
            "out with missing='listwise'; or call tl.mixed_model with the same arguments: it takes "
            "missing cells"
        )
    complete = ~absent.any(axis=1)
    if complete.sum() < 3:
        raise ValueError(
            f"subject: {counted(complete.sum(), 'complete subject')} in column {table.subject!r}; "
            f"at least three are needed. {shown_gaps}"
        )
    kept, excluded = (tuple(compress(table.subjects, side)) for side in (complete, ~complete))
    return replace(table, values=table.values[complete], subjects=kept), excluded


def read_groups(
    frame: pd.DataFrame, name: Hashable, listed: tuple, scores: ScoreTable
) -> tuple[tuple, np.ndarray]:
    """
    Return the listed groups of a column that have complete subjects, two or more each, and the
    group number of each subject.
    """
    group_of = dict(zip(frame[scores.subject].tolist(), frame[name].tolist(), strict=True))
    members = [group_of[subject] for subject in scores.subjects]
    levels = tuple(level for level in listed if level in members)
    if len(levels) < 2 or min(map(members.count, levels)) < 2:
        raise ValueError(
            f"between: column {name!r} needs two groups or more, with two complete participants in "
            f"each, got {members}"
        )
    return levels, np.array([levels.index(group) for group in members])
