"""Starting values from a coarse search on block means; the parameters that enter linearly are solved for."""

from __future__ import annotations

import numba
import numpy as np

from trustlab.identification.greybox import HUMAN, UNIT_MARGIN, Problem
from trustlab.identification.least_squares import minimise
from trustlab.identification.traces import Trace, blocks

__all__ = ["human_start", "robot_start"]

REST_STARTS = np.array([0.03, 0.3, 0.6, 0.9, 0.999])
BETAS = np.linspace(0.15, 0.95, 9)


@numba.njit(cache=True)
def _solve2(s11, s12, s22, t1, t2):
    determinant = s11 * s22 - s12 * s12
    if determinant <= 1e-12 * s11 * s22:
        return np.nan, np.nan
    return (s22 * t1 - s12 * t2) / determinant, (s11 * t2 - s12 * t1) / determinant


@numba.njit(cache=True)
def _human_grid(mode, p_h, starts, rates, betas, rests):
    """Return Σ e², a, beta, p_min, p_max, r0 of every grid point with p_max > p_min; Σ e² is infinite elsewhere."""
    out = np.full((rates.size * rests.size * betas.size, 6), np.inf)
    total = np.sum(p_h**2)
    log_r, log_q = np.empty(p_h.size), np.empty(p_h.size)  # of (2.6), shared by all beta
    row = 0
    for a in rates:
        for rest in rests:
            for i in range(starts.size - 1):
                r = rest
                for k in range(starts[i], starts[i + 1]):
                    middle = r + 0.5 * (1.0 - a) * (mode[k] - r)
                    inside = 0.0 < middle < 1.0
                    log_r[k] = np.log(middle) if inside else -np.inf
                    log_q[k] = np.log(1.0 - middle) if inside else -np.inf
                    r += (1.0 - a) * (mode[k] - r)
            for beta in betas:
                s11 = s12 = s22 = t1 = t2 = 0.0
                top = beta * np.log(beta) + (1.0 - beta) * np.log(1.0 - beta)
                for k in range(starts[0], starts[-1]):
                    high = np.exp(beta * log_r[k] + (1.0 - beta) * log_q[k] - top)
                    low = 1.0 - high
                    s11 += low * low
                    s12 += low * high
                    s22 += high * high
                    t1 += low * p_h[k]
                    t2 += high * p_h[k]
                p_min, p_max = _solve2(s11, s12, s22, t1, t2)
                if p_max > p_min:
                    out[row] = [total - p_min * t1 - p_max * t2, a, beta, p_min, p_max, rest]
                row += 1
    return out


@numba.njit(cache=True)
def _robot_grid(mode, p_h, p_r, starts, rates, p_h_max):
    """Return Σ e², a, p_min, p_max of the best grid point."""
    best = np.array([np.inf, np.nan, np.nan, np.nan])
    for a in rates:
        s11 = s12 = s22 = t1 = t2 = total = 0.0
        for i in range(starts.size - 1):
            low, high, left = 0.0, 0.0, p_r[starts[i]]
            for k in range(starts[i], starts[i + 1]):
                y = p_r[k] - left
                s11 += low * low
                s12 += low * high
                s22 += high * high
                t1 += low * y
                t2 += high * y
                total += y * y
                share = mode[k] * p_h[k] / p_h_max
                low += (1.0 - a) * (1.0 - share - low)
                high += (1.0 - a) * (share - high)
                left *= a
        p_min, p_max = _solve2(s11, s12, s22, t1, t2)
        squares = total - p_min * t1 - p_max * t2
        if np.isfinite(p_min) and squares < best[0]:
            best[:] = [squares, a, p_min, p_max]
    return best


def _rates(longest: int, length: int, low: float, high: float) -> np.ndarray:
    """Return shares kept per block, for time constants from a few samples to many runs."""
    taus = np.geomspace(min(20.0, 0.2 * longest), 4.0 * longest, 18)
    rates = np.clip(1.0 - 1.0 / taus, low, high)
    return np.unique(rates) ** length


def _joined(data: list[dict[str, np.ndarray]], name: str) -> np.ndarray:
    return np.concatenate([run[name] for run in data])


