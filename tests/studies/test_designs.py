"""
Orders of conditions: balanced designs, and what an order does to scores.

Oracles: balance counted by brute force, from 2 to 12 conditions; R's lm on full and reduced models
(reference/order_effects.R), SciPy, simulation.
"""

import itertools
import warnings
from collections import Counter

import numpy as np
import pandas as pd
from hypothesis import given, settings, strategies as st
from numpy.testing import assert_allclose
from pandas.testing import assert_frame_equal

import trustlab as tl
from tests.cases import refused
from tests.studies.scores import approx, parametrize, reference
from trustlab.studies.designs import design_balance, latin_square_design, williams_square

# --- designs --------------------------------------------------------------------------------------


SIZES = {n: n if n % 2 == 0 else 2 * n for n in range(2, 13)}


def counted(rows):
    """Positions and successions, counted one by one."""
    places = Counter((condition, i) for row in rows for i, condition in enumerate(row))
    return places, Counter(pair for row in rows for pair in itertools.pairwise(row))


@parametrize("squares", [1, 3])
@parametrize(("k", "size"), SIZES.items())
def test_whole_assignments_are_balanced_in_position_and_carry_over(k, size, squares):
    assert williams_square(k).shape == (size, k)
    names, n = [f"C{i}" for i in range(k)], squares * size
    design = latin_square_design(names, n, seed=k)
    places, follows = counted(design.table().to_numpy().tolist())
    assert places == dict.fromkeys(itertools.product(names, range(k)), n // k)
    assert follows == dict.fromkeys(itertools.permutations(names, 2), n // k)
    balance = design_balance(design.orders())
    assert balance.balanced
    assert set(balance.table().melt()["value"].dropna()) == {n // k}
    for start in range(0, n, size):
        assert not design.table().iloc[start : start + size].duplicated().any()


@given(st.integers(2, 8), st.integers(0, 1000))
@settings(max_examples=30)
def test_more_participants_change_no_order(k, seed):
    names = range(k)
    small, large = (latin_square_design(names, m * SIZES[k], seed=seed).table() for m in (1, 3))
    assert_frame_equal(small, large.iloc[: SIZES[k]])


def test_conditions_and_people_may_be_pairs_and_an_index_has_no_part_in_the_balance():
    conditions, people = [("M", 0.1), ("M", 0.2)], [("site", 0), ("site", 1)]
    orders = latin_square_design(conditions, people, seed=3).orders()
    assert {*orders["condition"]} == {*conditions}
    assert orders["participant"].tolist() == [people[0]] * 2 + [people[1]] * 2
    named = latin_square_design(["A", "B"], people).orders()
    assert design_balance(named.set_index("participant", drop=False)).balanced


# --- effects of order -----------------------------------------------------------------------------


SETS = reference("order_effects")["sets"]


def run(frame):
    return tl.order_effects(frame, "score", "condition", "position", subject="subject")


def effects_of(frame):
    return run(frame).table().set_index("effect")


def frame_of(name):
    return pd.DataFrame(SETS[name]["data"]).astype({"position": int, "condition": int})


def williams():
    frame = tl.latin_square_design([*"ABCD"], 8, seed=0).orders()
    rng = np.random.default_rng(0)
    score = rng.standard_normal(32) + rng.standard_normal(8).repeat(4)
    return frame.rename(columns={"participant": "subject"}).assign(score=score)


@parametrize("name", SETS)
def test_agrees_with_r(name):
    found = effects_of(frame_of(name))
    for effect in ("position", "condition", "carry_over", "condition_without_carry_over"):
        wanted = SETS[name][effect]
        if wanted["F"] is not None:
            ours = found.loc[effect, [*wanted]].astype(float)
            assert_allclose(ours, [*wanted.values()], rtol=1e-9)
    pairs = run(frame_of(name)).pairs()
    pairs["se"] = pairs["mean_difference"] / pairs["t"]
    found = pairs[["a", "b", "mean_difference", "se"]]
    assert_allclose(found.astype(float), SETS[name]["pairs"], rtol=1e-8)


def test_two_periods_do_not_separate_carry_over_and_say_so():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = effects_of(frame_of("two conditions"))
    assert "not estimable" in found.loc["carry_over", "note"]
    assert np.isnan(found.loc["carry_over", "F"])
    assert np.isfinite(found.loc["condition_without_carry_over", "F"])


def test_adjusted_differences_do_not_see_carry_over_and_raw_means_do():
    """
    A carry-over of 3 from D: the conditions after D are raised; unbalanced, as one order is left
    out.
    """
    frame = williams()
    before = frame.sort_values(["subject", "position"]).groupby("subject")["condition"].shift()
    clean = run(frame).pairs()
    carried = run(frame.assign(score=frame["score"] + 3.0 * (before == "D"))).pairs()
    assert_allclose(carried["mean_difference"], clean["mean_difference"], atol=1e-9)
    assert_allclose(carried["p"], clean["p"], rtol=1e-6)


def test_columns_named_twice_or_without_a_label_are_refused():
    frame = williams()
    with refused("columns must be different"):
        tl.order_effects(frame, "score", "position", "position")
    with refused("^condition: column 'condition' has nothing"):
        run(frame.assign(condition=frame["condition"].where(frame.index != 2)))


def test_sequences_are_compared_by_the_means_of_subjects():
    """Oracle: the squares by hand, of four scores each."""
    frame = williams()
    people = frame.sort_values("position").groupby("subject")
    people = people.agg({"condition": "sum", "score": "mean"})
    means = people.groupby("condition")["score"].transform("mean")
    row = effects_of(frame).loc["sequence"]
    assert row["ss"] == approx(4 * ((means - means.mean()) ** 2).sum())
    assert (row["df1"], row["df2"], row["note"]) == (3, 4, "")


def test_ranks_of_each_person_leave_nothing_to_compare_sequences_by():
    """Everybody's ranks have one total; without their means the totals differ by rounding alone."""
    frame = williams()
    scores = frame.groupby("subject")["score"]
    for score in (0.1 * scores.rank(), frame["score"] - scores.transform("mean")):
        row = effects_of(frame.assign(score=score)).loc["sequence"]
        assert row["note"] == "not testable: subjects' means do not differ within sequences"
        assert np.isnan(row[["F", "p"]].astype(float)).all()


def test_orders_that_leave_no_degree_of_freedom_are_refused_whatever_rounding_leaves():
    rng = np.random.default_rng(0)
    frame = pd.DataFrame({"subject": [*"111222333"], "position": [1, 2, 3] * 3})
    for _ in range(60):
        with refused("9 scores leave no error variance beside all"):
            run(frame.assign(condition=[*"abcbaccab"], score=rng.normal(50.0, 20.0, 9)))
