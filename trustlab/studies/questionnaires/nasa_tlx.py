"""NASA task load index (Hart and Staveland 1988), raw and weighted."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd

from trustlab.sessions.errors import nearest
from trustlab.studies.questionnaires.answers import check_responses, name_cell, read_responses
from trustlab.studies.questionnaires.likert import ScaleScores, missing_answers

__all__ = ["TLX_RESCALINGS", "TLX_SCALES", "score_nasa_tlx", "tlx_weights"]

TLX_SCALES = ("mental", "physical", "temporal", "performance", "effort", "frustration")
"""The six scales: demands (mental, physical, temporal), performance (good → poor), effort, frustration."""

TLX_RESCALINGS = {
    "0-20": (0.0, 20.0, lambda x: 5.0 * x, "5 times the answer"),
    "1-21": (1.0, 21.0, lambda x: 5.0 * (x - 1.0), "5 times the answer less 1"),
    "1-20, as intervals": (
        1.0,
        20.0,
        lambda x: 5.0 * x,
        "5 times the answer: the twenty intervals, 5 to 100",
    ),
    "1-20, stretched": (1.0, 20.0, lambda x: 100.0 * (x - 1.0) / 19.0, "1 to 20 stretched to 0 to 100"),
}
"""Other response scales: lowest and highest answer, what makes 0–100 of it, and this in words."""

_PAIRS = tuple(itertools.combinations(TLX_SCALES, 2))


def _check_weights(weights: np.ndarray, whose: str) -> None:
    """Refuse weights that fifteen choices cannot give."""
    for name, weight in zip(TLX_SCALES, weights, strict=True):
        if not np.isfinite(weight):
            raise ValueError(f"weights of {whose}: that of {name!r} is missing")
        if weight not in range(6):
            raise ValueError(
                f"weights of {whose}: that of {name!r} is {weight:g}; each must be a whole number from 0 to 5"
            )
    total = float(weights.sum())
    if total != 15.0:
        raise ValueError(
            f"weights of {whose} sum to {total:g}; fifteen pairwise choices give weights that sum to 15"
        )
    lowest = np.cumsum(np.sort(weights))
    for k in range(2, 6):  # Landau (1953): the k scales chosen least still meet each other k(k − 1)/2 times
        if lowest[k - 1] < k * (k - 1) / 2:
            raise ValueError(
                f"weights of {whose}: no fifteen choices give {[int(w) for w in weights]}; the {k} scales chosen least "
                f"meet each other {k * (k - 1) // 2} times but were chosen {int(lowest[k - 1])} times in all"
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
        Columns: who, the two scales compared, and the one that contributed more to the workload; scales are named as
        in TLX_SCALES.

    Returns
    -------
    pandas.DataFrame
        A row per subject: the subject column, then a whole number from 0 to 5 per scale, 15 in sum.

    Raises
    ------
    ValueError
        Naming the subject and the pair that is missing, twice there, or whose choice is neither of the two.
    """
    if not isinstance(choices, pd.DataFrame) or choices.empty:
        raise ValueError("choices must be a DataFrame with a row per subject and pair of scales")
    for name in (subject, first, second, chosen):
        if name not in choices.columns:
            raise ValueError(f"choices has no column {name!r}{nearest(name, choices.columns)}")
    if choices[subject].isna().any():
        raise ValueError(f"column {subject!r}: a subject is missing; every row needs one")
    rows = []
    for who, own in choices.groupby(subject, sort=False):
        counts, seen = dict.fromkeys(TLX_SCALES, 0), set()
        for a, b, pick in own[[first, second, chosen]].itertuples(index=False, name=None):
            for scale in (a, b):
                if scale not in TLX_SCALES:
                    raise ValueError(f"subject {who!r}: {scale!r} is no scale{nearest(scale, TLX_SCALES)}")
            pair = frozenset((a, b))
            if len(pair) < 2 or pair in seen:
                what = "is compared with itself" if len(pair) < 2 else f"and {b!r} are compared twice"
                raise ValueError(f"subject {who!r}: {a!r} {what}; keep one row per pair of scales")
            if pick not in pair:
                raise ValueError(f"subject {who!r}, {a!r} or {b!r}: chosen is {pick!r}, which is neither")
            seen.add(pair)
            counts[pick] += 1
        lacking = [" and ".join(pair) for pair in _PAIRS if frozenset(pair) not in seen]
        if lacking:
            raise ValueError(f"subject {who!r}: {len(lacking)} of 15 pairs are missing: {', '.join(lacking)}")
        rows.append((who, *counts.values()))
    return pd.DataFrame(rows, columns=[subject, *TLX_SCALES])


