"""Links and figures of README and CONTRIBUTING are there; README's Python blocks run in `test_wheel.py`."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("name", ["README.md", "CONTRIBUTING.md"])
def test_links_and_figures_are_there(name):
    targets = re.findall(r"\]\(([^)#:]+)\)", (ROOT / name).read_text())
    paths = re.findall(r"`((?:data|notebooks|reports|tests|trustlab)/[\w./]+)`", (ROOT / name).read_text())
    missing = [place for place in targets + paths if not (ROOT / place).exists()]
    assert [place for place in missing if not place.startswith("data/external")] == []
