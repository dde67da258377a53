"""What every model of trust has in common: events, beliefs about trust, ratings that follow."""

from collections.abc import Callable
from dataclasses import dataclass, field, fields
from typing import Any, ClassVar, NamedTuple

import numpy as np
import scipy

from trustlab.models.checks import between, finite_number, shown

# Least probability of a rating: a rating that a model excludes costs 69 nats, not infinitely many.
LEAST = 1e-30
# How close to an end of its range a parameter may start.
MARGIN = 1e-6
# Of a normal distribution: √(2π); where nothing is left of it; width of a cell that is nearly a
# point [standard deviations].
ROOT = np.sqrt(2.0 * np.pi)
FAR = 37.0
NARROW = 1e-3


class Event(NamedTuple):
    """
    What happened in one trial or sample; numbers, or arrays with a row per person.

    Parameters
    ----------
    dt : float or numpy.ndarray
        Its length: seconds, or 1 for a trial; rates of "performance" and "asymmetric" are per unit
        of it, and other models count events.
    p_r, p_h : float or numpy.ndarray
        Performance of robot and person, 0 to 1.
    fault : float or numpy.ndarray
        Size of a fault of the robot.
    mode : float or numpy.ndarray
        1 manual, 0 automatic.
    followed : float or numpy.ndarray
        1 where the person relied on the robot, 0 where not, NaN where nobody asked.
    seen : float or numpy.ndarray
        1 where the person saw how the robot performed.
    """

    dt: Any = 1.0
    p_r: Any = 0.5
    p_h: Any = 0.5
    fault: Any = 0.0
    mode: Any = 0.0
    followed: Any = np.nan
    seen: Any = 1.0


def cell(rating: np.ndarray, resolution: float) -> tuple[np.ndarray, np.ndarray]:
    """
    Return the ends of what is rounded to a rating; those at the ends of the scale are open. Where
    nobody rounds, both are the rating.
    """
    if not resolution:
        return rating, rating
    half = 0.5 * resolution
    low = np.where(rating - half <= 0.0, -np.inf, rating - half)
    return low, np.where(rating + half >= 1.0, np.inf, rating + half)


class NormalRating(NamedTuple):
    """
    Ratings that are normal; what lies beyond the scale is rated as its end.

    Parameters
    ----------
    mean, sd : numpy.ndarray, shape (N,)
        Mean and standard deviation, before the ends of the scale cut them.
    """

    mean: np.ndarray
    sd: np.ndarray

    @property
    def expected(self) -> np.ndarray:
        """The expected rating: none is beyond the scale."""
        return self._ramp(0.0) - self._ramp(1.0)

    def _ramp(self, end: float) -> np.ndarray:
        """Return by how much ratings are expected to exceed a number."""
        z = (self.mean - end) / self.sd
        return self.sd * (z * scipy.special.ndtr(z) + np.exp(-0.5 * z * z) / ROOT)

    def within(self, low, high) -> tuple[np.ndarray, np.ndarray]:
        """
        Return mean and variance of what was rounded to a rating, before the ends cut it.

        Parameters
        ----------
        low, high : array_like, shape (N,)
            Ends of what is rounded to the rating.
        """
        # In standard deviations from the mean, turned over where that side is nearer to it.
        low, high = (np.subtract(end, self.mean) / self.sd for end in (low, high))
        sign = np.where(low + high < 0.0, -1.0, 1.0)
        low, high = np.minimum(sign * low, sign * high), np.maximum(sign * low, sign * high)
        low = np.maximum(low, -FAR)
        high = np.minimum(high, low + NARROW**-2)
        middle, width = 0.5 * (low + high), high - low
        # The density at the upper end, and the probability, by the density at the lower end.
        fall = np.exp(-middle * width)
        mass = scipy.special.erfcx(low / np.sqrt(2.0))
        mass = 0.5 * ROOT * (mass - fall * scipy.special.erfcx(high / np.sqrt(2.0)))
        # Of a narrow cell the series: the closed form is a difference of like numbers there.
        narrow = width < NARROW
        mass = np.where(narrow, 1.0, mass)
        mean = np.where(narrow, middle * (1.0 - width**2 / 12.0), -np.expm1(-middle * width) / mass)
        variance = 1.0 + (low - high * fall) / mass - mean**2
        variance = np.where(narrow, width**2 / 12.0, np.clip(variance, 0.0, 1.0))
        return self.mean + sign * self.sd * mean, self.sd**2 * variance

    def mass(self, low, high) -> np.ndarray:
        """
        Return the probability of ratings between two numbers.

        Parameters
        ----------
        low, high : array_like, shape (N,)
            Ends, 0 to 1; beyond the scale they may be infinite.
        """
        # Differences of probabilities near 1 lose digits: the upper tail is turned over.
        sign = np.where(low > self.mean, -1.0, 1.0)
        below, above = (
            scipy.special.ndtr(sign * (end - self.mean) / self.sd) for end in (low, high)
        )
        return np.abs(above - below)

    def draw(self, rng: np.random.Generator) -> np.ndarray:
        """
        Return a rating of every person, before the ends of the scale cut it.

        Parameters
        ----------
        rng : numpy.random.Generator
            Where it is drawn from.
        """
        return rng.normal(self.mean, self.sd)


