"""Models of trust fitted to a panel: each person, all as one, or people of one population."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from scipy.optimize import minimize
from scipy.special import expit

from trustlab.models.checks import of_class, one_of
from trustlab.models.display import Result
from trustlab.trust.dynamics import BASELINES, MODELS
from trustlab.trust.interface import TrustDynamics, coordinates_of, with_parameters
from trustlab.trust.likelihood import log_likelihood, predict
from trustlab.trust.panel import Panel

# A loss of each row of coordinates, shape (rows, parameters), on the person with its number.
Losses = Callable[[np.ndarray, np.ndarray], np.ndarray]
# Step of the differences behind first and second derivatives, in coordinates without bounds.
CURVE = 3e-3
# Beyond ±9 a parameter is at its bound for all purposes.
EDGE = 9.0
ROUNDS = 30
# A search has settled where no coordinate moves further.
SETTLED = 1e-4
# The root of twice the fall of the log-likelihood at the ends of a 95 % interval, and its error.
FALL = 1.96
NEAR = 0.02
# Spread of a coordinate that is held where it is put.
HELD = 1e-4
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
        losses = _losses(self.panel, type(self.model))
        return profile_ends(losses, self.centre, np.arange(len(self.panel)))

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
        is_open = np.isinf(low) & np.isinf(high)
        without = is_open | np.isnan(self.ends).any(axis=0)
        reason: Any = np.where(is_open, "the data leave it open", "its ends were not found")
        if self.criterion == "free":
            reason = "free runs have no likelihood"
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
    people = np.arange(len(panel))
    starts = _starts(losses, chosen, panel, free, until) if start is None else start[None]
    total = _of_all(losses, people)
    optima = optima_from(total, starts)
    reached = total(optima, people)
    # The first that is as good as the best: last bits do not decide.
    centre = optima[np.argmax(reached <= reached.min() + ALIKE)]
    spread = np.zeros(centre.size)
    coordinates = centre
    if pooling == "partial":
        centre, spread, coordinates = _population(losses, centre, people)
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
    losses: Losses, chosen: type[TrustDynamics], panel: Panel, free: bool, until: int | None
) -> np.ndarray:
    """
    Return where searches begin: at the defaults, at the best of points drawn about them, and where
    the model is (3.2) as fitted, if it contains (3.2).
    """
    first = coordinates_of(chosen())
    drawn = first + 2.0 * np.random.default_rng(0).standard_normal((DRAWN, first.size))
    people = np.arange(len(panel))
    order = np.argsort(_of_all(losses, people)(drawn, people), kind="stable")
    starts = [first, *drawn[order[:BEST]]]
    if chosen.contains_performance:
        simple = fitted(panel, MODELS["performance"], free=free, until=until).typical
        starts.append(coordinates_of(chosen.as_performance(simple)))
    return np.array(starts)


def _losses(
    panel: Panel, chosen: type[TrustDynamics], free: bool = False, until: int | None = None
) -> Losses:
    """Return a function of coordinates and people: the loss of each row on its person."""

    def losses(coordinates: np.ndarray, rows: np.ndarray) -> np.ndarray:
        return -log_likelihood(with_parameters(chosen, coordinates), panel.of(rows), free, until)

    return losses


def _of_all(losses: Losses, people: np.ndarray) -> Losses:
    """Return the loss of all people together at each row of coordinates, whosever it is."""

    def total(x: np.ndarray, _: np.ndarray) -> np.ndarray:
        each = losses(np.repeat(x, people.size, axis=0), np.tile(people, len(x)))
        return each.reshape(len(x), people.size).sum(axis=1)

    return total


def _population(losses: Losses, centre: np.ndarray, people: np.ndarray):
    """Return the mean of people, their spread, and everybody's coordinates."""
    spread = np.ones(centre.size)
    x = np.tile(centre, (people.size, 1))
    for _ in range(ROUNDS):
        for _ in range(4):
            x, curvature, moved = newton_step(losses, x, people, centre, spread)
            if moved.max() < 1e-3:
                break
        # What a person's data leave open counts to the spread of people.
        left = np.linalg.inv(definite(curvature + np.diag(spread**-2.0)))
        uncertain = np.diagonal(left, axis1=1, axis2=2)
        new_centre = x.mean(axis=0)
        new_spread = np.sqrt(((x - new_centre) ** 2 + uncertain).mean(axis=0))
        new_spread = np.maximum(new_spread, LEAST_SPREAD)
        change = max(np.abs(new_centre - centre).max(), np.abs(new_spread - spread).max())
        centre, spread = new_centre, new_spread
        if change < 1e-2:
            break
    return centre, spread, x


def optima_from(
    total: Losses, x: np.ndarray, spread: Any = np.inf, rounds: int = ROUNDS, still: float = SETTLED
) -> np.ndarray:
    """Return rows of coordinates after Newton's steps until none moves further than `still`."""
    x, rows = x.copy(), np.arange(len(x))
    spread = np.broadcast_to(spread, x.shape)
    for _ in range(rounds if x.size else 0):
        stepped, _, moved = newton_step(total, x[rows], rows, x[rows], spread[rows])
        x[rows] = np.clip(stepped, -EDGE, EDGE)
        rows = rows[moved >= still]
        if not rows.size:
            break
    return x


