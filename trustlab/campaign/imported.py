"""Sources that a module imports, however far, and their digest."""

import functools
import re
from collections.abc import Iterable
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

from trustlab.models.digest import PACKAGE, digest

# An import statement on one line, or up to the closing bracket: "from a.b import c, d", "import a".
IMPORT = re.compile(
    r"^[ \t]*(?:from[ \t]+(\.*[\w.]*)[ \t]+import[ \t]+(?:\(([^)]*)\)|([^\n#;]*))"
    r"|import[ \t]+([\w., \t]+))",
    re.M,
)


def source_digest(*files: str | Path, root: Path = PACKAGE) -> str:
    """Return a digest of files of the package at `root` and of all that they import from it."""
    modules = sorted(imported_files(map(Path, files), root))
    names = [path.relative_to(root).as_posix() for path in modules]
    return digest(*names, *map(_source, modules))


def imported_files(files: Iterable[Path], root: Path) -> set[Path]:
    """Return files of the package at `root`, with all that they import from it, however far."""
    closure: set[Path] = set()
    waiting = list(files)
    while waiting:
        path = waiting.pop()
        if path not in closure:
            closure.add(path)
            waiting += _imports(path, root)
    return closure


@functools.cache
def _source(path: Path) -> bytes:
    return path.read_bytes()


@functools.cache
def _imports(path: Path, root: Path) -> list[Path]:
    """Return the files of a package that the import statements of one of its files name."""
    folder = path.relative_to(root).parent.parts
    modules: list[tuple[str, ...] | None] = []
    for origin, bracketed, listed, plain in IMPORT.findall(_source(path).decode()):
        if plain:
            modules += [_place(name.split()[0], (), root.name) for name in plain.split(",")]
            continue
        place = _place(origin, folder, root.name)
        # What is imported from a package may be a module of it.
        if place is not None:
            names = re.findall(r"\w+", bracketed or listed)
            modules += [place, *((*place, name) for name in names)]
    candidates = []
    for place in modules:
        if place is None:
            continue
        candidates.append(root.joinpath(*place).with_suffix(".py"))
        # A module's packages are imported before it.
        folders = [root.joinpath(*place[:depth]) for depth in range(len(place) + 1)]
        candidates += [folder / "__init__.py" for folder in folders]
    return [file for file in candidates if file.is_file()]


def _place(module: str, folder: tuple[str, ...], package: str) -> tuple[str, ...] | None:
    """Return the path of a module below its package; None if it is of another package."""
    name = module.lstrip(".")
    level = len(module) - len(name)
    parts = tuple(name.split(".")) if name else ()
    if level:
        return (*folder[: len(folder) + 1 - level], *parts)
    return parts[1:] if parts[0] == package else None


def forget_sources() -> None:
    """Read files again the next time: they may have been edited."""
    _source.cache_clear()
    _imports.cache_clear()


class PackageModule(NamedTuple):
    """The file of a module, and the folder of the package at the top that it belongs to."""

    file: Path
    root: Path


def package_of(module: str) -> PackageModule | None:
    """Return where a module stands; None if it has no file, as the cells of a notebook."""
    try:
        spec = find_spec(module)
        file = Path(spec.origin)
    except (ImportError, AttributeError, TypeError, ValueError):
        return None
    if not file.is_file():
        return None
    depth = module.count(".") + (file.name == "__init__.py")
    return PackageModule(file, file.parents[depth - 1] if depth else file.parent)
