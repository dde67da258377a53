"""
Linear algebra of small matrices in a fixed order of operations: the same bits on every machine.

BLAS and LAPACK choose their kernels by the processor, so that the last bits of a product or a
factor differ between machines. That is enough to turn a search, an acceptance or a switch another
way. What decides such a branch is computed here, one operation after the other. All functions take
stacks of matrices; sizes are meant to be small (k ≤ 10 or so), where this is as fast as LAPACK.
"""

import numpy as np

from trustlab.models.compiled import njit

# Sweeps after which Jacobi's rotations give up; ten suffice for every matrix of double precision.
SWEEPS = 60


def transposed(a: np.ndarray) -> np.ndarray:
    """Return a stack of matrices with rows and columns exchanged, contiguous."""
    return np.ascontiguousarray(np.swapaxes(a, -1, -2))


@njit
def products(a, b):
    """Return a @ b for stacks of matrices, shapes (B, m, k) and (B, k, n)."""
    count, rows, inner = a.shape
    columns = b.shape[2]
    out = np.zeros((count, rows, columns))
    for c in range(count):
        for i in range(rows):
            for k in range(inner):
                for j in range(columns):
                    out[c, i, j] += a[c, i, k] * b[c, k, j]
    return out


@njit
def cholesky_factors(a):
    """
    Return lower factors L with L Lᵀ = a, shape (B, k, k), and whether each matrix has one.

    The factor of a matrix that is not positive definite is NaN.
    """
    count, size, _ = a.shape
    factor = np.zeros((count, size, size))
    exists = np.ones(count, dtype=np.bool_)
    for c in range(count):
        for j in range(size):
            pivot = a[c, j, j]
            for k in range(j):
                pivot -= factor[c, j, k] * factor[c, j, k]
            if not pivot > 0.0:
                exists[c] = False
                factor[c] = np.nan
                break
            root = np.sqrt(pivot)
            factor[c, j, j] = root
            for i in range(j + 1, size):
                entry = a[c, i, j]
                for k in range(j):
                    entry -= factor[c, i, k] * factor[c, j, k]
                factor[c, i, j] = entry / root
    return factor, exists


@njit
def solutions(a, b):
    """
    Return x with a x = b by Gaussian elimination with partial pivoting, shapes (B, k, k), (B, k).

    The solution of a singular system is NaN.
    """
    count, size, _ = a.shape
    out = np.empty((count, size))
    for c in range(count):
        matrix = a[c].copy()
        right = b[c].copy()
        regular = True
        for j in range(size):
            pivot = j
            for i in range(j + 1, size):
                if abs(matrix[i, j]) > abs(matrix[pivot, j]):
                    pivot = i
            if not abs(matrix[pivot, j]) > 0.0:
                regular = False
                break
            if pivot != j:
                for k in range(size):
                    matrix[j, k], matrix[pivot, k] = matrix[pivot, k], matrix[j, k]
                right[j], right[pivot] = right[pivot], right[j]
            for i in range(j + 1, size):
                ratio = matrix[i, j] / matrix[j, j]
                for k in range(j, size):
                    matrix[i, k] -= ratio * matrix[j, k]
                right[i] -= ratio * right[j]
        # numbers one by one, for numba takes seconds to compile assignments of rows
        for i in range(size - 1, -1, -1):
            if not regular:
                out[c, i] = np.nan
                continue
            for k in range(i + 1, size):
                right[i] -= matrix[i, k] * right[k]
            right[i] /= matrix[i, i]
            out[c, i] = right[i]
    return out


@njit
def inverses(a):
    """Return the inverses of a stack of matrices, shape (B, k, k); NaN where one is singular."""
    count, size, _ = a.shape
    out = np.empty((count, size, size))
    column = np.zeros((count, size))
    for j in range(size):
        for c in range(count):
            for i in range(size):
                column[c, i] = 1.0 if i == j else 0.0
        solved = solutions(a, column)
        for c in range(count):
            for i in range(size):
                out[c, i, j] = solved[c, i]
    return out


@njit
def symmetric_eigen(a):
    """
    Return eigenvalues, ascending, and eigenvectors in columns of symmetric matrices (B, k, k).

    Jacobi's cyclic rotations (Golub and Van Loan, Matrix Computations, 2013, Section 8.5). The
    first entry of each vector that is not near zero is positive.
    """
    count, size, _ = a.shape
    values = np.full((count, size), np.nan)
    vectors = np.empty((count, size, size))
    for c in range(count):
        matrix = a[c].copy()
        basis = np.eye(size)
        for _ in range(SWEEPS):
            if not _rotate_once_round(matrix, basis):
                break
        for place in range(size):
            j = _rank(matrix, place)
            values[c, j] = matrix[place, place]
            vector = _with_positive_start(basis[:, place])
            for i in range(size):
                vectors[c, i, j] = vector[i]
    return values, vectors


