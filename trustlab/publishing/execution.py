"""One notebook, run in a process of its own: ``python -m trustlab.publishing.execution``, its job on standard input.

The process ends, and takes the kernel with it, as soon as its standard input is closed: whatever becomes of the publisher,
no kernel is left behind.
"""

import json
import os
import re
import shutil
import sys
import tempfile
import threading
import time
from datetime import UTC, datetime
from pathlib import Path

__all__ = ["declared_parameters", "end_processes", "parse_value", "run_notebook"]

ANSI = re.compile(r"\x1b\[[0-9;?]*[ -/]*[@-~]|\x1b\][^\x07]*\x07|\x1b[@-_]")
INJECTED = "injected-parameters"


def parse_value(text):
    """Return a parameter's value as papermill reads it.

    Parameters
    ----------
    text : str
        What was typed: ``True``, ``False``, ``None``, an integer, a real number, or else a string.

    Returns
    -------
    bool or None or int or float or str
        The scalar.
    """
    words = {"True": True, "False": False, "None": None}
    if text in words:
        return words[text]
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text


def declared_parameters(notebook):
    """Return the parameters a notebook declares in its cell tagged ``parameters``.

    Parameters
    ----------
    notebook : path-like or nbformat.NotebookNode
        The notebook, as a file or read.

    Returns
    -------
    dict
        Name → default, a Python literal where the default is one, else its source text.
    """
    import ast

    import nbformat

    if not hasattr(notebook, "cells"):
        notebook = nbformat.read(notebook, as_version=4)
    found = {}
    for cell in notebook.cells:
        if cell.cell_type != "code" or "parameters" not in cell.metadata.get("tags", []):
            continue
        try:
            statements = ast.parse(re.sub(r"(?m)^[%!].*$", "", cell.source)).body
        except SyntaxError:  # running the cell says where
            break
        for statement in statements:
            targets = (
                statement.targets
                if isinstance(statement, ast.Assign)
                else [getattr(statement, "target", None)]
            )
            for target in targets:
                if isinstance(target, ast.Name) and getattr(statement, "value", None) is not None:
                    source = ast.unparse(statement.value)
                    try:
                        found[target.id] = ast.literal_eval(source)
                    except ValueError:
                        found[target.id] = source
        break
    return found


def end_processes(pids):
    """End processes and all that they started.

    Parameters
    ----------
    pids : iterable of int
        Process ids; those already gone are passed over.
    """
    import psutil

    family = []
    for pid in pids:
        try:
            process = psutil.Process(pid)
            family += [*process.children(recursive=True), process]
        except psutil.NoSuchProcess:
            continue
    for act in ("terminate", "kill"):
        for process in family:
            try:
                getattr(process, act)()
            except psutil.NoSuchProcess:
                continue
        _, family = psutil.wait_procs(family, timeout=2)


def _end_with_parent(scratch):
    """Wait until standard input closes, then end everything below this process and the process."""
    import psutil

    sys.stdin.read()
    end_processes([child.pid for child in psutil.Process().children()])
    shutil.rmtree(scratch, ignore_errors=True)
    os._exit(1)


def _kernel_manager():
    """Return a kernel manager whose kernel is this interpreter, whatever kernels are or are not installed."""
    from jupyter_client.kernelspec import KernelSpec
    from jupyter_client.manager import AsyncKernelManager
    from jupyter_core.paths import jupyter_runtime_dir
    from traitlets import Unicode, default

    class ThisInterpreter(AsyncKernelManager):
        if (
            os.name == "posix"
        ):  # no ports: kernels that start at the same time would now and then take the same ones
            transport = Unicode("ipc")

            @default("ip")
            def _sockets(self):
                return os.path.join(jupyter_runtime_dir(), "kernel")

        @property
        def kernel_spec(self):
            argv = [sys.executable, "-m", "ipykernel_launcher", "-f", "{connection_file}"]
            return KernelSpec(argv=argv, display_name="Python 3", language="python")

    return ThisInterpreter


def _cell_number(notebook, index):
    """Return the number, from 1, of a cell in the notebook as written: the injected cell is not counted."""
    tags = [cell.metadata.get("tags", []) for cell in notebook.cells[: index + 1]]
    return sum(INJECTED not in names for names in tags)


def _failure(notebook, index, words, trace):
    cell = notebook.cells[index] if index is not None else None
    return {
        "cell": None if cell is None else _cell_number(notebook, index),
        "source": "" if cell is None else cell.source,
        "error": ANSI.sub("", words).strip(),
        "traceback": ANSI.sub("", trace).strip(),
    }


def _scrub(value, replacements):
    """Return nested text with the paths of this machine replaced."""
    if isinstance(value, str):
        for old, new in replacements:
            value = value.replace(old, new)
        return re.sub(r"[\w.@+~/-]*ipykernel_\d+/\d+\.py", "this notebook", value)
    if isinstance(value, list):
        return [_scrub(item, replacements) for item in value]
    if isinstance(value, dict):
        pixels = ("image/png", "image/jpeg")  # base64 may spell anything
        return type(value)({k: v if k in pixels else _scrub(v, replacements) for k, v in value.items()})
    return value


