"""
Scores against sums written out by hand, closed forms, pingouin and R; every bad answer is named.
"""

import itertools
import json
from decimal import Decimal
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings, strategies as st

from trustlab.studies.questionnaires.likert import (
    TRUST_CHECKLIST,
    LikertScale,
    Subscale,
    cronbach_alpha,
    satisfaction_scale,
    score_likert,
    score_satisfaction,
    score_trust_checklist,
)
from trustlab.studies.questionnaires.nasa_tlx import TLX_SCALES, score_nasa_tlx, tlx_weights

ALPHAS = json.loads((Path(__file__).parents[1] / "reference" / "cronbach_alpha.json").read_text())[
    "sets"
]
WEIGHTS = {
    "mental": 5,
    "physical": 0,
    "temporal": 4,
    "performance": 3,
    "effort": 2,
    "frustration": 1,
}


@pytest.fixture
def tlx():
    rows = [
        ("s1", "M", 80, 20, 60, 40, 70, 50),
        ("s1", "TMIG", 40, 10, 30, 20, 35, 15),
        ("s2", "M", 100, 0, 95, 5, 55, 45),
        ("s2", "TMIG", 25, 5, 10, 100, 20, 0),
    ]
    return pd.DataFrame(rows, columns=["pid", "scheme", *TLX_SCALES])


@pytest.fixture
def trust():
    rng = np.random.default_rng(4)
    frame = pd.DataFrame(rng.integers(1, 8, (12, 12)), columns=TRUST_CHECKLIST.items)
    return frame.assign(pid=np.repeat(range(1, 7), 2), scheme=["M", "TMIG"] * 6)


def put(frame, row, column, value):
    frame = frame.copy()
    frame[column] = frame[column].astype(object)
    frame.loc[row, column] = value
    return frame


def long(frame, items, keys=("pid", "scheme")):
    return frame.melt(
        id_vars=list(keys), value_vars=list(items), var_name="what", value_name="answer"
    )


