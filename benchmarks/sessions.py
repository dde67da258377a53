"""Reading a session of 20,000 rows with every check, beside pandas.read_csv without any."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path

import pandas as pd

import trustlab as tl
from benchmarks.data import session
from benchmarks.timing import Row, here, in_turns

TITLE = "Reading a session"


def rows() -> Iterator[Row]:
    """Yield the one comparison; for information."""
    run = session()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.csv"
        run.data.reset_index().to_csv(path, index=False)
        tl.read_session(path)
        ours_ms, peer_ms, ratio = in_turns(
            here(lambda: tl.read_session(path)), here(lambda: pd.read_csv(path)), turns=15
        )
    yield Row(
        "Session from CSV, 20,000 rows, 4 columns",
        "trustlab read_session: every cell checked",
        "pandas.read_csv: no checks",
        ours_ms,
        peer_ms,
        ratio,
        note=f"thousand rows per second: {len(run.data) / ours_ms.median:.0f} and {len(run.data) / peer_ms.median:.0f}",
    )
