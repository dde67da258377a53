"""
The report of a live study: its notebook, run in the study's folder by the pipeline that makes all
reports.
"""

from __future__ import annotations

import time
from datetime import UTC, datetime
from pathlib import Path

from trustlab.live.study.store import EVENTS, PLAN
from trustlab.models.files import write_atomically
from trustlab.publishing.provenance import Checkout, file_digest, provenance

NOTEBOOK = Path(__file__).with_name("report.ipynb")


def write_report(folder: Path, codes: list[str], path: Path) -> Path:
    """Run the notebook on what a folder holds of these participants, and write its page."""
    from trustlab.publishing.execution import Kernels, anonymous, execute
    from trustlab.publishing.report_page import report_html

    package = Path(__file__).parents[2]
    checkout = Checkout(
        root=package.parent,
        notebooks=folder,
        reports=path.parent,
        package=package,
        data=package.parent / "data",
        lock=package.parent / "environment.lock",
        external=folder / "none",
    )
    clock, started = time.monotonic(), datetime.now(UTC).isoformat(timespec="seconds")
    origin = provenance(checkout, NOTEBOOK, {}, started)
    origin["inputs"] = {
        file.relative_to(folder).as_posix(): file_digest(file)
        for file in [
            folder / PLAN,
            *(folder / code / f"{EVENTS}.jsonl" for code in codes),
            *sorted(folder.glob("*/*.csv")),
        ]
    }
    kernels = Kernels(checkout, threads=1)
    try:
        run = execute(NOTEBOOK, {}, kernels)
    finally:
        kernels.end()
    origin["seconds"] = time.monotonic() - clock
    page, _ = report_html(run, NOTEBOOK.stem, origin, {}, folder)
    page = anonymous(page, checkout).replace(str(folder), folder.name)
    alone = page.replace(
        '<a href="index.html">← All reports</a>', "<span></span>", 1
    )  # there are no others beside it
    write_atomically(path.absolute(), alone)
    return path
