"""What happens in a worker: a chunk of runs, one after the other."""

import copy
import os
import pickle
import threading
import traceback
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from functools import lru_cache
from multiprocessing.connection import Connection
from numbers import Integral, Real
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np

from trustlab.campaign.errors import CampaignError

# Names that neither parameters nor results may have: columns of the table, and the argument of the
# seed.
RESERVED = ("run", "seed", "failed", "error", "traceback")

PLAIN = (bool, int, float, str, type(None))

_local = threading.local()


class Outcome(NamedTuple):
    """The outcome of one run: its results by name, or the error in one line and its traceback."""

    results: dict | None
    error: str | None = None
    traceback: str | None = None


def running_task() -> bool:
    """Return whether this thread is running a task of a campaign."""
    return getattr(_local, "depth", 0) > 0


def exit_with_parent(lifeline: Connection, *_: object) -> None:
    """End this process when the holder of the other end of a pipe ends, even if it is killed."""

    def watch() -> None:
        with suppress(EOFError, OSError):
            # Nothing is ever sent: it returns when the system closes the other end.
            lifeline.recv_bytes()
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def run_seed(seed: np.random.SeedSequence, run: int) -> np.random.SeedSequence:
    """Return the seed of one run: the child that `seed.spawn` would give at that index."""
    key = (*seed.spawn_key, seed.n_children_spawned + run)
    return np.random.SeedSequence(seed.entropy, spawn_key=key, pool_size=seed.pool_size)


def pickled(role: str, value: object) -> bytes:
    """Return a value as bytes for any process; functions of scripts and notebooks go by value."""
    import cloudpickle

    try:
        return cloudpickle.dumps(value)
    except Exception as error:
        raise CampaignError(
            f"{role} cannot be sent to other processes: {type(error).__name__}: {error}; open "
            "files, locks and connections inside the task, or run with n_jobs=1"
        ) from error


@lru_cache(maxsize=4)
def _unpickled_task(data: bytes) -> Callable:
    try:
        return pickle.loads(data)
    except Exception as error:
        raise CampaignError(
            f"the task cannot be loaded in a worker: {type(error).__name__}: {error}; its module "
            "must be importable there: install it, or define the task in the script or notebook"
        ) from error


def run_pickled(data: bytes) -> tuple[list[Outcome], float]:
    """Run a chunk whose arguments come as bytes, so that Dask does not traverse them."""
    task, *arguments = pickle.loads(data)
    return run_chunk(_unpickled_task(task), *arguments)


def run_chunk(
    task: Callable, seed: np.random.SeedSequence, first: int, parameters: Sequence[Mapping]
) -> tuple[list[Outcome], float]:
    """Run a task with consecutive parameters; return the outcomes and the seconds they took."""
    start = perf_counter()
    _local.depth = getattr(_local, "depth", 0) + 1
    try:
        outcomes = [
            _outcome(task, values, run_seed(seed, run))
            for run, values in enumerate(parameters, first)
        ]
    finally:
        _local.depth -= 1
    return outcomes, perf_counter() - start


def _outcome(task: Callable, values: Mapping, seed: np.random.SeedSequence) -> Outcome:
    try:
        # A task that changes its arguments must not change those of other runs.
        arguments = {k: v if isinstance(v, PLAIN) else copy.deepcopy(v) for k, v in values.items()}
        return Outcome(_checked(task(**arguments, seed=seed), values))
    except (Exception, SystemExit) as error:
        return Outcome(None, _line(error), _traceback(error))


def _checked(results: object, parameters: Mapping) -> dict:
    """Return the results as plain Python values."""
    if not isinstance(results, Mapping) or not results:
        shown = "an empty dict" if isinstance(results, Mapping) else type(results).__name__
        raise CampaignError(
            f"a task must return a dict of results by name, got {shown}; return {{'name': value}}"
        )
    plain_results = {}
    for name, value in results.items():
        if not isinstance(name, str) or not name:
            raise CampaignError(f"results must have names that are text, got {name!r}")
        if name in RESERVED or name in parameters:
            role = "a parameter" if name in parameters else "a column of every campaign"
            raise CampaignError(
                f"result {name!r} has the name of {role}; return it under another name"
            )
        try:
            plain_results[name] = plain(value)
        except TypeError:
            raise CampaignError(
                f"result {name!r} must be a number, text, True, False or None, got "
                f"{type(value).__name__}; return one value under each name"
            ) from None
    return plain_results


def plain(value: object) -> bool | int | float | str | None:
    """Return a plain value as Python's own type; raise `TypeError` for anything else."""
    if isinstance(value, np.ndarray) and value.ndim == 0:
        value = value[()]
    if value is None:
        return None
    kinds: tuple[tuple[Any, Callable], ...] = (
        (bool | np.bool_, bool),
        (str, str),
        (Integral, int),
        (Real, float),
    )
    for kind, convert in kinds:
        if isinstance(value, kind):
            return convert(value)
    raise TypeError(f"{type(value).__name__} is no plain value")


def _line(error: BaseException) -> str:
    try:
        text = str(error)
    except Exception:  # the message is made by the task's own code, which may raise anything
        text = "(its message cannot be shown)"
    return f"{type(error).__name__}: {text}" if text else type(error).__name__


def _traceback(error: BaseException) -> str:
    """Return Python's traceback without source lines, which not every process can read."""
    report = traceback.TracebackException.from_exception(error, lookup_lines=False)
    pending = [report]
    while pending:
        part = pending.pop()
        part.stack[:] = [
            traceback.FrameSummary(
                frame.filename, frame.lineno, frame.name, lookup_line=False, line=""
            )
            for frame in part.stack
            if frame.filename != __file__
        ]
        pending += [cause for cause in (part.__cause__, part.__context__) if cause is not None]
    return "".join(report.format())
