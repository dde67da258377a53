"""
Every page as a reader has it: in Chromium at three widths, by pointer, keyboard and screen reader
(axe-core's rules).
"""

import base64
import itertools
import re
import shutil
from pathlib import Path
from unittest import mock
from urllib.parse import unquote

import matplotlib as mpl
import nbformat
import numpy as np
import pytest
from IPython.core.interactiveshell import InteractiveShell
from nbformat.v4 import new_code_cell, new_markdown_cell, new_notebook, new_output

from trustlab.publishing import figures
from trustlab.publishing.notebooks import publish
from trustlab.publishing.provenance import Checkout

ROOT = Path(__file__).parents[2]
BROWSER = next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None
)
WIDTHS = (1280, 1440, 390)
MOST_BYTES = 2_500_000
PAGE_WIDTH = 972 * 0.75  # of a figure on the page [pt]
LEAST_TEXT = 8.0  # [pt]
PAPER = 718  # width of A4 within margins of 1 cm [px]


@pytest.fixture(scope="module")
def browser():
    sync_api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    if BROWSER is None:
        pytest.skip("needs Chromium: apt-get install chromium")
    with sync_api.sync_playwright() as playwright:
        chromium = playwright.chromium.launch(
            executable_path=BROWSER, args=["--no-sandbox", "--disable-gpu"]
        )
        yield chromium
        chromium.close()


def drawn(figure):
    """Return a cell with a figure as a notebook keeps it."""
    shell = InteractiveShell.instance()
    try:
        figures.use_house_style()
        picture, about = shell.display_formatter.formatters["image/svg+xml"](figure)
    finally:
        InteractiveShell.clear_instance()
    return cell({"image/svg+xml": picture}, {"image/svg+xml": about})


def cell(data, metadata=None, tags=()):
    shown = new_code_cell(
        "x = 1", outputs=[new_output("display_data", data=data, metadata=metadata or {})]
    )
    shown.metadata["tags"] = list(tags)
    return shown


def panels(count):
    """Return a figure of several panels in a row, with one named line each."""
    with mpl.rc_context(), mock.patch.dict("os.environ", TRUSTLAB_REPORT="1"):
        figures.use_house_style()
        figure = mpl.figure.Figure(figsize=(10.0, 2.6), layout="constrained")
        for axes in np.atleast_1d(figure.subplots(1, count)):
            axes.plot([0.0, 1.0, 3.0], [5.0, 1.0, 2.0], label="measured")
            axes.set(
                xlim=(0.0, 4.0),
                ylim=(0.0, 6.0),
                xlabel="time [s]",
                ylabel="distance [m]",
                title="one run",
            )
        figures.caption(figure, "What is measured.", synthetic=True)
        return drawn(figure)


