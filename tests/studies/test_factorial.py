"""
Several factors. Oracles: R (afex, car, emmeans) on published data sets, values in
reference/factorial.json made by factorial.R; analyses of one factor; SciPy.
"""

import re

import numpy as np
import pandas as pd
from numpy.testing import assert_allclose

import trustlab as tl
from tests.cases import refused
from tests.studies.scores import analysed_set, approx, drawn, parametrize, reference

SETS = reference("factorial")["sets"]
SAME = ["F", "df1", "df2", "p", "eta2_generalized", "eta2_partial", "ss_effect", "ss_error"]
SAME += ["mauchly_w", "mauchly_p", "epsilon_gg", "p_gg", "epsilon_hf_untruncated", "p_hf"]


KEYS = ["a", "b", "level"]


def label(text):
    """A level before R made a name of it: "X0.2" was 0.2, "Golden.Rain" had a blank."""
    return re.sub(r"^X(?=\d)", "", text).replace("Golden.Rain", "Golden Rain")


@parametrize(
    "name", [name for name in SETS if len(SETS[name]["within"] + SETS[name]["between"]) > 1]
)
def test_every_effect_agrees_with_r(name):
    """One factor: test_against_r.py."""
    table = analysed_set(SETS[name]).table().to_dict("records")
    rows = {frozenset(row["effect"].split(" × ")): row for row in table}
    assert len(rows) == len(SETS[name]["effects"])
    for theirs in SETS[name]["effects"]:
        ours = rows[frozenset(theirs["effect"].split(":"))]
        same = [number for number in SAME if theirs[number] is not None]
        if not theirs["epsilon_gg"]:  # one degree of freedom: car has no row, or zeros
            same = [number for number in same if number not in ("p_gg", "p_hf")]
        elif theirs["epsilon_hf_untruncated"] > 1.0:
            same.remove("p_hf")
        ours, theirs = ([row[number] for number in same] for row in (ours, theirs))
        assert ours == approx(theirs, rel=1e-8, abs=1e-11)


@parametrize("name", [name for name in SETS if SETS[name]["pairs"]])
def test_pairs_agree_with_emmeans(name):
    result = analysed_set(SETS[name])
    numbers = ["mean_difference", "ci_low", "ci_high", "t", "df", "p", "p_holm"]
    for theirs in SETS[name]["pairs"]:
        factor, at = theirs.pop("factor"), theirs.pop("at")
        ours = result.pairs(factor, at).fillna({"level": ""})
        ours = ours.astype(dict.fromkeys(KEYS, str)).set_index(KEYS)[numbers]
        rows = pd.DataFrame(theirs, range(len(ours)))
        names = rows.pop("contrast").str.replace(factor, "").str.split(" - ")
        keys = [
            (*map(label, (*pair, level)),) for pair, level in zip(names, rows["level"], strict=True)
        ]
        expected = rows[numbers]
        assert_allclose(ours.loc[keys], expected, rtol=1e-8, atol=1e-10)


def two_way(n=10, seed=0):
    return drawn(n, seed, A=["a0", "a1"], B=["b0", "b1", "b2"])


def run(frame, **more):
    columns = {"dv": "score", "within": ["A", "B"], "subject": "person"}
    return tl.repeated_measures(frame, **columns | more)


def test_batch_and_table_agree():
    frames = [two_way(seed=seed) for seed in range(3)]
    batch = tl.repeated_measures_batch(
        [frame["score"].to_numpy().reshape(10, 2, 3) for frame in frames]
    )
    for study, frame in enumerate(frames):
        own = run(frame).table().set_index("effect")[batch.columns]
        pd.testing.assert_frame_equal(own, batch.loc[study], check_dtype=False)


def test_what_a_reader_sees():
    frame = two_way()
    result = run(frame, between="group")
    words = "2 × 2 × 3 mixed ANOVA of score (N = 10, correction of degrees of freedom: Greenhouse–"
    assert words in result.apa()
    assert len(result.plot().get_legend().get_texts()) == 6
    assert result.descriptives()["n"].tolist() == [5] * 12
    levels = run(frame, order={"B": ["b2", "b0", "b1"]}).descriptives()["B"].tolist()
    assert levels[:3] == ["b2", "b0", "b1"]


@parametrize(
    ("columns", "arguments", "message"),
    [
        ({}, {"order": {"C": ["a0"]}}, "order: 'C' is not a factor"),
        (
            {"group": lambda f: np.where(f["person"], "novice", "expert")},
            {"between": "group"},
            "between: every group of column 'group', .* needs two complete participants",
        ),
        ({"age": 1}, {"covariates": "age"}, r"^covariates: effects of \['age'\] are not defined"),
        (
            {"age": lambda f: f.index},
            {"covariates": ["age"]},
            "^covariates: subject 0 has several labels in column 'age'",
        ),
    ],
)
def test_bad_tables_are_refused(columns, arguments, message):
    with refused(message):
        run(two_way().assign(**columns), **arguments)


def test_a_covariate_has_no_line_in_the_figure_and_adjusts_groups():
    """Oracle: least squares of the participants' means on group and covariate."""
    frame = two_way().assign(age=lambda f: 20.0 + (7 * f["person"]) % 11)
    alone = run(frame, covariates="age")
    assert alone.plot().get_legend().get_title().get_text() == "B"
    one = run(frame[frame["B"] == "b0"], within="A", covariates="age")
    assert one.apa().startswith("A one-way repeated-measures ANOVA of score with age as a cov")
    assert one.plot().get_legend() is None
    row = run(frame, between="group", covariates=["age"]).pairs("group").loc[0]
    people = frame.groupby("person").agg({"score": "mean", "age": "first", "group": "first"})
    x = np.column_stack([people["group"] == "expert", people["age"], np.ones(10)])
    slope = np.linalg.lstsq(x, people["score"])[0][0]
    assert row["mean_difference"] == approx(slope, rel=1e-9)
    assert row["df"] == 10 - 3


def test_groups_are_compared_within_groups():
    """Oracle: the unweighted means of the cells of two factors between subjects."""
    frame = two_way(n=12).assign(sex=lambda f: np.where(f["person"] % 2, "f", "m"))
    pairs = run(frame, between=["group", "sex"]).pairs("group", at="sex")
    means = frame.groupby(["group", "sex"])["score"].mean()
    expected = (means["expert"] - means["novice"]).loc[pairs["level"]]
    assert_allclose(pairs["mean_difference"], expected, rtol=1e-9)
