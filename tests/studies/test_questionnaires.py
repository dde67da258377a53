"""
Scores against sums written out by hand, closed forms, pingouin and R; every bad answer is named.
"""

import itertools
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings, strategies as st

from trustlab.studies.questionnaires import (
    NASA_TLX,
    TRUST_CHECKLIST,
    Questionnaire,
    cronbach_alpha,
    satisfaction_scale,
    score,
    tlx_weights,
)

ALPHAS = json.loads((Path(__file__).parent / "reference" / "cronbach_alpha.json").read_text())[
    "sets"
]
WEIGHTS = [5, 0, 4, 3, 2, 1]
WHO = {"subject": "pid", "condition": "scheme"}


@pytest.fixture
def tlx():
    rows = [
        ("s1", "M", 80, 20, 60, 40, 70, 50),
        ("s1", "TMIG", 40, 10, 30, 20, 35, 15),
        ("s2", "M", 100, 0, 95, 5, 55, 45),
        ("s2", "TMIG", 25, 5, 10, 100, 20, 0),
    ]
    return pd.DataFrame(rows, columns=["pid", "scheme", *NASA_TLX.items])


def put(frame, row, column, value):
    frame = frame.copy()
    frame[column] = frame[column].astype(object)
    frame.loc[row, column] = value
    return frame


def weights_of(**people):
    return pd.DataFrame(people.values(), columns=NASA_TLX.items).assign(pid=list(people))


def answered(columns, low, high, step=1):
    return st.lists(
        st.lists(st.integers(0, (high - low) // step), min_size=columns, max_size=columns),
        min_size=1,
        max_size=6,
    ).map(lambda rows: low + step * np.array(rows))


# NASA-TLX


def test_tlx_by_hand(tlx):
    scores = score(tlx, NASA_TLX, **WHO, weights=weights_of(s2=WEIGHTS, s1=WEIGHTS)).table()
    assert list(scores.columns) == ["pid", "scheme", "tlx_raw", "tlx_weighted"]
    assert scores.loc[0, "tlx_raw"] == pytest.approx((80 + 20 + 60 + 40 + 70 + 50) / 6, rel=1e-15)
    assert scores.loc[0, "tlx_weighted"] == pytest.approx(
        (5 * 80 + 0 * 20 + 4 * 60 + 3 * 40 + 2 * 70 + 1 * 50) / 15, rel=1e-15
    )
    assert scores["pid"].tolist() == ["s1", "s1", "s2", "s2"]
    assert "tlx_weighted" not in score(tlx, NASA_TLX, **WHO).table()


def choices_of(order, subject="s1"):
    """Choices of someone who ranks the scales: the one earlier in `order` is always chosen."""
    return pd.DataFrame(
        [
            (subject, a, b, min(a, b, key=order.index))
            for a, b in itertools.combinations(NASA_TLX.items, 2)
        ],
        columns=["subject", "first", "second", "chosen"],
    )


@given(st.lists(st.booleans(), min_size=15, max_size=15), answered(6, 0, 100, 5))
@settings(max_examples=60)
def test_any_fifteen_choices_are_accepted_and_the_scores_stay_in_range(picks, answers):
    pairs = itertools.combinations(NASA_TLX.items, 2)
    rows = [("s", a, b, a if pick else b) for (a, b), pick in zip(pairs, picks, strict=True)]
    weights = tlx_weights(pd.DataFrame(rows, columns=["subject", "first", "second", "chosen"]))
    w = weights[list(NASA_TLX.items)].to_numpy()
    assert w.sum() == 15
    frame = pd.DataFrame(answers, columns=NASA_TLX.items)
    frame = frame.assign(subject="s", condition=range(len(answers)))
    scores = score(frame, NASA_TLX, condition="condition", weights=weights).scores
    weighted = (answers * w).sum(axis=1) / 15
    assert scores["tlx_weighted"].to_numpy() == pytest.approx(weighted, abs=1e-12)
    assert scores[["tlx_raw", "tlx_weighted"]].to_numpy().min() >= 0
    assert scores[["tlx_raw", "tlx_weighted"]].to_numpy().max() <= 100


def test_landau_condition_equals_brute_force():
    """Oracle: all 2^15 sets of choices."""
    pairs = list(itertools.combinations(range(6), 2))
    bits = (np.arange(2**15)[:, None] >> np.arange(15)) & 1
    possible = np.zeros((2**15, 6), dtype=int)
    for k, (a, b) in enumerate(pairs):
        possible[:, a] += bits[:, k]
        possible[:, b] += 1 - bits[:, k]
    possible = {tuple(sorted(row)) for row in possible.tolist()}
    answers = pd.DataFrame([["s"] + [50] * 6], columns=["pid", *NASA_TLX.items])
    accepted = set()
    for row in itertools.combinations_with_replacement(range(7), 6):
        if 14 <= sum(row) <= 16:
            try:
                score(answers, NASA_TLX, subject="pid", weights=weights_of(s=row))
                accepted.add(row)
            except ValueError as error:
                assert "no choices between two items give" in str(error)  # noqa: PT017
    assert accepted == possible


@pytest.mark.parametrize(
    ("low", "high", "step", "answer", "expected"),
    [
        (0, 100, None, 37.5, 37.5),
        (1, 7, 1, 4, 50.0),
        (1, 20, 1, 2, 100 / 19),
    ],
)
def test_other_forms_are_stretched(tlx, low, high, step, answer, expected):
    frame = tlx.assign(**dict.fromkeys(NASA_TLX.items, answer))
    scores = score(frame, replace(NASA_TLX, low=low, high=high, step=step), **WHO)
    assert scores.scores["tlx_raw"].to_numpy() == pytest.approx(expected, abs=1e-12)
    assert scores.coded["tlx_raw"].to_numpy() == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize(
    ("change", "arguments", "words"),
    [
        (
            lambda f: put(f, 0, "mental", 10**400),
            {},
            "subject 's1', condition 'M', item 'mental': 1000",
        ),
        (lambda f: put(f, 2, "effort", -5), {}, "-5 is not on the scale"),
        (
            lambda f: put(f, 3, "physical", None),
            {},
            "subject 's2', condition 'TMIG': missing answers of 'tlx_raw': physical",
        ),
        (
            lambda f: put(f, 1, "scheme", None),
            {},
            "condition: column 'scheme' has no label in row 1",
        ),
        (lambda f: pd.concat([f, f[["mental"]]], axis=1), {}, "column 'mental' occurs 2 times"),
        (lambda f: f, {"missing": ["refuse"]}, "missing must be one of"),
        (lambda f: f, {"questionnaire": "tlx"}, "questionnaire must be of class Questionnaire"),
    ],
)
def test_bad_tlx_is_refused(tlx, change, arguments, words):
    with pytest.raises(ValueError, match=words):
        score(change(tlx), **({"questionnaire": NASA_TLX} | WHO | arguments))


@pytest.mark.parametrize(
    ("weights", "words"),
    [
        (weights_of(s1=[4, 0, 4, 3, 2, 1]), "weights of subject 's1': no choices .* give"),
        (weights_of(s1=[5, "0", 4, 3, 2, 1]), "item 'physical': '0' is not a number"),
        (pd.concat([weights_of(s1=WEIGHTS)] * 2), "weights must have one row per subject"),
    ],
)
def test_bad_weights_are_refused(tlx, weights, words):
    with pytest.raises(ValueError, match=words):
        score(tlx, NASA_TLX, **WHO, weights=weights)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda f: f.iloc[1:], r"subject 's1': of mental and physical, chosen is \[\]"),
        (lambda f: put(f, 0, "first", "metal"), r"of mental and physical, chosen is \[\]"),
        (lambda f: None, "choices must be of class DataFrame"),
    ],
)
def test_bad_choices_are_refused(change, words):
    with pytest.raises(ValueError, match=words):
        tlx_weights(change(choices_of(list(NASA_TLX.items))))


