"""The house stays readable, beyond what ruff checks: repeats, numbered slots, names, folders."""

import ast
import functools
import re
from collections import Counter, defaultdict
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "trustlab"
FILES = sorted(PACKAGE.rglob("*.py"))
WIDTH = 100
SLOT = re.compile(r"\b(?:c|row|log|state|out)\[(?:\w+, *)?\d+\]")
DOCUMENTED = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
pytestmark = pytest.mark.xdist_group("layout")  # one worker reads all files, once


def code(source):
    """The statements of a file, one a line, without comments and docstrings."""
    tree = ast.parse(source)
    for node in ast.walk(tree):
        if isinstance(node, DOCUMENTED) and ast.get_docstring(node):
            node.body[0].value.value = ""
    return ast.unparse(tree).splitlines()


def wide_tuples(source):
    """Assignments of three or more names to as many values: each wants a line of its own."""
    assigned = [node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.Assign)]
    return [
        node.lineno
        for node in assigned
        if isinstance(node.value, ast.Tuple)
        and isinstance(node.targets[0], ast.Tuple)
        and len(node.targets[0].elts) > 2
    ]


def classes(sources):
    """Every class of these files, by name: what two files call the same is two things."""
    places = defaultdict(list)
    for name, source in sources.items():
        for node in ast.walk(ast.parse(source)):
            if isinstance(node, ast.ClassDef):
                places[node.name].append(name)
    return places


def slots(source):
    """Numbered slots, as in c[7] or row[39]: every place where a reader has to count."""
    return [match for line in code(source) for match in SLOT.findall(line)]


def repeats(sources, statements=8):
    """Runs of statements that stand in two places, to the letter but for indentation."""
    places = defaultdict(set)
    for name, source in sources.items():
        lines = [line.strip() for line in code(source)]
        telling = [x for x in lines if len(x) > 24 and not x.startswith(("from ", "import "))]
        for i in range(len(telling) - statements + 1):
            places[tuple(telling[i : i + statements])].add((name, i))
    return [(run[0], sorted(where)) for run, where in places.items() if len(where) > 1]


@functools.cache
def sources():
    return {path.relative_to(PACKAGE).as_posix(): path.read_text() for path in FILES}


def test_an_assignment_has_one_thought():
    assert {name: rows for name, text in sources().items() if (rows := wide_tuples(text))} == {}


def test_no_line_of_a_page_is_wide():
    lines = [(path.name, x) for path in PACKAGE.rglob("*.js") for x in path.read_text().split("\n")]
    assert [(name, line) for name, line in lines if len(line) > WIDTH] == []


def test_a_class_name_means_one_thing():
    """But for the settings of simulated studies, beside the loop that simulates one run."""
    twice = {name for name, at in classes(sources()).items() if len(at) > 1}
    assert twice == {"Simulation"}


def test_no_folder_shows_more_than_16_files():
    assert {f: n for f, n in Counter(path.parent for path in FILES).items() if n > 16} == {}


def test_no_numbered_slots():
    assert {name: match for name, source in sources().items() if (match := slots(source))} == {}


def test_no_eight_statements_stand_twice():
    assert repeats(sources()) == []


def test_the_checks_see_what_they_should():
    lines = "\n".join(f"    variable_of_some_length = f({i})" for i in range(9))
    source = f"def f(x):\n    '''Do it.'''\n{lines}\n"
    assert slots("a = c[7] + row[k, 39] + c[k]\n# c[3]\n") == ["c[7]", "row[k, 39]"]
    assert repeats({"a": source, "b": source}) != []
    assert repeats({"a": source}) == []
    assert classes({"a": "class A: pass", "b": "class A: pass"}) == {"A": ["a", "b"]}
    assert wide_tuples("a, b, c = 1, 2, 3\na, b = 1, 2\na, b, c = f()\n") == [1]


def test_a_group_of_tests_stays_in_one_worker(request):
    """pytest-xdist tells a group by a test's name; some versions of pytest undo that unseen."""
    if not hasattr(request.config, "workerinput"):
        pytest.skip("tests run in one process")
    assert request.node.nodeid.endswith("@layout")
