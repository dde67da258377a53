"""Many runs of one task: a seed by index, results on disk as they come, resumed after a kill."""

from __future__ import annotations

import copy
import inspect
import json
import os
import traceback
from collections.abc import Callable, Generator, Mapping, Sequence
from concurrent.futures import BrokenExecutor
from contextlib import closing
from pathlib import Path
from pickle import PicklingError
from statistics import mode
from time import perf_counter
from typing import Any

import numpy as np
import pandas as pd
from joblib import Parallel, cpu_count, delayed, effective_n_jobs, parallel_config
from joblib.externals.loky import get_reusable_executor
from tqdm import tqdm

from trustlab.campaign.identity import identity, sources, value_digest
from trustlab.campaign.parameters import RESERVED, check_parameters, child_of, seed_sequence
from trustlab.models.checks import flag, shown, warn, whole_number
from trustlab.models.digest import digest
from trustlab.models.files import path_of, write_atomically, writing

MANIFEST = "campaign.json"
FORMAT = "trustlab campaign, format 5"
REMEDY = "Use another folder, or remove it"

# Seconds after which the runs that have finished are written to a file.
PAUSE = 2.0

PLAIN = bool | int | float | str | None

# Digests of the source files that the processes kept by joblib may have imported.
_imported: dict[str, str] = {}


class CampaignError(ValueError):
    """A campaign that cannot run or go on; the message says what was found and what to do."""


class CampaignWarning(UserWarning):
    """Some runs of a campaign failed."""


def run_campaign(
    task: Callable[..., Mapping],
    parameters: Sequence[Mapping],
    *,
    seed: int | np.random.SeedSequence = 0,
    n_jobs: int = -1,
    out: str | os.PathLike | None = None,
    progress: bool | None = None,
) -> pd.DataFrame:
    """
    Run a task once for each set of parameters and return one table.

    Run i gets the child i of `seed.spawn`, so that the table is the same in whatever order and
    wherever runs are computed, and after an interruption. A run that fails is recorded, and the
    others go on.

    Parameters
    ----------
    task : callable
        Called as `task(**parameters, seed=SeedSequence)` with copies of the parameters; returns a
        dict of numbers, texts, True, False or None, with the same names in every run. Functions
        of notebooks, lambdas and closures can be used, those in a `functools.cache` with n_jobs=1.
    parameters : sequence of dict
        One per run, with the same names in each; `parameter_grid` and `parameter_draws` make them.
    seed : int or numpy.random.SeedSequence
        Seed of the campaign.
    n_jobs : int
        Processes, as in `joblib.Parallel`: -1 takes as many as there are cores, 1 runs everything
        in this process. Within a task everything runs in the task's own process. Inside
        `joblib.parallel_config("dask")`, runs are computed on a Dask cluster of two cores or more.
    out : str or os.PathLike, optional
        A folder for the results. A call with the same arguments goes on where a killed one
        stopped, with some seconds of work lost, and tries failed runs again. A campaign may grow:
        runs added at the end of `parameters`, or values at the end of a grid's first axis. Other
        files in the folder are left alone.
    progress : bool, optional
        Whether to show progress on stderr; by default where it is a terminal.

    Returns
    -------
    pandas.DataFrame
        One row per run, in order: run, parameters, results, failed, error (one line) and traceback.
        Results of a failed run are NaN. `attrs` holds runs, failed, resumed (runs read from
        `out`), seconds, and a `summary` in words.

    Raises
    ------
    CampaignError
        If `out` holds the results of another task, seed, parameters or versions (the message says
        what changed), or a process ended; finished runs stay in `out`.
    ValueError
        If an argument is not of its kind.

    Warns
    -----
    CampaignWarning
        If runs failed: how many, and the error of the first.

    Notes
    -----
    Results in `out` are used again only while nothing that they depend on has changed: all source
    files of the task's package, or the functions, classes and values of a script or notebook that
    the task uses, all modules and packages beside it (keep those that have nothing to do with it
    elsewhere) and all others that are loaded at the call and not installed; arguments bound to the
    task; the versions of trustlab, Python, numpy, scipy and numba. Data files and other installed
    packages do not count.

    Several processes may run one campaign in the same folder: they may repeat each other's work,
    and do no harm.

    Examples
    --------
    >>> import numpy as np
    >>> import trustlab as tl
    >>> def mean(n, seed):
    ...     return {"mean": float(np.random.default_rng(seed).normal(size=n).mean())}
    >>> table = tl.run_campaign(mean, tl.parameter_grid(n=[10, 100], repeats=50), seed=1, n_jobs=1)
    >>> len(table), int(table["failed"].sum())
    (100, 0)
    """
    start = perf_counter()
    check_parameters(parameters)
    _check_task(task, [*parameters[0], "seed"])
    seed = seed_sequence(seed)
    n_jobs = whole_number("n_jobs", n_jobs, least=-cpu_count() if n_jobs else 1)
    hidden = None if progress is None else not flag("progress", progress)
    rows: dict[int, dict] = {}
    if out is not None:
        folder = path_of("out", out)
        texts = [{name: _text(name, x) for name, x in run.items()} for run in parameters]
        prefix, rows = _opened(folder, task, seed, texts)
    resumed, begun, fresh = len(rows), start, {}

    def write() -> None:
        """Write the runs that finished since the last file."""
        if fresh and out is not None:
            content = {run: {**row, "parameters": texts[run]} for run, row in fresh.items()}
            _write(folder / f"{prefix}{digest(json.dumps(content))}.json", content)
            fresh.clear()

    missing = [run for run in range(len(parameters)) if run not in rows]
    with (
        tqdm(total=len(parameters), initial=resumed, unit="run", disable=hidden) as bar,
        # Closed, so that an interrupt ends what is under way.
        closing(_computed(task, parameters, seed, missing, n_jobs)) as computed,
    ):
        try:
            for run, row in computed:
                rows[run] = fresh[run] = row
                bar.update()
                if perf_counter() - begun > PAUSE:
                    write()
                    begun = perf_counter()
        finally:
            write()
    table = _table(rows, parameters)
    table.attrs |= {"resumed": resumed, "seconds": perf_counter() - start}
    if table.attrs["failed"]:
        warn(f"{table.attrs['summary']} (see failed, error and traceback)", CampaignWarning)
    return table


