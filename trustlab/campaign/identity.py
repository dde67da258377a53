"""
What the results of a campaign depend on: the task, source files, and versions.

Functions and classes of a notebook, or of the script that runs, count by their code, with all
values that they use. Others count by name, with all files of all packages that are loaded, all
modules outside packages, and those beside the task's own file, loaded or not: nobody can say for
certain which of them a task uses.
"""

import io
import os
import sys
from collections.abc import Callable
from importlib import metadata
from pathlib import Path
from types import CodeType
from typing import Any

from cloudpickle import Pickler

from trustlab import __version__
from trustlab.models.digest import digest

# Attributes of a class that say nothing of what it does.
BOILERPLATE = {"__dict__", "__weakref__", "__firstlineno__", "_abc_impl"}
# Files below these are of packages whose versions tell changes.
INSTALLED = {"site-packages", "dist-packages"}


class _Pickler(Pickler):
    """Pickles equal values to equal bytes in every process."""

    def persistent_id(self, value: Any) -> object:
        """Replace sets: their order differs between processes."""
        return sorted(map(repr, value)) if isinstance(value, set | frozenset) else None

    def reducer_override(self, value: Any) -> Any:
        """Leave out where code stands, and what names a class or a compiled function uniquely."""
        if isinstance(value, CodeType):
            return tuple, ((value.co_code, value.co_consts, value.co_names),)
        if hasattr(value, "py_func"):  # compiled by numba
            return str, (), value.py_func
        if isinstance(value, type) and value.__module__ == "__main__":
            body = {name: x for name, x in vars(value).items() if name not in BOILERPLATE}
            return str, (value.__qualname__,), (value.__bases__, body)
        return super().reducer_override(value)


def value_digest(name: str, value: object) -> str:
    """Return a digest of a value, the same in every process; `name` is for the error."""
    stream = io.BytesIO()
    try:
        _Pickler(stream).dump(value)
    except Exception as error:  # pickling runs the value's own code, which may raise anything
        raise ValueError(
            f"{name} cannot be sent to another process or compared with that of an earlier "
            f"campaign ({type(error).__name__}: {error}); create it inside the task"
        ) from error
    return digest(stream.getvalue())


def identity(task: Callable) -> dict[str, str]:
    """Return what a task's results depend on, by name: versions and digests."""
    parts = {"version of trustlab": __version__, "version of Python": sys.version.split()[0]}
    parts |= {f"version of {name}": metadata.version(name) for name in ("numpy", "scipy", "numba")}
    return parts | {"the task or a value it uses": value_digest("the task", task)} | sources(task)


def sources(task: Callable) -> dict[str, str]:
    """Return a digest of each source file that a task may use, by its path."""
    home = getattr(task, "func", task).__module__.partition(".")[0]
    paths: list[Path] = []
    for name in {name.partition(".")[0] for name in list(sys.modules)} - sys.stdlib_module_names:
        found = _paths(name)
        paths += [path for path in found if name == home or not INSTALLED & {*path.parts}]
    own = _paths(home)
    if not own or own[0].is_file():  # a notebook, a script or a module, no package
        folder = own[0].parent if own else Path()
        paths += [*folder.glob("*.py"), *(path.parent for path in folder.glob("*/__init__.py"))]
    # Of the script or notebook itself, the task's content holds what it uses.
    script = [path.resolve() for path in _paths("__main__")]
    return {
        str(file.relative_to(path.parent)): digest(file.read_bytes())
        for path in paths
        for file in _files(path)
        if path.resolve() not in script
    }


def _files(path: Path) -> list[Path]:
    """Return a module's file, or those of a package, but of no environment within its folder."""
    files = [path] if path.is_file() else []
    for folder, folders, names in os.walk(path):
        folders[:] = set(folders) - INSTALLED
        files += [Path(folder, name) for name in names if name.endswith(".py")]
    return files


def _paths(name: str) -> list[Path]:
    """Return the folders of a package, or the file of a module."""
    module = sys.modules.get(name)
    file = getattr(module, "__file__", None)
    return [Path(path) for path in getattr(module, "__path__", [file] if file else [])]
