"""
Repeated measures with several factors, from a long table: effects, simple effects, pairs, and all
of them by aligned ranks.
"""

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from itertools import combinations, product
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import scipy

from trustlab.models.axes import axes_or_new
from trustlab.models.checks import of_class, one_of, open_unit
from trustlab.models.html import as_html
from trustlab.studies.analysis.batch import bonferroni, holm, noncentrality_limit
from trustlab.studies.analysis.rank_tests import rating_notes
from trustlab.studies.analysis.score_table import (
    ScoreTable,
    complete_scores,
    labelled,
    levels_of,
    read_scores,
)
from trustlab.studies.analysis.sphericity import CORRECTIONS, decided, orthonormal_contrasts
from trustlab.studies.columns import column_of, number_or_nan
from trustlab.studies.factors.effects import (
    BetweenDesign,
    between_design,
    effect_tests,
    subsets,
    tested,
)

ERRORS = ("own", "pooled")
ESTIMATE = ("mean_difference", "ci_low", "ci_high", "t", "df", "p")


class ErrorVariances(NamedTuple):
    """
    Variance and degrees of freedom within subjects, the mean of all contrasts, and between them.
    """

    within: tuple[float, int]
    between: tuple[float, int]


@dataclass(frozen=True, eq=False)
class FactorialMeasures:
    """
    An analysis of variance with factors within and between subjects.

    Parameters
    ----------
    scores : ScoreTable
        What was analysed; its conditions are the cells of the within-subject factors, as tuples.
    within, between : dict of Hashable to tuple
        Factors and their levels; `between` is empty without groups.
    groups : dict of Hashable to numpy.ndarray
        For each between-subject factor the level number of every subject.
    covariate : Hashable or None
        Column with the covariate, taken about its mean.
    design : BetweenDesign
        The regressors of the subjects.
    effects : pandas.DataFrame
        What `table` returns.
    excluded : tuple
        Subjects left out for missing cells.
    correction : str
        The correction asked for.
    alpha : float
        Level below which a p-value is called significant.
    """

    scores: ScoreTable
    within: Mapping[Hashable, tuple]
    between: Mapping[Hashable, tuple]
    groups: Mapping[Hashable, np.ndarray]
    covariate: Hashable | None
    design: BetweenDesign
    effects: pd.DataFrame
    excluded: tuple
    correction: str
    alpha: float

    @property
    def origin(self) -> str:
        """What kind of data these are where they were not measured; else empty."""
        return self.scores.origin

    @property
    def notes(self) -> tuple[str, ...]:
        """What a reader should know before using the numbers."""
        return rating_notes(self.scores.values, "aligned_ranks()")

    def table(self) -> pd.DataFrame:
        """
        Return the test of every effect, sums of squares of type III.

        Returns
        -------
        pandas.DataFrame
            Columns dv, effect, n, F, df1, df2, p (sphericity assumed), ss_effect, ss_error,
            mauchly_w, mauchly_p, epsilon_gg, epsilon_hf, epsilon_hf_untruncated, p_gg, p_hf,
            eta2_partial, eta2_generalized, mauchly_reason, correction, reason, df1_corrected,
            df2_corrected, p_corrected, eta2_partial_low, eta2_partial_high (90 %), alpha, excluded.
        """
        return self.effects.copy()

    def descriptives(self) -> pd.DataFrame:
        """Return a row per group and cell: the factors' columns, then n, mean, sd, se."""
        rows = []
        for group, who in self.members():
            for j, cell in enumerate(self.scores.conditions):
                x = self.scores.values[who, j]
                sd = x.std(ddof=1) if x.size > 1 else np.nan
                rows.append((*group, *cell, x.size, x.mean(), sd, sd / np.sqrt(x.size)))
        return labelled(
            pd.DataFrame(rows, columns=[*self.between, *self.within, "n", "mean", "sd", "se"]),
            self.origin,
        )

    def simple_effects(self, factor: Hashable, at: Hashable) -> pd.DataFrame:
        """
        Return the effect of one factor at each level of another, with the error term of that level.

        Parameters
        ----------
        factor, at : hashable
            The factor tested, and the one whose levels are held. Other factors are averaged. Groups
            share one error variance.

        Returns
        -------
        pandas.DataFrame
            Columns factor, at, level, F, df1, df2, p, epsilon_gg, p_gg, eta2_partial, p_holm (of
            the corrected p over levels).

        Raises
        ------
        ValueError
            If a factor is unknown or the two are one.
        """
        rows = []
        for level, cells, mean in self._held(factor, at):
            if factor in self.within:
                contrasts = self._weights(
                    {factor: orthonormal_contrasts(len(self.within[factor]))}, cells
                )
                rows_of_design = mean[None]
            else:
                contrasts = self._weights({}, cells)
                rows_of_design = np.diff(
                    [self._mean_row({factor: x}) for x in self.between[factor]], axis=0
                )
            ss, covariance = tested(
                (self.scores.values @ contrasts)[None], self.design, rows_of_design
            )
            d, error = contrasts.shape[1], float(np.trace(covariance[0]))
            df1, df2 = d * len(rows_of_design), d * self.design.df_error
            f = float(ss[0]) / len(rows_of_design) / error if error > 0.0 else np.nan
            epsilon = (
                1.0 / (d * ((covariance[0] / error) ** 2).sum()) if d > 1 and error > 0.0 else 1.0
            )
            p, p_gg = (
                scipy.special.fdtrc(df1, df2, f),
                scipy.special.fdtrc(df1 * epsilon, df2 * epsilon, f),
            )
            rows.append(
                (factor, at, level, f, df1, df2, p, epsilon, p_gg, f * df1 / (f * df1 + df2))
            )
        columns = [
            "factor",
            "at",
            "level",
            "F",
            "df1",
            "df2",
            "p",
            "epsilon_gg",
            "p_gg",
            "eta2_partial",
        ]
        table = pd.DataFrame(rows, columns=columns)
        return labelled(table.assign(p_holm=holm(table["p_gg"].to_numpy())), self.origin)

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
        return labelled(aligned_tests(self, one_of("error", error, ERRORS)), self.origin)

    def residual_covariance(self) -> np.ndarray:
        """Return the covariance of the cells, given the groups."""
        x, scores = self.design.matrix, self.scores.values
        residual = scores - x @ np.linalg.lstsq(x, scores)[0]
        return residual.T @ residual / self.design.df_error

    def error_variances(self) -> ErrorVariances:
        """
        Return the variances of orthonormal contrasts of the cells, and of their normalized sum,
        given the groups.
        """
        covariance, df = self.residual_covariance(), self.design.df_error
        contrasts, between = len(covariance) - 1, float(covariance.mean() * len(covariance))
        return ErrorVariances(
            ((np.trace(covariance) - between) / contrasts, contrasts * df), (between, df)
        )

    def pairs(
        self, factor: Hashable, at: Hashable = None, *, method: str = "t", error: str = "own"
    ) -> pd.DataFrame:
        """
        Return all pairwise comparisons of one factor's levels, over all cells or within each level
        of another factor.

        Other factors are averaged with equal weights, and groups share one error variance.

        Parameters
        ----------
        factor, at : hashable
            The factor compared and, optionally, the one whose levels are held; p-values are
            adjusted within each level.
        method : {"t", "aligned_ranks"}
            t-tests of the scores, or of ranks aligned for the cells of `factor` and `at` (ART-C:
            Elkin and others, UIST 2021, 754-768).
        error : {"own", "pooled"}
            Whether every comparison within subjects has the error of its own differences, as
            `emmeans` on afex's multivariate model, or one variance of all cells, as with compound
            symmetry; degrees of freedom are then Satterthwaite's.

        Returns
        -------
        pandas.DataFrame
            Columns level (of `at`), a, b, mean_difference (a − b), ci_low, ci_high (95 %,
            unadjusted), t, df, p, p_bonferroni, p_holm, d_z (mean over the residual standard
            deviation of the differences; NaN between groups).

        Raises
        ------
        ValueError
            If a factor is unknown or the two are one.
        """
        one_of("error", error, ERRORS)
        if one_of("method", method, ("t", "aligned_ranks")) != "t":
            named = [self._known(name) for name in (factor, at) if name is not None]
            return aligned(self, named, whole=True).pairs(factor, at, error=error)
        held = self._held(factor, at) if at is not None else [(np.nan, {}, self._mean_row({}))]
        levels = {**self.within, **self.between}[self._known(factor)]
        tables = []
        for level, cells, mean in held:
            rows = []
            for i, j in combinations(range(len(levels)), 2):
                row, difference = mean, np.zeros((len(levels), 1))
                difference[[i, j], 0] = 1.0, -1.0
                if factor in self.within:
                    weights = self._weights({factor: difference}, cells)
                else:
                    weights = self._weights({}, cells)
                    row = self._mean_row({factor: levels[i]}) - self._mean_row({factor: levels[j]})
                estimate = self._estimate(weights[:, 0], row, factor in self.within, error)
                rows.append((level, levels[i], levels[j], *estimate))
            table = pd.DataFrame(rows, columns=["level", "a", "b", *ESTIMATE, "d_z"])
            p = table["p"].to_numpy()
            table.insert(table.columns.get_loc("d_z"), "p_bonferroni", bonferroni(p))
            table.insert(table.columns.get_loc("d_z"), "p_holm", holm(p))
            tables.append(table)
        return labelled(pd.concat(tables, ignore_index=True), self.origin)

    def apa(self) -> str:
        """
        Return the sentences for a paper: every effect with its test, corrected as `correction`
        says, and effect sizes.
        """
        from trustlab.studies.analysis.apa import apa_effects

        return apa_effects(self)

    def plot(self, axes=None):
        """
        Plot the cell means with 95 % intervals between subjects: the first factor along the axis, a
        line per other cell.

        Parameters
        ----------
        axes : matplotlib.axes.Axes, optional
            Where to draw; a new figure by default.

        Returns
        -------
        matplotlib.axes.Axes
        """
        axes = axes_or_new(axes, figsize=(6.0, 3.8))
        first, *others = self.within
        table = self.descriptives()
        lines = (
            table.groupby([*self.between, *others], sort=False)
            if self.between or others
            else [((), table)]
        )
        for i, (cell, own) in enumerate(lines):
            reach = scipy.special.stdtrit(own["n"] - 1, 0.975) * own["se"]
            places = np.arange(len(own)) + 0.06 * i
            label = ", ".join(map(str, cell)) or None
            axes.errorbar(places, own["mean"], reach, fmt="o-", capsize=4, lw=1.3, label=label)
        axes.set_xticks(
            range(len(self.within[first])), [str(level) for level in self.within[first]]
        )
        axes.set(xlabel=str(first), ylabel=str(self.scores.dv))
        title = f"means, 95 % intervals between subjects (N = {len(self.scores.subjects)})"
        axes.set_title(f"{self.origin}: {title}" if self.origin else title, fontsize="small")
        axes.legend(fontsize="small", title=", ".join(map(str, [*self.between, *others])))
        return axes

    def _repr_html_(self) -> str:
        columns = [
            "effect",
            "F",
            "df1_corrected",
            "df2_corrected",
            "p_corrected",
            "eta2_partial",
            "eta2_generalized",
        ]
        left_out = f" Left out: {', '.join(map(str, self.excluded))}." if self.excluded else ""
        about = (
            f"{self.origin} {len(self.scores.subjects)} subjects, correction: "
            f"{self.correction}.{left_out}".strip()
        )
        about = " ".join((about, *self.notes))
        return as_html(about, self.effects[columns], self.descriptives(), title=str(self.scores.dv))

    def members(self) -> list[tuple[tuple, np.ndarray]]:
        """Return every combination of groups, and which subjects are in it."""
        found = []
        for combination in product(*(range(len(levels)) for levels in self.between.values())):
            own = dict(zip(self.between, combination, strict=True))
            who = np.ones(len(self.scores.subjects), dtype=bool)
            for name, level in own.items():
                who &= self.groups[name] == level
            found.append((tuple(self.between[name][level] for name, level in own.items()), who))
        return found

    def _known(self, factor: Hashable) -> Hashable:
        if factor not in self.within and factor not in self.between:
            raise ValueError(
                f"{factor!r} is not a factor of this design: {[*self.within, *self.between]}"
            )
        return factor

    def _held(self, factor: Hashable, at: Hashable) -> list[tuple[Hashable, dict, np.ndarray]]:
        """
        Return each level of `at` with what it fixes: the level of a within-subject factor, or a row
        of the design.
        """
        if self._known(factor) == self._known(at):
            raise ValueError(f"factor and at are both {factor!r}; name two factors")
        if at in self.within:
            return [(level, {at: level}, self._mean_row({})) for level in self.within[at]]
        if factor in self.between:
            raise ValueError(
                f"{factor!r} and {at!r} are both between subjects; select the rows of a group "
                "instead"
            )
        return [(level, {}, self._mean_row({at: level})) for level in self.between[at]]

    def _weights(
        self, own: Mapping[Hashable, np.ndarray], held: Mapping[Hashable, Hashable]
    ) -> np.ndarray:
        """
        Return weights of the cells: contrasts of some factors, one level of others, the mean over
        the rest.
        """
        parts = []
        for name, levels in self.within.items():
            if name in own:
                parts.append(own[name])
            elif name in held:
                parts.append(np.eye(len(levels))[:, [levels.index(held[name])]])
            else:
                parts.append(np.full((len(levels), 1), 1.0 / len(levels)))
        return reduce(np.kron, parts)

    def _mean_row(self, held: Mapping[Hashable, Hashable]) -> np.ndarray:
        """
        Return the design's row of a mean: of one level of some between-subject factors, unweighted
        over the others.
        """
        coded = {}
        for name, levels in self.between.items():
            k = len(levels)
            rows = np.vstack([np.eye(k - 1), -np.ones(k - 1)])
            coded[name] = rows[levels.index(held[name])] if name in held else np.zeros(k - 1)
        row = np.zeros(self.design.matrix.shape[1])
        for block, columns in self.design.blocks.items():
            names = [name for name in self.between if str(name) in block.split(" × ")]
            if block and not names:
                continue  # a covariate: its mean is 0
            row[columns] = reduce(
                np.multiply.outer, (coded[name] for name in names), np.ones(1)
            ).ravel()
        return row

    def _estimate(
        self, weights: np.ndarray, row: np.ndarray, paired: bool, error: str
    ) -> tuple[float, ...]:
        """
        Return `ESTIMATE` and d_z of one linear combination of the cells and of the design's
        coefficients.
        """
        x = self.design.matrix
        y = self.scores.values @ weights
        df = float(self.design.df_error)
        inverse = np.linalg.inv(x.T @ x)
        coefficients = inverse @ x.T @ y
        variance = ((y - x @ coefficients) ** 2).sum() / df
        if error == "pooled":
            common = weights.sum() ** 2 / weights.size
            within, between = self.error_variances()
            parts = [
                ((weights @ weights - common) * within[0], within[1]),
                (common * between[0], between[1]),
            ]
            variance = sum(part for part, _ in parts)
            df = variance**2 / sum(part**2 / own for part, own in parts)
        flat = np.sqrt(variance) <= 4.0 * np.finfo(float).eps * np.abs(self.scores.values).max()
        mean, se = (
            float(row @ coefficients),
            np.nan if flat else float(np.sqrt(variance * (row @ inverse @ row))),
        )
        half, t = scipy.special.stdtrit(df, 0.975) * se, mean / se
        d_z = mean / np.sqrt(variance) if paired and not flat else np.nan
        return mean, mean - half, mean + half, t, df, 2.0 * scipy.special.stdtr(df, -abs(t)), d_z


