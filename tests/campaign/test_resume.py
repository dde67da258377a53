"""
Campaigns with a folder: killed, resumed, changed, damaged. Oracle: the table of a campaign that was
let run.
"""

import json
import os
import platform
import subprocess
import sys
import tracemalloc
from pathlib import Path

import numba
import numpy as np
import pandas as pd
import pytest

import trustlab as tl
from trustlab.campaign import CampaignError

SCRIPT = """
import os, random, signal, sys, time, warnings
import numpy as np
import trustlab as tl

place, n_jobs, kills, longest = sys.argv[1], int(sys.argv[2]), int(sys.argv[3]), float(sys.argv[4])
GRID = tl.parameter_grid(x=range(240))

def task(x, seed, log=place + "/log"):
    with open(log, "a") as file:
        file.write(f"{x}\\n")
    time.sleep(float(os.environ.get("PAUSE", 0.0)))
    if x % 50 == 7:
        raise ValueError(f"x = {x}")
    return {"y": np.random.default_rng(seed).normal() + x}

def run(out, n_jobs):
    return tl.run_campaign(task, GRID, seed=5, n_jobs=n_jobs, out=out)

def logged():
    ran = set()
    if os.path.exists(place + "/log"):
        with open(place + "/log") as file:
            ran = {int(x) for x in file}
        os.remove(place + "/log")
    return ran

def finished(out):
    try:
        return set(tl.read_campaign(out)["run"])
    except tl.campaign.CampaignError as error:
        assert "holds no campaign" in str(error), error
        return set()

def alive(session):
    import psutil
    for process in psutil.process_iter(["pid", "status"]):
        try:
            if process.info["status"] != "zombie" and os.getsid(process.info["pid"]) == session:
                yield process
        except ProcessLookupError:
            pass

def main():
    warnings.simplefilter("ignore")
    # Each driver is a fork of this process, which has imported everything already.
    import loky, tqdm
    import trustlab.campaign.dispatch, trustlab.campaign.folder
    rng, whole, killed, half_way = random.Random(kills), None, 0, 0
    for campaign in range(kills):
        out = f"{place}/out{campaign}"
        saved = set()
        while killed < kills and len(saved) < len(GRID):
            killed += 1
            driver = os.fork()
            if driver == 0:
                os.setsid()
                os.environ["PAUSE"] = "0.01"
                run(out, n_jobs)
                os._exit(0)
            if killed % 2:
                time.sleep(rng.uniform(0.0, longest))
            else:  # when it has saved more
                until = time.monotonic() + 60.0
                while len(finished(out)) == len(saved) and time.monotonic() < until:
                    time.sleep(0.005)
            os.kill(driver, signal.SIGKILL)
            os.waitpid(driver, 0)
            until = time.monotonic() + 30.0
            while (left := list(alive(driver))) and time.monotonic() < until:
                time.sleep(0.02)
            assert not left, f"workers stay behind: {left}"
            before, saved = saved, finished(out)
            assert before <= saved, "finished runs are gone"
            half_way += 0 < len(saved) < len(GRID)
            assert not before & logged(), "what was saved ran again"
        table = run(out, 1)
        assert table.attrs["resumed"] == len(saved)
        if whole is None:
            whole = tl.run_campaign(task, GRID, seed=5, n_jobs=1)
        assert table.drop(columns="traceback").equals(whole.drop(columns="traceback"))
        logged()
        if killed == kills:
            break
    print(killed, half_way)

if __name__ == "__main__":
    main()
"""


def chunks(folder):
    return sorted((Path(folder) / "chunks").glob("*.json.gz"))


@pytest.mark.skipif(os.name != "posix", reason="forks")
@pytest.mark.parametrize(
    ("n_jobs", "kills", "longest"),
    [
        (1, 8, 0.4),
        (2, 2, 3.0),  # while the workers start, and later
        pytest.param(1, 80, 0.4, marks=pytest.mark.long),
        pytest.param(2, 20, 3.0, marks=pytest.mark.long),
    ],
)
def test_drivers_killed_at_random_leave_nothing_half_made_and_the_next_goes_on(
    tmp_path, n_jobs, kills, longest
):
    """
    Nothing saved is lost or run again, no worker stays, and the table is that of a campaign without
    kills.
    """
    (tmp_path / "script.py").write_text(SCRIPT)
    environment = os.environ | {"PYTHONPATH": str(Path(tl.__file__).parents[1])}
    command = [sys.executable, tmp_path / "script.py", tmp_path, n_jobs, kills, longest]
    done = subprocess.run(
        list(map(str, command)), env=environment, capture_output=True, text=True, timeout=900
    )
    assert done.returncode == 0, done.stderr
    # Before it, loky's workers may say that their driver was killed while they started.
    killed, half_way = map(int, done.stdout.splitlines()[-1].split())
    assert killed == kills
    assert half_way > 0


