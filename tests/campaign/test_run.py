"""run_campaign: oracle is a plain loop over the parameters with `SeedSequence.spawn`."""

import os
import signal
import sys
import threading
import warnings

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings, strategies as st

import trustlab as tl
from trustlab.campaign import CampaignError, CampaignWarning
from trustlab.campaign.dispatch import LEAST, MOST_RUNS, ChunkSizes
from trustlab.campaign.table import assembled, decoded, encoded
from trustlab.campaign.worker import run_chunk

GRID = tl.parameter_grid(n=[5, 10], k=[1, 2], repeats=10)


def same(a, b):
    pd.testing.assert_frame_equal(a, b, check_exact=True)
    floats = a.select_dtypes("float").columns
    assert [a[c].to_numpy().tobytes() for c in floats] == [
        b[c].to_numpy().tobytes() for c in floats
    ]


def quiet(*args, **kwargs):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", CampaignWarning)
        return tl.run_campaign(*args, **kwargs)


def test_the_table_is_that_of_a_plain_loop(mean_task):
    table = quiet(mean_task, GRID, seed=3, n_jobs=1)
    children = np.random.SeedSequence(3).spawn(len(GRID))
    assert list(table.columns) == [
        "run",
        "n",
        "k",
        "mean",
        "count",
        "sign",
        "positive",
        "failed",
        "error",
        "traceback",
    ]
    assert list(table["run"]) == list(range(40))
    for i, (values, seed) in enumerate(zip(GRID, children, strict=True)):
        row = table.iloc[i]
        assert (row["n"], row["k"]) == (values["n"], values["k"])
        want, said = None, ""
        try:
            want = mean_task(**values, seed=seed)
        except ValueError as error:
            said = f"ValueError: {error}"
        assert row["failed"] == (want is None)
        if want is None:
            assert row["error"] == said
            assert row["traceback"].endswith(f"in task\n{said}\n")
            assert np.isnan(row["mean"])
            assert pd.isna(row["sign"])
        else:
            assert pd.isna(row["error"])
            assert {name: row[name] for name in want} == want
    assert 0 < table["failed"].sum() < 10  # some fail, so that both branches were seen


def test_loky_gives_the_table_of_the_serial_run(mean_task, tmp_path):
    serial = quiet(mean_task, GRID, seed=3, n_jobs=1)
    parallel = quiet(mean_task, GRID, seed=3, n_jobs=2, out=tmp_path / "a")
    same(serial, parallel)
    assert parallel.attrs["executor"] == "loky"
    same(serial, quiet(mean_task, GRID, seed=3, n_jobs=1, out=tmp_path / "b"))
    same(serial, tl.read_campaign(tmp_path / "a"))


def test_other_seeds_give_other_numbers_and_spawned_children_are_not_used_again(mean_task):
    draw = lambda seed: {"x": np.random.default_rng(seed).normal()}  # noqa: E731
    runs = [{}] * 3
    a = tl.run_campaign(draw, runs, seed=0, n_jobs=1)["x"]
    assert not set(a) & set(tl.run_campaign(draw, runs, seed=1, n_jobs=1)["x"])
    parent = np.random.SeedSequence(0)
    assert list(tl.run_campaign(draw, runs, seed=parent, n_jobs=1)["x"]) == list(a)
    parent.spawn(1)
    shifted = tl.run_campaign(draw, runs, seed=parent, n_jobs=1)["x"]
    assert list(shifted[:2]) == list(a[1:])
    child = np.random.SeedSequence(0).spawn(2)[1]
    want = [
        np.random.default_rng(s).normal() for s in np.random.SeedSequence(0).spawn(2)[1].spawn(3)
    ]
    assert list(tl.run_campaign(draw, runs, seed=child, n_jobs=1)["x"]) == want


VALUES = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(),
    st.floats(),
    st.text(max_size=5),
    st.integers(2**52, 2**54),
)


@given(
    values=st.lists(st.one_of(VALUES, st.just(ValueError)), min_size=1, max_size=12),
    cuts=st.sets(st.integers(1, 11)),
)
@settings(max_examples=150)
def test_chunk_boundaries_have_no_effect(values, cuts):
    """Any column of plain values, cut anywhere, gives the table of one chunk."""

    def task(i, seed):
        if values[i] is ValueError:
            raise ValueError("as asked")
        return {"y": values[i]} if i % 5 != 4 else {"y": values[i], "z": i}

    parameters = [{"i": i} for i in range(len(values))]

    def table(ends):
        outcomes = []
        for first, last in zip([0, *ends], [*ends, len(values)], strict=True):
            part = parameters[first:last]
            chunk, _ = run_chunk(task, np.random.SeedSequence(0), first, part)
            outcomes += decoded(encoded(part, chunk))[1] if ends else chunk
        return assembled(range(len(values)), outcomes, {"i": list(range(len(values)))})

    whole = table([])
    same(whole, table(sorted(c for c in cuts if c < len(values))))
    for i, value in enumerate(values):
        if not whole["failed"][i]:
            got = whole["y"][i]
            if value is None or value != value:
                assert pd.isna(got)
            else:
                assert got == value
                assert isinstance(got, str | bool | np.bool_) == isinstance(value, str | bool)


