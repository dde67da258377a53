"""Means of conditions with their intervals: between subjects, and within subjects after Cousineau and Morey."""

from typing import Any

import numpy as np
import pandas as pd
from scipy import special

from trustlab.studies.analysis.score_table import ScoreTable


def t_half_width(sd: Any, n: int, level: float = 0.95) -> Any:
    """Return half the width of the interval of a mean of n values, t · sd / √n."""
    return special.stdtrit(n - 1, 0.5 + 0.5 * level) * sd / np.sqrt(n)


def within_subject_sd(values: np.ndarray) -> np.ndarray:
    """
    Return each condition's standard deviation of scores less their subject's mean, times √(k/(k − 1)).

    Removing the subjects' means (Cousineau, 2005) leaves the spread that a comparison within subjects sees; the factor
    (Morey, 2008) compensates for the variance that this removes. For k = 2 the interval is 1/√2 times that of the
    paired difference.
    """
    k = values.shape[1]
    centred = values - values.mean()  # a common offset would cost digits in the subjects' means
    return (centred - centred.mean(axis=1, keepdims=True)).std(axis=0, ddof=1) * np.sqrt(k / (k - 1.0))


def describe(scores: ScoreTable, level: float = 0.95) -> pd.DataFrame:
    """Return a row per condition: condition n mean sd se median minimum maximum, and both intervals of the mean."""
    values = scores.values
    n = len(values)
    mean, sd = values.mean(axis=0), values.std(axis=0, ddof=1)
    between, within = t_half_width(sd, n, level), t_half_width(within_subject_sd(values), n, level)
    columns = {
        "condition": pd.Index(scores.conditions, tupleize_cols=False),
        "n": n,
        "mean": mean,
        "sd": sd,
        "se": sd / np.sqrt(n),
        "median": np.median(values, axis=0),
        "minimum": values.min(axis=0),
        "maximum": values.max(axis=0),
        "ci_low": mean - between,
        "ci_high": mean + between,
        "ci_low_within": mean - within,
        "ci_high_within": mean + within,
    }
    return pd.DataFrame(columns)