def tested_effects(
    scores: ScoreTable,
    within: Mapping[Hashable, tuple],
    design: BetweenDesign,
    correction: str,
    alpha: float,
) -> pd.DataFrame:
    """
    Return the test of every effect of complete scores, with the correction that applies to each.
    """
    one_of("correction", correction, ("auto", *CORRECTIONS))
    sizes = {str(name): len(levels) for name, levels in within.items()}
    try:
        tests = (
            effect_tests(scores.values[None], sizes, design)
            .reset_index("effect")
            .reset_index(drop=True)
        )
    except ValueError as error:
        raise ValueError(
            f"dv: column {scores.dv!r}: {str(error).removeprefix('study 0: ')}"
        ) from None
    rows, n = [], len(scores.subjects)
    for row in tests.to_dict("records"):
        row |= decided(row, row["df1"], row["df2"], design.df_error, correction, alpha)
        df1, df2 = row["df1_corrected"], row["df2_corrected"]
        low, high = (noncentrality_limit(row["F"], df1, df2, x) for x in (0.95, 0.05))
        total = df2 * n / design.df_error  # λ = total · η²/(1 − η²) in the population
        row |= {"eta2_partial_low": low / (low + total), "eta2_partial_high": high / (high + total)}
        rows.append({"dv": scores.dv, "n": n} | row | {"alpha": alpha})
    return pd.DataFrame(rows)


