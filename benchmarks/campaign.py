"""
2,000 runs of 5 ms on two workers, written to disk as they finish, beside the ideal and beside
joblib and Dask alone.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from statistics import median

import numpy as np

import trustlab as tl
from benchmarks.timing import Row, Spread

TITLE = "Campaigns"
RUNS = 2000
SECONDS = 0.005
WORKERS = 2
TURNS = 3
IDEAL = RUNS * SECONDS / WORKERS


def burn(x: float, seed: np.random.SeedSequence) -> dict:
    """
    Compute for 5 ms of processor time.

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


def grid(runs: int = RUNS) -> tl.campaign.ParameterGrid:
    """
    Return parameters of so many runs.

    Parameters
    ----------
    runs : int
        How many.
    """
    return tl.parameter_grid(x=np.linspace(0.0, 1.0, 20), repeats=runs // 20)


def rows() -> Iterator[Row]:
    """Yield loky and Dask against their goals, and both without a campaign around them."""
    import joblib

    with tempfile.TemporaryDirectory() as folder:
        began = time.perf_counter()
        tl.run_campaign(burn, grid(20), n_jobs=WORKERS)
        start = f"; starting the processes, uncounted: {time.perf_counter() - began:.1f} s"
        parallel = joblib.Parallel(n_jobs=WORKERS)
        seeds = np.random.SeedSequence(0).spawn(RUNS)

        def alone() -> None:
            parallel(
                joblib.delayed(burn)(**values, seed=seed)
                for values, seed in zip(grid(), seeds, strict=True)
            )

        yield from compared(
            "loky",
            Path(folder),
            0.10,
            "joblib.Parallel alone, nothing kept",
            alone,
            start,
            n_jobs=WORKERS,
        )
        try:
            from distributed import Client, LocalCluster
        except ImportError as error:
            yield Row(
                "Campaign on Dask",
                "trustlab run_campaign",
                "the ideal",
                fault=f"not installed: {error}",
            )
            return
        with (
            LocalCluster(
                n_workers=WORKERS,
                threads_per_worker=1,
                dashboard_address=":0",
                silence_logs="ERROR",
            ) as cluster,
            Client(cluster, set_as_default=False) as client,
        ):
            tl.run_campaign(burn, grid(20), executor=client.get_executor())

            def mapped() -> None:
                xs = [values["x"] for values in grid()]
                client.gather(client.map(burn, xs, seeds, pure=False))

            yield from compared(
                "Dask",
                Path(folder),
                0.15,
                "Client.map alone, nothing kept",
                mapped,
                "",
                executor=client.get_executor(),
            )


def compared(
    name: str,
    folder: Path,
    most: float,
    peer: str,
    alone: Callable[[], None],
    start: str,
    **where: object,
) -> Iterator[Row]:
    """
    Yield a campaign against the ideal and against its executor alone.

    Parameters
    ----------
    name : str
        The executor.
    folder : pathlib.Path
        Where campaigns are written.
    most : float
        Overhead allowed.
    peer : str
        The executor alone, in words.
    alone : callable
        Runs it.
    start : str
        What to add to the note.
    **where
        Arguments of `run_campaign`.
    """
    ours = []
    others = []
    within = []
    for turn in range(TURNS):
        began = time.perf_counter()
        table = tl.run_campaign(burn, grid(), out=folder / f"{name}_{turn}", **where)
        ours.append(time.perf_counter() - began)
        within.append(WORKERS * ours[-1] / table.attrs["seconds_in_runs"] - 1.0)
        began = time.perf_counter()
        alone()
        others.append(time.perf_counter() - began)
    case = f"Campaign of {RUNS:,} runs of {1e3 * SECONDS:.0f} ms on {WORKERS} workers, {name}"
    us = f"trustlab run_campaign, {name}, written to disk"
    over = [x / IDEAL - 1.0 for x in ours]
    times, ideal = Spread.of([1e3 * x for x in ours]), Spread.of([1e3 * IDEAL])
    note = (
        f"overhead {100 * median(over):.1f} % of processor time wanted; "
        f"{100 * median(within):.1f} % over the time that the runs took where they ran, which "
        f"other work on the machine stretches{start}"
    )
    goal = f"overhead ≤ {100 * most:.0f} %"
    ratio = Spread.of([IDEAL / x for x in ours])
    yield Row(
        case,
        us,
        "the ideal: processor time / workers",
        times,
        ideal,
        ratio,
        goal,
        median(over) <= most,
        note,
    )
    ratio = Spread.of([y / x for x, y in zip(ours, others, strict=True)])
    yield Row(case, us, peer, times, Spread.of([1e3 * x for x in others]), ratio)
