"""
Bad input: every fault is refused, and the error names the subject, the condition, the column or the
row.
"""

from decimal import Decimal

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings, strategies as st

import trustlab as tl
from trustlab.studies.table import complete_scores, read_scores


def table(n=5, k=3):
    rng = np.random.default_rng(0)
    return pd.DataFrame(
        {
            "pid": np.repeat([f"P{i + 1}" for i in range(n)], k),
            "condition": ["C1", "C2", "C3"][:k] * n,
            "score": rng.standard_normal(n * k),
        }
    )


def analysed(frame, dv="score", within="condition", subject="pid", **options):
    return tl.repeated_measures(frame, dv=dv, within=within, subject=subject, **options)


def changed(row, column, value):
    frame = table()
    frame[column] = frame[column].astype(object)
    frame.loc[row, column] = value
    return frame


TABLES = {
    "duplicate cell": (
        pd.concat([table(), table().iloc[[4, 4]]]),
        r"1 cells? with more than one row: subject 'P2', condition 'C2'; average the trials",
    ),
    "duplicate cell, one without score": (
        pd.concat([table(), table().iloc[[4]].assign(score=np.nan)]),
        r"1 cells? with more than one row: subject 'P2', condition 'C2'",
    ),
    "missing row": (table().drop(index=7), "subject 'P3' has no score in condition 'C2'"),
    "NaN": (
        changed(7, "score", np.nan).astype({"score": float}),
        "subject 'P3' has no score in condition 'C2'",
    ),
    "None": (changed(7, "score", None), "subject 'P3' has no score in condition 'C2'"),
    "pandas.NA": (changed(7, "score", pd.NA), "subject 'P3' has no score in condition 'C2'"),
    "NaT": (changed(7, "score", pd.NaT), "subject 'P3' has no score in condition 'C2'"),
    "one condition only": (
        table().drop(index=[3, 5]),
        "subject 'P2' has no score in condition 'C1', 'C3'.*listwise.*mixed_model",
    ),
    "no score at all": (
        table().assign(score=lambda f: f["score"].where(f["pid"] != "P4")),
        "subject 'P4' has no score at all",
    ),
    "spaces in a label": (
        changed(7, "condition", "C2 "),
        "subject 'P1' has no score in condition 'C2 '.*'P3' has no score in condition 'C2'",
    ),
    "case of a label": (
        changed(7, "condition", "c2"),
        "subject 'P1' has no score in condition 'c2'.*'P3' has no score in condition 'C2'",
    ),
    "text": (
        changed(7, "score", "n/a"),
        r"'score' holds 'n/a' for subject 'P3', condition 'C2' \(row 7\)",
    ),
    "number as text": (
        table().assign(score=lambda f: f["score"].astype(str)),
        "'P1', condition 'C1'.*pandas.to_numeric",
    ),
    "a boolean": (changed(7, "score", True), "holds True for subject 'P3', condition 'C2'"),
    "booleans": (table().assign(score=True), "'score' holds True for"),
    "a complex number": (changed(7, "score", 1j), "holds 1j for subject 'P3'"),
    "complex numbers": (table().assign(score=1j), "holds 1j for"),
    "a list": (
        changed(7, "score", "x").assign(score=lambda f: f["score"].map(lambda v: [v])),
        "for subject 'P1'",
    ),
    "dates": (table().assign(score=pd.Timestamp("2020-01-01")), "holds Timestamp"),
    "durations": (table().assign(score=pd.Timedelta("1s")), "holds Timedelta"),
    "inf": (
        changed(7, "score", np.inf).astype({"score": float}),
        "holds inf for subject 'P3', condition 'C2'",
    ),
    "-inf as an object": (
        changed(7, "score", -np.inf),
        "holds -inf for subject 'P3', condition 'C2'",
    ),
    "no condition": (
        changed(7, "condition", None),
        "within: column 'condition' has no label in row 7",
    ),
    "no subject": (changed(7, "pid", np.nan), "subject: column 'pid' has no label in row 7"),
    "one condition": (
        table().query("condition == 'C2'"),
        "'condition' has one condition only, 'C2'",
    ),
    "two subjects": (
        table(n=2),
        r"2 complete subjects in column 'pid'; at least three",
    ),
    "one subject": (table(n=1), r"1 complete subject"),
    "constant": (
        table().assign(score=4.5),
        "'score' by 'condition': the error variance is zero for condition",
    ),
    "no error variance": (
        table().assign(score=np.tile([0.1, 0.4, 0.7], 5) + np.repeat(0.3 * np.arange(5), 3)),
        "'score' by 'condition': the error variance is zero for condition",
    ),
    "subjects constant": (
        table().assign(score=np.repeat([0.1, 0.2, 0.3, 0.4, 0.5], 3)),
        "all subjects differ by the same amounts",
    ),
    "no rows": (table().iloc[:0], "no rows"),
    "mixed labels": (changed(7, "condition", 3), "mixes types of labels"),
    "labels that are lists": (table().assign(condition=[["a"]] * 15), "which is no label"),
    "huge": (table().assign(score=lambda f: f["score"] * 1e200), "another unit"),
}


