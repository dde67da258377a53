"""
Data that have all printed statistics, by least squares.

All statistics of a one-way within-subject study are functions of its means and covariance matrix.
The scores of random people are m + Gz, with z normal, on a measure without limits; where its scale
has one end, of their distances to it the logarithms are, and where it has two, of their positions
between them the logits. The unknowns are m and G. How far each statistic lies outside its printed
interval is minimised; where nothing does, the data are a solution.
"""

from collections.abc import Sequence
from itertools import combinations
from typing import Any

import numpy as np
from scipy import optimize, special

from trustlab.reproduction.published import PublishedStudy
from trustlab.reproduction.reconstruction.contradictions import (
    Constraint,
    Reading,
    adjusted,
    ends_of,
)
from trustlab.studies.anova import orthonormal_contrasts, sphericity

# Starts after which the search gives up.
STARTS = 60

# How far inside the printed intervals solutions are sought, as a share of their units.
MARGIN = 0.1

# Intervals are widened by these shares of their sizes at first, so that no single one leads astray.
WIDTHS = (0.1, 0.01, 0.001, 0.0)

# Greatest unit of violation: natural logarithm of a p, or a share of the size.
UNIT = 0.05

FAR = 1e6  # the violation of what is no number

TINY = 1e-300  # below which a p is not told apart


def statistics(
    study: PublishedStudy,
    reading: Reading,
    p_adjust: str,
    scores: np.ndarray,
) -> dict[str, np.ndarray]:
    """
    Return the statistics of scores (B, n, k) by the names of constraints.

    With A the covariance of k − 1 orthonormal contrasts: F = n Σ(m − m̄)²/tr A, and t_ij = (m_i −
    m_j)/√(V_ij/n) with V_ij the variance of a difference; of t the size.
    """
    n, k = study.n, study.k
    d = k - 1
    mean = scores.mean(axis=1)
    centred = scores - mean[:, None]
    covariance = centred.swapaxes(1, 2) @ centred / (n - 1)
    contrasts = orthonormal_contrasts(k)
    errors = contrasts.T @ covariance @ contrasts
    sphere = sphericity(errors, n - 1)
    f_ratio = n * k * mean.var(axis=1) / np.trace(errors, axis1=1, axis2=2)
    one, epsilon = np.ones(len(mean)), sphere["epsilon_gg"]
    factor = one * (reading.rounded or epsilon)
    df, df_of_p = (d * (factor if corrected else one) for corrected in (reading.df, reading.p))
    i, j = np.triu_indices(k, 1)
    variance = np.diagonal(covariance, axis1=1, axis2=2)
    of_difference = variance[:, i] + variance[:, j] - 2.0 * covariance[:, i, j]
    t = np.abs(mean[:, i] - mean[:, j]) / np.sqrt(of_difference / n)
    p = 2.0 * special.stdtr(n - 1, -t)
    values = {
        "anova.F": f_ratio,
        "anova.p": special.fdtrc(df_of_p, df_of_p * (n - 1), f_ratio),
        "anova.eta2": f_ratio / (f_ratio + n - 1),
        "anova.df1": df,
        "anova.df2": df * (n - 1),
        "epsilon": epsilon,
        "mauchly.chi2": sphere["mauchly_chi2"],
        "mauchly.df": sphere["mauchly_df"] * one,
        "mauchly.p": sphere["mauchly_p"],
        "mauchly.violated": sphere["mauchly_p"],
        "t_test.t": t[:, 0],
        "t_test.p": p[:, 0],
        "t_test.df": (n - 1) * one,
    }
    for c, name in enumerate(study.conditions):
        values |= {f"mean.{name}": mean[:, c], f"sd.{name}": np.sqrt(variance[:, c])}
    named = combinations(study.conditions, 2)
    for (a, b), p_value in zip(named, adjusted(p, p_adjust).T, strict=True):
        values[f"pairs.{a}-{b}"] = values[f"pairs.{b}-{a}"] = p_value
    return values


