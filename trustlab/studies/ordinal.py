"""
Ratings on ordered categories: cumulative-link (logit) models with a random intercept per person.

Logit P(y ≤ k) = θ_k − x β − σ v, v ~ N(0, 1) by person; two categories make a logistic model. Means
over v are taken by adaptive Gauss–Hermite quadrature (Pinheiro and Bates, 1995).
"""

from collections.abc import Hashable
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np
import pandas as pd
from scipy import sparse, special
from scipy.optimize import minimize

from trustlab.models.checks import whole_number
from trustlab.studies.anova import effect_name
from trustlab.studies.mixed import (
    FormulaModel,
    likelihood_ratios,
    matrices_of,
)
from trustlab.studies.pairs import estimates_of, holm, standard_errors
from trustlab.studies.table import (
    Columns,
    label_column,
    labelled,
    labels_index,
    names_of,
    numbers_of,
    origin_of,
    read_factors,
    refuse_shared,
    roles_of,
)
from trustlab.studies.words import apa_number, apa_p, interval

MOST_CATEGORIES = 30
# Logits beyond which no data tell a probability from 0 or 1.
FAR = 15.0
# SD below which people do not vary.
SINGULAR = 1e-2
STEP = 1e-3  # of differences
gauss_hermite = cache(np.polynomial.hermite_e.hermegauss)


class Cumulative:
    """
    The likelihood of answers in ordered categories.

    Parameters
    ----------
    category, people : numpy.ndarray of int
        Category and person of each row.
    points : int
        Nodes of the quadrature.
    """

    def __init__(self, category: np.ndarray, people: np.ndarray, points: int):
        self.category, self.people = category, people
        # Times rows, the sums over each person's.
        self.sums = sparse.csr_array((np.ones(people.size), (people, np.arange(people.size))))
        self.nodes, mass = gauss_hermite(points)
        self.log_mass = np.log(mass / mass.sum()) + 0.5 * self.nodes**2

    def log_likelihood(self, point: np.ndarray, x: np.ndarray) -> float:
        """Return it at a point: coefficients of x, thresholds and the SD of people."""
        beta, thresholds, (sd,) = np.split(point, [x.shape[1], -1])
        ends = np.concatenate([[-np.inf], thresholds, [np.inf]])
        bounds = ends[[self.category, self.category + 1]] - x @ beta
        mode, information = self._modes(bounds, sd)
        v = mode[:, None] + self.nodes / np.sqrt(information)[:, None]
        low, high = bounds[:, :, None] - sd * v[self.people]
        # F(b) − F(a) = F(b) (1 − F(a)) (1 − e^(a − b)), without cancellation.
        chance = special.log_expit(high) + special.log_expit(-low)
        chance += np.log1p(-np.exp(bounds[0] - bounds[1]))[:, None]
        logs = self.sums @ chance - 0.5 * v**2 + self.log_mass
        return float((special.logsumexp(logs, axis=1) - 0.5 * np.log(information)).sum())

    def _modes(self, bounds: np.ndarray, sd: float) -> tuple[np.ndarray, np.ndarray]:
        """
        Return where each person's integrand, which is log-concave, is greatest, and how sharply it
        is bent there.
        """
        high = abs(sd) * self.sums.sum(axis=1)
        low, mode = -high, np.zeros(high.size)
        while True:
            level = special.expit(bounds - sd * mode[self.people])
            slope = sd * (self.sums @ (level.sum(axis=0) - 1.0)) - mode
            information = 1.0 + sd**2 * (self.sums @ (level * (1.0 - level)).sum(axis=0))
            newton = mode + slope / information
            low, high = np.where(slope > 0.0, mode, low), np.where(slope > 0.0, high, mode)
            going = np.minimum(np.abs(newton - mode), high - low) > 1e-12 * (1.0 + np.abs(mode))
            if not going.any():
                return mode, information
            # Newton's steps can go round in circles, which end where the bracket is halved.
            inside = (low < newton) & (newton < high)
            mode = np.where(going, np.where(inside, newton, 0.5 * (low + high)), mode)

    def maximum(self, x: np.ndarray) -> np.ndarray:
        """Return the point of the greatest likelihood."""
        count, mean, scale = x.shape[1], x.mean(axis=0), x.std(axis=0)
        z = (x - mean) / scale

        def ordered(free: np.ndarray) -> np.ndarray:
            # The search goes by logarithms of the distances between thresholds.
            first, gaps, sd = np.split(free, [count + 1, -1])
            gaps = np.exp(np.minimum(gaps, 2.0 * FAR))
            return np.concatenate([first, first[-1] + np.cumsum(gaps), np.abs(sd)])

        thresholds = special.logit(np.cumsum(np.bincount(self.category))[:-1] / len(z))
        start = [*np.zeros(count), thresholds[0], *np.log(np.diff(thresholds)), 0.7]
        search = {"method": "BFGS", "jac": "3-point", "options": {"gtol": 1e-6}}
        found = minimize(lambda free: -self.log_likelihood(ordered(free), z), start, **search)
        beta, rest = np.split(ordered(found.x), [count])
        if max(np.ptp(z @ beta), *np.abs(rest)) > FAR:
            raise ValueError(
                "dv: the likelihood has no maximum: some effect separates low from high ratings, "
                "or people hardly vary; leave the effect or the people out"
            )
        beta = beta / scale
        rest[:-1] += mean @ beta
        return np.concatenate([beta, rest])

    def covariance(self, point: np.ndarray, x: np.ndarray) -> np.ndarray:
        """
        Return that of coefficients and thresholds at the maximum: the inverse of the observed
        information.
        """
        from statsmodels.tools.numdiff import approx_hess

        steps = np.full(point.size, STEP)
        steps[: x.shape[1]] /= x.std(axis=0)
        # People who do not vary are at the boundary, which carries no information on the rest.
        free, fixed = np.split(point, [point.size - (point[-1] < SINGULAR)])
        information = -approx_hess(
            free,
            lambda part: self.log_likelihood(np.concatenate([part, fixed]), x),
            steps[: free.size],
        )
        size = point.size - 1
        return np.linalg.inv(information)[:size, :size]


