"""Every Python block of the README runs as it stands, in a folder where data/ is the repository's."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
BLOCKS = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.S)
RUNNABLE = [block for block in BLOCKS if "my_lab.toml" not in block]


def test_there_are_blocks():
    assert len(RUNNABLE) >= 3


@pytest.mark.parametrize("block", RUNNABLE, ids=lambda block: block.splitlines()[2][:40])
def test_block_runs(block, tmp_path):
    (tmp_path / "data").symlink_to(ROOT / "data")
    env = os.environ | {"MPLBACKEND": "Agg"}
    done = subprocess.run(
        [sys.executable, "-c", block], cwd=tmp_path, env=env, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr[-2000:]
    assert done.stdout.strip()
