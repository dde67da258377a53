"""The one reader of tables: columns by name, labels, numbers, scores as subjects × conditions."""

from collections.abc import Hashable, Iterable, Sequence
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from trustlab.models.checks import (
    counted,
    did_you_mean,
    finite_number,
    of_class,
    one_of,
    shown,
)
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


def label_column(frame: pd.DataFrame, argument: str, name: Hashable) -> pd.Series:
    """Return a column that has rows, each with a label; the row without one is named."""
    column = column_of(frame, argument, name)
    if column.empty:
        raise ValueError(f"{argument}: column {name!r} has no rows")
    for row, label in column.items():
        if not isinstance(label, Hashable):
            raise ValueError(f"{argument}: {shown(label)} in row {row!r} of {name!r} is no label")
    for row in column.index[column.isna()]:
        raise ValueError(f"{argument}: column {name!r} has nothing in row {row!r}")
    return column


def numbers_of(column: pd.Series, argument: str) -> np.ndarray:
    """Return a column as floats, NaN where it has nothing; what is no number is refused."""
    numbers = np.full(len(column), np.nan)
    for place, (row, value) in enumerate(column.items()):
        if pd.api.types.is_scalar(value) and pd.isna(value):
            continue
        try:
            numbers[place] = finite_number(argument, value)
        except ValueError:
            raise ValueError(
                f"{argument}: column {column.name!r} holds {shown(value)} in row {row!r}; it must "
                "hold finite numbers (pandas.to_numeric converts text, astype(float) truth values)"
            ) from None
    return numbers


