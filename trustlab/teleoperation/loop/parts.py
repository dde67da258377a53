"""
The exchangeable parts of the loop: functions of its state, called by their addresses.

The loop is compiled once; a part is a C function void(STATE *, SETUP *). A built-in one is compiled
and cached like the loop. A user's function is compiled where numba can, which compiles nothing
else; where numba cannot, its address is that of a callback into Python.
"""

import ctypes
import inspect
from collections.abc import Callable
from functools import cached_property, lru_cache
from types import FunctionType
from typing import Any

import numba
import numpy as np
from numba import types
from numba.core import errors
from numba.extending import intrinsic, is_jitted

from trustlab.models.checks import did_you_mean, shown
from trustlab.models.compiled import cfunc
from trustlab.teleoperation.loop.state import PORTS, SETUP, STATE

SIGNATURE = types.void(numba.from_dtype(STATE), numba.from_dtype(SETUP))
CALLBACK = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_void_p)


@intrinsic
def call(typing_context, address, state, setup):
    """Call the part at an address with two records, which are passed as pointers."""

    def generate(context, builder, signature, arguments):
        from llvmlite import ir

        pointer = ir.IntType(8).as_pointer()
        kind = ir.FunctionType(ir.VoidType(), [pointer, pointer]).as_pointer()
        both = [builder.bitcast(record, pointer) for record in arguments[1:]]
        builder.call(builder.inttoptr(arguments[0], kind), both)
        return context.get_dummy_value()

    return types.void(types.int64, state, setup), generate


class Part:
    """A built-in part, compiled when it is first used."""

    way = "built-in"
    error: BaseException | None = None

    def __init__(self, function: Callable):
        self.function, self.__doc__ = function, function.__doc__

    @cached_property
    def address(self) -> int:
        """Where the C function stands."""
        self.kept = cfunc(SIGNATURE, self.function, error_model="numpy")
        return self.kept.address

    def raised(self) -> BaseException | None:
        """Return what the part raised in this sample: nothing, for built-in ones do not."""
        return self.error


class UserPart(Part):
    """
    A user's function as a part, compiled where numba can.

    A function takes the state, or the state and its own memory, an array of 16 numbers that are
    zero at the start.
    """

    def __init__(self, port: str, function: Callable, view):
        self.port = port
        self.function = function
        self.view = view
        self.kept, self.way = compiled(port, function)
        if self.kept is None:
            self.part = _setter(port, _with_memory(port, function))
            self.kept = CALLBACK(self._called_back)

    @cached_property
    def address(self) -> int:
        """Where the C function, or the callback, stands."""
        return (
            self.kept.address
            if self.way == "compiled"
            else ctypes.cast(self.kept, ctypes.c_void_p).value or 0
        )

    def _called_back(self, state: int, setup: int) -> None:
        # An exception cannot pass through compiled code: it is kept, and the loop stops at the
        # flag.
        try:
            self.part(self.view, None)
        except BaseException as error:
            self.error, self.view.raised = error, True

    def raised(self) -> BaseException | None:
        """
        Return what the function raised in this sample; a compiled one is called again in Python to
        find out.
        """
        if self.error is None:
            try:
                _setter(self.port, _with_memory(self.port, _plain(self.function)))(
                    self.view.copy(), None
                )
            except Exception as error:
                return error
        return self.error


@lru_cache(maxsize=64)
def compiled(port: str, function: Callable) -> tuple[Any, str]:
    """
    Return a user's function as a C function and how it runs; None where numba cannot compile it.
    """
    if not isinstance(_plain(function), FunctionType):
        return None, f"Python: a {type(function).__name__}, not a plain function"
    try:
        own = function if is_jitted(function) else numba.njit(boundscheck=True)(function)
        set_fields = numba.njit(boundscheck=True)(_setter(port, _with_memory(port, own)))

        def part(state, setup):
            # numba knows no narrower class; the loop stops at the flag, and `raised` finds out what
            # it was
            try:
                set_fields(state, setup)
            except Exception:
                state.raised = True

        return numba.cfunc(SIGNATURE)(part), "compiled"
    except (
        errors.NumbaError,
        NotImplementedError,
        KeyError,
    ) as error:  # the last for a field that the state has not
        lines = [line.strip() for line in str(error).splitlines() if line.strip()]
        return (
            None,
            "Python: numba cannot compile it "
            f"({shown(next(iter(lines[1:]), type(error).__name__))})",
        )


def _plain(function: Callable) -> Callable:
    """Return a function of numba as the Python function that it was."""
    return getattr(function, "py_func", function)


def _with_memory(port: str, function: Callable) -> Callable:
    """Return a function of the state alone; one that takes two arguments is given its memory."""
    memory = f"{port}_memory"
    if len(inspect.signature(_plain(function)).parameters) < 2:
        return function
    own = numba.njit if is_jitted(function) else (lambda same: same)
    return own(lambda state: function(state, state[memory]))


def _setter(port: str, function: Callable) -> Callable:
    """Return the part that sets the port's fields from what a function returns."""
    first, *rest = PORTS[port]
    second = rest[0] if rest else ""

    def numbers(state, setup):
        state[first], state[second] = function(state)

    def vector(state, setup):
        found, field = function(state), state[first]
        if len(found) != 3:
            raise ValueError("three numbers are wanted, for x, y and z")
        field[0] = found[0]
        field[1] = found[1]
        field[2] = found[2]

    def vectors(state, setup):
        (one, two), here, there = function(state), state[first], state[second]
        if len(one) != 3 or len(two) != 3:
            raise ValueError("position and velocity are wanted, three numbers each, for x, y and z")
        here[0] = one[0]
        here[1] = one[1]
        here[2] = one[2]
        there[0] = two[0]
        there[1] = two[1]
        there[2] = two[2]

    if not STATE[first].shape:
        return numbers
    return vectors if rest else vector


def part_of(port: str, part: Part | Callable, view) -> Part:
    """
    Return a built-in part as it is, and a user's function as a part of the loop with this state.
    """
    if isinstance(part, Part):
        return part
    if not callable(part):
        raise ValueError(f"{port} must be a function of the state, got {shown(part)}")
    return UserPart(port, part, view)


class View:
    """
    The state as Python sees it: numbers by name, vectors as arrays over the same memory.

    Unlike those of NumPy's own records, whose attributes hide fields (`device` is one), its numbers
    are Python's, which raise where they are divided by zero, as in compiled functions.
    """

    def __init__(self, states: np.ndarray):
        self.__dict__["_fields"] = {
            name: states[name][0] if STATE[name].shape else states[name] for name in STATE.names
        }
        self.__dict__["_states"] = states

    def __getitem__(self, name: str):
        field = self._fields[name]
        return field if STATE[name].shape else field.item()

    def __setitem__(self, name: str, value) -> None:
        self._fields[name][:] = value

    def __getattr__(self, name: str):
        if name not in STATE.names:
            raise AttributeError(f"the state has no {name!r}{did_you_mean(name, STATE.names)}")
        return self[name]

    def __setattr__(self, name: str, value) -> None:
        self[name] = value

    def copy(self) -> "View":
        """Return the state as it is now, which later samples do not change."""
        return View(self._states.copy())
