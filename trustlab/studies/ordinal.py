"""
Ratings on ordered categories: cumulative-link (logit) models with a random intercept per person.

Logit P(y ≤ k) = θ_k − x β − σ v, v ~ N(0, 1) by person; two categories make a logistic model. Means
over v are taken by adaptive Gauss–Hermite quadrature (Pinheiro and Bates, 1995).
"""

from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from scipy import sparse, special
from scipy.optimize import minimize

from trustlab.models.checks import finite_array, of_class, whole_number
from trustlab.studies.mixed import (
    estimates_of,
    likelihood_ratios,
    matrices_of,
    variances_of,
)
from trustlab.studies.pairs import holm
from trustlab.studies.table import (
    Tested,
    column_of,
    labelled,
    mark,
    origin_of,
    read_factors,
    refuse_missing_labels,
)
from trustlab.studies.words import apa_number, apa_p, interval

MOST_CATEGORIES = 30
# Logits beyond which no data tell a probability from 0 or 1.
FAR = 15.0
# SD below which people do not vary.
SINGULAR = 1e-3
STEP = 1e-4  # of differences
LEAST = 1e-6  # of the difference between thresholds


class CumulativeFit(NamedTuple):
    """
    Maximum of the likelihood: coefficients, thresholds, effects on each threshold (a row per
    threshold), SD of people, and the covariance of coefficients and thresholds.
    """

    llf: float
    beta: np.ndarray
    thresholds: np.ndarray
    nominal: np.ndarray
    sd: float
    covariance: np.ndarray


