"""
Analysis of variance with factors within and between subjects, for many studies at once.

Scores are regressed on the groups of subjects, whose coefficients are means of cells. An effect is
contrasts of groups times contrasts of cells within subjects; unweighted means make sums of squares
of type III. Each effect within subjects has its own error term, as in `Anova` of car and `aov_car`
of afex.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, reduce
from itertools import chain, combinations
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from scipy import special
from scipy.linalg import helmert
from scipy.optimize import brentq

from trustlab.models.checks import between, finite_numbers, not_negative, open_unit, positive

# The end of the names of p and ε with each correction.
CORRECTIONS = {"none": "", "greenhouse-geisser": "_gg", "huynh-feldt": "_hf"}

# Smallest ratio of eigenvalues that double precision distinguishes from zero.
_RELATIVE_RANK = 1e-14

# Beyond this noncentrality SciPy's noncentral F fails; the form for large λ has nine digits there.
_LARGE = 1e9


def subsets(names: Iterable) -> list[tuple]:
    """Return all subsets of some names, the empty one first and the largest last."""
    names = list(names)
    return list(chain.from_iterable(combinations(names, size) for size in range(len(names) + 1)))


def orthonormal_contrasts(k: int) -> np.ndarray:
    """Return Helmert contrasts of unit length, shape (k, k − 1): orthogonal to the constant."""
    return helmert(k).T


def contrasts(factors: Mapping[Any, Sequence], names: Iterable) -> np.ndarray:
    """Return orthonormal contrasts of all cells for an effect; factors not in it are averaged."""
    parts = [
        orthonormal_contrasts(len(levels))
        if name in names
        else np.full((len(levels), 1), len(levels) ** -0.5)
        for name, levels in factors.items()
    ]
    return reduce(np.kron, parts, np.eye(1))


@dataclass(frozen=True, eq=False)
class Design:
    """
    Who was measured in which cells.

    Parameters
    ----------
    n : int
        Subjects.
    within, between : mapping of Hashable to sequence
        Factors and their levels; the last factor within subjects varies fastest among the cells.
    group : int or numpy.ndarray, shape (n,)
        The number of every subject's group, the last factor between subjects varying fastest.
    covariates : mapping of Hashable to numpy.ndarray, shape (n,)
        Numbers of every subject, with mean 0.
    """

    n: int
    within: Mapping[Any, Sequence]
    between: Mapping[Any, Sequence] = field(default_factory=dict)
    group: Any = 0
    covariates: Mapping[Any, np.ndarray] = field(default_factory=dict)

    @property
    def combinations(self) -> int:
        """How many groups the factors between subjects make."""
        return math.prod(map(len, self.between.values()))

    @cached_property
    def matrix(self) -> np.ndarray:
        """The regressors, shape (n, columns): a mark of each group's subjects, then covariates."""
        groups = np.eye(self.combinations)[np.broadcast_to(self.group, self.n)]
        return np.column_stack([groups, *self.covariates.values()])

    @property
    def df_error(self) -> int:
        """Subjects less columns."""
        return self.n - self.matrix.shape[1]

    @cached_property
    def inverse(self) -> np.ndarray:
        """(X'X/n)⁻¹."""
        return np.linalg.inv(self.matrix.T @ self.matrix / self.n)

    @cached_property
    def hypotheses(self) -> dict[tuple, tuple[np.ndarray, np.ndarray]]:
        """
        The contrasts of columns and those of cells in the null hypothesis of each effect, by its
        factors; main effects first.
        """
        unit = np.eye(self.combinations + len(self.covariates))
        groups, slopes = np.split(unit, [self.combinations], axis=1)
        blocks = {names: groups @ contrasts(self.between, names) for names in subsets(self.between)}
        blocks |= {(name,): x[:, None] for name, x in zip(self.covariates, slopes.T, strict=True)}
        effects = {
            (*block, *names): (columns, contrasts(self.within, names))
            for names in subsets(self.within)
            for block, columns in blocks.items()
        }
        del effects[()]
        return dict(sorted(effects.items(), key=lambda effect: len(effect[0])))


