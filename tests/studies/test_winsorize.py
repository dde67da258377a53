"""Winsorizing: values by hand, and a list of every change."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings, strategies as st

from tests.cases import refused
from trustlab.studies.winsorize import winsorize

PLAIN = np.array([1.0, 2, 3, 4, 5, 6, 7, 8, 9, 100])
SD = tuple(PLAIN.mean() + np.array([-2, 2]) * PLAIN.std(ddof=1))


def of_values(x, **rule):
    """Winsorize one condition's scores, beside another that is left alone."""
    x = np.asarray(x)
    cells = {"pid": np.arange(x.size), "error": x}
    other = pd.DataFrame(cells).assign(scheme="B", error=np.arange(x.size))
    frame = pd.concat([pd.DataFrame(cells).assign(scheme="A"), other]).assign(synthetic=True)
    both = winsorize(frame, "error", "scheme", "pid", **rule)
    parts = {name: getattr(both, name).query("condition == 'A'") for name in ("changes", "limits")}
    return replace(both, **parts)


@pytest.mark.parametrize(
    ("rule", "limits", "changed"),
    [
        # Quartiles 3.25 and 7.75 by linear interpolation, R's type 7.
        ({"outside": "iqr", "k": 1.5, "to": "limit"}, (-3.5, 14.5), {9: 14.5}),
        ({"outside": "mad", "k": 3, "to": "limit"}, (-5.61951664, 16.61951664), {9: 16.61951664}),
        ({"outside": "sd", "k": 2, "to": "limit"}, SD, {9: SD[1]}),
        ({"outside": "sd", "k": 2, "to": "next"}, SD, {9: 9.0}),
    ],
)
def test_rules_by_hand(rule, limits, changed):
    found = of_values(PLAIN, **rule)
    expected = [*limits, len(changed)]
    assert found.limits.loc[0, ["low", "high", "changed"]].tolist() == pytest.approx(expected)
    assert dict(found.changes[["subject", "new"]].to_numpy()) == pytest.approx(changed)
    assert "1 of 10 values was winsorized (A, subject" in found.apa()
    assert found.apa().startswith("[synthetic data] 1 of")
    none = of_values([1, 2, 3], outside="iqr", k=1.5, to="next")
    assert "None of 3 values" in none.apa()


@given(
    st.lists(st.integers(-(10**6), 10**6), min_size=5, max_size=40, unique=True),
    st.sampled_from(["sd", "mad", "iqr"]),
    st.sampled_from(["limit", "next"]),
)
@settings(max_examples=150)
def test_order_is_kept_inner_values_are_not_touched(values, outside, to):
    x = np.array(values, dtype=float)
    found = of_values(x, outside=outside, k=1.5, to=to)
    low, high = found.limits.loc[0, ["low", "high"]]
    new = found.data.loc[found.data["scheme"] == "A", "error"].to_numpy()
    assert (np.diff(new[np.argsort(x)]) >= 0).all()
    inside = (x >= low) & (x <= high)
    assert (new[inside] == x[inside]).all()
    assert ((new >= low) & (new <= high)).all()
    changed = np.column_stack([np.flatnonzero(~inside), x[~inside], new[~inside]])
    np.testing.assert_array_equal(found.changes[["subject", "old", "new"]], changed)


def test_two_rows_of_a_cell_and_two_roles_of_a_column_are_refused():
    """They counted twice, and moved the limits."""
    frame = pd.DataFrame({"pid": [1, 2, 3, 3], "scheme": "A", "error": [1.0, 2.0, 3.0, 3.0]})
    for dv, message in (
        ("error", "more than one row for a cell, such as row 3; average"),
        ("pid", "columns must be different for every argument"),
    ):
        with refused(message):
            winsorize(frame, dv, "scheme", "pid", outside="sd", k=2.0, to="limit")