@pytest.mark.parametrize("name", TABLES)
def test_tables_that_are_refused(name):
    frame, message = TABLES[name]
    with pytest.raises(ValueError, match=message):
        analysed(frame)


@pytest.mark.parametrize(
    ("names", "message"),
    [
        (
            {"dv": "scores"},
            r"dv: no column 'scores'; did you mean 'score'\? \(there are pid, condition, score\)",
        ),
        ({"subject": "PID"}, "subject: no column 'PID'; did you mean 'pid'"),
        ({"within": np.array(["condition"])}, "within must be the name of one column"),
        ({"subject": "condition"}, "'condition' is named twice"),
    ],
)
def test_columns_that_are_refused(names, message):
    with pytest.raises(ValueError, match=message):
        analysed(table(), **names)


def test_a_wide_table_is_told_how_to_become_long():
    wide = table().pivot_table(index="pid", columns="condition", values="score")
    wide.columns.name = None
    right = analysed(table()).F
    for frame, remedy in (
        (wide, "frame.rename_axis('pid').reset_index().melt("),
        (wide.reset_index(), "frame.melt("),
        (wide.reset_index(drop=True), "frame.rename_axis('pid').reset_index().melt("),
    ):
        with pytest.raises(ValueError, match=r"no column 'score'.*becomes long by ") as caught:
            analysed(frame)
        code = str(caught.value).partition("becomes long by ")[2].rpartition(" (there are")[0]
        assert code.startswith(remedy)
        found = analysed(eval(code, {"frame": frame}))
        np.testing.assert_allclose(found.F, right, rtol=1e-12)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"missing": "drop"}, "missing must be one of 'raise', 'listwise', got 'drop'"),
        ({"alpha": "5 %"}, "alpha must be a number"),
        ({"order": [["C1"], "C2", "C3"]}, "order must list"),
    ],
)
def test_options_that_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        analysed(table(), **options)


def test_layout_of_scores():
    frame = table().sample(frac=1.0, random_state=1)
    read = read_scores(frame, "score", "condition", "pid")
    for row in frame.itertuples():
        assert (
            read.values[read.subjects.index(row.pid), read.conditions.index(row.condition)]
            == row.score
        )
    assert read.subjects == ("P1", "P2", "P3", "P4", "P5")


@settings(max_examples=60, deadline=None, derandomize=True)
@given(st.integers(3, 8), st.integers(2, 5), st.data())
def test_whatever_is_missing_is_named_or_left_out(n, k, data):
    """
    Property: no analysis ever has a NaN in it, and excluded and kept subjects together are all
    subjects.
    """
    rng = np.random.default_rng(n * 10 + k)
    gone = np.array(data.draw(st.lists(st.booleans(), min_size=n * k, max_size=n * k)))
    frame = pd.DataFrame(
        {
            "s": np.repeat(np.arange(n), k),
            "c": np.tile(np.arange(k), n),
            "y": np.where(gone, np.nan, rng.random(n * k)),
        }
    )
    read = read_scores(frame, "y", "c", "s")
    complete = ~gone.reshape(n, k).any(axis=1)
    if gone.any():
        with pytest.raises(ValueError, match=r"missing cells|complete subject"):
            complete_scores(read)
    if complete.sum() < 3:
        with pytest.raises(ValueError, match="complete subject"):
            complete_scores(read, "listwise")
        return
    kept, excluded = complete_scores(read, "listwise")
    assert np.isfinite(kept.values).all()
    assert kept.subjects == tuple(np.flatnonzero(complete))
    assert sorted(kept.subjects + excluded) == list(range(n))


@pytest.mark.parametrize(
    "value", [10**400, 10**5000, Decimal("sNaN")], ids=["10**400", "10**5000", "sNaN"]
)
def test_numbers_that_are_no_floats_are_refused_by_name(value):
    frame = table()
    frame["score"] = frame["score"].astype(object)
    frame.loc[frame.index[4], "score"] = value
    with pytest.raises(ValueError, match=r"dv: column 'score' holds .* for subject .*row"):
        analysed(frame)
