"""Printed tables come back as printed; digits are counted as a reader would."""

import pytest

from trustlab.reproduction import compare, published_models, published_table
from trustlab.reproduction.comparison import matching_digits


def test_models_have_the_printed_parameters():
    models = published_models()
    assert list(models) == ["pilot", "1", "2", "3", "4", "5"]
    table = published_table("2.1")
    for name in table.columns:
        assert round(models[name].robot.b, 4) == float(table.loc["b_pr", name])
        assert models[name].human.b == pytest.approx(float(table.loc["b_r", name]), abs=1e-12)


@pytest.mark.parametrize(
    ("ours", "printed", "digits"),
    [
        (0.39, "0.390", 3),
        (0.3906, "0.390", 2),
        (0.00127, "0.0013", 2),
        (5.38e-5, "5.44e-5", 2),
        (0.999, "1.0", 2),
        (-0.24, "0.24", 0),
        (float("nan"), "0.24", 0),
        (123.4, "120", 2),
    ],
)
def test_matching_digits(ours, printed, digits):
    assert matching_digits(ours, printed) == digits


def test_verdicts():
    table = compare(
        {"a": 0.9961, "b": 0.30, "c": 0.2},
        {"a": "0.996", "b": "0.29", "c": "0.3"},
        {"b": 0.01, "c": 0.01},
    )
    assert list(table["verdict"]) == ["reproduced", "within 2 s.e.", "differs"]
    with pytest.raises(ValueError, match="only on one side: b"):
        compare({"a": 1.0, "b": 1.0}, {"a": "1"})
    assert compare({"a": 0.394}, {"a": "0.390"})["verdict"].tolist() == ["differs"]
    for number in (0.390, 1, None, "about one"):  # 0.394 would round to 0.39, but not to 0.390
        for call in (
            lambda x: compare({"a": 0.394}, {"a": x}),
            lambda x: matching_digits(0.394, x),
        ):
            with pytest.raises(ValueError, match="as printed"):
                call(number)
