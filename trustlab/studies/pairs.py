"""Comparisons after an analysis of variance: pairs of levels, tests by ranks."""

from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from functools import reduce
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import scipy

from trustlab.studies.anova import (
    Design,
    Regression,
    effect_name,
    orthonormal_contrasts,
    regress,
    subsets,
)

ERRORS = ("own", "pooled")

# Scores of at most so many different whole numbers (0 to 10) are taken for a rating item's.
_MOST_STEPS = 11


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


class Pairs(NamedTuple):
    """
    Comparisons a − b of many studies, shape (studies, pairs); p is two-sided; NaN where every
    subject has the same difference.
    """

    mean_difference: np.ndarray
    ci_low: np.ndarray
    ci_high: np.ndarray
    t: np.ndarray
    df: Any
    p: np.ndarray
    p_bonferroni: np.ndarray
    p_holm: np.ndarray
    sd: np.ndarray
    d_z: np.ndarray


def compare(
    regression: Regression,
    weights: np.ndarray,
    rows: np.ndarray,
    error: str = "own",
    level: float = 0.95,
) -> Pairs:
    """
    Test linear combinations of the cells (weights, shape (cells, pairs)) and of the coefficients
    (rows, shape (pairs, columns)), each with its own error or with one variance of all cells.
    """
    design = regression.design
    mean = np.einsum("pq,sqc,cp->sp", rows, regression.coefficients, weights, optimize=True)
    variance = ((regression.residual @ weights) ** 2).sum(axis=1) / design.df_error
    flat = np.sqrt(variance) <= regression.rounding[:, None]
    df: Any = design.df_error
    if error == "pooled":
        cells = len(weights)
        sums = (regression.residual**2).sum(axis=(1, 2)) / df
        between = (regression.residual.sum(axis=2) ** 2).sum(axis=1) / cells / df
        common = weights.sum(axis=0) ** 2 / cells
        inside = np.outer((sums - between) / (cells - 1), (weights**2).sum(axis=0) - common)
        outside = np.outer(between, common)
        variance = inside + outside
        # Satterthwaite's degrees of freedom
        df = df * variance**2 / (inside**2 / (cells - 1) + outside**2)
    sd = np.sqrt(np.where(flat, np.nan, variance))
    se = sd * _leverage_root(design, rows)
    half = scipy.special.stdtrit(df, 0.5 + 0.5 * level) * se
    p = 2.0 * scipy.special.stdtr(df, -np.abs(mean / se))
    return Pairs(
        mean, mean - half, mean + half, mean / se, df, p, bonferroni(p), holm(p), sd, mean / sd
    )


def _leverage_root(design: Design, rows: np.ndarray) -> np.ndarray:
    """Return the standard error of estimates over the standard deviation of their errors."""
    return np.sqrt(np.einsum("pq,qr,pr->p", rows, design.inverse, rows) / design.n)


def condition_pairs(scores: np.ndarray) -> Pairs:
    """Compare all pairs of conditions, a before b, of studies of shape (studies, n, k)."""
    n, k = scores.shape[1:]
    a, b = np.triu_indices(k, 1)
    weights = np.eye(k)[:, a] - np.eye(k)[:, b]
    return compare(regress(scores, Design(n, {"": range(k)})), weights, np.ones((len(a), 1)))


def d_z_interval(t: np.ndarray, df: Any, scale: Any, level: float = 0.95) -> list[np.ndarray]:
    """
    Return the limits of an interval of d_z = t · scale, by the noncentral t distribution.
    """
    limits = []
    for share in (0.5 + 0.5 * level, 0.5 - 0.5 * level):
        limit = scipy.special.nctdtrinc(df, share, np.clip(t, -1e3, 1e3))
        # Beyond that only the denominator of t varies.
        large = t * np.sqrt(scipy.special.chdtri(df, np.where(t > 0.0, share, 1.0 - share)) / df)
        limits.append(np.where(np.abs(t) < 1e3, limit, large) * scale)
    return limits


def levels_of_factor(design: Design, factor: Hashable) -> Sequence:
    """Return the levels of a factor; an unknown one is refused."""
    factors = {**design.within, **design.between}
    if not isinstance(factor, Hashable) or factor not in factors:
        raise ValueError(f"{factor!r} is not a factor of this design: {[*factors]}")
    return factors[factor]


def _share(factors: Mapping[Hashable, Sequence], fixed: Mapping[Hashable, int]) -> np.ndarray:
    """Return weights of all combinations of levels: of the fixed ones, equal over the others."""
    parts = [
        np.eye(len(levels))[fixed[name]] if name in fixed else np.full(len(levels), 1 / len(levels))
        for name, levels in factors.items()
    ]
    return reduce(np.kron, parts, np.ones(1))


