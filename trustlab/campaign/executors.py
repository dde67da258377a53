"""Where chunks run: here, in other processes, on a cluster."""

from __future__ import annotations

import atexit
import os
import pickle
from collections.abc import Callable
from concurrent.futures import FIRST_COMPLETED, Future, wait

from trustlab.campaign.errors import CampaignError, WorkerDiedError
from trustlab.campaign.worker import end_with, packed, run_chunk

__all__ = ["Loky", "Serial"]


IDLE = 300
"""Seconds after which processes end that have nothing to do."""

_kept: dict = {}  # the processes of the last campaign, for the next; joblib's own are left alone
atexit.register(_kept.clear)  # while the modules that end them are still there


class Serial:
    """
    One chunk after the other in this process.

    Parameters
    ----------
    task : callable
        The task.
    seed : tuple
        As in `worker.run_seed`.
    """

    name = "serial"
    workers = slots = 1

    def __init__(self, task: Callable, seed: tuple):
        self.task, self.seed = task, seed

    def submit(self, first: int, parameters: list[dict]) -> object:
        """
        Take a chunk.

        Parameters
        ----------
        first : int
            Index of its first run.
        parameters : list of dict
            Parameters of its runs.
        """
        return _Later(first, parameters)

    def done(self, waiting: list) -> list:
        """
        Run the first chunk.

        Parameters
        ----------
        waiting : list
            What `submit` returned.
        """
        return waiting[:1]

    def outcome(self, later: object) -> tuple[list[tuple], float]:
        """
        Return what `worker.run_chunk` returned.

        Parameters
        ----------
        later : object
            What `done` returned.
        """
        return run_chunk(self.task, self.seed, later.first, later.parameters)

    def close(self, finished: bool) -> None:
        """
        Let go of what was taken.

        Parameters
        ----------
        finished : bool
            Whether the campaign came to its end.
        """


class _Later:
    def __init__(self, first: int, parameters: list[dict]):
        self.first, self.parameters = first, parameters


class Loky:
    """
    Processes of this machine, kept by joblib's loky for the next campaign.

    Parameters
    ----------
    task : callable
        The task.
    seed : tuple
        As in `worker.run_seed`.
    n_jobs : int
        How many processes.
    """

    name = "loky"

    def __init__(self, task: Callable, seed: tuple, n_jobs: int):
        self.task, self.seed, self.workers = packed(task), seed, n_jobs
        self.slots = 2 * n_jobs
        self._start()

    def _start(self) -> None:
        from joblib.externals.loky import ProcessPoolExecutor, cpu_count

        threads = str(max(1, cpu_count() // self.workers))
        names = ("OMP", "OPENBLAS", "MKL", "NUMEXPR", "NUMBA")
        env = {f"{name}_NUM_THREADS": os.environ.get(f"{name}_NUM_THREADS", threads) for name in names}
        key = (os.getpid(), self.workers, tuple(env.values()))
        if _kept.get("key") != key:
            if _kept and _kept["key"][0] == os.getpid():
                _kept["executor"].shutdown(wait=False, kill_workers=True)
            executor = ProcessPoolExecutor(
                self.workers, timeout=IDLE, env=env, initializer=end_with, initargs=(os.getpid(),)
            )
            _kept.update(key=key, executor=executor)
        self.executor = _kept["executor"]

    def submit(self, first: int, parameters: list[dict]) -> Future:
        """
        Send a chunk.

        Parameters
        ----------
        first : int
            Index of its first run.
        parameters : list of dict
            Parameters of its runs.
        """
        try:
            return self.executor.submit(run_chunk, self.task, self.seed, first, parameters)
        except RuntimeError:  # a process died, or another campaign of this process was stopped
            if _kept.get("executor") is self.executor:
                _kept.clear()
            self._start()
            return self.executor.submit(run_chunk, self.task, self.seed, first, parameters)

    def done(self, waiting: list[Future]) -> list[Future]:
        """
        Wait until a chunk is done.

        Parameters
        ----------
        waiting : list of Future
            Chunks under way.
        """
        return list(wait(waiting, return_when=FIRST_COMPLETED)[0])

    def outcome(self, future: Future) -> tuple[list[tuple], float]:
        """
        Return what `worker.run_chunk` returned.

        Parameters
        ----------
        future : Future
            A chunk that is done.

        Raises
        ------
        WorkerDiedError
            If its process ended.
        CampaignError
            If the parameters could not be sent.
        """
        from concurrent.futures import BrokenExecutor, CancelledError

        from joblib.externals.loky.process_executor import ShutdownExecutorError

        try:
            return future.result()
        except (BrokenExecutor, CancelledError, ShutdownExecutorError) as error:
            raise WorkerDiedError(str(error)) from error
        except (pickle.PicklingError, TypeError, AttributeError) as error:
            raise CampaignError(
                f"parameters cannot be sent to other processes: {error}; run with n_jobs=1"
            ) from error

    def close(self, finished: bool) -> None:
        """
        Stop what is under way; keep the processes if the campaign came to its end.

        Parameters
        ----------
        finished : bool
            Whether it did.
        """
        if not finished:
            self.executor.shutdown(wait=False, kill_workers=True)
            if _kept.get("executor") is self.executor:
                _kept.clear()
