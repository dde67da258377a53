"""
`sample_posterior`: from sessions to draws of every parameter.

A fit's optima are raised to the posterior's maxima; t distributions there propose points, which are
weighed and whose mixture is adapted; walkers come last.

[G] Goodman and Weare, Ensemble samplers with affine invariance, *Communications in Applied
Mathematics and Computational Science* 5 (2010), 65-80.
"""

from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np

from trustlab.identification.fitting import rough_optima
from trustlab.identification.log import LogSettings, log_settings, read_runs
from trustlab.identification.model import IdentificationError
from trustlab.identification.noise import whiteness_p
from trustlab.identification.posterior.coordinates import (
    Target,
    admissible,
    densities,
    to_thetas,
)
from trustlab.identification.posterior.importance import (
    Component,
    Sample,
    drawn,
    fitted_mixture,
    resampled,
    weighed,
)
from trustlab.identification.posterior.likelihood import (
    DELAY,
    OUTPUTS,
    SHARED,
    Blocks,
    blocks_of,
    innovations,
    simulate,
)
from trustlab.identification.posterior.priors import Normal, Prior, as_prior
from trustlab.identification.posterior.result import MOST_K, Posterior, physical
from trustlab.identification.posterior.search import Top, climb, starting_points
from trustlab.identification.problem import Optimum
from trustlab.identification.tsc import TSC
from trustlab.models.checks import whole_number, whole_seed
from trustlab.sessions.session import Session

# Ascents, and how far below the highest another maximum may lie: odds of e¹² to 1.
ASCENTS = 3
LOWER = 12.0

# A sample is good if k̂ says so and it is worth at least so many independent draws.
FEWEST = 1000.0

# Points that are weighed first, and in each round of adaptation; parts of the mixtures of rounds:
# first a single hill's true shape, then several for one that is bent.
POINTS = 4000
MORE_POINTS = 8000
ROUNDS = (1, 3, 3, 5)

# Walkers keep one of so many steps. After each round of kept steps it is asked whether they have
# gone for enough autocorrelation times, until there are the most.
STEPS = 10
ROUND = 200
MOST_KEPT = 2000
LENGTHS = 50


def sample_posterior(
    sessions: Session | Iterable[Session],
    prior: str | Prior = "weak",
    n: int = 1000,
    seed: int = 0,
    log: LogSettings | None = None,
    **settings: Any,
) -> Posterior:
    """
    Draw robot, operator and noise from their posterior, (2.3), (2.5) and (2.6).

    Unlike `fit_tsc` this answers for short logs, too: what the data leave open keeps the spread of
    the prior. Runs share the parameters; each has initial states of its own. The noise of each
    output is white plus a first-order process of unknown time constant.

    Parameters
    ----------
    sessions : Session or iterable of Session
        Runs of one person with columns mode, p_h and p_r.
    prior : {"weak", "published"} or Prior
        What is taken for granted: "weak" is wide around what such studies find, "published" is the
        spread of the six printed people, a half wider. `Prior` states your own.
    n : int
        Number of draws, 100 to 100,000.
    seed : int
        Seed of the draws.
    log : LogSettings, optional
        How the log shows the model: window, step, mode_delay, stamp_error, robust. Outliers are
        those of the fit, and noise is in the values that windows average or in their means,
        whichever is more likely. Errors of stamps count as one that all switches share.
    **settings : float or bool
        Fields of `LogSettings` as keywords; they replace those of `log`.

    Returns
    -------
    Posterior
        With `.table()`, `.models`, `.plot()` and `.message`.

    Raises
    ------
    IdentificationError
        If a run is shorter than eight seconds, or mode never changes in any run.
    SessionError
        If a column is missing.
    ValueError
        If an argument is not understood.

    Notes
    -----
    Switches of a rule that acts on what is logged tell nothing beyond the log. Where a rule knew
    more, its switches carry information that is not used.

    Examples
    --------
    >>> import trustlab as tl
    >>> session = tl.read_session("data/sessions/pilot.csv")
    >>> posterior = tl.sample_posterior(session)
    >>> posterior.table().loc["human_beta", ["ci_low", "ci_high"]].round(2).tolist()
    [0.74, 0.74]
    """
    prior = as_prior(prior)
    n = whole_number("n", n, least=100, most=100_000)
    log = log_settings(log, settings)
    runs = read_runs(sessions, "mode", *OUTPUTS, log=log)
    if all(np.ptp(run["mode"]) == 0.0 for run in runs):
        raise IdentificationError(
            "mode never changes within any run, so that neither rise nor decay is seen to end; "
            "record a run in which control changes hands"
        )
    optima = rough_optima(TSC, runs, TSC.limits(), robust=log.robust)
    target = target_of(optima[0], prior, log)
    rng = np.random.default_rng(whole_seed(seed))
    sampled = sample_target(target, tops_of(target, optima), rng, max(POINTS, 4 * n))
    thetas = to_thetas(resampled(sampled.sample, n, rng), target)
    step = runs[0].step
    return Posterior(
        draws=_columns(thetas, target, step),
        prior_draws=_columns(prior_thetas(target, 4000, rng), target, step),
        prior=prior,
        k_hat=float(sampled.sample.k_hat),
        effective=sampled.sample.effective,
        method=sampled.method,
        whiteness=_whiteness(thetas.mean(axis=0), target.blocks),
        labels=tuple(run.label for run in runs),
        synthetic=any(run.synthetic for run in runs),
        thetas=thetas,
        target=target,
    )


