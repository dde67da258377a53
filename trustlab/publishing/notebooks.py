"""Every notebook to a report, in parallel, built again only when its inputs changed."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import deque
from dataclasses import asdict, dataclass
from difflib import get_close_matches
from pathlib import Path

from trustlab.publishing.execution import declared_parameters, end_processes, parse_value
from trustlab.publishing.html_report import duration
from trustlab.publishing.index_page import read_sidecar, sidecar_path, write_index
from trustlab.publishing.inputs import Checkout, input_digest, shared_digest

__all__ = ["Built", "find_notebooks", "parameters_for", "publish"]

NAMED = re.compile(r"\d\d_.+\.ipynb")
ONE_THREAD = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "BLIS_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS",
    "NUMEXPR_NUM_THREADS",
)


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
        ``cell`` (its number from 1, or None), ``source``, ``error`` and ``traceback`` of a failed one.
    """

    name: str
    state: str
    seconds: float = 0.0
    failure: dict | None = None


def find_notebooks(checkout, names=()):
    """Return the notebooks to publish.

    Parameters
    ----------
    checkout : Checkout
        The folders.
    names : iterable of str
        Names with or without ``.ipynb``, or the beginning of one (``"01"``); none for all.

    Returns
    -------
    list of pathlib.Path
        ``NN_*.ipynb`` in order of their names.

    Raises
    ------
    ValueError
        If there is none, or a name fits none.
    """
    found = sorted(path for path in checkout.notebooks.glob("*.ipynb") if NAMED.fullmatch(path.name))
    if not found:
        raise ValueError(f"no notebook NN_name.ipynb (two digits, underscore, name) in {checkout.notebooks}")
    if not names:
        return found
    stems, chosen = [path.stem for path in found], set()
    for name in names:
        short = Path(name).name.removesuffix(".ipynb")
        fits = [stem for stem in stems if stem == short] or [stem for stem in stems if stem.startswith(short)]
        if not fits:
            near = get_close_matches(short, stems, 1)
            hint = f"; did you mean {near[0]}?" if near else ""
            raise ValueError(f"no notebook is called {name!r}{hint} There are: {', '.join(stems)}")
        chosen.update(fits)
    return [path for path in found if path.stem in chosen]


def _fitting(name, value, text, default, notebook):
    """Return a value of the kind the notebook declares."""
    if isinstance(default, str) and text is not None and not isinstance(value, str):
        return text
    kinds = {bool: (bool,), int: (int,), float: (int, float)}.get(type(default))
    wrong = kinds is not None and (
        not isinstance(value, kinds) or (isinstance(value, bool) and bool not in kinds)
    )
    if wrong:
        raise ValueError(
            f"parameter {name} of {notebook.stem} is {default!r} by default; {value!r} is of another kind"
        )
    return value


def parameters_for(notebooks, given):
    """Return the parameters each notebook gets: those of the given ones it declares.

    Parameters
    ----------
    notebooks : iterable of pathlib.Path
        The notebooks to run.
    given : dict
        Name → value. A string is read as papermill reads it: ``True False None``, numbers, else text.

    Returns
    -------
    dict
        Notebook → dict of parameters.

    Raises
    ------
    ValueError
        If no notebook declares one of the names, or a value is of another kind than the declared default.
    """
    if not given:
        return {path: {} for path in notebooks}
    declared = {path: declared_parameters(path) for path in notebooks}
    known = sorted({name for names in declared.values() for name in names})
    for name in given:
        if name not in known:
            near = get_close_matches(name, known, 1)
            lines = [f"  {path.stem}: {', '.join(names) or '(none)'}" for path, names in declared.items()]
            raise ValueError(
                f"no notebook declares a parameter {name!r}"
                + (f"; did you mean {near[0]!r}?" if near else ".")
                + "\nDeclared parameters:\n"
                + "\n".join(lines)
            )
    values = {name: (parse_value(v), v) if isinstance(v, str) else (v, None) for name, v in given.items()}
    return {
        path: {name: _fitting(name, *values[name], names[name], path) for name in given if name in names}
        for path, names in declared.items()
    }


