"""The audit: every printed number that follows from others, recomputed, with a verdict and its reason."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import astuple

import pandas as pd

from trustlab.reproduction.audit_checks import COLUMNS, VERDICTS, Remark
from trustlab.reproduction.audit_claims import claim_checks
from trustlab.reproduction.audit_columns import column_rows
from trustlab.reproduction.audit_model_tables import model_checks
from trustlab.reproduction.audit_numbers import printed_numbers
from trustlab.reproduction.audit_samples import sample_checks
from trustlab.reproduction.audit_statements import statement_checks
from trustlab.reproduction.audit_studies import study_checks

__all__ = ["VERDICTS", "audit"]


def audit(changes: Mapping[str, str] | None = None) -> pd.DataFrame:
    """
    Recompute every printed number that depends on other printed numbers, and say whether it follows from them.

    Every input varies within half a unit of its last printed digit; the range of the result decides the verdict.

    Parameters
    ----------
    changes : mapping of str to str, optional
        Other values to put in place of printed ones, by id, for example {"table_2.1/delta_TSC/2": "0.0061"}: the audit
        of a corrected, or a spoiled, dissertation.

    Returns
    -------
    pandas.DataFrame
        One row per printed number, and further rows where a number is checked in more than one way. Columns id, where,
        quantity, printed (text), recomputed, low, high (its range within rounding, or the range that other numbers
        allow), verdict, reason, formula, inputs. Verdicts: "reproduced", it follows at its printed precision; "within
        rounding", it follows for inputs that round as printed; "differs", it does not, whatever the rounding and by
        every convention tried; "not checkable", no printed number determines it. A reason that begins with
        "Suspicious" names a slip that is likely, not certain.

    Raises
    ------
    ValueError
        If a change names no printed number or is no text of a number.
    """
    numbers = printed_numbers(changes)
    makers = (model_checks, study_checks, sample_checks, claim_checks, statement_checks)
    rows = [check.row(numbers) for maker in makers for check in maker(numbers)]
    rows += column_rows(numbers)
    seen = {row.id for row in rows}
    for id in numbers:
        if id not in seen and not any(other.startswith(f"{id}/") for other in seen):
            rows.append(
                Remark(id, "Chosen or measured by the author; no other printed number bears on it.").row(
                    numbers
                )
            )
    order = {id: i for i, id in enumerate(numbers)}
    place = {row.id: next((order[x] for x in _ancestors(row.id) if x in order), len(order)) for row in rows}
    rows.sort(key=lambda row: (place[row.id], row.id))
    return pd.DataFrame([astuple(row) for row in rows], columns=list(COLUMNS))


def _ancestors(id: str) -> list[str]:
    """Return an id and what it begins with, up to each slash, longest first."""
    parts = id.split("/")
    return ["/".join(parts[:i]) for i in range(len(parts), 0, -1)]
