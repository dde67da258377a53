"""
What a report is made from, and digests of it: a report is run again only when one of them changed.
"""

from __future__ import annotations

import hashlib
import importlib.metadata
import json
import os
import platform
import re
import subprocess
from collections.abc import Iterable
from pathlib import Path
from typing import Any

Place = str | os.PathLike[str]
PACKAGE = Path(__file__).resolve().parents[1]
LISTED = (
    "trustlab",
    "numpy",
    "scipy",
    "pandas",
    "matplotlib",
    "numba",
    "statsmodels",
    "pingouin",
    "casadi",
    "emcee",
)
# Digits of a digest that a reader sees.
SHORT = 12


def external_data(root: Path) -> Path:
    """Return the folder of third-party data: ``TRUSTLAB_DATA``, else ``data/external``."""
    return (root / (os.environ.get("TRUSTLAB_DATA") or "data/external")).resolve()


def list_files(folder: Place) -> list[Path]:
    """Return every file below a folder in order of path, without caches and hidden files."""
    return sorted(
        path
        for path in Path(folder).rglob("*")
        if path.is_file()
        and not re.search(r"(^|/)(\.|__pycache__)|\.pyc$", path.relative_to(folder).as_posix())
    )


def file_digest(path: Place) -> str:
    """Return the SHA-256 of a file's content, or "absent"."""
    if not Path(path).is_file():
        return "absent"
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def digest(lines: Iterable[Any]) -> str:
    """Return the SHA-256 of plain values."""
    return hashlib.sha256(json.dumps(list(lines), default=repr).encode()).hexdigest()


def read_files(root: Path, notebook: Path) -> list[Path]:
    """
    Return what a notebook reads: the printed numbers, the folders of data that it names, and
    modules that it imports from beside it.
    """
    text = notebook.read_text(encoding="utf-8")
    # data/simulated, or "data" / "simulated", whose quotes have a backslash in a notebook's JSON
    named = {"published", *re.findall(r'\bdata\\?"?\s*/\s*\\?"?(\w+)', text)} - {"external"}
    modules = [
        path
        for path in notebook.parent.glob("*.py")
        if re.search(rf"\b(from|import) {path.stem}\b", text)
    ]
    return sorted(
        [*modules, *(path for name in named for path in list_files(root / "data" / name))]
    )


def shared_digest(root: Path) -> str:
    """
    Return the digest of what every report depends on: package, committed data, modules beside the
    notebooks, lock, Python and external data, of these names, sizes and times of change.
    """
    committed = [path for path in (root / "data").iterdir() if path.name != "external"]
    files = [path for folder in [PACKAGE, *committed] for path in list_files(folder)]
    files += [*sorted((root / "notebooks").glob("*.py")), root / "environment.lock"]
    contents = [(str(path), file_digest(path)) for path in files]
    status = [(str(path), path.stat()) for path in list_files(external_data(root))]
    external = [(name, about.st_size, about.st_mtime_ns) for name, about in status]
    return digest([platform.python_version(), platform.machine(), contents, external])


def commit(root: Path) -> str:
    """Return the commit of a repository, marked where files are changed."""

    def git(*words: str) -> str:
        command = ["git", "-C", str(root), *words]
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()

    try:
        if Path(git("rev-parse", "--show-toplevel")).resolve() != root.resolve():
            return "not a git checkout"
        changed = " + uncommitted changes" if git("status", "--porcelain") else ""
        return git("rev-parse", "HEAD") + changed
    except (OSError, subprocess.SubprocessError):
        return "not a git checkout"


def provenance(
    root: Path, notebook: Path, parameters: dict[str, Any], inputs: Iterable[Path]
) -> dict[str, str]:
    """
    Return where a report comes from, in words without paths, user or host names of this machine.

    Parameters
    ----------
    root : pathlib.Path
        The repository.
    notebook : pathlib.Path
        The notebook.
    parameters : dict
        Parameters with their values in this run, seeds among them.
    inputs : iterable of pathlib.Path
        The files that it reads; each is listed with its SHA-256.

    Returns
    -------
    dict of str
        Commit, notebook, lock, external data, platform, versions, parameters, files.
    """
    external = list_files(external_data(root))
    sizes = digest((path.name, path.stat().st_size) for path in external)[:SHORT]
    versions = [f"{name} {importlib.metadata.version(name)}" for name in LISTED]
    origin = {
        "Commit": commit(root),
        "Notebook": f"{notebook.name}, SHA-256 {file_digest(notebook)[:SHORT]}",
        "environment.lock": f"SHA-256 {file_digest(root / 'environment.lock')[:SHORT]}",
        "External data": f"{len(external)} files, names and sizes {sizes}" if external else "none",
        "Platform": f"{platform.system()} {platform.machine()}",
        "Versions": ", ".join([f"python {platform.python_version()}", *versions]),
    }
    origin |= {f"Parameter {name}": repr(value) for name, value in parameters.items()}
    files = {os.path.relpath(path, root): file_digest(path)[:SHORT] for path in inputs}
    return origin | {name: f"SHA-256 {value}" for name, value in files.items()}
