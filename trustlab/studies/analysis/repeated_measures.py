"""One-way repeated-measures analysis of a long table: everything that a paper reports about it."""

from collections.abc import Hashable
from dataclasses import dataclass, fields
from typing import Any, NoReturn

import numpy as np
import pandas as pd

from trustlab.models.checks import one_of, open_unit
from trustlab.models.html import as_html
from trustlab.studies.analysis.batch import (
    Omnibus,
    RepeatedMeasuresBatch,
    analyse_table,
    bonferroni,
    describe,
    holm,
    partial_eta_interval,
)
from trustlab.studies.analysis.mixed_model import MixedModel, fit_mixed_model
from trustlab.studies.analysis.rank_tests import (
    Friedman,
    friedman,
    normality_of_differences,
    rank_pairs,
    rating_notes,
)
from trustlab.studies.analysis.score_table import (
    ScoreTable,
    complete_scores,
    labelled,
    read_scores,
    same_for_all,
)
from trustlab.studies.analysis.sphericity import CORRECTIONS, decided

_DESIGN = ("dv", "within", "subject", "conditions", "subjects", "excluded")
_UNTABLED = (*_DESIGN, "notes", "scores", "observed", "batch")
_OF_CONDITIONS = (
    "F",
    "p",
    "epsilon_gg",
    "p_gg",
    "epsilon_hf",
    "p_hf",
    "eta2_partial",
    "eta2_generalized",
)