def read_campaign(folder: str | os.PathLike) -> pd.DataFrame:
    """
    Read what a campaign has written so far, while it runs or after it was interrupted.

    Parameters
    ----------
    folder : str or os.PathLike
        The `out` of `run_campaign`.

    Returns
    -------
    pandas.DataFrame
        The columns of `run_campaign`, one row per finished run, in the order of runs; parameters
        that are not plain values are text. `attrs` holds runs (finished so far), failed and
        summary.

    Raises
    ------
    CampaignError
        If there is no campaign in the folder, or a file of it is damaged.

    Examples
    --------
    >>> import tempfile
    >>> import trustlab as tl
    >>> def task(upper, seed):
    ...     return {"double": 2 * upper}
    >>> runs = tl.parameter_grid(upper=[0.2, 0.3])
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     run = tl.run_campaign(task, runs, seed=0, n_jobs=1, out=folder)
    ...     table = tl.read_campaign(folder)
    >>> table.equals(run)
    True
    """
    path = path_of("folder", folder)
    if not (path / MANIFEST).exists():
        raise CampaignError(f"folder: there is no campaign in {path}")
    rows = _stored(path, _manifest(path))
    return _table(rows, {run: row["parameters"] for run, row in rows.items()})


def _check_task(task: Any, names: list[str]) -> None:
    try:
        inspect.signature(task).bind(**dict.fromkeys(names))
    except TypeError as error:
        raise ValueError(
            f"task must be a function that can be called with {', '.join(names)} by name, got "
            f"{shown(task)}: {error}; `seed` is a numpy.random.SeedSequence"
        ) from None