def test_missing_scales_by_the_half_rule(tlx):
    frame = put(put(tlx, 0, "physical", np.nan), 0, "effort", np.nan)
    weights = weights_of(s1=WEIGHTS, s2=WEIGHTS)
    scored = score(frame, NASA_TLX, **WHO, weights=weights, missing="half_rule")
    assert scored.scores.loc[0, "tlx_raw"] == pytest.approx((80 + 60 + 40 + 50) / 4)
    assert scored.scores.loc[0, "tlx_weighted"] == pytest.approx(
        (5 * 80 + 4 * 60 + 3 * 40 + 1 * 50) / 13
    )
    assert list(scored.missing) == ["pid", "scheme", "item"]
    assert scored.missing.to_numpy().tolist() == [["s1", "M", "physical"], ["s1", "M", "effort"]]
    for scale in ("mental", "temporal"):
        frame = put(frame, 0, scale, None)
    with pytest.raises(ValueError, match="subject 's1', condition 'M': missing answers"):
        score(frame, NASA_TLX, **WHO, missing="half_rule")


# trust checklist


def test_trust_checklist_by_hand():
    answers = [1, 2, 3, 4, 5, 7, 6, 5, 4, 3, 2, 1]
    frame = pd.DataFrame([answers], columns=TRUST_CHECKLIST.items).assign(subject=1)
    row = score(frame, TRUST_CHECKLIST).scores.loc[0]
    assert row["trust_sum"] == pytest.approx((7 + 6 + 5 + 4 + 3) + (7 + 6 + 5 + 4 + 3 + 2 + 1))
    assert row["trust_mean"] == pytest.approx(53 / 12)
    assert row["trust_subscale"] == pytest.approx(28 / 7)
    assert row["distrust_subscale"] == pytest.approx(15 / 5)


# satisfaction and questionnaires in general


