"""
Bad input: every fault is refused, and the error names the subject, the condition, the column or the
row.
"""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings, strategies as st

import trustlab as tl
from tests.studies.scores import COLUMNS, drawn
from trustlab.studies.table import complete_scores, read_cells, read_factors


def table(n=5):
    frame = drawn(n, mode=["C1", "C2", "C3"])
    return frame.assign(person=[f"P{person + 1}" for person in frame["person"]])


def analysed(frame, **options):
    return tl.repeated_measures(frame, **COLUMNS | options)


def put(value, column="score"):
    """The table with a value in row 7, which is P3 in C2."""
    values = [*table()[column][:7], value, *table()[column][8:]]
    return table().assign(**{column: pd.Series(values, dtype=object)})


@pytest.mark.parametrize("value", [np.nan, None, pd.NA, pd.NaT])
def test_missing_scores_are_named(value):
    with pytest.raises(ValueError, match="subject 'P3' has no score in condition 'C2'"):
        analysed(put(value))


NO_NUMBERS = ["1.0", True, 1j, [1.0], pd.Timedelta("1s"), -np.inf, 10**5000]


@pytest.mark.parametrize("value", NO_NUMBERS, ids=lambda value: f"{type(value).__name__}")
@pytest.mark.parametrize("everywhere", [False, True])
def test_what_is_no_number_is_named(value, everywhere):
    """In one row, or in all, so that the column has the value's own type."""
    frame = table().assign(score=pd.Series([value] * 15)) if everywhere else put(value)
    with pytest.raises(
        ValueError, match=f"column 'score' holds .* in row {0 if everywhere else 7};"
    ):
        analysed(frame)


TABLES = {
    "duplicate cell": (
        pd.concat([table(), table().iloc[[4]].assign(score=np.nan)]),
        "more than one row for a cell, such as row 4; average the trials",
    ),
    "gaps": (
        table().drop(index=[3, 5]),
        "subject 'P2' has no score in condition 'C1', 'C3'.*listwise.*mixed_model",
    ),
    "no condition": (put(None, "mode"), "within: column 'mode' has no label in row 7"),
    "no subject": (put(np.nan, "person"), "subject: column 'person' has no label in row 7"),
    "mixed labels": (put(3, "mode"), "mixes types of labels"),
    "one condition": (table().iloc[::3], "'mode' has one condition only"),
    "two subjects": (table(n=2), "2 complete subjects with scores in 'score'; at least three"),
    "subjects constant": (
        table().assign(score=np.repeat(0.3 * np.arange(5), 3)),
        "^dv: the error variance is zero for mode ",
    ),
    "a column twice": (
        pd.concat([table(), table()[["mode"]]], axis=1),
        "2 columns are named 'mode'",
    ),
    "labels that are lists": (put([1], "mode"), r"within: \[1\] in row 7 of 'mode' is no label"),
    "no rows": (table().iloc[:0], "no rows"),
}


@pytest.mark.parametrize("name", TABLES)
def test_tables_that_are_refused(name):
    frame, message = TABLES[name]
    with pytest.raises(ValueError, match=message):
        analysed(frame)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"dv": "scores"}, r"dv: no column 'scores'; did you mean 'score'\? \(there are person, "),
        ({"within": np.array(["mode"])}, "within: no column array"),
        ({"subject": "mode"}, "columns must be different"),
        ({"order": [["C1"], "C2", "C3"]}, "order must list"),
    ],
)
def test_columns_and_orders_that_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        analysed(table(), **options)


def test_a_wide_table_is_told_how_to_become_long():
    wide = table().pivot_table(index="person", columns="mode", values="score")
    with pytest.raises(ValueError, match=r"no column 'score'; frame\.melt"):
        analysed(wide.reset_index())


@settings(max_examples=60, deadline=None, derandomize=True)
@given(st.integers(3, 8), st.integers(2, 5), st.data())
def test_whatever_is_missing_is_named_or_left_out(n, k, data):
    """
    Property: no analysis ever has a NaN in it, and excluded and kept subjects together are all
    subjects.
    """
    gone = np.array(data.draw(st.lists(st.booleans(), min_size=n * k, max_size=n * k)))
    frame = drawn(n, mode=range(k)).assign(score=np.where(gone, np.nan, 1.0))
    read = read_cells(*read_factors(frame, "score", "mode", "person")[:2], "score", "person")
    complete = ~gone.reshape(n, k).any(axis=1)
    if gone.any():
        with pytest.raises(ValueError, match=r"missing cells|complete subject"):
            complete_scores(read, "score")
    if complete.sum() < 3:
        with pytest.raises(ValueError, match="complete subject"):
            complete_scores(read, "score", "listwise")
        return
    kept, excluded = complete_scores(read, "score", "listwise")
    assert np.isfinite(kept).all(axis=None)
    assert kept.index.tolist() == np.flatnonzero(complete).tolist()
    assert sorted([*kept.index, *excluded]) == list(range(n))
