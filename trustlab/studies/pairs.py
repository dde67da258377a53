"""Comparisons after an analysis of variance: pairs of levels, ranks, normality."""

from collections.abc import Callable, Hashable
from functools import reduce
from itertools import combinations
from typing import Any

import numpy as np
import pandas as pd
from scipy import special, stats
from scipy.linalg import khatri_rao

from trustlab.models.checks import shown
from trustlab.studies.anova import Design, Regression


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
    p = np.asarray(p)
    if p.dtype.kind not in "iuf" or not p.ndim or ((p < 0.0) | (p > 1.0)).any():
        raise ValueError(f"p must hold p-values, from 0 to 1, got {shown(p)}")
    count = (~np.isnan(p)).sum(axis=-1, keepdims=True)
    order = np.argsort(p, axis=-1)  # NaN last
    steps = np.maximum(count - np.arange(p.shape[-1]), 1) * np.take_along_axis(p, order, axis=-1)
    adjusted = np.minimum(np.maximum.accumulate(steps, axis=-1), 1.0)
    return np.take_along_axis(adjusted, np.argsort(order, axis=-1), axis=-1)


def estimates_of(
    estimate: np.ndarray, se: np.ndarray, df: float = np.inf, level: float = 0.95
) -> pd.DataFrame:
    """Return estimates with tests and intervals, by t or (by default) by the normal."""
    half = stats.t.ppf(0.5 + 0.5 * level, df) * se
    columns = {"estimate": estimate, "se": se, "z" if np.isinf(df) else "t": estimate / se}
    columns |= {"p": 2.0 * stats.t.sf(np.abs(estimate / se), df)}
    return pd.DataFrame(columns | {"ci_low": estimate - half, "ci_high": estimate + half})