def answered(columns, low, high, step=1):
    return st.lists(
        st.lists(st.integers(0, (high - low) // step), min_size=columns, max_size=columns),
        min_size=1,
        max_size=6,
    ).map(lambda rows: low + step * np.array(rows))


# NASA-TLX


def test_tlx_by_hand(tlx):
    scores = score_nasa_tlx(tlx, subject="pid", condition="scheme", weights=WEIGHTS).table()
    assert list(scores.columns) == ["pid", "scheme", "tlx_raw", "tlx_weighted"]
    assert scores.loc[0, "tlx_raw"] == pytest.approx((80 + 20 + 60 + 40 + 70 + 50) / 6, rel=1e-15)
    assert scores.loc[0, "tlx_weighted"] == pytest.approx(
        (5 * 80 + 0 * 20 + 4 * 60 + 3 * 40 + 2 * 70 + 1 * 50) / 15, rel=1e-15
    )
    assert scores.attrs["scales"]["tlx_raw"] == {"name": "NASA-TLX", "low": 0.0, "high": 100.0}
    assert scores["pid"].tolist() == ["s1", "s1", "s2", "s2"]


def test_performance_is_not_reversed_unless_asked(tlx):
    poor = tlx.assign(performance=100)
    good = tlx.assign(performance=0)
    kw = {"subject": "pid", "condition": "scheme"}
    difference = (
        score_nasa_tlx(poor, **kw).scores["tlx_raw"] - score_nasa_tlx(good, **kw).scores["tlx_raw"]
    )
    assert difference.to_numpy() == pytest.approx(100 / 6)
    turned = score_nasa_tlx(poor, **kw, performance="poor_to_good")
    pd.testing.assert_frame_equal(turned.scores, score_nasa_tlx(good, **kw).scores)
    assert (turned.answers["performance"] == 100).all()


def test_without_weights_the_weighted_score_is_nan(tlx):
    assert (
        score_nasa_tlx(tlx, subject="pid", condition="scheme").scores["tlx_weighted"].isna().all()
    )


def test_long_and_mapped_tables_give_the_same(tlx):
    wanted = score_nasa_tlx(tlx, subject="pid", condition="scheme").scores
    names = {scale: f"q{k}" for k, scale in enumerate(TLX_SCALES)}
    renamed = tlx.rename(columns=names)
    for items in (names, list(names.values())):
        pd.testing.assert_frame_equal(
            score_nasa_tlx(renamed, subject="pid", condition="scheme", items=items).scores, wanted
        )
    melted = long(renamed, names.values())
    found = score_nasa_tlx(
        melted, subject="pid", condition="scheme", items=names, item="what", response="answer"
    ).scores
    pd.testing.assert_frame_equal(found.sort_values(["pid", "scheme"], ignore_index=True), wanted)


def test_weights_per_subject_and_per_condition(tlx):
    other = dict(zip(TLX_SCALES, (0, 5, 1, 2, 3, 4), strict=True))
    own = pd.DataFrame([{"pid": "s2"} | other, {"pid": "s1"} | WEIGHTS])
    scores = score_nasa_tlx(tlx, subject="pid", condition="scheme", weights=own).scores[
        "tlx_weighted"
    ]
    w = np.array([list(WEIGHTS.values())] * 2 + [list(other.values())] * 2)
    assert scores.to_numpy() == pytest.approx(
        (w * tlx[list(TLX_SCALES)].to_numpy()).sum(axis=1) / 15, rel=1e-15
    )
    both = pd.DataFrame(
        [
            {"pid": who, "scheme": which} | (WEIGHTS if which == "M" else other)
            for who in ("s1", "s2")
            for which in ("TMIG", "M")
        ]
    )
    scores = score_nasa_tlx(tlx, subject="pid", condition="scheme", weights=both).scores[
        "tlx_weighted"
    ]
    w = np.array([list(WEIGHTS.values()), list(other.values())] * 2)
    assert scores.to_numpy() == pytest.approx(
        (w * tlx[list(TLX_SCALES)].to_numpy()).sum(axis=1) / 15, rel=1e-15
    )


def choices_of(order, subject="s1"):
    """Choices of someone who ranks the scales: the one earlier in `order` is always chosen."""
    return pd.DataFrame(
        [
            (subject, a, b, min(a, b, key=order.index))
            for a, b in itertools.combinations(TLX_SCALES, 2)
        ],
        columns=["subject", "first", "second", "chosen"],
    )


@given(st.permutations(TLX_SCALES))
@settings(max_examples=20)
def test_a_ranking_gives_weights_five_to_zero(order):
    weights = tlx_weights(choices_of(order)).loc[0, list(TLX_SCALES)]
    assert [weights[name] for name in order] == [5, 4, 3, 2, 1, 0]


@given(st.lists(st.booleans(), min_size=15, max_size=15), answered(6, 0, 100, 5))
@settings(max_examples=80)
def test_any_fifteen_choices_are_accepted_and_the_scores_stay_in_range(picks, answers):
    pairs = itertools.combinations(TLX_SCALES, 2)
    rows = [("s", a, b, a if pick else b) for (a, b), pick in zip(pairs, picks, strict=True)]
    weights = tlx_weights(pd.DataFrame(rows, columns=["subject", "first", "second", "chosen"]))
    assert weights[list(TLX_SCALES)].to_numpy().sum() == 15
    frame = pd.DataFrame(answers, columns=TLX_SCALES).assign(
        subject="s", condition=range(len(answers))
    )
    scores = score_nasa_tlx(
        frame, subject="subject", condition="condition", weights=weights, scale="0-100"
    ).scores
    own = answers * weights[list(TLX_SCALES)].to_numpy()
    assert scores["tlx_weighted"].to_numpy() == pytest.approx(own.sum(axis=1) / 15, abs=1e-12)
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
    answers = pd.DataFrame([["s"] + [50] * 6], columns=["subject", *TLX_SCALES])
    accepted = set()
    for row in itertools.combinations_with_replacement(range(6), 6):
        if sum(row) == 15:
            try:
                score_nasa_tlx(
                    answers, subject="subject", weights=dict(zip(TLX_SCALES, row, strict=True))
                )
                accepted.add(row)
            except ValueError as error:
                assert "no fifteen choices give" in str(error)  # noqa: PT017
    assert accepted == possible


@pytest.mark.parametrize(
    ("scale", "answer", "score"),
    [
        ("0-100", 37.5, 37.5),
        ("0-100", 20, 20.0),
        ("0-10", 7, 70.0),
        ("1-7", 1, 0.0),
        ("1-7", 4, 50.0),
        ("1-7", 7, 100.0),
        ("0-20", 18, 90.0),
        ("0-20", 0, 0.0),
        ("1-21", 1, 0.0),
        ("1-21", 21, 100.0),
        ("1-20, as intervals", 20, 100.0),
        ("1-20, as intervals", 1, 5.0),
        ("1-20, stretched", 1, 0.0),
        ("1-20, stretched", 20, 100.0),
        ("1-20, stretched", 2, 100 / 19),
    ],
)
def test_rescaling_by_name(tlx, scale, answer, score):
    frame = tlx.assign(**dict.fromkeys(TLX_SCALES, answer))
    scores = score_nasa_tlx(frame, subject="pid", condition="scheme", scale=scale)
    assert scores.scores["tlx_raw"].to_numpy() == pytest.approx(score, abs=1e-12)
    assert scores.answers.to_numpy() == pytest.approx(score, abs=1e-12)


@pytest.mark.parametrize(
    ("change", "arguments", "words"),
    [
        (
            lambda f: put(f, 0, "mental", 10**400),
            {},
            "subject 's1', condition 'M', item 'mental': the answer is 1000",
        ),
        (
            lambda f: put(f, 0, "mental", Decimal("sNaN")),
            {},
            "item 'mental': the answer is Decimal",
        ),
        (
            lambda f: put(f, 1, "temporal", 23),
            {},
            "subject 's1', condition 'TMIG', item 'temporal': 23 is not a step of 5",
        ),
        (
            lambda f: put(f, 2, "effort", 105),
            {},
            "'s2', condition 'M', item 'effort': 105 lies outside 0 to 100",
        ),
        (lambda f: put(f, 2, "effort", -5), {}, "-5 lies outside 0 to 100"),
        (
            lambda f: put(f, 0, "mental", "high"),
            {},
            "subject 's1', condition 'M', item 'mental': the answer is 'high'",
        ),
        (lambda f: put(f, 0, "mental", "80"), {}, "the answer is '80', not a number"),
        (lambda f: put(f, 0, "mental", True), {}, "the answer is True"),
        (lambda f: put(f, 0, "mental", np.inf), {}, "inf lies outside"),
        (
            lambda f: put(f, 3, "physical", None),
            {},
            "1 answer is missing: subject 's2', condition 'TMIG', item 'physical'",
        ),
        (
            lambda f: put(f, 3, "physical", np.nan),
            {},
            "missing: subject 's2', condition 'TMIG', item 'physical'",
        ),
        (lambda f: f.drop(columns="effort"), {}, "item 'effort': no column 'effort'"),
        (lambda f: f.rename(columns={"effort": "efort"}), {}, "did you mean 'efort'"),
        (
            lambda f: pd.concat([f, f.iloc[:1]]),
            {},
            "subject 's1', condition 'M', item 'mental' occurs twice",
        ),
        (
            lambda f: put(f, 1, "scheme", None),
            {},
            "condition: column 'scheme' has no label in row 1",
        ),
        (lambda f: put(f, 1, "pid", np.nan), {}, "subject: column 'pid' has no label in row 1"),
        (lambda f: f.iloc[:0], {}, "the table of answers is empty"),
        (lambda f: f.to_numpy(), {}, "the answers must be of class DataFrame, got ndarray"),
        (lambda f: pd.concat([f, f[["mental"]]], axis=1), {}, "column 'mental' occurs 2 times"),
        (lambda f: f, {"subject": "pidd"}, "subject: no column 'pidd'; did you mean 'pid'"),
        (lambda f: f, {"condition": "pid"}, "subject and condition are the same column"),
        (lambda f: f, {"items": {"mental": "mental"}}, "no column is named for physical, temporal"),
        (
            lambda f: f,
            {"items": {"mentall": "mental"}},
            "'mentall' is not an item of this questionnaire; did you mean 'mental'",
        ),
        (lambda f: f, {"items": ["mental"]}, "items lists 1 columns, the questionnaire has 6"),
        (lambda f: f, {"items": ["mental"] * 6}, "two items are given the same column"),
        (lambda f: f, {"items": "mental"}, "items must be a dict"),
        (lambda f: f, {"item": "what"}, "needs both item= and response="),
        (lambda f: f, {"performance": "good"}, "performance must be"),
        (lambda f: f, {"missing": "mean"}, "missing must be one of 'refuse'"),
        (lambda f: f, {"scale": ["0-20"]}, "scale must be one of"),
        (lambda f: f, {"missing": ["refuse"]}, "missing must be one of"),
        (lambda f: f, {"subject": ["pid"]}, "subject must be the name of one column"),
        (
            lambda f: f,
            {"condition": None},
            "subject 's1', item 'mental' occurs twice; keep one, or say condition=",
        ),
        (lambda f: f, {"scale": "1-20"}, "scale must be one of '0-100'"),
        (lambda f: f, {"scale": "0-20"}, "80 lies outside 0 to 20"),
        (
            lambda f: f.assign(**dict.fromkeys(TLX_SCALES, 18)),
            {},
            "18 is not a step of 5 .*if the form had another scale, set scale=",
        ),
        (
            lambda f: f.assign(**dict.fromkeys(TLX_SCALES, 20)),
            {},
            "no answer exceeds 20, which fits several forms",
        ),
        (
            lambda f: f.assign(**dict.fromkeys(TLX_SCALES, 0)),
            {},
            "no answer exceeds 0, which fits several forms",
        ),
        (
            lambda f: f.assign(**dict.fromkeys(TLX_SCALES, 7.5)),
            {"scale": "0-20"},
            "7.5 is not a step of 1",
        ),
    ],
)
def test_bad_tlx_is_refused(tlx, change, arguments, words):
    with pytest.raises(ValueError, match=words):
        score_nasa_tlx(change(tlx), **({"subject": "pid", "condition": "scheme"} | arguments))


@pytest.mark.parametrize(
    ("weights", "words"),
    [
        (WEIGHTS | {"mental": 4}, "weights of subject 's1', condition 'M' sum to 14; .* sum to 15"),
        (
            WEIGHTS | {"mental": 6, "temporal": 3},
            "'mental' is 6; each must be a whole number from 0 to 5",
        ),
        (WEIGHTS | {"mental": 4.5, "temporal": 4.5}, "'mental' is 4.5"),
        (WEIGHTS | {"physical": -1, "frustration": 2}, "'physical' is -1"),
        (WEIGHTS | {"physical": np.nan}, "'physical' is missing"),
        (WEIGHTS | {"physical": "0"}, "item 'physical': the answer is '0'"),
        ({"mental": 15}, "weights must have the six scales"),
        (WEIGHTS | {"total": 15}, "weights must have the six scales"),
        (
            dict(zip(TLX_SCALES, (5, 5, 5, 0, 0, 0), strict=True)),
            "the 2 scales chosen least meet each other 1 times",
        ),
        ([5, 0, 4, 3, 2, 1], "weights must be of class DataFrame, got list; or give a dict"),
        (pd.DataFrame([WEIGHTS]), "weights has no column 'pid'"),
        (pd.DataFrame([{"pid": "s1"} | WEIGHTS]), "subject 's2': there are no weights"),
        (pd.DataFrame([{"pid": "s1"} | WEIGHTS] * 2), "subject 's1', item 'mental' occurs twice"),
        (
            pd.DataFrame([{"pid": "s1"} | WEIGHTS, {"pid": "s2"} | WEIGHTS | {"effort": 1}]),
            "weights of subject 's2' sum to 14",
        ),
    ],
)
def test_bad_weights_are_refused(tlx, weights, words):
    with pytest.raises(ValueError, match=words):
        score_nasa_tlx(tlx, subject="pid", condition="scheme", weights=weights)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda f: f.iloc[1:], "subject 's1': 1 of 15 pairs are missing: mental and physical"),
        (lambda f: pd.concat([f, f.iloc[:1]]), "'mental' and 'physical' are compared twice"),
        (lambda f: f.assign(second=f["first"]), "'mental' is compared with itself"),
        (
            lambda f: put(f, 0, "chosen", "effort"),
            "'mental' or 'physical': chosen is 'effort', which is neither",
        ),
        (lambda f: put(f, 0, "first", "metal"), "'metal' is not a scale; did you mean 'mental'"),
        (lambda f: f.drop(columns="chosen"), "chosen: no column 'chosen'"),
        (lambda f: put(f, 3, "subject", None), "subject: column 'subject' has no label in row 3"),
        (lambda f: None, "choices must be a DataFrame"),
    ],
)
def test_bad_choices_are_refused(change, words):
    with pytest.raises(ValueError, match=words):
        tlx_weights(change(choices_of(list(TLX_SCALES))))


