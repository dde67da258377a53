"""
Likert scales: reversed items, subscales, missing answers by a named rule, and scores that know
their range.

Two of them are at hand: satisfaction on five points (Chapter 2) or seven, and the trust checklist
of Jian, Bisantz and Drury.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Required, TypedDict, Unpack

import numpy as np
import pandas as pd

from trustlab.models.checks import finite_number, in_order, of_class, one_of, open_unit
from trustlab.models.display import as_html
from trustlab.studies.questionnaires.answers import answer_name, check_answers, read_answers
from trustlab.studies.table import origin_of


@dataclass(frozen=True, eq=False)
class Reliability:
    """
    Internal consistency of a scale.

    Parameters
    ----------
    alpha : float
        Cronbach's alpha.
    ci_low, ci_high : float
        Its interval (Feldt's F interval, unrounded).
    confidence : float
        The interval's level.
    n, items : int
        How many subjects and items.
    without : pandas.Series
        Alpha of the scale less each item; NaN where one item is left.
    """

    alpha: float
    ci_low: float
    ci_high: float
    confidence: float
    n: int
    items: int
    without: pd.Series

    def table(self) -> pd.DataFrame:
        """Return one row: n, items, alpha, ci_low, ci_high."""
        names = ("n", "items", "alpha", "ci_low", "ci_high")
        return pd.DataFrame([{name: getattr(self, name) for name in names}])


def cronbach_alpha(items: pd.DataFrame, confidence: float = 0.95) -> Reliability:
    """
    Return Cronbach's alpha of items scored in the same direction, α = k/(k − 1) · (1 − Σ s_i²/s²),
    by pingouin.

    Parameters
    ----------
    items : pandas.DataFrame
        A row per subject, a column per item, reversed items already recoded; no missing values.
    confidence : float
        Level of the interval.

    Returns
    -------
    Reliability

    Raises
    ------
    ValueError
        If there are fewer than two items or three subjects, an answer is missing or not a number,
        or the sum of the items is the same for all subjects.

    References
    ----------
    L. S. Feldt, D. J. Woodruff, F. A. Salih, Statistical inference for coefficient alpha, Applied
    Psychological Measurement 11 (1987) 93-103.

    Examples
    --------
    >>> import pandas as pd
    >>> import trustlab as tl
    >>> items = pd.DataFrame({"q1": [1, 2, 4, 5], "q2": [2, 2, 5, 4], "q3": [1, 3, 4, 5]})
    >>> round(tl.cronbach_alpha(items).alpha, 3)
    0.946
    """
    from pingouin import cronbach_alpha as alpha_of
    from scipy.stats import f

    of_class("items", items, pd.DataFrame, "give a column per item")
    confidence = open_unit("confidence", confidence)
    n, k = items.shape
    if k < 2:
        raise ValueError(f"alpha needs at least two items, got {k}")
    if n < 3:
        raise ValueError(f"alpha needs at least three subjects who answered every item, got {n}")
    for j, name in enumerate(items.columns):
        if name in items.columns[:j]:
            raise ValueError(f"item {name!r} occurs twice; keep or rename one of the columns")
        column = items.iloc[:, j]
        if column.dtype.kind not in "iuf" or not np.isfinite(column).all():
            raise ValueError(f"item {name!r} must hold only finite numbers (dtype {column.dtype})")
    numbers = items.astype(float).set_axis(range(k), axis=1).reset_index(drop=True)
    if np.abs(numbers.to_numpy()).max() > 1e100:
        raise ValueError("items are so large that their squares overflow; change their unit")
    # Squares of tiny numbers underflow.
    numbers /= np.ldexp(1.0, np.frexp(np.abs(numbers.to_numpy()).max())[1])
    if np.ptp(numbers.sum(axis=1)) == 0.0:
        raise ValueError("the items' sum is the same for all subjects: alpha is not defined")
    alpha = float(alpha_of(data=numbers)[0])
    df1 = n - 1
    df2 = (n - 1) * (k - 1)
    tail = (1.0 - confidence) / 2.0
    low, high = (1.0 - (1.0 - alpha) * float(f.isf(p, df1, df2)) for p in (tail, 1.0 - tail))
    rest = {}
    for j, name in enumerate(items.columns):
        left = numbers.drop(columns=j)
        rest[name] = (
            float(alpha_of(data=left)[0]) if k > 2 and np.ptp(left.sum(axis=1)) > 0.0 else np.nan
        )
    return Reliability(alpha, low, high, confidence, n, k, pd.Series(rest, name="alpha_without"))


# Every item must be answered; or a score is formed where at least half of its items are answered.
MISSING_RULES = ("refuse", "half_rule")

# The items of Section 2.4.1.3: satisfaction, comfort, and the feeling of being in control of the
# task.
SATISFACTION_ITEMS = ("satisfaction", "comfort", "control")


@dataclass(frozen=True)
class Subscale:
    """
    Some items of a questionnaire that have a score of their own.

    Parameters
    ----------
    name : str
        The score's column.
    items : tuple of str
        Its items.
    reversed : tuple of str
        Those of them that are reversed within this subscale.
    """

    name: str
    items: tuple[str, ...]
    reversed: tuple[str, ...] = ()


def _check_names(
    what: str, names: Sequence[str], known: Sequence[str] | None = None, least: int = 1
) -> None:
    """Refuse names of items that are too few, occur twice or are not among those known."""
    if isinstance(names, str) or not all(isinstance(name, str) and name.strip() for name in names):
        raise ValueError(f"{what} must be a list of names, got {names!r}")
    if len(names) < least:
        raise ValueError(f"{what} must name at least one item")
    for i, name in enumerate(names):
        if name in names[:i]:
            raise ValueError(f"{what}: {name!r} occurs twice")
        if known is not None and name not in known:
            raise ValueError(f"{what}: {name!r} is not one of the items {', '.join(known)}")


@dataclass(frozen=True)
class LikertScale:
    """
    A questionnaire with one response scale for all its items.

    Parameters
    ----------
    name : str
        The questionnaire's name; its scores are the columns ``<name>_mean`` and ``<name>_sum``.
    items : tuple of str
        Short names of the items.
    low, high : float
        The ends of the response scale.
    reversed : tuple of str
        Items worded in the opposite direction, scored as low + high − answer.
    subscales : tuple of Subscale
        Further scores, the means of some items.
    step : float or None
        Distance between answers; None for a continuous scale.
    source : str
        Where the questionnaire comes from.

    Raises
    ------
    ValueError
        If items repeat, a reversed item or an item of a subscale is not among the items, or low is
        not below high.
    """

    name: str
    items: tuple[str, ...]
    low: float
    high: float
    reversed: tuple[str, ...] = ()
    subscales: tuple[Subscale, ...] = ()
    step: float | None = 1.0
    source: str = ""

    def __post_init__(self):
        if not isinstance(self.name, str) or not self.name.strip():
            raise ValueError(f"name must be a name, got {self.name!r}")
        _check_names("items", self.items)
        _check_names("reversed", self.reversed, self.items, least=0)
        for field in ("items", "reversed"):
            object.__setattr__(self, field, tuple(getattr(self, field)))
        taken = [f"{self.name}_mean", f"{self.name}_sum"]
        for part in self.subscales:
            if part.name in taken:
                raise ValueError(
                    f"subscale {part.name!r}: another score has this name; rename one of the two"
                )
            taken.append(part.name)
            _check_names(f"subscale {part.name!r}", part.items, self.items)
            _check_names(
                f"reversed items of subscale {part.name!r}", part.reversed, part.items, least=0
            )
        low, high = in_order("low", self.low, "high", self.high)
        if self.step is not None:
            steps = (high - low) / finite_number("step", self.step)
            if not (steps >= 1.0 and abs(steps - round(steps)) < 1e-9):
                raise ValueError(
                    f"step must divide {low:g} to {high:g} into equal parts, got {self.step:g}"
                )

    def table(self) -> pd.DataFrame:
        """
        Return the items: item, low, high, step, reversed, and for each subscale a column that marks
        its items.
        """
        columns = {
            "item": self.items,
            "low": float(self.low),
            "high": float(self.high),
            "step": np.nan if self.step is None else float(self.step),
            "reversed": [name in self.reversed for name in self.items],
        }
        columns |= {
            part.name: [name in part.items for name in self.items] for part in self.subscales
        }
        return pd.DataFrame(columns)


@dataclass(frozen=True, eq=False)
class ScaleScores:
    """
    Scores of a questionnaire, with the answers they come from.

    Parameters
    ----------
    name : str
        The questionnaire.
    scores : pandas.DataFrame
        A row per subject and condition: the columns that name them, then a column per score.
    answers : pandas.DataFrame
        The answers, indexed by subject (and condition), a column per item; rescaled where that was
        asked for, not reversed.
    ranges : dict of str to tuple
        Lowest and highest value that each score can have.
    coded : dict of str to pandas.DataFrame
        For each score the items it is formed from, with reversed items recoded.
    missing : pandas.DataFrame
        Answers that were missing: subject, condition, item, rule.
    """

    name: str
    scores: pd.DataFrame
    answers: pd.DataFrame
    ranges: Mapping[str, tuple[float, float]]
    coded: Mapping[str, pd.DataFrame]
    missing: pd.DataFrame

    def table(self) -> pd.DataFrame:
        """
        Return the scores; `.attrs["scales"]` keeps name, low and high of every score's column.
        """
        frame = self.scores.copy()
        frame.attrs["scales"] = {
            score: {"name": self.name, "low": float(low), "high": float(high)}
            for score, (low, high) in self.ranges.items()
        }
        return frame

    def reliability(self, confidence: float = 0.95) -> pd.DataFrame:
        """
        Return Cronbach's alpha of every score of two items or more, for each condition.

        Answers of one subject under several conditions are not independent, hence one alpha per
        condition.

        Parameters
        ----------
        confidence : float
            Level of the intervals.

        Returns
        -------
        pandas.DataFrame
            Columns score, condition (NaN where there is none), n, items, alpha, ci_low, ci_high;
            subjects with missing answers are left out of n; alpha is NaN for fewer than three
            subjects, or where all have the same score.
        """
        rows = []
        for score, coded in self.coded.items():
            if coded.shape[1] < 2:
                continue
            several = isinstance(coded.index, pd.MultiIndex)
            groups = coded.groupby(level=1, sort=False) if several else [(np.nan, coded)]
            for condition, group in groups:
                items = group.dropna()
                row = {"score": score, "condition": condition}
                row |= {"n": len(items), "items": items.shape[1]}
                row |= dict.fromkeys(("alpha", "ci_low", "ci_high"), np.nan)
                if len(items) >= 3 and np.ptp(items.sum(axis=1)) > 0.0:
                    result = cronbach_alpha(items, confidence)
                    row |= {"alpha": result.alpha}
                    row |= {"ci_low": result.ci_low, "ci_high": result.ci_high}
                rows.append(row)
        return pd.DataFrame(
            rows, columns=["score", "condition", "n", "items", "alpha", "ci_low", "ci_high"]
        )

    def _repr_html_(self) -> str:
        return as_html("", self.scores, title=self.name)


def missing_answers(
    answers: pd.DataFrame, parts: Mapping[str, Sequence[str]], rule: str
) -> pd.DataFrame:
    """
    Return the answers that are missing (subject, condition, item, rule), or refuse them where the
    rule does.

    `parts` gives the items of every score.
    """
    one_of("missing", rule, MISSING_RULES)
    several = isinstance(answers.index, pd.MultiIndex)
    gaps = [
        (answers.index[i], answers.columns[j]) for i, j in np.argwhere(answers.isna().to_numpy())
    ]
    if gaps and rule == "refuse":
        named = "; ".join(answer_name(*gap) for gap in gaps[:10]) + (" …" if len(gaps) > 10 else "")
        remedy = (
            'Fill them in from the records, leave the subject out, or ask for missing="half_rule"'
        )
        raise ValueError(
            f"{len(gaps)} {'answer is' if len(gaps) == 1 else 'answers are'} missing: {named}. "
            f"{remedy}"
        )
    for score, items in parts.items():
        short = answers[list(items)].isna().mean(axis=1).to_numpy() > 0.5
        if short.any():
            row = answer_name(answers.index[int(np.argmax(short))])
            raise ValueError(
                f"{row}: fewer than half of the {len(items)} items of {score!r} are answered, so "
                "that the half rule gives no score; leave the subject out"
            )
    rows = [(*(row if several else (row, np.nan)), item, rule) for row, item in gaps]
    table = pd.DataFrame(rows, columns=["subject", "condition", "item", "rule"])
    return table if several else table.astype({"condition": float})


class AnswerColumns(TypedDict, total=False):
    """
    Where the answers are and what is done about missing ones: the keyword arguments of
    `score_likert`.
    """

    subject: Required[str]
    condition: str | None
    items: Mapping[str, str] | Sequence[str] | None
    item: str | None
    response: str | None
    missing: str


def score_likert(
    frame: pd.DataFrame,
    scale: LikertScale,
    *,
    subject: str,
    condition: str | None = None,
    items: Mapping[str, str] | Sequence[str] | None = None,
    item: str | None = None,
    response: str | None = None,
    missing: str = "refuse",
) -> ScaleScores:
    """
    Score a questionnaire: mean and sum over all items, reversed ones recoded, and the mean of every
    subscale.

    Parameters
    ----------
    frame : pandas.DataFrame
        Answers as given, not reversed: wide (a column per item) or, with `item` and `response`,
        long.
    scale : LikertScale
        The questionnaire.
    subject, condition : str
        Columns that say whose answers these are and under which condition; `condition` may be None.
    items : dict or list, optional
        Item of the scale → column (wide) or label in column `item` (long); or those in the scale's
        order. By default they have the scale's own names.
    item, response : str, optional
        For a long table: the column that names the item and the one that holds the answer.
    missing : str
        "refuse", or "half_rule": means of the answered items where at least half are answered, sums
        prorated.

    Returns
    -------
    ScaleScores

    Raises
    ------
    ValueError
        Naming subject, condition and item of an answer that is missing, not a number, outside the
        scale or between its steps.

    Examples
    --------
    >>> import pandas as pd
    >>> import trustlab as tl
    >>> answers = pd.DataFrame({"person": [1, 2], "q1": [4, 5], "q2": [2, 1]})
    >>> scale = tl.studies.LikertScale("ease", items=("q1", "q2"), low=1, high=5, reversed=("q2",))
    >>> tl.score_likert(answers, scale, subject="person").table()
       person  ease_mean  ease_sum
    0       1        4.0       8.0
    1       2        5.0      10.0
    """
    of_class("scale", scale, LikertScale)
    columns: dict[str, Any] = {"condition": condition, "items": items}
    columns |= {"item": item, "response": response}
    answers = read_answers(frame, scale.items, subject=subject, **columns)
    check_answers(answers, scale.low, scale.high, scale.step)
    return scores_of(answers, scale, f"{scale.name}_mean", missing, frame)


def scores_of(
    answers: pd.DataFrame, scale: LikertScale, mean: str, missing: str, frame: pd.DataFrame
) -> ScaleScores:
    """
    Return the scores of checked answers.

    `mean` names the mean of all items; what `frame` says of the origin of its answers is passed on.
    """
    whole = Subscale(mean, scale.items, scale.reversed)
    parts = (whole, *scale.subscales)
    gaps = missing_answers(answers, {part.name: part.items for part in parts}, missing)
    coded = {}
    scores = {}
    for part in parts:
        items = answers[list(part.items)].copy()
        turned = list(part.reversed)
        items[turned] = scale.low + scale.high - items[turned]
        coded[part.name] = items
        scores[part.name] = items.mean(axis=1)
        if part is whole:
            scores[f"{scale.name}_sum"] = scores[part.name] * len(scale.items)
    ranges = dict.fromkeys(scores, (scale.low, scale.high))
    ranges[f"{scale.name}_sum"] = (scale.low * len(scale.items), scale.high * len(scale.items))
    table = pd.DataFrame(scores, index=answers.index).reset_index()
    table.attrs = dict(frame.attrs)  # synthetic answers give synthetic scores
    if origin := origin_of(frame):
        table.attrs["origin"] = origin
    return ScaleScores(scale.source or scale.name, table, answers, ranges, coded, gaps)


def satisfaction_scale(
    points: int, items: Any = SATISFACTION_ITEMS, reversed: Any = ()
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
        Answers as given, not reversed: wide (a column per item) or, with `item` and `response`,
        long.
    points : {5, 7}
        Answers run from 1 to this.
    items : sequence of str or dict
        The items, which are the columns' names; or a dict of item → column (wide) or label in
        column `item` (long).
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
        Naming subject, condition and item of an answer that is missing, not a number, or not a
        whole number from 1 to `points`.

    Examples
    --------
    >>> import pandas as pd
    >>> import trustlab as tl
    >>> answers = pd.DataFrame({"person": [1, 2], "satisfaction": [6, 3]})
    >>> answers = answers.assign(comfort=[5, 4], control=[7, 2])
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


_DISTRUST = ("deceptive", "underhanded", "suspicious", "wary", "harmful")
_TRUST = ("confident", "security", "integrity", "dependable", "reliable", "trust", "familiar")

# : Items 1–5 (distrust) are reversed in mean and sum; both subscales are means of the answers as
# given.
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
        Answers as given, not reversed: wide (a column per item) or, with `item` and `response`,
        long.
    **columns : AnswerColumns
        The keyword arguments of `score_likert`: subject, condition, items, item, response, missing.
        `items` maps items of TRUST_CHECKLIST to columns (wide) or to labels in column `item`
        (long), or lists those of items 1 to 12.

    Returns
    -------
    ScaleScores
        Scores trust_mean (1–7), trust_sum (12–84), trust_subscale (1–7, items 6–12) and
        distrust_subscale (1–7, items 1–5, where a high score is distrust).

    Raises
    ------
    ValueError
        Naming subject, condition and item of an answer that is missing, not a number, or not a
        whole number from 1 to 7.

    References
    ----------
    J.-Y. Jian, A. M. Bisantz, C. G. Drury, Foundations for an empirically determined scale of trust
    in automated systems, International Journal of Cognitive Ergonomics 4 (2000) 53-71.

    Examples
    --------
    >>> import pandas as pd
    >>> import trustlab as tl
    >>> items = tl.studies.TRUST_CHECKLIST.items
    >>> answers = pd.DataFrame([dict.fromkeys(items, 4)]).assign(person=1)
    >>> tl.score_trust_checklist(answers, subject="person").table()
       person  trust_mean  trust_sum  trust_subscale  distrust_subscale
    0       1         4.0       48.0             4.0                4.0
    """
    return score_likert(frame, TRUST_CHECKLIST, **columns)
