"""
Figures of the audit show the numbers of its table; oracle: counts and places made here from the
table.
"""

import matplotlib
import pytest

import trustlab as tl
from trustlab.reproduction import plot_ranges, plot_slips

matplotlib.use("Agg")


@pytest.fixture(scope="module")
def verdicts():
    return tl.audit()


def test_ranges_and_slips_are_where_the_table_has_them(verdicts):
    rows = verdicts[verdicts["id"].str.startswith("table_2.1/delta_TSC")]
    ax = plot_ranges(rows)
    assert [label.get_text() for label in ax.get_yticklabels()] == [
        f"participant {p}" for p in range(1, 6)
    ]
    printed = [line.get_xdata()[0] for line in ax.lines if line.get_marker() == "D"]
    assert printed == [float(text) for text in rows["printed"]]
    slips = verdicts[(verdicts["verdict"] == "differs") & (verdicts["high"] > verdicts["low"])]
    places = [line.get_xdata()[0] for line in plot_slips(slips).lines if line.get_marker() == "D"]
    assert len(places) == len(slips) > 3
    assert all(abs(place) > 1.0 for place in places)
