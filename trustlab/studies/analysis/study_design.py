"""The factors of a study, read from a long table: cells of every subject, groups, a covariate."""

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
import pandas as pd

from trustlab.models.checks import of_class
from trustlab.studies.analysis.anova import BetweenDesign, between_design
from trustlab.studies.analysis.score_table import (
    ScoreTable,
    complete_scores,
    levels_of,
    read_scores,
)
from trustlab.studies.columns import column_of, number_or_nan, origin_of


@dataclass(frozen=True, eq=False)
class StudyDesign:
    """
    Factors within and between subjects.

    Parameters
    ----------
    within, between : dict of Hashable to tuple
        Factors and their levels; `between` is empty without groups. The last factor within subjects
        varies fastest among the cells.
    groups : dict of Hashable to numpy.ndarray
        For each between-subject factor the level number of every subject.
    covariate : Hashable or None
        Column with the covariate, taken about its mean.
    regressors : BetweenDesign
        The regressors of the subjects.
    """

    within: Mapping[Hashable, tuple]
    between: Mapping[Hashable, tuple]
    groups: Mapping[Hashable, np.ndarray]
    covariate: Hashable | None
    regressors: BetweenDesign

    @property
    def one_way(self) -> bool:
        """Whether there is one factor within subjects and nothing else."""
        return len(self.within) == 1 and not self.between and self.covariate is None

    @property
    def sizes(self) -> dict[str, int]:
        """How many levels each factor within subjects has."""
        return {str(name): len(levels) for name, levels in self.within.items()}

    @property
    def cells(self) -> list[tuple]:
        """The levels of every cell."""
        return list(product(*self.within.values()))

    def levels(self, factor: Hashable) -> tuple:
        """Return the levels of a factor; an unknown one is refused."""
        factors = {**self.within, **self.between}
        if factor not in factors:
            raise ValueError(f"{factor!r} is not a factor of this design: {[*factors]}")
        return factors[factor]

    def members(self) -> list[tuple[tuple, np.ndarray]]:
        """Return every combination of groups with a mask of its subjects."""
        n = len(self.regressors.matrix)
        combinations = []
        for levels in product(*self.between.values()):
            mask = np.ones(n, dtype=bool)
            for (name, labels), level in zip(self.between.items(), levels, strict=True):
                mask &= self.groups[name] == labels.index(level)
            combinations.append((levels, mask))
        return combinations

    def marginal(self, fixed: Mapping[Hashable, Hashable]) -> tuple[np.ndarray, np.ndarray]:
        """
        Return the weights of the cells, and the row of the between-subject design, of a mean at
        fixed levels of some factors, unweighted over the others.
        """
        cells = [_fits(dict(zip(self.within, cell, strict=True)), fixed) for cell in self.cells]
        rows = [
            self.regressors.matrix[mask][0]
            for levels, mask in self.members()
            if _fits(dict(zip(self.between, levels, strict=True)), fixed)
        ]
        row = np.mean(rows, axis=0)
        if self.covariate is not None:
            row[self.regressors.blocks[str(self.covariate)]] = 0.0  # its mean
        return np.array(cells) / sum(cells), row

    def marginals(
        self, factor: Hashable, at: Hashable = None
    ) -> list[tuple[Hashable, np.ndarray, np.ndarray]]:
        """
        Return the cell weights (cells, k) and design rows (k, columns) of the means of a factor's k
        levels, with each level of `at`; over all cells, with NaN, where `at` is None.
        """
        labels = self.levels(factor)
        if factor == at:
            raise ValueError(f"factor and at are both {factor!r}; name two factors")
        tables = []
        for level in (np.nan,) if at is None else self.levels(at):
            fixed = {} if at is None else {at: level}
            means = [self.marginal(fixed | {factor: label}) for label in labels]
            weights, rows = (np.array(part) for part in zip(*means, strict=True))
            tables.append((level, weights.T, rows))
        return tables


def _fits(levels: Mapping[Hashable, Hashable], fixed: Mapping[Hashable, Hashable]) -> bool:
    """Return whether a cell or group has the fixed levels of its factors."""
    return all(fixed.get(name, level) == level for name, level in levels.items())


def read_design(
    frame: pd.DataFrame,
    dv: Hashable,
    within: Sequence[Hashable],
    subject: Hashable,
    between: Sequence[Hashable],
    covariate: Hashable | None,
    missing: str,
    order: Any,
) -> tuple[ScoreTable, ScoreTable, tuple, StudyDesign]:
    """
    Return the scores as read, the complete ones, the subjects excluded and the design; the
    arguments are those of `repeated_measures`.
    """
    of_class("frame", frame, pd.DataFrame, "with a row per subject and condition")
    columns = [dv, subject, *within, *between, *([] if covariate is None else [covariate])]
    for name in columns:
        if len(columns) > 3 and columns.count(name) > 1:
            raise ValueError(f"every column has one part in a design, but {name!r} is named twice")
    if order is None:
        order = {}
    elif len(within) == 1 and not isinstance(order, dict):
        order = {within[0]: order}
    of_class("order", order, dict, "give the levels of each factor")
    if unknown := [name for name in order if name not in (*within, *between)]:
        raise ValueError(
            f"order: {unknown[0]!r} is not a factor of this design: {[*within, *between]}"
        )
    if len(within) == 1:
        conditions = order.get(within[0]) if order else None
        observed = read_scores(frame, dv, within[0], subject, order=conditions)
        levels = {within[0]: observed.conditions}
    else:
        levels = {name: _levels(frame, name, order.get(name)) for name in within}
        observed = _read_cells(frame, dv, levels, subject)
    scores, excluded = complete_scores(observed, missing)
    groups = {}
    labels = {}
    for name in between:
        members = _per_subject(frame, "between", name, subject)
        column = [members[label] for label in scores.subjects]
        labels[name] = _groups(frame, name, column, scores, order.get(name))
        groups[name] = np.array([labels[name].index(label) for label in column])
    covariates = (
        {} if covariate is None else {str(covariate): _covariate(frame, covariate, subject, scores)}
    )
    regressors = between_design(
        len(scores.subjects), {str(name): codes for name, codes in groups.items()}, covariates
    )
    _check_rank(regressors, between, scores)
    return observed, scores, excluded, StudyDesign(levels, labels, groups, covariate, regressors)


