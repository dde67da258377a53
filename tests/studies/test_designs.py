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


@pytest.mark.parametrize("squares", [1, 3])
@pytest.mark.parametrize(("k", "size"), SIZES.items())
def test_whole_assignments_are_balanced_in_position_and_carry_over(k, size, squares):
    assert williams_square(k).shape == (size, k)
    names, n = [f"C{i}" for i in range(k)], squares * size
    design = latin_square_design(names, n, seed=k)
    places, follows = counted(design.table().to_numpy().tolist())
    assert set(places) == set(itertools.product(names, range(k)))
    assert set(places.values()) == {n // k}
    assert set(follows) == set(itertools.permutations(names, 2))
    assert set(follows.values()) == {n // k}
    balance = design_balance(design.orders())
    assert balance.balanced
    assert set(balance.table().melt()["value"].dropna()) == {n // k}
    for start in range(0, n, size):
        assert sorted(design.rows[start : start + size]) == list(range(1, size + 1))


@given(st.integers(2, 8), st.integers(0, 1000))
@settings(max_examples=30)
def test_same_seed_same_design_and_more_participants_change_no_order(k, seed):
    names = [f"C{i}" for i in range(k)]
    small = latin_square_design(names, SIZES[k], seed=seed)
    again = latin_square_design(names, SIZES[k], seed=seed)
    large = latin_square_design(names, 3 * SIZES[k], seed=seed)
    pd.testing.assert_frame_equal(small.orders(), again.orders())
    pd.testing.assert_frame_equal(small.table(), large.table().iloc[: SIZES[k]])


def test_an_order_without_a_label_is_refused():
    orders = latin_square_design(list("ABCD"), 4, seed=3).orders()
    with pytest.raises(ValueError, match="column 'condition' has no label in row 2"):
        design_balance(orders.assign(condition=orders["condition"].where(orders.index != 2)))
