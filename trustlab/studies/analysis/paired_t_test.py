"""Two conditions: the paired t-test with its interval, effect sizes, normality and Wilcoxon's test beside it."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from trustlab.models.checks import open_unit
from trustlab.studies.analysis.apa import apa_decimals, apa_number, apa_p
from trustlab.studies.analysis.score_table import ScoreTable, complete_scores, read_scores

__all__ = ["PairedTTest", "paired_t_test"]


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
        "exact" below 50 subjects without ties or zero differences, else "normal approximation, continuity corrected".
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
        """Return condition, n, mean, sd, se, ci_low and ci_high (between subjects), median, minimum, maximum."""
        from scipy import special

        x = self.scores.values
        mean, sd = x.mean(axis=0), x.std(axis=0, ddof=1)
        se = sd / np.sqrt(self.n)
        half = special.stdtrit(self.df, 0.5 + 0.5 * self.confidence) * se
        return pd.DataFrame(
            {
                "condition": list(self.scores.conditions),
                "n": self.n,
                "mean": mean,
                "sd": sd,
                "se": se,
                "ci_low": mean - half,
                "ci_high": mean + half,
                "median": np.median(x, axis=0),
                "minimum": x.min(axis=0),
                "maximum": x.max(axis=0),
            }
        )

    def apa(self) -> str:
        """Return the sentence a paper needs."""
        rows = self.descriptives()
        digits = apa_decimals(rows["sd"].to_numpy())
        means = [
            f"{row.condition} (M = {apa_number(row.mean, digits)}, SD = {apa_number(row.sd, digits)})"
            for row in rows.itertuples(index=False)
        ]
        words = "differed significantly" if self.p < 0.05 else "did not differ significantly"
        origin = f"[{self.scores.origin}] " if self.scores.origin else ""
        left = (
            f" {len(self.excluded)} subject(s) with missing scores were left out ({', '.join(map(str, self.excluded))})."
            if self.excluded
            else ""
        )
        return (
            f"{origin}{self.scores.dv} {words} between {means[0]} and {means[1]}, t({self.df}) = {apa_number(self.t)}, "
            f"{apa_p(self.p)}, mean difference {apa_number(self.mean_difference, digits)}, {100 * self.confidence:g}% CI "
            f"[{apa_number(self.ci_low, digits)}, {apa_number(self.ci_high, digits)}], d_z = {apa_number(self.d_z)}.{left}"
        )

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
        import matplotlib.pyplot as plt

        if axes is None:
            _, axes = plt.subplots(
                1, 2, figsize=(7.2, 3.6), width_ratios=[2, 1], layout="constrained", squeeze=True
            )
        left, right = axes
        x, rows = self.scores.values, self.descriptives()
        left.plot([0, 1], x.T, "o-", color="0.75", lw=0.8, ms=3, zorder=1)
        half = rows["ci_high"] - rows["mean"]
        left.errorbar([0, 1], rows["mean"], yerr=half, fmt="o", color="C0", capsize=5, lw=1.8, zorder=3)
        left.set_xticks([0, 1], [str(c) for c in self.scores.conditions])
        left.set(xlim=(-0.4, 1.4), xlabel=str(self.scores.within), ylabel=str(self.scores.dv))
        d = x[:, 0] - x[:, 1]
        jitter = np.random.default_rng(0).uniform(-0.12, 0.12, d.size)
        right.plot(jitter, d, "o", color="0.65", ms=4, zorder=1)
        half = self.ci_high - self.mean_difference
        right.errorbar(
            [0], [self.mean_difference], yerr=[half], fmt="o", color="C1", capsize=5, lw=1.8, zorder=3
        )
        right.axhline(0.0, color="k", lw=0.8, ls=":")
        right.set(xlim=(-0.6, 0.6), xticks=[], ylabel=f"{self.a} − {self.b}")
        if self.scores.origin:
            left.set_title(self.scores.origin, fontsize="small", color="#8a5a00")
        return np.array([left, right])

    def _repr_html_(self) -> str:
        return f"<p>{self.apa()}</p>{self.descriptives()._repr_html_()}{self.table().T._repr_html_()}"


def _wilcoxon(d: np.ndarray) -> tuple[float, float, str, float]:
    """Return V, p, the method and the rank-biserial correlation, by the rules of R's wilcox.test."""
    from scipy import special, stats

    kept = d[d != 0.0]
    n = kept.size
    ranks = stats.rankdata(np.abs(kept))
    v, total = float(ranks[kept > 0.0].sum()), n * (n + 1) / 2.0
    rank_biserial = (2.0 * v - total) / total
    ties = np.unique(ranks, return_counts=True)[1].astype(float)
    if n == d.size and n < 50 and (ties == 1.0).all():
        p = float(stats.wilcoxon(kept, method="exact").pvalue)
        return v, p, "exact", rank_biserial
    z = v - total / 2.0
    spread = np.sqrt(n * (n + 1) * (2 * n + 1) / 24.0 - (ties**3 - ties).sum() / 48.0)
    z = (z - 0.5 * np.sign(z)) / spread
    p = min(1.0, 2.0 * float(special.ndtr(-abs(z))))
    return v, p, "normal approximation, continuity corrected", rank_biserial


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
        If the table is refused (see `trustlab.studies.analysis.score_table`), there are not exactly two conditions, or every
        subject has the same difference.

    References
    ----------
    D. Lakens, Calculating and reporting effect sizes, Frontiers in Psychology 4 (2013) 863.
    """
    from scipy import special, stats

    confidence = open_unit("confidence", confidence)
    table = read_scores(frame, dv, within, subject, order=order)
    if len(table.conditions) != 2:
        raise ValueError(
            f"within: column {within!r} has {len(table.conditions)} conditions, {list(table.conditions)}; a paired t-test "
            "compares two. Select their rows, or use repeated_measures"
        )
    scores, excluded = complete_scores(table, missing)
    x = scores.values
    n = x.shape[0]
    with np.errstate(over="ignore", invalid="ignore"):
        d = x[:, 0] - x[:, 1]
        mean, sd, spreads = float(d.mean()), float(d.std(ddof=1)), x.std(axis=0, ddof=1)
    if not np.isfinite([mean, sd, *spreads]).all():
        raise ValueError(
            f"dv: values in column {dv!r} are so large that their squares overflow; change their unit"
        )
    if sd <= 4.0 * np.finfo(float).eps * np.abs(x).max():
        raise ValueError(
            f"every subject has the same difference {scores.conditions[0]!r} − {scores.conditions[1]!r} = {mean:g} in "
            f"{dv!r}: without any variance t is not defined. Is the column a constant, or a copy of another?"
        )
    se = sd / np.sqrt(n)
    t = mean / se
    half = float(special.stdtrit(n - 1, 0.5 + 0.5 * confidence)) * se
    constant = np.ptp(x, axis=0) == 0.0
    shapiro = stats.shapiro(d)
    v, wilcoxon_p, method, rank_biserial = _wilcoxon(d)
    return PairedTTest(
        a=scores.conditions[0],
        b=scores.conditions[1],
        n=n,
        mean_difference=mean,
        sd_difference=sd,
        ci_low=mean - half,
        ci_high=mean + half,
        confidence=confidence,
        t=float(t),
        df=n - 1,
        p=float(2.0 * special.stdtr(n - 1, -abs(t))),
        d_z=mean / sd,
        d_av=float(mean / spreads.mean()),
        correlation=np.nan if constant.any() else float(np.corrcoef(x.T)[0, 1]),
        wilcoxon_v=v,
        wilcoxon_p=wilcoxon_p,
        wilcoxon_method=method,
        rank_biserial=rank_biserial,
        shapiro_w=float(shapiro.statistic),
        shapiro_p=float(shapiro.pvalue),
        excluded=excluded,
        scores=scores,
    )
