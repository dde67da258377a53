"""A mixed model with a random intercept per subject; cells may be missing."""

from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pandas as pd
from scipy import special
from scipy.optimize import minimize_scalar

from trustlab.models.display import as_html
from trustlab.studies.anova import orthonormal_contrasts
from trustlab.studies.table import ScoreTable, read_scores


@dataclass(frozen=True, eq=False)
class MixedModel:
    """
    Score = mean of the condition + random intercept of the subject + error, by restricted maximum
    likelihood.

    Parameters
    ----------
    F : float
        Wald test of equal means, χ²/df1.
    df1, df2 : int
        k − 1, and cells − subjects − (k − 1): the ANOVA's own where no cell is missing.
    p : float
        From F.
    chi2, p_chi2 : float
        The Wald statistic and its asymptotic p.
    subject_variance, residual_variance : float
        Variance components.
    icc : float
        subject_variance over the sum of both.
    singular : bool
        Whether the subjects' variance is estimated as zero; F is then not the ANOVA's, even without
        missing cells.
    n, cells, missing_cells : int
        Subjects with a score, cells with a score and cells without.
    means : pandas.DataFrame
        Index condition; columns mean, se, ci_low, ci_high (95 %, t with df2).
    origin : str
        What kind of data these are where they were not measured; else empty.
    """

    F: float
    df1: int
    df2: int
    p: float
    chi2: float
    p_chi2: float
    subject_variance: float
    residual_variance: float
    icc: float
    singular: bool
    n: int
    cells: int
    missing_cells: int
    means: pd.DataFrame
    origin: str = ""

    def table(self) -> pd.DataFrame:
        """Return one row with every number but the means."""
        row = {k: v for k, v in vars(self).items() if k not in ("means", "origin")}
        return pd.DataFrame([row])

    def _repr_html_(self) -> str:
        return as_html(
            self.origin, self.table(), self.means, title="Mixed model, random intercept per subject"
        )


def mixed_model(
    frame: pd.DataFrame,
    dv: Hashable,
    within: Hashable,
    subject: Hashable,
    *,
    order: Sequence | None = None,
) -> MixedModel:
    """
    Fit a random intercept per subject to a long table; cells may be missing.

    Parameters
    ----------
    frame : pandas.DataFrame
        One row per subject and condition; a missing cell is an absent row or a missing score.
    dv, within, subject : hashable
        Columns with the score, the condition and the subject.
    order : sequence, optional
        The order of the conditions.

    Returns
    -------
    MixedModel

    Raises
    ------
    ValueError
        If the table is refused (see `trustlab.studies.table.read_scores`), fewer
        than three subjects have a score, a condition has fewer than two, or nothing is left to
        estimate the error from.

    See Also
    --------
    formula_model : Trials, covariates, random slopes and counts of successes.

    Examples
    --------
    >>> import trustlab as tl
    >>> frame = tl.reconstruct(tl.published_studies()["uav.tlx"], seed=0)
    >>> fit = tl.mixed_model(frame, dv="value", within="condition", subject="subject")
    >>> fit.table()[["F", "df1", "df2", "icc"]].round(2)
          F  df1  df2   icc
    0  5.89    4  140  0.78
    """
    return fit_mixed_model(read_scores(frame, dv, within, subject, order=order))


def fit_mixed_model(table: ScoreTable) -> MixedModel:
    """
    Fit a random intercept per subject to scores arranged as subjects × conditions, NaN for a
    missing cell.
    """
    there = ~np.isnan(table.values)
    person, condition = np.nonzero(there)
    raw = table.values[there]
    k, n = len(table.conditions), int(there.any(axis=1).sum())
    df2 = raw.size - n - (k - 1)
    _check_counts(table, there, n, df2)
    # Scores are centred and scaled, so that neither their unit nor a common offset costs digits.
    centre = raw.mean()
    scale = np.abs(raw - centre).max()
    score = (raw - centre) / scale if scale > 0.0 else raw
    design = (condition[:, None] == np.arange(k)).astype(float)
    _check_error(table, score, design, person, np.abs(raw).max() / max(scale, 1e-300))
    ratio = _ratio_of_variances(score, design, person)
    fit = _generalized_least_squares(score, design, person, ratio)
    covariance = fit.residual_variance * fit.inverse
    contrasts = orthonormal_contrasts(k)
    effect = contrasts.T @ fit.means
    chi2 = float(effect @ np.linalg.solve(contrasts.T @ covariance @ contrasts, effect))
    f = chi2 / (k - 1)
    standard_error = scale * np.sqrt(np.diag(covariance))
    mean = centre + scale * fit.means
    half = special.stdtrit(df2, 0.975) * standard_error
    means = pd.DataFrame(
        {"mean": mean, "se": standard_error, "ci_low": mean - half, "ci_high": mean + half},
        index=pd.Index(table.conditions, name="condition", tupleize_cols=False),
    )
    return MixedModel(
        F=f,
        df1=k - 1,
        df2=df2,
        p=float(special.fdtrc(k - 1, df2, f)),
        chi2=chi2,
        p_chi2=float(special.chdtrc(k - 1, chi2)),
        subject_variance=float(ratio * fit.residual_variance * scale**2),
        residual_variance=float(fit.residual_variance * scale**2),
        icc=float(ratio / (1.0 + ratio)),
        singular=ratio == 0.0,
        n=n,
        cells=raw.size,
        missing_cells=n * k - raw.size,
        means=means,
        origin=table.origin,
    )


