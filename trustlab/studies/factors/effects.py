"""
The tests of all effects of a design with factors within and between subjects, for many studies at
once.

The cells of every subject are projected on orthonormal contrasts of each within-subject effect, and
the projections are regressed on the between-subject design (sum-to-zero coding, so that sums of
squares are of type III): the intercept tests the effect itself, every other block of columns its
interaction with that block. Each within-subject effect has an error term of its own (Greenwald's
multivariate form of the univariate tests, as in `Anova` of car and `aov_car` of afex).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import reduce
from itertools import chain, combinations
from typing import Any

import numpy as np
import pandas as pd

from trustlab.studies.analysis.batch import checked_scores, chunks
from trustlab.studies.analysis.sphericity import corrected_tests, mauchly, orthonormal_contrasts


@dataclass(frozen=True, eq=False)
class BetweenDesign:
    """
    The regressors of subjects, shape (subjects, columns), and which columns belong to which
    between-subject effect.
    """

    matrix: np.ndarray
    blocks: Mapping[str, list[int]]

    @property
    def df_error(self) -> int:
        """Subjects less columns."""
        rows, columns = self.matrix.shape
        return rows - columns


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
    columns: list[np.ndarray] = []
    blocks: dict[str, list[int]] = {}
    coded = {name: _sum_to_zero(codes) for name, codes in (groups or {}).items()}
    parts = {
        " × ".join(names): reduce(_products, (coded[x] for x in names), np.ones((n, 1)))
        for names in subsets(list(coded))
    }
    parts |= {name: (x - x.mean())[:, None] for name, x in (covariates or {}).items()}
    for name, own in parts.items():
        blocks[name] = list(range(len(columns), len(columns) + own.shape[1]))
        columns += list(own.T)
    return BetweenDesign(np.column_stack(columns), blocks)


def _sum_to_zero(codes: np.ndarray) -> np.ndarray:
    """Return the columns of a factor: 1 in its level, −1 in the last."""
    indicators = (codes[:, None] == np.arange(codes.max() + 1)).astype(float)
    return indicators[:, :-1] - indicators[:, -1:]


def _products(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    return (first[:, :, None] * second[:, None, :]).reshape(len(first), -1)


def within_contrasts(levels: Mapping[str, int], effect: Sequence[str]) -> np.ndarray:
    """
    Return orthonormal contrasts of the cells for an effect; the factors that are not in it are
    averaged.
    """
    own = [
        orthonormal_contrasts(k) if name in effect else np.full((k, 1), k**-0.5)
        for name, k in levels.items()
    ]
    return reduce(np.kron, own)


def tested(
    projected: np.ndarray, design: BetweenDesign, rows: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """
    Return the sum of squares of the hypothesis `rows` · β = 0 and the error's covariance, for each
    study.

    `projected` has shape (studies, subjects, d) and `rows` (q, columns of the design).
    """
    x = design.matrix
    inverse = np.linalg.inv(x.T @ x)
    coefficients = np.matmul(inverse @ x.T, projected)
    residual = projected - np.matmul(x, coefficients)
    covariance = np.matmul(residual.transpose(0, 2, 1), residual) / design.df_error
    whitened = np.linalg.solve(np.linalg.cholesky(rows @ inverse @ rows.T), rows)
    return (np.matmul(whitened, coefficients) ** 2).sum(axis=(1, 2)), covariance


def effect_tests(
    scores: np.ndarray, levels: Mapping[str, int], design: BetweenDesign, first: int = 0
) -> pd.DataFrame:
    """
    Return the test of every effect in every study: index study, effect; columns as in `Omnibus`.

    `scores` have shape (studies, subjects, cells), the last factor of `levels` varying fastest;
    `first` is the first study's number.
    """
    rounding = 4.0 * np.finfo(float).eps * np.abs(scores).max(axis=(1, 2))
    scores = scores - scores.mean(axis=(1, 2), keepdims=True)
    rows, identity = [], np.eye(design.matrix.shape[1])
    errors = np.zeros(len(scores))
    for names in subsets(list(levels)):
        projected = np.matmul(scores, within_contrasts(levels, names))
        d = projected.shape[2]
        for block, columns in design.blocks.items():
            ss_effect, covariance = tested(projected, design, identity[columns])
            ss_error = design.df_error * np.trace(covariance, axis1=1, axis2=2)
            if flat := np.flatnonzero(ss_error <= design.df_error * d * rounding**2).tolist():
                what = f"the error variance of {' × '.join(names) or 'the subjects'} is zero"
                raise ValueError(f"study {first + flat[0]}: {what}, so that F is not defined")
            if block or names:
                effect = " × ".join(filter(None, (block, *names)))
                row = {
                    "effect": effect,
                    "df1": d * len(columns),
                    "ss_effect": ss_effect,
                    "ss_error": ss_error,
                }
                sphericity = mauchly(covariance, design.df_error + 1, rounding**2, scores.shape[2])
                row |= {
                    "mauchly_w": sphericity.w,
                    "mauchly_p": sphericity.p,
                    "df2": d * design.df_error,
                }
                rows.append(
                    row
                    | corrected_tests(
                        ss_effect, ss_error, covariance, len(columns), design.df_error
                    )
                )
        errors += ss_error
    rows.sort(
        key=lambda row: row["effect"].count(" × ")
    )  # main effects first; the order of the rest is kept
    studies = pd.RangeIndex(first, first + len(scores), name="study")
    table = pd.concat([pd.DataFrame(row, index=studies) for row in rows])
    table["eta2_generalized"] = table["ss_effect"] / (
        table["ss_effect"] + np.tile(errors, len(rows))
    )
    return table.set_index("effect", append=True).sort_index(
        level="study", sort_remaining=False, kind="stable"
    )


def factorial_batch(
    array: np.ndarray, factors: Sequence[str] | None = None, groups: Sequence[int] | None = None
) -> pd.DataFrame:
    """
    Analyse many studies of several within-subject factors, and of one between-subject factor, at
    once.

    Parameters
    ----------
    array : array_like, shape (studies, subjects, levels of the first factor, of the second, …)
        Complete finite scores.
    factors : sequence of str, optional
        Names of the within-subject factors; "A", "B" … by default.
    groups : array_like of int, shape (subjects,), optional
        Group of each subject, numbered from 0; the factor is called "group".

    Returns
    -------
    pandas.DataFrame
        Index study, effect; columns df1, ss_effect, ss_error, df2, F, p, eta2_partial, mauchly_w,
        mauchly_p, epsilon_gg, epsilon_hf, epsilon_hf_untruncated, p_gg, p_hf, eta2_generalized.

    Raises
    ------
    ValueError
        If shapes do not fit, a score is not a finite number, or a study has no error variance.
    """
    given = np.asarray(array)
    if given.ndim < 3:
        raise ValueError(
            f"array must have axes for studies, subjects and each factor, got shape {given.shape}"
        )
    names = [chr(ord("A") + i) for i in range(given.ndim - 2)] if factors is None else list(factors)
    if len(names) != given.ndim - 2:
        raise ValueError(
            f"factors must name the {given.ndim - 2} axes after studies and subjects, got {names}"
        )
    studies, n = given.shape[:2]
    scores = checked_scores(given.reshape(studies, n, -1))
    codes = None if groups is None else np.asarray(groups)
    if codes is not None and (
        codes.shape != (n,) or set(codes.tolist()) != set(range(codes.max() + 1))
    ):
        raise ValueError(
            f"groups must number the group of each of {n} subjects from 0, got {groups!r:.60}"
        )
    design = between_design(n, None if codes is None else {"group": codes})
    if design.df_error < 1:
        raise ValueError(
            f"{n} subjects in {codes.max() + 1} groups leave nothing to estimate the error from"
        )
    levels = dict(zip(names, given.shape[2:], strict=True))
    parts = chunks(studies, scores[0].size)
    return pd.concat(
        [effect_tests(scores[part.start : part.stop], levels, design, part.start) for part in parts]
    )
