"""What ruff does not see: statements that stand twice, and tests that need the same worker."""

import ast
from collections import defaultdict
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "trustlab"
DOCUMENTED = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
pytestmark = pytest.mark.xdist_group("layout")  # one worker reads all files, once


def code(source):
    """The statements of a file, one a line, without comments and docstrings."""
    tree = ast.parse(source)
    for node in ast.walk(tree):
        if isinstance(node, DOCUMENTED) and ast.get_docstring(node):
            node.body[0].value.value = ""
    return ast.unparse(tree).splitlines()


def repeats(sources, statements=8):
    """Runs of statements that stand in two places, to the letter but for indentation."""
    places = defaultdict(set)
    for name, source in sources.items():
        lines = [line.strip() for line in code(source)]
        telling = [x for x in lines if len(x) > 24 and not x.startswith(("from ", "import "))]
        for i in range(len(telling) - statements + 1):
            places[tuple(telling[i : i + statements])].add((name, i))
    return [(run[0], sorted(where)) for run, where in places.items() if len(where) > 1]


def test_no_eight_statements_stand_twice():
    sources = {str(path): path.read_text() for path in PACKAGE.rglob("*.py")}
    assert repeats(sources) == []


def test_the_checks_see_what_they_should():
    lines = "\n".join(f"    variable_of_some_length = f({i})" for i in range(9))
    source = f"def f(x):\n    '''Do it.'''\n{lines}\n"
    assert repeats({"a": source, "b": source}) != []
    assert repeats({"a": source}) == []


def test_a_group_of_tests_stays_in_one_worker(request):
    """pytest-xdist tells a group by a test's name; some versions of pytest undo that unseen."""
    if not hasattr(request.config, "workerinput"):
        pytest.skip("tests run in one process")
    assert request.node.nodeid.endswith("@layout")
