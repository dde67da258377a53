"""Every notebook to a report, in parallel, built again only when its inputs changed."""

from __future__ import annotations

import ast
import contextlib
import json
import re
import time
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from loky import cpu_count

from trustlab.models.checks import did_you_mean, positive, shown, whole_number
from trustlab.models.extras import extra
from trustlab.publishing.provenance import (
    Checkout,
    duration,
    input_digest,
    provenance,
    shared_digest,
)

if TYPE_CHECKING:
    from trustlab.publishing.execution import Kernels

NAMED = re.compile(r"\d\d_.+\.ipynb")


@dataclass(frozen=True)
class Built:
    """What became of one notebook.

    Parameters
    ----------
    name : str
        Its name, without ``.ipynb``.
    state : {"built", "up to date", "failed"}
        What was done.
    seconds : float
        Time taken, s; 0 where nothing was run.
    failure : dict or None
        ``cell`` (its number from 1, or None), ``source``, ``error`` and ``traceback`` of a failed
        one.
    """

    name: str
    state: str
    seconds: float = 0.0
    failure: dict | None = None

    @property
    def where(self) -> str:
        """The cell that failed, in words; empty where it is none's."""
        return (
            f" in cell {self.failure['cell']}" if self.failure and self.failure.get("cell") else ""
        )


def find_notebooks(checkout: Checkout, names: Iterable[str] = ()) -> list[Path]:
    """
    Return the files ``NN_*.ipynb`` in order; those that `names` name, in full or by their
    beginning, or all.
    """
    notebooks = sorted(
        path for path in checkout.notebooks.glob("*.ipynb") if NAMED.fullmatch(path.name)
    )
    if not notebooks:
        raise ValueError(
            f"no notebook NN_name.ipynb (two digits, underscore, name) in {checkout.notebooks}"
        )
    if not names:
        return notebooks
    stems, chosen = [path.stem for path in notebooks], set()
    for name in names:
        short = Path(name).name.removesuffix(".ipynb")
        fits = [stem for stem in stems if stem == short] or [
            stem for stem in stems if stem.startswith(short)
        ]
        if not fits:
            known = f"{did_you_mean(short, stems)}. There are: {', '.join(stems)}"
            raise ValueError(f"no notebook is called {name!r}{known}")
        chosen.update(fits)
    return [path for path in notebooks if path.stem in chosen]


def _parameters_cell(path: Path) -> tuple[int, str]:
    """
    Return index and source of the cell tagged ``parameters``; behind the last cell and empty where
    there is none.
    """
    with extra("reports"):
        import nbformat

    cells = nbformat.read(path, as_version=4).cells
    tagged = (i for i, cell in enumerate(cells) if "parameters" in cell.metadata.get("tags", []))
    index = next(tagged, len(cells))
    return index, cells[index].source if index < len(cells) else ""


def declared_parameters(path: Path) -> dict[str, Any]:
    """
    Return the parameters that a notebook declares in its cell tagged ``parameters``, and their
    defaults.
    """
    with extra("reports"):
        from papermill.translators import PythonTranslator

    declared = PythonTranslator.inspect({"source": _parameters_cell(path)[1]})
    return {parameter.name: parse_value(parameter.default) for parameter in declared}


def parse_value(text: str) -> Any:
    """
    Return a parameter's value: what Python reads in the text, a number that it spells (inf, nan),
    or else the text.
    """
    with contextlib.suppress(SyntaxError, ValueError):
        return ast.literal_eval(text)
    with contextlib.suppress(ValueError):
        return float(text)
    return text


