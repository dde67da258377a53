"""
Orders of conditions: balance is counted by brute force, for every number of conditions from 2 to
12.
"""

import itertools

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings, strategies as st

from trustlab.studies.designs import (
    design_balance,
    latin_square_design,
    participants_needed,
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


def test_the_squares_of_three_and_four_conditions():
    """Oracle: written out by hand from Williams (1949)."""
    assert williams_square(4).tolist() == [[0, 1, 3, 2], [1, 2, 0, 3], [2, 3, 1, 0], [3, 0, 2, 1]]
    assert williams_square(3).tolist() == [
        [0, 1, 2],
        [1, 2, 0],
        [2, 0, 1],
        [2, 1, 0],
        [0, 2, 1],
        [1, 0, 2],
    ]


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


def test_seeds_differ():
    plans = {
        latin_square_design(["A", "B", "C", "D"], 8, seed=s).orders().to_csv() for s in range(20)
    }
    first = {
        tuple(latin_square_design(["A", "B", "C", "D"], 8, seed=s).square.iloc[0])
        for s in range(60)
    }
    assert len(plans) > 15
    assert len(first) > 15


def test_tables_of_a_design():
    design = latin_square_design(
        ["C1", "C2", "C3", "C4", "C5"], [f"p{i:02d}" for i in range(20)], seed=7
    )
    orders = design.orders()
    assert list(orders.columns) == ["participant", "position", "condition"]
    assert len(orders) == 100
    assert orders["position"].tolist()[:5] == [1, 2, 3, 4, 5]
    assert design.square.shape == (10, 5)
    assert design.seed == 7
    assert design.table().index.tolist()[:2] == ["p00", "p01"]
    assert "seed 7" in design._repr_html_()
    assert "balanced" in design.balance()._repr_html_()
    numbers = latin_square_design([0.0, 0.2, 0.6, 0.8], 4)
    assert numbers.orders()["condition"].dtype.kind == "f"
    assert numbers.orders()["participant"].tolist()[:5] == [1, 1, 1, 1, 2]


def test_dropping_participants_ends_the_balance():
    """The dissertation's second study: 20 participants in five conditions, less numbers 4 and 5."""
    orders = latin_square_design(["C1", "C2", "C3", "C4", "C5"], 20, seed=1).orders()
    left = orders[~orders["participant"].isin([4, 5])]
    balance = design_balance(left)
    assert not balance.balanced
    assert balance.positions.to_numpy().sum() == 18 * 5
    assert int(balance.carry_over.sum().sum()) == 18 * 4


def test_order_up_or_down_is_not_balanced():
    rows = [(p, k + 1, c) for p in range(6) for k, c in enumerate("ABCD" if p % 2 else "DCBA")]
    balance = design_balance(
        pd.DataFrame(rows, columns=["who", "when", "what"]), "who", "when", "what"
    )
    assert not balance.balanced_positions
    assert not balance.balanced_carry_over
    assert balance.positions.loc["A"].tolist() == [3, 0, 0, 3]
    assert balance.carry_over.loc["A", "C"] == 0
    assert np.isnan(balance.carry_over.loc["A", "A"])


@pytest.mark.parametrize(
    ("k", "least", "needed"), [(4, 30, 32), (5, 18, 20), (5, 20, 20), (2, 1, 2), (3, 7, 12)]
)
def test_participants_needed(k, least, needed):
    assert participants_needed(k, least) == needed
    assert participants_needed(list(range(k)), least) == needed


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((["A", "B", "C", "D"], 30), "multiple of 4; 32 would do, or 28"),
        (
            (["A", "B", "C", "D", "E"], 5),
            "10; 10 would do; .*whole_squares=False\\) takes 5",
        ),
        ((["A"], 2), "conditions must have at least 2 labels, got 1"),
        ((["A", "B", "A"], 6), "'A' occurs twice"),
        (("AB", 2), "conditions must be a list of labels, got 'AB'"),
        ((5, 10), "conditions must be a list of labels, got 5"),
        ((["A", None], 2), r"conditions\[1\] is None"),
        ((["A", pd.NA], 2), r"conditions\[1\] is <NA>"),
        ((["A", float("nan")], 2), r"conditions\[1\] is nan"),
        ((["A", " "], 2), r"conditions\[1\] is ' '"),
        ((["A", ["B"]], 2), r"conditions\[1\] is \['B'\]"),
        ((["A", "B"], 0), "participants must be a whole number, 1 or more, got 0"),
        ((["A", "B"], 2.5), "participants must be a whole number, 1 or more, got 2.5"),
        ((["A", "B"], True), "participants must be a whole number, 1 or more, got True"),
        ((["A", "B"], "12"), "participants must be a list of labels"),
        ((["A", "B"], [1, 1]), "participants must differ from one another"),
        ((["A", "B"], 2, -1), "seed must be a whole number, 0 or more, got -1"),
        ((["A", "B"], 2, None), "seed must be a whole number, 0 or more, got None"),
    ],
)
def test_bad_designs_are_refused(arguments, words):
    with pytest.raises(ValueError, match=words):
        latin_square_design(*arguments)


def test_an_unfinished_square_only_when_asked_for():
    with pytest.warns(
        UserWarning, match="participants: 18 do not fill whole squares.*20 would do, or 10"
    ):
        design = latin_square_design(list("ABCDE"), 18, whole_squares=False)
    assert not design.balance().balanced
    assert len(design.participants) == 18
    with pytest.raises(ValueError, match="whole_squares must be True or False"):
        latin_square_design(["A", "B"], 2, whole_squares="no")


@pytest.mark.parametrize("n", [1, 0, -2, 2.5, "4", True, None])
def test_sizes_that_are_none(n):
    with pytest.raises(ValueError, match="n must be"):
        williams_square(n)
    with pytest.raises(ValueError, match="conditions must be"):
        participants_needed(n)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda f: f.drop(columns="position"), "position: no column 'position'"),
        (lambda f: f.rename(columns={"condition": "conditon"}), "did you mean 'conditon'"),
        (
            lambda f: f.iloc[1:],
            "participant 1 had .* at positions 1 to 4",
        ),
        (lambda f: pd.concat([f, f.iloc[:1]]), "participant 1 had"),
        (
            lambda f: f.assign(condition=f["condition"].where(f.index != 2)),
            "column 'condition' has no label in row 2",
        ),
        (lambda f: f.assign(condition="A"), "condition must have at least 2 labels, got 1"),
        (lambda f: f.assign(position=f["position"].astype(str)), "participant 1 had"),
        (lambda f: f.to_numpy(), "orders must be of class DataFrame, got ndarray"),
    ],
)
def test_bad_orders_are_refused(change, words):
    with pytest.raises(ValueError, match=words):
        design_balance(change(latin_square_design(list("ABCD"), 4, seed=3).orders()))


def test_a_condition_had_twice_is_refused():
    orders = latin_square_design(list("ABCD"), 8, seed=3).orders()
    orders.loc[0, "condition"] = orders.loc[1, "condition"]
    with pytest.raises(ValueError, match=r"participant 1 had .* is needed once"):
        design_balance(orders)
