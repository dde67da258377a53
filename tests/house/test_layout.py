"""The house stays readable: width, length of functions, parameters, numbered slots, repeats."""

import ast
import functools
import io
import re
import tokenize
from collections import Counter, defaultdict
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "trustlab"
FILES = sorted(PACKAGE.rglob("*.py"))
WIDTH = 100
MOST_PARAMETERS = 10
SLOT = re.compile(r"\b(?:c|row|log|state|out)\[(?:\w+, *)?\d+\]")
pytestmark = pytest.mark.xdist_group("layout")  # one worker reads all files, once
SILENT = {
    tokenize.COMMENT,
    tokenize.NL,
    tokenize.NEWLINE,
    tokenize.INDENT,
    tokenize.DEDENT,
    tokenize.ENDMARKER,
}


def docstring_lines(tree):
    lines = set()
    for node in ast.walk(tree):
        documented = ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef
        if isinstance(node, documented) and node.body:
            first = node.body[0]
            if isinstance(first, ast.Expr) and isinstance(getattr(first.value, "value", None), str):
                lines.update(range(first.lineno, first.end_lineno + 1))
    return lines


@functools.cache
def code_lines(source):
    """The numbers of the lines that hold code."""
    lines = set()
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type not in SILENT:
            lines.update(range(token.start[0], token.end[0] + 1))
    return lines - docstring_lines(ast.parse(source))


def functions(tree):
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            yield node


def compiled(node):
    return any(re.search("njit|vectorize", ast.unparse(d)) for d in node.decorator_list)


def long_functions(source, most):
    """Functions outside kernels with more than `most` lines of code."""
    lines = code_lines(source)
    length = {
        node.name: sum(node.lineno <= line <= node.end_lineno for line in lines)
        for node in functions(ast.parse(source))
        if not compiled(node)
    }
    return {name: n for name, n in length.items() if n > most}


def many_parameters(source, most):
    """Functions and methods that a user may call with more than `most` parameters."""
    counts = {}

    def visit(body):
        for node in body:
            public = not node.name.startswith("_") or node.name == "__init__"
            if isinstance(node, ast.ClassDef) and public:
                visit([n for n in node.body if isinstance(n, ast.FunctionDef | ast.ClassDef)])
            elif isinstance(node, ast.FunctionDef) and public and not compiled(node):
                args = node.args
                names = {a.arg for a in args.posonlyargs + args.args + args.kwonlyargs}
                counts[node.name] = len(names - {"self", "cls"})

    visit([n for n in ast.parse(source).body if isinstance(n, ast.FunctionDef | ast.ClassDef)])
    return {name: n for name, n in counts.items() if n > most}


def wide_tuples(source):
    """Assignments of three or more names to as many values: each wants a line of its own."""
    lines = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Assign) and isinstance(node.value, ast.Tuple):
            targets = node.targets[0]
            if isinstance(targets, ast.Tuple) and len(targets.elts) > 2:
                lines.append(node.lineno)
    return lines


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
    lines = source.splitlines()
    return [match for line in sorted(code_lines(source)) for match in SLOT.findall(lines[line - 1])]


def repeats(sources, lines=8):
    """Runs of `lines` lines of code that stand in two places, to the letter but for indentation."""
    places = defaultdict(set)
    for name, source in sources.items():
        text = source.splitlines()
        numbered = [(n, text[n - 1].strip()) for n in sorted(code_lines(source))]
        telling = [
            (n, line)
            for n, line in numbered
            if len(line) > 24 and not re.match(r"(from|import) |\"?\w+\"?,$", line)
        ]
        for i in range(len(telling) - lines + 1):
            run = telling[i : i + lines]
            places[tuple(line for _, line in run)].add((name, run[0][0]))
    return sorted({tuple(sorted(where)) for where in places.values() if len(where) > 1})


def module(path):
    parts = path.relative_to(PACKAGE.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


@functools.cache
def sources():
    return {module(path): path.read_text() for path in FILES}


def over(measure, limit):
    """What each file shows of a measure that takes its source and a limit."""
    return {name: worst for name, text in sources().items() if (worst := measure(text, limit))}


def test_an_assignment_has_one_thought():
    assert {name: rows for name, text in sources().items() if (rows := wide_tuples(text))} == {}


def test_no_line_is_wider_than_a_page():
    wide = [
        f"{path.relative_to(ROOT)}:{n}"
        for path in [*FILES, *PACKAGE.rglob("*.js")]
        for n, line in enumerate(path.read_text().splitlines(), 1)
        if len(line) > WIDTH
    ]
    assert wide == []


def test_functions_are_short():
    assert over(long_functions, 66) == {}


def test_public_functions_take_few_parameters():
    many = {}
    for functions in over(many_parameters, MOST_PARAMETERS).values():
        many |= functions
    assert many == {}


def test_a_class_name_means_one_thing():
    """But for the settings of simulated studies, beside the loop that simulates one run."""
    twice = {name for name, at in classes(sources()).items() if len(at) > 1}
    assert twice == {"Simulation"}


def test_no_folder_shows_more_than_16_files():
    assert {f: n for f, n in Counter(path.parent for path in FILES).items() if n > 16} == {}


def test_no_numbered_slots():
    assert {name: match for name, source in sources().items() if (match := slots(source))} == {}


def test_no_eight_lines_stand_twice():
    assert repeats(sources()) == []


def test_the_checks_see_what_they_should():
    lines = "\n".join(f"    variable_of_some_length = f({i})" for i in range(9))
    source = f"def f(x):\n    '''Do it.'''\n{lines}\n"
    assert long_functions(source, 9) == {"f": 10}
    assert long_functions("@numba.njit\n" + source, 9) == {}
    assert slots("a = c[7] + row[k, 39] + c[k]\n# c[3]\n") == ["c[7]", "row[k, 39]"]
    assert repeats({"a": source, "b": source}) != []
    assert repeats({"a": source}) == []
    assert many_parameters("def f(a, b, *, c): pass\ndef _g(a, b, c): pass", 2) == {"f": 3}
    assert many_parameters("class A:\n    def __init__(self, a, b): pass", 1) == {"__init__": 2}
    assert classes({"a": "class A: pass", "b": "class A: pass"}) == {"A": ["a", "b"]}
    assert wide_tuples("a, b, c = 1, 2, 3\na, b = 1, 2\na, b, c = f()\n") == [1]
    assert code_lines("'''Prose.'''\n\n# A comment.\nx = (\n    1\n)\n") == {4, 5, 6}


def test_a_group_of_tests_stays_in_one_worker(request):
    """pytest-xdist tells a group by a test's name; some versions of pytest undo that unseen."""
    if not hasattr(request.config, "workerinput"):
        pytest.skip("tests run in one process")
    assert request.node.nodeid.endswith("@layout")
