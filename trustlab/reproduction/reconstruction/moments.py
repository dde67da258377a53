"""
Means and covariance that have all printed statistics, by least squares, and values that have them.

The unknowns are the means and a lower triangular G with S = GG', so that every S is a covariance
matrix. The violation of a constraint is how far its statistic lies outside the printed interval, in
half-widths of the interval; a root of all violations is a solution.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import optimize, special

from trustlab.reproduction.reconstruction.constraints import Constraint
from trustlab.studies.anova import mauchly_factor

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

# Statistics that are compared by their logarithms.
P_VALUES = ("p", "adjusted_p", "anova_p")


@dataclass(frozen=True, eq=False)
class Moments:
    """
    Means (k,) and G, shape (k, rank), of a covariance GG'; the search's closest candidate.

    `outside` is by how many half-widths each constraint is violated; `starts` counts the starts.
    """

    mean: np.ndarray
    factor: np.ndarray
    outside: dict[str, float]
    starts: int

    @property
    def violation(self) -> float:
        """The largest violation, 0 where all constraints hold."""
        return max(self.outside.values(), default=0.0)


@dataclass(frozen=True, eq=False)
class MomentProblem:
    """
    Constraints on k conditions and n subjects, as inequalities in means and covariance.

    `corrected` says whether p of F uses corrected degrees of freedom. Conditions without a printed
    mean and standard deviation are held to what `scale` allows.
    """

    constraints: Sequence[Constraint]
    n: int
    k: int
    corrected: bool
    scale: tuple[float, float]

    def without(self, name: str) -> "MomentProblem":
        """Return the problem without one of its constraints."""
        return replace(self, constraints=[s for s in self.constraints if s.name != name])

    @cached_property
    def rows(self) -> list[Constraint]:
        """The constraints, and what the scale says."""
        rows = list(self.constraints)
        for i in range(self.k):
            rows.append(Constraint(f"scale.{i}", "mean", i, *self.scale, "scale"))
            if np.isfinite(self.scale).all():
                rows.append(Constraint(f"spread.{i}", "spread", i, -np.inf, 0.0, "scale"))
        return rows

    @cached_property
    def ends(self) -> np.ndarray:
        """Lower and upper ends, shape (2, rows); of p-values their logarithms."""
        ends = np.array([(s.low, s.high) for s in self.rows], dtype=float).T
        with np.errstate(divide="ignore", invalid="ignore"):
            logarithms = np.log(np.maximum(ends, 0.0))
        logarithms[1, ends[1] >= 1.0] = np.inf
        return np.where(self.is_p, logarithms, ends)

    @cached_property
    def is_p(self) -> np.ndarray:
        """Which rows are compared by their logarithms."""
        return np.array([s.kind in P_VALUES for s in self.rows], dtype=bool)

    @cached_property
    def triangle(self) -> tuple[int, tuple[np.ndarray, np.ndarray]]:
        """The rank of G, as n values have n − 1 degrees of freedom, and where it is not zero."""
        rank = min(self.k, self.n - 1)
        return rank, np.tril_indices(self.k, 0, rank)

    @cached_property
    def size(self) -> np.ndarray:
        """What a relative change is relative to, one per row."""
        _, spread = self.typical

        def size(s: Constraint) -> float:
            end = abs(s.low if np.isfinite(s.low) else s.high)
            sizes = {"mean": spread, "sd": max(end, 0.01 * spread), "spread": spread**2}
            return sizes.get(s.kind, 1.0 if s.kind in P_VALUES else max(end, 1e-3))

        return np.array([size(s) for s in self.rows])

    @cached_property
    def unit(self) -> np.ndarray:
        """Unit of violation per row: half the interval, or a share of `size` where it is open."""
        low, high = self.ends
        with np.errstate(invalid="ignore"):
            half = 0.5 * (high - low)
        unit = np.where(np.isfinite(half), half, OPEN_UNIT * self.size)
        # Of an interval that ends at p = 1, half of what is left of it.
        at_one = np.isinf(high) & self.is_p
        return np.maximum(np.where(at_one, np.minimum(unit, -0.5 * low), unit), 1e-12 * self.size)

    @cached_property
    def cells(self) -> dict[str, np.ndarray]:
        """The printed intervals of means and standard deviations, shape (k, 2); NaN if none."""
        cells = {kind: np.full((self.k, 2), np.nan) for kind in ("mean", "sd")}
        for s in self.constraints:
            if s.kind in cells and np.isfinite(s.high - s.low):
                cells[s.kind][s.index] = s.low, s.high
        return cells

    @cached_property
    def typical(self) -> tuple[float, float]:
        """A typical mean and standard deviation, from what is printed."""
        low, high = self.scale
        width = high - low if np.isfinite(high - low) else 1.0
        mean, sd = (box[np.isfinite(box)] for box in self.cells.values())
        centre = low + 0.5 * width if np.isfinite(low) else 0.0
        spread = sd.mean() if sd.size else 0.2 * width
        return float(mean.mean() if mean.size else centre), float(max(spread, 1e-9 * width))

    def statistics(self, mean: np.ndarray, factor: np.ndarray) -> dict[str, np.ndarray]:
        """
        Return the statistics of candidates (B, k), (B, k, rank) by kind, shape (B, …).

        With P = I − 11'/k, T = tr(PS), Q = tr(PSPS) and A the covariance of k − 1 orthonormal
        contrasts: F = n Σ(m − m̄)²/T, ε = T²/((k − 1)Q), W = det A/(T/(k − 1))^(k − 1), Mauchly's
        χ² = −(n − 1) ρ ln W, t_ij = (m_i − m_j)/√(V_ij/n) with V_ij the variance of a difference
        (Mauchly 1940; Greenhouse & Geisser 1959).
        """
        n, k = self.n, self.k
        d = k - 1
        covariance = factor @ factor.swapaxes(1, 2)
        variance = np.diagonal(covariance, axis1=1, axis2=2)
        rows = covariance - covariance.mean(axis=2, keepdims=True)
        centred = rows - rows.mean(axis=1, keepdims=True)
        trace = np.maximum(np.trace(centred, axis1=1, axis2=2), TINY)
        f_ratio = n * k * mean.var(axis=1) / trace
        epsilon = trace**2 / (d * np.maximum((centred**2).sum(axis=(1, 2)), TINY))
        # det A is the product of the nonzero eigenvalues of PSP: the zero one is shifted to 1.
        _, log_w = np.linalg.slogdet(centred / trace[:, None, None] * d + 1.0 / k)
        i, j = np.triu_indices(k, 1)
        difference = variance[:, i] + variance[:, j] - 2.0 * covariance[:, i, j]
        t = (mean[:, i] - mean[:, j]) / np.sqrt(np.maximum(difference, TINY) / n)
        p = np.log(np.maximum(2.0 * special.stdtr(n - 1, -np.abs(t)), TINY))
        df = d * np.minimum(epsilon, 1.0) if self.corrected else np.full(len(mean), float(d))
        low, high = self.scale
        # Of no use where the scale is unlimited.
        spread = variance * (n - 1) / n - (mean - low) * (high - mean)
        return {
            "mean": mean,
            "sd": np.sqrt(variance),
            "spread": spread,
            "f_ratio": f_ratio[:, None],
            "epsilon": epsilon[:, None],
            "chi2": -mauchly_factor(n, k) * log_w[:, None],
            "p": p,
            "adjusted_p": _holm(p),
            "anova_p": np.log(np.maximum(special.fdtrc(df, df * (n - 1), f_ratio), TINY))[:, None],
        }

    def outside(self, x: np.ndarray, width: float, margin: float) -> np.ndarray:
        """Return how far each row lies outside its interval, in its unit, shape (B, rows)."""
        stats = self.statistics(*self._unpack(x))
        value = np.stack([stats[s.kind][:, s.index] for s in self.rows], axis=1)
        low, high = self.ends
        unit = np.maximum(self.unit, width * self.size)
        # Intervals are widened about their middles, then narrowed by the margin.
        inner = (1.0 - margin) * unit - np.where(np.isfinite(high - low), self.unit, unit)
        outside = np.maximum(np.maximum(low - inner - value, value - high - inner), 0.0) / unit
        return np.nan_to_num(outside, nan=FAR, posinf=FAR)

    def _unpack(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return means and factors of unknowns (B, …) in typical standard deviations."""
        k, (_, spread) = self.k, self.typical
        rank, below = self.triangle
        factor = np.zeros((len(x), k, rank))
        factor[:, *below] = x[:, k:] * spread
        return x[:, :k] * spread, factor

    def _start(self, rng: np.random.Generator) -> np.ndarray:
        """Draw unknowns: means and standard deviations as printed, random correlations."""
        k, (centre, spread) = self.k, self.typical
        rank, below = self.triangle
        low, high = self.cells["mean"].T
        drawn = np.clip(centre + spread * rng.standard_normal(k), *self.scale)
        mean = np.where(np.isfinite(low), low + (high - low) * rng.random(k), drawn)
        drawn = spread * np.exp(0.3 * rng.standard_normal(k))
        sd = np.where(np.isfinite(self.cells["sd"][:, 0]), self.cells["sd"].mean(axis=1), drawn)
        common = rng.uniform(0.0, 3.0) * np.abs(rng.standard_normal(k))
        loading = rng.standard_normal((k, k)) + common
        covariance = loading @ loading.T + 0.05 * np.eye(k)
        root = np.sqrt(np.diagonal(covariance))
        # So much of the variance is error as the printed F needs, where that is little.
        f_ratio = max((s.low for s in self.constraints if s.kind == "f_ratio"), default=0.0)
        share = self.n * mean.var(ddof=1) / max(f_ratio, TINY) / (sd**2).mean()
        share = max(share, 1e-12) if share < 0.02 else 1.0
        factor = np.linalg.cholesky(share * covariance / np.outer(root, root) + 1.0 - share)
        factor = factor[:, :rank] / np.linalg.norm(factor[:, :rank], axis=1, keepdims=True)
        factor *= sd[:, None]
        return np.concatenate([mean, factor[below]]) / spread

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
        by_name = {s.name: float(x) for s, x in zip(self.rows, outside, strict=True)}
        return Moments(mean, factor, by_name, start + 1)

    def _slopes(self, x: np.ndarray, width: float, margin: float) -> np.ndarray:
        """Return the derivatives of `outside` by forward differences, all in one call."""
        step = 1e-7 * np.maximum(np.abs(x), 1e-3)
        moved = self.outside(np.vstack([x, x + np.diag(step)]), width, margin)
        slopes = (moved[1:] - moved[0]) / step[:, None]
        return np.nan_to_num(slopes, nan=0.0, posinf=FAR, neginf=-FAR).T


def _holm(log_p: np.ndarray) -> np.ndarray:
    """Return the logarithms of Holm's adjusted p, not limited to 1."""
    m = log_p.shape[1]
    order = np.argsort(log_p, axis=1)
    steps = np.take_along_axis(log_p, order, axis=1) + np.log(m - np.arange(m))
    adjusted = np.empty_like(log_p)
    np.put_along_axis(adjusted, order, np.maximum.accumulate(steps, axis=1), axis=1)
    return adjusted


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
