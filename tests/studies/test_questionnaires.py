"""
Scores against sums written out by hand, closed forms, pingouin and R; every bad answer is named.
"""

import itertools
import json
from dataclasses import replace
from decimal import Decimal
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


def test_performance_is_not_reversed_unless_asked(tlx):
    poor, good = (score(tlx.assign(performance=x), NASA_TLX, **WHO).scores for x in (100, 0))
    assert (poor["tlx_raw"] - good["tlx_raw"]).to_numpy() == pytest.approx(100 / 6)
    turned = score(tlx.assign(performance=100), replace(NASA_TLX, reversed=["performance"]), **WHO)
    pd.testing.assert_frame_equal(turned.scores, good)


def test_weights_per_subject(tlx):
    second = [0, 5, 1, 2, 3, 4]
    scores = score(tlx, NASA_TLX, **WHO, weights=weights_of(s2=second, s1=WEIGHTS)).scores
    w = np.array([WEIGHTS] * 2 + [second] * 2)
    assert scores["tlx_weighted"].to_numpy() == pytest.approx(
        (w * tlx[list(NASA_TLX.items)].to_numpy()).sum(axis=1) / 15, rel=1e-15
    )


def choices_of(order, subject="s1"):
    """Choices of someone who ranks the scales: the one earlier in `order` is always chosen."""
    return pd.DataFrame(
        [
            (subject, a, b, min(a, b, key=order.index))
            for a, b in itertools.combinations(NASA_TLX.items, 2)
        ],
        columns=["subject", "first", "second", "chosen"],
    )


@given(st.permutations(NASA_TLX.items))
@settings(max_examples=20)
def test_a_ranking_gives_weights_five_to_zero(order):
    weights = tlx_weights(choices_of(order)).loc[0, list(NASA_TLX.items)]
    assert [weights[name] for name in order] == [5, 4, 3, 2, 1, 0]


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
        (0, 10, 1, 7, 70.0),
        (1, 7, 1, 1, 0.0),
        (1, 7, 1, 4, 50.0),
        (0, 20, 1, 18, 90.0),
        (1, 21, 1, 21, 100.0),
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
        (lambda f: put(f, 0, "mental", Decimal("sNaN")), {}, "item 'mental': Decimal"),
        (
            lambda f: put(f, 1, "temporal", 23),
            {},
            "subject 's1', condition 'TMIG', item 'temporal': 23 is not on the scale from 0 to 100 "
            "in steps of 5; .*low=…",
        ),
        (lambda f: put(f, 2, "effort", 105), {}, "'s2', condition 'M', item 'effort': 105 is not"),
        (lambda f: put(f, 2, "effort", -5), {}, "-5 is not on the scale"),
        (lambda f: put(f, 0, "mental", "80"), {}, "'mental': '80' is not a number"),
        (lambda f: put(f, 0, "mental", True), {}, "True is not a number"),
        (lambda f: put(f, 0, "mental", np.inf), {}, "inf is not on the scale"),
        (
            lambda f: put(f, 3, "physical", None),
            {},
            "subject 's2', condition 'TMIG': missing answers of 'tlx_raw': physical",
        ),
        (lambda f: f.drop(columns="effort"), {}, "answers: no column 'effort'"),
        (lambda f: f.rename(columns={"effort": "efort"}), {}, "did you mean 'efort'"),
        (lambda f: pd.concat([f, f.iloc[:1]]), {}, "repeated: subject 's1', condition 'M'"),
        (
            lambda f: put(f, 1, "scheme", None),
            {},
            "condition: column 'scheme' has no label in row 1",
        ),
        (lambda f: f.iloc[:0], {}, "answers must have one row .*; it has 0 rows"),
        (lambda f: f.to_numpy(), {}, "answers must be of class DataFrame, got ndarray"),
        (lambda f: pd.concat([f, f[["mental"]]], axis=1), {}, "column 'mental' occurs 2 times"),
        (lambda f: f, {"subject": "pidd"}, "subject: no column 'pidd'; did you mean 'pid'"),
        (lambda f: f, {"condition": "pid"}, "repeated: subject 's1', condition 's1'"),
        (lambda f: f, {"missing": "mean"}, "missing must be one of 'refuse'"),
        (lambda f: f, {"missing": ["refuse"]}, "missing must be one of"),
        (lambda f: f, {"subject": ["pid"]}, "subject must be the name of one column"),
        (lambda f: f, {"condition": None}, "or per subject and condition= if there are several"),
        (
            lambda f: f,
            {"questionnaire": replace(NASA_TLX, high=20, step=1)},
            "80 is not on the scale from 0 to 20",
        ),
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
        (weights_of(s1=[4.5, 0, 4.5, 3, 2, 1]), "no choices between two items"),
        (weights_of(s1=[5, -1, 4, 3, 2, 2]), "no choices between two items"),
        (weights_of(s1=[5, np.nan, 4, 3, 2, 1]), "no choices between two items"),
        (weights_of(s1=[5, "0", 4, 3, 2, 1]), "item 'physical': '0' is not a number"),
        (weights_of(s1=[5, 5, 5, 0, 0, 0]), "no choices between two items"),
        (WEIGHTS, "weights must be of class DataFrame, got list"),
        (weights_of(s1=WEIGHTS).drop(columns="pid"), "subject: no column 'pid'"),
        (weights_of(s1=WEIGHTS), "weights: there are none for subject 's2'"),
        (pd.concat([weights_of(s1=WEIGHTS)] * 2), "weights must have one row per subject"),
    ],
)
def test_bad_weights_are_refused(tlx, weights, words):
    with pytest.raises(ValueError, match=words):
        score(tlx, NASA_TLX, **WHO, weights=weights)


