"""Ranges of the unprinted quantities over data that have all printed statistics."""

from dataclasses import replace

import numpy as np
import pandas as pd

from trustlab.reproduction.reconstruction.constraints import Constraint
from trustlab.reproduction.reconstruction.feasibility import MARGINS, decide
from trustlab.reproduction.reconstruction.moment_search import MomentProblem, Moments
from trustlab.reproduction.reconstruction.moment_statistics import pair_indices
from trustlab.reproduction.reconstruction.relaxation import proves_infeasible

# Every end is attained this far inside the printed intervals, as a share of their half-widths.
INSIDE = 0.02


def feasible_ranges(problem: MomentProblem, rng: np.random.Generator, conditions: tuple[str, ...]) -> pd.DataFrame:
    """
    Return the lowest and highest value found of every quantity that is not printed.

    Each quantity in turn is pushed outwards from the solutions in which it is most extreme, while all constraints hold; the
    step grows after success and shrinks after failure. Every solution found also serves the other quantities, and the whole
    round is made twice. Both ends are attained by solutions, so that the true range is at least as wide. Beyond proved_low
    and proved_high (for means; NaN otherwise) it is proved that no data have the printed statistics.
    """
    printed = {(s.kind, s.index) for s in problem.found}
    wanted = {  # name: kind, index and size of the statistic
        f"{kind}.{name}": (kind, i, problem.typical[1])
        for i, name in enumerate(conditions)
        for kind in ("mean", "sd")
        if (kind, i) not in printed
    }
    for q, (i, j) in enumerate(zip(*pair_indices(problem.k), strict=True)):
        wanted[f"correlation.{conditions[i]}-{conditions[j]}"] = "correlation", q, 1.0
    pool = _Pool(problem, decide(problem, rng, branches=0).moments)
    for margin in MARGINS:
        pool.add(pool.solutions(problem.search(*problem.starts(48, rng), margin)))
    rows = {}
    for _ in range(2):
        for name, what in wanted.items():
            rows[name] = [pool.push(*what, upwards) for upwards in (False, True)]
    for name, (kind, i, _) in wanted.items():
        low, high = rows[name]
        rows[name] += _proved(problem, i, low, high) if kind == "mean" else [np.nan, np.nan]
    table = pd.DataFrame.from_dict(rows, orient="index", columns=["low", "high", "proved_low", "proved_high"])
    return table.rename_axis("quantity")


def _proved(problem: MomentProblem, i: int, low: float, high: float, steps: int = 8) -> list[float]:
    """Return bounds on a mean that is not printed, beyond which it is proved that nothing is feasible; by bisection."""
    bounds = []
    for attained, end in zip((low, high), problem.scale, strict=True):
        outside = end
        for _ in range(steps if np.isfinite(end) else 0):
            middle = 0.5 * (attained + outside)
            beyond = Constraint("beyond", "mean", i, min(middle, end), max(middle, end), "")
            if proves_infeasible(replace(problem, found=[*problem.found, beyond]), branches=12):
                outside = middle
            else:
                attained = middle
        bounds.append(outside)
    return bounds


class _Pool:
    """The solutions found so far."""

    def __init__(self, problem: MomentProblem, moments: Moments) -> None:
        self.problem, self.mean, self.factor = problem, moments.mean, moments.factor

    def solutions(self, moments: Moments) -> Moments:
        """Return the solutions among some candidates."""
        return moments.select(self.problem.violation(moments.mean, moments.factor) <= 0.0)

    def add(self, solutions: Moments) -> None:
        """Keep some solutions."""
        self.mean = np.concatenate([self.mean, solutions.mean])
        self.factor = np.concatenate([self.factor, solutions.factor])

    def push(self, kind: str, index: int, size: float, upwards: bool, rounds: int = 14) -> float:
        """Push one quantity outwards until no step succeeds, and return its value there."""
        sign, step = (1.0 if upwards else -1.0), 0.1 * size

        def reached(mean: np.ndarray, factor: np.ndarray) -> np.ndarray:
            return sign * getattr(self.problem.statistics(mean, factor), kind)[:, index]

        value = reached(self.mean, self.factor)
        furthest = np.argsort(-value)[:4]
        mean, factor, best = self.mean[furthest], self.factor[furthest], float(value.max())
        for _ in range(rounds):
            target = best + step
            ends = (target, np.inf) if upwards else (-np.inf, -target)
            pushed = Constraint("pushed", kind, index, *ends, "")
            problem = replace(self.problem, found=[*self.problem.found, pushed])
            tried = problem.search(mean, factor, INSIDE, stages=(0.0,), enough=2, iterations=40)
            moved = self.solutions(tried)
            value = reached(moved.mean, moved.factor).max(initial=-np.inf)
            if value <= best:
                step *= 0.35
                if step < 1e-3 * size:
                    break
                continue
            self.add(moved)
            mean = np.concatenate([moved.mean, mean])[:4]
            factor = np.concatenate([moved.factor, factor])[:4]
            best, step = float(value), 1.7 * step
        return sign * best
