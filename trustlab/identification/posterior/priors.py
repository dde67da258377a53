"""
Priors: what is taken for granted about a person, a robot and the noise before the log is read.

Each is normal in the coordinate in which a parameter is unbounded: the logarithm of a time or a
range, the log odds of a share. `docs/how_to/identify.md` has them in seconds and metres per second.
"""

from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from trustlab.identification.model import COORDINATES, Coordinate
from trustlab.identification.noise import HALF_WIDTH
from trustlab.identification.posterior.density import BETA, SHARED
from trustlab.models.checks import finite_number, of_class, one_of, positive
from trustlab.models.published import published_models

# Coordinates in which a parameter is unbounded, by name.
LOGARITHM = "logarithm"
LOG_ODDS = "log odds"
PLAIN = "plain"
SCALES = {
    LOGARITHM: Coordinate(np.log, np.exp),
    LOG_ODDS: COORDINATES["odds"],
    PLAIN: COORDINATES["plain"],
}


@dataclass(frozen=True)
class Normal:
    """
    A normal distribution of a parameter in its unbounded coordinate.

    Parameters
    ----------
    median : float
        Median, in the parameter's own unit.
    spread : float
        Standard deviation in the coordinate.
    scale : {"logarithm", "log odds", "plain"}
        The coordinate.
    """

    median: float
    spread: float
    scale: str

    @property
    def mean(self) -> float:
        """Mean in the coordinate."""
        return float(SCALES[self.scale].to(self.median))

    def interval(self) -> tuple[float, float]:
        """Return the 95 % interval in the parameter's own unit."""
        ends = self.mean + np.array([-1.0, 1.0]) * HALF_WIDTH * self.spread
        low, high = SCALES[self.scale].back(ends)
        return float(low), float(high)


