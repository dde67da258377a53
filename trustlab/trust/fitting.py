"""Models of trust fitted to a panel: each person, all as one, or people of one population."""

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
from trustlab.trust.search import (
    ROUNDS,
    Losses,
    definite,
    newton_step,
    pooled_optimum,
    profile_ends,
    total_loss,
)

# A weak prior about the pooled estimate keeps what a person's data leave open near it.
WEAK = 3.0
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
        The model; with pooling "none" or "partial" its parameters are arrays with a row per person.
    pooling : {"full", "partial", "none"}
        Who shares parameters.
    panel : Panel
        What it was fitted to.
    criterion : {"step", "free"}
        What it was fitted for, see `fit_trust`.
    centre : numpy.ndarray
        Coordinates of the pooled model, or of the population's mean.
    spread : numpy.ndarray
        Standard deviation of people in coordinates; zero when pooled, NaN without a population.
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
        if self.pooling == "none":
            reason = "no population was fitted"
        elif self.criterion == "free":
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

    def people_table(self) -> pd.DataFrame:
        """
        Return every person's parameters.

        Returns
        -------
        pandas.DataFrame
            Column person, then the parameters.
        """
        values = {
            name: np.broadcast_to(getattr(self.model, name), (len(self.panel),))
            for name in self.model.parameters()
        }
        return pd.DataFrame({"person": self.panel.people} | values)


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
    starts = _starts(losses, chosen, panel, free, until) if start is None else [start]
    optima = np.array([pooled_optimum(losses, each, people) for each in starts])
    reached = total_loss(losses, optima, people)
    # The first that is as good as the best: last bits do not decide.
    centre = optima[np.argmax(reached <= reached.min() + ALIKE)]
    spread = np.zeros(centre.size)
    coordinates = centre
    if pooling != "full":
        centre, spread, coordinates = _by_person(losses, centre, people, pooling == "partial")
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
) -> list[np.ndarray]:
    """
    Return where searches begin: at the defaults, at the best of points drawn about them, and where
    the model is (3.2) as fitted, if it contains (3.2).
    """
    first = coordinates_of(chosen())
    drawn = first + 2.0 * np.random.default_rng(0).standard_normal((DRAWN, first.size))
    order = np.argsort(total_loss(losses, drawn, np.arange(len(panel))), kind="stable")
    starts = [first, *drawn[order[:BEST]]]
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


def _by_person(losses: Losses, centre: np.ndarray, people: np.ndarray, population: bool):
    """
    Return the centre, the spread of people (NaN without a population) and everybody's coordinates.
    """
    spread = np.full(centre.size, 1.0 if population else WEAK)
    x = np.tile(centre, (people.size, 1))
    for _ in range(ROUNDS if population else 1):
        for _ in range(4 if population else ROUNDS):
            x, curvature, moved = newton_step(losses, x, people, centre, spread)
            if moved < 1e-3:
                break
        if not population:
            return centre, np.full(centre.size, np.nan), x
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
