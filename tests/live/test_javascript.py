"""
The browser's modules, linted and run in node. Oracle: numba's rows, and what the tests in
JavaScript state.
"""

import json
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

import trustlab as tl
from trustlab.live.build import STATIC
from trustlab.live.runs import drive_config, driven
from trustlab.live.tasks.task import task_named

HERE = Path(__file__).with_name("javascript")
NODE = shutil.which("node")
PACKAGES = HERE / "node_modules"
ESLINT = shutil.which("eslint", path=str(PACKAGES / ".bin"))


@pytest.fixture(scope="module")
def modules(tmp_path_factory):
    """A folder with the modules, their tests, and a drive by numba."""
    folder = tmp_path_factory.mktemp("javascript")
    for path in [*STATIC.glob("*.js"), *HERE.glob("*.test.js"), STATIC / "kernel.wasm"]:
        shutil.copy(path, folder)
    (folder / "package.json").write_text('{"type": "module"}')
    config = drive_config("C1", tl.published_models()["2"], seconds=150.0, seed=3)
    t = np.arange(1200)
    v = 0.3 + 0.2 * np.sin(0.01 * t)
    commands = np.column_stack([v, 0.1 + 0.7 * np.sin(0.05 * t), t // 60 % 2])
    rows, _ = driven(config, commands)
    drive = {"config": config, "commands": commands.tolist(), "rows": rows.tolist()}
    (folder / "drive.json").write_text(json.dumps(drive))
    (folder / "flight.json").write_text(json.dumps(flight()))
    (folder / "lead.json").write_text(json.dumps(lead()))
    return folder


def made(task, config, commands):
    """A run by numba, with what a page would draw."""
    run, rows, pictures = task.begin(config), [], []
    for command in commands:
        rows.append(run.step(*command))
        pictures.append(run.picture())
    memory = task.memory(config)
    config["words"] = {"diverged": "too far"}
    written = {"config": config, "memory": memory, "commands": commands}
    return written | {"rows": rows, "pictures": pictures}


def flight():
    """A flight."""
    task = task_named("teleoperation")
    config = task.config(task.settings(duration=5.0).as_json(), "TMIG", {}, seed=3)
    t = 0.05 * np.arange(config["samples"])
    commands = np.column_stack([np.sin(t), 0.5 * np.cos(2 * t), np.full(len(t), -1.0)]).tolist()
    written = made(task, config, commands)
    shown = ("target", "robot", "device", "force", "guide")
    pictures = [{name: picture[name] for name in shown} for picture in written["pictures"]]
    return written | {"pictures": pictures}


def lead():
    """A team of which the person lets another robot lead half-way."""
    task = task_named("team")
    config = task.config(task.settings(duration=20.0).as_json(), "suggested", {}, seed=1)
    t = 0.05 * np.arange(config["samples"])
    commands = np.column_stack([np.sin(0.3 * t), np.cos(0.2 * t), 2 * (t >= 10)]).tolist()
    return made(task, config, commands)


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
@pytest.mark.parametrize("name", ["physics", "hands", "view", "flight", "lead"])
def test_modules_in_node(modules, name):
    done = subprocess.run(
        [NODE, "--test", f"{name}.test.js"], cwd=modules, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "# fail 0" in done.stdout or "ℹ fail 0" in done.stdout
