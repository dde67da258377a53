"""Ratings on ordered categories: cumulative-link mixed models with effects as probabilities."""

from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise
from typing import NamedTuple

import numpy as np
import pandas as pd
from scipy import special

from trustlab.models.checks import finite_array, of_class, spawned, whole_number
from trustlab.models.display import as_html
from trustlab.studies.pairs import holm
from trustlab.studies.regression.cumulative_model import (
    MOST_NODES,
    Cumulative,
    CumulativeFit,
)
from trustlab.studies.regression.formula_model import (
    FAR,
    coefficients_of,
    matrices_of,
    term_test,
    variances_of,
)
from trustlab.studies.table import column_of, labelled, levels_of, origin_of, refuse_missing_labels

MOST_CATEGORIES = 30
# Nodes of the quadrature in each direction, by the number of random effects.
POINTS = {1: 15, 2: 9, 3: 5}


@dataclass(frozen=True, eq=False)
class OrdinalModel:
    """
    A cumulative-link (logit) mixed model of ratings.

    Parameters
    ----------
    dv, subject : hashable
        Columns of the ratings and of the people.
    categories : tuple
        Values of the ratings, ascending.
    random : str
        Random effects of a person.
    n, observations : int
        People and ratings.
    tests, coefficients, thresholds, variances : pandas.DataFrame
        What `table`, `coefficients_table`, `thresholds_table` and `random_effects` return.
    cells, differences, proportional : pandas.DataFrame
        What `probabilities`, `pairs` and `proportional_odds` return.
    log_likelihood : float
        Maximum of the likelihood.
    singular : bool
        Whether a random variance is estimated as zero, or a correlation as ±1.
    origin : str
        What kind of data these are where they were not measured; else empty.
    """

    dv: Hashable
    subject: Hashable
    categories: tuple
    random: str
    n: int
    observations: int
    tests: pd.DataFrame
    coefficients: pd.DataFrame
    thresholds: pd.DataFrame
    variances: pd.DataFrame
    cells: pd.DataFrame
    differences: pd.DataFrame
    proportional: pd.DataFrame
    log_likelihood: float
    singular: bool
    origin: str

    def table(self) -> pd.DataFrame:
        """
        Return the likelihood-ratio test of every term against the model without the term and the
        interactions that contain it: term, chi2, df, p_chi2, p_bootstrap.
        """
        return self.tests.copy()

    def coefficients_table(self) -> pd.DataFrame:
        """
        Return the fixed effects in logits: name estimate se z p ci_low ci_high (95 %, normal).

        A positive one raises ratings; exp(estimate) multiplies one person's odds of rating above
        any category.
        """
        return self.coefficients.copy()

    def thresholds_table(self) -> pd.DataFrame:
        """Return the thresholds between categories in logits: name estimate se ci_low ci_high."""
        return self.thresholds.copy()

    def random_effects(self) -> pd.DataFrame:
        """Return variances and correlations of the random effects: name, variance, sd, ..."""
        return self.variances.copy()

    def probabilities(self) -> pd.DataFrame:
        """
        Return how likely every rating is in every cell, averaged over people.

        Returns
        -------
        pandas.DataFrame
            Columns of the factors, category, probability, ci_low and ci_high (95 %, delta method on
            logits), at_least (probability of this rating or a higher one). Covariates are at their
            means.
        """
        return self.cells.copy()

    def pairs(self) -> pd.DataFrame:
        """
        Return differences between cells, for one person.

        Returns
        -------
        pandas.DataFrame
            Columns a, b, estimate (a − b in logits), se, z, p, ci_low, ci_high, p_holm, odds_ratio,
            superiority (probability that the median person rates a above b, ties half).
        """
        return self.differences.copy()

    def proportional_odds(self) -> pd.DataFrame:
        """
        Return the check of proportional odds, whether a term moves every threshold alike.

        Returns
        -------
        pandas.DataFrame
            Columns term, chi2, df, p (likelihood ratio against an effect of the term on each
            threshold; a small p says that one odds ratio does not describe it) and note. NaN where
            some category is empty in a cell.
        """
        return self.proportional.copy()

    def _repr_html_(self) -> str:
        text = f"{self.origin} {self.observations} ratings of {self.n} people".strip()
        title = f"Cumulative-link mixed model of {self.dv}, random {self.random}"
        tables = (self.tests, self.differences, self.cells, self.proportional)
        return as_html(text, *tables, title=title)


