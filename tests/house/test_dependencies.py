"""What is imported is declared in pyproject.toml, and what is declared is imported."""

import ast
import functools
import re
import sys
import tomllib
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
EXTRAS = PROJECT["project"]["optional-dependencies"]
# Declared although no file imports them: JupyterLab is started by `make lab`, ipykernel by
# papermill; docs/conf.py names extensions and a theme; a Dask client is the user's own.
NOT_IMPORTED = {"jupyter", "ipykernel", "dask", "distributed"}
NOT_IMPORTED |= {"myst-nb", "numpydoc", "pydata-sphinx-theme"}


def names(requirements):
    return {re.match(r"[\w.-]+", line)[0].lower().replace("_", "-") for line in requirements}


CORE = names(PROJECT["project"]["dependencies"])
OPTIONAL = set().union(*(names(lines) for extra, lines in EXTRAS.items() if extra != "all"))
DEV = names(PROJECT["dependency-groups"]["dev"])


ROS = names(PROJECT["dependency-groups"]["robot"])


def sources_of(folder):
    return [p for p in (ROOT / folder).rglob("*.py") if ".venv" not in p.parts]


def imports(source):
    """Top-level modules that a file imports: (name, whether it must be there)."""
    tree = ast.parse(source)
    guarded = {
        inner
        for node in ast.walk(tree)
        if (isinstance(node, ast.With) and ast.unparse(node.items[0]).startswith("extra("))
        or (isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING")
        or (
            isinstance(node, ast.Try)
            and any("Import" in ast.unparse(h.type or node) for h in node.handlers)
        )
        for inner in ast.walk(node)
    }
    for node in ast.walk(tree):
        modules = []
        if isinstance(node, ast.Import):
            modules = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            modules = [node.module]
        for module in modules:
            top = module.partition(".")[0]
            own = ("trustlab", "tests", "benchmarks", "notebooks")
            if top not in sys.stdlib_module_names and top not in own:
                yield top, node not in guarded


@functools.cache
def distributions(folder):
    """
    Distributions that the files of a folder import: all, and those imported without `extra` or
    another guard.
    """
    known = packages_distributions()
    anywhere, needed = set(), set()
    for path in sources_of(folder):
        found: dict[bool, set] = {True: set(), False: set()}
        for module, must in imports(path.read_text()):
            found[must] |= {name.lower().replace("_", "-") for name in known.get(module, [module])}
        anywhere |= found[True] | found[False]
        needed |= found[True] - found[False]  # one guard in a file is enough
    return anywhere, needed


def test_what_trustlab_imports_is_declared():
    anywhere, needed = distributions("trustlab")
    assert anywhere - CORE - OPTIONAL == {"rclpy"}  # which a lab's own ROS 2 has
    assert needed - CORE == {"rclpy"}


def test_what_is_declared_is_imported():
    imported = distributions("trustlab")[0] | distributions("docs")[0]
    assert (CORE | OPTIONAL) - imported == NOT_IMPORTED


@pytest.mark.parametrize("folder", ["tests", "data"])
def test_what_tests_import_is_declared(folder):
    beside = {path.stem for path in sources_of(folder)}
    assert (
        distributions(folder)[1] - CORE - OPTIONAL - DEV - ROS - beside - {"no-such-package"}
        == set()
    )
