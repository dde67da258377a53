"""
Pictures of a live study's pages, taken from Chromium; the committed ones where there is no
Chromium.
"""

import shutil
import tempfile
import time
import warnings
from pathlib import Path

import trustlab as tl
from trustlab.live.study.drives import stand_in
from trustlab.live.study.server import StudyServer

COMMITTED = Path(__file__).parents[1] / "data" / "live_demo"
NAMES = ("consent", "drive", "workload", "experimenter")
SIZE = {"width": 1000, "height": 720}


def chromium():
    """Return where Chromium is, if it is, and Playwright to drive it."""
    try:
        import playwright.sync_api  # noqa: F401
    except ImportError:
        return None
    return next(
        filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None
    )


def pictures():
    """Return where the pictures come from, in words, and each as PNG by name."""
    if chromium() is None:
        return "committed pictures; there is no Chromium here", {
            n: (COMMITTED / f"{n}.png").read_bytes() for n in NAMES
        }
    # Playwright's synchronous interface wants a thread without a running loop, which a notebook's
    # own has.
    from concurrent.futures import ThreadPoolExecutor

    with ThreadPoolExecutor(1) as pool:
        return "taken from Chromium as this page was made", pool.submit(taken).result()


def taken():
    """Take the pictures: a study of two, served for as long as that takes."""
    from playwright.sync_api import sync_playwright

    options = {"executable_path": chromium(), "args": ["--no-sandbox", "--disable-gpu"]}
    found = {}
    with (
        tempfile.TemporaryDirectory() as folder,
        warnings.catch_warnings(),
        sync_playwright() as playwright,
    ):
        plan = tl.LiveStudy(Path(folder) / "mystudy", ["C1", "C3"], 2, training=60.0)
        browser = playwright.chromium.launch(**options)
        with StudyServer(plan) as server:
            links = server.links()
            page = browser.new_page(viewport=SIZE)
            page.goto(links["P01"])
            page.wait_for_selector("form")
            found["consent"] = page.locator("main").screenshot()
            page.click("input[type=checkbox]")
            page.click("form button")
            page.click("main > button")
            page.wait_for_selector("canvas")
            page.keyboard.down("ArrowUp")
            time.sleep(1.5)  # on the course, which a straight way soon leaves
            found["drive"] = page.locator("main").screenshot()
            other = server.participant("P02")
            for step in other.steps:
                if step.page.name == "nasa_tlx":
                    break
                facts = {"page": step.index, "name": step.page.name, "attempt": 0, "link": ""}
                other.add("page", **facts)  # as if P02 had come so far
                if step.page.name == "identification":
                    known = stand_in(plan, "")
                    other.add("model", page=step.index, attempt=0, **known)
            second = browser.new_page(viewport=SIZE)
            second.goto(links["P02"])
            second.wait_for_selector("fieldset")
            found["workload"] = second.locator("main").screenshot()
            third = browser.new_page(viewport={"width": 1200, "height": 420})
            third.goto(server.experimenter)
            third.wait_for_selector("tbody tr")
            found["experimenter"] = third.screenshot()
        browser.close()
    return found
