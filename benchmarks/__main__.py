"""
Run all benchmarks, or those named on the command line, and print one table.

A whole run also writes it to docs/benchmarks.md, a page of the book, with date and machine.
"""

import importlib
import importlib.metadata
import os
import platform
import sys
import time
from datetime import UTC, datetime
from pathlib import Path
from statistics import median

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
ours within each turn, so that above 1 ours is faster. Medians are shown, with the least and the
greatest. One thread everywhere; first calls do not count unless a row says so; a peer's results
are checked against ours before anything is timed.

{table}

## Peers that take long to install

Measured on 2026-11-24, on the same loop and fits: Drake's periodic system in NumPy takes 389
times as long as the teleoperation loop and its compiled linear blocks, which do less, 16 times;
GEKKO takes 155 times as long as the CasADi engine for a step of the correction; SIPPY takes 529
times as long as `arx`.
"""


def cells(row) -> list[str]:
    """Return a row as text."""
    met = {True: "met", False: "not met", None: ""}[row.met]
    goal = f"{row.goal}: {met}" if row.goal else ""
    numbers = [spread(values) for values in (row.ours, row.theirs, row.ratios)]
    return [row.work, numbers[0], row.peer, *numbers[1:], goal, row.note]


def spread(values: list[float]) -> str:
    """Return median, least and greatest with three digits."""
    if not values:
        return ""
    if len(values) == 1:
        return f"{values[0]:,.3g}"
    return f"{median(values):,.3g} [{min(values):.3g}–{max(values):.3g}]"


def table(rows) -> str:
    """Return the rows as a table in Markdown."""
    heads = ["work", "ours [ms]", "peer", "peer [ms]", "ratio", "goal", "note"]
    lines = [heads, ["---"] * len(heads), *map(cells, rows)]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def machine() -> str:
    """Return processor, cores and versions, without names of hosts or people."""
    name = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    for line in info.read_text().splitlines() if info.exists() else ():
        if line.startswith("model name"):
            name = line.partition(":")[2].strip()
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
        date = datetime.now(UTC).strftime("%Y-%m-%d")
        text = ABOUT.format(date=date, machine=machine(), table=table(rows))
        PAGE.write_text(text, encoding="utf-8")
    goals = [row for row in rows if row.met is not None]
    met = sum(bool(row.met) for row in goals)
    print(f"{met} of {len(goals)} goals met; {time.perf_counter() - began:.0f} s")
    return faults


if __name__ == "__main__":
    # They count from a process's start.
    if any(os.environ.get(name) != value for name, value in SETTING.items()):
        command = [sys.executable, "-m", "benchmarks", *sys.argv[1:]]
        os.execve(sys.executable, command, os.environ | SETTING)
    sys.exit(main(sys.argv[1:]))
