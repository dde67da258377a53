"""
How verdicts are made: ranges against closed forms and brute force, rounding of printed text, and
the bounds used.
"""

from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy import stats

from tests import textbook
from trustlab.reproduction.audit.catalogue import PARTICIPANTS, PrintedNumber, printed_numbers
from trustlab.reproduction.audit.check import Follows, Formula, reach, rows_of
from trustlab.reproduction.audit.consistency import sample_checks
from trustlab.reproduction.audit.relations import (
    STATEMENTS,
    chi2_of_epsilon,
    of_participant,
    relations,
    thresholds_of,
)
from trustlab.studies.anova import mauchly_p_value

positive = st.floats(0.1, 10.0)


@settings(max_examples=60, deadline=None, derandomize=True)
@given(positive, positive, positive, st.floats(0.001, 0.05))
def test_reach_holds_every_point_of_the_box(a, b, c, half):
    def compute(v):
        return (v["a"] * v["b"] + v["c"]) / (v["b"] + v["c"])

    middle = {"a": a, "b": b, "c": c}
    halves = dict.fromkeys(middle, half)
    value, low, high = reach(compute, middle, halves)
    assert value == pytest.approx(compute(middle))
    draws = np.random.default_rng(0).uniform(-1, 1, (3, 500))
    found = compute({k: middle[k] + half * draws[i] for i, k in enumerate(middle)})
    assert found.min() >= low - 1e-12
    assert found.max() <= high + 1e-12


def number(id, text):
    return PrintedNumber(id, "Table", id, text)


def verdict(printed, conventions=(), explanations=(), **more):
    numbers = {id: number(id, text) for id, text in {"a": "2.0", "b": "3.0", "x": printed}.items()}
    more |= {"conventions": conventions, "explanations": explanations}
    product = Follows("a b", lambda v: v.a * v.b, ids={"a": "a", "b": "b"}, of="x", **more)
    return product.row(numbers)


def test_verdicts_at_their_edges():
    # a b lies in [1.95 × 2.95, 2.05 × 3.05] = [5.7525, 6.2525].
    assert verdict("6.0").verdict == "reproduced"
    for text in ("6.2", "6.3"):  # 6.2525 rounds to 6.3
        assert verdict(text).verdict == "within rounding"
    for text in ("6.4", "5.70"):
        assert verdict(text).verdict == "differs"
    row = verdict("6.2")
    assert (row.low, row.recomputed, row.high) == pytest.approx((5.7525, 6.0, 6.2525))
    assert "One digit differs." in verdict("6.9").reason
    assert "One digit differs." not in verdict("7.1").reason


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
    rows = {row.id: row for row in rows_of(sample_checks(numbers), numbers)}
    for study in ("uav.trust", "uav.satisfaction"):
        means = [float(x.printed) for id, x in numbers.items() if id.startswith(f"{study}/mean.")]
        fits = [
            items
            for items in range(1, 41)
            if all(abs(round(m * 36 * items) / (36 * items) - m) <= 0.0005 for m in means)
        ]
        assert rows[f"{study}/items"].recomputed == fits[0] == 10


def test_extreme_chi2_of_epsilon_by_brute_force():
    # Random eigenvalues of p = 4 contrasts: no χ² below the least at its ε, and the least is
    # reached.
    rng = np.random.default_rng(2)
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
    assert chi2_of_epsilon(4.0 / (one**2).sum(), 36.0, 5, False) == pytest.approx(at)


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


@pytest.mark.parametrize("seed", range(4))
def test_what_means_and_sds_allow_holds_true_data(seed):
    values = np.random.default_rng(seed).normal([0.0, 0.2, 0.4, 0.6, 0.9], 0.7, (36, 5))
    found = textbook.analysed(values + np.random.default_rng(9).normal(size=(36, 1)))
    printed = {"n": "36", "anova.F": f"{found['F']:.3f}"}
    for i, c in enumerate("12345"):
        printed |= {f"{key}.C{c}": f"{found[key][i]:.3f}" for key in ("mean", "sd")}
    for (a, b), test in zip(combinations("12345", 2), found["pairs"], strict=True):
        printed[f"pairs.C{a}-C{b}"] = f"{test.pvalue:.4f}"
    made = {f"uav.made/{key}": number(f"uav.made/{key}", text) for key, text in printed.items()}
    numbers = printed_numbers() | made
    rows = rows_of(relations(numbers, "uav.made/[ap]*"), numbers)
    assert len(rows) == 11
    assert {row.verdict for row in rows} == {"not checkable"}
    spoiled = numbers | {"uav.made/anova.F": number("uav.made/anova.F", "0.010")}
    (row,) = rows_of(relations(spoiled, "uav.made/anova.F"), spoiled)
    assert row.verdict == "differs"


def test_every_listed_relation_is_about_a_printed_number():
    """Nothing that the tables and the text relate lacks an input; a study may print less."""
    about = [r for p in PARTICIPANTS for r in (*of_participant(p), *thresholds_of(p))]
    checked = [check.of + check.suffix for check in relations(printed_numbers())]
    assert {relation.of + relation.suffix for relation in (*about, *STATEMENTS)} <= set(checked)
    assert len(checked) == len(set(checked))
