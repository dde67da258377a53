"""Whole runs on small notebooks, in a repository of their own, to pages in a browser."""

import os
import re
import signal
import subprocess
import sys
import time
from unittest import mock

import pandas as pd
import psutil
import pytest
from nbformat.v4 import new_code_cell

from tests.publishing.world import (
    ROOT,
    faults,
    make,
    pages,
    publish,
    run,
    serious,
    tagged,
    walked,
    write_book,
)
from trustlab.publishing.run import CellError, execute

ATTACK = '<img src="https://attacker.invalid/" onerror="fire()">'
GOOD = [
    "# A good one\n\nIt shows $\\overline{P}_h$, and succeeds as in (2.3) and in report “plain”. "
    "See Table 01-1.",
    tagged("seed = 7\nsize = 2", "parameters"),
    new_code_cell(
        "from IPython.display import Markdown\nimport pandas as pd\n"
        "from matplotlib import pyplot\nfrom trustlab.publishing import caption, use_house_style\n"
        "use_house_style()\nprint('seed is', seed)"
    ),
    "## Figures",
    new_code_cell(
        "for name in 'ab':\n    figure, axes = pyplot.subplots()\n"
        "    axes.plot([1, 2, 3], [3, 4, 5], label='rise')\n"
        "    caption(axes, f'Figure of {name}.', synthetic='made up')"
    ),
    "## Tables",
    new_code_cell(
        "rows = range(60)\nnames = [f'n{i}' for i in rows]\n"
        "p = [0.0595 - i / 1000 for i in rows]\n"
        "pd.DataFrame({'name': names, 'p_holm': p, 'eta2': [i + 0.5 for i in rows]})"
    ),
    new_code_cell("caption(pd.DataFrame({'x': [1, 2]}), 'What *x* is.', synthetic=True)"),
    new_code_cell("import pathlib\nprint('data at', pathlib.Path.cwd().parent / 'data')"),
    new_code_cell(f"name = {ATTACK!r}\nprint(name)\nname"),
    tagged("Markdown('**It holds.** By (2.8).')", "hide", "answer"),
]
ABSENT = [
    "# Of data\n\nWords.",
    new_code_cell("from trustlab.publishing import required_data\nrequired_data('nowhere')"),
    new_code_cell("print('half a page')"),
]
FOLDERS = ("notebooks", "docs")
BAD = [
    "# A bad one",
    tagged("x = 0", "parameters"),
    new_code_cell("print('half a page')"),
    new_code_cell("y = 1 / x"),
]


# One worker, which makes the small book once.
pytestmark = pytest.mark.xdist_group("publish")


@pytest.fixture(scope="module", autouse=True)
def environment():
    """Keep what a run sets for its kernels from other tests."""
    with mock.patch.dict(os.environ, PYTHONPATH=str(ROOT)):
        yield


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    root = make(
        tmp_path_factory.mktemp("book"),
        n01_good=GOOD,
        n02_bad=BAD,
        n03_plain=["# Plain\n\nSee Table 01-9 and Figure 02-9."],
        n04_of_data=ABSENT,
    )
    return root, publish(root, parameters="-p seed 5"), write_book(root)


def html(root, name):
    return (root / "reports" / f"{name}.html").read_text(encoding="utf-8")


def test_a_report_has_its_answer_figures_tables_and_origin(world):
    root, done, _ = world
    text = html(root, "01_good")
    assert "01_good … run in " in done.stdout
    assert text.count("attacker.invalid") == 3  # the cell, what it prints, and its value
    assert ATTACK not in text
    assert text.index("It holds.") < text.index("seed is 5")
    assert text.count("It holds.") == 1
    for words in (
        '<img[^>]* alt="Synthetic data: made up. Figure of a',
        '<img[^>]* alt="Synthetic data: made up. Figure of b',
        "Figure 01-1 .*Synthetic data: made up. Figure of a.",
        "Figure 01-2 .*Synthetic data: made up. Figure of b.",
        "Table 01-1 .*Synthetic data. What <em>x</em> is.",
        'href="concepts/equations.html#eq-2-3"',
        'href="03_plain.html">report “plain”</a>',
        '<a [^>]*href="[^"]*#[^"]+">Table 01-1</a>',
        "<math",
        '<mover accent="true">',
        r'id="provenance"[\s\S]*Parameter seed',
    ):
        assert re.search(words, text), words


def test_a_table_that_is_cited_exists(world):
    *_, book = world
    assert book.returncode != 0
    (said,) = re.findall("WARNING: (.*)", book.stderr)
    # 02 failed, and has no figures at all.
    assert said == "Table 01-9 is cited, which report 01 does not have"


def test_no_path_of_this_machine_is_in_a_report(world):
    root, *_ = world
    for path in pages(root / "reports"):
        assert str(root) not in path.read_text()
    assert "data at ./data" in html(root, "01_good")


def test_a_notebook_that_fails_is_named_and_shows_nothing_else(world):
    root, done, _ = world
    assert done.returncode != 0
    states = re.findall(r"^(\d\d)_\w+ … (\w+) in", done.stdout, re.M)
    expected = [("01", "run"), ("02", "failed"), ("03", "run"), ("04", "skipped")]
    assert sorted(states) == expected
    assert "02_bad failed in cell 4:\n\ny = 1 / x" in done.stderr
    assert "ZeroDivisionError: division by zero" in done.stderr
    assert "\x1b" not in done.stderr
    text = html(root, "02_bad")
    assert "A bad one" in text
    assert "This report failed." in text
    assert "ZeroDivisionError" in text
    assert "half a page" not in text


