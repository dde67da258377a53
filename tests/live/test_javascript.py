"""The browser's modules, linted and run in node. Oracle: what the tests in JavaScript state."""

import re
import shutil
import subprocess
from pathlib import Path

import pytest

from trustlab.live.widget import STATIC

HERE = Path(__file__).with_name("javascript")
NODE = shutil.which("node")
PACKAGES = HERE / "node_modules"
ESLINT = shutil.which("eslint", path=str(PACKAGES / ".bin"))


@pytest.fixture(scope="module")
def modules(tmp_path_factory):
    """A folder with the modules and their tests."""
    folder = tmp_path_factory.mktemp("javascript")
    for path in [*STATIC.glob("*.js"), *HERE.glob("*.test.js")]:
        shutil.copy(path, folder)
    (folder / "package.json").write_text('{"type": "module"}')
    return folder


@pytest.mark.skipif(ESLINT is None, reason="needs eslint: npm ci --prefix tests/live/javascript")
def test_modules_are_linted(modules):
    """A fault is found where it was put, and nowhere else."""
    shutil.copy(HERE / "eslint.config.js", modules)
    (modules / "node_modules").symlink_to(PACKAGES)
    (modules / "fault.js").write_text("let unused = undeclared;\n")
    command = [ESLINT, "--max-warnings=0", "."]
    said = subprocess.run(command, cwd=modules, capture_output=True, text=True).stdout
    assert "no-undef" in said
    assert re.findall(r"(\S+\.js)$", said, re.M) == [str(modules / "fault.js")], said


@pytest.mark.skipif(NODE is None, reason="needs node: apt-get install nodejs")
def test_modules_in_node(modules):
    done = subprocess.run([NODE, "--test"], cwd=modules, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    assert re.search("[#ℹ] pass [1-9]", done.stdout), "some were found"
