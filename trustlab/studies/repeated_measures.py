"""Repeated-measures ANOVA of a long table, and everything that a paper reports about it."""

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
import pandas as pd
from scipy import special

from trustlab.models.checks import one_of, open_unit, shown
from trustlab.models.display import axes_or_new
from trustlab.studies import pairs
from trustlab.studies.anova import (
    CORRECTIONS,
    Design,
    effect_name,
    effects,
    partial_eta_interval,
    regress,
)
from trustlab.studies.table import (
    Columns,
    Tested,
    complete_scores,
    labelled,
    mark,
    names_of,
    numbers_of,
    origin_of,
    read_cells,
    read_factors,
    refuse_shared,
)
from trustlab.studies.words import apa_report


@dataclass(frozen=True, eq=False, repr=False)
class RepeatedMeasures(Tested):
    """
    An analysis of variance with factors within and between subjects.

    Columns of `table` in which all effects agree are attributes too: ``.n``, ``.k``, ``.dv``,
    ``.alpha``; of a design with one effect also ``.F``, ``.p_corrected``, ``.epsilon_gg`` …

    Parameters
    ----------
    scores : pandas.DataFrame
        What was analysed: a row per subject, a column per condition, or cell of several factors.
    design : Design
        Factors within and between subjects, and groups.
    tests : pandas.DataFrame
        What `table` returns: the test of every effect, sums of squares of type III. Columns dv,
        within (the factors), effect, n, k; those of `repeated_measures_batch`; the correction that
        applies: correction, df1_corrected, df2_corrected, p_corrected, and eta2_partial_low,
        eta2_partial_high (90 %) with its degrees of freedom; alpha, excluded (how many subjects),
        origin.
    excluded : tuple
        Subjects left out for missing cells.
    correction_rule : {"greenhouse-geisser", "huynh-feldt", "none"}
        The correction asked for.
    """

    scores: pd.DataFrame
    design: Design
    tests: pd.DataFrame
    excluded: tuple
    correction_rule: str

    @property
    def conditions(self) -> tuple:
        """Labels of the conditions: the levels of one factor, or the cells of several."""
        return tuple(self.scores.columns)

    @property
    def within(self) -> Mapping[Hashable, Sequence]:
        """Factors within subjects and their levels."""
        return self.design.within

    @property
    def between(self) -> Mapping[Hashable, Sequence]:
        """Factors between subjects and their levels; empty without groups."""
        return self.design.between

    @property
    def one_way(self) -> bool:
        """Whether there is one factor within subjects and nothing else."""
        return len(self.within) == 1 and not {*self.between, *self.design.covariates}

    @property
    def title(self) -> str:
        """The measure and the factors."""
        return f"{self.dv} by {', '.join(map(str, [*self.within, *self.between]))}"

    def _refuse_several_factors(self, name: str) -> None:
        if not self.one_way:
            raise ValueError(
                f"{name} is for one factor within subjects, without groups or covariates; this "
                f"design has {[*self.within, *self.between, *self.design.covariates]}"
            )

    def descriptives(self) -> pd.DataFrame:
        """
        Return descriptive statistics of the conditions, or of every group and cell.

        Returns
        -------
        pandas.DataFrame
            Columns condition, or the factors' of several; n mean sd se median minimum maximum, then
            two 95 % intervals of the mean: ci_low and ci_high between subjects, ci_low_within and
            ci_high_within after Cousineau and Morey.
        """
        k = self.scores.shape[1]
        scores = self.scores.set_axis(range(k), axis=1)
        # Removing the subjects' means (Cousineau, 2005) leaves the spread that a comparison within
        # subjects sees; the factor (Morey, 2008) compensates for the variance that this removes.
        inside = scores.sub(scores.mean(axis=1), axis=0) * np.sqrt(k / (k - 1.0))
        group = np.broadcast_to(self.design.group, len(scores))
        table = scores.groupby(group).agg(["count", "mean", "std", "sem", "median", "min", "max"])
        table = table.stack(0, future_stack=True).reset_index(drop=True)  # noqa: PD013
        table.columns = ["n", "mean", "sd", "se", "median", "minimum", "maximum"]
        within = inside.groupby(group).sem().to_numpy().ravel()
        half = special.stdtrit(table["n"] - 1, 0.975)
        for end, se in {"": table["se"], "_within": within}.items():
            table[f"ci_low{end}"] = table["mean"] - half * se
            table[f"ci_high{end}"] = table["mean"] + half * se
        names = ["condition"] if self.one_way else [*self.between, *self.within]
        refuse_shared(names, table)
        cells = [*product(*self.between.values(), *self.within.values())]
        return labelled(pd.DataFrame(cells, columns=names, dtype=object).join(table), self.origin)

    def pairs(
        self,
        factor: Hashable = None,
        at: Hashable = None,
        *,
        method: str = "t",
        confidence: float = 0.95,
    ) -> pd.DataFrame:
        """
        Return all pairwise comparisons of one factor's levels, a before b.

        Other factors are averaged with equal weights, and groups share one error variance.

        Parameters
        ----------
        factor, at : hashable, optional
            The factor compared (by default the only one within subjects) and the one whose levels
            are fixed; p-values are adjusted within each level.
        method : {"t", "wilcoxon"}
            Paired t-tests, or Wilcoxon's signed-rank tests of one factor, which follow `friedman`.
        confidence : float
            Level of the intervals.

        Returns
        -------
        pandas.DataFrame
            Columns level (of `at`, with several factors) a b mean_difference (a − b) t p ci_low
            ci_high (unadjusted) df p_bonferroni p_holm d_z (mean over the residual standard
            deviation of the differences; NaN between groups) d_z_low d_z_high; of one factor also
            d_av (mean over the mean of both standard deviations). For "wilcoxon", a b V (sum of
            the ranks of positive differences) p method rank_biserial (positive − negative ranks,
            over all) median_difference p_bonferroni p_holm; p is NaN where no scores differ.

        Raises
        ------
        ValueError
            If a factor is unknown or missing, both are the same, or an argument has no effect.
        """
        level = open_unit("confidence", confidence)
        if one_of("method", method, ("t", "wilcoxon")) == "wilcoxon":
            self._refuse_several_factors('pairs(method="wilcoxon")')
            if (factor, at, level) != (None, None, 0.95):
                raise ValueError("factor, at and confidence have no effect on ranks")
            table = pairs.of_pairs(self.scores, pairs.signed_ranks)
            p = table["p"].to_numpy()
            table = table.assign(p_bonferroni=pairs.bonferroni(p), p_holm=pairs.holm(p))
            return labelled(table, self.origin)
        if factor is None and len(self.within) == 1:
            factor = next(iter(self.within))
        names, groups, cells = pairs.level_pairs(self.design, factor, at)
        regression = regress(self.scores.to_numpy()[None], self.design)
        (difference,), (se,), (sd,) = pairs.differences(regression, groups, cells)
        sd = np.nan if factor in self.between else sd
        table = pairs.compared(names, difference, se, self.design.df_error, sd, level)
        table = table.drop(columns="se")
        if self.one_way:
            both = 0.5 * self.scores.std() @ np.abs(cells)
            d_av = difference / np.where(both > 0.0, both, np.nan)
            table = table.drop(columns="level").assign(d_av=d_av)
        return labelled(table, self.origin, confidence=level)

    def residual_covariance(self) -> np.ndarray:
        """Return the covariance of the cells, given the groups."""
        errors = regress(self.scores.to_numpy()[None], self.design).residual[0]
        return errors.T @ errors / self.design.df_error

    def normality(self) -> pd.DataFrame:
        """
        Return the Shapiro–Wilk test of every pair's differences: columns a b W p, NaN for more than
        5,000 subjects.
        """
        self._refuse_several_factors("normality()")
        return labelled(pairs.of_pairs(self.scores, pairs.normality), self.origin)

    def friedman(self) -> pd.DataFrame:
        """Return Friedman's rank test of one factor: columns chi2, df, p, kendall_w."""
        self._refuse_several_factors("friedman()")
        import pingouin

        # A wide table: a row per subject.
        test = pingouin.friedman(pd.DataFrame(self.scores.to_numpy()))
        names = ["chi2", "df", "p", "kendall_w"]
        table = test[["Q", "ddof1", "p_unc", "W"]].set_axis(names, axis=1)
        return labelled(table.reset_index(drop=True), self.origin)

    def assumptions(self) -> pd.DataFrame:
        """
        Return in one row what speaks for or against the ANOVA of one factor.

        Returns
        -------
        pandas.DataFrame
            Columns p_shapiro_least (of all pairs' differences), pairs_not_normal (p below alpha
            after Holm's adjustment), p_anova (corrected), friedman_chi2, p_friedman, kendall_w.
        """
        p, ranks = self.normality()["p"], self.friedman().loc[0]
        row = {
            "p_shapiro_least": p.min(),
            "pairs_not_normal": (pairs.holm(p.to_numpy()) < self.alpha).sum(),
            "p_anova": self.p_corrected,
            "friedman_chi2": ranks["chi2"],
            "p_friedman": ranks["p"],
            "kendall_w": ranks["kendall_w"],
        }
        return labelled(pd.DataFrame([row]), self.origin)

    def apa(self, adjust: str = "holm") -> str:
        """
        Return the sentences for a paper.

        Parameters
        ----------
        adjust : {"holm", "bonferroni", "none"}
            Which adjustment of the pairwise p-values to report; with several factors, every effect
            is reported, and no pairs.

        Raises
        ------
        ValueError
            If an adjustment is unknown, or is chosen where no pairs are reported.
        """
        if isinstance(adjust, str) and adjust != "holm":
            self._refuse_several_factors(f"apa(adjust={adjust!r})")
        return apa_report(self, adjust)

    def plot(self, axes=None):
        """
        Plot the means with 95 % intervals between subjects, as in Figs. 2.11–2.17 and 3.18–3.21;
        with several factors, the first along the axis and a line per cell of the others.

        Parameters
        ----------
        axes : matplotlib.axes.Axes, optional
            Where to draw; a new figure by default.

        Returns
        -------
        matplotlib.axes.Axes
        """
        factor, *others = self.within
        stats, levels, lines = self.descriptives(), self.within[factor], [*self.between, *others]
        cells: Any = stats.groupby(lines, sort=False) if lines else [((), stats)]
        axes = axes_or_new(axes, figsize=(5.6, 3.6))
        for i, (cell, rows) in enumerate(cells):
            mean, places = rows["mean"], np.arange(len(levels)) + 0.06 * i
            ends = [mean - rows["ci_low"], rows["ci_high"] - mean]
            label, style = ", ".join(map(str, cell)), "o-" if lines else "o"
            axes.errorbar(places, mean, ends, fmt=style, capsize=5, label=label)
        if lines:
            axes.legend(fontsize="small", title=", ".join(map(str, lines)))
        axes.set_xticks(range(len(levels)), [*map(str, levels)])
        title = f"{mark(self.origin)}means, 95 % intervals (N = {self.n})"
        axes.set_title(title, fontsize="small", wrap=True)
        axes.set(xlabel=str(factor), ylabel=str(self.dv))
        return axes


