"""The population that studies are drawn from, and how they are simulated."""

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy import special
from scipy.optimize import brentq

from trustlab.models.checks import (
    finite_number,
    finite_numbers,
    open_unit,
    positive,
    warn,
    whole_number,
)
from trustlab.studies.anova import Design, orthonormal_contrasts, sphericity
from trustlab.studies.planning.covariance import checked_covariance
from trustlab.studies.repeated_measures import repeated_measures
from trustlab.studies.table import labels_of, names_of

# --- settings -------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Simulation:
    """
    How studies are simulated and tested.

    Parameters
    ----------
    replicates : int
        Simulated studies per cell, at least 100.
    seed : int
        Seed of the draws. All populations of a size share their draws, whatever their place in
        a grid.
    alpha : float
        Level of all tests, in (0, 1).
    level : float
        Coverage of the Monte-Carlo intervals (Clopper–Pearson), in (0, 1).
    n_jobs : int
        How many processes simulate studies, as in `run_campaign`; no effect on results.

    Raises
    ------
    ValueError
        If a number is out of range.
    """

    replicates: int = 10_000
    seed: int = 0
    alpha: float = 0.05
    level: float = 0.95
    n_jobs: int = 1

    def __post_init__(self):
        open_unit("alpha", self.alpha)
        open_unit("level", self.level)
        whole_number("replicates", self.replicates, least=100, most=10_000_000)
        whole_number("seed", self.seed, least=0)


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

    @property
    def factors(self) -> list:
        """The factors within subjects."""
        return names_of(self.within)

    @property
    def groups(self) -> list:
        """The factors between subjects."""
        return names_of(self.between)

    @property
    def several(self) -> bool:
        """Whether there is more than one factor."""
        return len(self.factors) > 1 or bool(self.groups)


USUAL_SIMULATION = Simulation()
USUAL_COLUMNS = StudyColumns()


