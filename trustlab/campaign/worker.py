"""What happens in a worker: a chunk of runs, one after the other."""

from __future__ import annotations

import copy
import hashlib
import importlib
import os
import pickle
import sys
import threading
import traceback
from collections.abc import Callable, Mapping
from functools import lru_cache
from numbers import Integral, Real
from time import perf_counter, sleep
from types import CodeType, FunctionType

import numpy as np

from trustlab.campaign.errors import CampaignError

__all__ = [
    "as_bytes",
    "code_digest",
    "end_with",
    "inside",
    "loaded",
    "packed",
    "run_chunk",
    "run_packed",
    "run_seed",
]

RESERVED = ("run", "seed", "failed", "error", "traceback", "returned")
"""Names that neither parameters nor results may have: columns of the table, and the argument of the seed."""

PLAIN = (bool, int, float, str, type(None))

_local = threading.local()


def inside() -> bool:
    """Return whether this thread is running a task of a campaign."""
    return getattr(_local, "depth", 0) > 0


def end_with(parent: int) -> None:
    """
    End this process within a second or so of the one that started it, which may be killed without a word.

    Parameters
    ----------
    parent : int
        Its process id.
    """

    def watch() -> None:
        while os.getppid() == parent:
            sleep(0.5)
        os._exit(1)

    if os.getppid() == parent:  # with a launcher between the two, as on Windows, this cannot be told
        threading.Thread(target=watch, daemon=True).start()


def run_seed(seed: tuple, run: int) -> np.random.SeedSequence:
    """
    Return the seed of one run: the child that `spawn` gives at that index.

    Parameters
    ----------
    seed : tuple
        Entropy, spawn key, pool size and how many children were spawned before.
    run : int
        Index of the run.
    """
    entropy, key, pool_size, before = seed
    return np.random.SeedSequence(entropy, spawn_key=(*key, before + run), pool_size=pool_size)


def code_digest(code: CodeType) -> str:
    """
    Return a digest of compiled code that does not depend on where the source stands.

    Parameters
    ----------
    code : types.CodeType
        Code of a function.
    """
    digest = hashlib.sha256()

    def add(part: CodeType) -> None:
        head = (part.co_code, part.co_names, part.co_varnames, part.co_freevars, part.co_cellvars)
        digest.update(repr((head, part.co_argcount, part.co_kwonlyargcount, part.co_flags)).encode())
        for constant in part.co_consts:
            if isinstance(constant, CodeType):
                add(constant)
            elif isinstance(constant, frozenset):
                digest.update(repr(sorted(map(repr, constant))).encode())
            else:
                digest.update(repr(constant).encode("utf-8", "backslashreplace"))

    add(code)
    return digest.hexdigest()


def as_bytes(what: str, value: object) -> bytes:
    """
    Return a value as bytes that any process can load, with functions of scripts and notebooks by value.

    Parameters
    ----------
    what : str
        What it is, for the error.
    value : object
        The value.

    Raises
    ------
    CampaignError
        If it cannot be pickled.
    """
    try:
        import cloudpickle
    except ImportError:  # joblib before 1.6 carries its own
        from joblib.externals import cloudpickle

    try:
        return cloudpickle.dumps(value)
    except Exception as error:
        raise CampaignError(
            f"{what} cannot be sent to other processes: {type(error).__name__}: {error}; open files, locks and "
            "connections inside the task, or run with n_jobs=1"
        ) from error


def packed(task: Callable) -> tuple[bytes, str | None]:
    """
    Return a task as bytes that any process can load, and a digest of its code where it is a function of a module.

    Parameters
    ----------
    task : callable
        The task; functions of scripts and notebooks, closures and lambdas go by value.

    Raises
    ------
    CampaignError
        If it cannot be pickled.
    """
    data = as_bytes("task", task)
    by_name = (
        isinstance(task, FunctionType) and task.__module__ != "__main__" and "<" not in task.__qualname__
    )
    return data, code_digest(task.__code__) if by_name else None


@lru_cache(maxsize=4)
def loaded(data: bytes, digest: str | None) -> Callable:
    """
    Return the task that `packed` made into bytes.

    Parameters
    ----------
    data : bytes
        The pickled task.
    digest : str or None
        Digest of its code: a worker that imported an earlier version of its module imports it again.

    Raises
    ------
    CampaignError
        If the task cannot be loaded here or its code is another than that of the process that sent it.
    """
    try:
        task = pickle.loads(data)
        if digest is not None and code_digest(task.__code__) != digest:
            importlib.reload(sys.modules[task.__module__])
            task = pickle.loads(data)
    except Exception as error:
        raise CampaignError(
            f"the task cannot be loaded in a worker: {type(error).__name__}: {error}; its module must be importable "
            "there: install it, or define the task in the script or notebook"
        ) from error
    if digest is not None and code_digest(task.__code__) != digest:
        raise CampaignError(
            f"workers find other code for {task.__module__}.{task.__qualname__} than the process that sent it: the file "
            "was edited after it was imported, or differs between machines; import it anew and start again"
        )
    return task


