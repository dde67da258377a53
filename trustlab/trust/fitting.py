"""Models of trust fitted to a panel: each person, all as one, or people of one population."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
import pandas as pd
from scipy.optimize import minimize
from scipy.special import expit

from trustlab.models.checks import of_class, one_of
from trustlab.models.html import as_html
from trustlab.trust.dynamics import BASELINES, MODELS
from trustlab.trust.interface import TrustDynamics, coordinates_of, with_parameters
from trustlab.trust.likelihood import log_likelihood, predict
from trustlab.trust.panel import Panel

# Steps of differences in coordinates without bounds.
STEP = 1e-6
CURVE = 3e-3
# A weak prior about the pooled estimate keeps what a person's data leave open near it.
WEAK = 3.0
LEAST_SPREAD = 0.05
ROUNDS = 30
CRITERIA = ("step", "free")


class Link(NamedTuple):
    """Log odds of reliance: bias + slope · preference."""

    bias: float
    slope: float


@dataclass(frozen=True, eq=False)
class TrustFit:
    """
    A model of trust fitted to a panel.

    Parameters
    ----------
    model : TrustDynamics
        The model; with pooling "none" or "partial" its parameters are arrays with a row per person.
    name : str
        Its name.
    pooling : {"full", "partial", "none"}
        Who shares parameters.
    people : tuple
        Names.
    centre : numpy.ndarray
        Coordinates of the pooled model, or of the population's mean.
    spread : numpy.ndarray
        Standard deviation of people in coordinates; zero when pooled, NaN without a population.
    covariance : numpy.ndarray
        Of the pooled coordinates, by the curvature of the likelihood; NaN where it has none.
    log_likelihood : float
        Of the ratings after the first.
    link : Link
        Of reliance on the model's preference, fitted afterwards; NaN where nobody could rely.
    ratings : int
        Ratings fitted.
    """

    model: TrustDynamics
    name: str
    pooling: str
    people: tuple
    centre: np.ndarray
    spread: np.ndarray
    covariance: np.ndarray
    log_likelihood: float
    link: Link
    ratings: int

    @cached_property
    def typical(self) -> TrustDynamics:
        """The model of the pooled parameters, or of a typical person: numbers, not arrays."""
        pooled = with_parameters(type(self.model), self.centre)
        return type(self.model)(**{n: float(getattr(pooled, n)) for n in pooled.parameters()})

    @property
    def bic(self) -> float:
        """Schwarz's criterion of a pooled fit: smaller is better."""
        return self.centre.size * np.log(self.ratings) - 2.0 * self.log_likelihood

    def table(self) -> pd.DataFrame:
        """
        Return the pooled parameters with 95 % intervals, or those of a typical person with the
        range of 95 % of people.

        Returns
        -------
        pandas.DataFrame
            Columns parameter, estimate, low, high; NaN where the data say nothing.
        """
        half = 1.96 * (np.sqrt(np.diag(self.covariance)) if self.pooling == "full" else self.spread)
        ends = [with_parameters(type(self.model), self.centre + s * half) for s in (0, -1, 1)]
        names = list(self.model.parameters())
        values = [[float(getattr(end, name)) for name in names] for end in ends]
        columns = dict(zip(("estimate", "low", "high"), values, strict=True))
        return pd.DataFrame({"parameter": names} | columns)

    def people_table(self) -> pd.DataFrame:
        """
        Return every person's parameters.

        Returns
        -------
        pandas.DataFrame
            Column person, then the parameters.
        """
        values = {
            name: np.broadcast_to(getattr(self.model, name), (len(self.people),))
            for name in self.model.parameters()
        }
        return pd.DataFrame({"person": self.people} | values)

    def _repr_html_(self) -> str:
        text = f"{len(self.people)} people, {self.ratings} ratings, pooling {self.pooling}"
        return as_html(text, self.table(), title=self.model.title or self.name)


def model_class(model: str | type[TrustDynamics]) -> type[TrustDynamics]:
    """Return a model's class by its name, or a class of a user's own."""
    if isinstance(model, type) and issubclass(model, TrustDynamics):
        return model
    known = MODELS | BASELINES
    return known[one_of("model", model, known, also="a subclass of trustlab.trust.TrustDynamics")]