def marginals(
    design: Design, factor: Hashable, at: Hashable
) -> Iterator[tuple[Hashable, np.ndarray, np.ndarray]]:
    """
    Yield the cell weights (cells, k) and design rows (k, columns) of the means of a factor's k
    levels, unweighted over other factors: with each level of `at`, or over all, with NaN.
    """
    k = len(levels_of_factor(design, factor))
    fixed_levels = [np.nan] if at is None else levels_of_factor(design, at)
    if factor == at:
        raise ValueError(f"factor and at are both {factor!r}; name two factors")
    sizes = [len(levels) for levels in design.between.values()]
    count = int(np.prod(sizes))
    codes = np.indices(sizes).reshape(len(sizes), count)
    combinations = Design(count, {}, design.between, dict(zip(design.between, codes, strict=True)))
    for place, level in enumerate(fixed_levels):
        fixed = [{factor: i} | ({} if at is None else {at: place}) for i in range(k)]
        cells = np.array([_share(design.within, levels) for levels in fixed]).T
        groups = np.array([_share(design.between, levels) for levels in fixed])
        yield level, cells, groups @ combinations.matrix


def paired_levels(
    design: Design,
    factor: Hashable,
    at: Hashable,
    test: Callable[[np.ndarray, np.ndarray], pd.DataFrame],
) -> pd.DataFrame:
    """
    Return all comparisons of two levels of a factor, over all cells or within each level of
    another: level, a, b, and what `test` makes of the weights of cells and of the design's rows.
    """
    levels = pd.Index(levels_of_factor(design, factor), tupleize_cols=False)
    a, b = np.triu_indices(len(levels), 1)
    tables = []
    for level, cells, rows in marginals(design, factor, at):
        weights, hypotheses = cells[:, a] - cells[:, b], rows[a]
        if factor in design.between:
            weights, hypotheses = cells[:, a], rows[a] - rows[b]
        names = {"level": [level] * len(a), "a": levels.take(a), "b": levels.take(b)}
        tables.append(pd.DataFrame(names).join(test(weights, hypotheses)))
    return pd.concat(tables, ignore_index=True)


def factor_pairs(
    values: np.ndarray, design: Design, factor: Hashable, at: Hashable, error: str, level: float
) -> pd.DataFrame:
    """Return comparisons of levels with what `Pairs` holds, and the interval of d_z."""
    regression = regress(values[None], design)

    def test(weights: np.ndarray, hypotheses: np.ndarray) -> pd.DataFrame:
        pairs = compare(regression, weights, hypotheses, error, level)
        numbers = {name: np.ravel(x) if np.ndim(x) else x for name, x in pairs._asdict().items()}
        table = pd.DataFrame(numbers).drop(columns="sd")
        scale = _leverage_root(design, hypotheses)
        limits = d_z_interval(pairs.t[0], table["df"], scale, level)
        table["d_z_low"], table["d_z_high"] = limits
        return table

    table = paired_levels(design, factor, at, test)
    if factor in design.between:  # d_z is of differences within subjects
        table[["d_z", "d_z_low", "d_z_high"]] = np.nan
    return table


def aligned(
    values: np.ndarray, design: Design, factors: Sequence[Hashable], whole: bool = False
) -> np.ndarray:
    """
    Return the ranks of scores aligned for the effect of some factors (Wobbrock and others, 2011).

    With `whole`, all that their cells differ by stays, as if they were one factor: contrasts need
    this (ART-C, Elkin and others, 2021). Cells are means of all scores in them, whatever the sizes
    of groups.
    """
    cells = pd.MultiIndex.from_product(
        [range(design.n), *map(range, map(len, design.within.values()))]
    )
    codes = dict(zip(design.within, cells.codes[1:], strict=True))
    codes |= {name: group[cells.codes[0]] for name, group in design.groups.items()}
    y = pd.Series(values.ravel() / np.abs(values).max())

    def mean(names: Sequence[Hashable]) -> Any:
        return y.groupby([codes[name] for name in names]).transform("mean") if names else y.mean()

    signs = {names: (-1.0) ** (len(factors) - len(names)) for names in subsets(factors)}
    if whole:
        signs = {tuple(factors): 1.0, (): -1.0}
    effect = sum(sign * mean(names) for names, sign in signs.items())
    # Equal values differ in floating point: ranks are those of twelve digits of the largest score.
    scores = np.round(y - mean([*codes]) + effect, 12)
    return scipy.stats.rankdata(scores).reshape(values.shape)


def aligned_tests(values: np.ndarray, design: Design, error: str) -> pd.DataFrame:
    """Return the test of every effect on the ranks aligned for it."""
    every = orthonormal_contrasts(values.shape[1])
    kept = ("F", "df1", "df2", "p", "epsilon_gg", "p_gg", "eta2_partial")
    rows = []
    for block, names in design.effects:
        regression = regress(aligned(values, design, (*block, *names))[None], design)
        test = regression.test(design.contrasts(names), design.rows(block))
        row = {name: float(np.ravel(test[name])[0]) for name in kept}
        if error == "pooled" and names:
            variance = np.trace(regression.covariance(every)[0]) / every.shape[1]
            f, df1 = float(test["ss_effect"][0]) / test["df1"] / variance, test["df1"]
            df2 = every.shape[1] * design.df_error
            row |= {"F": f, "df2": df2, "p": scipy.special.fdtrc(df1, df2, f)}
            row |= {"epsilon_gg": np.nan, "p_gg": np.nan}
            row["eta2_partial"] = f * df1 / (f * df1 + df2)
        rows.append({"effect": effect_name(block, names)} | row)
    return pd.DataFrame(rows)