def test_missing_scales_by_the_half_rule(tlx):
    frame = put(put(tlx, 0, "physical", np.nan), 0, "effort", np.nan)
    found = score_nasa_tlx(
        frame, subject="pid", condition="scheme", weights=WEIGHTS, missing="half_rule"
    )
    assert found.scores.loc[0, "tlx_raw"] == pytest.approx((80 + 60 + 40 + 50) / 4)
    assert found.scores.loc[0, "tlx_weighted"] == pytest.approx(
        (5 * 80 + 4 * 60 + 3 * 40 + 1 * 50) / 13
    )
    assert found.missing.to_numpy().tolist() == [
        ["s1", "M", "physical", "half_rule"],
        ["s1", "M", "effort", "half_rule"],
    ]
    for scale in ("mental", "temporal"):
        frame = put(frame, 0, scale, None)
    with pytest.raises(
        ValueError, match="subject 's1', condition 'M': fewer than half of the 6 items of 'tlx_raw'"
    ):
        score_nasa_tlx(frame, subject="pid", condition="scheme", missing="half_rule")


def test_one_condition_needs_no_column(tlx):
    found = score_nasa_tlx(tlx[tlx["scheme"] == "M"], subject="pid", weights=WEIGHTS)
    assert list(found.scores.columns) == ["pid", "tlx_raw", "tlx_weighted"]
    assert found.scores["pid"].tolist() == ["s1", "s2"]
    assert "NASA-TLX" in found._repr_html_()


