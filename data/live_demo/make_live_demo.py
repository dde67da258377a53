"""
Measure a live study on this machine, and take pictures of its pages in Chromium, which notebook 11
shows.

    .venv/bin/python data/live_demo/make_live_demo.py        # five minutes; needs Chromium and an
    otherwise idle machine

Scripted hands drive and scripted participants send commands; no person takes part.
"""

import csv
import os
import shutil
import sys
import tempfile
import time
import warnings
from pathlib import Path

import numpy as np

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
sys.path.insert(0, str(ROOT))

import trustlab as tl  # noqa: E402
from benchmarks.live import CLIENTS, DRIVE, PEOPLE, browsers, load, losses  # noqa: E402
from trustlab.live.study.drives import stand_in  # noqa: E402
from trustlab.live.study.server import StudyServer  # noqa: E402

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
                    other.add("model", page=step.index, attempt=0, **stand_in(plan, ""))
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


def figures():
    """Yield case, figure, value, unit and goal of everything that is measured."""
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        found = load(Path(folder) / "study")
        waits = np.array(found["waits_ms"])
        case = f"{PEOPLE} scripted participants without a browser"
        figure = "command on disk and acknowledged"
        yield case, f"{figure}, median", np.median(waits), "ms", ""
        yield case, f"{figure}, 99th percentile", np.percentile(waits, 99), "ms", "≤ 50"
        yield case, "acknowledged commands lost", found["lost"], "", "0"
        yield case, "memory of the server", found["memory_mb"], "MB", ""
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        found = browsers(Path(folder) / "study")
        period = 1e3 * np.array(found["periods"])
        case = f"one page in Chromium beside {CLIENTS} scripted participants, {DRIVE:g} s"
        yield case, "log period, median", np.median(period), "ms", "100"
        yield case, "log period, longest", period.max(), "ms", "≤ 200"
        yield case, "frames per second", found["fps"], "1/s", "≥ 58"
        yield case, "pictures are shown late by", found["delay_ms"], "ms", ""
        yield case, "memory of the server", found["memory_mb"], "MB", "≤ 400"
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        for loss in losses(Path(folder) / "study"):
            figure = f"acknowledged commands lost of {loss['commands']}"
            yield loss["what"], figure, loss["lost"], "", "0"


def main():
    """Write measured.csv and the pictures."""
    for name, picture in pictures().items():
        (HERE / f"{name}.png").write_bytes(picture)
    with (HERE / "measured.csv").open("w", encoding="utf-8", newline="") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(["case", "figure", "value", "unit", "goal", "load", "cores"])
        for case, figure, value, unit, goal in figures():
            row = [
                case,
                figure,
                f"{value:.4g}",
                unit,
                goal,
                f"{os.getloadavg()[0]:.1f}",
                os.cpu_count(),
            ]
            table.writerow(row)
            file.flush()
            print(*row, sep=" | ", flush=True)


if __name__ == "__main__":
    main()
