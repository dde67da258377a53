"""Many runs of one task: `run_campaign`."""

from __future__ import annotations

import inspect
import os
import warnings
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from time import perf_counter
from typing import TYPE_CHECKING

import numpy as np

from trustlab.campaign.chunks import ChunkSizes
from trustlab.campaign.errors import CampaignError, CampaignWarning, WorkerDiedError
from trustlab.campaign.parameters import checked_names
from trustlab.campaign.progress import Progress
from trustlab.campaign.worker import inside
from trustlab.models.checks import whole_number

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["run_campaign"]

HOPELESS = 5
"""So many runs may end their process, one after the other and none succeeding, before the campaign gives up."""


def run_campaign(
    task: Callable[..., Mapping],
    parameters: Sequence[Mapping],
    *,
    seed: int | np.random.SeedSequence = 0,
    n_jobs: int = -1,
    out: str | os.PathLike | None = None,
    cluster: object = None,
    progress: bool | None = None,
    fresh: bool = False,
) -> pd.DataFrame:
    """
    Run a task once for each set of parameters and return one table.

    Run i gets `seed.spawn`'s child i, so that the table does not depend on who ran what when: serial, parallel, on a
    cluster, or resumed, it is the same bit for bit (as far as the task is a function of its arguments; the text of an
    error may hold addresses). A run that fails is recorded, and the others go on.

    Parameters
    ----------
    task : callable
        Called as `task(**parameters, seed=SeedSequence)`; returns a dict of numbers, texts, True, False or None by name,
        the same names in every run. It works on copies of parameters that are not plain. Functions of notebooks, lambdas
        and closures can be used.
    parameters : sequence of dict
        One per run, with the same names in each; `parameter_grid` and `parameter_draws` make them.
    seed : int or numpy.random.SeedSequence
        Seed of the campaign.
    n_jobs : int
        Processes: 1 runs everything in this one; -1 takes as many as there are cores, -2 one fewer. Within a task of
        another campaign -1 means 1.
    out : str or os.PathLike, optional
        A folder to which finished chunks are written at once. A call with the same arguments goes on where a killed one
        stopped; at most the chunks under way are lost. Memory then holds no results until the table is read at the end.
    cluster : distributed.Client, distributed cluster or str, optional
        A Dask cluster, or the address of its scheduler, instead of processes of this machine.
    progress : bool, optional
        Whether to show runs done, rate and time left on stderr; by default where it is a terminal. In a notebook: True.
    fresh : bool
        Whether to remove an earlier campaign from `out`.

    Returns
    -------
    pandas.DataFrame
        One row per run, in order: run, parameters, results, failed, error (one line) and traceback. Results of a failed run
        are NaN. `attrs` holds runs, failed, resumed (runs that were read from `out`), seconds, seconds_in_runs (of all
        workers together), executor, and a `summary` in words.

    Raises
    ------
    CampaignError
        If the folder cannot be used, or holds a campaign with another task, parameters or seed (it says what changed); if
        the task cannot be sent to workers; if a cluster cannot be reached.
    ValueError
        If an argument is not of its kind.

    Warns
    -----
    CampaignWarning
        If runs failed: how many, and the first.

    Notes
    -----
    A run also fails whose process dies (it is then tried alone once more), that returns no dict, or that returns other
    names than most runs. Whether a task is the same as before is told by its module, name and source, see
    `trustlab.campaign.identity.task_identity`.

    Examples
    --------
    >>> import trustlab as tl
    >>> def mean(n, seed):
    ...     return {"mean": float(np.random.default_rng(seed).normal(size=n).mean())}
    >>> table = tl.run_campaign(mean, tl.parameter_grid(n=[10, 100], repeats=50), seed=1, n_jobs=1)
    >>> len(table)
    100
    """
    names = _checked_task(task, parameters)
    state = _seed_state(seed)
    for name, value, none in (("progress", progress, True), ("fresh", fresh, False)):
        if not (isinstance(value, bool) or (none and value is None)):
            raise ValueError(f"{name} must be True or False{' or None' if none else ''}, got {value!r}")
    if fresh and out is None:
        raise ValueError("fresh=True removes a campaign from a folder, but `out` is not given")
    workers = _workers(n_jobs, cluster)
    began = perf_counter()
    if out is None:
        store = _Memory()
    else:
        from trustlab.campaign.folder import Folder
        from trustlab.campaign.identity import task_identity

        identity = {"task": task_identity(task), "seed": _seed_text(state), "names": names}
        store = Folder(out, identity, parameters, names, fresh)
    try:
        todo = _gaps(store.spans, len(parameters))
        resumed = len(parameters) - sum(last - first for first, last in todo)
        executor, busy = None, 0.0
        if todo:
            executor = _executor(task, state, workers, cluster)
            busy = _drive(executor, parameters, todo, store, resumed, progress)
        from trustlab.campaign.table import assembled

        columns = {name: [] for name in names}
        for values in parameters:
            for name, column in columns.items():
                column.append(values[name])
        table = assembled(store.tables(), names, columns)
    finally:
        store.close()
    times = {"seconds": perf_counter() - began, "seconds_in_runs": busy}
    return _summed(table, resumed, times | {"executor": executor.name if executor else "none"})


