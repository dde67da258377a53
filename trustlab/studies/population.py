"""Populations of conditions: means and covariances of scores, from numbers or a pilot study."""

import math
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from typing import Any

import numpy as np
import pandas as pd
from scipy import special
from scipy.optimize import brentq

from trustlab.models.checks import (
    between,
    finite_array,
    finite_number,
    finite_numbers,
    of_class,
    positive,
    warn,
    whole_number,
)
from trustlab.studies.anova import Design
from trustlab.studies.repeated_measures import repeated_measures
from trustlab.studies.table import Levels, cells_of, labels_of, names_of, numbers_of


@dataclass(frozen=True)
class StudyColumns:
    """
    Columns of a pilot study's table, or levels of the index of its means.

    Parameters
    ----------
    dv, subject : hashable
        Columns of the measure and of the participants.
    within : hashable or list of hashable
        The factor or factors within subjects.
    between : hashable or list of hashable, optional
        Factors between subjects, which come first in the index of the means.
    order : sequence or dict, optional
        Order of the conditions; of several factors, a dict of factor to levels.
    """

    dv: Hashable = "value"
    within: Hashable | list[Hashable] = "condition"
    subject: Hashable = "subject"
    between: Hashable | list[Hashable] | None = None
    order: Any = None


USUAL_COLUMNS = StudyColumns()


def graded_covariance(
    k: int, correlation: float = 0.5, epsilon: float = 1.0, sd: float = 1.0
) -> np.ndarray:
    """
    Return a covariance of k conditions with a wanted mean correlation and ε.

    The variances of the k − 1 orthonormal polynomial contrasts (linear first) form a geometric
    sequence, falling so steeply that ε comes out; their mean is σ² (1 − ρ), and that of the sum
    over conditions is σ² (1 + (k − 1) ρ). ε = 1 is compound symmetry. Mean variance and mean
    covariance are σ² and ρ σ². With ε below 1 power depends on which contrasts vary most: this is
    one choice.

    Parameters
    ----------
    k : int
        Conditions, at least 2.
    correlation : float
        ρ, between −1/(k − 1) and 1.
    epsilon : float
        ε, above 1/(k − 1) and at most 1; for k = 2 it is 1.
    sd : float
        σ, the root of the mean variance.

    Returns
    -------
    numpy.ndarray, shape (k, k)

    Raises
    ------
    ValueError
        If an argument is out of range.
    """
    d = whole_number("k", k, least=2, most=1000) - 1
    rho, eps = finite_number("correlation", correlation), finite_number("epsilon", epsilon)
    sd = positive("sd", between("sd", sd, 0.0, 1e100))
    possible = 1.0 / d < eps <= 1.0 or eps == d == 1
    if not (possible and -1.0 / d < rho < 1.0):
        raise ValueError(
            f"correlation = {rho:g}, epsilon = {eps:g}: {d + 1} conditions have a correlation "
            f"between {-1.0 / d:.4g} and 1, and an ε above {1.0 / d:.4g} up to 1 (1 for two)"
        )

    steps = np.arange(d)

    def excess(log_ratio: float) -> float:
        return 1.0 / (d * (special.softmax(log_ratio * steps) ** 2).sum()) - eps

    ratio = brentq(excess, -60.0, 0.0, xtol=1e-14, rtol=1e-14) if eps < 1.0 - 1e-12 else 0.0
    variances = d * sd**2 * (1.0 - rho) * special.softmax(ratio * steps)
    # Powers of x span the same spaces, but are nearly dependent beyond a dozen conditions.
    basis = np.linalg.qr(np.polynomial.legendre.legvander(np.linspace(-1.0, 1.0, d + 1), d))[0]
    together = sd**2 * (1.0 + d * rho)
    if variances.min() <= 1e-12 * max(together, variances.max()):
        raise ValueError(f"epsilon = {eps:g} is too near {1.0 / d:.4g}: some contrast never varies")
    return basis @ np.diag(np.r_[together, variances]) @ basis.T