def test_weights_of_unweighted_items_are_refused(trust):
    with pytest.raises(ValueError, match="weights: the items of 'trust' are not weighted"):
        score(trust, TRUST_CHECKLIST, **WHO, weights=weights_of(s1=WEIGHTS))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda f: f.iloc[1:], r"subject 's1': of mental and physical, chosen is \[\]"),
        (lambda f: pd.concat([f, f.iloc[:1]]), "of mental and physical, chosen is .*one row per"),
        (lambda f: f.assign(second=f["first"]), "of mental and physical, chosen is"),
        (lambda f: put(f, 0, "chosen", "effort"), r"physical, chosen is \['effort'\]"),
        (lambda f: put(f, 0, "first", "metal"), r"of mental and physical, chosen is \[\]"),
        (lambda f: f.drop(columns="chosen"), "chosen: no column 'chosen'"),
        (lambda f: put(f, 3, "subject", None), "subject: column 'subject' has no label in row 3"),
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


def test_one_condition_needs_no_column(tlx):
    scored = score(tlx[tlx["scheme"] == "M"], NASA_TLX, subject="pid")
    assert list(scored.scores.columns) == ["pid", "tlx_raw"]
    assert scored.scores["pid"].tolist() == ["s1", "s2"]
    assert "NASA-TLX" in scored._repr_html_()


def test_synthetic_answers_give_synthetic_scores(tlx, trust):
    for frame, asked in ((tlx, NASA_TLX), (trust, TRUST_CHECKLIST)):
        frame.attrs["synthetic"] = True
        assert score(frame, asked, **WHO).table().attrs["synthetic"] is True
        frame.attrs.clear()
        scores = score(frame.assign(synthetic=True), asked, **WHO).table()
        assert scores.attrs["origin"] == "synthetic data"


# trust checklist


def test_trust_checklist_by_hand():
    answers = [1, 2, 3, 4, 5, 7, 6, 5, 4, 3, 2, 1]
    frame = pd.DataFrame([answers], columns=TRUST_CHECKLIST.items).assign(subject=1)
    row = score(frame, TRUST_CHECKLIST).scores.loc[0]
    assert row["trust_sum"] == pytest.approx((7 + 6 + 5 + 4 + 3) + (7 + 6 + 5 + 4 + 3 + 2 + 1))
    assert row["trust_mean"] == pytest.approx(53 / 12)
    assert row["trust_subscale"] == pytest.approx(28 / 7)
    assert row["distrust_subscale"] == pytest.approx(15 / 5)


@given(answered(12, 1, 7))
@settings(max_examples=50)
def test_trust_scores_hold_together(answers):
    frame = pd.DataFrame(answers, columns=TRUST_CHECKLIST.items).assign(subject=range(len(answers)))
    scores = score(frame, TRUST_CHECKLIST).scores
    assert scores["trust_mean"].to_numpy() == pytest.approx(
        (7 * scores["trust_subscale"] + 5 * (8 - scores["distrust_subscale"])).to_numpy() / 12,
        abs=1e-12,
    )
    mirror = frame.assign(**{name: 8 - frame[name] for name in TRUST_CHECKLIST.items})
    turned = score(mirror, TRUST_CHECKLIST).scores
    assert turned["trust_sum"].to_numpy() == pytest.approx(
        96 - scores["trust_sum"].to_numpy(), abs=1e-9
    )