def _check_counts(table: ScoreTable, there: np.ndarray, n: int, df2: int) -> None:
    """Refuse a table with too few scores to estimate means, both variances and the error."""
    if n < 3:
        raise ValueError(
            f"subject: {n} subject(s) in column {table.subject!r} have a score; at least three are "
            "needed"
        )
    counts = there.sum(axis=0)
    if counts.min() < 2:
        least = table.conditions[int(np.argmin(counts))]
        raise ValueError(
            f"within: condition {least!r} has {counts.min()} score(s); at least two are needed"
        )
    if df2 < 1:
        raise ValueError(
            f"dv: {there.sum()} scores of {n} subjects under {len(table.conditions)} conditions "
            "leave nothing to estimate the error from; more subjects must have scores under "
            "several conditions"
        )


def _sums_by_subject(columns: np.ndarray, person: np.ndarray) -> np.ndarray:
    """Return, in every row, the sums of the columns over that row's subject."""
    return np.column_stack([np.bincount(person, column)[person] for column in columns.T])


def _check_error(
    table: ScoreTable, score: np.ndarray, design: np.ndarray, person: np.ndarray, size: float
) -> None:
    """Refuse scores that are exactly the sum of a subject's level and a condition's."""
    columns = np.column_stack([score, design])
    within = columns - _sums_by_subject(columns, person) / np.bincount(person)[person, None]
    fitted = within[:, 1:] @ np.linalg.lstsq(within[:, 1:], within[:, 0], rcond=None)[0]
    if np.abs(within[:, 0] - fitted).max() <= 32.0 * np.finfo(float).eps * max(size, 1.0):
        raise ValueError(
            f"dv: column {table.dv!r} has no error variance: every score is its subject's level "
            "plus its condition's"
        )


class _Fit(NamedTuple):
    """Generalized least squares at one ratio of variances; `inverse` is (X'V⁻¹X)⁻¹."""

    deviance: float
    means: np.ndarray
    inverse: np.ndarray
    residual_variance: float


def _generalized_least_squares(
    score: np.ndarray, design: np.ndarray, person: np.ndarray, ratio: float
) -> _Fit:
    """
    Estimate the means for V = I + ratio · 11' within a subject; the deviance is that of the
    restricted likelihood.
    """
    counts = np.bincount(person)
    # V⁻¹ = I − ratio/(1 + counts · ratio) · 11' within a subject (Sherman–Morrison): no matrix of
    # all scores is formed.
    weight = (ratio / (1.0 + counts * ratio))[person, None]
    columns = np.column_stack([score, design])
    products = columns.T @ (columns - weight * _sums_by_subject(columns, person))
    inverse = np.linalg.inv(products[1:, 1:])
    means = inverse @ products[1:, 0]
    error = (score - design @ means)[:, None]
    quadratic = float((error * (error - weight * _sums_by_subject(error, person))).sum())
    free = score.size - design.shape[1]
    deviance = (
        free * np.log(quadratic) + np.log1p(counts * ratio).sum() - np.linalg.slogdet(inverse)[1]
    )
    return _Fit(float(deviance), means, inverse, quadratic / free)


def _ratio_of_variances(score: np.ndarray, design: np.ndarray, person: np.ndarray) -> float:
    """
    Return the ratio of subjects' to residual variance with the least restricted deviance; 0 at the
    boundary.

    The whole range is searched: statsmodels' MixedLM, from its own start, can stop at a variance of
    zero and report success.
    """

    def deviance(log_ratio: float) -> float:
        return _generalized_least_squares(score, design, person, float(np.exp(log_ratio))).deviance

    grid = np.linspace(-16.0, 23.0, 40)
    best = int(np.argmin([deviance(x) for x in grid]))
    bounds = grid[max(best - 1, 0)], grid[min(best + 1, grid.size - 1)]
    optimum = minimize_scalar(deviance, bounds=bounds, method="bounded", options={"xatol": 1e-10})
    at_zero = _generalized_least_squares(score, design, person, 0.0).deviance
    return 0.0 if at_zero <= optimum.fun + 1e-9 else float(np.exp(optimum.x))
