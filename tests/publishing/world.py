"""
A project that is published as trustlab is, and a walk through its book as a reader's browser sees
it.
"""

import functools
import shutil
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urldefrag

import nbformat
import pytest
from nbformat.v4 import new_code_cell, new_markdown_cell, new_notebook

# --- a project ------------------------------------------------------------------------------------


ROOT = Path(__file__).parents[2]
SETTINGS = """
api_only = "Session$"
suppress_warnings += ["ref.obj", "ref.mod"]
"""
INDEX = """# A small book

```{toctree}
reports
concepts/equations
api/index
```
"""
REPORTS = """# Reports

```{toctree}
:glob:

[0-9][0-9]_*
```
"""


def tagged(source, *tags):
    return new_code_cell(source, metadata={"tags": list(tags)})


def make(root, **notebooks):
    """Make a repository with these notebooks, given as lists of cells; words are Markdown."""
    docs = root / "docs"
    for name in ("notebooks", "data/published", "docs/concepts", "docs/static"):
        (root / name).mkdir(parents=True, exist_ok=True)
    for name in (
        "docs/conf.py",
        "docs/extension.py",
        "docs/concepts/equations.md",
        "data/published/equations.toml",
        "data/published/verdicts.toml",
    ):
        shutil.copy(ROOT / name, root / name)
    shutil.copytree(ROOT / "docs" / "static", docs / "static", dirs_exist_ok=True)
    with (docs / "conf.py").open("a") as file:
        file.write(SETTINGS)
    page = docs / "concepts" / "equations.md"
    page.write_text(page.read_text().replace("[another page](does_not_hold.md)", "another page"))
    (root / "environment.lock").touch()
    (docs / "index.md").write_text(INDEX)
    (docs / "reports.md").write_text(REPORTS)
    for name, cells in notebooks.items():
        cells = [new_markdown_cell(cell) if isinstance(cell, str) else cell for cell in cells]
        about = {"kernelspec": {"name": "python3", "display_name": "Python", "language": "python"}}
        notebook = new_notebook(cells=cells, metadata=about)
        nbformat.write(notebook, root / "notebooks" / f"{name[1:]}.ipynb")
    return root


def publish(root, *names, parameters=""):
    """Let Make run the notebooks of these names, or all; return what it did."""
    names = names or [path.stem for path in (root / "notebooks").glob("*.ipynb")]
    command = ["make", "-f", ROOT / "Makefile", f"VENV={sys.prefix}", "-k", "-j", "3"]
    return run(root, *command, f"PARAMS={parameters}", *(f"docs/{name}.ipynb" for name in names))


def write_book(root):
    """Let Sphinx write the book; return what it did."""
    command = [sys.executable, "-m", "sphinx", "-q", "-N", "-W", "--keep-going"]
    return run(root, *command, "docs", "reports")


def run(root, *command):
    return subprocess.run(command, cwd=root, capture_output=True, text=True)


# --- a walk ---------------------------------------------------------------------------------------


ELSEWHERE = ("http:", "https:", "mailto:", "data:", "javascript:")
WIDTHS = (1280, 1440, 390)
PAPER = 718  # width of A4 within margins of 1 cm [px]
CUT = """[...document.querySelectorAll("pre, .formula, .dt-container")]
    .filter((box) => box.scrollWidth > box.clientWidth)
    .map((box) => box.textContent.slice(0, 80))"""
CUT_IN_PRINT = """[...document.querySelectorAll("main :is(img, figure, .equation)")]
    .filter((box) => box.getBoundingClientRect().right > document.documentElement.clientWidth + 1)
    .map((box) => box.outerHTML.slice(0, 80))"""


class Page(HTMLParser):
    """Links, anchors, pictures and scripts of a page."""

    def __init__(self, path):
        super().__init__()
        self.links = set()
        self.anchors = {""}
        self.loaded = set()
        self.wordless = []
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag, attrs):
        given = dict(attrs)
        self.anchors |= {given[name] for name in ("id", "name") if given.get(name)}
        if tag == "a" and given.get("href"):
            self.links.add(given["href"])
        self.loaded |= {given[name] for name in ("src", "href") if given.get(name) and tag != "a"}
        if tag == "img" and not given.get("alt", "").strip():
            self.wordless.append(given.get("src"))


@functools.cache
def page(path):
    return Page(path)


def pages(folder):
    """The pages of a folder; the theme leaves a template among its scripts."""
    return [path for path in sorted(folder.rglob("*.html")) if "_static" not in path.parts]


def faults(folder):
    """What is wrong with the links and pictures of the pages of a folder."""
    found = []
    for path in pages(folder):
        own = page(path)
        found += [f"{path.name}: no words for {picture}" for picture in own.wordless]
        outside = ("http:", "https:", "//")
        found += [f"{path.name}: loads {link}" for link in own.loaded if link.startswith(outside)]
        for link in own.links | own.loaded:
            place, anchor = urldefrag(link)
            if link.startswith(ELSEWHERE):
                continue
            target = (path.parent / unquote(place.partition("?")[0])).resolve() if place else path
            if not target.is_file():
                found.append(f"{path.name}: nothing at {link}")
            elif target.suffix == ".html" and unquote(anchor) not in page(target).anchors:
                found.append(f"{path.name}: no anchor at {link}")
    return found


def serious(tab, path):
    """What axe-core finds serious."""
    axe = pytest.importorskip(
        "axe_playwright_python.sync_playwright", reason="axe-playwright-python is not installed"
    )
    tab.goto(path.as_uri(), wait_until="load")
    return [
        (path.name, rule["id"], [node["target"] for node in rule["nodes"]][:3])
        for rule in axe.Axe().run(tab).response["violations"]
        if rule["impact"] in ("serious", "critical")
    ]


def walked(browser, paths, widths=WIDTHS):
    """Walk pages at these widths and on paper; return what is wrong."""
    found = []
    for width in widths:
        tab = browser.new_page(viewport={"width": width, "height": 900})
        tab.on("console", lambda said: found.append(said.text) if said.type == "error" else None)
        tab.on("pageerror", lambda error: found.append(str(error)))
        tab.on(
            "request",
            lambda asked: (
                None
                if asked.url.startswith(("file:", "data:", "blob:"))
                else found.append(asked.url)
            ),
        )
        for path in paths:
            tab.goto(path.as_uri())
            wide = tab.evaluate("document.documentElement.scrollWidth")
            if wide > width:
                found.append(f"{path.name} is {wide} wide at {width}")
            if width >= 1280:
                cut = tab.evaluate(CUT)
                found.extend(f"{path.name}: {words} is cut at {width}" for words in cut)
        tab.close()
    tab = browser.new_page(viewport={"width": PAPER, "height": 1000})
    tab.emulate_media(media="print")
    for path in paths:
        tab.goto(path.as_uri())
        found += [f"{path.name}: cut in print: {words}" for words in tab.evaluate(CUT_IN_PRINT)]
    tab.close()
    return found