def _levels(frame: pd.DataFrame, name: Hashable, order: Any) -> tuple:
    """Return the levels of a within-subject factor."""
    levels = tuple(levels_of(column_of(frame, "within", name), "within", order))
    if len(levels) < 2:
        raise ValueError(
            f"within: column {name!r} has one level only, {levels[0]!r}; a factor needs two"
        )
    return levels


def _check_rank(regressors: BetweenDesign, between: Sequence[Hashable], scores: ScoreTable) -> None:
    """Refuse groups whose effects are not defined or that leave no degree of freedom."""
    n, columns = regressors.matrix.shape
    if np.linalg.matrix_rank(regressors.matrix) < columns:
        raise ValueError(
            f"between: some combination of {[*between]} has no participant: its effects are not "
            "defined"
        )
    if regressors.df_error < 1:
        raise ValueError(
            f"subject: {n} participants {[*scores.subjects]} for {columns} parameters leave "
            "nothing to estimate the error from"
        )


def _read_cells(
    frame: pd.DataFrame, dv: Hashable, levels: Mapping[Hashable, tuple], subject: Hashable
) -> ScoreTable:
    """Return scores of every subject in every cell, whose label is the tuple of its levels."""
    name = " × ".join(map(str, levels))
    labels = np.empty(len(frame), dtype=object)
    labels[:] = list(zip(*(frame[factor].tolist() for factor in levels), strict=True))
    cells = list(product(*levels.values()))
    occurring = set(labels)
    if empty := [cell for cell in cells if cell not in occurring]:
        more = f" and {len(empty) - 1} more" if len(empty) > 1 else ""
        raise ValueError(f"within: no participant has a score in cell {empty[0]!r} of {name}{more}")
    long = pd.DataFrame(
        {"subject": column_of(frame, "subject", subject), "dv": column_of(frame, "dv", dv)}
    )
    long = long.assign(cell=labels)
    long.attrs = frame.attrs | {"origin": origin_of(frame)}
    long.columns = pd.Index([subject, dv, name], tupleize_cols=False)
    return read_scores(long, dv, name, subject, order=cells)


def _per_subject(frame: pd.DataFrame, argument: str, name: Hashable, subject: Hashable) -> dict:
    """Return each participant's value in a column; a participant with two is refused by name."""
    values: dict[Hashable, Hashable] = {}
    column = column_of(frame, argument, name).tolist()
    for label, value in zip(frame[subject].tolist(), column, strict=True):
        first = values.setdefault(label, value)
        if first != value and not (pd.isna(first) and pd.isna(value)):
            raise ValueError(
                f"{argument}: subject {label!r} has two values in column {name!r}, {first!r} and "
                f"{value!r}"
            )
    return values


def _groups(
    frame: pd.DataFrame, name: Hashable, column: list, scores: ScoreTable, order: Any
) -> tuple:
    """Return the labels of a between-subject factor, each with two participants or more."""
    levels = levels_of(frame[name], "between", order)
    labels = tuple(label for label in levels if label in column)
    if len(labels) < 2:
        raise ValueError(
            f"between: column {name!r} has one group only among the complete participants, "
            f"{labels[0]!r}"
        )
    for label in labels:
        if column.count(label) < 2:
            raise ValueError(
                f"between: group {label!r} of {name!r} has one participant, "
                f"{scores.subjects[column.index(label)]!r}; two are needed"
            )
    return labels


def _covariate(
    frame: pd.DataFrame, name: Hashable, subject: Hashable, scores: ScoreTable
) -> np.ndarray:
    """Return a covariate of the subjects, finite and not the same for all."""
    column = _per_subject(frame, "covariate", name, subject)
    values = np.empty(len(scores.subjects))
    for i, label in enumerate(scores.subjects):
        try:
            values[i] = number_or_nan(column[label])
        except TypeError:
            values[i] = np.nan
        if not np.isfinite(values[i]):
            raise ValueError(
                f"covariate: column {name!r} is {column[label]!r} for subject {label!r}, no "
                "finite number"
            )
    if np.ptp(values) == 0.0:
        raise ValueError(
            f"covariate: column {name!r} is {values[0]:g} for every participant; leave it out"
        )
    return values
