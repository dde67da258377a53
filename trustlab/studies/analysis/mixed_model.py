"""A mixed model with a random intercept per subject: a second opinion on the ANOVA that also takes missing cells."""

from __future__ import annotations

import warnings
from collections.abc import Hashable, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy import special
from scipy.optimize import minimize_scalar

from trustlab.studies.analysis.score_table import ScoreTable, read_scores
from trustlab.studies.analysis.sphericity import orthonormal_contrasts

__all__ = ["MixedModel", "fit_mixed_model", "mixed_model"]


@dataclass(frozen=True, eq=False)
class MixedModel:
    """
    Score = mean of the condition + random intercept of the subject + error, by restricted maximum likelihood.

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
        Whether the subjects' variance is estimated as zero; F is then not the ANOVA's, even without missing cells.
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
        note = f" ({self.origin})" if self.origin else ""
        return (
            f"<p><b>Mixed model, random intercept per subject</b>{note}</p>"
            f"{self.table().to_html(index=False, float_format='%.6g')}{self.means.to_html(float_format='%.6g')}"
        )


def mixed_model(
    frame: pd.DataFrame, dv: Hashable, within: Hashable, subject: Hashable, *, order: Sequence | None = None
) -> MixedModel:
    """
    Fit a random intercept per subject to a long table, missing cells allowed.

    Parameters
    ----------
    frame : pandas.DataFrame
        One row per subject and condition; a missing cell is a row that is not there or has no score.
    dv, within, subject : hashable
        Columns with the score, the condition and the subject.
    order : sequence, optional
        Conditions in the order wanted.

    Returns
    -------
    MixedModel

    Raises
    ------
    ValueError
        If the table is refused (see `trustlab.studies.analysis.score_table.read_scores`), fewer than three subjects have a
        score, a condition has fewer than two, or nothing is left to estimate the error from.
    """
    return fit_mixed_model(read_scores(frame, dv, within, subject, order=order))


def fit_mixed_model(table: ScoreTable) -> MixedModel:
    """
    Fit a random intercept per subject to scores laid out as subjects × conditions.

    The ratio of the two variances is searched over its whole range first and statsmodels' MixedLM is started there: from
    its own start, its optimizers can stop at a variance of zero and report success. A variance whose estimate is zero is
    no fit for MixedLM; the model is then ordinary least squares.

    Parameters
    ----------
    table : ScoreTable
        Scores; NaN for a missing cell.

    Returns
    -------
    MixedModel

    Raises
    ------
    ValueError
        See `mixed_model`.
    """
    there = ~np.isnan(table.values)
    person, condition = np.nonzero(there)
    score = table.values[there]
    k, n = len(table.conditions), int(there.any(axis=1).sum())
    df2 = score.size - n - (k - 1)
    _check(table, there, n, df2)
    centre = score.mean()
    scale = np.abs(score - centre).max()
    if scale > 0.0:
        score = (score - centre) / scale
    design = (condition[:, None] == np.arange(k)).astype(float)
    _check_error(table, score, design, person, np.abs(table.values[there]).max() / max(scale, 1e-300))
    beta, covariance, ratio, residual = _fit(score, design, person)
    contrasts = orthonormal_contrasts(k)
    effect = contrasts.T @ beta
    chi2 = float(effect @ np.linalg.solve(contrasts.T @ covariance @ contrasts, effect))
    standard_error = scale * np.sqrt(np.diag(covariance))
    mean = centre + scale * beta
    half = special.stdtrit(df2, 0.975) * standard_error
    means = pd.DataFrame(
        {"mean": mean, "se": standard_error, "ci_low": mean - half, "ci_high": mean + half},
        index=pd.Index(table.conditions, name="condition", tupleize_cols=False),
    )
    f = chi2 / (k - 1)
    return MixedModel(
        F=f,
        df1=k - 1,
        df2=df2,
        p=float(special.fdtrc(k - 1, df2, f)),
        chi2=chi2,
        p_chi2=float(special.chdtrc(k - 1, chi2)),
        subject_variance=float(ratio * residual * scale**2),
        residual_variance=float(residual * scale**2),
        icc=float(ratio / (1.0 + ratio)),
        singular=ratio == 0.0,
        n=n,
        cells=int(there.sum()),
        missing_cells=int(n * k - there.sum()),
        means=means,
        origin=table.origin,
    )


def _check(table: ScoreTable, there: np.ndarray, n: int, df2: int) -> None:
    if n < 3:
        raise ValueError(
            f"subject: {n} subject(s) in column {table.subject!r} have a score; at least three are needed"
        )
    counts = there.sum(axis=0)
    if counts.min() < 2:
        j = int(np.argmin(counts))
        raise ValueError(
            f"within: condition {table.conditions[j]!r} has {counts[j]} score(s); at least two are needed in each"
        )
    if df2 < 1:
        raise ValueError(
            f"dv: {there.sum()} scores of {n} subjects under {len(table.conditions)} conditions leave nothing to estimate "
            "the error from; more subjects must have scores under several conditions"
        )


def _check_error(
    table: ScoreTable, score: np.ndarray, design: np.ndarray, person: np.ndarray, size: float
) -> None:
    """Refuse scores that are a subject's number plus a condition's number exactly."""
    counts = np.bincount(person)
    columns = np.column_stack([score, design])
    within = (
        columns - np.column_stack([np.bincount(person, c) for c in columns.T])[person] / counts[person, None]
    )
    fitted = within[:, 1:] @ np.linalg.lstsq(within[:, 1:], within[:, 0], rcond=None)[0]
    if np.abs(within[:, 0] - fitted).max() <= 32.0 * np.finfo(float).eps * max(size, 1.0):
        raise ValueError(
            f"dv: column {table.dv!r} has no error variance: every score is its subject's level plus its condition's"
        )


def _generalized_least_squares(
    score: np.ndarray, design: np.ndarray, person: np.ndarray, ratio: float
) -> tuple:
    """Return the restricted deviance, means and (X'V⁻¹X)⁻¹ for V = I + ratio · 11' within a subject."""
    counts = np.bincount(person, minlength=person.max() + 1)
    weight = (ratio / (1.0 + counts * ratio))[person, None]
    columns = np.column_stack([score, design])
    sums = np.column_stack([np.bincount(person, column, minlength=counts.size) for column in columns.T])[
        person
    ]
    products = columns.T @ (columns - weight * sums)
    inverse = np.linalg.inv(products[1:, 1:])
    beta = inverse @ products[1:, 0]
    error = score - design @ beta
    quadratic = error @ (error - weight[:, 0] * np.bincount(person, error, minlength=counts.size)[person])
    free = score.size - design.shape[1]
    deviance = free * np.log(quadratic) + np.log1p(counts * ratio).sum() - np.linalg.slogdet(inverse)[1]
    return float(deviance), beta, inverse


def _ratio_of_variances(score: np.ndarray, design: np.ndarray, person: np.ndarray) -> float:
    """Return the ratio of subjects' to residual variance with the least restricted deviance; 0 at the boundary."""

    def deviance(log_ratio: float) -> float:
        return _generalized_least_squares(score, design, person, float(np.exp(log_ratio)))[0]

    grid = np.linspace(-16.0, 23.0, 40)
    values = [deviance(x) for x in grid]
    best = int(np.argmin(values))
    bounds = grid[max(best - 1, 0)], grid[min(best + 1, grid.size - 1)]
    found = minimize_scalar(deviance, bounds=bounds, method="bounded", options={"xatol": 1e-10})
    at_zero = _generalized_least_squares(score, design, person, 0.0)[0]
    return 0.0 if at_zero <= found.fun + 1e-9 else float(np.exp(found.x))


def _fit(score: np.ndarray, design: np.ndarray, person: np.ndarray) -> tuple:
    """Return means, their covariance, the ratio of subjects' to residual variance, and the residual variance."""
    from statsmodels.regression.mixed_linear_model import MixedLM, MixedLMParams

    ratio = _ratio_of_variances(score, design, person)
    _, beta, inverse = _generalized_least_squares(score, design, person, ratio)
    if ratio == 0.0:
        residual = float(((score - design @ beta) ** 2).sum() / (score.size - design.shape[1]))
        return beta, residual * inverse, 0.0, residual
    start = MixedLMParams.from_components(fe_params=beta, cov_re=np.array([[ratio]]))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # it starts at the solution: that it can go no further is no news
        fit = MixedLM(score, design, groups=person).fit(start_params=start, reml=True, method=["bfgs"])
    ratio, residual = float(fit.cov_re[0, 0]) / fit.scale, float(fit.scale)
    # Not fit.cov_params(): it inverts the Hessian of all parameters, which with missing cells is not what nlme and lme4 do.
    return (
        fit.fe_params,
        residual * _generalized_least_squares(score, design, person, ratio)[2],
        ratio,
        residual,
    )
