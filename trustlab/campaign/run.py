"""Many runs of one task: `run_campaign`."""

from __future__ import annotations

import contextlib
import inspect
import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np

from trustlab.campaign.errors import CampaignWarning
from trustlab.campaign.parameters import checked_names
from trustlab.models.checks import flag, one_of, warn, whole_number

if TYPE_CHECKING:
    import pandas as pd


def run_campaign(
    task: Callable[..., Mapping],
    parameters: Sequence[Mapping],
    *,
    seed: int | np.random.SeedSequence = 0,
    n_jobs: int = -1,
    out: str | os.PathLike | None = None,
    executor: Executor | None = None,
    progress: bool | None = None,
    fresh: bool = False,
    other_versions: Sequence[str] = (),
) -> pd.DataFrame:
    """
    Run a task once for each set of parameters and return one table.

    Run i gets the child i of `seed.spawn`, so that the table does not depend on which worker ran
    what and when: serial, parallel, on a cluster, or resumed, it is the same bit for bit (as far as
    the task is a function of its arguments; the text of an error may hold addresses). A run that
    fails is recorded, and the others go on.

    Parameters
    ----------
    task : callable
        Called as `task(**parameters, seed=SeedSequence)`; returns a dict of numbers, texts, True,
        False or None by name, the same names in every run. It works on copies of parameters that
        are not plain. Functions of notebooks, lambdas and closures can be used.
    parameters : sequence of dict
        One per run, with the same names in each; `parameter_grid` and `parameter_draws` make them.
    seed : int or numpy.random.SeedSequence
        Seed of the campaign.
    n_jobs : int
        Processes, kept by loky for the next campaign: 1 runs everything in this process; -1 takes
        as many as there are cores, -2 one fewer. Within a task of another campaign -1 means 1. With
        `executor`: how many workers it has, where the executor does not know.
    out : str or os.PathLike, optional
        A folder to which finished chunks are written at once. A call with the same arguments goes
        on where a killed one stopped; at most the chunks under way are lost. Memory then holds no
        results until the table is read at the end. The campaign may grow: with runs added at the
        end of `parameters` (or values at the end of a grid's first axis), only these are run.
    executor : concurrent.futures.Executor, optional
        Any executor instead of processes of this machine: `client.get_executor()` of a Dask client,
        `mpi4py.futures.MPIPoolExecutor`, `executorlib.SlurmClusterExecutor`, a ThreadPoolExecutor;
        it stays open.
    progress : bool, optional
        Whether to show runs done, rate and time left on stderr; by default where it is a terminal.
        In a notebook: True.
    fresh : bool
        Whether to remove an earlier campaign from `out`.
    other_versions : sequence of str
        Of "trustlab", "Python", "numpy" and "numba": those that may have another version than the
        runs in `out` have, so that the table mixes both; `read_campaign` says which. By default
        each must be the same.

    Returns
    -------
    pandas.DataFrame
        One row per run, in order: run, parameters, results, failed, error (one line) and traceback.
        Results of a failed run are NaN. `attrs` holds runs, failed, resumed (runs that were read
        from `out`), seconds, seconds_in_runs (of all workers together), executor, and a `summary`
        in words.

    Raises
    ------
    CampaignError
        If the folder cannot be used, or holds a campaign with another task, parameters, seed or
        versions (it says what changed); if the task cannot be sent to workers; if an executor is
        broken.
    ValueError
        If an argument is not of its kind.

    Warns
    -----
    CampaignWarning
        If runs failed: how many, and the first.

    Notes
    -----
    A run also fails if its process dies (it is first tried once more, with nothing beside it), if
    it returns no dict, or if it returns other names than most runs. Whether a task is the same as
    before is decided by its module, name and source, see
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
    if not isinstance(seed, np.random.SeedSequence):
        seed = np.random.SeedSequence(whole_number("seed", seed, least=0))
    if flag("fresh", fresh) and out is None:
        raise ValueError("fresh=True removes a campaign from a folder, but `out` is not given")
    for name in other_versions:
        one_of("other_versions", name, ("trustlab", "Python", "numpy", "numba"))
    _check_jobs(n_jobs)
    start = perf_counter()
    with contextlib.ExitStack() as stack:
        storage: Any = Unsaved()
        if out is not None:
            from trustlab.campaign.folder import CampaignFolder
            from trustlab.campaign.identity import seed_text, task_identity

            identity = {"task": task_identity(task), "seed": seed_text(seed), "names": names}
            storage = CampaignFolder(out, identity, parameters, fresh, other_versions)
            stack.enter_context(contextlib.closing(storage))
        gaps = _gaps([chunk[:2] for chunk in storage.chunks], len(parameters))
        resumed = len(parameters) - sum(last - first for first, last in gaps)
        facts = {"executor": "none", "seconds_in_runs": 0.0}
        if gaps:
            from tqdm import tqdm

            from trustlab.campaign.dispatch import Dispatcher
            from trustlab.campaign.executors import workers_for

            workers = workers_for(task, seed, int(n_jobs), executor)
            # tqdm takes None as "only on a terminal".
            quiet = None if progress is None else not flag("progress", progress)
            with tqdm(total=len(parameters), initial=resumed, unit="run", disable=quiet) as bar:
                seconds = Dispatcher(workers, parameters, storage.store, bar).run(gaps)
            facts = {"executor": workers.name, "seconds_in_runs": seconds}
        from trustlab.campaign.table import assembled

        columns = {name: [values[name] for values in parameters] for name in names}
        table = assembled(range(len(parameters)), storage.outcomes(), columns)
    return _described(table, resumed, {"seconds": perf_counter() - start} | facts)


class Unsaved:
    """The outcomes of a campaign without a folder."""

    chunks: tuple = ()

    def __init__(self) -> None:
        self.stored: dict[int, list] = {}

    def store(self, first: int, parameters: object, outcomes: list) -> None:
        """Keep the outcomes of consecutive runs."""
        self.stored[first] = outcomes

    def outcomes(self) -> list:
        """Return the outcomes of all runs, in their order."""
        return [outcome for _, chunk in sorted(self.stored.items()) for outcome in chunk]


def _checked_task(task: object, parameters: Any) -> list[str]:
    """
    Return the names of the parameters; raise unless the task can be called with them and a seed.
    """
    if not callable(task):
        raise ValueError(
            "task must be a function called as task(**parameters, seed=…), got "
            f"{type(task).__name__}"
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
            f"task {called}{signature} cannot be called with {', '.join([*names, 'seed'])} as "
            f"named arguments: {error}; every task takes its parameters and `seed`, a "
            "numpy.random.SeedSequence"
        ) from None
    return names


def _check_jobs(n_jobs: object) -> None:
    whole = isinstance(n_jobs, int | np.integer) and not isinstance(n_jobs, bool)
    if not whole or n_jobs == 0:
        raise ValueError(
            "n_jobs must be a whole number of processes: 1 for this, -1 for all cores, got "
            f"{n_jobs!r}"
        )


def where_to_run(n_jobs: int | None, executor: object) -> dict:
    """Return these arguments of `run_campaign`: by default this process, or all of the executor."""
    if n_jobs is None:
        n_jobs = 1 if executor is None else -1
    return {"n_jobs": n_jobs, "executor": executor}


def _gaps(spans: list[tuple], runs: int) -> list[tuple[int, int]]:
    """Return first and end of what is still to be run."""
    gaps = []
    end = 0
    for first, last in spans:
        if first > end:
            gaps.append((end, first))
        end = last
    return [*gaps, (end, runs)] if end < runs else gaps


def _described(table: pd.DataFrame, resumed: int, facts: dict) -> pd.DataFrame:
    """Add to a table what its campaign was, and warn of failed runs."""
    failed = int(table["failed"].sum())
    words = f"{len(table):,} runs, {failed:,} failed"
    if failed:
        worst = table.loc[table["failed"], ["run", "error"]].iloc[0]
        words += f"; first run {worst['run']}: {worst['error']}"
        warn(
            f"{failed:,} of {len(table):,} runs failed; run {worst['run']}: {worst['error']} (see "
            "the columns failed, error and traceback)",
            CampaignWarning,
        )
    if resumed:
        words += f"; {resumed:,} were there already"
    facts = {"runs": len(table), "failed": failed, "resumed": resumed} | facts
    table.attrs = facts | {"summary": words}
    return table