def plain(offset=0, scale=2):
    def task(x, seed):
        return {"y": x * scale}

    return task


RUNS = tl.parameter_grid(x=range(30))


def go(folder, task=None, runs=RUNS, **kwargs):
    return tl.run_campaign(task or plain(), runs, n_jobs=1, out=folder, **kwargs)


def test_a_finished_campaign_is_read_and_not_run_again(tmp_path):
    first = go(tmp_path)

    second = go(tmp_path)
    assert second.attrs["resumed"] == 30
    assert second.attrs["executor"] == "none"
    pd.testing.assert_frame_equal(first, second)


@pytest.mark.parametrize("longer", [tl.parameter_grid(x=range(45)), [*RUNS, {"x": 7}, {"x": 99}]])
def test_a_campaign_that_grows_runs_only_what_is_new(tmp_path, longer):
    go(tmp_path)
    grown = go(tmp_path, runs=longer)
    assert grown.attrs["resumed"] == 30
    pd.testing.assert_frame_equal(grown, tl.run_campaign(plain(), longer, n_jobs=1))
    assert tl.read_campaign(tmp_path).attrs["runs"] == len(longer)


def test_gaps_in_the_middle_are_filled(tmp_path):
    first = go(tmp_path)
    files = chunks(tmp_path)
    assert len(files) > 2
    files[0].unlink()
    files[-1].unlink()
    second = go(tmp_path)
    assert 0 < second.attrs["resumed"] < 30
    pd.testing.assert_frame_equal(first, second)


WORKER = """
import sys, time
from multiprocessing.connection import Connection
from trustlab.campaign.worker import exit_with_parent
exit_with_parent(Connection(int(sys.argv[1]), writable=False))
time.sleep(50)
"""


@pytest.mark.skipif(os.name != "posix", reason="passes a file descriptor on")
def test_a_worker_whose_parent_died_before_it_had_started_ends():
    read, write = os.pipe()
    environment = os.environ | {"PYTHONPATH": str(Path(tl.__file__).parents[1])}
    worker = subprocess.Popen(
        [sys.executable, "-c", WORKER, str(read)], env=environment, pass_fds=[read]
    )
    os.close(write)  # as the system does when the parent is killed
    os.close(read)
    assert worker.wait(45) == 1


def test_what_was_being_written_is_thrown_away(tmp_path):
    first = go(tmp_path)
    victim = chunks(tmp_path)[-1]
    half = victim.with_name(victim.name + ".partial-1")
    half.write_bytes(victim.read_bytes()[:100])
    victim.unlink()
    pd.testing.assert_frame_equal(first, go(tmp_path))
    assert not half.exists()


def test_another_task_is_refused_with_what_changed(tmp_path):
    go(tmp_path)
    before = [f.name for f in chunks(tmp_path)]

    def other(x, seed):
        return {"y": x * 3}

    with pytest.raises(
        CampaignError, match=r"holds another campaign: the task changed.*fresh=True"
    ):
        go(tmp_path, other)
    with pytest.raises(CampaignError, match=r"scale in .*plain.*task was 2, is 4"):
        go(tmp_path, plain(scale=4))
    with pytest.raises(CampaignError, match="seed was 0, is 1"):
        go(tmp_path, seed=1)
    assert [f.name for f in chunks(tmp_path)] == before
    assert list(go(tmp_path, other, fresh=True)["y"]) == [3 * x for x in range(30)]


@pytest.mark.parametrize(
    ("runs", "said"),
    [
        (
            tl.parameter_grid(x=[*range(12), 50, *range(13, 30)]),
            r"runs \d+ to \d+ have other values",
        ),
        (tl.parameter_grid(x=range(29)), r"it has runs \d+ to 29, of 29 runs now"),
        (tl.parameter_grid(x=[float(i) for i in range(30)]), r"runs 0 to \d+ have other values"),
        (tl.parameter_grid(x=range(30), z=[1]), "parameters were x, are x, z"),
    ],
)
def test_other_parameters_are_refused_with_what_changed(tmp_path, runs, said):
    def task(x, seed, z=0):
        return {"y": x}

    go(tmp_path, task)
    with pytest.raises(CampaignError, match=said):
        go(tmp_path, task, runs)


