"""
The one engine of repeated-measures ANOVA: every effect of a design, for many studies at once.

Scores are regressed on the between-subject design (sum-to-zero coding, so that sums of squares are
of type III). Coefficients and residuals are then projected on orthonormal contrasts of each
within-subject effect: the intercept tests the effect itself, every other block of columns its
interaction with that block. Each within-subject effect has its own error term (Greenwald's
multivariate form of the univariate tests, as in `Anova` of car and `aov_car` of afex).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import reduce
from itertools import chain, combinations
from typing import Any, NamedTuple

import numpy as np

from trustlab.studies.analysis.sphericity import corrected_tests, mauchly, orthonormal_contrasts

# Scores analysed or drawn at once, so that memory does not grow with the number of studies.
_CHUNK = 1 << 20

# Sizes of scores beyond which squares would overflow, and below which they would underflow.
_GREATEST, _LEAST = 1e140, 1e-100


def checked_scores(array: np.ndarray) -> np.ndarray:
    """
    Return scores as floats of shape (studies, subjects, cells), each finite and of a size that can
    be squared.
    """
    try:
        numbers = np.asarray(array)
    except ValueError:
        numbers = np.empty(0, dtype=object)
    if numbers.dtype.kind not in "fiu":
        raise ValueError(
            f"array must hold real numbers, got {type(array).__name__} of dtype {numbers.dtype}"
        )
    if numbers.ndim != 3:
        raise ValueError(
            f"array must have three axes (study, subject, condition), got {numbers.shape}: one "
            "study is array[None]"
        )
    studies, n, k = numbers.shape
    if studies < 1:
        raise ValueError(f"array holds no study: its shape is {numbers.shape}")
    if n < 3 or k < 2:
        raise ValueError(
            "every study needs at least 3 subjects and 2 conditions, got "
            f"{n} subject(s) and {k} condition(s)"
        )
    scores = numbers.astype(float, copy=False)
    bad = ~np.isfinite(scores)
    if bad.any():
        s, i, j = np.argwhere(bad)[0]
        raise ValueError(
            f"array[{s}, {i}, {j}] (study {s}, subject {i}, condition {j}) is "
            f"{scores[s, i, j]}, not a finite number"
        )
    largest = np.abs(scores).max(axis=(1, 2))
    out = (largest > _GREATEST) | ((largest > 0.0) & (largest < _LEAST))
    if out.any():
        s = int(np.argmax(out))
        raise ValueError(
            f"study {s} has scores of size {largest[s]:.3g}, whose squares no number holds; use "
            "another unit"
        )
    return scores


def chunks(studies: int, scores: int) -> list[range]:
    """Return the studies, each of `scores` numbers, in parts that are analysed or drawn at once."""
    step = max(1, _CHUNK // scores)
    return [range(first, min(first + step, studies)) for first in range(0, studies, step)]


@dataclass(frozen=True, eq=False)
class BetweenDesign:
    """
    The regressors of subjects, shape (subjects, columns), and the columns of each between-subject
    effect.
    """

    matrix: np.ndarray
    blocks: Mapping[str, list[int]]

    @property
    def df_error(self) -> int:
        """Subjects less columns."""
        rows, columns = self.matrix.shape
        return rows - columns

    @property
    def inverse(self) -> np.ndarray:
        """(X'X/n)⁻¹; exactly 1 for an intercept alone."""
        return np.linalg.inv(self.matrix.T @ self.matrix / len(self.matrix))


def subsets(names: Sequence[Any]) -> list[tuple[Any, ...]]:
    """Return all subsets of some factors, the empty one first and the largest last."""
    return list(chain.from_iterable(combinations(names, size) for size in range(len(names) + 1)))


def between_design(
    n: int,
    groups: Mapping[str, np.ndarray] | None = None,
    covariates: Mapping[str, np.ndarray] | None = None,
) -> BetweenDesign:
    """
    Return the design of factors (group numbers from 0) with all their interactions, and of
    covariates about their means.
    """
    coded = {name: _sum_to_zero(codes) for name, codes in (groups or {}).items()}
    parts = {
        " × ".join(names): reduce(_products, (coded[name] for name in names), np.ones((n, 1)))
        for names in subsets(list(coded))
    }
    parts |= {name: (x - x.mean())[:, None] for name, x in (covariates or {}).items()}
    blocks: dict[str, list[int]] = {}
    count = 0
    for name, part in parts.items():
        blocks[name] = list(range(count, count + part.shape[1]))
        count += part.shape[1]
    return BetweenDesign(np.column_stack(list(parts.values())), blocks)


def _sum_to_zero(codes: np.ndarray) -> np.ndarray:
    """Return the columns of a factor: 1 in its level, −1 in the last."""
    indicators = (codes[:, None] == np.arange(codes.max() + 1)).astype(float)
    return indicators[:, :-1] - indicators[:, -1:]


def _products(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    return (first[:, :, None] * second[:, None, :]).reshape(len(first), -1)


def within_contrasts(levels: Mapping[str, int], effect: Sequence[str]) -> np.ndarray:
    """Return orthonormal contrasts of the cells for an effect; other factors are averaged."""
    parts = [
        orthonormal_contrasts(k) if name in effect else np.full((k, 1), k**-0.5)
        for name, k in levels.items()
    ]
    return reduce(np.kron, parts)


class Regression(NamedTuple):
    """
    Studies of shape (studies, subjects, cells) about their grand means, regressed on the
    between-subject design.

    `rounding` is the spread that rounding of the scores alone can cause, shape (studies,).
    """

    grand: np.ndarray
    centred: np.ndarray
    coefficients: np.ndarray
    residual: np.ndarray
    rounding: np.ndarray
    design: BetweenDesign

    def hypothesis(self, contrasts: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """
        Return the sum of squares of the hypothesis `rows` · coefficients · `contrasts` = 0 of each
        study.
        """
        studies, columns, cells = self.coefficients.shape
        projected = (self.coefficients.reshape(-1, cells) @ contrasts).reshape(studies, columns, -1)
        # SS = n |L⁻¹ R B C|² with L L' = R (X'X/n)⁻¹ R'
        root = np.linalg.cholesky(rows @ self.design.inverse @ rows.T)
        whitened = np.matmul(np.linalg.solve(root, rows), projected)
        return len(self.design.matrix) * (whitened.reshape(studies, -1) ** 2).sum(axis=1)

    def covariance(self, contrasts: np.ndarray) -> np.ndarray:
        """Return the residual covariance of contrasts, shape (studies, d, d)."""
        within = np.matmul(self.residual, contrasts)
        return np.matmul(within.transpose(0, 2, 1), within) / self.design.df_error


def regress(scores: np.ndarray, design: BetweenDesign) -> Regression:
    """Regress studies of shape (studies, subjects, cells) on the between-subject design."""
    rounding = 4.0 * np.finfo(float).eps * np.abs(scores).max(axis=(1, 2))
    grand = scores.mean(axis=(1, 2))
    centred = scores - grand[:, None, None]
    if design.matrix.shape[1] == 1:
        coefficients = centred.mean(axis=1, keepdims=True)
        fitted = coefficients
    else:
        x = design.matrix
        coefficients = np.matmul(design.inverse @ x.T / len(x), centred)
        fitted = np.matmul(x, coefficients)
    return Regression(grand, centred, coefficients, centred - fitted, rounding, design)


def effect_tests(
    regression: Regression, levels: Mapping[str, int], first: int = 0
) -> dict[str, dict[str, Any]]:
    """
    Return the statistics of every effect, by name; those that differ by study are arrays.

    The last factor of `levels` varies fastest among the cells; `first` is the first study's number.
    """
    design = regression.design
    cells = regression.centred.shape[2]
    identity = np.eye(design.matrix.shape[1])
    tests: dict[str, dict[str, Any]] = {}
    errors: list[np.ndarray] = []
    for names in subsets(list(levels)):
        contrasts = within_contrasts(levels, names)
        d = contrasts.shape[1]
        if names:
            covariance = regression.covariance(contrasts)
            ss_error = design.df_error * np.trace(covariance, axis1=1, axis2=2)
        else:  # the sum over all cells needs no product of matrices
            ss_error = (regression.residual.sum(axis=2) ** 2).sum(axis=1) / cells
            covariance = (ss_error / design.df_error)[:, None, None]
        errors.append(ss_error)
        blocks = {block: columns for block, columns in design.blocks.items() if block or names}
        flat = np.flatnonzero(ss_error <= design.df_error * d * regression.rounding**2)
        if flat.size and blocks:
            raise ValueError(
                f"study {first + flat[0]}: {_why_flat(regression, levels, names, flat[0])}"
            )
        sphericity = mauchly(covariance, design.df_error + 1, regression.rounding**2, cells)
        common = {"df2": d * design.df_error, "ss_subjects": errors[0], "ss_error": ss_error}
        common |= {f"mauchly_{name}": value for name, value in sphericity._asdict().items()}
        for block, columns in blocks.items():
            q = len(columns)
            ss_effect = regression.hypothesis(contrasts, identity[columns])
            test = {"df1": d * q, "ss_effect": ss_effect} | common
            test |= corrected_tests(ss_effect, ss_error, covariance, q, design.df_error)
            tests[" × ".join(filter(None, (block, *names)))] = test
    # Of all variance but that of the other effects (Olejnik and Algina, 2003).
    for test in tests.values():
        test["eta2_generalized"] = test["ss_effect"] / sum(errors, start=test["ss_effect"])
    # Main effects come first; the order of the rest is kept.
    return dict(sorted(tests.items(), key=lambda item: item[0].count(" × ")))


def _why_flat(
    regression: Regression, levels: Mapping[str, int], names: Sequence[str], study: int
) -> str:
    """Return why a study has no error variance for an effect."""
    if len(levels) > 1 or len(regression.design.blocks) > 1:
        effect = " × ".join(names) or "the subjects"
        return f"the error variance of {effect} is zero, so that F is not defined"
    means = regression.coefficients[study, 0]
    if np.ptp(regression.centred[study]) == 0.0:
        return f"every score is {regression.grand[study]:g}; there is nothing to analyse"
    # A difference of means beyond what rounding can cause.
    differ = (means**2).sum() > (means.size - 1) * regression.rounding[study] ** 2
    reason = "all subjects differ by the same amounts" if differ else "no subject's scores differ"
    return (
        f"the error variance is zero ({reason} between conditions), so that F and t are not defined"
    )