def parameters_for(notebooks: list[Path], values: dict[str, Any]) -> dict[Path, dict[str, Any]]:
    """
    Return the parameters each notebook gets: those of the given ones that it declares, of the kind
    of their default.
    """
    if not values:
        return {path: {} for path in notebooks}
    declared = {path: declared_parameters(path) for path in notebooks}
    known = {name for names in declared.values() for name in names}
    for name in values:
        if name not in known:
            lines = [
                f"  {path.stem}: {', '.join(names) or '(none)'}" for path, names in declared.items()
            ]
            unknown = f"no notebook declares a parameter {name!r}{did_you_mean(name, known)}"
            raise ValueError("\n".join([unknown, "Declared parameters:", *lines]))
    return {
        path: {
            name: _fitting(name, values[name], names[name], path)
            for name in values
            if name in names
        }
        for path, names in declared.items()
    }


def _fitting(name: str, content: Any, default: Any, notebook: Path) -> Any:
    """Return a value of the kind the notebook declares; text is read by `parse_value`."""
    if isinstance(content, str) and isinstance(default, str):
        return content
    value = parse_value(content) if isinstance(content, str) else content
    kinds = {bool: bool, int: int, float: int | float}.get(type(default), object)
    if not isinstance(value, kinds) or (isinstance(value, bool) and kinds not in (bool, object)):
        fault = f"{shown(value)} is of another kind"
        raise ValueError(f"parameter {name} of {notebook.stem} is {default!r} by default; {fault}")
    return value


def _run(
    checkout: Checkout,
    path: Path,
    parameters: dict[str, Any],
    kernels: Kernels,
    timeout: float | None,
) -> dict[str, Any]:
    """Run one notebook and lay out its page; return what is known of it afterwards."""
    from trustlab.publishing.execution import CellError, anonymous, execute
    from trustlab.publishing.report_page import report_html

    clock = time.monotonic()
    result: dict[str, Any] = {"started": datetime.now(UTC).isoformat(timespec="seconds")}
    used = declared_parameters(path) | parameters
    origin = provenance(checkout, path, used, **result)  # before the run: what it starts from
    try:
        run = execute(path, parameters, kernels, timeout)
        origin["seconds"] = time.monotonic() - clock
        page, card = report_html(run, path.stem, origin, parameters, checkout.notebooks)
        result |= card | {"page": anonymous(page, checkout)}
    except CellError as error:
        # Papermill puts given parameters into a cell of its own, behind the one that declares them.
        given = parameters and error.cell is not None and error.cell > _parameters_cell(path)[0]
        result["failure"] = {
            "cell": None if error.cell is None else error.cell + (0 if given else 1),
            "source": error.source,
            "error": str(error),
            "traceback": error.traceback,
            "shown": anonymous(str(error), checkout),
        }
    return result | {"seconds": time.monotonic() - clock}


def _keep(checkout: Checkout, name: str, result: dict[str, Any], record: dict[str, Any]) -> Built:
    """Put a finished report in place, or take away the one that is no longer true."""
    from trustlab.publishing.index_page import record_path, replace_file

    page, failure = checkout.reports / f"{name}.html", result.get("failure")
    record_path(checkout, name).unlink(missing_ok=True)  # what is cut off here is built again
    if failure is None:
        replace_file(page, result.pop("page"))
        record |= result
    else:
        page.unlink(missing_ok=True)
        record = result | {"failure": {key: failure[key] for key in ("cell", "shown")}}
    replace_file(record_path(checkout, name), json.dumps(record, indent=1))
    return Built(name, "failed" if failure else "built", result["seconds"], failure)


