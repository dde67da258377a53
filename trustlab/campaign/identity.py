"""What makes a task and its parameters the same as before."""

import ast
import functools
import inspect
import io
import json
import pickle
import platform
import textwrap
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from importlib import metadata
from pathlib import Path
from types import CodeType, FunctionType, MethodType
from typing import Any

import numpy as np

from trustlab import __version__
from trustlab.campaign.imported import forget_sources, imported_files, package_of
from trustlab.models.digest import digest

PLAIN = (bool, int, float, str, bytes, type(None))


def task_identity(task: Callable) -> dict[str, str]:
    """
    Return what a task consists of, by name, as text.

    What counts: the source of the function, comments and layout apart, and of functions and classes
    of its module that it uses; default and bound arguments; values it closes over; plain values
    among the global names it uses (numbers, text, tuples of them); other modules of its package
    that its module imports, directly or not. What does not: other packages, files, and global
    objects that are not plain. Lambdas, wrappers, and functions without source text are known by
    their compiled code, which changes with Python's version too.
    """
    forget_sources()  # files may have been edited since the last campaign
    _code_digest.cache_clear()
    return _Identity(task).parts


def versions() -> dict[str, str]:
    """Return the versions of what computes a task's numbers beside the task itself."""
    return {
        "trustlab": __version__,
        "Python": platform.python_version(),
        "numpy": np.__version__,
        "numba": metadata.version("numba"),
    }


def _package_modules(module: str) -> dict[str, str]:
    """Return a digest of each other module of its package that a module imports, however far."""
    place = package_of(module)
    if place is None:
        return {}
    files = imported_files([place.file], place.root) - {place.file}
    names = {file.relative_to(place.root).as_posix(): file for file in sorted(files)}
    return {f"module {place.root.name}/{name}": _code_digest(file) for name, file in names.items()}


@functools.cache
def _code_digest(file: Path) -> str:
    """Return a digest of a module's source, comments and layout apart."""
    return digest(ast.unparse(ast.parse(file.read_bytes())))


class _Identity:
    """The parts of a task, collected from its function and what that uses."""

    def __init__(self, task: Callable):
        self.parts: dict[str, str] = {}
        self.seen: list[FunctionType] = []
        self._add("task", task)

    def _add(self, role: str, thing: Any) -> None:
        thing = getattr(thing, "py_func", thing)  # numba keeps the function there
        if isinstance(thing, functools.partial):
            self.parts[f"{role}: arguments bound"] = value_text((thing.args, thing.keywords))
            self._add(role, thing.func)
        elif isinstance(thing, MethodType):
            self.parts[f"{role}: object of the method"] = value_text(thing.__self__)
            self._add(role, thing.__func__)
        elif isinstance(thing, FunctionType):
            self.parts[f"{role}: name"] = _name(thing)
            self._add_function(thing)
        elif inspect.isclass(thing) or inspect.isbuiltin(thing):
            self.parts[f"{role}: name"] = _name(thing)
            self._add_class(thing)
        else:
            self.parts[f"{role}: object"] = value_text(thing)
            self._add_class(type(thing))

    def _add_class(self, thing: Any) -> None:
        source = _source(thing)
        if source:
            self.parts[f"source of {_name(thing)}"] = source

    def _add_function(self, function: FunctionType) -> None:
        if any(function is known for known in self.seen):
            return
        self.seen.append(function)
        self.parts |= _package_modules(function.__module__ or "")
        name = _name(function)
        same = sum(_name(known) == name for known in self.seen)
        if same > 1:  # made by the same lines, with other values closed over
            name = f"{name} (number {same})"
        # Of a wrapper, inspect would show the source of what it wraps; a lambda's source is a line
        # with more on it.
        wrapper = hasattr(function, "__wrapped__")
        name = f"the wrapper of {name}" if wrapper else name
        source = "" if wrapper or function.__name__ == "<lambda>" else _source(function)
        if source:
            self.parts[f"source of {name}"] = source
        else:
            self.parts[f"code of {name}"] = digest(code_text(function.__code__))
        if function.__defaults__ or function.__kwdefaults__:
            self.parts[f"defaults of {name}"] = value_text(
                (function.__defaults__, function.__kwdefaults__)
            )
        code, space = function.__code__, function.__globals__
        for variable, cell in zip(code.co_freevars, function.__closure__ or (), strict=True):
            try:
                value = cell.cell_contents
            except ValueError:  # not yet given a value
                continue
            value = getattr(value, "py_func", value)
            if isinstance(value, FunctionType):
                self._add_function(value)
            else:
                self.parts[f"{variable} in {name}"] = value_text(value)
        for variable in sorted(_global_names(code) & space.keys()):
            value = getattr(space[variable], "py_func", space[variable])
            if _is_plain(value):
                self.parts[f"{variable} in {name}"] = value_text(value)
            elif getattr(value, "__module__", None) == function.__module__:
                if isinstance(value, FunctionType):
                    self._add_function(value)
                elif inspect.isclass(value):
                    self._add_class(value)


