"""Trust between people and automation: the twelve-item checklist of Jian, Bisantz and Drury (2000)."""

from typing import Unpack

import pandas as pd

from trustlab.studies.questionnaires.likert import AnswerColumns, LikertScale, ScaleScores, Subscale, score_likert

_DISTRUST = ("deceptive", "underhanded", "suspicious", "wary", "harmful")
_TRUST = ("confident", "security", "integrity", "dependable", "reliable", "trust", "familiar")

#: Items 1–5 (distrust) are reversed in mean and sum; both subscales are means of the answers as given.
TRUST_CHECKLIST = LikertScale(
    name="trust",
    items=_DISTRUST + _TRUST,
    low=1,
    high=7,
    reversed=_DISTRUST,
    subscales=(Subscale("trust_subscale", _TRUST), Subscale("distrust_subscale", _DISTRUST)),
    source="trust checklist (Jian, Bisantz and Drury 2000)",
)


def score_trust_checklist(frame: pd.DataFrame, **columns: Unpack[AnswerColumns]) -> ScaleScores:
    """
    Score the twelve-item trust checklist, 1 to 7, items 1–5 reversed.

    Parameters
    ----------
    frame : pandas.DataFrame
        Answers as given, not reversed: wide (a column per item) or, with `item` and `response`, long.
    **columns : AnswerColumns
        The keyword arguments of `score_likert`: subject, condition, items, item, response, missing. `items` maps items of
        TRUST_CHECKLIST to columns (wide) or to labels in column `item` (long), or lists those of items 1 to 12.

    Returns
    -------
    ScaleScores
        Scores trust_mean (1–7), trust_sum (12–84), trust_subscale (1–7, items 6–12) and distrust_subscale (1–7, items
        1–5, where a high score is distrust).

    Raises
    ------
    ValueError
        Naming subject, condition and item of an answer that is missing, not a number, or not a whole number from 1 to 7.

    References
    ----------
    J.-Y. Jian, A. M. Bisantz, C. G. Drury, Foundations for an empirically determined scale of trust in automated systems,
    International Journal of Cognitive Ergonomics 4 (2000) 53-71.

    Examples
    --------
    >>> import pandas as pd
    >>> import trustlab as tl
    >>> answers = pd.DataFrame([dict.fromkeys(tl.studies.TRUST_CHECKLIST.items, 4)]).assign(person=1)
    >>> tl.score_trust_checklist(answers, subject="person").table()
       person  trust_mean  trust_sum  trust_subscale  distrust_subscale
    0       1         4.0       48.0             4.0                4.0
    """
    return score_likert(frame, TRUST_CHECKLIST, **columns)
