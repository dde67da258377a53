"""Campaigns on disk: killed, resumed, grown, refused. Oracle: the campaign without a folder."""

import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from pandas.testing import assert_frame_equal

import trustlab
from tests.cases import refused
from trustlab import parameter_grid, read_campaign, run_campaign
from trustlab.campaign import CampaignError

ENVIRONMENT = os.environ | {"PYTHONPATH": str(Path(trustlab.__file__).parents[1])}
RUNS = parameter_grid(x=range(30))


def task(x, seed, calls=None):
    if calls is not None:
        calls.append(x)
    if x == 7:
        raise ValueError("as asked")
    return {"y": np.random.default_rng(seed).normal() + x}


def go(out, runs=RUNS, task=task, n_jobs=1, **options):
    return run_campaign(task, runs, n_jobs=n_jobs, out=out, **options)


def contents(folder):
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


pytestmark = pytest.mark.filterwarnings("ignore::trustlab.campaign.CampaignWarning")

SCRIPT = """
import os, sys, time
import numpy as np
import trustlab as tl
import trustlab.campaign.run

trustlab.campaign.run.PAUSE = 0.1

def task(x, seed):
    with open("log", "a") as file:
        file.write(f"{x}\\n")
    time.sleep(float(os.environ["PAUSE"]))
    return {"y": np.random.default_rng(seed).normal() + x}

if __name__ == "__main__":
    runs = tl.parameter_grid(x=range(100))
    tl.run_campaign(task, runs, seed=5, n_jobs=int(sys.argv[1]), out="out")
"""


@pytest.mark.parametrize("n_jobs", ["1", "2"])
def test_a_killed_campaign_goes_on_and_repeats_nothing_that_was_written(tmp_path, n_jobs):
    (tmp_path / "script.py").write_text(SCRIPT)
    command, out, log = [sys.executable, "script.py", n_jobs], tmp_path / "out", tmp_path / "log"
    process = subprocess.Popen(
        command,
        cwd=tmp_path,
        env=ENVIRONMENT | {"PAUSE": "0.05"},
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    try:
        until = time.monotonic() + 300.0
        while len(list(out.glob("runs-*"))) < 2 and time.monotonic() < until:
            time.sleep(0.02)
    finally:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
    written = set(read_campaign(out)["run"])
    assert 0 < len(written) < 100
    log.unlink()
    subprocess.run(command, cwd=tmp_path, env=ENVIRONMENT | {"PAUSE": "0"}, check=True, timeout=300)
    repeated = [int(line) for line in log.read_text().split()]
    assert sorted(repeated) == sorted(set(range(100)) - written)
    seeds = np.random.SeedSequence(5).spawn(100)
    expected = [np.random.default_rng(seed).normal() + x for x, seed in enumerate(seeds)]
    assert read_campaign(out)["y"].tolist() == expected


@pytest.mark.parametrize(("n_jobs", "error"), [(1, KeyboardInterrupt), (2, CampaignError)])
def test_a_process_that_dies_or_is_interrupted_loses_nothing_that_was_finished(
    tmp_path, n_jobs, error
):
    def deadly(x, seed):
        time.sleep(0.01)
        if x == 29 and not calm.exists():
            if os.getpid() == parent:
                raise KeyboardInterrupt
            os.kill(os.getpid(), signal.SIGKILL)
        return task(x, seed)

    parent, calm, out = os.getpid(), tmp_path / "calm", tmp_path / "out"
    with pytest.raises(error):
        go(out, task=deadly, n_jobs=n_jobs)
    calm.touch()
    table = go(out, task=deadly, n_jobs=n_jobs)
    assert 0 < table.attrs["resumed"] < 30
    assert_frame_equal(table, go(None, task=deadly))


def test_a_campaign_grows_and_fills_gaps(tmp_path, monkeypatch):
    monkeypatch.setattr("trustlab.campaign.run.PAUSE", 1e-9)  # a file for each run
    expected = go(None)
    assert_frame_equal(go(tmp_path), expected)
    before = contents(tmp_path)
    longer = [*RUNS, {"x": 7}, {"x": 99}]
    for runs in (RUNS, longer):
        again = go(tmp_path, runs)
        assert again.attrs["resumed"] == 29  # the failed one is tried again
        assert_frame_equal(again, go(None, runs))
    assert before.items() <= contents(tmp_path).items()
    for path in list(tmp_path.glob("runs-*"))[::4]:
        path.unlink()
    left = read_campaign(tmp_path)
    assert len(left) == 24
    filled = go(tmp_path, longer)
    assert filled.attrs["resumed"] == 24 - left.attrs["failed"]
    assert_frame_equal(filled, again)
    assert go(tmp_path, RUNS[:10]).equals(expected[:10])


@pytest.mark.parametrize("seed", range(5))
def test_a_failed_run_is_tried_again_and_what_succeeded_stays(tmp_path, seed):
    """
    Memory, a licence, a full disk, as here: none of these is the task's. Names of files follow from
    what is in them: the failure is read first or last, as the seed has it.
    """
    full, out = tmp_path / "full", tmp_path / "out"
    full.touch()

    def flaky(x, seed):
        if x == 1 and full.exists():
            raise OSError("disk full")
        return {"y": x}

    def campaign():
        return go(out, RUNS[:3], flaky, seed=seed)

    assert campaign().attrs["failed"] == 1
    full.unlink()
    table = campaign()
    assert table.attrs["resumed"] == 2
    assert table["y"].tolist() == [0, 1, 2]
    assert read_campaign(out).equals(table)
    assert campaign().attrs["resumed"] == 3


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"seed": 1}, "seed was 0, is 1"),
        ({"seed": np.random.SeedSequence(0, spawn_key=(1,))}, r"spawn key was \(0,\), is \(1, 0\)"),
        ({"runs": [*RUNS[:12], {"x": 50}]}, "x of run 12 was 12, is 50"),
        ({"runs": parameter_grid(x=np.arange(30.0))}, "x of run 0 was 0, is 0.0"),
        ({"runs": [*RUNS[:1], {"x": True}]}, "x of run 1 was 1, is True"),
        ({"runs": [{"x": np.arange(3)}]}, "x of run 0 was 0, is 'ndarray "),
        ({"runs": [{"x": 0, "calls": None}]}, "calls of run 0"),
        ({"task": lambda x, seed: {"y": -x}}, "the task or a value it uses or fills changed"),
    ],
)
def test_another_campaign_is_refused_by_what_changed(tmp_path, arguments, said):
    go(tmp_path)
    before = contents(tmp_path)
    with refused(rf"holds another campaign: .*{said}.*another folder"):
        go(tmp_path, **arguments)
    assert contents(tmp_path) == before


