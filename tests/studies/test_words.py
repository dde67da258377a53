"""Numbers as the APA manual prints them: oracle, rounding on paper (halves away from zero)."""

import numpy as np
import pandas as pd

from tests.studies.scores import parametrize
from trustlab.studies.words import apa_number, apa_p, printed


@parametrize(
    ("value", "digits", "text"),
    [
        (6.875, 2, "6.88"),
        (6.874999999999999, 2, "6.88"),
        (-2.625, 2, "−2.63"),
        (2.5, 0, "3"),
        (-0.004, 2, "0.00"),
        (-0.005, 2, "−0.01"),
        (1e130, 1, "1" + 130 * "0" + ".0"),
        (np.float64(0.30000000000000004), 12, "0.300000000000"),
        (float("nan"), 2, "nan"),
        (float("inf"), 2, "inf"),
    ],
)
def test_rounding(value, digits, text):
    assert apa_number(value, digits) == text


def test_only_a_leading_zero_is_left_out():
    """10.5 was printed as 1.50."""
    numbers = (0.5, -0.5, 1.0, 10.5, 20.04)
    texts = [".50", "−.50", "1.00", "10.50", "20.04"]
    assert [apa_number(number, below_one=True) for number in numbers] == texts


@parametrize(
    ("p", "text"),
    [
        (0.0009999, "p < .001"),
        (0.001, "p = .001"),
        (0.0495, "p = .050"),
        (0.9994, "p = .999"),
        (0.9995, "p > .999"),
        (1.0, "p > .999"),
    ],
)
def test_p_values(p, text):
    assert apa_p(p) == text


HEADS = {"p_holm": "p (Holm)", "se": "standard error", "mean": "M", "ci_low": "95% CI low"}


@parametrize(
    "columns",
    [
        {
            # Labels stay.
            **{name: {0.125: "0.125", 0.25: "0.25"} for name in ("a", "b", "level", "condition")},
            "df1": {1.0: "1", 2.0: "2"},  # decimals only where there are fractions
            "df2": {21.0: "21.00", 30.5: "30.50"},
            "F": {6.875: "6.88", np.nan: ""},
            "p": {0.0004: "< .001", 0.0495: ".050"},
            "p_holm": {np.nan: "", 0.9999: "> .999"},
            "points": {0.0123: "0.012", 0.02: "0.020"},
            "estimate": {1.23456: "1.235", 2.0: "2.00"},  # as their standard errors
            "se": {0.0123: "0.012", 0.2: "0.20"},
        },
        # Without the other limit an error of pandas came.
        {"mean": {1.234: "1.23"}, "ci_low": {0.5: "0.50"}},
        # One measure without a test made "n 10.00, df1 1.00" of the others.
        {"n": {10.0: "10", np.nan: ""}, "df1": {1.0: "1", np.nan: ""}},
        # A Bayes factor of 0.0004 beside greater ones was 0.00.
        {"bf01": {3.1: "3.1", 0.0004: "0.0004", 1e-15: "1e-15"}},
        {"bf10": {0.32: "0.32", 2500.0: "2.5e+03", 1e15: "1e+15"}},
        # Robot performance was printed as a p-value.
        {"p_r": {1.0: "1.00", 0.35: "0.35"}, "p_h": {-0.2: "−0.20", 0.41: "0.41"}},
        {"shapiro_p": {0.17: ".170"}, "mauchly_p": {0.5: ".500"}},
    ],
)
def test_columns_for_reading(columns):
    texts = printed(pd.DataFrame({name: [*cells] for name, cells in columns.items()}))
    assert [*texts] == [HEADS.get(name, name.replace("_", " ")) for name in columns]
    assert texts.T.to_numpy().tolist() == [[*cells.values()] for cells in columns.values()]


def test_heads_name_the_level_of_intervals():
    table = pd.DataFrame({"ci_low": [0.5], "ci_high": [0.7], "confidence": 0.8})
    assert [*printed(table)] == ["80% CI low", "80% CI high", "confidence"]
