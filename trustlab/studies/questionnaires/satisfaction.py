"""Satisfaction after a test, on a scale of five points (Chapter 2) or seven."""

from collections.abc import Mapping, Sequence
from typing import Any, Unpack

import pandas as pd

from trustlab.studies.questionnaires.likert import AnswerColumns, LikertScale, ScaleScores, score_likert

# The items of Section 2.4.1.3: satisfaction, comfort, and the feeling of being in control of the task.
SATISFACTION_ITEMS = ("satisfaction", "comfort", "control")


def satisfaction_scale(points: int, items: Any = SATISFACTION_ITEMS, reversed: Any = ()) -> LikertScale:
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
    source = f"satisfaction, 1 to {int(points)}"
    return LikertScale("satisfaction", items, 1, int(points), reversed, source=source)


def score_satisfaction(  # type: ignore[misc]  # `items` is among the columns too
    frame: pd.DataFrame,
    *,
    points: int,
    items: Mapping[str, str] | Sequence[str] = SATISFACTION_ITEMS,
    reversed: Sequence[str] = (),
    **columns: Unpack[AnswerColumns],
) -> ScaleScores:
    """
    Score satisfaction: mean and sum of its items.

    Parameters
    ----------
    frame : pandas.DataFrame
        Answers as given, not reversed: wide (a column per item) or, with `item` and `response`, long.
    points : {5, 7}
        Answers run from 1 to this.
    items : sequence of str or dict
        The items, which are the columns' names; or a dict of item → column (wide) or label in column `item` (long).
    reversed : sequence of str
        Items for which a high answer means little satisfaction.
    **columns : AnswerColumns
        The other keyword arguments of `score_likert`: subject, condition, item, response, missing.

    Returns
    -------
    ScaleScores
        Scores satisfaction_mean and satisfaction_sum.

    Raises
    ------
    ValueError
        Naming subject, condition and item of an answer that is missing, not a number, or not a whole number from 1 to
        `points`.

    Examples
    --------
    >>> import pandas as pd
    >>> import trustlab as tl
    >>> answers = pd.DataFrame({"person": [1, 2], "satisfaction": [6, 3], "comfort": [5, 4], "control": [7, 2]})
    >>> tl.score_satisfaction(answers, points=7, subject="person").table()
       person  satisfaction_mean  satisfaction_sum
    0       1                6.0              18.0
    1       2                3.0               9.0
    """
    if isinstance(items, str):
        raise ValueError(f"items must be a list of columns, got the text {items!r}")
    scale = satisfaction_scale(points, tuple(items), reversed)
    names = dict(items) if isinstance(items, Mapping) else None
    return score_likert(frame, scale, items=names, **columns)
