"""Campaigns on a real Dask cluster of two worker processes. Oracle: the serial table."""

import os
import signal
import threading
import time

import numpy as np
import pandas as pd
import pytest

import trustlab as tl
from trustlab.campaign import CampaignWarning

distributed = pytest.importorskip("distributed")
dask = pytest.importorskip("dask")


@pytest.fixture(scope="module")
def cluster():
    # A worker takes one run at a time: what waits on a worker that dies counts as having killed it.
    settings = {
        "distributed.scheduler.allowed-failures": 1,
        "distributed.scheduler.worker-saturation": 1.0,
    }
    with (
        dask.config.set(settings),
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, dashboard_address=None, silence_logs="CRITICAL"
        ) as local,
    ):
        yield local


@pytest.fixture(scope="module")
def client(cluster):
    with distributed.Client(cluster, set_as_default=False) as one:
        yield one


GRID = tl.parameter_grid(n=[5, 10], k=[1, 2], repeats=10)


def test_dask_gives_the_table_of_the_serial_run(mean_task, cluster, client, tmp_path):
    with pytest.warns(CampaignWarning):
        serial = tl.run_campaign(mean_task, GRID, seed=3, n_jobs=1)
    with pytest.warns(CampaignWarning):
        table = tl.run_campaign(
            mean_task, GRID, seed=3, executor=client.get_executor(), out=tmp_path
        )
    pd.testing.assert_frame_equal(serial, table, check_exact=True)
    assert table["mean"].to_numpy().tobytes() == serial["mean"].to_numpy().tobytes()
    assert table.attrs["executor"] == "ClientExecutor"


def test_parameters_are_left_as_they_are_on_their_way(client):
    """Tuples with a function first would be calls to an older Dask, and keys would be looked up."""

    def task(x, seed):
        return {"text": repr(x)}

    values = [("a", 1), [(len, "abc")], {"k": "task-0"}, "task-0", np.arange(3), None]
    runs = tl.parameter_grid(x=values)
    want = tl.run_campaign(task, runs, n_jobs=1)
    got = tl.run_campaign(task, runs, executor=client.get_executor())
    assert list(want["text"]) == list(got["text"]) == [repr(x) for x in values]


def test_one_of_two_workers_is_killed_half_way(cluster, client, tmp_path):
    log, mark = str(tmp_path / "log"), tmp_path / "killed"

    def task(x, seed):
        with open(log, "a") as file:
            file.write(f"{x} {os.getpid()}\n")
        until = time.monotonic() + (60.0 if x >= 150 else 0.01)  # not over before the kill
        while time.monotonic() < until and not mark.exists():
            time.sleep(0.01)
        return {"y": np.random.default_rng(seed).normal() + x}

    runs = tl.parameter_grid(x=range(200))
    killed = []

    def kill():
        until = time.monotonic() + 60
        while time.monotonic() < until:
            if os.path.exists(log):
                with open(log) as file:
                    lines = file.read().splitlines()
                pids = {line.split()[1] for line in lines}
                if len(lines) > 60 and len(pids) > 1:
                    killed.append(int(lines[-1].split()[1]))
                    os.kill(killed[0], signal.SIGKILL)
                    mark.touch()
                    return
            time.sleep(0.01)

    thread = threading.Thread(target=kill)
    thread.start()
    table = tl.run_campaign(
        task, runs, seed=5, executor=client.get_executor(), out=tmp_path / "out"
    )
    thread.join()
    assert killed, "no worker was killed"
    assert len(table) == 200
    assert table.attrs["failed"] == 0
    with open(log) as file:
        counts = pd.Series([line.split()[0] for line in file]).value_counts()
    assert len(counts) == 200
    os.remove(log)
    pd.testing.assert_frame_equal(
        table, tl.run_campaign(task, runs, seed=5, n_jobs=1), check_exact=True
    )


def test_a_run_that_kills_its_worker_every_time_is_recorded(cluster, client):
    def task(i, seed):
        if i == 3:
            os.kill(os.getpid(), signal.SIGKILL)
        return {"y": i}

    with pytest.warns(CampaignWarning, match="1 of 8 runs failed; run 3: WorkerDiedError"):
        table = tl.run_campaign(task, tl.parameter_grid(i=range(8)), executor=client.get_executor())
    assert list(table["y"].drop(3)) == [0, 1, 2, 4, 5, 6, 7]
