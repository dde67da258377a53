"""
`fit_population`: several people at once, each held by what the others show (partial pooling).

Parameters of people are normal, with a mean and a covariance that are sampled.

[L] Lunn, Barrett, Sweeting and Thompson, Fully Bayesian hierarchical modelling in two stages, with
application to meta-analysis, *Applied Statistics* 62 (2013), 551-572: draws of each person alone
serve the Gibbs sampler of all.
[H] Huang and Wand, Simple marginally noninformative prior distributions for covariance matrices,
*Bayesian Analysis* 8 (2013), 439-452.

Coordinates z are θ of the first seven parameters, whitened by the prior. Half of the prior's
variance is that of the population's mean, half the expected variance within it, so that a person of
a population has the same prior, but for heavier tails, as a person alone.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from tqdm import tqdm

from trustlab.identification.log import LogSettings, as_list, each_once
from trustlab.identification.posterior.density import (
    R0,
    SHARED,
    Prior,
    admissible,
    as_prior,
    physical,
    prior_of,
)
from trustlab.identification.posterior.result import (
    MODEL,
    WORDS,
    Posterior,
    interval_words,
    summary,
)
from trustlab.identification.posterior.sampling import resampled, sample_posterior, weighed
from trustlab.models.checks import flag, one_of, open_unit, whole_number, whole_seed
from trustlab.models.display import Result
from trustlab.sessions.session import Session

# Variance of the population's mean. A spread within the population is half-t, [H]; its degrees of
# freedom give correlations a standard deviation of 1/√(FREEDOM + 1), its scale the variance left.
OF_MEAN = 0.5
FREEDOM = 8.0
SCALE = np.sqrt((1.0 - OF_MEAN) * (FREEDOM - 2.0) / FREEDOM)

# Draws of the covariance for each of the people: without these the sampler moves slowly.
REPEATS = 4

# Steps of the Gibbs sampler, and how many of them are left out at its beginning.
STEPS = 4000
SETTLING = 800


class Pool(NamedTuple):
    """
    What the Gibbs sampler draws.

    Means (steps, 7) and covariances (steps, 7, 7) of the population; for every person the
    probability of each of their draws.
    """

    means: np.ndarray
    covariances: np.ndarray
    weights: list[np.ndarray]


def pool(draws: list[np.ndarray], base: list[np.ndarray], rng: np.random.Generator) -> Pool:
    """
    Sample mean and covariance of a population, and who its people are.

    Parameters
    ----------
    draws : list of numpy.ndarray
        Of each person the draws z, shape (draws, 7), under a prior of their own.
    base : list of numpy.ndarray
        Minus the logarithm of that prior's density at the draws.
    rng : numpy.random.Generator
        Random numbers.
    """
    size = draws[0].shape[1]
    weights = [np.zeros(len(each)) for each in draws]
    people = np.array([each.mean(axis=0) for each in draws])
    covariance = SCALE**2 * np.eye(size)
    means = np.empty((STEPS, size))
    covariances = np.empty((STEPS, size, size))
    for step in range(STEPS):
        means[step] = _mean(people, covariance, rng)
        for _ in range(REPEATS):
            covariance = _covariance(people - means[step], covariance, rng)
        covariances[step] = covariance
        whitening = np.linalg.inv(np.linalg.cholesky(covariance))
        for i, each in enumerate(draws):
            # A draw with probability ∝ exp(base) · normal density.
            normal = each @ whitening.T - whitening @ means[step]
            logarithms = base[i] - 0.5 * np.einsum("ki,ki->k", normal, normal)
            probability = np.exp(logarithms - logarithms.max())
            passed = probability.cumsum()
            if step >= SETTLING:
                weights[i] += probability / passed[-1]
            people[i] = each[np.searchsorted(passed, rng.random() * passed[-1], side="right")]
    shares = [each / each.sum() for each in weights]
    return Pool(means[SETTLING:], covariances[SETTLING:], shares)


def _mean(people: np.ndarray, covariance: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return a draw of the population's mean."""
    count, size = people.shape
    precision = np.linalg.inv(covariance)
    posterior = np.linalg.inv(count * precision + np.eye(size) / OF_MEAN)
    centre = posterior @ precision @ people.sum(axis=0)
    return centre + np.linalg.cholesky(posterior) @ rng.standard_normal(size)


