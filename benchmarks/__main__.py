"""
Run all cases, or those named on the command line: print the table and write reports/benchmarks.csv
and .html.
"""

import importlib
import os
import sys
import time

CASES = (
    "arx",
    "greybox",
    "imports",
    "first_use",
    "simulation",
    "sessions",
    "repeated_measures",
    "correction",
    "teleoperation",
    "team",
    "campaign",
    "virtual_study",
    "live",
    "robot",
    "scaling",
)

# One thread everywhere; and memory once taken stays with the process (glibc): otherwise large
# arrays are mapped anew in every call, which costs the SciPy peer half of its time and ours none.
SETTING = {f"{name}_NUM_THREADS": "1" for name in ("OMP", "OPENBLAS", "MKL", "NUMEXPR", "NUMBA")}
SETTING |= {
    "MALLOC_MMAP_THRESHOLD_": str(2**25),
    "MALLOC_TRIM_THRESHOLD_": str(2**31 - 1),
    "MALLOC_TOP_PAD_": str(2**26),
}


def chosen(names: list[str]) -> list[str]:
    """
    Return the cases to run, in their order: all where none is named.

    Parameters
    ----------
    names : list of str
        Names of cases.

    Raises
    ------
    ValueError
        If a name is none of CASES.
    """
    unknown = [name for name in names if name not in CASES]
    if unknown:
        raise ValueError(
            f"no benchmark is called {', '.join(unknown)}; there are: {', '.join(CASES)}"
        )
    return [name for name in CASES if not names or name in names]


def main(names: list[str]) -> int:
    """
    Return 0, or 1 when a peer is missing or gave another result; goals that are not met are said,
    not failed on.

    Parameters
    ----------
    names : list of str
        Cases to run; with any, the table is printed only, so that the files stay those of a whole
        run.
    """
    from benchmarks import report

    began, rows = time.perf_counter(), []
    for name in chosen(names):
        case = importlib.import_module(f"benchmarks.{name}")
        print(f"{case.TITLE} …", flush=True)
        for row in case.rows():
            rows.append(row)
            print("  " + report.line(row), flush=True)
    seconds = time.perf_counter() - began
    print("\n" + report.table(rows))
    if not names:
        report.write(rows, seconds)
    print(
        f"\n{seconds:.0f} s"
        + ("" if names else "; written: reports/benchmarks.csv, reports/benchmarks.html")
    )
    faults = [row for row in rows if row.fault]
    for row in faults:
        print(f"NOT COMPARED: {row.peer} ({row.case}): {row.fault}", file=sys.stderr)
    for row in rows:
        if row.met is False:
            print(f"goal not met: {row.case}, {row.peer}: {row.goal}", file=sys.stderr)
    return 1 if faults else 0


if __name__ == "__main__":
    try:
        chosen(sys.argv[1:])
    except ValueError as error:
        sys.exit(str(error))
    if any(
        os.environ.get(name) != value for name, value in SETTING.items()
    ):  # they count from a process's start
        command = [sys.executable, "-m", "benchmarks", *sys.argv[1:]]
        os.execve(sys.executable, command, os.environ | SETTING)
    sys.exit(main(sys.argv[1:]))