@dataclass(frozen=True, eq=False, kw_only=True)
class RepeatedMeasures(Omnibus):
    """
    A one-way repeated-measures analysis: every field of `Omnibus` (n, k, F, df1, df2, p …) as a
    number, and the following.

    Parameters
    ----------
    dv, within, subject : hashable
        Columns analysed.
    conditions, subjects, excluded : tuple
        Labels; `excluded` are the subjects left out for missing cells.
    mauchly_reason : str
        Why Mauchly's test is not defined; empty where it is.
    df1_gg, df2_gg, df1_hf, df2_hf : float
        Degrees of freedom times ε.
    correction : {"none", "greenhouse-geisser", "huynh-feldt"}
        Which of the three applies.
    reason : str
        Why.
    df1_corrected, df2_corrected, p_corrected : float
        Those of the correction that applies.
    eta2_partial_low, eta2_partial_high : float
        90 % interval of the partial η², from the degrees of freedom of the correction that applies.
    alpha : float
        Level below which a p-value is called significant.
    notes : tuple of str
        What a reader should know before using the numbers.
    origin : str
        What kind of data these are where they were not measured ("synthetic data" …); else empty.
    scores, observed : ScoreTable
        What was analysed, and what was read (with the cells of excluded subjects).
    batch : RepeatedMeasuresBatch
        The same analysis as a batch of one.
    """

    dv: Hashable
    within: Hashable
    subject: Hashable
    conditions: tuple
    subjects: tuple
    excluded: tuple
    mauchly_reason: str
    df1_gg: float
    df2_gg: float
    df1_hf: float
    df2_hf: float
    correction: str
    reason: str
    df1_corrected: float
    df2_corrected: float
    p_corrected: float
    eta2_partial_low: float
    eta2_partial_high: float
    alpha: float
    notes: tuple
    origin: str
    scores: ScoreTable
    observed: ScoreTable
    batch: RepeatedMeasuresBatch

    def table(self) -> pd.DataFrame:
        """
        Return every omnibus statistic in one row, so that tables of several measures can be
        concatenated.
        """
        row = {"dv": self.dv, "within": self.within}
        names = [field.name for field in fields(self) if field.name not in _UNTABLED]
        row |= {name: getattr(self, name) for name in names}
        row["excluded"] = len(self.excluded)
        return labelled(pd.DataFrame([row]), self.origin)

    def anova_table(self) -> pd.DataFrame:
        """
        Return sums of squares, mean squares and the test, one row per source of variance; nothing
        is rounded.

        Returns
        -------
        pandas.DataFrame
            Rows condition, error (conditions × subjects) and subjects. Columns source, ss, df, ms
            (of all three), then F, p (sphericity assumed), epsilon_gg, p_gg, epsilon_hf, p_hf,
            eta2_partial and eta2_generalized, which only the first row has.
        """
        ss = np.array([self.ss_effect, self.ss_error, self.ss_subjects])
        df = np.array([self.df1, self.df2, self.n - 1])
        columns = {"source": ["condition", "error", "subjects"], "ss": ss, "df": df, "ms": ss / df}
        for name in _OF_CONDITIONS:
            columns[name] = [getattr(self, name), np.nan, np.nan]
        return labelled(pd.DataFrame(columns), self.origin)

    def corrections(self) -> pd.DataFrame:
        """Return the test under each correction: columns correction epsilon df1 df2 F p applies."""
        rows = {
            "correction": CORRECTIONS,
            "epsilon": (1.0, self.epsilon_gg, self.epsilon_hf),
            "df1": (float(self.df1), self.df1_gg, self.df1_hf),
            "df2": (float(self.df2), self.df2_gg, self.df2_hf),
            "F": self.F,
            "p": (self.p, self.p_gg, self.p_hf),
            "applies": [name == self.correction for name in CORRECTIONS],
        }
        return labelled(pd.DataFrame(rows), self.origin)

    def descriptives(self) -> pd.DataFrame:
        """
        Return descriptive statistics of the conditions.

        Returns
        -------
        pandas.DataFrame
            Columns condition n mean sd se median minimum maximum, then two 95 % intervals of the
            mean: ci_low and ci_high between subjects, ci_low_within and ci_high_within after
            Cousineau and Morey.
        """
        return labelled(describe(self.scores), self.origin)

    def pairs(self, method: str = "t") -> pd.DataFrame:
        """
        Return all pairwise comparisons, a before b in the order of the conditions.

        Parameters
        ----------
        method : {"t", "wilcoxon", "conover"}
            Paired t-tests; or, after Friedman's test, Wilcoxon's signed-rank tests or Conover's t
            of the mean ranks.

        Returns
        -------
        pandas.DataFrame
            For "t", columns a b mean_difference (a − b) ci_low ci_high (95 %, unadjusted) t df p
            p_bonferroni p_holm d_z d_av. For "wilcoxon", a b V p method rank_biserial
            median_difference p_bonferroni p_holm; p is NaN where no subject's scores differ. For
            "conover", a b mean_rank_difference t df p p_bonferroni p_holm.
        """
        one_of("method", method, ("t", "wilcoxon", "conover"))
        found = self.batch.pairs().drop(columns="study")
        if method != "t":
            pairwise = self.batch.pairwise
            tests = rank_pairs(self.scores.values, pairwise.a, pairwise.b, method)
            p = tests["p"].to_numpy()
            found = pd.concat(
                [found[["a", "b"]], tests.assign(p_bonferroni=bonferroni(p), p_holm=holm(p))],
                axis=1,
            )
        labels = pd.Index(self.conditions, tupleize_cols=False)
        return labelled(
            found.assign(a=labels.take(found["a"]), b=labels.take(found["b"])), self.origin
        )

    def normality(self) -> pd.DataFrame:
        """Return the Shapiro–Wilk test of every pair's differences: columns a b W p."""
        pairwise = self.batch.pairwise
        tests = normality_of_differences(self.scores.values, pairwise.a, pairwise.b)
        return labelled(pd.concat([self.pairs()[["a", "b"]], tests], axis=1), self.origin)

    def friedman(self) -> Friedman:
        """Return Friedman's rank test with Kendall's W."""
        return friedman(self.scores.values)

    def aligned_ranks(self, error: str = "own") -> NoReturn:
        """
        Say what to take instead: ranks are aligned for one factor among several.

        Parameters
        ----------
        error : str
            As of a design with several factors; of no effect.

        Raises
        ------
        ValueError
            Always.
        """
        raise ValueError(
            "more factors are needed, within=[…, …] or between=…; of one, .friedman(), "
            '.pairs("wilcoxon")'
        )

    def assumptions(self) -> pd.DataFrame:
        """
        Return in one row what speaks for or against the ANOVA, so that tables of several measures
        can be concatenated.

        Returns
        -------
        pandas.DataFrame
            Columns p_shapiro_least (of all pairs' differences), pairs_not_normal (p below alpha
            after Holm's adjustment), p_anova (corrected), friedman_chi2, p_friedman, kendall_w,
            mixed_n, mixed_F, p_mixed.
        """
        normality = self.normality()["p"]
        ranks = self.friedman()
        mixed = self.mixed_model()
        row = {
            "p_shapiro_least": normality.min(),
            "pairs_not_normal": int((holm(normality.to_numpy()) < self.alpha).sum()),
            "p_anova": self.p_corrected,
            "friedman_chi2": ranks.chi2,
            "p_friedman": ranks.p,
            "kendall_w": ranks.kendall_w,
            "mixed_n": mixed.n,
            "mixed_F": mixed.F,
            "p_mixed": mixed.p,
        }
        return labelled(pd.DataFrame([row]), self.origin)

    def mixed_model(self) -> MixedModel:
        """Return the mixed model of all scores, those of excluded subjects included."""
        return fit_mixed_model(self.observed)

    def apa(self, adjust: str = "holm") -> str:
        """
        Return the sentences for a paper.

        Parameters
        ----------
        adjust : {"holm", "bonferroni", "none"}
            Which adjustment of the pairwise p-values to report.
        """
        from trustlab.studies.analysis.apa import apa_report

        return apa_report(self, adjust)

    def plot(self, kind: str = "means", *, interval: str = "between", axes=None):
        """
        Plot the conditions.

        Parameters
        ----------
        kind : {"means", "raincloud", "paired"}
            Means with 95 % intervals, as in Figs. 2.11–2.17 and 3.18–3.21; distributions; or a line
            per subject.
        interval : {"between", "within"}
            Which interval of the means to draw.
        axes : matplotlib.axes.Axes, optional
            Where to draw; a new figure by default.

        Returns
        -------
        matplotlib.axes.Axes
        """
        from trustlab.studies.analysis.plots import plot_conditions

        return plot_conditions(self, kind, interval, axes)

    def __repr__(self) -> str:
        note = f" [{self.origin}]" if self.origin else ""
        return (
            f"RepeatedMeasures({self.dv} by {self.within}, {self.n} subjects × {self.k} "
            f"conditions{note}: F({self.df1_corrected:.4g}, {self.df2_corrected:.4g}) = "
            f"{self.F:.4g}, p = {self.p_corrected:.3g}, correction: {self.correction})"
        )

    def _repr_html_(self) -> str:
        left_out = f"Left out: {', '.join(map(str, self.excluded))}." if self.excluded else ""
        counts = f"{self.n} subjects × {self.k} conditions."
        words = " ".join(
            filter(
                None,
                (counts, self.origin and f"{self.origin}.", left_out, self.reason, *self.notes),
            )
        )
        tables = (self.corrections(), self.descriptives(), self.pairs())
        return as_html(words, *tables, title=f"{self.dv} by {self.within}")