def test_synthetic_answers_give_synthetic_scores(tlx, trust):
    for frame, score in ((tlx, score_nasa_tlx), (trust, score_trust_checklist)):
        frame.attrs["synthetic"] = True
        assert score(frame, subject="pid", condition="scheme").table().attrs["synthetic"] is True
        frame.attrs.clear()
        marked = frame.assign(synthetic=True)
        scores = score(marked, subject="pid", condition="scheme").table()
        assert scores.attrs["origin"] == "synthetic data"


# trust checklist


def test_trust_checklist_by_hand():
    answers = [1, 2, 3, 4, 5, 7, 6, 5, 4, 3, 2, 1]
    frame = pd.DataFrame([answers], columns=TRUST_CHECKLIST.items).assign(pid=1)
    row = score_trust_checklist(frame, subject="pid").scores.loc[0]
    assert row["trust_sum"] == pytest.approx((7 + 6 + 5 + 4 + 3) + (7 + 6 + 5 + 4 + 3 + 2 + 1))
    assert row["trust_mean"] == pytest.approx(53 / 12)
    assert row["trust_subscale"] == pytest.approx(28 / 7)
    assert row["distrust_subscale"] == pytest.approx(15 / 5)


@given(answered(12, 1, 7))
@settings(max_examples=50)
def test_trust_scores_hold_together(answers):
    frame = pd.DataFrame(answers, columns=TRUST_CHECKLIST.items).assign(pid=range(len(answers)))
    found = score_trust_checklist(frame, subject="pid")
    scores = found.scores
    assert scores["trust_mean"].to_numpy() == pytest.approx(
        (7 * scores["trust_subscale"] + 5 * (8 - scores["distrust_subscale"])).to_numpy() / 12,
        abs=1e-12,
    )
    mirror = frame.assign(**{name: 8 - frame[name] for name in TRUST_CHECKLIST.items})
    turned = score_trust_checklist(mirror, subject="pid").scores
    assert turned["trust_sum"].to_numpy() == pytest.approx(
        96 - scores["trust_sum"].to_numpy(), abs=1e-9
    )
    for name, (low, high) in found.ranges.items():
        assert scores[name].between(low, high).all()


