"""A campaign on a real Dask cluster of two worker processes. Oracle: the serial table."""

import os

import joblib
import numpy as np
import pandas as pd
import pytest

import trustlab as tl

distributed = pytest.importorskip("distributed")


@pytest.mark.filterwarnings("ignore::trustlab.campaign.CampaignWarning")
def test_dask_gives_the_table_of_the_serial_run(tmp_path):
    # Tuples that begin with a function are calls to a Dask graph.
    values = [("a", 1), [(len, "abc")], {"k": "task-0"}, "task-0", np.arange(3), None]
    runs = [{"i": i, "value": value} for i in range(10) for value in values]

    def task(i, value, seed):
        if i == 7:
            raise ValueError("as asked")
        draw = np.random.default_rng(seed).normal()
        return {"draw": draw, "x": repr(value), "process": os.getpid()}

    serial = tl.run_campaign(task, runs, seed=3, n_jobs=1)
    with (
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, dashboard_address=None, silence_logs="CRITICAL"
        ) as cluster,
        distributed.Client(cluster),
        joblib.parallel_config("dask"),
    ):
        table = tl.run_campaign(task, runs, seed=3, out=tmp_path)
    assert os.getpid() not in set(table["process"])
    assert table["process"].nunique() == 2
    both = [frame.drop(columns=["process", "traceback"]) for frame in (serial, table)]
    pd.testing.assert_frame_equal(*both, check_exact=True)
    assert len(tl.read_campaign(tmp_path)) == 60