def test_satisfaction_by_hand():
    """The small studies (Section 2.4.1.3): satisfaction, comfort and control, from 1 to 5."""
    frame = pd.DataFrame(
        {"subject": [1, 2], "satisfaction": [5, 1], "comfort": [4, 2], "control": [3, 1]}
    )
    scores = score(frame, satisfaction_scale()).scores
    assert scores["satisfaction_mean"].tolist() == pytest.approx([4.0, 4 / 3])
    assert scores["satisfaction_sum"].tolist() == pytest.approx([12, 4])
    with pytest.raises(ValueError, match="subject 1, item 'comfort': 6 is not on the scale"):
        score(frame.assign(comfort=6), satisfaction_scale(5))
    seven = satisfaction_scale(7, ["comfort", "control"], reversed=["control"])
    scores = score(frame.assign(comfort=6), seven).scores
    assert scores["satisfaction_mean"].tolist() == pytest.approx([(6 + 5) / 2, (6 + 7) / 2])


def test_the_questionnaire_of_the_large_studies_has_no_invented_items():
    asked = satisfaction_scale(7, items=3)
    assert asked.items == ("satisfaction_1", "satisfaction_2", "satisfaction_3")
    assert "[65]" in asked.source
    assert "2.4.1.3" in satisfaction_scale(5).source


def test_subscales_count_as_answered_and_scales_may_be_continuous():
    mood = Questionnaire("mood", ["a", "b", "c"], 0, 10, ["c"], {"ac": ["a", "c"]}, step=2.5)
    frame = pd.DataFrame({"subject": [1], "a": [2.5], "b": [5.0], "c": [10.0]})
    row = score(frame, mood).scores.loc[0]
    assert row["mood_mean"] == pytest.approx((2.5 + 5 + 0) / 3)
    assert row["ac"] == pytest.approx(6.25)
    assert mood.table()["ac"].tolist() == [True, False, True]
    free = Questionnaire("free", ["a"], 0, 1, step=None)
    frame = pd.DataFrame({"subject": [1], "a": [0.123]})
    assert score(frame, free).scores.loc[0, "free_mean"] == 0.123


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("x", [], 1, 7), "items must have at least 1 labels"),
        (("x", ["a"], 1, 7, (), {"s": ["b"]}), "s must be one of 'a', got 'b'"),
        (("x", "ab", 1, 7), "items must be a list"),
        (("x", ["a"], 1, 7, ["b"]), "reversed must be one of 'a', got 'b'"),
        ((3, ["a"], 1, 7), "name must be of class str"),
    ],
)
def test_bad_questionnaires_are_refused(arguments, words):
    with pytest.raises(ValueError, match=words):
        Questionnaire(*arguments)


# Cronbach's alpha


def test_alpha_of_the_textbook_and_of_pingouin():
    """Oracle: pingouin (interval rounded to three decimals), and the formula by hand."""
    import pingouin as pg

    rng = np.random.default_rng(1)
    frame = pd.DataFrame(rng.normal(size=(30, 1)) + rng.normal(size=(30, 5)), columns=list("abcde"))
    result = cronbach_alpha(frame, 0.9)
    alpha, interval = pg.cronbach_alpha(frame, ci=0.9)
    assert result.alpha == pytest.approx(alpha, rel=1e-13)
    assert [result.ci_low, result.ci_high] == pytest.approx(interval, abs=5.1e-4)
    v = frame.to_numpy()
    assert result.alpha == pytest.approx(
        1.25 * (1 - v.var(axis=0, ddof=1).sum() / v.sum(axis=1).var(ddof=1)), rel=1e-13
    )
    assert result.without["c"] == pytest.approx(
        pg.cronbach_alpha(frame.drop(columns="c"))[0], rel=1e-13
    )
    assert list(result.table().columns) == ["n", "items", "alpha", "ci_low", "ci_high"]
    assert "90% CI" in result.message


@pytest.mark.parametrize("name", ALPHAS)
def test_alpha_agrees_with_r(name):
    """Oracle: psych::alpha with Feldt's interval (reference/cronbach_alpha.R)."""
    expected = ALPHAS[name]
    result = cronbach_alpha(pd.DataFrame(expected["items"]))
    assert [result.alpha, result.ci_low, result.ci_high] == pytest.approx(
        [expected["alpha"], expected["ci_low"], expected["ci_high"]], rel=1e-9
    )
    if expected["without"]:
        assert result.without.tolist() == pytest.approx(expected["without"], rel=1e-9, abs=1e-12)
    else:
        assert result.without.isna().all()


@pytest.mark.parametrize(
    ("frame", "words"),
    [
        (pd.DataFrame({"a": [1, 2, 3]}), r"alpha needs at least two items .* shape \(3, 1\)"),
        (pd.DataFrame({"a": [1, 2, 3], "b": [3, 2, 1]}), "with sums that differ"),
        (np.ones((3, 3)), "items must be of class DataFrame, got ndarray"),
    ],
)
def test_bad_items_are_refused(frame, words):
    with pytest.raises(ValueError, match=words):
        cronbach_alpha(frame)