class _Run:
    """One notebook under way in a process of its own."""

    def __init__(self, checkout, notebook, parameters, digest, threads, build):
        self.notebook, self.digest = notebook, digest
        self.scratch = Path(tempfile.mkdtemp(prefix=f"run-{os.getpid()}-", dir=build))
        self.sockets = tempfile.mkdtemp(prefix="tl-", dir="/tmp" if os.access("/tmp", os.W_OK) else None)
        environment = os.environ | {
            "PYTHONHASHSEED": "0",
            "MPLBACKEND": "module://matplotlib_inline.backend_inline",
            "JUPYTER_RUNTIME_DIR": self.sockets,
            "IPYTHONDIR": str(Path(self.sockets, "ipython")),  # nobody's own start-up files
            "JUPYTER_PLATFORM_DIRS": "1",
        }
        for name in ONE_THREAD:  # also the same sums on every machine
            environment.setdefault(name, "1")
        environment.setdefault("NUMBA_NUM_THREADS", str(threads))
        if "TRUSTLAB_DATA" in os.environ or checkout.external.is_dir():
            environment["TRUSTLAB_DATA"] = str(checkout.external)
        job = {
            "checkout": {name: str(value) for name, value in asdict(checkout).items()},
            "notebook": str(notebook),
            "parameters": parameters,
            "scratch": str(self.scratch),
            "sockets": self.sockets,
        }
        self.words = (self.scratch / "words.txt").open("w+", encoding="utf-8", errors="replace")
        self.process = subprocess.Popen(
            [sys.executable, "-m", "trustlab.publishing.execution"],
            stdin=subprocess.PIPE,
            stdout=self.words,
            stderr=subprocess.STDOUT,
            env=environment,
            text=True,
            start_new_session=True,  # an interrupt reaches the publisher, which ends its processes in order
        )
        try:
            self.process.stdin.write(json.dumps(job) + "\n")
            self.process.stdin.flush()
        except BrokenPipeError:
            pass

    def result(self):
        """Return what the process found; call it once it has ended."""
        self.words.seek(0)
        said = self.words.read().strip()
        try:
            found = json.loads((self.scratch / "result.json").read_text(encoding="utf-8"))
        except FileNotFoundError:
            last = said.splitlines()[-1] if said else f"its process ended with code {self.process.returncode}"
            failure = {
                "cell": None,
                "source": "",
                "error": last,
                "traceback": said,
                "shown": "It could not be run.",
            }
            return {"seconds": 0.0, "failure": failure}
        if "failure" in found and found["failure"]["cell"] is None:
            found["failure"]["traceback"] += f"\n{said}"
        return found

    def close(self):
        """Remove what the run leaves, having ended it if it has not."""
        if self.process.poll() is None:
            end_processes([self.process.pid])
            self.process.wait()
        self.process.stdin.close()
        self.words.close()
        for folder in (self.scratch, self.sockets):
            shutil.rmtree(folder, ignore_errors=True)


def _sweep(build):
    """Remove what publishers left that were killed outright."""
    import psutil

    for folder in build.glob("run-*"):
        pid = folder.name.split("-")[1]
        if pid.isdigit() and int(pid) != os.getpid() and not psutil.pid_exists(int(pid)):
            shutil.rmtree(folder, ignore_errors=True)


def _remove(checkout, name):
    (checkout.reports / f"{name}.html").unlink(missing_ok=True)
    sidecar_path(checkout, name).unlink(missing_ok=True)


def _keep(checkout, run, result, report, position):
    """Put a finished run's report in place, or take away the one that is no longer true."""
    name, failure = run.notebook.stem, result.get("failure")
    page = checkout.reports / f"{name}.html"
    record = {"name": name, "digest": run.digest} | result
    if failure is None:
        sidecar_path(checkout, name).unlink(missing_ok=True)
        os.replace(run.scratch / "report.html", page)
    else:
        page.unlink(missing_ok=True)
        record = {"name": name, "digest": None} | {key: result.get(key) for key in ("started", "seconds")}
        record["failure"] = {key: failure[key] for key in ("cell", "shown")}
    written = run.scratch / "sidecar.json"
    written.write_text(json.dumps(record, indent=1), encoding="utf-8")
    os.replace(written, sidecar_path(checkout, name))
    if failure is None:
        report(f"{position} {name} … built in {duration(result['seconds'])}")
        return Built(name, "built", result["seconds"])
    where = f" in cell {failure['cell']}" if failure["cell"] is not None else ""
    report(f"{position} {name} … FAILED{where} after {duration(result['seconds'])}")
    return Built(name, "failed", result["seconds"], failure)


