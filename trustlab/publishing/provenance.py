"""Where a report comes from: commit, locked environment, inputs, parameters, seeds, versions, time taken."""

import importlib.metadata
import platform
import subprocess
from pathlib import Path
from typing import Any

from trustlab.publishing.inputs import Checkout, file_digest, folder_digest, list_files

LISTED = ("trustlab", "numpy", "scipy", "pandas", "matplotlib", "numba", "statsmodels", "pingouin", "casadi")
# Digits of a digest that a reader sees.
SHORT = 12


def commit(root: str | Path) -> str:
    """Return the commit a repository is at, marked where files are changed, or that it is no git checkout."""

    def git(*words: str) -> str:
        command = ["git", "-C", str(root), *words]
        return subprocess.run(command, capture_output=True, text=True, check=True, timeout=60).stdout.strip()

    try:
        if Path(git("rev-parse", "--show-toplevel")).resolve() != Path(root).resolve():
            return "not a git checkout"
        found = git("rev-parse", "HEAD")
        return found + (" + uncommitted changes" if git("status", "--porcelain") else "")
    except (OSError, subprocess.SubprocessError):
        return "not a git checkout"


def versions() -> dict[str, str]:
    """Return the versions of Python and of the packages that results depend on, by name."""
    return {"python": platform.python_version()} | {name: importlib.metadata.version(name) for name in LISTED}


def provenance(
    checkout: Checkout,
    notebook: str | Path,
    parameters: dict[str, Any] | None = None,
    started: str = "",
    seconds: float = float("nan"),
) -> dict[str, Any]:
    """Return where a report comes from, as plain values without paths, user or host names of this machine.

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
        ``notebook notebook_sha256 commit environment_lock inputs external_data parameters seeds versions platform started
        seconds``; ``inputs`` maps every file of ``data/published`` and ``data/sessions`` to its SHA-256.
    """
    parameters = dict(parameters or {})
    folders = [checkout.data / "published", checkout.data / "sessions"]
    files = [path for folder in folders for path in list_files(folder)]
    external = folder_digest(checkout.external)
    if external != "absent":
        count = len(list_files(checkout.external))
        external = f"{count} files, digest of names and sizes {external[:SHORT]}"
    return {
        "notebook": Path(notebook).name,
        "notebook_sha256": file_digest(notebook),
        "commit": commit(checkout.root),
        "environment_lock": file_digest(checkout.lock)[:SHORT],
        "inputs": {path.relative_to(checkout.data.parent).as_posix(): file_digest(path) for path in files},
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
