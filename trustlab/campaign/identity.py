"""What makes a task and its parameters the same as before."""

from __future__ import annotations

import ast
import functools
import hashlib
import inspect
import json
import textwrap
from collections.abc import Callable, Iterator, Mapping, Sequence
from numbers import Integral
from types import CodeType, FunctionType, MethodType

import numpy as np

from trustlab.campaign.worker import code_digest

__all__ = ["differences", "parameter_texts", "task_identity"]

PLAIN = (bool, int, float, str, bytes, type(None))


def task_identity(task: Callable) -> dict[str, str]:
    """
    Return what a task consists of, by name, as text.

    What counts: the source of the function, comments and layout apart, and of functions and classes of its module that it
    uses; default and bound arguments; values it closes over; plain values among the global names it uses (numbers, text,
    tuples of them). What does not: other modules, files, and global objects that are not plain. Lambdas, wrappers, and
    functions without source text are known by their compiled code, which changes with Python's version too.

    Parameters
    ----------
    task : callable
        The task.
    """
    parts: dict[str, str] = {}
    _add(task, parts, "task", [])
    return parts


def _name(function: object) -> str:
    return f"{getattr(function, '__module__', '?')}.{getattr(function, '__qualname__', type(function).__qualname__)}"


def _add(thing: object, parts: dict[str, str], role: str, seen: list) -> None:
    thing = getattr(thing, "py_func", thing)  # numba keeps the function there
    if isinstance(thing, functools.partial):
        parts[f"{role}: arguments bound"] = value_text((thing.args, thing.keywords))
        _add(thing.func, parts, role, seen)
    elif isinstance(thing, MethodType):
        parts[f"{role}: object of the method"] = value_text(thing.__self__)
        _add(thing.__func__, parts, role, seen)
    elif isinstance(thing, FunctionType):
        parts[f"{role}: name"] = _name(thing)
        _add_function(thing, parts, seen)
    elif inspect.isclass(thing) or inspect.isbuiltin(thing):
        parts[f"{role}: name"] = _name(thing)
        _add_class(thing, parts)
    else:
        parts[f"{role}: object"] = value_text(thing)
        _add_class(type(thing), parts)


def _add_class(thing: type, parts: dict[str, str]) -> None:
    source = _source(thing)
    if source:
        parts[f"source of {_name(thing)}"] = source


def _add_function(function: FunctionType, parts: dict[str, str], seen: list) -> None:
    if any(function is other for other in seen):
        return
    seen.append(function)
    name = _name(function)
    same = sum(_name(other) == name for other in seen)
    if same > 1:  # made by the same lines, with other values closed over
        name = f"{name} (number {same})"
    if hasattr(function, "__wrapped__"):
        name, source = f"the wrapper of {name}", ""
    else:
        source = "" if function.__name__ == "<lambda>" else _source(function)
    parts[f"source of {name}" if source else f"code of {name}"] = source or code_digest(function.__code__)
    if function.__defaults__ or function.__kwdefaults__:
        parts[f"defaults of {name}"] = value_text((function.__defaults__, function.__kwdefaults__))
    for variable, cell in zip(function.__code__.co_freevars, function.__closure__ or (), strict=True):
        try:
            value = cell.cell_contents
        except ValueError:  # not yet given a value
            continue
        value = getattr(value, "py_func", value)
        if isinstance(value, FunctionType):
            _add_function(value, parts, seen)
        else:
            parts[f"{variable} in {name}"] = value_text(value)
    for variable in sorted(_global_names(function.__code__) & function.__globals__.keys()):
        value = function.__globals__[variable]
        value = getattr(value, "py_func", value)
        if isinstance(value, FunctionType):
            if value.__module__ == function.__module__:
                _add_function(value, parts, seen)
        elif inspect.isclass(value):
            if value.__module__ == function.__module__:
                _add_class(value, parts)
        elif _is_plain(value):
            parts[f"{variable} in {name}"] = value_text(value)


def _global_names(code: CodeType) -> set[str]:
    """Return names that code may look up among globals; names of attributes come along."""
    inner = (_global_names(part) for part in code.co_consts if isinstance(part, CodeType))
    return set(code.co_names).union(*inner)


