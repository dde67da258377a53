"""What printed text stands for, by hand."""

import math

import pytest

from trustlab.reproduction.audit.catalogue import PrintedNumber
from trustlab.reproduction.printed import half_unit, printed_interval


@pytest.mark.parametrize(
    ("text", "low", "high"),
    [
        ("0.50", 0.495, 0.505),
        ("0.5", 0.45, 0.55),
        ("5.44e-5", 5.435e-5, 5.445e-5),
        ("120", 119.5, 120.5),
        ("<.0005", -math.inf, 0.0005),
        (">0.05", 0.05, math.inf),
    ],
)
def test_printed_text_keeps_its_rounding(text, low, high):
    assert printed_interval(text) == pytest.approx((low, high))
    number = PrintedNumber("x", "Table", "x", text)
    assert number.compatible == pytest.approx((low, high))
    if math.isfinite(high - low):
        assert [half_unit(text), number.half] == pytest.approx([(high - low) / 2] * 2)


def test_printed_words_have_values():
    def number(text, exact=False):
        return PrintedNumber("x", "Table", "x", text, exact)

    assert number("36", exact=True).half == 0.0
    assert number("worst").value == 5.0  # of five schemes
    assert number("4 and 11").value == 2.0
    assert math.isnan(number("met").value)
