"""Where a report comes from, without paths, user or host names of this machine."""

from __future__ import annotations

import importlib.metadata
import os
import platform
import re
import subprocess
from pathlib import Path
from typing import Any

LISTED = ("trustlab", "numpy", "scipy", "pandas", "matplotlib", "numba", "statsmodels", "pingouin")


def external_data(root: Path) -> Path:
    """Return the folder of third-party data: ``TRUSTLAB_DATA``, else ``data/external``."""
    return (root / (os.environ.get("TRUSTLAB_DATA") or "data/external")).resolve()


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


def provenance(root: Path, notebook: Path, parameters: dict[str, Any]) -> dict[str, str]:
    """
    Return commit, notebook, folders of data that it names, platform, versions and parameters.

    The commit holds the notebook, the data and the lock of every dependency.
    """
    text = notebook.read_text(encoding="utf-8")
    # data/simulated, or "data" / "simulated", whose quotes have a backslash in a notebook's JSON
    folders = {"published", *re.findall(r'\bdata\\?"?\s*/\s*\\?"?(\w+)', text)}
    versions = [f"{name} {importlib.metadata.version(name)}" for name in LISTED]
    return {
        "Commit": commit(root),
        "Notebook": notebook.name,
        "Data": ", ".join(f"data/{name}" for name in sorted(folders)),
        "Platform": f"{platform.system()} {platform.machine()}",
        "Versions": ", ".join([f"python {platform.python_version()}", *versions]),
    } | {f"Parameter {name}": repr(value) for name, value in parameters.items()}
