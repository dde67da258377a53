"""
Compiled functions are found again only where nothing that they may use has changed. Oracle: what a
copy of the package, whose sources are edited, prints and compiles in a process of its own.
"""

import os
import shutil
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from trustlab.models.digest import digest

ROOT = Path(__file__).parents[2]
RUN = """
import numba, trustlab as tl
robot = tl.RobotModel(a=0.996, p_min=0.24, p_max=0.39, p_h_max=0.46)
tsc = tl.TscModel(robot, tl.HumanModel(a=0.9991, beta=0.74, p_min=0.39, p_max=0.46))
run = tl.simulate_allocation(tsc, 0.0, 0.35, steps=5000)
print(repr(float(run["r"].mean())), numba.config.CACHE_DIR or "-")
"""


def package_in(folder):
    """A copy of the package, without anything compiled."""
    shutil.copytree(
        ROOT / "trustlab", folder / "trustlab", ignore=shutil.ignore_patterns("__pycache__")
    )
    return folder


def run(folder, code=RUN, **environment):
    """What a process prints on both streams that imports the package from a folder."""
    env = os.environ | {"PYTHONPATH": str(folder)} | {k: str(v) for k, v in environment.items()}
    if "TRUSTLAB_CACHE_DIR" not in environment:
        env.pop("TRUSTLAB_CACHE_DIR", None)
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, env=env, cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout.split(), done.stderr


def caches(folder):
    return sorted((folder / "trustlab" / "__pycache__" / "compiled").iterdir())


def compiled(folder):
    return {path: path.stat().st_mtime_ns for path in folder.rglob("*.nbc")}


@pytest.fixture(scope="module")
def first(tmp_path_factory):
    """A copy of the package in which `RUN` has compiled what it needs, and what it printed."""
    folder = package_in(tmp_path_factory.mktemp("first"))
    return folder, *run(folder)


def test_the_first_run_says_that_it_compiles_and_the_second_compiles_nothing(first):
    folder, printed, said = first
    assert said.count("trustlab is compiling") == 1
    before = compiled(folder)
    assert before
    assert run(folder) == (printed, "")
    assert compiled(folder) == before


def test_the_users_own_setting_of_numba_is_left_alone(first, tmp_path):
    (_, shown), _ = run(first[0], NUMBA_CACHE_DIR=tmp_path / "theirs")
    assert shown == str(tmp_path / "theirs")
    assert not (tmp_path / "theirs").exists()


def test_without_a_folder_to_write_to_it_works_and_says_so_once(first, tmp_path):
    copy = package_in(tmp_path)
    (copy / "trustlab" / "__pycache__").mkdir()
    (copy / "trustlab" / "__pycache__" / "compiled").write_text("in the way")
    nowhere = dict.fromkeys(("HOME", "XDG_CACHE_HOME", "LOCALAPPDATA"), os.devnull)
    printed, said = run(copy, **nowhere)
    assert said.count("TRUSTLAB_CACHE_DIR") == 1
    assert compiled(copy) == {}
    assert printed == first[1]
    named = copy / "named"
    _, said = run(copy, "import trustlab.models.tsc", TRUSTLAB_CACHE_DIR=named, **nowhere)
    assert "TRUSTLAB_CACHE_DIR" not in said
    assert next(named.glob("models-*")).is_dir()


def test_an_edit_recompiles_the_rooms_below_and_none_above(first):
    folder, printed, _ = first
    models = folder / "trustlab" / "models" / "tsc.py"
    allocation = folder / "trustlab" / "allocation" / "limits.py"
    text, before = models.read_text(), compiled(folder)
    allocation.write_text(allocation.read_text() + "# edited\n")
    assert run(folder)[0] == printed
    rooms = {
        path.relative_to(folder).parts[3].split("-")[0] for path in compiled(folder) - before.keys()
    }
    assert rooms == {"allocation"}
    models.write_text(text.replace("if r <= 0.0 or r >= 1.0:", "if r > 0.5:"))
    assert run(folder)[0] != printed
    models.write_text(text)
    assert run(folder)[0] == printed


def test_caches_of_older_sources_go_after_a_day_and_not_before(first):
    folder = first[0]
    yesterday, fresh = (caches(folder)[0].with_name(f"models-{name}") for name in ("old", "new"))
    for cache in (yesterday, fresh):
        (cache / "inside").mkdir(parents=True)
    for cache in caches(folder):
        if cache != fresh:
            os.utime(cache, (0, 0))
    run(folder, "import trustlab.models.tsc")
    left = caches(folder)
    assert yesterday not in left
    assert fresh in left
    # The cache in use is touched, and an import of this room says nothing of others.
    assert {cache.name.split("-")[0] for cache in left} == {"models", "allocation"}


def test_parallel_first_starts_agree(first, tmp_path):
    copy = package_in(tmp_path)
    with ThreadPoolExecutor() as pool:
        starts = [*pool.map(run, [copy, copy])]
    assert [printed[0] for printed, _ in starts] == [first[1][0]] * 2


def test_parts_of_a_digest_do_not_run_together():
    assert digest("ab", "c") != digest("a", "bc")
    assert digest("a", "b") != digest("b", "a")
    assert digest("ü") == digest("ü".encode())