class Regression(NamedTuple):
    """
    Studies, about their grand means, regressed on the design between subjects.

    `coefficients` has shape (studies, columns, cells), `residual` (studies, n, cells); `rounding`
    is the spread that rounding of the scores alone can cause, shape (studies,).
    """

    design: Design
    coefficients: np.ndarray
    residual: np.ndarray
    rounding: np.ndarray


def regress(scores: np.ndarray, design: Design) -> Regression:
    """Regress studies of shape (studies, n, cells) on the design between subjects."""
    largest = np.abs(scores).max(axis=(1, 2))
    centred = scores - scores.mean(axis=(1, 2), keepdims=True)
    coefficients = design.inverse @ design.matrix.T / design.n @ centred
    residual = centred - design.matrix @ coefficients
    return Regression(design, coefficients, residual, 4.0 * np.finfo(float).eps * largest)


def mauchly_factor(n: Any, k: int) -> Any:
    """Return (n − 1) ρ, ρ = 1 − (2d² + d + 2) / (6 d (n − 1)), d = k − 1: χ² = −(n − 1) ρ ln W."""
    d = k - 1
    return n - 1 - (2 * d**2 + d + 2) / (6 * d)


def mauchly_p_value(chi2: Any, n: Any, k: int, cells: int | None = None) -> Any:
    """
    Return the p-value of Mauchly's χ² to second order, as R, SPSS, JASP, jamovi and pingouin print
    it; n ≥ k ≥ 3.

    p = P_f + w₂ (P_{f+4} − P_f) with f = d (d + 1)/2 − 1 and w₂ = (d+2)(d−1)(d−2)(2d³ + 6d² + 3k +
    2) / (288 ((n−1) d ρ)²), d = k − 1 (Anderson, 2003). The expansion can exceed 1 by some
    thousandths when n is hardly above k; it is then 1.
    """
    d = k - 1
    df = d * (d + 1) // 2 - 1
    # Anderson has d in the place of k; the packages named above all put k there, and printed values
    # come from them. In designs of several factors R puts the number of all cells there.
    cubic = 2 * d**3 + 6 * d**2 + 3 * (cells or k) + 2
    w2 = (d + 2) * (d - 1) * (d - 2) * cubic / (288 * (d * mauchly_factor(n, k)) ** 2)
    first = special.chdtrc(df, chi2)
    return np.minimum(first + w2 * (special.chdtrc(df + 4, chi2) - first), 1.0)


def sphericity(
    covariance: np.ndarray, df_error: int, floor: Any = 0.0, cells: int | None = None
) -> dict[str, Any]:
    """
    Return ε and Mauchly's test of covariances of d orthonormal contrasts, from their eigenvalues.

    ε of Greenhouse and Geisser is (Σ λ)² / (d Σ λ²), that of Huynh and Feldt (n d ε − 2) / (d (n −
    1 − d ε)) with n = df_error + 1, as in car and afex; W = Π λ / (Σ λ / d)^d (Mauchly, 1940). W is
    NaN for one contrast, for fewer degrees of freedom than contrasts, and where an eigenvalue is
    not above `floor`, the variance that rounding of the scores alone can cause.
    """
    d, n = covariance.shape[-1], df_error + 1
    eigenvalues = np.linalg.eigvalsh(covariance)
    with np.errstate(invalid="ignore", divide="ignore"):
        ratios = eigenvalues / eigenvalues.mean(axis=-1, keepdims=True)
        # The bounds are exact: only rounding is cut.
        gg = np.clip(d / (ratios**2).sum(axis=-1), 1.0 / d, 1.0)
        below = d * (n - 1 - d * gg)
        hf = np.where(below > 1e-12 * n, (n * d * gg - 2.0) / below, np.inf) if d > 1 else gg
        least = np.maximum(d * _RELATIVE_RANK * eigenvalues[..., -1], floor)
        testable = 1 < d <= df_error
        defined = (eigenvalues[..., 0] > least) & testable
        log_w = np.minimum(np.log(ratios).sum(axis=-1), np.where(defined, 0.0, np.nan))
    chi2 = -mauchly_factor(n, d + 1) * log_w
    return {
        "epsilon_gg": gg,
        "epsilon_hf": np.minimum(hf, 1.0),
        "epsilon_hf_untruncated": hf,
        "mauchly_w": np.exp(log_w),
        "mauchly_chi2": chi2,
        "mauchly_df": d * (d + 1) // 2 - 1,
        "mauchly_p": mauchly_p_value(chi2, n, d + 1, cells) if testable else chi2,
    }


