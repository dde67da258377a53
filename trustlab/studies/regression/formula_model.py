"""Mixed models by formula, tested by likelihood ratios."""

from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.random import SeedSequence
from scipy import special

from trustlab.models.checks import of_class, one_of, spawned, whole_number
from trustlab.models.display import as_html
from trustlab.studies.regression.cumulative_model import (
    Cumulative,
    Logistic,
    checked_counts,
)
from trustlab.studies.regression.linear_model import Linear
from trustlab.studies.table import column_of, labelled, origin_of, refuse_missing_labels

# Logits beyond which no data tell a probability from 0 or 1.
FAR = 15.0

# Simulated statistics this close to the observed one are equal but for rounding.
_TIE = 1e-7


@dataclass(frozen=True, eq=False)
class FormulaModel:
    """
    A mixed model, fixed effects by a formula, random effects of groups.

    Parameters
    ----------
    formula, random : str
        Fixed effects with the score, and random effects, as given.
    groups : hashable
        Column with the groups (subjects).
    family : {"normal", "binomial"}
        Whether scores are normal, or counts of successes with a logistic model.
    n, observations : int
        Groups and rows.
    coefficients, tests, variances : pandas.DataFrame
        What `coefficients_table`, `table` and `random_effects` return.
    log_likelihood : float
        Maximum of the likelihood (not restricted), with all its constants. With several nodes,
        glmer of lme4 gives that of counts relative to the saturated model.
    singular : bool
        Whether a random variance is estimated as zero, or a correlation as ±1.
    draws : int
        Simulated data sets of the parametric bootstrap; 0 without it.
    origin : str
        What kind of data these are where they were not measured; else empty.
    """

    formula: str
    random: str
    groups: Hashable
    family: str
    n: int
    observations: int
    coefficients: pd.DataFrame
    tests: pd.DataFrame
    variances: pd.DataFrame
    log_likelihood: float
    singular: bool
    draws: int
    origin: str

    def table(self) -> pd.DataFrame:
        """
        Return the likelihood-ratio test of every term against the model without the term and the
        interactions that contain it.

        Returns
        -------
        pandas.DataFrame
            Columns term, chi2, df, p_chi2 (asymptotic: too small with few groups), p_bootstrap
            (share of data sets simulated from the model without the term whose χ² is as large,
            (count + 1)/(draws + 1); NaN without a bootstrap).
        """
        return self.tests.copy()

    def coefficients_table(self) -> pd.DataFrame:
        """
        Return the fixed effects, by restricted likelihood or in logits: name estimate se z p ci_low
        ci_high (95 %, normal).
        """
        return self.coefficients.copy()

    def random_effects(self) -> pd.DataFrame:
        """
        Return variances and correlations of the random effects and the residual variance: name,
        variance, sd, then correlations.
        """
        return self.variances.copy()

    def _repr_html_(self) -> str:
        tests = "likelihood ratios, asymptotic"
        if self.draws:
            tests += f" and by {self.draws} simulated data sets"
        text = f"{self.origin} {self.observations} rows of {self.n} groups; {tests}".strip()
        title = f"{self.formula}, random {self.random}, {self.family}"
        return as_html(text, self.tests, self.coefficients, self.variances, title=title)


