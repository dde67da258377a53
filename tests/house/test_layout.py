"""
The house stays small and readable: lines of code, files in a folder, length of functions, slots,
circles, repeats.
"""

import ast
import functools
import io
import re
import tokenize
from collections import Counter, defaultdict
from pathlib import Path

import networkx as nx
import pytest

PACKAGE = Path(__file__).parents[2] / "trustlab"
FILES = sorted(PACKAGE.rglob("*.py"))
MOST_LINES = 24_500
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
        if (
            isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef)
            and node.body
        ):
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
    return any(
        re.search("njit|vectorize", ast.unparse(decorator)) for decorator in node.decorator_list
    )


def long_functions(source, most):
    """Functions outside kernels with more than `most` lines of code."""
    lines = code_lines(source)
    length = {
        node.name: sum(node.lineno <= line <= node.end_lineno for line in lines)
        for node in functions(ast.parse(source))
        if not compiled(node)
    }
    return {name: n for name, n in length.items() if n > most}


def slots(source):
    """Numbered slots, as in c[7] or row[39]: every place where a reader has to count."""
    lines = source.splitlines()
    return [found for line in sorted(code_lines(source)) for found in SLOT.findall(lines[line - 1])]


def imports(source):
    """
    Modules of trustlab that are imported anywhere in a file but for type checking, functions
    included.
    """
    tree = ast.parse(source)
    only_types = {
        inner
        for node in ast.walk(tree)
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"
        for inner in ast.walk(node)
    }
    for node in ast.walk(tree):
        if node in only_types:
            continue
        if isinstance(node, ast.ImportFrom) and node.module.startswith("trustlab"):
            yield node.module
            yield from (f"{node.module}.{alias.name}" for alias in node.names)
        elif isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name.startswith("trustlab"))


def circles(sources):
    """Groups of modules that import each other, directly or by way of others."""
    graph = nx.DiGraph()
    for name, source in sources.items():
        graph.add_edges_from(
            (name, other) for other in imports(source) if other in sources and other != name
        )
    return [sorted(group) for group in nx.strongly_connected_components(graph) if len(group) > 1]


def repeats(sources, lines=6):
    """Runs of `lines` lines of code that stand in two places, to the letter but for indentation."""
    places = defaultdict(set)
    for name, source in sources.items():
        text = source.splitlines()
        numbered = [(n, text[n - 1].strip()) for n in sorted(code_lines(source))]
        telling = [
            (n, line)
            for n, line in numbered
            if re.search(r"\w", line) and not re.match(r"(from|import) |\"?\w+\"?,$", line)
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


def test_lines_of_code():
    rooms = {
        name: source for name, source in sources().items() if not name.startswith("trustlab.live")
    }
    assert sum(len(code_lines(source)) for source in rooms.values()) <= MOST_LINES


def test_a_file_holds_one_idea():
    assert {
        name: n for name, source in sources().items() if (n := len(code_lines(source))) > 400
    } == {}
    assert {
        name: found for name, source in sources().items() if (found := long_functions(source, 60))
    } == {}


def test_no_folder_shows_more_than_16_files():
    assert {
        folder: n for folder, n in Counter(path.parent for path in FILES).items() if n > 16
    } == {}


def test_no_numbered_slots():
    assert {name: found for name, source in sources().items() if (found := slots(source))} == {}


def test_no_circle_of_imports():
    assert circles(sources()) == []


def test_no_six_lines_stand_twice():
    assert repeats(sources()) == []


def test_the_checks_see_what_they_should():
    lines = "\n".join(f"    x = f({i})" for i in range(7))
    source = f"def f(x):\n    '''Do it.'''\n{lines}\n"
    assert long_functions(source, 7) == {"f": 8}
    assert long_functions("@numba.njit\n" + source, 7) == {}
    assert slots("a = c[7] + row[k, 39] + c[k]\n# c[3]\n") == ["c[7]", "row[k, 39]"]
    assert circles(
        {"trustlab.a": "import trustlab.b", "trustlab.b": "from trustlab.a import f"}
    ) == [["trustlab.a", "trustlab.b"]]
    assert circles({"trustlab.a": "import trustlab.b", "trustlab.b": ""}) == []
    assert repeats({"a": source, "b": source}) != []
    assert repeats({"a": source}) == []