@dataclass(frozen=True)
class Prior:
    """
    Prior of `sample_posterior`, as medians and spreads; the defaults are "weak".

    A pair (median, spread) replaces a parameter's own: the spread is a standard deviation of the
    natural logarithm of times, ranges and noise, of the log odds of shares, and of the value itself
    for the rest. Performance is in the unit of the measure: m/s for (2.4) and (2.7), where these
    defaults come from. For another measure state the four performances and the noise.

    Parameters
    ----------
    human_time_constant : tuple
        Of utilization [s].
    beta : tuple
        Utilization of greatest performance.
    human_p_min, human_span : tuple
        Least human performance, and the greatest less the least.
    robot_time_constant : tuple
        Of robot performance [s].
    robot_p_min, robot_span : tuple
        Least robot performance, and the greatest less the least.
    r0 : tuple
        Utilization at the first sample of a run.
    p_r0 : tuple
        Robot performance at the first sample of a run, less robot_p_min.
    white, slow : tuple
        Standard deviation of white and of first-order noise, per sample.
    slow_time : tuple
        Time constant of first-order noise [s].
    mode_delay : tuple
        By how much the mode acts later than it is stamped [s]; used with mode_delay=True.
    correlation : numpy.ndarray, optional
        Correlations of the first seven, shape (7, 7); none by default.

    Raises
    ------
    ValueError
        If a median or a spread makes no distribution.

    Examples
    --------
    >>> import trustlab as tl
    >>> prior = tl.Prior(human_p_min=(0.7, 0.2), human_span=(0.2, 0.7))  # a share of 1
    >>> prior.table().loc["human_time_constant"].round(0).tolist()
    [150.0, 38.0, 591.0]
    """

    human_time_constant: Normal = Normal(150.0, 0.7, LOGARITHM)
    beta: Normal = Normal(0.73, 1.2, LOG_ODDS)
    human_p_min: Normal = Normal(0.40, 0.10, PLAIN)
    human_span: Normal = Normal(0.05, 0.7, LOGARITHM)
    robot_time_constant: Normal = Normal(30.0, 0.7, LOGARITHM)
    robot_p_min: Normal = Normal(0.25, 0.10, PLAIN)
    robot_span: Normal = Normal(0.13, 0.7, LOGARITHM)
    r0: Normal = Normal(0.12, 1.5, LOG_ODDS)
    p_r0: Normal = Normal(0.0, 0.1, PLAIN)
    white: Normal = Normal(0.005, 1.2, LOGARITHM)
    slow: Normal = Normal(0.003, 1.5, LOGARITHM)
    slow_time: Normal = Normal(8.0, 0.8, LOGARITHM)
    mode_delay: Normal = Normal(0.0, 1.0, PLAIN)
    correlation: np.ndarray | None = None

    def __post_init__(self):
        for name, default in DEFAULTS.items():
            stated = getattr(self, name)
            if not isinstance(stated, Normal):
                object.__setattr__(self, name, _stated(name, stated, default))
        if self.correlation is not None:
            matrix = np.asarray(self.correlation, dtype=float)
            if matrix.shape != (SHARED, SHARED) or not np.allclose(np.diag(matrix), 1.0):
                raise ValueError(
                    f"correlation must be a ({SHARED}, {SHARED}) matrix with unit diagonal, got "
                    f"shape {matrix.shape}"
                )

    def shared(self) -> list[Normal]:
        """Return the distributions of the first seven parameters."""
        return [getattr(self, name) for name in SHARED_NAMES]

    def table(self) -> pd.DataFrame:
        """
        Return what the prior means in the units of the parameters.

        Returns
        -------
        pandas.DataFrame
            Index `parameter`; columns median, low and high, the ends of the 95 % interval.
        """
        normals = [getattr(self, name) for name in DEFAULTS]
        rows = [(normal.median, *normal.interval()) for normal in normals]
        index = pd.Index(DEFAULTS, name="parameter")
        return pd.DataFrame(rows, index, columns=["median", "low", "high"])

    def vectors(self, runs: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """
        Return mean, standard deviations and whitening factor of θ, for a number of runs.

        Parameters
        ----------
        runs : int
            Number of runs, each with initial states of its own.
        """
        noise = [self.white, self.slow, self.slow_time]
        normals = [*self.shared(), *noise, *noise, self.mode_delay]
        normals += [self.r0, self.p_r0] * runs
        mean, deviation = np.array([(normal.mean, normal.spread) for normal in normals]).T.copy()
        whitening = np.diag(1.0 / deviation)
        if self.correlation is not None:
            factor = np.linalg.cholesky(np.asarray(self.correlation, dtype=float))
            scaled = np.linalg.inv(factor) / deviation[:SHARED]
            whitening[:SHARED, :SHARED] = np.tril(scaled)
        return mean, deviation, whitening


SHARED_NAMES = (
    "human_time_constant",
    "beta",
    "human_p_min",
    "human_span",
    "robot_time_constant",
    "robot_p_min",
    "robot_span",
)

DEFAULTS: dict[str, Normal] = {
    name: value for name, value in vars(Prior).items() if isinstance(value, Normal)
}


def _stated(name: str, stated, default: Normal) -> Normal:
    """Return a user's pair as a distribution in the parameter's own coordinate."""
    try:
        median, spread = stated
    except (TypeError, ValueError):
        raise ValueError(f"{name} must be a pair (median, spread), got {stated!r}") from None
    spread = positive(f"spread of {name}", spread)
    median = finite_number(f"median of {name}", median)
    if default.scale != PLAIN:
        positive(f"median of {name}", median)
    if default.scale == LOG_ODDS and median >= 1.0:
        raise ValueError(f"median of {name} must lie in (0, 1), got {median}")
    return Normal(median, spread, default.scale)


def transformed(models) -> np.ndarray:
    """Return the first seven parameters of models in their coordinates, at steps of 0.1 s."""
    rows = []
    for tsc in models:
        own = [
            [np.log(0.1 * model.time_constant), model.p_min, np.log(model.p_max - model.p_min)]
            for model in (tsc.human, tsc.robot)
        ]
        rows.append(np.insert(np.ravel(own), BETA, SCALES[LOG_ODDS].to(tsc.human.beta)))
    return np.array(rows)


def prior_of(mean: np.ndarray, covariance: np.ndarray, prior: Prior | None = None) -> Prior:
    """Return a prior with another mean and covariance of the first seven, in their coordinates."""
    deviation = np.sqrt(np.diag(covariance))
    changes = {}
    for name, centre, spread in zip(SHARED_NAMES, mean, deviation, strict=True):
        scale = DEFAULTS[name].scale
        changes[name] = Normal(float(SCALES[scale].back(centre)), float(spread), scale)
    correlation = covariance / np.outer(deviation, deviation)
    return replace(prior or Prior(), correlation=correlation, **changes)


# Least spreads of the prior made of the printed people, as shares of the weak prior's.
LEAST_SPREAD = 0.25


def _published() -> Prior:
    """Return the spread of the six printed people as a prior, a half wider."""
    values = transformed(published_models().values())
    weak = [normal.spread for normal in Prior().shared()]
    spread = np.maximum(1.5 * values.std(axis=0, ddof=1), LEAST_SPREAD * np.array(weak))
    return prior_of(values.mean(axis=0), np.diag(spread**2))


PRIORS = {"weak": Prior, "published": _published}


def as_prior(prior: str | Prior) -> Prior:
    """Return a prior by name, or the user's own."""
    if isinstance(prior, str):
        return PRIORS[one_of("prior", prior, PRIORS, "a Prior")]()
    return of_class("prior", prior, Prior, "trustlab.Prior(…) states one")