@pytest.mark.parametrize(
    ("result", "said"),
    [
        (5, "must return a dict of results by name, got int"),
        (None, "got NoneType"),
        ({}, "got an empty dict"),
        ({1: 2}, "names that are text, got 1"),
        ({"x": [1, 2]}, "'x' must be a number, text, True, False or None, got list"),
        ({"x": np.zeros(2)}, "got ndarray"),
        ({"x": 1j}, "got complex"),
        ({"i": 1}, "'i' has the name of a parameter"),
        ({"failed": 1}, "'failed' has the name of a column"),
    ],
)
def test_a_result_of_another_kind_is_a_recorded_failure(result, said):
    with pytest.warns(CampaignWarning, match="1 of 2 runs failed; run 1"):
        table = tl.run_campaign(
            lambda i, seed: result if i else {"x": 1.5}, [{"i": 0}, {"i": 1}], n_jobs=1
        )
    assert list(table["failed"]) == [False, True]
    assert said in table["error"][1]


def test_runs_with_other_columns_than_most_are_recorded_failures():
    task = lambda i, seed: {"a": i, "b": 1} if i != 0 else {"a": 7, "c": 1}  # noqa: E731
    with pytest.warns(CampaignWarning, match="1 of 4"):
        table = tl.run_campaign(task, tl.parameter_grid(i=range(4)), n_jobs=1)
    assert list(table.columns) == ["run", "i", "a", "b", "failed", "error", "traceback"]
    assert list(table["failed"]) == [True, False, False, False]
    assert "returned a, c, where most runs returned a, b" in table["error"][0]
    assert np.isnan(table["a"][0])
    other_order = lambda i, seed: {"a": i, "b": 1} if i else {"b": 1, "a": i}  # noqa: E731
    assert list(tl.run_campaign(other_order, [{"i": 0}, {"i": 1}], n_jobs=1)["a"]) == [0, 1]


def test_when_all_runs_fail_the_table_says_so_and_why():
    def task(seed):
        sys.exit("gone")

    with pytest.warns(CampaignWarning, match="2 of 2 runs failed; run 0: SystemExit: gone"):
        table = tl.run_campaign(task, [{}, {}], n_jobs=1)
    assert list(table.columns) == ["run", "failed", "error", "traceback"]
    assert table.attrs["failed"] == 2
    assert "2 runs, 2 failed; first run 0" in table.attrs["summary"]


def test_a_traceback_tells_the_cause_too():
    def task(seed):
        try:
            {}["missing"]
        except KeyError as error:
            raise RuntimeError("no such thing") from error

    with pytest.warns(CampaignWarning):
        text = tl.run_campaign(task, [{}], n_jobs=1)["traceback"][0]
    assert (
        text.index("KeyError: 'missing'")
        < text.index("direct cause")
        < text.index("RuntimeError: no such")
    )
    assert "worker.py" not in text


def test_a_task_cannot_change_parameters_of_other_runs():
    shared = [1.0]

    def task(x, seed):
        x.append(len(x))
        return {"length": len(x)}

    table = tl.run_campaign(task, [{"x": shared}] * 3, n_jobs=1)
    assert list(table["length"]) == [2, 2, 2]
    assert shared == [1.0]
    assert table["x"][0] is shared  # the table has the caller's own