def test_a_report_whose_data_are_absent_is_not_in_the_book(world):
    root, *_ = world
    text = (root / "docs" / "04_of_data.ipynb").read_text()
    assert "**Skipped: the data set nowhere is not here." in text
    assert "Put it in data/external/nowhere" in text
    assert "half a page" not in text
    assert not (root / "reports" / "04_of_data.html").exists()


def test_run_again_only_where_an_input_changed(world):
    root, *_ = world

    def due():
        """The chapters that Make would run, were the parameters as they were."""
        command = ["make", "-n", "-o", "docs/.parameters", "-f", ROOT / "Makefile"]
        chapters = [f"docs/{path.name}" for path in (root / "notebooks").glob("*.ipynb")]
        return re.findall(r"notebooks/(\d\d)_", run(root, *command, *sorted(chapters)).stdout)

    assert due() == ["02", "04"]  # what failed, and what lacked data
    done = publish(root, "02_bad", "03_plain", parameters="-p x 1")
    ran = re.findall(r"^(\w+ … \w+) in", done.stdout, re.M)
    assert sorted(ran) == ["02_bad … run", "03_plain … run"]
    assert due() == ["04"]
    (root / "data" / "published" / "more.csv").write_text("1\n")
    assert due() == ["01", "02", "03", "04"]
    before = (root / "docs" / "01_good.ipynb").stat().st_mtime_ns
    done = publish(root, "01_good", parameters="-p sed 1")
    assert done.returncode != 0
    assert "one of 'seed', 'size', 'x', got 'sed'; did you mean 'seed'?" in done.stderr
    assert (root / "docs" / "01_good.ipynb").stat().st_mtime_ns == before


def test_a_kernel_that_dies_and_a_cell_without_end_fail_in_their_cells(tmp_path):
    for name, words, limit, fault in (
        ("01_dies", "import os; os._exit(1)", 60.0, "DeadKernelError"),
        ("02_long", "import time; time.sleep(1000)", 1.0, "TimeoutError"),
    ):
        root = make(tmp_path, **{f"n{name}": ["# Ends", new_code_cell(words)]})
        path = root / "notebooks" / f"{name}.ipynb"
        with pytest.raises(CellError, match=rf"cell 2:\n\n{words[:10]}[\s\S]*{fault}"):
            execute(path, {}, path.parent, limit)


def test_an_interrupt_leaves_neither_report_nor_kernel(tmp_path):
    cell = (
        "import os, pathlib, time\npathlib.Path('pid').write_text(str(os.getpid()))\n"
        "time.sleep(1000)"
    )
    root = make(tmp_path, n01_long=["# Long", new_code_cell(cell)])
    process = subprocess.Popen(
        [sys.executable, "-m", "trustlab.publishing", *(f"{f}/01_long.ipynb" for f in FOLDERS)],
        cwd=root,
        stderr=subprocess.PIPE,
        text=True,
        # A job in the background hands down that the signal is ignored.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )
    mark = root / "notebooks" / "pid"
    try:
        while not (mark.exists() and mark.read_text()) and process.poll() is None:
            time.sleep(0.05)
        process.send_signal(signal.SIGINT)
        said = process.communicate(timeout=120)[1]
    finally:
        process.kill()
    assert process.returncode == -signal.SIGINT
    assert said == ""
    kernel = int(mark.read_text())
    deadline = time.monotonic() + 60.0
    while psutil.pid_exists(kernel):
        assert time.monotonic() < deadline
        time.sleep(0.1)
    assert not (root / "docs" / "01_long.ipynb").exists()


def test_pages_are_complete_fit_their_window_and_can_be_read_by_all(world, browser):
    reports = world[0] / "reports"
    paths = [reports / f"{name}.html" for name in ("01_good", "02_bad", "concepts/equations")]
    assert faults(reports) == []
    assert walked(browser, paths, widths=(1280, 390)) == []
    for scheme in ("light", "dark"):
        tab = browser.new_page(color_scheme=scheme)
        assert [fault for path in paths for fault in serious(tab, path)] == []
        tab.close()


def test_tables_sort_filter_and_download(world, browser):
    tab = browser.new_page(viewport={"width": 1280, "height": 900})
    tab.goto((world[0] / "reports" / "01_good.html").as_uri())
    rows = "[...document.querySelector('.cell_output table').tBodies[0].rows]"
    first = f"{rows}[0].cells[0].textContent"
    assert tab.evaluate(f"{rows}.length") == 25
    assert tab.evaluate(first) == "n0"
    tab.click("th:has-text('p, Holm')")
    tab.wait_for_function(f"{first} === 'n59'")  # the least p, written "< .001"
    assert "<\u00a0.001" in tab.evaluate(f"{rows}[0].textContent")
    tab.fill(".dt-search input", "n17")
    assert tab.evaluate(f"{rows}.map(row => row.cells[0].textContent)") == ["n17"]
    with tab.expect_download() as saved:
        tab.click("text=CSV")
    row = pd.read_csv(saved.value.path()).iloc[0].tolist()
    assert row == ["n17", pytest.approx(0.0425, abs=1e-15), 17.5]
    tab.close()
