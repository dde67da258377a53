"""
Notebooks are committed without outputs; links of the book lead somewhere, and pages show well.
"""

import re
import shutil
from urllib.parse import quote

import nbformat
import pytest

import trustlab as tl
from tests.house.documents import ROOT
from tests.publishing.world import SETTINGS, faults, pages, publish, serious, walked, write_book
from trustlab.publishing.chapter import empty_chapter

# --- notebooks ------------------------------------------------------------------------------------


# Of a cell, with lines of 100 columns that the formatter lays out.
MOST_LINES = 60
# Of a notebook, blank ones not counted.
MOST_CODE = 250
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))
QUOTED = re.compile(r"“[^”]*”|```.*?```|`[^`]*`", re.S)
DECIMAL = re.compile(r"(?<![\w.()\-])\d+\.\d+(?![\w.)])")
EQUATION = re.compile(
    r"\(\d\.\d+\)(?:[-–]\(\d\.\d+\))?"
    r"|(?:Fig|Figs|Table|Tables|Section|Sections|Chapter|Algorithm)\.?\s+"
    r"[\d.]+(?:(?:, | and |[-–])[\d.]+)*"
)


def decimals(text):
    """
    Decimal literals in prose: not equation, figure, table or section numbers, not quoted or in
    code.
    """
    return DECIMAL.findall(EQUATION.sub("", QUOTED.sub("", text)))


@pytest.fixture(params=NOTEBOOKS, ids=lambda path: path.stem)
def cells(request):
    return nbformat.read(request.param, 4).cells


def code_of(cells):
    return [cell for cell in cells if cell.cell_type == "code"]


def test_no_outputs(cells):
    for cell in code_of(cells):
        assert (cell.outputs, cell.execution_count) == ([], None)


def test_no_decimal_literals_in_prose(cells):
    prose = [cell.source for cell in cells if cell.cell_type == "markdown"]
    assert [found for text in prose for found in decimals(text)] == []


def test_code_cells_are_short(cells):
    code = [cell.source.splitlines() for cell in code_of(cells)]
    assert max(map(len, code)) <= MOST_LINES
    assert sum(bool(line.strip()) for lines in code for line in lines) <= MOST_CODE


def test_begins_with_a_title_and_a_sentence(cells):
    assert re.match(r"# .+\n\n\w.+", cells[0].source)


# --- the book -------------------------------------------------------------------------------------


MOST_BYTES = 2.5e6
# What users type, and the page that they want among the first three.
QUESTIONS = {
    "stable": "how_to/teleoperate",
    "cite": "concepts/cite",
    "wrong in the dissertation": "concepts/does_not_hold",
    "r": "concepts/glossary",
    "own robot": "how_to/robot",
    "which trust model fits people best": "how_to/trust",
    "participant 3": "concepts/glossary",
    "how long to record": "how_to/logs",
    "TSC": "concepts/glossary",
    "Table 2.3": "03_allocation",
}
HITS = "#search-results ul.search > li > a"


def build(folder, options=""):
    """
    Build the book from a copy of its sources, so that tests at the same time keep out of each
    other's way; as it is before any notebook has run.
    """
    root = folder / "tree"
    ignored = shutil.ignore_patterns("api", "__pycache__", "*.ipynb")
    shutil.copytree(ROOT / "docs", root / "docs", ignore=ignored)
    for name in ("data", "notebooks"):
        (root / name).symlink_to(ROOT / name)
    shutil.copytree(ROOT / "reports" / "figures", root / "reports" / "figures")
    shutil.copy(ROOT / "environment.lock", root)
    for path in NOTEBOOKS:
        (root / "docs" / path.name).write_text(empty_chapter(path, "Not run yet."))
    with (root / "docs" / "conf.py").open("a") as file:
        file.write(options)
    done = write_book(root)
    assert done.returncode == 0, done.stderr[-3000:]
    return root


@pytest.mark.xdist_group("docs")
def test_book_without_most_of_its_api(tmp_path):
    root = build(tmp_path, SETTINGS.replace("Session", "(fit_robot|Session)"))
    assert faults(root / "reports") == []
    assert (root / "reports" / "api" / "fit_robot.html").is_file()
    assert "Not run yet" in (root / "reports" / "06_audit.html").read_text()


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The whole book, with every notebook run."""
    root = build(tmp_path_factory.mktemp("site"))
    for path in (root / "docs").glob("*.ipynb"):
        path.unlink()
    done = publish(root)
    assert done.returncode == 0, done.stderr[-3000:]
    assert write_book(root).returncode == 0
    return root / "reports"


@pytest.mark.long
def test_whole_book(site):
    assert faults(site) == []
    assert [path.name for path in pages(site) if path.stat().st_size > MOST_BYTES] == []
    names = [name for name in tl.__all__ if not isinstance(getattr(tl, name), type(tl))]
    assert [name for name in names if not (site / "api" / f"{name}.html").is_file()] == []


@pytest.mark.long
def test_pages_in_a_browser(site, browser):
    assert walked(browser, pages(site)) == []
    tab = browser.new_page()
    named = ("index", "start", "finder", "api/fit_robot", "api/room_models", "how_to/logs")
    paths = [site / f"{name}.html" for name in named] + sorted(site.glob("[0-9p]*.html"))
    assert [fault for path in paths for fault in serious(tab, path)] == []


@pytest.mark.long
def test_search_knows_the_words_of_users(site, browser):
    tab, missed = browser.new_page(), {}
    for question, wanted in QUESTIONS.items():
        tab.goto(f"{(site / 'search.html').as_uri()}?q={quote(question)}")
        tab.get_by_text("Search finished").wait_for()
        hits = tab.eval_on_selector_all(HITS, "links => links.map(link => link.pathname)")
        if not any(hit.endswith(f"{wanted}.html") for hit in hits[:3]):
            missed[question] = hits[:3]
    assert missed == {}


def test_the_check_sees_what_it_should(tmp_path):
    (tmp_path / "a.html").write_text(
        '<a href="b.html#x">b</a><a href="c.html">c</a><img src="a.png"><script '
        'src="https://x/y.js">'
    )
    (tmp_path / "b.html").write_text("<p id='y'>")
    (tmp_path / "a.png").touch()
    assert len(faults(tmp_path)) == 4
