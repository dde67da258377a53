"""Printed text, tables and studies come back as printed; digits are counted as a reader would."""

import math

import pytest

import trustlab as tl
from trustlab.reproduction import PublishedStudyError, compare, published_models, published_table
from trustlab.reproduction.audit.catalogue import PrintedNumber
from trustlab.reproduction.printed import half_unit, printed_interval

parametrize = pytest.mark.parametrize
approx = pytest.approx


@parametrize(
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
    assert printed_interval(text) == approx((low, high))
    number = PrintedNumber("x", "Table", "x", text)
    assert number.compatible == approx((low, high))
    if math.isfinite(high - low):
        assert [half_unit(text), number.half] == approx([(high - low) / 2] * 2)


def test_printed_words_have_values():
    def number(text, exact=False):
        return PrintedNumber("x", "Table", "x", text, exact)

    assert number("36", exact=True).half == 0.0
    assert number("worst").value == 5.0  # of five schemes
    assert number("4 and 11").value == 2.0
    assert math.isnan(number("met").value)


def test_models_have_the_printed_parameters():
    models = published_models()
    assert list(models) == ["pilot", "1", "2", "3", "4", "5"]
    table = published_table("2.1")
    for name in table.columns:
        assert round(models[name].robot.b, 4) == float(table.loc["b_pr", name])
        assert models[name].human.b == approx(float(table.loc["b_r", name]), abs=1e-12)


@parametrize(
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
        (1e27, "0.50", 0),
    ],
)
def test_matching_digits(ours, printed, digits):
    assert compare({"a": ours}, {"a": printed})["matching_digits"].item() == digits


def test_numbers_beside_printed_ones():
    table = compare(
        {"a": 0.9961, "b": 0.30, "c": 0.2},
        {"a": "0.996", "b": "0.29", "c": "0.3"},
        {"b": 0.01, "c": 0.01},
    )
    assert list(table["verdict"]) == ["reproduced", "within 2 s.e.", "differs"]
    with pytest.raises(ValueError, match="only on one side: b"):
        compare({"a": 1.0, "b": 1.0}, {"a": "1"})
    for errors in ({"A": 0.1}, {"a": -0.1}):  # without them, a verdict of "differs"
        with pytest.raises(ValueError, match="stderr"):
            compare({"a": 1.05}, {"a": "1.00"}, errors)
    assert compare({"a": 0.394}, {"a": "0.390"})["verdict"].tolist() == ["differs"]
    for number in (0.390, "about one"):  # 0.394 would round to 0.39, but not to 0.390
        with pytest.raises(ValueError, match="as printed"):
            compare({"a": 0.394}, {"a": number})


def test_the_eleven_studies_are_there_as_printed():
    studies = tl.published_studies()
    assert len(studies) == 11
    assert studies["uav.robot_performance"].mean["C5"] == "0.58"
    assert studies["uav.utilization"].mauchly["chi2"] == "15.030"
    assert studies["uav.satisfaction"].missing == ("C2",)
    assert studies["uav.trust"].missing == ("C1",)
    assert {s.k for s in studies.values()} == {2, 4, 5}
    assert studies["uav.tlx"].corrected
    assert not studies["teleop.tlx"].corrected


@parametrize(
    ("changes", "message"),
    [
        ({"anova": {"F": "nan"}}, r"mine: anova\.F must be a number"),
        ({"sd": {"A": "1", "D": "1"}}, "a condition of mean and sd must be one of 'A', 'B', 'C'"),
        ({"pairs": {"A-C": ".002", "C-A": ".002"}}, "pairs: a pair was given twice"),
        ({"pairs": {"A-D": ".002"}}, "'A-D' does not name two of the conditions A, B, C"),
        ({"scale": (7, 1)}, "scale must be the lowest and the highest"),
    ],
)
def test_what_is_no_number_is_refused_by_field(changes, message):
    printed = {"n": 20, "mean": {"A": "5.0", "B": "4.25"}, "sd": {"A": "1.0"}}
    with pytest.raises(PublishedStudyError, match=message):
        tl.PublishedStudy("mine", **printed | {"conditions": ("A", "B", "C")} | changes)


def test_conditions_may_come_from_an_iterator():
    study = tl.PublishedStudy("s", conditions=iter("AB"), n=12, mean={"A": "3", "B": "4"}, sd={})
    assert study.conditions == ("A", "B")