def test_other_versions_are_refused_by_name_and_allowed_by_name(tmp_path):
    first = go(tmp_path)
    manifest = tmp_path / "campaign.json"
    now = {"trustlab": tl.__version__, "Python": platform.python_version(), "numpy": np.__version__}
    now["numba"] = numba.__version__
    assert json.loads(manifest.read_text())["versions"] == now
    older = now | {"numpy": "1.26.4", "numba": "0.59.1"}
    manifest.write_text(json.dumps(json.loads(manifest.read_text()) | {"versions": older}))
    chunks(tmp_path)[0].unlink()
    with pytest.raises(
        CampaignError,
        match=rf"other versions.*: numpy was 1\.26\.4, is {np.__version__}; numba was 0\.59",
    ):
        go(tmp_path)
    with pytest.raises(CampaignError, match=r"numpy was .*other_versions=\['numpy'\]"):
        go(tmp_path, other_versions=["numba"])
    table = go(tmp_path, other_versions=["numba", "numpy"])
    pd.testing.assert_frame_equal(first, table)
    mixed = tl.read_campaign(tmp_path).attrs["versions"]
    assert mixed == now | {
        "numpy": f"1.26.4, {np.__version__}",
        "numba": f"0.59.1, {numba.__version__}",
    }
    with pytest.raises(CampaignError, match=r"numpy was 1\.26\.4, "):
        go(tmp_path)  # a mixed table is never returned without being asked for
    assert tl.read_campaign(tmp_path).attrs["versions"] == mixed
    with pytest.raises(ValueError, match=r"other_versions must be one of .*did you mean 'numpy'"):
        go(tmp_path, other_versions=["nunpy"])


def test_parameters_of_any_kind_are_told_apart(tmp_path, operators):
    def task(model, f, seed):
        return {"b": model.robot.b}

    model = operators["pilot"]
    runs = [{"model": model, "f": plain()}, {"model": operators["1"], "f": plain()}]
    table = go(tmp_path, task, runs)
    assert table["model"][0] is model
    assert list(go(tmp_path, task, [dict(values) for values in runs])["b"]) == [
        m.robot.b for m in table["model"]
    ]
    with pytest.raises(CampaignError, match=r"parameters changed: runs \d to \d have other values"):
        go(tmp_path, task, [runs[0], {"model": operators["2"], "f": plain()}])
    with pytest.raises(CampaignError, match=r"parameters changed: runs \d to \d have other values"):
        go(tmp_path, task, [{"model": model, "f": plain(scale=3)}, runs[1]])
    assert "TscModel" in tl.read_campaign(tmp_path)["model"][0]