@njit
def _rank(matrix, place):
    """Return how many entries of the diagonal come before this one in ascending order."""
    value = matrix[place, place]
    rank = 0
    for i in range(len(matrix)):
        if matrix[i, i] < value or (matrix[i, i] == value and i < place):
            rank += 1
    return rank


@njit
def _rotate_once_round(matrix, basis):
    """Annihilate every off-diagonal entry in turn, in place; return whether any was not zero."""
    size = len(matrix)
    rotated = False
    for p in range(size - 1):
        for q in range(p + 1, size):
            entry = matrix[p, q]
            scale = abs(matrix[p, p]) + abs(matrix[q, q])
            if abs(entry) <= 1e-18 * scale or entry == 0.0:
                continue
            rotated = True
            slope = (matrix[q, q] - matrix[p, p]) / (2.0 * entry)
            tangent = 1.0 / (abs(slope) + np.sqrt(1.0 + slope * slope))
            if slope < 0.0:
                tangent = -tangent
            cosine = 1.0 / np.sqrt(1.0 + tangent * tangent)
            sine = tangent * cosine
            _turn_columns(matrix, p, q, cosine, sine)
            _turn_columns(matrix.T, p, q, cosine, sine)
            _turn_columns(basis, p, q, cosine, sine)
            matrix[p, q] = 0.0
            matrix[q, p] = 0.0
    return rotated


@njit
def _with_positive_start(vector):
    """Return a vector or its opposite, so that its first entry above 1e-8 is positive."""
    for k in range(len(vector)):
        if abs(vector[k]) > 1e-8:
            return vector.copy() if vector[k] > 0.0 else -vector
    return vector.copy()


@njit
def polar_factor(a):
    """
    Return the orthonormal polar factor of a matrix (m, n), m ≥ n, by one-sided Jacobi rotations.

    The nearest matrix with orthonormal columns (Hestenes 1958; Golub and Van Loan 2013, Section
    8.6). A direction in which the matrix has no extent is left out.
    """
    rows, columns = a.shape
    left = a.copy()
    basis = np.eye(columns)
    for _ in range(SWEEPS):
        rotated = False
        for p in range(columns - 1):
            for q in range(p + 1, columns):
                first = 0.0
                second = 0.0
                product = 0.0
                for i in range(rows):
                    first += left[i, p] * left[i, p]
                    second += left[i, q] * left[i, q]
                    product += left[i, p] * left[i, q]
                if abs(product) <= 1e-15 * np.sqrt(first * second):
                    continue
                rotated = True
                slope = (second - first) / (2.0 * product)
                tangent = 1.0 / (abs(slope) + np.sqrt(1.0 + slope * slope))
                if slope < 0.0:
                    tangent = -tangent
                cosine = 1.0 / np.sqrt(1.0 + tangent * tangent)
                _turn_columns(left, p, q, cosine, tangent * cosine)
                _turn_columns(basis, p, q, cosine, tangent * cosine)
        if not rotated:
            break
    for j in range(columns):
        square = 0.0
        for i in range(rows):
            square += left[i, j] * left[i, j]
        if square > 0.0:
            left[:, j] /= np.sqrt(square)
    out = np.zeros((rows, columns))
    for i in range(rows):
        for k in range(columns):
            for j in range(columns):
                out[i, j] += left[i, k] * basis[j, k]
    return out


@njit
def _turn_columns(matrix, p, q, cosine, sine):
    """Rotate two columns of a matrix in their plane, in place."""
    for k in range(len(matrix)):
        first = matrix[k, p]
        second = matrix[k, q]
        matrix[k, p] = cosine * first - sine * second
        matrix[k, q] = sine * first + cosine * second


@njit
def matrix_exponential(a):
    """Return e to the power of a matrix (k, k): Taylor's series of a/2ˢ, squared s times."""
    size = len(a)
    norm = 0.0
    for i in range(size):
        row = 0.0
        for j in range(size):
            row += abs(a[i, j])
        norm = max(norm, row)
    squarings = 0
    scaled = a.copy()
    while norm > 0.5:
        norm *= 0.5
        scaled *= 0.5
        squarings += 1
    alone = (1, size, size)
    scaled = scaled.reshape(alone)
    whole = np.eye(size)
    # 0.5¹⁸/18! is below a unit in the last place.
    for order in range(18, 0, -1):
        whole = np.eye(size) + products(scaled, whole.reshape(alone))[0] / order
    for _ in range(squarings):
        whole = products(whole.reshape(alone), whole.reshape(alone))[0]
    return whole
