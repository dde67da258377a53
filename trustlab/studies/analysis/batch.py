"""Repeated-measures analyses of many studies at once, with all pairs of conditions."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
import pandas as pd
from scipy import special

from trustlab.models.display import as_html
from trustlab.studies.analysis.anova import (
    between_design,
    checked_scores,
    chunks,
    effect_tests,
    regress,
)
from trustlab.studies.analysis.descriptives import t_half_width
from trustlab.studies.analysis.score_table import ScoreTable


@dataclass(frozen=True, eq=False)
class PairwiseBatch:
    """
    Pairwise statistics of many studies, shape (studies, pairs); NaN where every subject has the
    same difference.

    `a` and `b` are the positions of the two conditions, shape (pairs,), a before b; differences are
    a − b, intervals have 95 %, p-values are two-sided. d_z is the mean over the standard deviation
    of the differences, d_av the mean difference over the mean of the two conditions' standard
    deviations (Lakens, 2013).
    """

    a: np.ndarray
    b: np.ndarray
    mean_difference: np.ndarray
    sd_difference: np.ndarray
    ci_low: np.ndarray
    ci_high: np.ndarray
    t: np.ndarray
    df: int
    p: np.ndarray
    p_bonferroni: np.ndarray
    p_holm: np.ndarray
    d_z: np.ndarray
    d_av: np.ndarray

    def statistics(self) -> dict[str, np.ndarray]:
        """Return what tables show, by name and in their order."""
        hidden = ("a", "b", "sd_difference")
        return {name: value for name, value in vars(self).items() if name not in hidden}


def bonferroni(p: np.ndarray) -> np.ndarray:
    """
    Return p-values times their number, at most 1.

    Parameters
    ----------
    p : numpy.ndarray, shape (..., tests)
        Unadjusted p-values of one family along the last axis; NaN stay NaN and do not count, as in
        R's p.adjust.
    """
    count = (~np.isnan(p)).sum(axis=-1, keepdims=True)
    return np.minimum(count * p, 1.0)


def holm(p: np.ndarray) -> np.ndarray:
    """
    Return p-values adjusted step by step (Holm, 1979).

    Parameters
    ----------
    p : numpy.ndarray, shape (..., tests)
        Unadjusted p-values of one family along the last axis; NaN stay NaN and do not count, as in
        R's p.adjust.
    """
    count = (~np.isnan(p)).sum(axis=-1, keepdims=True)
    order = np.argsort(p, axis=-1, kind="stable")  # NaN last
    steps = np.maximum(count - np.arange(p.shape[-1]), 1)
    ascending = np.take_along_axis(p, order, axis=-1)
    adjusted = np.minimum(np.maximum.accumulate(steps * ascending, axis=-1), 1.0)
    result = np.empty_like(p)
    np.put_along_axis(result, order, adjusted, axis=-1)
    return result


def paired_differences(scores: np.ndarray, sd: np.ndarray, rounding: np.ndarray) -> PairwiseBatch:
    """
    Compare every pair of conditions by a paired t-test.

    `scores` has shape (studies, subjects, conditions), `sd` are the conditions' standard
    deviations, and `rounding` is the spread of differences that rounding of the scores alone can
    cause, shape (studies,).
    """
    studies, n, k = scores.shape
    a, b = np.array(list(combinations(range(k), 2))).T
    mean = np.empty((studies, a.size))
    spread = np.empty((studies, a.size))
    for pair in range(a.size):  # pair by pair: all at once would not fit the cache
        difference = scores[:, :, a[pair]] - scores[:, :, b[pair]]
        mean[:, pair] = difference.mean(axis=1)
        difference -= mean[:, pair, None]
        spread[:, pair] = np.sqrt(np.einsum("sn,sn->s", difference, difference) / (n - 1))
    sd_difference = np.where(spread <= rounding[:, None], 0.0, spread)
    divisor = np.where(sd_difference > 0.0, sd_difference, np.nan)
    t = mean / (divisor / np.sqrt(n))
    p = 2.0 * special.stdtr(n - 1, -np.abs(t))
    half = t_half_width(divisor, n)
    average = 0.5 * (sd[:, a] + sd[:, b])
    return PairwiseBatch(
        a=a,
        b=b,
        mean_difference=mean,
        sd_difference=sd_difference,
        ci_low=mean - half,
        ci_high=mean + half,
        t=t,
        df=n - 1,
        p=p,
        p_bonferroni=bonferroni(p),
        p_holm=holm(p),
        d_z=mean / divisor,
        d_av=mean / np.where(average > 0.0, average, np.nan),
    )


@dataclass(frozen=True, eq=False)
class RepeatedMeasuresBatch:
    """
    One-way repeated-measures analyses of many studies; arrays have shape (studies,).

    Parameters
    ----------
    n, k : int
        Subjects and conditions.
    F : numpy.ndarray
        Ratio of mean squares.
    df1, df2 : int
        k − 1 and (n − 1)(k − 1).
    p : numpy.ndarray
        Sphericity assumed.
    ss_effect, ss_subjects, ss_error : numpy.ndarray
        Sums of squares.
    mauchly_w, mauchly_chi2, mauchly_p, mauchly_p_first_order : numpy.ndarray
        Mauchly's test, its p with and without the second-order term; NaN for k = 2, for n ≤ k − 1
        and where the covariance of the contrasts is singular.
    mauchly_df : int
        k (k − 1)/2 − 1.
    epsilon_gg, epsilon_hf, epsilon_hf_untruncated : numpy.ndarray
        Greenhouse–Geisser and Huynh–Feldt ε, the latter cut at 1 and not.
    p_gg, p_hf : numpy.ndarray
        p with degrees of freedom times ε.
    eta2_partial, eta2_generalized : numpy.ndarray
        SS_effect over SS_effect + SS_error, and over the sum of all three.
    mean, sd : numpy.ndarray, shape (studies, k)
        Of each condition.
    pairwise : PairwiseBatch
        Every pair of conditions.
    """

    n: int
    k: int
    F: np.ndarray
    df1: int
    df2: int
    p: np.ndarray
    ss_effect: np.ndarray
    ss_subjects: np.ndarray
    ss_error: np.ndarray
    mauchly_w: np.ndarray
    mauchly_chi2: np.ndarray
    mauchly_df: int
    mauchly_p: np.ndarray
    mauchly_p_first_order: np.ndarray
    epsilon_gg: np.ndarray
    epsilon_hf: np.ndarray
    epsilon_hf_untruncated: np.ndarray
    p_gg: np.ndarray
    p_hf: np.ndarray
    eta2_partial: np.ndarray
    eta2_generalized: np.ndarray
    mean: np.ndarray
    sd: np.ndarray
    pairwise: PairwiseBatch

    def __len__(self) -> int:
        return self.F.size

    def _statistics(self) -> dict[str, Any]:
        hidden = ("mean", "sd", "pairwise")
        return {name: value for name, value in vars(self).items() if name not in hidden}

    def study(self, s: int) -> dict[str, Any]:
        """
        Return the omnibus statistics of one study.

        Parameters
        ----------
        s : int
            Its position.
        """
        statistics = self._statistics().items()
        return {name: float(value[s]) if np.ndim(value) else value for name, value in statistics}

    def table(self) -> pd.DataFrame:
        """Return one row per study with every omnibus statistic; index `study`."""
        return pd.DataFrame(self._statistics(), pd.RangeIndex(len(self), name="study"))

    def pairs(self) -> pd.DataFrame:
        """
        Return one row per study and pair; columns study a b (positions of the conditions)
        mean_difference … d_av.
        """
        studies, pairs = self.pairwise.t.shape
        keys = {
            "study": np.repeat(np.arange(studies), pairs),
            "a": np.tile(self.pairwise.a, studies),
            "b": np.tile(self.pairwise.b, studies),
        }
        statistics = self.pairwise.statistics().items()
        values = {name: np.ravel(value) if np.ndim(value) else value for name, value in statistics}
        return pd.DataFrame(keys | values)

    def __repr__(self) -> str:
        return (
            f"RepeatedMeasuresBatch({len(self)} studies of {self.n} subjects × {self.k} conditions)"
        )

    def _repr_html_(self) -> str:
        return as_html(repr(self), self.table().describe().T)


def repeated_measures_batch(array: np.ndarray) -> RepeatedMeasuresBatch:
    """
    Analyse many studies of the same size at once.

    Parameters
    ----------
    array : array_like, shape (studies, subjects, conditions)
        Complete finite scores.

    Returns
    -------
    RepeatedMeasuresBatch

    Raises
    ------
    ValueError
        If `array` has another shape, fewer than 3 subjects or 2 conditions, a score that is not a
        finite number, or a study without error variance; the study, subject and condition are
        named.

    Notes
    -----
    Sums of squares come from orthonormal contrasts of the centred scores, so that a large common
    offset costs no digits beyond those that the scores themselves have lost.

    Examples
    --------
    >>> import numpy as np
    >>> import trustlab as tl
    >>> studies = np.random.default_rng(0).normal(size=(1000, 12, 3)) + [0.0, 0.2, 0.8]
    >>> batch = tl.repeated_measures_batch(studies)
    >>> float((batch.p < 0.05).mean())
    0.382
    """
    scores = checked_scores(array)
    studies, n, k = scores.shape
    design = between_design(n)
    parts, pairs = [], []
    for part in chunks(studies, n * k):
        batch = scores[part.start : part.stop]
        regression = regress(batch, design)
        sums = np.einsum("snk,snk->sk", regression.residual, regression.residual)
        sd = np.sqrt(sums / (n - 1))
        test = effect_tests(regression, {"condition": k}, part.start)["condition"]
        parts.append(test | {"mean": batch.mean(axis=1), "sd": sd})
        pairs.append(vars(paired_differences(regression.centred, sd, regression.rounding)))
    return RepeatedMeasuresBatch(n, k, pairwise=PairwiseBatch(**_joined(pairs)), **_joined(parts))


def _joined(parts: list[dict]) -> dict:
    """Concatenate the arrays of all chunks; what all studies share comes from the first."""
    shared = ("a", "b")
    return {
        name: np.concatenate([part[name] for part in parts])
        if np.ndim(value) and name not in shared
        else value
        for name, value in parts[0].items()
    }


def factorial_batch(
    array: np.ndarray, factors: Sequence[str] | None = None, groups: Sequence[int] | None = None
) -> pd.DataFrame:
    """
    Analyse many studies with several within-subject factors and at most one between-subject factor.

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
        Index study, effect; columns df1, ss_effect, df2, ss_subjects, ss_error, mauchly_w,
        mauchly_chi2, mauchly_df, mauchly_p, mauchly_p_first_order, F, p, eta2_partial, epsilon_gg,
        epsilon_hf, epsilon_hf_untruncated, p_gg, p_hf, eta2_generalized.

    Raises
    ------
    ValueError
        If shapes do not fit, a score is not a finite number, or a study has no error variance.
    """
    cells = np.asarray(array)
    if cells.ndim < 3:
        raise ValueError(
            f"array must have axes for studies, subjects and each factor, got shape {cells.shape}"
        )
    names = [chr(ord("A") + i) for i in range(cells.ndim - 2)] if factors is None else list(factors)
    if len(names) != cells.ndim - 2:
        raise ValueError(
            f"factors must name the {cells.ndim - 2} axes after studies and subjects, got {names}"
        )
    studies, n = cells.shape[:2]
    scores = checked_scores(cells.reshape(studies, n, -1))
    codes = np.zeros(n, dtype=int) if groups is None else np.asarray(groups)
    if codes.shape != (n,) or set(codes.tolist()) != set(range(codes.max() + 1)):
        raise ValueError(
            f"groups must number the group of each of {n} subjects from 0, got {groups!r:.60}"
        )
    design = between_design(n, None if groups is None else {"group": codes})
    if design.df_error < 1:
        raise ValueError(
            f"{n} subjects in {codes.max() + 1} groups leave nothing to estimate the error from"
        )
    levels = dict(zip(names, cells.shape[2:], strict=True))
    tables = []
    for part in chunks(studies, scores[0].size):
        regression = regress(scores[part.start : part.stop], design)
        tests = effect_tests(regression, levels, part.start)
        index = pd.MultiIndex.from_product([part, list(tests)], names=["study", "effect"])
        columns = {}
        for name in next(iter(tests.values())):
            values = [np.broadcast_to(test[name], len(part)) for test in tests.values()]
            columns[name] = np.column_stack(values).ravel()
        tables.append(pd.DataFrame(columns, index))
    return pd.concat(tables)


def analyse_table(scores: ScoreTable) -> RepeatedMeasuresBatch:
    """Analyse one complete table as a batch of one; an error names its columns."""
    try:
        return repeated_measures_batch(scores.values[None])
    except ValueError as error:
        raise table_error(scores, error) from None


def table_error(scores: ScoreTable, error: ValueError) -> ValueError:
    """Return an error of the engine with the columns of the table in the place of the study."""
    reason = str(error).removeprefix("study 0: ")
    return ValueError(f"dv: column {scores.dv!r} by {scores.within!r}: {reason}")
