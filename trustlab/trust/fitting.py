"""Models of trust fitted to a panel: one set of parameters for all people."""

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
# Step of the differences behind slopes, in coordinates without bounds.
STEP = 1e-3
# Beyond ±9 a parameter is at its bound for all purposes.
EDGE = 9.0
# The root of twice the fall of the log-likelihood at the ends of a 95 % interval.
FALL = 1.96
# When a search ends: of a fit, whose digits count, and of the other coordinates at an end.
FINE = {"ftol": 1e-15, "gtol": 1e-6}
COARSE = {"ftol": 1e-7, "gtol": 2e-2}
# Least curvature of the loss that a search takes for true.
FLAT = 1.0
# Farther from 0 the loss may be too flat for a search to begin.
STEEP = 4.0
# How near to that root an end of an interval is.
NEAR = 0.01
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
        without = is_open | np.isnan(low)
        reason = "free runs have no likelihood"
        if self.criterion == "step":
            reason = "the data leave it open"
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
    optima, reached = zip(*(optimum(loss, x) for x in starts), strict=True)
    # The first that is as good as the best: last bits do not decide.
    coordinates = optima[np.argmax(np.array(reached) <= min(reached) + ALIKE)]
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


def optimum(loss: Loss, start: np.ndarray, axes: np.ndarray | None = None) -> tuple:
    """
    Return the coordinates of least loss, and the loss.

    `axes` are the directions of a coarse search, in rows: those along which coordinates may move.
    """
    start = np.clip(start, -EDGE, EDGE)
    moves = np.eye(start.size) if axes is None else axes
    bounds = None if axes is not None else np.array([-EDGE - start, EDGE - start]).T

    def place(z: np.ndarray) -> np.ndarray:
        # Differences at a bound take a step beyond it.
        return np.clip(start + z @ moves, -EDGE - STEP, EDGE + STEP)

    def loss_and_slope(z: np.ndarray):
        step = STEP * np.eye(len(moves))
        here, *beside = loss(place(np.vstack([z, z + step, z - step])))
        ahead, behind = np.split(np.array(beside), 2)
        return here, (ahead - behind) / (2.0 * STEP)

    # Models without parameters to fit are at their best.
    if not len(moves):
        return start, float(loss(start[None])[0])
    found = minimize(
        loss_and_slope,
        np.zeros(len(moves)),
        jac=True,
        method="L-BFGS-B",
        bounds=bounds,
        options=FINE if axes is None else COARSE,
    )
    return place(found.x), float(found.fun)


def profile_ends(loss: Loss, centre: np.ndarray) -> np.ndarray:
    """
    Return the ends of 95 % intervals of coordinates, shape (2, parameters).

    At an end the log-likelihood, with all other coordinates at their best, is 1.92 less than at the
    centre: D. J. Venzon, S. H. Moolgavkar, Applied Statistics 37(1), 1988. An end is infinite where
    a parameter reaches its bound before.
    """
    curvature = second_derivatives(loss, centre)
    ends = [
        [_end(loss, centre, curvature, i, edge) for i in range(centre.size)]
        for edge in (-EDGE, EDGE)
    ]
    return np.reshape(ends, (2, centre.size))


def second_derivatives(loss: Loss, x: np.ndarray) -> np.ndarray:
    """Return the second derivatives of the loss, by differences."""
    step = STEP * np.eye(x.size)
    both = (step[:, None] + step).reshape(-1, x.size), (step[:, None] - step).reshape(-1, x.size)
    along, across = (loss(x + each) + loss(x - each) for each in both)
    return (along - across).reshape(x.size, x.size) / (4.0 * STEP**2)


def _end(loss: Loss, centre: np.ndarray, curvature: np.ndarray, held: int, edge: float) -> float:
    """Return where the log-likelihood has fallen enough between a coordinate and its bound."""
    best, least = centre.copy(), float(loss(centre[None])[0])
    free = np.arange(centre.size) != held
    # Along these axes the loss is about equally curved near the centre.
    values, vectors = np.linalg.eigh(curvature[np.ix_(free, free)])
    axes = np.zeros((values.size, centre.size))
    axes[:, free] = (vectors / np.sqrt(np.maximum(values, FLAT))).T

    @cache
    def fall(place: float) -> float:
        """Return the root of twice the fall of the log-likelihood, less that at an end."""
        # From the centre or from the last search, whichever is better: each can lie in a plain.
        points = np.clip([centre, best], -STEEP, STEEP)
        points[:, held] = place
        best[:], reached = optimum(loss, points[np.argmin(loss(points))], axes)
        more = np.sqrt(2.0 * max(reached - least, 0.0)) - FALL
        return 0.0 if abs(more) < NEAR else more

    inner, step = centre[held], np.copysign(0.25, edge)
    while (more := fall(outer := float(np.clip(centre[held] + step, -EDGE, EDGE)))) < 0.0:
        if outer == edge:
            return np.copysign(np.inf, edge)
        # A little beyond where the root would be if it grew in proportion to the distance.
        inner, step = outer, step * np.clip(1.05 * FALL / (more + FALL + 1e-9), 1.1, 4.0)
    return brentq(fall, inner, outer)


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