def _name(function: object) -> str:
    name = getattr(function, "__qualname__", type(function).__qualname__)
    return f"{getattr(function, '__module__', '?')}.{name}"


def code_text(code: CodeType) -> str:
    """Return a text of compiled code that does not depend on where its source stands."""
    head = (code.co_code, code.co_names, code.co_varnames, code.co_freevars, code.co_flags)
    constants = [
        code_text(constant) if isinstance(constant, CodeType) else value_text(constant)
        for constant in code.co_consts
    ]
    return repr((head, constants))


def _global_names(code: CodeType) -> set[str]:
    """Return names that code may look up among globals, which includes names of attributes."""
    inner = (_global_names(part) for part in code.co_consts if isinstance(part, CodeType))
    return set(code.co_names).union(*inner)


def _is_plain(value: object) -> bool:
    return isinstance(value, PLAIN) or (isinstance(value, tuple) and all(map(_is_plain, value)))


def _source(thing: Any) -> str:
    """Return source without comments and layout; empty where it cannot be read."""
    text = ""
    with suppress(OSError, TypeError, SyntaxError):
        text = textwrap.dedent(inspect.getsource(thing))
        text = ast.unparse(ast.parse(text))
    return text


def value_text(value: object) -> str:
    """
    Return a text that is the same for equal values: the value where it is plain, else its type and
    a digest.

    A value that cannot be pickled is known by its attributes; where it has none, by its type alone,
    so that a change of it is not seen. As a parameter such a value lets its run fail on record, so
    that no result is taken for another's.
    """
    if isinstance(value, np.generic):
        value = value.item()
    if value is None or isinstance(value, int | str):  # a bool is an int
        return json.dumps(value)
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
        return f"{_name(value)} {digest(json.dumps(_Identity(value).parts))}"
    try:
        content = _pickle_digest(value)
    except Exception:  # pickling runs the value's own code, which may raise anything
        attributes = getattr(value, "__dict__", None)
        content = value_text(attributes) if attributes else "of which no digest can be taken"
    try:
        shown = repr(value)
    except Exception:  # so may its repr
        shown = ""
    # A repr that holds an address or a set differs between processes.
    plain = shown and len(shown) <= 80 and not any(sign in shown for sign in (" at 0x", "{", "\n"))
    return f"{shown if plain else type(value).__qualname__} {content}"


def seed_text(seed: np.random.SeedSequence) -> str:
    """
    Return the text of a seed: the number where it is no more than that, else all that it consists
    of.
    """
    bare = np.random.SeedSequence(seed.entropy).state == seed.state
    return value_text(seed.entropy if bare else seed.state)


class _Pickler(pickle.Pickler):
    """
    Pickles equal values to equal bytes: no memo, which depends on which parts are one object, and
    sorted sets.
    """

    def persistent_id(self, value: object) -> tuple | None:
        return (
            ("set", sorted(map(value_text, value))) if isinstance(value, set | frozenset) else None
        )


def _pickle_digest(value: object) -> str:
    buffer = io.BytesIO()
    pickler = _Pickler(buffer, protocol=4)
    pickler.fast = True  # without memo; values that contain themselves are refused
    pickler.dump(value)
    return digest(buffer.getvalue())


def parameter_texts(parameters: Sequence[Mapping], names: list[str]) -> Iterator[str]:
    """Yield one text per run that is the same for equal parameters."""
    # Runs often share an object, such as a model. Objects are held, so that their ids stay theirs.
    known: dict[int, tuple[object, str]] = {}

    def text(value: object) -> str:
        if isinstance(value, PLAIN):
            return value_text(value)
        if id(value) not in known:
            if len(known) >= 256:
                known.clear()
            known[id(value)] = (value, value_text(value))
        return known[id(value)][1]

    for values in parameters:
        yield ", ".join(f"{name} = {text(values[name])}" for name in names)


def differences(before: Mapping[str, str], now: Mapping[str, str]) -> list[str]:
    """Say in what two tasks differ, given what `task_identity` returned for each."""
    said = []
    for key in dict.fromkeys([*before, *now]):
        old, new = before.get(key), now.get(key)
        if old == new:
            continue
        if old is None or new is None:
            said.append(f"{key} is {'new' if old is None else 'gone'}")
        elif key.startswith(("source of", "code of", "module ")):
            said.append(f"{key} changed")
        else:
            said.append(f"{key} was {old:.120}, is {new:.120}")
    return said