def test_the_answers_must_not_be_reversed_beforehand(trust):
    """Negative control: reversing items 1-5 before scoring changes the score."""
    first = list(TRUST_CHECKLIST.items[:5])
    kw = {"subject": "pid", "condition": "scheme"}
    assert TRUST_CHECKLIST.reversed == tuple(first)
    twice = score_trust_checklist(
        trust.assign(**{name: 8 - trust[name] for name in first}), **kw
    ).scores
    naive = trust[list(TRUST_CHECKLIST.items)].mean(axis=1)
    assert twice["trust_mean"].to_numpy() == pytest.approx(naive.to_numpy())
    assert not np.allclose(score_trust_checklist(trust, **kw).scores["trust_mean"], naive)


def test_trust_long_numbered_and_missing(trust):
    kw = {"subject": "pid", "condition": "scheme"}
    wanted = score_trust_checklist(trust, **kw)
    numbered = trust.rename(columns={name: k for k, name in enumerate(TRUST_CHECKLIST.items, 1)})
    pd.testing.assert_frame_equal(
        score_trust_checklist(numbered, **kw, items=list(range(1, 13))).scores, wanted.scores
    )
    melted = long(trust, TRUST_CHECKLIST.items)
    args = kw | {"item": "what", "response": "answer"}
    pd.testing.assert_frame_equal(score_trust_checklist(melted, **args).scores, wanted.scores)
    gap = melted[~((melted["pid"] == 3) & (melted["scheme"] == "M") & (melted["what"] == "wary"))]
    with pytest.raises(
        ValueError, match="1 answer is missing: subject 3, condition 'M', item 'wary'"
    ):
        score_trust_checklist(gap, **args)
    found = score_trust_checklist(gap, **args, missing="half_rule")
    assert found.missing[["subject", "condition", "item"]].to_numpy().tolist() == [[3, "M", "wary"]]
    row = trust[(trust["pid"] == 3) & (trust["scheme"] == "M")].iloc[0]
    own = [8 - row[n] for n in TRUST_CHECKLIST.items[:5] if n != "wary"] + [
        row[n] for n in TRUST_CHECKLIST.items[5:]
    ]
    where = (found.scores["pid"] == 3) & (found.scores["scheme"] == "M")
    assert found.scores.loc[where, "trust_sum"].item() == pytest.approx(12 * np.mean(own))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            lambda f: put(f, 4, "wary", 8),
            "subject 3, condition 'M', item 'wary': 8 lies outside 1 to 7",
        ),
        (lambda f: put(f, 4, "wary", 0), "0 lies outside 1 to 7"),
        (lambda f: put(f, 4, "wary", 3.5), "3.5 is not a step of 1"),
        (lambda f: put(f, 4, "wary", "often"), "'wary': the answer is 'often'"),
        (lambda f: f.assign(wary=[9] * 12), r"\(12 such answers\)"),
    ],
)
def test_bad_trust_is_refused(trust, change, words):
    with pytest.raises(ValueError, match=words):
        score_trust_checklist(change(trust), subject="pid", condition="scheme")


