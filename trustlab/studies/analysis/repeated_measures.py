"""Repeated-measures ANOVA of a long table, and everything that a paper reports about it."""

from collections.abc import Hashable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd

from trustlab.models.checks import one_of, open_unit
from trustlab.models.display import as_html
from trustlab.studies.analysis import contrasts
from trustlab.studies.analysis.anova import checked_scores, effect_tests, regress
from trustlab.studies.analysis.batch import (
    RepeatedMeasuresBatch,
    analyse_table,
    bonferroni,
    holm,
    table_error,
)
from trustlab.studies.analysis.descriptives import describe, noncentrality_interval
from trustlab.studies.analysis.rank_tests import (
    Friedman,
    friedman,
    normality_of_differences,
    rank_pairs,
    rating_notes,
)
from trustlab.studies.analysis.score_table import ScoreTable, labelled, same_for_all
from trustlab.studies.analysis.sphericity import CORRECTIONS, choose_correction
from trustlab.studies.analysis.study_design import StudyDesign, read_design
from trustlab.studies.mixed import MixedModel, fit_mixed_model

_ETA2 = ["eta2_partial", "eta2_generalized"]
# Statistics of the effect of conditions in a table of sources of variance.
_OF_CONDITIONS = ["F", "p", "epsilon_gg", "p_gg", "epsilon_hf", "p_hf", *_ETA2]
# Columns of effects that a notebook shows.
_SHOWN = ["effect", "F", "df1_corrected", "df2_corrected", "p_corrected", *_ETA2]


