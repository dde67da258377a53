"""
Figures of the audit show the numbers of its table; oracle: counts and places made here from the
table.
"""

import matplotlib
import pytest

import trustlab as tl
from trustlab.reproduction import part_of, plot_ranges, plot_slips, plot_verdicts, verdict_counts

matplotlib.use("Agg")


@pytest.fixture(scope="module")
def verdicts():
    return tl.audit()


def test_counts_are_those_of_the_table(verdicts):
    counts = verdict_counts(verdicts)
    assert counts["all"].sum() == len(verdicts)
    assert counts["differs"].sum() == (verdicts["verdict"] == "differs").sum()
    assert counts.loc["Appendix A", "all"] == verdicts["where"].str.startswith("Appendix").sum()
    bars = plot_verdicts(verdicts).patches
    assert sum(bar.get_width() for bar in bars) == len(verdicts)


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


def test_parts_of_the_dissertation():
    assert part_of("Section 2.4.2.4, Fig. 2.11").startswith("2.4.2")
    assert part_of("Section 3.1").startswith("3.9")
    with pytest.raises(ValueError, match=r"no part of the dissertation for 'Section 9'"):
        part_of("Section 9")
