"""What `import trustlab` costs beyond `import numpy`, in fresh processes."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator

from benchmarks.timing import Row, Spread

TITLE = "Import"
LIMIT_MS = 300.0
TIMED = (
    "from time import perf_counter as t; a = t(); import numpy; b = t(); {}; print(b - a, t() - b)"
)
USE = "import trustlab; trustlab.read_session; trustlab.fit_tsc"


def rows() -> Iterator[Row]:
    """
    Yield what comes on top of NumPy: the import itself, and (for information) reaching for the
    first functions.
    """
    yield _row(
        "Import in a fresh process",
        "import trustlab",
        11,
        "the rooms load when they are first used: next row",
        f"ours ≤ {LIMIT_MS:g} ms",
    )
    yield _row("First use in a fresh process", USE, 5, "paid once, at the first call")


def _row(case: str, statement: str, turns: int, note: str, goal: str = "") -> Row:
    ours = f"{statement}, after import numpy"
    peer = "import numpy, in the same process before"
    try:
        _milliseconds(statement)
        pairs = [_milliseconds(statement) for _ in range(turns)]
    except subprocess.CalledProcessError as error:
        last = (error.stderr.strip().splitlines() or ["no message"])[-1]
        return Row(case, ours, peer, goal=goal, fault=f"the import failed: {last[:200]}")
    extra = Spread.of([pair[1] for pair in pairs])
    numpy = Spread.of([pair[0] for pair in pairs])
    met = extra.median <= LIMIT_MS if goal else None
    return Row(case, ours, peer, extra, numpy, goal=goal, met=met, note=note)


def _milliseconds(statement: str) -> tuple[float, float]:
    """Return the milliseconds that NumPy and then `statement` took in a process of their own."""
    done = subprocess.run(
        [sys.executable, "-c", TIMED.format(statement)], check=True, capture_output=True, text=True
    )
    numpy, ours = done.stdout.split()
    return 1e3 * float(numpy), 1e3 * float(ours)