def test_bad_long_tables_are_refused(trust):
    melted = long(trust, TRUST_CHECKLIST.items)
    args = {"subject": "pid", "condition": "scheme", "item": "what", "response": "answer"}
    with pytest.raises(ValueError, match="item 'deceptive' occurs twice"):
        score_trust_checklist(pd.concat([melted, melted.iloc[:1]]), **args)
    with pytest.raises(
        ValueError,
        match="'warry' in column 'what' is no item of this questionnaire; did you mean 'wary'",
    ):
        score_trust_checklist(melted.replace({"what": {"wary": "warry"}}), **args)
    with pytest.raises(ValueError, match="response: no column 'anser'; did you mean 'answer'"):
        score_trust_checklist(melted, **(args | {"response": "anser"}))


def test_fewer_than_half_of_a_subscale_is_refused(trust):
    frame = trust
    for name in TRUST_CHECKLIST.items[:3]:
        frame = put(frame, 0, name, np.nan)
    with pytest.raises(ValueError, match="fewer than half of the 5 items of 'distrust_subscale'"):
        score_trust_checklist(frame, subject="pid", condition="scheme", missing="half_rule")


# satisfaction and Likert scales in general


def test_satisfaction_by_hand():
    frame = pd.DataFrame(
        {"pid": [1, 2], "satisfaction": [5, 1], "comfort": [4, 2], "control": [3, 1]}
    )
    scores = score_satisfaction(frame, points=5, subject="pid").scores
    assert scores["satisfaction_mean"].tolist() == pytest.approx([4.0, 4 / 3])
    assert scores["satisfaction_sum"].tolist() == pytest.approx([12, 4])
    with pytest.raises(ValueError, match="subject 1, item 'comfort': 6 lies outside 1 to 5"):
        score_satisfaction(frame.assign(comfort=6), points=5, subject="pid")
    seven = score_satisfaction(
        frame.assign(comfort=6),
        points=7,
        subject="pid",
        items=["comfort", "control"],
        reversed=["control"],
    )
    assert seven.scores["satisfaction_mean"].tolist() == pytest.approx([(6 + 5) / 2, (6 + 7) / 2])
    assert seven.ranges == {"satisfaction_mean": (1, 7), "satisfaction_sum": (2, 14)}
    named = score_satisfaction(frame, points=5, subject="pid", items={"overall": "satisfaction"})
    assert named.scores["satisfaction_mean"].tolist() == [5, 1]


