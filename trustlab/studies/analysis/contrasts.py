"""Contrasts in a design of several factors: pairs of levels, simple effects, aligned ranks."""

from collections.abc import Hashable, Sequence
from dataclasses import replace
from itertools import combinations, product
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import scipy

from trustlab.models.checks import one_of
from trustlab.studies.analysis.anova import effect_tests, regress, subsets
from trustlab.studies.analysis.batch import bonferroni, holm
from trustlab.studies.analysis.score_table import ScoreTable
from trustlab.studies.analysis.sphericity import greenhouse_geisser, orthonormal_contrasts
from trustlab.studies.analysis.study_design import StudyDesign

ERRORS = ("own", "pooled")
ESTIMATE = ("mean_difference", "ci_low", "ci_high", "t", "df", "p")


class ErrorVariances(NamedTuple):
    """
    Variance and degrees of freedom within subjects, the mean of all contrasts, and between them.
    """

    within: tuple[float, int]
    between: tuple[float, int]


def residual_covariance(scores: ScoreTable, design: StudyDesign) -> np.ndarray:
    """Return the covariance of the cells, given the groups."""
    regression = regress(scores.values[None], design.regressors)
    return regression.covariance(np.eye(scores.values.shape[1]))[0]


def error_variances(scores: ScoreTable, design: StudyDesign) -> ErrorVariances:
    """
    Return the variances of orthonormal contrasts of the cells, and of their normalized sum, given
    the groups.
    """
    covariance = residual_covariance(scores, design)
    df = design.regressors.df_error
    contrasts, between = len(covariance) - 1, float(covariance.mean() * len(covariance))
    within = (np.trace(covariance) - between) / contrasts
    return ErrorVariances((within, contrasts * df), (between, df))


def simple_effects(
    scores: ScoreTable, design: StudyDesign, factor: Hashable, at: Hashable
) -> pd.DataFrame:
    """
    Return the effect of one factor at each level of another; the columns are those of
    `RepeatedMeasures.simple_effects`.
    """
    regression = regress(scores.values[None], design.regressors)
    rows = []
    for level, weights, means in design.marginals(factor, at):
        if factor in design.within:
            contrasts, hypothesis = weights @ orthonormal_contrasts(len(means)), means[:1]
        else:
            contrasts, hypothesis = weights[:, :1], np.diff(means, axis=0)
        ss = float(regression.hypothesis(contrasts, hypothesis)[0])
        covariance = regression.covariance(contrasts)[0]
        error = float(np.trace(covariance))
        d, q = contrasts.shape[1], len(hypothesis)
        f = ss / q / error if error > 0.0 else np.nan
        epsilon = float(greenhouse_geisser(covariance)) if d > 1 and error > 0.0 else 1.0
        statistics = _statistics(f, d * q, d * design.regressors.df_error, epsilon)
        rows.append({"factor": factor, "at": at, "level": level} | statistics)
    table = pd.DataFrame(rows)
    return table.assign(p_holm=holm(table["p_gg"].to_numpy()))


def _statistics(f: float, df1: int, df2: int, epsilon: float) -> dict[str, float]:
    """Return a test with and without Greenhouse and Geisser's correction."""
    return {
        "F": f,
        "df1": df1,
        "df2": df2,
        "p": scipy.special.fdtrc(df1, df2, f),
        "epsilon_gg": epsilon,
        "p_gg": scipy.special.fdtrc(epsilon * df1, epsilon * df2, f),
        "eta2_partial": f * df1 / (f * df1 + df2),
    }


def factor_pairs(
    scores: ScoreTable, design: StudyDesign, factor: Hashable, at: Hashable, error: str
) -> pd.DataFrame:
    """
    Return all comparisons of two levels of a factor, over all cells or within each level of
    another.
    """
    levels = design.levels(factor)
    paired = factor in design.within
    tables = []
    for level, weights, means in design.marginals(factor, at):
        rows = []
        for i, j in combinations(range(len(levels)), 2):
            cells = weights[:, i] - weights[:, j] if paired else weights[:, i]
            row = means[i] if paired else means[i] - means[j]
            estimate = _estimate(scores, design, cells, row, error)
            if not paired:
                estimate = (*estimate[:-1], np.nan)  # d_z is of differences within subjects
            rows.append((level, levels[i], levels[j], *estimate))
        table = pd.DataFrame(rows, columns=["level", "a", "b", *ESTIMATE, "d_z"])
        p = table["p"].to_numpy()
        table.insert(table.columns.get_loc("d_z"), "p_bonferroni", bonferroni(p))
        table.insert(table.columns.get_loc("d_z"), "p_holm", holm(p))
        tables.append(table)
    return pd.concat(tables, ignore_index=True)


