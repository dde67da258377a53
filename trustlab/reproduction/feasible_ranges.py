"""How far the quantities that are not printed can range while all that is printed holds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd

from trustlab.reproduction.certificate import proves_infeasible
from trustlab.reproduction.covariance_search import MomentProblem, Moments
from trustlab.reproduction.moment_solution import MARGINS, decide
from trustlab.reproduction.moment_statistics import pair_indices
from trustlab.reproduction.statements import Statement

__all__ = ["feasible_ranges"]

INSIDE = 0.02
"""Every end is attained this far inside the printed intervals, as a share of their half-widths."""


def feasible_ranges(
    problem: MomentProblem, rng: np.random.Generator, conditions: tuple[str, ...]
) -> pd.DataFrame:
    """
    Return the lowest and highest value found of everything that is not printed.

    One quantity at a time is pushed on from the solutions in which it is furthest, while all statements hold; the step grows
    after success and shrinks after failure. Every solution met serves the other quantities, and all are gone through twice.
    Both ends are attained by solutions; the true range is at least as wide.

    Parameters
    ----------
    problem : MomentProblem
        What must hold.
    rng : numpy.random.Generator
        Source of the solutions to start from.
    conditions : tuple of str
        Names of the conditions.

    Returns
    -------
    pandas.DataFrame
        Index quantity: means and standard deviations that are not printed ("mean.C2", "sd.C2"), and correlations of all pairs
        ("correlation.C1-C2"); columns low, high (attained), proved_low, proved_high (of means: beyond these it is proved that
        no data have what is printed; NaN otherwise).
    """
    printed = {(s.kind, s.index) for s in problem.found}
    wanted = [
        (f"{kind}.{name}", kind, i, problem.typical[1])
        for i, name in enumerate(conditions)
        for kind in ("mean", "sd")
        if (kind, i) not in printed
    ]
    pairs = zip(*pair_indices(problem.k), strict=True)
    wanted += [
        (f"correlation.{conditions[i]}-{conditions[j]}", "correlation", q, 1.0)
        for q, (i, j) in enumerate(pairs)
    ]
    pool = _Pool(problem, decide(problem, rng, branches=0).moments)
    for margin in MARGINS:
        pool.add(problem.search(*problem.starts(48, rng), margin))
    ends = np.empty((len(wanted), 2))
    for _ in range(2):
        for row, (_, kind, index, size) in enumerate(wanted):
            ends[row] = [pool.push(kind, index, upwards, size) for upwards in (False, True)]
    proved = [
        _proved(problem, i, *ends[row]) if kind == "mean" else (np.nan, np.nan)
        for row, (_, kind, i, _) in enumerate(wanted)
    ]
    index = pd.Index([name for name, *_ in wanted], name="quantity")
    return pd.DataFrame(
        np.column_stack([ends, proved]), index=index, columns=["low", "high", "proved_low", "proved_high"]
    )


def _proved(problem: MomentProblem, i: int, low: float, high: float, steps: int = 8) -> tuple[float, float]:
    """Bounds on a mean that is not printed, beyond which it is proved that nothing is feasible; by bisection."""
    bounds = []
    for attained, end in zip((low, high), problem.scale, strict=True):
        outside = end
        for _ in range(steps if np.isfinite(end) else 0):
            middle = 0.5 * (attained + outside)
            row = Statement("beyond", "mean", i, min(middle, end), max(middle, end), "")
            known = problem.n, problem.k, problem.p_adjust, problem.scale
            refuted = proves_infeasible([*problem.found, row], *known, branches=12)
            attained, outside = (attained, middle) if refuted else (middle, outside)
        bounds.append(outside)
    return bounds[0], bounds[1]


class _Pool:
    """Solutions met so far."""

    def __init__(self, problem: MomentProblem, moments: Moments) -> None:
        self.problem, self.mean, self.factor = problem, moments.mean, moments.factor

    def add(self, moments: Moments) -> None:
        """Keep the solutions among some candidates."""
        solved = self.problem.violation(moments.mean, moments.factor) <= 0.0
        self.mean = np.concatenate([self.mean, moments.mean[solved]])
        self.factor = np.concatenate([self.factor, moments.factor[solved]])

    def _reached(
        self, mean: np.ndarray, factor: np.ndarray, kind: str, index: int, sign: float
    ) -> np.ndarray:
        return sign * getattr(self.problem.statistics(mean, factor), kind)[:, index]

    def push(self, kind: str, index: int, upwards: bool, size: float, rounds: int = 14) -> float:
        """Push one quantity as far as it goes, and return its value there."""
        sign, step = (1.0 if upwards else -1.0), 0.1 * size
        value = self._reached(self.mean, self.factor, kind, index, sign)
        furthest = np.argsort(-value)[:4]
        mean, factor, best = self.mean[furthest], self.factor[furthest], float(value.max())
        for _ in range(rounds):
            target = best + step
            ends = (target, np.inf) if upwards else (-np.inf, -target)
            row = Statement("pushed", kind, index, *ends, "")
            pushed = replace(self.problem, found=[*self.problem.found, row])
            moved = pushed.search(mean, factor, INSIDE, stages=(0.0,), enough=2, iterations=40)
            value = self._reached(moved.mean, moved.factor, kind, index, sign)
            value = np.where(self.problem.violation(moved.mean, moved.factor) <= 0.0, value, -np.inf)
            if value.max() <= best:
                step *= 0.35
                if step < 1e-3 * size:
                    break
                continue
            new = np.isfinite(value)
            self.mean, self.factor = (
                np.concatenate([self.mean, moved.mean[new]]),
                np.concatenate([self.factor, moved.factor[new]]),
            )
            mean, factor = (
                np.concatenate([moved.mean[new], mean])[:4],
                np.concatenate([moved.factor[new], factor])[:4],
            )
            best, step = float(value.max()), 1.7 * step
        return sign * best