def publish(
    names: Iterable[str] = (),
    *,
    checkout: Checkout | None = None,
    parameters: dict[str, Any] | None = None,
    jobs: int | str = "auto",
    force: bool = False,
    timeout: float | None = None,
    report: Callable[[str], object] | None = None,
    on_failure: Callable[[Built], object] | None = None,
) -> list[Built]:
    """Run notebooks and write one self-contained HTML report each, and the index of all.

    A notebook that fails leaves no report, an earlier one of it is removed, and the others are
    built all the same.

    Parameters
    ----------
    names : iterable of str
        Notebooks to publish, none for all. Reports of notebooks that no longer exist are removed
        when all are published.
    checkout : Checkout, optional
        The folders, by default ``Checkout.find()``. Notebooks run with the folder of the notebooks
        as working directory.
    parameters : dict, optional
        Parameter → value; a notebook gets those it declares. Strings are read by `parse_value`.
    jobs : int or "auto"
        Notebooks run at once; ``"auto"`` for the number of CPUs there are.
    force : bool
        Whether to build what is up to date.
    timeout : float, optional
        Time limit of each cell [s]; none when not given.
    report : callable, optional
        Gets each line of progress.
    on_failure : callable, optional
        Gets the `Built` of each failed notebook as soon as it has failed.

    Returns
    -------
    list of Built
        One per notebook, in order.

    Raises
    ------
    ValueError
        Before any notebook runs: no such notebook, a parameter no notebook declares, a value of
        another kind, a time limit that is not positive.
    OSError
        If the reports cannot be written.
    ModuleNotFoundError
        If the extra ``reports`` is not installed.
    """
    from trustlab.publishing.index_page import held, read_record, write_index

    checkout = Checkout.find() if checkout is None else checkout
    say = report or (lambda line: None)
    chosen = find_notebooks(checkout, names)
    values = parameters_for(chosen, dict(parameters or {}))
    most = cpu_count() if jobs == "auto" else whole_number("jobs", jobs)
    limit = None if timeout is None else positive("timeout", timeout)
    done = {}

    def finish(path: Path, result: dict[str, Any]) -> None:
        record = {
            "digest": digests[path],
            "sources": input_digest(checkout, path, shared=shared),
            "parameters": {name: repr(value) for name, value in values[path].items()},
        }
        done[path] = built = _keep(checkout, path.stem, result, record)
        say(
            f"{path.stem} … {f'FAILED{built.where} after' if built.failure else 'built in'} "
            f"{duration(built.seconds)}"
        )
        if built.failure and on_failure:
            on_failure(built)

    with held(checkout, say):
        shared = shared_digest(checkout)
        digests = {path: input_digest(checkout, path, values[path], shared) for path in chosen}
        for path in chosen:
            current = read_record(checkout, path.stem).get("digest") == digests[path]
            if current and not force and (checkout.reports / f"{path.stem}.html").is_file():
                say(f"{path.stem} … up to date")
                done[path] = Built(path.stem, "up to date")
        waiting = {path: values[path] for path in chosen if path not in done}
        _run_all(checkout, waiting, most, limit, finish)
        if not names:
            _remove_orphans(checkout, say)
        write_index(checkout, find_notebooks(checkout), shared)
    return [done[path] for path in chosen]


def _run_all(
    checkout: Checkout,
    waiting: dict[Path, dict],
    jobs: int,
    timeout: float | None,
    finish: Callable[[Path, dict], None],
) -> None:
    """
    Run notebooks with their parameters, `jobs` at once, and hand over what became of each as soon
    as it is known.
    """
    from trustlab.publishing.execution import Kernels

    jobs = max(1, min(jobs, len(waiting)))
    kernels = Kernels(checkout, threads=max(1, cpu_count() // jobs))
    # The work is done in the kernels, which are processes: threads are enough to wait for them.
    pool = ThreadPoolExecutor(jobs)
    try:
        runs = {
            pool.submit(_run, checkout, path, values, kernels, timeout): path
            for path, values in waiting.items()
        }
        for run in as_completed(runs):
            finish(runs[run], run.result())
    except BaseException:  # an interrupt too: no kernel outlives the command
        kernels.end()
        raise
    finally:
        pool.shutdown(cancel_futures=True)


def _remove_orphans(checkout: Checkout, say: Callable[[str], object]) -> None:
    """Remove reports whose notebook is gone."""
    for record in sorted((checkout.reports / ".build").glob("*.json")):
        if not (checkout.notebooks / f"{record.stem}.ipynb").is_file():
            (checkout.reports / f"{record.stem}.html").unlink(missing_ok=True)
            record.unlink()
            say(f"{record.stem}: removed, its notebook is gone")
