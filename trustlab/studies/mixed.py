"""
Mixed models of scores with a random intercept per participant, all by one profiled likelihood.

The scores of a participant have the covariance σ² (I + ρ 11ᵀ), where ρ is the variance between
participants over the residual variance σ².
"""

import re
from collections.abc import Callable, Hashable
from dataclasses import dataclass
from functools import cache
from itertools import chain, product
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from scipy import special
from scipy.linalg import khatri_rao
from scipy.optimize import brentq

from trustlab.models.checks import counted, of_class
from trustlab.studies.anova import Design, contrasts, effect_name, partial_eta_interval, subsets
from trustlab.studies.pairs import compared, estimates_of, level_pairs, standard_errors
from trustlab.studies.table import (
    Columns,
    Tested,
    column_of,
    label_column,
    labelled,
    mark,
    origin_of,
    read_cells,
    read_factors,
)
from trustlab.studies.words import apa_number, apa_p, effect_text, left_out

# Ratios of variances between which a minimum of the deviance is bracketed.
RATIOS = np.concatenate([[0.0], np.exp(np.linspace(-16.0, 23.0, 14))])


class InterceptFit(NamedTuple):
    """The best coefficients and residual variance at one ratio of variances."""

    deviance: float  # −2 log-likelihood
    slope: float  # of the deviance, by the ratio
    beta: np.ndarray
    inverse: np.ndarray  # of Xᵀ V⁻¹ X, V the covariance over the residual variance
    ratio: float
    residual: float


def intercept_fit(
    y: np.ndarray, x: np.ndarray, people: np.ndarray, *, restricted: bool = False
) -> InterceptFit:
    """
    Return the maximum of the likelihood of scores, or of the restricted one; `people` are numbers
    from 0.
    """
    counts = np.bincount(people)
    if counts.size < 3:
        raise ValueError(
            f"subject or groups: {counted(counts.size, 'group')} with scores; at least three are "
            "needed"
        )
    # Least squares first, so that neither the offset nor the unit of scores costs digits.
    start = np.linalg.lstsq(x, y)[0]
    columns = np.column_stack([x, y - x @ start])
    means = pd.DataFrame(columns).groupby(people).mean().to_numpy()
    inside = columns - means[people]
    products = inside.T @ inside
    error = inside[:, -1] - inside[:, :-1] @ np.linalg.lstsq(inside[:, :-1], inside[:, -1])[0]
    if np.abs(error).max() <= 32.0 * np.finfo(float).eps * np.abs(y).max():
        raise ValueError(
            "dv or formula: the scores leave no error variance: each is its subject's level "
            "plus its condition's, as where every subject has one score"
        )
    free = y.size - restricted * x.shape[1]

    def profile(ratio: float) -> InterceptFit:
        # V⁻¹ = I − 11ᵀ/m + 11ᵀ/m / (1 + m ratio) for a participant with m scores.
        weight = counts / (1.0 + counts * ratio)
        weighted = products + (means.T * weight) @ means
        inverse = np.linalg.inv(weighted[:-1, :-1])
        shift = inverse @ weighted[:-1, -1]
        contrast = np.append(-shift, 1.0)
        residual = float(contrast @ weighted @ contrast) / free
        falling = (means.T * weight**2) @ means  # of `weighted`, as the ratio rises
        slope = weight.sum() - contrast @ falling @ contrast / residual
        deviance = free * (1.0 + np.log(2.0 * np.pi * residual)) + np.log1p(counts * ratio).sum()
        if restricted:
            slope -= (inverse * falling[:-1, :-1]).sum()
            deviance -= np.linalg.slogdet(inverse)[1]
        return InterceptFit(deviance, slope, start + shift, inverse, ratio, residual)

    # All minima are compared: a search from one start can stop at a variance of zero.
    rising = np.array([profile(ratio).slope >= 0.0 for ratio in RATIOS])
    if not rising.any():
        raise ValueError(
            "dv or formula: scores differ between subjects 100,000 times as much as within them, "
            "too much for both to be estimated; subtract each subject's mean"
        )
    minima = [0.0]
    for i in np.flatnonzero(~rising[:-1] & rising[1:]):
        bracket = RATIOS[i], RATIOS[i + 1]
        minima.append(brentq(lambda ratio: profile(ratio).slope, *bracket, xtol=1e-18))
    return min(map(profile, minima), key=lambda fit: fit.deviance)


