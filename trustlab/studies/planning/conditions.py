"""
The population that studies are drawn from, how they are simulated, and power in closed form:
noncentral F where sphericity holds, Box's approximation elsewhere.
"""

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
    counted,
    finite_array,
    finite_number,
    not_negative,
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

    labels: tuple[Hashable, ...]
    mean: np.ndarray
    covariance: np.ndarray
    origin: str = ""
    within: Mapping[str, Sequence] = field(default_factory=dict)
    between: Mapping[str, Sequence] = field(default_factory=dict)

    def __post_init__(self):
        mean = self.mean if self.between else finite_array("mean", self.mean)
        k = mean.shape[-1]
        if k < 2:
            raise ValueError(f"mean must have at least two conditions, got {k}")
        matrix = checked_covariance("covariance", self.covariance, k)
        labels = labels_of("labels", self.labels, k)
        if len(labels) != k:
            raise ValueError(f"labels must name {k} conditions, each once, got {labels!r:.200}")
        for name, value in (("labels", labels), ("mean", mean), ("covariance", matrix)):
            object.__setattr__(self, name, value)
        object.__setattr__(self, "within", self.within or {"condition": labels})

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
        k = len(self.labels)
        trace = np.trace(self.covariance)
        return float((self.covariance.sum() - trace) / (trace * (k - 1)))

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
        apart = self.mean - self.mean.mean()
        now = np.sqrt((apart**2).sum())
        if eta2 > 0.0 and now <= 1e-12 * max(np.abs(self.mean).max(), 1e-300):
            raise ValueError(
                "effect_size scales differences between means, but all means are the same"
            )
        target = np.sqrt(eta2 / (1.0 - eta2) * np.trace(self.contrasts))
        return replace(self, mean=self.mean.mean() + apart * (target / now if eta2 > 0.0 else 0.0))

    def with_structure(self, correlation: float | None, epsilon: float | None) -> "Conditions":
        """
        Return the population with `graded_covariance` of the same mean variance; what is None stays
        as it is.

        Parameters
        ----------
        correlation, epsilon : float or None
            As for `graded_covariance`.
        """
        if correlation is None and epsilon is None:
            return self
        k = len(self.labels)
        rho = self.correlation if correlation is None else correlation
        eps = self.epsilon if epsilon is None else epsilon
        sd = float(np.sqrt(np.trace(self.covariance) / k))
        return replace(self, covariance=graded_covariance(k, rho, eps, sd))


def conditions_from(mean: Any, covariance: Any, data: Any, columns: StudyColumns) -> Conditions:
    """
    Return the population that means and a covariance, or those of data, make.

    Means are an array, or a mapping or Series that names the conditions; a DataFrame as covariance
    names them too. With several factors they are a Series indexed by their levels. Of data, the
    sample means and covariance are taken for the population's; means given beside data replace
    those of the conditions that they name, and leave the others out.
    """
    mean = pd.Series(mean) if isinstance(mean, dict) else mean
    if data is not None:
        if covariance is not None:
            raise ValueError("give either data= or covariance=, not both")
        return _conditions_of_data(data, mean, columns)
    if mean is None or covariance is None:
        raise ValueError(
            "power needs mean= and covariance= of the conditions, or data= to take both from"
        )
    if columns.several:
        return _conditions_of_cells(pd.Series(mean, dtype=float), covariance, columns)
    names = list(mean.index) if isinstance(mean, pd.Series) else None
    if isinstance(covariance, pd.DataFrame):
        if list(covariance.index) != list(covariance.columns):
            raise ValueError(
                "covariance must have the same conditions in rows and columns, in the same order"
            )
        if names is not None and list(covariance.columns) != names:
            raise ValueError(
                f"mean has conditions {names}, but covariance {list(covariance.columns)}"
            )
        names, covariance = list(covariance.columns), covariance.to_numpy()
    means = finite_array("mean", mean)
    labels: Any = names or range(1, means.size + 1)
    return Conditions(labels, means, covariance)


def _conditions_of_cells(mean: pd.Series, covariance: Any, columns: StudyColumns) -> Conditions:
    """Return the population of means indexed by the levels of several factors."""
    names = [*map(str, columns.groups), *map(str, columns.factors)]
    if mean.index.nlevels != len(names):
        given = counted(mean.index.nlevels, "level")
        raise ValueError(f"mean must be indexed by {', '.join(names)}, got {given}")
    levels = {name: tuple(mean.index.unique(i)) for i, name in enumerate(names)}
    cells = mean.reindex(pd.MultiIndex.from_product(levels.values()))
    if cells.isna().any():
        raise ValueError(
            f"mean: no number for cell {cells.index[cells.isna()][0]!r} of {' × '.join(names)}"
        )
    between = {name: levels.pop(name) for name in names[: len(columns.groups)]}
    labels = tuple(product(*levels.values()))
    means = cells.to_numpy().reshape(-1, len(labels))
    return Conditions(
        labels, means if between else means[0], covariance, within=levels, between=between
    )


