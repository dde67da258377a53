"""
run_campaign, on processes of this machine and on a Dask cluster.

Oracles: a plain loop over the parameters with `SeedSequence.spawn`; the serial table.
"""

import os
import re
import sys
import threading
import time

import joblib
import numpy as np
import pandas as pd
import pytest
from pandas.testing import assert_frame_equal
from scipy import stats

from tests.cases import refused
from trustlab import parameter_draws, parameter_grid, read_campaign, run_campaign
from trustlab.campaign import CampaignWarning

RUNS = parameter_grid(n=[5, 10], k=[1, 2], repeats=10)
pytestmark = pytest.mark.filterwarnings("ignore::trustlab.campaign.CampaignWarning")


def run(task, runs=2, n_jobs=1, **options):
    """Run a task with these parameters, or so often with i = 0, 1 …, in this process."""
    parameters = parameter_grid(i=range(runs)) if isinstance(runs, int) else runs
    return run_campaign(task, parameters, n_jobs=n_jobs, **options)


def task(n, k, seed):
    x = np.random.default_rng(seed).normal(size=n)
    if k == 2 and x[0] > 1.0:
        raise ValueError(f"first draw too large\nfor n = {n}")
    return {"mean": x.mean(), "count": np.int64(n), "word": "ab"[n > 5], "positive": x[0] > 0}


def loop(seeds):
    rows = []
    for i, (values, seed) in enumerate(zip(RUNS, seeds, strict=True)):
        row = {"run": i, **values, "failed": False}
        try:
            row |= task(**values, seed=seed)
        except ValueError:
            row |= {"failed": True, "error": "ValueError: first draw too large"}
        rows.append(row)
    columns = ["run", "n", "k", "mean", "count", "word", "positive", "failed", "error"]
    return pd.DataFrame(rows, columns=columns).astype({"error": "str"})


def grandchild():
    """A seed sequence that is a child itself, and has given seeds away."""
    parent = np.random.SeedSequence(0).spawn(2)[1]
    parent.spawn(3)
    return parent


@pytest.mark.parametrize(
    ("seed", "twin", "n_jobs"),
    [(3, np.random.SeedSequence(3), 2), (grandchild(), grandchild(), 1)],
)
def test_the_table_is_that_of_a_plain_loop(seed, twin, n_jobs):
    expected = loop(twin.spawn(40))
    failed = expected.index[expected["failed"]]
    assert 1 < len(failed) < 5
    said = f"40 runs, {len(failed)} failed; run {failed[0]}: ValueError: first draw"
    with pytest.warns(CampaignWarning, match=said):
        table = run(task, RUNS, n_jobs, seed=seed)
    assert table.attrs["failed"] == len(failed)
    assert_frame_equal(table.drop(columns="traceback"), expected, check_exact=True)
    for text in table["traceback"][failed]:
        assert text.startswith("Traceback")
        assert "in task" in text


def test_one_process_waits_for_the_other_and_both_work_to_the_end(tmp_path):
    """Every run waits until both processes have begun the pair of runs that it belongs to."""

    def together(i, seed):
        (tmp_path / f"{i}-{os.getpid()}").touch()
        until = time.monotonic() + 60.0
        while i >= 100 and time.monotonic() < until:
            if len(list(tmp_path.glob("10[01]-*"))) == 2:
                return {"process": os.getpid(), "met": True}
            time.sleep(0.001)
        return {"process": os.getpid(), "met": False}

    table = run(together, 102, n_jobs=2)
    assert table["process"].nunique() == 2
    assert table["met"].tolist() == [False] * 100 + [True] * 2
    assert table["process"][100] != table["process"][101]


def test_within_a_task_all_cores_means_its_own_process():
    def inner(i, seed):
        return {"process": os.getpid(), "thread": threading.get_ident()}

    def outer(i, seed):
        table = run(inner, 4, n_jobs=-1)
        return {"here": bool((table[["process", "thread"]] == inner(i, seed)).all(axis=None))}

    for n_jobs in (1, 2):
        assert run(outer, 4, n_jobs)["here"].tolist() == [True] * 4


@pytest.mark.parametrize(
    ("results", "said"),
    [
        (5, "must return a dict of results, got 5"),
        ({"x": [1, 2]}, r"'x' must be a number, text, True, False or None, got \[1, 2\]"),
        ({"failed": 1}, "result 'failed' has the name of another"),
        ({1: 1.5}, "result 1 has .*, or no text for one"),
        ({"y": 1}, "returned y, where most runs returned x"),
    ],
)
def test_a_run_with_other_results_has_failed(results, said):
    table = run(lambda i, seed: {"x": 1.5} if i else results, 3)
    assert table["failed"].tolist() == [True, False, False]
    assert table["x"].tolist()[1:] == [1.5, 1.5]
    assert np.isnan(table["x"][0])
    assert re.search(said, table["error"][0])


def test_when_all_runs_fail_the_table_says_why():
    table = run(lambda seed: sys.exit("gone"), [{}, {}])
    assert list(table) == ["run", "failed", "error", "traceback"]
    assert table["error"].tolist() == ["SystemExit: gone"] * 2


