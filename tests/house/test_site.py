"""
The built documentation: links and anchors lead somewhere, pictures have words, and pages show well
without a network.
"""

import functools
import os
import shutil
import subprocess
import sys
from html.parser import HTMLParser
from urllib.parse import unquote, urldefrag

import pytest

import trustlab as tl
from tests.house.documents import ROOT
from tests.publishing.test_reading import serious

ELSEWHERE = ("http:", "https:", "mailto:", "data:", "javascript:")
MOST_BYTES = 2.5e6
CUT = """[...document.querySelectorAll("pre, .formula")]
    .filter((box) => box.scrollWidth > box.clientWidth)
    .map((box) => box.textContent.slice(0, 80))"""


def build(folder, *options):
    """
    Build the documentation from a copy of its sources, so that tests at the same time keep out of
    each other's way.
    """
    source = folder / "tree" / "docs"
    shutil.copytree(ROOT / "docs", source, ignore=shutil.ignore_patterns("api", "__pycache__"))
    for name in ("data", "notebooks", "reports"):
        (source.parent / name).symlink_to(ROOT / name)
    command = [
        sys.executable,
        "-m",
        "sphinx",
        "-q",
        "-W",
        "--keep-going",
        *options,
        str(source),
        str(folder / "docs"),
    ]
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    done = subprocess.run(command, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-3000:]
    return folder / "docs"


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    return build(tmp_path_factory.mktemp("site"), "-j", "2")


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
        found += [
            f"{path.name}: loads {link}"
            for link in own.loaded
            if link.startswith(("http:", "https:", "//"))
        ]
        for link in own.links | own.loaded:
            place, anchor = urldefrag(link)
            if link.startswith(ELSEWHERE) or (link in own.loaded and link.startswith("http")):
                continue
            target = (path.parent / unquote(place.partition("?")[0])).resolve() if place else path
            if folder.resolve() not in target.parents and target != path:
                continue  # the reports beside the site, which are there once they have run
            if not target.is_file():
                found.append(f"{path.name}: nothing at {link}")
            elif target.suffix == ".html" and unquote(anchor) not in page(target).anchors:
                found.append(f"{path.name}: no anchor at {link}")
    return found


def sizes(folder):
    """The size of every page with what it loads [B]."""
    for path in pages(folder):
        loaded = {
            (path.parent / urldefrag(link)[0].partition("?")[0]).resolve()
            for link in page(path).loaded
        }
        yield (
            path.name,
            path.stat().st_size + sum(each.stat().st_size for each in loaded if each.is_file()),
        )


@pytest.mark.xdist_group("docs")
def test_site_without_most_of_its_api(tmp_path):
    folder = build(
        tmp_path,
        "-D",
        "api_only=(fit_robot|Session)$",
        "-D",
        "nitpicky=0",
        "-D",
        "suppress_warnings=ref.obj,ref.mod",
    )
    assert faults(folder) == []
    assert (folder / "api" / "fit_robot.html").is_file()


@pytest.mark.long
def test_whole_site(site):
    assert faults(site) == []
    assert {name: size for name, size in sizes(site) if size > MOST_BYTES} == {}
    names = {name for name in tl.__all__ if not isinstance(getattr(tl, name), type(tl))}
    assert {name for name in names if not (site / "api" / f"{name}.html").is_file()} == set()


@pytest.mark.long
def test_pages_in_a_browser(site):
    from playwright.sync_api import sync_playwright

    chromium = shutil.which("chromium") or shutil.which("chromium-browser")
    if chromium is None:
        pytest.skip("needs Chromium: apt-get install chromium")
    found = []
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium)
        for width in (1280, 1440, 390):
            tab = browser.new_page(viewport={"width": width, "height": 900})
            tab.on(
                "console", lambda said: found.append(said.text) if said.type == "error" else None
            )
            tab.on("pageerror", lambda error: found.append(str(error)))
            tab.on(
                "request",
                lambda asked: None if asked.url.startswith("file:") else found.append(asked.url),
            )
            for path in pages(site):
                tab.goto(path.as_uri())
                wide = tab.evaluate("document.documentElement.scrollWidth")
                if wide > width:
                    found.append(f"{path.name} is {wide} wide at {width}")
                if width >= 1280:
                    found.extend(
                        f"{path.name}: {words} is cut at {width}" for words in tab.evaluate(CUT)
                    )
            tab.close()
        tab = browser.new_page()
        for name in (
            "index",
            "start",
            "api/fit_robot",
            "api/room_models",
            "how_to/recipe",
            "concepts/glossary",
        ):
            found += serious(tab, site / f"{name}.html")
        tab.goto(f"{(site / 'search.html').as_uri()}?q=threshold")
        tab.wait_for_selector("#search-results ul.search li")
        browser.close()
    assert found == []


def test_the_check_sees_what_it_should(tmp_path):
    (tmp_path / "a.html").write_text(
        '<a href="b.html#x">b</a><a href="c.html">c</a><img src="a.png"><script '
        'src="https://x/y.js">'
    )
    (tmp_path / "b.html").write_text("<p id='y'>")
    (tmp_path / "a.png").touch()
    assert len(faults(tmp_path)) == 4