@dataclass(frozen=True, eq=False)
class RepeatedMeasures:
    """
    An analysis of variance with factors within and between subjects.

    Where the design has one effect alone, every column of `table` is an attribute too: ``.F``,
    ``.df1``, ``.p_corrected``, ``.epsilon_gg``, ``.reason`` and so on.

    Parameters
    ----------
    scores, observed : ScoreTable
        What was analysed, and what was read (with the cells of excluded subjects). The conditions
        of several factors are their cells, as tuples.
    design : StudyDesign
        Factors, groups and covariate.
    tests : list of dict
        The rows of `table`.
    excluded : tuple
        Subjects left out for missing cells.
    correction_rule : {"greenhouse-geisser", "huynh-feldt", "none", "auto"}
        The correction asked for.
    alpha : float
        Level below which a p-value is called significant.
    """

    scores: ScoreTable
    observed: ScoreTable
    design: StudyDesign
    tests: list[dict[str, Any]]
    excluded: tuple
    correction_rule: str
    alpha: float

    def __getattr__(self, name: str) -> Any:
        # Python calls this only for names that are no field or method.
        if name.startswith("_") or name == "tests" or name not in self.tests[0]:
            raise AttributeError(f"RepeatedMeasures has no attribute {name!r}")
        if len(self.tests) > 1:
            raise AttributeError(
                f"there are {len(self.tests)} effects, each with its {name!r}: see .table()"
            )
        return self.tests[0][name]

    def __dir__(self) -> list[str]:
        return [*super().__dir__(), *(self.tests[0] if len(self.tests) == 1 else [])]

    @property
    def dv(self) -> Hashable:
        """Column analysed."""
        return self.scores.dv

    @property
    def subject(self) -> Hashable:
        """Column with the subjects."""
        return self.scores.subject

    @property
    def subjects(self) -> tuple:
        """Labels of the subjects analysed."""
        return self.scores.subjects

    @property
    def conditions(self) -> tuple:
        """Labels of the conditions: the levels of one factor, or the cells of several."""
        return self.scores.conditions

    @property
    def n(self) -> int:
        """Subjects analysed."""
        return len(self.scores.subjects)

    @property
    def k(self) -> int:
        """Conditions or cells."""
        return len(self.scores.conditions)

    @property
    def within(self) -> Mapping[Hashable, tuple]:
        """Factors within subjects and their levels."""
        return self.design.within

    @property
    def between(self) -> Mapping[Hashable, tuple]:
        """Factors between subjects and their levels; empty without groups."""
        return self.design.between

    @property
    def origin(self) -> str:
        """Synthetic or reconstructed data; empty for measured data."""
        return self.scores.origin

    @cached_property
    def batch(self) -> RepeatedMeasuresBatch:
        """The analysis of one factor as a batch of one study."""
        self._refuse_several_factors("batch")
        return analyse_table(self.scores)

    @cached_property
    def notes(self) -> tuple[str, ...]:
        """What a reader should know before using the numbers."""
        if not self.design.one_way:
            return rating_notes(self.scores.values, "aligned_ranks()")
        notes = []
        if self.excluded:
            notes.append(f"Left out for missing cells: {', '.join(map(repr, self.excluded))}.")
        if constant := same_for_all(self.scores):
            notes.append(
                f"Every subject has the same score (SD = 0) in {', '.join(map(repr, constant))}: "
                "a limit of the scale, or a fault of the data? Tests with that condition rest on "
                "the variance of the other conditions alone."
            )
        notes += rating_notes(self.scores.values, 'friedman() and pairs(method="wilcoxon")')
        pairs = self.pairs()
        flat = pairs[pairs["t"].isna()]
        if len(flat):
            a, b = flat[["a", "b"]].iloc[0].tolist()
            notes.append(
                f"In {len(flat)} pair(s) of conditions every subject has the same difference "
                f"({a!r} and {b!r} first): no t-test."
            )
        return tuple(notes)

    def _refuse_several_factors(self, name: str) -> None:
        if not self.design.one_way:
            raise ValueError(
                f"{name} is for one factor within subjects, without groups or a covariate; this "
                f"design has {[*self.within, *self.between]}"
            )

    def table(self) -> pd.DataFrame:
        """
        Return the test of every effect, sums of squares of type III; nothing is rounded.

        Returns
        -------
        pandas.DataFrame
            Columns dv, within (the factors), effect, n, k, F, df1, df2, p (sphericity assumed),
            ss_effect, ss_subjects, ss_error; Mauchly's test: mauchly_w, mauchly_chi2, mauchly_df,
            mauchly_p, mauchly_p_first_order (without the second-order term; NaN where it is not
            defined) and mauchly_reason (why not); epsilon_gg, epsilon_hf (cut at 1),
            epsilon_hf_untruncated, p_gg, p_hf, df1_gg, df2_gg, df1_hf, df2_hf; eta2_partial,
            eta2_generalized (SS_effect over the sum of all sums of squares of subjects and errors
            and itself); the correction that applies: correction, reason, df1_corrected,
            df2_corrected, p_corrected, and eta2_partial_low, eta2_partial_high (90 %) with its
            degrees of freedom; alpha, excluded (how many subjects), origin.
        """
        return labelled(pd.DataFrame(self.tests), self.origin)

    def anova_table(self) -> pd.DataFrame:
        """
        Return sums of squares, mean squares and the test of one factor, a row per source of
        variance.

        Returns
        -------
        pandas.DataFrame
            Rows condition, error (conditions × subjects) and subjects. Columns source, ss, df, ms
            (of all three), then F, p (sphericity assumed), epsilon_gg, p_gg, epsilon_hf, p_hf,
            eta2_partial and eta2_generalized, which only the first row has.
        """
        self._refuse_several_factors("anova_table()")
        ss = np.array([self.ss_effect, self.ss_error, self.ss_subjects])
        df = np.array([self.df1, self.df2, self.n - 1])
        columns = {"source": ["condition", "error", "subjects"], "ss": ss, "df": df, "ms": ss / df}
        for name in _OF_CONDITIONS:
            columns[name] = [getattr(self, name), np.nan, np.nan]
        return labelled(pd.DataFrame(columns), self.origin)

    def corrections(self) -> pd.DataFrame:
        """
        Return the tests under each correction: columns effect correction epsilon df1 df2 F p
        applies.
        """
        tables = []
        for row in self.tests:
            columns = {
                "effect": row["effect"],
                "correction": CORRECTIONS,
                "epsilon": (1.0, row["epsilon_gg"], row["epsilon_hf"]),
                "df1": (float(row["df1"]), row["df1_gg"], row["df1_hf"]),
                "df2": (float(row["df2"]), row["df2_gg"], row["df2_hf"]),
                "F": row["F"],
                "p": (row["p"], row["p_gg"], row["p_hf"]),
                "applies": [name == row["correction"] for name in CORRECTIONS],
            }
            tables.append(pd.DataFrame(columns))
        return labelled(pd.concat(tables, ignore_index=True), self.origin)

    def descriptives(self) -> pd.DataFrame:
        """
        Return descriptive statistics of the conditions, or of every group and cell.

        Returns
        -------
        pandas.DataFrame
            Of one factor, columns condition n mean sd se median minimum maximum, then two 95 %
            intervals of the mean: ci_low and ci_high between subjects, ci_low_within and
            ci_high_within after Cousineau and Morey. Of several, the factors' columns, then n,
            mean, sd, se.
        """
        if self.design.one_way:
            return labelled(describe(self.scores), self.origin)
        rows = []
        for group, mask in self.design.members():
            for j, cell in enumerate(self.design.cells):
                x = self.scores.values[mask, j]
                sd = x.std(ddof=1) if x.size > 1 else np.nan
                rows.append((*group, *cell, x.size, x.mean(), sd, sd / np.sqrt(x.size)))
        columns = [*self.between, *self.within, "n", "mean", "sd", "se"]
        return labelled(pd.DataFrame(rows, columns=columns), self.origin)

    def pairs(
        self,
        factor: Hashable = None,
        at: Hashable = None,
        *,
        method: str = "t",
        error: str = "own",
    ) -> pd.DataFrame:
        """
        Return all pairwise comparisons of one factor's levels, a before b.

        Other factors are averaged with equal weights, and groups share one error variance.

        Parameters
        ----------
        factor, at : hashable, optional
            The factor compared (not needed where there is one) and the one whose levels are fixed;
            p-values are adjusted within each level.
        method : {"t", "wilcoxon", "conover", "aligned_ranks"}
            Paired t-tests. Of one factor, after Friedman's test, Wilcoxon's signed-rank tests or
            Conover's t of the mean ranks; of several, t-tests of ranks aligned for the cells of
            `factor` and `at` (ART-C: Elkin and others, UIST 2021, 754-768).
        error : {"own", "pooled"}
            With several factors, whether every comparison within subjects has the error of its own
            differences, as `emmeans` on afex's multivariate model, or one variance of all cells, as
            with compound symmetry; degrees of freedom are then Satterthwaite's.

        Returns
        -------
        pandas.DataFrame
            For t-tests, columns a b mean_difference (a − b) ci_low ci_high (95 %, unadjusted) t df
            p p_bonferroni p_holm d_z (mean over the residual standard deviation of the differences;
            NaN between groups); of one factor also d_av, of several first the level of `at`. For
            "wilcoxon", a b V p method rank_biserial median_difference p_bonferroni p_holm; p is NaN
            where no subject's scores differ. For "conover", a b mean_rank_difference t df p
            p_bonferroni p_holm.

        Raises
        ------
        ValueError
            If a factor is unknown or missing, or both are the same.
        """
        one_of("error", error, contrasts.ERRORS)
        if self.design.one_way:
            one_of("method", method, ("t", "wilcoxon", "conover"))
            for name in (factor, at):
                if name is not None:
                    self.design.levels(name)
            return labelled(self._pairs_of_one_factor(method), self.origin)
        one_of("method", method, ("t", "aligned_ranks"))
        if factor is None:
            raise ValueError(f"factor must be one of {[*self.within, *self.between]}")
        scores = self.scores
        if method == "aligned_ranks":
            factors = [factor] if at is None else [factor, at]
            for name in factors:
                self.design.levels(name)
            scores = contrasts.aligned(scores, self.design, factors, whole=True)
        table = contrasts.factor_pairs(scores, self.design, factor, at, error)
        return labelled(table, self.origin)

    def _pairs_of_one_factor(self, method: str) -> pd.DataFrame:
        """Return all pairs of conditions."""
        table = self.batch.pairs().drop(columns="study")
        a, b = self.batch.pairwise.a, self.batch.pairwise.b
        if method != "t":
            tests = rank_pairs(self.scores.values, a, b, method)
            p = tests["p"].to_numpy()
            tests = tests.assign(p_bonferroni=bonferroni(p), p_holm=holm(p))
            table = pd.concat([table[["a", "b"]], tests], axis=1)
        labels = pd.Index(self.conditions, tupleize_cols=False)
        return table.assign(a=labels.take(a), b=labels.take(b))

    def simple_effects(self, factor: Hashable, at: Hashable) -> pd.DataFrame:
        """
        Return the effect of one factor at each level of another, with the error term of that level.

        Parameters
        ----------
        factor, at : hashable
            The factor tested, and the one whose levels are fixed. Other factors are averaged.
            Groups share one error variance.

        Returns
        -------
        pandas.DataFrame
            Columns factor, at, level, F, df1, df2, p, epsilon_gg, p_gg, eta2_partial, p_holm (of
            the corrected p over levels).

        Raises
        ------
        ValueError
            If a factor is unknown or both are the same.
        """
        table = contrasts.simple_effects(self.scores, self.design, factor, at)
        return labelled(table, self.origin)

    def aligned_ranks(self, error: str = "own") -> pd.DataFrame:
        """
        Return the test of every effect on ranks aligned for it: for ratings and skewed scores.

        Parameters
        ----------
        error : {"own", "pooled"}
            Error terms as for `pairs`; "pooled" is what ARTool's models with a random intercept per
            subject have.

        Returns
        -------
        pandas.DataFrame
            Columns effect, F, df1, df2, p, epsilon_gg, p_gg (NaN where the error is pooled),
            eta2_partial, all of ranks.

        Raises
        ------
        ValueError
            If the design has a covariate, or every rank is the same.

        References
        ----------
        J. O. Wobbrock, L. Findlater, D. Gergle, J. J. Higgins, The aligned rank transform for
        nonparametric factorial analyses using only ANOVA procedures, CHI 2011, 143-146.
        """
        table = contrasts.aligned_tests(self.scores, self.design, error)
        return labelled(table, self.origin)

    def residual_covariance(self) -> np.ndarray:
        """Return the covariance of the cells, given the groups."""
        return contrasts.residual_covariance(self.scores, self.design)

    def error_variances(self) -> contrasts.ErrorVariances:
        """
        Return the variances of orthonormal contrasts of the cells, and of their normalized sum,
        given the groups.
        """
        return contrasts.error_variances(self.scores, self.design)

    def normality(self) -> pd.DataFrame:
        """Return the Shapiro–Wilk test of every pair's differences: columns a b W p."""
        pairwise = self.batch.pairwise
        tests = normality_of_differences(self.scores.values, pairwise.a, pairwise.b)
        return labelled(pd.concat([self.pairs()[["a", "b"]], tests], axis=1), self.origin)

    def friedman(self) -> Friedman:
        """Return Friedman's rank test of one factor with Kendall's W."""
        self._refuse_several_factors("friedman()")
        return friedman(self.scores.values)

    def assumptions(self) -> pd.DataFrame:
        """
        Return in one row what speaks for or against the ANOVA of one factor.

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
        """Return the mixed model of all scores of one factor, excluded subjects included."""
        self._refuse_several_factors("mixed_model()")
        return fit_mixed_model(self.observed)

    def apa(self, adjust: str = "holm") -> str:
        """
        Return the sentences for a paper.

        Parameters
        ----------
        adjust : {"holm", "bonferroni", "none"}
            Which adjustment of the pairwise p-values to report; with several factors, every effect
            is reported, and no pairs.
        """
        from trustlab.studies.analysis.apa import apa_effects, apa_report

        return apa_report(self, adjust) if self.design.one_way else apa_effects(self)

    def plot(self, kind: str = "means", *, interval: str = "between", axes=None):
        """
        Plot the conditions; with several factors, the first along the axis and a line per other
        cell.

        Parameters
        ----------
        kind : {"means", "raincloud", "paired"}
            Means with 95 % intervals, as in Figs. 2.11–2.17 and 3.18–3.21; of one factor also
            distributions, or a line per subject.
        interval : {"between", "within"}
            Which interval of the means to draw; of several factors "between".
        axes : matplotlib.axes.Axes, optional
            Where to draw; a new figure by default.

        Returns
        -------
        matplotlib.axes.Axes
        """
        from trustlab.studies.analysis.plots import plot_cells, plot_conditions

        if self.design.one_way:
            return plot_conditions(self, kind, interval, axes)
        one_of("kind", kind, ("means",))
        one_of("interval", interval, ("between",))
        return plot_cells(self, axes)

    def __repr__(self) -> str:
        note = f" [{self.origin}]" if self.origin else ""
        factors = ", ".join(map(str, [*self.within, *self.between]))
        tests = "; ".join(
            f"F({row['df1_corrected']:.4g}, {row['df2_corrected']:.4g}) = {row['F']:.4g}, p = "
            f"{row['p_corrected']:.3g}, correction: {row['correction']}"
            for row in self.tests
        )
        return (
            f"RepeatedMeasures({self.dv} by {factors}, {self.n} subjects × {self.k} "
            f"conditions{note}: {tests})"
        )

    def _repr_html_(self) -> str:
        left_out = f"Left out: {', '.join(map(str, self.excluded))}." if self.excluded else ""
        counts = f"{self.n} subjects × {self.k} conditions."
        origin = self.origin and f"{self.origin}."
        tables = [self.table()[_SHOWN], self.descriptives()]
        reason = ""
        if self.design.one_way:
            reason = self.reason
            corrections = self.corrections().drop(columns="effect")
            tables = [corrections, self.descriptives(), self.pairs()]
        words = " ".join(filter(None, (counts, origin, left_out, reason, *self.notes)))
        factors = ", ".join(map(str, [*self.within, *self.between]))
        return as_html(words, *tables, title=f"{self.dv} by {factors}")


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
) -> RepeatedMeasures:
    """
    Analyse one score under several conditions, or in all cells of several factors.

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
    RepeatedMeasures
        Sums of squares of type III, with Greenhouse–Geisser's and Huynh–Feldt's ε for every effect.

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
    groups = between if isinstance(between, list) else [] if between is None else [between]
    one_of("correction", correction, ("auto", *CORRECTIONS))
    alpha = open_unit("alpha", alpha)
    observed, scores, excluded, design = read_design(
        frame, dv, factors, subject, groups, covariate, missing, order
    )
    tests = _tests_of_effects(scores, design, correction, alpha)
    for test in tests:
        test |= {"alpha": alpha, "excluded": len(excluded), "origin": scores.origin}
    return RepeatedMeasures(scores, observed, design, tests, excluded, correction, alpha)