def world(root):
    """
    Publish a notebook with all that a report can hold, as if it had run, beside one that it names.
    """
    (root / "notebooks").mkdir(parents=True)
    (root / "data" / "published").mkdir(parents=True)
    (root / "environment.lock").touch()
    shutil.copy(ROOT / "data" / "published" / "equations.toml", root / "data" / "published")
    finder = (ROOT / "notebooks" / "finder.csv").read_text(encoding="utf-8").splitlines()
    listed = [
        finder[0],
        "Fig. 2.3,what it is,reproduced,,02_b,Where it is",
        "Fig. 2.1,the testbed,diagram only,,,",
    ]
    (root / "notebooks" / "finder.csv").write_text("\n".join(listed) + "\n", encoding="utf-8")
    rows = "".join(
        f"<tr><th>Fig. 2.3</th><td>{i}</td><td>{i / 40:.3f}</td><td>{'long ' * 30}</td></tr>"
        for i in range(40)
    )
    heads = "".join(f"<th>{name}</th>" for name in ("place", "number", "p_holm", "why"))
    table = f"<table><thead><tr>{heads}</tr></thead><tbody>{rows}</tbody></table>"
    words = (
        "# A title\n\nBy (2.3) and report 02.\n\n## One\n\n## Two\n\n### Three\n\n$$P_r = "
        "a$$\n\n## Four"
    )
    words += (
        "\n\n```python\nimport numpy as np  # as axe sees only code that is not folded\n\nx "
        "= np.sqrt(1.5)\n```"
    )
    answer = cell({"text/markdown": "**It holds.** By (2.8)."}, tags=["answer"])
    counted = "".join(f"<tr><th>{i}</th><td>{2 * i}</td><td>p_r</td></tr>" for i in range(4))
    counted = (
        "<table><thead><tr><th></th><th>by "
        f"(2.5)</th><th>b</th></tr></thead><tbody>{counted}</tbody></table>"
    )
    tables = [cell({"text/html": one}) for one in (table, counted)]
    grouped = (
        "<tr><th "
        "rowspan='2'>M</th><th>mean</th><td>1</td></tr><tr><th>SD</th><td>2</td></tr><tr><th>OMI</th><th>n</th>"
    )
    head = "<thead><tr><th></th><th></th><th>value</th></tr></thead>"
    grouped = f"<table>{head}<tbody>{grouped}<td>3</td></tr></tbody></table>"
    tables.append(cell({"text/html": grouped}))
    cells = [new_markdown_cell(words), answer, panels(5), panels(1), *tables]
    nbformat.write(new_notebook(cells=cells), root / "notebooks" / "01_a.ipynb")
    nbformat.write(
        new_notebook(cells=[new_markdown_cell("# B\n\n## Where it is")]),
        root / "notebooks" / "02_b.ipynb",
    )
    return publish_all(root)


def publish_all(root):
    """Publish the notebooks of a folder as they are, as if they had run."""
    with mock.patch(
        "trustlab.publishing.execution.execute", lambda path, *_: nbformat.read(path, as_version=4)
    ):
        publish(checkout=Checkout.find(root))
    return root / "reports"


@pytest.fixture(scope="module")
def reports(tmp_path_factory):
    return world(tmp_path_factory.mktemp("reading"))


def faults(page, path, width):
    """Return what is wrong with a page at one width of the window."""
    asked, said = [], []
    page.on("request", lambda request: asked.append(request.url))
    page.on(
        "console", lambda message: said.append(message.text) if message.type == "error" else None
    )
    page.on("pageerror", lambda error: said.append(str(error)))
    page.set_viewport_size({"width": width, "height": 900})
    page.goto(path.as_uri(), wait_until="load")
    found = [
        f"asks for {url[:80]}"
        for url in asked
        if url != path.as_uri() and not url.startswith("data:")
    ]
    found += [f"says {words}" for words in said]
    wide = page.evaluate(
        "document.documentElement.scrollWidth - document.documentElement.clientWidth"
    )
    if wide > 0:
        found.append(f"is {wide} px wider than the window")
    page.emulate_media(media="print")
    page.set_viewport_size({"width": PAPER, "height": 1000})
    found += page.evaluate(
        "[...document.querySelectorAll('main :is(table, img, pre, .equation)')].filter(one => "
        "one.getBoundingClientRect().right > document.documentElement.clientWidth + 1).map(one "
        "=> `cut off in print: ${one.textContent.slice(0, 60)}`)"
    )
    found += page.evaluate(
        "[...document.images].filter(one => !one.hasAttribute('alt')).map(() => 'an image "
        "without alt')"
    )
    found += page.evaluate(
        "[...document.querySelectorAll('figure img')].filter(one => !one.alt && "
        "!one.closest('[role=img]')).map(() => 'a figure without words')"
    )
    return found


def lost_links(path):
    """Return links of a page that lead nowhere: to no file, or to no place in it."""
    lost = []
    for link in set(re.findall(r'<a\b[^>]*\bhref="([^"]*)"', path.read_text(encoding="utf-8"))):
        if link.startswith(("https:", "mailto:")) or link == "#":
            continue
        name, _, anchor = link.partition("#")
        to = path.parent / name if name else path
        if not to.is_file() or (anchor and f'id="{anchor}"' not in to.read_text(encoding="utf-8")):
            lost.append(link)
    return lost