class Cumulative:
    """
    Answers in ordered categories; a model is fitted to them or draws them.

    Parameters
    ----------
    codes : numpy.ndarray
        Person of each row.
    categories : int
        How many there are.
    points : int
        Nodes of the quadrature.
    """

    def __init__(self, codes: np.ndarray, categories: int, points: int):
        self.codes = codes
        self.cuts = categories - 1
        # Times rows, the sums over each person's.
        self.member = sparse.csr_array((np.ones(codes.size), (codes, np.arange(codes.size))))
        self.nodes, mass = np.polynomial.hermite_e.hermegauss(points)
        self.log_mass = np.log(mass / mass.sum()) + 0.5 * self.nodes**2

    def fit(
        self,
        category: np.ndarray,
        x: np.ndarray,
        *,
        nominal: np.ndarray | None = None,
        covariance: bool = False,
    ) -> CumulativeFit:
        """
        Return the maximum of the likelihood; with `covariance`, to the last digits and with the
        inverse of the observed information. `nominal` regressors have an effect on every threshold.
        """
        category, count = category.astype(int), len(x)
        cut = np.pad(np.eye(self.cuts), ((1, 1), (0, 0)))
        ends = np.array([cut[category], cut[category + 1]])  # lower and upper bound of each row
        effects = np.zeros((count, 0)) if nominal is None else nominal
        wide = (ends[..., None] * effects[:, None]).reshape(2, count, -1)
        finite = ends.sum(axis=2)
        design = np.concatenate([-x * finite[..., None], ends, -wide], axis=2)
        infinite = np.where(finite == 1.0, 0.0, [[-np.inf], [np.inf]])
        # The search is along uncorrelated directions of equal size.
        directions, size, rows = np.linalg.svd(np.concatenate(design), full_matrices=False)
        directions, rows = directions[:, size > 1e-12 * size[0]], rows[size > 1e-12 * size[0]]
        size = size[: len(rows)] / np.sqrt(count)
        turned = np.sqrt(count) * directions.reshape(2, count, -1)
        turn = rows.T / size

        def loss(point: np.ndarray) -> tuple[float, np.ndarray]:
            bounds = turned @ point[:-1] + infinite
            value, by_bound, by_sd = self._integrals(bounds, point[-1])
            return -value, -np.append(np.tensordot(by_bound, turned), by_sd)

        below = np.cumsum(np.bincount(category, minlength=self.cuts + 1))[:-1] / count
        start = np.zeros(design.shape[2])
        start[x.shape[1] :][: self.cuts] = special.logit(np.clip(below, 1e-3, 1.0 - 1e-3))
        start = np.append(size * (rows @ start), 0.7)
        point = minimize(loss, start, jac=True, method="BFGS", options={"gtol": 1e-6}).x
        spread = np.zeros((0, 0))
        if covariance:
            # People who do not vary are at the boundary, which carries no information on the rest.
            free = point.size - (abs(point[-1]) < SINGULAR)
            steps = STEP * np.eye(point.size)[:free]
            ahead, behind = (
                np.array([loss(point + sign * step)[1][:free] for step in steps])
                for sign in (1.0, -1.0)
            )
            inverse = np.linalg.inv((ahead - behind) / (2.0 * STEP))
            point[:free] -= inverse @ loss(point)[1][:free]
            spread = turn @ inverse[: size.size, : size.size] @ turn.T
        places = [x.shape[1], x.shape[1] + self.cuts]
        beta, thresholds, nominal = np.split(turn @ point[:-1], places)
        value, sd = float(-loss(point)[0]), float(abs(point[-1]))
        nominal = nominal.reshape(self.cuts, -1)
        return CumulativeFit(value, beta, thresholds, nominal, sd, spread)

    def _integrals(self, bounds: np.ndarray, sd: float) -> tuple[float, np.ndarray, float]:
        """
        Return the log-likelihood and its slopes by the bounds of every row's category, θ − x β,
        lower and upper, and by the standard deviation of people.
        """
        mode, level = self._modes(bounds, sd)
        density = level * (1.0 - level)
        bend = density * (1.0 - 2.0 * level)
        second = self.member @ density.sum(axis=0)
        third = self.member @ bend.sum(axis=0)
        width = 1.0 / np.sqrt(1.0 + sd**2 * second)

        v = mode[:, None] + width[:, None] * self.nodes
        logit = bounds[:, :, None] - sd * v[self.codes]
        # F(b) − F(a) = F(b) (1 − F(a)) (1 − e^(a − b)), without cancellation.
        gap = bounds[1] - bounds[0]
        rate = 1.0 / np.expm1(np.maximum(gap, LEAST))
        chance = special.log_expit(logit[1]) + special.log_expit(-logit[0])
        # Beyond a least gap it goes on in a straight line, so that a search finds its way back.
        chance += np.log1p(-np.exp(-np.maximum(gap, LEAST)))[:, None]
        chance += (rate * np.minimum(gap - LEAST, 0.0))[:, None]
        logs = self.member @ chance - 0.5 * v**2 + self.log_mass
        total = special.logsumexp(logs, axis=1)
        share = np.exp(logs - total[:, None])
        level_at = special.expit(logit)
        pull = self.member @ (level_at.sum(axis=0) - 1.0)
        by_bound = -(share[self.codes] * level_at).sum(axis=2)
        by_bound += np.array([[0.0], [1.0]]) + np.array([[-1.0], [1.0]]) * rate
        by_sd = (share * v * pull).sum()

        # Nodes move with bounds and sd; the more of them there are, the less it matters.
        slope = sd * pull - v
        by_width = 0.5 * width**3 * ((share * slope * self.nodes).sum(axis=1) + 1.0 / width)
        by_mode = width**2 * ((share * slope).sum(axis=1) + by_width * sd**3 * third)
        by_bound += sd * by_mode[self.codes] * density - sd**2 * by_width[self.codes] * bend
        first = self.member @ (level.sum(axis=0) - 1.0)
        by_sd += (by_mode * (first - sd * mode * second)).sum()
        by_sd += (by_width * (sd**2 * mode * third - 2.0 * sd * second)).sum()
        return (total + np.log(width)).sum(), by_bound, by_sd

    def _modes(self, bounds: np.ndarray, sd: float) -> tuple[np.ndarray, np.ndarray]:
        """
        Return where each person's integrand, which is log-concave, is greatest, and the
        probabilities up to each bound there.
        """
        high = abs(sd) * self.member.sum(axis=1)
        low = -high
        mode = np.zeros(high.size)
        while True:
            level = special.expit(bounds - sd * mode[self.codes])
            slope = sd * (self.member @ (level.sum(axis=0) - 1.0)) - mode
            step = slope / (1.0 + sd**2 * (self.member @ (level * (1.0 - level)).sum(axis=0)))
            going = np.abs(step) > 1e-12 * (1.0 + np.abs(mode))
            if not going.any():
                return mode, level
            low, high = np.where(slope > 0.0, mode, low), np.where(slope > 0.0, high, mode)
            # Newton's steps can go round in circles, which end where the bracket is halved.
            newton = mode + step
            inside = (low < newton) & (newton < high)
            mode = np.where(going, np.where(inside, newton, 0.5 * (low + high)), mode)

    def draw(self, fit: CumulativeFit, x: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Return categories drawn from a fitted model."""
        people = fit.sd * rng.standard_normal(self.member.shape[0])
        answers = x @ fit.beta + people[self.codes] + special.logit(rng.random(self.codes.size))
        return (answers[:, None] > fit.thresholds).sum(axis=1)


@dataclass(frozen=True, eq=False, repr=False)
class OrdinalModel(Tested):
    """
    A cumulative-link (logit) mixed model of ratings.

    Parameters
    ----------
    dv : hashable
        Column of the ratings.
    categories : tuple
        Values of the ratings, ascending.
    tests : pandas.DataFrame
        What `table` returns.
    model, fit : Cumulative, CumulativeFit
        The likelihood, and its maximum.
    answers : numpy.ndarray
        Number of every rating's category.
    regressors : pandas.DataFrame
        A row per rating.
    terms : dict
        Numbers of the columns of every term.
    cells : pandas.DataFrame
        Regressors of every cell of the factors, covariates at their means.
    origin : str
        What kind of data these are where they were not measured; else empty.
    """

    dv: Hashable
    categories: tuple
    tests: pd.DataFrame
    model: Cumulative
    fit: CumulativeFit
    answers: np.ndarray
    regressors: pd.DataFrame
    terms: dict[str, list[int]]
    cells: pd.DataFrame
    origin: str

    @property
    def title(self) -> str:
        """What was fitted."""
        return f"Cumulative-link mixed model of {self.dv}"

    @property
    def n(self) -> int:
        """How many people rated."""
        return self.model.member.shape[0]

    @property
    def log_likelihood(self) -> float:
        """Maximum of the likelihood."""
        return self.fit.llf

    @property
    def singular(self) -> bool:
        """Whether the variance of people is estimated as zero."""
        return self.fit.sd < SINGULAR

    def table(self) -> pd.DataFrame:
        """
        Return the likelihood-ratio test of every term against the model without the term and the
        interactions that contain it: term, chi2, df, p_chi2, p_bootstrap.
        """
        return super().table()

    def _estimates(self) -> pd.DataFrame:
        """Return coefficients and thresholds."""
        point = np.concatenate([self.fit.beta, self.fit.thresholds])
        names = [f"{low} | {high}" for low, high in pairwise(self.categories)]
        table = estimates_of(point, np.sqrt(np.diag(self.fit.covariance)))
        table.insert(0, "name", [*self.regressors, *names])
        return labelled(table, self.origin)

    def coefficients_table(self) -> pd.DataFrame:
        """
        Return the fixed effects in logits: name estimate se z p ci_low ci_high (95 %, normal).

        A positive one raises ratings; exp(estimate) multiplies one person's odds of rating above
        any category.
        """
        return self._estimates()[: self.fit.beta.size]

    def thresholds_table(self) -> pd.DataFrame:
        """Return the thresholds between categories in logits: name estimate se ci_low ci_high."""
        table = self._estimates()[self.fit.beta.size :].drop(columns=["z", "p"])
        return table.reset_index(drop=True)

    def random_effects(self) -> pd.DataFrame:
        """Return variance and standard deviation of people's intercepts, in logits."""
        return variances_of(Intercept=self.fit.sd**2)

    def probabilities(self) -> pd.DataFrame:
        """
        Return how likely every rating is in every cell, averaged over people.

        Returns
        -------
        pandas.DataFrame
            Columns of the factors, category, probability, ci_low and ci_high (95 %, delta method on
            logits, taking the variance between people as estimated), at_least (probability of this
            rating or a higher one). Covariates are at their means.
        """
        fit, cells = self.fit, self.cells
        nodes, mass = np.polynomial.hermite_e.hermegauss(60)

        def at_most(parameters: np.ndarray) -> np.ndarray:
            beta, thresholds = np.split(parameters, [fit.beta.size])
            logit = thresholds[:, None] - (cells.to_numpy() @ beta)[:, None, None] - fit.sd * nodes
            return special.expit(logit) @ (mass / mass.sum())

        def logits(parameters: np.ndarray) -> np.ndarray:
            chance = np.diff(at_most(parameters), axis=1, prepend=0.0, append=1.0)
            return special.logit(chance).ravel()

        point = np.concatenate([fit.beta, fit.thresholds])
        steps = STEP * np.eye(point.size)
        slope = np.array([logits(point + row) - logits(point - row) for row in steps])
        slope /= 2.0 * STEP
        half = special.ndtri(0.975) * np.sqrt(((fit.covariance @ slope) * slope).sum(axis=0))
        centre = logits(point)
        table = cells.index.to_frame(index=False)
        table = table.loc[table.index.repeat(len(self.categories))].reset_index(drop=True)
        table = table.assign(
            category=[*self.categories] * len(cells),
            probability=special.expit(centre),
            ci_low=special.expit(centre - half),
            ci_high=special.expit(centre + half),
            at_least=1.0 - np.pad(at_most(point), ((0, 0), (1, 0))).ravel(),
        )
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
        index, x = self.cells.index.to_frame(), self.cells.to_numpy()
        beta = self.fit.beta
        names = np.array([" × ".join(map(str, row)) for row in index.itertuples(index=False)])
        a, b = np.triu_indices(len(names), 1)
        contrast = x[a] - x[b]
        variance = self.fit.covariance[: beta.size, : beta.size]
        se = np.sqrt(((contrast @ variance) * contrast).sum(axis=1))
        table = pd.DataFrame({"a": names[a], "b": names[b]}).join(estimates_of(contrast @ beta, se))
        below = special.expit(self.fit.thresholds - (x @ beta)[:, None])
        chance = np.diff(below, axis=1, prepend=0.0, append=1.0)
        middle = np.cumsum(chance, axis=1) - 0.5 * chance  # P(below) and half of P(equal)
        table = table.assign(
            p_holm=holm(table["p"].to_numpy()),
            odds_ratio=np.exp(table["estimate"]),
            superiority=(chance[a] * middle[b]).sum(axis=1),
        )
        return labelled(table, self.origin)

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
        x, rows = self.regressors.to_numpy(), []
        for name, columns in self.terms.items():
            df = len(columns) * (self.model.cuts - 1)
            chi2, note = np.nan, "two categories have one threshold"
            if df:
                rest, own = np.delete(x, columns, axis=1), x[:, columns]
                wide = self.model.fit(self.answers, rest, nominal=own)
                chi2, note = max(2.0 * (wide.llf - self.fit.llf), 0.0), ""
                if np.abs(wide.nominal * np.ptp(own, axis=0)).max() > FAR:
                    chi2, note = np.nan, "some category is empty in a cell"
            rows.append((name, chi2, df, float(special.chdtrc(df, chi2)), note))
        table = pd.DataFrame(rows, columns=["term", "chi2", "df", "p", "note"])
        return labelled(table, self.origin)

    def apa(self) -> str:
        """Return the sentences for a paper: the test of every term, and pairs that differ."""
        tests = [
            f"{row.term}, χ²({row.df}) = {apa_number(row.chi2)}, {apa_p(row.p_chi2)}"
            for row in self.tests.itertuples()
        ]
        pairs = [
            f"{row.a} against {row.b}, OR = {apa_number(row.odds_ratio)}, "
            f"{interval(np.exp(row.ci_low), np.exp(row.ci_high))}, Holm-adjusted "
            f"{apa_p(row.p_holm)}"
            for row in self.pairs().query("p_holm < 0.05").itertuples()
        ]
        kind = "logistic" if len(self.categories) == 2 else "cumulative-link"
        return (
            f"{mark(self.origin)}A {kind} mixed model of {self.dv} with random intercepts "
            f"({self.n} people, {self.answers.size} ratings) was tested by likelihood ratios: "
            f"{'; '.join(tests)}. "
            f"Pairs that differ: {'; '.join(pairs) or 'none'}."
        )


def ordinal_model(
    frame: pd.DataFrame,
    dv: Hashable,
    within: Hashable | Sequence[Hashable],
    subject: Hashable = "subject",
    *,
    between: Hashable | Sequence[Hashable] = None,
    covariates: Sequence[Hashable] = (),
    order: Any = None,
    points: int = 15,
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
        Column with the ratings: numbers, or an ordered categorical. Two categories, such as whether
        a suggestion was followed, make a logistic model.
    within, between : hashable or list of hashable
        Columns of the factors within and between people, with all their interactions; [] is none.
    subject : hashable
        Column with the people.
    covariates : sequence of hashable
        Columns with numbers, such as the trial.
    order : sequence or dict, optional
        The order of a single factor's levels, or of several factors' by name; the first is the
        reference.
    points : int
        Nodes of the adaptive Gauss–Hermite quadrature; 1 is Laplace's approximation.
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
    refuse_missing_labels(column_of(data, "subject", subject), "subject")
    codes, people = pd.factorize(data[subject])
    if len(people) < 3:
        raise ValueError(f"subject: column {subject!r} has {len(people)} people; at least 3 needed")
    answers, categories = _categories(column_of(data, "dv", dv))
    inside, groups = read_factors(data, dv, within, subject, between, order)
    factors = groups | inside
    for name, levels in factors.items():
        data[name] = pd.Categorical(data[name], levels)
    for name in covariates:
        finite_array("covariates", column_of(data, "covariates", name))
    product = " * ".join(f"`{name}`" for name in factors)
    formula = " + ".join([f"answer ~ {product}", *(f"`{name}`" for name in covariates)])
    y, regressors, terms = matrices_of(formula, data.assign(answer=answers))
    # Thresholds take the place of the intercept.
    regressors = regressors.drop(columns="Intercept")
    terms = {name: [column - 1 for column in columns] for name, columns in terms.items()}
    x = regressors.to_numpy()
    model = Cumulative(codes, len(categories), whole_number("points", points, most=100))
    fit = model.fit(y, x, covariance=True)
    effects = (x - x.mean(axis=0)) @ fit.beta
    thresholds = fit.thresholds - x.mean(axis=0) @ fit.beta
    if max(np.abs(effects).max(), np.abs(thresholds).max(), fit.sd) > FAR:
        raise ValueError(
            "dv: the likelihood has no maximum: some effect separates low from high ratings, or "
            "people hardly vary; leave the effect or the people out"
        )
    cells = regressors.groupby([data[name] for name in factors], observed=True).mean()
    for name in covariates:
        cells.iloc[:, terms[name]] = x[:, terms[name]].mean(axis=0)
    origin = origin_of(frame)
    tests = labelled(likelihood_ratios(y, x, terms, model, bootstrap, seed), origin)
    return OrdinalModel(
        dv, tuple(categories), tests, model, fit, y, regressors, terms, cells, origin
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
    codes, categories = pd.factorize(column, sort=True)
    if not 2 <= len(categories) <= MOST_CATEGORIES:
        raise ValueError(
            f"dv: column {column.name!r} has {len(categories)} different ratings, not 2 to "
            f"{MOST_CATEGORIES}; formula_model takes ratings on a fine scale as numbers"
        )
    return codes, list(categories)
