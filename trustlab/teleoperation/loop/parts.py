"""
State and parts of the loop: what every sample reads and changes, and functions that do so.

The loop is compiled once; a part is a C function void(STATE *, SETUP *), called by its address. A
built-in one is compiled and cached like the loop. A user's function is compiled where numba can,
which compiles nothing else; where numba cannot, its address is that of a callback into Python. A
user's function gets the state without the ledger: no part can write to what the guards rely on.
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

from trustlab.allocation.blending import DEGREE
from trustlab.models.checks import did_you_mean, shown
from trustlab.models.compiled import cfunc
from trustlab.teleoperation.ports import device as haptic, waves
from trustlab.teleoperation.records import columns_of, record

# What a user may replace, and which fields of the state each part sets.
PORTS = {
    "scheme": ("alpha", "beta"),
    "trust": ("trust_hr", "trust_rh"),
    "feedback": ("guiding",),
    "autonomy": ("u_a",),
    "operator": ("wanted",),
    "vehicle": ("robot", "velocity"),
}

# Numbers that every part keeps from sample to sample, zero at the start.
MEMORY = 16

# Energy that has come in at the ports and been dissipated since the start [J], and what the
# operator's port may spend. The guards rely on it; the log and parts have copies.
LEDGER = record(numbers="operator dissipated channel robot port target account")

# A row of the log: the state before the sample and the signals of the sample.
LOG = np.dtype(
    record(
        vectors="reference robot velocity device device_velocity r_m f_h f_m r_s f_s u_h u_a u_i",
        numbers=(
            "alpha beta p_r p_h trust_hr trust_rh path_error port_share "
            "energy_operator energy_device energy_dissipated energy_channel energy_robot"
        ),
    ).descr
    + record(vectors="guide", numbers="energy_port energy_target").descr
)

COLUMNS = columns_of(LOG)

# What comes from outside in one sample: where the robot should be and how fast it should move, how
# far the target moves on within the operator's preview, noise of the hand, a force added to the
# hand's, where the hand wants to be and α where they are given (NaN elsewhere), and whether the
# controller's camera finds its target.
INPUT = record(
    vectors="reference reference_velocity ahead motor pushed hand",
    numbers="alpha",
    flags="detected",
)

# What is looked up later: errors as they were seen, energies as they were sent, performance that
# leaves its window.
HISTORY = record(vectors="error", numbers="good_r good_h")

# Room that scheme OMI computes in: what lies ahead, the cost as a series in α, its derivative.
BLENDING = np.dtype(
    [("ahead", float, (3, 5)), ("series", float, DEGREE + 1), ("slope", float, DEGREE + 2)]
)

# The state proper: lagging wish of the hand, integral of the controller, acceleration; and what
# came with this sample.
KEPT = "acceleration wish integral reference_velocity pushed motor hand error"
# What has arrived by now: the picture of camera and operator (and the one before), waves, and the
# device's output.
ARRIVED = "picture picture_before seen seen_before v_l v_r arrived"
# What the parts of a step tell each other.
SIGNALS = (
    "wanted force free_output stretch guiding pull free_velocity compliance u_l u_r middle command"
)
BOUNDS = "sample_time alpha_min alpha_max beta_min beta_max"
# The whole state of the loop, which every part reads and changes; it begins with the row of the
# log.
STATE = np.dtype(
    LOG.descr
    + record(
        vectors=f"{KEPT} {ARRIVED} {SIGNALS}",
        numbers=(f"t {BOUNDS} effort sum_r sum_h good_r good_h leaving_r leaving_h"),
        counts="waited samples",
    ).descr
    + [(f"{port}_memory", float, MEMORY) for port in PORTS]
    + record(flags="sees finds found_before raised").descr
    + [("ledger", LEDGER), ("blending", BLENDING)]
)
# What a user's function sees of it.
SHARED = STATE[list(STATE.names[:-2])]

# Exact one-sample matrices of (position, velocity, acceleration) per axis.
VEHICLE = np.dtype([("phi", float, (3, 3, 3)), ("gamma", float, (3, 3))])

# One axis of the haptic device in its hand.
DEVICE = record(numbers=" ".join(haptic.Device._fields))

# A `TrustModel` for one sample time; `gain` is b/a.
TRUST = record(numbers="decay gain p_min p_max t_min t_max")

# Channel, guidance, trust, scales and measures of performance; see `LoopSettings`.
NUMBERS = record(
    numbers="force_scaling gain guidance steepness command_range error_range", counts="window"
)
LOOP = np.dtype([*NUMBERS.descr, ("trust_hr", TRUST), ("trust_rh", TRUST)])

# The simulated hand and eye: gains on the error seen, delay in samples, lag, impedance, and
# handling of α; `learned` is the share of what is new, per sample, in what an operator knows of the
# channel.
HAND = record(
    numbers="proportional derivative compensation crossover learned decay reach stiffness "
    "damping noise shift fatigue",
    counts="delay patience",
)

# The autonomous controller (PID on what the camera saw `delay` samples ago), and half its picture's
# width.
AUTONOMY = record(numbers="proportional integral derivative reach picture", counts="delay")

# One end of the channel: what multiplies velocity or force and waves, see `OperatorEnd` and
# `RobotEnd`.
END = record(numbers=" ".join(waves.OperatorEnd._fields))

# What stays the same during a run; `parts` holds the addresses of the compiled parts.
SETUP = np.dtype(
    [
        ("sample_time", float),
        ("loop", LOOP),
        ("hand", HAND),
        ("auto", AUTONOMY),
        ("device", DEVICE, 3),
        ("admittance", float, 3),
        ("near", END),
        ("far", END),
        ("vehicle", VEHICLE),
        ("blend", float, (3, DEGREE + 1, 5, 5)),
        ("budget_energy", float),
        ("budget_power", float),
        ("guard", int),
        ("read_out", int),
        ("channel", int),
        ("parts", record(counts=f"guidance {' '.join(PORTS)}")),
    ]
)


SIGNATURE = types.void(numba.from_dtype(STATE), numba.from_dtype(SETUP))
USERS = types.void(numba.from_dtype(SHARED), numba.from_dtype(SETUP))
CALLBACK = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_void_p)


@intrinsic
def call(typing_context, address, state, setup):
    """Call the part at an address with two records, which are passed as pointers."""

    def generate(context, builder, signature, arguments):
        from llvmlite import ir

        pointer = ir.IntType(8).as_pointer()
        kind = ir.FunctionType(ir.VoidType(), [pointer, pointer]).as_pointer()
        records = [builder.bitcast(record, pointer) for record in arguments[1:]]
        builder.call(builder.inttoptr(arguments[0], kind), records)
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
        self.compiled = cfunc(SIGNATURE, self.function, error_model="numpy")
        return self.compiled.address

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
        self.compiled, self.way = compiled(port, function)
        if self.compiled is None:
            self.part = _setter(port, _with_memory(port, function))
            self.compiled = CALLBACK(self._called_back)

    @cached_property
    def address(self) -> int:
        """Where the C function, or the callback, stands."""
        return (
            self.compiled.address
            if self.way == "compiled"
            else ctypes.cast(self.compiled, ctypes.c_void_p).value or 0
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
        jitted = function if is_jitted(function) else numba.njit(boundscheck=True)(function)
        set_fields = numba.njit(boundscheck=True)(_setter(port, _with_memory(port, jitted)))

        def part(state, setup):
            # numba knows no narrower class; the loop stops at the flag, and `raised` finds out what
            # it was
            try:
                set_fields(state, setup)
            except Exception:
                state.raised = True

        return numba.cfunc(USERS)(part), "compiled"
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

    def with_memory(state):
        return function(state, state[memory])

    return numba.njit(with_memory) if is_jitted(function) else with_memory


def _setter(port: str, function: Callable) -> Callable:
    """Return the part that sets the port's fields from what a function returns."""
    first, *rest = PORTS[port]
    second = rest[0] if rest else ""

    def numbers(state, setup):
        state[first], state[second] = function(state)

    def vector(state, setup):
        values, field = function(state), state[first]
        if len(values) != 3:
            raise ValueError("three numbers are wanted, for x, y and z")
        field[0] = values[0]
        field[1] = values[1]
        field[2] = values[2]

    def vectors(state, setup):
        place, speed = function(state)
        position, velocity = state[first], state[second]
        if len(place) != 3 or len(speed) != 3:
            raise ValueError("position and velocity are wanted, three numbers each, for x, y and z")
        position[0] = place[0]
        position[1] = place[1]
        position[2] = place[2]
        velocity[0] = speed[0]
        velocity[1] = speed[1]
        velocity[2] = speed[2]

    if not SHARED[first].shape:
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
    The state as Python sees it, without the ledger: numbers by name, vectors as arrays over the
    same memory.

    Unlike those of NumPy's own records, whose attributes hide fields (`device` is one), its numbers
    are Python's, which raise where they are divided by zero, as in compiled functions.
    """

    def __init__(self, states: np.ndarray, kind: np.dtype = SHARED):
        self.__dict__["_fields"] = {
            name: states[name][0] if kind[name].shape else states[name] for name in kind.names
        }
        self.__dict__["_states"] = states
        self.__dict__["_kind"] = kind

    def __getitem__(self, name: str):
        field = self._fields[name]
        return field if field.size > 1 else field.item()

    def __setitem__(self, name: str, value) -> None:
        self._fields[name][:] = value

    def __getattr__(self, name: str):
        if name not in self._fields:
            raise AttributeError(f"the state has no {name!r}{did_you_mean(name, self._fields)}")
        return self[name]

    def __setattr__(self, name: str, value) -> None:
        self[name] = value

    def copy(self) -> "View":
        """Return the state as it is now, which later samples do not change."""
        return View(self._states.copy(), self._kind)
