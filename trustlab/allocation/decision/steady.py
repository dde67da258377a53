"""The steady motion of many models under many pairs of thresholds, at a coarse sample time."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from trustlab.models.compiled import njit
from trustlab.models.tsc import TscModel, advance, human_at, threshold_mode, tsc_at

# Samples of the quicker process's time constant that a coarse sample time leaves.
SAMPLES = 25

# Time constants of the slower process that are left to settle, and switches recorded after.
SETTLING = 7.0
RECORDED = 9

# Time constants of the slower process after which a phase counts as endless.
ENDLESS = 12.0


class SteadyMotions(NamedTuple):
    """
    What models do under pairs of thresholds, shape (models, pairs) each; NaN where they stop.

    Dwell times are in samples of 0.1 s, or of whatever the models step by.
    """

    switches: np.ndarray
    encloses: np.ndarray
    mean_r: np.ndarray
    mean_p_r: np.ndarray
    mean_p_h: np.ndarray
    peak: np.ndarray
    dwell: np.ndarray


class SteadyMotion(NamedTuple):
    """The motion of one model under one pair; NaN where it stops."""

    switches: bool
    encloses: bool
    mean_r: float
    mean_p_r: float
    mean_p_h: float
    peak: float
    dwell: float


def coarse(tsc: TscModel) -> tuple[TscModel, int]:
    """Return the model at a longer sample time, and how many of its own samples that is."""
    quick = min(tsc.robot.time_constant, tsc.human.time_constant)
    ratio = max(1, int(quick / SAMPLES))
    a = tsc.robot.a**ratio
    b = tsc.robot.b * (1.0 - a) / (1.0 - tsc.robot.a)
    return TscModel(replace(tsc.robot, a=a, b=b), replace(tsc.human, a=tsc.human.a**ratio)), ratio


@njit
def steady(c, lower, upper):
    """Return the steady motion of one model under one pair of thresholds."""
    slowest = 1.0 / (1.0 - max(c.a_r, c.a_pr))
    r = c.beta
    p_h = human_at(r, c)
    p_r = (lower + c.b_T * p_h) / c.a_T
    mode = 1
    since = 0
    recorded = 0
    samples = 0.0
    low = 2.0
    high = -1.0
    sum_r = 0.0
    sum_p_r = 0.0
    sum_p_h = 0.0
    peak = -np.inf
    shortest = np.inf
    step = 0
    while recorded < RECORDED:
        before = mode
        mode = threshold_mode(tsc_at(p_r, p_h, c), lower, upper, mode)
        if mode != before:
            if recorded > 0:
                shortest = min(shortest, since)
            # An odd number of switches from the first on makes whole cycles.
            if recorded > 0 or step > SETTLING * slowest:
                recorded += 1
            if recorded == RECORDED:
                break
            since = 0
        since += 1
        step += 1
        if since > ENDLESS * slowest:
            return SteadyMotion(False, False, np.nan, np.nan, np.nan, np.nan, np.nan)
        if recorded > 0:
            samples += 1.0
            low = min(low, r)
            high = max(high, r)
            peak = max(peak, p_r)
            sum_r += r
            sum_p_r += p_r
            sum_p_h += p_h
        r, p_r = advance(r, p_r, p_h, mode, c)
        p_h = human_at(r, c)
    around = low <= c.beta <= high
    return SteadyMotion(
        True, around, sum_r / samples, sum_p_r / samples, sum_p_h / samples, peak, shortest
    )


@njit
def _write(i, c, ratio, pairs, motions):
    """Write row i of `motions`: one model under every pair."""
    for j in range(len(pairs)):
        motion = steady(c, pairs[j, 0], pairs[j, 1])
        motions.switches[i, j] = motion.switches
        motions.encloses[i, j] = motion.encloses
        motions.mean_r[i, j] = motion.mean_r
        motions.mean_p_r[i, j] = motion.mean_p_r
        motions.mean_p_h[i, j] = motion.mean_p_h
        motions.peak[i, j] = motion.peak
        motions.dwell[i, j] = motion.dwell * ratio


def survey(models: list[TscModel], pairs: np.ndarray) -> SteadyMotions:
    """Return the steady motion of every model under every pair of thresholds."""
    shape = (len(models), len(pairs))
    marks = [np.zeros(shape, bool) for _ in range(2)]
    motions = SteadyMotions(*marks, *(np.empty(shape) for _ in range(5)))
    for i, tsc in enumerate(models):
        slow, ratio = coarse(tsc)
        _write(i, slow.constants(), ratio, np.ascontiguousarray(pairs), motions)
    return motions


def points(motions: SteadyMotions, tsc: list[TscModel], weight: float) -> np.ndarray:
    """
    Return weight · robot performance + (1 − weight) · human performance, in points of (2.39).

    Both are means over the motion, in per cent of their ranges.
    """
    robot = np.array([[m.robot.p_min, m.robot.p_max] for m in tsc])
    human = np.array([[m.human.p_min, m.human.p_max] for m in tsc])
    of_robot = (motions.mean_p_r - robot[:, :1]) / np.diff(robot)
    of_human = (motions.mean_p_h - human[:, :1]) / np.diff(human)
    return 100.0 * (weight * of_robot + (1.0 - weight) * of_human)


def grid_of_pairs(low: float, high: float, count: int) -> np.ndarray:
    """Return every pair of a grid between two limits, lower below upper."""
    grid = np.linspace(low, high, count)
    first, second = np.triu_indices(count, 1)
    return np.column_stack([grid[first], grid[second]])
