"""Sending runs to workers in chunks, and isolating runs that kill their process."""

import math
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, CancelledError, Future, wait
from traceback import extract_tb
from typing import Any

from trustlab.campaign.errors import CampaignError
from trustlab.campaign.executors import Workers
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
# Runs that may kill their process in a row, with none succeeding, before the campaign gives up.
HOPELESS = 5
DIED = (
    "WorkerDiedError: the process ended while it ran this, twice: it was killed, ran out of "
    "memory or crashed"
)


class ChunkSizes:
    """Sizes of chunks, from how long runs have taken so far; they have no effect on results."""

    def __init__(self, remaining: int, workers: int):
        self.remaining = remaining
        self.workers = max(1, workers)
        self.per_run: float | None = None
        self.largest = 1

    def next(self, available: int) -> int:
        """Return how many of the `available` consecutive runs the next chunk takes."""
        size = 1
        if self.per_run is not None:
            per_run = max(self.per_run, 1e-7)
            share = self.remaining * per_run / self.workers  # seconds left for each worker
            seconds = min(max(USUAL, share / 100.0), MOST)
            # Chunks become smaller towards the end, so that workers finish together.
            seconds = max(1.2 * LEAST, min(seconds, share / 3.0))
            size = min(math.ceil(seconds / per_run), GROWTH * self.largest, MOST_RUNS)
        size = min(max(1, size), available)
        self.remaining -= size
        return size

    def took(self, runs: int, seconds: float) -> None:
        """Learn from a chunk: so many runs took so many seconds in a worker."""
        mean = seconds / runs
        # The first run also imports and compiles: the first chunk that is quicker says more than
        # the mean of both.
        first = self.per_run is None or (self.largest == 1 and mean < self.per_run)
        self.per_run = mean if first else 0.5 * (self.per_run + mean)
        self.largest = max(self.largest, runs)


class Dispatcher:
    """
    Sends spans of runs to workers and stores their outcomes.

    A span is the first run and the one after the last. `store(first, parameters, outcomes)` is
    called for every chunk, in the order in which they finish.
    """

    def __init__(self, workers: Workers, parameters: Sequence[Mapping], store: Callable, bar: Any):
        self.workers = workers
        self.parameters = parameters
        self.store = store
        self.bar = bar
        self.pending: dict[Future, tuple[int, int]] = {}
        self.suspects: deque[tuple[int, int]] = deque()  # spans that were lost when a process died
        self.alone: Future | None = None  # the suspect that is being tried with nothing beside it
        self.deaths = 0
        self.failures = 0
        self.succeeded = False
        self.seconds = 0.0

    def run(self, spans: list[tuple[int, int]]) -> float:
        """Run all spans; return the seconds that the runs took, of all workers together."""
        queue = deque(spans)
        self.sizes = ChunkSizes(sum(last - first for first, last in spans), self.workers.count)
        try:
            while queue or self.suspects or self.pending:
                self._send_next(queue)
                for future in wait(self.pending, return_when=FIRST_COMPLETED).done:
                    self._receive(future)
        finally:
            self.workers.close(list(self.pending))
        return self.seconds

    def _send_next(self, queue: deque) -> None:
        """Keep all workers busy, or try a suspect once no other chunk is under way."""
        # When a process dies, all chunks on the same executor may be lost. Each is tried again
        # with nothing beside it, so that the next death has one possible cause.
        if self.suspects:
            if not self.pending:
                self.alone = self._send(*self.suspects.popleft())
            return
        while queue and len(self.pending) < self.workers.slots:
            first, last = queue.popleft()
            end = first + self.sizes.next(last - first)
            if end < last:
                queue.appendleft((end, last))
            self._send(first, end)

    def _send(self, first: int, last: int) -> Future:
        future = self.workers.submit(first, [dict(self.parameters[i]) for i in range(first, last)])
        self.pending[future] = (first, last)
        return future

    def _receive(self, future: Future) -> None:
        first, last = self.pending.pop(future)
        try:
            outcomes, seconds = future.result()
        except CampaignError:
            raise
        except BaseException as error:
            if _is_death(error):
                self._lost(first, last, future is self.alone, error)
                return
            raise CampaignError(
                f"a worker of {self.workers.name} could not run a chunk: {type(error).__name__}: "
                f"{error}; workers need the same versions of trustlab and its libraries as this "
                "process. Finished chunks are safe where `out` was given"
            ) from error
        self.sizes.took(last - first, seconds)
        self.seconds += seconds
        self.succeeded = self.succeeded or any(o.results is not None for o in outcomes)
        self._store(first, last, outcomes)

    def _lost(self, first: int, last: int, alone: bool, error: BaseException) -> None:
        """Try a chunk whose process died alone, then halve it until one run is to blame."""
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
        self.store(first, [self.parameters[i] for i in range(first, last)], outcomes)
        self.failures += sum(outcome.results is None for outcome in outcomes)
        if self.failures:
            self.bar.set_postfix(failed=self.failures, refresh=False)
        self.bar.update(last - first)


def _is_death(error: BaseException) -> bool:
    """
    Return whether a worker died with the chunk.

    Dask has an error of its own, and its executor fails to unpack a result that was lost with the
    workers that held it.
    """
    if isinstance(error, BrokenExecutor | CancelledError):
        return True
    places = [frame.filename for frame in extract_tb(error.__traceback__)]
    lost = isinstance(error, ValueError) and places[-1:] and places[-1].endswith("cfexecutor.py")
    return bool(lost) or type(error).__name__ == "KilledWorker"