@dataclass(frozen=True, eq=False)
class Conditions:
    """
    Population from which studies are drawn: normal scores with these means and this covariance.

    Parameters
    ----------
    labels : tuple
        Conditions; of several factors the cells, the last factor varying fastest.
    mean : numpy.ndarray, shape (k,) or (groups, k)
        Their means, in each group.
    covariance : numpy.ndarray, shape (k, k)
        Positive definite.
    origin : str
        Where they come from, if not given as numbers ("reconstructed data" …).
    within, between : mapping of str to sequence
        Factors and their levels; "condition" with the labels when not given.

    Raises
    ------
    ValueError
        If sizes differ, labels repeat, or the covariance is not positive definite.
    """

    labels: Sequence[Hashable]
    mean: np.ndarray
    covariance: np.ndarray
    origin: str = ""
    within: Mapping[Any, Sequence] = field(default_factory=dict)
    between: Mapping[Any, Sequence] = field(default_factory=dict)

    def __post_init__(self):
        labels = labels_of("labels", self.labels, 2)
        mean = finite_numbers("mean", self.mean)
        covariance = finite_numbers("covariance", self.covariance)
        k = len(labels)
        if mean.shape[-1:] != (k,) or covariance.shape != (k, k):
            raise ValueError(
                f"mean and covariance must be of the {k} conditions {[*labels]}, got shapes "
                f"{mean.shape} and {covariance.shape}"
            )
        least, *_, greatest = np.linalg.eigvalsh(covariance)
        asymmetry = np.abs(covariance - covariance.T).max()
        if asymmetry > 1e-8 * greatest or least <= 1e-12 * greatest:
            raise ValueError(
                f"covariance must be symmetric and positive definite; its least eigenvalue is "
                f"{least:.6g}, the greatest {greatest:.6g} (a pilot study needs more people than "
                "conditions)"
            )
        within = self.within or {"condition": labels}
        self.__dict__.update(labels=labels, mean=mean, covariance=covariance, within=within)

    @property
    def simulated_origin(self) -> str:
        """Where results of studies drawn from this population come from, for captions."""
        return "simulated studies" + (f", from {self.origin}" if self.origin else "")

    @property
    def correlation(self) -> float:
        """Mean covariance between conditions over their mean variance."""
        trace = np.trace(self.covariance)
        return float((self.covariance.sum() / trace - 1.0) / (len(self.labels) - 1))

    @property
    def groups(self) -> int:
        """How many groups of participants there are."""
        return len(np.atleast_2d(self.mean))

    def study(self, noise: np.ndarray) -> tuple[np.ndarray, Design]:
        """
        Return the scores of participants, as many in each group, and the design.

        Parameters
        ----------
        noise : numpy.ndarray, shape (..., participants, k)
            What makes them differ: independent numbers of variance 1.
        """
        groups = np.repeat(np.arange(self.groups), noise.shape[-2] // self.groups)
        scores = noise @ np.linalg.cholesky(self.covariance).T
        scores += np.atleast_2d(self.mean)[groups]
        return scores, Design(len(groups), self.within, self.between, groups)

    def with_effect(self, eta2_partial: float) -> "Conditions":
        """
        Return the population with its means scaled about their mean, to a given partial η².

        Parameters
        ----------
        eta2_partial : float
            In [0, 1).

        Raises
        ------
        ValueError
            If it is out of range, or all means are the same, so that no factor separates them.
        """
        eta2 = finite_number("effect_size", eta2_partial)
        centre = self.mean.mean()
        shape = self.mean - centre
        flat = np.abs(shape).max() <= 1e-12 * np.abs(self.mean).max()
        if not 0.0 <= eta2 < 1.0 or (eta2 > 0.0 and flat):
            raise ValueError(
                f"effect_size is a population partial η², in [0, 1) and 0 where all means are the "
                f"same, got {eta2}"
            )
        # η²/(1 − η²) = Σ (μ_j − μ)² / tr M, M the covariance of orthonormal contrasts.
        error = np.trace(self.covariance) - self.covariance.sum() / len(self.labels)
        scale = np.sqrt(eta2 / (1.0 - eta2) * error / ((shape**2).sum() or 1.0))
        return replace(self, mean=centre + scale * shape)

    def with_epsilon(self, epsilon: float) -> "Conditions":
        """
        Return the population with `graded_covariance` of the same mean variance and correlation.

        Parameters
        ----------
        epsilon : float
            As for `graded_covariance`.
        """
        k = len(self.labels)
        sd = float(np.sqrt(np.trace(self.covariance) / k))
        return replace(self, covariance=graded_covariance(k, self.correlation, epsilon, sd))


def population_of(
    mean: Any, covariance: Any, data: pd.DataFrame | None, columns: StudyColumns
) -> Conditions:
    """
    Return the population that means and a covariance, or those of data, make.

    Means are an array, or a mapping or Series that names the conditions, or of several factors is
    indexed by their levels. Means given beside data replace those of the conditions that they name,
    and leave the others out.
    """
    factors, origin = factors_of(columns), ""
    several = len(factors) > 1
    if data is not None:
        if covariance is not None or (several and mean is not None):
            raise ValueError(
                "data= takes the place of covariance=, of several factors of mean= too"
            )
        pilot_mean, covariance, origin = _pilot(data, columns)
        mean = pilot_mean if mean is None else mean
    elif columns.order is not None or (columns.dv, columns.subject) != ("value", "subject"):
        raise ValueError(
            "columns: dv, subject and order are of data=; without it the order is that of mean"
        )
    if mean is None or covariance is None:
        raise ValueError("give mean= and covariance= of the conditions, or data= to take both from")
    known = [*covariance.index] if isinstance(covariance, pd.DataFrame) else []
    if not isinstance(mean, dict | pd.Series):
        values = finite_array("mean", mean)
        same = len(known) == len(values)
        mean = pd.Series(values, known if same else range(1, len(values) + 1))
    means = pd.Series(mean, dtype=object, name="mean")
    means = pd.Series(numbers_of(means, "mean"), means.index)
    # Of one factor a label may be a tuple, which an index takes for labels of several.
    levels: Levels = {factors[0]: (*means.index,)}
    between: Levels = {}
    if several:
        named = [*means.index.names]
        if len(named) != len(factors) or ({*named} == {*factors} and named != factors):
            raise ValueError(
                f"mean must be indexed by {', '.join(map(str, factors))}, in this order, got "
                f"{named}"
            )
        levels = {name: (*means.index.unique(i),) for i, name in enumerate(factors)}
        if [*means.index] != [*product(*levels.values())]:
            raise ValueError(
                f"mean must have each cell of {factors} once, with the last factor varying "
                f"fastest: {[*product(*levels.values())]}, got {[*means.index]}"
            )
        between = {name: levels.pop(name) for name in names_of(columns.between)}
    labels = cells_of(levels)
    if known:
        both = [name for name in known if name in covariance.columns]
        if unknown := [name for name in labels if name not in both]:
            raise ValueError(
                f"mean names {unknown}, but the covariance is that of {both}, the names of its "
                "rows and columns"
            )
        covariance = covariance.loc[labels, labels]
    groups = means.to_numpy().reshape(math.prod(map(len, between.values())), -1)
    return Conditions(labels, groups if between else groups[0], covariance, origin, levels, between)


def _pilot(data: pd.DataFrame, columns: StudyColumns) -> tuple[pd.Series, pd.DataFrame, str]:
    """Return means, covariance given the groups, and origin of the scores of a pilot study."""
    of_class("data", data, pd.DataFrame, "a table of pandas with a row per person and condition")
    roles = (columns.dv, columns.within, columns.subject)
    pilot = repeated_measures(data, *roles, between=columns.between, order=columns.order)
    cells = pilot.scores.columns
    if pilot.origin:
        warn(
            f"the covariance is that of {pilot.origin}: how much people differ is assumed there, "
            "and n goes with the square of it"
        )
    names = "condition" if pilot.one_way else factors_of(columns)
    means = pilot.descriptives().set_index(names)["mean"]
    return means, pd.DataFrame(pilot.residual_covariance(), cells, cells), pilot.origin


def factors_of(columns: StudyColumns) -> list[Hashable]:
    """Return the factors of a study, those between subjects first."""
    of_class("columns", columns, StudyColumns)
    within = names_of(columns.within)
    if not within:
        raise ValueError("columns: within must name a factor")
    return [*names_of(columns.between), *within]