def _covariance(apart: np.ndarray, covariance: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return a draw of the population's covariance, [H] (2), by way of its auxiliary scales."""
    count, size = apart.shape
    rates = FREEDOM * np.diag(np.linalg.inv(covariance)) + SCALE**-2
    auxiliary = rates / rng.gamma(0.5 * (FREEDOM + size), size=size)
    scatter = apart.T @ apart + 2.0 * FREEDOM * np.diag(1.0 / auxiliary)
    # The inverse has a Wishart distribution, here by Bartlett's decomposition.
    freedom = FREEDOM + size - 1.0 + count
    triangle = np.tril(rng.standard_normal((size, size)), -1)
    triangle += np.diag(np.sqrt(rng.chisquare(freedom - np.arange(size))))
    root = np.linalg.cholesky(np.linalg.inv(scatter)) @ triangle
    return np.linalg.inv(root @ root.T)


# Draws of each person that the population is sampled from.
DRAWS = 2000

# In the second pass each is drawn under what the first predicts, with deviations this much
# greater.
WIDER = 1.2

# The row of tables for a person who was not recorded.
NEW = "new person"


@dataclass(frozen=True, eq=False, repr=False)
class Population(Result):
    """
    People who were recorded alike, and what they say of one who was not.

    Parameters
    ----------
    posteriors : dict of Posterior
        Of every person, each under what the others show.
    alone : dict of Posterior
        Of every person, under the prior alone.
    new_person : pandas.DataFrame
        New people, each of another draw of the population's mean and covariance.
    prior : Prior
        What is expected of a new person: the prior for the next one's sessions.
    """

    posteriors: dict[str | int, Posterior]
    alone: dict[str | int, Posterior]
    new_person: pd.DataFrame
    prior: Prior

    how_to_get = "trustlab.fit_population({name: sessions, …}) returns one"

    def __len__(self) -> int:
        return len(self.posteriors)

    def posterior(self, name: str | int) -> Posterior:
        """
        Return the posterior of one person.

        Parameters
        ----------
        name : str or int
            As given to `fit_population`.

        Raises
        ------
        ValueError
            If there is no such person.
        """
        known = {str(each): each for each in self.posteriors}
        return self.posteriors[known[one_of("name", str(name), known)]]

    @property
    def synthetic(self) -> bool:
        """Whether any of the data were simulated."""
        return any(each.synthetic for each in self.posteriors.values())

    @property
    def title(self) -> str:
        """How many people."""
        origin = ", synthetic data" if self.synthetic else ""
        return f"Population of {len(self)}{origin}"

    def table(self, level: float = 0.95) -> pd.DataFrame:
        """
        Return every person's parameters beside what their own sessions alone say.

        Parameters
        ----------
        level : float
            Level of the intervals, in (0, 1).

        Returns
        -------
        pandas.DataFrame
            Index `person` and `parameter`, "new person" last; columns mean, sd, ci_low, ci_high,
            alone_mean and alone_sd, NaN for the new person.

        Raises
        ------
        ValueError
            If `level` is outside (0, 1).
        """
        level = open_unit("level", level)
        tables = {}
        for name, posterior in self.posteriors.items():
            alone = self.alone[name].draws[list(MODEL)]
            table = summary(posterior.draws[list(MODEL)], level)
            tables[name] = table.assign(alone_mean=alone.mean(), alone_sd=alone.std())
        tables[NEW] = summary(self.new_person, level)
        return pd.concat(tables, names=["person", "parameter"])

    @cached_property
    def message(self) -> str:
        """What is expected of a new person, and whose draws to doubt."""
        table = self.table().loc[NEW]
        expected = [f"{WORDS[name]} {interval_words(row)}" for name, row in table.iterrows()]
        sentences = [f"{len(self)} people; of a new one they predict {', '.join(expected)}."]
        for name, posterior in self.posteriors.items():
            sentences += [f"{name}: {doubt}" for doubt in posterior.doubts()]
        return " ".join(sentences)


@np.errstate(under="ignore")
def fit_population(
    people: Mapping[str | int, Session | Iterable[Session]],
    prior: str | Prior = "weak",
    n: int = 1000,
    seed: int = 0,
    log: LogSettings | None = None,
    progress: bool | None = None,
    **settings: Any,
) -> Population:
    """
    Draw the parameters of several people, and of the population that they come from.

    The seven parameters of a person are normal about a mean, in the coordinates of `Prior`; mean
    and covariance of the population are drawn, too, so that a few people do not pretend to show
    its spread. Each person is held by the others as far as these are alike (partial pooling).
    Initial states and noise are each person's own.

    Parameters
    ----------
    people : mapping of str or int to Session or iterable of Session
        Sessions of each person, as for `sample_posterior`; two people at least.
    prior : {"weak", "published"} or Prior
        What is taken for granted about the population's mean, about noise and initial states.
    n : int
        Number of draws of each person, 100 to 100,000.
    seed : int
        Seed of the draws.
    log : LogSettings, optional
        As for `sample_posterior`.
    progress : bool, optional
        Whether to show progress on stderr; by default where it is a terminal.
    **settings : float or bool
        Fields of `LogSettings` as keywords.

    Returns
    -------
    Population
        With `.posterior(name)`, `.table()`, `.message`, and `.prior`, what is expected
        of a new person.

    Raises
    ------
    ValueError
        If there are fewer than two people, or an argument is not understood.
    IdentificationError
        As `sample_posterior`.

    Notes
    -----
    Half of the prior's variance is that of the population's mean, half the expected variance within
    it: spreads are half-t with eight degrees of freedom, and correlations lie about 0 with a
    standard deviation of 1/3, in coordinates that the prior makes independent.

    Examples
    --------
    >>> import trustlab as tl
    >>> logs = {who: tl.read_session(f"data/sessions/participant_{who}.parquet") for who in "24"}
    >>> people = tl.fit_population({k: log.between(900.0, 1500.0) for k, log in logs.items()})
    >>> people.table().loc["2"].shape
    (7, 6)
    >>> next_person = tl.sample_posterior(logs["4"].between(500.0, 800.0), prior=people.prior)
    """
    if not isinstance(people, Mapping) or len(people) < 2:
        raise ValueError(
            "people must map names to sessions, of two people at least; of one person, "
            "sample_posterior(sessions) draws"
        )
    texts = [*map(str, people), NEW]
    if repeated := [text for text in texts if texts.count(text) > 1]:
        raise ValueError(
            f"people: {repeated[0]!r} names two rows of the table ({NEW!r} is its last); name "
            "people apart"
        )
    prior = as_prior(prior)
    n = whole_number("n", n, least=100, most=100_000)
    root = np.random.SeedSequence(whole_seed(seed))
    seeds = [int(value) for value in root.generate_state(2 * len(people))]
    rng = np.random.default_rng(root)
    sessions = {name: as_list(each) for name, each in people.items()}
    each_once([session for of_person in sessions.values() for session in of_person])
    expected = prior
    alone: dict[str | int, Posterior] = {}
    hidden = None if progress is None else not flag("progress", progress)
    steps = iter(tqdm(seeds, unit="posterior", disable=hidden))
    for _ in range(2):
        # Under the prior first, then under what the others show.
        drawn = {
            name: sample_posterior(each, expected, max(n, DRAWS), next(steps), log, **settings)
            for name, each in sessions.items()
        }
        alone = alone or drawn
        pooled = _pooled(list(drawn.values()), prior, rng)
        thetas = _new_people(pooled, prior, rng)
        expected = _prediction(thetas, prior, WIDER)
    pairs = zip(drawn.items(), pooled.weights, strict=True)
    return Population(
        posteriors={name: _reweighted(each, shares, n, rng) for (name, each), shares in pairs},
        alone=alone,
        new_person=physical(np.pad(thetas, ((0, 0), (0, R0 - SHARED))), 0.1)[list(MODEL)],
        prior=_prediction(thetas, prior, 1.0),
    )


def _pooled(posteriors: list[Posterior], prior: Prior, rng: np.random.Generator) -> Pool:
    """Return draws of the population; each person's own prior is divided out."""
    mean, _, whitening = prior.vectors(0)
    draws = [_whitened(each.thetas, mean, whitening) for each in posteriors]
    own = [_whitened(each.thetas, each.target.mean, each.target.whitening) for each in posteriors]
    return pool(draws, [0.5 * (z**2).sum(axis=1) for z in own], rng)


def _whitened(thetas: np.ndarray, mean: np.ndarray, whitening: np.ndarray) -> np.ndarray:
    """Return the first seven coordinates of rows of θ as standard normal ones."""
    return (thetas[:, :SHARED] - mean[:SHARED]) @ whitening[:SHARED, :SHARED].T


def _new_people(pooled: Pool, prior: Prior, rng: np.random.Generator) -> np.ndarray:
    """Return a person of each draw of the population, θ of those who make a model."""
    mean, _, whitening = prior.vectors(0)
    normal = rng.standard_normal(pooled.means.shape)
    z = pooled.means + np.einsum("sij,sj->si", np.linalg.cholesky(pooled.covariances), normal)
    thetas = mean[:SHARED] + z @ np.linalg.inv(whitening[:SHARED, :SHARED]).T
    return thetas[admissible(thetas)]


def _prediction(thetas: np.ndarray, prior: Prior, wider: float) -> Prior:
    """Return the prior of people like these, with deviations so much greater."""
    # Rounded, so that last bits, which differ between processors, are not what draws start from.
    mean = np.round(thetas.mean(axis=0), 8)
    return prior_of(mean, np.round(wider**2 * np.cov(thetas.T), 8), prior)


def _reweighted(
    posterior: Posterior, weights: np.ndarray, n: int, rng: np.random.Generator
) -> Posterior:
    """Return a person's posterior with draws chosen by weight."""
    sample = weighed(np.arange(weights.size), np.log(np.maximum(weights, 1e-300)))
    rows = resampled(sample, n, rng)
    return replace(
        posterior,
        draws=posterior.draws.iloc[rows].reset_index(drop=True),
        thetas=posterior.thetas[rows],
        k_hat=sample.k_hat,
        effective=sample.effective,
        method="population",
    )
