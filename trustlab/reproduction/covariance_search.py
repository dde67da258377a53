"""
Means and covariance that have all printed statistics: damped least squares on interval violations, from many starts at once.

The unknowns are the means and a lower triangular G with S = GG', so that every S is a covariance matrix. The violation of a
statement is how far its statistic lies outside the printed interval, in half-widths of the interval; a root of all
violations is a solution (Levenberg 1944, Marquardt 1963; Gill & Murray 1978 for the scaling).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from trustlab.reproduction.moment_statistics import MomentStatistics
from trustlab.reproduction.statements import Statement

__all__ = ["MomentProblem", "Moments"]

OPEN_UNIT = 0.05
"""Unit of violation of a statement that is open to one side: natural logarithm of a p, or a share of chi-square."""


@dataclass(frozen=True, eq=False)
class Moments:
    """
    Candidate means and covariances, best first.

    Parameters
    ----------
    mean : numpy.ndarray, shape (B, k)
        Means.
    factor : numpy.ndarray, shape (B, k, k)
        Lower triangular factors G of the covariances GG'.
    violation : numpy.ndarray, shape (B,)
        Largest violation of a statement, in half-widths; 0 where all hold.
    """

    mean: np.ndarray
    factor: np.ndarray
    violation: np.ndarray

    @property
    def covariance(self) -> np.ndarray:
        """Covariance matrices, shape (B, k, k)."""
        return self.factor @ np.swapaxes(self.factor, -1, -2)

    @property
    def solved(self) -> np.ndarray:
        """Whether all statements hold, shape (B,)."""
        return self.violation <= 0.0


@dataclass(frozen=True, eq=False)
class MomentProblem:
    """
    Statements about k conditions and n subjects, as a system of inequalities in means and covariance.

    Parameters
    ----------
    found : sequence of Statement
        What must hold.
    n, k : int
        Numbers of subjects and conditions.
    p_adjust : str
        How printed pairwise p-values were adjusted; only "holm" matters here.
    corrected : bool
        Whether p of F uses corrected degrees of freedom.
    scale : tuple of float
        Range of the measure. Conditions without a printed mean and standard deviation are held to what it allows.
    """

    found: Sequence[Statement]
    n: int
    k: int
    p_adjust: str = "none"
    corrected: bool = False
    scale: tuple[float, float] = (float("-inf"), float("inf"))

    @cached_property
    def _cells(self) -> list[Statement]:
        """Printed means and standard deviations."""
        return [s for s in self.found if s.kind in ("mean", "sd") and np.isfinite(s.high - s.low)]

    @cached_property
    def rows(self) -> list[Statement]:
        """The statements, and what the scale says where they do not already imply it."""
        printed = {
            kind: {s.index: (s.low, s.high) for s in self._cells if s.kind == kind} for kind in ("mean", "sd")
        }
        rows, (low, high) = list(self.found), self.scale
        for i in range(self.k):
            mean, sd = printed["mean"].get(i, (-np.inf, np.inf)), printed["sd"].get(i, (0.0, np.inf))
            if mean[0] < low or mean[1] > high:
                rows.append(Statement(f"scale.{i}", "mean", i, low, high, "scale"))
            room = (
                min((m - low) * (high - m) for m in mean)
                if np.isfinite([low, high, *mean]).all()
                else -np.inf
            )
            if np.isfinite([low, high]).all() and sd[1] ** 2 * (self.n - 1.0) / self.n >= room:
                rows.append(Statement(f"scale.{i}", "spread", i, -np.inf, 0.0, "scale"))
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
        spread, sizes = self.typical[1], []
        for s in self.rows:
            end = s.low if np.isfinite(s.low) else s.high
            sizes.append(
                {"mean": spread, "sd": max(end, 0.01 * spread), "spread": spread**2}.get(s.kind, 1.0)
                if s.kind in ("mean", "sd", "spread") or s.kind.startswith("log")
                else max(abs(end), 1e-3)
            )
        return np.array(sizes)

    @cached_property
    def unit(self) -> np.ndarray:
        """Unit of violation, one per row: half the interval's width, or a share of `size` where it is open."""
        with np.errstate(invalid="ignore"):
            half = 0.5 * (self.high - self.low)
        unit = np.where(np.isfinite(half), np.maximum(half, 1e-12 * self.size), OPEN_UNIT * self.size)
        # No p exceeds 1: what is left of an interval that ends there.
        ends_at_one = np.isinf(self.high) & np.array(
            [s.kind in ("log_p", "log_anova_p") for s in self.rows], bool
        )
        return np.where(ends_at_one, np.minimum(unit, np.maximum(-0.5 * self.low, 1e-12)), unit)

    @cached_property
    def _ends_at_one(self) -> np.ndarray:
        return np.isinf(self.high) & np.array([s.kind in ("log_p", "log_anova_p") for s in self.rows], bool)

    @cached_property
    def typical(self) -> tuple[float, float]:
        """A typical mean and standard deviation, from what is printed."""
        middle = {
            kind: [0.5 * (s.low + s.high) for s in self._cells if s.kind == kind] for kind in ("mean", "sd")
        }
        low, high = self.scale
        width = high - low if np.isfinite(high - low) else 1.0
        mean = middle["mean"] or [low + 0.5 * width if np.isfinite(low) else 0.0]
        sd = middle["sd"] or [0.2 * width]
        return float(np.mean(mean)), float(np.mean(sd))

    def statistics(self, mean: np.ndarray, factor: np.ndarray) -> MomentStatistics:
        """
        Return the statistics of candidates.

        Parameters
        ----------
        mean : numpy.ndarray, shape (B, k)
            Means.
        factor : numpy.ndarray, shape (B, k, k)
            Factors of the covariances.
        """
        return MomentStatistics(mean, factor @ np.swapaxes(factor, -1, -2), self.n, self.corrected)

    def values(self, stats: MomentStatistics, gradient: bool = False) -> tuple[np.ndarray, ...]:
        """
        Return the statistic of every row, and its gradients with respect to means and covariance where wanted.

        Parameters
        ----------
        stats : MomentStatistics
            The candidates' statistics.
        gradient : bool
            Whether to return gradients.

        Returns
        -------
        tuple of numpy.ndarray
            Values, shape (B, rows); with `gradient` also shapes (B, rows, k) and (B, rows, k, k).
        """
        kinds = list(dict.fromkeys(s.kind for s in self.rows))
        start, value, by_mean, by_covariance = {}, [], [], []
        for kind in kinds:
            v, gm, gc = self._kind(stats, kind, gradient)
            start[kind] = sum(block.shape[1] for block in value)
            value.append(v)
            by_mean.append(gm)
            by_covariance.append(gc)
        columns = [start[s.kind] + s.index for s in self.rows]
        values = np.concatenate(value, axis=1)[:, columns]
        if not gradient:
            return (values,)
        return (
            values,
            np.concatenate(by_mean, axis=1)[:, columns],
            np.concatenate(by_covariance, axis=1)[:, columns],
        )

    def _kind(self, stats: MomentStatistics, kind: str, gradient: bool) -> tuple[np.ndarray, ...]:
        if kind == "spread":
            return self._spread(stats)
        if kind == "log_adjusted_p":
            return self._holm(stats, gradient)
        value = getattr(stats, kind)
        value = value[:, None] if value.ndim == 1 else value
        return (value, *getattr(stats, f"gradient_{kind}")) if gradient else (value, None, None)

    def _spread(self, stats: MomentStatistics) -> tuple[np.ndarray, ...]:
        """S_ii(n − 1)/n − (m − low)(high − m): positive where no values within the scale have these moments."""
        (low, high), k, share = self.scale, self.k, (self.n - 1.0) / self.n
        value = share * stats.sd**2 - (stats.mean - low) * (high - stats.mean)
        by_mean = np.zeros((*stats.mean.shape, k))
        by_mean[:, range(k), range(k)] = 2.0 * stats.mean - low - high
        by_covariance = np.zeros((*stats.mean.shape, k, k))
        by_covariance[:, range(k), range(k), range(k)] = share
        return value, by_mean, by_covariance

    def _holm(self, stats: MomentStatistics, gradient: bool) -> tuple[np.ndarray, ...]:
        """Logarithms of Holm's adjusted p; each has the gradient of the one that sets the running maximum."""
        log_p = stats.log_p
        m = log_p.shape[1]
        order = np.argsort(log_p, axis=1)
        stepped = np.take_along_axis(log_p, order, axis=1) + np.log(m - np.arange(m))
        largest = np.maximum.accumulate(stepped, axis=1)
        place = np.maximum.accumulate(np.where(stepped == largest, np.arange(m), 0), axis=1)
        value, source = np.empty_like(log_p), np.empty_like(order)
        np.put_along_axis(value, order, largest, axis=1)
        np.put_along_axis(source, order, np.take_along_axis(order, place, axis=1), axis=1)
        if not gradient:
            return value, None, None
        by_mean, by_covariance = stats.gradient_log_p
        batch = np.arange(log_p.shape[0])[:, None]
        return value, by_mean[batch, source], by_covariance[batch, source]

    def violation(self, mean: np.ndarray, factor: np.ndarray) -> np.ndarray:
        """
        Return each candidate's largest violation in half-widths, 0 where all statements hold.

        Parameters
        ----------
        mean : numpy.ndarray, shape (B, k)
            Means.
        factor : numpy.ndarray, shape (B, k, k)
            Factors of the covariances.
        """
        (value,) = self.values(self.statistics(mean, factor))
        outside = np.maximum(np.maximum(self.low - value, value - self.high), 0.0) / self.unit
        return np.where(np.isfinite(value), outside, np.inf).max(axis=1, initial=0.0)

    def starts(self, count: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        """
        Draw means and factors to start from: printed means and standard deviations, random correlations.

        Parameters
        ----------
        count : int
            How many.
        rng : numpy.random.Generator
            Source of randomness.
        """
        k, (centre, spread) = self.k, self.typical
        mean = centre + spread * rng.standard_normal((count, k))
        sd = spread * np.exp(0.3 * rng.standard_normal((count, k)))
        for s in self._cells:
            (mean if s.kind == "mean" else sd)[:, s.index] = 0.5 * (s.low + s.high)
        mean = np.clip(mean, *self.scale)
        common = rng.uniform(0.0, 3.0, (count, 1, 1))
        loading = rng.standard_normal((count, k, k)) + common * np.abs(rng.standard_normal((count, 1, k)))
        covariance = loading @ np.swapaxes(loading, -1, -2) + 0.05 * np.eye(k)
        root = np.sqrt(np.diagonal(covariance, axis1=-2, axis2=-1))
        return mean, sd[:, :, None] * np.linalg.cholesky(covariance / (root[:, :, None] * root[:, None, :]))

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
        Reduce the violations of candidates until all statements hold or nothing helps.

        Parameters
        ----------
        mean : numpy.ndarray, shape (B, k)
            Means to start from.
        factor : numpy.ndarray, shape (B, k, k)
            Factors to start from.
        margin : float
            How far inside the intervals to go, as a share of their half-widths, in [0, 1).
        stages : sequence of float
            Relative widths that the intervals have at least, one stage after the other.
        enough : int, optional
            How many solutions to stop at; all candidates are worked on to the end unless given.
        iterations : int
            Most iterations of the last stage.

        Returns
        -------
        Moments
            Least violated first.
        """
        x = np.concatenate([mean, factor[:, self._rows, self._columns]], axis=1) / self.typical[1]
        for width in stages:
            x = self._descend(x, margin, width, 40 if width else iterations, None if width else enough)
        mean, factor = self._unpack(x)
        violation = self.violation(mean, factor)
        order = np.argsort(violation, kind="stable")
        return Moments(mean[order], factor[order], violation[order])

    @cached_property
    def _rows(self) -> np.ndarray:
        return np.tril_indices(self.k)[0]

    @cached_property
    def _columns(self) -> np.ndarray:
        return np.tril_indices(self.k)[1]

    def _unpack(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        factor = np.zeros((x.shape[0], self.k, self.k))
        factor[:, self._rows, self._columns] = x[:, self.k :] * self.typical[1]
        return x[:, : self.k] * self.typical[1], factor

    def _residuals(
        self, x: np.ndarray, margin: float, width: float, gradient: bool
    ) -> tuple[np.ndarray, ...]:
        mean, factor = self._unpack(x)
        value, *slopes = self.values(self.statistics(mean, factor), gradient)
        unit = np.where(self._ends_at_one, self.unit, np.maximum(self.unit, width * self.size))
        inner = (1.0 - margin) * unit - np.where(np.isfinite(self.high - self.low), self.unit, unit)
        below, above = (self.low - inner) - value, value - (self.high + inner)
        residual = np.where(above > 0.0, above, np.where(below > 0.0, -below, 0.0)) / unit
        residual = np.where(np.isfinite(value), residual, np.inf)
        if not gradient:
            return (residual,)
        by_mean, by_covariance = slopes
        by_factor = 2.0 * (by_covariance @ factor[:, None])[:, :, self._rows, self._columns]
        jacobian = np.concatenate([by_mean, by_factor], axis=2) * self.typical[1] / unit[:, None]
        return residual, np.where(residual[..., None] != 0.0, jacobian, 0.0)

    def _descend(
        self, x: np.ndarray, margin: float, width: float, iterations: int, enough: int | None
    ) -> np.ndarray:
        """Levenberg-Marquardt on all candidates at once; a candidate stops when nothing is violated."""
        x = x.copy()
        damping = np.full(x.shape[0], 1e-2)
        active = np.arange(x.shape[0])
        residual, jacobian = self._residuals(x, margin, width, True)
        identity, solved = np.eye(x.shape[1]), 0
        for _ in range(iterations):
            cost = (residual**2).sum(axis=1)
            keep = (cost > 0.0) & (damping[active] < 1e12)
            solved += int((cost == 0.0).sum())
            if not keep.any() or (enough is not None and solved >= enough):
                break
            active, residual, jacobian, cost = active[keep], residual[keep], jacobian[keep], cost[keep]
            normal = np.swapaxes(jacobian, 1, 2) @ jacobian
            diagonal = np.diagonal(normal, axis1=1, axis2=2)
            floor = 1e-8 * diagonal.max(axis=1, keepdims=True) + 1e-12
            damped = normal + (damping[active, None] * (diagonal + floor))[:, :, None] * identity
            step = np.linalg.solve(damped, -(np.swapaxes(jacobian, 1, 2) @ residual[..., None]))[..., 0]
            trial = x[active] + step
            (found,) = self._residuals(trial, margin, width, False)
            better = np.nan_to_num((found**2).sum(axis=1), nan=np.inf) < cost
            x[active[better]] = trial[better]
            damping[active] *= np.where(better, 0.2, 5.0)
            damping[active] = np.maximum(damping[active], 1e-10)
            if better.any():
                residual[better], jacobian[better] = self._residuals(x[active[better]], margin, width, True)
        return x
