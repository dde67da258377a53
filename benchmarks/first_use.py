"""The import, and first calls of main functions: nothing compiled yet, and in the next process."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from statistics import median

from benchmarks.timing import Row

IMPORT = (
    "import numpy; from time import perf_counter as t; a = t(); import trustlab; print(t() - a)"
)
CALL = (
    "import time, networkx as nx, trustlab as tl; tsc = tl.published_models()['2']; "
    "session = tl.read_session('data/sessions/pilot.csv'); a = time.perf_counter(); {}; "
    "print(time.perf_counter() - a)"
)
CALLS = {
    "fit_tsc": "tl.fit_tsc(session)",
    "sample_posterior": "tl.sample_posterior(session.between(0.0, 600.0))",
    "choose_thresholds": "tl.choose_thresholds(tsc)",
    "ThresholdCorrector": "tl.ThresholdCorrector(tsc, target=(0.0, 0.35), horizon=200)"
    ".step(r=0.5, p_r=0.3, lower=-0.02, upper=0.33, mode=1)",
    "invariant_bounds": "tl.invariant_bounds(tsc, 0.0, 0.35)",
    "run_condition": "tl.run_condition('C3', participant=2, laps=1, seed=0)",
    "simulate_teleoperation": "tl.simulate_teleoperation('TMIG', seed=0, duration=10.0)",
    "simulate_team": "tl.simulate_team(nx.cycle_graph(4), seed=0, duration=10.0)",
}

# Seconds with nothing compiled; and in every later process.
FIRST = dict.fromkeys(CALLS, 5.0) | {"simulate_teleoperation": 8.0, "sample_posterior": 10.0}
LATER = dict.fromkeys(CALLS, 1.5)
LATER |= {name: 0.4 for name in CALLS if name.startswith(("run_", "simulate_", "Threshold"))}


def rows() -> Iterator[Row]:
    """Yield the import beyond NumPy's, and a row per function."""
    run(IMPORT)
    times = [1e3 * run(IMPORT) for _ in range(9)]
    work = "import trustlab, beyond import numpy"
    yield Row(work, times, goal="≤ 300 ms", met=median(times) <= 300.0)
    for name, call in CALLS.items():
        with tempfile.TemporaryDirectory() as folder:
            cold, warm = (run(CALL.format(call), TRUSTLAB_CACHE_DIR=folder) for _ in range(2))
        goal = f"≤ {FIRST[name]:g} s, then ≤ {LATER[name]:g} s"
        note = f"in the next process {warm:.2f} s"
        met = cold <= FIRST[name] and warm <= LATER[name]
        yield Row(f"First {name}, nothing compiled", [1e3 * cold], goal=goal, met=met, note=note)


def run(code: str, **variables: str) -> float:
    """Return the seconds that code prints in a process with these variables."""
    command, environment = [sys.executable, "-c", code], os.environ | variables
    return float(subprocess.check_output(command, text=True, env=environment))
