"""
Proof that no data set has certain printed statistics: a linear relaxation with cutting planes.

The unknowns are the variances q_i and the variances of differences V_ij; the covariance matrix is
linear in them. Printed standard deviations, means and pairwise p bound them; F bounds their sum, T
= Σ V_ij/k. What is left is convex and cut off by planes where a solution violates it (Kelley 1960):
no combination of conditions has a negative variance; ε ≥ e is the cone ‖PSP‖ ≤ T/√((k − 1)e); W ≥ w
is det(A)^(1/p) ≥ w^(1/p) T/p. The upper ends of ε and W are not convex and are left out, so that
"infeasible" is certain, and "feasible" is inconclusive.

Of the 12 adjustments of p that are proved impossible for printed studies, intervals alone refute 2
and one relaxation 9. Without the cone of ε 10 are refuted in all, and without that of W 8.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import product

import numpy as np
from scipy import optimize, special

from trustlab.reproduction.reconstruction.constraints import Constraint, Interval
from trustlab.reproduction.reconstruction.moment_search import MomentProblem
from trustlab.reproduction.reconstruction.moment_statistics import pair_indices
from trustlab.studies.anova import mauchly_factor


def _cells(constraints: Sequence[Constraint], kind: str, k: int, default: Interval) -> np.ndarray:
    """Return the intervals of a kind of statistic, shape (k, 2), intersected where several."""
    bounds = np.tile(np.array(default, dtype=float), (k, 1))
    for s in constraints:
        if s.kind == kind:
            bounds[s.index] = max(bounds[s.index, 0], s.low), min(bounds[s.index, 1], s.high)
    return bounds


def _raw_intervals(constraints: Sequence[Constraint], pairs: int, p_adjust: str) -> np.ndarray:
    """Return the ends of each pair's log p before adjustment; for Holm over all orders of ties."""
    bounds = _cells(constraints, "log_p", pairs, (-np.inf, 0.0))
    if p_adjust != "holm":
        return bounds
    low, high = _cells(constraints, "log_adjusted_p", pairs, (-np.inf, np.inf)).T
    # A pair's place in the order lies between the number of pairs surely before it and of those
    # surely behind.
    first = 1 + (high[None, :] < low[:, None]).sum(axis=1)
    last = pairs - (low[None, :] > high[:, None]).sum(axis=1)
    bounds[:, 0] = np.maximum(bounds[:, 0], low - np.log(pairs - first + 1))
    bounds[:, 1] = np.minimum(bounds[:, 1], high - np.log(pairs - last + 1))
    return bounds


def _spread_of_means(mean: np.ndarray) -> Interval:
    """Return the least and greatest Σ(m − m̄)² over a box of means."""
    k, (low, high) = len(mean), mean.T
    fit = optimize.lsq_linear(np.eye(k) - 1.0 / k, np.zeros(k), (low, high + 1e-300))
    # The tangent at the fit is a lower bound everywhere, however accurate the fit: the proof must
    # not rest on it.
    slope = 2.0 * (fit.x - fit.x.mean())
    reach = np.where(slope > 0.0, fit.x - low, high - fit.x)
    least = ((fit.x - fit.x.mean()) ** 2).sum() - np.abs(slope) @ reach
    return max(least, 0.0), max(np.var(corner) * k for corner in product(*mean))


