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
from scipy import stats

import trustlab as tl
from trustlab.campaign import CampaignWarning

RUNS = tl.parameter_grid(n=[5, 10], k=[1, 2], repeats=10)
pytestmark = pytest.mark.filterwarnings("ignore::trustlab.campaign.CampaignWarning")


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
    [
        (3, np.random.SeedSequence(3), 1),
        (3, np.random.SeedSequence(3), 2),
        (grandchild(), grandchild(), 1),
    ],
)
def test_the_table_is_that_of_a_plain_loop(seed, twin, n_jobs):
    expected = loop(twin.spawn(40))
    failed = expected.index[expected["failed"]]
    assert 1 < len(failed) < 5
    said = f"40 runs, {len(failed)} failed; run {failed[0]}: ValueError: first draw"
    with pytest.warns(CampaignWarning, match=said):
        table = tl.run_campaign(task, RUNS, seed=seed, n_jobs=n_jobs)
    assert table.attrs["failed"] == len(failed)
    pd.testing.assert_frame_equal(table.drop(columns="traceback"), expected, check_exact=True)
    for text in table["traceback"][failed]:
        assert text.startswith("Traceback")
        assert "in task" in text


def test_one_process_waits_for_the_other_and_both_work_to_the_end(tmp_path):
    """Every run waits until both processes have begun the pair of runs that it belongs to."""

    def together(i, seed):
        (tmp_path / f"{i}-{os.getpid()}").touch()
        until = time.monotonic() + 60.0
        while i >= 98 and time.monotonic() < until:
            if len(list(tmp_path.glob("9[89]-*"))) == 2:
                return {"process": os.getpid(), "met": True}
            time.sleep(0.001)
        return {"process": os.getpid(), "met": False}

    table = tl.run_campaign(together, tl.parameter_grid(i=range(100)), n_jobs=2)
    assert table["process"].nunique() == 2
    assert table["met"].tolist() == [False] * 98 + [True] * 2
    assert table["process"][98] != table["process"][99]


def test_runs_that_a_process_had_no_time_for_are_computed_all_the_same(monkeypatch):
    calls = []

    def counted(n, k, seed):
        calls.append((n, k))
        return task(n, k, seed)

    expected = tl.run_campaign(counted, RUNS, seed=3, n_jobs=1)
    assert len(calls) == 40
    monkeypatch.setattr("trustlab.campaign.run.perf_counter", iter(range(10**6)).__next__)
    pd.testing.assert_frame_equal(tl.run_campaign(counted, RUNS, seed=3, n_jobs=1), expected)
    assert len(calls) == 80


def test_within_a_task_all_cores_means_its_own_process():
    def inner(i, seed):
        return {"process": os.getpid(), "thread": threading.get_ident()}

    def outer(i, seed):
        table = tl.run_campaign(inner, tl.parameter_grid(i=range(4)), n_jobs=-1)
        return {"here": bool((table[["process", "thread"]] == inner(i, seed)).all(axis=None))}

    for n_jobs in (1, 2):
        table = tl.run_campaign(outer, tl.parameter_grid(i=range(4)), n_jobs=n_jobs)
        assert table["here"].tolist() == [True] * 4


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
    table = tl.run_campaign(
        lambda i, seed: results if i == 0 else {"x": 1.5}, tl.parameter_grid(i=range(3)), n_jobs=1
    )
    assert table["failed"].tolist() == [True, False, False]
    assert table["x"].tolist()[1:] == [1.5, 1.5]
    assert np.isnan(table["x"][0])
    assert re.search(said, table["error"][0])


def test_when_all_runs_fail_the_table_says_why():
    table = tl.run_campaign(lambda seed: sys.exit("gone"), [{}, {}], n_jobs=1)
    assert list(table) == ["run", "failed", "error", "traceback"]
    assert table["error"].tolist() == ["SystemExit: gone"] * 2


def test_a_task_cannot_change_parameters_of_other_runs():
    shared = [1.0]

    def longer(x, seed):
        x.append(len(x))
        return {"length": len(x)}

    assert set(tl.run_campaign(longer, [{"x": shared}] * 3, n_jobs=1)["length"]) == {2}
    assert shared == [1.0]


