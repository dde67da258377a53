"""NASA task load index (Hart and Staveland 1988), raw and weighted."""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from trustlab.models.checks import did_you_mean, of_class, one_of
from trustlab.studies.questionnaires.answers import answer_name, check_answers, read_answers
from trustlab.studies.questionnaires.likert import LikertScale, ScaleScores, scores_of
from trustlab.studies.table import column_of, refuse_missing_labels

# : The six scales: demands (mental, physical, temporal), performance (good → poor), effort,
# frustration.
TLX_SCALES = ("mental", "physical", "temporal", "performance", "effort", "frustration")

# : The questionnaire as published, 0 (low, or a good performance) to 100 in steps of 5.
TLX = LikertScale("tlx", TLX_SCALES, 0.0, 100.0, step=5.0, source="NASA-TLX")


class Form(NamedTuple):
    """
    A response scale: 100 (answer − zero)/steps is the answer on the scale 0–100.

    low, high, step: the answers of the form, step None where they are continuous.
    """

    low: float
    high: float
    step: float | None
    zero: float
    steps: float
    meaning: str


# : Response scales besides 0–100 in steps of 5.
TLX_RESCALINGS: dict[str, Form] = {
    "0-100": Form(0.0, 100.0, None, 0.0, 100.0, "as it is, on or between the marks (sliders)"),
    "0-20": Form(0.0, 20.0, 1.0, 0.0, 20.0, "5 times the answer"),
    "1-21": Form(1.0, 21.0, 1.0, 1.0, 20.0, "5 times the answer less 1"),
    "1-20, as intervals": Form(
        1.0, 20.0, 1.0, 0.0, 20.0, "5 times the answer: twenty intervals, 5 to 100"
    ),
    "1-20, stretched": Form(1.0, 20.0, 1.0, 1.0, 19.0, "1 to 20 stretched to 0 to 100"),
    "0-10": Form(0.0, 10.0, 1.0, 0.0, 10.0, "10 times the answer"),
    "1-7": Form(1.0, 7.0, 1.0, 1.0, 6.0, "1 to 7 stretched to 0 to 100"),
}

_PAIRS = tuple(itertools.combinations(TLX_SCALES, 2))


def _check_weights(weights: np.ndarray, whose: str) -> None:
    """Refuse weights that fifteen pairwise choices cannot give."""
    for name, weight in zip(TLX_SCALES, weights, strict=True):
        if weight not in range(6):
            value = "missing" if np.isnan(weight) else f"{weight:g}"
            raise ValueError(
                f"weights of {whose}: that of {name!r} is {value}; each must be a whole number "
                "from 0 to 5"
            )
    total = float(weights.sum())
    if total != 15.0:
        raise ValueError(f"weights of {whose} sum to {total:g}; those of fifteen choices sum to 15")
    lowest = np.cumsum(np.sort(weights))
    # Landau (1953): the k scales chosen least still meet each other k(k − 1)/2 times.
    for k in range(2, 6):
        if lowest[k - 1] < k * (k - 1) / 2:
            why = (
                f"meet each other {k * (k - 1) // 2} times but were chosen {int(lowest[k - 1])} "
                "times in all"
            )
            counts = [int(weight) for weight in weights]
            raise ValueError(
                f"weights of {whose}: no fifteen choices give {counts}; the {k} scales chosen "
                f"least {why}"
            )


