"""Models of trust fitted to a panel: each person, all as one, or people of one population."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, cached_property
from typing import NamedTuple

import numpy as np
import pandas as pd
from scipy.optimize import brentq, minimize
from scipy.special import expit

from trustlab.models.checks import of_class, one_of
from trustlab.models.display import Result
from trustlab.trust.dynamics import BASELINES, MODELS
from trustlab.trust.interface import TrustDynamics, coordinates_of, with_parameters
from trustlab.trust.likelihood import log_likelihood, predict
from trustlab.trust.panel import Panel

# A loss of each row of coordinates, shape (rows, parameters), on the person with its number.
Losses = Callable[[np.ndarray, np.ndarray], np.ndarray]
# A loss at coordinates, shape (parameters,), with its derivatives.
Loss = Callable[[np.ndarray], tuple[float, np.ndarray]]
# Step of the differences behind derivatives, in coordinates without bounds.
STEP = 1e-3
# Beyond ±9 a parameter is at its bound for all purposes.
EDGE = 9.0
ROUNDS = 30
# What the log-likelihood has fallen by at the ends of a 95 % interval.
FALL = 1.92
LEAST_SPREAD = 0.05
CRITERIA = ("step", "free")
# Points drawn about the defaults, and how many of the best a search begins at.
DRAWN = 40
BEST = 2
# Optima of log-likelihoods so near each other are one.
ALIKE = 1e-3


class Link(NamedTuple):
    """Log odds of reliance: bias + slope · preference."""

    bias: float
    slope: float


@dataclass(frozen=True, eq=False, repr=False)
class TrustFit(Result):
    """
    A model of trust fitted to a panel.

    Parameters
    ----------
    model : TrustDynamics
        The model; with partial pooling its parameters are arrays with a row per person.
    pooling : {"full", "partial"}
        Who shares parameters.
    panel : Panel
        What it was fitted to.
    criterion : {"step", "free"}
        What it was fitted for, see `fit_trust`.
    centre : numpy.ndarray
        Coordinates of the pooled model, or of the population's mean.
    spread : numpy.ndarray
        Standard deviation of people in coordinates; zero when pooled.
    log_likelihood : float
        Of the ratings after the first.
    link : Link
        Of reliance on the model's preference, fitted afterwards; NaN where nobody could rely.
    ratings : int
        Ratings fitted.
    """

    model: TrustDynamics
    pooling: str
    panel: Panel
    criterion: str
    centre: np.ndarray
    spread: np.ndarray
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

    @cached_property
    def ends(self) -> np.ndarray:
        """
        Ends of 95 % intervals of the coordinates, shape (2, parameters).

        Of a pooled fit, by the profile of the likelihood: infinite where the data leave a side
        open, NaN for fits of free runs, which have no likelihood. Of a population, the range of
        95 % of people.
        """
        if self.pooling != "full":
            return self.centre + np.outer([-1.96, 1.96], self.spread)
        if self.criterion == "free" or not self.centre.size:
            return np.full((2, self.centre.size), np.nan)
        loss = _pooled(_losses(self.panel, type(self.model)), len(self.panel))
        ends = [
            [profile_end(loss, self.centre, i, side) for i in range(self.centre.size)]
            for side in (-1.0, 1.0)
        ]
        return np.array(ends)

    @property
    def title(self) -> str:
        """The name of the model."""
        return self.model.name

    @property
    def message(self) -> str:
        """How many people and ratings it was fitted to."""
        return f"{len(self.panel)} people, {self.ratings} ratings, pooling {self.pooling}"

    def table(self) -> pd.DataFrame:
        """
        Return the pooled parameters with 95 % intervals, or those of a typical person with the
        range of 95 % of people.

        Returns
        -------
        pandas.DataFrame
            Columns parameter, estimate, ci_low, ci_high, note. An end that the data leave open is
            that of the parameter's range; where both are, there is no interval, and the note says
            so: such an estimate may differ between processors, and the likelihood does not.
        """
        names = list(self.model.parameters())
        _, least, most = np.array(list(self.model.parameters().values())).reshape(-1, 3).T
        low, high = self.ends
        at = [with_parameters(type(self.model), x) for x in (self.centre, low, high)]
        values = [np.array([getattr(end, name) for name in names], dtype=float) for end in at]
        without = (np.isinf(low) & np.isinf(high)) | np.isnan(low)
        free = self.criterion == "free"
        reason = "free runs have no likelihood" if free else "the data leave it open"
        return pd.DataFrame(
            {
                "parameter": names,
                "estimate": values[0],
                "ci_low": np.where(without, np.nan, np.where(np.isinf(low), least, values[1])),
                "ci_high": np.where(without, np.nan, np.where(np.isinf(high), most, values[2])),
                "note": np.where(without, reason, ""),
            }
        )


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
    pooling : {"full", "partial"}
        "full": one set of parameters. "partial": people's parameters are normal about a mean, in
        coordinates without bounds, which is estimated with them.
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
    one_of("pooling", pooling, ("full", "partial"))
    one_of("criterion", criterion, CRITERIA)
    return fitted(panel, model_class(model), pooling, free=criterion == "free")


def fitted(
    panel: Panel,
    chosen: type[TrustDynamics],
    pooling: str = "full",
    *,
    free: bool = False,
    until: int | None = None,
    start: np.ndarray | None = None,
) -> TrustFit:
    """Return a fit to the ratings up to an event, or to all, searched from coordinates `start`."""
    ratings = int(np.isfinite(panel.ratings[:, 1:][:, :until]).sum())
    if not ratings:
        raise ValueError("the panel has no rating after an event: nothing can be fitted")
    losses = _losses(panel, chosen, free, until)
    loss = _pooled(losses, len(panel))
    starts = _starts(loss, chosen, panel, free, until) if start is None else [start]
    optima = [optimum(loss, x) for x in starts]
    reached = np.array([loss(x)[0] for x in optima])
    # The first that is as good as the best: last bits do not decide.
    centre = optima[np.argmax(reached <= reached.min() + ALIKE)]
    spread = np.zeros(centre.size)
    coordinates = centre
    if pooling == "partial":
        centre, spread, coordinates = _population(losses, centre, len(panel))
    model = with_parameters(chosen, coordinates)
    return TrustFit(
        model=model,
        pooling=pooling,
        panel=panel,
        criterion="free" if free else "step",
        centre=centre,
        spread=spread,
        log_likelihood=float(log_likelihood(model, panel, free, until).sum()),
        link=reliance_link(model, panel, until),
        ratings=ratings,
    )


def _starts(
    loss: Loss, chosen: type[TrustDynamics], panel: Panel, free: bool, until: int | None
) -> list[np.ndarray]:
    """
    Return where searches begin: at the defaults, at the best of points drawn about them, and where
    the model is (3.2) as fitted, if it contains (3.2).
    """
    first = coordinates_of(chosen())
    drawn = first + 2.0 * np.random.default_rng(0).standard_normal((DRAWN, first.size))
    starts = [first, *sorted(drawn, key=lambda x: loss(x)[0])[:BEST]]
    if chosen.contains_performance:
        simple = fitted(panel, MODELS["performance"], free=free, until=until).typical
        starts.append(coordinates_of(chosen.as_performance(simple)))
    return starts


def _losses(
    panel: Panel, chosen: type[TrustDynamics], free: bool = False, until: int | None = None
) -> Losses:
    """Return a function of coordinates and people: the loss of each row on its person."""

    def losses(coordinates: np.ndarray, rows: np.ndarray) -> np.ndarray:
        return -log_likelihood(with_parameters(chosen, coordinates), panel.of(rows), free, until)

    return losses


def slopes(losses: Losses, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return each person's loss at their row of coordinates, and its derivatives."""
    people, count = x.shape
    moves = STEP * np.concatenate([np.zeros((1, count)), np.eye(count), -np.eye(count)])
    rows = np.tile(np.arange(people), len(moves))
    values = losses((x + moves[:, None]).reshape(-1, count), rows).reshape(len(moves), people)
    centre, ahead, behind = np.split(values, [1, count + 1])
    return centre[0], (ahead - behind).T / (2.0 * STEP)


