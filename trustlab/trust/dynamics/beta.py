"""Trust as a Beta distribution of successes and failures, after Guo and Yang."""

from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np

from trustlab.trust.interface import BetaRating, Event, TrustDynamics, parameter

# How close to an end of the scale the mean of a belief may come.
END = 1e-3


class Counts(NamedTuple):
    """Weighed successes and failures, shape (N,)."""

    alpha: np.ndarray
    beta: np.ndarray

    @classmethod
    def of(cls, mean, total) -> "Counts":
        """Return the counts of a mean, which is kept off the ends of the scale, and of a total."""
        mean = np.clip(mean, END, 1.0 - END)
        return cls(total * mean, total * (1.0 - mean))


@dataclass(frozen=True)
class BetaTrust(TrustDynamics):
    """
    T ~ Beta(α, β), α' = α + w_s p, β' = β + w_f (1 − p): steps shrink as experience grows.

    Parameters
    ----------
    strength : float
        α + β before the first event; their ratio is the first rating's.
    success, failure : float
        w_s and w_f.
    anchor : float
        Share of its distance to a later rating that the mean moves; 0, as published, takes ratings
        as draws that say nothing of the next.

    Notes
    -----
    Y. Guo, X. J. Yang, Modeling and predicting trust dynamics in human-robot teaming: a Bayesian
    inference approach, Int. J. Social Robotics 13, 2021 (arXiv 2007.13151). The update was checked
    against three public implementations. The anchor is not theirs.
    """

    title: ClassVar[str] = "Beta (Guo and Yang)"
    strength: float = parameter(10.0, 0.1, np.inf)
    success: float = parameter(1.0, 0.0, np.inf)
    failure: float = parameter(1.0, 0.0, np.inf)
    anchor: float = parameter(0.5, 0.0, 1.0)

    def start(self, rating) -> Counts:
        """
        Return the belief after a first rating; .5 where there is none.

        Parameters
        ----------
        rating : array_like, shape (N,)
            Ratings, 0 to 1.
        """
        return Counts.of(np.nan_to_num(np.atleast_1d(rating), nan=0.5), self.strength)

    def step(self, belief: Counts, event: Event) -> Counts:
        """
        Return the belief after an event.

        Parameters
        ----------
        belief : Counts
            The belief before it.
        event : Event
            Its p_r.
        """
        failed = 1.0 - event.p_r
        return Counts(belief.alpha + self.success * event.p_r, belief.beta + self.failure * failed)

    def learn(self, belief: Counts, rating) -> Counts:
        """
        Return the belief with its mean moved towards a rating; unchanged where that is NaN.

        Parameters
        ----------
        belief : Counts
            The belief before it.
        rating : array_like, shape (N,)
            Ratings, 0 to 1.
        """
        total = belief.alpha + belief.beta
        mean = belief.alpha / total
        return Counts.of(mean + self.anchor * np.nan_to_num(rating - mean), total)

    def rating(self, belief: Counts) -> BetaRating:
        """
        Return the distribution of the next rating.

        Parameters
        ----------
        belief : Counts
            The belief now.
        """
        return BetaRating(belief.alpha, belief.beta)