def effects(scores: np.ndarray, design: Design) -> pd.DataFrame:
    """
    Return the type III test of every effect, a row per study and effect, of scores of shape
    (studies, n, cells); the columns are those of `repeated_measures_batch`.
    """
    regression = regress(scores, design)
    residual, floor = regression.residual, regression.rounding**2
    errors = (residual**2).sum(axis=(1, 2))
    subjects = (residual.sum(axis=2) ** 2).sum(axis=1) / residual.shape[2]
    tests = []
    for names, (columns, cells) in design.hypotheses.items():
        d, contrasted = cells.shape[1], residual @ cells
        covariance = np.swapaxes(contrasted, 1, 2) @ contrasted / design.df_error
        # SS = n |L⁻¹ C' B M|² with L L' = C' (X'X/n)⁻¹ C
        root = np.linalg.cholesky(columns.T @ design.inverse @ columns)
        whitened = np.linalg.solve(root, columns.T @ regression.coefficients @ cells)
        ss = design.n * (whitened**2).sum(axis=(1, 2))
        error = np.trace(covariance, axis1=1, axis2=2)
        for study in np.flatnonzero((error <= d * floor) | ~np.isfinite(error)):
            where = "dv" if len(scores) == 1 else f"array: study {study}"
            raise ValueError(
                f"{where}: the error variance is zero for {effect_name(names)} (all "
                "subjects differ by the same amounts, or not at all), or no number holds it: F is "
                "not defined"
            )
        df1, df2 = d * columns.shape[1], d * design.df_error
        f = ss * d / df1 / error
        shape = sphericity(covariance, design.df_error, floor, residual.shape[2])
        test = {"F": f, "df1": df1, "df2": df2}
        for end in CORRECTIONS.values():
            epsilon = shape.get(f"epsilon{end}", 1.0)
            test[f"p{end}"] = special.fdtrc(epsilon * df1, epsilon * df2, f)
        test |= {
            "eta2_partial": f * df1 / (f * df1 + df2),
            "ss_effect": ss,
            "ss_error": design.df_error * error,
            # Of all variance but that of the other effects (Olejnik and Algina, 2003).
            "eta2_generalized": ss / (ss + errors),
            "ss_subjects": subjects,
        }
        tests.append(test | shape)
    labels = map(effect_name, design.hypotheses)
    index = pd.MultiIndex.from_product([range(len(scores)), labels], names=["study", "effect"])
    table = {
        name: np.column_stack([np.broadcast_to(test[name], len(scores)) for test in tests]).ravel()
        for name in tests[0]
    }
    return pd.DataFrame(table, index)


def effect_name(names: Iterable) -> str:
    """Return "group × condition" for the factors of an effect."""
    return " × ".join(map(str, names))


