"""Many runs of one task: a seed by index, results on disk as they come, resumed after a kill."""

from __future__ import annotations

import copy
import inspect
import json
import os
import traceback
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import BrokenExecutor
from contextlib import closing
from numbers import Integral
from pathlib import Path
from pickle import PicklingError
from time import perf_counter
from typing import Any

import numpy as np
import pandas as pd
from joblib import Parallel, delayed, effective_n_jobs, parallel_config
from joblib.externals.loky import get_reusable_executor
from tqdm import tqdm

from trustlab.campaign.identity import Identity
from trustlab.campaign.parameters import RESERVED, checked_names, plain, seed_sequence
from trustlab.models.checks import flag, shown, warn
from trustlab.models.digest import digest
from trustlab.models.files import path_of, write_atomically

FORMAT = 3
MANIFEST = "campaign.json"
REMEDY = "Use another folder, or remove this one"

# Seconds of work that a process is sent at a time, as far as the runs before it tell.
SENT = 1.0
# Seconds between two files of results.
SAVED = 2.0

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
        of notebooks, lambdas and closures can be used.
    parameters : sequence of dict
        One per run, with the same names in each; `parameter_grid` and `parameter_draws` make them.
    seed : int or numpy.random.SeedSequence
        Seed of the campaign.
    n_jobs : int
        Processes, as in `joblib.Parallel`: -1 takes as many as there are cores, 1 runs everything
        in this process. Within a task everything runs in the task's own process. Inside
        `joblib.parallel_config("dask")`, runs are computed on a Dask cluster.
    out : str or os.PathLike, optional
        A folder for the results. A call with the same arguments goes on where a killed one
        stopped; some seconds of work are lost. A campaign may grow: runs added at the end of
        `parameters`, or values at the end of a grid's first axis. Other files in the folder are
        left alone.
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
    files of the task's package, or all modules beside its script, or the functions, classes and
    values that a notebook's task uses; arguments bound to the task; the versions of trustlab,
    Python, numpy, scipy and numba. Data files and other installed packages do not count.

    Several processes may run one campaign in the same folder: they may repeat each other's work,
    and do no harm.

    Examples
    --------
    >>> import trustlab as tl
    >>> def mean(n, seed):
    ...     return {"mean": float(np.random.default_rng(seed).normal(size=n).mean())}
    >>> table = tl.run_campaign(mean, tl.parameter_grid(n=[10, 100], repeats=50), seed=1, n_jobs=1)
    >>> len(table)
    100
    """
    start = perf_counter()
    names = checked_names(parameters)
    _check_task(task, names)
    seed = seed_sequence(seed)
    if isinstance(n_jobs, bool) or not isinstance(n_jobs, Integral) or n_jobs == 0:
        raise ValueError(
            f"n_jobs must be a whole number of processes, -1 for all cores, got {shown(n_jobs)}"
        )
    hidden = None if progress is None else not flag("progress", progress)
    folder = None if out is None else _Folder(out, task, parameters, seed)
    rows = {} if folder is None else folder.rows()
    resumed = len(rows)
    missing = [run for run in range(len(parameters)) if run not in rows]
    computed = _finished(task, parameters, seed, missing, n_jobs)
    bar = tqdm(total=len(parameters), initial=resumed, unit="run", disable=hidden)
    with bar, closing(computed):  # an interrupt ends what is under way
        try:
            for finished in computed:
                rows |= finished
                bar.update(len(finished))
                if folder is not None:
                    folder.add(finished)
        finally:
            if folder is not None:
                folder.save()
    table = _table({name: [values[name] for values in parameters] for name in names}, rows)
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
        that are not plain values are text. `attrs` holds runs (finished so far), failed, summary,
        and the versions with which they were computed.

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
    parts = _parts(path)
    if parts is None:
        raise CampaignError(f"folder {path} holds no campaign: {MANIFEST} is not there")
    rows = _stored(path, parts)
    parameters = [rows[run]["parameters"] for run in sorted(rows)]
    names = parameters[0] if parameters else ()
    table = _table({name: [values[name] for values in parameters] for name in names}, rows)
    table.attrs["versions"] = {k: parts[k] for k in parts if k.startswith("version of ")}
    return table


def _check_task(task: Any, names: list[str]) -> None:
    try:
        inspect.signature(task).bind(**dict.fromkeys([*names, "seed"]))
    except TypeError as error:
        raise ValueError(
            f"task must be a function that can be called with {', '.join([*names, 'seed'])} by "
            f"name, got {shown(task)}: {error}; `seed` is a numpy.random.SeedSequence"
        ) from None


def _finished(
    task: Callable,
    parameters: Sequence[Mapping],
    seed: np.random.SeedSequence,
    missing: list[int],
    n_jobs: int,
) -> Iterator[dict[int, dict]]:
    """Yield the rows of runs, as processes return them."""
    processes = min(effective_n_jobs(n_jobs), len(missing))
    if processes > 1:
        _end_outdated_processes(task)
    mean = SENT  # seconds of a run: the first to be sent go alone

    def chunks() -> Iterator[tuple]:
        first = 0
        while first < len(missing):
            # Chunks become smaller towards the end, so that processes finish together.
            left = len(missing) - first
            last = first + max(1, min(int(SENT / mean), left // (3 * processes)))
            yield delayed(_chunk)(task, {run: parameters[run] for run in missing[first:last]}, seed)
            first = last

    try:
        parallel = Parallel(max(1, processes), return_as="generator_unordered", batch_size=1)
        for rows, seconds in parallel(chunks()):
            mean = seconds / len(rows)
            yield rows
    except (BrokenExecutor, PicklingError) as error:
        raise CampaignError(
            f"{error} Finished runs are in `out`, where that was given; the same call goes on"
        ) from error


def _end_outdated_processes(task: Callable) -> None:
    """End the processes that joblib keeps if what they have imported may have changed since."""
    sources = Identity(task).sources()
    if any(_imported.get(file, content) != content for file, content in sources.items()):
        get_reusable_executor().shutdown()
    _imported.update(sources)


def _chunk(
    task: Callable, parameters: dict[int, Mapping], seed: np.random.SeedSequence
) -> tuple[dict[int, dict], float]:
    """Return rows by run, and the seconds that they took."""
    start = perf_counter()
    rows: dict[int, dict] = {}
    with parallel_config("sequential"):  # within a task: the other cores are taken
        for run, values in parameters.items():
            # The child that `seed.spawn` would give at this index.
            key = (*seed.spawn_key, seed.n_children_spawned + run)
            child = np.random.SeedSequence(seed.entropy, spawn_key=key, pool_size=seed.pool_size)
            rows[run] = _row(task, values, child)
    return rows, perf_counter() - start


def _row(task: Callable, values: Mapping, seed: np.random.SeedSequence) -> dict[str, Any]:
    """Return the results of a run by name, or its error in one line and its traceback."""
    try:
        # A task that changes its arguments must not change those of other runs.
        results = _checked(task(**copy.deepcopy(dict(values)), seed=seed), values)
    except (Exception, SystemExit) as error:
        line = f"{type(error).__name__}: {error}".partition("\n")[0]
        lines = traceback.format_exception(error.with_traceback(error.__traceback__.tb_next))
        return {"results": None, "error": line, "traceback": "".join(lines)}
    return {"results": results, "error": None, "traceback": None}


def _checked(results: Any, parameters: Mapping) -> dict[str, Any]:
    """Return results as plain Python values."""
    if not isinstance(results, Mapping) or not results:
        raise CampaignError(f"a task must return a dict of results by name, got {shown(results)}")
    checked = {}
    for name, value in results.items():
        if not isinstance(name, str) or name in RESERVED or name in parameters:
            raise CampaignError(
                f"a result cannot be called {name!r}: names are text, and neither those of "
                f"parameters nor {', '.join(RESERVED)}"
            )
        try:
            checked[name] = plain(value)
        except TypeError:
            raise CampaignError(
                f"result {name!r} must be a number, text, True, False or None, got {shown(value)}"
            ) from None
    return checked


class _Folder:
    """
    A campaign on disk: a file that says what it depends on, and files of finished runs.

    Files of runs are named by what they depend on and by their content. So nothing is written
    twice, and results of another campaign are never read as those of this one.
    """

    def __init__(
        self,
        out: Any,
        task: Callable,
        parameters: Sequence[Mapping],
        seed: np.random.SeedSequence,
    ):
        self.path = path_of("out", out)
        identity = Identity(task)
        self.parameters = _texts(identity, parameters)
        bare = seed.state == np.random.SeedSequence(seed.entropy).state
        self.parts = {"seed": str(seed.entropy if bare else seed.state)} | identity.parts()
        self.unsaved: dict[int, dict] = {}
        self.saved = perf_counter()
        before = _parts(self.path)
        if before is None:
            self._write(MANIFEST, {"format": FORMAT, "parts": self.parts})
        elif before != self.parts:
            raise self._other(_changes(before, self.parts))

    def _other(self, changes: Iterable[str]) -> CampaignError:
        return CampaignError(f"{self.path} holds another campaign: {'; '.join(changes)}. {REMEDY}")

    def rows(self) -> dict[int, dict]:
        """Return the rows that are there, by run; raise if they have other parameters."""
        rows = _stored(self.path, self.parts)
        rows = {run: rows[run] for run in sorted(rows) if run < len(self.parameters)}
        for run, row in rows.items():
            before, now = row["parameters"], self.parameters[run]
            # As texts, which tell 1, 1.0 and True apart.
            if json.dumps(before, sort_keys=True) != json.dumps(now, sort_keys=True):
                raise self._other([f"the parameters of run {run} were {before}, are {now}"])
        return rows

    def add(self, rows: Mapping[int, dict]) -> None:
        """Take finished runs, and write them with those before every few seconds."""
        self.unsaved |= {
            run: row | {"parameters": self.parameters[run]} for run, row in rows.items()
        }
        if perf_counter() - self.saved > SAVED:
            self.save()

    def save(self) -> None:
        """Write what is not yet written."""
        if self.unsaved:
            content = digest(json.dumps(self.unsaved))[:16]
            self._write(f"{_prefix(self.parts)}{content}.json", self.unsaved)
        self.unsaved = {}
        self.saved = perf_counter()

    def _write(self, name: str, content: dict) -> None:
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            write_atomically(self.path / name, json.dumps(content))
        except OSError as error:
            raise CampaignError(
                f"cannot write in {self.path}: {error.strerror}; give a folder that has room and "
                "that you may write to"
            ) from error


def _texts(identity: Identity, parameters: Sequence[Mapping]) -> list[dict]:
    """Return parameters as a file keeps them: what is not plain by its type and a digest."""
    known: dict[int, tuple] = {}  # by id; runs often share a model. Values are held with it.

    def text(name: str, value: Any) -> Any:
        try:
            return plain(value)
        except TypeError:
            if id(value) not in known:
                content = identity.digest(f"parameter {name}", value)
                known[id(value)] = (f"{type(value).__name__} {content}", value)
            return known[id(value)][0]

    return [{name: text(name, value) for name, value in run.items()} for run in parameters]


def _changes(before: Mapping[str, str], now: Mapping[str, str]) -> Iterable[str]:
    """Yield what differs between two campaigns."""
    for name in sorted({*before, *now}):
        if name not in before or name not in now:
            yield f"{name} is {'new' if name in now else 'gone'}"
        elif before[name] != now[name]:
            readable = name == "seed" or name.startswith("version of ")
            yield f"{name} was {before[name]}, is {now[name]}" if readable else f"{name} changed"


def _prefix(parts: Mapping[str, str]) -> str:
    """Return how the names of a campaign's files of runs begin."""
    return f"runs-{digest(json.dumps(parts))[:16]}-"


