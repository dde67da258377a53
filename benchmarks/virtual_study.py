"""
Virtual studies of 1,000 operators and of 20,000 UAV sessions from end to end, memory, and power by
10,000 simulated studies.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from time import perf_counter

import numpy as np

import trustlab as tl
from benchmarks.timing import Row, Spread, seconds_per_call
from trustlab.studies import Simulation, graded_covariance

TITLE = "Virtual studies and power"
STUDIES = {"ground_robot": ("8 laps", 1_000, 20.0), "uav_following": ("6 minutes", 4_000, 60.0)}
"""Sessions, operators and seconds by testbed."""

SMALL = 20
LARGE = 120
GROWTH = 30.0
"""
Participants of the two studies whose memory is compared, and how much more the larger may take
[MB].
"""

MEMORY = """
import resource, sys
import trustlab as tl
tl.virtual_study(n=int(sys.argv[1]), seed=1).table()
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
"""


def rows() -> Iterator[Row]:
    """Yield the study, its memory, and the power analysis."""
    for testbed, (session, operators, most) in STUDIES.items():
        tl.virtual_study(
            n=10, testbed=testbed, n_jobs=2
        )  # the processes are there, kernels are compiled
        began = perf_counter()
        study = tl.virtual_study(n=operators, seed=1, testbed=testbed, n_jobs=2)
        study.table()
        seconds = perf_counter() - began
        yield Row(
            f"Virtual study ({testbed}), {operators:,} operators × 5 conditions × {session}",
            "trustlab virtual_study, two processes: sessions, measures, statistics",
            "none",
            Spread.of([1e3 * seconds]),
            goal=f"≤ {most:.0f} s on two cores",
            met=seconds <= most,
            note=f"one run; {len(study.measures) / seconds:.0f} sessions per second",
        )
    small, large = (peak(n) for n in (SMALL, LARGE))
    yield Row(
        f"Memory of a virtual study, {SMALL} and {LARGE} participants, one process",
        "trustlab virtual_study",
        "none",
        goal=f"≤ {GROWTH:.0f} MB more for {LARGE - SMALL} participants more",
        met=large - small <= GROWTH,
        note=f"peak resident memory {small:.0f} and {large:.0f} MB",
    )
    yield power()


def peak(participants: int) -> float:
    """
    Return the peak resident memory of a process that runs a study [MB].

    Parameters
    ----------
    participants : int
        Of the study.
    """
    command = [sys.executable, "-c", MEMORY, str(participants)]
    return float(
        subprocess.run(command, capture_output=True, text=True, check=True).stdout.split()[-1]
    )


def power() -> Row:
    """Return the row of one power analysis, its result checked against the noncentral F."""
    case, ours = (
        "Power of 36 × 5, 10,000 simulated studies",
        "trustlab power_analysis: F with three corrections, all pairs",
    )
    given = {
        "mean": [0.0, 0.1, 0.4, 0.5, 0.5],
        "covariance": graded_covariance(5),
        "n": 36,
        "effect_size": 0.05,
    }
    row = tl.power_analysis(**given, simulation=Simulation(seed=1)).table().iloc[0]
    error = (row["power"] - row["closed_form"]) / np.sqrt(
        row["closed_form"] * (1.0 - row["closed_form"]) / 10_000
    )
    if not abs(error) < 4.0:
        return Row(
            case, ours, "noncentral F", fault=f"power differs by {error:.1f} standard errors"
        )
    times = [1e3 * seconds_per_call(lambda: tl.power_analysis(**given), 1) for _ in range(5)]
    spread = Spread.of(times)
    note = f"power {row['power']:.4f}, noncentral F {row['closed_form']:.4f}"
    return Row(case, ours, "none", spread, goal="≤ 5 s", met=spread.median <= 5e3, note=note)
