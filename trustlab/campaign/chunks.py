"""How many runs go into a chunk."""

from __future__ import annotations

import math

__all__ = ["ChunkSizes"]

LEAST = 0.1
"""Seconds that a chunk should last at least: less, and sending and writing it costs more than a few per cent."""
USUAL, MOST = 0.25, 5.0
"""Seconds that a chunk lasts in a short and a long campaign: what a killed campaign loses, per worker."""
GROWTH = 16
"""How many times longer the next chunk may be: the first runs say little of the others."""
MOST_RUNS = 20_000
"""Runs in a chunk of very quick tasks."""


class ChunkSizes:
    """
    Sizes of chunks from how long runs have taken so far; they have no effect on results.

    Parameters
    ----------
    remaining : int
        Runs still to be sent.
    workers : int
        How many chunks run at the same time.
    """

    def __init__(self, remaining: int, workers: int):
        self.remaining, self.workers = remaining, max(1, workers)
        self.per_run: float | None = None
        self.largest = 1

    def next(self, available: int) -> int:
        """
        Return how many runs the next chunk takes.

        Parameters
        ----------
        available : int
            Consecutive runs that there are.
        """
        size = 1
        if self.per_run is not None:
            per_run = max(self.per_run, 1e-7)
            share = self.remaining * per_run / self.workers  # seconds left for each worker
            wanted = min(max(USUAL, share / 100.0), MOST)
            wanted = max(
                1.2 * LEAST, min(wanted, share / 3.0)
            )  # smaller towards the end, so that workers end together
            size = min(math.ceil(wanted / per_run), GROWTH * self.largest, MOST_RUNS)
        size = min(max(1, size), available)
        self.remaining -= size
        return size

    def took(self, runs: int, seconds: float) -> None:
        """
        Take in how long a chunk took.

        Parameters
        ----------
        runs : int
            Runs in it.
        seconds : float
            Time in the worker.
        """
        now = seconds / runs
        first = self.per_run is None or (self.largest == 1 and now < self.per_run)  # compilation is over
        self.per_run = now if first else 0.5 * (self.per_run + now)
        self.largest = max(self.largest, runs)