def fit_trust(
    panel: Panel,
    model: str | type[TrustDynamics] = "asymmetric",
    *,
    pooling: str = "full",
    criterion: str = "step",
) -> TrustFit:
    """
    Fit a model of trust to people's ratings, by the likelihood of its predictions.

    Parameters
    ----------
    panel : Panel
        See `read_people`; ratings may be missing.
    model : str or subclass of TrustDynamics
        A name in `trust.MODELS` or `trust.BASELINES`, or a model of one's own.
    pooling : {"full", "partial", "none"}
        "full": one set of parameters. "partial": people's parameters are normal about a mean, in
        coordinates without bounds, which is estimated with them. "none": each person alone; a weak
        prior about the pooled estimate holds what ten ratings leave open.
    criterion : {"step", "free"}
        "step": each rating is predicted from all before it, the exact likelihood. "free": from the
        first alone, which asks for the course over many trials; intervals are then not valid.

    Returns
    -------
    TrustFit

    Raises
    ------
    ValueError
        If the model is unknown, or the panel has no rating after an event.

    Notes
    -----
    "partial" alternates between each person's mode and the mean and variance of people (an EM
    algorithm with Laplace's approximation). Reliance is fitted after trust, so that it does not
    change what the ratings say.

    Examples
    --------
    >>> import trustlab as tl
    >>> fit = tl.fit_trust(tl.read_people("hybrid_vr"), "asymmetric")
    >>> bool(fit.typical.level_success > fit.typical.level_failure)
    True
    """
    of_class("panel", panel, Panel, "tl.read_people(…) reads one")
    one_of("pooling", pooling, ("full", "partial", "none"))
    one_of("criterion", criterion, CRITERIA)
    chosen = model_class(model)
    name = model if isinstance(model, str) else chosen.__name__
    fit = fitted(panel, chosen, name, pooling, free=criterion == "free")
    if pooling != "full":
        return fit
    return replace(fit, covariance=_uncertainty(fit, panel, criterion == "free"))


def fitted(
    panel: Panel,
    chosen: type[TrustDynamics],
    name: str,
    pooling: str = "full",
    *,
    free: bool = False,
    until: int | None = None,
    start: np.ndarray | None = None,
) -> TrustFit:
    """
    Return a fit to the ratings up to an event, or to all, searched from coordinates `start`.

    A pooled fit has no covariance.
    """
    ratings = int(np.isfinite(panel.ratings[:, 1:][:, :until]).sum())
    if not ratings:
        raise ValueError("the panel has no rating after an event: nothing can be fitted")
    losses = _losses(panel, chosen, free, until)
    people = np.arange(len(panel))
    centre = _pooled(losses, coordinates_of(chosen()) if start is None else start, people)
    spread = np.zeros(centre.size)
    coordinates = centre
    if pooling != "full":
        centre, spread, coordinates = _by_person(losses, centre, people, pooling == "partial")
    model = with_parameters(chosen, coordinates)
    return TrustFit(
        model=model,
        name=name,
        pooling=pooling,
        people=panel.people,
        centre=centre,
        spread=spread,
        covariance=np.full((centre.size, centre.size), np.nan),
        log_likelihood=float(log_likelihood(model, panel, free, until).sum()),
        link=reliance_link(model, panel, until),
        ratings=ratings,
    )


def _losses(panel: Panel, chosen: type[TrustDynamics], free: bool, until: int | None):
    """Return a function of coordinates and people: the loss of each row on its person."""

    def losses(coordinates: np.ndarray, rows: np.ndarray) -> np.ndarray:
        return -log_likelihood(with_parameters(chosen, coordinates), panel.of(rows), free, until)

    return losses


def _uncertainty(fit: TrustFit, panel: Panel, free: bool) -> np.ndarray:
    """Return the covariance of pooled coordinates."""
    if not fit.centre.size:
        return fit.covariance
    losses = _losses(panel, type(fit.model), free, None)
    coordinates = np.tile(fit.centre, (len(panel), 1))
    _, _, curvature = derivatives(losses, coordinates, np.arange(len(panel)))
    return _inverse(curvature.sum(axis=0))


Losses = Callable[[np.ndarray, np.ndarray], np.ndarray]


def _pooled(losses: Losses, start: np.ndarray, people: np.ndarray) -> np.ndarray:
    """Return the coordinates of least total loss: all differences of a gradient in one run."""

    def loss_and_slope(x: np.ndarray):
        moves = np.concatenate([np.zeros((1, x.size)), STEP * np.eye(x.size)])
        rows = np.tile(people, len(moves))
        total = losses(np.repeat(x + moves, people.size, axis=0), rows)
        total = total.reshape(len(moves), -1).mean(axis=1)
        return total[0], (total[1:] - total[0]) / STEP

    if not start.size:
        return start
    # Beyond ±9 a parameter is at its bound for all purposes.
    bounds = [(-9.0, 9.0)] * start.size
    return minimize(loss_and_slope, start, jac=True, method="L-BFGS-B", bounds=bounds).x


