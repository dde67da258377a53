"""Chunks on a Dask cluster; the extra `cluster` is imported here and nowhere else."""

from __future__ import annotations

import asyncio
import queue
import threading
from collections.abc import Callable
from time import monotonic

from trustlab.campaign.errors import CampaignError, WorkerDiedError
from trustlab.campaign.worker import as_bytes, packed, run_packed

__all__ = ["DaskCluster"]

CONNECT = 5.0
"""Seconds after which a scheduler that does not answer counts as unreachable."""
PATIENCE = 60.0
"""Seconds that a cluster may be without workers, or its scheduler without connection, before the campaign gives up."""
LOOK = 2.0
"""Seconds between two looks at the cluster."""


class DaskCluster:
    """
    The workers of a cluster, as many as there are at any time.

    Parameters
    ----------
    task : callable
        The task.
    seed : tuple
        As in `worker.run_seed`.
    cluster : distributed.Client, distributed cluster or str
        A client, a cluster such as LocalCluster, or the address of a scheduler.

    Raises
    ------
    CampaignError
        If the extra is not installed, the scheduler cannot be reached, or it has no workers.
    """

    name = "dask"

    def __init__(self, task: Callable, seed: tuple, cluster: object):
        self.task, self.seed = packed(task), seed
        self.client, self.own = _client(cluster)
        self.address = self.client.scheduler.address if self.client.scheduler else "its scheduler"
        self.finished: queue.SimpleQueue = queue.SimpleQueue()
        self.futures: set = set()
        self.workers, self.slots, self.seen = 1, 2, monotonic()
        try:
            if not self._look():
                self._wait_for_workers()
        except BaseException:
            self.close(False)
            raise

    def _wait_for_workers(self) -> None:
        try:
            self.client.wait_for_workers(1, timeout=2 * CONNECT)
        except TimeoutError:
            raise CampaignError(
                f"the scheduler at {self.address} has no workers; start some with `dask worker {self.address}`"
            ) from None
        self._look()

    def _look(self) -> int:
        """Count threads of workers; give up where there have been none for long."""
        try:
            threads = sum(self.client.nthreads().values()) if self.client.status == "running" else 0
        except Exception:  # whatever a lost connection raises
            threads = 0
        now = monotonic()
        if threads:
            self.seen, self.workers, self.slots = now, threads, 2 * threads
        elif now - self.seen > PATIENCE or self.client.status == "closed":
            raise CampaignError(self._gone())
        return threads

    def _gone(self) -> str:
        status = self.client.status
        state = "no workers" if status == "running" else f"the connection is {status}"
        return (
            f"the cluster at {self.address} is gone: {state}; finished chunks are safe where `out` was given: call again "
            "with the same arguments to go on"
        )

    def submit(self, first: int, parameters: list[dict]) -> object:
        """
        Send a chunk.

        Parameters
        ----------
        first : int
            Index of its first run.
        parameters : list of dict
            Parameters of its runs.

        Raises
        ------
        CampaignError
            If it cannot be sent.
        """
        data = as_bytes("parameters", (self.task, self.seed, first, parameters))
        try:
            future = self.client.submit(run_packed, data, pure=False)
        except Exception as error:  # whatever a closed client raises
            raise CampaignError(self._gone()) from error
        self.futures.add(future)
        future.add_done_callback(self.finished.put)
        return future

    def done(self, waiting: list) -> list:
        """
        Wait until a chunk is done, with an eye on the cluster.

        Parameters
        ----------
        waiting : list
            Chunks under way.

        Raises
        ------
        CampaignError
            If the cluster is gone.
        """
        while True:
            ready = []
            try:
                ready.append(self.finished.get(timeout=LOOK))
                while True:
                    ready.append(self.finished.get_nowait())
            except queue.Empty:
                pass
            ready = [future for future in ready if future in self.futures]
            if not ready or monotonic() - self.seen > LOOK:
                self._look()
            if ready:
                return list(dict.fromkeys(ready))

    def outcome(self, future: object) -> tuple[list[tuple], float]:
        """
        Return what `worker.run_chunk` returned.

        Parameters
        ----------
        future : distributed.Future
            A chunk that is done.

        Raises
        ------
        WorkerDiedError
            If workers died of it, or its result was lost.
        CampaignError
            If a worker could not load it.
        """
        from concurrent.futures import CancelledError

        from distributed.scheduler import KilledWorker

        self.futures.discard(future)
        try:
            return future.result(timeout=PATIENCE)
        except (KilledWorker, CancelledError, TimeoutError) as error:
            raise WorkerDiedError(str(error)) from error
        except CampaignError:
            raise
        except Exception as error:
            if self.client.status != "running":
                raise CampaignError(self._gone()) from error
            raise CampaignError(
                f"a worker of {self.address} could not run a chunk: {type(error).__name__}: {error}; workers need the same "
                "versions of trustlab and its libraries as this process"
            ) from error
        finally:
            future.release()

    def close(self, finished: bool) -> None:
        """
        Cancel what is under way; close the client if it was made here.

        Parameters
        ----------
        finished : bool
            Whether the campaign came to its end.
        """
        try:
            if self.futures and self.client.status == "running":
                self.client.cancel(list(self.futures), force=True)
        finally:
            self.futures.clear()
            if self.own:
                self.client.close(timeout=CONNECT)


def _client(cluster: object) -> tuple[object, bool]:
    try:
        from distributed import Client
    except ImportError as error:
        raise CampaignError(
            f"`cluster` needs Dask, which cannot be imported ({error}); install trustlab with its extra: trustlab[cluster]"
        ) from error
    if isinstance(cluster, Client):
        if cluster.asynchronous:
            raise CampaignError(
                "the client is asynchronous; give an ordinary one, or the address of its scheduler"
            )
        if cluster.status != "running":
            raise CampaignError(
                f"the client is not connected, its status is {cluster.status}; make a new one"
            )
        return cluster, False
    address = cluster if isinstance(cluster, str) else getattr(cluster, "scheduler_address", None)
    if not isinstance(address, str) or not address:
        raise CampaignError(
            "cluster must be a distributed.Client, a running cluster or the address of a scheduler such as "
            f"'tcp://127.0.0.1:8786', got {cluster!r}"
        )
    _reach(address)
    try:
        return Client(address, timeout=CONNECT, set_as_default=False), True
    except Exception as error:
        raise CampaignError(_unreachable(address, error)) from error


def _unreachable(address: str, error: BaseException) -> str:
    return (
        f"no Dask scheduler could be reached at {address!r} within {CONNECT:.0f} s ({str(error) or type(error).__name__}); start one with `dask "
        "scheduler`, and mind port, firewalls and, where it asks for TLS, give a Client with its `security`"
    )


def _reach(address: str) -> None:
    """Shake hands with a scheduler and leave again: a client that cannot connect ends less quickly and less quietly."""
    from distributed.comm import connect

    async def greet() -> None:
        comm = await connect(address, timeout=CONNECT)
        await comm.close()

    failed: list[BaseException] = [TimeoutError("no answer")]

    def run() -> None:
        try:
            asyncio.run(asyncio.wait_for(greet(), CONNECT))
            failed.clear()
        except BaseException as error:
            failed[0] = error

    thread = threading.Thread(
        target=run, daemon=True
    )  # a notebook runs an event loop in the thread that called
    thread.start()
    thread.join(2 * CONNECT)
    if failed:
        raise CampaignError(_unreachable(address, failed[0])) from failed[0]
