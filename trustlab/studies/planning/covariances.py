"""
Covariances of conditions: checked, measured from data, and built to a wanted correlation and
sphericity.
"""

from collections.abc import Hashable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import brentq

from trustlab.models.checks import (
    finite_array,
    finite_number,
    positive,
    warn,
    whole_number,
)
from trustlab.studies.anova import orthonormal_contrasts, sphericity
from trustlab.studies.planning.settings import StudyColumns
from trustlab.studies.table import labels_of
from trustlab.testbeds.covariance import checked_covariance


@dataclass(frozen=True, eq=False)
class Conditions:
    """
    Population from which studies are drawn: normal scores with these means and this covariance.

    Parameters
    ----------
    labels : tuple
        Conditions.
    mean : numpy.ndarray, shape (k,)
        Their means.
    covariance : numpy.ndarray, shape (k, k)
        Positive definite.
    origin : str
        Where they come from, if not given as numbers ("reconstructed data" …).

    Raises
    ------
    ValueError
        If sizes differ, labels repeat, or the covariance is not positive definite.
    """

    labels: tuple[Hashable, ...]
    mean: np.ndarray
    covariance: np.ndarray
    origin: str = ""

    def __post_init__(self):
        mean = finite_array("mean", self.mean)
        if mean.size < 2:
            raise ValueError(f"mean must have at least two conditions, got {mean.size}")
        matrix = checked_covariance("covariance", self.covariance, mean.size)
        labels = labels_of("labels", self.labels, mean.size)
        if len(labels) != mean.size:
            raise ValueError(
                f"labels must name {mean.size} conditions, each once, got {labels!r:.200}"
            )
        for name, value in (("labels", labels), ("mean", mean), ("covariance", matrix)):
            object.__setattr__(self, name, value)

    @property
    def simulated_origin(self) -> str:
        """
        Where the results of studies drawn from this population come from, for headers and captions.
        """
        return "simulated studies" + (f", from {self.origin}" if self.origin else "")

    @property
    def contrasts(self) -> np.ndarray:
        """Covariance of orthonormal contrasts, shape (k − 1, k − 1)."""
        c = orthonormal_contrasts(len(self.mean))
        return c.T @ self.covariance @ c

    @property
    def epsilon(self) -> float:
        """ε of the population; 1 where sphericity holds."""
        return float(sphericity(self.contrasts, len(self.mean))["epsilon_gg"])

    @property
    def correlation(self) -> float:
        """Mean covariance between conditions over their mean variance."""
        k = len(self.mean)
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
        a, b = np.triu_indices(len(self.mean), 1)
        s = self.covariance
        return (self.mean[a] - self.mean[b]) / np.sqrt(s[a, a] + s[b, b] - 2.0 * s[a, b])

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
        wanted = np.sqrt(eta2 / (1.0 - eta2) * np.trace(self.contrasts))
        mean = self.mean.mean() + apart * (wanted / now if eta2 > 0.0 else 0.0)
        return Conditions(self.labels, mean, self.covariance, self.origin)

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
        k = len(self.mean)
        rho = self.correlation if correlation is None else correlation
        eps = self.epsilon if epsilon is None else epsilon
        matrix = graded_covariance(k, rho, eps, float(np.sqrt(np.trace(self.covariance) / k)))
        return Conditions(self.labels, self.mean, matrix, self.origin)


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
        values = np.exp(log_ratio * np.arange(d))
        return values / values.sum()

    ratio = 0.0
    if d > 1 and eps < 1.0 - 1e-12:
        ratio = brentq(
            lambda x: 1.0 / (d * (shares(x) ** 2).sum()) - eps, -60.0, 0.0, xtol=1e-14, rtol=1e-14
        )
    variances = d * sd**2 * (1.0 - rho) * shares(ratio)
    # Powers are nearly dependent beyond a dozen conditions; cosines are orthogonal, and as smooth.
    if k <= 12:
        points = np.vander(np.linspace(-1.0, 1.0, k), k, increasing=True)
    else:
        points = np.cos(np.pi * np.outer(np.arange(k) + 0.5, np.arange(k)) / k)
    basis = np.linalg.qr(points)[0]
    together = sd**2 * (1.0 + d * rho)
    return basis @ np.diag(np.r_[together, variances]) @ basis.T


def conditions_from(mean: Any, covariance: Any, data: Any, columns: StudyColumns) -> Conditions:
    """
    Return the population that means and a covariance, or those of data, make.

    Means are an array, or a mapping or Series that names the conditions; a DataFrame as covariance
    names them too. Of data, the sample means and covariance are taken for the population's; means
    given beside data replace those of the conditions that they name, and leave the others out.
    """
    import pandas as pd

    if isinstance(mean, dict):
        mean = pd.Series(mean)
    if data is not None:
        if covariance is not None:
            raise ValueError("give either data= or covariance=, not both")
        return _conditions_of_data(data, mean, columns)
    if mean is None or covariance is None:
        raise ValueError(
            "power needs mean= and covariance= of the conditions, or data= to take both from"
        )
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


def _conditions_of_data(data: Any, mean: Any, columns: StudyColumns) -> Conditions:
    """Return the population with the covariance of data, and their means where none are given."""
    import pandas as pd

    from trustlab.studies.table import complete_scores, read_scores

    factor = columns.factors[0]
    frame = read_scores(data, columns.dv, factor, columns.subject, order=columns.order)
    scores, _ = complete_scores(frame)
    labels = list(scores.conditions)
    if isinstance(mean, pd.Series):
        if unknown := [name for name in mean.index if name not in labels]:
            raise ValueError(f"mean names {unknown}, but data hold the conditions {labels}")
        labels = list(mean.index)
    values = scores.values[:, [scores.conditions.index(label) for label in labels]]
    n, k = values.shape
    if n <= k:
        raise ValueError(
            f"data hold {n} subjects in {k} conditions: their covariance needs at least {k + 1}"
        )
    matrix = checked_covariance("covariance of data", np.cov(values.T))
    if scores.origin:
        warn(
            f"the covariance is that of {scores.origin}: how much people differ is assumed there, "
            "and n goes with the square of it; SmallestN.apa() says what half and twice the "
            "spread would ask for"
        )
    means = values.mean(axis=0) if mean is None else finite_array("mean", mean)
    return Conditions(tuple(labels), means, matrix, scores.origin)