def standard_errors(weights: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Return those of weighted sums, a row of weights each, of numbers with a covariance."""
    return np.sqrt(((weights @ covariance) * weights).sum(axis=1))


def d_z_interval(t: np.ndarray, df: float, scale: Any, level: float = 0.95) -> list[np.ndarray]:
    """
    Return the limits of an interval of d_z = t · scale, by the noncentral t distribution.
    """
    # Beyond 1000 both limits are proportional to t, to four digits.
    factor, t = scale * np.maximum(np.abs(t) / 1e3, 1.0), np.clip(t, -1e3, 1e3)
    limits = []
    for share in (0.5 + 0.5 * level, 0.5 - 0.5 * level):
        limit = special.nctdtrinc(df, share, t)
        # Near t = 0 it is some percent off. Normal quantiles of the share are nearly linear in it.
        for _ in range(3):
            step = 1e-3 * (1.0 + np.abs(limit))
            z, next_z = (special.ndtri(special.nctdtr(df, limit + s, t)) for s in (0.0, step))
            limit = limit + (special.ndtri(share) - z) * step / (next_z - z)
        limits.append(limit * factor)
    return limits


def level_pairs(
    design: Design, factor: Hashable, at: Hashable = None
) -> tuple[pd.DataFrame, np.ndarray, np.ndarray]:
    """
    Return all pairs of a factor's levels, over all cells or within each level of `at`: level, a, b.

    With them come the weights of groups, shape (groups, pairs), and those of cells within subjects,
    shape (cells, pairs), in the difference of the levels' means, unweighted over other factors.
    """
    factors = {**design.between, **design.within}
    for name in (factor,) if at is None else (factor, at):
        if not isinstance(name, Hashable) or name not in factors:
            raise ValueError(f"factor: {name!r} is not a factor of this design: {[*factors]}")
    if factor == at:
        raise ValueError(f"factor and at are both {factor!r}; name two factors")
    levels = [np.nan] if at is None else factors[at]
    pairs = [(level, *pair) for level in levels for pair in combinations(factors[factor], 2)]
    weights = {name: np.full((len(k), len(pairs)), 1.0 / len(k)) for name, k in factors.items()}
    a, b = np.triu_indices(len(factors[factor]), 1)
    unit = np.eye(len(factors[factor]))
    weights[factor] = np.tile(unit[:, a] - unit[:, b], len(levels))
    if at is not None:
        weights[at] = np.repeat(np.eye(len(levels)), a.size, axis=1)
    groups, cells = (
        reduce(khatri_rao, [weights[name] for name in names], np.ones((1, len(pairs))))
        for names in (design.between, design.within)
    )
    return pd.DataFrame(pairs, columns=["level", "a", "b"], dtype=object), groups, cells


def differences(
    regression: Regression, groups: np.ndarray, cells: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """
    Return the differences that weights of groups and of cells make in every study, their standard
    errors, and the standard deviation of a subject's difference, all of shape (studies, pairs); NaN
    where it is what rounding of the scores can cause.
    """
    design, count = regression.design, len(groups)
    difference = np.einsum("gp,sgc,cp->sp", groups, regression.coefficients[:, :count], cells)
    sd = np.sqrt(((regression.residual @ cells) ** 2).sum(axis=1) / design.df_error)
    sd = np.where(sd > regression.rounding[:, None], sd, np.nan)
    se = sd * standard_errors(groups.T, design.inverse[:count, :count] / design.n)
    return difference, se, sd


def compared(
    pairs: pd.DataFrame,
    difference: np.ndarray,
    se: np.ndarray,
    df: float,
    sd: Any,
    level: float = 0.95,
) -> pd.DataFrame:
    """
    Return pairs with their tests, p-values adjusted within each level, and d_z by the standard
    deviation of a subject's difference.
    """
    tests = estimates_of(difference, se, df, level).rename(columns={"estimate": "mean_difference"})
    families = tests["p"].to_numpy().reshape(pairs["level"].nunique(dropna=False), -1)
    scale = se / sd
    low, high = d_z_interval(tests["t"].to_numpy(), df, scale, level)
    return pairs.join(tests).assign(
        df=df,
        p_bonferroni=bonferroni(families).ravel(),
        p_holm=holm(families).ravel(),
        d_z=tests["t"] * scale,
        d_z_low=low,
        d_z_high=high,
    )


def of_pairs(scores: pd.DataFrame, test: Callable[..., dict]) -> pd.DataFrame:
    """Return a test of every pair of conditions, a row each: a, b and what it returns."""
    rows = [
        {"a": a, "b": b} | test(x.to_numpy(), y.to_numpy())
        for (a, x), (b, y) in combinations(scores.items(), 2)
    ]
    return pd.DataFrame(rows).astype({"a": object, "b": object})


def signed_ranks(a: np.ndarray, b: np.ndarray) -> dict[str, Any]:
    """
    Return Wilcoxon's signed-rank test by the rules of R's wilcox.test: zero differences are left
    out; exact below 50 subjects without ties or zeros.
    """
    # Ranked to twelve digits of the largest score: 0.3 − 0.2 and 0.2 − 0.1 are a tie.
    largest = max(np.abs(a).max(), np.abs(b).max()) or 1.0
    grid = 10.0 ** (np.ceil(np.log10(largest)) - 12.0)
    steps = np.round((a - b) / grid)
    steps = steps[steps != 0.0]
    ranks = stats.rankdata(np.abs(steps))
    v, p, method = np.nan, np.nan, "not defined"
    if steps.size:
        exact = np.unique(ranks).size == a.size < 50
        method = "exact" if exact else "normal approximation, continuity corrected"
        kind = "exact" if exact else "asymptotic"
        v = ranks[steps > 0.0].sum()
        p = stats.wilcoxon(steps, correction=not exact, method=kind).pvalue
    return {
        "V": v,
        "p": p,
        "method": method,
        "rank_biserial": 2.0 * v / ranks.sum() - 1.0,
        "median_difference": np.median(a - b),
    }


def normality(a: np.ndarray, b: np.ndarray) -> dict[str, float]:
    """Return Shapiro and Wilk's W of the differences and its p; NaN where all are equal."""
    x = a - b
    w, p = np.nan, np.nan
    rounding = 8.0 * np.finfo(float).eps * max(np.abs(a).max(), np.abs(b).max())
    if np.ptp(x) > rounding and x.size <= 5000:  # beyond, SciPy's p is not defined
        w, p = stats.shapiro(x / np.abs(x).max())  # SciPy takes tiny differences for equal
    return {"W": w, "p": p}
