"""Winsorizing: values by hand, and a list of every change."""

from dataclasses import replace

import numpy as np
from hypothesis import given, settings, strategies as st

from tests.cases import refused
from tests.studies.scores import COLUMNS, approx, drawn, long, parametrize
from trustlab.studies.winsorize import winsorize

PLAIN = np.array([1.0, 2, 3, 4, 5, 6, 7, 8, 9, 100])
SD = tuple(PLAIN.mean() + np.array([-2, 2]) * PLAIN.std(ddof=1))


def of_values(x, **rule):
    """Winsorize one condition's scores, beside another that is left alone."""
    frame = long(np.column_stack([x, np.arange(len(x))])).assign(synthetic=True)
    both = winsorize(frame, **COLUMNS, **rule)
    parts = {name: getattr(both, name).query("condition == 'a'") for name in ("changes", "limits")}
    return replace(both, **parts)


@parametrize(
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
    assert found.limits.loc[0, ["low", "high", "changed"]].tolist() == approx(expected)
    assert dict(found.changes[["subject", "new"]].to_numpy()) == approx(changed)
    assert found.apa().startswith(
        "[synthetic data] Values winsorized: 1 of 10 (a, subject 9). Rule"
    )
    assert "0 of 3. Rule" in of_values([1, 2, 3], **rule).apa()


@given(
    st.lists(st.integers(-(10**6), 10**6), min_size=5, max_size=40, unique=True),
    st.sampled_from(["sd", "mad", "iqr"]),
    st.sampled_from(["limit", "next"]),
)
@settings(max_examples=50)
def test_order_is_kept_inner_values_are_not_touched(values, outside, to):
    x = np.array(values, dtype=float)
    found = of_values(x, outside=outside, k=1.5, to=to)
    low, high = found.limits.loc[0, ["low", "high"]]
    new = found.data["score"].to_numpy()[::2]
    assert (np.diff(new[np.argsort(x)]) >= 0).all()
    assert ((new >= low) & (new <= high)).all()
    outside = new != x
    assert outside.tolist() == ((x < low) | (x > high)).tolist()
    changed = np.column_stack([np.flatnonzero(outside), x[outside], new[outside]])
    np.testing.assert_array_equal(found.changes[["subject", "old", "new"]], changed)


def test_conditions_may_be_pairs():
    """An error of pandas came."""
    frame = drawn()
    pairs = frame.assign(mode=[(mode, 1) for mode in frame["mode"]])
    rule = {"outside": "sd", "k": 1.0, "to": "next"}
    found, same = (winsorize(each, **COLUMNS, **rule) for each in (pairs, frame))
    assert found.data["score"].equals(same.data["score"])
    assert found.changes["condition"].tolist() == [(mode, 1) for mode in same.changes["condition"]]


def test_two_rows_of_a_cell_and_two_roles_of_a_column_are_refused():
    """They counted twice, and moved the limits; later they were said to be in `frame`."""
    frame = drawn().assign(mode="a")
    for dv, message in (("score", "^dv: there is more than one row"), ("person", "must be diff")):
        with refused(message):
            winsorize(frame, **COLUMNS | {"dv": dv}, outside="sd", k=2.0, to="limit")