def factorial_measures(
    frame: pd.DataFrame,
    dv: Hashable,
    within: Sequence[Hashable],
    subject: Hashable,
    between: Sequence[Hashable],
    covariate: Hashable | None,
    missing: str,
    order: Mapping[Hashable, Sequence] | None,
    correction: str,
    alpha: float,
) -> FactorialMeasures:
    """
    Analyse a long table with factors `within` and `between` subjects; the arguments are those of
    `repeated_measures`.
    """
    of_class("frame", frame, pd.DataFrame, "with a row per subject and cell")
    alpha = open_unit("alpha", alpha)
    columns = [dv, subject, *within, *between, *([] if covariate is None else [covariate])]
    for name in columns:
        if columns.count(name) > 1:
            raise ValueError(f"every column has one part in a design, but {name!r} is named twice")
    order = (
        {} if order is None else of_class("order", order, dict, "give the levels of each factor")
    )
    if unknown := [name for name in order if name not in (*within, *between)]:
        raise ValueError(
            f"order: {unknown[0]!r} is not a factor of this design: {[*within, *between]}"
        )
    levels = {
        name: tuple(levels_of(column_of(frame, "within", name), "within", order.get(name)))
        for name in within
    }
    for name, own in levels.items():
        if len(own) < 2:
            raise ValueError(
                f"within: column {name!r} has one level only, {own[0]!r}; a factor needs two"
            )
    observed = _cells(frame, dv, levels, subject)
    scores, excluded = complete_scores(observed, missing)
    sides = {name: _per_subject(frame, "between", name, subject) for name in between}
    groups, labels = {}, {}
    for name, side in sides.items():
        sorted_in = [side[who] for who in scores.subjects]
        labels[name], groups[name] = _groups(frame, name, sorted_in, scores, order.get(name))
    covariates = (
        {} if covariate is None else {str(covariate): _covariate(frame, covariate, subject, scores)}
    )
    design = between_design(
        len(scores.subjects), {str(name): codes for name, codes in groups.items()}, covariates
    )
    if np.linalg.matrix_rank(design.matrix) < design.matrix.shape[1]:
        raise ValueError(
            f"between: some combination of {[*between]} has no participant: its effects are not "
            "defined"
        )
    if design.df_error < 1:
        found = (
            f"{len(scores.subjects)} participants {[*scores.subjects]} for "
            f"{design.matrix.shape[1]} parameters"
        )
        raise ValueError(f"subject: {found} leave nothing to estimate the error from")
    effects = tested_effects(scores, levels, design, correction, alpha).assign(
        excluded=len(excluded)
    )
    effects = labelled(effects, scores.origin)
    return FactorialMeasures(
        scores, levels, labels, groups, covariate, design, effects, excluded, correction, alpha
    )