@pytest.mark.parametrize("points", [4, 10, "5", None, True, 5.5])
def test_satisfaction_has_five_or_seven_points(points):
    with pytest.raises(ValueError, match="points must be 5 or 7"):
        satisfaction_scale(points)


def test_items_of_satisfaction_are_a_list():
    with pytest.raises(ValueError, match="items must be a list of columns, got the text"):
        score_satisfaction(pd.DataFrame({"pid": [1], "q": [1]}), points=5, subject="pid", items="q")


def test_likert_scale_with_subscales():
    scale = LikertScale(
        "mood", ("a", "b", "c"), 0, 10, ("c",), (Subscale("ac", ("a", "c")),), step=2.5
    )
    frame = pd.DataFrame({"who": [1], "a": [2.5], "b": [5.0], "c": [10.0]})
    row = score_likert(frame, scale, subject="who").scores.loc[0]
    assert row["mood_mean"] == pytest.approx((2.5 + 5 + 0) / 3)
    assert row["ac"] == pytest.approx(6.25)
    assert scale.table()["ac"].tolist() == [True, False, True]
    free = LikertScale("free", ("a",), 0, 1, step=None)
    assert (
        score_likert(pd.DataFrame({"who": [1], "a": [0.123]}), free, subject="who").scores.loc[
            0, "free_mean"
        ]
        == 0.123
    )


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("x", (), 1, 7), "items must name at least one item"),
        (("x", ("a", "a"), 1, 7), "items: 'a' occurs twice"),
        (("x", ("a", "b"), 1, 7, ("a", "a")), "reversed: 'a' occurs twice"),
        (
            ("x", ("a",), 1, 7, (), (Subscale("x_mean", ("a",)),)),
            "subscale 'x_mean': another score has this name",
        ),
        (
            ("x", ("a",), 1, 7, (), (Subscale("x_sum", ("a",)),)),
            "subscale 'x_sum': another score has this name",
        ),
        (
            ("x", ("a",), 1, 7, (), (Subscale("s", ("a",)),) * 2),
            "subscale 's': another score has this name",
        ),
        (("x", ("a",), 1, 7, (), (Subscale("s", ("a", "a")),)), "subscale 's': 'a' occurs twice"),
        (("x", ("a",), 1, 7, (), (Subscale("s", ()),)), "subscale 's' must name at least one item"),
        (("x", ("a",), 1, 7, (), (Subscale("s", "a"),)), "subscale 's' must be a list of names"),
        (
            ("x", ("a", "b"), 1, 7, (), (Subscale("s", ("a",), ("b",)),)),
            "reversed items of subscale 's': 'b' is not",
        ),
        (("x", "ab", 1, 7), "items must be a list of names"),
        (("x", ("a",), 7, 1), "low must be below high"),
        (("x", ("a",), 1, np.inf), "high must be finite"),
        (("x", ("a",), 1, 7, ("b",)), "reversed: 'b' is not one of the items"),
        (
            ("x", ("a",), 1, 7, (), (Subscale("s", ("b",)),)),
            "subscale 's': 'b' is not one of the items",
        ),
        (("x", ("a",), 1, 7, (), (), 4), "step must divide"),
        (("x", ("a",), 1, 7, (), (), -1), "step must divide"),
        (("", ("a",), 1, 7), "name must be a name"),
    ],
)
def test_bad_scales_are_refused(arguments, words):
    with pytest.raises(ValueError, match=words):
        LikertScale(*arguments)


def test_scale_must_be_a_scale():
    with pytest.raises(ValueError, match="scale must be of class LikertScale"):
        score_likert(pd.DataFrame({"who": [1]}), "trust", subject="who")


# Cronbach's alpha


def test_alpha_of_the_textbook_and_of_pingouin():
    """Oracle: pingouin (interval rounded to three decimals), and the formula by hand."""
    import pingouin as pg

    rng = np.random.default_rng(1)
    frame = pd.DataFrame(rng.normal(size=(30, 1)) + rng.normal(size=(30, 5)), columns=list("abcde"))
    found = cronbach_alpha(frame, 0.9)
    alpha, interval = pg.cronbach_alpha(frame, ci=0.9)
    assert found.alpha == pytest.approx(alpha, rel=1e-14)
    assert [found.ci_low, found.ci_high] == pytest.approx(interval, abs=5.1e-4)
    v = frame.to_numpy()
    assert found.alpha == pytest.approx(
        1.25 * (1 - v.var(axis=0, ddof=1).sum() / v.sum(axis=1).var(ddof=1)), rel=1e-13
    )
    assert found.without["c"] == pytest.approx(
        pg.cronbach_alpha(frame.drop(columns="c"))[0], rel=1e-14
    )
    assert list(found.table().columns) == ["n", "items", "alpha", "ci_low", "ci_high"]