def _tests_of_effects(
    scores: ScoreTable, design: StudyDesign, correction: str, alpha: float
) -> list[dict]:
    """Return the statistics of every effect, with the correction that applies."""
    try:
        values = checked_scores(scores.values[None])
        tests = effect_tests(regress(values, design.regressors), design.sizes)
    except ValueError as error:
        raise table_error(scores, error) from None
    n, k = scores.values.shape
    columns = n - design.regressors.df_error
    factors = scores.within
    rows = []
    for effect, statistics in tests.items():
        test: dict[str, Any] = {
            name: float(value[0]) if np.ndim(value) else value for name, value in statistics.items()
        }
        df1, df2 = test["df1"], test["df2"]
        test |= {"df1_gg": df1 * test["epsilon_gg"], "df2_gg": df2 * test["epsilon_gg"]}
        test |= {"df1_hf": df1 * test["epsilon_hf"], "df2_hf": df2 * test["epsilon_hf"]}
        decision = choose_correction(test, df1, df2, design.regressors.df_error, correction, alpha)
        corrected = decision["df1_corrected"], decision["df2_corrected"]
        low, high = noncentrality_interval(test["F"], *corrected, 0.90)
        # λ = n d ε η²/(1 − η²) in the population, for d contrasts within subjects.
        d = df2 // design.regressors.df_error
        total = corrected[1] + corrected[0] * (columns * d / df1)
        rows.append(
            {"dv": scores.dv, "within": factors, "effect": effect, "n": n, "k": k}
            | test
            | decision
            | {"eta2_partial_low": low / (low + total), "eta2_partial_high": high / (high + total)}
        )
    return rows
