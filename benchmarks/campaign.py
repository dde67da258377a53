"""5,000 runs of 1 ms on two processes, written to disk as they finish, beside joblib alone."""

from __future__ import annotations

import contextlib
import tempfile
import time
from collections.abc import Callable, Iterator

import numpy as np

import trustlab as tl
from benchmarks.timing import Row, Spread

TITLE = "Campaigns"
RUNS = 5000
SECONDS = 0.001
WORKERS = 2
TURNS = 5


def burn(x: float, seed: np.random.SeedSequence) -> dict:
    """
    Compute for 1 ms of processor time.

    Parameters
    ----------
    x : float
        Anything.
    seed : numpy.random.SeedSequence
        Seed of the run.
    """
    end = time.thread_time() + SECONDS
    draw = np.random.default_rng(seed).normal()
    while time.thread_time() < end:
        pass
    return {"y": draw, "z": 2.0 * x}


def rows() -> Iterator[Row]:
    """Yield a campaign against joblib alone, on processes of this machine and on Dask."""
    yield compared("processes", contextlib.nullcontext)
    try:
        from distributed import Client, LocalCluster
    except ImportError as error:
        yield Row("Campaign, Dask", "trustlab run_campaign", "joblib alone", fault=str(error))
        return
    settings = {"dashboard_address": ":0", "silence_logs": "ERROR"}
    with (
        LocalCluster(n_workers=WORKERS, threads_per_worker=1, **settings) as cluster,
        Client(cluster),
    ):
        yield compared("Dask", on_dask)


def on_dask() -> contextlib.AbstractContextManager:
    """Return a context in which joblib computes on Dask."""
    import joblib

    return joblib.parallel_config("dask")


def compared(name: str, context: Callable) -> Row:
    """
    Return a campaign against joblib alone, in turns.

    Parameters
    ----------
    name : str
        Where runs are computed.
    context : callable
        Makes the context in which they are.
    """
    import joblib

    parameters = [{"x": x} for x in np.linspace(0.0, 1.0, RUNS).tolist()]
    seeds = np.random.SeedSequence(0).spawn(RUNS)
    ours, others = [], []
    for turn in range(TURNS + 1):
        with tempfile.TemporaryDirectory() as folder, context():
            start = time.perf_counter()
            tl.run_campaign(burn, parameters, n_jobs=WORKERS, out=folder)
            middle = time.perf_counter()
            tasks = zip(parameters, seeds, strict=True)
            joblib.Parallel(WORKERS)(
                joblib.delayed(burn)(**values, seed=seed) for values, seed in tasks
            )
            end = time.perf_counter()
        if turn:  # in the first, processes start
            ours.append(1e3 * (middle - start))
            others.append(1e3 * (end - middle))
    ratio = Spread.of([y / x for x, y in zip(ours, others, strict=True)])
    overhead = 1.0 / ratio.median - 1.0
    return Row(
        f"Campaign of {RUNS:,} runs of {1e3 * SECONDS:.0f} ms on {WORKERS} workers, {name}",
        "trustlab run_campaign, written to disk",
        "joblib.Parallel alone, nothing kept",
        Spread.of(ours),
        Spread.of(others),
        ratio,
        "overhead ≤ 5 %",
        overhead <= 0.05,
        f"overhead {100 * overhead:.1f} %",
    )
