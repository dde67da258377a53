"""Where chunks run: in this process, in others, or on any `concurrent.futures` executor."""

import functools
import os
from collections.abc import Callable
from concurrent.futures import BrokenExecutor, CancelledError, Executor, Future
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from trustlab.campaign.errors import CampaignError
from trustlab.campaign.worker import exit_with_parent, pickled, pickled_task, run_chunk, run_pickled

# Seconds after which idle processes end.
IDLE = 300

THREADS = [f"{library}_NUM_THREADS" for library in ("OMP", "OPENBLAS", "MKL", "NUMEXPR", "NUMBA")]


class Workers:
    """
    Workers behind an executor; `make` returns it, and a new one when the death of a process has
    broken it.
    """

    # Exceptions of a future whose worker died.
    deaths: tuple[type[BaseException], ...] = (BrokenExecutor, CancelledError)

    def __init__(
        self,
        task: Callable,
        seed: np.random.SeedSequence,
        name: str,
        make: Callable[[], Executor],
        count: int = 1,
    ):
        self.task = pickled_task(task)
        self.seed = seed
        self.name = name
        self.make, self.count = make, count
        self.executor: Any = make()

    @property
    def slots(self) -> int:
        """
        How many chunks are under way at most: two for each worker, so that none waits for the next.
        """
        return 2 * self.count

    def submit(self, first: int, parameters: list[dict]) -> Future:
        """Send a chunk, of which `first` is the index of the first run."""
        data = pickled("parameters", (self.task, self.seed, first, parameters))
        try:
            return self.executor.submit(run_pickled, data)
        except (
            RuntimeError
        ) as error:  # broken by the death of a process, or shut down by someone else
            self.executor, broken = self.make(), self.executor
            if self.executor is broken:
                if not isinstance(error, BrokenExecutor):
                    raise
                raise CampaignError(
                    f"{type(broken).__name__} takes no more work ({error}); runs {first} to "
                    f"{first + len(parameters) - 1} were lost with it or still to be sent. "
                    "Finished chunks are safe where `out` was given: call again with a new "
                    "executor, or give a function that makes one, so that the campaign goes on "
                    "by itself"
                ) from error
            return self.executor.submit(run_pickled, data)

    def watch(self) -> None:
        """
        Raise where no answer can be expected any more; called every few seconds while nothing
        arrives.
        """

    def failed(self, error: Exception) -> CampaignError:
        """Return what to raise for an error that no run raised."""
        return CampaignError(
            f"a worker of {self.name} could not run a chunk: {type(error).__name__}: {error}; "
            "workers need the same versions of trustlab and its libraries as this process"
        )

    def close(self, left: list[Future]) -> None:
        """
        Release what was taken; `left` are the chunks under way where the campaign was broken off.
        """
        for future in left:
            future.cancel()


class InProcess(Workers):
    """
    No other workers: each chunk runs in this process when it is submitted, and nothing is pickled.
    """

    name = "serial"
    slots = 1
    count = 1

    def __init__(self, task: Callable, seed: np.random.SeedSequence):
        self.function, self.seed = task, seed

    def submit(self, first: int, parameters: list[dict]) -> Future:
        """
        Run a chunk. Errors of runs are results; what escapes, such as KeyboardInterrupt, ends the
        campaign.
        """
        future: Future = Future()
        future.set_result(run_chunk(self.function, self.seed, first, parameters))
        return future


class _Loky(Workers):
    """Processes of this machine."""

    def close(self, left: list[Future]) -> None:
        """Keep the processes for the next campaign, or kill them where they are still at work."""
        if left:
            self.executor.shutdown(wait=False, kill_workers=True)


@functools.cache
def _lifeline() -> tuple[Connection, Connection]:
    """
    Return a pipe, made once for a process: whoever reads from it sees when this process is gone.
    """
    return Pipe(duplex=False)


def loky_workers(task: Callable, seed: np.random.SeedSequence, count: int) -> Workers:
    """Return processes of this machine: loky's reusable executor."""
    import loky

    # Linear algebra in every process takes its share of the cores, unless the user has said
    # otherwise.
    share = str(max(1, loky.cpu_count() // count))
    options = {
        "timeout": IDLE,
        "env": {name: os.environ.get(name, share) for name in THREADS},
        "initializer": exit_with_parent,
        "initargs": _lifeline()[:1],
    }
    return _Loky(task, seed, "loky", lambda: loky.get_reusable_executor(count, **options), count)


class _Made(Workers):
    """Workers of an executor that the user's function made for this campaign alone."""

    def close(self, left: list[Future]) -> None:
        """Shut the executor down."""
        self.executor.shutdown(wait=not left, cancel_futures=True)


def brought_workers(
    task: Callable, seed: np.random.SeedSequence, executor: object, count: int | None
) -> Workers:
    """
    Return the workers of an executor that the user brings, or of a function that makes executors.
    """
    workers = None
    if isinstance(executor, Executor):
        workers = Workers(task, seed, type(executor).__name__, lambda: executor)
    elif callable(executor):
        workers = _Made(task, seed, getattr(executor, "__name__", "executor"), executor)
    if workers is None or not isinstance(workers.executor, Executor):
        raise ValueError(
            f"executor must be a concurrent.futures.Executor, or make one, got {executor!r:.60}"
        )
    # Executors of the standard library, loky and mpi4py know how many workers they have; others may
    # not.
    workers.count = count or getattr(workers.executor, "_max_workers", None) or os.cpu_count() or 1
    return workers
