"""
How verdicts are made: ranges against closed forms and brute force, rounding of printed text, and
the bounds used.
"""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from numpy.random import default_rng
from scipy import stats

from trustlab.reproduction.audit.catalogue import PrintedNumber, printed_numbers
from trustlab.reproduction.audit.check import Follows, Formula, NotPrintedError
from trustlab.reproduction.audit.consistency import sample_checks
from trustlab.reproduction.audit.relations import RELATIONS, chi2_of_epsilon, relations
from trustlab.studies.anova import mauchly_p_value

approx = pytest.approx


def numbers_of(**texts):
    return {id: PrintedNumber(id, "Table", id, str(text)) for id, text in texts.items()}


positive = st.decimals("0.1", "9.99", places=2)


@settings(max_examples=60)
@given(positive, positive, positive)
def test_a_range_holds_every_point_of_the_box(a, b, c):
    def compute(v):
        return (v.a * v.b + v.c) / (v.b + v.c)

    numbers = numbers_of(a=a, b=b, c=c, x=1)
    follows = Follows("x", "", compute, ids={name: name for name in "abc"})
    value, low, high = follows.range(follows, numbers)
    middle = {name: numbers[name].value for name in "abc"}
    assert value == approx(follows.at(follows, numbers, middle)[0])
    draws = default_rng(0).uniform(-0.005, 0.005, (3, 500))
    values = {k: middle[k] + draws[i] for i, k in enumerate(middle)}
    found = follows.at(follows, numbers, values)[0]
    assert found.min() >= low - 1e-12
    assert found.max() <= high + 1e-12


def test_a_formula_that_turns_inside_its_box_reaches_its_least():
    """|a − b| is 0 within the rounding of a and b, and neither in the middle nor at a corner."""
    numbers = numbers_of(a="2.01", b="2.0", x="0.00")
    ids = {"a": "a", "b": "b"}
    row = Follows("x", "|a − b|", lambda v: abs(v.a - v.b), ids=ids).row(numbers)
    assert row.verdict == "within rounding"


def verdict(printed, conventions=(), explanations=(), **more):
    numbers = numbers_of(a="2.0", b="3.0", x=printed)
    more |= {"conventions": conventions, "explanations": explanations}
    product = Follows("x", "a b", lambda v: v.a * v.b, ids={"a": "a", "b": "b"}, **more)
    return product.row(numbers)


def test_verdicts_at_their_edges():
    # a b lies in [1.95 × 2.95, 2.05 × 3.05] = [5.7525, 6.2525].
    assert verdict("6.0").verdict == "reproduced"
    for text in ("6.2", "6.3"):  # 6.2525 rounds to 6.3
        assert verdict(text).verdict == "within rounding"
    for text in ("6.4", "5.70"):
        assert verdict(text).verdict == "differs"
    row = verdict("6.2")
    assert (row.low, row.recomputed, row.high) == approx((5.7525, 6.0, 6.2525))
    assert "It should be 6.0." in verdict("6.9").reason


def test_conventions_are_tried_and_explanations_only_explain():
    total = Formula("a + b", lambda v: v.a + v.b, "the sum", {"a": "a", "b": "b"})
    assert verdict("5.0", conventions=(total,)).verdict == "reproduced"
    row = verdict("5.0", explanations=(total,))
    assert row.verdict == "differs"
    assert "Probably the sum" in row.reason
    # An explanation that does not give the printed number is not named.
    assert "Probably" not in verdict("7.0", explanations=(total,)).reason
    assert verdict("5.0", binding="it need not.").verdict == "not checkable"


def test_items_that_fit():
    numbers = printed_numbers()
    rows = {row.id: row for row in sample_checks(numbers)}
    means = {id: float(number.printed) for id, number in numbers.items() if "mean" in id}
    # Five people, who drove under C1 twice.
    table = {f"table_2.4/C{i}/trust_mean": 10 if i == 1 else 5 for i in range(1, 6)}
    studies = {
        f"{study}/items": ({id: 36 for id in means if id.startswith(f"{study}/")}, 0.0005, 10)
        for study in ("uav.trust", "uav.satisfaction")
    }
    for items, (people, half, fewest) in (
        studies | {"table_2.4/trust/items": (table, 0.005, 8)}
    ).items():
        fits = [
            k
            for k in range(1, 41)
            if all(
                abs(round(means[id] * n * k) / (n * k) - means[id]) <= half
                for id, n in people.items()
            )
        ]
        assert rows[items].recomputed == fits[0] == fewest
    assert "none of raw, steps of 5" in rows["table_2.4/tlx/scoring"].reason


def test_extreme_chi2_of_epsilon_by_brute_force():
    # Random eigenvalues of p = 4 contrasts: no χ² below the least at its ε, and the least is
    # reached.
    rng = default_rng(2)
    values = rng.dirichlet(np.ones(4) * 2.0, 20000)
    epsilon = 1.0 / (4.0 * (values**2).sum(axis=1))
    n, p = 36, 4
    rho = 1.0 - (2 * p * p + p + 2) / (6.0 * p * (n - 1))
    chi2 = -(n - 1) * rho * np.log(values.prod(axis=1) * 4.0**4)
    low = chi2_of_epsilon(epsilon, np.array(36.0), 5, False)
    high = chi2_of_epsilon(epsilon, np.array(36.0), 5, True)
    assert (chi2 >= low - 1e-9).all()
    assert (chi2 <= high + 1e-9).all()
    assert np.min(chi2 - low) < 0.05
    one = np.array([1.0 + 0.9, *[1.0 - 0.3] * 3])
    at = -(n - 1) * rho * np.log(one.prod())
    assert chi2_of_epsilon(4.0 / (one**2).sum(), 36.0, 5, False) == approx(at)


def test_second_order_p_is_what_was_printed():
    # Printed p of six studies; the first-order p rounds to another third decimal in two of them.
    numbers = printed_numbers()
    missed = 0
    for id in [id for id in numbers if id.endswith("mauchly.p")]:
        study, printed = id.split("/")[0], numbers[id]
        k = 5 if study.startswith("uav") else 4
        chi2, n = numbers[f"{study}/mauchly.chi2"].value, numbers[f"{study}/n"].value
        assert round(float(mauchly_p_value(chi2, n, k)), printed.decimals) == printed.value
        missed += round(stats.chi2.sf(chi2, k * (k - 1) / 2 - 1), printed.decimals) != printed.value
    assert missed == 2


def test_every_listed_relation_is_about_a_printed_number():
    """Each line of the list gives a row at least; ranks are printed of some schemes only."""
    numbers, rows, used = printed_numbers(), [], set()
    for check in relations(numbers):
        try:
            rows.append(check.row(numbers).id)
        except NotPrintedError:
            continue
        used.add(check.compute)
    assert len(rows) == len(set(rows))
    unused = {relation.of for relation in RELATIONS if relation.compute not in used}
    assert all(of.startswith("section_3_8_3/") for of in unused)
