"""The smallest change by hand."""

import pandas as pd
import pytest

from trustlab.reproduction import smallest_change
from trustlab.reproduction.printed_number import half_unit


def area(values):
    if values["width"] < 0:
        raise ValueError("no width")
    return {"area": values["width"] * values["height"], "sum": values["width"] + values["height"]}


def test_half_units():
    assert half_unit("0.320") == pytest.approx(0.0005)
    assert half_unit("5.44e-5") == pytest.approx(5e-8)
    assert half_unit("120") == pytest.approx(0.5)


def test_smallest_change_names_the_input():
    table = smallest_change(area, {"width": "2.0", "height": "3.0"}, "area", "7.0")
    # 2.0 × 3.5 = 7.0; no width of one decimal times 3.0 rounds to 7.0 (2.3 gives 6.9, 2.4 gives
    # 7.2).
    assert len(table) == 1
    assert table.loc[0, "input"] == "height"
    assert table.loc[0, "needed"] == pytest.approx(3.5)
    assert table.loc[0, "units"] == 5
    column = pd.Series({"width": "2.0", "height": "3.0"})
    pd.testing.assert_frame_equal(smallest_change(area, column, "area", "7.0"), table)