def test_values_keep_their_kind(tmp_path):
    """Of every kind alone and with a missing one, in memory and read again."""
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
        table = tl.run_campaign(given, tl.parameter_grid(i=[0, 1]), n_jobs=1, out=out)
        for name, pair in values.items():
            assert table[name].tolist() == pair
            assert table[name].dtype == kinds.get(name, object)


def test_whole_numbers_keep_their_digits_beside_a_failed_run(tmp_path):
    def given(i, seed):
        return {"whole": 2**60 + 1} if i else 1 / i

    for out in (None, tmp_path, tmp_path):
        table = tl.run_campaign(given, tl.parameter_grid(i=[0, 1]), n_jobs=1, out=out)
        assert int(table["whole"][1]) == 2**60 + 1  # a float would be equal
        assert np.isnan(table["whole"][0])


def test_what_cannot_be_sent_is_refused_before_anything_runs(tmp_path):
    lock = threading.Lock()

    def locked(i, seed):
        return {"y": lock.locked()}

    runs = tl.parameter_grid(i=range(2))
    with pytest.raises(
        ValueError, match=r"Could not pickle the task.* cannot pickle '_thread.lock'"
    ):
        tl.run_campaign(locked, runs, n_jobs=2)
    with pytest.raises(ValueError, match=r"the task cannot be sent.*create it inside"):
        tl.run_campaign(locked, runs, n_jobs=1, out=tmp_path / "out")
    assert not list(tmp_path.iterdir())
    with pytest.raises(ValueError, match="n_jobs must be a whole number, 1 or more, got 0"):
        tl.run_campaign(locked, runs, n_jobs=0)
    assert tl.run_campaign(locked, runs, n_jobs=1)["y"].tolist() == [False, False]


def test_draws_follow_their_distributions_and_their_names():
    draws = tl.parameter_draws(4000, seed=1, a=(2.0, 4.0), b=stats.norm(1.0, 0.5))
    a, b = np.array([d["a"] for d in draws]), np.array([d["b"] for d in draws])
    assert stats.kstest(a, stats.uniform(2.0, 2.0).cdf).pvalue > 1e-3
    assert stats.kstest(b, stats.norm(1.0, 0.5).cdf).pvalue > 1e-3
    assert abs(np.corrcoef(a, b)[0, 1]) < 0.05
    again = tl.parameter_draws(4000, seed=1, b=stats.norm(1.0, 0.5), z=(0, 1))
    assert [d["b"] for d in again] == b.tolist()  # neither order nor company matters
    named = tl.parameter_draws(50, n=(5.0, 6.0))  # a parameter may be called n
    assert all(5.0 < draw["n"] < 6.0 for draw in named)
    assert tl.parameter_draws(n=3, a=(0, 1)) == tl.parameter_draws(3, a=(0, 1))


# --- a Dask cluster -------------------------------------------------------------------------------


@pytest.mark.filterwarnings("ignore::trustlab.campaign.CampaignWarning")
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


def test_runs_have_the_same_names():
    with pytest.raises(ValueError, match=r"run 0 has .*'a'.* and run 1 has .*'b'"):
        tl.run_campaign(dict, [{"a": 1}, {"b": 1}])


@pytest.mark.parametrize("values", [{"a"}, {"a": 1}, pd.DataFrame({"a": [1]}), b"a"])
def test_a_grid_of_what_is_no_list_is_refused(values):
    """The order of a set differs between processes: no campaign of it could be resumed."""
    with pytest.raises(ValueError, match="x must be a list of values, got "):
        tl.parameter_grid(x=values)


@pytest.mark.parametrize("axes", [{}, {"x": []}, {"x": [1], "y": np.array([])}])
def test_a_grid_without_values_is_refused(axes):
    with pytest.raises(ValueError, match="give at least one value for each name"):
        tl.parameter_grid(**axes)


def test_large_whole_numbers_beside_nothing_keep_their_digits():
    table = tl.run_campaign(lambda k, seed: {"y": 2**53 + 1 if k else None}, [{"k": 0}, {"k": 1}])
    assert table["y"].iloc[1] == 2**53 + 1


def test_a_grid_that_no_memory_holds_is_refused():
    with pytest.raises(ValueError, match=r"number of runs must be .* got 10000000000"):
        tl.parameter_grid(**{name: range(100) for name in "abcde"})
