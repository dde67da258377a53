"""README, the documentation's sources and docstrings: complete, linked, and their code runs."""

import doctest
import importlib
import inspect
import re
import tomllib
from dataclasses import is_dataclass

import matplotlib as mpl
import pytest
from matplotlib import pyplot as plt
from numpydoc.docscrape import NumpyDocString

import trustlab as tl
from tests.house.documents import DOCUMENTS, ROOT, TARGETS, blocks, name_of, python, write_files
from trustlab.sessions import load_recipe

# --- pages ----------------------------------------------------------------------------------------


def is_there(path, place):
    """Say whether what a page links to is there, or will be once the book is written."""
    if place.startswith("api/"):
        return path.parent.name == "docs"
    # Executed notebooks become chapters beside the book's first page.
    chapter = path.name == "index.md" and (ROOT / "notebooks" / place).exists()
    return chapter or (path.parent / place).exists()


@pytest.mark.parametrize("path", [*DOCUMENTS, ROOT / "CONTRIBUTING.md"], ids=name_of)
def test_links_and_figures_are_there(path):
    targets = re.findall(r"\]\(([^)#:\s]+)(?:#[^)]*)?\)", path.read_text())
    assert [place for place in targets if not is_there(path, place)] == []
    named = re.findall(r"`((?:data|notebooks|reports|tests|trustlab)/[\w./]+)`", path.read_text())
    # what users fetch by hand, and what `make reports` and `make session` write
    made = ("data/external", "reports/index", "reports/my_session")
    missing = [place for place in named if not (ROOT / place).exists()]
    assert [place for place in missing if not place.startswith(made)] == []


SCRIPTS = [path for path in DOCUMENTS if python(path)]


# One worker runs them all, so that what they compile and read is there for all.
@pytest.mark.xdist_group("docs")
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("path", SCRIPTS, ids=name_of)
def test_code_runs(path, tmp_path, monkeypatch, capsys):
    write_files(path, tmp_path)
    if path.name != "README.md":  # its lines run anywhere
        (tmp_path / "data").symlink_to(ROOT / "data")
    monkeypatch.chdir(tmp_path)
    with mpl.rc_context({"backend": "Agg"}):
        exec(compile(python(path), name_of(path), "exec"), {"__name__": "__main__"})
        plt.close("all")
    assert capsys.readouterr().out.strip()


def words_of(path):
    """Words of a page with its blocks of code, without the markup of tables and signs."""
    return [word for word in path.read_text().split() if re.search(r"\w", word)]


def test_documentation_is_short():
    readme, *pages = DOCUMENTS
    assert len(readme.read_text().splitlines()) <= 70
    assert sum(len(words_of(path)) for path in pages) <= 10_000
    assert len(words_of(ROOT / "CONTRIBUTING.md")) <= 600


def test_names_of_the_state_on_the_page_are_its_own():
    page = (ROOT / "docs" / "how_to" / "own_parts.md").read_text()
    names = re.findall(r"`(\w+)`", " ".join(re.findall(r"^\| (`.*?) \|", page, re.M)))
    assert len(names) > 10
    state = tl.TeleoperationLoop().state
    logged = tl.simulate_teleoperation("M", duration=2.0).data
    names += [re.sub("_[xyz]$", "", name) for name in logged]
    assert [name for name in names if not hasattr(state, name)] == []


@pytest.mark.parametrize("path", DOCUMENTS, ids=name_of)
def test_blocks_that_tests_do_not_run_can_be_followed(path, tmp_path):
    for language, caption, runs, code in blocks(path):
        if language == "python" and not runs:
            compile(code, name_of(path), "exec")
            # a server, ROS, a cluster, readers of other formats
            assert path.name in {"live_study.md", "robot.md", "reproducible.md", "logs.md"}
        elif language == "toml" and "kind = " in code and "[columns]" in code:  # of logs
            (tmp_path / caption).write_text(code)
            load_recipe(tmp_path / caption)
        elif language == "sh":
            assert set(re.findall(r"^make (\S+)", code, re.M)) <= TARGETS


def test_every_equation_is_shown():
    printed = tomllib.loads((ROOT / "data" / "published" / "equations.toml").read_text())
    page = (ROOT / "docs" / "concepts" / "equations.md").read_text()
    shown = " ".join(re.findall(r"^```\{equation\} (.*)$", page, re.M))
    assert sorted(shown.split()) == sorted(printed)