# One score in cells of factors.


@dataclass(frozen=True, eq=False, repr=False)
class MixedModel(Tested):
    """
    Score = mean of the cell + random intercept of the subject + error, by restricted maximum
    likelihood.

    Columns of `table` in which all effects agree are attributes too: subject_variance and
    residual_variance, in squared units of the score; icc, the share of the variance that is between
    subjects; singular, whether the subjects' variance is estimated as zero (F is then not the
    ANOVA's, even without missing cells); n, the subjects with a score; cells and missing_cells of
    theirs, with a score and without.

    Parameters
    ----------
    dv : hashable
        Column analysed.
    design : Design
        Factors within and between subjects.
    tests : pandas.DataFrame
        A row per effect: effect, F (Wald's χ²/df1, type III), df1, df2 (those of the ANOVA where no
        cell is missing), p, chi2, p_chi2 (asymptotic), eta2_partial and its 90 % interval.
    means : pandas.DataFrame
        Index cell; columns mean, se, ci_low, ci_high (95 %, t with the least df2).
    covariance : numpy.ndarray, shape (cells, cells)
        Of the means.
    excluded : tuple
        Subjects without any score.
    """

    dv: Hashable
    design: Design
    tests: pd.DataFrame
    means: pd.DataFrame
    covariance: np.ndarray
    excluded: tuple
    title = "Mixed model, random intercept per subject"

    def pairs(self, factor: Hashable = None, at: Hashable = None) -> pd.DataFrame:
        """
        Return all pairwise comparisons of one factor's levels, a before b; others are averaged with
        equal weights.

        Parameters
        ----------
        factor, at : hashable, optional
            The factor compared (by default the first within subjects), and the one whose levels are
            fixed; p-values are adjusted within each level.

        Returns
        -------
        pandas.DataFrame
            Columns level (of `at`), a, b, mean_difference (a − b), se, t, p, ci_low, ci_high (95 %,
            unadjusted), df, p_bonferroni, p_holm, d_z (over √2 residual standard deviations; NaN
            between groups) with its interval, d_z_low, d_z_high (95 %), and d_av (over the standard
            deviation of a score). df is that of the factor's F; of groups at a level within
            subjects Satterthwaite's, exactly so where no cell is missing.

        Raises
        ------
        ValueError
            If a factor is unknown, or both are the same.
        """
        factor = next(iter(self.design.within)) if factor is None else factor
        pairs, *parts = level_pairs(self.design, factor, at)
        weights = khatri_rao(*parts).T
        difference, se = weights @ self.means["mean"], standard_errors(weights, self.covariance)
        df2 = self.tests.set_index("effect")["df2"]
        df, between = df2[str(factor)], factor in self.design.between
        if between and at in self.design.within:
            # The variances of a subject's mean, and of its score at a level about the mean.
            inside, k = self.residual_variance / len(parts[1]), len(self.design.within[at])
            mean, level = self.subject_variance + inside, (k - 1) * inside
            df = (mean + level) ** 2 / (mean**2 / df + level**2 / df2[str(at)])
        sd = np.nan if between else np.sqrt(2.0 * self.residual_variance)
        both = np.sqrt(self.subject_variance + self.residual_variance)
        table = compared(pairs, difference, se, df, sd).assign(d_av=difference / both)
        return labelled(table, self.origin)

    def apa(self) -> str:
        """Return the sentence for a paper, with the test of every effect."""
        effects = "; ".join(map(effect_text, self.tests.to_dict("records")))
        return (
            f"{mark(self.origin)}A mixed model of {self.dv} with a random intercept per subject "
            f"(N = {self.n}, {counted(self.missing_cells, 'cell')} missing): {effects}."
            f"{' The variance between subjects is estimated as zero.' * self.singular}"
            f"{left_out(self.excluded)}"
        )