def profile_ends(losses: Losses, centre: np.ndarray, people: np.ndarray) -> np.ndarray:
    """
    Return the ends of 95 % intervals of pooled coordinates, shape (2, parameters).

    At an end the log-likelihood, with all other coordinates at their best, is 1.92 less than at the
    centre: D. J. Venzon, S. H. Moolgavkar, Applied Statistics 37(1), 1988. An end is infinite where
    a parameter reaches its bound before, and NaN where the search did not settle.
    """
    # Every end is searched like a person whose coordinates are all free but one.
    place = np.tile(np.arange(centre.size), 2)
    side = np.repeat([-1.0, 1.0], centre.size)
    spread = np.full((place.size, centre.size), np.inf)
    spread[np.arange(place.size), place] = HELD

    total = _of_all(losses, people)
    least, _, curvature = derivatives(total, centre[None], place[:1])
    covariance = np.linalg.inv(definite(curvature[0]))
    variance = np.diag(covariance)
    distance = np.minimum(FALL * np.sqrt(variance), 1.0)[place]
    # How the others change with a coordinate while the loss is quadratic; those that it leaves open
    # stay about where they are.
    along = (covariance / variance).T[place] * distance[:, None]
    along = np.clip(along, -1.0, 1.0) / distance[:, None]
    ends = np.full(place.size, np.nan)
    x = np.tile(centre, (place.size, 1))
    rows = np.arange(place.size)
    before = np.zeros(place.size)
    reached = np.zeros(place.size)
    for _ in range(ROUNDS):
        at = np.clip(centre[place] + side * distance, -EDGE, EDGE)[rows]
        change = at - x[rows, place[rows]]
        x[rows] += change[:, None] * along[rows]
        x[rows] = optima_from(total, x[rows], spread[rows], rounds=4, still=0.05)
        fall = np.sqrt(2.0 * np.maximum(total(x[rows], rows) - least, 1e-12))
        settled = np.abs(fall - before[rows]) < NEAR
        beyond = settled & (np.abs(at) == EDGE) & (fall < FALL)
        ends[rows] = np.where(beyond, np.inf * side[rows], at)
        power = _power(fall, before[rows], distance[rows], reached[rows])
        before[rows] = fall
        reached[rows] = distance[rows]
        distance[rows] *= np.clip((FALL / fall) ** (1.0 / power), 0.5, 2.0)
        distance = np.minimum(distance, 2.0 * EDGE)
        rows = rows[~beyond & ~(settled & (np.abs(fall - FALL) < NEAR))]
        if not rows.size:
            break
    # Towards a bound the likelihood may level off before it has fallen enough.
    ends[rows] = np.where(before[rows] < FALL, np.inf * side[rows], np.nan)
    return ends.reshape(2, centre.size)


def _power(fall, fall_before, distance, distance_before) -> np.ndarray:
    """
    Return the power of the distance that a fall is by its last two values.

    It is 1 where the loss is quadratic, and more where a parameter leaves its bound.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        power = np.log(fall / fall_before) / np.log(distance / distance_before)
    return np.where(np.isfinite(power), np.clip(power, 1.0, 20.0), 1.0)


def derivatives(losses: Losses, x: np.ndarray, people: np.ndarray):
    """Return every person's loss, gradient and matrix of second derivatives, by differences."""
    size, count = x.shape
    i, j = np.tril_indices(count)
    unit = CURVE * np.eye(count)
    moves = np.concatenate([np.zeros((1, count)), unit, -unit, unit[i] + unit[j]])
    stacked = (x + moves[:, None]).reshape(-1, count)
    values = losses(stacked, np.tile(people, len(moves))).reshape(len(moves), size)
    centre, ahead, behind, both = np.split(values, [1, count + 1, 2 * count + 1])
    slope = (ahead - behind).T / (2.0 * CURVE)
    # ∂²f/∂i∂j ≈ (f(i + j) − f(i) − f(j) + f)/h²
    mixed = (both - ahead[i] - ahead[j] + centre).T / CURVE**2
    curvature = np.zeros((size, count, count))
    curvature[:, i, j] = mixed
    curvature[:, j, i] = mixed
    return centre[0], slope, curvature


def newton_step(
    losses: Losses, x: np.ndarray, people: np.ndarray, centre: np.ndarray, spread: np.ndarray
):
    """
    Return everybody's coordinates after a step that lowers the loss with a normal prior, the
    curvature of the loss, and how far each moved.
    """
    loss, slope, curvature = derivatives(losses, x, people)
    weight = spread**-2.0

    def prior(coordinates: np.ndarray) -> np.ndarray:
        return 0.5 * ((coordinates - centre) ** 2 * weight).sum(axis=1)

    loss = loss + prior(x)
    slope = slope + (x - centre) * weight
    matrix = definite(curvature + weight[..., None] * np.eye(x.shape[1]))
    direction = -np.linalg.solve(matrix, slope[..., None])[..., 0]
    direction *= np.minimum(1.0, 2.0 / np.maximum(np.abs(direction).max(axis=1), 1e-12))[:, None]
    share = np.ones(people.size)
    for _ in range(6):
        tried = x + share[:, None] * direction
        worse = ~(losses(tried, people) + prior(tried) <= loss)
        if not worse.any():
            break
        share[worse] *= 0.3
    share[worse] = 0.0
    step = share[:, None] * direction
    return x + step, curvature, np.abs(step).max(axis=1)


def definite(matrices: np.ndarray) -> np.ndarray:
    """Return symmetric matrices with eigenvalues of at least 1e-3."""
    values, vectors = np.linalg.eigh(matrices)
    values = np.maximum(values, 1e-3)
    return (vectors * values[..., None, :]) @ np.swapaxes(vectors, -1, -2)


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
