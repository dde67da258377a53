"""All checks together: one table with a row per printed number, in their order."""

import re
from collections.abc import Iterator, Mapping
from contextlib import suppress

import pandas as pd

from trustlab.reproduction.audit.catalogue import printed_numbers, why_unchecked
from trustlab.reproduction.audit.check import NotPrintedError, Numbers, Row, row_about
from trustlab.reproduction.audit.consistency import (
    remarks,
    restated_rows,
    sample_checks,
    study_conflicts,
)
from trustlab.reproduction.audit.relations import relations


def checked_rows(numbers: Numbers, conflicts: Mapping[str, str]) -> Iterator[Row]:
    """Return the rows of all checks, given what conflicts."""
    for relation in relations(numbers):
        with suppress(NotPrintedError):  # a study need not print all that its relations use
            yield relation.row(numbers)
    yield from sample_checks(numbers)
    yield from remarks(numbers, conflicts)
    yield from restated_rows(numbers)


def audit(changes: Mapping[str, str] | None = None) -> pd.DataFrame:
    """
    Recompute every printed number that follows from others, and judge whether it does.

    Every input varies within half a unit of its last printed digit; the range of the result decides
    the verdict.

    Parameters
    ----------
    changes : mapping of str to str, optional
        Other values to put in place of printed ones, by id, for example {"table_2.1/delta_TSC/2":
        "0.0061"}: the audit of a corrected, or a spoiled, dissertation.

    Returns
    -------
    pandas.DataFrame
        One row per printed number, and further rows where a number is checked in more than one way.
        Columns id, where, quantity, printed (text), recomputed, low, high (its range within
        rounding, or the range that other numbers allow), verdict, reason, formula, inputs.
        Verdicts: "reproduced", it follows at its printed precision; "within rounding", it follows
        for inputs that round as printed; "differs", it does not, whatever the rounding and by every
        convention tried; "not checkable", no printed number determines it. A reason that begins
        with "Suspicious" names a slip that is likely, not certain.

    Raises
    ------
    ValueError
        If a change names no printed number or is not the text of a number.

    Examples
    --------
    >>> import trustlab as tl
    >>> verdicts = tl.audit()
    >>> verdicts["verdict"].value_counts().to_dict()
    {'not checkable': 443, 'reproduced': 178, 'differs': 21, 'within rounding': 17}
    """
    numbers = printed_numbers(changes)
    conflicts = study_conflicts(numbers)
    rows = list(checked_rows(numbers, conflicts))

    def about(row: Row) -> str:
        """Return the number whose id a row has or continues; an empty text if none."""
        id = row.id
        while id and id not in numbers:
            id = id.rpartition("/")[0]
        return id

    # To be printed twice is no check.
    checked = {about(row) for row in rows if not row.id.endswith("/duplicate")}
    for id in numbers.keys() - checked:
        rows.append(row_about(numbers[id], why_unchecked(id)))
    # What a study contradicts is wrong, though other numbers may agree with it.
    rows = [
        row._replace(verdict="differs", reason=conflicts[row.id])
        if row.id in conflicts and row.verdict != "differs"
        else row
        for row in rows
    ]
    differ = {row.id for row in rows if row.verdict == "differs"}
    order = [*numbers, ""]
    rows.sort(key=lambda row: (order.index(about(row)), row.id))
    return pd.DataFrame([_resting(row, differ) for row in rows])


def _resting(row: Row, differ: set[str]) -> Row:
    """Return a row that says on which numbers it rests that do not follow from others."""
    used = [id for id in re.findall(r"\(([^()\s]+)\)", row.inputs) if id in differ]
    if not used or row.formula.startswith("number of"):  # which counts its inputs
        return row
    return row._replace(reason=f"{row.reason} Rests on {', '.join(used)}, judged “differs”.")