@dataclass(frozen=True, eq=False, repr=False)
class OrdinalModel(FormulaModel):
    """
    A cumulative-link (logit) mixed model of ratings, tested by likelihood ratios.

    A positive effect raises ratings; exp(estimate) multiplies one person's odds of rating above any
    category. The coefficients are the fixed effects and, below them, thresholds between categories,
    in logits.

    Parameters
    ----------
    dv : hashable
        Column of the ratings.
    categories : tuple
        Values of the ratings, ascending.
    covariance : numpy.ndarray
        Of coefficients and thresholds.
    cells : pandas.DataFrame
        Regressors of every cell of the factors, covariates at their means.

    See Also
    --------
    FormulaModel : Its table, coefficients_table, random_effects and sentence.
    """

    dv: Hashable
    categories: tuple
    covariance: np.ndarray
    cells: pd.DataFrame

    def _chances(self, point: np.ndarray, sd: float) -> np.ndarray:
        """Return how likely every category is in every cell, over people of an SD."""
        x = self.cells.to_numpy()
        beta, thresholds = np.split(point, [x.shape[1]])
        nodes, mass = gauss_hermite(60)
        logits = thresholds[:, None] - (x @ beta)[:, None, None] - sd * nodes
        below = special.expit(logits) @ (mass / mass.sum())
        return np.diff(below, axis=1, prepend=0.0, append=1.0)

    def probabilities(self) -> pd.DataFrame:
        """
        Return how likely every rating is in every cell, averaged over people.

        Returns
        -------
        pandas.DataFrame
            Columns of the factors, category, probability, ci_low and ci_high (95 %, delta method on
            logits, taking the variance between people as estimated). Covariates are at their means.
        """
        from statsmodels.tools.numdiff import approx_fprime

        refuse_shared(self.cells.index.names, ["category", "probability", "ci_low", "ci_high"])
        point = self.coefficients["estimate"].to_numpy()
        sd = np.sqrt(self.variances["Intercept"])

        def logits(point: np.ndarray) -> np.ndarray:
            return special.logit(self._chances(point, sd)).ravel()

        slope = approx_fprime(point, logits, 2.0 * STEP, centered=True)  # which takes half of it
        half = special.ndtri(0.975) * standard_errors(slope, self.covariance)
        centre = logits(point)
        table = self.cells.index.to_frame(index=False).merge(
            pd.Series(self.categories, name="category"), how="cross"
        )
        for name, logit in {"probability": 0.0, "ci_low": -half, "ci_high": half}.items():
            table[name] = special.expit(centre + logit)
        return labelled(table, self.origin)

    def pairs(self) -> pd.DataFrame:
        """
        Return differences between cells, for one person.

        Returns
        -------
        pandas.DataFrame
            Columns a, b, estimate (a − b in logits), se, z, p, ci_low, ci_high, p_holm, odds_ratio,
            superiority (probability that the median person rates a above b, ties half).
        """
        x, point = self.cells.to_numpy(), self.coefficients["estimate"].to_numpy()
        cells = self.cells.index
        names = labels_index(map(effect_name, cells) if cells.nlevels > 1 else cells)
        a, b = np.triu_indices(len(names), 1)
        contrast = np.pad(x[a] - x[b], ((0, 0), (0, point.size - x.shape[1])))
        tests = estimates_of(contrast @ point, standard_errors(contrast, self.covariance))
        table = pd.DataFrame({"a": names[a], "b": names[b]}).join(tests)
        chance = self._chances(point, 0.0)
        middle = np.cumsum(chance, axis=1) - 0.5 * chance  # P(below) and half of P(equal)
        table = table.assign(
            p_holm=holm(table["p"].to_numpy()),
            odds_ratio=np.exp(table["estimate"]),
            superiority=(chance[a] * middle[b]).sum(axis=1),
        )
        return labelled(table, self.origin)

    def apa(self) -> str:
        """Return the sentences for a paper: the test of every term, and pairs that differ."""
        pairs = [
            f"{row.a} against {row.b}, OR = {apa_number(row.odds_ratio)}, "
            f"{interval(np.exp(row.ci_low), np.exp(row.ci_high))}, Holm-adjusted "
            f"{apa_p(row.p_holm)}"
            for row in self.pairs().query("p_holm < 0.05").itertuples()
        ]
        return f"{super().apa()} Pairs that differ: {'; '.join(pairs) or 'none'}."


