"""Two conditions: the paired t-test, its effect sizes, normality and Wilcoxon's test."""

from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from trustlab.models.checks import open_unit
from trustlab.models.display import as_html
from trustlab.studies.pairs import condition_pairs, normality_of_differences, wilcoxon
from trustlab.studies.repeated_measures import describe, t_half_width, table_effects
from trustlab.studies.table import (
    ScoreTable,
    complete_scores,
    read_scores,
    same_for_all,
)


@dataclass(frozen=True, eq=False)
class PairedTTest:
    """
    A dependent t-test, difference a − b.

    Parameters
    ----------
    a, b : hashable
        The two conditions.
    n : int
        Subjects compared.
    mean_difference, sd_difference : float
        Of a − b.
    ci_low, ci_high : float
        Interval of the mean difference.
    confidence : float
        Its level.
    t, df, p : float
        Student's t on n − 1 degrees of freedom, two-sided p.
    d_z : float
        Mean over standard deviation of the differences.
    d_av : float
        Mean difference over the mean of the two standard deviations.
    correlation : float
        Pearson correlation of a and b; NaN if one of them is constant.
    wilcoxon_v, wilcoxon_p : float
        Sum of the ranks of positive differences, zero differences left out, and its two-sided p.
    wilcoxon_method : str
        "exact" below 50 subjects without ties or zero differences, else "normal approximation,
        continuity corrected"; and whether ties were judged to twelve digits, where floating point
        separates them.
    rank_biserial : float
        (positive − negative rank sum) over their total.
    shapiro_w, shapiro_p : float
        Shapiro and Wilk's test of the differences.
    excluded : tuple
        Subjects left out because a score is missing.
    scores : ScoreTable
        What was compared.
    """

    a: Hashable
    b: Hashable
    n: int
    mean_difference: float
    sd_difference: float
    ci_low: float
    ci_high: float
    confidence: float
    t: float
    df: int
    p: float
    d_z: float
    d_av: float
    correlation: float
    wilcoxon_v: float
    wilcoxon_p: float
    wilcoxon_method: str
    rank_biserial: float
    shapiro_w: float
    shapiro_p: float
    excluded: tuple
    scores: ScoreTable

    def table(self) -> pd.DataFrame:
        """Return one row with every number."""
        names = [name for name in self.__dataclass_fields__ if name not in ("excluded", "scores")]
        return pd.DataFrame([{name: getattr(self, name) for name in names}])

    def descriptives(self) -> pd.DataFrame:
        """
        Return descriptive statistics as `RepeatedMeasures.descriptives`; intervals at `confidence`.
        """
        labels = pd.Index(self.scores.conditions, tupleize_cols=False)
        return pd.DataFrame({"condition": labels} | describe(self.scores.values, self.confidence))

    def apa(self) -> str:
        """Return the sentence a paper needs."""
        from trustlab.studies.words import apa_pair

        return apa_pair(self)

    def plot(self, axes=None):
        """
        Plot every subject's pair with both means and intervals, and the differences with theirs.

        Parameters
        ----------
        axes : sequence of two matplotlib.axes.Axes, optional
            Where to draw; a new figure by default.

        Returns
        -------
        numpy.ndarray of matplotlib.axes.Axes, shape (2,)
        """
        from trustlab.studies.plots import plot_pair

        return plot_pair(self, axes)

    def _repr_html_(self) -> str:
        return as_html(self.apa(), self.descriptives(), self.table().T)


def paired_t_test(
    frame: pd.DataFrame,
    dv: Hashable,
    within: Hashable,
    subject: Hashable,
    *,
    order: Sequence[Hashable] | None = None,
    confidence: float = 0.95,
    missing: str = "raise",
) -> PairedTTest:
    """
    Compare two conditions within subjects: t = mean(a − b)/(s/√n) on n − 1 degrees of freedom.

    Parameters
    ----------
    frame : pandas.DataFrame
        One row per subject and condition.
    dv, within, subject : hashable
        Columns with the score, the condition (two of them) and the subject.
    order : sequence, optional
        The two conditions, a then b. By default sorted, or in the order of a categorical column.
    confidence : float
        Level of the intervals.
    missing : {"raise", "listwise"}
        Whether a missing score is an error, or its subject is left out and named in the result.

    Returns
    -------
    PairedTTest

    Raises
    ------
    ValueError
        If the table is refused (see `trustlab.studies.table`), there are not exactly
        two conditions, or every subject has the same difference.

    References
    ----------
    D. Lakens, Calculating and reporting effect sizes, Frontiers in Psychology 4 (2013) 863.

    Examples
    --------
    >>> import pandas as pd
    >>> import trustlab as tl
    >>> values = {"subject": [1, 1, 2, 2, 3, 3], "mode": ["A", "B"] * 3}
    >>> frame = pd.DataFrame(values).assign(error=[1.0, 1.4, 1.1, 1.9, 0.8, 1.0])
    >>> test = tl.paired_t_test(frame, dv="error", within="mode", subject="subject")
    >>> test.table()[["mean_difference", "t", "df", "p"]].round(3)
       mean_difference      t  df      p
    0           -0.467 -2.646   2  0.118
    """
    confidence = open_unit("confidence", confidence)
    table = read_scores(frame, dv, within, subject, order=order)
    if len(table.conditions) != 2:
        raise ValueError(
            f"within: column {within!r} has {len(table.conditions)} conditions, "
            f"{list(table.conditions)}; a paired t-test compares two. Select their rows, or use "
            "repeated_measures"
        )
    scores, excluded = complete_scores(table, missing)
    table_effects(scores)  # refuses scores without error variance
    pair = condition_pairs(scores.values[None])
    names = ("mean_difference", "t", "p", "d_z")
    test: dict[str, Any] = {name: float(getattr(pair, name)[0, 0]) for name in names}
    a, b = scores.values.T
    test["sd_difference"] = float((a - b).std(ddof=1))
    spread = 0.5 * (a.std(ddof=1) + b.std(ddof=1))
    test["d_av"] = test["mean_difference"] / spread
    half = float(t_half_width(test["sd_difference"], len(scores.subjects), confidence))
    normality = normality_of_differences(scores.values)
    return PairedTTest(
        a=scores.conditions[0],
        b=scores.conditions[1],
        n=len(scores.subjects),
        ci_low=test["mean_difference"] - half,
        ci_high=test["mean_difference"] + half,
        confidence=confidence,
        df=pair.df,
        correlation=np.nan if same_for_all(scores) else float(np.corrcoef(a, b)[0, 1]),
        shapiro_w=float(normality["W"][0]),
        shapiro_p=float(normality["p"][0]),
        excluded=excluded,
        scores=scores,
        **wilcoxon(a - b, np.abs(scores.values).max())._asdict(),
        **test,
    )