@pytest.mark.parametrize("name", ["trustlab", "Python", "numpy", "scipy", "numba"])
def test_other_versions_are_refused(tmp_path, name):
    go(tmp_path)
    path = tmp_path / "campaign.json"
    path.write_text(re.sub(rf'(version of {name}": )"[^"]+"', r'\1"0.0.1"', path.read_text()))
    with refused(rf"version of {name} was 0\.0\.1, is \d+\.\d+"):
        go(tmp_path)


def test_values_that_are_not_plain_are_compared_by_content(tmp_path):
    """In whatever order and memory they stand."""

    def total(x, words, seed):
        return {"y": float(np.sum(x)), "n": len(words)}

    first, second = (word.lower() for word in ("AB", "AB"))
    runs = [{"x": np.arange(n), "words": ["ab", "ab"]} for n in (3, 4)]
    again = [{"words": [first, second], "x": np.arange(n)} for n in (3, 4)]
    for resumed, parameters in ((0, runs), (2, again)):
        table = go(tmp_path, parameters, total)
        assert table["y"].tolist() == [3.0, 6.0]
        assert table.attrs["resumed"] == resumed
    with refused("x of run 1 was"):
        go(tmp_path, [runs[0], runs[1] | {"x": np.arange(5)}], total)


def test_damage_and_places_that_cannot_be_used_are_named(tmp_path):
    go(tmp_path / "out")
    chunk = next(tmp_path.glob("out/runs-*"))
    for damaged in (chunk.read_bytes()[:-5], b"[]"):
        chunk.write_bytes(damaged)
        with refused(rf"{chunk.name} cannot be read: .*or remove it"):
            go(tmp_path / "out")
    with refused(r"cannot write .*File exists; give a folder that is"):
        go(chunk)
    with refused(rf"^folder: there is no campaign in {tmp_path}$"):
        read_campaign(tmp_path)


def test_processes_that_imported_an_earlier_version_are_not_used(tmp_path):
    """joblib keeps its processes. Oracle: the task called in this process."""
    script = """
import importlib
from pathlib import Path
import trustlab as tl
file = Path("edited.py")
for value in (1, 2):
    file.write_text(f"def task(x, seed): return {{'y': {value}}}")
    edited = importlib.reload(edited) if value > 1 else importlib.import_module("edited")
    table = tl.run_campaign(edited.task, [{"x": 1}, {"x": 2}], n_jobs=2)
    print([*table["y"], edited.task(1, 0)["y"]])
"""
    command = [sys.executable, "-B", "-c", script]
    output = subprocess.check_output(command, cwd=tmp_path, env=ENVIRONMENT, text=True)
    assert output == "[1, 1, 1]\n[2, 2, 2]\n"