def _read(path: Path, remedy: str) -> Any:
    try:
        return json.loads(path.read_bytes())
    except (OSError, ValueError) as error:
        raise CampaignError(f"{path} cannot be read: {error}. {remedy}") from error


def _parts(folder: Path) -> dict[str, str] | None:
    """Return what the campaign in a folder depends on; None where there is none."""
    path = folder / MANIFEST
    if not path.exists():
        return None
    content = _read(path, REMEDY)
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise CampaignError(f"{path} is of another version of trustlab. {REMEDY}")
    return content["parts"]


def _stored(folder: Path, parts: dict[str, str]) -> dict[int, dict]:
    """Return the rows in all files of a campaign, by run."""
    files = folder.glob(f"{_prefix(parts)}*.json")
    remedy = "Remove it, and its runs are computed again"
    return {int(run): row for file in files for run, row in _read(file, remedy).items()}


def _table(columns: Mapping[str, Iterable], rows: Mapping[int, dict]) -> pd.DataFrame:
    """Return the table of a campaign; a run with other results than most has failed."""
    runs = sorted(rows)
    results = [rows[run]["results"] for run in runs]
    errors = [rows[run]["error"] for run in runs]
    counts = Counter(frozenset(values) for values in results if values)
    usual = max(counts, key=counts.__getitem__, default=frozenset())
    names = next((list(values) for values in results if values and values.keys() == usual), [])
    for k, values in enumerate(results):
        if values and values.keys() != usual:
            results[k] = None
            errors[k] = (
                f"CampaignError: returned {', '.join(values)}, where most runs returned "
                f"{', '.join(names)}; return the same names from every run"
            )
    data = {"run": runs, **columns}
    data |= {name: [(values or {}).get(name) for values in results] for name in names}
    data |= {"failed": [values is None for values in results], "error": errors}
    data["traceback"] = [rows[run]["traceback"] for run in runs]
    data = {name: [np.nan if x is None else x for x in values] for name, values in data.items()}
    try:
        table = pd.DataFrame(data).astype({"error": "str", "traceback": "str"})
    except UnicodeEncodeError:  # half a surrogate pair, as file names may hold
        table = pd.DataFrame(data, dtype=object)
    failed = table[table["failed"].astype(bool)]
    summary = f"{len(table):,} runs, {len(failed):,} failed"
    if len(failed):
        summary += f"; run {failed['run'].iloc[0]}: {failed['error'].iloc[0]}"
    table.attrs = {"runs": len(table), "failed": len(failed), "summary": summary}
    return table