def friedman(values: np.ndarray) -> pd.DataFrame:
    """Test whether the conditions' mean ranks differ; `values` has shape (n, k)."""
    import pingouin

    n, k = values.shape
    test = pingouin.friedman(pd.DataFrame(values))  # a wide table: a row per subject
    w = float(np.clip(test["W"].iloc[0], 0.0, 1.0))  # the bounds are exact: only rounding is cut
    chi2 = n * (k - 1) * w
    p = scipy.special.chdtrc(k - 1, chi2)
    return pd.DataFrame([{"chi2": chi2, "df": k - 1, "p": p, "kendall_w": w}])


class Wilcoxon(NamedTuple):
    """
    Wilcoxon's signed-rank test: rank sum of the positive differences, two-sided p, method, effect
    size.
    """

    wilcoxon_v: float = np.nan
    wilcoxon_p: float = np.nan
    wilcoxon_method: str = "not defined"
    rank_biserial: float = np.nan


def wilcoxon(differences: np.ndarray, largest: float) -> Wilcoxon:
    """
    Test paired differences of scores of size up to `largest` by the rules of R's wilcox.test; not
    defined where all are zero.

    Zero differences are left out. The p-value is exact below 50 subjects without ties or zero
    differences, else from the normal approximation with continuity correction. Differences are
    ranked to twelve digits of the largest score, as 0.3 − 0.2 and 0.2 − 0.1 are a tie although they
    differ in floating point; where that changes a rank, the method says so.
    """
    grid = 10.0 ** (np.ceil(np.log10(largest)) - 12.0)
    rounded = np.round(differences / grid)
    nonzero = rounded[rounded != 0.0]
    if not nonzero.size:
        return Wilcoxon()
    merged = np.unique(np.abs(rounded)).size < np.unique(np.abs(differences)).size
    ranks = scipy.stats.rankdata(np.abs(nonzero))
    exact = nonzero.size == differences.size < 50 and np.unique(ranks).size == nonzero.size
    test = scipy.stats.wilcoxon(
        nonzero, method="exact" if exact else "asymptotic", correction=not exact
    )
    v = float(ranks[nonzero > 0.0].sum())
    total = nonzero.size * (nonzero.size + 1) / 2.0
    method = "exact" if exact else "normal approximation, continuity corrected"
    method += "; ties judged to twelve digits" if merged else ""
    return Wilcoxon(v, float(test.pvalue), method, (2.0 * v - total) / total)


def _differences(values: np.ndarray) -> np.ndarray:
    """Return the subjects' differences of every pair of conditions, shape (pairs, n)."""
    a, b = np.triu_indices(values.shape[1], 1)
    return (values[:, a] - values[:, b]).T


def rank_pairs(values: np.ndarray) -> pd.DataFrame:
    """Compare every pair of conditions by Wilcoxon's signed-rank test, a row per pair."""
    largest = np.abs(values).max()
    rows = [(*wilcoxon(x, largest), np.median(x)) for x in _differences(values)]
    names = ["V", "p", "method", "rank_biserial", "median_difference"]
    table = pd.DataFrame(rows, columns=names)
    p = table["p"].to_numpy()
    return table.assign(p_bonferroni=bonferroni(p), p_holm=holm(p))


def rating_note(values: np.ndarray, tests: str) -> str:
    """Return a note that names the tests by ranks if scores look like those of one rating item."""
    steps = np.unique(values)
    if steps.size > _MOST_STEPS or (steps % 1.0).any():
        return ""
    return (
        f"Scores are whole numbers from {steps[0]:g} to {steps[-1]:g}, as of a rating item, "
        f"whose steps need not be equal: see {tests} for tests by ranks."
    )


def normality_of_differences(values: np.ndarray) -> pd.DataFrame:
    """
    Return W and p of the Shapiro–Wilk test of the differences of every pair of conditions.

    NaN where all differences are equal.
    """
    rounding = 4.0 * np.finfo(float).eps * np.abs(values).max()
    rows = []
    for difference in _differences(values):
        row = (np.nan, np.nan)
        if np.ptp(difference) > 2.0 * rounding:
            # scaled, as SciPy takes tiny differences for equal
            row = tuple(scipy.stats.shapiro(difference / np.abs(difference).max()))
        rows.append(row)
    return pd.DataFrame(rows, columns=["W", "p"])
