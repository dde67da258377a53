"""Every notebook run, where its inputs changed, and the book of all of them and docs/."""

from __future__ import annotations

import contextlib
import json
import re
import subprocess
import sys
import time
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from joblib import cpu_count

from trustlab.models.checks import did_you_mean, positive, whole_number
from trustlab.models.files import write_atomically
from trustlab.publishing.provenance import (
    digest,
    file_digest,
    provenance,
    read_files,
    shared_digest,
)

NAMED = re.compile(r"\d\d_.+\.ipynb")


@dataclass(frozen=True)
class Built:
    """What became of one notebook.

    Parameters
    ----------
    name : str
        Its name, without ``.ipynb``.
    state : {"run", "up to date", "skipped", "failed"}
        What was done; a notebook is skipped where data that it needs are absent.
    seconds : float
        Time taken, s; 0 where nothing was run.
    failure : str
        Cell, source and traceback of a failed one.
    """

    name: str
    state: str
    seconds: float = 0.0
    failure: str = ""


def find_notebooks(root: Path, names: Iterable[str] = ()) -> list[Path]:
    """
    Return the files ``NN_*.ipynb`` in order: those whose names begin with one of `names`, or all.
    """
    paths = sorted(path for path in (root / "notebooks").iterdir() if NAMED.fullmatch(path.name))
    stems = [path.stem for path in paths]
    short = tuple(Path(name).name.removesuffix(".ipynb") for name in names)
    for name in short:
        if not any(stem.startswith(name) for stem in stems):
            raise ValueError(
                f"no notebook is called {name!r}{did_you_mean(name, stems)}; there are: "
                f"{', '.join(stems) or 'none named NN_name.ipynb'}"
            )
    return [path for path in paths if not short or path.stem.startswith(short)]


def publish(
    names: Iterable[str] = (),
    *,
    root: str | Path = ".",
    parameters: dict[str, Any] | None = None,
    jobs: int | str = "auto",
    force: bool = False,
    timeout: float | None = None,
    report: Callable[[str], object] | None = None,
) -> list[Built]:
    """Run notebooks and write the book: ``docs/`` with them as its chapters.

    A notebook that fails is a chapter that says so, and nothing else of it; the others are run all
    the same.

    Parameters
    ----------
    names : iterable of str
        Notebooks to run, by the beginnings of their names; none for all.
    root : path-like
        The repository, with ``notebooks/``, where they run, ``docs/`` and ``reports/``.
    parameters : dict, optional
        Parameter → value; a notebook gets those it declares. Strings are read as Python.
    jobs : int or "auto"
        Notebooks run at once; ``"auto"`` for one more than there are CPUs.
    force : bool
        Whether to run what is up to date.
    timeout : float, optional
        Time limit of each cell [s]; none by default.
    report : callable, optional
        Gets each line of progress.

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
        If the book cannot be written.
    ModuleNotFoundError
        If the extra ``reports`` is not installed.
    """
    from trustlab.publishing.execution import choose_parameters, prepare_environment

    root = Path(root).resolve()
    say = report or (lambda line: None)
    chosen = find_notebooks(root, names)
    values = choose_parameters(chosen, parameters or {})
    # one more than CPUs, for notebooks that start, or wait for a browser, leave one idle
    most = cpu_count() + 1 if jobs == "auto" else whole_number("jobs", jobs)
    limit = None if timeout is None else positive("timeout", timeout)
    prepare_environment(root)
    for path in _chapters(root):
        if not (root / "notebooks" / path.name).is_file():
            path.unlink()
    shared = shared_digest(root)
    built = {}
    runs = []
    # The work is done in the kernels, which are processes: threads are enough to wait for them.
    pool = ThreadPoolExecutor(most)
    for path in chosen:
        state = digest([shared, file_digest(path), sorted(values[path].items())])
        if not force and _noted(root, path.stem) == state:
            built[path.stem] = Built(path.stem, "up to date")
        else:
            runs.append(pool.submit(_run, root, path, values[path], limit, state))
    try:
        for run in as_completed(runs):
            done = run.result()
            built[done.name] = done
            say(f"{done.name} … {done.state} in {done.seconds:.1f} s")
    finally:
        pool.shutdown(wait=False, cancel_futures=True)
    return [built[path.stem] for path in chosen]


def _run(
    root: Path, path: Path, parameters: dict[str, Any], timeout: float | None, inputs: str
) -> Built:
    """Run one notebook and put it, or its failure, into the book's sources."""
    from trustlab.publishing.chapter import chapter, empty_chapter
    from trustlab.publishing.execution import CellError, anonymous, declared_parameters, execute
    from trustlab.publishing.parameters import DataAbsentError

    clock = time.monotonic()
    started = f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC"
    used = declared_parameters(path) | parameters
    origin = provenance(root, path, used, read_files(root, path))  # before the run
    failure = ""
    try:
        run = execute(path, parameters, path.parent, timeout)
        origin |= {"Started": started, "Time taken": f"{time.monotonic() - clock:.1f} s"}
        page = chapter(run, origin, inputs)
        state = "run"
    except DataAbsentError as error:
        state = "skipped"
        page = empty_chapter(path, f"**Skipped: {error}**")
    except CellError as error:
        state = "failed"
        failure = anonymous(str(error), root)
        page = empty_chapter(path, "**This report failed.** Nothing of it is shown.", failure)
    write_atomically(root / "docs" / path.name, anonymous(page, root))
    seconds = time.monotonic() - clock
    return Built(path.stem, state, seconds, failure)


def _chapters(root: Path) -> list[Path]:
    return sorted((root / "docs").glob("[0-9][0-9]_*.ipynb"))


def _noted(root: Path, name: str) -> str:
    """Return the digest of the inputs that a chapter was run with, empty where it was not."""
    with contextlib.suppress(OSError, ValueError, TypeError):
        chapter = json.loads((root / "docs" / f"{name}.ipynb").read_text(encoding="utf-8"))
        return str(chapter["metadata"].get("digest", ""))
    return ""


def write_book(root: Path) -> bool:
    """Write the book by Sphinx; return whether it did so without a warning.

    A notebook that was never run is a chapter that says so.
    """
    from trustlab.publishing.chapter import empty_chapter

    for path in find_notebooks(root):
        if not (root / "docs" / path.name).is_file():
            page = empty_chapter(path, "It was not run yet; `make reports` runs it.")
            write_atomically(root / "docs" / path.name, page)
    trees = root / "reports" / ".build"
    command = [sys.executable, "-m", "sphinx", "-q", "-W", "--keep-going", "-j", "auto"]
    folders = ["-d", str(trees), str(root / "docs"), str(root / "reports")]
    return subprocess.run([*command, *folders], check=False).returncode == 0