class Search:
    """
    A search for data of a study, read in a way, with p of pairs adjusted so, that meet constraints.
    """

    @np.errstate(all="ignore")  # of intervals that are open
    def __init__(
        self, study: PublishedStudy, reading: Reading, p_adjust: str, rows: Sequence[Constraint]
    ):
        self._study, self._reading, self._p_adjust = study, reading, p_adjust
        self._names = [s.name for s in rows]
        printed = {s.name: s for s in rows}
        self._cells = [
            np.array([ends_of(printed, f"{cell}.{c}").mean() for c in study.conditions])
            for cell in ("mean", "sd")
        ]
        known = [x[np.isfinite(x)] for x in self._cells]
        self._centre, spread = (x.sum() / max(x.size, 1) for x in known)
        width = study.scale[1] - study.scale[0]
        self._spread = spread or (0.2 * width if np.isfinite(width) else 1.0)
        self._is_p = is_p = np.array([s.is_p for s in rows], dtype=bool)
        is_cell = [name.startswith(("mean.", "sd.")) for name in self._names]
        low, high = np.reshape([(s.low, s.high) for s in rows], (-1, 2)).T
        size = np.maximum(np.abs(np.where(np.isfinite(low), low, high)), 1e-3)
        self._size = np.where(is_p, 1.0, np.where(is_cell, self._spread, size))
        # Of a p its logarithm counts, and none lies above 1.
        low, high = (np.where(is_p, np.log(np.clip(x, 0.0, 1.0)), x) for x in (low, high))
        self._unit = np.clip(0.5 * (high - low), 1e-12 * self._size, UNIT * self._size)
        self._low, self._high = low, np.where(is_p & (high == 0.0), np.inf, high)

    def _scores(self, x: np.ndarray, people: np.ndarray) -> np.ndarray:
        """Return the scores of people (n, k) by unknowns (B, …), shape (B, n, k)."""
        k, (low, high) = self._study.k, self._study.scale
        y = x[:, None, :k] + people @ x[:, k:].reshape(-1, k, k)
        if np.isfinite(high - low):
            return low + (high - low) * special.expit(y)
        if np.isfinite(low):
            return low + self._spread * np.exp(y)
        if np.isfinite(high):
            return high - self._spread * np.exp(-y)
        return self._centre + self._spread * y

    def _unlimited(self, mean: np.ndarray, sd: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return about the means and standard deviations of y of `_scores` for those of scores."""
        if not np.isfinite(self._study.scale).any():
            return (mean - self._centre) / self._spread, sd / self._spread
        least, (low, high) = np.maximum(sd / 3.0, 1e-6 * self._spread), self._study.scale
        below, above = (np.maximum(x, least) for x in (mean - low, high - mean))
        ratio = np.where(np.isfinite(below), below, self._spread)
        ratio = ratio / np.where(np.isfinite(above), above, self._spread)
        return np.log(ratio), sd * (1.0 / below + 1.0 / above)

    def _outside(
        self, x: np.ndarray, people: np.ndarray, width: float, margin: float
    ) -> np.ndarray:
        """Return how far statistics lie outside by unknowns (B, …), in units, shape (B, rows)."""
        scores = self._scores(x, people)
        found = statistics(self._study, self._reading, self._p_adjust, scores)
        value = np.reshape([found[name] for name in self._names], (-1, len(x))).T
        value[:, self._is_p] = np.log(np.maximum(value[:, self._is_p], TINY))
        widened = width * self._size
        unit = np.maximum(self._unit, widened)
        inner = margin * unit - widened
        outside = np.maximum(self._low + inner - value, value - self._high + inner) / unit
        return np.nan_to_num(np.maximum(outside, 0.0), nan=FAR, posinf=FAR)

    def _slopes(self, x: np.ndarray, *where: Any) -> np.ndarray:
        """Return the derivatives of `_outside` by forward differences, all in one call."""
        step = 1e-7 * np.maximum(np.abs(x), 1e-3)
        first, *moved = self._outside(np.vstack([x, x + np.diag(step)]), *where)
        slopes = (moved - first) / step[:, None]
        return np.nan_to_num(slopes, nan=0.0, posinf=FAR, neginf=-FAR).T

    def _start(self, rng: np.random.Generator) -> np.ndarray:
        """Draw m and G: means and standard deviations as printed, random correlations."""
        k, spread = self._study.k, self._spread
        drawn = np.clip(self._centre + spread * rng.standard_normal(k), *self._study.scale)
        drawn = drawn, spread * np.exp(0.3 * rng.standard_normal(k))
        mean, sd = (np.where(np.isfinite(x), x, y) for x, y in zip(self._cells, drawn, strict=True))
        common = rng.uniform(0.0, 3.0) * np.abs(rng.standard_normal((k, 1)))
        loading = rng.standard_normal((k, k)) + common
        mean, sd = self._unlimited(mean, sd)
        loading *= sd / np.linalg.norm(loading, axis=0)
        return np.concatenate([mean, loading.ravel()])

    @np.errstate(all="ignore")  # candidates may be degenerate, and numbers that are printed, too
    def solve(self, rng: np.random.Generator) -> tuple[np.ndarray, tuple[str, ...]]:
        """
        Search from several starts; return the scores (n, k) of the first solution, or the closest
        ones, and the printed statistics that they do not have.
        """
        closest, least = None, np.array([np.inf])
        for _ in range(STARTS):
            x, people = self._start(rng), rng.standard_normal((self._study.n, self._study.k))
            for width in WIDTHS:
                x = optimize.least_squares(
                    lambda x, *where: self._outside(x[None], *where)[0],
                    x,
                    self._slopes,
                    args=(people, width, MARGIN),
                    max_nfev=60,
                ).x
                if not np.isfinite(x).all():  # numbers that are far out lead there
                    break
            outside = self._outside(x[None], people, 0.0, 0.0)[0]
            if outside.max(initial=0.0) < least.max():
                closest, least = self._scores(x[None], people)[0], outside
            if not least.any():
                break
        missed = (name for name, beyond in zip(self._names, least, strict=True) if beyond)
        return closest, tuple(missed)
