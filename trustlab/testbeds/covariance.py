"""Covariance matrices that users hand over."""

import numpy as np

# Least eigenvalue, as a share of the greatest, that counts as positive.
LEAST_EIGENVALUE = 1e-12


def checked_covariance(name: str, values: np.ndarray, size: int | None = None) -> np.ndarray:
    """
    Return a matrix that is square, symmetric and positive definite; the error names the eigenvalue
    that is not.
    """
    try:
        array = np.asarray(values)
    except ValueError:  # rows of different lengths
        array = np.empty(0, dtype=object)
    numbers = array.dtype.kind in "fiu"
    if not numbers or array.ndim != 2 or array.shape[0] != array.shape[1] or array.size == 0:
        kind = f"shape {array.shape}" if numbers else type(values).__name__
        raise ValueError(f"{name} must be a square matrix of numbers, got {kind}")
    matrix = array.astype(float)
    if size is not None and len(matrix) != size:
        raise ValueError(
            f"{name} must be {size} × {size}, one row per condition, got {len(matrix)} × "
            f"{len(matrix)}"
        )
    if not np.isfinite(matrix).all():
        i, j = np.argwhere(~np.isfinite(matrix))[0]
        raise ValueError(f"{name} must be finite, but row {i}, column {j} is {matrix[i, j]}")
    scale = np.abs(matrix).max()
    off = np.abs(matrix - matrix.T)
    if off.max() > 1e-8 * scale:
        i, j = np.unravel_index(int(np.argmax(off)), off.shape)
        raise ValueError(
            f"{name} must be symmetric, but [{i}, {j}] is {matrix[i, j]:g} and [{j}, {i}] is "
            f"{matrix[j, i]:g}"
        )
    matrix = 0.5 * (matrix + matrix.T)
    eigenvalues = np.linalg.eigvalsh(matrix)
    if not eigenvalues[0] > LEAST_EIGENVALUE * eigenvalues[-1]:
        raise ValueError(
            f"{name} is not positive definite: its least eigenvalue is {eigenvalues[0]:.6g} "
            f"(greatest {eigenvalues[-1]:.6g}); zero means that one condition is a linear function "
            "of the others. Check its variances and correlations"
        )
    return matrix
