"""Linear algebra in a fixed order. Oracle: NumPy's LAPACK, and products written out."""

from fractions import Fraction

import numpy as np
import pytest
from scipy import linalg

from trustlab.models.linear_algebra import (
    cholesky_factors,
    inverses,
    matrix_exponential,
    polar_factor,
    products,
    solutions,
    symmetric_eigen,
)


def covariances(rng, size, count=20):
    rows = rng.normal(size=(count, size + 3, size)) * 10.0 ** rng.uniform(-3, 3, size=(count, 1, 1))
    return np.swapaxes(rows, 1, 2) @ rows / (size + 2)


@pytest.mark.parametrize("size", [1, 2, 3, 5, 10])
def test_factors_solutions_and_inverses_agree_with_lapack(size):
    rng = np.random.default_rng(size)
    matrices = covariances(rng, size)
    factor, exists = cholesky_factors(matrices)
    assert exists.all()
    scale = np.abs(matrices).max(axis=(1, 2), keepdims=True)
    np.testing.assert_allclose(
        products(factor, factor.swapaxes(1, 2)) / scale, matrices / scale, atol=1e-14
    )
    general = rng.normal(size=(20, size, size))
    right = rng.normal(size=(20, size))
    residual = products(general, solutions(general, right)[..., None])[..., 0] - right
    assert np.abs(residual).max() < 1e-11
    np.testing.assert_allclose(inverses(general), np.linalg.inv(general), rtol=1e-8, atol=1e-9)


@pytest.mark.parametrize("size", [1, 2, 3, 5, 10])
def test_eigenvalues_and_vectors_agree_with_lapack(size):
    matrices = covariances(np.random.default_rng(10 + size), size)
    values, vectors = symmetric_eigen(matrices)
    scale = np.abs(matrices).max(axis=(1, 2))
    expected = np.linalg.eigvalsh(matrices)
    assert np.abs((values - expected) / scale[:, None]).max() < 1e-13
    again = products(vectors * values[:, None, :], vectors.swapaxes(1, 2).copy())
    assert np.abs((again - matrices) / scale[:, None, None]).max() < 1e-13
    identity = products(vectors.swapaxes(1, 2).copy(), vectors)
    assert np.abs(identity - np.eye(size)).max() < 1e-13


def test_equal_eigenvalues_and_diagonal_matrices():
    values, vectors = symmetric_eigen(np.array([np.eye(3), np.diag([3.0, 1.0, 2.0])]))
    assert values.tolist() == [[1.0, 1.0, 1.0], [1.0, 2.0, 3.0]]
    assert vectors[1].tolist() == [[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]


def test_a_product_has_the_bits_of_its_order():
    rng = np.random.default_rng(0)
    a, b = rng.normal(size=(1, 3, 4)), rng.normal(size=(1, 4, 2))
    for i in range(3):
        for j in range(2):
            total = 0.0
            for k in range(4):
                total = total + a[0, i, k] * b[0, k, j]
            exact = sum(Fraction(a[0, i, k]) * Fraction(b[0, k, j]) for k in range(4))
            assert products(a, b)[0, i, j] == total
            assert abs(float(exact) - total) < 1e-14


def test_what_has_no_factor_or_no_solution_is_said():
    indefinite = np.array([[[1.0, 2.0], [2.0, 1.0]], [[2.0, 0.0], [0.0, 1.0]]])
    factor, exists = cholesky_factors(indefinite)
    assert exists.tolist() == [False, True]
    assert np.isnan(factor[0]).all()
    singular = np.array([[[1.0, 2.0], [2.0, 4.0]]])
    assert np.isnan(solutions(singular, np.ones((1, 2)))).all()
    assert np.isnan(inverses(singular)).all()


@pytest.mark.parametrize("shape", [(5, 1), (18, 5), (36, 10)])
def test_polar_factor_is_that_of_the_singular_values(shape):
    matrix = np.random.default_rng(shape[0]).normal(size=shape)
    left, _, right = np.linalg.svd(matrix, full_matrices=False)
    assert polar_factor(matrix) == pytest.approx(left @ right, abs=1e-13)


def test_polar_factor_leaves_out_a_direction_without_extent():
    matrix = np.random.default_rng(0).normal(size=(6, 3))
    matrix[:, 1] = 0.0
    factor = polar_factor(matrix)
    assert not factor[:, 1].any()
    assert factor.T @ factor == pytest.approx(np.diag([1.0, 0.0, 1.0]), abs=1e-13)


@pytest.mark.parametrize("scale", [1e-3, 0.4, 7.0])
def test_matrix_exponential_agrees_with_scipy(scale):
    matrix = scale * np.random.default_rng(1).normal(size=(5, 5))
    expected = linalg.expm(matrix)
    assert matrix_exponential(matrix) / np.abs(expected).max() == pytest.approx(
        expected / np.abs(expected).max(), abs=1e-13
    )
    assert matrix_exponential(np.zeros((3, 3))).tolist() == np.eye(3).tolist()
