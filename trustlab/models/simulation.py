"""Runs a compiled kernel that can pause at any sample, so that Python decides in between."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numba
import numpy as np

from trustlab.models.checks import did_you_mean, finite_array, finite_number

# What a kernel returns in place of a block where the run comes to its end.
END = -2

# How far away a hand is taken to be at the most [m], far beyond any device.
FARTHEST_HAND = 10.0

# Kernels as compiled for some kinds of arguments. numba would look for them at every call, by the
# types of all records, which takes some hundred times as long as a sample.
COMPILED: dict[tuple, Callable] = {}


class DivergenceError(ArithmeticError):
    """
    A simulation grew without bound; the message names the block and when. `.session` holds the run
    so far, where two samples were done.
    """

    session: Any = None


class PartError(ValueError):
    """
    A part of a simulation raised an error or returned what cannot be; the message says which and
    when. `.session` holds the run so far, where two samples were done.
    """

    session: Any = None


def asked(where: str, function: Callable, *arguments: Any, **more: Any) -> Any:
    """Return what a function of the user's returns; an error says where it was called."""
    try:
        return function(*arguments, **more)
    except Exception as error:
        raise PartError(f"{where}: {type(error).__name__}: {error}") from error


class View:
    """
    Records by name: numbers as Python's, vectors as arrays over the same memory. Nothing can be
    written through it, so that no function changes what the guards rely on.

    `memory` is a dictionary for whoever reads: empty at the start of a run.
    """

    def __init__(self, records: np.ndarray):
        self.__dict__.update(_records=records, _numbers={}, memory={})
        self._add(records)

    def _add(self, records: np.ndarray) -> None:
        for name in records.dtype.names:
            part = records[name]
            part.flags.writeable = False
            if part.dtype.names:
                self._add(part)
            elif part.ndim > 1:
                self.__dict__[name] = part[0]
            else:
                self._numbers[name] = part.data

    def __getattr__(self, name: str) -> Any:
        try:
            return self._numbers[name][0]
        except KeyError:
            names = [*self._numbers, *self.__dict__]
            hint = did_you_mean(name, [each for each in names if not each.startswith("_")])
            raise AttributeError(f"the state has no {name!r}{hint}") from None

    def __setattr__(self, name: str, value: Any) -> None:
        raise AttributeError(f"{name} is read only: return what is to be set, or use state.memory")

    def __getitem__(self, name: str) -> Any:
        return getattr(self, name)

    def copy(self) -> "View":
        """Return the state as it is now, which later samples do not change."""
        same = View(self._records.copy())
        same.memory.update(self.memory)
        return same


def filled(kind: np.dtype, *settings, **values) -> np.void:
    """
    Return a record of these values and of what settings have by the same name, the first of them
    that has it; else zero.
    """
    out = np.zeros(1, kind)[0]
    for source in settings:
        known = {name: getattr(source, name) for name in kind.names if hasattr(source, name)}
        values = known | values
    for name, value in values.items():
        out[name] = value
    return out