# --- the population -------------------------------------------------------------------------------


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
    k = whole_number("k", k, least=2, most=1000)
    rho, eps = finite_number("correlation", correlation), finite_number("epsilon", epsilon)
    sd = positive("sd", sd)
    d = k - 1
    if not -1.0 / d < rho < 1.0:
        raise ValueError(
            f"correlation must lie between −1/(k − 1) = {-1.0 / d:.4g} and 1, got {rho}"
        )
    if not (1.0 / d < eps <= 1.0 + 1e-12 or (d == 1 and abs(eps - 1.0) < 1e-12)):
        raise ValueError(
            f"epsilon must lie above 1/(k − 1) = {1.0 / d:.4g} and be at most 1, got {eps}"
        )

    def shares(log_ratio: float) -> np.ndarray:
        return special.softmax(log_ratio * np.arange(d))

    ratio = 0.0
    if d > 1 and eps < 1.0 - 1e-12:
        ratio = brentq(
            lambda x: 1.0 / (d * (shares(x) ** 2).sum()) - eps, -60.0, 0.0, xtol=1e-14, rtol=1e-14
        )
    variances = d * sd**2 * (1.0 - rho) * shares(ratio)
    # Powers of x span the same spaces, but are nearly dependent beyond a dozen conditions.
    points = np.polynomial.legendre.legvander(np.linspace(-1.0, 1.0, k), d)
    basis = np.linalg.qr(points)[0]
    together = sd**2 * (1.0 + d * rho)
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
    within: Mapping[str, Sequence] = field(default_factory=dict)
    between: Mapping[str, Sequence] = field(default_factory=dict)

    def __post_init__(self):
        labels = labels_of("labels", self.labels, 2)
        mean = finite_numbers("mean", self.mean)
        if mean.shape[-1:] != (len(labels),):
            raise ValueError(f"mean must have {len(labels)} conditions, got shape {mean.shape}")
        covariance = checked_covariance("covariance", self.covariance, len(labels))
        within = self.within or {"condition": labels}
        self.__dict__.update(labels=labels, mean=mean, covariance=covariance, within=within)

    @property
    def simulated_origin(self) -> str:
        """Where results of studies drawn from this population come from, for captions."""
        return "simulated studies" + (f", from {self.origin}" if self.origin else "")

    @property
    def several(self) -> bool:
        """Whether there is more than one factor."""
        return len(self.within) > 1 or bool(self.between)

    @property
    def contrasts(self) -> np.ndarray:
        """Covariance of orthonormal contrasts, shape (k − 1, k − 1)."""
        c = orthonormal_contrasts(len(self.labels))
        return c.T @ self.covariance @ c

    @property
    def epsilon(self) -> float:
        """ε of the population; 1 where sphericity holds."""
        return float(sphericity(self.contrasts, len(self.labels))["epsilon_gg"])

    @property
    def correlation(self) -> float:
        """Mean covariance between conditions over their mean variance."""
        trace = np.trace(self.covariance)
        return float((self.covariance.sum() / trace - 1.0) / (len(self.labels) - 1))

    @property
    def eta2_partial(self) -> float:
        """
        Partial η² of the population, S / (S + tr M), S = Σ (μ_j − μ)² and M the covariance of
        contrasts.
        """
        effect = ((self.mean - self.mean.mean()) ** 2).sum()
        return float(effect / (effect + np.trace(self.contrasts)))

    @property
    def d_z(self) -> np.ndarray:
        """Standardized differences of all pairs a < b, mean over SD of a − b."""
        a, b = np.triu_indices(len(self.labels), 1)
        s = self.covariance
        return (self.mean[a] - self.mean[b]) / np.sqrt(s[a, a] + s[b, b] - 2.0 * s[a, b])

    def design(self, n: int) -> tuple[np.ndarray, Design]:
        """
        Return the group of every participant and the design.

        Parameters
        ----------
        n : int
            Participants in each group.
        """
        groups = np.repeat(np.arange(len(np.atleast_2d(self.mean))), n)
        codes = np.unravel_index(groups, [len(levels) for levels in self.between.values()] or [1])
        numbers = dict(zip(self.between, codes, strict=False))
        return groups, Design(len(groups), self.within, self.between, numbers)

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
        if not 0.0 <= eta2 < 1.0:
            raise ValueError(f"effect_size is a population partial η², in [0, 1), got {eta2}")
        if eta2 > 0.0 and np.ptp(self.mean) <= 1e-12 * np.abs(self.mean).max():
            raise ValueError(
                "effect_size scales differences between means, but all means are the same"
            )
        apart = self.mean - self.mean.mean()
        target = eta2 / (1.0 - eta2) * np.trace(self.contrasts)
        scale = np.sqrt(target / (apart**2).sum()) if eta2 > 0.0 else 0.0
        return replace(self, mean=self.mean.mean() + apart * scale)

    def varied(
        self, effect_size: float | None, correlation: float | None, epsilon: float | None
    ) -> "Conditions":
        """
        Return the population with `graded_covariance` of the same mean variance and with a given
        partial η²; what is None stays as it is.

        Parameters
        ----------
        effect_size : float or None
            As for `with_effect`.
        correlation, epsilon : float or None
            As for `graded_covariance`.
        """
        people = self
        if correlation is not None or epsilon is not None:
            k = len(self.labels)
            rho = self.correlation if correlation is None else correlation
            eps = self.epsilon if epsilon is None else epsilon
            sd = float(np.sqrt(np.trace(self.covariance) / k))
            people = replace(self, covariance=graded_covariance(k, rho, eps, sd))
        return people if effect_size is None else people.with_effect(effect_size)


def conditions_from(mean: Any, covariance: Any, data: Any, columns: StudyColumns) -> Conditions:
    """
    Return the population that means and a covariance, or those of data, make.

    Means are an array, or a mapping or Series that names the conditions; a DataFrame as covariance
    names them too. With several factors they are a Series indexed by their levels. Of data, the
    sample means and covariance are taken for the population's; means given beside data replace
    those of the conditions that they name, and leave the others out.
    """
    origin = ""
    mean = pd.Series(mean) if isinstance(mean, dict) else mean
    if data is not None:
        if covariance is not None:
            raise ValueError("give either data= or covariance=, not both")
        mean, covariance, origin = _moments_of_data(data, mean, columns)
    if mean is None or covariance is None:
        raise ValueError(
            "power needs mean= and covariance= of the conditions, or data= to take both from"
        )
    if columns.several:
        return _conditions_of_cells(pd.Series(mean, dtype=float), covariance, columns, origin)
    labels = [*mean.index] if isinstance(mean, pd.Series) else None
    if isinstance(covariance, pd.DataFrame):
        labels = labels or [*covariance.index]
        if not labels == [*covariance.index] == [*covariance.columns]:
            raise ValueError(
                f"covariance must have the conditions {labels} in rows and columns, in this order"
            )
    means = finite_numbers("mean", mean)
    return Conditions(labels or range(1, means.size + 1), means, np.asarray(covariance), origin)