def repeated_measures(
    frame: pd.DataFrame,
    dv: Hashable,
    within: Columns,
    subject: Hashable,
    *,
    between: Columns = None,
    covariates: Columns = None,
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
    covariates : hashable or list of hashable, optional
        Columns with a number of each subject, such as age, taken about its mean; they interact with
        the factors within subjects.
    missing : {"raise", "listwise"}
        Whether a missing cell is an error, or its subject is left out (and named in `.excluded`).
    order : sequence or dict, optional
        Conditions in the order wanted; with several factors, a dict of factor to levels. By default
        a categorical column keeps the order of its categories (those that occur); numbers are
        sorted by value and text by alphabet.
    correction : {"greenhouse-geisser", "huynh-feldt", "none"}
        Which correction `.p_corrected` has. All three are always in the result.
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
        subject is in two groups, a level of `between` has one subject, or scores have no error
        variance.

    Notes
    -----
    Values follow R: `aov_car` of afex and `Anova` of car for F, ε and η², `mauchly.test` (its p to
    second order, as SPSS prints it), `t.test(paired = TRUE)` and `p.adjust` for the pairs,
    `friedman.test`, `shapiro.test`.

    Examples
    --------
    >>> import trustlab as tl
    >>> frame = tl.reconstruct(tl.published_studies()["uav.tlx"], seed=0)
    >>> result = tl.repeated_measures(frame, dv="value", within="condition", subject="subject")
    >>> result.table()[["F", "df1", "df2", "epsilon_gg", "p_gg"]].round(3)
           F  df1  df2  epsilon_gg   p_gg
    0  5.891    4  140       0.819  0.001
    """
    one_of("correction", correction, CORRECTIONS)
    alpha = open_unit("alpha", alpha)
    if not names_of(within):
        raise ValueError("within must name a column")
    table, levels, groups = read_factors(frame, dv, within, subject, between, order, covariates)
    cells = read_cells(table, levels, dv, subject)
    call = f"tl.mixed_model(frame, {dv!r}, {within!r}, {subject!r}, between={between!r})"
    remedy = "leave them out with missing='listwise'"
    if not covariates:
        remedy += f"; or call {call}, which takes missing cells"
    scores, excluded = complete_scores(cells, dv, missing, remedy)
    people = table.drop_duplicates(subject).set_index(subject).loc[scores.index]
    group, numbers = np.zeros(len(people), dtype=int), {}
    for name, listed in groups.items():
        group = len(listed) * group + people[name].cat.codes.to_numpy()
        if people[name].value_counts().min() < 2:
            raise ValueError(
                f"between: every group of column {name!r}, {listed}, needs two complete "
                f"participants, got {shown(people[name].value_counts().to_dict())}"
            )
    for name in names_of(covariates):
        x = numbers_of(people[name], "covariates")
        numbers[name] = (x - x.mean()) / (x.std() or 1.0)
    design = Design(len(people), levels, groups, group, numbers)
    parameters = design.matrix.shape[1]
    if np.linalg.matrix_rank(design.matrix) < parameters or design.df_error < 1:
        raise ValueError(
            f"{'covariates' if covariates else 'between'}: effects of {[*groups, *numbers]} are "
            "not defined: some combination of groups has no participant, a covariate follows from "
            f"them, or {parameters} parameters are too many for {design.n} participants"
        )
    tests = effects(scores.to_numpy()[None], design).loc[0].reset_index()
    # A name of the first line that comes again keeps its place.
    columns = {"dv": [dv] * len(tests), "within": effect_name(levels), "effect": "", "n": design.n}
    columns |= {"k": scores.shape[1], **tests, **_corrected(tests, design, correction)}
    columns |= {"alpha": alpha, "excluded": len(excluded), "origin": origin_of(frame)}
    tests = labelled(pd.DataFrame(columns), origin_of(frame))
    return RepeatedMeasures(scores, design, tests, excluded, correction)


def _corrected(tests: pd.DataFrame, design: Design, correction: str) -> dict[str, Any]:
    """Return columns of the correction that applies, and the interval of partial η²."""
    end = CORRECTIONS[correction]
    epsilon = tests.get(f"epsilon{end}", 1.0)
    df1, df2 = tests["df1"] * epsilon, tests["df2"] * epsilon
    d = tests["df2"] // design.df_error
    ends = zip(tests["F"], df1, df2, strict=True)
    strengths = np.array([partial_eta_interval(*numbers)[2:] for numbers in ends]).T
    # λ = n d ε η²/(1 − η²) in the population, for d contrasts within subjects.
    total = df2 + epsilon * (design.n - design.df_error) * d
    low, high = strengths / (strengths + total.to_numpy())
    return {
        "correction": np.where(d > 1, correction, "none"),  # of one, sphericity always holds
        "df1_corrected": df1,
        "df2_corrected": df2,
        "p_corrected": tests[f"p{end}"],
        "eta2_partial_low": low,
        "eta2_partial_high": high,
    }
