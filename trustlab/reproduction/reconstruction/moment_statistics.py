"""
Repeated-measures statistics of many means and covariances, with their gradients.

One-way within-subject F, Greenhouse-Geisser epsilon, Mauchly's W and chi-square and paired t all
follow from the k means m and the k x k covariance S (n − 1 in the denominator). With P = I − 11'/k,
T = tr(PS), Q = tr(PSPS) and A the covariance of k − 1 orthonormal contrasts: F = n Σ(m − m̄)²/T, ε
= T²/((k − 1)Q), W = det A/(T/(k − 1))^(k − 1), χ² = −(n − 1) d ln W, d = 1 − (2p² + p + 2)/(6p(n −
1)), p = k − 1, and t_ij = (m_i − m_j)/√(V_ij/n) with V_ij the variance of a difference (Mauchly
1940; Greenhouse & Geisser 1959).
"""

from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np

from trustlab.models.linear_algebra import cholesky_factors, inverses
from trustlab.reproduction.reconstruction.p_values import log_p_of_f, log_p_of_t, logarithms
from trustlab.studies.anova import mauchly_factor

TINY = 1e-300


@cache
def pair_indices(k: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the rows i and columns j of all pairs, i < j, as in the statistics' last axis."""
    return np.triu_indices(k, 1)


@dataclass(frozen=True, eq=False)
class MomentStatistics:
    """
    The statistics of B sets of means (B, k) and covariances (B, k, k) of n subjects.

    Covariances have n − 1 in their denominator.

    `corrected` says whether the p-value of F uses degrees of freedom multiplied by the
    Greenhouse-Geisser epsilon.
    """

    mean: np.ndarray
    covariance: np.ndarray
    n: int
    corrected: bool = False

    @property
    def k(self) -> int:
        """Number of conditions."""
        return self.mean.shape[-1]

    @cached_property
    def sd(self) -> np.ndarray:
        """Standard deviations, shape (B, k)."""
        return np.sqrt(np.diagonal(self.covariance, axis1=-2, axis2=-1))

    @cached_property
    def _centred(self) -> np.ndarray:
        rows = self.covariance - self.covariance.mean(axis=-1, keepdims=True)
        return rows - rows.mean(axis=-2, keepdims=True)

    @cached_property
    def _trace(self) -> np.ndarray:
        return np.maximum(np.trace(self._centred, axis1=-2, axis2=-1), TINY)

    @cached_property
    def _square(self) -> np.ndarray:
        return np.maximum((self._centred**2).sum(axis=(-2, -1)), TINY)

    @cached_property
    def f_ratio(self) -> np.ndarray:
        """F of the one-way within-subject analysis, shape (B,)."""
        return self.n * self.mean.var(axis=-1) * self.k / self._trace

    @cached_property
    def epsilon(self) -> np.ndarray:
        """Greenhouse-Geisser epsilon, shape (B,)."""
        return self._trace**2 / ((self.k - 1) * self._square)

    @cached_property
    def chi2(self) -> np.ndarray:
        """Mauchly's chi-square, shape (B,)."""
        p = self.k - 1
        # det A of orthonormal contrasts is the product of the p nonzero eigenvalues of PSP: shift
        # the zero one to 1.
        factor, _ = cholesky_factors(self._centred / self._trace[:, None, None] * p + 1.0 / self.k)
        roots = np.ascontiguousarray(np.diagonal(factor, axis1=-2, axis2=-1))
        return -2.0 * mauchly_factor(self.n, self.k) * logarithms(roots).sum(axis=-1)

    @cached_property
    def difference_variance(self) -> np.ndarray:
        """Variances of the pairwise differences, shape (B, pairs)."""
        i, j = pair_indices(self.k)
        variance = (
            self.covariance[:, i, i] + self.covariance[:, j, j] - 2.0 * self.covariance[:, i, j]
        )
        return np.maximum(variance, TINY)

    @cached_property
    def t(self) -> np.ndarray:
        """Paired t of all pairs, shape (B, pairs)."""
        i, j = pair_indices(self.k)
        return (self.mean[:, i] - self.mean[:, j]) / np.sqrt(self.difference_variance / self.n)

    @cached_property
    def _log_p_and_slope(self) -> tuple[np.ndarray, np.ndarray]:
        return log_p_of_t(self.t, self.n - 1.0)

    @property
    def log_p(self) -> np.ndarray:
        """Natural logarithms of the unadjusted two-sided p of all pairs, shape (B, pairs)."""
        return self._log_p_and_slope[0]

    @cached_property
    def _log_anova_p_and_slopes(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return log_p_of_f(self.f_ratio, self.epsilon, self.k, self.n, self.corrected)

    @property
    def log_anova_p(self) -> np.ndarray:
        """Natural logarithm of the p of F, shape (B,)."""
        return self._log_anova_p_and_slopes[0]

    # Gradients of Q statistics: with respect to the means, shape (B, Q, k), and to the covariance,
    # shape (B, Q, k, k), symmetric: a small symmetric change dS changes the statistic by the sum of
    # gradient * dS.

    @property
    def gradient_mean(self) -> tuple[np.ndarray, np.ndarray]:
        """The gradients of the k means."""
        B, k = self.mean.shape
        return np.broadcast_to(np.eye(k), (B, k, k)), np.zeros((B, k, k, k))

    @property
    def gradient_sd(self) -> tuple[np.ndarray, np.ndarray]:
        """The gradients of the k standard deviations."""
        B, k = self.mean.shape
        by_covariance = np.zeros((B, k, k, k))
        by_covariance[:, range(k), range(k), range(k)] = 0.5 / self.sd
        return np.zeros((B, k, k)), by_covariance

    @property
    def gradient_f_ratio(self) -> tuple[np.ndarray, np.ndarray]:
        """The gradient of F."""
        centring = np.eye(self.k) - 1.0 / self.k
        by_mean = (
            2.0
            * self.n
            * (self.mean - self.mean.mean(axis=-1, keepdims=True))
            / self._trace[:, None]
        )
        return by_mean[:, None], -(self.f_ratio / self._trace)[:, None, None, None] * centring

    @property
    def gradient_epsilon(self) -> tuple[np.ndarray, np.ndarray]:
        """The gradient of the Greenhouse-Geisser epsilon."""
        centring = np.eye(self.k) - 1.0 / self.k
        by_covariance = (
            centring / self._trace[:, None, None] - self._centred / self._square[:, None, None]
        )
        return np.zeros_like(self.mean)[:, None], (
            2.0 * self.epsilon[:, None, None] * by_covariance
        )[:, None]

    @property
    def gradient_chi2(self) -> tuple[np.ndarray, np.ndarray]:
        """The gradient of Mauchly's chi-square."""
        p = self.k - 1
        centring = np.eye(self.k) - 1.0 / self.k
        scale = (self._trace / p)[:, None, None]
        inverse = inverses(self._centred / scale + 1.0 / self.k) - 1.0 / self.k
        by_covariance = -mauchly_factor(self.n, self.k) * (inverse - centring) / scale
        return np.zeros_like(self.mean)[:, None], by_covariance[:, None]

    @property
    def gradient_log_p(self) -> tuple[np.ndarray, np.ndarray]:
        """The gradients of the logarithms of the unadjusted p of all pairs."""
        rows = np.arange(self.t.shape[-1])
        difference = np.zeros((rows.size, self.k))
        i, j = pair_indices(self.k)
        difference[rows, i], difference[rows, j] = 1.0, -1.0
        slope = self._log_p_and_slope[1]
        by_mean = (slope / np.sqrt(self.difference_variance / self.n))[..., None] * difference
        step = -0.5 * slope * self.t / self.difference_variance
        return by_mean, step[..., None, None] * (difference[:, :, None] * difference[:, None, :])

    @property
    def gradient_log_anova_p(self) -> tuple[np.ndarray, np.ndarray]:
        """The gradient of the logarithm of the p of F."""
        F_mean, F_covariance = self.gradient_f_ratio
        _, e_covariance = self.gradient_epsilon
        _, by_F, by_epsilon = self._log_anova_p_and_slopes
        by_covariance = (
            by_F[:, None, None, None] * F_covariance
            + by_epsilon[:, None, None, None] * e_covariance
        )
        return by_F[:, None, None] * F_mean, by_covariance
