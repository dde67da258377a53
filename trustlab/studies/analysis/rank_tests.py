"""Friedman's, Wilcoxon's and Conover's rank tests, and the normality of differences."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pandas as pd
import scipy

from trustlab.models.display import as_html

# Scores of at most so many different whole numbers (0 to 10) are taken for a rating item's.
_MOST_STEPS = 11


@dataclass(frozen=True)
class Friedman:
    """
    Friedman's rank test: χ² = n (k − 1) W, corrected for ties, on k − 1 degrees of freedom.

    `kendall_w` is the concordance W of the subjects' rankings, from 0 to 1.
    """

    chi2: float
    df: int
    p: float
    kendall_w: float

    def table(self) -> pd.DataFrame:
        """Return one row: chi2 df p kendall_w."""
        return pd.DataFrame([vars(self)])

    def _repr_html_(self) -> str:
        return as_html("", self.table(), title="Friedman")


def friedman(values: np.ndarray) -> Friedman:
    """
    Test whether the conditions' mean ranks differ; `values` has shape (n, k).
    """
    import pingouin

    n, k = values.shape
    test = pingouin.friedman(pd.DataFrame(values))  # a wide table: a row per subject
    w = float(np.clip(test["W"].iloc[0], 0.0, 1.0))  # the bounds are exact: only rounding is cut
    chi2 = n * (k - 1) * w
    return Friedman(chi2, k - 1, float(scipy.special.chdtrc(k - 1, chi2)), w)


class Wilcoxon(NamedTuple):
    """
    Wilcoxon's signed-rank test: rank sum of the positive differences, two-sided p, method, effect
    size.
    """

    wilcoxon_v: float
    wilcoxon_p: float
    wilcoxon_method: str
    rank_biserial: float


def wilcoxon(differences: np.ndarray, largest: float) -> Wilcoxon:
    """
    Test paired differences of scores of size up to `largest`, not all zero, by the rules of R's
    wilcox.test.

    Zero differences are left out. The p-value is exact below 50 subjects without ties or zero
    differences, else from the normal approximation with continuity correction. Differences are
    ranked to twelve digits of the largest score, as 0.3 − 0.2 and 0.2 − 0.1 are a tie although they
    differ in floating point; where that changes a rank, the method says so.
    """
    grid = 10.0 ** (np.ceil(np.log10(largest)) - 12.0)
    rounded = np.round(differences / grid)
    merged = np.unique(np.abs(rounded)).size < np.unique(np.abs(differences)).size
    nonzero = rounded[rounded != 0.0]
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


def rank_pairs(values: np.ndarray, a: np.ndarray, b: np.ndarray, method: str) -> pd.DataFrame:
    """
    Compare every pair of conditions a, b by ranks, a row per pair.

    "wilcoxon" is the signed-rank test of each pair; NaN where no subject's scores differ. "conover"
    follows Friedman's test: t of the mean ranks of all conditions on (n − 1)(k − 1) degrees of
    freedom (Conover, 1999, Section 5.8).
    """
    if method == "wilcoxon":
        largest = np.abs(values).max()
        rows = []
        for i, j in zip(a, b, strict=True):
            difference = values[:, i] - values[:, j]
            test = Wilcoxon(np.nan, np.nan, "not defined", np.nan)
            if np.ptp([*difference, 0.0]) > 1e-12 * largest:
                test = wilcoxon(difference, largest)
            rows.append((*test, np.median(difference)))
        names = ["V", "p", "method", "rank_biserial", "median_difference"]
        return pd.DataFrame(rows, columns=names)
    n, k = values.shape
    ranks = scipy.stats.rankdata(values, axis=1)
    mean = ranks.mean(axis=0)
    df = (n - 1) * (k - 1)
    error = ((ranks - mean) ** 2).sum() / df  # the sum of a subject's ranks is the same for all
    t = (mean[a] - mean[b]) / np.sqrt(2.0 * error / n) if error > 0.0 else np.full(a.size, np.nan)
    p = 2.0 * scipy.special.stdtr(df, -np.abs(t))
    return pd.DataFrame({"mean_rank_difference": mean[a] - mean[b], "t": t, "df": df, "p": p})


def rating_notes(values: np.ndarray, tests: str) -> tuple[str, ...]:
    """
    Return a note that names the tests by ranks if scores look like those of one rating item.
    """
    steps = np.unique(values)
    if steps.size > _MOST_STEPS or not np.array_equal(steps, np.round(steps)):
        return ()
    return (
        f"Scores are whole numbers from {steps[0]:g} to {steps[-1]:g}, as of a rating item, "
        f"whose steps need not be equal: see {tests} for tests by ranks.",
    )


def normality_of_differences(values: np.ndarray, a: np.ndarray, b: np.ndarray) -> pd.DataFrame:
    """
    Return W and p of the Shapiro–Wilk test of the differences of every pair of conditions a, b.

    NaN where all differences are equal, and above 5000 subjects, where the approximation of p is
    not valid.
    """
    rounding = 4.0 * np.finfo(float).eps * np.abs(values).max()
    rows = []
    for i, j in zip(a, b, strict=True):
        difference = values[:, i] - values[:, j]
        if difference.size > 5000 or np.ptp(difference) <= 2.0 * rounding:
            rows.append((np.nan, np.nan))
        else:
            # scaled, as SciPy takes tiny differences for equal
            test = scipy.stats.shapiro(difference / np.abs(difference).max())
            rows.append((float(test.statistic), float(test.pvalue)))
    return pd.DataFrame(rows, columns=["W", "p"])