def path_replacements(checkout):
    """Return what stands for the paths of this machine in a report, longest path first.

    Parameters
    ----------
    checkout : Checkout
        The folders.

    Returns
    -------
    list of tuple of str
        Pairs of a path and what is written in its place.
    """
    pairs = {
        str(checkout.external) + os.sep: "TRUSTLAB_DATA/",
        str(checkout.external): "TRUSTLAB_DATA",
        str(checkout.root) + os.sep: "",
        str(checkout.root): ".",
        str(checkout.package.parent) + os.sep: "",
        sys.prefix + os.sep: ".venv/",
        sys.base_prefix + os.sep: "python/",
        str(Path.home()) + os.sep: "~/",
        tempfile.gettempdir() + os.sep: "temporary/",
    }
    return sorted(((old, new) for old, new in pairs.items() if len(old) > 2), key=lambda pair: -len(pair[0]))


def _execute(notebook, checkout, parameters, kept):
    """Run a notebook; return it with its outputs, and its failure or None."""
    import nbformat
    import papermill
    from papermill.exceptions import PapermillExecutionError

    reached = []
    engine = {
        "kernel_manager_class": _kernel_manager(),
        "on_cell_execute": lambda cell, cell_index: reached.append(cell_index),
    }
    try:
        return papermill.execute_notebook(
            str(notebook).replace("{", "{{").replace("}", "}}"),
            str(kept),
            parameters=parameters,
            kernel_name="python3",
            language="python",
            progress_bar=False,
            cwd=str(checkout.notebooks),
            start_timeout=60,
            **engine,
        ), None
    except PapermillExecutionError as error:
        run = nbformat.read(kept, as_version=4)
        run.cells = [
            cell for cell in run.cells if "papermill-error-cell-tag" not in cell.metadata.get("tags", [])
        ]
        trace = "\n".join(error.traceback) or f"{error.ename}: {error.evalue}"
        return run, _failure(run, error.cell_index, f"{error.ename}: {error.evalue}", trace)
    except Exception as error:  # the kernel died, or never came up
        if not kept.exists():
            raise
        run = nbformat.read(kept, as_version=4)
        index = reached[-1] if reached else None
        words = f"{type(error).__name__}: {error}"
        return run, _failure(
            run, index, words, f"{words}\nThe kernel ended before the cell did (out of memory?)."
        )


def run_notebook(checkout, notebook, parameters, target, scratch):
    """Run one notebook and write its report.

    Parameters
    ----------
    checkout : Checkout
        The folders; the notebook runs in the folder of the notebooks.
    notebook : pathlib.Path
        The notebook.
    parameters : dict
        Values for parameters it declares.
    target : pathlib.Path
        Where the HTML is written, once everything has succeeded.
    scratch : pathlib.Path
        An empty folder for the run.

    Returns
    -------
    dict
        ``started``, ``seconds`` and either ``failure`` (``cell source error traceback``) or ``title``, ``sentence``,
        ``thumbnail`` and ``parameters``.
    """
    from trustlab.publishing.html_report import ReportError, report_html
    from trustlab.publishing.provenance import provenance

    clock = time.monotonic()
    result = {"started": datetime.now(UTC).isoformat(timespec="seconds")}
    replacements = path_replacements(checkout)
    used = {**declared_parameters(notebook), **parameters}
    origin = provenance(
        checkout, notebook, used, started=result["started"]
    )  # before the run: what it starts from
    run, failure = _execute(notebook, checkout, parameters, scratch / "run.ipynb")
    result["seconds"] = origin["seconds"] = time.monotonic() - clock
    if failure is None:
        for cell in run.cells:
            if "outputs" in cell:
                cell.outputs = _scrub(cell.outputs, replacements)
        try:
            page, card = report_html(run, notebook.stem, origin, given=parameters, folder=checkout.notebooks)
            target.write_text(page, encoding="utf-8")
            result |= card | {"parameters": {name: repr(value) for name, value in parameters.items()}}
        except ReportError as error:
            failure = _failure(run, error.cell, str(error), str(error))
    if failure is not None:
        failure["shown"] = _scrub(failure["error"], replacements)
        result["failure"] = failure
    return result


def _main():
    from trustlab.publishing.inputs import Checkout

    job = json.loads(sys.stdin.readline())
    scratch = Path(job["scratch"])
    threading.Thread(target=_end_with_parent, args=[job["sockets"]], daemon=True).start()
    checkout = Checkout(**{name: Path(value) for name, value in job["checkout"].items()})
    result = run_notebook(
        checkout, Path(job["notebook"]), job["parameters"], scratch / "report.html", scratch
    )
    (scratch / "result.json").write_text(json.dumps(result), encoding="utf-8")


if __name__ == "__main__":
    _main()