def repeated_measures(
    frame: pd.DataFrame,
    dv: Hashable,
    within: Hashable | list[Hashable],
    subject: Hashable,
    *,
    between: Hashable | list[Hashable] | None = None,
    covariate: Hashable | None = None,
    missing: str = "raise",
    order: Any = None,
    correction: str = "greenhouse-geisser",
    alpha: float = 0.05,
) -> Any:
    """
    Analyse one score under several conditions, or in all cells of several factors, each of which
    every subject went through.

    Parameters
    ----------
    frame : pandas.DataFrame
        Long table: one row per subject and condition; other columns are not looked at.
    dv, subject : hashable
        Columns with the score and the subject.
    within : hashable or list of hashable
        The column with the condition, or a list of those of several crossed factors.
    between : hashable or list of hashable, optional
        Columns with groups of subjects, each of whom is in one; only by keyword.
    covariate : hashable, optional
        A column with one number per subject, which enters about its mean and interacts with the
        factors within subjects.
    missing : {"raise", "listwise"}
        Whether a missing cell is an error, or its subject is left out (and named in `.excluded`).
    order : sequence or dict, optional
        Conditions in the order wanted; with several factors, a dict of factor to levels. By default
        a categorical column keeps the order of its categories (those that occur); numbers are
        sorted by value and text by alphabet.
    correction : {"greenhouse-geisser", "huynh-feldt", "none", "auto"}
        Which correction `.p_corrected` has. "auto": Greenhouse–Geisser where Mauchly's test rejects
        sphericity at `alpha` or is not defined, none elsewhere; with few subjects its type I error
        is above `alpha`, as the test misses violations. All three are always in the result.
    alpha : float
        Level of significance.

    Returns
    -------
    RepeatedMeasures or FactorialMeasures
        The latter where there are several factors, groups or a covariate: sums of squares of type
        III, with Greenhouse–Geisser's and Huynh–Feldt's ε for every effect.

    Raises
    ------
    ValueError
        If a column is unknown, a label is missing, a score is not a finite number, a cell has
        several rows or none, there is one condition or fewer than three complete subjects, a
        subject is in two groups, a group has one subject, or scores have no error variance.

    Notes
    -----
    Values follow R: `aov_car` of afex and `Anova` of car for F, ε and η², `mauchly.test` (see
    `trustlab.studies.analysis.sphericity.mauchly` for its p-value), `t.test(paired = TRUE)` and
    `p.adjust` for the pairs, `friedman.test`, `shapiro.test`.

    Examples
    --------
    >>> import trustlab as tl
    >>> frame = tl.reconstruct(tl.published_studies()["uav.tlx"], seed=0)
    >>> result = tl.repeated_measures(frame, dv="value", within="condition", subject="subject")
    >>> result.table()[["F", "df1", "df2", "epsilon_gg", "p_gg"]].round(3)
           F  df1  df2  epsilon_gg   p_gg
    0  5.891    4  140       0.819  0.001
    """
    factors = within if isinstance(within, list) else [within]
    if len(factors) != 1 or between is not None or covariate is not None:
        from trustlab.studies.factors.factorial import factorial_measures

        groups = between if isinstance(between, list) else [] if between is None else [between]
        return factorial_measures(
            frame, dv, factors, subject, groups, covariate, missing, order, correction, alpha
        )
    within = factors[0]
    order = order.get(within) if isinstance(order, dict) else order
    one_of("correction", correction, ("auto", *CORRECTIONS))
    alpha = open_unit("alpha", alpha)
    observed = read_scores(frame, dv, within, subject, order=order)
    scores, excluded = complete_scores(observed, missing)
    batch = analyse_table(scores)
    omnibus = batch.study(0)
    df1 = batch.df1
    df2 = batch.df2
    gg = omnibus["epsilon_gg"]
    hf = omnibus["epsilon_hf"]
    decision = decided(omnibus, df1, df2, batch.n - 1, correction, alpha)
    interval = partial_eta_interval(
        omnibus["F"], decision["df1_corrected"], decision["df2_corrected"], 0.90
    )
    return RepeatedMeasures(
        **omnibus,
        **decision,
        dv=dv,
        within=within,
        subject=subject,
        conditions=scores.conditions,
        subjects=scores.subjects,
        excluded=excluded,
        df1_gg=df1 * gg,
        df2_gg=df2 * gg,
        df1_hf=df1 * hf,
        df2_hf=df2 * hf,
        eta2_partial_low=interval.low,
        eta2_partial_high=interval.high,
        alpha=alpha,
        notes=_notes(scores, excluded, batch),
        origin=scores.origin,
        scores=scores,
        observed=observed,
        batch=batch,
    )


def _notes(scores: ScoreTable, excluded: tuple, batch: RepeatedMeasuresBatch) -> tuple[str, ...]:
    """Return what a reader should know of the data before using the numbers."""
    notes = []
    if excluded:
        notes.append(f"Left out for missing cells: {', '.join(map(repr, excluded))}.")
    if constant := same_for_all(scores):
        notes.append(
            f"Every subject has the same score (SD = 0) in {', '.join(map(repr, constant))}: a "
            "limit of the scale, or a fault of the data? Tests with that condition rest on the "
            "variance of the other conditions alone."
        )
    notes += rating_notes(scores.values, 'friedman() and pairs(method="wilcoxon")')
    flat = np.flatnonzero(np.isnan(batch.pairwise.t[0]))
    if flat.size:
        a, b = (
            scores.conditions[int(index[flat[0]])] for index in (batch.pairwise.a, batch.pairwise.b)
        )
        same = f"every subject has the same difference ({a!r} and {b!r} first)"
        notes.append(f"In {flat.size} pair(s) of conditions {same}: no t-test.")
    return tuple(notes)