def human_start(runs: list[Trace], bounds: dict[str, tuple[float, float]]) -> dict[str, float]:
    """
    Return starting values of a, beta, p_min, p_max and r0 of the human model.

    The likelihood of (2.6) has several valleys (a slow operator past their best looks like a quick one short of it),
    so the best grid points of different rates and initial utilizations are refined on block means before the best
    is taken.

    Parameters
    ----------
    runs : list of Trace
        Runs with mode and p_h.
    bounds : dict
        Lowest and highest value by parameter; equal values fix it.
    """
    data, length = blocks(runs)
    starts = np.cumsum([0, *(run["mode"].size for run in data)])
    longest = max(run.mode.size for run in runs)
    betas = np.unique(np.clip(BETAS, *bounds["beta"]))
    rests = np.unique(np.clip(REST_STARTS, *bounds["r0"]))
    rates = _rates(longest, length, *bounds["a"])
    p_h = _joined(data, "p_h")
    grid = _human_grid(_joined(data, "mode"), p_h, starts, rates, betas, rests)
    if not np.isfinite(grid[:, 0]).any():
        high = p_h.max() + (1e-3 * max(abs(p_h.max()), 1.0) if np.ptp(p_h) == 0.0 else 0.0)
        grid = np.array([[0.0, rates[rates.size // 2], betas[betas.size // 2], p_h.min(), high, rests[0]]])
    means = [
        Trace(run.label, run.synthetic, run.t, d["mode"], d["p_h"]) for run, d in zip(runs, data, strict=True)
    ]
    found = min((_refined(means, row, bounds, length) for row in _apart(grid, rates)), key=lambda row: row[0])
    a = min(max(found[1] ** (1.0 / length), UNIT_MARGIN), 1.0 - UNIT_MARGIN)
    return {"a": a, "beta": found[2], "p_min": found[3], "p_max": found[4], "r0": found[5]}


def _apart(grid: np.ndarray, rates: np.ndarray, most: int = 6) -> np.ndarray:
    """Return the best grid points, one for each initial utilization and third of the rates."""
    third = np.searchsorted(rates, grid[:, 1]) * 3 // max(rates.size, 1)
    best: dict[tuple, np.ndarray] = {}
    for row, band in zip(grid, third, strict=True):
        key = (band, row[5])
        if np.isfinite(row[0]) and (key not in best or row[0] < best[key][0]):
            best[key] = row
    return np.array(sorted(best.values(), key=lambda row: row[0])[:most])


def _refined(means: list[Trace], row: np.ndarray, bounds: dict, length: int) -> np.ndarray:
    """Search from one grid point on block means; p_min and p_max stay free even where the user fixed them."""
    problem = Problem(HUMAN, means, power=row[2])
    low_a, high_a = (min(max(bound**length, UNIT_MARGIN), 1.0 - UNIT_MARGIN) for bound in bounds["a"])
    count = len(means)
    low = np.array([low_a, bounds["beta"][0], -np.inf, -np.inf] + [bounds["r0"][0]] * count)
    high = np.array([high_a, bounds["beta"][1], np.inf, np.inf] + [bounds["r0"][1]] * count)
    start = np.r_[row[1:5], np.full(count, row[5])]
    found = minimise(
        problem.search_normal,
        problem.to_search(np.clip(start, low, high)),
        problem.to_search(low),
        problem.to_search(high),
        tolerance=1e-2,
        max_iterations=25,
    )
    theta = problem.from_search(found.x)
    if not theta[3] > theta[2]:
        return row
    return np.r_[found.normal.squares[0], theta[:4], np.median(theta[4:])]


def robot_start(
    runs: list[Trace], p_h: list[np.ndarray] | None, p_h_max: float, bounds: dict[str, tuple[float, float]]
) -> dict[str, float | np.ndarray]:
    """
    Return starting values of a, p_min and p_max of the robot model and of p_r0 for every run.

    Parameters
    ----------
    runs : list of Trace
        Runs with mode, p_h and p_r.
    p_h : list of numpy.ndarray, optional
        Human performance per run to use in place of the measured one.
    p_h_max : float
        Greatest human performance.
    bounds : dict
        Lowest and highest value by parameter; equal values fix it.
    """
    if p_h is not None:
        runs = [
            Trace(run.label, run.synthetic, run.t, run.mode, h, run.p_r)
            for run, h in zip(runs, p_h, strict=True)
        ]
    data, length = blocks(runs)
    starts = np.cumsum([0, *(run["mode"].size for run in data)])
    rates = _rates(max(run.mode.size for run in runs), length, *bounds["a"])
    found = _robot_grid(*(_joined(data, name) for name in ("mode", "p_h", "p_r")), starts, rates, p_h_max)
    if not np.isfinite(found[0]):
        p_r = _joined(data, "p_r")
        found = np.array([0.0, rates[rates.size // 2], p_r.min(), p_r.max()])
    a = min(max(found[1] ** (1.0 / length), UNIT_MARGIN), 1.0 - UNIT_MARGIN)
    first = np.array([run["p_r"][0] for run in data])
    return {"a": a, "p_min": found[2], "p_max": found[3], "p_r0": first}