def test_a_task_cannot_change_parameters_of_other_runs():
    shared = [1.0]

    def longer(x, seed):
        x.append(len(x))
        return {"length": len(x)}

    assert set(run(longer, [{"x": shared}] * 3)["length"]) == {2}
    assert shared == [1.0]


def test_values_keep_their_kind(tmp_path):
    """In memory and read again."""
    values = {
        "flag": [True, False],
        "whole": [2**62, -1],
        "float": [0.1, np.float32(0.1)],
        "word": ["a", ""],
        "great": [2**70, 1],
        "mixed": [1, "a"],
    }
    kinds = {"flag": bool, "whole": np.int64, "float": float, "word": "str"}

    def given(i, seed):
        return {name: pair[i] for name, pair in values.items()}

    for out in (None, tmp_path, tmp_path):
        table = run(given, out=out)
        for name, pair in values.items():
            assert table[name].tolist() == pair
            assert table[name].dtype == kinds.get(name, object)


@pytest.mark.parametrize("values", [[2**60 + 1, None], [2**60 + 1]])
def test_whole_numbers_keep_their_digits_beside_nothing_or_a_failed_run(tmp_path, values):
    for out in (None, tmp_path, tmp_path):
        table = run(lambda i, seed: {"whole": values[i]}, out=out)
        assert int(table["whole"][0]) == 2**60 + 1  # a float would be equal
        assert pd.isna(table["whole"][1])


def test_what_cannot_be_sent_is_refused_before_anything_runs(tmp_path):
    lock = threading.Lock()

    def locked(i, seed):
        return {"y": lock.locked()}

    with refused(r"Could not pickle the task.* cannot pickle '_thread.lock'"):
        run(locked, n_jobs=2)
    with refused(r"the task cannot be sent.*create it inside"):
        run(locked, out=tmp_path / "out")
    assert not list(tmp_path.iterdir())
    with refused("n_jobs must be a whole number, 1 or more, got 0"):
        run(locked, n_jobs=0)
    assert run(locked)["y"].tolist() == [False, False]


def test_draws_follow_their_distributions_and_their_names():
    draws = parameter_draws(4000, seed=1, a=(2.0, 4.0), b=stats.norm(1.0, 0.5))
    a, b = np.array([[draw["a"], draw["b"]] for draw in draws]).T
    assert stats.kstest(a, stats.uniform(2.0, 2.0).cdf).pvalue > 1e-3
    assert stats.kstest(b, stats.norm(1.0, 0.5).cdf).pvalue > 1e-3
    assert abs(np.corrcoef(a, b)[0, 1]) < 0.05
    again = parameter_draws(4000, seed=1, b=stats.norm(1.0, 0.5), z=(0, 1))
    assert [draw["b"] for draw in again] == b.tolist()  # neither order nor company matters
    named = parameter_draws(50, n=(5.0, 6.0))  # a parameter may be called n
    assert all(5.0 < draw["n"] < 6.0 for draw in named)
    assert parameter_draws(n=3, a=(0, 1)) == parameter_draws(3, a=(0, 1))


def test_runs_have_the_same_names():
    with refused(r"run 0 has .*'a'.* and run 1 has .*'b'"):
        run(dict, [{"a": 1}, {"b": 1}])


# The order of a set differs between processes: no campaign of it could be resumed.
NO_LISTS = [{"x": values} for values in ({"a"}, {"a": 1}, pd.DataFrame({"a": [1]}), b"a")]
EMPTY = [{}, {"x": []}, {"x": [1], "y": np.array([])}]


@pytest.mark.parametrize(
    ("axes", "words"),
    [
        *((axes, "x must be a list of values, got ") for axes in NO_LISTS),
        *((axes, "give at least one value for each name") for axes in EMPTY),
        ({name: range(100) for name in "abcde"}, r"number of runs must be .* got 10000000000"),
    ],
)
def test_grids_of_no_lists_without_values_or_too_large_are_refused(axes, words):
    with refused(words):
        parameter_grid(**axes)


# --- a Dask cluster -------------------------------------------------------------------------------


def test_dask_gives_the_table_of_the_serial_run(tmp_path):
    distributed = pytest.importorskip("distributed")
    # Tuples that begin with a function are calls to a Dask graph.
    values = [("a", 1), [(len, "abc")], {"k": "task-0"}, "task-0", np.arange(3), None]
    runs = [{"i": i, "value": value} for i in range(10) for value in values]

    def task(i, value, seed):
        if i == 7:
            raise ValueError("as asked")
        draw = np.random.default_rng(seed).normal()
        return {"draw": draw, "x": repr(value), "process": os.getpid()}

    serial = run(task, runs, seed=3)
    with (
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, dashboard_address=None, silence_logs="CRITICAL"
        ) as cluster,
        distributed.Client(cluster),
        joblib.parallel_config("dask"),
    ):
        table = run_campaign(task, runs, seed=3, out=tmp_path)
    assert os.getpid() not in set(table["process"])
    assert table["process"].nunique() == 2
    both = [frame.drop(columns=["process", "traceback"]) for frame in (serial, table)]
    assert_frame_equal(*both, check_exact=True)
    assert len(read_campaign(tmp_path)) == 60