def mixed_model(
    frame: pd.DataFrame,
    dv: Hashable,
    within: Columns,
    subject: Hashable,
    *,
    between: Columns = None,
    order: Any = None,
) -> MixedModel:
    """
    Test one score in cells of factors with a random intercept per subject; cells may be missing.

    All scores of a subject correlate alike (compound symmetry); `repeated_measures` does not assume
    this, but needs every cell.

    Parameters
    ----------
    frame : pandas.DataFrame
        One row per subject and cell; a missing cell is an absent row or a missing score.
    dv, subject : hashable
        Columns with the score and the subject.
    within, between : hashable or list of hashable
        Columns of the factors within and between subjects; all interactions are tested.
    order : sequence or dict, optional
        The order of a single factor's levels, or of several factors' by name.

    Returns
    -------
    MixedModel

    Raises
    ------
    ValueError
        If the table is refused, fewer than three subjects have a score, a cell has none, a subject
        has two groups, or nothing is left to estimate an error from.

    See Also
    --------
    formula_model : Several trials in a cell, and covariates.

    Examples
    --------
    >>> import trustlab as tl
    >>> frame = tl.reconstruct(tl.published_studies()["uav.tlx"], seed=0)
    >>> fit = tl.mixed_model(frame, dv="value", within="condition", subject="subject")
    >>> fit.table()[["F", "df1", "df2", "icc"]].round(2)
          F  df1  df2   icc
    0  5.89    4  140  0.78
    """
    table, levels, groups = read_factors(frame, dv, within, subject, between, order)
    factors = groups | levels
    scores = read_cells(table, factors, dv, subject)
    answered = scores.notna().any(axis=1)
    excluded, scores = tuple(scores.index[~answered]), scores[answered]
    there = scores.notna().to_numpy()
    for cell in scores.columns[~there.any(axis=0)]:
        raise ValueError(f"within: no subject has a score in cell {cell!r} of {[*factors]}")
    person, cells = np.nonzero(there)
    x = np.eye(scores.shape[1])[cells]
    fit = intercept_fit(scores.to_numpy()[there], x, person, restricted=True)
    covariance = fit.residual * fit.inverse
    design = Design(len(scores), levels, groups)
    between_df = design.n - design.combinations
    # Of conditions that share no subject the difference is one between subjects.
    about = x - pd.DataFrame(x).groupby(person).transform("mean").to_numpy()
    within_df = cells.size - len(scores) - np.linalg.matrix_rank(about)
    rows = []
    for names in subsets(factors)[1:]:
        tested = contrasts(factors, names)
        effect = tested.T @ fit.beta
        chi2 = float(effect @ np.linalg.solve(tested.T @ covariance @ tested, effect))
        df1, df2, d = effect.size, within_df, scores.shape[1] // design.combinations - 1
        if {*names} <= {*groups}:
            df2, d = between_df, 1
        f = chi2 / df1
        # λ = n d η²/(1 − η²) in the population, as in `repeated_measures`.
        strengths = np.array(partial_eta_interval(f, df1, df2)[2:])
        low, high = strengths / (strengths + df2 + design.combinations * d)
        rows.append(
            {
                "effect": effect_name(names),
                "F": f,
                "df1": df1,
                "df2": df2,
                "p": special.fdtrc(df1, df2, f),
                "chi2": chi2,
                "p_chi2": special.chdtrc(df1, chi2),
                "eta2_partial": chi2 / (chi2 + df2),
                "eta2_partial_low": low,
                "eta2_partial_high": high,
            }
        )
    tests = pd.DataFrame(rows).assign(
        subject_variance=fit.ratio * fit.residual,
        residual_variance=fit.residual,
        icc=fit.ratio / (1.0 + fit.ratio),
        singular=fit.ratio == 0.0,
        n=design.n,
        cells=cells.size,
        missing_cells=design.n * scores.shape[1] // design.combinations - cells.size,
    )
    means = estimates_of(fit.beta, np.sqrt(np.diag(covariance)), tests["df2"].min())
    means = means.rename(columns={"estimate": "mean"})[["mean", "se", "ci_low", "ci_high"]]
    means.index = pd.Index(map(effect_name, product(*factors.values())), name="cell")
    origin = origin_of(frame)
    tables = labelled(tests, origin), labelled(means, origin)
    return MixedModel(dv, design, *tables, covariance, excluded)


