"""The examples of docstrings print what they say, and every name of `trustlab` has one."""

import doctest
import importlib
import inspect
from pathlib import Path

import pytest

import trustlab as tl

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "trustlab"
MODULES = [
    ".".join(path.relative_to(ROOT).with_suffix("").parts)
    for path in sorted(PACKAGE.rglob("*.py"))
    if ">>> " in path.read_text()
]
# One worker compiles and reads what many examples need once.
pytestmark = pytest.mark.xdist_group("examples")


def test_a_group_of_tests_stays_in_one_worker(request):
    """pytest-xdist tells a group by a test's name; some versions of pytest undo that unseen."""
    if not hasattr(request.config, "workerinput"):
        pytest.skip("tests run in one process")
    assert request.node.nodeid.endswith("@examples")


@pytest.mark.parametrize("name", MODULES)
@pytest.mark.filterwarnings("ignore")
def test_examples(name, monkeypatch, tmp_path):
    (tmp_path / "data").symlink_to(ROOT / "data")  # some read it, and what they write is left here
    monkeypatch.chdir(tmp_path)
    done = doctest.testmod(importlib.import_module(name), optionflags=doctest.NORMALIZE_WHITESPACE)
    assert done.attempted > 0
    assert done.failed == 0


@pytest.mark.parametrize(
    "name", [name for name in tl.__all__ if not inspect.ismodule(getattr(tl, name))]
)
def test_every_public_name_has_an_example(name):
    doc = getattr(tl, name).__doc__
    examples = doctest.DocTestParser().get_examples(doc)
    assert any(name in example.source for example in examples)
    assert not examples[-1].options.get(doctest.SKIP)