def _weight_table(weights, responses: pd.DataFrame) -> np.ndarray:
    """Return the weights beside every row of the answers."""
    several = isinstance(responses.index, pd.MultiIndex)
    names = list(responses.index.names)
    if isinstance(weights, Mapping):
        lacking = [name for name in TLX_SCALES if name not in weights]
        unknown = [name for name in weights if name not in TLX_SCALES]
        if lacking or unknown:
            raise ValueError(
                f"weights must have the six scales {', '.join(TLX_SCALES)}; got {', '.join(map(str, weights))}"
            )
        weights = pd.DataFrame(
            {name: [weights[name]] * len(responses) for name in TLX_SCALES}, index=responses.index
        )
        own = weights.reset_index()
        keys = names
    elif isinstance(weights, pd.DataFrame):
        own = weights
        keys = [name for name in names if name in own.columns]
        if names[0] not in keys:
            raise ValueError(f"weights has no column {names[0]!r}, which says whose they are")
    else:
        raise ValueError(
            f"weights must be a DataFrame or a dict of scale to weight, got {type(weights).__name__}"
        )
    table = read_responses(
        own, TLX_SCALES, subject=keys[0], condition=keys[1] if several and len(keys) > 1 else None
    )
    by_condition = isinstance(table.index, pd.MultiIndex)
    for row, values in zip(table.index, table.to_numpy(), strict=True):
        _check_weights(values, name_cell(*(row if by_condition else (row, None))))
    wanted = responses.index if by_condition or not several else responses.index.get_level_values(0)
    lacking = [row for row in wanted if row not in table.index]
    if lacking:
        whose = name_cell(*(lacking[0] if by_condition else (lacking[0], None)))
        raise ValueError(f"{whose}: there are no weights; add them, or leave weights out for the raw score")
    return table.loc[list(wanted)].to_numpy(dtype=float)


def score_nasa_tlx(
    frame: pd.DataFrame,
    *,
    subject: str,
    condition: str | None = None,
    items: Mapping[str, str] | Sequence[str] | None = None,
    item: str | None = None,
    response: str | None = None,
    weights: pd.DataFrame | Mapping[str, int] | None = None,
    rescale: str | None = None,
    performance: str = "good_to_poor",
    missing: str = "refuse",
) -> ScaleScores:
    """
    Score the NASA task load index: the raw score is the mean of six scales, the weighted one Σ w_i x_i/15.

    Performance runs from good (0) to poor (100) on the form, so that it is not reversed.

    Parameters
    ----------
    frame : pandas.DataFrame
        Answers 0–100 in steps of 5: wide (a column per scale: mental, physical, temporal, performance, effort, frustration,
        or those that `items` names) or, with `item` and `response`, long.
    subject, condition : str
        Columns that say whose answers these are and under which condition; `condition` may be None.
    items : dict or list, optional
        Scale (TLX_SCALES) → column (wide) or label in column `item` (long); or those in the order of TLX_SCALES.
    item, response : str, optional
        For a long table: the column that names the scale and the one that holds the answer.
    weights : pandas.DataFrame or dict, optional
        Six weights per subject (and condition, if it has that column), as `tlx_weights` gives them, or one set for all.
    rescale : str, optional
        A name in TLX_RESCALINGS, if the answers are on another scale than 0–100. Nothing is rescaled unasked.
    performance : {"good_to_poor", "poor_to_good"}
        How the Performance scale ran on the form that was used; "poor_to_good" turns it, 100 − x.
    missing : str
        "refuse", or "half_rule": means of the answered scales where at least half are answered, weights likewise.

    Returns
    -------
    ScaleScores
        Scores `tlx_raw` and `tlx_weighted` (NaN without weights), 0–100.

    Raises
    ------
    ValueError
        Naming subject, condition and scale of an answer that is missing, no number, out of range or no step of 5, or the
        subject whose weights are no whole numbers from 0 to 5, do not sum to 15 or cannot come from fifteen choices.

    References
    ----------
    S. G. Hart, L. E. Staveland, Development of NASA-TLX, in: Human Mental Workload, 1988, 139-183.
    """
    if performance not in ("good_to_poor", "poor_to_good"):
        raise ValueError(f'performance must be "good_to_poor" or "poor_to_good", got {performance!r}')
    responses = read_responses(
        frame, TLX_SCALES, subject=subject, condition=condition, items=items, item=item, response=response
    )
    known = "; ".join(f"{name!r}: {row[3]}" for name, row in TLX_RESCALINGS.items())
    if rescale is None:
        hint = ""
        top = np.nanmax(responses.to_numpy(), initial=0.0)
        if top <= 21.0:
            hint = f"; no answer passes {top:g}: if the form had another scale, say rescale= one of {known}"
        check_responses(responses, 0.0, 100.0, 5.0, hint)
    elif isinstance(rescale, str) and rescale in TLX_RESCALINGS:
        low, high, rule, words = TLX_RESCALINGS[rescale]
        check_responses(responses, low, high, 1.0, f' (rescale="{rescale}": {words})')
        responses = rule(responses)
    else:
        raise ValueError(f"rescale must be one of {known}; got {rescale!r}")
    gaps = missing_answers(responses, {"tlx_raw": TLX_SCALES}, missing)
    coded = responses.copy()
    if performance == "poor_to_good":
        coded["performance"] = 100.0 - coded["performance"]
    scores = pd.DataFrame({"tlx_raw": coded.mean(axis=1), "tlx_weighted": np.nan}, index=responses.index)
    if weights is not None:
        w = np.where(coded.notna(), _weight_table(weights, responses), 0.0)
        if (w.sum(axis=1) == 0.0).any():
            row = responses.index[int(np.argmax(w.sum(axis=1) == 0.0))]
            whose = name_cell(*(row if isinstance(responses.index, pd.MultiIndex) else (row, None)))
            raise ValueError(f"{whose}: every scale with a weight is missing, so there is no weighted score")
        scores["tlx_weighted"] = (w * coded.fillna(0.0)).sum(axis=1) / w.sum(axis=1)
    ranges = dict.fromkeys(scores, (0.0, 100.0))
    table = scores.reset_index()
    table.attrs = dict(frame.attrs)  # synthetic answers give synthetic scores
    return ScaleScores("NASA-TLX", table, responses, ranges, {"tlx_raw": coded}, gaps)
