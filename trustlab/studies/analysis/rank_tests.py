"""What to look at beside the ANOVA: Friedman's test and the normality of the differences."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy import special, stats

__all__ = ["Friedman", "friedman", "normality_of_differences"]


@dataclass(frozen=True)
class Friedman:
    """
    Friedman's rank test.

    Parameters
    ----------
    chi2 : float
        n (k − 1) W, corrected for ties.
    df : int
        k − 1.
    p : float
        Upper tail of χ².
    kendall_w : float
        Concordance of the subjects' rankings, from 0 to 1.
    """

    chi2: float
    df: int
    p: float
    kendall_w: float

    def table(self) -> pd.DataFrame:
        """Return one row: chi2 df p kendall_w."""
        return pd.DataFrame([vars(self)])

    def _repr_html_(self) -> str:
        return f"<p><b>Friedman</b></p>{self.table().to_html(index=False, float_format='%.6g')}"


def friedman(scores: np.ndarray) -> Friedman:
    """
    Rank every subject's scores and test whether the conditions' mean ranks differ (pingouin).

    Parameters
    ----------
    scores : numpy.ndarray, shape (n, k)
        Complete scores.
    """
    import pingouin

    n, k = scores.shape
    frame = pd.DataFrame(
        {
            "subject": np.repeat(np.arange(n), k),
            "condition": np.tile(np.arange(k), n),
            "value": scores.ravel(),
        }
    )
    w = float(pingouin.friedman(frame, dv="value", within="condition", subject="subject")["W"].iloc[0])
    w = min(max(w, 0.0), 1.0)  # the bounds are exact: only rounding is cut
    chi2 = n * (k - 1) * w
    return Friedman(chi2, k - 1, float(special.chdtrc(k - 1, chi2)), w)


def normality_of_differences(scores: np.ndarray, a: np.ndarray, b: np.ndarray) -> pd.DataFrame:
    """
    Apply the Shapiro–Wilk test to the differences of every pair.

    Parameters
    ----------
    scores : numpy.ndarray, shape (n, k)
        Complete scores.
    a, b : numpy.ndarray of int, shape (pairs,)
        Positions of the two conditions.

    Returns
    -------
    pandas.DataFrame
        Columns W, p, one row per pair; NaN where all differences are equal, and above 5000 subjects, where the
        approximation of p does not reach.
    """
    rounding = 4.0 * np.finfo(float).eps * np.abs(scores).max()
    rows = []
    for i, j in zip(a, b, strict=True):
        difference = scores[:, i] - scores[:, j]
        if difference.size > 5000 or np.ptp(difference) <= 2.0 * rounding:
            rows.append((np.nan, np.nan))
        else:
            found = stats.shapiro(difference)
            rows.append((float(found.statistic), float(found.pvalue)))
    return pd.DataFrame(rows, columns=["W", "p"])