class BetaRating(NamedTuple):
    """
    Ratings that have a Beta distribution.

    Parameters
    ----------
    alpha, beta : numpy.ndarray, shape (N,)
        Its parameters.
    """

    alpha: np.ndarray
    beta: np.ndarray

    @property
    def mean(self) -> np.ndarray:
        """The expected rating."""
        return self.alpha / (self.alpha + self.beta)

    def mass(self, low, high) -> np.ndarray:
        """
        Return the probability of ratings between two numbers.

        Parameters
        ----------
        low, high : array_like, shape (N,)
            Ends, 0 to 1; beyond the scale they may be infinite.
        """
        ends = np.clip(low, 0.0, 1.0), np.clip(high, 0.0, 1.0)
        below, above = (scipy.special.betainc(self.alpha, self.beta, end) for end in ends)
        return above - below

    def draw(self, rng: np.random.Generator) -> np.ndarray:
        """
        Return a rating of every person.

        Parameters
        ----------
        rng : numpy.random.Generator
            Where it is drawn from.
        """
        return rng.beta(self.alpha, self.beta)


class GridRating(NamedTuple):
    """
    Ratings that are normal about a trust known by its probability in every bin.

    Parameters
    ----------
    weights : numpy.ndarray, shape (N, bins)
        Probabilities.
    bins : numpy.ndarray, shape (bins,)
        Trust in the middle of each.
    sd : float or numpy.ndarray, shape (N,)
        Standard deviation of a rating about trust.
    """

    weights: np.ndarray
    bins: np.ndarray
    sd: Any

    @property
    def mean(self) -> np.ndarray:
        """Expected trust."""
        return self.weights @ self.bins

    @property
    def expected(self) -> np.ndarray:
        """The expected rating: none is beyond the scale."""
        ratings = NormalRating(self.bins, np.asarray(self.sd)[..., None])
        return (self.weights * ratings.expected).sum(axis=-1)

    def mass(self, low, high) -> np.ndarray:
        """
        Return the probability of ratings between two numbers.

        Parameters
        ----------
        low, high : array_like, shape (N,)
            Ends, 0 to 1; beyond the scale they may be infinite.
        """
        low, high, sd = (np.asarray(each)[..., None] for each in (low, high, self.sd))
        return (self.weights * NormalRating(self.bins, sd).mass(low, high)).sum(axis=-1)

    def draw(self, rng: np.random.Generator) -> np.ndarray:
        """
        Return a rating of every person, before the ends of the scale cut it.

        Parameters
        ----------
        rng : numpy.random.Generator
            Where it is drawn from.
        """
        passed = np.cumsum(self.weights[:, :-1], axis=-1) < rng.random((len(self.weights), 1))
        return rng.normal(self.bins[passed.sum(axis=-1)], self.sd)


def parameter(default: float, low: float, high: float) -> Any:
    """
    Return the field of a parameter that is fitted within a range.

    Parameters
    ----------
    default : float
        Where the search starts, and the value of a model that is not fitted.
    low, high : float
        Ends of the range; high may be infinite.

    Examples
    --------
    >>> import trustlab as tl
    >>> tl.trust.parameter(0.2, 0.0, 1.0).metadata["range"]
    (0.2, 0.0, 1.0)
    """
    default, low = finite_number("default", default), finite_number("low", low)
    if not isinstance(high, int | float) or not low < high:
        raise ValueError(f"high must be a number above low = {low}, got {shown(high)}")
    return field(default=default, metadata={"range": (default, low, high)})


