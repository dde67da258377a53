"""The workers of a Dask cluster; the extra `cluster` is imported here and nowhere else."""

import asyncio
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack
from time import monotonic
from typing import Any

import numpy as np

from trustlab.campaign.errors import CampaignError
from trustlab.campaign.executors import Workers
from trustlab.models.extras import extra

# Seconds after which a scheduler that does not answer counts as unreachable.
CONNECT = 5.0
# Seconds that a cluster may be without workers, or its scheduler without connection, before the
# campaign gives up.
PATIENCE = 60.0


class DaskWorkers(Workers):
    """Workers of a cluster, as many as there are at any time, by way of a client's own executor."""

    def __init__(self, task: Callable, seed: np.random.SeedSequence, cluster: object):
        self.client, self.own = _client(cluster)
        self.address = self.client.scheduler.address if self.client.scheduler else "its scheduler"
        self.seen = monotonic()  # when there was last a worker
        with ExitStack() as unless_ready:
            unless_ready.callback(self.close, [])
            super().__init__(task, seed, "dask", lambda: self.client.get_executor(pure=False))
            from distributed.scheduler import KilledWorker

            self.deaths = (*Workers.deaths, KilledWorker)
            try:
                self.client.wait_for_workers(1, timeout=2 * CONNECT)
            except TimeoutError:
                remedy = f"start some with `dask worker {self.address}`"
                raise CampaignError(
                    f"the scheduler at {self.address} has no workers; {remedy}"
                ) from None
            self.watch()
            unless_ready.pop_all()

    def submit(self, first: int, parameters: list[dict]) -> Future:
        """Send a chunk."""
        try:
            return super().submit(first, parameters)
        except CampaignError:
            raise
        except Exception as error:  # whatever a closed client raises
            raise self._gone() from error

    def watch(self) -> None:
        """Count threads of workers; give up where there have been none for long."""
        try:
            threads = sum(self.client.nthreads().values()) if self.client.status == "running" else 0
        except Exception:  # whatever a lost connection raises
            threads = 0
        if threads:
            self.seen, self.count = monotonic(), threads
        elif monotonic() - self.seen > PATIENCE or self.client.status == "closed":
            raise self._gone()

    def failed(self, error: Exception) -> CampaignError:
        """Return what to raise for an error that no run raised."""
        return super().failed(error) if self.client.status == "running" else self._gone()

    def _gone(self) -> CampaignError:
        status = self.client.status
        state = "no workers" if status == "running" else f"the connection is {status}"
        return CampaignError(
            f"the cluster at {self.address} is gone: {state}; finished chunks are safe where "
            "`out` was given: call again with the same arguments to go on"
        )

    def close(self, left: list[Future]) -> None:
        """Cancel what is under way, and close the client if it was made here."""
        try:
            if self.client.status == "running":
                super().close(left)
        finally:
            if self.own:
                self.client.close(timeout=CONNECT)


def _client(cluster: Any) -> tuple[Any, bool]:
    """Return a client of a cluster, and whether it was made here."""
    with extra("cluster"):
        from distributed import Client
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
            "cluster must be a distributed.Client, a running cluster or the address of a "
            f"scheduler such as 'tcp://127.0.0.1:8786', got {cluster!r}"
        )
    try:
        _reach(address)
        return Client(address, timeout=CONNECT, set_as_default=False), True
    except Exception as error:
        raise CampaignError(
            f"no Dask scheduler could be reached at {address!r} within {CONNECT:.0f} s "
            f"({str(error) or type(error).__name__}); start one with `dask scheduler`, and mind "
            "port, firewalls and, where it asks for TLS, give a Client with its `security`"
        ) from error


def _reach(address: str) -> None:
    """
    Connect to a scheduler and disconnect: unlike a Client, this fails quietly and within the time
    limit.
    """
    from distributed.comm import connect

    async def greet() -> None:
        await (await connect(address, timeout=CONNECT)).close()

    # In a thread of its own, because a notebook already runs an event loop in this one.
    thread = ThreadPoolExecutor(1)
    try:
        thread.submit(asyncio.run, asyncio.wait_for(greet(), CONNECT)).result(2 * CONNECT)
    finally:
        thread.shutdown(wait=False)