class _Relaxation:
    """The linear programme: maximise the depth behind all planes; columns q, V, depth."""

    def __init__(self, problem: MomentProblem) -> None:
        constraints = problem.constraints
        n = problem.n
        k = problem.k
        scale = problem.scale
        self.k, self.n = k, n
        self.i, self.j = pair_indices(k)
        mean, sd = (
            _cells(constraints, "mean", k, scale),
            _cells(constraints, "sd", k, (0.0, np.inf)),
        )
        self.empty = bool((mean[:, 0] > mean[:, 1]).any() or (sd[:, 0] > sd[:, 1]).any())
        _, spread = problem.typical
        self.size = spread**2  # the unit of the unknowns
        self.q = np.maximum(sd, 0.0) ** 2
        if np.isfinite(scale).all():
            middle = np.clip(0.5 * sum(scale), mean[:, 0], mean[:, 1])
            largest = (middle - scale[0]) * (scale[1] - middle) * n / (n - 1)
            self.q[:, 1] = np.minimum(self.q[:, 1], largest)
        log_p = _raw_intervals(constraints, len(self.i), problem.p_adjust)
        self.variance = self._difference_variances(mean, log_p)
        self.trace = (0.0, np.inf)
        f_low, f_high = _cells(constraints, "f_ratio", 1, (0.0, np.inf))[0]
        if np.isfinite(mean).all() and not self.empty:
            least, most = _spread_of_means(mean)
            self.trace = n * least / f_high, (n * most / f_low if f_low > 0.0 else np.inf)
            self.empty |= f_low > f_high
        self.epsilon = _cells(constraints, "epsilon", 1, (1.0 / (k - 1), 1.0))[0]
        chi2 = _cells(constraints, "chi2", 1, (0.0, np.inf))[0]
        self.log_w = -chi2[1] / mauchly_factor(n, k) if k > 2 else -np.inf
        self.empty |= self.epsilon[0] > self.epsilon[1] or chi2[0] > chi2[1]

    def _difference_variances(self, mean: np.ndarray, log_p: np.ndarray) -> np.ndarray:
        """Return the ends of each difference's variance, n (m_i − m_j)²/t², from means and p."""
        n = self.n
        i = self.i
        j = self.j
        with np.errstate(invalid="ignore"):
            high = np.maximum(mean[i, 1] - mean[j, 0], mean[j, 1] - mean[i, 0])
            low = np.maximum(np.maximum(mean[i, 0] - mean[j, 1], mean[j, 0] - mean[i, 1]), 0.0)
        # The greatest p belongs to the least t.
        t_low, t_high = -special.stdtrit(n - 1, 0.5 * np.exp(np.minimum(log_p.T[::-1], 0.0)))
        with np.errstate(divide="ignore", invalid="ignore"):
            least = np.where(np.isfinite(t_high) & (t_high > 0.0), n * low**2 / t_high**2, 0.0)
            most = np.where(t_low > 1e-12, n * high**2 / t_low**2, np.inf)
        return np.column_stack(
            [np.nan_to_num(least, nan=0.0), np.where(np.isnan(most), np.inf, most)]
        )

    def covariance(self, x: np.ndarray) -> np.ndarray:
        """Return the covariance matrix at a solution."""
        k = self.k
        S = np.diag(x[:k])
        S[self.i, self.j] = S[self.j, self.i] = 0.5 * (
            x[self.i] + x[self.j] - x[k : k + len(self.i)]
        )
        return S

    def row(self, M: np.ndarray) -> np.ndarray:
        """
        Return the coefficients of <M, S> in q and V, for symmetric M; the last column is the depth.
        """
        off = M[self.i, self.j]
        q = np.diag(M) + np.bincount(self.i, off, self.k) + np.bincount(self.j, off, self.k)
        return np.concatenate([q, -off, [0.0]])

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """
        Return rows and right-hand sides of all intervals, each widened by a millionth of itself.
        """
        k, pairs = self.k, len(self.i)
        trace = np.concatenate([np.zeros(k), np.full(pairs, 1.0 / k)])
        units = np.column_stack([np.vstack([np.eye(k + pairs), trace]), np.zeros(k + pairs + 1)])
        low, high = np.array([*self.q, *self.variance, self.trace]).T / self.size
        # Above and below by turns: unit · x ≤ high, −unit · x ≤ −low.
        rows = np.stack([units, -units], axis=1).reshape(-1, k + pairs + 1)
        right = np.column_stack([high * (1.0 + 1e-6), -low * (1.0 - 1e-6)]).ravel()
        binding = np.column_stack([np.isfinite(high), low > 0.0]).ravel()
        return rows[binding], right[binding]

    def cuts(self, x: np.ndarray) -> list[np.ndarray]:
        """
        Return planes row · x ≤ 0 that all covariance matrices satisfy and this solution does not.
        """
        k = self.k
        S = self.covariance(x)
        planes = []
        value, vector = np.linalg.eigh(S)
        planes += [
            -self.row(np.outer(v, v)) for e, v in zip(value, vector.T, strict=True) if e < -1e-9
        ]
        P = np.eye(k) - 1.0 / k
        centred = P @ S @ P
        trace, size = np.trace(centred), np.linalg.norm(centred)
        if self.epsilon[0] > 1.0 / (k - 1) and size > 0.0:
            limit = 1.0 / np.sqrt((k - 1) * self.epsilon[0])
            if size > trace * limit + 1e-9:
                planes.append(self.row(centred / size - limit * P))
        if np.isfinite(self.log_w) and trace > 1e-6 * np.abs(x[:-1]).max():
            # 11'/k turns the eigenvalue 0 of PSP into 1, so that the determinant is that of the
            # contrasts.
            value, vector = np.linalg.eigh(centred / trace + np.full((k, k), 1.0 / k))
            value = np.maximum(value, 1e-6)
            log_w = np.log(value).sum() + (k - 1) * np.log(k - 1)
            if log_w < self.log_w - 1e-9:
                B = P @ (vector / value) @ vector.T @ P
                root = np.exp((self.log_w - np.log(value).sum()) / (k - 1))
                planes.append(self.row(root * P - B))
        return [row / np.linalg.norm(row) for row in planes]


