"""Questionnaires as data, the scores of their answers, and how reliable these are."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from typing import Any

import numpy as np
import pandas as pd
from scipy import special

from trustlab.models.checks import (
    flag,
    in_order,
    of_class,
    positive,
    whole_number,
)
from trustlab.models.display import Result
from trustlab.studies.table import (
    Tested,
    label_column,
    labelled,
    labels_of,
    numbers_of,
    origin_of,
    roles_of,
)


@dataclass(frozen=True)
class Questionnaire:
    """
    A questionnaire whose items are answered on one scale.

    A form with other ends or steps is another questionnaire, such as
    ``dataclasses.replace(tl.NASA_TLX, low=1, high=20, step=1)``.

    Parameters
    ----------
    name : str
        Its name, with which the columns of its scores begin.
    items : sequence of str
        Short names of the items.
    low, high : float
        The lowest and the highest answer.
    reversed : sequence of str
        Items worded in the opposite direction, which count as low + high − answer.
    subscales : dict of str to sequence of str
        Further scores, the means of some items as answered, by the names of their columns.
    step : float or None
        Distance between answers; None for a continuous scale.
    task_load : bool
        Whether it is a task load index: answers are stretched to a range from 0 to 100, and scores
        are the mean `<name>_raw` and, where subjects weighted six items by pairwise choices,
        `<name>_weighted`; else they are mean and sum, `<name>_mean` and `<name>_sum`.
    source : str
        Where it comes from.

    Raises
    ------
    ValueError
        If items repeat, a reversed item or one of a subscale is not among them, `low` is not below
        `high`, or `step` does not divide the scale into equal parts.

    Examples
    --------
    >>> import trustlab as tl
    >>> ease = tl.studies.Questionnaire("ease", ["quick", "tiring"], 1, 5, reversed=["tiring"])
    >>> tl.NASA_TLX.items
    ('mental', 'physical', 'temporal', 'performance', 'effort', 'frustration')
    >>> tl.TRUST_CHECKLIST.reversed
    ('deceptive', 'underhanded', 'suspicious', 'wary', 'harmful')
    >>> ease.reversed
    ('tiring',)
    """

    name: str
    items: Sequence[str]
    low: float
    high: float
    reversed: Sequence[str] = ()
    subscales: dict[str, Sequence[str]] = field(default_factory=dict)
    step: float | None = 1.0
    task_load: bool = False
    source: str = ""

    def __post_init__(self):
        of_class("name", self.name, str)
        of_class("source", self.source, str)
        of_class("subscales", self.subscales, dict)
        items = labels_of("items", self.items, 1)
        for name, part in [("reversed", self.reversed), *self.subscales.items()]:
            if unknown := {*labels_of(name, part, name in self.subscales)} - {*items}:
                raise ValueError(f"{name}: {unknown.pop()!r} is none of the items {items}")
        low, high = in_order("low", self.low, "high", self.high)
        steps = 1.0 if self.step is None else (high - low) / positive("step", self.step)
        if steps < 1.0 or abs(steps - round(steps)) > 1e-9:
            raise ValueError(f"step must divide {low:g} to {high:g} equally, got {self.step:g}")
        flag("task_load", self.task_load)
        self.__dict__.update(items=items, reversed=tuple(self.reversed), low=low, high=high)


#: NASA task load index, performance answered from good (0) to poor (100).
NASA_TLX = Questionnaire(
    "tlx",
    ("mental", "physical", "temporal", "performance", "effort", "frustration"),
    low=0,
    high=100,
    step=5,
    task_load=True,
    source="NASA-TLX (Hart and Staveland 1988)",
)

_DISTRUST = ("deceptive", "underhanded", "suspicious", "wary", "harmful")
_TRUST = ("confident", "security", "integrity", "dependable", "reliable", "trust", "familiar")

#: Trust checklist; its first five items, of distrust, are reversed in mean and sum.
TRUST_CHECKLIST = Questionnaire(
    "trust",
    _DISTRUST + _TRUST,
    low=1,
    high=7,
    reversed=_DISTRUST,
    subscales={"trust_subscale": _TRUST, "distrust_subscale": _DISTRUST},
    source="trust checklist (Jian, Bisantz and Drury 2000)",
)


def satisfaction_scale(
    points: int = 5,
    items: Sequence[str] | int = ("satisfaction", "comfort", "control"),
    reversed: Sequence[str] = (),
) -> Questionnaire:
    """
    Return the satisfaction questionnaire of the small studies, or of the large ones.

    The small studies (Section 2.4.1.3) ask for satisfaction, comfort and the feeling of being in
    control of the task, from 1 to 5. The large ones (Sections 2.4.2.4 and 3.9.3) take the
    questionnaire of reference [65] of the dissertation, which prints neither its items, nor how
    many they are, nor its scale (means up to 5.925 need more than five points): give `points`, and
    how many items your copy has.

    Parameters
    ----------
    points : int
        Answers run from 1 to this, at least 2.
    items : sequence of str or int
        Short names of the items; or how many items of [65], which are then called satisfaction_1,
        satisfaction_2 ….
    reversed : sequence of str
        Items for which a high answer means little satisfaction.

    Returns
    -------
    Questionnaire

    Raises
    ------
    ValueError
        If `points` is no whole number of at least 2, or a reversed item is not among the items.

    Examples
    --------
    >>> import trustlab as tl
    >>> tl.satisfaction_scale(7, items=4).items
    ('satisfaction_1', 'satisfaction_2', 'satisfaction_3', 'satisfaction_4')
    """
    points = whole_number("points", points, least=2, most=1000)
    if isinstance(items, Sequence):
        source = "satisfaction (Section 2.4.1.3)"
    else:
        source = "satisfaction, the questionnaire of [65] (Sections 2.4.2.4 and 3.9.3)"
        items = [f"satisfaction_{k + 1}" for k in range(whole_number("items", items, most=100))]
    return Questionnaire("satisfaction", items, 1, points, reversed, source=source)


@dataclass(frozen=True, eq=False, repr=False)
class ScaleScores(Result):
    """
    Scores of a questionnaire.

    Parameters
    ----------
    questionnaire : Questionnaire
        What was answered.
    scores : pandas.DataFrame
        A row per subject and condition: the columns that name them, then a column per score.
    coded : dict of str to pandas.DataFrame
        For each score that is a mean its items, rescaled and reversed as they count in it.
    """

    questionnaire: Questionnaire
    scores: pd.DataFrame
    coded: Mapping[str, pd.DataFrame]

    @property
    def title(self) -> str:
        """The questionnaire."""
        return self.questionnaire.source or self.questionnaire.name

    @property
    def message(self) -> str:
        """How many forms were scored."""
        return f"forms scored: {len(self.scores)}"

    def table(self) -> pd.DataFrame:
        """Return the scores."""
        return self.scores.copy()

    def reliability(self) -> pd.DataFrame:
        """
        Return Cronbach's alpha of every score of two items or more.

        There is an alpha per condition, as answers of a subject under several conditions are not
        independent.

        Returns
        -------
        pandas.DataFrame
            Columns score, condition (NaN where there is none), n, items, alpha, ci_low, ci_high
            (95 %). Alpha is NaN for fewer than three subjects, or where all have the same score.
        """
        rows = []
        for name, coded in self.coded.items():
            several = coded.index.nlevels > 1
            groups: Any = coded.groupby(level=1, sort=False) if several else [(np.nan, coded)]
            for label, group in groups:
                rows.append({"score": name, "condition": label} | _alpha(group))
        table = pd.DataFrame(rows).query("items > 1").reset_index(drop=True)
        return labelled(table, origin_of(self.scores))


def score(
    answers: pd.DataFrame,
    questionnaire: Questionnaire,
    *,
    subject: str = "subject",
    condition: str | None = None,
    weights: pd.DataFrame | None = None,
) -> ScaleScores:
    """
    Score the answers to a questionnaire.

    Mean and sum are over all items, reversed ones recoded; a subscale is the mean of its items as
    answered. Of the task load index they are the raw score, the mean of six scales, and the
    weighted one, Σ w x/Σ w.

    Parameters
    ----------
    answers : pandas.DataFrame
        A row per subject (and condition), a column per item that has its name; answers as given,
        not reversed. `DataFrame.rename` gives columns the items' names, and `DataFrame.pivot` makes
        a column per item of a row per answer.
    questionnaire : Questionnaire
        What was answered: NASA_TLX, TRUST_CHECKLIST, `satisfaction_scale`, or another.
    subject, condition : str
        Columns that say whose answers these are and under which condition; `condition` may be None.
    weights : pandas.DataFrame, optional
        Of a task load index: a weight per item, one row per subject, as `tlx_weights` gives them.

    Returns
    -------
    ScaleScores

    Raises
    ------
    ValueError
        Naming the item, and its row or subject, of an answer that is missing, not a number or not
        on the scale, or whose weights are of nobody who answered or cannot come from pairwise
        choices; or if a column has two roles, or a subscale the name of another column.

    References
    ----------
    S. G. Hart, L. E. Staveland, Development of NASA-TLX, in: Human Mental Workload, 1988, 139-183.
    J.-Y. Jian, A. M. Bisantz, C. G. Drury, Foundations for an empirically determined scale of trust
    in automated systems, International Journal of Cognitive Ergonomics 4 (2000) 53-71.

    Examples
    --------
    >>> import pandas as pd
    >>> import trustlab as tl
    >>> answers = pd.DataFrame([(60, 20, 45, 35, 50, 30)], columns=tl.NASA_TLX.items)
    >>> tl.score(answers.assign(subject="P1"), tl.NASA_TLX).table()
      subject  tlx_raw
    0      P1     40.0
    """
    of_class("questionnaire", questionnaire, Questionnaire)
    table = _read("answers", answers, questionnaire.items, subject, condition)
    low, high, step = questionnaire.low, questionnaire.high, questionnaire.step
    on = (table >= low) & (table <= high)
    if step is not None:
        on &= ((table - low) / step % 1.0).sub(0.5).abs() > 0.5 - 1e-9
    for i, j in np.argwhere(~on.to_numpy()):
        raise ValueError(
            f"answers: {table.columns[j]} of subject {_words(table.index[i])} is "
            f"{table.iloc[i, j]:g}, not on the scale from {low:g} to {high:g}"
            f"{f' in steps of {step:g}' if step else ''}; correct it from the records, or leave "
            "the subject out; if the form had another scale, score by "
            "dataclasses.replace(questionnaire, low=…, high=…, step=…)"
        )
    name, ends, kind = questionnaire.name, low + high, "mean"
    if questionnaire.task_load:
        table, ends, kind = 100.0 * (table - low) / (high - low), 100.0, "raw"
    whole, turned = table.copy(), [*questionnaire.reversed]
    whole[turned] = ends - whole[turned]
    columns = [f"{name}_{kind}" for kind in ("mean", "sum", "raw", "weighted")]
    columns += [*questionnaire.subscales, *table.index.names]
    for column in columns:
        if columns.count(column) > 1:
            raise ValueError(
                f"answers or subscales: {column!r} is another column of the scores; rename it"
            )
    coded = {f"{name}_{kind}": whole}
    coded |= {part: table[[*items]] for part, items in questionnaire.subscales.items()}
    scores = {part: items.mean(axis=1) for part, items in coded.items()}
    if not questionnaire.task_load:
        scores[f"{name}_sum"] = whole.sum(axis=1)
    if weights is not None:
        if not questionnaire.task_load or len(whole.columns) != 6:
            raise ValueError(f"weights are for six items of a task load index, not for {name!r}")
        w = _read("weights", weights, questionnaire.items, subject, None)
        w.index, people = (frame.index.get_level_values(0) for frame in (w, whole))
        if strangers := [*w.index.difference(people)]:
            raise ValueError(f"weights: {strangers} did not answer; leave their weights out")
        w = w.reindex(people).set_axis(whole.index)
        # Landau (1953): of six items, the j chosen least meet each other j(j − 1)/2 times.
        wins, least = np.sort(w).cumsum(axis=1), np.cumsum(range(6))
        possible = (wins >= least).all(axis=1) & (wins[:, -1] == 15.0)
        for row in w.index[~(possible & w.isin(range(6)).all(axis=1))]:
            raise ValueError(
                f"weights: {w.loc[row].tolist()} of subject {_words(row)} are not those of fifteen "
                "choices between pairs: six whole numbers from 0 to 5 with the sum 15 (nan: the "
                "subject has none)"
            )
        scores[f"{name}_weighted"] = (w * whole).sum(axis=1) / 15.0
    result = labelled(pd.DataFrame(scores).reset_index(), origin_of(answers))
    return ScaleScores(questionnaire, result, coded)


def _words(labels: tuple) -> str:
    """Return a subject, and the condition where there are several."""
    return ", ".join(map(str, labels))


def _read(
    argument: str, frame: pd.DataFrame, items: Sequence[str], subject: str, condition: str | None
) -> pd.DataFrame:
    """Return a column of numbers per item; subject and condition are the index."""
    named = [] if condition is None else [condition]
    roles_of(argument, frame, subject=[subject], condition=named, **{argument: [*items]})
    index = pd.MultiIndex.from_frame(frame[[subject, *named]])
    if index.has_duplicates:
        raise ValueError(
            f"{argument} must have one row per subject, or per subject and condition= if there are "
            f"several; it has {len(frame)} rows, repeated: {[*index[index.duplicated()]][:5]}"
        )
    numbers = {item: numbers_of(frame[item], argument) for item in items}
    return pd.DataFrame(numbers).set_axis(index)


def tlx_weights(
    choices: pd.DataFrame,
    *,
    subject: str = "subject",
    first: str = "first",
    second: str = "second",
    chosen: str = "chosen",
) -> pd.DataFrame:
    """
    Count weights of the task load index from the fifteen pairwise choices.

    Parameters
    ----------
    choices : pandas.DataFrame
        A row per subject and pair of scales.
    subject, first, second, chosen : str
        Columns: who, the two scales compared, and the one that contributed more to the workload;
        scales are named as in NASA_TLX.items.

    Returns
    -------
    pandas.DataFrame
        A row per subject: the subject column, then a whole number from 0 to 5 per scale, 15 in sum.

    Raises
    ------
    ValueError
        Naming the subject whose choices are not one for each pair, or lie outside the pair.
    """
    roles_of("choices", choices, subject=[subject], first=[first], second=[second], chosen=[chosen])
    items, rows = NASA_TLX.items, []
    for label, part in choices.groupby(choices[subject], sort=False):
        triples = part[[first, second, chosen]].itertuples(index=False)
        picks = Counter(frozenset(pair) for *pair, pick in triples if pick in pair)
        wrong = [pair for pair in combinations(items, 2) if picks[frozenset(pair)] != 1]
        if wrong or len(part) > 15:
            raise ValueError(
                f"chosen: subject {label!r} must have one row for each pair of {items}, with one "
                f"of the two; it has {len(part)} rows, and not one for {wrong}"
            )
        wins = part[chosen].value_counts().reindex(items, fill_value=0)
        rows.append({subject: label, **wins})
    return pd.DataFrame(rows)


@dataclass(frozen=True, eq=False, repr=False)
class Reliability(Tested):
    """
    Internal consistency of a scale.

    Columns of `table` are attributes too: n and items, how many subjects and items; alpha,
    Cronbach's alpha, with its interval ci_low, ci_high (95 %, Feldt's F interval).

    Parameters
    ----------
    tests : pandas.DataFrame
        What `table` returns, a row.
    without : pandas.Series
        Alpha of the scale less each item; NaN where one item is left or all subjects agree.
    """

    title = "Cronbach's alpha"

    tests: pd.DataFrame
    without: pd.Series

    @property
    def message(self) -> str:
        """Alpha and its interval."""
        return f"α = {self.alpha:.2f}, 95% CI {self.ci_low:.2f}, {self.ci_high:.2f}"


def cronbach_alpha(items: pd.DataFrame) -> Reliability:
    """
    Return Cronbach's alpha of items scored in the same direction, α = k/(k − 1) · (1 − Σ s_i²/s²).

    Parameters
    ----------
    items : pandas.DataFrame
        A row per subject, a column per item, reversed items already recoded; no missing values.

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
    of_class("items", items, pd.DataFrame, "a table of pandas with a column per item")
    origin = origin_of(items)
    answers = {item: numbers_of(label_column(items, "items", item), "items") for item in items}
    items = pd.DataFrame(answers)
    row = _alpha(items)
    if np.isnan(row["alpha"]):
        raise ValueError(
            "items: alpha needs two items or more of three subjects, and sums that differ; got "
            f"a table of shape {items.shape}"
        )
    rest = {name: _alpha(items.drop(columns=name))["alpha"] for name in items}
    table = labelled(pd.DataFrame([row]), origin)
    return Reliability(table, pd.Series(rest, name="alpha_without"))


def _alpha(items: pd.DataFrame) -> dict[str, float]:
    """Return how many subjects and items, alpha and its interval; NaN where it is not defined."""
    n, k = items.shape
    values = items.to_numpy(dtype=float)
    total = values.sum(axis=1)
    alpha, ends = np.nan, np.full(2, np.nan)
    if k > 1 and n > 2 and np.ptp(total) > 1e-12 * np.abs(total).max():
        alpha = (1.0 - values.var(axis=0, ddof=1).sum() / total.var(ddof=1)) * k / (k - 1)
        ends = special.fdtri(n - 1, (n - 1) * (k - 1), [0.975, 0.025])
    low, high = 1.0 - (1.0 - alpha) * ends
    return {"n": n, "items": k, "alpha": alpha, "ci_low": low, "ci_high": high}
