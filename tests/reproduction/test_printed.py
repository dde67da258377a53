"""Printed text, tables and studies come back as printed; digits are counted as a reader would."""

import math

import pytest

import trustlab as tl
from tests.cases import refused
from tests.reproduction.cases import study_of
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
    numbers = [
        PrintedNumber("x", "Table", "x", text, True) for text in ("worst", "4 and 11", "met")
    ]
    # Worst of five schemes, and how many are named.
    assert [number.value for number in numbers] == approx([5.0, 2.0, math.nan], nan_ok=True)
    assert PrintedNumber("x", "Table", "x", "36", True).half == 0.0


def test_a_table_has_the_heads_of_its_rows():
    assert published_table("2.3").index.names == ["threshold", "statistic"]


def test_models_have_the_printed_parameters():
    models, table = published_models(), published_table("2.1").astype(float)
    assert list(models) == ["pilot", "1", "2", "3", "4", "5"]
    for name in table.columns:
        assert round(models[name].robot.b, 4) == table.loc["b_pr", name]
        assert models[name].human.b == approx(table.loc["b_r", name], abs=1e-12)


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
    ours, printed = [0.9961, 0.30, 0.2, 0.394], ["0.996", "0.29", "0.3", "0.390"]
    errors = {1: 0.01, 2: 0.01}
    table = compare(dict(enumerate(ours)), dict(enumerate(printed)), errors)
    assert list(table["verdict"]) == ["reproduced", "within 2 s.e.", "differs", "differs"]
    with refused("the same quantities.* not so: b"):
        compare({"a": 1.0, "b": 1.0}, {"a": "1"})
    for errors in ({"A": 0.1}, {"a": -0.1}):  # without them, a verdict of "differs"
        with refused("stderr"):
            compare({"a": 1.05}, {"a": "1.00"}, errors)
    for number in (0.390, "about one"):  # 0.394 would round to 0.39, but not to 0.390
        with refused("as printed"):
            compare({"a": 0.394}, {"a": number})


def test_verdicts_of_a_report_are_its_own_without_diagrams():
    found = tl.reproduction.verdicts("allocation")
    assert {*found["report"]} == {"allocation"}
    assert {"Theorem 2"} <= {*found.index}
    assert "diagram" not in {*found["verdict"]}


def test_studies_say_what_is_missing_and_whether_they_are_corrected():
    """That they are there as printed says the audit."""
    studies = tl.published_studies()
    assert studies["uav.satisfaction"].missing == ("C2",)
    assert studies["uav.trust"].missing == ("C1",)
    assert studies["uav.tlx"].corrected
    assert not studies["teleop.tlx"].corrected


@parametrize(
    ("printed", "message"),
    [
        ("anova.F = nan", r"s: anova\.F must be a number"),
        ("sd.D = 1", "a condition of mean and sd must be one of 'A', 'B', 'C'"),
        ("pairs.A-C = .002, pairs.C-A = .002", "pairs: a pair was given twice"),
        ("pairs.A-D = .002", "'A-D' does not name two of the conditions A, B, C"),
        ("scale = 7 to 1", "scale must be the lowest and the highest"),
    ],
)
def test_what_is_no_number_is_refused_by_field(printed, message):
    with pytest.raises(PublishedStudyError, match=message):
        study_of(f"n = 20, mean.A = 5.0, mean.B = 4.25, {printed}", conditions=("A", "B", "C"))


def test_conditions_are_names():
    with refused("a name of conditions must be a text, got 3"):
        study_of("n = 20, mean.A = 5.0", conditions=("A", 3))


def test_conditions_may_come_from_an_iterator():
    assert study_of("n = 12, mean.A = 3", conditions=iter("AB")).conditions == ("A", "B")
