"""Rows of the table: two calls timed in turns, one against a limit, or times already measured."""

from __future__ import annotations

import gc
import math
from collections.abc import Callable, Sequence
from statistics import median
from time import perf_counter
from typing import NamedTuple

from benchmarks.peers.worker import Seconds

# A repetition lasts at least so many seconds: a quicker call is repeated, and the mean is taken.
LEAST = 0.005


class Row(NamedTuple):
    """What was done; milliseconds of ours and of the peer; peer / ours by turn; the goal."""

    work: str
    ours: Sequence[float]
    peer: str = ""
    theirs: Sequence[float] = ()
    ratios: Sequence[float] = ()
    goal: str = ""
    met: bool | None = None
    note: str = ""


class NotComparedError(Exception):
    """What a row needs is not there, or a peer computes something else."""


def number(value: float) -> str:
    """Return three digits of a number, written out."""
    return f"{float(f'{value:.3g}'):,g}"


def time_of(milliseconds: Sequence[float]) -> str:
    """Return the median, and the least and the greatest of several, in the unit that suits."""
    if not len(milliseconds):
        return ""
    values = [median(milliseconds), min(milliseconds), max(milliseconds)]
    sizes = {"s": 1e-3, "ms": 1.0, "µs": 1e3}
    unit = "s" if values[0] >= 1e3 else "ms" if values[0] >= 0.1 else "µs"
    middle, least, most = (number(sizes[unit] * value) for value in values)
    return f"{middle} {unit}" + (f" ({least}–{most})" if len(milliseconds) > 1 else "")


def seconds(call: Callable[[], object], calls: int) -> float:
    """Return the mean time of a call; a peer in a process of its own returns its seconds."""
    gc.collect()
    gc.disable()
    try:
        began = perf_counter()
        told = [call() for _ in range(calls)]
        spent = perf_counter() - began
    finally:
        gc.enable()
    return (sum(told) if isinstance(told[0], Seconds) else spent) / calls


def calls_of(call: Callable[[], object]) -> int:
    """Return how often a call is repeated, after a first one that does not count."""
    call()
    return max(1, min(1000, math.ceil(LEAST / seconds(call, 1))))


def beside(
    work: str,
    ours: Callable[[], object],
    peer: str,
    theirs: Callable[[], object],
    *,
    limit: float = math.inf,
    least: float = 0.0,
    turns: int = 9,
    scale: float = 1.0,
    note: str = "",
) -> Row:
    """
    Time ours, the peer, ours, the peer …; the goal is that ours takes at most `limit` milliseconds
    and that the peer takes at least `least` times as long. A peer that does only a share of the
    work has its time scaled.
    """
    counts = calls_of(ours), calls_of(theirs)
    mine, other = [], []
    for _ in range(turns):
        mine.append(1e3 * seconds(ours, counts[0]))
        other.append(1e3 * scale * seconds(theirs, counts[1]))
    ratios = [b / a for a, b in zip(mine, other, strict=True)]
    goals = [f"≤ {time_of([limit])}"] if limit < math.inf else []
    goals += [f"ratio ≥ {least:.3g}"] if least else []
    met = median(mine) <= limit and median(ratios) >= least if goals else None
    return Row(work, mine, peer, other, ratios, ", ".join(goals), met, note)


def within(
    work: str, call: Callable[[], object], limit: float, *, turns: int = 9, note: str = ""
) -> Row:
    """Time a call whose goal is to take at most `limit` milliseconds."""
    count = calls_of(call)
    times = [1e3 * seconds(call, count) for _ in range(turns)]
    return Row(work, times, goal=f"≤ {time_of([limit])}", met=median(times) <= limit, note=note)


def tail(
    work: str,
    times: Sequence[float],
    limit: float,
    more: str = "",
    met: bool = True,
    note: str = "",
) -> Row:
    """Return a row of times whose 99th percentile is to be at most a limit [ms], and `more`."""
    import numpy as np

    p99 = float(np.percentile(times, 99))
    goal = f"p99 ≤ {time_of([limit])}{more}"
    note = "; ".join(filter(None, [f"p99 {time_of([p99])}", note]))
    return Row(work, times, goal=goal, met=met and p99 <= limit, note=note)


def same(what: str, ours: object, theirs: object, tolerance: float) -> None:
    """Refuse to compare with a peer whose numbers differ from ours by more than a share of them."""
    import numpy as np

    ours, theirs = np.asarray(ours, dtype=float), np.asarray(theirs, dtype=float)
    apart = float(np.max(np.abs(theirs - ours) / np.maximum(np.abs(ours), 1e-12)))
    if not apart <= tolerance:
        raise NotComparedError(f"{what}: its results differ by {apart:.1e}")