def run_packed(data: bytes) -> tuple[list[tuple], float]:
    """
    Run a chunk that came as bytes, so that nothing between here and there takes it apart.

    Parameters
    ----------
    data : bytes
        The arguments of `run_chunk`, pickled.
    """
    return run_chunk(*pickle.loads(data))


def run_chunk(
    task: Callable | tuple[bytes, str | None], seed: tuple, first: int, parameters: list[Mapping]
) -> tuple[list[tuple], float]:
    """
    Run a task with consecutive parameters and return what came of each.

    Parameters
    ----------
    task : callable or tuple
        The task, or what `packed` made of it.
    seed : tuple
        As in `run_seed`.
    first : int
        Index of the first run.
    parameters : list of dict
        Parameters of the runs.

    Returns
    -------
    outcomes : list of tuple
        For each run the results by name, or None; the error in a line, or None; the traceback, or None.
    seconds : float
        How long the runs took.
    """
    if isinstance(task, tuple):
        task = loaded(*task)
    outcomes, began = [], perf_counter()
    _local.depth = getattr(_local, "depth", 0) + 1
    try:
        for run, values in enumerate(parameters, first):
            outcomes.append(_outcome(task, values, run_seed(seed, run)))
    finally:
        _local.depth -= 1
    return outcomes, perf_counter() - began


def _outcome(task: Callable, values: Mapping, seed: np.random.SeedSequence) -> tuple:
    try:
        own = {k: v if isinstance(v, PLAIN) else copy.deepcopy(v) for k, v in values.items()}
        result = task(**own, seed=seed)
        return _checked(result, values), None, None
    except (Exception, SystemExit) as error:
        return None, _line(error), _trace(error)


def _checked(result: object, parameters: Mapping) -> dict:
    """Return the results as plain Python values."""
    if not isinstance(result, Mapping):
        raise CampaignError(
            f"a task must return a dict of results by name, got {type(result).__name__}; return {{'name': value}}"
        )
    checked = {}
    for name, value in result.items():
        if not isinstance(name, str) or not name:
            raise CampaignError(f"results must have names that are text, got {name!r}")
        if name in RESERVED or name in parameters:
            what = "a parameter" if name in parameters else "a column of every campaign"
            raise CampaignError(f"result {name!r} has the name of {what}; return it under another name")
        checked[name] = _plain(name, value)
    if not checked:
        raise CampaignError("a task must return at least one result, got an empty dict")
    return checked


def _plain(name: str, value: object) -> bool | int | float | str | None:
    if isinstance(value, np.ndarray) and value.ndim == 0:
        value = value[()]
    if value is None:
        return None
    if isinstance(value, bool | np.bool_):
        return bool(value)
    if isinstance(value, str):
        str(value).encode()
        return str(value)
    if isinstance(value, Integral):
        return int(value)
    if isinstance(value, Real):
        return float(value)
    raise CampaignError(
        f"result {name!r} must be a number, text, True, False or None, got {type(value).__name__}; return one value "
        "under each name"
    )


def _line(error: BaseException) -> str:
    try:
        text = str(error)
    except Exception:  # the message is made by the task's own code, which may raise anything
        text = "(its message cannot be shown)"
    return _utf8(f"{type(error).__name__}: {text}" if text else type(error).__name__)


def _utf8(text: str) -> str:
    return text.encode("utf-8", "backslashreplace").decode()


def _trace(error: BaseException) -> str:
    """Return files, lines and functions, without source text, which not every process can read."""
    parts, seen = [], set()
    while error is not None and id(error) not in seen:
        seen.add(id(error))
        frames = [
            traceback.FrameSummary(f.filename, f.lineno, f.name, lookup_line=False, line="")
            for f in traceback.extract_tb(error.__traceback__)
            if f.filename != __file__
        ]
        lines = [f'  File "{f.filename}", line {f.lineno}, in {f.name}\n' for f in frames]
        parts.append("Traceback (most recent call last):\n" + "".join(lines) + _line(error) + "\n")
        cause = error.__cause__
        between = (
            "\nThe exception above caused the following one:\n\n"
            if cause
            else "\nAnd then, while it was handled:\n\n"
        )
        error = cause or (None if error.__suppress_context__ else error.__context__)
        if error is not None:
            parts.append(between)
    return _utf8("".join(reversed(parts)))