def formula_model(
    formula: str,
    data: pd.DataFrame,
    groups: Hashable,
    *,
    random: str = "1",
    bootstrap: int = 0,
    seed: int = 0,
    family: str = "normal",
    trials: str | None = None,
    points: int = 15,
) -> FormulaModel:
    """
    Fit a mixed model by formula: trials, covariates, random slopes, or counts of successes.

    Parameters
    ----------
    formula : str
        Score and fixed effects, such as "error ~ autonomy * trial".
    data : pandas.DataFrame
        One row per trial; rows with missing values are refused.
    groups : hashable
        The column whose groups (subjects) have random effects.
    random : str
        The random effects of a group, "1" for intercepts, "1 + trial" for intercepts and correlated
        slopes.
    bootstrap : int
        Data sets simulated to test each term. No maintained Python library has Satterthwaite's or
        Kenward and Roger's degrees of freedom; the likelihood ratio's own p is asymptotic and too
        small with few groups.
    seed : int
        Of the bootstrap.
    family : {"normal", "binomial"}
        "binomial" is a logistic model with random intercepts of successes (0 and 1, or counts), by
        maximum likelihood.
    trials : str, optional
        Of a binomial family: the column with how many trials a row has; 1 each when left out.
    points : int
        Of a binomial family: nodes of the adaptive Gauss–Hermite quadrature; 1 is Laplace's
        approximation, the default of lme4.

    Returns
    -------
    FormulaModel

    Raises
    ------
    ValueError
        If the formula does not fit the table, its effects are not estimable, a value is missing or
        no maximum of the likelihood is found.

    Examples
    --------
    >>> import trustlab as tl
    >>> frame = tl.reconstruct(tl.published_studies()["uav.tlx"], seed=0)
    >>> model = tl.formula_model("value ~ condition", frame, groups="subject")
    >>> model.table()[["term", "df"]]
            term  df
    0  condition   4
    """
    of_class("formula", formula, str)
    of_class("random", random, str, 'such as "1" (intercepts) or "1 + trial" (and slopes)')
    frame = of_class("data", data, pd.DataFrame, "with a row per trial").reset_index(drop=True)
    if formula.count("~") != 1:
        raise ValueError(f"formula must be “score ~ terms”, got {formula!r}")
    bootstrap = whole_number("bootstrap", bootstrap, least=0, most=100_000)
    points = whole_number("points", points, most=100)
    if one_of("family", family, ("normal", "binomial")) == "normal" and trials is not None:
        raise ValueError('trials are of counts: give family="binomial"')
    refuse_missing_labels(column_of(frame, "groups", groups), "groups")
    codes, labels = pd.factorize(frame[groups])
    if len(labels) < 3:
        raise ValueError(
            f"groups: column {groups!r} has {len(labels)} groups; at least three are needed"
        )
    y, x, z, terms = matrices_of(formula, random, frame)
    if family == "binomial":
        if list(z.columns) != ["Intercept"]:
            raise ValueError(
                f'family="binomial" has random intercepts only: random="1", got {random!r}; '
                "ordinal_model takes answers of two categories with slopes, too"
            )
        logistic = Logistic(codes, checked_counts(y, frame, trials), points)
        model: Model = logistic
        estimates = _logistic_estimates(logistic, y, x, labels)
    else:
        centre, scale = y.mean() if "Intercept" in x.columns else 0.0, y.std()
        y = (y - centre) / scale  # the search does not depend on the unit
        model = linear = Linear(codes, z)
        estimates = _normal_estimates(linear, y, x, centre, scale)
    seeds = spawned(seed, len(terms))
    tests = [
        term_test(name, terms, y, x, model, bootstrap, child)
        for name, child in zip(terms, seeds, strict=True)
    ]
    origin = origin_of(data)
    labelled(estimates["coefficients"], origin)
    table = pd.DataFrame(tests, columns=["term", "chi2", "df", "p_chi2", "p_bootstrap"])
    return FormulaModel(
        formula=formula,
        random=random,
        groups=groups,
        family=family,
        n=len(labels),
        observations=len(y),
        tests=labelled(table, origin),
        draws=bootstrap,
        origin=origin,
        **estimates,
    )


def _normal_estimates(
    model: Linear, y: np.ndarray, x: pd.DataFrame, centre: float, scale: float
) -> dict:
    """
    Return the estimates of a linear model in the unit of the score: fixed effects and variances by
    restricted likelihood.
    """
    full, restricted = model.fit(y, x.to_numpy()), model.fit(y, x.to_numpy(), reml=True)
    offset = centre * np.array([name == "Intercept" for name in x.columns])
    return {
        "coefficients": coefficients_of(
            list(x.columns), scale * restricted.beta + offset, scale * restricted.se
        ),
        "variances": variances_of(
            list(model.z.columns), scale**2 * restricted.covariance, scale**2 * restricted.residual
        ),
        "log_likelihood": float(full.llf - len(y) * np.log(scale)),
        "singular": restricted.singular,
    }


def _logistic_estimates(
    model: Logistic, y: np.ndarray, x: pd.DataFrame, labels: Sequence[Hashable]
) -> dict:
    """Return the estimates of a logistic model, in logits."""
    fit = model.fit(y, x.to_numpy(), covariance=True)
    if np.abs(x.to_numpy() @ fit.beta).max() > FAR or fit.sd > FAR:
        never, always = ([labels[i] for i in group] for group in model.constant_groups(y))
        people = (
            f"groups {never} never succeed and {always} always do, or " if never or always else ""
        )
        raise ValueError(
            f"the likelihood has no maximum: {people}some effect separates successes from "
            "failures; leave them or it out"
        )
    return {
        "coefficients": coefficients_of(
            list(x.columns), fit.beta, np.sqrt(np.diag(fit.covariance))
        ),
        "variances": variances_of(["Intercept"], np.array([[fit.sd**2]])),
        "log_likelihood": fit.llf + model.log_coefficients(y),
        "singular": fit.sd < 1e-3,
    }