def _pooled(losses: Losses, people: int) -> Loss:
    """Return the loss of all people together at the same coordinates, with its derivatives."""

    def loss(x: np.ndarray) -> tuple[float, np.ndarray]:
        values, slope = slopes(losses, np.tile(x, (people, 1)))
        return float(values.sum()), slope.sum(axis=0)

    return loss


def optimum(loss: Loss, x: np.ndarray, held: int | None = None) -> np.ndarray:
    """Return the coordinates of least loss, searched from x; the one `held` stays as it is."""
    low, high = np.full((2, x.size), [[-EDGE], [EDGE]])
    if held is not None:
        low[held] = high[held] = x[held]
    return minimize(loss, x, jac=True, bounds=np.transpose([low, high])).x if x.size else x


def profile_end(loss: Loss, centre: np.ndarray, place: int, side: float) -> float:
    """
    Return an end of the 95 % interval of a pooled coordinate, below (−1) or above (1) its optimum.

    At an end the log-likelihood, with all other coordinates at their best, is 1.92 less than at the
    optimum: D. J. Venzon, S. H. Moolgavkar, Applied Statistics 37(1), 1988. It is infinite where a
    parameter reaches its bound before.
    """
    least, _ = loss(centre)
    near = centre.copy()

    @cache
    def best(value: float) -> np.ndarray:
        """The other coordinates at their best, searched from the last point within."""
        x = near.copy()
        x[place] = value
        return optimum(loss, x, place)

    def fall(value: float) -> float:
        """How much more than at an end the log-likelihood has fallen."""
        return loss(best(value))[0] - least - FALL

    distance = 0.25
    while side * near[place] < EDGE:
        beyond = float(np.clip(centre[place] + side * distance, -EDGE, EDGE))
        if fall(beyond) > 0.0:
            return brentq(fall, near[place], beyond, xtol=1e-3)
        near = best(beyond)
        distance *= 2.0
    return side * np.inf


