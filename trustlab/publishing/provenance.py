"""
What a report is made from, and digests of it: a report is built again only when one of them
changed.
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
from dataclasses import dataclass
from pathlib import Path
from typing import Any

Place = str | os.PathLike[str]
SKIPPED = ("__pycache__", ".ipynb_checkpoints")


@dataclass(frozen=True)
class Checkout:
    """The folders one `make reports` reads and writes.

    Parameters
    ----------
    root : pathlib.Path
        The repository.
    notebooks : pathlib.Path
        Folder of the notebooks; also the working directory they run in.
    reports : pathlib.Path
        Folder the reports are written to.
    package : pathlib.Path
        The package ``trustlab``.
    data : pathlib.Path
        Committed data; ``external`` in it is not part of it.
    lock : pathlib.Path
        The locked environment.
    external : pathlib.Path
        Third-party data: what ``TRUSTLAB_DATA`` names, else ``data/external``. It may be absent.
    """

    root: Path
    notebooks: Path
    reports: Path
    package: Path
    data: Path
    lock: Path
    external: Path

    @classmethod
    def find(
        cls, root: Place | None = None, notebooks: Place | None = None, reports: Place | None = None
    ) -> Checkout:
        """Return the checkout around a folder.

        Parameters
        ----------
        root : path-like, optional
            The repository; by default the parent of ``notebooks``, else the working directory, else
            the one the package lies in: the first that has a folder ``notebooks``.
        notebooks : path-like, optional
            Folder of the notebooks, by default ``notebooks`` in the repository.
        reports : path-like, optional
            Folder of the reports, by default ``reports`` in the repository.

        Returns
        -------
        Checkout
            Absolute folders.

        Raises
        ------
        ValueError
            If there is no such folder of notebooks.
        """
        own = Path(__file__).resolve().parents[1]
        if root is None:
            places = (
                [Path.cwd(), own.parent]
                if notebooks is None
                else [Path(notebooks).resolve().parent]
            )
            root = next((place for place in places if (place / "notebooks").is_dir()), places[0])
        root = Path(root).resolve()
        notebooks = Path(notebooks).resolve() if notebooks is not None else root / "notebooks"
        if not notebooks.is_dir():
            raise ValueError(
                f"no folder of notebooks at {notebooks}: run in the repository, or give --notebooks"
            )
        package = root / "trustlab"
        data = root / "data"
        external = os.environ.get("TRUSTLAB_DATA") or data / "external"
        return cls(
            root=root,
            notebooks=notebooks,
            reports=Path(reports).resolve() if reports is not None else root / "reports",
            package=package if package.is_dir() else own,
            data=data,
            lock=root / "environment.lock",
            external=(root / external).resolve(),
        )


def list_files(folder: Place, without: Iterable[Place] = ()) -> list[Path]:
    """
    Return every file below a folder in order of path; caches, hidden files and the folders
    `without` are left out.

    Links are followed, but not into a folder that the link lies in.
    """
    without, listed = {Path(place) for place in without}, []
    root = Path(folder).resolve()
    above = {
        Path(folder): {root, *root.parents}
    }  # folder → itself and what it lies in, links resolved
    for place, folders, files in os.walk(folder, followlinks=True):
        here = Path(place)
        visible = [
            here / name for name in folders if name not in SKIPPED and not name.startswith(".")
        ]
        real = {path: path.resolve() for path in visible if path not in without}
        above |= {path: above[here] | {to} for path, to in real.items() if to not in above[here]}
        folders[:] = [path.name for path in real if path in above]
        listed += [
            here / name
            for name in files
            if not name.startswith(".") and not name.endswith((".pyc", "~"))
        ]
    return sorted(
        path for path in listed if path.is_file()
    )  # a pipe would never end, a broken link has no content


def file_digest(path: Place) -> str:
    """Return the SHA-256 of a file's content, or "absent"."""
    try:
        with open(path, "rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except FileNotFoundError:
        return "absent"


def folder_digest(folder: Place, times: bool = False) -> str:
    """
    Return a digest of names and sizes of a folder's files, and of their times of last change; or
    "absent".
    """
    if not Path(folder).is_dir():
        return "absent"
    digest = hashlib.sha256()
    for path in list_files(folder):
        status = path.stat()
        line = [
            path.relative_to(folder).as_posix(),
            status.st_size,
            status.st_mtime_ns if times else 0,
        ]
        digest.update(json.dumps(line).encode())
    return digest.hexdigest()


def read_files(checkout: Checkout, notebook: Place) -> list[Path]:
    """
    Return what a notebook reads: the printed numbers, the folders of data that it names, and
    modules that it imports from beside it.
    """
    text = Path(notebook).read_text(encoding="utf-8")
    # data/simulated, or "data" / "simulated", whose quotes have a backslash in a notebook's JSON
    named = {"published", *re.findall(r'\bdata\\?"?\s*/\s*\\?"?(\w+)', text)} - {"external"}
    modules = [
        path
        for path in checkout.notebooks.glob("*.py")
        if re.search(rf"\b(from|import) {path.stem}\b", text)
    ]
    return sorted(
        [*modules, *(path for name in named for path in list_files(checkout.data / name))]
    )


def shared_digest(checkout: Checkout) -> str:
    """
    Return the digest of what every report depends on: package, committed data, lock, Python,
    external data.

    With them go the modules beside the notebooks, and the finder, which reports link by.
    """
    digest = hashlib.sha256(f"{platform.python_version()} {platform.machine()}".encode())
    without = [checkout.data / "external", checkout.external]
    files = [
        path for folder in (checkout.package, checkout.data) for path in list_files(folder, without)
    ]
    files += [*sorted(checkout.notebooks.glob("*.py")), checkout.notebooks / "finder.csv"]
    for path in files:
        digest.update(f"{os.path.relpath(path, checkout.root)} {file_digest(path)}\n".encode())
    digest.update(f"lock {file_digest(checkout.lock)}\n".encode())
    digest.update(f"external {folder_digest(checkout.external, times=True)}\n".encode())
    return digest.hexdigest()


def input_digest(
    checkout: Checkout, notebook: Place, parameters: dict | None = None, shared: str | None = None
) -> str:
    """
    Return the digest of all that one report depends on; `shared` is the `shared_digest` where it is
    at hand.
    """
    shared = shared_digest(checkout) if shared is None else shared
    line = [shared, file_digest(notebook), sorted((parameters or {}).items())]
    return hashlib.sha256(json.dumps(line, default=repr).encode()).hexdigest()


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
)
# Digits of a digest that a reader sees.
SHORT = 12