def ordinal_model(
    frame: pd.DataFrame,
    dv: Hashable,
    within: Hashable | Sequence[Hashable],
    subject: Hashable = "subject",
    *,
    covariates: Sequence[Hashable] = (),
    random: str = "1",
    order: Sequence | None = None,
    points: int | None = None,
    bootstrap: int = 0,
    seed: int = 0,
) -> OrdinalModel:
    """
    Fit ratings on ordered categories, such as trust from 1 to 7, without taking steps for equal.

    Parameters
    ----------
    frame : pandas.DataFrame
        A row per rating; a person may have any number of them in a cell.
    dv : hashable
        Column with the ratings: numbers, or an ordered categorical. Two categories make a logistic
        model.
    within : hashable or sequence of hashable
        Columns of the factors, with all their interactions; factors between people are allowed too.
    subject : hashable
        Column with the people.
    covariates : sequence of hashable
        Columns with numbers, such as the trial.
    random : str
        Random effects of a person: "1" for intercepts, "1 + autonomy" for intercepts and correlated
        slopes.
    order : sequence, optional
        The order of the levels of a single factor; the first is the reference.
    points : int, optional
        Nodes of the adaptive Gauss–Hermite quadrature for each random effect; 15, with slopes 9 or
        fewer. 1 is Laplace's approximation.
    bootstrap, seed : int
        As of `formula_model`.

    Returns
    -------
    OrdinalModel

    Raises
    ------
    ValueError
        If a column is missing, ratings have one category or more than 30, effects are not
        estimable, or no maximum of the likelihood is found.

    References
    ----------
    A. Agresti, Analysis of Ordinal Categorical Data, 2nd ed., 2010, Chapters 3 and 10.

    Examples
    --------
    >>> import numpy as np, pandas as pd, trustlab as tl
    >>> frame = pd.DataFrame({"subject": np.repeat(range(12), 4), "mode": ["A", "B"] * 24})
    >>> frame["trust"] = 1 + (np.arange(48) * 7 + 3 * (frame["mode"] == "B")) % 5
    >>> tl.ordinal_model(frame, dv="trust", within="mode").table()[["term", "df"]]
       term  df
    0  mode   1
    """
    of_class("frame", frame, pd.DataFrame, "with a row per rating")
    data = frame.reset_index(drop=True)
    factors = [within] if isinstance(within, str) or not isinstance(within, Sequence) else within
    refuse_missing_labels(column_of(data, "subject", subject), "subject")
    codes, people = pd.factorize(data[subject])
    if len(people) < 3:
        raise ValueError(f"subject: column {subject!r} has {len(people)} people; at least 3 needed")
    answers, categories = _categories(column_of(data, "dv", dv))
    formula = _formula(data, factors, covariates, order)
    data["answer"] = answers
    y, full, z, terms = matrices_of(formula, random, data)
    x = full.drop(columns="Intercept")  # thresholds take its place
    terms = {name: [column - 1 for column in columns] for name, columns in terms.items()}
    nodes = _nodes(points, z.shape[1])
    model = Cumulative(codes, z.to_numpy(), nodes, len(categories))
    fit = model.fit(y, x.to_numpy(), covariance=True)
    if max(np.abs(fit.beta).max(), np.abs(fit.thresholds).max(), np.abs(fit.factor).max()) > FAR:
        raise ValueError(
            "the likelihood has no maximum: some effect separates low from high ratings, or people "
            "hardly vary; leave the effect or the people out"
        )
    draws = whole_number("bootstrap", bootstrap, least=0, most=100_000)
    tests = [
        term_test(name, terms, y, x, model, draws, child)
        for name, child in zip(terms, spawned(seed, len(terms)), strict=True)
    ]
    cells = _cells(data[list(factors)], x, z, [i for name in covariates for i in terms[str(name)]])
    origin = origin_of(frame)
    table = pd.DataFrame(tests, columns=["term", "chi2", "df", "p_chi2", "p_bootstrap"])
    se = np.sqrt(np.diag(fit.covariance))
    size = fit.beta.size
    return OrdinalModel(
        dv=dv,
        subject=subject,
        categories=tuple(categories),
        random=random,
        n=len(people),
        observations=len(y),
        tests=labelled(table, origin),
        coefficients=labelled(coefficients_of(list(x.columns), fit.beta, se[:size]), origin),
        thresholds=labelled(_thresholds(fit.thresholds, se[size:], categories), origin),
        variances=variances_of(list(z.columns), fit.factor @ fit.factor.T),
        cells=labelled(_probabilities(fit, cells, categories), origin),
        differences=labelled(_pairs(fit, cells), origin),
        proportional=labelled(_proportional(model, fit, y, x.to_numpy(), terms), origin),
        log_likelihood=fit.llf,
        singular=fit.singular,
        origin=origin,
    )