def _population(
    losses: Losses, centre: np.ndarray, people: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the mean of people, their spread, and everybody's coordinates."""
    spread = np.ones(centre.size)
    x = np.tile(centre, (people, 1))

    def loss(flat: np.ndarray) -> tuple[float, np.ndarray]:
        values, slope = slopes(losses, flat.reshape(x.shape))
        away = (flat.reshape(x.shape) - centre) / spread
        return values.sum() + 0.5 * (away**2).sum(), (slope + away / spread).ravel()

    unit = STEP * np.eye(centre.size)
    for _ in range(ROUNDS):
        x = optimum(loss, x.ravel()).reshape(x.shape)
        # What a person's data leave open counts to the spread of people.
        turns = [slopes(losses, x + each)[1] - slopes(losses, x - each)[1] for each in unit]
        curvature = np.stack(turns, axis=1) / (2.0 * STEP) + np.diag(spread**-2.0)
        values, vectors = np.linalg.eigh(curvature)
        uncertain = (vectors**2 / np.maximum(values, 1e-3)[:, None]).sum(axis=2)
        new_centre = x.mean(axis=0)
        new_spread = np.sqrt(((x - new_centre) ** 2 + uncertain).mean(axis=0))
        new_spread = np.maximum(new_spread, LEAST_SPREAD)
        change = max(np.abs(new_centre - centre).max(), np.abs(new_spread - spread).max())
        centre, spread = new_centre, new_spread
        if change < 1e-2:
            break
    return centre, spread, x


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
