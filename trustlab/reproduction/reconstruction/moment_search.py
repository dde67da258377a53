"""
Means and covariance that have all printed statistics, by damped least squares.

The squares are of violations of intervals; many starts are taken at once.

Every operation has a fixed order, so that the same seed finds the same solution on every machine.

The unknowns are the means and a lower triangular G with S = GG', so that every S is a covariance
matrix. The violation of a constraint is how far its statistic lies outside the printed interval, in
half-widths of the interval; a root of all violations is a solution (Levenberg 1944, Marquardt 1963;
Gill & Murray 1978 for the scaling).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from trustlab.models.linear_algebra import cholesky_factors, products, solutions, transposed
from trustlab.reproduction.reconstruction.constraints import Constraint
from trustlab.reproduction.reconstruction.moment_statistics import MomentStatistics, pair_indices
from trustlab.reproduction.reconstruction.p_values import exponentials, logarithms

# Unit of violation of a statement that is open to one side: natural logarithm of a p, or a share of
# chi-square.
OPEN_UNIT = 0.05


@dataclass(frozen=True, eq=False)
class Moments:
    """
    Candidate means (B, k) and lower triangular factors G (B, k, k) of GG', best first.

    `violation`, shape (B,), is the largest violation of a constraint in half-widths, 0 where all
    hold.
    """

    mean: np.ndarray
    factor: np.ndarray
    violation: np.ndarray

    @property
    def solved(self) -> np.ndarray:
        """Whether all constraints hold, shape (B,)."""
        return self.violation <= 0.0

    def select(self, rows: np.ndarray) -> "Moments":
        """Return some of the candidates."""
        return Moments(self.mean[rows], self.factor[rows], self.violation[rows])


@dataclass(frozen=True, eq=False)
class MomentProblem:
    """
    Constraints on k conditions and n subjects, as a system of inequalities in means and covariance.

    `p_adjust` says how printed pairwise p-values were adjusted (only "holm" matters here),
    `corrected` whether p of F uses corrected degrees of freedom. Conditions without a printed mean
    and standard deviation are held to what `scale` allows.
    """

    constraints: Sequence[Constraint]
    n: int
    k: int
    p_adjust: str = "none"
    corrected: bool = False
    scale: tuple[float, float] = (float("-inf"), float("inf"))

    @cached_property
    def _cells(self) -> list[Constraint]:
        """Printed means and standard deviations."""
        return [
            s for s in self.constraints if s.kind in ("mean", "sd") and np.isfinite(s.high - s.low)
        ]

    @cached_property
    def rows(self) -> list[Constraint]:
        """The constraints, and what the scale says where they do not already imply it."""
        printed = {(s.kind, s.index): (s.low, s.high) for s in self._cells}
        rows, (low, high) = list(self.constraints), self.scale
        bounded = np.isfinite([low, high]).all()
        for i in range(self.k):
            mean, sd = (
                printed.get(("mean", i), (-np.inf, np.inf)),
                printed.get(("sd", i), (0.0, np.inf)),
            )
            if mean[0] < low or mean[1] > high:
                rows.append(Constraint(f"scale.{i}", "mean", i, low, high, "scale"))
            room = (
                -np.inf
            )  # the least that the mean leaves of the variance between the ends of the scale
            if bounded and np.isfinite(mean).all():
                room = min((m - low) * (high - m) for m in mean)
            if bounded and sd[1] ** 2 * (self.n - 1.0) / self.n >= room:
                rows.append(Constraint(f"scale.{i}", "spread", i, -np.inf, 0.0, "scale"))
        return rows

    @cached_property
    def low(self) -> np.ndarray:
        """Lower ends, one per row."""
        return np.array([s.low for s in self.rows])

    @cached_property
    def high(self) -> np.ndarray:
        """Upper ends, one per row."""
        return np.array([s.high for s in self.rows])

    @cached_property
    def size(self) -> np.ndarray:
        """What a relative change is relative to, one per row."""
        _, spread = self.typical

        def size(s: Constraint) -> float:
            end = s.low if np.isfinite(s.low) else s.high
            sizes = {"mean": spread, "sd": max(end, 0.01 * spread), "spread": spread**2}
            return sizes.get(s.kind, 1.0 if s.kind.startswith("log") else max(abs(end), 1e-3))

        return np.array([size(s) for s in self.rows])

    @cached_property
    def _ends_at_one(self) -> np.ndarray:
        """Whether a row's interval ends at p = 1, which no p exceeds."""
        return np.isinf(self.high) & np.array(
            [s.kind in ("log_p", "log_anova_p") for s in self.rows], bool
        )

    @cached_property
    def unit(self) -> np.ndarray:
        """Unit of violation per row: half the interval, or a share of `size` where it is open."""
        with np.errstate(invalid="ignore"):
            half = 0.5 * (self.high - self.low)
        unit = np.where(
            np.isfinite(half), np.maximum(half, 1e-12 * self.size), OPEN_UNIT * self.size
        )
        # Of an interval that ends at p = 1, half of what is left of it.
        return np.where(
            self._ends_at_one, np.minimum(unit, np.maximum(-0.5 * self.low, 1e-12)), unit
        )

    @cached_property
    def typical(self) -> tuple[float, float]:
        """A typical mean and standard deviation, from what is printed."""
        low, high = self.scale
        width = high - low if np.isfinite(high - low) else 1.0
        mean, sd = (
            [0.5 * (s.low + s.high) for s in self._cells if s.kind == kind]
            for kind in ("mean", "sd")
        )
        mean = mean or [low + 0.5 * width if np.isfinite(low) else 0.0]
        return float(np.mean(mean)), float(np.mean(sd or [0.2 * width]))

    def statistics(self, mean: np.ndarray, factor: np.ndarray) -> MomentStatistics:
        """Return the statistics of candidates."""
        covariance = products(factor, transposed(factor))
        return MomentStatistics(mean, covariance, self.n, self.corrected)

    def values(self, stats: MomentStatistics) -> tuple[np.ndarray, ...]:
        """
        Return every row's statistic and its gradients by means and covariance.

        Shapes (B, rows), (B, rows, k) and (B, rows, k, k).
        """
        kinds = list(dict.fromkeys(s.kind for s in self.rows))
        blocks = [self._kind(stats, kind) for kind in kinds]
        start = dict(
            zip(kinds, np.cumsum([0, *(value.shape[1] for value, *_ in blocks)]), strict=False)
        )
        columns = [start[s.kind] + s.index for s in self.rows]
        return tuple(
            np.concatenate(parts, axis=1)[:, columns] for parts in zip(*blocks, strict=True)
        )

    def _kind(self, stats: MomentStatistics, kind: str) -> tuple[np.ndarray, ...]:
        """Return all statistics of a kind, with their gradients."""
        if kind == "spread":
            return self._spread(stats)
        if kind == "log_adjusted_p":
            return self._holm(stats)
        value = getattr(stats, kind)
        value = value[:, None] if value.ndim == 1 else value
        return value, *getattr(stats, f"gradient_{kind}")

    def _spread(self, stats: MomentStatistics) -> tuple[np.ndarray, ...]:
        """
        Return S_ii(n − 1)/n − (m − low)(high − m): positive where the scale has no such values.
        """
        low, high = self.scale
        k = self.k
        share = (self.n - 1.0) / self.n
        value = share * stats.sd**2 - (stats.mean - low) * (high - stats.mean)
        by_mean = np.zeros((*stats.mean.shape, k))
        by_mean[:, range(k), range(k)] = 2.0 * stats.mean - low - high
        by_covariance = np.zeros((*stats.mean.shape, k, k))
        by_covariance[:, range(k), range(k), range(k)] = share
        return value, by_mean, by_covariance

    def _holm(self, stats: MomentStatistics) -> tuple[np.ndarray, ...]:
        """
        Return logarithms of Holm's adjusted p.

        Each has the gradient of the p that sets the running maximum.
        """
        log_p = stats.log_p
        m = log_p.shape[1]
        order = np.argsort(log_p, axis=1)
        stepped = np.take_along_axis(log_p, order, axis=1) + logarithms(m - np.arange(float(m)))
        largest = np.maximum.accumulate(stepped, axis=1)
        value = np.empty_like(log_p)
        np.put_along_axis(value, order, largest, axis=1)
        place = np.maximum.accumulate(np.where(stepped == largest, np.arange(m), 0), axis=1)
        source = np.empty_like(order)
        np.put_along_axis(source, order, np.take_along_axis(order, place, axis=1), axis=1)
        by_mean, by_covariance = stats.gradient_log_p
        batch = np.arange(log_p.shape[0])[:, None]
        return value, by_mean[batch, source], by_covariance[batch, source]

    def violation(self, mean: np.ndarray, factor: np.ndarray) -> np.ndarray:
        """
        Return each candidate's largest violation in half-widths, 0 where all constraints hold.
        """
        value = self.values(self.statistics(mean, factor))[0]
        outside = np.maximum(np.maximum(self.low - value, value - self.high), 0.0) / self.unit
        return np.where(np.isfinite(value), outside, np.inf).max(axis=1, initial=0.0)

    def starts(self, count: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        """Draw starting means and factors: means and SDs as printed, random correlations."""
        k, (centre, spread) = self.k, self.typical
        mean = centre + spread * rng.standard_normal((count, k))
        sd = spread * exponentials(0.3 * rng.standard_normal((count, k)))
        for s in self._cells:
            (mean if s.kind == "mean" else sd)[:, s.index] = 0.5 * (s.low + s.high)
            if s.kind == "mean" and s.index in self._level:
                mean[:, s.index] = rng.uniform(s.low, s.high, count)
        mean = np.clip(mean, *self.scale)
        common = rng.uniform(0.0, 3.0, (count, 1, 1))
        loading = rng.standard_normal((count, k, k)) + common * np.abs(
            rng.standard_normal((count, 1, k))
        )
        covariance = products(loading, transposed(loading)) + 0.05 * np.eye(k)
        root = np.sqrt(np.diagonal(covariance, axis1=-2, axis2=-1))
        correlation = covariance / (root[:, :, None] * root[:, None, :])
        share = self._varying_share(mean, sd)
        factor, _ = cholesky_factors(share * correlation + (1.0 - share))
        if self.n <= self.k:  # n values have n − 1 degrees of freedom: the covariance is singular
            factor[:, :, self.n - 1 :] = 0.0
            factor /= np.sqrt((factor**2).sum(axis=2, keepdims=True))
        return mean, sd[:, :, None] * factor

    @cached_property
    def _level(self) -> set[int]:
        """
        Conditions with equal printed means that a test tells apart: no slope leads from there.
        """
        centre = {s.index: 0.5 * (s.low + s.high) for s in self._cells if s.kind == "mean"}
        if len(centre) == self.k and len(set(centre.values())) == 1:
            return set(centre)
        first, second = pair_indices(self.k)
        differ = [
            s.index
            for s in self.constraints
            if s.kind in ("log_p", "log_adjusted_p") and s.high < 0.0
        ]
        pairs = [{int(first[q]), int(second[q])} for q in differ]
        return {
            i
            for pair in pairs
            if pair <= set(centre) and len({centre[i] for i in pair}) == 1
            for i in pair
        }

    def _varying_share(self, mean: np.ndarray, sd: np.ndarray) -> np.ndarray:
        """
        Return the error share of the variance implied by the printed F, (B, 1, 1); 1 if not small.
        """
        f_ratio = max((s.low for s in self.constraints if s.kind == "f_ratio"), default=0.0)
        error = self.n * mean.var(axis=1, ddof=1) / max(f_ratio, 1e-300)
        share = error / (sd**2).mean(axis=1)
        return np.where(share < 0.02, np.maximum(share, 1e-12), 1.0)[:, None, None]

    def search(
        self,
        mean: np.ndarray,
        factor: np.ndarray,
        margin: float = 0.0,
        stages: Sequence[float] = (0.1, 0.01, 0.001, 0.0),
        enough: int | None = None,
        iterations: int = 80,
    ) -> Moments:
        """
        Reduce violations until all constraints hold or no step helps; return the least first.

        `margin` is how far inside the intervals to go, as a share of their half-widths, in [0, 1);
        `stages` are relative widths that the intervals have at least, one stage after the other;
        the last one stops at `enough` solutions (at the end of `iterations` unless given).
        """
        x = np.concatenate([mean, factor[:, *self._triangle]], axis=1) / self.typical[1]
        for width in stages:
            x = self._descend(
                x, margin, width, 40 if width else iterations, None if width else enough
            )
        mean, factor = self._unpack(x)
        violation = self.violation(mean, factor)
        order = np.argsort(violation, kind="stable")
        return Moments(mean[order], factor[order], violation[order])

    @cached_property
    def _triangle(self) -> tuple[np.ndarray, np.ndarray]:
        """Rows and columns of the elements of G: n values have n − 1 degrees of freedom."""
        return np.tril_indices(self.k, 0, min(self.k, self.n - 1))

    def _unpack(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return means and factors of scaled unknowns."""
        factor = np.zeros((x.shape[0], self.k, self.k))
        factor[:, *self._triangle] = x[:, self.k :] * self.typical[1]
        return x[:, : self.k] * self.typical[1], factor

    def _residuals(
        self, x: np.ndarray, margin: float, width: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return how far each row lies outside its interval, in its unit, and the derivatives."""
        mean, factor = self._unpack(x)
        value, by_mean, by_covariance = self.values(self.statistics(mean, factor))
        unit = np.where(self._ends_at_one, self.unit, np.maximum(self.unit, width * self.size))
        # Intervals are widened about their middles to the width of the stage, then narrowed by the
        # margin.
        inner = (1.0 - margin) * unit - np.where(np.isfinite(self.high - self.low), self.unit, unit)
        below, above = (self.low - inner) - value, value - (self.high + inner)
        residual = np.where(above > 0.0, above, np.where(below > 0.0, -below, 0.0)) / unit
        residual = np.where(np.isfinite(value), residual, np.inf)
        # S = GG', so that dS = dG G' + G dG', and the gradient is symmetric.
        count, rows = value.shape
        gradient = by_covariance.reshape(count * rows, self.k, self.k)
        by_factor = 2.0 * products(gradient, np.repeat(factor, rows, axis=0))
        by_factor = by_factor.reshape(count, rows, self.k, self.k)[:, :, *self._triangle]
        jacobian = np.concatenate([by_mean, by_factor], axis=2) * self.typical[1] / unit[:, None]
        return residual, np.where(residual[..., None] != 0.0, jacobian, 0.0)

    def _descend(
        self, x: np.ndarray, margin: float, width: float, iterations: int, enough: int | None
    ) -> np.ndarray:
        """
        Take Levenberg-Marquardt steps on all candidates that still violate a constraint.

        SciPy's `least_squares` takes one candidate at a time, and many starts are what finds a
        solution.
        """
        x = x.copy()
        damping = np.full(x.shape[0], 1e-2)
        active = np.arange(x.shape[0])
        residual, jacobian = self._residuals(x, margin, width)
        identity, solved = np.eye(x.shape[1]), 0
        for _ in range(iterations):
            cost = (residual**2).sum(axis=1)
            keep = (cost > 0.0) & (damping[active] < 1e12)
            solved += int((cost == 0.0).sum())
            if not keep.any() or (enough is not None and solved >= enough):
                break
            active = active[keep]
            residual = residual[keep]
            jacobian = jacobian[keep]
            cost = cost[keep]
            normal = products(transposed(jacobian), jacobian)
            diagonal = np.diagonal(normal, axis1=1, axis2=2)
            floor = 1e-8 * diagonal.max(axis=1, keepdims=True) + 1e-12
            damped = normal + (damping[active, None] * (diagonal + floor))[:, :, None] * identity
            slope = products(transposed(jacobian), residual[..., None])[..., 0]
            trial = x[active] + solutions(damped, -slope)
            moved, slopes = self._residuals(trial, margin, width)
            better = np.nan_to_num((moved**2).sum(axis=1), nan=np.inf) < cost
            x[active[better]] = trial[better]
            # Less damping after a step that helps, as near a solution the full Gauss-Newton step is
            # best.
            damping[active] = np.maximum(damping[active] * np.where(better, 0.2, 5.0), 1e-10)
            residual[better], jacobian[better] = moved[better], slopes[better]
        return x
