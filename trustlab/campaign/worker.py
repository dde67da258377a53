"""What happens in a worker: a chunk of runs, one after the other."""

import copy
import hashlib
import importlib
import os
import pickle
import sys
import threading
import traceback
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from functools import lru_cache
from multiprocessing.connection import Connection
from numbers import Integral, Real
from time import perf_counter
from types import CodeType, FunctionType
from typing import Any, NamedTuple

import numpy as np

from trustlab.campaign.errors import CampaignError

# Names that neither parameters nor results may have: columns of the table, and the argument of the
# seed.
RESERVED = ("run", "seed", "failed", "error", "traceback", "returned")

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


def exit_with_parent(lifeline: Connection) -> None:
    """
    End this process when the one that holds the other end of a pipe ends, even where that one is
    killed.
    """

    def watch() -> None:
        with suppress(EOFError, OSError):
            # Nothing is ever sent: it returns when the system closes the other end
            lifeline.recv_bytes()
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def run_seed(seed: np.random.SeedSequence, run: int) -> np.random.SeedSequence:
    """Return the seed of one run: the child that `seed.spawn` would give at that index."""
    key = (*seed.spawn_key, seed.n_children_spawned + run)
    return np.random.SeedSequence(seed.entropy, spawn_key=key, pool_size=seed.pool_size)


def code_digest(code: CodeType) -> str:
    """Return a digest of compiled code that does not depend on where its source stands."""
    digest = hashlib.sha256()

    def add(part: CodeType) -> None:
        head = (part.co_code, part.co_names, part.co_varnames, part.co_freevars, part.co_cellvars)
        digest.update(
            repr((head, part.co_argcount, part.co_kwonlyargcount, part.co_flags)).encode()
        )
        for constant in part.co_consts:
            if isinstance(constant, CodeType):
                add(constant)
            elif isinstance(constant, frozenset):  # its order differs between processes
                digest.update(repr(sorted(map(repr, constant))).encode())
            else:
                digest.update(repr(constant).encode("utf-8", "backslashreplace"))

    add(code)
    return digest.hexdigest()


def pickled(what: str, value: object) -> bytes:
    """
    Return a value as bytes that any process can load, with functions of scripts and notebooks by
    value.
    """
    import cloudpickle

    try:
        return cloudpickle.dumps(value)
    except Exception as error:
        raise CampaignError(
            f"{what} cannot be sent to other processes: {type(error).__name__}: {error}; open "
            "files, locks and connections inside the task, or run with n_jobs=1"
        ) from error


def pickled_task(task: Callable) -> tuple[bytes, str | None]:
    """
    Return a task as bytes, and a digest of its code where workers import it by name from a module.
    """
    by_name = (
        isinstance(task, FunctionType)
        and task.__module__ != "__main__"
        and "<" not in task.__qualname__
    )
    return pickled("task", task), code_digest(task.__code__) if by_name else None


@lru_cache(maxsize=4)
def unpickled_task(data: bytes, digest: str | None) -> Callable:
    """
    Return the task that `pickled_task` made into bytes; a module imported in an earlier version is
    reloaded.
    """
    try:
        task = pickle.loads(data)
        if digest is not None and code_digest(task.__code__) != digest:
            importlib.reload(sys.modules[task.__module__])
            task = pickle.loads(data)
    except Exception as error:
        raise CampaignError(
            f"the task cannot be loaded in a worker: {type(error).__name__}: {error}; its module "
            "must be importable there: install it, or define the task in the script or notebook"
        ) from error
    if digest is not None and code_digest(task.__code__) != digest:
        raise CampaignError(
            f"workers find other code for {task.__module__}.{task.__qualname__} than the process "
            "that sent it: the file was edited after it was imported, or differs between "
            "machines; import it anew and start again"
        )
    return task


def run_pickled(data: bytes) -> tuple[list[Outcome], float]:
    """Run a chunk whose arguments come as bytes, so that Dask does not traverse them."""
    task, *rest = pickle.loads(data)
    return run_chunk(unpickled_task(*task), *rest)


def run_chunk(
    task: Callable, seed: np.random.SeedSequence, first: int, parameters: Sequence[Mapping]
) -> tuple[list[Outcome], float]:
    """
    Run a task with consecutive parameters; return what came of each run, and the seconds they took
    together.
    """
    began = perf_counter()
    _local.depth = getattr(_local, "depth", 0) + 1
    try:
        outcomes = [
            _outcome(task, values, run_seed(seed, run))
            for run, values in enumerate(parameters, first)
        ]
    finally:
        _local.depth -= 1
    return outcomes, perf_counter() - began


def _outcome(task: Callable, values: Mapping, seed: np.random.SeedSequence) -> Outcome:
    try:
        # A task that changes its arguments must not change those of other runs.
        own = {k: v if isinstance(v, PLAIN) else copy.deepcopy(v) for k, v in values.items()}
        return Outcome(_checked(task(**own, seed=seed), values))
    except (Exception, SystemExit) as error:
        return Outcome(None, _line(error), _traceback(error))


def _checked(results: object, parameters: Mapping) -> dict:
    """Return the results as plain Python values."""
    if not isinstance(results, Mapping):
        raise CampaignError(
            f"a task must return a dict of results by name, got {type(results).__name__}; return "
            "{'name': value}"
        )
    checked = {}
    for name, value in results.items():
        if not isinstance(name, str) or not name:
            raise CampaignError(f"results must have names that are text, got {name!r}")
        if name in RESERVED or name in parameters:
            what = "a parameter" if name in parameters else "a column of every campaign"
            raise CampaignError(
                f"result {name!r} has the name of {what}; return it under another name"
            )
        try:
            checked[name] = plain(value)
        except TypeError:
            raise CampaignError(
                f"result {name!r} must be a number, text, True, False or None, got "
                f"{type(value).__name__}; return one value under each name"
            ) from None
        if isinstance(value, str):
            value.encode()  # a lone surrogate cannot be written to a file
    if not checked:
        raise CampaignError("a task must return at least one result, got an empty dict")
    return checked


def plain(value: object) -> bool | int | float | str | None:
    """
    Return a number, text, truth value or None as Python's own; raise `TypeError` for anything else.
    """
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
    for kind, of in kinds:
        if isinstance(value, kind):
            return of(value)
    raise TypeError(f"{type(value).__name__} is no plain value")


def _line(error: BaseException) -> str:
    try:
        text = str(error)
    except Exception:  # the message is made by the task's own code, which may raise anything
        text = "(its message cannot be shown)"
    return _utf8(f"{type(error).__name__}: {text}" if text else type(error).__name__)


def _traceback(error: BaseException) -> str:
    """
    Return Python's text of a traceback, without source lines, which not every process can read.
    """
    whole = traceback.TracebackException.from_exception(error, lookup_lines=False)
    waiting = [whole]
    while waiting:
        part = waiting.pop()
        part.stack[:] = [
            traceback.FrameSummary(
                frame.filename, frame.lineno, frame.name, lookup_line=False, line=""
            )
            for frame in part.stack
            if frame.filename != __file__
        ]
        waiting += [cause for cause in (part.__cause__, part.__context__) if cause is not None]
    return _utf8("".join(whole.format()))


def _utf8(text: str) -> str:
    return text.encode("utf-8", "backslashreplace").decode()