def _cells(
    frame: pd.DataFrame, dv: Hashable, levels: Mapping[Hashable, tuple], subject: Hashable
) -> ScoreTable:
    """Return scores of every subject in every cell, whose label is the tuple of its levels."""
    name = " × ".join(map(str, levels))
    cells = np.empty(len(frame), dtype=object)
    cells[:] = list(zip(*(frame[factor].tolist() for factor in levels), strict=True))
    wanted, seen = list(product(*levels.values())), set(cells)
    if empty := [cell for cell in wanted if cell not in seen]:
        more = f" and {len(empty) - 1} more" if len(empty) > 1 else ""
        raise ValueError(f"within: no participant has a score in cell {empty[0]!r} of {name}{more}")
    long = pd.DataFrame(
        {"subject": column_of(frame, "subject", subject), "dv": column_of(frame, "dv", dv)}
    )
    long = long.assign(cell=cells)
    long.attrs = frame.attrs
    long.columns = pd.Index([subject, dv, name], tupleize_cols=False)
    return read_scores(long, dv, name, subject, order=wanted)


def _per_subject(frame: pd.DataFrame, argument: str, name: Hashable, subject: Hashable) -> dict:
    """
    Return the one value that each participant has in a column; a participant with two is refused by
    name.
    """
    found: dict[Hashable, Hashable] = {}
    for who, value in zip(
        frame[subject].tolist(), column_of(frame, argument, name).tolist(), strict=True
    ):
        first = found.setdefault(who, value)
        if first != value and not (pd.isna(first) and pd.isna(value)):
            raise ValueError(
                f"{argument}: subject {who!r} has two values in column {name!r}, {first!r} and "
                f"{value!r}"
            )
    return found


