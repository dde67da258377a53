"""Covariance matrices that users hand over."""

import numpy as np

from trustlab.models.checks import finite_numbers

# Least eigenvalue, as a share of the greatest, that counts as positive.
LEAST_EIGENVALUE = 1e-12


def checked_covariance(name: str, values: np.ndarray, size: int | None = None) -> np.ndarray:
    """
    Return a matrix that is square, symmetric and positive definite; the error names the eigenvalue
    that is not.
    """
    matrix = finite_numbers(name, values)
    size = matrix.shape[0] if size is None else size
    if matrix.shape != (size, size):
        shape = " × ".join(map(str, matrix.shape)) or "one number"
        raise ValueError(f"{name} must be {size} × {size}, got {shape}")
    off = np.abs(matrix - matrix.T)
    if off.max() > 1e-8 * np.abs(matrix).max():
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
            f"(greatest {eigenvalues[-1]:.6g}); zero means that one row is a linear function "
            "of the others. Check its variances and correlations"
        )
    return matrix