def coefficients_of(names: list[str], estimate: np.ndarray, se: np.ndarray) -> pd.DataFrame:
    """Return the fixed effects with z tests and intervals."""
    p, half = 2.0 * special.ndtr(-np.abs(estimate / se)), special.ndtri(0.975) * se
    columns = {"name": names, "estimate": estimate, "se": se, "z": estimate / se, "p": p}
    return pd.DataFrame(columns | {"ci_low": estimate - half, "ci_high": estimate + half})


def matrices_of(formula: str, random: str, frame: pd.DataFrame) -> tuple:
    """
    Return score, regressors of fixed and of random effects, and the columns of every term; rows
    with missing values are refused.
    """
    from formulaic import model_matrix
    from formulaic.errors import FormulaicError

    try:
        matrices = model_matrix(formula, frame, na_action="ignore")
        z = model_matrix(random, frame, na_action="ignore")
    except (FormulaicError, NameError, KeyError, SyntaxError, ValueError) as error:
        there = ", ".join(map(str, frame))
        raise ValueError(
            f"formula {formula!r}, random {random!r}: {error} (columns are {there})"
        ) from None
    y, x = matrices.lhs, matrices.rhs
    if y.shape[1] != 1:
        raise ValueError(f"formula {formula!r}: the score must be one column of numbers")
    together = np.column_stack([np.asarray(part, dtype=float) for part in (y, x, z)])
    bad = ~np.isfinite(together).all(axis=1)
    if bad.any():
        row = int(np.argmax(bad))
        raise ValueError(
            f"data: {bad.sum()} rows have a missing or infinite value, row {row} first; leave "
            "them out"
        )
    terms = {
        str(term): list(columns)
        for term, columns in x.model_spec.term_indices.items()
        if str(term) != "1"
    }
    score = together[:, 0]
    if np.linalg.matrix_rank(together[:, 1 : x.shape[1] + 1]) < x.shape[1]:
        raise ValueError(
            f"formula {formula!r}: its columns are linearly dependent; an effect is not estimable"
        )
    if not np.ptp(score):
        raise ValueError(f"formula {formula!r}: every score is {score[0]:g}")
    numbers = [
        pd.DataFrame(np.asarray(part, dtype=float), columns=list(part.columns)) for part in (x, z)
    ]
    return score, *numbers, terms


Model = Linear | Logistic | Cumulative


def term_test(
    name: str,
    terms: dict,
    y: np.ndarray,
    x: pd.DataFrame,
    model: Model,
    draws: int,
    seed: SeedSequence,
) -> tuple:
    """
    Return the likelihood-ratio test of a term, asymptotic and by simulation from the model without
    it.
    """
    factors = set(name.split(":"))
    above = [
        column
        for term, columns in terms.items()
        if factors < set(term.split(":"))
        for column in columns
    ]
    full = x.drop(columns=x.columns[above]).to_numpy()
    reduced = x.drop(columns=x.columns[[*above, *terms[name]]]).to_numpy()

    def statistic(score: np.ndarray, null) -> float:
        return max(2.0 * (model.fit(score, full).llf - null.llf), 0.0)

    null: Any = model.fit(y, reduced)
    chi2, df = statistic(y, null), full.shape[1] - reduced.shape[1]
    p_bootstrap = np.nan
    if draws:
        rng = np.random.default_rng(seed)
        scores = (model.draw(null, reduced, rng) for _ in range(draws))
        least = chi2 * (1.0 - _TIE)
        larger = sum(statistic(score, model.fit(score, reduced)) >= least for score in scores)
        p_bootstrap = (larger + 1.0) / (draws + 1.0)
    return name, chi2, df, float(special.chdtrc(df, chi2)), p_bootstrap


def variances_of(
    names: list[str], covariance: np.ndarray, residual: float | None = None
) -> pd.DataFrame:
    """Return the random effects in a table, and the residual variance of a model that has one."""
    sd = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    with np.errstate(divide="ignore", invalid="ignore"):
        correlation = covariance / np.outer(sd, sd)
    table = pd.DataFrame(
        {"name": [*names, "residual"], "variance": [*np.diag(covariance), residual]}
    )
    table["sd"] = np.sqrt(table["variance"].clip(lower=0.0))
    for j, name in enumerate(names):
        table[f"correlation with {name}"] = [*correlation[:, j], np.nan]
    return table if residual is not None else table.iloc[:-1].astype({"variance": float})
