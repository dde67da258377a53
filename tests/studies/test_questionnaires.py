"""
Scores against sums written out by hand, closed forms, pingouin and R; bad answers are named.
"""

import itertools
from dataclasses import replace

import numpy as np
import pandas as pd
from hypothesis import given, settings, strategies as st

from tests.cases import refused
from tests.studies.scores import approx, parametrize, reference
from trustlab.studies.questionnaires import (
    NASA_TLX,
    TRUST_CHECKLIST,
    Questionnaire,
    cronbach_alpha,
    satisfaction_scale,
    score,
    tlx_weights,
)

ALPHAS = reference("cronbach_alpha")["sets"]
WEIGHTS = [5, 0, 4, 3, 2, 1]
WHO = {"subject": "pid", "condition": "scheme"}


TLX = pd.DataFrame(
    [
        ("s1", "M", 80, 20, 60, 40, 70, 50),
        ("s2", "M", 100, 0, 95, 5, 55, 45),
    ],
    columns=["pid", "scheme", *NASA_TLX.items],
)


def weights_of(**people):
    return pd.DataFrame(people.values(), columns=NASA_TLX.items).assign(pid=list(people))


# NASA-TLX


def test_weights_are_those_of_the_subject():
    weights = weights_of(s2=WEIGHTS, s1=[0, 5, 4, 3, 2, 1])
    first = score(TLX, NASA_TLX, **WHO, weights=weights).table().loc[0].to_dict()
    by_hand = (0 * 80 + 5 * 20 + 4 * 60 + 3 * 40 + 2 * 70 + 1 * 50) / 15
    raw = approx(320 / 6)
    assert first == {"pid": "s1", "scheme": "M", "tlx_raw": raw, "tlx_weighted": by_hand}


def choices_of(picks):
    """The fifteen choices of one person, each the first item of its pair or the second."""
    pairs = itertools.combinations(NASA_TLX.items, 2)
    rows = [("s", *pair, pair[not pick]) for pair, pick in zip(pairs, picks, strict=True)]
    return pd.DataFrame(rows, columns=["subject", "first", "second", "chosen"])


@given(
    st.lists(st.booleans(), min_size=15, max_size=15),
    st.lists(st.lists(st.integers(0, 20), min_size=6, max_size=6), min_size=1, max_size=6),
)
@settings(max_examples=30)
def test_any_fifteen_choices_make_weights_of_the_scores(picks, answers):
    choices = choices_of(picks)
    weights = tlx_weights(choices)
    counts = choices["chosen"].value_counts().reindex(NASA_TLX.items, fill_value=0)
    answers = 5 * np.array(answers)
    frame = pd.DataFrame(answers, columns=NASA_TLX.items)
    frame = frame.assign(subject="s", condition=range(len(answers)))
    scores = score(frame, NASA_TLX, condition="condition", weights=weights).scores
    assert scores["tlx_weighted"].tolist() == approx(answers @ counts / 15, abs=1e-12)
    assert scores["tlx_raw"].tolist() == approx(answers.mean(axis=1), abs=1e-12)


def test_the_pair_without_a_choice_is_named_and_an_index_has_no_part_in_choices():
    choices = choices_of([True] * 15)
    for rows, message in (
        (
            choices.drop(index=1),
            r"subject 's' .* 14 rows, and not one for \[\('mental', 'temporal'",
        ),
        (pd.concat([choices, choices[:1]]), r"16 rows, and not one for \[\('mental', 'physical'"),
        (choices[:0], "column 'subject' has no rows"),
    ):
        with refused(message):
            tlx_weights(rows)
    indexed = choices.set_index("subject", drop=False)
    pd.testing.assert_frame_equal(tlx_weights(indexed), tlx_weights(choices))


@parametrize(
    ("change", "message"),
    [
        ({"answers": pd.concat([TLX, TLX])}, "one row per subject"),
        ({"answers": TLX.replace({"effort": 55}, -5)}, "effort of subject s2, M is -5, not on the"),
        (
            {"weights": weights_of(s1=WEIGHTS, s2=[4.5, 0.5, 4, 3, 2, 1])},
            "of subject s2, M are not those of fifteen choices",
        ),
        # They were dropped in silence.
        (
            {"weights": weights_of(s1=WEIGHTS, s2=WEIGHTS, s3=WEIGHTS)},
            r"weights: \['s3'\] did not answer",
        ),
    ],
)
def test_answers_and_weights_that_are_none_are_named(change, message):
    with refused(message):
        score(**{"answers": TLX, "questionnaire": NASA_TLX} | WHO | change)


