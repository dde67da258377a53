"""A model of trust run along a panel: predictions, their log-likelihood, draws from it."""

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from trustlab.models.checks import finite_numbers, flag, of_class
from trustlab.trust.interface import LEAST, Event, TrustDynamics, cell
from trustlab.trust.panel import Panel, panel_until


class Predictions(NamedTuple):
    """
    What a model says before every event and every later rating.

    Parameters
    ----------
    distributions : list
        Of the ratings after each event.
    preference : numpy.ndarray, shape (N, K)
        What reliance depends on, before each event.
    """

    distributions: list
    preference: np.ndarray

    @property
    def mean(self) -> np.ndarray:
        """Expected ratings, shape (N, K)."""
        each = [getattr(rating, "expected", rating.mean) for rating in self.distributions]
        return np.stack(each, axis=1)

    def probability(self, panel: Panel) -> np.ndarray:
        """Return the probability of each rating after an event, shape (N, K); NaN where none is."""
        cells = [
            rating.mass(*cell(panel.ratings[:, k + 1], panel.resolution))
            for k, rating in enumerate(self.distributions)
        ]
        # Nobody asked: no probability, rather than one of whatever lies between NaN and NaN.
        # What a model has lost costs the most: fmax takes LEAST beside NaN.
        probability = np.fmax(np.stack(cells, axis=1), LEAST)
        return np.where(np.isnan(panel.ratings[:, 1:]), np.nan, probability)


def _event(panel: Panel, k: int) -> Event:
    """
    Return everybody's event of one trial; where a person had none, one of length 0 with the
    defaults of `Event`, which still moves models that count events.
    """
    absent = np.isnan(panel.events.dt[:, k])
    pairs = zip(Event(dt=0.0), panel.events, strict=True)
    return Event(*(np.where(absent, usual, signal[:, k]) for usual, signal in pairs))


def _scale(model: TrustDynamics, panel: Panel) -> dict[str, Any]:
    """Return what a model is told of the scale beside ratings."""
    return {"resolution": panel.resolution} if model.rounds else {}


def predict(
    model: TrustDynamics, panel: Panel, free: bool = False, known: int | np.ndarray = 0
) -> Predictions:
    """
    Return what a model predicts of a panel.

    Parameters
    ----------
    model : TrustDynamics
        The model.
    panel : Panel
        Events, and ratings to learn from.
    free : bool
        Learn from no rating but the first, or the `known` first ones.
    known : int or numpy.ndarray, shape (N,)
        With `free`: ratings after how many events are learned from.

    Returns
    -------
    Predictions
    """
    of_class("model", model, TrustDynamics)
    scale = _scale(model, of_class("panel", panel, Panel))
    known = finite_numbers("known", known)
    ratings = panel_until(panel, known).ratings if flag("free", free) else panel.ratings
    rated = np.isfinite(ratings).any(axis=0)
    belief = model.start(ratings[:, 0], **scale)
    distributions, preference = [], np.empty((len(panel), panel.trials))
    for k in range(panel.trials):
        preference[:, k] = model.preference(belief)
        belief = model.step(belief, _event(panel, k))
        distributions.append(model.rating(belief))
        if rated[k + 1]:
            belief = model.learn(belief, ratings[:, k + 1], **scale)
    return Predictions(distributions, preference)


def log_likelihood(model: TrustDynamics, panel: Panel, free: bool = False) -> np.ndarray:
    """Return the log-likelihood of each person's ratings after the first."""
    return np.nansum(np.log(predict(model, panel, free).probability(panel)), axis=1)


def simulate_ratings(model: TrustDynamics, panel: Panel, rng: np.random.Generator) -> Panel:
    """
    Return a panel with ratings drawn from a model, where the panel has ratings.

    Parameters
    ----------
    model : TrustDynamics
        The model that people shall follow.
    panel : Panel
        Events, first ratings and scale.
    rng : numpy.random.Generator
        Where the draws come from.

    Returns
    -------
    Panel
    """
    of_class("model", model, TrustDynamics)
    of_class("rng", rng, np.random.Generator)
    ratings = of_class("panel", panel, Panel).ratings.copy()
    belief = model.start(ratings[:, 0], **_scale(model, panel))
    steps = round(1.0 / panel.resolution)
    for k in range(panel.trials):
        belief = model.step(belief, _event(panel, k))
        drawn = np.where(np.isnan(ratings[:, k + 1]), np.nan, model.rating(belief).draw(rng))
        ratings[:, k + 1] = np.round(np.clip(drawn, 0.0, 1.0) * steps) / steps
        # What was rounded depends on what was meant before, not on what was written down.
        belief = model.learn(belief, drawn if model.rounds else ratings[:, k + 1])
    return replace(panel, ratings=ratings)
