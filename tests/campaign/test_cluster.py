"""Campaigns on a real Dask cluster of two worker processes. Oracle: the serial table."""

import os
import signal
import socket
import threading
import time

import numpy as np
import pandas as pd
import pytest

import trustlab as tl
from trustlab.campaign import CampaignError, CampaignWarning

distributed = pytest.importorskip("distributed")
dask = pytest.importorskip("dask")


@pytest.fixture(scope="module")
def cluster():
    with (
        dask.config.set({"distributed.scheduler.allowed-failures": 1}),
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
    for i, where in enumerate((client, cluster, cluster.scheduler_address)):
        with pytest.warns(CampaignWarning):
            table = tl.run_campaign(mean_task, GRID, seed=3, cluster=where, out=tmp_path / str(i))
        pd.testing.assert_frame_equal(serial, table, check_exact=True)
        assert table["mean"].to_numpy().tobytes() == serial["mean"].to_numpy().tobytes()
        assert table.attrs["executor"] == "dask"


def test_parameters_are_left_as_they_are_on_their_way(client):
    """Tuples with a function first would be calls to an older Dask, and keys would be looked up."""

    def task(x, seed):
        return {"text": repr(x)}

    values = [("a", 1), [(len, "abc")], {"k": "task-0"}, "task-0", np.arange(3), None]
    runs = tl.parameter_grid(x=values)
    want = tl.run_campaign(task, runs, n_jobs=1)
    got = tl.run_campaign(task, runs, cluster=client)
    assert list(want["text"]) == list(got["text"]) == [repr(x) for x in values]


def test_one_of_two_workers_is_killed_half_way(cluster, client, tmp_path):
    log = str(tmp_path / "log")

    def task(x, seed):
        with open(log, "a") as file:
            file.write(f"{x} {os.getpid()}\n")
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
                    return
            time.sleep(0.01)

    thread = threading.Thread(target=kill)
    thread.start()
    table = tl.run_campaign(task, runs, seed=5, cluster=client, out=tmp_path / "out")
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
        table = tl.run_campaign(task, tl.parameter_grid(i=range(8)), cluster=client)
    assert list(table["y"].drop(3)) == [0, 1, 2, 4, 5, 6, 7]


@pytest.mark.parametrize(
    "address",
    [
        "tcp://127.0.0.1:1",
        "127.0.0.1:1",
        "nonsense",
        "abc://x:1",
        "tcp://no-such-host.invalid:8786",
    ],
)
def test_a_scheduler_that_cannot_be_reached_is_an_error_with_the_address(address, monkeypatch):
    monkeypatch.setattr("trustlab.campaign.dask_cluster.CONNECT", 1.0)
    with pytest.raises(
        CampaignError, match=f"no Dask scheduler could be reached at '{address}' within 1 s"
    ):
        tl.run_campaign(lambda seed: {"y": 1}, [{}], cluster=address)


def test_a_server_that_takes_the_connection_and_says_nothing_is_no_wait_for_ever(monkeypatch):
    monkeypatch.setattr("trustlab.campaign.dask_cluster.CONNECT", 0.5)
    with socket.create_server(("127.0.0.1", 0)) as silent:
        port = silent.getsockname()[1]
        with pytest.raises(
            CampaignError, match=f"no Dask scheduler could be reached at 'tcp://127.0.0.1:{port}'"
        ):
            tl.run_campaign(lambda seed: {"y": 1}, [{}], cluster=f"tcp://127.0.0.1:{port}")


@pytest.mark.parametrize("given", [5, "", None.__class__, object()])
def test_what_is_no_cluster_is_refused(given):
    with pytest.raises(CampaignError, match=r"cluster must be a distributed\.Client"):
        tl.run_campaign(lambda seed: {"y": 1}, [{}], cluster=given)


def test_a_closed_client_is_refused(cluster):
    with distributed.Client(cluster, set_as_default=False) as one:
        pass
    with pytest.raises(CampaignError, match="the client is not connected"):
        tl.run_campaign(lambda seed: {"y": 1}, [{}], cluster=one)


def test_without_workers_or_without_its_scheduler_a_campaign_gives_up_and_goes_on_later(
    tmp_path, monkeypatch
):
    monkeypatch.setattr("trustlab.campaign.dask_cluster.CONNECT", 0.5)
    monkeypatch.setattr("trustlab.campaign.dask_cluster.PATIENCE", 1.0)
    monkeypatch.setattr("trustlab.campaign.dispatch.WATCH", 0.2)
    stop, quick = tmp_path / "stop", tmp_path / "quick"

    def task(x, seed):
        if x == 40:
            stop.touch()
        if not quick.exists():
            time.sleep(0.005 if x < 40 else 0.2)
        return {"y": x}

    runs = tl.parameter_grid(x=range(80))
    local = distributed.LocalCluster(
        n_workers=0,
        processes=False,
        dashboard_address=":0",
        silence_logs="CRITICAL",
        threads_per_worker=1,
    )
    with pytest.raises(CampaignError, match=r"has no workers; start some"):
        tl.run_campaign(task, runs, cluster=local, out=tmp_path / "out")
    local.scale(1)

    def end():
        until = time.monotonic() + 60
        while not stop.exists() and time.monotonic() < until:
            time.sleep(0.01)
        local.scale(0)

    thread = threading.Thread(target=end)
    thread.start()
    with pytest.raises(
        CampaignError, match=r"is gone: no workers; finished chunks are safe.*call again"
    ):
        tl.run_campaign(task, runs, cluster=local, out=tmp_path / "out")
    thread.join()
    local.close()
    quick.touch()
    table = tl.run_campaign(task, runs, n_jobs=1, out=tmp_path / "out")
    assert 0 < table.attrs["resumed"] < 80
    assert list(table["y"]) == list(range(80))


def test_a_scheduler_that_goes_away_is_an_error_and_not_a_wait_for_ever(tmp_path, monkeypatch):
    monkeypatch.setattr("trustlab.campaign.dask_cluster.CONNECT", 0.5)
    monkeypatch.setattr("trustlab.campaign.dask_cluster.PATIENCE", 2.0)
    monkeypatch.setattr("trustlab.campaign.dispatch.WATCH", 0.2)
    local = distributed.LocalCluster(
        n_workers=1,
        processes=False,
        dashboard_address=":0",
        silence_logs="CRITICAL",
        threads_per_worker=1,
    )
    folder = tmp_path / "out"

    def task(x, seed):
        time.sleep(0.02)
        return {"y": x}

    def end():
        until = time.monotonic() + 60
        while not list(folder.glob("chunks/*.parquet")) and time.monotonic() < until:
            time.sleep(0.01)
        local.close()

    thread = threading.Thread(target=end)
    thread.start()
    with pytest.raises(CampaignError, match=r"the cluster at inproc.* is gone: the connection is"):
        tl.run_campaign(task, tl.parameter_grid(x=range(2000)), cluster=local, out=folder)
    thread.join()
    assert 0 < len(tl.read_campaign(folder)) < 2000