def derivatives(losses: Losses, x: np.ndarray, people: np.ndarray):
    """Return every person's loss, gradient and matrix of second derivatives, by differences."""
    size, count = x.shape
    unit = CURVE * np.eye(count)
    pairs = [(i, j) for i in range(count) for j in range(i)]
    moves = [np.zeros(count), *unit, *-unit, *(unit[i] + unit[j] for i, j in pairs)]
    stacked = np.concatenate([x + move for move in moves])
    values = losses(stacked, np.tile(people, len(moves))).reshape(len(moves), size)
    centre = values[0]
    ahead = values[1 : count + 1]
    behind = values[count + 1 : 2 * count + 1]
    slope = (ahead - behind).T / (2.0 * CURVE)
    curvature = np.zeros((size, count, count))
    second = (ahead - 2.0 * centre + behind) / CURVE**2
    curvature[:, np.arange(count), np.arange(count)] = second.T
    for (i, j), both in zip(pairs, values[2 * count + 1 :], strict=True):
        # ∂²f/∂i∂j ≈ (f(i + j) − f(i) − f(j) + f)/h²
        mixed = (both - ahead[i] - ahead[j] + centre) / CURVE**2
        curvature[:, i, j] = mixed
        curvature[:, j, i] = mixed
    return centre, slope, curvature


def _by_person(losses: Losses, centre: np.ndarray, people: np.ndarray, population: bool):
    """
    Return the centre, the spread of people (NaN without a population) and everybody's coordinates.
    """
    spread = np.full(centre.size, 1.0 if population else WEAK)
    x = np.tile(centre, (people.size, 1))
    for _ in range(ROUNDS if population else 1):
        for _ in range(4 if population else ROUNDS):
            x, curvature, moved = _newton(losses, x, people, centre, spread)
            if moved < 1e-3:
                break
        if not population:
            return centre, np.full(centre.size, np.nan), x
        # What a person's data leave open counts to the spread of people.
        left = np.linalg.inv(_definite(curvature + np.diag(spread**-2.0)))
        uncertain = np.diagonal(left, axis1=1, axis2=2)
        new_centre = x.mean(axis=0)
        new_spread = np.sqrt(((x - new_centre) ** 2 + uncertain).mean(axis=0))
        new_spread = np.maximum(new_spread, LEAST_SPREAD)
        change = max(np.abs(new_centre - centre).max(), np.abs(new_spread - spread).max())
        centre, spread = new_centre, new_spread
        if change < 1e-2:
            break
    return centre, spread, x


def _newton(losses: Losses, x: np.ndarray, people: np.ndarray, centre, spread):
    """Return everybody's coordinates after a step that lowers the loss with its prior."""
    loss, slope, curvature = derivatives(losses, x, people)
    weight = spread**-2.0
    slope = slope + (x - centre) * weight
    loss = loss + 0.5 * ((x - centre) ** 2 * weight).sum(axis=1)
    direction = -np.linalg.solve(_definite(curvature + np.diag(weight)), slope[..., None])[..., 0]
    direction *= np.minimum(1.0, 2.0 / np.maximum(np.abs(direction).max(axis=1), 1e-12))[:, None]
    share = np.ones(people.size)
    for _ in range(6):
        tried = x + share[:, None] * direction
        new = losses(tried, people) + 0.5 * ((tried - centre) ** 2 * weight).sum(axis=1)
        worse = ~(new <= loss)
        if not worse.any():
            break
        share[worse] *= 0.3
    share[worse] = 0.0
    step = share[:, None] * direction
    return x + step, curvature, float(np.abs(step).max())


def _definite(matrices: np.ndarray) -> np.ndarray:
    """Return symmetric matrices with eigenvalues of at least 1e-3."""
    values, vectors = np.linalg.eigh(matrices)
    values = np.maximum(values, 1e-3)
    return (vectors * values[..., None, :]) @ np.swapaxes(vectors, -1, -2)


def _inverse(information: np.ndarray) -> np.ndarray:
    """Return the covariance of parameters; NaN for those that the likelihood does not determine."""
    values, vectors = np.linalg.eigh(information)
    flat = values < 1e-3
    known = np.where(flat, np.inf, values)
    covariance = (vectors / known) @ vectors.T
    open_ended = (np.abs(vectors[:, flat]) > 0.05).any(axis=1)
    covariance[open_ended] = np.nan
    covariance[:, open_ended] = np.nan
    return covariance


def reliance_link(model: TrustDynamics, panel: Panel, until: int | None = None) -> Link:
    """Return the link of reliance that is likeliest, given what a model says of trust."""
    followed = panel.events.followed[:, :until]
    asked = np.isfinite(followed)
    if not asked.any():
        return Link(np.nan, np.nan)
    preference = predict(model, panel).preference[:, :until][asked]
    relied = followed[asked]

    def loss_and_slope(x: np.ndarray):
        odds = x[0] + x[1] * preference
        error = expit(odds) - relied
        # A weak prior: where trust and reliance are one step the slope has no maximum.
        loss = np.logaddexp(0.0, odds) - relied * odds
        slope = np.array([error.mean(), (error * preference).mean()])
        return loss.mean() + 1e-5 * x @ x, slope + 2e-5 * x

    return Link(*map(float, minimize(loss_and_slope, np.zeros(2), jac=True, method="BFGS").x))