def test_the_answers_must_not_be_reversed_beforehand(trust):
    """Negative control: reversing items 1-5 before scoring changes the score."""
    first = list(TRUST_CHECKLIST.items[:5])
    assert TRUST_CHECKLIST.reversed == tuple(first)
    turned = trust.assign(**{name: 8 - trust[name] for name in first})
    twice = score(turned, TRUST_CHECKLIST, **WHO).scores
    naive = trust[list(TRUST_CHECKLIST.items)].mean(axis=1)
    assert twice["trust_mean"].to_numpy() == pytest.approx(naive.to_numpy())
    assert not np.allclose(score(trust, TRUST_CHECKLIST, **WHO).scores["trust_mean"], naive)


def test_fewer_than_half_of_a_subscale_is_refused(trust):
    frame = trust
    for name in TRUST_CHECKLIST.items[:3]:
        frame = put(frame, 0, name, np.nan)
    with pytest.raises(ValueError, match="missing answers of 'distrust_subscale': deceptive, unde"):
        score(frame, TRUST_CHECKLIST, **WHO, missing="half_rule")


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
        (("x", ["a", "a"], 1, 7), "'a' occurs twice"),
        (("x", ["a", "b"], 1, 7, ["a", "a"]), "reversed must differ"),
        (("x", ["a"], 1, 7, (), {"s": ["b"]}), "s must be one of 'a', got 'b'"),
        (("x", ["a"], 1, 7, (), {"s": []}), "s must have at least 1"),
        (("x", ["a"], 1, 7, (), ["a"]), "subscales must be of class dict"),
        (("x", "ab", 1, 7), "items must be a list"),
        (("x", ["a"], 7, 1), "low must be below high"),
        (("x", ["a"], 1, np.inf), "high must be finite"),
        (("x", ["a"], 1, 7, ["b"]), "reversed must be one of 'a', got 'b'"),
        (("x", ["a"], 1, 7, (), {}, 4), "step must divide"),
        (("x", ["a"], 1, 7, (), {}, -1), "step must be positive"),
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


def test_reliability_is_per_condition_and_score(trust):
    result = score(trust, TRUST_CHECKLIST, **WHO).reliability()
    assert result.groupby("score", sort=False)["condition"].apply(list).to_dict() == {
        name: ["M", "TMIG"] for name in ("trust_mean", "trust_subscale", "distrust_subscale")
    }
    coded = trust[trust["scheme"] == "TMIG"][list(TRUST_CHECKLIST.items)].copy()
    coded[list(TRUST_CHECKLIST.reversed)] = 8 - coded[list(TRUST_CHECKLIST.reversed)]
    assert result.loc[1, "alpha"] == pytest.approx(cronbach_alpha(coded).alpha, rel=1e-13)
    alike = trust.assign(**dict.fromkeys(TRUST_CHECKLIST.items, 4))
    same = score(alike, TRUST_CHECKLIST, **WHO).reliability()
    assert same["alpha"].isna().all()
    assert same["n"].tolist() == [6] * 6


@pytest.mark.parametrize(
    ("frame", "words"),
    [
        (pd.DataFrame({"a": [1, 2, 3]}), r"alpha needs at least two items .* shape \(3, 1\)"),
        (
            pd.DataFrame({"a": [1, 2], "b": [1, 2]}),
            r"alpha needs at least two items .* shape \(2, 2\)",
        ),
        (pd.DataFrame({"a": [1, 2, 3], "b": [3, 2, 1]}), "with sums that differ"),
        (
            pd.DataFrame({"a": [1, 2, np.nan], "b": [3, 2, 1]}),
            "item 'a' must hold only finite numbers",
        ),
        (
            pd.DataFrame({"a": [1, 2, 3], "b": ["x", "y", "z"]}),
            "item 'b' must hold only finite numbers",
        ),
        (np.ones((3, 3)), "items must be of class DataFrame, got ndarray"),
    ],
)
def test_bad_items_are_refused(frame, words):
    with pytest.raises(ValueError, match=words):
        cronbach_alpha(frame)


@pytest.mark.parametrize("confidence", [0.0, 1.0, 95, "0.95", np.nan])
def test_confidence_lies_between_0_and_1(confidence):
    with pytest.raises(ValueError, match="confidence"):
        cronbach_alpha(pd.DataFrame({"a": [1, 2, 3], "b": [2, 3, 5]}), confidence)


@pytest.mark.parametrize("unit", [1e-20, 1e-160, 1e-250, 1e300])
def test_alpha_of_any_unit(unit):
    answers = pd.DataFrame([[1, 2, 3], [2, 2, 4], [3, 1, 5], [2, 4, 4]], columns=["a", "b", "c"])
    assert cronbach_alpha(answers * unit).alpha == pytest.approx(
        cronbach_alpha(answers).alpha, rel=1e-12
    )
