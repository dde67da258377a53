"""A long table with several factors, checked and arranged as subjects × cells."""

from collections.abc import Hashable, Mapping, Sequence
from itertools import product
from typing import Any

import numpy as np
import pandas as pd

from trustlab.models.checks import of_class, open_unit
from trustlab.studies.analysis.score_table import ScoreTable, complete_scores, levels_of, read_scores
from trustlab.studies.columns import column_of, number_or_nan
from trustlab.studies.factors.effects import between_design
from trustlab.studies.factors.factorial import FactorialMeasures, tested_effects


def factorial_measures(
    frame: pd.DataFrame,
    dv: Hashable,
    within: Sequence[Hashable],
    subject: Hashable,
    between: Sequence[Hashable],
    covariate: Hashable | None,
    missing: str,
    order: Mapping[Hashable, Sequence] | None,
    correction: str,
    alpha: float,
) -> FactorialMeasures:
    """Analyse a long table with factors `within` and `between` subjects; the arguments are those of `repeated_measures`."""
    of_class("frame", frame, pd.DataFrame, "with a row per subject and cell")
    alpha = open_unit("alpha", alpha)
    columns = [dv, subject, *within, *between, *([] if covariate is None else [covariate])]
    for name in columns:
        if columns.count(name) > 1:
            raise ValueError(f"every column has one part in a design, but {name!r} is named twice")
    order = {} if order is None else of_class("order", order, dict, "give the levels of each factor")
    if unknown := [name for name in order if name not in (*within, *between)]:
        raise ValueError(f"order: {unknown[0]!r} is not a factor of this design: {[*within, *between]}")
    levels = {name: tuple(levels_of(column_of(frame, "within", name), "within", order.get(name))) for name in within}
    for name, own in levels.items():
        if len(own) < 2:
            raise ValueError(f"within: column {name!r} has one level only, {own[0]!r}; a factor needs two")
    observed = _cells(frame, dv, levels, subject)
    scores, excluded = complete_scores(observed, missing)
    sides = {name: _per_subject(frame, "between", name, subject) for name in between}
    groups, labels = {}, {}
    for name, side in sides.items():
        sorted_in = [side[who] for who in scores.subjects]
        labels[name], groups[name] = _groups(frame, name, sorted_in, scores, order.get(name))
    covariates = {} if covariate is None else {str(covariate): _covariate(frame, covariate, subject, scores)}
    design = between_design(len(scores.subjects), {str(name): codes for name, codes in groups.items()}, covariates)
    if np.linalg.matrix_rank(design.matrix) < design.matrix.shape[1]:
        raise ValueError(f"between: some combination of {[*between]} has no participant: its effects are not defined")
    if design.df_error < 1:
        found = f"{len(scores.subjects)} participants {[*scores.subjects]} for {design.matrix.shape[1]} parameters"
        raise ValueError(f"subject: {found} leave nothing to estimate the error from")
    effects = tested_effects(scores, levels, design, correction, alpha).assign(excluded=len(excluded))
    effects.attrs |= {"origin": scores.origin} if scores.origin else {}
    return FactorialMeasures(scores, levels, labels, groups, covariate, design, effects, excluded, correction, alpha)


def _cells(frame: pd.DataFrame, dv: Hashable, levels: Mapping[Hashable, tuple], subject: Hashable) -> ScoreTable:
    """Return scores of every subject in every cell, whose label is the tuple of its levels."""
    name = " × ".join(map(str, levels))
    cells = np.empty(len(frame), dtype=object)
    cells[:] = list(zip(*(frame[factor].tolist() for factor in levels), strict=True))
    wanted, seen = list(product(*levels.values())), set(cells)
    if empty := [cell for cell in wanted if cell not in seen]:
        more = f" and {len(empty) - 1} more" if len(empty) > 1 else ""
        raise ValueError(f"within: no participant has a score in cell {empty[0]!r} of {name}{more}")
    long = pd.DataFrame({"subject": column_of(frame, "subject", subject), "dv": column_of(frame, "dv", dv)})
    long = long.assign(cell=cells)
    long.attrs = frame.attrs
    long.columns = pd.Index([subject, dv, name], tupleize_cols=False)
    return read_scores(long, dv, name, subject, order=wanted)


def _per_subject(frame: pd.DataFrame, argument: str, name: Hashable, subject: Hashable) -> dict:
    """Return the one value that each participant has in a column; a participant with two is refused by name."""
    found: dict[Hashable, Hashable] = {}
    for who, value in zip(frame[subject].tolist(), column_of(frame, argument, name).tolist(), strict=True):
        first = found.setdefault(who, value)
        if first != value and not (pd.isna(first) and pd.isna(value)):
            raise ValueError(f"{argument}: subject {who!r} has two values in column {name!r}, {first!r} and {value!r}")
    return found


def _groups(frame: pd.DataFrame, name: Hashable, own: list, scores: ScoreTable, order: Any) -> tuple:
    """Return the labels of a between-subject factor and the group number of every subject."""
    labels = tuple(label for label in levels_of(frame[name], "between", order) if label in own)
    members = {label: [who for who, x in zip(scores.subjects, own, strict=True) if x == label] for label in labels}
    if len(labels) < 2:
        raise ValueError(f"between: column {name!r} has one group only among the complete participants, {labels[0]!r}")
    for label, who in members.items():
        if len(who) < 2:
            raise ValueError(f"between: group {label!r} of {name!r} has one participant, {who[0]!r}; two are needed")
    return labels, np.array([labels.index(x) for x in own])


def _covariate(frame: pd.DataFrame, name: Hashable, subject: Hashable, scores: ScoreTable) -> np.ndarray:
    """Return a covariate of the subjects, finite and not the same for all."""
    found = _per_subject(frame, "covariate", name, subject)
    values = np.empty(len(scores.subjects))
    for i, who in enumerate(scores.subjects):
        try:
            values[i] = number_or_nan(found[who])
        except TypeError:
            values[i] = np.nan
        if not np.isfinite(values[i]):
            raise ValueError(f"covariate: column {name!r} is {found[who]!r} for subject {who!r}, no finite number")
    if np.ptp(values) == 0.0:
        raise ValueError(f"covariate: column {name!r} is {values[0]:g} for every participant; leave it out")
    return values
