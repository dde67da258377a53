"""Trust between people and automation: the twelve-item checklist of Jian, Bisantz and Drury (2000)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import pandas as pd

from trustlab.studies.questionnaires.likert import LikertScale, ScaleScores, Subscale, score_likert

__all__ = ["TRUST_CHECKLIST", "score_trust_checklist"]

_DISTRUST = ("deceptive", "underhanded", "suspicious", "wary", "harmful")
_TRUST = ("confident", "security", "integrity", "dependable", "reliable", "trust", "familiar")

TRUST_CHECKLIST = LikertScale(
    name="trust",
    items=_DISTRUST + _TRUST,
    low=1,
    high=7,
    reversed=_DISTRUST,
    subscales=(Subscale("trust_subscale", _TRUST), Subscale("distrust_subscale", _DISTRUST)),
    source="trust checklist (Jian, Bisantz and Drury 2000)",
)
"""Items 1–5 (distrust) reversed in mean and sum; the subscales are means of answers as given, distrust included."""


def score_trust_checklist(
    frame: pd.DataFrame,
    *,
    subject: str,
    condition: str | None = None,
    items: Mapping[str, str] | Sequence[str] | None = None,
    item: str | None = None,
    response: str | None = None,
    missing: str = "refuse",
) -> ScaleScores:
    """
    Score the twelve-item trust checklist, 1 to 7, items 1–5 reversed.

    Parameters
    ----------
    frame : pandas.DataFrame
        Answers as given, not reversed: wide (a column per item) or, with `item` and `response`, long.
    subject, condition : str
        Columns that say whose answers these are and under which condition; `condition` may be None.
    items : dict or list, optional
        Item of TRUST_CHECKLIST → column (wide) or label in column `item` (long); or those of items 1 to 12.
    item, response : str, optional
        For a long table: the column that names the item and the one that holds the answer.
    missing : str
        "refuse", or "half_rule" (see `score_likert`).

    Returns
    -------
    ScaleScores
        Scores trust_mean (1–7), trust_sum (12–84), trust_subscale (1–7, items 6–12) and distrust_subscale (1–7, items
        1–5, high is distrust).

    Raises
    ------
    ValueError
        Naming subject, condition and item of an answer that is missing, no number, or no whole number from 1 to 7.

    References
    ----------
    J.-Y. Jian, A. M. Bisantz, C. G. Drury, Foundations for an empirically determined scale of trust in automated systems,
    International Journal of Cognitive Ergonomics 4 (2000) 53-71.
    """
    return score_likert(
        frame,
        TRUST_CHECKLIST,
        subject=subject,
        condition=condition,
        items=items,
        item=item,
        response=response,
        missing=missing,
    )
