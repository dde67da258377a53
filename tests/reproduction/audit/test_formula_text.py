"""Formulas as text: what is shown is what is computed, and nothing but arithmetic is."""

import re
import tomllib

import numpy as np
import pytest

from trustlab.reproduction.audit.arithmetic import evaluate
from trustlab.reproduction.audit.catalogue import printed_numbers
from trustlab.reproduction.audit.relations import relations
from trustlab.reproduction.audit.verdict import Formula
from trustlab.reproduction.published import published_folder

IDS = {
    "F": "s/F",
    "df1": "s/df1",
    "df2": "s/df2",
    "n": "s/n",
    "ε": "s/epsilon",
    "after": "a",
    "before": "b",
}


@pytest.mark.parametrize(
    ("expression", "text", "inputs"),
    [
        ("F * df1 / (F * df1 + df2)", "F df1/(F df1 + df2)", ["F", "df1", "df2"]),
        ("4 * ε * (n - 1)", "4 ε (n − 1)", ["ε", "n"]),
        ("100 * abs(after - before) / before", "100 |after − before|/before", ["after", "before"]),
        ("n % 10", "n modulo 10", ["n"]),
    ],
)
def test_text_and_inputs_follow_from_the_expression(expression, text, inputs):
    formula = Formula.of(expression, IDS)
    assert formula.text == text
    assert list(formula.inputs) == inputs
    rng = np.random.default_rng(0)
    values = {symbol: rng.uniform(1.0, 9.0, 50) for symbol in inputs}
    found = formula.compute(values)
    np.testing.assert_array_equal(found, eval(expression, {"abs": np.abs}, values))


def test_a_name_of_several_numbers_is_their_stack():
    values = {"x_1": np.array([1.0, 2.0]), "x_2": np.array([3.0, 1.0]), "y": np.array([5.0, 5.0])}
    np.testing.assert_array_equal(evaluate("max(x) - y", values), [-2.0, -3.0])
    np.testing.assert_array_equal(evaluate("max(x_1, y, 4)", values), [5.0, 5.0])
    assert evaluate("count(x)", values) == 2


@pytest.mark.parametrize(
    "expression",
    ["x.real", "x[0]", "__import__('os')", "(lambda: x)()", "'x'", "x if x else 1", "mean(x=1)"],
)
def test_anything_but_arithmetic_is_refused(expression):
    with pytest.raises(ValueError, match="no arithmetic of printed numbers"):
        evaluate(expression, {"x": np.ones(2)})


def test_every_listed_relation_is_about_a_printed_number():
    listed = tomllib.loads((published_folder() / "relations.toml").read_text())
    names = {row["number"] for kind in ("follows", "allows") for row in listed[kind]}
    checked = [check.number for check in relations(printed_numbers())]
    for name in names:
        pattern = re.sub(r"\\{\w+\\}", "[^/]+", re.escape(name))
        assert any(re.fullmatch(pattern, id) for id in checked), name