def proves_infeasible(problem: MomentProblem, branches: int = 80) -> bool:
    """
    Return whether it is proved that no means and covariance satisfy the constraints of a problem.

    True when even the relaxation has no solution, with all its intervals widened by a millionth of
    themselves; False is inconclusive. At most `branches` relaxations are solved: the widest
    interval of a mean is halved until each part is refuted.
    """
    constraints, k = list(problem.constraints), problem.k
    if np.isfinite(problem.scale).all():
        constraints += [Constraint("scale", "mean", i, *problem.scale, "") for i in range(k)]
    apart = [s for s in constraints if s.kind != "mean"]
    open_parts = [_cells(constraints, "mean", k, (-np.inf, np.inf))]
    for _ in range(branches):
        if not open_parts:
            return True
        box = open_parts.pop()
        bounded = np.isfinite(box).all(axis=1)
        means = [
            Constraint("mean", "mean", i, low, high, "")
            for i, (low, high) in enumerate(box)
            if bounded[i]
        ]
        if _refuted(_Relaxation(replace(problem, constraints=[*apart, *means]))):
            continue
        width = np.where(bounded, box[:, 1] - box[:, 0], 0.0)
        i = int(np.argmax(width))
        if width[i] <= 1e-9:
            return False
        for half in (0, 1):
            part = box.copy()
            part[i, half] = box[i].mean()
            open_parts.append(part)
    return not open_parts


def _refuted(problem: _Relaxation, rounds: int = 100) -> bool:
    """Add cutting planes until no point is left (True) or the deepest violates none (False)."""
    if problem.empty:
        return True
    rows, right = problem.bounds()
    columns = rows.shape[1] - 1
    limits = [(0.0, 1e6)] * columns + [(-1e3, 1.0)]
    depth = np.append(np.zeros(columns), -1.0)
    for _ in range(rounds):
        solution = optimize.linprog(depth, rows, right, bounds=limits, method="highs")
        if solution.status == 2 or (solution.status == 0 and solution.x[-1] < -1e-6):
            return True
        cuts = problem.cuts(solution.x) if solution.status == 0 else []
        if not cuts:
            return False
        rows = np.vstack([rows, np.array(cuts) + np.eye(columns + 1)[-1]])
        right = np.append(right, np.zeros(len(cuts)))
    return False
