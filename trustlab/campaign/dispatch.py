"""
Sending runs to workers in chunks, storing what comes back, and isolating runs that kill their
process.
"""

import math
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from time import monotonic
from typing import Any

from trustlab.campaign.errors import CampaignError
from trustlab.campaign.executors import Workers
from trustlab.campaign.table import encoded
from trustlab.campaign.worker import Outcome

# Seconds that a chunk should last at least: less, and sending and writing it costs more than a few
# per cent.
LEAST = 0.1
# Seconds that a chunk lasts in a short and a long campaign: what a killed campaign loses, per
# worker.
USUAL, MOST = 0.25, 5.0
# How many times longer the next chunk may be: the first runs say little of the others.
GROWTH = 16
# Runs in a chunk of very quick tasks.
MOST_RUNS = 20_000

# Seconds between two looks at whether the workers are still there.
WATCH = 2.0
# Runs that may kill their process in a row, with none succeeding, before the campaign gives up.
HOPELESS = 5
DIED = (
    "WorkerDiedError: the process ended while it ran this, twice: it was killed, ran out of "
    "memory or crashed"
)


class ChunkSizes:
    """Sizes of chunks, from how long runs have taken so far; they have no effect on results."""

    def __init__(self, remaining: int, workers: int):
        self.remaining, self.workers = remaining, max(1, workers)
        self.per_run: float | None = None
        self.largest = 1

    def next(self, available: int) -> int:
        """Return how many of the `available` consecutive runs the next chunk takes."""
        size = 1
        if self.per_run is not None:
            per_run = max(self.per_run, 1e-7)
            share = self.remaining * per_run / self.workers  # seconds left for each worker
            wanted = min(max(USUAL, share / 100.0), MOST)
            # Chunks become smaller towards the end, so that workers finish together.
            wanted = max(1.2 * LEAST, min(wanted, share / 3.0))
            size = min(math.ceil(wanted / per_run), GROWTH * self.largest, MOST_RUNS)
        size = min(max(1, size), available)
        self.remaining -= size
        return size

    def took(self, runs: int, seconds: float) -> None:
        """Learn from a chunk: so many runs took so many seconds in a worker."""
        now = seconds / runs
        # The first run also imports and compiles: the first chunk that is quicker says more than
        # the mean of both.
        first = self.per_run is None or (self.largest == 1 and now < self.per_run)
        self.per_run = now if first else 0.5 * (self.per_run + now)
        self.largest = max(self.largest, runs)


class Dispatcher:
    """
    Sends chunks of runs to workers and stores their outcomes; a span is the first run and the one
    after the last.
    """

    def __init__(self, workers: Workers, parameters: Sequence[Mapping], add: Callable, bar: Any):
        self.workers = workers
        self.parameters = parameters
        self.add = add
        self.bar = bar
        self.under_way: dict[Future, tuple[int, int]] = {}
        self.suspects: deque[tuple[int, int]] = deque()  # spans that were lost when a process died
        self.alone: Future | None = None  # the suspect that is being tried with nothing beside it
        self.deaths = 0
        self.failures = 0
        self.succeeded = False
        self.seconds = 0.0
        self.watched = monotonic()

    def run(self, spans: list[tuple[int, int]]) -> float:
        """Run all spans; return the seconds that the runs took, of all workers together."""
        todo = deque(spans)
        sizes = self.sizes = ChunkSizes(
            sum(last - first for first, last in spans), self.workers.count
        )
        try:
            while todo or self.suspects or self.under_way:
                if self.suspects:
                    # When a process dies, all chunks on the same executor may be lost. Each is
                    # tried again with nothing beside it, so that the next death has one possible
                    # cause.
                    if not self.under_way:
                        self.alone = self._send(*self.suspects.popleft())
                else:
                    while todo and len(self.under_way) < self.workers.slots:
                        first, last = todo.popleft()
                        end = first + sizes.next(last - first)
                        if end < last:
                            todo.appendleft((end, last))
                        self._send(first, end)
                for future in self._done():
                    self._receive(future)
        finally:
            self.workers.close(list(self.under_way))
        return self.seconds

    def _send(self, first: int, last: int) -> Future:
        future = self.workers.submit(first, [dict(self.parameters[i]) for i in range(first, last)])
        self.under_way[future] = (first, last)
        return future

    def _done(self) -> list[Future]:
        """Wait until a chunk is done, watching the workers meanwhile."""
        while True:
            done = wait(self.under_way, timeout=WATCH, return_when=FIRST_COMPLETED)[0]
            if not done or monotonic() - self.watched > WATCH:
                self.workers.watch()
                self.watched = monotonic()
            if done:
                return list(done)

    def _receive(self, future: Future) -> None:
        first, last = self.under_way.pop(future)
        try:
            outcomes, seconds = future.result()
        except self.workers.deaths as error:
            self._lost(first, last, future is self.alone, error)
        except CampaignError:
            raise
        except Exception as error:
            raise self.workers.failed(error) from error
        else:
            self.sizes.took(last - first, seconds)
            self.seconds += seconds
            self.succeeded = self.succeeded or any(
                outcome.results is not None for outcome in outcomes
            )
            self._store(first, last, outcomes)

    def _lost(self, first: int, last: int, alone: bool, error: BaseException) -> None:
        """
        Deal with a chunk whose process died: try it alone, then halve it until one run is left to
        blame.
        """
        if not alone:
            self.suspects.append((first, last))
        elif last - first > 1:
            half = (first + last) // 2
            self.suspects.extendleft([(half, last), (first, half)])
        else:
            self.deaths += 1
            if self.deaths >= HOPELESS and not self.succeeded:
                raise CampaignError(
                    f"{self.deaths} processes died one after the other and no run has succeeded "
                    f"({error}); try the task with n_jobs=1"
                ) from error
            self._store(first, last, [Outcome(None, DIED, DIED + "\n")])

    def _store(self, first: int, last: int, outcomes: list[Outcome]) -> None:
        parameters = [self.parameters[i] for i in range(first, last)]
        self.add(encoded(first, parameters, outcomes))
        self.failures += sum(outcome.results is None for outcome in outcomes)
        if self.failures:
            self.bar.set_postfix(failed=self.failures, refresh=False)
        self.bar.update(last - first)