def test_the_checks_see_what_they_should(tmp_path):
    page = tmp_path / "page.md"
    page.write_text(
        "```python\nx = 1\n```\n```{code-block} python\n:class: not-run\n\nx = 2\n```\n"
        "```{code-block} toml\n:caption: a.toml\n\ny = 3\n```\n"
    )
    assert list(blocks(page)) == [
        ("python", "", True, "x = 1\n"),
        ("python", "", False, "x = 2\n"),
        ("toml", "a.toml", True, "y = 3\n"),
    ]
    assert python(page) == "x = 1\n"


# --- docstrings -----------------------------------------------------------------------------------


NAMED = {name: getattr(tl, name) for name in tl.__all__}
ROOMS = list(filter(inspect.ismodule, NAMED.values()))
THINGS = [getattr(room, name) for room in ROOMS for name in room.__all__]


def documented(thing):
    """The names that the docstrings of a function, or of a class and those above it, explain."""
    docs = [
        NumpyDocString(inspect.getdoc(each) or "") for each in getattr(thing, "__mro__", [thing])
    ]
    entries = [entry for doc in docs for entry in [*doc["Parameters"], *doc["Attributes"]]]
    return {name.strip().lstrip("*") for entry in entries for name in entry.name.split(",")}


def undocumented(thing, name):
    """What of a function or class has no docstring, and arguments that its docstring leaves out."""
    if not inspect.getdoc(thing):
        return [name]
    made_by_users = is_dataclass(thing) or "__init__" in vars(thing)
    taken = inspect.isroutine(thing) or (
        made_by_users and not getattr(thing, "_is_protocol", False)
    )
    arguments = set(inspect.signature(thing).parameters) - {"self", "cls"} if taken else set()
    public = {argument for argument in arguments if not argument.startswith("_")}
    faults = [f"{name}({argument})" for argument in public - documented(thing)]
    for own, method in vars(thing).items() if inspect.isclass(thing) else ():
        method = getattr(method, "__func__", method)
        if inspect.isfunction(method) and not own.startswith("_"):
            faults += undocumented(method, f"{name}.{own}")
    return faults


def test_every_public_argument_is_documented():
    public = [thing for thing in THINGS if inspect.isroutine(thing) or inspect.isclass(thing)]
    assert [fault for thing in public for fault in undocumented(thing, thing.__name__)] == []


def test_the_check_sees_what_it_should():
    def scaled(x, factor):
        """
        Scale.

        Parameters
        ----------
        x : float
            A number.
        """

    assert undocumented(scaled, "scaled") == ["scaled(factor)"]


# --- examples -------------------------------------------------------------------------------------


PACKAGE = ROOT / "trustlab"
MODULES = [
    ".".join(path.relative_to(ROOT).with_suffix("").parts)
    for path in sorted(PACKAGE.rglob("*.py"))
    if ">>> " in path.read_text()
]


@pytest.mark.xdist_group("examples")
def test_a_group_of_tests_stays_in_one_worker(request):
    """pytest-xdist tells a group by a test's name; some versions of pytest undo that unseen."""
    if not hasattr(request.config, "workerinput"):
        pytest.skip("tests run in one process")
    assert request.node.nodeid.endswith("@examples")


# One worker compiles and reads what many examples need once.
@pytest.mark.xdist_group("examples")
@pytest.mark.parametrize("name", MODULES)
@pytest.mark.filterwarnings("ignore")
def test_examples(name, monkeypatch, tmp_path):
    (tmp_path / "data").symlink_to(ROOT / "data")  # some read it, and what they write is left here
    monkeypatch.chdir(tmp_path)
    module, flags = importlib.import_module(name), doctest.NORMALIZE_WHITESPACE
    done = doctest.testmod(module, globs={}, optionflags=flags)  # as who copies them begins
    assert done.attempted > 0
    assert done.failed == 0


def shown(name):
    """Say whether the docstring of a name has an example with it, which runs to its end."""
    examples = doctest.DocTestParser().get_examples(NAMED[name].__doc__)
    runs = examples and not examples[-1].options.get(doctest.SKIP)
    return runs and any(name in example.source for example in examples)


def test_every_public_name_has_an_example():
    assert [name for name in NAMED if NAMED[name] not in ROOMS and not shown(name)] == []
