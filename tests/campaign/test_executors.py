"""Campaigns on executors that a user brings. Oracle: the serial table."""

import os
import signal
import threading
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from multiprocessing import get_context

import pandas as pd
import pytest

import trustlab as tl
from trustlab.campaign import CampaignError

GRID = tl.parameter_grid(n=[5, 10], k=[1, 2], repeats=10)


def processes():
    return ProcessPoolExecutor(2, mp_context=get_context("spawn"))


@pytest.mark.filterwarnings("ignore::trustlab.campaign.CampaignWarning")
@pytest.mark.parametrize("make", [lambda: ThreadPoolExecutor(3), processes])
def test_any_executor_gives_the_table_of_the_serial_run(mean_task, tmp_path, make):
    serial = tl.run_campaign(mean_task, GRID, seed=3, n_jobs=1)
    with make() as executor:
        table = tl.run_campaign(mean_task, GRID, seed=3, executor=executor, out=tmp_path)
        assert executor.submit(len, "open").result() == 4  # it is the user's, and stays open
    pd.testing.assert_frame_equal(serial, table, check_exact=True)
    assert table["mean"].to_numpy().tobytes() == serial["mean"].to_numpy().tobytes()
    assert table.attrs["executor"] == type(executor).__name__


def test_an_executor_that_broke_for_good_is_an_error_that_names_runs_and_the_campaign_goes_on_later(
    tmp_path,
):
    def task(i, seed):
        if i == 7 and not (tmp_path / "calm").exists():
            os.kill(os.getpid(), signal.SIGKILL)
        return {"y": i}

    runs, out = tl.parameter_grid(i=range(20)), tmp_path / "out"
    with (
        processes() as executor,
        pytest.raises(
            CampaignError,
            match=r"ProcessPoolExecutor takes no more work .*; runs \d+ to \d+ were lost",
        ),
    ):
        tl.run_campaign(task, runs, executor=executor, out=out)
    (tmp_path / "calm").touch()
    table = tl.run_campaign(task, runs, n_jobs=1, out=out)
    assert list(table["y"]) == list(range(20))


class Adapter(Executor):
    """As of a cluster: it knows neither how many workers it has nor how to cancel."""

    def __init__(self):
        self.most = self.now = 0
        self.lock = threading.Lock()

    def submit(self, function, /, *args):
        future = Future()
        with self.lock:
            self.now += 1
            self.most = max(self.most, self.now)

        def run():
            result = function(*args)
            with self.lock:
                self.now -= 1
            future.set_result(result)

        threading.Timer(0.1, run).start()
        return future


def test_the_workers_of_an_adapter_can_be_said():
    adapter = Adapter()
    table = tl.run_campaign(
        lambda i, seed: {"y": i}, tl.parameter_grid(i=range(30)), executor=adapter, n_jobs=3
    )
    assert list(table["y"]) == list(range(30))
    assert adapter.most == 6  # two chunks for each worker


@pytest.mark.parametrize("given", [5, "loky", int])
def test_what_is_no_executor_is_refused(given):
    with pytest.raises(ValueError, match=r"executor must be a concurrent\.futures\.Executor"):
        tl.run_campaign(lambda seed: {"y": 1}, [{}], executor=given)


def test_an_error_of_the_executor_is_told_from_one_of_the_task():
    class Wrong(Executor):
        def submit(self, function, /, *args):
            future = Future()
            future.set_exception(ImportError("no module named trustlab"))
            return future

    with pytest.raises(CampaignError, match="a worker of Wrong could not run a chunk: ImportError"):
        tl.run_campaign(lambda seed: {"y": 1}, [{}], executor=Wrong())
