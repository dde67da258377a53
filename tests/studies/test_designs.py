"""
Orders of conditions: balance is counted by brute force, for every number of conditions from 2 to
12.
"""

import itertools

import pandas as pd
import pytest
from hypothesis import given, settings, strategies as st

from trustlab.studies.designs import (
    design_balance,
    latin_square_design,
    williams_square,
)

SIZES = {n: n if n % 2 == 0 else 2 * n for n in range(2, 13)}


def counted(rows):
    """Positions and successions, counted one by one."""
    places, follows = {}, {}
    for row in rows:
        for position, condition in enumerate(row):
            places[condition, position] = places.get((condition, position), 0) + 1
        for before, after in itertools.pairwise(row):
            follows[before, after] = follows.get((before, after), 0) + 1
    return places, follows


@pytest.mark.parametrize(("n", "size"), SIZES.items())
def test_a_square_is_balanced_in_position_and_carry_over(n, size):
    square = williams_square(n)
    assert square.shape == (size, n)
    places, follows = counted(square.tolist())
    assert set(places) == set(itertools.product(range(n), range(n)))
    assert set(places.values()) == {size // n}
    assert set(follows) == set(itertools.permutations(range(n), 2))
    assert set(follows.values()) == {size // n}


@given(st.integers(2, 12), st.integers(1, 4), st.integers(0, 2**63))
@settings(max_examples=60)
def test_whole_assignments_are_balanced(k, squares, seed):
    n = squares * SIZES[k]
    design = latin_square_design([f"C{i}" for i in range(k)], n, seed=seed)
    places, follows = counted(design.table().to_numpy().tolist())
    assert len(places) == k * k
    assert set(places.values()) == {n // k}
    assert len(follows) == k * (k - 1)
    assert set(follows.values()) == {n // k}
    balance = design.balance()
    assert balance.balanced
    assert (balance.table()["count"] == balance.table()["balanced_count"]).all()
    for start in range(0, n, SIZES[k]):
        assert sorted(design.rows[start : start + SIZES[k]]) == list(range(1, SIZES[k] + 1))


@given(st.integers(2, 8), st.integers(0, 1000))
@settings(max_examples=30)
def test_same_seed_same_design_and_more_participants_change_no_order(k, seed):
    names = [f"C{i}" for i in range(k)]
    small = latin_square_design(names, SIZES[k], seed=seed)
    again = latin_square_design(names, SIZES[k], seed=seed)
    large = latin_square_design(names, 3 * SIZES[k], seed=seed)
    pd.testing.assert_frame_equal(small.orders(), again.orders())
    pd.testing.assert_frame_equal(small.table(), large.table().iloc[: SIZES[k]])


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((["A", "B", "C", "D"], 30), "multiple of 4; 32 would do, or 28"),
        (("AB", 2), "conditions must be a list of labels, got 'AB'"),
        ((["A", float("nan")], 2), r"conditions\[1\] is nan"),
        ((["A", "B"], True), "participants must be a whole number, 1 or more, got True"),
        ((["A", "B"], 2, None), "seed must be a whole number, 0 or more, got None"),
    ],
)
def test_bad_designs_are_refused(arguments, words):
    with pytest.raises(ValueError, match=words):
        latin_square_design(*arguments)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda f: f.drop(columns="position"), "position: no column 'position'"),
        (
            lambda f: f.assign(condition=f["condition"].where(f.index != 2)),
            "column 'condition' has no label in row 2",
        ),
        (lambda f: f.to_numpy(), "orders must be of class DataFrame, got ndarray"),
    ],
)
def test_bad_orders_are_refused(change, words):
    with pytest.raises(ValueError, match=words):
        design_balance(change(latin_square_design(list("ABCD"), 4, seed=3).orders()))
