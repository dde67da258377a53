"""Compiled functions are cached under a digest of everything they call: an edit elsewhere is never missed."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
RUN = """
import numba, trustlab as tl
robot = tl.RobotModel(a=0.996, p_min=0.24, p_max=0.39, p_h_max=0.46)
tsc = tl.TscModel(robot, tl.HumanModel(a=0.9991, beta=0.74, p_min=0.39, p_max=0.46))
print(repr(float(tl.simulate_allocation(tsc, 0.0, 0.35, steps=5000)["r"].mean())), numba.config.CACHE_DIR or "-")
"""


@pytest.fixture
def copy(tmp_path):
    """A copy of the package, without anything compiled."""
    shutil.copytree(ROOT / "trustlab", tmp_path / "trustlab", ignore=shutil.ignore_patterns("__pycache__"))
    return tmp_path


def run(folder, code=RUN, **environment):
    env = os.environ | {"PYTHONPATH": str(folder)} | {k: str(v) for k, v in environment.items()}
    done = subprocess.run([sys.executable, "-c", code], env=env, cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout.split(), done.stderr


def compiled(folder):
    return {path.relative_to(folder) for path in folder.rglob("*.nbc")}


def test_an_edit_of_a_function_in_another_file_is_seen(copy):
    human = copy / "trustlab" / "models" / "human.py"
    text = human.read_text()
    (before, _), _ = run(copy)
    kept = compiled(copy)
    assert kept
    human.write_text(text.replace("if r <= 0.0 or r >= 1.0:", "if r > 0.5:"))
    (edited, _), _ = run(copy)
    assert edited != before
    # What depends on the edited file is swept and compiled again; what does not, as the robot's model, is kept.
    unchanged = {path.parts[3].rpartition("-")[0] for path in kept & compiled(copy)}
    assert "models.robot" in unchanged
    assert not unchanged & {"models.human", "models.tsc", "allocation.simulation"}
    human.write_text(text)
    assert run(copy)[0][0] == before


def test_a_second_start_compiles_nothing(copy):
    run(copy)
    ages = {path: path.stat().st_mtime_ns for path in copy.rglob("*.nbc")}
    run(copy)
    assert {path: path.stat().st_mtime_ns for path in copy.rglob("*.nbc")} == ages


def test_the_users_own_setting_of_numba_is_left_alone(copy, tmp_path):
    (_, shown), _ = run(copy, NUMBA_CACHE_DIR=tmp_path / "theirs")
    assert shown == str(tmp_path / "theirs")
    assert not (tmp_path / "theirs").exists()


def test_without_a_folder_to_write_to_it_works_and_says_so_once(copy):
    (copy / "trustlab" / "__pycache__").mkdir(exist_ok=True)
    (copy / "trustlab" / "__pycache__" / "compiled").write_text("in the way")
    (value, _), said = run(copy, HOME=os.devnull, XDG_CACHE_HOME=os.devnull, LOCALAPPDATA=os.devnull)
    assert said.count("TRUSTLAB_CACHE_DIR") == 1
    assert compiled(copy) == set()
    assert run(copy, TRUSTLAB_CACHE_DIR=copy / "named")[0][0] == value
    assert (copy / "named").is_dir()
