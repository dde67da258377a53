"""
Results of public functions, to compare two machines: `make digest`.

Each case has a digest of its numbers. Those marked `bits` are the same to the last bit on every
machine; the others, which go through LAPACK or an optimiser, agree to 1e-9. `digests.json` holds
what is expected; `python data/digests/make_digests.py --write` writes it again.
"""

import argparse
import hashlib
import json
import sys
import tempfile
import warnings
from pathlib import Path

import networkx as nx
import numpy as np
import pandas as pd

import trustlab as tl

HERE = Path(__file__).parent
EXPECTED = HERE / "digests.json"
PILOT = HERE.parent / "sessions" / "pilot.csv"
CLOSE = 1e-9


def scores(subjects=12, conditions=4):
    """Return a table of synthetic scores: subjects, conditions, a value with a trend."""
    rng = np.random.default_rng(7)
    values = np.round(rng.normal(size=(subjects, conditions)) + 0.4 * np.arange(conditions), 3)
    index = [(f"P{i}", f"C{j}") for i in range(subjects) for j in range(conditions)]
    frame = pd.DataFrame(index, columns=["subject", "condition"])
    return frame.assign(score=values.ravel())


def model():
    """Return the printed model of participant 2."""
    return tl.published_models()["2"]


def analysis():
    """Return a repeated-measures analysis of the scores."""
    return tl.repeated_measures(scores(), dv="score", within="condition", subject="subject")


def campaign():
    """Return the table of a campaign that is written to a folder."""

    def task(x, seed):
        return {"y": np.random.default_rng(seed).normal() + x}

    with tempfile.TemporaryDirectory() as folder:
        return tl.run_campaign(task, tl.parameter_grid(x=range(20)), seed=3, n_jobs=1, out=folder)


def corrections():
    """Return one step of the threshold corrector."""
    corrector = tl.ThresholdCorrector(model(), target=(0.05, 0.4), horizon=100)
    plan = corrector.step(r=0.6, p_r=0.3, lower=0.0, upper=0.35, mode=1)
    return [plan.lower, plan.upper, plan.cost]


def reconstruction(name):
    """Return data with the printed statistics of a study."""
    return tl.reconstruct(tl.published_studies()[name], seed=0)


# Name of the case: whether every bit is the same, and what computes it.
CASES = {
    "simulate_allocation": (True, lambda: tl.simulate_allocation(model(), 0.0, 0.35, steps=20_000)),
    "threshold_limits": (True, lambda: bounds(tl.threshold_limits(model()))),
    "run_condition": (
        True,
        lambda: tl.run_condition("C3", participant=2, laps=1, seed=0).session.table(),
    ),
    "virtual_study": (
        True,
        lambda: tl.virtual_study(n=3, conditions=["C1", "C3", "C5"], laps=1, seed=0).measures,
    ),
    "virtual_study_uav": (
        True,
        lambda: tl.virtual_study(n=10, testbed="uav_following", seed=0).measures,
    ),
    "simulate_teleoperation": (
        True,
        lambda: tl.simulate_teleoperation("TMIG", seed=0, duration=5.0).table(),
    ),
    "simulate_team": (True, lambda: tl.simulate_team(nx.cycle_graph(4), seed=0).positions),
    "ThresholdCorrector": (True, corrections),
    "run_campaign": (True, campaign),
    "parameter_draws": (
        True,
        lambda: pd.DataFrame(tl.parameter_draws(50, seed=1, beta=(0.6, 0.8), laps=[4, 8])),
    ),
    "latin_square_design": (
        True,
        lambda: tl.latin_square_design(["A", "B", "C", "D"], 12, seed=0).table(),
    ),
    "reconstruct_tlx": (True, lambda: reconstruction("uav.tlx")),
    "reconstruct_tracking": (True, lambda: reconstruction("teleop.tracking_error")),
    "limit_cycle": (True, lambda: tl.limit_cycle(model(), 0.0, 0.3).table()),
    "invariant_bounds": (False, lambda: tl.invariant_bounds(model(), 0.0, 0.3).table()),
    "choose_thresholds": (False, lambda: list(thresholds())),
    "fit_tsc": (False, lambda: tl.fit_tsc(tl.read_session(PILOT)).table()),
    "arx": (False, lambda: tl.fit_robot(tl.read_session(PILOT), method="regression").table()),
    "repeated_measures": (False, lambda: analysis().table()),
    "pairs": (False, lambda: analysis().pairs()),
    "equivalence": (
        False,
        lambda: tl.equivalence(
            scores(), dv="score", within="condition", subject="subject", bound=0.8
        ),
    ),
    "mixed_model": (
        False,
        lambda: tl.mixed_model(scores(), dv="score", within="condition", subject="subject").table(),
    ),
    "audit": (False, tl.audit),
    "printed_effects": (False, tl.printed_effects),
    "model_effects": (False, tl.model_effects),
    "power_analysis": (False, lambda: power().table()),
}


