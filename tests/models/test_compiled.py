"""
Compiled functions are cached under a digest of everything they call: an edit elsewhere is never
missed.
"""

import os
import shutil
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from trustlab.models.compiled import NOTICE, _Notice

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


@pytest.fixture(scope="module")
def first(tmp_path_factory):
    """A copy of the package in which `RUN` has compiled what it needs, and what it printed."""
    folder = package_in(tmp_path_factory.mktemp("first"))
    (value, _), _ = run(folder)
    return folder, value


def run(folder, code=RUN, **environment):
    inherited = {name: value for name, value in os.environ.items() if name != "TRUSTLAB_CACHE_DIR"}
    env = inherited | {"PYTHONPATH": str(folder)} | {k: str(v) for k, v in environment.items()}
    done = subprocess.run(
        [sys.executable, "-c", code], env=env, cwd=folder, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout.split(), done.stderr


def compiled(folder):
    return {path.relative_to(folder) for path in folder.rglob("*.nbc")}


def test_a_second_start_compiles_nothing(first):
    copy, _ = first
    ages = {path: path.stat().st_mtime_ns for path in copy.rglob("*.nbc")}
    run(copy)
    assert {path: path.stat().st_mtime_ns for path in copy.rglob("*.nbc")} == ages


def test_the_users_own_setting_of_numba_is_left_alone(first, tmp_path):
    (_, shown), _ = run(first[0], NUMBA_CACHE_DIR=tmp_path / "theirs")
    assert shown == str(tmp_path / "theirs")
    assert not (tmp_path / "theirs").exists()


def test_without_a_folder_to_write_to_it_works_and_says_so_once(first, tmp_path):
    copy = package_in(tmp_path)
    (copy / "trustlab" / "__pycache__").mkdir()
    (copy / "trustlab" / "__pycache__" / "compiled").write_text("in the way")
    (value, _), said = run(
        copy, HOME=os.devnull, XDG_CACHE_HOME=os.devnull, LOCALAPPDATA=os.devnull
    )
    assert said.count("TRUSTLAB_CACHE_DIR") == 1
    assert compiled(copy) == set()
    assert value == first[1]
    assert (
        run(
            copy,
            "from trustlab.models.tsc import yerkes_dodson",
            TRUSTLAB_CACHE_DIR=copy / "named",
        )[1]
        == ""
    )
    assert (copy / "named").is_dir()


def test_an_edit_of_a_function_in_another_file_is_seen(first):
    folder, before = first
    human = folder / "trustlab" / "models" / "human.py"
    text = human.read_text()
    kept = compiled(folder)
    assert kept
    human.write_text(text.replace("if r <= 0.0 or r >= 1.0:", "if r > 0.5:"))
    (edited, _), _ = run(folder)
    assert edited != before
    # What depends on the edited file is swept and compiled again; what does not, as the robot's
    # model, is kept.
    unchanged = {path.parts[3].rpartition("-")[0] for path in kept & compiled(folder)}
    assert "models.robot" in unchanged
    assert not unchanged & {"models.human", "models.tsc", "allocation.simulation"}
    human.write_text(text)
    assert run(folder)[0][0] == before


def compilation_in(module):
    """What numba says of compiling a function of a module."""
    function = SimpleNamespace(py_func=SimpleNamespace(__module__=module))
    return SimpleNamespace(data={"dispatcher": function})


def test_compilation_is_announced_once_after_two_seconds_and_quick_ones_not_at_all(capsys):
    quick, slow = _Notice(), _Notice()
    ours = compilation_in("trustlab.models.trust")
    quick.on_start(ours)
    quick.on_end(ours)
    quick.timer.join()
    assert capsys.readouterr().err == ""
    slow.spent = 1.99  # of functions compiled before
    for _ in range(2):
        slow.on_start(ours)
        slow.on_start(ours)  # one that the first calls
        slow.timer.join()
        slow.on_end(ours)
        slow.on_end(ours)
    assert capsys.readouterr().err == NOTICE + "\n"


def test_compilation_of_a_users_function_is_not_announced(capsys):
    notice = _Notice()
    notice.spent = 1.99
    for module in ("mine", "trustlabelled"):
        notice.on_start(compilation_in(module))
        assert notice.timer is None
        notice.on_end(compilation_in(module))
    assert (notice.spent, capsys.readouterr().err) == (1.99, "")