def _computed(
    task: Callable,
    parameters: Sequence[Mapping],
    seed: np.random.SeedSequence,
    missing: list[int],
    n_jobs: int,
) -> Generator[tuple[int, dict]]:
    """Yield runs and their rows, as processes return them."""
    processes = max(1, min(effective_n_jobs(n_jobs), len(missing)))
    if processes > 1:
        _end_outdated_processes(task)
    try:
        parallel = Parallel(processes, return_as="generator_unordered")
        yield from parallel(delayed(_row)(task, run, parameters[run], seed) for run in missing)
    except (BrokenExecutor, PicklingError) as error:
        reason = str(error.__cause__ or "").strip('\n"').rpartition("\n")[2]
        raise CampaignError(
            f"{error} {reason}\nOnce that is mended, the same call goes on with the finished runs "
            "in `out`"
        ) from error


def _end_outdated_processes(task: Callable) -> None:
    """End the processes that joblib keeps if what they have imported may have changed since."""
    files = sources(task)
    if any(_imported.get(file, content) != content for file, content in files.items()):
        get_reusable_executor().shutdown()
    _imported.update(files)


def _row(
    task: Callable, run: int, values: Mapping, seed: np.random.SeedSequence
) -> tuple[int, dict[str, Any]]:
    """Return a run and its results by name, or its error in one line and its traceback."""
    try:
        # That which `seed.spawn` would give at this index.
        child = child_of(seed, seed.n_children_spawned + run)
        # A task that changes its arguments must not change those of other runs.
        with parallel_config("sequential"):  # within a task: the other cores are taken
            results = task(**copy.deepcopy(dict(values)), seed=child)
        if not isinstance(results, Mapping) or not results:
            raise CampaignError(f"a task must return a dict of results, got {shown(results)}")
        results = {name: _plain(value) for name, value in results.items()}
        for name, value in results.items():
            if not isinstance(name, str) or name in RESERVED or name in values:
                raise CampaignError(
                    f"result {name!r} has the name of another column, or no text for one; rename it"
                )
            if not isinstance(value, PLAIN):
                raise CampaignError(
                    f"result {name!r} must be a number, text, True, False or None, got "
                    f"{shown(value)}"
                )
    except (Exception, SystemExit) as error:
        line = f"{type(error).__name__}: {error}".partition("\n")[0]
        return run, {"results": {}, "error": line, "traceback": traceback.format_exc()}
    return run, {"results": results, "error": None, "traceback": None}


def _plain(value: Any) -> Any:
    """Return a number of NumPy's as Python's own."""
    return value.item() if getattr(value, "ndim", None) == 0 else value


def _text(name: str, value: Any) -> Any:
    """Return a parameter as a file keeps it: what is not plain by its type and a digest."""
    value = _plain(value)
    if isinstance(value, PLAIN):
        return value
    return f"{type(value).__name__} {value_digest(f'parameter {name}', value)}"


def _readable(value: Any) -> Any:
    """Return a text in characters that tables can hold, as names of files may have others."""
    return value.encode("utf-8", "backslashreplace").decode() if isinstance(value, str) else value