def _conditions_of_data(data: Any, mean: Any, columns: StudyColumns) -> Conditions:
    """Return the population with the covariance of data, and their means where none are given."""
    pilot = repeated_measures(
        data,
        columns.dv,
        columns.within,
        columns.subject,
        between=columns.groups or None,
        order=columns.order,
    )
    matrix = pilot.residual_covariance()
    means = pilot.descriptives()["mean"].to_numpy()
    if columns.several:
        if mean is not None:
            raise ValueError("mean has no effect here; leave it out")
        within = {str(name): levels for name, levels in pilot.within.items()}
        between = {str(name): levels for name, levels in pilot.between.items()}
        labels = tuple(product(*within.values()))
        means = means.reshape(-1, len(labels))
        return Conditions(
            labels, means if between else means[0], matrix, pilot.origin, within, between
        )
    conditions = list(pilot.conditions)
    labels = tuple(mean.index) if isinstance(mean, pd.Series) else tuple(conditions)
    if unknown := [name for name in labels if name not in conditions]:
        raise ValueError(f"mean names {unknown}, but data hold the conditions {conditions}")
    if pilot.n <= len(labels):
        raise ValueError(
            f"data hold {pilot.n} subjects in {len(labels)} conditions: their covariance needs at "
            f"least {len(labels) + 1}"
        )
    places = [conditions.index(label) for label in labels]
    if pilot.origin:
        warn(
            f"the covariance is that of {pilot.origin}: how much people differ is assumed there, "
            "and n goes with the square of it; SmallestN.apa() says what half and twice the "
            "spread would ask for"
        )
    means = means[places] if mean is None else finite_array("mean", mean)
    return Conditions(labels, means, matrix[np.ix_(places, places)], pilot.origin)


# --- closed forms ---------------------------------------------------------------------------------


def noncentrality(eta2_partial: float, n: int, k: int) -> float:
    """
    Return λ = n (k − 1) η² / (1 − η²), the noncentrality of F at a population partial η².

    η² = S / (S + (k − 1) σ_e²) with S = Σ (μ_j − μ)² and σ_e² the mean variance of orthonormal
    contrasts, so that λ = n S / σ_e². With Cohen's f² = η² / (1 − η²).

    Parameters
    ----------
    eta2_partial : float
        Partial η² of the population, in [0, 1).
    n, k : int
        Subjects and conditions.

    Raises
    ------
    ValueError
        If η² lies outside [0, 1), or a number is not whole or too small.
    """
    eta2 = finite_number("eta2_partial", eta2_partial)
    if not 0.0 <= eta2 < 1.0:
        raise ValueError(f"eta2_partial must lie in [0, 1), got {eta2}")
    n, k = whole_number("n", n, least=2), whole_number("k", k, least=2)
    return n * (k - 1) * eta2 / (1.0 - eta2)


def noncentral_f_power(
    n: int, k: int, noncentrality: float, alpha: float = 0.05, epsilon: float = 1.0
) -> float:
    """
    Return the power of the repeated-measures F with n subjects and k conditions.

    With sphericity (ε = 1) F is exactly noncentral with k − 1 and (n − 1)(k − 1) degrees of
    freedom. Below 1 it is taken as noncentral F with both degrees of freedom and λ times ε, after
    Box: an approximation of the test with ε known, and no more than a guide. A paired t-test is the
    case k = 2 with λ = n d_z².

    Parameters
    ----------
    n, k : int
        Subjects and conditions; at least 2.
    noncentrality : float
        λ, not negative; `noncentrality(eta2_partial, n, k)` gives it.
    alpha : float
        Level of the test.
    epsilon : float
        ε of the population, from 1/(k − 1) to 1.

    Raises
    ------
    ValueError
        If an argument is out of range.

    References
    ----------
    G. E. P. Box, Annals of Mathematical Statistics 25 (1954) 290-302 and 484-498.
    """
    n, k = whole_number("n", n, least=2), whole_number("k", k, least=2)
    value = not_negative("noncentrality", noncentrality)
    alpha, epsilon = open_unit("alpha", alpha), finite_number("epsilon", epsilon)
    if not 1.0 / (k - 1) - 1e-12 <= epsilon <= 1.0 + 1e-12:
        raise ValueError(
            f"epsilon must lie in [1/(k − 1), 1] = [{1.0 / (k - 1):.4g}, 1], got {epsilon}"
        )
    df1, df2 = epsilon * (k - 1), epsilon * (k - 1) * (n - 1)
    return exceeds_critical(df1, df2, epsilon * value, alpha)


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