@dataclass(frozen=True)
class TrustDynamics:
    """
    A model of trust: what people are believed to trust, how it changes, what they rate and do.

    A subclass has its parameters as fields (`parameter`), and `start`, `step`, `learn` and
    `rating`. A belief is whatever it wants; arrays in it have a row per person. Parameters may be
    arrays, too: people who differ.
    """

    how_to_get: ClassVar[str] = "see trustlab.trust.MODELS"
    title: ClassVar[str] = ""
    # Whether `start` and `learn` take the `resolution` of ratings, too.
    rounds: ClassVar[bool] = False
    # Makes the model that is (3.2) with these parameters, where (3.2) is a case of the model: a fit
    # begins there, too.
    as_performance: ClassVar[Callable[..., Any] | None] = None

    @property
    def name(self) -> str:
        """Its title, or the name of its class."""
        return self.title or type(self).__name__

    @classmethod
    def parameters(cls) -> dict[str, tuple[float, float, float]]:
        """Return default, least and greatest value of every fitted parameter."""
        return {each.name: each.metadata["range"] for each in fields(cls) if each.metadata}

    def __post_init__(self):
        for name, (_, low, high) in self.parameters().items():
            for value in np.ravel(getattr(self, name)):
                between(name, value, low, high)

    def start(self, rating) -> Any:
        """
        Return the belief after a first rating; NaN where a person gave none.

        Parameters
        ----------
        rating : array_like, shape (N,)
            Ratings, 0 to 1.
        """
        raise NotImplementedError(f"{self.name} has no method start")

    def step(self, belief: Any, event: Event) -> Any:
        """
        Return the belief after an event.

        Parameters
        ----------
        belief : Any
            The belief before it.
        event : Event
            What happened.
        """
        raise NotImplementedError(f"{self.name} has no method step")

    def learn(self, belief: Any, rating) -> Any:
        """
        Return the belief after a rating; unchanged where it is NaN.

        Parameters
        ----------
        belief : Any
            The belief before it.
        rating : array_like, shape (N,)
            Ratings, 0 to 1.
        """
        raise NotImplementedError(f"{self.name} has no method learn")

    def rating(self, belief: Any) -> Any:
        """
        Return the distribution of the next rating: `mean`, `mass(low, high)` and `draw(rng)`; also
        `expected`, where the ends of the scale cut the mean.

        Parameters
        ----------
        belief : Any
            The belief now.
        """
        raise NotImplementedError(f"{self.name} has no method rating")

    def preference(self, belief: Any) -> np.ndarray:
        """
        Return what reliance depends on: the expected trust, unless a model says otherwise.

        Parameters
        ----------
        belief : Any
            The belief now.
        """
        return self.rating(belief).mean


def _least_and_unit(model: TrustDynamics | type[TrustDynamics]) -> tuple[np.ndarray, ...]:
    """Return the least values of parameters, the widths of ranges or 1, and which are finite."""
    _, low, high = np.reshape(list(model.parameters().values()), (-1, 3)).T
    finite = np.isfinite(high)
    return low, np.where(finite, high, low + 1.0) - low, finite


def values_at(model: type[TrustDynamics], coordinates: np.ndarray) -> np.ndarray:
    """
    Return a model's parameters at coordinates without bounds, shape (…, parameters).

    A coordinate is the log odds within a finite range, and the logarithm of the distance from the
    least value otherwise.
    """
    low, unit, finite = _least_and_unit(model)
    return low + unit * np.where(finite, scipy.special.expit(coordinates), np.exp(coordinates))


def with_parameters(model: type[TrustDynamics], coordinates: np.ndarray) -> TrustDynamics:
    """Return a model at coordinates without bounds, shape (…, parameters)."""
    # Clipped, so that no parameter reaches its bound.
    rows = np.moveaxis(values_at(model, np.clip(coordinates, -14.0, 14.0)), -1, 0)
    # Their ranges hold by construction: checks are for what a user types.
    made = model.__new__(model)
    made.__dict__.update(zip(model.parameters(), rows, strict=True))
    return made


def coordinates_of(model: TrustDynamics) -> np.ndarray:
    """Return the coordinates of a model, as `values_at` takes them."""
    low, unit, finite = _least_and_unit(model)
    share = (np.array([getattr(model, name) for name in model.parameters()]) - low) / unit
    share = np.clip(share, MARGIN, np.where(finite, 1.0 - MARGIN, np.inf))
    return np.where(finite, scipy.special.logit(share), np.log(share))
