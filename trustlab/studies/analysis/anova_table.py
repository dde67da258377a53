"""The table of sums of squares that a paper prints below a repeated-measures analysis."""

from __future__ import annotations

import numpy as np
import pandas as pd

__all__ = ["anova_table"]


def anova_table(result) -> pd.DataFrame:
    """
    Return sums of squares, mean squares and the test, one row per source of variance; nothing is rounded.

    Parameters
    ----------
    result : RepeatedMeasures
        The analysis.

    Returns
    -------
    pandas.DataFrame
        Rows condition, error (conditions × subjects) and subjects. Columns source, ss, df, ms (of all three), then F, p
        (sphericity assumed), epsilon_gg, p_gg, epsilon_hf, p_hf, eta2_partial and eta2_generalized, which only the first row
        has.
    """
    ss = np.array([result.ss_effect, result.ss_error, result.ss_subjects])
    df = np.array([result.df1, result.df2, result.n - 1])
    columns = {"source": ["condition", "error", "subjects"], "ss": ss, "df": df, "ms": ss / df}
    for name in ("F", "p", "epsilon_gg", "p_gg", "epsilon_hf", "p_hf", "eta2_partial", "eta2_generalized"):
        columns[name] = [getattr(result, name), np.nan, np.nan]
    return pd.DataFrame(columns)
