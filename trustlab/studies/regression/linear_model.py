"""
Linear models with correlated random effects by group: profiled likelihood with analytic slopes
(Bates and others, 2015).
"""

from typing import NamedTuple

import numpy as np
import pandas as pd
from scipy.optimize import minimize

from trustlab.studies.regression.newton import polished

# The search starts from random effects as large as the residual, and from smaller ones.
STARTS = (1.0, 0.2)
AT_BOUND = 1e-5  # of the ratio of a random effect's SD to the residual's


class LinearFit(NamedTuple):
    """Maximum of the likelihood, or of the restricted one."""

    llf: float
    beta: np.ndarray
    se: np.ndarray
    covariance: np.ndarray  # of the random effects
    residual: float  # variance
    singular: bool  # whether a random variance is zero, or a correlation ±1


class Profile(NamedTuple):
    """The deviance at a covariance of random effects, and what maximizes the likelihood there."""

    deviance: float
    slope: np.ndarray
    beta: np.ndarray
    inverse: np.ndarray  # of X'V⁻¹X
    residual: float


class Linear:
    """
    Scores by group: random effects z are fitted to them, or drawn.

    The covariance of a group's scores is V = σ² (I + Z Λ Λᵀ Zᵀ), Λ lower triangular with a diagonal
    that is not negative; β and σ² are profiled out. Groups enter by their cross products, so that
    the cost of a step does not depend on the number of rows.
    """

    def __init__(self, codes: np.ndarray, z: pd.DataFrame):
        self.codes, self.z = codes, z
        self._unit = np.abs(z.to_numpy()).max(axis=0)
        self._rows = z.to_numpy() / self._unit
        self._groups = int(codes.max()) + 1
        self._zz = self._summed(self._rows[:, :, None] * self._rows[:, None, :])
        self._triangle = np.tril_indices(z.shape[1])
        self._diagonal = self._triangle[0] == self._triangle[1]

    def _summed(self, rows: np.ndarray) -> np.ndarray:
        """Return the sums of rows over each group."""
        sums = np.zeros((self._groups, *rows.shape[1:]))
        np.add.at(sums, self.codes, rows)
        return sums

    def fit(self, y: np.ndarray, x: np.ndarray, reml: bool = False) -> LinearFit:
        """Return the maximum of the likelihood."""
        zx = self._summed(self._rows[:, :, None] * x[:, None, :])
        zy = self._summed(self._rows * y[:, None])
        products = x.T @ x, x.T @ y, float(y @ y), zx, zy, len(y), reml

        def loss(factor):
            profile = self._profile(factor, *products)
            return profile.deviance, profile.slope

        bounds = [(0.0, None) if diagonal else (None, None) for diagonal in self._diagonal]
        limits = {"ftol": 1e-14, "gtol": 1e-8, "maxiter": 500}
        optima = [
            minimize(
                loss,
                start * self._diagonal,
                jac=True,
                bounds=bounds,
                method="L-BFGS-B",
                options=limits,
            )
            for start in STARTS
        ]
        best = min(optima, key=lambda optimum: optimum.fun)
        # A variance at its bound stays there.
        bounded = self._diagonal & (best.x < AT_BOUND)
        factor, _ = polished(
            lambda point: loss(point)[1], np.where(bounded, 0.0, best.x), np.flatnonzero(~bounded)
        )
        profile = self._profile(factor, *products)
        lower = np.zeros((self.z.shape[1],) * 2)
        lower[self._triangle] = factor
        lower /= self._unit[:, None]
        return LinearFit(
            llf=-0.5 * profile.deviance,
            beta=profile.beta,
            se=np.sqrt(profile.residual * np.diag(profile.inverse)),
            covariance=profile.residual * lower @ lower.T,
            residual=profile.residual,
            singular=bool((np.abs(factor[self._diagonal]) < 1e-4).any()),
        )

    def _profile(self, factor, xx, xy, yy, zx, zy, n, reml) -> Profile:
        """Return −2 log-likelihood at Λ, profiled over β and σ², and its slope in Λ."""
        q, p = self.z.shape[1], len(xx)
        lower = np.zeros((q, q))
        lower[self._triangle] = factor
        # Woodbury: V⁻¹ = I − Z Λ B Λᵀ Zᵀ with B = (I + Λᵀ Zᵀ Z Λ)⁻¹, per group.
        inner = np.eye(q) + lower.T @ self._zz @ lower
        middle = np.linalg.inv(inner)
        shrink = lower @ middle @ lower.T
        left = np.eye(q) - self._zz @ shrink  # Zᵀ V⁻¹ = left Zᵀ
        weighted = xx - np.einsum("gqa,gqr,grb->ab", zx, shrink, zx)
        inverse = np.linalg.inv(weighted)
        beta = inverse @ (xy - np.einsum("gqa,gqr,gr->a", zx, shrink, zy))
        rest = zy - zx @ beta
        square = yy - 2.0 * beta @ xy + beta @ xx @ beta
        square -= np.einsum("gq,gqr,gr->", rest, shrink, rest)
        degrees = n - p if reml else n
        residual = square / degrees
        deviance = np.linalg.slogdet(inner)[1].sum() + degrees * (
            1.0 + np.log(2.0 * np.pi * residual)
        )
        pull = np.einsum("gqr,gr->gq", left, rest)
        slope = 2.0 * (self._zz @ lower @ middle).sum(axis=0)
        slope -= 2.0 / residual * pull.T @ (pull @ lower)
        if reml:
            spread = left @ zx
            deviance += np.linalg.slogdet(weighted)[1]
            slope -= 2.0 * np.einsum("gqa,ab,grb->qr", spread, inverse, spread) @ lower
        return Profile(deviance, slope[self._triangle], beta, inverse, residual)

    def draw(self, fit: LinearFit, x: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Return scores drawn from a fitted model."""
        values, vectors = np.linalg.eigh(fit.covariance)
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        effects = rng.standard_normal((self._groups, self.z.shape[1])) @ root.T
        noise = np.sqrt(fit.residual) * rng.standard_normal(self.codes.size)
        return x @ fit.beta + (self.z.to_numpy() * effects[self.codes]).sum(axis=1) + noise
