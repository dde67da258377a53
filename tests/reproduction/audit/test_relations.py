"""A relation notes the numbers that it uses, and is about numbers that are printed."""

import numpy as np
import pytest

from trustlab.reproduction.audit.catalogue import PARTICIPANTS, printed_numbers
from trustlab.reproduction.audit.check import Formula, NotPrintedError, Values
from trustlab.reproduction.audit.relations import (
    STATEMENTS,
    of_participant,
    relations,
    thresholds_of,
)

NUMBERS = printed_numbers()


def test_a_formula_notes_what_it_uses_in_its_order():
    formula = Formula(
        "F/(F + n − 1)",
        lambda v: v.F / (v.F + v.n - 1),
        ids={"n": "uav.tlx/n", "F": "uav.tlx/anova.F", "p": "uav.tlx/anova.p"},
    )
    assert list(formula.inputs(NUMBERS).items()) == [("F", "uav.tlx/anova.F"), ("n", "uav.tlx/n")]
    value, low, high = formula.range(NUMBERS)
    assert value == pytest.approx(5.891 / (5.891 + 35))
    assert (low, high) == pytest.approx((5.8905 / 40.8905, 5.8915 / 40.8915))


def test_a_name_of_several_numbers_is_their_stack():
    ids = {"x_1": "a", "x_2": "b", "y": "c"}
    values = {"x_1": np.array([1.0, 2.0]), "x_2": np.array([3.0, 1.0]), "y": np.array([5.0, 5.0])}
    v = Values(ids, lambda symbol, id: values[symbol])
    np.testing.assert_array_equal(v.x.max(axis=0) - v.y, [-2.0, -3.0])
    assert list(v.used) == ["x_1", "x_2", "y"]
    with pytest.raises(NotPrintedError, match="z"):
        v.z  # noqa: B018


def test_every_listed_relation_is_about_a_printed_number():
    """Nothing that the tables and the text relate lacks an input; a study may print less."""
    about = [r for p in PARTICIPANTS for r in (*of_participant(p), *thresholds_of(p))]
    checked = [check.of + check.suffix for check in relations(NUMBERS)]
    for relation in (*about, *STATEMENTS):
        assert relation.of + relation.suffix in checked
    assert len(checked) == len(set(checked))