def ordinal_model(
    frame: pd.DataFrame,
    dv: Hashable,
    within: Columns,
    subject: Hashable = "subject",
    *,
    between: Columns = None,
    covariates: Columns = None,
    order: Any = None,
    points: int = 15,
) -> OrdinalModel:
    """
    Fit ratings on ordered categories, such as trust from 1 to 7, without taking steps for equal.

    Parameters
    ----------
    frame : pandas.DataFrame
        A row per rating; a person may have any number of them in a cell.
    dv : hashable
        Column with the ratings: numbers, or an ordered categorical. Two categories, such as whether
        a suggestion was followed, make a logistic model.
    within, between : hashable or list of hashable
        Columns of the factors within and between people, with all their interactions; [] is none.
    subject : hashable
        Column with the people.
    covariates : hashable or list of hashable, optional
        Columns with numbers, such as the trial.
    order : sequence or dict, optional
        The order of a single factor's levels, or of several factors' by name; the first is the
        reference.
    points : int
        Nodes of the adaptive Gauss–Hermite quadrature; 1 is Laplace's approximation.

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
    table, inside, groups = read_factors(frame, dv, within, subject, between, order)
    data = table.reset_index(drop=True)
    people = data[subject].cat
    n = len(people.categories)
    if n < 3:
        raise ValueError(f"subject: column {subject!r} has {n} people; at least 3 needed")
    answers, categories = _categories(label_column(table, "dv", dv))
    factors, covariates = groups | inside, names_of(covariates)
    roles_of("frame", table, dv=[dv], factors=[*factors], subject=[subject], covariates=covariates)
    for name in covariates:
        numbers_of(table[name], "covariates")
    if {"0", "1"} & {*map(str, (dv, *factors, *covariates))}:
        raise ValueError("columns: 0 and 1 are numbers in a formula; rename the column")
    crossed = " * ".join(f"`{name}`" for name in factors)
    formula = " + ".join([f"`{dv}` ~ {crossed}", *(f"`{name}`" for name in covariates)])
    data[dv] = answers
    used = data[[dv, *factors, *covariates]].rename(columns=str)
    _, regressors, terms = matrices_of(formula, used)
    x = regressors.to_numpy()
    # Thresholds take the place of the intercept, the first column.
    every = tuple(range(1, x.shape[1]))
    model = Cumulative(
        answers, people.codes.to_numpy(int), whole_number("points", points, most=100)
    )
    maximum = cache(lambda kept: model.maximum(x[:, kept]))

    def log_likelihood(kept: tuple[int, ...]) -> float:
        return model.log_likelihood(maximum(kept), x[:, kept])

    tests = likelihood_ratios(terms, every, log_likelihood)
    effects = regressors.columns[1:]
    cells = regressors[effects].groupby([data[name] for name in factors], observed=True).mean()
    for name in map(str, covariates):
        cells[name] = regressors[name].mean()
    point = maximum(every)
    covariance = model.covariance(point, x[:, every])
    coefficients = estimates_of(point[:-1], np.sqrt(np.diag(covariance)))
    thresholds = [f"{low} | {high}" for low, high in pairwise(categories)]
    coefficients.insert(0, "name", [*effects, *thresholds])
    kind = "logistic" if len(categories) == 2 else "cumulative-link"
    return OrdinalModel(
        title=f"A {kind} mixed model of {dv} with random intercepts",
        n=n,
        observations=answers.size,
        tests=labelled(tests, origin_of(frame)),
        coefficients=labelled(coefficients, origin_of(frame)),
        variances=pd.Series({"Intercept": point[-1] ** 2}),
        log_likelihood=log_likelihood(every),
        singular=bool(point[-1] < SINGULAR),
        dv=dv,
        categories=tuple(categories),
        covariance=covariance,
        cells=cells,
    )


def _categories(column: pd.Series) -> tuple[np.ndarray, list]:
    """Return the number of every answer's category, and the categories that occur, ascending."""
    ordered = isinstance(column.dtype, pd.CategoricalDtype) and column.cat.ordered
    if not ordered:
        if not pd.api.types.is_numeric_dtype(column):
            raise ValueError(
                f"dv: column {column.name!r} is neither numbers nor an ordered categorical; "
                "pandas.Categorical(…, [lowest, …, highest], ordered=True) makes one"
            )
        numbers_of(column.astype(float), "dv")
    codes, categories = pd.factorize(column, sort=True)
    if not 2 <= len(categories) <= MOST_CATEGORIES:
        raise ValueError(
            f"dv: column {column.name!r} has {len(categories)} different ratings, not 2 to "
            f"{MOST_CATEGORIES}; formula_model takes ratings on a fine scale as numbers"
        )
    return codes, list(categories)