def small_text(path):
    """
    Return sizes of text in the figures of a page that are too small where they are as wide as the
    page [pt].
    """
    small = []
    figure = r'<figure><img[^>]*src="data:image/svg\+xml;base64,([^"]*)"'
    for data in re.findall(figure, path.read_text(encoding="utf-8")):
        picture = base64.b64decode(data).decode()
        found = re.search(r'width="([\d.]+)pt"', picture)  # as Matplotlib writes it
        width = float(found[1]) if found else 0.0
        # Matplotlib draws letters at a size of 100 and scales them to theirs; half of the size is
        # an index.
        sizes = [
            100.0 * float(size)
            for size in re.findall(r'<g [^>]*transform="translate[^"]*scale\(([\d.]+) -', picture)
        ]
        small += [
            size for size in sizes if size * min(1.0, PAGE_WIDTH / max(width, 1.0)) < LEAST_TEXT
        ]
    return small


def serious(page, path):
    """Return what axe-core finds serious."""
    axe = pytest.importorskip(
        "axe_playwright_python.sync_playwright", reason="axe-playwright-python is not installed"
    )
    page.goto(path.as_uri(), wait_until="load")
    found = axe.Axe().run(page).response["violations"]
    return [
        (one["id"], [node["target"] for node in one["nodes"]][:3])
        for one in found
        if one["impact"] in ("serious", "critical")
    ]


def walked(browser, pages, widths=WIDTHS):
    """Walk pages and return what is wrong, by page."""
    wrong = {}
    for path in sorted(pages):
        found = [
            f"at {width}: {fault}"
            for width in widths
            for fault in visited(browser, faults, path, width)
        ]
        found += [f"no such place: {link}" for link in lost_links(path)]
        found += [f"axe: {rule}" for rule in visited(browser, serious, path)]
        found += [f"text of {size:.1f} pt" for size in small_text(path)]
        if path.stat().st_size > MOST_BYTES:
            found.append(f"has {path.stat().st_size} bytes")
        if found:
            wrong[path.name] = list(dict.fromkeys(found))
    return wrong


def visited(browser, look, *where):
    page = browser.new_page()
    try:
        return look(page, *where)
    finally:
        page.close()


def test_pages_are_complete_fit_their_window_and_can_be_read_by_all(browser, reports):
    assert {path.name for path in reports.glob("*.html")} == {
        "01_a.html",
        "02_b.html",
        "index.html",
    }
    assert walked(browser, reports.glob("*.html")) == {}


def test_the_walk_finds_what_is_wrong(browser, reports, tmp_path):
    shutil.copytree(reports, tmp_path / "reports")
    page = tmp_path / "reports" / "01_a.html"
    text = page.read_text(encoding="utf-8")
    spoiled = (
        "<img src='http://127.0.0.1:9/x.png' alt=''><img "
        "src='data:image/png;base64,AA'><button></button>"
    )
    spoiled += "<div style='width: 200rem'>wide</div>"
    text = (
        text.replace("By <a", f"{spoiled}By <a", 1)
        .replace("#where-it-is", "#nowhere")
        .replace("#eq-2-3", "#eq-9-9")
    )
    page.write_text(text, encoding="utf-8")
    found = " ".join(walked(browser, [page], widths=[390])["01_a.html"])
    assert re.search(
        "at 390: says .*x.png.* px wider than the window.*an image without alt.*"
        r"no such place: .*axe: \('button-name'",
        found,
    )
    assert "no such place: 02_b.html#nowhere" in found
    assert "no such place: index.html#eq-9-9" in found