def _groups(
    frame: pd.DataFrame, name: Hashable, own: list, scores: ScoreTable, order: Any
) -> tuple:
    """Return the labels of a between-subject factor and the group number of every subject."""
    labels = tuple(label for label in levels_of(frame[name], "between", order) if label in own)
    members = {
        label: [who for who, x in zip(scores.subjects, own, strict=True) if x == label]
        for label in labels
    }
    if len(labels) < 2:
        raise ValueError(
            f"between: column {name!r} has one group only among the complete participants, "
            f"{labels[0]!r}"
        )
    for label, who in members.items():
        if len(who) < 2:
            raise ValueError(
                f"between: group {label!r} of {name!r} has one participant, {who[0]!r}; two are "
                "needed"
            )
    return labels, np.array([labels.index(x) for x in own])


def _covariate(
    frame: pd.DataFrame, name: Hashable, subject: Hashable, scores: ScoreTable
) -> np.ndarray:
    """Return a covariate of the subjects, finite and not the same for all."""
    found = _per_subject(frame, "covariate", name, subject)
    values = np.empty(len(scores.subjects))
    for i, who in enumerate(scores.subjects):
        try:
            values[i] = number_or_nan(found[who])
        except TypeError:
            values[i] = np.nan
        if not np.isfinite(values[i]):
            raise ValueError(
                f"covariate: column {name!r} is {found[who]!r} for subject {who!r}, no finite "
                "number"
            )
    if np.ptp(values) == 0.0:
        raise ValueError(
            f"covariate: column {name!r} is {values[0]:g} for every participant; leave it out"
        )
    return values


