"""Steady motions of the switched system: followed from a start, and searched for until none is left to find."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numba
import numpy as np

from trustlab.allocation.covers import cover, generation, merge, narrow, reach, trap
from trustlab.allocation.intervals import nest
from trustlab.allocation.itineraries import CORNERS
from trustlab.allocation.phases import human_at, record, settle

__all__ = ["Motion", "Motions", "longest_phase"]

MOST_CYCLES = 2000
"""Cycles that are recorded once transients have died away."""

NEAR = (1e-9, 2e-5)
"""How near in r and P_r a start must come to a motion that repeats, and to one that does not, to count as drawn to it."""

LONGEST_TRAP = 500
"""Longest period about which a trap is built."""

STACK = 20_000
"""Most sets of states that wait to be carried on."""

CROWD = 400
"""Sets of states from which on those near one another are put together."""

FINE = 1e-8
"""To about which size, in utilization, sets of states are carried on where motions do not repeat."""


@dataclass(frozen=True, eq=False)
class Motion:
    """
    One steady motion.

    Parameters
    ----------
    rows : numpy.ndarray, shape (cycles, 5)
        r and P_r at the beginning of each manual phase, dwell times manual and autonomous, r at the middle.
    trace : numpy.ndarray, shape (7,)
        Least and greatest P_r and TSC, sums of r and P_r, number of samples.
    period : int or None
        After how many cycles it repeats.
    """

    rows: np.ndarray
    trace: np.ndarray
    period: int | None

    def same(self, other: Motion) -> bool:
        """
        Return whether another motion that repeats is this one.

        Parameters
        ----------
        other : Motion
            The other.
        """
        if self.period is None or self.period != other.period:
            return False
        return abs(self.rows[:, 0].min() - other.rows[:, 0].min()) < 1e-8


def longest_phase(constants: np.ndarray) -> int:
    """
    Return a number of samples after which a phase without a crossing has settled for good.

    Parameters
    ----------
    constants : numpy.ndarray
        A packed model.
    """
    return int(50.0 / (1.0 - max(constants[0], constants[4]))) + 100


def _period(rows: np.ndarray) -> int | None:
    """Return after how many cycles the recorded motion repeats."""
    r, dwell = rows[:, 0], rows[:, 2:4]
    for period in range(1, len(rows) // 3 + 1):
        same = abs(r[period] - r[0]) < 1e-9 and (dwell[period:] == dwell[:-period]).all()
        if same and np.abs(r[period:] - r[:-period]).max() < 1e-9:
            return period
    return None


@numba.njit(cache=True)
def _ends(polys, sizes, count, lower, upper, c, most):
    """Run one cycle from every corner of `count` polygons; return rows and trace as `record` does."""
    total = 0
    for i in range(count):
        total += sizes[i]
    rows = np.empty((total, 5))
    trace = np.array([np.inf, -np.inf, np.inf, -np.inf, 0.0, 0.0, 0.0])
    at = 0
    for i in range(count):
        for j in range(sizes[i]):
            own, one = record(polys[i, j, 0], polys[i, j, 1], lower, upper, c, 1, most)
            rows[at] = own[0]
            at += 1
            for q in (0, 2):
                trace[q], trace[q + 1] = min(trace[q], one[q]), max(trace[q + 1], one[q + 1])
    return rows, trace


@dataclass(eq=False)
class Motions:
    """
    The steady motions under one pair of thresholds, as far as they are known.

    Parameters
    ----------
    c : numpy.ndarray
        The packed model.
    lower, upper : float
        Thresholds TSC_l and TSC_u.
    found : list of Motion
        The motions known so far.
    stopped : list of tuple
        Starts from which a mode stays: -1 manual or -2 autonomous, with r and P_r at the end.
    rest : Motion or None
        What encloses all that is not drawn to a motion that repeats, after a search.
    exhaustive : bool
        Whether a search came to its end.
    """

    c: np.ndarray
    lower: float
    upper: float
    found: list[Motion] = field(default_factory=list)
    stopped: list[tuple] = field(default_factory=list)
    rest: Motion | None = None
    exhaustive: bool = False

    def __post_init__(self):
        self.most = longest_phase(self.c)
        self.known = np.empty((0, 3))
        self.traps = np.empty((0, CORNERS, 2)), np.empty(0, np.int64), np.empty(0)

    def follow(self, r: float, p_r: float) -> None:
        """
        Follow the motion from the beginning of a manual phase and keep it if it is new.

        Parameters
        ----------
        r, p_r : float
            The state there.
        """
        lower, upper, c, most = self.lower, self.upper, self.c, self.most
        state, r, p_r = settle(r, p_r, lower, upper, c, most, most)
        if state < 0:
            self.stopped.append((state, r, p_r))
            return
        if (np.abs(self.known[:, :2] - (r, p_r)).max(axis=1) < self.known[:, 2]).any():
            return
        rows, trace = record(r, p_r, lower, upper, c, 24, most)
        period = _period(rows)
        if period is None:
            rows, trace = record(r, p_r, lower, upper, c, MOST_CYCLES, most)
            period = _period(rows)
        if period is not None:
            rows, trace = record(r, p_r, lower, upper, c, period, most)
        motion = Motion(rows, trace, period)
        if not any(own.same(motion) for own in self.found):
            self.found.append(motion)
            near = np.full(len(rows), NEAR[period is None])
            self.known = np.concatenate([self.known, np.column_stack([rows[:, :2], near])])
            if period is not None and period <= LONGEST_TRAP:
                self._set_trap(motion)

    def _set_trap(self, motion: Motion) -> None:
        """Find a set of states about a motion that repeats, from which nothing escapes to another."""
        c, period = self.c, motion.period
        r, p_r = motion.rows[0, :2]
        if not 1e-9 < r < 1.0 - 1e-9:
            return
        # What is far from the motion in r by ξ and in P_r by η is, one period later, by αξ and by γξ + ρη.
        samples = motion.rows[:, 2:4].sum()
        alpha, rho = c[0] ** samples, c[4] ** samples
        gamma = self._drift(motion)
        section = c[8] * (human_at(r, c) - c[2]) * (c[1] - r) / (r * (1.0 - r)) / c[7]
        height = c[7] ** -1 * (1.0 - c[4]) * (1.0 + abs(self.lower) + abs(self.upper))
        best, area = None, 0.0
        leans = [section]
        if abs(alpha - rho) > 1e-3 * max(alpha, rho):
            leans.append(gamma / (alpha - rho))
        for lean in leans:
            skew = abs(gamma - lean * (alpha - rho))
            width = 8.0 * (1.0 - c[0])
            if skew * width > 0.9 * (1.0 - rho) * height:
                width = 0.9 * (1.0 - rho) * height / skew
            width = min(width, 0.2 * min(r, 1.0 - r))
            traps = np.empty((period, CORNERS, 2))
            sizes, errors = np.empty(period, np.int64), np.empty(period)
            if trap(
                r,
                p_r,
                period,
                lean,
                width,
                height,
                self.lower,
                self.upper,
                c,
                self.most,
                traps,
                sizes,
                errors,
            ):
                own = abs((traps[0, 1, 0] - traps[0, 0, 0]) * (traps[0, 2, 1] - traps[0, 1, 1]))
                if own > area:
                    best, area = (traps, sizes, errors), own
        if best is not None:
            self.traps = tuple(np.concatenate([old, new]) for old, new in zip(self.traps, best, strict=True))

    def _drift(self, motion: Motion) -> float:
        """Return the derivative of P_r one period later by r now, dwell times fixed."""
        return float(_tangent(motion.rows, self.c))

    def search(self, budget: int) -> None:
        """
        Carry all states at which manual phases begin on, until every one is drawn to a known motion.

        Sets of states are cut wherever dwell times change. A set that has shrunk without being drawn to a known motion
        is followed to a new one. Sets that are left after so many cycles that they are as small as `FINE` enclose what
        does not repeat; they are kept as `rest`. `exhaustive` tells whether the search came to its end.

        Parameters
        ----------
        budget : int
            How many samples may be stepped through.
        """
        lower, upper, c, most = self.lower, self.upper, self.c, self.most
        manual, autonomous = np.empty(9), np.empty(9)
        if not self.found or nest(lower, upper, c, 4, 60, most, 0.1, manual, autonomous) < 0:
            return
        # A phase has at least one sample, and an autonomous one at most as many as the intervals leave room for.
        low = max(manual[0], (1.0 - c[0]) * c[0] ** autonomous[4] * (1.0 - 1e-9))
        high = min(manual[1], c[0] + 1e-12)
        if low < 1e-100 or high <= low:
            return
        over = autonomous[2]
        for cells in (24, 96):
            low, high, over, stepped, _ = narrow(
                low, high, over, lower, upper, c, cells, 1000, most, budget // 2
            )
            budget -= stepped
            if high - low < 10.0 * (1.0 - c[0]):
                break
        samples = min(motion.trace[6] / len(motion.rows) for motion in self.found)
        alpha, rho = c[0] ** samples, c[4] ** samples
        rate = max(alpha, rho, 1e-3)
        deep = math.ceil(math.log(FINE) / math.log(rate)) + 2
        lean = self._slow_direction()
        width, height = 0.2 * (high - low), 0.2 * over / c[7]
        now, then = (
            (np.empty((STACK, CORNERS, 2)), np.empty(STACK, np.int64), np.zeros(STACK)) for _ in range(2)
        )
        cells = 24 if high - low > 20.0 * (1.0 - c[0]) else 6
        odds = np.geomspace(low / (1.0 - low), high / (1.0 - high), cells + 1)
        edges = odds / (1.0 + odds)
        edges[0], edges[-1] = low, high
        top = cells
        for j in range(cells):
            cover(edges[j], edges[j + 1], reach(edges[j], edges[j + 1], over, lower, c), lower, c, now[0][j])
            now[1][j] = 4
        for age in range(1, deep + 1):
            top, stepped = generation(*now, top, *self.traps, lower, upper, c, most, budget, *then)
            budget -= stepped
            if top < 0 or budget < 0:
                return
            if top == 0:
                break
            now, then = then, now
            if top > CROWD:
                thin = max(width * max(alpha**age, 1e-9), 1e-11)
                flat = max(height * max(rho, alpha * alpha) ** age, 1e-11)
                top = merge(*now, top, lean, thin, flat)
            if (age >= 16 and age & (age - 1) == 0) or age == deep - 1:
                for j in range(0, top, max(top // (64 if age == deep - 1 else 8), 1)):
                    middle = now[0][j, : now[1][j]].mean(axis=0)
                    self.follow(middle[0], middle[1])
        self.exhaustive, self.left = True, top
        if top:
            self.rest = Motion(*_ends(now[0], now[1], top, lower, upper, c, most), None)

    def _slow_direction(self) -> float:
        """Return the slope dP_r/dr along which sets of states shrink most slowly."""
        motion = self.found[0]
        c, samples = self.c, motion.rows[:, 2:4].sum()
        alpha, rho = c[0] ** samples, c[4] ** samples
        if alpha > 1.1 * rho:
            return self._drift(motion) / (alpha - rho)
        r = motion.rows[0, 0]
        return c[8] * (human_at(r, c) - c[2]) * (c[1] - r) / (r * (1.0 - r)) / c[7]


@numba.njit(cache=True)
def _tangent(rows, c):
    """Return the derivative of P_r at the end of recorded cycles by r at their beginning, dwell times fixed."""
    r, keep, tangent = rows[0, 0], 1.0, 0.0
    for j in range(rows.shape[0]):
        for manual in (True, False):
            for _ in range(int(rows[j, 2 if manual else 3])):
                tangent *= c[4]
                if manual:
                    if 0.0 < r < 1.0:
                        tangent += c[5] * keep * (human_at(r, c) - c[2]) * (c[1] - r) / (r * (1.0 - r))
                    r = c[0] * r + (1.0 - c[0])
                else:
                    r = c[0] * r
                keep *= c[0]
    return tangent
