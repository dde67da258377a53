"""All checks together: one table with a row per printed number, in the order in which they are printed."""

import re
from collections.abc import Mapping
from dataclasses import astuple, fields, replace

import pandas as pd

from trustlab.reproduction.audit.catalogue import printed_numbers, why_unchecked
from trustlab.reproduction.audit.joint_consistency import joint_rows
from trustlab.reproduction.audit.models import model_checks
from trustlab.reproduction.audit.sample_moments import sample_checks
from trustlab.reproduction.audit.statements import claim_checks, setting_checks, statement_checks
from trustlab.reproduction.audit.statistics import study_checks
from trustlab.reproduction.audit.verdict import Remark, Row, rows_of

MAKERS = (model_checks, study_checks, sample_checks, claim_checks, statement_checks, setting_checks, joint_rows)


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
        If a change names no printed number or is not the text of a number.

    Examples
    --------
    >>> import trustlab as tl
    >>> verdicts = tl.audit()
    >>> verdicts["verdict"].value_counts().to_dict()
    {'not checkable': 451, 'reproduced': 179, 'differs': 24, 'within rounding': 23}
    """
    numbers = printed_numbers(changes)
    rows = [row for maker in MAKERS for row in rows_of(maker(numbers), numbers)]
    # A number counts as checked if a row has its id, or continues it after a slash.
    checked = {start for row in rows for start in _ancestors(row.id)}
    rows += rows_of([Remark(id, why_unchecked(id)) for id in numbers if id not in checked], numbers)
    differ = {row.id for row in rows if row.verdict == "differs"}
    rows = [_resting(row, differ) for row in rows]
    order = {id: i for i, id in enumerate(numbers)}
    place = {row.id: next((order[x] for x in _ancestors(row.id) if x in order), len(order)) for row in rows}
    rows.sort(key=lambda row: (place[row.id], row.id))
    return pd.DataFrame([astuple(row) for row in rows], columns=[field.name for field in fields(Row)])


def _resting(row: Row, differ: set[str]) -> Row:
    """Return a row that says on which numbers it rests that do not follow from others."""
    used = [id for id in re.findall(r"\(([^()\s]+)\)", row.inputs) if id in differ]
    if row.formula.startswith("number of"):  # which counts its inputs, whatever they are
        return row
    return replace(row, reason=f"{row.reason} Rests on {', '.join(used)}, judged “differs”.") if used else row


def _ancestors(id: str) -> list[str]:
    """Return an id and what it begins with, up to each slash, longest first."""
    parts = id.split("/")
    return ["/".join(parts[:i]) for i in range(len(parts), 0, -1)]
