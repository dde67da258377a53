"""Numbers as the APA manual prints them: oracle, rounding on paper (halves away from zero)."""

import re

import numpy as np
import pandas as pd
import pytest

import trustlab as tl
from trustlab.studies.words import apa_number, apa_p


@pytest.mark.parametrize(
    ("value", "digits", "text"),
    [
        (6.875, 2, "6.88"),
        (6.874999999999999, 2, "6.88"),
        (6.8749, 2, "6.87"),
        (-2.625, 2, "−2.63"),
        (2.5, 0, "3"),
        (-0.004, 2, "0.00"),
        (-0.005, 2, "−0.01"),
        (0.0, 2, "0.00"),
        (1e130, 1, "1" + 130 * "0" + ".0"),
        (np.float64(0.30000000000000004), 12, "0.300000000000"),
        (float("nan"), 2, "nan"),
        (float("inf"), 2, "inf"),
    ],
)
def test_rounding(value, digits, text):
    assert apa_number(value, digits) == text


@pytest.mark.parametrize(
    ("p", "text"),
    [
        (0.0009999, "p < .001"),
        (0.001, "p = .001"),
        (0.0495, "p = .050"),
        (0.9994, "p = .999"),
        (0.9995, "p > .999"),
        (0.9996, "p > .999"),
        (1.0, "p > .999"),
    ],
)
def test_p_values(p, text):
    assert apa_p(p) == text


@pytest.mark.parametrize("seed", range(20))
def test_a_mean_of_whole_points_is_exact(seed):
    answers = np.random.default_rng(seed).integers(1, 11, (24, 4)).astype(float)
    frame = pd.DataFrame(
        {
            "pid": np.repeat(np.arange(24), 4),
            "scheme": ["A", "B", "C", "D"] * 24,
            "trust": answers.ravel(),
        }
    )
    result = tl.repeated_measures(frame, dv="trust", within="scheme", subject="pid")
    assert result.descriptives()["mean"].tolist() == [
        sum(column) / 24 for column in answers.T.tolist()
    ]
    for scheme, mean in zip("ABCD", answers.sum(axis=0), strict=True):
        on_paper = int((100 * mean + 12) // 24)  # hundredths, halves up
        assert f"{scheme} (M = {on_paper // 100}.{on_paper % 100:02d}, SD = " in result.apa()


def test_levels_that_are_numbers_are_not_rounded():
    frame = pd.DataFrame({"level": [0.125], "autonomy": [0.375], "mean": [0.375]})
    frame.attrs["labels"] = ["autonomy"]
    table = tl.studies.apa_table(frame)
    assert table.loc[0].tolist() == [0.125, 0.375, "0.38"]


def test_degrees_of_freedom_have_decimals_only_where_they_are_fractions():
    frame = pd.DataFrame({"df1": [1.0, 2.0], "df2": [21.0, 30.5]})
    assert tl.studies.apa_table(frame).to_dict("list") == {
        "df1": ["1", "2"],
        "df2": ["21.00", "30.50"],
    }


def two_way(n=12, **more):
    cells = pd.MultiIndex.from_product([range(n), list("ab"), list("xyz")], names=["who", "A", "B"])
    frame = cells.to_frame(index=False)
    rng = np.random.default_rng(0)
    frame["score"] = rng.normal(size=len(frame)) + rng.normal(size=n).repeat(6)
    frame["side"] = np.where(frame["who"] < 5, "l", "r")
    return tl.repeated_measures(frame, "score", ["A", "B"], "who", **more)


@pytest.mark.parametrize("between", [None, "side"])
def test_every_effect_has_the_interval_of_its_size(between):
    result = two_way(between=between)
    number = r"[−]?\d*\.\d\d"
    pattern = rf"ηp² = {number}, 90% CI \[{number}, {number}\], ηG² = {number}"
    assert len(re.findall(pattern, result.apa())) == len(result.table())
    assert "greenhouse-geisser" not in result.apa()


def test_pairs_have_the_interval_of_d_z():
    scores = np.random.default_rng(1).normal(size=(9, 3)) + np.array([0.0, 2.0, 4.0])
    cells = pd.MultiIndex.from_product([range(9), list("abc")], names=["who", "c"])
    frame = cells.to_frame(index=False).assign(v=scores.ravel())
    result = tl.repeated_measures(frame, "v", "c", "who")
    row = result.pairs().iloc[1]
    words = f"d_z = {apa_number(row['d_z'])}, 95% CI [{apa_number(row['d_z_low'])}, "
    assert words + f"{apa_number(row['d_z_high'])}]" in result.apa()


def test_one_participant_and_several():
    cells = pd.MultiIndex.from_product([range(12), list("ab")], names=["who", "c"])
    frame = cells.to_frame(index=False).assign(v=np.random.default_rng(2).normal(size=24))
    for rows, words in (
        ([3], "1 participant with missing cells was left out (1)."),
        ([3, 5], "2 participants with missing cells were left out (1, 2)."),
    ):
        result = tl.repeated_measures(frame.drop(index=rows), "v", "c", "who", missing="listwise")
        assert result.apa().endswith(words)


def test_a_table_for_reading():
    frame = pd.DataFrame(
        {
            "a": [0.0, 0.2],
            "n": [7, 8],
            "F": [6.875, np.nan],
            "p": [0.0004, 0.0495],
            "p_holm": [np.nan, 0.9999],
            "mauchly_p": [0.5, 0.25],
            "points": [1.25, 2.0],
        }
    )
    before = frame.copy()
    found = tl.studies.apa_table(frame, digits=1)
    assert found.to_dict("list") == {
        "a": [0.0, 0.2],  # a label stays
        "n": [7, 8],
        "F": ["6.9", ""],
        "p": ["< .001", ".050"],
        "p_holm": ["", "> .999"],
        "mauchly_p": [".500", ".250"],
        "points": ["1.3", "2.0"],
    }
    pd.testing.assert_frame_equal(frame, before)
