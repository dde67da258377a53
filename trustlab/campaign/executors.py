"""Where chunks run: in this process, in processes that loky keeps, or on the user's executor."""

import functools
import os
from collections.abc import Callable
from concurrent.futures import Executor, Future
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from trustlab.campaign.errors import CampaignError
from trustlab.campaign.imported import forget_sources, package_of, source_digest
from trustlab.campaign.worker import exit_with_parent, pickled, run_chunk, run_pickled, running_task

# Seconds after which idle processes end.
IDLE = 300

THREADS = [f"{library}_NUM_THREADS" for library in ("OMP", "OPENBLAS", "MKL", "NUMEXPR", "NUMBA")]


class Workers:
    """
    Workers behind an executor that the user brought; it stays open.

    `slots` is how many chunks are sent at a time: two for each worker, so that none waits.
    """

    def __init__(
        self, task: Callable, seed: np.random.SeedSequence, executor: Any, count: int | None = None
    ):
        if not isinstance(executor, Executor):
            raise ValueError(
                f"executor must be a concurrent.futures.Executor, got {executor!r:.60}; on Dask "
                "give client.get_executor()"
            )
        self.name = type(executor).__name__
        self.executor: Any = executor
        # Executors of the standard library, loky and mpi4py know their workers; others may not.
        self.count = count or getattr(executor, "_max_workers", None) or os.cpu_count() or 1
        self.slots = 2 * self.count
        self.task = pickled("task", task)
        self.seed = seed

    def submit(self, first: int, parameters: list[dict]) -> Future:
        """Send a chunk, of which `first` is the index of the first run."""
        data = pickled("parameters", (self.task, self.seed, first, parameters))
        try:
            return self.executor.submit(run_pickled, data)
        except RuntimeError as error:  # broken by the death of a process, or shut down
            self.renew(error, first, first + len(parameters) - 1)
            return self.executor.submit(run_pickled, data)

    def renew(self, error: RuntimeError, first: int, last: int) -> None:
        """Replace an executor that takes no more work, or raise."""
        raise CampaignError(
            f"{self.name} takes no more work ({error}); runs {first} to {last} were lost with it "
            "or still to be sent. Finished chunks are safe where `out` was given: call again with "
            "a new executor"
        ) from error

    def close(self, pending: list[Future]) -> None:
        """Cancel chunks that are under way when a campaign is broken off."""
        for future in pending:
            future.cancel()


class Serial(Workers):
    """No workers: each chunk runs in this process when it is submitted; nothing is pickled."""

    def __init__(self, task: Callable, seed: np.random.SeedSequence):
        self.name = "serial"
        self.count = 1
        self.slots = 1
        self.function = task
        self.seed = seed

    def submit(self, first: int, parameters: list[dict]) -> Future:
        """Run a chunk; what is no error of a run, such as KeyboardInterrupt, ends the campaign."""
        future: Future = Future()
        future.set_result(run_chunk(self.function, self.seed, first, parameters))
        return future


class Processes(Workers):
    """Processes of this machine, which loky keeps for the next campaign."""

    def __init__(self, task: Callable, seed: np.random.SeedSequence, count: int):
        import loky

        # Linear algebra in every process takes its share of the cores, unless the user decides.
        share = str(max(1, loky.cpu_count() // count))
        options = {
            "timeout": IDLE,
            "env": {name: os.environ.get(name, share) for name in THREADS},
            "initializer": exit_with_parent,
            # With other sources loky starts new processes, which import them again.
            "initargs": (_lifeline()[0], _sources(task)),
        }
        self.make = functools.partial(loky.get_reusable_executor, count, **options)
        super().__init__(task, seed, self.make(), count)
        self.name = "loky"

    def renew(self, error: RuntimeError, first: int, last: int) -> None:
        """Start new processes after one has died."""
        self.executor = self.make()

    def close(self, pending: list[Future]) -> None:
        """Keep the processes for the next campaign; kill them if they are still at work."""
        if pending:
            self.executor.shutdown(wait=False, kill_workers=True)


@functools.cache
def _lifeline() -> tuple[Connection, Connection]:
    """Return a pipe made once for a process: its readers see when this process is gone."""
    return Pipe(duplex=False)


def _sources(task: Callable) -> str:
    """Return a digest of a task's module and of what that imports from its package."""
    package = package_of(getattr(task, "__module__", ""))
    if package is None:
        return ""
    forget_sources()
    return source_digest(package.file, root=package.root)


def workers_for(
    task: Callable, seed: np.random.SeedSequence, n_jobs: int, executor: object
) -> Workers:
    """Return where chunks run."""
    if executor is not None:
        return Workers(task, seed, executor, n_jobs if n_jobs > 0 else None)
    if n_jobs < 0:
        import loky

        # The cores are taken already where this is part of a run of another campaign.
        n_jobs = 1 if running_task() else max(1, loky.cpu_count() + 1 + n_jobs)
    return Serial(task, seed) if n_jobs == 1 else Processes(task, seed, n_jobs)
