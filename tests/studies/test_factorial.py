"""
Several factors. Oracles: R (afex, car, emmeans) on published data sets, values in
reference/factorial.json made by factorial.R; analyses of one factor; SciPy.
"""

import re

import numpy as np
import pandas as pd
import pytest

import trustlab as tl
from tests.cases import refused
from tests.studies.scores import analysed_set, drawn, reference
from trustlab.studies import repeated_measures_batch

SETS = reference("factorial")["sets"]
SAME = ["F", "df1", "df2", "p", "eta2_generalized", "eta2_partial", "ss_effect", "ss_error"]
SAME += ["mauchly_w", "mauchly_p", "epsilon_gg", "p_gg", "epsilon_hf_untruncated", "p_hf"]


def label(text):
    """A level before R made a name of it: "X0.2" was 0.2, "Golden.Rain" had a blank."""
    return re.sub(r"^X(?=\d)", "", text).replace("Golden.Rain", "Golden Rain")


@pytest.mark.parametrize(
    "name", [name for name in SETS if len(SETS[name]["within"] + SETS[name]["between"]) > 1]
)
def test_every_effect_agrees_with_r(name):
    """One factor: test_against_r.py."""
    table = analysed_set(SETS[name]).table().to_dict("records")
    rows = {frozenset(row["effect"].split(" × ")): row for row in table}
    assert len(rows) == len(SETS[name]["effects"])
    for theirs in SETS[name]["effects"]:
        ours = rows[frozenset(theirs["effect"].split(":"))]
        left_out = {number for number in SAME if theirs[number] is None}
        if not theirs["epsilon_gg"]:  # one degree of freedom: car has no row, or zeros
            left_out |= {"p_gg", "p_hf"}
        elif theirs["epsilon_hf_untruncated"] > 1.0:
            left_out |= {"p_hf"}
        for number in set(SAME) - left_out:
            expected = pytest.approx(theirs[number], rel=1e-8, abs=1e-11)
            assert ours[number] == expected, (theirs["effect"], number)


@pytest.mark.parametrize("name", [name for name in SETS if SETS[name]["pairs"]])
def test_pairs_agree_with_emmeans(name):
    result = analysed_set(SETS[name])
    numbers = ["mean_difference", "ci_low", "ci_high", "t", "df", "p", "p_holm"]
    for theirs in SETS[name]["pairs"]:
        ours = result.pairs(theirs["factor"], theirs["at"])
        given = {column: theirs[column] for column in ("contrast", "level", *numbers)}
        for row in pd.DataFrame(given, index=range(len(ours))).to_dict("records"):
            a, b = (label(x.removeprefix(theirs["factor"])) for x in row["contrast"].split(" - "))
            here = (ours["a"].astype(str) == a) & (ours["b"].astype(str) == b)
            if theirs["at"] is not None:
                here &= ours["level"].astype(str) == label(row["level"])
            found = ours[here].iloc[0][numbers].astype(float)
            expected = [row[number] for number in numbers]
            np.testing.assert_allclose(found, expected, rtol=1e-8, atol=1e-10)


def two_way(n=10, seed=0):
    return drawn(n, seed, A=["a0", "a1"], B=["b0", "b1", "b2"])


def run(frame, **more):
    columns = {"dv": "score", "within": ["A", "B"], "subject": "person"}
    return tl.repeated_measures(frame, **columns | more)


def test_batch_and_table_agree():
    frames = [two_way(seed=seed) for seed in range(3)]
    array = np.stack([frame["score"].to_numpy().reshape(10, 2, 3) for frame in frames])
    batch = repeated_measures_batch(array)
    for s, frame in enumerate(frames):
        own = run(frame).table()
        theirs = batch.loc[s].loc[own["effect"]]
        for number in ("F", "p", "p_gg", "p_hf", "eta2_generalized"):
            np.testing.assert_allclose(own[number], theirs[number], rtol=1e-10)


def test_what_a_reader_sees():
    frame = two_way()
    result = run(frame, between="group")
    words = (
        "2 × 2 × 3 mixed ANOVA of score (N = 10, correction of degrees of freedom: "
        "Greenhouse–Geisser)"
    )
    assert words in result.apa()
    assert len(result.plot().get_legend().get_texts()) == 6
    assert result.descriptives()["n"].tolist() == [5] * 12
    levels = run(frame, order={"B": ["b2", "b0", "b1"]}).descriptives()["B"].tolist()
    assert levels[:3] == ["b2", "b0", "b1"]


@pytest.mark.parametrize(
    ("change", "arguments", "message"),
    [
        (lambda f: f.drop(index=7), {}, r"subject 1 has no score in condition \('a0', 'b1'\)"),
        (lambda f: f, {"order": {"C": ["a0"]}}, "order: 'C' is not a factor"),
        (
            lambda f: f.assign(same=f["group"]),
            {"between": ["group", "same"]},
            r"effects of \['group', 'same'\] are not defined",
        ),
        (
            lambda f: f[f["person"].isin([0, 1, 2, 9])],
            {"between": "group"},
            "between: every group of column 'group', .* needs two complete participants",
        ),
        (lambda f: f.assign(age=1), {"covariates": "age"}, r"^covariates: effects of \['age'\]"),
        (
            lambda f: f.assign(age=f.index),
            {"covariates": ["age"]},
            "^covariates: subject 0 has several labels in column 'age'",
        ),
    ],
)
def test_bad_tables_are_refused(change, arguments, message):
    with refused(message):
        run(change(two_way()), **arguments)


def test_a_covariate_has_no_line_in_the_figure_and_adjusts_groups():
    """Oracle: least squares of the participants' means on group and covariate."""
    frame = two_way().assign(age=lambda f: 20.0 + (7 * f["person"]) % 11)
    alone = run(frame, covariates="age")
    assert alone.plot().get_legend().get_title().get_text() == "B"
    one = run(frame[frame["B"] == "b0"], within="A", covariates="age")
    assert one.plot().get_legend() is None
    assert one.apa().startswith("A one-way repeated-measures ANOVA of score with age as a cov")
    with refused(r"without groups or covariates; .* \['A', 'age'\]"):
        one.friedman()
    row = run(frame, between="group", covariates=["age"]).pairs("group").loc[0]
    people = frame.groupby("person").agg({"score": "mean", "age": "first", "group": "first"})
    x = np.column_stack([people["group"] == "expert", people["age"], np.ones(10)])
    slope = np.linalg.lstsq(x, people["score"])[0][0]
    assert row["mean_difference"] == pytest.approx(slope, rel=1e-9)
    assert row["df"] == 10 - 3


def test_groups_are_compared_within_groups():
    """Oracle: the unweighted means of the cells of two factors between subjects."""
    frame = two_way(n=12).assign(sex=lambda f: np.where(f["person"] % 2, "f", "m"))
    pairs = run(frame, between=["group", "sex"]).pairs("group", at="sex")
    means = frame.groupby(["group", "sex"])["score"].mean()
    expected = (means["expert"] - means["novice"]).loc[pairs["level"]]
    np.testing.assert_allclose(pairs["mean_difference"], expected, rtol=1e-9)