def repeated_measures_batch(array: np.ndarray) -> pd.DataFrame:
    """
    Analyse many studies of the same size at once.

    Parameters
    ----------
    array : array_like, shape (studies, subjects, levels of the first factor, of the second, …)
        Complete finite scores. The factor is called "condition", or "A", "B" … of several.

    Returns
    -------
    pandas.DataFrame
        Index study, effect. Columns F, df1, df2, p (sphericity assumed), p_gg, p_hf (with
        Greenhouse–Geisser's and Huynh–Feldt's ε), eta2_partial, ss_effect, ss_error, epsilon_gg,
        epsilon_hf (cut at 1), epsilon_hf_untruncated, mauchly_w, mauchly_chi2, mauchly_df,
        mauchly_p (to second order; NaN where the test is not defined), eta2_generalized and
        ss_subjects.

    Raises
    ------
    ValueError
        If shapes do not fit, there are fewer than 3 subjects or 2 levels, a score is not a finite
        number, or a study has no error variance.

    Examples
    --------
    >>> import numpy as np
    >>> import trustlab as tl
    >>> studies = np.random.default_rng(0).normal(size=(1000, 12, 3)) + [0.0, 0.2, 0.8]
    >>> batch = tl.repeated_measures_batch(studies)
    >>> float((batch["p"] < 0.05).mean())
    0.382
    """
    scores = finite_numbers("array", array)
    if scores.ndim < 3 or len(scores) < 1 or scores.shape[1] < 3 or min(scores.shape[2:]) < 2:
        raise ValueError(
            "array must have axes for studies (at least 1; one study is array[None]), subjects (3) "
            f"and each factor's levels (2), got shape {scores.shape}"
        )
    studies, n, *sizes = scores.shape
    names = ["condition"] if len(sizes) == 1 else "ABCDEFGHIJ"
    within = {name: range(k) for name, k in zip(names, sizes, strict=False)}
    return effects(scores.reshape(studies, n, -1), Design(n, within))


class PartialEtaInterval(NamedTuple):
    """Limits of partial η², and of the noncentrality that they come from."""

    low: float
    high: float
    noncentrality_low: float
    noncentrality_high: float


def partial_eta_interval(
    f: float, df1: float, df2: float, level: float = 0.90
) -> PartialEtaInterval:
    """
    Return the interval of partial η² that inverts the noncentral F distribution.

    With λ_low and λ_high such that P(F′ ≥ f | λ_low) = P(F′ ≤ f | λ_high) = (1 − level)/2, the
    limits are λ / (λ + df1 + df2): λ = n (k − 1) η²/(1 − η²) in the population (`noncentrality`),
    and n (k − 1) = df1 + df2. Where the test is corrected, both degrees of freedom are those times
    ε, and λ is ε times that of the uncorrected F (Box, 1954). Steiger (2004) has one more below,
    for designs between subjects. The customary level is 0.90: its lower limit is above 0 where the
    test's p is below 0.05.

    Parameters
    ----------
    f : float
        Observed F, at least 0.
    df1, df2 : float
        Degrees of freedom, above 0.
    level : float
        Coverage, in (0, 1).

    Raises
    ------
    ValueError
        If F is negative or a number is not finite.
    """
    f, level = not_negative("f", f), open_unit("level", level)
    df1, df2 = (
        positive(name, between(name, df, 0.0, 1e9)) for name, df in {"df1": df1, "df2": df2}.items()
    )
    tail = 0.5 * (1.0 - level)
    low, high = (noncentrality_limit(f, df1, df2, share) for share in (1.0 - tail, tail))
    total = df1 + df2
    return PartialEtaInterval(low / (low + total), high / (high + total), low, high)


def noncentrality_limit(f: float, df1: float, df2: float, probability: float) -> float:
    """
    Return the λ ≥ 0 at which P(F′ ≤ f | λ) is `probability`; 0 where it is less even at λ = 0.
    """
    # F′ df1/df2 = χ′²(λ)/χ²(df2), where χ′²(λ) = λ + df1 to within √λ: only the denominator is left
    # to vary.
    large = df1 * (f * special.chdtri(df2, probability) / df2 - 1.0)
    if large > _LARGE:
        return large

    def excess(noncentrality: float) -> float:
        return special.ncfdtr(df1, df2, noncentrality, f) - probability

    if excess(0.0) <= 0.0:
        return 0.0
    high = min(max(1.0, 2.0 * df1 * f), _LARGE)
    while excess(high) > 0.0:
        high *= 2.0
    return brentq(excess, 0.0, high, xtol=1e-12 * high, rtol=1e-13, maxiter=500)
