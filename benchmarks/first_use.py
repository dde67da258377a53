"""
The first call of each main function, with nothing compiled yet and in the next process, each in a
process of its own.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator

from benchmarks.timing import Row, Spread

TITLE = "First use"
LIMIT_S = 10.0
TIMED = (
    "import time, trustlab as tl; tsc = tl.published_models()['2']; a = time.perf_counter(); "
    "{}; print(time.perf_counter() - a)"
)
CALLS = {
    "virtual_study": 'tl.virtual_study(n=4, conditions=["C1", "C3"], laps=2, seed=0)',
    "run_condition": 'tl.run_condition("C3", participant=2, laps=1, seed=0)',
    "choose_thresholds": "tl.choose_thresholds(tsc)",
    "ThresholdCorrector": "tl.ThresholdCorrector(tsc, target=(0.0, 0.35), horizon=200)"
    ".step(r=0.5, p_r=0.3, lower=-0.02, upper=0.33, mode=1)",
    "limit_cycle": "tl.limit_cycle(tsc, 0.0, 0.35)",
    "invariant_bounds": "tl.invariant_bounds(tsc, 0.0, 0.35)",
    "simulate_teleoperation": 'tl.simulate_teleoperation("TMIG", seed=0, duration=10.0)',
    "fit_tsc": 'tl.fit_tsc(tl.read_session("data/sessions/pilot.csv"))',
}


def rows() -> Iterator[Row]:
    """
    Yield a row per call: cold with an empty folder for what is compiled, warm in the next process.
    """
    for name, call in CALLS.items():
        yield _row(name, call)


def _row(name: str, call: str) -> Row:
    case, ours = f"First use of {name}", "nothing compiled yet"
    with tempfile.TemporaryDirectory() as folder:
        try:
            cold, warm = (1e3 * _seconds(call, folder) for _ in range(2))
        except subprocess.CalledProcessError as error:
            last = (error.stderr.strip().splitlines() or ["no message"])[-1]
            return Row(
                case,
                ours,
                "compiled before",
                goal=f"ours ≤ {LIMIT_S:g} s",
                fault=f"it failed: {last[:200]}",
            )
    times = [Spread.of([value]) for value in (cold, warm, warm / cold)]
    return Row(
        case,
        ours,
        "compiled before",
        *times,
        goal=f"ours ≤ {LIMIT_S:g} s",
        met=cold <= 1e3 * LIMIT_S,
    )


def _seconds(call: str, folder: str) -> float:
    """
    Return the seconds that a call takes in a process of its own, with its compiled functions kept
    in a folder.
    """
    command = [sys.executable, "-c", TIMED.format(call)]
    environment = os.environ | {"TRUSTLAB_CACHE_DIR": folder}
    return float(
        subprocess.run(command, check=True, capture_output=True, text=True, env=environment).stdout
    )
