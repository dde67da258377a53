"""The text of a formula is the expression that is computed, set as in print."""

import numpy as np
import pytest

from trustlab.reproduction.audit.verdict import Formula

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
