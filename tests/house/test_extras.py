"""A feature whose extra is not installed says which one to install, and changes nothing."""

import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]

USES = {
    "read a bag": ("ros", "rosbags.highlevel", "tl.read_session('run.bag')"),
    "write a bag": ("ros", "rosbags", "tl.write_session(session, 'new.mcap')"),
    "publish": ("reports", "papermill", "import trustlab.publishing.run"),
}


@pytest.mark.parametrize("use", USES)
def test_missing_extra_is_named(use, tmp_path):
    extra, package, call = USES[use]
    (tmp_path / "run.bag").write_bytes(b"#ROSBAG V2.0\n")
    (tmp_path / "notebooks").mkdir()
    code = (
        f"import sys; sys.modules[{package!r}] = None\n"
        "import numpy as np, pandas as pd, trustlab as tl\n"
        "frame = pd.DataFrame({'mode': [1.0, 0.0]}, index=pd.Index([0.0, 0.1], name='t'))\n"
        f"session = tl.Session(frame)\n{call}\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True
    )
    assert f'pip install "trustlab[{extra}]"' in done.stderr.splitlines()[-1]
    assert package.partition(".")[0] in done.stderr.splitlines()[-1]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["notebooks", "run.bag"]


NO_LIVE = """
import sys

class Missing:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {"anywidget", "tornado", "traitlets"}:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

sys.meta_path.insert(0, Missing())
"""


@pytest.mark.parametrize("module", ["tl", "tl.live"])
def test_names_of_a_missing_extra_are_absent_and_asking_for_one_says_what_to_install(module):
    """Oracle: the protocol of hasattr and inspect.getmembers, which pass over AttributeError."""
    code = (
        f"{NO_LIVE}\nimport inspect\nimport trustlab as tl\n"
        f"names = [name for name, _ in inspect.getmembers({module})]\n"
        f"print(hasattr({module}, 'LiveGroundRobot'), 'LiveGroundRobot' in names)\n"
        f"print(hasattr({module}, 'DriveSettings'), 'DriveSettings' in names)\n"
        f"{module}.LiveGroundRobot\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.stdout.split() == ["False", "False", "True", "True"], done.stderr
    last = done.stderr.splitlines()[-1]
    assert last.startswith("AttributeError: anywidget is not installed")
    assert 'pip install "trustlab[live]"' in last


def test_the_lock_has_every_dependency_and_names_no_registry():
    lock = (ROOT / "environment.lock").read_text()
    locked = {line.partition("==")[0] for line in lock.splitlines() if line[:1].isalpha()}
    needed = [PROJECT["dependencies"], *PROJECT["optional-dependencies"].values()]
    names = {
        line.partition(">")[0].replace("_", "-")
        for group in needed
        for line in group
        if "[" not in line
    }
    assert names - locked == set()
    assert "://" not in lock