def _conditions_of_cells(
    mean: pd.Series, covariance: Any, columns: StudyColumns, origin: str
) -> Conditions:
    """Return the population of means indexed by the levels of several factors."""
    names = [*map(str, columns.groups), *map(str, columns.factors)]
    if mean.index.nlevels != len(names):
        raise ValueError(f"mean must be indexed by {', '.join(names)}")
    levels = {name: tuple(mean.index.unique(i)) for i, name in enumerate(names)}
    cells = mean.reindex(pd.MultiIndex.from_product(levels.values()))
    if cells.isna().any():
        raise ValueError(
            f"mean: no number for cell {cells.index[cells.isna()][0]!r} of {' × '.join(names)}"
        )
    between = {str(name): levels.pop(str(name)) for name in columns.groups}
    labels = tuple(product(*levels.values()))
    means = cells.to_numpy().reshape(-1, len(labels))
    means = means if between else means[0]
    return Conditions(labels, means, np.asarray(covariance), origin, levels, between)


def _moments_of_data(data: Any, mean: Any, columns: StudyColumns) -> tuple[Any, Any, str]:
    """Return means, those of data if there are no others, with data's covariance and origin."""
    between = columns.groups or None
    roles = (columns.dv, columns.within, columns.subject)
    pilot = repeated_measures(data, *roles, between=between, order=columns.order)
    covariance, means = pilot.residual_covariance(), pilot.descriptives()["mean"]
    if columns.several:
        if mean is not None:
            raise ValueError("mean has no effect here; leave it out")
        cells = product(*pilot.between.values(), *pilot.within.values())
        return means.set_axis(pd.MultiIndex.from_tuples(cells)), covariance, pilot.origin
    if pilot.origin:
        warn(
            f"the covariance is that of {pilot.origin}: how much people differ is assumed there, "
            "and n goes with the square of it; SmallestN.apa() says what half and twice the "
            "spread would ask for"
        )
    names = pd.Index(pilot.conditions, tupleize_cols=False)
    frame = pd.DataFrame(covariance, names, names)
    if isinstance(mean, pd.Series):
        if unknown := [name for name in mean.index if name not in names]:
            raise ValueError(f"mean names {unknown}, but data hold the conditions {[*names]}")
        frame = frame.loc[mean.index, mean.index]
    return means.set_axis(names) if mean is None else mean, frame, pilot.origin


# --- closed forms ---------------------------------------------------------------------------------


def exceeds_critical(df1: float, df2: float, strength: float, alpha: float) -> float:
    """Return the probability that noncentral F exceeds its critical value."""
    return float(1.0 - special.ncfdtr(df1, df2, strength, special.fdtri(df1, df2, 1.0 - alpha)))


def clopper_pearson(
    count: ArrayLike, total: int, level: float = 0.95
) -> tuple[np.ndarray, np.ndarray]:
    """
    Return the exact interval of a share of which `count` in `total` draws were found (Clopper and
    Pearson, 1934).

    Parameters
    ----------
    count : array_like of int
        How often, from 0 to `total`.
    total : int
        Draws.
    level : float
        Coverage.

    Returns
    -------
    low, high : numpy.ndarray
        Limits, of the shape of `count`.

    Raises
    ------
    ValueError
        If a count is not whole or lies outside 0 to `total`.
    """
    total, level = whole_number("total", total), open_unit("level", level)
    counts = np.asarray(count)
    if counts.dtype.kind not in "iu" or ((counts < 0) | (counts > total)).any():
        raise ValueError(f"count must hold whole numbers from 0 to {total}, got {count!r:.60}")
    from statsmodels.stats.proportion import proportion_confint

    low, high = proportion_confint(counts, total, alpha=1.0 - level, method="beta")
    return np.asarray(low), np.asarray(high)
