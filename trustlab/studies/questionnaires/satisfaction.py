"""Satisfaction after a test, on a scale of five points (Chapter 2) or seven."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import pandas as pd

from trustlab.studies.questionnaires.likert import LikertScale, ScaleScores, score_likert

__all__ = ["SATISFACTION_ITEMS", "satisfaction_scale", "score_satisfaction"]

SATISFACTION_ITEMS = ("satisfaction", "comfort", "control")
"""What Section 2.4.1.3 asks for: satisfaction, comfort, and the feeling of being in control of the task."""


def satisfaction_scale(
    points: int, items: Sequence[str] = SATISFACTION_ITEMS, reversed: Sequence[str] = ()
) -> LikertScale:
    """
    Return a satisfaction scale.

    Parameters
    ----------
    points : {5, 7}
        Answers run from 1 to this.
    items : sequence of str
        Short names of the items.
    reversed : sequence of str
        Items for which a high answer means little satisfaction.

    Raises
    ------
    ValueError
        If `points` is neither 5 nor 7, or a reversed item is none of the items.
    """
    if isinstance(points, bool) or points not in (5, 7):
        raise ValueError(f"points must be 5 or 7, got {points!r}; for other scales use LikertScale")
    return LikertScale(
        "satisfaction", items, 1, int(points), reversed, source=f"satisfaction, 1 to {int(points)}"
    )


def score_satisfaction(
    frame: pd.DataFrame,
    *,
    points: int,
    subject: str,
    condition: str | None = None,
    items: Mapping[str, str] | Sequence[str] = SATISFACTION_ITEMS,
    reversed: Sequence[str] = (),
    item: str | None = None,
    response: str | None = None,
    missing: str = "refuse",
) -> ScaleScores:
    """
    Score satisfaction: mean and sum of its items.

    Parameters
    ----------
    frame : pandas.DataFrame
        Answers as given, not reversed: wide (a column per item) or, with `item` and `response`, long.
    points : {5, 7}
        Answers run from 1 to this.
    subject, condition : str
        Columns that say whose answers these are and under which condition; `condition` may be None.
    items : sequence of str or dict
        The items, which are the columns' names; or a dict of item → column (wide) or label in column `item` (long).
    reversed : sequence of str
        Items for which a high answer means little satisfaction.
    item, response : str, optional
        For a long table: the column that names the item and the one that holds the answer.
    missing : str
        "refuse", or "half_rule" (see `score_likert`).

    Returns
    -------
    ScaleScores
        Scores satisfaction_mean and satisfaction_sum.

    Raises
    ------
    ValueError
        Naming subject, condition and item of an answer that is missing, no number, or no whole number from 1 to `points`.
    """
    if isinstance(items, str):
        raise ValueError(f"items must be a list of columns, got the text {items!r}")
    scale = satisfaction_scale(points, tuple(items), reversed)
    return score_likert(
        frame,
        scale,
        subject=subject,
        condition=condition,
        items=dict(items) if isinstance(items, Mapping) else None,
        item=item,
        response=response,
        missing=missing,
    )