def _is_plain(value: object) -> bool:
    return isinstance(value, PLAIN) or (isinstance(value, tuple) and all(map(_is_plain, value)))


def _source(thing: object) -> str:
    """Return source without comments and layout; empty where it cannot be read."""
    try:
        text = textwrap.dedent(inspect.getsource(thing))
    except (OSError, TypeError):
        return ""
    try:
        return ast.unparse(ast.parse(text))
    except SyntaxError:
        return text


@functools.lru_cache(maxsize=1)
def _joblib_hash() -> Callable:
    import joblib

    return joblib.hash


def value_text(value: object) -> str:
    """
    Return a text that is the same for equal values: the value where it is plain, else its type and a digest.

    A value that cannot be pickled is known by its attributes; where it has none, by its type alone, so that a change of it
    is not seen. As a parameter such a value lets its run fail on record, so that no result is taken for another's.

    Parameters
    ----------
    value : object
        Any value.
    """
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, bool) or value is None or isinstance(value, str):
        return json.dumps(value)
    if isinstance(value, Integral):
        return str(int(value))
    if isinstance(value, float):
        return repr(float(value))
    if isinstance(value, bytes) and len(value) <= 80:
        return repr(value)
    short = isinstance(value, tuple | list | dict) and len(value) <= 20
    if short and isinstance(value, tuple | list):
        return f"{type(value).__name__}[{', '.join(map(value_text, value))}]"
    if short and type(value) is dict:
        return "{" + ", ".join(f"{value_text(k)}: {value_text(v)}" for k, v in value.items()) + "}"
    if isinstance(value, FunctionType | functools.partial | MethodType):
        digest = hashlib.sha256(json.dumps(task_identity(value)).encode()).hexdigest()[:32]
        return f"{_name(value)} {digest}"
    try:
        digest = _joblib_hash()(value)
    except Exception:  # pickling runs the value's own code, which may raise anything
        digest = (
            value_text(vars(value)) if getattr(value, "__dict__", None) else "of which no digest can be taken"
        )
    try:
        shown = repr(value)
    except Exception:  # so may its repr
        shown = ""
    plain = shown and len(shown) <= 80 and " at 0x" not in shown and "\n" not in shown
    return f"{shown if plain else type(value).__qualname__} {digest}"


def parameter_texts(parameters: Sequence[Mapping], names: list[str]) -> Iterator[str]:
    """
    Yield one text per run that is the same for equal parameters.

    Parameters
    ----------
    parameters : sequence of dict
        Parameters of all runs.
    names : list of str
        Their names.
    """
    known: dict[int, tuple[object, str]] = {}  # objects are held, so that their addresses stay theirs
    for values in parameters:
        texts = []
        for name in names:
            value = values[name]
            if isinstance(value, PLAIN):
                text = value_text(value)
            else:
                if id(value) not in known:
                    if len(known) >= 256:
                        known.clear()
                    known[id(value)] = (value, value_text(value))
                text = known[id(value)][1]
            texts.append(f"{name} = {text}")
        yield ", ".join(texts)


def differences(before: Mapping[str, str], now: Mapping[str, str]) -> list[str]:
    """
    Say in what two tasks differ.

    Parameters
    ----------
    before, now : dict of str
        What `task_identity` returned.
    """
    said = []
    for key in dict.fromkeys([*before, *now]):
        old, new = before.get(key), now.get(key)
        if old == new:
            continue
        if old is None:
            said.append(f"{key} is new")
        elif new is None:
            said.append(f"{key} is gone")
        elif key.startswith("source of"):
            said.append(f"{key} changed: {_first_line(old, new)}")
        elif key.startswith("code of"):
            said.append(f"{key} changed")
        else:
            said.append(f"{key} was {_cut(old)}, is {_cut(new)}")
    return said


def _first_line(old: str, new: str) -> str:
    before, now = old.splitlines(), new.splitlines()
    for a, b in zip(before, now, strict=False):
        if a != b:
            return f"“{_cut(a.strip())}” is now “{_cut(b.strip())}”"
    return f"{len(before)} lines then, {len(now)} now"


def _cut(text: str) -> str:
    return text if len(text) <= 120 else text[:117] + "…"