def target_of(optimum: Optimum, prior: Prior, log: LogSettings) -> Target:
    """
    Return data and prior; the delay of the mode is free where it is asked for or stamps err.

    As in the fit, whose best optimum this is, outliers are left out, and noise is in the means over
    a window or in the values, whichever is more likely.
    """
    runs = optimum.problem.runs
    mean, deviation, whitening = prior.vectors(len(runs))
    stamp_error = max(run.stamp_error for run in runs)
    delayed = log.mode_delay or stamp_error > 0.0
    if delayed and not log.mode_delay:
        error = Normal(0.0, stamp_error, "plain")
        deviation[DELAY] = error.spread
        whitening[DELAY, DELAY] = 1.0 / error.spread
    free = np.delete(np.arange(mean.size), [] if delayed else [DELAY])
    return Target(blocks_of(optimum.problem), mean, deviation, whitening, free)


def prior_thetas(target: Target, count: int, rng: np.random.Generator) -> np.ndarray:
    """Return draws of the prior that make a model."""
    factor = np.linalg.inv(target.whitening)
    drawn: list[np.ndarray] = []
    while len(drawn) < count:
        z = np.zeros((count, target.mean.size))
        z[:, target.free] = rng.standard_normal((count, target.free.size))
        for theta in target.mean + z @ factor.T:
            if admissible(theta):
                drawn.append(theta)
    return np.array(drawn[:count])


def _columns(thetas: np.ndarray, target: Target, step: float):
    """Return draws in their own units, without a delay that is not estimated."""
    table = physical(thetas, step)
    return table if DELAY in target.free else table.drop(columns="mode_delay")


def _whiteness(theta: np.ndarray, blocks: Blocks) -> dict[str, float]:
    """Return the p value of the Ljung–Box test of each output's prediction errors."""
    scaled = np.empty(blocks.measured.shape)
    innovations(theta, blocks, simulate(theta, blocks), scaled)
    p_values = {}
    for name, errors, known in zip(OUTPUTS, scaled, blocks.known, strict=True):
        parts = (np.split(each, blocks.first_block[1:-1]) for each in (errors, known))
        p_values[name] = whiteness_p([error[there] for error, there in zip(*parts, strict=True)])
    return p_values


# --- the sampler ----------------------------------------------------------------------------------


class Sampled(NamedTuple):
    """A weighted sample, and how it was made."""

    sample: Sample
    method: str


def good(sample: Sample) -> bool:
    """Return whether weights may be trusted as far as they tell."""
    return sample.k_hat <= MOST_K and sample.effective >= FEWEST


def tops_of(target: Target, optima: list[Optimum]) -> list[Top]:
    """Return the maxima that ascents from a fit's optima reach, the highest first."""
    climbed = [climb(x, target) for x in starting_points(target, optima)[:ASCENTS]]
    climbed.sort(key=lambda top: -top.value)
    apart: list[Top] = []
    for top in climbed:
        if top.value > climbed[0].value - LOWER and all(_apart(top, t) for t in apart):
            apart.append(top)
    return apart


def _apart(top: Top, higher: Top) -> bool:
    """Return whether a maximum lies outside of a higher one's hill."""
    distance = top.x - higher.x
    return bool(distance @ np.linalg.solve(higher.covariance, distance) > 4.0)