def tlx_weights(
    choices: pd.DataFrame,
    *,
    subject: str = "subject",
    first: str = "first",
    second: str = "second",
    chosen: str = "chosen",
) -> pd.DataFrame:
    """
    Count weights from the fifteen pairwise choices.

    Parameters
    ----------
    choices : pandas.DataFrame
        A row per subject and pair of scales.
    subject, first, second, chosen : str
        Columns: who, the two scales compared, and the one that contributed more to the workload;
        scales are named as in TLX_SCALES.

    Returns
    -------
    pandas.DataFrame
        A row per subject: the subject column, then a whole number from 0 to 5 per scale, 15 in sum.

    Raises
    ------
    ValueError
        Naming the subject and the pair that is missing or occurs twice, or whose choice is neither
        of the two.
    """
    if not isinstance(choices, pd.DataFrame) or choices.empty:
        raise ValueError("choices must be a DataFrame with a row per subject and pair of scales")
    columns = {"subject": subject, "first": first, "second": second, "chosen": chosen}
    for argument, name in columns.items():
        column_of(choices, argument, name)
    refuse_missing_labels(choices[subject], "subject")
    rows = []
    for who, part in choices.groupby(subject, sort=False):
        counts = dict.fromkeys(TLX_SCALES, 0)
        pairs = set()
        for a, b, pick in part[[first, second, chosen]].itertuples(index=False, name=None):
            for scale in (a, b):
                if scale not in TLX_SCALES:
                    hint = did_you_mean(scale, TLX_SCALES)
                    raise ValueError(f"subject {who!r}: {scale!r} is not a scale{hint}")
            pair = frozenset((a, b))
            if len(pair) < 2 or pair in pairs:
                fault = (
                    "is compared with itself" if len(pair) < 2 else f"and {b!r} are compared twice"
                )
                raise ValueError(f"subject {who!r}: {a!r} {fault}; keep one row per pair of scales")
            if pick not in pair:
                raise ValueError(
                    f"subject {who!r}, {a!r} or {b!r}: chosen is {pick!r}, which is neither"
                )
            pairs.add(pair)
            counts[pick] += 1
        lacking = [" and ".join(pair) for pair in _PAIRS if frozenset(pair) not in pairs]
        if lacking:
            raise ValueError(
                f"subject {who!r}: {len(lacking)} of 15 pairs are missing: {', '.join(lacking)}"
            )
        rows.append((who, *counts.values()))
    return pd.DataFrame(rows, columns=[subject, *TLX_SCALES])


def _weights_of_rows(weights: pd.DataFrame | Mapping, answers: pd.DataFrame) -> np.ndarray:
    """Return six weights for every row of the answers."""
    keys = list(answers.index.names)
    if isinstance(weights, Mapping):
        if set(weights) != set(TLX_SCALES):
            names = ", ".join(map(str, weights))
            raise ValueError(
                f"weights must have the six scales {', '.join(TLX_SCALES)}; got {names}"
            )
        weights = pd.DataFrame([dict(weights)] * len(answers), index=answers.index).reset_index()
    of_class("weights", weights, pd.DataFrame, "or give a dict of scale to weight")
    if keys[0] not in weights.columns:
        raise ValueError(f"weights has no column {keys[0]!r}, which says whose they are")
    condition = keys[1] if len(keys) > 1 and keys[1] in weights.columns else None
    table = read_answers(weights, TLX_SCALES, subject=keys[0], condition=condition)
    for row, values in zip(table.index, table.to_numpy(), strict=True):
        _check_weights(values, answer_name(row))
    # Without a column for the condition, a subject's weights hold under every condition.
    rows = answers.index if condition or len(keys) == 1 else answers.index.get_level_values(0)
    lacking = [row for row in rows if row not in table.index]
    if lacking:
        remedy = "add them, or leave weights out for the raw score"
        raise ValueError(f"{answer_name(lacking[0])}: there are no weights; {remedy}")
    return table.loc[list(rows)].to_numpy(dtype=float)


def _on_hundred(answers: pd.DataFrame, scale: str | None) -> pd.DataFrame:
    """
    Return checked answers on the scale 0–100; without a name, answers that another form could have
    are refused.
    """
    forms = "; ".join(f"{name!r}: {form.meaning}" for name, form in TLX_RESCALINGS.items())
    if scale is None:
        hint = f"; if the form had another scale, set scale= to one of {forms}"
        check_answers(answers, TLX.low, TLX.high, TLX.step, hint)
        top = np.nanmax(answers.to_numpy(), initial=0.0)
        if top <= 21.0:
            raise ValueError(
                f"no answer exceeds {top:g}, which fits several forms; set scale= to one of {forms}"
            )
        return answers
    if not isinstance(scale, str) or scale not in TLX_RESCALINGS:
        raise ValueError(f"scale must be one of {forms}; got {scale!r}")
    form = TLX_RESCALINGS[scale]
    check_answers(answers, form.low, form.high, form.step, f' (scale="{scale}": {form.meaning})')
    if form.steps == 100.0:
        return answers
    return 100.0 * (answers - form.zero) / form.steps


