"""
What the results of a campaign depend on: the task, the sources that it may use, and versions.

A task counts as what would be sent to another process: functions and classes of a notebook or a
script by their code, with all values that they use; others by name. To a name belongs its whole
package, or all modules beside its script, since nobody can say for certain which a task uses.
"""

import dis
import functools
import io
import re
import sys
import sysconfig
from collections import ChainMap
from collections.abc import Callable, Iterator
from importlib import metadata
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
from typing import Any

from cloudpickle import Pickler

from trustlab import __version__
from trustlab.models.digest import digest

# Attributes of a class that say nothing of what it does.
BOILERPLATE = {"__dict__", "__weakref__", "__module__", "__firstlineno__", "_abc_impl"}
IMPORT = re.compile(r"^\s*(?:from|import)\s.*", re.MULTILINE)
INSTALLED = {"site-packages", "dist-packages"}


class Identity:
    """What a task and its values depend on."""

    def __init__(self, task: Callable):
        self.modules: set[str] = set()  # of functions and classes that are known by name
        self.imports: set[str] = set()  # what code imports when it runs
        self.task = self.digest("the task", task)
        while isinstance(task, functools.partial):
            task = task.func
        self.home = task.__module__
        self.modules.add(self.home)

    def digest(self, name: str, value: object) -> str:
        """Return a digest of a value, the same in every process; `name` is for the error."""
        stream = io.BytesIO()
        try:
            _Digester(stream, self).dump(value)
        except Exception as error:  # pickling runs the value's own code, which may raise anything
            raise ValueError(
                f"{name} can neither be sent to another process nor be compared with that of an "
                f"earlier campaign ({type(error).__name__}: {error}); create it inside the task"
            ) from error
        return digest(stream.getvalue())

    def parts(self) -> dict[str, str]:
        """Return digests and versions by name."""
        packages = {f"version of {p}": metadata.version(p) for p in ("numpy", "scipy", "numba")}
        versions = {"version of trustlab": __version__, "version of Python": sys.version.split()[0]}
        return versions | packages | {"the task or a value it uses": self.task} | self.sources()

    def sources(self) -> dict[str, str]:
        """Return a digest of each source file that belongs to the modules."""
        files: set[tuple[str, Path]] = set()
        for name in self.modules:
            module = sys.modules.get(name)
            file = getattr(module, "__file__", None) or ("notebook" if name == "__main__" else "")
            top = (getattr(module, "__package__", None) or "").partition(".")[0]
            package = getattr(sys.modules.get(top), "__path__", None)
            for folder in map(Path, package or [Path(file).resolve().parent]):
                if file and (name == self.home or not _is_installed(folder)):
                    found = _below(folder) if package else self._beside(folder)
                    above = folder.parent if package else folder
                    files |= {(path.relative_to(above).as_posix(), path) for path in found}
        digests: dict[str, str] = {}
        for name, path in sorted(files):  # modules of several folders may share a name
            digests[name] = digests.get(name, "") + digest(path.read_bytes())
        return digests

    def _beside(self, folder: Path) -> Iterator[Path]:
        """Yield the sources in a folder that are loaded or may be imported, however far."""
        loaded = (getattr(module, "__file__", None) for module in list(sys.modules.values()))
        below = [Path(f).relative_to(folder) for f in loaded if f and folder in Path(f).parents]
        names = self.imports | {path.parts[0].removesuffix(".py") for path in below}
        done: set[str] = set()
        while names - done:
            name = min(names - done)
            done.add(name)
            for file in [folder / f"{name}.py", *_below(folder / name)]:
                if file.is_file():
                    yield file
                    for line in IMPORT.findall(file.read_text(encoding="utf-8", errors="replace")):
                        names |= set(re.findall(r"\w+", line))


class _Digester(Pickler):
    """Pickles code by its content, and equal values of whatever process to equal bytes."""

    def __init__(self, stream: io.BytesIO, identity: Identity):
        # Read once, by the constructor.
        self.dispatch_table = ChainMap({CodeType: self._code}, Pickler.dispatch_table)
        super().__init__(stream)
        self.identity = identity
        self.classes: list[type] = []

    def persistent_id(self, value: Any) -> object:
        """Note modules; return a replacement for what differs between processes."""
        if isinstance(value, ModuleType):
            self.identity.modules.add(value.__name__)
        elif isinstance(value, FunctionType | type):
            self.identity.modules.add(value.__module__)
        if isinstance(value, set | frozenset):
            return sorted(self.identity.digest("a set", item) for item in value)
        if isinstance(getattr(value, "py_func", None), FunctionType):  # compiled by numba
            return "compiled", value.py_func
        if isinstance(value, type) and value.__module__ == "__main__":
            if value in self.classes:
                return "class", value.__qualname__
            self.classes.append(value)
            body = {name: x for name, x in vars(value).items() if name not in BOILERPLATE}
            return "class", value.__qualname__, value.__bases__, body
        return None

    def _code(self, code: CodeType) -> tuple:
        """Return how code is pickled: without the file and the lines where it stands."""
        for instruction in dis.get_instructions(code):
            if instruction.opname == "IMPORT_NAME":
                self.identity.imports.add(instruction.argval.partition(".")[0])
        names = (code.co_names, code.co_varnames, code.co_freevars)
        return tuple, ((code.co_code, code.co_consts, names),)


def _below(folder: Path) -> Iterator[Path]:
    return (f for f in folder.rglob("*.py") if not INSTALLED & {*f.relative_to(folder).parts})


def _is_installed(folder: Path) -> bool:
    """Return whether a folder came with a package or with Python, whose versions tell changes."""
    stdlib = Path(sysconfig.get_path("stdlib")).resolve()
    return bool(INSTALLED & {*folder.parts}) or folder.resolve().is_relative_to(stdlib)
