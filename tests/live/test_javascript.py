"""The browser's modules, linted and run in node. Oracle: what the tests in JavaScript state."""

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
    shutil.copy(HERE / "eslint.config.js", modules)
    (modules / "node_modules").symlink_to(PACKAGES)
    command = [ESLINT, "--max-warnings=0", "."]
    done = subprocess.run(command, cwd=modules, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    fault = modules / "fault.js"
    fault.write_text("let unused = undeclared;\n")
    done = subprocess.run(command, cwd=modules, capture_output=True, text=True)
    fault.unlink()
    assert "no-undef" in done.stdout, "the linter sees what it should"


@pytest.mark.skipif(NODE is None, reason="needs node: apt-get install nodejs")
@pytest.mark.parametrize("name", ["hands", "view", "playout", "socket", "play"])
def test_modules_in_node(modules, name):
    done = subprocess.run(
        [NODE, "--test", f"{name}.test.js"], cwd=modules, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "# fail 0" in done.stdout or "ℹ fail 0" in done.stdout