@dataclass(eq=False)
class Simulation:
    """
    A compiled kernel, the records that it works on, and who decides in between.

    Before sample k the kernel can stop. `decide` then sees the state and may write the inputs of
    the samples until the next decision; NaN there means that the kernel decides. As decisions are
    inputs, a run is repeated without Python: the same start and these inputs, `decide` left out.

    Parameters
    ----------
    kernel : callable
        kernel(first, stop, setup, state, inputs, log), compiled, does the samples from `first` to
        before `stop`: for each it takes the inputs, writes a row of `log`, and goes on to where the
        next sample's decision is due, which is where it leaves the state. It returns (samples done,
        −1), (samples done, END) where the run comes to its end, or (sample, block) where a block
        diverged in that sample. It must do the same whether samples are done in one call or in
        several. kernel(0, 0, …) comes to the first decision.
    setup : record, or tuple of records
        Constants.
    state : record, or tuple of records
        What a sample hands to the next; changed in place.
    inputs : numpy.ndarray, shape (N,)
        Records of what comes from outside at each sample, decisions included; ``np.full(N, np.nan,
        dtype)`` where nothing is decided yet. A hand or a robot may write them as they come.
    log : numpy.ndarray, shape (N,), or tuple of arrays
        One row for each sample.
    decide : callable, optional
        decide(state, inputs) with the inputs of the samples until the next decision.
    every : int
        Samples from one decision to the next.
    blocks : sequence of str
        Names of the blocks that may diverge, by their number.
    sample_time : float
        T [s], for the message of a divergence.

    Attributes
    ----------
    done : int
        Samples that have been done.
    ended : bool
        Whether the run has come to its end; nothing more is done then.

    Examples
    --------
    A tank that leaks, filled by a valve that a rule opens at a low level.

    >>> import numba
    >>> import numpy as np
    >>> from trustlab.models.simulation import Simulation
    >>> @numba.njit
    ... def tank(first, stop, setup, state, inputs, log):
    ...     for k in range(first, stop):
    ...         log[k] = state[0]
    ...         valve = inputs[k].valve
    ...         state[0] = 0.9 * state[0] + (0.0 if np.isnan(valve) else valve)
    ...     return stop, -1
    >>> def rule(state, inputs):
    ...     if state[0] < 1.0:
    ...         inputs["valve"] = 0.5
    >>> inputs = np.full(8, np.nan, [("valve", float)])
    >>> run = Simulation(tank, (), np.ones(1), inputs, np.empty(8), decide=rule, every=2)
    >>> run.advance(8)
    >>> run.log.round(3)
    array([1.   , 0.9  , 0.81 , 1.229, 1.606, 1.445, 1.301, 1.171])
    """

    kernel: Any
    setup: Any
    state: Any
    inputs: np.ndarray
    log: Any
    decide: Callable | None = None
    every: int = 1
    blocks: tuple[str, ...] = ()
    sample_time: float = 1.0
    done: int = 0
    ended: bool = False

    def __post_init__(self):
        arguments = 0, 0, self.setup, self.state, self.inputs, self.log
        self._compiled = compiled_for(self.kernel, *arguments)
        self._compiled(*arguments)

    def advance(self, stop: int) -> None:
        """
        Do the samples before `stop`, or until the run ends, with a pause for `decide` wherever a
        decision is due.

        Parameters
        ----------
        stop : int
            At most the rows of `inputs` and `log`; nothing happens where it is done already.

        Raises
        ------
        DivergenceError
            If a block diverges; the rows of the log before that sample are valid.
        """
        while self.done < stop and not self.ended:
            until = stop
            if self.decide is not None:
                next_decision = (self.done // self.every + 1) * self.every
                if self.done % self.every == 0:
                    self.decide(self.state, self.inputs[self.done : next_decision])
                until = min(stop, next_decision)
            records = self.setup, self.state, self.inputs, self.log
            self.done, block = self._compiled(self.done, until, *records)
            if block >= 0:
                seconds = self.done * self.sample_time
                raise DivergenceError(
                    f"{self.blocks[block]} diverged at sample {self.done} ({seconds:g} s)"
                )
            self.ended = block == END


class Loop:
    """
    A simulation that its user steps or runs: what `TeleoperationLoop` and `TeamLoop` share.

    Attributes
    ----------
    simulation : Simulation
        With `hand`, shape (3,), among its inputs.
    count : int
        How many samples it can do.
    remedy : str
        What to do about a run that diverges.
    """

    simulation: Simulation
    count: int
    remedy: str = ""
    _failure: Exception | None = None

    @property
    def t(self) -> float:
        """Time that has been simulated [s]."""
        return self.simulation.done * self.simulation.sample_time

    @property
    def _done(self) -> int:
        """How many samples there are so far."""
        if not self.simulation.done:
            raise ValueError("nothing has been done yet: step or run the loop first")
        return self.simulation.done

    def so_far(self) -> Any:
        """Return the run so far."""
        raise NotImplementedError

    def run(self, until: float | None = None) -> Any:
        """
        Advance until a time and return the run so far.

        Parameters
        ----------
        until : float, optional
            The time [s], counted from the start of the run; the loop's duration when not given.

        Raises
        ------
        ValueError
            If the loop is beyond that time, or does not last so long.
        PartError
            If a function of the user's raises an error or returns what cannot be.
        DivergenceError
            If the run grows without bound.
        """
        T = self.simulation.sample_time
        stop = self.count if until is None else round(finite_number("until", until) / T)
        if not max(self.simulation.done, 2) <= stop <= self.count:
            raise ValueError(
                f"until must lie between t = {self.t:g} s, where the loop is, and its duration of "
                f"{self.count * T:g} s, and be two samples or more, got {until}"
            )
        self._advance(stop)
        return self.so_far()

    def _held(self, samples: int, hand: Any, **given: float) -> int:
        """
        Return before which sample to stop after some more, in which a hand wants the device to be
        somewhere [m], and other inputs are given.
        """
        run = self.simulation
        stop = run.done + samples
        if stop > self.count:
            raise ValueError(
                f"{samples} more samples go on beyond the loop, which ends at t = "
                f"{self.count * run.sample_time:g} s; make it with a longer duration"
            )
        if hand is not None:
            place = np.clip(finite_array("hand", hand, length=3), -FARTHEST_HAND, FARTHEST_HAND)
            given["hand"] = place
        for name, value in given.items():
            run.inputs[name][run.done : stop] = value
        return stop

    def _advance(self, stop: int) -> None:
        """Do the samples before `stop`; a run that failed fails again."""
        if self._failure is None:
            try:
                return self.simulation.advance(stop)
            except PartError as error:
                self._failure = error
            except DivergenceError as error:
                self._failure = DivergenceError(f"{error}; {self.remedy}")
            if self.simulation.done > 1:
                self._failure.session = self.so_far()
        raise self._failure from self._failure.__cause__


def compiled_for(function: Any, *arguments: Any) -> Callable:
    """Return a compiled function as it is called with arguments of these types, and no others."""
    key = function, *map(_kinds, arguments)
    if key not in COMPILED:
        COMPILED[key] = function.compile(tuple(map(numba.typeof, arguments)))
    return COMPILED[key]


def _kinds(value: Any) -> Any:
    """Return what numba's type of an argument depends on."""
    if isinstance(value, tuple):
        return type(value), *map(_kinds, value)
    if isinstance(value, np.ndarray | np.void):
        return type(value), value.dtype, value.ndim, value.flags.c_contiguous, value.flags.writeable
    return type(value)
