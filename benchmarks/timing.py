"""Repetitions of two sides in turns, and the row that comes of them."""

from __future__ import annotations

import gc
import math
from collections.abc import Callable
from dataclasses import dataclass
from statistics import median
from time import perf_counter

LEAST = 0.005
"""
Seconds that one repetition lasts at least: a quicker side is called several times and the mean is
taken.
"""


@dataclass(frozen=True)
class Spread:
    """
    Median, least and greatest of repeated measurements.

    Parameters
    ----------
    median, low, high : float
        In the unit of what was measured.
    """

    median: float
    low: float
    high: float

    @classmethod
    def of(cls, values: list[float]) -> Spread:
        """
        Return the spread of measurements.

        Parameters
        ----------
        values : list of float
            At least one.
        """
        return cls(median(values), min(values), max(values))

    def text(self, digits: int = 3) -> str:
        """
        Return "median [low–high]".

        Parameters
        ----------
        digits : int
            Significant digits.
        """
        return (
            f"{_short(self.median, digits)} "
            f"[{_short(self.low, digits)}–{_short(self.high, digits)}]"
        )


def _short(value: float, digits: int) -> str:
    if value == 0.0:
        return "0"
    places = digits - 1 - math.floor(math.log10(abs(value)))
    return f"{round(value, places):.{max(places, 0)}f}"


@dataclass(frozen=True)
class Row:
    """
    One line of the table.

    Parameters
    ----------
    case, ours, peer : str
        What is compared.
    ours_ms, peer_ms : Spread or None
        Milliseconds per call.
    ratio : Spread or None
        Peer's time over ours within each turn: how many times faster ours is.
    goal : str
        In words; empty for information only.
    met : bool or None
        Whether the median meets the goal; None without a goal.
    note : str
        What a reader must know.
    fault : str
        Why there is no comparison; empty when there is one.
    """

    case: str
    ours: str
    peer: str
    ours_ms: Spread | None = None
    peer_ms: Spread | None = None
    ratio: Spread | None = None
    goal: str = ""
    met: bool | None = None
    note: str = ""
    fault: str = ""


def seconds_per_call(call: Callable[[], object], calls: int) -> float:
    """
    Return the mean time of consecutive calls, garbage collection held off.

    Parameters
    ----------
    call : callable
        What is timed.
    calls : int
        How often, at least once.
    """
    gc.collect()
    gc.disable()
    try:
        began = perf_counter()
        for _ in range(calls):
            call()
        return (perf_counter() - began) / calls
    finally:
        gc.enable()


def here(call: Callable[[], object]) -> Callable[[int], float]:
    """
    Return a side that runs in this process: a function from a number of calls to seconds per call.

    Parameters
    ----------
    call : callable
        What is timed.
    """
    return lambda calls: seconds_per_call(call, calls)


def in_turns(
    ours: Callable[[int], float], peer: Callable[[int], float], turns: int, warm: bool = True
) -> tuple[Spread, Spread, Spread]:
    """
    Measure ours, peer, ours, peer … and return milliseconds of both and the ratio peer / ours
    within turns.

    Parameters
    ----------
    ours, peer : callable
        Sides: functions from a number of calls to seconds per call.
    turns : int
        How many of each.
    warm : bool
        Whether a first call of each side (compilation, caches) goes before, uncounted.
    """
    calls = []
    for side in (ours, peer):
        if warm:
            side(1)
            calls.append(max(1, min(1000, math.ceil(LEAST / side(1)))))
        else:
            calls.append(1)
    a, b = [], []
    for _ in range(turns):
        a.append(1e3 * ours(calls[0]))
        b.append(1e3 * peer(calls[1]))
    return Spread.of(a), Spread.of(b), Spread.of([y / x for x, y in zip(a, b, strict=True)])
