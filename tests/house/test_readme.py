"""Every Python block of the README runs as it stands, where data/ is the repository's and the lab's log is made up."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text()
BLOCKS = re.findall(r"```python\n(.*?)```", README, re.S)
RECIPE = re.search(r"```toml\n(.*?)```", README, re.S)[1]

LOG = """stamp,driver,deviation,x,y,stick_v,stick_w
2000,human,1.5,0,0,1.0,0
2100,human,1.6,3,4,1.0,0
2200,robot,1.7,6,8,1.0,90
"""


def test_there_are_blocks():
    assert len(BLOCKS) >= 8


@pytest.mark.parametrize("block", BLOCKS, ids=lambda block: block.splitlines()[2][:40])
def test_block_runs(block, tmp_path):
    (tmp_path / "data").symlink_to(ROOT / "data")
    (tmp_path / "my_lab.toml").write_text(RECIPE)
    for folder in ("p3", "study/p3"):
        (tmp_path / folder).mkdir(parents=True)
        (tmp_path / folder / "run1.csv").write_text(LOG)
    env = os.environ | {"MPLBACKEND": "Agg"}
    done = subprocess.run([sys.executable, "-c", block], cwd=tmp_path, env=env, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-2000:]
    assert done.stdout.strip()


@pytest.mark.parametrize("name", ["README.md", "CONTRIBUTING.md"])
def test_links_and_figures_are_there(name):
    targets = re.findall(r"\]\(([^)#:]+)\)", (ROOT / name).read_text())
    paths = re.findall(r"`((?:data|notebooks|reports|tests|trustlab)/[\w./]+)`", (ROOT / name).read_text())
    missing = [place for place in targets + paths if not (ROOT / place).exists()]
    assert [place for place in missing if not place.startswith("data/external")] == []