def test_landau_condition_equals_brute_force():
    """Oracle: all 2^15 sets of choices."""
    every = itertools.product(*itertools.combinations(range(6), 2))
    possible = {tuple(sorted(map(chosen.count, range(6)))) for chosen in every}
    answers = pd.DataFrame([["s"] + [50] * 6], columns=["pid", *NASA_TLX.items])
    accepted = set()
    for row in itertools.combinations_with_replacement(range(7), 6):
        if 14 <= sum(row) <= 16:
            try:
                score(answers, NASA_TLX, subject="pid", weights=weights_of(s=row))
                accepted.add(row)
            except ValueError as error:
                assert "are not those of fifteen choices" in str(error)  # noqa: PT017
    assert accepted == possible


# Other questionnaires


def one_row(**answers):
    return pd.DataFrame(answers, [0]).assign(subject=1)


MOOD = Questionnaire("mood", ["a", "b", "c"], 0, 10, ["c"], {"ac": ["a", "c"]}, step=2.5)
# The small studies (Section 2.4.1.3): satisfaction, comfort and control, from 1 to 5.
SMALL = {"satisfaction": 5, "comfort": 4, "control": 3}
SEVEN = satisfaction_scale(7, ["comfort", "control"], reversed=["control"])
FREE = Questionnaire("free", ["a"], 0, 1, step=None)
TWENTY = replace(NASA_TLX, low=1, high=20, step=1)


@parametrize(
    ("questionnaire", "answers", "expected"),
    [
        (
            TRUST_CHECKLIST,
            dict(zip(TRUST_CHECKLIST.items, [1, 2, 3, 4, 5, 7, 6, 5, 4, 3, 2, 1], strict=True)),
            # Distrust is 1 to 5, and counts as 7 to 3; trust is 7 to 1.
            {
                "trust_sum": 25 + 28,
                "trust_mean": 53 / 12,
                "trust_subscale": 4.0,
                "distrust_subscale": 3.0,
            },
        ),
        (satisfaction_scale(), SMALL, {"satisfaction_mean": 4.0, "satisfaction_sum": 12}),
        (SEVEN, {"comfort": 6, "control": 3}, {"satisfaction_mean": (6 + 5) / 2}),
        # A subscale counts its items as answered.
        (MOOD, {"a": 2.5, "b": 5.0, "c": 10.0}, {"mood_mean": 7.5 / 3, "ac": 6.25}),
        (FREE, {"a": 0.123}, {"free_mean": 0.123}),
        # Other forms of the task load index are stretched.
        (TWENTY, dict.fromkeys(NASA_TLX.items, 2), {"tlx_raw": 100 / 19}),
    ],
)
def test_scores_by_hand(questionnaire, answers, expected):
    row = score(one_row(**answers), questionnaire).scores.loc[0]
    assert row[[*expected]].tolist() == approx([*expected.values()])


def test_an_answer_that_is_not_on_the_scale_is_named_with_it():
    for step, words in ((1.0, " in steps of 1;"), (None, ";")):
        with refused(f"comfort of .* is 6, not on .* from 1 to 5{words}"):
            score(one_row(**SMALL | {"comfort": 6}), replace(satisfaction_scale(5), step=step))


# Cronbach's alpha


@parametrize("name", ALPHAS)
def test_alpha_agrees_with_r(name):
    """Oracle: psych::alpha with Feldt's interval (reference/cronbach_alpha.R)."""
    expected = ALPHAS[name]
    result = cronbach_alpha(pd.DataFrame(expected["items"]))
    numbers = [expected["alpha"], expected["ci_low"], expected["ci_high"]]
    assert [result.alpha, result.ci_low, result.ci_high] == approx(numbers, rel=1e-9)
    without = expected["without"] or [np.nan] * len(result.without)
    assert result.without.tolist() == approx(without, rel=1e-9, abs=1e-12, nan_ok=True)


def test_items_without_an_alpha_are_refused():
    for b, message in ((2, "sums that differ"), (np.nan, "items: column 'b' has nothing in row 1")):
        with refused(message):
            cronbach_alpha(pd.DataFrame({"a": [1, 2, 3], "b": [3, b, 1]}))


TAKEN = [
    ({"questionnaire": replace(MOOD, subscales={name: ["a"]})}, f"'{name}' is another column of")
    for name in ("mood_mean", "mood_sum", "subject")
]
LOAD = {"questionnaire": replace(MOOD, task_load=True), "weights": one_row(a=5, b=5, c=5)}


@parametrize(
    ("change", "message"),
    [
        # An item was the subject, and a subscale took the place of the score.
        ({"subject": "a"}, "columns must be different for every argument"),
        *TAKEN,
        # An error of pandas came.
        ({"condition": "mood_sum"}, "'mood_sum' is another column of"),
        (LOAD, "weights are for six items of a task load index"),
    ],
)
def test_what_cannot_be_scored_is_refused(change, message):
    with refused(message):
        answers = one_row(a=5.0, b=5.0, c=5.0, mood_sum=1)
        score(**{"answers": answers, "questionnaire": MOOD} | change)


def test_reversed_items_are_looked_at_beside_a_subscale_of_that_name():
    with refused("reversed: 'd' is none of the items"):
        replace(MOOD, reversed=["d"], subscales={"reversed": ["a"]})
