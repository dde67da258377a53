"""
Values of n subjects with exactly given means and covariance, inside the range of a scale.

Normal draws are given the moments exactly, X = 1m' + √(n − 1) U G' with UᵀU = I, Uᵀ1 = 0 and S = GG'. While values lie
outside the range they are moved to its ends, and the nearest values with the exact moments are taken: U is the orthogonal
polar factor of the centred values times G (orthogonal Procrustes problem, Schönemann 1966; alternating projections).
"""

import numpy as np


def sample_with_moments(
    mean: np.ndarray,
    factor: np.ndarray,
    n: int,
    scale: tuple[float, float],
    rng: np.random.Generator,
    iterations: int = 2000,
) -> np.ndarray | None:
    """
    Draw values, shape (n, k), with given means and covariance GG' (n − 1 in the denominator) within a scale.

    `factor` is G, of which only the first n − 1 columns may differ from 0; the ends of the scale may be infinite. None where
    `iterations` projections find none.
    """
    factor = factor[:, : n - 1]
    low, high = scale
    inset = 1e-4 * (high - low) if np.isfinite(high - low) else 1e-3 * float(np.abs(factor).max())
    values = mean + rng.standard_normal((n, factor.shape[1])) @ factor.T
    for _ in range(iterations):
        values = _with_moments(values, mean, factor)
        if values.min() >= low and values.max() <= high:
            return values
        values = np.clip(values, low + inset, high - inset)
    return None


def _with_moments(values: np.ndarray, mean: np.ndarray, factor: np.ndarray) -> np.ndarray:
    """Return the nearest values with exactly these moments."""
    n = len(values)
    left, _, right = np.linalg.svd((values - values.mean(axis=0)) @ factor, full_matrices=False)
    whitened = left @ right
    whitened = whitened - whitened.mean(axis=0)
    return mean + np.sqrt(n - 1.0) * whitened @ factor.T