def test_figure_is_explored_by_pointer_and_keyboard(browser, reports):
    page = browser.new_page(viewport={"width": 1280, "height": 900})
    page.goto((reports / "01_a.html").as_uri())
    figure = page.locator("figure").nth(1)
    figure.get_by_role("button", name="explore").click()
    view, told = figure.get_by_role("application"), figure.locator("output")
    readings = view.evaluate("""view => {
        const box = view.getBoundingClientRect();
        const told = view.closest("figure").querySelector("output");
        const found = [];
        for (let x = 1; x < box.width; x += 8) for (let y = 1; y < box.height; y += 3) {
            const place = { clientX: box.left + x, clientY: box.top + y };
            view.dispatchEvent(new PointerEvent("pointermove", place));
            found.push(told.textContent);
        }
        return found;
    }""")
    found = [
        re.match(r"time \[s\]: ([\d.]+); distance \[m\]: ([\d.]+)", words) for words in readings
    ]
    across, up = np.array([[float(one[1]), float(one[2])] for one in found if one]).T
    # The pointer comes within a step of the ends of both axes, and to each corner of the line.
    assert (across.min(), across.max(), up.min(), up.max()) == pytest.approx(
        (0.0, 4.0, 0.0, 6.0), abs=0.2
    )
    for corner in ("5 at 0", "1 at 1", "2 at 3"):
        assert any(f"measured: {corner}" in words for words in readings)
    view.hover()
    before = told.inner_text()
    view.focus()
    page.keyboard.press("ArrowLeft")
    assert told.inner_text() != before
    page.keyboard.press("+")
    assert "scale(1.5)" in view.locator("img").get_attribute("style")
    page.keyboard.press("0")
    assert "scale(1)" in view.locator("img").get_attribute("style")
    page.close()


def test_panels_come_one_below_the_other_on_a_phone(browser, reports):
    page = browser.new_page(viewport={"width": 390, "height": 900})
    page.goto((reports / "01_a.html").as_uri())
    several = page.locator("figure").first
    images = several.locator(".panels img")
    # The page takes the figure apart once its picture is loaded.
    page.wait_for_function(
        "() => document.querySelector('figure').querySelectorAll('.panels img').length === 6"
    )
    boxes = [
        one.bounding_box() for one in images.all()
    ]  # five panels and the mark that they are synthetic
    assert all(
        above["y"] + above["height"] <= below["y"] for above, below in itertools.pairwise(boxes)
    )
    assert (
        several.get_by_role("img")
        .first.get_attribute("aria-label")
        .startswith("5 panels. one run; ")
    )
    page.set_viewport_size({"width": 1280, "height": 900})
    page.wait_for_function(
        "() => document.querySelector('figure').querySelectorAll('img').length === 1"
    )
    page.close()


def test_five_findings_stand_on_the_index_and_the_others_are_folded(tmp_path):
    notebooks = [nbformat.read(path, as_version=4) for path in (ROOT / "notebooks").glob("*.ipynb")]
    assert sum(bool(one.metadata["trustlab"].get("finding")) for one in notebooks) == 5
    (tmp_path / "notebooks").mkdir()
    (tmp_path / "environment.lock").touch()
    for number in (1, 2, 3):
        answer = cell({"text/markdown": f"**Finding {number}.** More."}, tags=["answer"])
        about = {"trustlab": {"finding": True} if number == 2 else {}}
        one = new_notebook(cells=[new_markdown_cell(f"# Title {number}"), answer], metadata=about)
        nbformat.write(one, tmp_path / "notebooks" / f"0{number}_a.ipynb")
    index = (publish_all(tmp_path) / "index.html").read_text(encoding="utf-8")
    first, folded = index[index.index('id="findings"') : index.index('id="reports"')].split(
        "<details>"
    )
    assert re.findall(r"Finding \d", first) == ["Finding 2"]
    assert re.findall(r"Finding \d", folded) == ["Finding 1", "Finding 3"]


def test_a_panel_on_a_phone_shows_nothing_of_its_neighbours(browser, reports):
    page = browser.new_page(viewport={"width": 390, "height": 900})
    page.goto((reports / "01_a.html").as_uri())
    several = page.locator("figure").first
    page.wait_for_function(
        "() => document.querySelector('figure').querySelectorAll('.panels img').length === 6"
    )
    drawn = [unquote(one.get_attribute("src")) for one in several.locator(".panels img").all()]
    seen = [re.findall(r'<g id="(axes_\d)"(?! visibility="hidden")', picture) for picture in drawn]
    assert seen == [
        [],
        *([f"axes_{number}"] for number in range(1, 6)),
    ]  # first the mark that they are synthetic
    assert all(
        re.search("<defs>", picture) for picture in drawn
    )  # the letters, which one panel defines for all
    page.close()


