"""
One notebook, run by papermill in a kernel of its own, and where its results come from, without
paths, user or host names of this machine.
"""

from __future__ import annotations

import ast
import os
import platform
import re
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

from trustlab.models.checks import one_of
from trustlab.models.extras import extra
from trustlab.publishing.parameters import DataAbsentError

with extra("reports"):
    import papermill
    from nbformat import NotebookNode
    from traitlets.config import Config

# What a kernel of the book is told, as the process that starts it is. Libraries sum in one thread:
# with more, the last digits differ from machine to machine.
SETTINGS = {
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "VECLIB_MAXIMUM_THREADS": "1",
    "NUMBA_NUM_THREADS": "1",
    "PYTHONHASHSEED": "0",
    "TRUSTLAB_REPORT": "1",
    "MPLBACKEND": "module://matplotlib_inline.backend_inline",
}

LISTED = ("trustlab", "numpy", "scipy", "pandas", "matplotlib", "numba", "statsmodels", "pingouin")

# Seconds that a cell may take.
LIMIT = 1800.0


class CellError(ValueError):
    """A notebook that failed: the message names its cell and shows its source and traceback."""


def execute(
    path: Path, parameters: dict[str, Any], folder: Path, limit: float = LIMIT
) -> NotebookNode:
    """Run a notebook in a folder, each cell for some seconds at most; return it with outputs."""
    place = "no cell"

    def note(cell: NotebookNode, cell_index: int) -> None:
        nonlocal place
        place = f"cell {cell_index + 1}:\n\n{cell.source}"

    # Of kernels that start at the same time, some now and then take the same port; names of sockets
    # are their own. They have some 100 characters at most; macOS's temporary folder is long.
    with tempfile.TemporaryDirectory(prefix="tl-", dir="/tmp") as scratch:
        sockets = {"transport": "ipc", "ip": str(Path(scratch, "kernel"))}
        try:
            return papermill.execute_notebook(
                path,
                None,
                parameters=parameters,
                kernel_name="python3",
                progress_bar=False,
                execution_timeout=limit,
                resources={"metadata": {"path": str(folder)}},
                # an idle kernel calls the signal that ends it an error
                extra_arguments=["--log-level=CRITICAL"],
                config=Config({"KernelManager": sockets}),
                on_cell_execute=note,
            )
        except Exception as error:  # of a cell; or the kernel died, or its time was over
            about = vars(error)
            if about.get("ename") == DataAbsentError.__name__:
                raise DataAbsentError(about["evalue"]) from None
            raise CellError(f"{place}\n\n{type(error).__name__}: {error}") from error


def given_parameters(path: Path, words: Sequence[tuple[str, str]]) -> dict[str, Any]:
    """
    Return those of the given parameters that a notebook declares; one that neither it nor a
    notebook beside it declares is refused.
    """
    paths = path.parent.glob("*.ipynb") if words else ()
    declared = {other: papermill.inspect_notebook(other) for other in paths}
    known = sorted(set().union(*declared.values()))
    return {
        name: _parsed(word)
        for name, word in words
        if one_of("a parameter", name, known) in declared[path]
    }


def _parsed(word: str) -> Any:
    """Return what Python reads in a text, or else the text."""
    try:
        return ast.literal_eval(word)
    except (SyntaxError, ValueError):
        return word


def commit(root: Path) -> str:
    """Return the commit of a repository, marked where files are changed."""
    command = ["git", f"--git-dir={root / '.git'}", f"--work-tree={root}"]
    command += ["status", "--porcelain=v2", "--branch"]
    try:
        status = subprocess.check_output(command, text=True, stderr=subprocess.DEVNULL)
    except (OSError, subprocess.SubprocessError):
        return "not a git checkout"
    head, *lines = status.splitlines()
    changed = any(not line.startswith("#") for line in lines)
    return head.removeprefix("# branch.oid ") + (" + uncommitted changes" if changed else "")


def provenance(root: Path, notebook: Path, run: NotebookNode) -> dict[str, str]:
    """
    Return commit, notebook, folders of data that it names, platform, versions, parameters and time.

    The commit holds the notebook, the repository's data and the lock of every dependency.
    """
    text = notebook.read_text(encoding="utf-8")
    # data/simulated, or "data" / "simulated", whose quotes have a backslash in a notebook's JSON
    folders = {"published", *re.findall(r'\bdata\\?"?\s*/\s*\\?"?(\w+)', text)}
    versions = [f"{name} {version(name)}" for name in LISTED]
    declared = papermill.inspect_notebook(notebook)
    parameters = {name: _parsed(about["default"]) for name, about in declared.items()}
    told = run.metadata.papermill
    return {
        "Commit": commit(root),
        "Notebook": notebook.name,
        "Data": ", ".join(f"data/{name}" for name in sorted(folders)),
        "Platform": f"{platform.system()} {platform.machine()}",
        "Versions": ", ".join([f"python {platform.python_version()}", *versions]),
        **{f"Parameter {name}": repr(x) for name, x in (parameters | told.parameters).items()},
        "Started": f"{told.start_time[:16].replace('T', ' ')} UTC",
        "Time taken": f"{told.duration:.1f} s",
    }


def anonymous(text: str, root: Path) -> str:
    """Return a text with the paths of this machine replaced."""
    data = os.environ.get("TRUSTLAB_DATA") or root / "data" / "external"
    places = {data: "TRUSTLAB_DATA", root: ".", sys.prefix: ".venv", Path.home(): "~"}
    for place, name in places.items():
        if str(place) == os.sep:  # the home of who has none
            continue
        text = text.replace(str(place), name)
    # A name begins where no part of it stands before: else long words would take their square.
    return re.sub(r"(?<![\w./~-])[\w./~-]*ipykernel_\d+/\d+\.py", "this notebook", text)
