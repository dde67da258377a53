"""Run every case, print the table and write reports/benchmarks.csv and reports/benchmarks.html."""

import os
import sys
import time

# One thread everywhere; and memory once taken stays with the process (glibc): otherwise large arrays are mapped anew in every call,
# which costs the SciPy peer half of its time and ours none.
SETTING = {f"{name}_NUM_THREADS": "1" for name in ("OMP", "OPENBLAS", "MKL", "NUMEXPR", "NUMBA")}
SETTING |= {
    "MALLOC_MMAP_THRESHOLD_": str(2**25),
    "MALLOC_TRIM_THRESHOLD_": str(2**31 - 1),
    "MALLOC_TOP_PAD_": str(2**26),
}
if any(os.environ.get(name) != value for name, value in SETTING.items()):  # they count from a process's start
    os.execve(sys.executable, [sys.executable, "-m", "benchmarks"], os.environ | SETTING)

from benchmarks import (  # noqa: E402
    arx,
    campaign,
    correction,
    greybox,
    imports,
    repeated_measures,
    report,
    scaling,
    sessions,
    simulation,
    team,
    teleoperation,
    virtual_study,
)

CASES = (
    arx,
    greybox,
    imports,
    simulation,
    sessions,
    repeated_measures,
    correction,
    teleoperation,
    team,
    campaign,
    virtual_study,
    scaling,
)


def main() -> int:
    """Return 0, or 1 when a peer is missing or gave another result; goals that are not met are said, not failed on."""
    began, rows = time.perf_counter(), []
    for case in CASES:
        print(f"{case.TITLE} …", flush=True)
        for row in case.rows():
            rows.append(row)
            print("  " + report.line(row), flush=True)
    seconds = time.perf_counter() - began
    report.write(rows, seconds)
    print("\n" + report.table(rows))
    print(f"\n{seconds:.0f} s; written: reports/benchmarks.csv, reports/benchmarks.html")
    faults = [row for row in rows if row.fault]
    for row in faults:
        print(f"NOT COMPARED: {row.peer} ({row.case}): {row.fault}", file=sys.stderr)
    for row in rows:
        if row.met is False:
            print(f"goal not met: {row.case}, {row.peer}: {row.goal}", file=sys.stderr)
    return 1 if faults else 0


sys.exit(main())