@pytest.mark.parametrize("name", ALPHAS)
def test_alpha_agrees_with_r(name):
    """Oracle: psych::alpha with Feldt's interval (reference/cronbach_alpha.R)."""
    wanted = ALPHAS[name]
    found = cronbach_alpha(pd.DataFrame(wanted["items"]))
    assert [found.alpha, found.ci_low, found.ci_high] == pytest.approx(
        [wanted["alpha"], wanted["ci_low"], wanted["ci_high"]], rel=1e-9
    )
    if wanted["without"]:
        assert found.without.tolist() == pytest.approx(wanted["without"], rel=1e-9, abs=1e-12)
    else:
        assert found.without.isna().all()


def test_reliability_is_per_condition_and_score(trust):
    found = score_trust_checklist(trust, subject="pid", condition="scheme").reliability()
    assert found.groupby("score", sort=False)["condition"].apply(list).to_dict() == {
        name: ["M", "TMIG"] for name in ("trust_mean", "trust_subscale", "distrust_subscale")
    }
    own = trust[trust["scheme"] == "TMIG"][list(TRUST_CHECKLIST.items)].copy()
    own[list(TRUST_CHECKLIST.reversed)] = 8 - own[list(TRUST_CHECKLIST.reversed)]
    assert found.loc[1, "alpha"] == pytest.approx(cronbach_alpha(own).alpha, rel=1e-13)
    same = score_trust_checklist(
        trust.assign(**dict.fromkeys(TRUST_CHECKLIST.items, 4)), subject="pid", condition="scheme"
    )
    assert same.reliability()["alpha"].isna().all()
    assert same.reliability()["n"].tolist() == [6] * 6


@pytest.mark.parametrize(
    ("frame", "words"),
    [
        (pd.DataFrame({"a": [1, 2, 3]}), "at least two items, got 1"),
        (
            pd.DataFrame({"a": [1, 2], "b": [1, 2]}),
            "at least three subjects who answered every item, got 2",
        ),
        (pd.DataFrame({"a": [1, 2, 3], "b": [3, 2, 1]}), "sum is the same for all subjects"),
        (
            pd.DataFrame({"a": [1, 2, np.nan], "b": [3, 2, 1]}),
            "item 'a' must hold only finite numbers",
        ),
        (
            pd.DataFrame({"a": [1, 2, 3], "b": ["x", "y", "z"]}),
            "item 'b' must hold only finite numbers",
        ),
        (np.ones((3, 3)), "items must be of class DataFrame, got ndarray"),
        (
            pd.DataFrame({"a": [1e300, 2, 3], "b": [3, 1e300, 1]}),
            "so large that their squares overflow",
        ),
    ],
)
def test_bad_items_are_refused(frame, words):
    with pytest.raises(ValueError, match=words):
        cronbach_alpha(frame)


@pytest.mark.parametrize("confidence", [0.0, 1.0, 95, "0.95", np.nan])
def test_confidence_lies_between_0_and_1(confidence):
    with pytest.raises(ValueError, match="confidence"):
        cronbach_alpha(pd.DataFrame({"a": [1, 2, 3], "b": [2, 3, 5]}), confidence)


def test_items_of_one_name_are_refused():
    answers = pd.DataFrame([[1, 2, 3], [2, 2, 4], [3, 1, 5], [2, 4, 4]], columns=["a", "b", "a"])
    with pytest.raises(ValueError, match="item 'a' occurs twice"):
        cronbach_alpha(answers)


@pytest.mark.parametrize("unit", [1e-20, 1e-160, 1e-250])
def test_alpha_of_tiny_numbers(unit):
    answers = pd.DataFrame([[1, 2, 3], [2, 2, 4], [3, 1, 5], [2, 4, 4]], columns=["a", "b", "c"])
    assert cronbach_alpha(answers * unit).alpha == pytest.approx(
        cronbach_alpha(answers).alpha, rel=1e-12
    )