def _categories(column: pd.Series) -> tuple[np.ndarray, list]:
    """Return the number of every answer's category, and the categories that occur, ascending."""
    refuse_missing_labels(column, "dv")
    ordered = isinstance(column.dtype, pd.CategoricalDtype) and column.cat.ordered
    if not ordered and not pd.api.types.is_numeric_dtype(column):
        raise ValueError(
            f"dv: column {column.name!r} is neither numbers nor an ordered categorical; "
            "pandas.Categorical(…, [lowest, …, highest], ordered=True) makes one"
        )
    values = column.cat.remove_unused_categories().cat.categories if ordered else column.unique()
    categories = list(values) if ordered else sorted(values)
    if not 2 <= len(categories) <= MOST_CATEGORIES:
        raise ValueError(
            f"dv: column {column.name!r} has {len(categories)} different ratings, not 2 to "
            f"{MOST_CATEGORIES}; formula_model takes ratings on a fine scale as numbers"
        )
    return column.map({label: float(k) for k, label in enumerate(categories)}).astype(
        float
    ).to_numpy(), categories


def _formula(
    data: pd.DataFrame, factors: Sequence, covariates: Sequence, order: Sequence | None
) -> str:
    """Return the formula of all interactions of factors, which are made categorical in place."""
    for name in factors:
        column = column_of(data, "within", name)
        listed = levels_of(column, "within", order if len(factors) == 1 else None)
        if len(listed) < 2:
            raise ValueError(
                f"within: column {name!r} has one level, {listed[0]!r}; two are needed"
            )
        data[name] = pd.Categorical(column, listed)
    for name in covariates:
        finite_array("covariates", column_of(data, "covariates", name))
    terms = " * ".join(f"`{name}`" for name in factors)
    return " + ".join([f"answer ~ {terms}", *(f"`{name}`" for name in covariates)])


def _nodes(points: int | None, effects: int) -> int:
    """Return the nodes of the quadrature for each random effect."""
    nodes = whole_number("points", points or POINTS.get(effects, 1), most=100)
    if nodes**effects > MOST_NODES:
        most = int(MOST_NODES ** (1.0 / effects))
        raise ValueError(
            f"points={nodes} for each of {effects} random effects are too many; points={most}"
        )
    return nodes


class Cells(NamedTuple):
    """Cells of the factors: their levels, and the regressors of fixed and random effects."""

    levels: pd.DataFrame
    x: np.ndarray
    z: np.ndarray


def _cells(labels: pd.DataFrame, x: pd.DataFrame, z: pd.DataFrame, covariates: list[int]) -> Cells:
    """Return the cells that occur, with covariates at their means."""
    number = labels.groupby(list(labels), observed=True, sort=True).ngroup().to_numpy()
    first = labels.assign(number=number).drop_duplicates("number").sort_values("number")
    rows = x.groupby(number).mean().to_numpy(copy=True)
    rows[:, covariates] = x.to_numpy()[:, covariates].mean(axis=0)
    levels = first.drop(columns="number").reset_index(drop=True)
    return Cells(levels, rows, z.groupby(number).mean().to_numpy())


