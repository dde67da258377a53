"""Models of trust fitted to a panel: one set of parameters for all people."""

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
from trustlab.trust.interface import (
    TrustDynamics,
    coordinates_of,
    ranges_of,
    values_at,
    with_parameters,
)
from trustlab.trust.likelihood import log_likelihood, predict
from trustlab.trust.panel import Panel

# The loss at each row of coordinates, shape (rows, parameters).
Loss = Callable[[np.ndarray], np.ndarray]
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
        The model.
    panel : Panel
        What it was fitted to.
    criterion : {"step", "free"}
        What it was fitted for, see `fit_trust`.
    coordinates : numpy.ndarray
        Those of the model, without bounds.
    log_likelihood : float
        Of the ratings after the first.
    link : Link
        Of reliance on the model's preference, fitted afterwards; NaN where nobody could rely.
    ratings : int
        Ratings fitted.
    """

    model: TrustDynamics
    panel: Panel
    criterion: str
    coordinates: np.ndarray
    log_likelihood: float
    link: Link
    ratings: int

    @property
    def bic(self) -> float:
        """Schwarz's criterion: smaller is better."""
        return self.coordinates.size * np.log(self.ratings) - 2.0 * self.log_likelihood

    @cached_property
    def ends(self) -> np.ndarray:
        """
        Ends of 95 % intervals of the coordinates by the profile of the likelihood, shape (2,
        parameters).

        Infinite where the data leave a side open, NaN for fits of free runs, which have no
        likelihood.
        """
        if self.criterion == "free" or not self.coordinates.size:
            return np.full((2, self.coordinates.size), np.nan)
        return profile_ends(_loss(self.panel, type(self.model)), self.coordinates)

    @property
    def title(self) -> str:
        """The name of the model."""
        return self.model.name

    @property
    def message(self) -> str:
        """How many people and ratings it was fitted to."""
        return f"{len(self.panel)} people, {self.ratings} ratings"

    def table(self) -> pd.DataFrame:
        """
        Return the parameters with 95 % intervals.

        Returns
        -------
        pandas.DataFrame
            Columns parameter, estimate, ci_low, ci_high, note. An end that the data leave open is
            that of the parameter's range; where both are, there is no interval, and the note says
            so: such an estimate may differ between processors, and the likelihood does not.
        """
        (least, most), (low, high) = ranges_of(self.model), self.ends
        ci_low, ci_high = values_at(type(self.model), self.ends)
        is_open = np.isinf(low) & np.isinf(high)
        without = is_open | np.isnan(self.ends).any(axis=0)
        reason: Any = np.where(is_open, "the data leave it open", "its ends were not found")
        if self.criterion == "free":
            reason = "free runs have no likelihood"
        return pd.DataFrame(
            {
                "parameter": list(self.model.parameters()),
                "estimate": values_at(type(self.model), self.coordinates),
                "ci_low": np.where(without, np.nan, np.where(np.isinf(low), least, ci_low)),
                "ci_high": np.where(without, np.nan, np.where(np.isinf(high), most, ci_high)),
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
    All people share their parameters. Reliance is fitted after trust, so that it does not change
    what the ratings say.

    Examples
    --------
    >>> import trustlab as tl
    >>> fit = tl.fit_trust(tl.read_people("hybrid_vr"), "asymmetric")
    >>> fit.model.level_success > fit.model.level_failure
    True
    """
    of_class("panel", panel, Panel, "tl.read_people(…) reads one")
    one_of("criterion", criterion, CRITERIA)
    return fitted(panel, model_class(model), free=criterion == "free")


def fitted(
    panel: Panel,
    chosen: type[TrustDynamics],
    *,
    free: bool = False,
    until: int | None = None,
    start: np.ndarray | None = None,
) -> TrustFit:
    """Return a fit to the ratings up to an event, or to all, searched from coordinates `start`."""
    ratings = int(np.isfinite(panel.ratings[:, 1:][:, :until]).sum())
    if not ratings:
        raise ValueError("the panel has no rating after an event: nothing can be fitted")
    loss = _loss(panel, chosen, free, until)
    starts = _starts(loss, chosen, panel, free, until) if start is None else start[None]
    optima = optima_from(loss, starts)
    reached = loss(optima)
    # The first that is as good as the best: last bits do not decide.
    coordinates = optima[np.argmax(reached <= reached.min() + ALIKE)]
    values = values_at(chosen, coordinates).tolist()
    model = chosen(**dict(zip(chosen.parameters(), values, strict=True)))
    return TrustFit(
        model=model,
        panel=panel,
        criterion="free" if free else "step",
        coordinates=coordinates,
        log_likelihood=float(log_likelihood(model, panel, free, until).sum()),
        link=reliance_link(model, panel, until),
        ratings=ratings,
    )


def _loss(
    panel: Panel, chosen: type[TrustDynamics], free: bool = False, until: int | None = None
) -> Loss:
    """Return minus the log-likelihood of all people's ratings as a function of coordinates."""
    people = len(panel)

    def loss(x: np.ndarray) -> np.ndarray:
        # Everybody under the first coordinates, then everybody under the second …
        everybody = panel.of(np.tile(np.arange(people), len(x)))
        model = with_parameters(chosen, np.repeat(x, people, axis=0))
        each = log_likelihood(model, everybody, free, until)
        return -each.reshape(len(x), people).sum(axis=1)

    return loss


def _starts(
    loss: Loss, chosen: type[TrustDynamics], panel: Panel, free: bool, until: int | None
) -> np.ndarray:
    """
    Return where searches begin: at the defaults, at the best of points drawn about them, and where
    the model is (3.2) as fitted, if it contains (3.2).
    """
    first = coordinates_of(chosen())
    drawn = first + 2.0 * np.random.default_rng(0).standard_normal((DRAWN, first.size))
    order = np.argsort(loss(drawn), kind="stable")
    starts = [first, *drawn[order[:BEST]]]
    if chosen.contains_performance:
        simple = fitted(panel, MODELS["performance"], free=free, until=until).model
        starts.append(coordinates_of(chosen.as_performance(simple)))
    return np.array(starts)


def optima_from(
    loss: Loss,
    x: np.ndarray,
    held: np.ndarray | bool = False,
    rounds: int = ROUNDS,
    still: float = SETTLED,
) -> np.ndarray:
    """
    Return rows of coordinates after Newton's steps until none moves further than `still`; those
    that are `held` stay.
    """
    x, rows = x.copy(), np.arange(len(x))
    held = np.broadcast_to(held, x.shape)
    for _ in range(rounds if x.size else 0):
        stepped, moved = newton_step(loss, x[rows], held[rows])
        x[rows] = np.clip(stepped, -EDGE, EDGE)
        rows = rows[moved >= still]
        if not rows.size:
            break
    return x


def profile_ends(loss: Loss, centre: np.ndarray) -> np.ndarray:
    """
    Return the ends of 95 % intervals of coordinates, shape (2, parameters).

    At an end the log-likelihood, with all other coordinates at their best, is 1.92 less than at the
    centre: D. J. Venzon, S. H. Moolgavkar, Applied Statistics 37(1), 1988. An end is infinite where
    a parameter reaches its bound before, and NaN where the search did not settle.
    """
    # A row for every end: one coordinate is put somewhere, and all others are at their best.
    place = np.tile(np.arange(centre.size), 2)
    side = np.repeat([-1.0, 1.0], centre.size)
    held = np.eye(centre.size, dtype=bool)[place]
    least, _, curvature = derivatives(loss, centre[None])
    variance = np.diag(np.linalg.inv(definite(curvature[0])))
    distance = np.minimum(FALL * np.sqrt(variance), 1.0)[place]
    ends = np.full(place.size, np.nan)
    x = np.tile(centre, (place.size, 1))
    rows = np.arange(place.size)
    before = np.zeros(place.size)
    reached = np.zeros(place.size)
    for _ in range(ROUNDS):
        at = np.clip(centre[place] + side * distance, -EDGE, EDGE)[rows]
        x[rows, place[rows]] = at
        x[rows] = optima_from(loss, x[rows], held[rows], rounds=4, still=0.05)
        fall = np.sqrt(2.0 * np.maximum(loss(x[rows]) - least, 1e-12))
        settled = np.abs(fall - before[rows]) < NEAR
        beyond = settled & (np.abs(at) == EDGE) & (fall < FALL)
        ends[rows] = np.where(beyond, np.inf * side[rows], at)
        now = distance[rows]
        # The secant through the last two distances, or through the centre.
        with np.errstate(divide="ignore", invalid="ignore"):
            slope = (fall - before[rows]) / (now - reached[rows])
        slope = np.where(slope > 0.0, slope, fall / now)
        before[rows] = fall
        reached[rows] = now
        distance[rows] = np.clip(now + (FALL - fall) / slope, 0.5 * now, 2.0 * now)
        distance = np.minimum(distance, 2.0 * EDGE)
        rows = rows[~beyond & ~(settled & (np.abs(fall - FALL) < NEAR))]
        if not rows.size:
            break
    # Towards a bound the likelihood may level off before it has fallen enough.
    ends[rows] = np.where(before[rows] < FALL, np.inf * side[rows], np.nan)
    return ends.reshape(2, centre.size)


def derivatives(loss: Loss, x: np.ndarray):
    """Return the loss at rows of coordinates, gradient and second derivatives, by differences."""
    size, count = x.shape
    i, j = np.tril_indices(count)
    unit = CURVE * np.eye(count)
    moves = np.concatenate([np.zeros((1, count)), unit, -unit, unit[i] + unit[j]])
    values = loss((x + moves[:, None]).reshape(-1, count)).reshape(len(moves), size)
    centre, ahead, behind, both = np.split(values, [1, count + 1, 2 * count + 1])
    slope = (ahead - behind).T / (2.0 * CURVE)
    # ∂²f/∂i∂j ≈ (f(i + j) − f(i) − f(j) + f)/h²
    mixed = (both - ahead[i] - ahead[j] + centre).T / CURVE**2
    curvature = np.zeros((size, count, count))
    curvature[:, i, j] = mixed
    curvature[:, j, i] = mixed
    return centre[0], slope, curvature


def newton_step(loss: Loss, x: np.ndarray, held: np.ndarray):
    """
    Return rows of coordinates after a step that lowers the loss, and how far each moved; those that
    are `held` stay.
    """
    before, slope, curvature = derivatives(loss, x)
    slope[held] = 0.0
    matrix = np.where(held[:, :, None] | held[:, None], np.eye(x.shape[1]), curvature)
    direction = -np.linalg.solve(definite(matrix), slope[..., None])[..., 0]
    direction *= np.minimum(1.0, 2.0 / np.maximum(np.abs(direction).max(axis=1), 1e-12))[:, None]
    share = np.ones(len(x))
    for _ in range(6):
        worse = ~(loss(x + share[:, None] * direction) <= before)
        if not worse.any():
            break
        share[worse] *= 0.3
    share[worse] = 0.0
    step = share[:, None] * direction
    return x + step, np.abs(step).max(axis=1)


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