def _estimate(
    scores: ScoreTable, design: StudyDesign, weights: np.ndarray, row: np.ndarray, error: str
) -> tuple[float, ...]:
    """
    Return `ESTIMATE` and d_z of one linear combination of the cells and of the design's
    coefficients.
    """
    regression = regress(scores.values[None], design.regressors)
    mean = float(row @ regression.coefficients[0] @ weights)
    variance = float(regression.covariance(weights[:, None])[0, 0, 0])
    df = float(design.regressors.df_error)
    if error == "pooled":
        common = weights.sum() ** 2 / weights.size
        variances = error_variances(scores, design)
        within = ((weights**2).sum() - common) * variances.within[0]
        between = common * variances.between[0]
        variance = within + between
        # Satterthwaite's degrees of freedom
        df = variance**2 / (within**2 / variances.within[1] + between**2 / variances.between[1])
    flat = np.sqrt(variance) <= 4.0 * np.finfo(float).eps * np.abs(scores.values).max()
    leverage = row @ design.regressors.inverse @ row / len(scores.values)
    se = np.nan if flat else float(np.sqrt(variance * leverage))
    half = scipy.special.stdtrit(df, 0.975) * se
    t = mean / se
    p = 2.0 * scipy.special.stdtr(df, -abs(t))
    return mean, mean - half, mean + half, t, df, p, np.nan if flat else mean / np.sqrt(variance)


def aligned(
    scores: ScoreTable, design: StudyDesign, factors: Sequence[Hashable], whole: bool = False
) -> ScoreTable:
    """
    Return the ranks of scores aligned for the effect of some factors (Wobbrock and others, 2011).

    With `whole`, all that their cells differ by stays, as if they were one factor: contrasts need
    this (ART-C, Elkin and others, 2021). Cells are means of all scores in them, whatever the sizes
    of groups.
    """
    if design.covariate is not None:
        raise ValueError(
            "the aligned rank transform has no covariates; leave the covariate out of the analysis"
        )
    values = scores.values
    cells = pd.DataFrame(design.cells, columns=[*design.within])
    long = cells.loc[np.tile(cells.index, len(values))].reset_index(drop=True)
    for name, codes in design.groups.items():
        long[name] = np.repeat(codes, len(cells))
    y = pd.Series(values.ravel() / np.abs(values).max())

    def mean(names: Sequence[Hashable]) -> np.ndarray:
        if not names:
            return (y * 0.0 + y.mean()).to_numpy()
        return y.groupby([long[name] for name in names]).transform("mean").to_numpy()

    signs = {names: (-1.0) ** (len(factors) - len(names)) for names in subsets(factors)}
    if whole:
        signs = {tuple(factors): 1.0, (): -1.0}
    effect = sum(sign * mean(names) for names, sign in signs.items())
    scores_of_effect = y.to_numpy() - mean([*long]) + effect
    # Equal values differ in floating point: ranks are those of twelve digits of the largest score.
    ranks = scipy.stats.rankdata(np.round(scores_of_effect, 12)).reshape(values.shape)
    return replace(scores, values=ranks)


def aligned_tests(scores: ScoreTable, design: StudyDesign, error: str) -> pd.DataFrame:
    """
    Return the test of every effect on the ranks aligned for it; the columns are those of
    `RepeatedMeasures.aligned_ranks`.
    """
    one_of("error", error, ERRORS)
    rows: list[dict[str, Any]] = []
    for within, between in product(subsets([*design.within]), subsets([*design.between])):
        if not within and not between:
            continue
        effect = " × ".join(map(str, (*between, *within)))
        ranked = aligned(scores, design, (*between, *within))
        regression = regress(ranked.values[None], design.regressors)
        test = effect_tests(regression, design.sizes)[effect]
        f = float(test["F"][0])
        df1, df2 = test["df1"], test["df2"]
        epsilon = float(test["epsilon_gg"][0])
        if error == "pooled" and within:
            variance, df2 = error_variances(ranked, design).within
            f, epsilon = float(test["ss_effect"][0]) / df1 / variance, np.nan
        rows.append({"effect": effect} | _statistics(f, df1, df2, epsilon))
    # Main effects come first, as in the table of effects.
    rows.sort(key=lambda row: row["effect"].count(" × "))
    return pd.DataFrame(rows)