# Models by formula.


@dataclass(frozen=True, eq=False, repr=False)
class FormulaModel(Tested):
    """
    A mixed model: fixed effects by a formula, and a random intercept of every group.

    Parameters
    ----------
    title : str
        What was fitted: the formula and the column with the groups.
    n, observations : int
        Groups and rows.
    tests : pandas.DataFrame
        What `table` returns: the likelihood-ratio test of every term against the model without the
        term and the interactions that contain it; columns term, chi2, df, p_chi2 (asymptotic: too
        small with few groups).
    coefficients : pandas.DataFrame
        What `coefficients_table` returns.
    variances : pandas.Series
        Of the intercepts and the residual.
    log_likelihood : float
        Maximum of the likelihood (not restricted), with all its constants.
    singular : bool
        Whether the groups' variance is estimated as zero.
    """

    title: str
    n: int
    observations: int
    tests: pd.DataFrame
    coefficients: pd.DataFrame
    variances: pd.Series
    log_likelihood: float
    singular: bool

    def coefficients_table(self) -> pd.DataFrame:
        """Return the fixed effects: name estimate se z p ci_low ci_high (95 %, normal)."""
        return self.coefficients.copy()

    def random_effects(self) -> pd.DataFrame:
        """Return variances, such as that of the intercepts, with standard deviations."""
        table = self.variances.rename_axis("name").reset_index(name="variance")
        return table.assign(sd=np.sqrt(table["variance"]))

    def apa(self) -> str:
        """Return the sentence for a paper: the test of every term."""
        tests = [
            f"{row.term}, χ²({row.df}) = {apa_number(row.chi2)}, {apa_p(row.p_chi2)}"
            for row in self.tests.itertuples()
        ]
        found = "was tested by likelihood ratios: " if tests else "has no effects to test"
        return (
            f"{mark(self.origin)}{self.title} ({self.n} people, {self.observations} observations) "
            f"{found}{'; '.join(tests)}."
        )


def formula_model(formula: str, data: pd.DataFrame, groups: Hashable) -> FormulaModel:
    """
    Fit a mixed model by formula, with a random intercept per group: trials and covariates.

    Parameters
    ----------
    formula : str
        Score and fixed effects, such as "error ~ autonomy * trial".
    data : pandas.DataFrame
        One row per trial; rows with missing values or labels are refused.
    groups : hashable
        The column whose groups (subjects) have random intercepts.

    Returns
    -------
    FormulaModel

    Raises
    ------
    ValueError
        If the formula does not fit the table, its effects are not estimable, or a value is missing.

    Examples
    --------
    >>> import trustlab as tl
    >>> frame = tl.reconstruct(tl.published_studies()["uav.tlx"], seed=0)
    >>> model = tl.formula_model("value ~ condition", frame, groups="subject")
    >>> model.table()[["term", "df"]]
            term  df
    0  condition   4
    """
    of_class("data", data, pd.DataFrame, "a table of pandas with a row per trial")
    score, *terms = of_class("formula", formula, str).split("~")
    if len(terms) != 1 or not score.strip():
        raise ValueError(f"formula must be “score ~ terms”, got {formula!r}")
    people, names = pd.factorize(label_column(data, "groups", groups))
    y, regressors, columns = matrices_of(formula, data)
    x = regressors.to_numpy()
    log_likelihood = cache(lambda kept: -0.5 * intercept_fit(y, x[:, kept], people).deviance)
    every = tuple(range(x.shape[1]))
    tests = likelihood_ratios(columns, every, log_likelihood)
    fit = intercept_fit(y, x, people, restricted=True)
    coefficients = estimates_of(fit.beta, np.sqrt(fit.residual * np.diag(fit.inverse)))
    coefficients.insert(0, "name", regressors.columns.str.replace(".0]", "]"))
    variances = {"Intercept": fit.ratio * fit.residual, "residual": fit.residual}
    return FormulaModel(
        title=f"A mixed model, {formula}, with random intercepts by {groups}",
        n=len(names),
        observations=y.size,
        tests=labelled(tests, origin_of(data)),
        coefficients=labelled(coefficients, origin_of(data)),
        variances=pd.Series(variances),
        log_likelihood=log_likelihood(every),
        singular=fit.ratio == 0.0,
    )