def _jobs(jobs):
    if jobs == "auto":
        from joblib import cpu_count

        return cpu_count()
    try:
        count = int(jobs)
    except ValueError:
        count = 0
    if count < 1:
        raise ValueError(f'jobs must be "auto" or a whole number from 1, found {jobs!r}')
    return count


def publish(
    names=(), *, checkout=None, parameters=None, jobs="auto", force=False, report=None, on_failure=None
):
    """Run notebooks and write one self-contained HTML report each, and the index of all.

    A notebook that fails leaves no report, an earlier one of it is removed, and the others are built all the same.

    Parameters
    ----------
    names : iterable of str
        Notebooks to publish, none for all. Reports of notebooks that no longer exist are removed when all are published.
    checkout : Checkout, optional
        The folders, by default ``Checkout.find()``. Notebooks run with the folder of the notebooks as working directory.
    parameters : dict, optional
        Parameter → value; a notebook gets those it declares. Strings are read as papermill reads them.
    jobs : int or "auto"
        Notebooks run at once; ``"auto"`` for the number of CPUs there are.
    force : bool
        Whether to build what is up to date.
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
        Before any notebook runs: no such notebook, a parameter no notebook declares, a value of another kind.
    """
    checkout = Checkout.find() if checkout is None else checkout
    say = report or (lambda line: None)
    chosen = find_notebooks(checkout, names)
    given = parameters_for(chosen, dict(parameters or {}))
    most = _jobs(jobs)
    build = checkout.reports / ".build"
    build.mkdir(parents=True, exist_ok=True)
    _sweep(build)
    shared = shared_digest(checkout)
    digests = {path: input_digest(checkout, path, given[path], shared) for path in chosen}
    done, waiting = {}, deque()
    positions = {path: f"[{number}/{len(chosen)}]" for number, path in enumerate(chosen, 1)}
    for path in chosen:
        current = read_sidecar(checkout, path.stem).get("digest") == digests[path]
        if current and not force and (checkout.reports / f"{path.stem}.html").is_file():
            say(f"{positions[path]} {path.stem} … up to date")
            done[path] = Built(path.stem, "up to date")
        else:
            waiting.append(path)
    threads = max(1, _jobs("auto") // max(1, min(most, len(waiting))))
    running = []
    try:
        while waiting or running:
            while waiting and len(running) < most:
                path = waiting.popleft()
                say(f"{positions[path]} {path.stem} … running")
                running.append(_Run(checkout, path, given[path], digests[path], threads, build))
            for run in [run for run in running if run.process.poll() is not None]:
                path = run.notebook
                done[path] = _keep(checkout, run, run.result(), say, positions[path])
                running.remove(run)
                run.close()
                if done[path].failure and on_failure:
                    on_failure(done[path])
            time.sleep(0.05 if running else 0)
    finally:
        before = signal.getsignal(signal.SIGINT)
        _hold_interrupts(running)
        end_processes([run.process.pid for run in running if run.process.poll() is None])
        for run in running:
            run.close()
        _hold_interrupts(running, before)
    if not names:
        _remove_orphans(checkout, say)
    write_index(checkout, find_notebooks(checkout), shared)
    return [done[path] for path in chosen]


def _hold_interrupts(running, handler=signal.SIG_IGN):
    """Let nothing disturb the ending of processes (only the main thread may say so)."""
    import threading

    if running and threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, handler)


def _remove_orphans(checkout, report):
    """Remove reports whose notebook is gone."""
    for path in sorted((checkout.reports / ".build").glob("*.json")):
        if not (checkout.notebooks / f"{path.stem}.ipynb").is_file():
            _remove(checkout, path.stem)
            report(f"{path.stem}: removed, its notebook is gone")
