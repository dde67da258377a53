"""
How our time grows: with samples of a fit, with studies of a batch, and with workers of a campaign.
"""

from __future__ import annotations

from collections.abc import Iterator
from time import perf_counter, process_time

import numpy as np

import trustlab as tl
from benchmarks.timing import Row, Spread, seconds_per_call

TITLE = "Scaling"
SAMPLES = (12_000, 48_000, 192_000)
STUDIES = (100, 1_000, 10_000, 100_000)
WORKERS = (1, 2)
RUNS, SECONDS = 400, 0.005


def rows() -> Iterator[Row]:
    """Yield a row per size, each with its time against the size before."""
    yield from _curve("Joint fit against samples", "trustlab fit_tsc", SAMPLES, _fit)
    yield from _curve(
        "Batch of studies of 36 × 5", "trustlab repeated_measures_batch", STUDIES, _batch
    )
    yield from _workers()


def _fit(samples: int):
    model = tl.published_models()["pilot"]
    mode = (np.arange(samples) // 3000 + 1) % 2
    frame = model.simulate(mode)[["mode", "p_r", "p_h"]]
    rng = np.random.default_rng(0)
    frame[["p_r", "p_h"]] += rng.normal(0.0, 0.005, (samples, 2))
    frame.index = 0.1 * np.arange(samples)
    session = tl.Session(frame.rename_axis("t"), tl.Metadata(synthetic=True))
    return lambda: tl.fit_tsc(session)


def _batch(studies: int):
    scores = np.random.default_rng(0).normal(size=(studies, 36, 5))
    return lambda: tl.repeated_measures_batch(scores)


def _curve(case, ours, sizes, build) -> Iterator[Row]:
    before = None
    for size in sizes:
        call = build(size)
        call()
        taken = Spread.of([1e3 * seconds_per_call(call, 1) for _ in range(3)])
        note = (
            ""
            if before is None
            else (
                f"{taken.median / before[1]:.1f} times the time for {size / before[0]:.0f} times "
                "the size"
            )
        )
        before = (size, taken.median)
        yield Row(f"{case}: {size:,}", ours, "none", taken, note=note)


def busy(seconds, seed):
    """
    Keep a core busy for some processor time.

    Parameters
    ----------
    seconds : float
        Processor time.
    seed : numpy.random.SeedSequence
        Not used.
    """
    began = process_time()
    while process_time() - began < seconds:
        pass
    return {"done": 1.0}


def _workers() -> Iterator[Row]:
    parameters, first = [{"seconds": SECONDS}] * RUNS, None
    for workers in WORKERS:
        tl.run_campaign(busy, parameters[:20], n_jobs=workers)
        taken = []
        for _ in range(3):
            began = perf_counter()
            tl.run_campaign(busy, parameters, n_jobs=workers)
            taken.append(1e3 * (perf_counter() - began))
        spread = Spread.of(taken)
        note = "" if first is None else f"{first / spread.median:.2f} times as fast as one"
        first = first or spread.median
        yield Row(
            f"Campaign of {RUNS} runs of 5 ms: {workers} worker(s)",
            "trustlab run_campaign",
            "none",
            spread,
            note=note,
        )