def labels_of(name: str, values: object, least: int) -> tuple[Hashable, ...]:
    """Return at least `least` labels, all different and none missing."""
    if not isinstance(values, Sequence | np.ndarray | pd.Series | pd.Index) or isinstance(
        values, str | bytes
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
    if origin:
        return str(origin)
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


def levels_of(column: pd.Series, argument: str, order: Any = None) -> tuple:
    """
    Return each label of a column once, in the given order, else that of its categories, else
    sorted.
    """
    labels = tuple(dict.fromkeys(column.tolist()))
    if order is not None:
        listed = list(order) if np.iterable(order) and not isinstance(order, str) else []
        if len(listed) != len(labels) or any(label not in listed for label in labels):
            raise ValueError(
                f"order must list every condition in column {column.name!r} once, {[*labels]}, got "
                f"{order!r}; leave conditions out by selecting rows"
            )
        return tuple(listed)
    if isinstance(column.dtype, pd.CategoricalDtype):
        return tuple(label for label in column.cat.categories.tolist() if label in labels)
    try:
        return tuple(sorted(labels))
    except TypeError:
        if argument == "subject":  # such as simulated and recorded people in one table
            return labels
        raise ValueError(
            f"{argument}: column {column.name!r} mixes types of labels, without a common order; "
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
        if len(values) != 1:
            raise AttributeError(
                f"there are {len(self.tests)} effects, each with its {name!r}: table() has a row "
                "per effect"
            )
        return values[0]

    @property
    def origin(self) -> str:
        """What kind of data these are where they were not measured; else empty."""
        return self.tests.attrs.get("origin", "")

    def table(self) -> pd.DataFrame:
        """Return the tests, a row for each effect; nothing is rounded."""
        return self.tests.copy()

    @property
    def message(self) -> str:
        """The sentences for a paper."""
        return self.apa()


Columns = Hashable | list[Hashable] | None
Levels = dict[Hashable, tuple]


def names_of(names: Columns) -> list[Hashable]:
    """Return a list of columns; one name alone or None is a list of one or none."""
    if isinstance(names, list):
        return names
    return [] if names is None else [names]


def roles_of(table: str, frame: pd.DataFrame, **columns: list) -> dict[Hashable, str]:
    """
    Return the argument that names each column of a table, itself called by its argument; a column
    with two is refused, and so is one that lacks a label (of dv it is a score that is missing).
    """
    of_class(table, frame, pd.DataFrame, "a table of pandas with a row per subject and condition")
    roles: dict[Hashable, str] = {}
    for argument, names in columns.items():
        for name in names:
            (column_of if argument == "dv" else label_column)(frame, argument, name)
            if name in roles:
                raise ValueError(f"columns must be different for every argument: {columns}")
            roles[name] = argument
    return roles


def read_factors(
    frame: pd.DataFrame,
    dv: Hashable,
    within: Any,
    subject: Hashable,
    between: Any = None,
    order: Any = None,
    covariates: Any = None,
) -> tuple[pd.DataFrame, Levels, Levels]:
    """
    Return a long table with subjects and factors as categories, and the levels of the factors
    within and between subjects. `order` has the levels of a single factor (that within), or of
    several by name.
    """
    within, between, covariates = map(names_of, (within, between, covariates))
    factors = within + between
    if not factors:
        raise ValueError("within and between name no factor")
    columns = {"dv": [dv], "within": within, "between": between, "covariates": covariates}
    arguments = roles_of("frame", frame, **columns, subject=[subject])
    if order is not None and not isinstance(order, dict):
        single = len(within or between) == 1
        order = {factors[0]: order} if single else of_class("order", order, dict)
    order = order or {}
    if unknown := [name for name in order if name not in factors]:
        raise ValueError(f"order: {unknown[0]!r} is not a factor of this design: {factors}")
    table, levels = frame.copy(), {}
    for name in [subject, *factors]:
        levels[name] = levels_of(frame[name], arguments[name], order.get(name))
        table[name] = pd.Categorical(frame[name].tolist(), labels_index(levels[name]))
        if len(levels[name]) < 2 and name != subject:
            raise ValueError(
                f"{arguments[name]}: column {name!r} has one condition only, {levels[name]}"
            )
    labels = frame[factors + covariates].groupby(frame[subject], sort=False).nunique()
    for name in factors + covariates:
        several = labels.index[labels[name] > 1].tolist()
        if name in within and not several:
            raise ValueError(
                f"within: column {name!r} has one label for every person; give between={name!r}"
            )
        if name not in within and several:
            raise ValueError(
                f"{arguments[name]}: subject {several[0]!r} has several labels in column {name!r}"
            )
    inside, groups = ({name: levels[name] for name in names} for names in (within, between))
    return table, inside, groups


def labels_index(labels: Iterable) -> pd.Index:
    """Return labels as an index; tuples stay one label each."""
    return pd.Index(labels, dtype=object, tupleize_cols=False)


def cells_of(levels: Levels) -> list:
    """Return the cells of factors, the last varying fastest: tuples; of one factor its levels."""
    return [cell if len(levels) > 1 else cell[0] for cell in product(*levels.values())]


def refuse_shared(factors: Iterable, statistics: Iterable) -> None:
    """Refuse a factor that has the name of a column beside it."""
    for name in {*factors} & {*statistics}:
        raise ValueError(f"{name!r} is the name of a factor and of a statistic; rename it")


def one_row_a_cell(table: pd.DataFrame, names: list[Hashable], dv: Hashable) -> None:
    """Refuse a table with two rows of one label in all of these columns."""
    for row in table.index[table.duplicated(names)]:
        raise ValueError(
            f"dv: there is more than one row for a cell, such as row {row!r}; average the trials "
            f"of a cell first: frame[{dv!r}] = frame.groupby({names})[{dv!r}].transform('mean'), "
            f"then frame.drop_duplicates({names})"
        )


def read_cells(
    table: pd.DataFrame, levels: Levels, dv: Hashable, subject: Hashable
) -> pd.DataFrame:
    """
    Return the scores of all subjects, a row each, in all cells of the factors, NaN where there is
    none; the last factor varies fastest, and its cells are called by tuples of levels.
    """
    scores = numbers_of(table[dv], "dv")
    names = [subject, *levels]
    one_row_a_cell(table, names, dv)
    subjects = table[subject].cat.categories
    values = np.full([len(subjects), *map(len, levels.values())], np.nan)
    values[*(table[name].cat.codes for name in names)] = scores
    cells = labels_index(cells_of(levels))
    wide = pd.DataFrame(values.reshape(len(subjects), -1), subjects, cells)
    return labelled(wide, origin_of(table))


def complete_scores(
    scores: pd.DataFrame, dv: Hashable, missing: str = "raise", remedy: str = "leave them out"
) -> tuple[pd.DataFrame, tuple]:
    """
    Return scores of subjects without missing cells, and the subjects left out
    (missing="listwise").
    """
    one_of("missing", missing, ("raise", "listwise"))
    complete = scores.notna().all(axis=1)
    gaps = [
        f"subject {subject!r} has no score in condition "
        f"{', '.join(map(repr, row.index[row.isna()]))}"
        for subject, row in scores[~complete].iterrows()
    ]
    if len(gaps) > _SHOWN:
        gaps[_SHOWN:] = [f"and {len(gaps) - _SHOWN} more"]
    if gaps and missing == "raise":
        raise ValueError(
            f"missing cells in {dv!r}: {'; '.join(gaps)}. Complete these subjects, or {remedy}"
        )
    if complete.sum() < 3:
        raise ValueError(
            f"subject: {counted(complete.sum(), 'complete subject')} with scores in {dv!r}; at "
            f"least three are needed. {'; '.join(gaps)}"
        )
    return scores[complete], tuple(scores.index[~complete])
