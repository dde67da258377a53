"""One notebook, run by papermill in a kernel of its own."""

from __future__ import annotations

import ast
import re
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from trustlab.models.checks import did_you_mean
from trustlab.models.extras import extra
from trustlab.publishing.parameters import DataAbsentError
from trustlab.publishing.provenance import external_data

with extra("reports"):
    import nbformat
    import papermill
    from nbconvert.filters import strip_ansi
    from nbformat import NotebookNode
    from papermill.exceptions import PapermillExecutionError
    from traitlets.config import Config

# Libraries told to sum in one thread: with more, the last digits differ from machine to machine.
LIBRARIES = ("OMP", "OPENBLAS", "MKL", "VECLIB_MAXIMUM", "NUMBA")
ONE_THREAD = {f"{name.removesuffix('_MAXIMUM')}_NUM_THREADS": "1" for name in LIBRARIES}

# What a kernel of the book is told, as the process that starts it is.
SETTINGS = ONE_THREAD | {
    "PYTHONHASHSEED": "0",
    "TRUSTLAB_REPORT": "1",
    "MPLBACKEND": "module://matplotlib_inline.backend_inline",
}

# Seconds that a cell may take.
LIMIT = 1800.0


class CellError(ValueError):
    """A notebook that failed: the message names its cell and shows its source and traceback."""


def execute(
    path: Path, parameters: dict[str, Any], folder: Path, limit: float = LIMIT
) -> NotebookNode:
    """Run a notebook in a folder, each cell for some seconds at most; return it with outputs."""
    source = nbformat.read(path, as_version=4)
    numbers = {cell.id: f"cell {i}:\n\n{cell.source}" for i, cell in enumerate(source.cells, 1)}
    place = "no cell"

    def note(cell: NotebookNode, cell_index: int) -> None:
        nonlocal place
        place = numbers.get(cell.id, "the parameters given")

    # Of kernels that start at the same time, some now and then take the same port; names of sockets
    # are their own. They have some 100 characters at most; macOS's temporary folder is long.
    with tempfile.TemporaryDirectory(prefix="tl-", dir="/tmp") as scratch:
        sockets = {"transport": "ipc", "ip": str(Path(scratch, "kernel"))}
        try:
            return papermill.execute_notebook(
                source,
                None,
                parameters=parameters,
                kernel_name="python3",
                language="python",
                progress_bar=False,
                execution_timeout=limit,
                resources={"metadata": {"path": str(folder)}},
                # an idle kernel calls the signal that ends it an error
                extra_arguments=["--log-level=CRITICAL"],
                config=Config({"KernelManager": sockets}),
                on_cell_execute=note,
            )
        except PapermillExecutionError as error:
            if error.ename == DataAbsentError.__name__:
                raise DataAbsentError(error.evalue) from None
            traceback = "\n".join(error.traceback)
            raise CellError(f"{place}\n\n{strip_ansi(traceback)}") from error
        except Exception as error:  # its kernel died, or its time was over
            raise CellError(f"{place}\n\n{type(error).__name__}: {error}") from error


def chosen_parameters(path: Path, words: Sequence[tuple[str, str]]) -> dict[str, Any]:
    """
    Return those of the given parameters that a notebook declares; one that neither it nor a
    notebook beside it declares is refused.
    """
    beside = [declared_parameters(other) for other in path.parent.glob("[0-9]*.ipynb") if words]
    known = {name for parameters in beside for name in parameters}
    for name, _ in words:
        if name not in known:
            raise ValueError(
                f"no notebook declares a parameter {name!r}{did_you_mean(name, known)}; declared "
                f"are: {', '.join(sorted(known)) or 'none'}"
            )
    declared = declared_parameters(path) if words else {}
    return {name: _parsed(word) for name, word in words if name in declared}


def declared_parameters(path: Path) -> dict[str, Any]:
    """Return what a notebook declares in its cell with the tag "parameters"."""
    declared = papermill.inspect_notebook(str(path))
    return {name: _parsed(about["default"]) for name, about in declared.items()}


def _parsed(word: str) -> Any:
    """Return what Python reads in a text, or else the text."""
    try:
        return ast.literal_eval(word)
    except (SyntaxError, ValueError):
        return word


def anonymous(text: str, root: Path) -> str:
    """Return a text with the paths of this machine replaced."""
    places = {external_data(root): "TRUSTLAB_DATA", root: ".", Path(sys.prefix): ".venv"}
    for place, name in [*places.items(), (Path.home(), "~")]:
        text = text.replace(str(place), name)
    # A name begins where no part of it stands before: else long words would take their square.
    return re.sub(r"(?<![\w./~-])[\w./~-]*ipykernel_\d+/\d+\.py", "this notebook", text)