def test_damaged_and_foreign_folders_are_refused(tmp_path):
    folder = tmp_path / "a"
    go(folder)
    victim = chunks(folder)[-1]
    data = victim.read_bytes()
    victim.write_bytes(data[:-1] + bytes([data[-1] ^ 1]))
    with pytest.raises(CampaignError, match=rf"{victim.name} is damaged: .*delete it"):
        go(folder)
    victim.unlink()
    go(folder)
    extra = victim.with_name(chunks(folder)[0].name.replace("runs-0000000000", "runs-0000000002"))
    extra.write_bytes(b"")
    with pytest.raises(CampaignError, match="which other chunks hold too"):
        go(folder)
    extra.unlink()
    (folder / "chunks" / "notes.txt").write_bytes(b"")
    with pytest.raises(CampaignError, match="no chunk of a campaign"):
        go(folder)
    (folder / "chunks" / "notes.txt").unlink()
    manifest = (folder / "campaign.json").read_text()
    (folder / "campaign.json").write_text(manifest[: len(manifest) // 2])
    with pytest.raises(CampaignError, match=r"campaign.json cannot be read"):
        go(folder)
    (folder / "campaign.json").write_text(json.dumps(json.loads(manifest) | {"format": 99}))
    with pytest.raises(CampaignError, match="has format 99"):
        go(folder)
    for text in ["[]", "5", "[" * 100_000, "\ud800"]:
        (folder / "campaign.json").write_bytes(text.encode("utf-8", "surrogatepass"))
        for use in (go, tl.read_campaign):
            with pytest.raises(CampaignError, match=r"campaign.json cannot be read .*restore it"):
                use(folder)
    (folder / "campaign.json").unlink()
    with pytest.raises(CampaignError, match=r"half a campaign: \d+ chunks, but campaign.json"):
        go(folder)
    assert len(go(folder, fresh=True)) == 30
    other = tmp_path / "b"
    other.mkdir()
    (other / "thesis.tex").write_text("years of work")
    for fresh in (False, True):
        with pytest.raises(CampaignError, match=r"holds other files, such as thesis.tex;"):
            go(other, fresh=fresh)
    assert (other / "thesis.tex").exists()
    with pytest.raises(CampaignError, match=r"thesis.tex is a file"):
        go(other / "thesis.tex")
    with pytest.raises(CampaignError, match="holds no campaign"):
        tl.read_campaign(other)


def test_a_kill_before_the_first_chunk_leaves_a_folder_that_can_be_used(tmp_path):
    go(tmp_path)
    (tmp_path / "campaign.json").unlink()  # it is written after the parameters and before any chunk
    for file in chunks(tmp_path):
        file.unlink()
    assert len(go(tmp_path)) == 30


def test_an_unwritable_folder_is_refused(tmp_path):
    if os.geteuid() == 0:
        target = Path("/proc/trustlab-campaign")  # not even the superuser writes there
    else:
        target = tmp_path / "closed" / "out"
        target.parent.mkdir(mode=0o500)
    with pytest.raises(CampaignError, match=r"cannot write in .*choose a folder"):
        go(target)


def test_a_full_disk_loses_nothing_that_was_written(tmp_path, monkeypatch):
    import trustlab.campaign.folder as folder

    write, calls = folder.write_atomically, []

    def full(path, data):
        calls.append(path)
        if len(calls) > 3:
            raise OSError(28, "No space left on device")
        write(path, data)

    monkeypatch.setattr(folder, "write_atomically", full)
    with pytest.raises(
        CampaignError, match=r"No space left on device; finished chunks before it are safe"
    ):
        go(tmp_path)
    monkeypatch.undo()
    assert go(tmp_path).attrs["resumed"] > 0


def test_a_disk_that_is_full_from_the_start_is_a_sentence(tmp_path, monkeypatch):
    import trustlab.campaign.folder as folder

    def full(path, data, write=folder.write_atomically):
        if path.name == "campaign.json":
            raise OSError(28, "No space left on device")
        write(path, data)

    monkeypatch.setattr(folder, "write_atomically", full)
    with pytest.raises(
        CampaignError,
        match=r"cannot write in .*: No space left on device; choose a folder that has room",
    ):
        go(tmp_path)
    monkeypatch.undo()
    assert len(go(tmp_path)) == 30


def test_two_processes_cannot_share_a_folder(tmp_path):
    def task(x, seed):
        go(tmp_path)
        return {"y": 0}

    with pytest.warns(tl.campaign.CampaignWarning, match="another process is running a campaign"):
        tl.run_campaign(task, [{"x": 1}], n_jobs=1, out=tmp_path)


def test_a_broken_off_campaign_goes_on(tmp_path):
    stop = [12]

    def task(x, seed):
        if x == stop[0]:
            raise KeyboardInterrupt
        return {"y": x}

    with pytest.raises(KeyboardInterrupt):
        go(tmp_path, task)
    part = tl.read_campaign(tmp_path)
    assert 0 < len(part) <= 12
    assert part.attrs == {
        "runs": 30,
        "finished": len(part),
        "failed": 0,
        "versions": part.attrs["versions"],
    }
    stop[0] = -1
    with pytest.raises(CampaignError, match=r"stop in .*was list\[12\], is list\[-1\]"):
        go(tmp_path, task)
    stop[0] = 12
    with pytest.raises(KeyboardInterrupt):
        go(tmp_path, task)


def test_an_empty_campaign_reads_as_an_empty_table(tmp_path):
    def task(x, seed):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        go(tmp_path, task)
    assert list(tl.read_campaign(tmp_path).columns) == ["run", "x", "failed", "error", "traceback"]


def test_memory_does_not_grow_with_the_number_of_runs(tmp_path, monkeypatch):
    """
    Peak up to the moment at which the table is read, for 500 and 4,000 runs of four kilobytes each.
    """

    def task(x, seed):
        return {"text": f"{x:04000d}"}

    def peak(n):
        seen = []

        def stop(*_):
            seen.append(tracemalloc.get_traced_memory()[1])
            raise InterruptedError

        monkeypatch.setattr("trustlab.campaign.folder.CampaignFolder.outcomes", stop)
        monkeypatch.setattr("trustlab.campaign.dispatch.MOST_RUNS", 100)
        tracemalloc.start()
        try:
            with pytest.raises(InterruptedError):
                go(tmp_path / str(n), task, tl.parameter_grid(x=range(n)))
        finally:
            tracemalloc.stop()
        return seen[0]

    peak(300)
    small, large = peak(500), peak(4_000)
    assert large < small + 4e6  # the results alone are 16 MB


class Sealed:
    """A value that cannot be pickled and has no attributes to be known by."""

    __slots__ = ("x",)

    def __init__(self, x):
        self.x = x

    def __reduce__(self):
        raise TypeError("sealed")


def test_a_value_without_digest_never_gives_a_result_that_could_be_taken_for_another(tmp_path):
    def unsealed(value, seed):
        return {"y": value.x}

    for x in (1, 2):
        with pytest.warns(tl.campaign.CampaignWarning, match="sealed"):
            table = tl.run_campaign(
                unsealed, [{"value": Sealed(x)}], n_jobs=1, out=tmp_path / "out"
            )
        assert table["failed"].all()
        assert "y" not in table
