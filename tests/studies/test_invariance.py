"""
What no analysis of scores depends on: the order of rows, the names of people and levels, the unit
and the origin of scores. Negative control: one score that is changed.
"""

from functools import partial

import pandas as pd
from hypothesis import given, settings, strategies as st
from pandas.testing import assert_frame_equal

import trustlab as tl
from tests.studies.scores import COLUMNS, drawn, parametrize

# In units of the score, or of its origin: changed by the unit.
RAW = ["mean", "sd", "se", "median", "minimum", "maximum", "ci_low", "ci_high", "low", "high"]
RAW += ["ci_low_within", "ci_high_within", "mean_difference", "median_difference", "ms", "ss"]
RAW += ["ss_effect", "ss_error", "ss_subjects", "subject_variance", "residual_variance"]
RAW += ["sd_difference"]
one = partial(tl.repeated_measures, **COLUMNS)
two = partial(one, within=["mode", "task"])
groups = partial(two, between="group")
mixed = partial(tl.mixed_model, **COLUMNS)
mixed_groups = partial(mixed, within=["mode", "task"], between="group")
ANALYSES = {
    "one factor": lambda f: one(f).table(),
    "its pairs": lambda f: one(f).pairs(),
    "its pairs by ranks": lambda f: one(f).pairs(method="wilcoxon"),
    "its assumptions": lambda f: one(f).assumptions(),
    "two factors": lambda f: two(f).table(),
    "their pairs": lambda f: two(f).pairs("mode", at="task"),
    "groups": lambda f: groups(f).table(),
    "pairs of groups": lambda f: groups(f).pairs("group", at="mode"),
    "paired t-test": lambda f: tl.paired_t_test(f[f["mode"].astype(str) < "c"], **COLUMNS).table(),
    "equivalence": lambda f: tl.equivalence(f, **COLUMNS, bound=0.5 * f["score"].std()),
    "Bayes factors": lambda f: tl.bayes_factor(f, **COLUMNS),
    "mixed model": lambda f: mixed(f).table(),
    "mixed model of groups": lambda f: mixed_groups(f).table(),
    "pairs of its groups": lambda f: mixed_groups(f).pairs("group", at="mode"),
    "covariates": lambda f: two(f, covariates=["person_number"]).table(),
    "winsorizing": lambda f: tl.winsorize(f, **COLUMNS, outside="iqr", k=0.5, to="next").limits,
    "formula model": lambda f: tl.formula_model("score ~ mode", f, groups="person").table(),
    "ordinal model": lambda f: of_thirds(f).table(),
    "its odds ratios": lambda f: of_thirds(f).pairs(),
    "order effects": lambda f: in_order(f).table(),
}


def of_thirds(frame):
    """Of ratings: the third of all scores in which each lies."""
    ratings = pd.qcut(frame["score"], 3, labels=False)
    return tl.ordinal_model(frame.assign(score=ratings), **COLUMNS)


def in_order(frame):
    """Effects of orders, where each person was in the modes in one of the orders of a square."""
    mode = frame["mode"].str[0].map({"a": 0, "b": 1, "c": 2})
    person = frame["person"].astype(str).str.removeprefix("P").astype(int)
    frame = frame.assign(position=(mode * (1 + person % 2) + person // 2) % 3 + 1)
    return tl.order_effects(frame, "score", "mode", "position", subject="person")


def table(seed, several):
    """Scores of nine people in two groups, in three modes and two tasks, or one."""
    frame = drawn(9, seed, mode="abc", task=[1, 2] if several else [1])
    return frame.assign(person_number=frame["person"] ** 2)


def numbers(name, frame):
    result = ANALYSES[name](frame).select_dtypes("number")
    return result.drop(columns=[*RAW, "a", "b", "level"], errors="ignore")


def changed(frame, seed, unit, origin):
    """The same scores in other rows, of other people's names, in another unit."""
    names = {"mode": frame["mode"] + " mode", "person": "P" + frame["person"].astype(str)}
    frame = frame.assign(**names, score=unit * (origin + frame["score"]))
    return frame.sample(frac=1.0, random_state=seed)


def several(name):
    return any(word in name for word in ("two", "their", "groups", "covariates"))


@parametrize("name", ANALYSES)
@settings(max_examples=5)
@given(
    seed=st.integers(0, 10_000),
    unit=st.sampled_from([1e-3, 0.7, 1e3]),
    origin=st.sampled_from([-50.0, 0.0, 200.0]),
)
def test_rows_names_and_units_do_not_matter(name, seed, unit, origin):
    frame = table(seed, several(name))
    other = changed(frame, seed, unit, origin)
    assert_frame_equal(
        numbers(name, other), numbers(name, frame), rtol=1e-6, atol=1e-9, check_dtype=False
    )


@parametrize("labels", ["category", "str", "object"])
@parametrize("name", ANALYSES)
def test_types_of_columns_and_names_of_rows_do_not_matter(name, labels):
    frame = table(2, several(name))
    types = {"mode": labels, "person": "Int64" if labels == "object" else "category"}
    other = frame.astype(types | {"score": "Float64", "group": labels})
    if "ordinal" in name or "odds" in name or "formula" in name:
        other = other.astype({"score": float})  # a rating, or a name in a formula
    other = other.set_index(["person", "mode"], drop=False)
    assert_frame_equal(numbers(name, other), numbers(name, frame), check_dtype=False)


def test_labels_may_be_true_and_false():
    frame = table(3, several=False).query("mode < 'c'")
    truths = one(frame.assign(mode=frame["mode"] == "b"))
    for view in ("descriptives", "pairs", "normality"):
        own, other = (getattr(result, view)().iloc[:, 2:] for result in (truths, one(frame)))
        assert_frame_equal(own, other)


@parametrize("name", ANALYSES)
def test_one_score_matters(name):
    frame = table(1, several(name))
    other = frame.assign(score=frame["score"].mask(frame.index == 0, 9.0))
    assert not numbers(name, other).equals(numbers(name, frame))