def proposals(tops: list[Top]) -> list[Component]:
    """Return a part for each maximum, a little wide, and one along the weakest directions."""
    highest = tops[0]
    parts = []
    for top in tops:
        _, log_volume = np.linalg.slogdet(top.covariance)
        weight = np.exp(top.value - highest.value + 0.5 * log_volume)
        parts.append(Component(weight, top.x, 1.15 * top.covariance))
    # A hill falls off more slowly than its top's curvature says where data tell least: three
    # directions are stretched to six times the variance, within one and a half prior variances.
    values, vectors = np.linalg.eigh(highest.covariance)
    values[-3:] = np.maximum(np.minimum(6.0 * values[-3:], 1.5), values[-3:])
    total = sum(part.weight for part in parts)
    return [*parts, Component(0.3 * total, highest.x, (vectors * values) @ vectors.T)]


def sample_target(
    target: Target, tops: list[Top], rng: np.random.Generator, count: int = POINTS
) -> Sampled:
    """
    Sample a posterior from its maxima.

    Proposals are adapted where weights are bad, and walkers come last.
    """
    mixture = proposals(tops)
    wide = Component(0.1, mixture[-1].centre, mixture[-1].scale)
    points = drawn(mixture, count, rng)
    values = densities(points, target)
    proposed = shared(mixture, count)
    sample = weighed(points, values, proposed)
    method = "importance"
    for parts in ROUNDS:
        if good(sample):
            break
        method = "adapted mixture"
        mixture = [*fitted_mixture(sample, parts, rng), wide]
        more = drawn(mixture, MORE_POINTS, rng)
        points = np.concatenate([points, more])
        values = np.concatenate([values, densities(more, target)])
        proposed += shared(mixture, MORE_POINTS)
        sample = weighed(points, values, proposed)
    if not good(sample):
        method = "ensemble"
        sample = walked(target, sample, rng)
    return Sampled(sample, method)


def shared(mixture: list[Component], count: int) -> list[Component]:
    """Return a mixture whose weights are the points that each part proposes of so many."""
    total = sum(part.weight for part in mixture)
    return [part._replace(weight=count * part.weight / total) for part in mixture]


def walked(target: Target, sample: Sample, rng: np.random.Generator) -> Sample:
    """
    Return points of emcee's walkers, which begin at draws of a weighted sample.

    They stretch ([G] Section 2) and do nothing else: differences of walkers as moves left a
    posterior a fifth too narrow, and no diagnostic told. The model's coordinates alone judge how
    far they have gone. Those of the noise may wait long for another explanation that data hardly
    tell apart: slow noise so quick that it is white. The model does not depend on it.
    """
    import emcee

    size = sample.points.shape[1]
    count = 2 * size + 4
    # A draw of great weight comes many times, and walkers must lie apart.
    points = resampled(sample, 10 * count, rng)
    points = points + 0.01 * rng.standard_normal(points.shape)
    begin = points[np.isfinite(densities(points, target))][:count]
    sampler = emcee.EnsembleSampler(
        count,
        size,
        densities,
        moves=emcee.moves.StretchMove(),
        args=[target],
        vectorize=True,
    )
    # emcee draws from a state of its own, which would be another one each time.
    sampler.random_state = np.random.MT19937(int(rng.integers(2**63))).state
    enough = False
    while not enough and sampler.iteration < MOST_KEPT:
        begin = sampler.run_mcmc(begin, ROUND, thin_by=STEPS)
        settled = sampler.get_chain(discard=sampler.iteration // 3)
        time = _autocorrelation_time(settled[:, :, :SHARED])
        enough = len(settled) > LENGTHS * time
    thin = settled[:: max(1, int(time / 4.0))].reshape(-1, size)
    weights = np.full(len(thin), 1.0 / len(thin))
    # There are no weights whose tail could be long; short chains are marked as bad weights are.
    return Sample(thin, weights, 0.0 if enough else np.inf, len(settled) * count / time)


def _autocorrelation_time(chains: np.ndarray) -> float:
    """Return the longest autocorrelation time of coordinates, shape (steps, walkers, size)."""
    import emcee

    # 0/0 where a walker never moved: an unknown time is as long as the chain.
    with np.errstate(invalid="ignore"):
        within = emcee.autocorr.integrated_time(chains, tol=0)
        # emcee takes each walker's own mean, so that walkers that stay apart look quick; their
        # means vary by the time over the steps.
        between = len(chains) * chains.mean(axis=0).var(axis=0) / chains.var(axis=(0, 1))
    return float(np.nan_to_num(np.maximum(within, between), nan=len(chains)).max())
