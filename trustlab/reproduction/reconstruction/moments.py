"""
Means and covariance that have all printed statistics, by least squares, and values that have them.

The unknowns are the means and a lower triangular G with S = GG', so that every S is a covariance
matrix. The violation of a constraint is how far its statistic lies outside the printed interval, in
half-widths of the interval; a root of all violations is a solution.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy import optimize

from trustlab.reproduction.published_study import PublishedStudy
from trustlab.reproduction.reconstruction.constraints import Constraint, Reading, statistics

# Starts after which the search gives up.
STARTS = 60

# How far inside the printed intervals solutions are sought in turn, as shares of half-widths.
MARGINS = (0.3, 0.1, 0.02)

# The intervals are widened to these relative widths at first, so that no single one leads astray.
WIDTHS = (0.1, 0.01, 0.001, 0.0)

# Unit of violation of a statement that is open to one side: natural logarithm of a p, or a share of
# the statistic.
OPEN_UNIT = 0.05

FAR = 1e6  # the violation of what is no number

TINY = 1e-300  # below which a p is not told apart


class Moments(NamedTuple):
    """
    Means (k,) and G, shape (k, rank), of a covariance GG'; the search's closest candidate.

    `outside` is by how many half-widths each constraint is violated, `violation` the largest of
    these and of what the scale says; `starts` counts the starts.
    """

    mean: np.ndarray
    factor: np.ndarray
    outside: dict[str, float]
    violation: float
    starts: int


class MomentProblem:
    """
    Constraints on means and covariance of a study, to be met within the measure's scale.

    Parameters
    ----------
    study : PublishedStudy
        Its conditions, n and scale.
    reading : Reading
        What is corrected by ε.
    p_adjust : str
        How pairwise p-values are adjusted.
    rows : sequence of Constraint
        What must hold.
    """

    def __init__(
        self, study: PublishedStudy, reading: Reading, p_adjust: str, rows: Sequence[Constraint]
    ):
        self.study = study
        self.reading = reading
        self.p_adjust = p_adjust
        self.rows = rows
        k, scale = study.k, study.scale
        self._bounded = bool(np.isfinite(scale).all())
        self._is_p = np.array([s.is_p for s in rows], dtype=bool)
        intervals = {s.name: (s.low, s.high) for s in rows if np.isfinite(s.high - s.low)}
        self._cells = np.array(
            [
                [intervals.get(f"{kind}.{c}", (np.nan, np.nan)) for c in study.conditions]
                for kind in ("mean", "sd")
            ]
        )
        self._centre, self._spread = self._typical()
        # G has the rank of n values, which have n − 1 degrees of freedom.
        self._rank = min(k, study.n - 1)
        self._below = np.tril_indices(k, 0, self._rank)
        printed = np.reshape([(s.low, s.high) for s in rows], (-1, 2))
        with np.errstate(divide="ignore"):
            printed[self._is_p] = np.log(np.maximum(printed[self._is_p], 0.0))
        printed[self._is_p & (printed[:, 1] >= 0.0), 1] = np.inf
        # After what is printed, what the scale says of means and variances.
        ends = [*printed, *[scale] * k, *[(-np.inf, 0.0)] * k * self._bounded]
        self._low, self._high = np.transpose(ends)
        of_scale = [self._spread] * k + [self._spread**2] * k * self._bounded
        self._size = np.array([*map(self._typical_size, rows), *of_scale])
        half = 0.5 * (self._high - self._low)
        unit = np.where(np.isfinite(half), half, OPEN_UNIT * self._size)
        # Of an interval that ends at p = 1, half of what is left of it.
        at_one = np.flatnonzero(self._is_p & np.isinf(self._high[: len(rows)]))
        unit[at_one] = np.minimum(unit[at_one], -0.5 * self._low[at_one])
        self._unit = np.maximum(unit, 1e-12 * self._size)

    def _typical(self) -> tuple[float, float]:
        """Return a typical mean and standard deviation, from what is printed."""
        low, high = self.study.scale
        width = high - low if self._bounded else 1.0
        mean, sd = (box[np.isfinite(box)] for box in self._cells)
        centre = low + 0.5 * width if np.isfinite(low) else 0.0
        spread = sd.mean() if sd.size else 0.2 * width
        return float(mean.mean() if mean.size else centre), float(max(spread, 1e-9 * width))

    def _typical_size(self, s: Constraint) -> float:
        """Return what a relative change of a statistic is relative to."""
        end = abs(s.low if np.isfinite(s.low) else s.high)
        if s.is_p:
            return 1.0
        if s.name.startswith("mean."):
            return self._spread
        return max(end, 0.01 * self._spread if s.name.startswith("sd.") else 1e-3)

    def outside(self, x: np.ndarray, width: float, margin: float) -> np.ndarray:
        """Return how far each row lies outside its interval, in its unit, shape (B, rows)."""
        mean, factor = self._unpack(x)
        study, covariance = self.study, factor @ factor.swapaxes(1, 2)
        found = statistics(study, self.reading, self.p_adjust, mean, covariance)
        value = np.reshape([found[s.name] for s in self.rows], (-1, len(x))).T
        value[:, self._is_p] = np.log(np.maximum(value[:, self._is_p], TINY))
        value = np.column_stack([value, mean])
        if self._bounded:
            # The variance is greatest with all values at the ends of the scale.
            least, most = study.scale
            variance = np.diagonal(covariance, axis1=1, axis2=2) * (study.n - 1) / study.n
            value = np.column_stack([value, variance - (mean - least) * (most - mean)])
        low, high = self._low, self._high
        unit = np.maximum(self._unit, width * self._size)
        # Intervals are widened about their middles, then narrowed by the margin.
        inner = (1.0 - margin) * unit - np.where(np.isfinite(high - low), self._unit, unit)
        outside = np.maximum(np.maximum(low - inner - value, value - high - inner), 0.0) / unit
        return np.nan_to_num(outside, nan=FAR, posinf=FAR)

    def _unpack(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return means and factors of unknowns (B, …) in typical standard deviations."""
        k = self.study.k
        factor = np.zeros((len(x), k, self._rank))
        factor[:, *self._below] = x[:, k:] * self._spread
        return x[:, :k] * self._spread, factor

    def _start(self, rng: np.random.Generator) -> np.ndarray:
        """Draw unknowns: means and standard deviations as printed, random correlations."""
        k, spread = self.study.k, self._spread
        means, sds = self._cells
        low, high = means.T
        drawn = np.clip(self._centre + spread * rng.standard_normal(k), *self.study.scale)
        mean = np.where(np.isfinite(low), low + (high - low) * rng.random(k), drawn)
        drawn = spread * np.exp(0.3 * rng.standard_normal(k))
        sd = np.where(np.isfinite(sds[:, 0]), sds.mean(axis=1), drawn)
        common = rng.uniform(0.0, 3.0) * np.abs(rng.standard_normal(k))
        loading = rng.standard_normal((k, k)) + common
        covariance = loading @ loading.T + 0.05 * np.eye(k)
        root = np.sqrt(np.diagonal(covariance))
        # So much of the variance is error as the printed F needs, where that is little.
        f_ratio = max((s.low for s in self.rows if s.name == "anova.F"), default=0.0)
        share = self.study.n * mean.var(ddof=1) / max(f_ratio, TINY) / (sd**2).mean()
        share = max(share, 1e-12) if share < 0.02 else 1.0
        factor = np.linalg.cholesky(share * covariance / np.outer(root, root) + 1.0 - share)
        factor = factor[:, : self._rank]
        factor *= (sd / np.linalg.norm(factor, axis=1))[:, None]
        return np.concatenate([mean, factor[self._below]]) / spread

    @np.errstate(all="ignore")  # candidates may be degenerate, and numbers that are printed, too
    def solve(self, rng: np.random.Generator, starts: int = STARTS) -> Moments:
        """Search from several starts; return the first solution, or the closest candidate."""
        closest, outside = None, np.array([np.inf])
        for start in range(starts):
            x = self._start(rng)
            for width in WIDTHS:
                arguments = width, MARGINS[start // 4 % len(MARGINS)]
                x = optimize.least_squares(
                    lambda x, *where: self.outside(x[None], *where)[0],
                    x,
                    self._slopes,
                    args=arguments,
                    max_nfev=60,
                ).x
                if not np.isfinite(x).all():  # numbers that are far out lead there
                    break
            violation = self.outside(x[None], 0.0, 0.0)[0]
            if violation.max() < outside.max():
                closest, outside = x, violation
            if outside.max() == 0.0:
                break
        (mean,), (factor,) = self._unpack(closest[None])
        names = [s.name for s in self.rows]
        by_name = dict(zip(names, outside.tolist(), strict=False))
        return Moments(mean, factor, by_name, float(outside.max()), start + 1)

    def _slopes(self, x: np.ndarray, width: float, margin: float) -> np.ndarray:
        """Return the derivatives of `outside` by forward differences, all in one call."""
        step = 1e-7 * np.maximum(np.abs(x), 1e-3)
        moved = self.outside(np.vstack([x, x + np.diag(step)]), width, margin)
        slopes = (moved[1:] - moved[0]) / step[:, None]
        return np.nan_to_num(slopes, nan=0.0, posinf=FAR, neginf=-FAR).T


def sample_with_moments(
    mean: np.ndarray,
    factor: np.ndarray,
    n: int,
    scale: tuple[float, float],
    rng: np.random.Generator,
    iterations: int = 2000,
) -> np.ndarray | None:
    """
    Draw values, shape (n, k), with given means and covariance GG' within a scale.

    The covariance has n − 1 in its denominator; `factor` is G, shape (k, rank), rank < n; the ends
    of the scale may be infinite. None where `iterations` projections find none.

    Normal draws are given the moments exactly, X = 1m' + √(n − 1) U G' with UᵀU = I, Uᵀ1 = 0. While
    values lie outside the scale they are moved to its ends, and the nearest values with the exact
    moments are taken: U is the orthogonal polar factor of the centred values times G (orthogonal
    Procrustes problem, Schönemann 1966; alternating projections).
    """
    low, high = scale
    inset = 1e-4 * (high - low) if np.isfinite(high - low) else 1e-3 * float(np.abs(factor).max())
    values = mean + rng.standard_normal((n, factor.shape[1])) @ factor.T
    for _ in range(iterations):
        left, _, right = np.linalg.svd((values - values.mean(axis=0)) @ factor, full_matrices=False)
        whitened = left @ right
        values = mean + np.sqrt(n - 1.0) * (whitened - whitened.mean(axis=0)) @ factor.T
        if values.min() >= low and values.max() <= high:
            return values
        values = np.clip(values, low + inset, high - inset)
    return None
