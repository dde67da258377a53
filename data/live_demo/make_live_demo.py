"""
Take pictures of the pages of a live study in Chromium, which notebook 11 shows.

    .venv/bin/python data/live_demo/make_live_demo.py

A scripted hand drives; no person takes part.
"""

import shutil
import tempfile
import time
import warnings
from pathlib import Path

import trustlab as tl
from trustlab.live.fit import stand_in
from trustlab.live.study.server import StudyServer

HERE = Path(__file__).parent
SIZE = {"width": 1000, "height": 720}


def pictures():
    """Return pictures of pages as PNG by name, of a study of two that is served meanwhile."""
    from playwright.sync_api import sync_playwright

    names = ("chromium", "chromium-browser", "google-chrome")
    options = {
        "executable_path": next(filter(None, map(shutil.which, names))),
        "args": ["--no-sandbox", "--disable-gpu"],
    }
    shown = {}
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
            shown["consent"] = page.locator("main").screenshot()
            page.click("input[type=checkbox]")
            page.click("form button")
            page.click("main > button")
            page.wait_for_selector("canvas")
            page.keyboard.down("ArrowUp")
            time.sleep(1.5)  # on the course, which a straight way soon leaves
            shown["drive"] = page.locator("main").screenshot()
            other = server.participant("P02")
            for step in other.steps:
                if step.page.name == "nasa_tlx":
                    break
                facts = {"page": step.index, "name": step.page.name, "attempt": 0, "link": ""}
                other.add("page", **facts)  # as if P02 had come so far
                if step.page.name == "identification":
                    other.add("model", page=step.index, attempt=0, **stand_in(plan.content, ""))
            second = browser.new_page(viewport=SIZE)
            second.goto(links["P02"])
            second.wait_for_selector("fieldset")
            shown["workload"] = second.locator("main").screenshot()
            third = browser.new_page(viewport={"width": 1200, "height": 420})
            third.goto(server.experimenter)
            third.wait_for_selector("tbody tr")
            shown["experimenter"] = third.screenshot()
        browser.close()
    return shown


def main():
    """Write the pictures."""
    for name, picture in pictures().items():
        (HERE / f"{name}.png").write_bytes(picture)


if __name__ == "__main__":
    main()