def score_nasa_tlx(
    frame: pd.DataFrame,
    *,
    subject: str,
    condition: str | None = None,
    items: Mapping[str, str] | Sequence[str] | None = None,
    item: str | None = None,
    response: str | None = None,
    weights: pd.DataFrame | Mapping[str, int] | None = None,
    scale: str | None = None,
    performance: str = "good_to_poor",
    missing: str = "refuse",
) -> ScaleScores:
    """
    Score the NASA task load index: the raw score is the mean of six scales, the weighted one Σ w_i
    x_i/15.

    On the standard form performance runs from good (0) to poor (100), so it is not reversed.

    Parameters
    ----------
    frame : pandas.DataFrame
        Answers 0–100 in steps of 5: wide (a column per scale: mental, physical, temporal,
        performance, effort, frustration, or those that `items` names) or, with `item` and
        `response`, long.
    subject, condition : str
        Columns that say whose answers these are and under which condition; `condition` may be None.
    items : dict or list, optional
        Scale (TLX_SCALES) → column (wide) or label in column `item` (long); or those in the order
        of TLX_SCALES.
    item, response : str, optional
        For a long table: the column that names the scale and the one that holds the answer.
    weights : pandas.DataFrame or dict, optional
        Six weights per subject (and condition, if it has that column), as `tlx_weights` gives them,
        or one set for all.
    scale : str, optional
        The form, a name in TLX_RESCALINGS. When left out, answers must be those of the published
        form, 0–100 in steps of 5, and fit no other: where none exceeds 21, the form must be named.
    performance : {"good_to_poor", "poor_to_good"}
        Direction of the performance scale on the form; "poor_to_good" is recoded as 100 − x.
    missing : str
        "refuse", or "half_rule": means of the answered scales where at least half are answered,
        weights likewise.

    Returns
    -------
    ScaleScores
        Scores `tlx_raw` and `tlx_weighted` (NaN without weights), 0–100.

    Raises
    ------
    ValueError
        Naming subject, condition and scale of an answer that is missing, not a number, out of range
        or not a step of 5, or the subject whose weights are not whole numbers from 0 to 5, do not
        sum to 15 or cannot come from fifteen choices.

    References
    ----------
    S. G. Hart, L. E. Staveland, Development of NASA-TLX, in: Human Mental Workload, 1988, 139-183.

    Examples
    --------
    >>> import pandas as pd
    >>> import trustlab as tl
    >>> names = tl.studies.TLX_SCALES
    >>> answers = pd.DataFrame([dict(zip(names, (60, 20, 45, 35, 50, 30)))]).assign(person=1)
    >>> tl.score_nasa_tlx(answers, subject="person").table()
       person  tlx_raw  tlx_weighted
    0       1     40.0           NaN
    """
    one_of("performance", performance, ("good_to_poor", "poor_to_good"))
    columns: dict[str, Any] = {"condition": condition, "items": items}
    columns |= {"item": item, "response": response}
    answers = _on_hundred(read_answers(frame, TLX_SCALES, subject=subject, **columns), scale)
    reversed_items = ("performance",) if performance == "poor_to_good" else ()
    questionnaire = replace(TLX, reversed=reversed_items)
    raw = scores_of(answers, questionnaire, "tlx_raw", missing, frame)
    coded = raw.coded["tlx_raw"]
    weighted = np.full(len(answers), np.nan)
    if weights is not None:
        w = np.where(coded.notna(), _weights_of_rows(weights, answers), 0.0)
        if (w.sum(axis=1) == 0.0).any():
            row = answers.index[int(np.argmax(w.sum(axis=1) == 0.0))]
            raise ValueError(
                f"{answer_name(row)}: every scale with a weight is missing: no weighted score"
            )
        weighted = (w * coded.fillna(0.0)).sum(axis=1) / w.sum(axis=1)
    table = raw.scores.drop(columns="tlx_sum")
    table["tlx_weighted"] = np.asarray(weighted)
    ranges = dict.fromkeys(("tlx_raw", "tlx_weighted"), (TLX.low, TLX.high))
    return replace(raw, scores=table, ranges=ranges)
