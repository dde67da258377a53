"""
Write the simulations that the reports only read, as they take minutes: `make simulated`.

The reports simulate a sample of every table again and compare. `make_simulated.py guidance` makes
one of them.
"""

import json
import sys
from pathlib import Path

import pandas as pd

import trustlab as tl
from trustlab.allocation import bound_failures
from trustlab.models.digest import PACKAGE, source_digest
from trustlab.reproduction import read_calibration
from trustlab.testbeds import compare_guidance

HERE = Path(__file__).resolve().parent
SEED = 0


def adjustments() -> pd.DataFrame:
    """Which adjustments of p-values the printed numbers of each study can belong to (report 05)."""
    return tl.reproduction.compare_adjustments(tl.published_studies(), SEED).reset_index()


def failures() -> pd.DataFrame:
    """
    How often random parameter sets violate the printed bounds, and those of `invariant_bounds`
    (report 03).
    """
    return bound_failures(20_000, SEED, invariant=2_000).reset_index()


def guidance() -> pd.DataFrame:
    """Simulated operators of the main study in every scheme under every guidance (report 07)."""
    wanted = [
        "guidance",
        "scheme",
        "participant",
        "tracking_error",
        "guidance_felt",
        "energy_target",
    ]
    return compare_guidance(30, seed=SEED).runs[[*wanted, "energy_port_min", "guarded"]]


def checks() -> pd.DataFrame:
    """
    Printed effects beside 40 studies of each testbed simulated under the posterior (report 10);
    needs `make calibration`.
    """
    found = {
        name: read_calibration(name, HERE.parent / "calibration")
        for name in ("ground_robot", "uav")
    }
    tables = {
        name: one.within_reach().checks(40, seed=SEED + 1, n_jobs=2) for name, one in found.items()
    }
    return pd.concat(tables, names=["study"]).reset_index("study")


TABLES = {
    adjustments: "reproduction/reconstruction/feasibility.py",
    failures: "allocation/bound_failures.py",
    guidance: "testbeds/guidance_comparison.py",
    checks: "reproduction/calibration.py",
}
"""Each table, and the file whose imports, direct or not, are what it comes from."""

if __name__ == "__main__":
    for make, source in TABLES.items():
        if sys.argv[1:] in ([], [make.__name__]):
            make().to_csv(HERE / f"{make.__name__}.csv", index=False)
            about = {
                "seed": SEED,
                "origin": make.__doc__.strip(),
                "source_digest": source_digest(PACKAGE / source),
            }
            (HERE / f"{make.__name__}.json").write_text(
                json.dumps(about, indent=1) + "\n", encoding="utf-8"
            )
