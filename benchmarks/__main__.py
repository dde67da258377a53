"""
Run all benchmarks, or those named on the command line, and print one table.

A whole run in which all could be compared also writes it to data/benchmarks/, and a page of the
book that shows it, with date and machine, to docs/benchmarks.md.
"""

import csv
import importlib
import importlib.metadata
import os
import platform
import re
import sys
import time
from datetime import UTC, datetime
from pathlib import Path
from statistics import median

from benchmarks.timing import number, time_of

CASES = (
    "first_use",
    "sessions",
    "identification",
    "allocation",
    "loops",
    "studies",
    "campaign",
    "live",
    "robot",
)
RESULTS = Path(__file__).parents[1] / "data" / "benchmarks" / "results.csv"
PAGE = Path(__file__).parents[1] / "docs" / "benchmarks.md"

# One thread everywhere; and memory once taken stays with the process (glibc): otherwise large
# arrays are mapped anew in every call, which costs peers more than ours.
SETTING = {f"{name}_NUM_THREADS": "1" for name in ("OMP", "OPENBLAS", "MKL", "NUMEXPR", "NUMBA")}
SETTING |= {
    "MALLOC_MMAP_THRESHOLD_": str(2**25),
    "MALLOC_TRIM_THRESHOLD_": str(2**31 - 1),
    "MALLOC_TOP_PAD_": str(2**26),
}

ABOUT = """# Benchmarks

What `make bench` printed on {date}, on {machine}.

Ours and a peer are timed in turns, ours, peer, ours, peer …; the ratio is the peer's time over
ours within each turn, so that above 1 ours is faster. Medians are shown, in parentheses the least
and the greatest. One thread everywhere; first calls do not count unless a row says so; a peer's
results are checked against ours before anything is timed.

:::{{csv-table}}
:file: ../data/benchmarks/results.csv
:header-rows: 1
:::

## Peers that are not measured again

They take long to install or to write down. Measured on 2026-11-24, the last on 2026-11-28.

| work | peer | ratio |
| --- | --- | --- |
| Teleoperation loop, three axes, 120 s at 1 kHz | Drake, a LeafSystem in NumPy | 389 |
| its linear part, beside our whole loop | Drake, compiled linear blocks and delays | 16 |
| Correction, N = 200, engine casadi | GEKKO with its own IPOPT | 155 |
| ARX, 20,000 samples | SIPPY, least squares | 529 |
| Joint fit, 20,000 samples, 8 unknowns | CasADi's example of system identification, IPOPT | 15 |
"""


def cells(row) -> list[str]:
    """Return a row as text: work, ours, peer, ratio, goal."""
    peer = f"{row.peer}: {time_of(row.theirs)}" if row.peer else ""
    ratio = number(median(row.ratios)) if row.ratios else ""
    goal = f"{row.goal}: {'met' if row.met else 'not met'}" if row.goal else ""
    return [row.work, time_of(row.ours), peer, ratio, "; ".join(filter(None, [goal, row.note]))]


def write(rows) -> None:
    """Write the rows as text, and the page that shows them."""
    with RESULTS.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["work", "ours", "peer", "ratio", "goal"])
        writer.writerows(map(cells, rows))
    date = datetime.now(UTC).strftime("%Y-%m-%d")
    PAGE.write_text(ABOUT.format(date=date, machine=machine()), encoding="utf-8")


def machine() -> str:
    """Return processor, cores and versions, without names of hosts or people."""
    info = Path("/proc/cpuinfo")
    named = re.search(r"model name\s*: (.*)", info.read_text()) if info.exists() else None
    name = named[1] if named else platform.processor() or platform.machine()
    packages = ("numpy", "scipy", "pandas", "numba", "statsmodels", "pingouin", "casadi")
    versions = [f"{each} {importlib.metadata.version(each)}" for each in packages]
    return f"{name}, {os.cpu_count()} cores, {platform.system()}, " + ", ".join(
        [f"Python {platform.python_version()}", *versions]
    )


def main(names: list[str]) -> int:
    """Return how many cases could not be compared; goals that are not met are said."""
    unknown = sorted(set(names) - set(CASES))
    if unknown:
        sys.exit(f"no benchmark is called {', '.join(unknown)}; there are: {', '.join(CASES)}")
    began, rows, faults = time.perf_counter(), [], 0
    for name in names or CASES:
        print(f"{name} …", flush=True)
        try:
            for row in importlib.import_module(f"benchmarks.{name}").rows():
                rows.append(row)
                print("  " + "; ".join(filter(None, cells(row))), flush=True)
        except Exception as error:  # the others are measured all the same
            faults += 1
            print(f"  NOT COMPARED: {type(error).__name__}: {error}", file=sys.stderr)
    if not names and not faults:
        write(rows)
    goals = [row for row in rows if row.met is not None]
    met = sum(bool(row.met) for row in goals)
    print(f"{met} of {len(goals)} goals met; {time.perf_counter() - began:.0f} s")
    return faults


if __name__ == "__main__":
    # Variables of the environment that libraries read when they are loaded.
    if any(os.environ.get(name) != value for name, value in SETTING.items()):
        command = [sys.executable, "-m", "benchmarks", *sys.argv[1:]]
        os.execve(sys.executable, command, os.environ | SETTING)
    sys.exit(main(sys.argv[1:]))