def test_a_process_that_dies_takes_only_its_run_along(mean_task):
    def task(i, seed):
        if i == 7:
            os.kill(os.getpid(), signal.SIGKILL)
        return {"y": i}

    with pytest.warns(CampaignWarning, match="1 of 20 runs failed; run 7: WorkerDiedError"):
        table = tl.run_campaign(task, tl.parameter_grid(i=range(20)), n_jobs=2)
    assert list(table.index[table["failed"]]) == [7]
    assert list(table["y"].drop(7)) == [i for i in range(20) if i != 7]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"task": 5}, "task must be a function"),
        (
            {"task": lambda n: {}},
            "cannot be called with n, seed as named arguments: got an unexpected keyword "
            "argument 'seed'",
        ),
        (
            {"task": lambda m, seed: {}},
            "missing a required argument: 'm'|unexpected keyword argument 'n'",
        ),
        ({"parameters": []}, "parameters is empty"),
        ({"parameters": {"n": [1]}}, "got one dict"),
        ({"parameters": "abc"}, "must be a list of dicts, one per run, got str"),
        ({"parameters": ({"n": i} for i in range(2))}, "got generator"),
        ({"parameters": pd.DataFrame({"n": [1]})}, "to_dict"),
        ({"parameters": [{"n": 1}, 5]}, "parameters of run 1 must be a dict, got int"),
        ({"parameters": [5]}, "parameters of run 0 must be a dict"),
        ({"parameters": [{"n": 1}, {"m": 1}]}, "run 1 has parameters m, run 0 has n"),
        ({"parameters": [{"seed": 1}]}, "cannot be called 'seed': every run is given a seed"),
        ({"parameters": [{"error": 1}]}, "cannot be called 'error'"),
        ({"parameters": [{3: 1}]}, "must be text, got 3"),
        ({"seed": None}, "seed must be a whole number"),
        ({"seed": -1}, "seed must be a whole number, 0 or more"),
        ({"seed": True}, "seed must be"),
        ({"n_jobs": 0}, "n_jobs must be a whole number of processes"),
        ({"n_jobs": 1.5}, "n_jobs must be"),
        ({"n_jobs": True}, "n_jobs must be"),
        ({"n_jobs": None}, "n_jobs must be"),
        ({"progress": "yes"}, "progress must be"),
        ({"fresh": None}, "fresh must be"),
        ({"fresh": True}, "`out` is not given"),
        ({"out": 5}, "out must be the path of a folder"),
        ({"out": ""}, "out must be the path of a folder"),
    ],
)
def test_bad_arguments_are_refused(change, said):
    arguments = {"task": lambda n, seed: {"y": n}, "parameters": [{"n": 1}], "n_jobs": 1} | change
    with pytest.raises(ValueError, match=said):
        tl.run_campaign(arguments.pop("task"), arguments.pop("parameters"), **arguments)


def test_a_task_that_cannot_be_sent_is_refused_before_anything_runs():
    lock = threading.Lock()
    with pytest.raises(CampaignError, match=r"task cannot be sent to other processes.*n_jobs=1"):
        tl.run_campaign(lambda seed: {"y": lock.locked()}, [{}], n_jobs=2)
    assert tl.run_campaign(lambda seed: {"y": lock.locked()}, [{}], n_jobs=1)["y"][0] == np.False_


def test_within_a_task_all_cores_means_this_one():
    def outer(seed):
        inner = tl.run_campaign(lambda seed: {"x": seed.entropy}, [{}], seed=seed)
        return {"executor": inner.attrs["executor"]}

    assert tl.run_campaign(outer, [{}], n_jobs=1)["executor"][0] == "serial"


def test_nothing_is_printed_unless_asked(capfd, mean_task):
    quiet(mean_task, GRID, n_jobs=1)
    assert capfd.readouterr() == ("", "")
    quiet(mean_task, GRID, n_jobs=1, progress=True)
    out, err = capfd.readouterr()
    assert out == ""
    assert "40/40" in err
    assert "failed=" in err
    assert "run/s" in err
    assert err.endswith("\n")


@given(st.floats(1e-6, 3.0), st.integers(1, 5000), st.integers(1, 8))
@settings(max_examples=100)
def test_chunks_last_long_enough_and_cover_every_run(per_run, runs, workers):
    sizes = ChunkSizes(runs, workers)
    left = runs
    taken = []
    while left:
        size = sizes.next(left)
        assert 1 <= size <= min(left, MOST_RUNS)
        sizes.took(size, size * per_run)
        left -= size
        taken.append(size)
    assert sum(taken) == runs
    grown = next((i for i, size in enumerate(taken) if size * per_run >= LEAST), len(taken))
    assert grown <= 5  # calibrated within five chunks
    assert all(size * per_run >= LEAST for size in taken[grown:-1] if size < MOST_RUNS)
    assert all(size == 1 or (size - 1) * per_run <= 5.0 for size in taken)


def test_parameters_of_any_kind_are_in_the_table_as_they_were_given(tmp_path):
    values = [
        None,
        True,
        3,
        2**70,
        0.5,
        np.float32(0.1),
        "\ud800",
        (1, 2),
        np.arange(3),
        pd.DataFrame({"a": [1]}),
        list(range(5000)),
    ]
    runs = tl.parameter_grid(x=values)
    for _ in range(2):  # run, then read
        table = tl.run_campaign(lambda x, seed: {"y": 1}, runs, n_jobs=1, out=tmp_path)
        assert np.isnan(table["x"][0])
        assert all(table["x"][i] is values[i] for i in range(2, len(values)) if i != 4)
    texts = tl.read_campaign(tmp_path)["x"]
    assert texts[8] == "array([0, 1, 2])"
    assert len(texts[10]) == 1000
    lone = tl.run_campaign(
        lambda x, seed: {"y": 1}, [{"x": "\ud800"}, {"x": "a"}], n_jobs=1, out=tmp_path / "lone"
    )
    assert list(lone["x"]) == ["\ud800", "a"]