def commit(root: str | Path) -> str:
    """
    Return the commit a repository is at, marked where files are changed, or that it is no git
    checkout.
    """

    def git(*words: str) -> str:
        command = ["git", "-C", str(root), *words]
        return subprocess.run(
            command, capture_output=True, text=True, check=True, timeout=60
        ).stdout.strip()

    try:
        if Path(git("rev-parse", "--show-toplevel")).resolve() != Path(root).resolve():
            return "not a git checkout"
        found = git("rev-parse", "HEAD")
        return found + (" + uncommitted changes" if git("status", "--porcelain") else "")
    except (OSError, subprocess.SubprocessError):
        return "not a git checkout"


def versions() -> dict[str, str]:
    """Return the versions of Python and of the packages that results depend on, by name."""
    return {"python": platform.python_version()} | {
        name: importlib.metadata.version(name) for name in LISTED
    }


def provenance(
    checkout: Checkout,
    notebook: str | Path,
    parameters: dict[str, Any] | None = None,
    started: str = "",
    seconds: float = float("nan"),
) -> dict[str, Any]:
    """
    Return where a report comes from, as plain values without paths, user or host names of this
    machine.

    Parameters
    ----------
    checkout : Checkout
        The folders.
    notebook : path-like
        The notebook.
    parameters : dict, optional
        Parameters used, with their values in this run. Those named ``…seed…`` are the seeds.
    started : str
        Start of the run, UTC, ISO 8601.
    seconds : float
        Time taken, s.

    Returns
    -------
    dict
        ``notebook notebook_sha256 commit environment_lock inputs external_data parameters seeds
        versions platform started seconds``; ``inputs`` maps every file that `read_files` finds to
        its SHA-256.
    """
    parameters = dict(parameters or {})
    external = folder_digest(checkout.external)
    if external != "absent":
        count = len(list_files(checkout.external))
        external = f"{count} files, digest of names and sizes {external[:SHORT]}"
    return {
        "notebook": Path(notebook).name,
        "notebook_sha256": file_digest(notebook),
        "commit": commit(checkout.root),
        "environment_lock": file_digest(checkout.lock)[:SHORT],
        "inputs": {
            os.path.relpath(path, checkout.root): file_digest(path)
            for path in read_files(checkout, notebook)
        },
        "external_data": external,
        "parameters": parameters,
        "seeds": {name: value for name, value in parameters.items() if "seed" in name.lower()},
        "versions": versions(),
        "platform": f"{platform.system()} {platform.machine()}",
        "started": started,
        "seconds": seconds,
    }


def duration(seconds: float) -> str:
    """Return a time taken as people write it: "0.8 s", "12.3 s", "3 min 07 s"."""
    if round(seconds, 1) < 60:
        return f"{seconds:.1f} s"
    return f"{round(seconds) // 60} min {round(seconds) % 60:02d} s"