def _checked_task(task: object, parameters: object) -> list[str]:
    if not callable(task):
        raise ValueError(
            f"task must be a function that is called as task(**parameters, seed=…), got {type(task).__name__}"
        )
    names = checked_names(parameters)
    try:
        signature = inspect.signature(task)
    except (TypeError, ValueError):  # some built-in functions have none
        return names
    called = getattr(task, "__qualname__", type(task).__qualname__)
    try:
        signature.bind(**dict.fromkeys([*names, "seed"]))
    except TypeError as error:
        raise ValueError(
            f"task {called}{signature} cannot be called with {', '.join([*names, 'seed'])} as named arguments: {error}; "
            "every task takes its parameters and `seed`, a numpy.random.SeedSequence"
        ) from None
    return names


def _seed_state(seed: object) -> tuple:
    if isinstance(seed, np.random.SeedSequence):
        entropy = seed.entropy
        entropy = int(entropy) if isinstance(entropy, int | np.integer) else tuple(int(x) for x in entropy)
        return entropy, tuple(int(k) for k in seed.spawn_key), seed.pool_size, seed.n_children_spawned
    return whole_number("seed", seed, least=0), (), 4, 0


def _seed_text(state: tuple) -> str:
    entropy, key, pool_size, before = state
    rest = (
        ""
        if (key, pool_size, before) == ((), 4, 0)
        else f", spawn key {key}, pool {pool_size}, child {before} on"
    )
    return f"{entropy}{rest}"


def _workers(n_jobs: object, cluster: object) -> int:
    if isinstance(n_jobs, bool | np.bool_) or not isinstance(n_jobs, int | np.integer) or n_jobs == 0:
        raise ValueError(
            f"n_jobs must be a whole number of processes, 1 for none beside this one, -1 for all cores, got {n_jobs!r}"
        )
    if cluster is not None:
        if n_jobs != -1:
            raise ValueError(
                f"give n_jobs or cluster, not both: a cluster has its own workers, got n_jobs={n_jobs}"
            )
        return 0
    if n_jobs > 0:
        return int(n_jobs)
    if inside():
        return 1
    import joblib

    return max(1, joblib.cpu_count() + 1 + int(n_jobs))


def _executor(task: Callable, state: tuple, workers: int, cluster: object) -> object:
    if cluster is not None:
        from trustlab.campaign.dask_cluster import DaskCluster

        return DaskCluster(task, state, cluster)
    from trustlab.campaign.executors import Loky, Serial

    return Serial(task, state) if workers == 1 else Loky(task, state, workers)


