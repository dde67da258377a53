"""All checks together: one table with a row per printed number, in their order."""

import re
from collections.abc import Mapping

import pandas as pd

from trustlab.models.display import axes_or_new
from trustlab.reproduction.audit.catalogue import printed_numbers, why_unchecked
from trustlab.reproduction.audit.check import VERDICTS, Row, row_about, rows_of
from trustlab.reproduction.audit.consistency import (
    joint_rows,
    relation_checks,
    sample_checks,
    study_checks,
)
from trustlab.reproduction.published import published_facts

MAKERS = (
    relation_checks,
    study_checks,
    sample_checks,
    joint_rows,
)


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
    {'not checkable': 445, 'reproduced': 178, 'differs': 23, 'within rounding': 23}
    """
    numbers = printed_numbers(changes)
    rows = [row for maker in MAKERS for row in rows_of(maker(numbers), numbers)]
    # A number counts as checked if a row has its id, or continues it after a slash; to be printed
    # twice is no check.
    checks = [row.id for row in rows if not row.id.endswith("/duplicate")]
    checked = {start for id in checks for start in _ancestors(id)}
    rows += [row_about(numbers[id], why_unchecked(id)) for id in numbers if id not in checked]
    differ = {row.id for row in rows if row.verdict == "differs"}
    order = {id: i for i, id in enumerate(numbers)}

    def place(row: Row) -> tuple[int, str]:
        """Where the number stands that a row is about, or that its id continues."""
        return next((order[id] for id in _ancestors(row.id) if id in order), len(order)), row.id

    return pd.DataFrame([_resting(row, differ) for row in sorted(rows, key=place)])


def _resting(row: Row, differ: set[str]) -> Row:
    """Return a row that says on which numbers it rests that do not follow from others."""
    used = [id for id in re.findall(r"\(([^()\s]+)\)", row.inputs) if id in differ]
    if not used or row.formula.startswith("number of"):  # which counts its inputs
        return row
    return row._replace(reason=f"{row.reason} Rests on {', '.join(used)}, judged “differs”.")


def _ancestors(id: str) -> list[str]:
    """Return an id and what it begins with, up to each slash, longest first."""
    parts = id.split("/")
    return ["/".join(parts[:i]) for i in range(len(parts), 0, -1)]


COLOURS = dict(zip(VERDICTS, ("C2", "C5", "C1", "#bbbbbb"), strict=True))


def _part_of(where: str) -> str:
    """Return the part of the dissertation that the place of a printed number belongs to."""
    parts = published_facts("parts").items()
    return next(part for part, starts in parts if where.startswith(tuple(starts)))


def verdict_counts(verdicts: pd.DataFrame) -> pd.DataFrame:
    """
    Count the audit's verdicts, part by part.

    Parameters
    ----------
    verdicts : pandas.DataFrame
        What `audit` returns.

    Returns
    -------
    pandas.DataFrame
        Index part; a column per verdict, and all.
    """
    parts = verdicts["where"].map(_part_of).rename("part")
    counts = pd.crosstab(parts, verdicts["verdict"]).reindex(columns=list(VERDICTS), fill_value=0)
    return counts.assign(all=counts.sum(axis=1))


def plot_ranges(rows: pd.DataFrame, ax=None):
    """
    Draw recomputed values, their ranges within rounding, and the printed numbers.

    Parameters
    ----------
    rows : pandas.DataFrame
        Rows of the audit about one quantity, with a range.
    ax : matplotlib.axes.Axes, optional
        Where to draw; a new figure when not given.
    """
    ax = axes_or_new(ax, figsize=(7.2, 0.3 + 0.5 * len(rows)))
    for i, row in enumerate(rows.itertuples()):
        ax.plot([row.low, row.high], [i, i], color="#999999", lw=6, solid_capstyle="butt", zorder=1)
        ax.plot(row.recomputed, i, "o", color="black", zorder=2)
        ax.plot(float(row.printed), i, "D", color=COLOURS[row.verdict], zorder=3)
    ax.set_yticks(range(len(rows)), [where.partition(", ")[2] for where in rows["where"]])
    ax.invert_yaxis()
    ax.set_xlabel("recomputed (dot), its range within rounding (bar), printed (diamond)")
    return ax
