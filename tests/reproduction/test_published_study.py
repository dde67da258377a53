"""Printed studies come back as printed; what is no number is refused and the field named."""

import pytest

import trustlab as tl
from trustlab.reproduction import PublishedStudyError

GOOD = {
    "n": 20,
    "mean": {"A": "5.0", "B": "4.25", "C": "3.50"},
    "sd": {"A": "1.0", "B": "1.10", "C": "0.90"},
    "anova": {"F": "8.1", "df1": "2", "df2": "38", "p": ".001"},
    "mauchly": {"chi2": "1.2", "df": "2", "p": "0.55"},
    "pairs": {"A-C": "0.002"},
    "scale": (1.0, 7.0),
}


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


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"anova": {"F": "nan"}}, r"anova\.F must be a number"),
        ({"mean": {"A": None, "B": "4", "C": "3"}}, r"mean\.A"),
        ({"significant_without_p": "A-B"}, r"significant_without_p must be a list"),
        ({"listed_only": "no"}, r"listed_only"),
        ({"anova": {"f": "1"}}, "did you mean 'F'|must be one of 'F'"),
        ({"sd": {"A": "1", "D": "1"}}, "a condition of mean and sd must be one of 'A', 'B', 'C'"),
        ({"pairs": {"A-C": ".002", "C-A": ".002"}}, "mine: pairs: a pair was given twice"),
        ({"pairs": {"A-D": ".002"}}, "'A-D' does not name two of the conditions A, B, C"),
        ({"scale": (7, 1)}, "scale must be the lowest and the highest"),
    ],
)
def test_what_is_no_number_is_refused_by_field(changes, message):
    with pytest.raises(PublishedStudyError, match=message):
        tl.PublishedStudy("mine", **GOOD | {"conditions": ("A", "B", "C")} | changes)
