"""The aligned rank transform: scores less all effects but one, ranked, so that an analysis of variance tests that one by ranks."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import replace
from itertools import product
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from scipy import special, stats

from trustlab.studies.factors.effects import effect_tests, subsets

if TYPE_CHECKING:
    from trustlab.studies.factors.factorial import FactorialMeasures


def aligned(result: FactorialMeasures, factors: Sequence[Hashable], whole: bool = False) -> FactorialMeasures:
    """
    Return the design with the ranks of its scores aligned for the effect of some factors (Wobbrock and others, 2011).

    With `whole`, all that their cells differ by stays, as if they were one factor: what contrasts need (ART-C, Elkin and others,
    2021). Cells are means of all scores in them, whatever the sizes of groups.
    """
    if result.covariate is not None:
        raise ValueError("the aligned rank transform has no covariates; leave the covariate out of the analysis")
    scores = result.scores.values
    largest = np.abs(scores).max()
    cells = pd.DataFrame(list(product(*(range(len(own)) for own in result.within.values()))), columns=[*result.within])
    long = cells.loc[np.tile(cells.index, len(scores))].reset_index(drop=True)
    for name, codes in result.groups.items():
        long[name] = np.repeat(codes, len(cells))
    y = pd.Series(scores.ravel() / largest)

    def mean(names: Sequence[Hashable]) -> np.ndarray:
        own = y.groupby([long[name] for name in names]).transform("mean") if names else y * 0.0 + y.mean()
        return own.to_numpy()

    signs = {names: (-1.0) ** (len(factors) - len(names)) for names in subsets(factors)}
    if whole:
        signs = {tuple(factors): 1.0, (): -1.0}
    effect = sum(sign * mean(names) for names, sign in signs.items())
    kept = y.to_numpy() - mean([*long]) + effect
    # Equal values differ in floating point: ranks are those of twelve digits of the largest score.
    ranks = stats.rankdata(np.round(kept, 12)).reshape(scores.shape)
    return replace(result, scores=replace(result.scores, values=ranks))


def aligned_tests(result: FactorialMeasures, error: str) -> pd.DataFrame:
    """Return the test of every effect on the ranks aligned for it; the columns are those of `FactorialMeasures.aligned_ranks`."""
    sizes = {str(name): len(levels) for name, levels in result.within.items()}
    rows = []
    for within, between in product(subsets([*result.within]), subsets([*result.between])):
        if not within and not between:
            continue
        effect = " × ".join(map(str, (*between, *within)))
        ranked = aligned(result, (*between, *within))
        test = effect_tests(ranked.scores.values[None], sizes, result.design).loc[(0, effect)]
        f, df1, df2, epsilon = test["F"], int(test["df1"]), int(test["df2"]), test["epsilon_gg"]
        if error == "pooled" and within:
            variance, df2 = ranked.error_variances().within
            f, epsilon = test["ss_effect"] / df1 / variance, np.nan
        p, p_gg = special.fdtrc(df1, df2, f), special.fdtrc(epsilon * df1, epsilon * df2, f)
        rows.append((effect, f, df1, df2, p, epsilon, p_gg, f * df1 / (f * df1 + df2)))
    columns = ["effect", "F", "df1", "df2", "p", "epsilon_gg", "p_gg", "eta2_partial"]
    return pd.DataFrame(rows, columns=columns).set_index("effect").loc[result.effects["effect"]].reset_index()