def matrices_of(formula: str, frame: pd.DataFrame) -> tuple[np.ndarray, pd.DataFrame, dict]:
    """Return score, regressors, and the numbers of every term's columns."""
    from formulaic import model_matrix
    from formulaic.errors import FormulaicError

    rows, frame = frame.index, frame.reset_index(drop=True).infer_objects()
    # Products of integers overflow.
    numbers = frame.select_dtypes("number", exclude="timedelta")
    frame = frame.astype(dict.fromkeys(numbers, float))
    for name in frame:
        column = column_of(frame, "data", name)
        # Formulaic knows only some kinds of text, and counts categories without rows as levels.
        if isinstance(column.dtype, pd.CategoricalDtype | pd.StringDtype):
            frame[name] = column.astype("category").cat.remove_unused_categories()
    try:
        # A missing label would be zeros, as if it were the reference level.
        matrices = model_matrix(formula, frame, na_action="drop")
    except (FormulaicError, LookupError, TypeError, ValueError) as error:
        said = re.sub(r"\x1b\[[\d;]*m", "", str(error))  # colours of a terminal
        raise ValueError(f"formula {formula!r}: {said} (columns are {[*frame]})") from None
    score, x = (pd.DataFrame(part, dtype=float) for part in (matrices.lhs, matrices.rhs))
    if score.shape[1] != 1:
        raise ValueError(f"formula {formula!r}: the score must be one column of numbers")
    whole = np.isfinite(pd.concat([score, x], axis=1)).all(axis=1)
    whole = whole.reindex(frame.index, fill_value=False)
    if not whole.all():
        raise ValueError(
            f"data: {(~whole).sum()} rows have a missing or infinite value, row "
            f"{rows[whole.argmin()]} first; leave them out"
        )
    terms = matrices.rhs.model_spec.term_indices
    terms = {str(term): columns for term, columns in terms.items() if str(term) != "1"}
    if np.linalg.matrix_rank(x) < x.shape[1] or not all(terms.values()):
        raise ValueError(
            f"formula {formula!r}: an effect is not estimable, as it depends on others or has one "
            "level"
        )
    return score.to_numpy()[:, 0], x, terms


def likelihood_ratios(
    terms: dict[str, list[int]],
    every: tuple[int, ...],
    log_likelihood: Callable[[tuple[int, ...]], float],
) -> pd.DataFrame:
    """
    Return the test of every term against the model without it and the interactions that contain it,
    by the greatest log-likelihood of models with some of all columns.
    """
    rows = []
    for name, own in terms.items():
        above = [terms[term] for term in terms if {*name.split(":")} < {*term.split(":")}]
        full = tuple(column for column in every if column not in chain(*above))
        reduced = tuple(column for column in full if column not in own)
        chi2 = max(2.0 * (log_likelihood(full) - log_likelihood(reduced)), 0.0)
        rows.append((name, chi2, len(own), float(special.chdtrc(len(own), chi2))))
    return pd.DataFrame(rows, columns=["term", "chi2", "df", "p_chi2"])