def _thresholds(estimate: np.ndarray, se: np.ndarray, categories: list) -> pd.DataFrame:
    """Return the thresholds with their intervals."""
    names = [f"{low} | {high}" for low, high in pairwise(categories)]
    table = coefficients_of(names, estimate, se)
    return table[["name", "estimate", "se", "ci_low", "ci_high"]]


def _at_most(fit: CumulativeFit, cells: Cells, parameters: np.ndarray) -> np.ndarray:
    """Return P(y ≤ k) by cell, averaged over people, at coefficients and thresholds."""
    beta, thresholds = np.split(parameters, [fit.beta.size])
    nodes, weights = np.polynomial.hermite_e.hermegauss(60)
    sd = np.linalg.norm(cells.z @ fit.factor, axis=1)
    logit = thresholds[:, None] - (cells.x @ beta)[:, None, None] - sd[:, None, None] * nodes
    return special.expit(logit) @ (weights / weights.sum())


def _probabilities(fit: CumulativeFit, cells: Cells, categories: list) -> pd.DataFrame:
    """Return the probability of each category in each cell; random effects are as estimated."""
    point = np.concatenate([fit.beta, fit.thresholds])

    def logits(parameters: np.ndarray) -> np.ndarray:
        below = _at_most(fit, cells, parameters)
        return special.logit(np.diff(below, axis=1, prepend=0.0, append=1.0)).ravel()

    step = 1e-4 * np.eye(point.size)
    slope = np.array([(logits(point + row) - logits(point - row)) / 2e-4 for row in step])
    half = special.ndtri(0.975) * np.sqrt(((fit.covariance @ slope) * slope).sum(axis=0))
    centre = logits(point)
    count = len(categories)
    table = cells.levels.loc[cells.levels.index.repeat(count)].reset_index(drop=True)
    at_least = 1.0 - np.pad(_at_most(fit, cells, point), ((0, 0), (1, 0)))
    return table.assign(
        category=categories * len(cells.levels),
        probability=special.expit(centre),
        ci_low=special.expit(centre - half),
        ci_high=special.expit(centre + half),
        at_least=at_least.ravel(),
    )


def _pairs(fit: CumulativeFit, cells: Cells) -> pd.DataFrame:
    """Return the differences between cells."""
    names = [" × ".join(map(str, row)) for row in cells.levels.itertuples(index=False)]
    a, b = np.array(list(combinations(range(len(names)), 2))).T
    contrast = cells.x[a] - cells.x[b]
    variance = fit.covariance[: fit.beta.size, : fit.beta.size]
    se = np.sqrt(((contrast @ variance) * contrast).sum(axis=1))
    table = coefficients_of([names[i] for i in a], contrast @ fit.beta, se)
    table = table.rename(columns={"name": "a"})
    table.insert(1, "b", [names[i] for i in b])
    below = special.expit(fit.thresholds - (cells.x @ fit.beta)[:, None])
    chance = np.diff(below, axis=1, prepend=0.0, append=1.0)
    middle = np.cumsum(chance, axis=1) - 0.5 * chance  # P(below) and half of P(equal)
    return table.assign(
        p_holm=holm(table["p"].to_numpy()),
        odds_ratio=np.exp(table["estimate"]),
        superiority=(chance[a] * middle[b]).sum(axis=1),
    )


def _proportional(
    model: Cumulative, fit: CumulativeFit, y: np.ndarray, x: np.ndarray, terms: dict
) -> pd.DataFrame:
    """Return the tests of each term's effect against one on every threshold."""
    rows = []
    for name, columns in terms.items():
        df = len(columns) * (model.categories - 2)
        if df == 0:
            rows.append((name, np.nan, 0, np.nan, "two categories have one threshold"))
            continue
        wide = model.fit(y, np.delete(x, columns, axis=1), nominal=x[:, columns])
        chi2 = max(2.0 * (wide.llf - fit.llf), 0.0)
        if np.abs(wide.nominal).max() > FAR or not np.isfinite(chi2):
            rows.append((name, np.nan, df, np.nan, "some category is empty in a cell"))
        else:
            rows.append((name, chi2, df, float(special.chdtrc(df, chi2)), ""))
    return pd.DataFrame(rows, columns=["term", "chi2", "df", "p", "note"])