def test_figure_that_stays_whole_is_scrolled_on_a_phone_so_that_it_can_be_read(browser, reports):
    page = browser.new_page(viewport={"width": 390, "height": 900})
    page.goto((reports / "01_a.html").as_uri())
    region = page.locator("figure").nth(1).locator(".wide")
    page.wait_for_function("() => document.querySelectorAll('figure .wide img').length === 1")
    image = region.locator("img")
    drawn = base64.b64decode(image.get_attribute("src").partition(",")[2]).decode()
    width = float(re.search(r'viewBox="0 0 ([\d.]+)', drawn)[1])
    # A point of the drawing is a pixel at least: letters of 8 pt are 8 px high. The page itself is
    # not wider for it.
    assert image.bounding_box()["width"] >= width - 0.5 > region.bounding_box()["width"]
    assert page.evaluate("document.documentElement.scrollWidth") == 390
    assert region.get_attribute("tabindex") == "0"
    region.evaluate("one => one.scrollTo(1000, 0)")
    assert region.evaluate(
        "one => Math.abs(one.scrollLeft + one.clientWidth - one.scrollWidth) <= 1"
    )
    page.emulate_media(media="print")
    assert image.bounding_box()["width"] <= 390
    page.emulate_media(media="screen")
    page.locator("figure").nth(1).get_by_role("button", name="explore").click()
    assert page.locator("figure").nth(1).locator(".wide").count() == 0  # zoomed instead
    assert page.evaluate("document.documentElement.scrollWidth") == 390
    page.close()


def test_first_column_stays_where_rows_are_grouped_too(browser, reports):
    page = browser.new_page(viewport={"width": 390, "height": 900})
    page.goto((reports / "01_a.html").as_uri())
    table = page.locator("main .scroll").nth(2)
    stays = (
        "cells => cells.filter(one => getComputedStyle(one).position === 'sticky').map(one "
        "=> one.textContent)"
    )
    assert table.locator("tbody :is(th, td)").evaluate_all(stays) == ["M", "OMI"]
    page.close()


def test_long_table_is_folded_filtered_sorted_and_saved(browser, reports):
    page = browser.new_page(viewport={"width": 1280, "height": 900})
    page.goto((reports / "01_a.html").as_uri())
    rows = page.locator("main .scroll").first.locator("tbody tr:visible")
    assert rows.count() == 15
    page.get_by_role("button", name="show all 40 rows").click()
    assert rows.count() == 40
    page.get_by_role("button", name="number", exact=True).click()
    page.get_by_role("button", name="number", exact=True).click()
    assert rows.first.locator("td").first.inner_text() == "39"
    page.get_by_role("searchbox").fill("0.325")
    assert rows.count() == 1
    page.emulate_media(media="print")
    page.get_by_role("searchbox", include_hidden=True).evaluate(
        "one => { one.value = ''; one.dispatchEvent(new Event('input')) }"
    )
    assert rows.count() == 40  # on paper nothing is folded
    page.emulate_media(media="screen")
    saved = page.get_by_role("link", name="CSV").first
    saved.evaluate("one => one.addEventListener('click', event => event.preventDefault())")
    saved.click()
    assert saved.get_attribute("href").startswith(
        "data:text/csv;charset=utf-8,place%2Cnumber%2Cp_holm%2Cwhy%0A"
    )
    page.close()


def test_rows_that_are_only_counted_lose_their_count(browser, reports):
    page = browser.new_page(viewport={"width": 1280, "height": 900})
    page.goto((reports / "01_a.html").as_uri())
    table = page.locator("main .scroll").nth(1)
    assert table.locator("tr").first.inner_text().split() == ["by", "(2.5)", "b"]
    assert table.locator("tr").nth(1).inner_text().split() == ["0", "robot", "performance", "P_r"]
    assert table.locator("button a").count() == 0  # a link within a button is none
    page.close()


@pytest.mark.long
def test_all_reports_are_complete_fit_their_window_and_can_be_read_by_all(browser, tmp_path):
    built = publish(checkout=Checkout.find(ROOT, reports=tmp_path))
    assert {one.state for one in built} == {"built"}
    assert walked(browser, tmp_path.glob("*.html")) == {}
