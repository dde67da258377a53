"""
Reading a session of 20,000 rows, and one of ten million, with every check, beside pandas.read_csv
without any.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
from pyarrow import csv

import trustlab as tl
from benchmarks.data import session
from benchmarks.timing import Row, Spread, here, in_turns

TITLE = "Reading a session"
MEASURED = """
import resource, sys, time
most = lambda: resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
import trustlab as tl, pandas as pd, pyarrow.csv; tl.read_session
before, began = most(), time.perf_counter()
data = {}
print(time.perf_counter() - began, most() - before)
"""


def rows() -> Iterator[Row]:
    """Yield the comparison of a session of usual length, for information, and of a long one."""
    yield _usual()
    yield _long(10_000_000)


def _long(size: int) -> Row:
    """Compare time and memory, each side in fresh processes in turn."""
    rng, t = np.random.default_rng(0), np.round(0.001 * np.arange(size), 3)
    columns = {
        "t": t,
        "mode": (t % 100.0 > 50.0) * 1.0,
        "p_r": rng.random(size),
        "p_h": rng.random(size),
    }
    with tempfile.TemporaryDirectory() as folder:
        path = str(Path(folder) / "run.csv")
        csv.write_csv(pa.table(columns), path)
        turns = [
            [_measured(f"{read}({path!r})") for read in ("tl.read_session", "pd.read_csv")]
            for _ in range(3)
        ]
    ours_s, peer_s = ([turn[side][0] for turn in turns] for side in (0, 1))
    ratio = Spread.of([peer / ours for ours, peer in zip(ours_s, peer_s, strict=True)])
    ours_mb, peer_mb = (np.median([turn[side][1] for turn in turns]) for side in (0, 1))
    return Row(
        f"Session from CSV, {size:,} rows, 4 columns",
        "trustlab read_session: every cell checked",
        "pandas.read_csv: no checks",
        Spread.of([1e3 * one for one in ours_s]),
        Spread.of([1e3 * one for one in peer_s]),
        ratio,
        goal="time ≤ 1.4 × and memory ≤ 1.5 × pandas",
        met=bool(ratio.median >= 1 / 1.4 and ours_mb <= 1.5 * peer_mb),
        note=f"memory on top of the imports: {ours_mb:.0f} MB and {peer_mb:.0f} MB",
    )


def _measured(read: str) -> tuple[float, float]:
    """Return the seconds and the megabytes that reading takes in a process of its own."""
    command = [sys.executable, "-c", MEASURED.format(read)]
    # pandas reads with several threads, which no variable limits: so may Arrow.
    threads = {name: text for name, text in os.environ.items() if "_NUM_THREADS" not in name}
    done = subprocess.run(command, check=True, capture_output=True, text=True, env=threads)
    seconds, megabytes = map(float, done.stdout.split())
    return seconds, megabytes


def _usual() -> Row:
    run = session()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.csv"
        run.data.reset_index().to_csv(path, index=False)
        tl.read_session(path)
        ours_ms, peer_ms, ratio = in_turns(
            here(lambda: tl.read_session(path)), here(lambda: pd.read_csv(path)), turns=15
        )
    return Row(
        "Session from CSV, 20,000 rows, 4 columns",
        "trustlab read_session: every cell checked",
        "pandas.read_csv: no checks",
        ours_ms,
        peer_ms,
        ratio,
        note=f"thousand rows per second: {len(run.data) / ours_ms.median:.0f} and "
        f"{len(run.data) / peer_ms.median:.0f}",
    )