class _Memory:
    """Chunks of a campaign without a folder, as the tables that a folder would hold."""

    def __init__(self):
        self.spans, self._tables = [], []

    def add(self, first, last, table):
        self.spans.append((first, last, None))
        self._tables.append(table)

    def tables(self):
        return self._tables

    def close(self):
        pass


def _gaps(spans: list[tuple], runs: int) -> list[tuple[int, int]]:
    """Return first and end of what is still to be run."""
    gaps, end = [], 0
    for first, last, _ in sorted(spans, key=lambda span: span[0]):
        if first > end:
            gaps.append((end, first))
        end = last
    return [*gaps, (end, runs)] if end < runs else gaps


def _drive(
    executor: object,
    parameters: Sequence[Mapping],
    todo: list[tuple[int, int]],
    store: object,
    resumed: int,
    shown: bool | None,
) -> float:
    """Send chunks, write what comes back, try what was lost with a process again, alone; return seconds in runs."""
    from trustlab.campaign.table import encoded

    todo, suspects, under_way, solitary = deque(todo), deque(), {}, None
    sizes = ChunkSizes(sum(last - first for first, last in todo), executor.workers)
    bar, died, succeeded, finished, busy = Progress(len(parameters), resumed, 0, shown), 0, False, False, 0.0

    def send(first: int, last: int) -> object:
        future = executor.submit(first, [dict(parameters[i]) for i in range(first, last)])
        under_way[future] = (first, last)
        return future

    def take(first: int, last: int, outcomes: list[tuple]) -> None:
        store.add(first, last, encoded(first, [parameters[i] for i in range(first, last)], outcomes))
        bar.add(last - first, sum(outcome[0] is None for outcome in outcomes))

    try:
        while todo or suspects or under_way:
            alone = bool(suspects)
            if alone and not under_way:
                solitary = send(*suspects.popleft())
            while not alone and todo and len(under_way) < executor.slots:
                first, last = todo.popleft()
                size = sizes.next(last - first)
                if first + size < last:
                    todo.appendleft((first + size, last))
                send(first, first + size)
            for future in executor.done(list(under_way)):
                was_alone = future is solitary
                first, last = under_way.pop(future)
                try:
                    outcomes, seconds = executor.outcome(future)
                except WorkerDiedError as error:
                    if last - first > 1 and was_alone:
                        half = (first + last) // 2
                        suspects.extendleft([(half, last), (first, half)])
                    elif was_alone:
                        died += 1
                        if died >= HOPELESS and not succeeded:
                            raise CampaignError(
                                f"{died} processes died one after the other and no run has succeeded ({error}); try the "
                                "task with n_jobs=1"
                            ) from error
                        take(first, last, [(None, DIED, DIED + "\n")])
                    else:
                        suspects.append((first, last))
                else:
                    sizes.took(last - first, seconds)
                    busy += seconds
                    succeeded = succeeded or any(outcome[0] is not None for outcome in outcomes)
                    take(first, last, outcomes)
        finished = True
    finally:
        executor.close(finished)
        bar.close()
    return busy


DIED = (
    "WorkerDiedError: the process ended while it ran this, twice: it was killed, ran out of memory or crashed"
)


def _summed(table: pd.DataFrame, resumed: int, facts: dict) -> pd.DataFrame:
    failed = int(table["failed"].sum())
    words = f"{len(table):,} runs, {failed:,} failed"
    if failed:
        worst = table.loc[table["failed"], ["run", "error"]].iloc[0]
        words += f"; first run {worst['run']}: {worst['error']}"
        warnings.warn(
            f"{failed:,} of {len(table):,} runs failed; run {worst['run']}: {worst['error']} (see the columns failed, "
            "error and traceback)",
            CampaignWarning,
            stacklevel=3,
        )
    if resumed:
        words += f"; {resumed:,} were there already"
    table.attrs = {
        "runs": len(table),
        "failed": failed,
        "resumed": resumed,
        **facts,
        "summary": words,
    }
    return table
