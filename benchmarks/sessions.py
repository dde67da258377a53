"""Reading ten million rows with every check, beside pandas.read_csv without any."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pyarrow as pa
from pyarrow import csv

from benchmarks.timing import Row

SIZE = 10_000_000
MEASURED = """
import resource, time
most = lambda: resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
import trustlab as tl, pandas as pd, pyarrow.csv; tl.read_session
before, began = most(), time.perf_counter()
data = {}({!r})
print(time.perf_counter() - began, most() - before)
"""


def rows() -> Iterator[Row]:
    """Yield time and memory, each side in fresh processes in turn."""
    rng, t = np.random.default_rng(0), np.round(0.001 * np.arange(SIZE), 3)
    columns = {"t": t, "mode": (t % 100.0 > 50.0) * 1.0}
    columns |= {name: rng.random(SIZE) for name in ("p_r", "p_h")}
    with tempfile.TemporaryDirectory() as folder:
        path = str(Path(folder) / "run.csv")
        csv.write_csv(pa.table(columns), path)
        readers = ("tl.read_session", "pd.read_csv")
        measured(readers[0], path)  # now the file is in the system's memory
        turns = np.array([[measured(read, path) for read in readers] for _ in range(3)])
    ours, theirs = (1e3 * turns[:, :, 0]).T.tolist()
    ratios = (turns[:, 1, 0] / turns[:, 0, 0]).tolist()
    memory = np.median(turns[:, :, 1], axis=0)
    met = bool(np.median(ratios) >= 1 / 1.4 and memory[0] <= 1.5 * memory[1])
    note = f"memory on top of the imports: {memory[0]:.0f} and {memory[1]:.0f} MB"
    work, peer = f"read_session, CSV of {SIZE:,} rows", "pandas.read_csv, no checks"
    goal = "ratio ≥ 0.714, memory ≤ 1.5 ×"
    yield Row(work, ours, peer, theirs, ratios, goal, met, note)


def measured(read: str, path: str) -> tuple[float, float]:
    """Return the seconds and the megabytes that reading takes in a process of its own."""
    # pandas reads with several threads, which no variable limits: so may Arrow.
    threads = {name: text for name, text in os.environ.items() if "_NUM_THREADS" not in name}
    command = [sys.executable, "-c", MEASURED.format(read, path)]
    said = subprocess.check_output(command, text=True, env=threads)
    seconds, megabytes = map(float, said.split())
    return seconds, megabytes