def _table(rows: Mapping[int, dict], parameters: Any) -> pd.DataFrame:
    """Return the table of a campaign; a run with other results than most has failed."""
    usual = mode(
        [frozenset(row["results"]) for row in rows.values() if row["results"]] or [frozenset()]
    )
    records, errors = [], []
    for run, row in sorted(rows.items()):
        results, error = row["results"], row["error"]
        if results and set(results) != usual:
            error = (
                f"CampaignError: returned {', '.join(results)}, where most runs returned "
                f"{', '.join(sorted(usual))}; return the same names from every run"
            )
            results = {}
        values = {"run": run, **parameters[run], **results}
        records.append({name: _readable(value) for name, value in values.items()})
        errors.append(_readable(error))
    table = pd.DataFrame(records or {"run": []})
    for name in table.select_dtypes(float):
        column = enumerate(row.get(name) for row in records)
        exact = pd.Series({k: value for k, value in column if value is not None})
        if exact.dtype == int and exact.abs().max() > 2**53:  # floats would lose digits
            table[name] = exact.astype(object)
    table["failed"] = [error is not None for error in errors]
    table["error"] = pd.Series(errors, dtype="str")
    tracebacks = [_readable(rows[run]["traceback"]) for run in table["run"]]
    table["traceback"] = pd.Series(tracebacks, dtype="str")
    failed = table[table["failed"].astype(bool)]
    summary = f"{len(table):,} runs, {len(failed):,} failed"
    if len(failed):
        summary += f"; run {failed['run'].iloc[0]}: {failed['error'].iloc[0]}"
    table.attrs = {"runs": len(table), "failed": len(failed), "summary": summary}
    return table


def _opened(
    folder: Path, task: Callable, seed: np.random.SeedSequence, texts: Sequence[Mapping]
) -> tuple[str, dict[int, dict]]:
    """
    Return how the names of a campaign's files of runs begin, and the rows in them; raise if the
    folder holds another campaign.
    """
    key = str((*seed.spawn_key, seed.n_children_spawned))
    now = {"seed": str(seed.entropy), "seed's spawn key": key} | identity(task)
    if not (folder / MANIFEST).exists():
        _write(folder / MANIFEST, {FORMAT: now})
    before = _manifest(folder)
    # Which modules are loaded depends on what else was done: those in one of them do not count.
    changes = [
        f"{name} changed" if len(text) == 32 else f"{name} was {text}, is {now[name]}"
        for name, text in sorted(before.items())
        if now.get(name, text) != text
    ]
    rows = {run: row for run, row in _stored(folder, before).items() if run < len(texts)}
    changes += [
        f"{name} of run {run} was {row['parameters'].get(name)!r}, is {texts[run].get(name)!r}"
        for run, row in sorted(rows.items())
        for name in row["parameters"] | texts[run]
        # Their texts tell 1, 1.0 and True apart.
        if repr(row["parameters"].get(name, ...)) != repr(texts[run].get(name, ...))
    ][:1]
    if changes:
        raise CampaignError(f"{folder} holds another campaign: {'; '.join(changes)}. {REMEDY}")
    # What failed may have failed for want of memory or of a file: it is computed anew.
    return _prefix(before), {run: row for run, row in rows.items() if row["error"] is None}


def _manifest(folder: Path) -> dict[str, str]:
    """Return what the campaign in a folder depends on."""
    content = _read(folder / MANIFEST)
    if FORMAT not in content:
        raise CampaignError(f"{folder / MANIFEST} is of another version of trustlab. {REMEDY}")
    return content[FORMAT]


def _prefix(parts: dict[str, str]) -> str:
    """
    Return how the names of a campaign's files of runs begin.

    They are named by what the runs depend on and by their content. So nothing is written twice,
    and results of another campaign are never read as those of this one.
    """
    return f"runs-{digest(json.dumps(parts, sort_keys=True))[:16]}-"


def _stored(folder: Path, parts: dict[str, str]) -> dict[int, dict]:
    """Return the rows in all files of a campaign, by run; one that succeeded before a failure."""
    contents = map(_read, folder.glob(f"{_prefix(parts)}*.json"))
    rows = [(int(run), row) for content in contents for run, row in content.items()]
    return dict(sorted(rows, key=lambda pair: pair[1]["error"] is None))


def _read(path: Path) -> dict:
    try:
        return {**json.loads(path.read_bytes())}
    except (OSError, TypeError, ValueError) as error:
        raise CampaignError(f"{path} cannot be read: {error}. {REMEDY}") from error


def _write(path: Path, content: dict) -> None:
    with writing(path, CampaignError):
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(path, json.dumps(content))