def bounds(limits):
    """Return the limits of thresholds."""
    return [limits.lower, limits.upper]


def thresholds():
    """Return the thresholds chosen for the model."""
    choice = tl.choose_thresholds(model())
    return choice.lower, choice.upper


def power():
    """Return the power of a study like the scores."""
    columns = tl.studies.StudyColumns("score", "condition", "subject")
    quick = tl.studies.Simulation(replicates=500, seed=0)
    return tl.power_analysis(data=scores(12, 3), columns=columns, n=12, simulation=quick)


def values(result):
    """Return every number and text of a result, in order."""
    if isinstance(result, pd.DataFrame):
        frame = result.reset_index() if result.index.name or result.index.nlevels > 1 else result
        return [x for name in frame for x in [str(name), *values(frame[name].to_numpy())]]
    if isinstance(result, np.ndarray) and result.dtype != object:
        return result.ravel().tolist()
    return [x.item() if isinstance(x, np.generic) else x for x in result]


def text(value):
    """Return a text of a value that no bit of it escapes."""
    return value.hex() if isinstance(value, float) else str(value)


def measured(name):
    """Return what this machine computes: digest, and the numbers where bits may differ."""
    bits, compute = CASES[name]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        content = values(compute())
    digest = hashlib.sha256("\n".join(map(text, content)).encode()).hexdigest()[:16]
    entry = {"bits": bits, "digest": digest}
    return entry if bits else entry | {"values": content}


def near(found, expected):
    """Return the greatest relative difference of numbers; infinite where anything else differs."""
    if len(found) != len(expected):
        return np.inf
    worst = 0.0
    for x, y in zip(found, expected, strict=True):
        numeric = isinstance(x, float | int) and isinstance(y, float | int)
        if numeric and not isinstance(x, bool):
            if x == y or (x != x and y != y):
                continue
            worst = max(worst, abs(x - y) / max(1.0, abs(y)))
        elif str(x) != str(y):
            return np.inf
    return worst


def compared(names):
    """Yield name, verdict and whether it is as expected, for each case."""
    expected = json.loads(EXPECTED.read_text(encoding="utf-8"))
    for name in names:
        entry = measured(name)
        if entry["digest"] == expected[name]["digest"]:
            yield name, "the same bits", True
        elif entry["bits"]:
            yield name, f"DIFFERS: {entry['digest']}, expected {expected[name]['digest']}", False
        else:
            gap = near(entry["values"], expected[name]["values"])
            words = f"agrees to {gap:.1e}" if gap <= CLOSE else f"DIFFERS by {gap:.1e}"
            yield name, words, gap <= CLOSE


def main():
    """Compare this machine with the digests in the repository, or write them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", help="cases; all by default")
    parser.add_argument("--write", action="store_true", help="write digests.json again")
    options = parser.parse_args()
    names = options.names or list(CASES)
    if options.write:
        content = {name: measured(name) for name in names}
        EXPECTED.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
        return 0
    agree = True
    for name, verdict, fine in compared(names):
        print(f"{name:24} {verdict}", flush=True)
        agree &= fine
    return 0 if agree else 1


if __name__ == "__main__":
    sys.exit(main())
