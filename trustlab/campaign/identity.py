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
from functools import cache, partial
from importlib import metadata
from pathlib import Path
from types import CodeType
from typing import Any

from cloudpickle import Pickler

from trustlab import __version__
from trustlab.models.digest import digest

# Attributes of a class that say nothing of what it does.
BOILERPLATE = {"__dict__", "__weakref__", "__firstlineno__", "_abc_impl"}
# Functions in a cache.
CACHED = type(cache(len))
# Files below these are of packages whose versions tell changes.
INSTALLED = {"site-packages", "dist-packages"}


class _Pickler(Pickler):
    """Pickles a value to the same bytes in every process; sets are ordered by `order`."""

    order: Callable

    def persistent_id(self, value: Any) -> object:
        """Replace sets, whose order differs between processes, and equal texts by one."""
        if type(value) in (set, frozenset):
            return type(value), sorted(value, key=self.order)
        return sys.intern(value) if type(value) is str else None

    def reducer_override(self, value: Any) -> Any:
        """Leave out where code stands, and count by content what is pickled by name."""
        if isinstance(value, CodeType):
            code = value.replace(co_filename="", co_firstlineno=1, co_linetable=b"")
            return self.dispatch_table[CodeType](code)
        if hasattr(value, "_reduce_states"):  # compiled by numba, which gives it a random name
            return str, (), value._reduce_states() | {"uuid": None}
        if isinstance(value, type | CACHED) and value.__module__ == "__main__":
            body = {name: x for name, x in vars(value).items() if name not in BOILERPLATE}
            parts = type(value), getattr(value, "__bases__", ()), body
            return str, (value.__qualname__,), None if self.order is repr else parts
        return super().reducer_override(value)


def _content(value: object, order: Callable) -> bytes:
    stream = io.BytesIO()
    pickler = _Pickler(stream)
    pickler.order = order
    pickler.dump(value)
    return stream.getvalue()


def value_digest(name: str, value: object) -> str:
    """Return a digest of a value, the same in every process; `name` is for the error."""
    try:
        # Elements of a set are ordered by content, but for what their classes do and sets in them.
        return digest(_content(value, partial(_content, order=repr)))
    except Exception as error:  # pickling runs the value's own code, which may raise anything
        raise ValueError(
            f"{name} cannot be sent to another process or compared with that of an earlier "
            f"campaign ({type(error).__name__}: {error}); create it inside the task"
        ) from error


def identity(task: Callable) -> dict[str, str]:
    """Return what a task's results depend on, by name: versions and digests."""
    parts = {"version of trustlab": __version__, "version of Python": sys.version.split()[0]}
    parts |= {f"version of {name}": metadata.version(name) for name in ("numpy", "scipy", "numba")}
    parts["the task or a value it uses or fills"] = value_digest("the task", task)
    return parts | sources(task)


def sources(task: Callable) -> dict[str, str]:
    """Return a digest of each source file that a task may use, by its path."""
    home = str(getattr(task, "func", task).__module__).partition(".")[0]
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
    return [file for file in files if file.is_file()]  # an editor's lock leads nowhere


def _paths(name: str) -> list[Path]:
    """Return the folders of a package, or the file of a module."""
    module = sys.modules.get(name)
    file = getattr(module, "__file__", None)
    return [Path(path) for path in getattr(module, "__path__", [file] if file else [])]
