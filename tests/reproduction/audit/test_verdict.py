"""
How verdicts are made: ranges against closed forms and brute force, rounding of printed text, and
the bounds used.
"""

from contextlib import suppress

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from numpy.random import default_rng
from scipy import stats

import trustlab as tl
from trustlab.reproduction.audit.catalogue import PrintedNumber, printed_numbers
from trustlab.reproduction.audit.check import Follows, Formula, NotPrintedError
from trustlab.reproduction.audit.consistency import sample_checks
from trustlab.reproduction.audit.relations import RELATIONS, chi2_of_epsilon, relations
from trustlab.studies.anova import mauchly_p_value

approx = pytest.approx


def follows(compute, texts, **more):
    """A check of x, and the printed numbers."""
    numbers = {id: PrintedNumber(id, "Table", id, str(text)) for id, text in texts.items()}
    return Follows("x", "", compute, ids={id: id for id in texts if id != "x"}, **more), numbers


positive = st.decimals("0.1", "9.99", places=2)


@settings(max_examples=60)
@given(positive, positive, positive)
def test_a_range_holds_every_point_of_the_box(a, b, c):
    def compute(v):
        return (v.a * v.b + v.c) / (v.b + v.c)

    check, numbers = follows(compute, {"a": a, "b": b, "c": c, "x": 1})
    value, low, high = check.range(check, numbers)
    draws = default_rng(0).uniform(-0.005, 0.005, (3, 500))
    draws[:, 0] = 0.0
    values = {id: numbers[id].value + draw for id, draw in zip("abc", draws, strict=True)}
    found = check.at(check, numbers, values)[0]
    assert value == approx(found[0])
    assert found.min() >= low - 1e-12
    assert found.max() <= high + 1e-12


def test_a_formula_that_turns_inside_its_box_reaches_its_least():
    """|a − b| is 0 within the rounding of a and b, and neither in the middle nor at a corner."""
    check, numbers = follows(lambda v: abs(v.a - v.b), {"a": "2.01", "b": "2.0", "x": "0.00"})
    assert check.row(numbers).verdict == "within rounding"


def verdict(printed, **more):
    check, numbers = follows(lambda v: v.a * v.b, {"a": "2.0", "b": "3.0", "x": printed}, **more)
    return check.row(numbers)


def test_verdicts_at_their_edges():
    # a b lies in [1.95 × 2.95, 2.05 × 3.05] = [5.7525, 6.2525].
    edges = {"6.0": "reproduced", "6.2": "within rounding"}
    edges |= {"6.3": "within rounding", "6.4": "differs", "5.70": "differs"}  # 6.2525 is 6.3
    for text, expected in edges.items():
        assert verdict(text).verdict == expected
    row = verdict("6.2")
    assert (row.low, row.recomputed, row.high) == approx((5.7525, 6.0, 6.2525))
    assert "It should be 6.0." in verdict("6.9").reason


def test_conventions_are_tried_and_explanations_only_explain():
    total = Formula("a + b", lambda v: v.a + v.b, "the sum", {"a": "a", "b": "b"})
    assert verdict("5.0", convention=total).verdict == "reproduced"
    row = verdict("5.0", explanations=(total,))
    assert row.verdict == "differs"
    assert "Probably the sum" in row.reason
    # An explanation that does not give the printed number is not named.
    assert "Probably" not in verdict("7.0", explanations=(total,)).reason
    assert verdict("5.0", binding="it need not.").verdict == "not checkable"


def test_items_that_fit():
    numbers = printed_numbers()
    rows = {row.id: row for row in sample_checks(numbers)}
    for items, id, people, half, fewest in (
        ("uav.trust/items", "uav.trust/mean.C{}", 36, 0.0005, 10),
        ("uav.satisfaction/items", "uav.satisfaction/mean.C{}", 36, 0.0005, 10),
        ("table_2.4/trust/items", "table_2.4/C{}/trust_mean", 5, 0.005, 8),
    ):
        found = [numbers.get(id.format(i)) for i in range(1, 6)]
        means = np.array([float(number.printed) for number in found if number])
        n = np.full(means.size, people)
        n[0] += 5 * (people == 5)  # the five drove under C1 twice
        apart = ([abs((means * n * k).round() / (n * k) - means).max()] for k in range(1, 41))
        assert rows[items].recomputed == 1 + np.argmax(np.array([*apart]) <= half) == fewest
    assert "none of raw, steps of 5" in rows["table_2.4/tlx/scoring"].reason


def test_extreme_chi2_of_epsilon_by_brute_force():
    # Random eigenvalues of 4 contrasts: no χ² below the least at its ε, which the first reach.
    values = np.vstack([[0.475, *[0.175] * 3], default_rng(2).dirichlet(np.full(4, 2.0), 20000)])
    epsilon = 1.0 / (4.0 * (values**2).sum(axis=1))
    rho = 1.0 - (2 * 4 * 4 + 4 + 2) / (6.0 * 4 * 35)
    chi2 = -35 * rho * np.log(values.prod(axis=1) * 4.0**4)
    low, high = (chi2_of_epsilon(epsilon, np.array(36.0), 5, end) for end in (False, True))
    assert (chi2 >= low - 1e-9).all()
    assert (chi2 <= high + 1e-9).all()
    assert low[0] == approx(chi2[0])


def test_second_order_p_is_what_was_printed():
    # Printed p of six studies; the first-order p rounds to another third decimal in two of them.
    numbers = printed_numbers()
    missed = 0
    for study in tl.published_studies().values():
        if "p" in study.mauchly:
            printed, k = numbers[f"{study.name}/mauchly.p"], study.k
            chi2 = float(study.mauchly["chi2"])
            p = mauchly_p_value(chi2, study.n, k), stats.chi2.sf(chi2, k * (k - 1) / 2 - 1)
            second, first = (round(float(each), printed.decimals) for each in p)
            assert second == printed.value
            missed += first != printed.value
    assert missed == 2


def test_every_listed_relation_is_about_a_printed_number():
    """Each line of the list gives a row at least; ranks are printed of some schemes only."""
    numbers, rows, used = printed_numbers(), [], set()
    for check in relations(numbers):
        with suppress(NotPrintedError):
            rows.append(check.row(numbers).id)
            used.add(check.compute)
    assert len(rows) == len(set(rows))
    unused = {relation.of for relation in RELATIONS if relation.compute not in used}
    assert all(of.startswith("section_3_8_3/") for of in unused)
