"""5,000 runs of 1 ms on two processes, written to disk as they finish, beside joblib alone."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterator

import joblib
import numpy as np

import trustlab as tl
from benchmarks.timing import Row, beside

RUNS, SECONDS, WORKERS = 5000, 0.001, 2
PARAMETERS = [{"x": x} for x in np.linspace(0.0, 1.0, RUNS).tolist()]
SEEDS = np.random.SeedSequence(0).spawn(RUNS)


def burn(x: float, seed: np.random.SeedSequence) -> dict:
    """Compute for a millisecond of processor time."""
    end = time.thread_time() + SECONDS
    draw = np.random.default_rng(seed).normal()
    while time.thread_time() < end:
        pass
    return {"y": draw, "z": 2.0 * x}


def kept() -> None:
    """Run a campaign in a folder of its own."""
    with tempfile.TemporaryDirectory() as folder:
        tl.run_campaign(burn, PARAMETERS, n_jobs=WORKERS, out=folder)


def alone() -> None:
    """Run the same with joblib, nothing kept."""
    pairs = zip(PARAMETERS, SEEDS, strict=True)
    joblib.Parallel(WORKERS)(joblib.delayed(burn)(**values, seed=seed) for values, seed in pairs)


def rows() -> Iterator[Row]:
    """Yield campaigns on processes of this machine, and on Dask."""
    from distributed import Client, LocalCluster

    yield compared("processes")
    quiet = {"dashboard_address": ":0", "silence_logs": "ERROR"}
    cluster = LocalCluster(n_workers=WORKERS, threads_per_worker=1, **quiet)
    with cluster, Client(cluster), joblib.parallel_config("dask"):
        yield compared("Dask")


def compared(place: str) -> Row:
    """Return the row of one place where runs are computed."""
    work = f"run_campaign, {RUNS:,} runs of 1 ms on two workers, {place}, written to disk"
    return beside(work, kept, "joblib alone, nothing kept", alone, least=0.95, turns=3)