def aligned(
    result: FactorialMeasures, factors: Sequence[Hashable], whole: bool = False
) -> FactorialMeasures:
    """
    Return the design with the ranks of its scores aligned for the effect of some factors (Wobbrock
    and others, 2011).

    With `whole`, all that their cells differ by stays, as if they were one factor: what contrasts
    need (ART-C, Elkin and others, 2021). Cells are means of all scores in them, whatever the sizes
    of groups.
    """
    if result.covariate is not None:
        raise ValueError(
            "the aligned rank transform has no covariates; leave the covariate out of the analysis"
        )
    scores = result.scores.values
    largest = np.abs(scores).max()
    cells = pd.DataFrame(
        list(product(*(range(len(own)) for own in result.within.values()))),
        columns=[*result.within],
    )
    long = cells.loc[np.tile(cells.index, len(scores))].reset_index(drop=True)
    for name, codes in result.groups.items():
        long[name] = np.repeat(codes, len(cells))
    y = pd.Series(scores.ravel() / largest)

    def mean(names: Sequence[Hashable]) -> np.ndarray:
        own = (
            y.groupby([long[name] for name in names]).transform("mean")
            if names
            else y * 0.0 + y.mean()
        )
        return own.to_numpy()

    signs = {names: (-1.0) ** (len(factors) - len(names)) for names in subsets(factors)}
    if whole:
        signs = {tuple(factors): 1.0, (): -1.0}
    effect = sum(sign * mean(names) for names, sign in signs.items())
    kept = y.to_numpy() - mean([*long]) + effect
    # Equal values differ in floating point: ranks are those of twelve digits of the largest score.
    ranks = scipy.stats.rankdata(np.round(kept, 12)).reshape(scores.shape)
    return replace(result, scores=replace(result.scores, values=ranks))


def aligned_tests(result: FactorialMeasures, error: str) -> pd.DataFrame:
    """
    Return the test of every effect on the ranks aligned for it; the columns are those of
    `FactorialMeasures.aligned_ranks`.
    """
    sizes = {str(name): len(levels) for name, levels in result.within.items()}
    rows = []
    for within, between in product(subsets([*result.within]), subsets([*result.between])):
        if not within and not between:
            continue
        effect = " × ".join(map(str, (*between, *within)))
        ranked = aligned(result, (*between, *within))
        test = effect_tests(ranked.scores.values[None], sizes, result.design).loc[(0, effect)]
        f = test["F"]
        df1 = int(test["df1"])
        df2 = int(test["df2"])
        epsilon = test["epsilon_gg"]
        if error == "pooled" and within:
            variance, df2 = ranked.error_variances().within
            f, epsilon = test["ss_effect"] / df1 / variance, np.nan
        p, p_gg = (
            scipy.special.fdtrc(df1, df2, f),
            scipy.special.fdtrc(epsilon * df1, epsilon * df2, f),
        )
        rows.append((effect, f, df1, df2, p, epsilon, p_gg, f * df1 / (f * df1 + df2)))
    columns = ["effect", "F", "df1", "df2", "p", "epsilon_gg", "p_gg", "eta2_partial"]
    return (
        pd.DataFrame(rows, columns=columns)
        .set_index("effect")
        .loc[result.effects["effect"]]
        .reset_index()
    )
