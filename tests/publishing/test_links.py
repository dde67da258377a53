"""Links between reports, to the equations and to the sections that show what is named."""

import re
import tomllib
from operator import attrgetter
from pathlib import Path

import nbformat
import pytest

import trustlab as tl
from trustlab.publishing.mathml import to_mathml
from trustlab.publishing.report_page import linker

ROOT = Path(__file__).parents[2]
EQUATIONS = tomllib.loads(
    (ROOT / "data" / "published" / "equations.toml").read_text(encoding="utf-8")
)


@pytest.mark.parametrize("number", EQUATIONS)
def test_equation_can_be_shown_and_is_computed_by_what_it_names(number):
    entry = EQUATIONS[number]
    assert "<math" in to_mathml(entry["latex"], display=True)
    assert entry["says"].endswith(".")
    if "computed_by" in entry:
        assert attrgetter(entry["computed_by"])(tl) is not None


def test_every_equation_that_a_report_cites_is_listed():
    cited = set()
    for path in (ROOT / "notebooks").glob("*.ipynb"):
        cells = nbformat.read(path, as_version=4).cells
        cited |= {
            number
            for cell in cells
            for number in re.findall(r"\(((?:2|3|4|A)\.[1-9]\d?)\)", cell.source)
        }
    assert cited
    assert not cited - set(EQUATIONS)


@pytest.mark.parametrize(
    ("markup", "linked"),
    [
        ("by (2.3), as", 'by <a href="index.html#eq-2-3">(2.3)</a>, as'),
        ("M = 4.0 (9.9)", None),
        ("<code>(2.3)</code> <h2>(2.3)</h2> <a href='x'>(2.3)</a>", None),
        (
            "<td>Table 2.4, C1</td>",
            '<td><a href="05_studies.html#tables-2-4-and-3-1">Table 2.4</a>, C1</td>',
        ),
        ("<td>Section 3.9.4.1, Fig. 3.18</td>", "05_studies.html#chapter-3-figs-3-18-3-21"),
        ("<td>Fig. 99.1</td>", None),
        ("<td>Table 2.1</td>", None),  # is shown on this page itself
        ("in words Table 2.4 too", None),
        (
            'see report 06<img alt="report 06">',
            'see <a href="06_audit.html">report 06</a><img alt="report 06">',
        ),
    ],
)
def test_links_lead_to_what_is_named(markup, linked):
    found = linker(ROOT / "notebooks", "03_allocation")(markup)
    assert found == markup if linked is None else linked in found
