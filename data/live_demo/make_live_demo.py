"""
Measure a live study on this machine, and take pictures of its pages: what notebook 11 shows where
it cannot do so itself.

    .venv/bin/python data/live_demo/make_live_demo.py        # five minutes; needs Chromium and an
    otherwise idle machine

Scripted hands drive and scripted participants send commands; no person takes part.
"""

import csv
import os
import runpy
import sys
import tempfile
from pathlib import Path

import numpy as np

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
sys.path.insert(0, str(ROOT))

from benchmarks.live import CLIENTS, DRIVE, PEOPLE, browsers, load, losses  # noqa: E402


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
    taken = runpy.run_path(str(ROOT / "notebooks" / "live_pictures.py"))["taken"]
    for name, picture in taken().items():
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
