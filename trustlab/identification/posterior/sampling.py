"""
`sample_posterior`: from sessions to draws of every parameter.

A fit's optima are raised to the posterior's maxima; t distributions there propose points, which are
weighed, with Pareto-smoothed weights, and whose mixture is adapted; walkers come last.

[C] Cornuet, Marin, Mira and Robert, Adaptive multiple importance sampling, *Scandinavian Journal of
Statistics* 39 (2012), 798-812.
[G] Goodman and Weare, Ensemble samplers with affine invariance, *Communications in Applied
Mathematics and Computational Science* 5 (2010), 65-80.
[V] Vehtari, Simpson, Gelman, Yao and Gabry, Pareto smoothed importance sampling, *Journal of
Machine Learning Research* 25 (2024), 72.
[Z] Zhang and Stephens, A new and efficient estimation method for the generalized Pareto
distribution, *Technometrics* 51 (2009), 316-325.
"""

import itertools
from collections.abc import Iterable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from scipy import special, stats

from trustlab.identification.log import (
    LogSettings,
    log_settings,
    never_switches,
    read_runs,
    whiteness_p,
)
from trustlab.identification.model import IdentificationError
from trustlab.identification.posterior.density import (
    DELAY,
    FAR,
    H_MIN,
    H_SPAN,
    LEAST,
    ODDS,
    OUTPUTS,
    P_MIN,
    P_R0,
    P_SPAN,
    PER_RUN,
    R0,
    SHARED,
    SLOW,
    WHITE,
    Prior,
    Target,
    admissible,
    as_prior,
    blocks_of,
    coordinates_of,
    curvature,
    densities,
    evaluated,
    gradients,
    innovations,
    physical,
    point_of,
    simulate,
)
from trustlab.identification.posterior.result import MOST_K, Posterior
from trustlab.identification.problem import Optimum, rough_optima
from trustlab.identification.tsc import TSC
from trustlab.models.checks import whole_number, whole_seed
from trustlab.sessions.session import Session

# --- where ascents begin -------------------------------------------------------------------------

# Prior deviations from the mean within which an ascent begins: further out the prior would rule.
BULK = 2.4


def starting_points(target: Target, optima: list[Optimum]) -> list[np.ndarray]:
    """Return points of the optima of a fit, drawn to the prior, and of its mean; the best first."""
    mean, blocks = target.mean, target.blocks
    bulk = mean - BULK * target.deviation, mean + BULK * target.deviation
    points = []
    for theta in (*(_theta(optimum, target) for optimum in optima), mean):
        theta = np.clip(theta, *bulk)
        errors = np.where(blocks.known, blocks.measured - simulate(theta, blocks), 0.0)
        spread = np.sqrt(np.mean(errors**2, axis=1)) + 1e-7
        theta[WHITE], theta[SLOW] = np.log(spread * np.sqrt(blocks.samples)), np.log(spread)
        # To a thousandth of a prior deviation: the same place on every processor.
        points.append(np.round(point_of(np.clip(theta, *bulk), target), 3))
    measured = np.average(blocks.measured, axis=1, weights=blocks.known)
    low, span = [H_MIN, P_MIN], [H_SPAN, P_SPAN]
    ranges = FAR * target.deviation[low] + np.exp(bulk[1][span])
    values = densities(np.array(points), target)
    if values.max() == -np.inf or (np.abs(measured - mean[low]) > ranges).any():
        raise IdentificationError(
            f"the data lie far from what the prior expects: p_h is {measured[0]:.3g} and p_r "
            f"{measured[1]:.3g} on average; state the scale of your measure with "
            "prior=trustlab.Prior(human_p_min=(…, …), human_span=(…, …), robot_p_min=(…, …), "
            "robot_span=(…, …))"
        )
    return [points[i] for i in np.argsort(-values, kind="stable") if values[i] > -np.inf]


def _theta(optimum: Optimum, target: Target) -> np.ndarray:
    """Return θ of a fit's optimum, noise at the prior's mean."""
    theta, values = target.mean.copy(), optimum.values()
    theta[:SHARED] = coordinates_of(values, target.blocks.step)
    theta[R0::PER_RUN] = ODDS.to(np.clip(values["r0"], LEAST, 1.0 - LEAST))
    theta[P_R0::PER_RUN] = values["p_r0"] - values["robot_p_min"]
    return theta


# --- ascents --------------------------------------------------------------------------------------

# Least curvature that ascents and proposals go by: nothing is wider than two prior deviations.
LEAST_CURVATURE = 0.25

# Slope per prior deviation at which an ascent ends, and minus the density where it is zero.
CLOSE = 1e-2
NOWHERE = 1e10

# Ascents, and how far below the highest another maximum may lie: odds of e¹² to 1.
ASCENTS = 3
LOWER = 12.0


class Top(NamedTuple):
    """A maximum of the density: where, the logarithm there, and the covariance of its hill."""

    x: np.ndarray
    value: float
    covariance: np.ndarray


def hill(x: np.ndarray, target: Target) -> np.ndarray:
    """Return the inverse of the curvature's size, which has a least value in any direction."""
    values, vectors = np.linalg.eigh(curvature(x, target))
    root = vectors / np.sqrt(np.maximum(np.abs(values), LEAST_CURVATURE))
    return root @ root.T


def climb(x: np.ndarray, target: Target) -> Top:
    """Return the maximum that an ascent from x reaches."""
    from scipy.optimize import minimize

    end = minimize(
        lambda x: min(-densities(x[None], target)[0], NOWHERE),
        x,
        jac=lambda x: -gradients(x[None], target)[0],
        method="BFGS",
        options={"gtol": CLOSE, "maxiter": 100, "hess_inv0": hill(x, target)},
    )
    step = hill(end.x, target) @ gradients(end.x[None], target)[0]
    # After Newton's step, and rounded, it is the same point on every processor. Where an ascent
    # stopped short, the step may lead to where there is no model.
    points = np.array([*np.round([end.x + step, end.x], 4), x])
    values = densities(points, target)
    best = int(np.argmax(values >= values[-1]))
    return Top(points[best], float(values[best]), hill(points[best], target))


def tops_of(target: Target, optima: list[Optimum]) -> list[Top]:
    """Return the maxima that ascents from a fit's optima reach, the highest first."""
    climbed = [climb(x, target) for x in starting_points(target, optima)[:ASCENTS]]
    climbed.sort(key=lambda top: -top.value)
    tops: list[Top] = []
    for top in climbed:
        # Outside of the hills of higher ones.
        steps = [(top.x - other.x, other.covariance) for other in tops]
        apart = all(step @ np.linalg.solve(hill, step) > 4.0 for step, hill in steps)
        if top.value > climbed[0].value - LOWER and apart:
            tops.append(top)
    return tops


# --- importance sampling -------------------------------------------------------------------------

# Degrees of freedom of the proposals: tails that are heavier than a normal posterior's.
FREEDOM = 7.0

# Independent points that a proposal is adapted to at least.
LEVEL = 80.0


class Component(NamedTuple):
    """One part of a mixture: its weight, centre and scale matrix."""

    weight: float
    centre: np.ndarray
    scale: np.ndarray


class Sample(NamedTuple):
    """
    Weighted points: coordinates (N, d), weights that add up to 1, and diagnostics.

    `k_hat` is the shape of the weights' tail ([V]: above 0.7 they are not to be trusted),
    `effective` the number of equally weighted points that would serve as well.
    """

    points: np.ndarray
    weights: np.ndarray
    k_hat: float
    effective: float


def weighed(points: np.ndarray, log_weights: np.ndarray) -> Sample:
    """Return points with weights whose tail is smoothed, [V] Section 2.1."""
    weights = np.exp(log_weights - log_weights.max())
    tail = int(min(0.2 * weights.size, 3.0 * np.sqrt(weights.size)))
    order = np.argsort(weights, kind="stable")
    cut, highest = weights[order[-tail - 1]], order[-tail:]
    k_hat = np.inf
    if cut < 1.0:
        k_hat, scale = pareto_fit(np.maximum(weights[highest] - cut, 1e-300))
        ranks = (np.arange(1, tail + 1) - 0.5) / tail
        quantiles = -scale * special.boxcox1p(-ranks, -k_hat)
        weights[highest] = np.minimum(cut + quantiles, 1.0)
    weights /= weights.sum()
    return Sample(points, weights, float(k_hat), float(1.0 / np.sum(weights**2)))


def pareto_fit(excess: np.ndarray) -> tuple[float, float]:
    """Return shape and scale of a generalized Pareto distribution of sorted excesses, [Z]."""
    size = excess.size
    points = 30 + int(np.sqrt(size))
    grid = 1.0 - np.sqrt(points / (np.arange(1, points + 1) - 0.5))
    grid = grid / (3.0 * excess[int(size / 4 + 0.5) - 1]) + 1.0 / excess[-1]
    shapes = np.mean(np.log1p(-grid[:, None] * excess), axis=1)
    profile = size * (np.log(-grid / shapes) - shapes - 1.0)
    best = special.softmax(profile) @ grid
    shape = float(np.mean(np.log1p(-best * excess)))
    # The shape is drawn to 0.5 as ten more excesses would ([V] Appendix C).
    return (size * shape + 10.0 * 0.5) / (size + 10.0), -shape / best


def log_parts(points: np.ndarray, parts: list[Component]) -> np.ndarray:
    """Return the logarithm of each part's weight times density, shape (points, parts)."""
    densities = [stats.multivariate_t(p.centre, p.scale, FREEDOM).logpdf(points) for p in parts]
    return np.column_stack(densities) + np.log([part.weight for part in parts])


def drawn(parts: list[Component], count: int, rng: np.random.Generator) -> np.ndarray:
    """Return points of a mixture, in random order."""
    shares = np.array([part.weight for part in parts])
    points = []
    for part, number in zip(parts, rng.multinomial(count, shares / shares.sum()), strict=True):
        # SciPy draws by singular vectors, whose signs may differ between processors.
        normal = rng.standard_normal((number, part.centre.size)) @ np.linalg.cholesky(part.scale).T
        deviation = np.sqrt(rng.chisquare(FREEDOM, (number, 1)) / FREEDOM)
        points.append(part.centre + normal / deviation)
    return rng.permutation(np.concatenate(points))


def adapted(sample: Sample) -> Component:
    """Return a proposal of a weighted sample's mean and covariance, a little wide."""
    weights = np.maximum(sample.weights, 1e-300)
    while 1.0 / np.sum(weights**2) < LEVEL:  # few points carry all weight: level them
        weights = weights**0.6
        weights /= weights.sum()
    scale = np.cov(sample.points.T, aweights=weights) + 1e-6 * np.eye(sample.points.shape[1])
    return Component(1.0, weights @ sample.points, 1.1 * scale)


def resampled(sample: Sample, count: int, rng: np.random.Generator) -> np.ndarray:
    """Return so many equally weighted points, in random order."""
    at = (np.arange(count) + rng.random()) / count
    rows = np.minimum(np.searchsorted(np.cumsum(sample.weights), at), len(sample.points) - 1)
    return sample.points[rng.permutation(rows)]


# --- the sampler ----------------------------------------------------------------------------------

# A sample is good if k̂ says so and it is worth at least so many independent draws; proposals are
# adapted until it is worth more.
FEWEST = 1000.0
ENOUGH = 2000.0

# Points that are weighed first, and in each round of adaptation; how many of these.
POINTS = 4000
MORE_POINTS = 8000
ROUNDS = 6

# Walkers keep one of so many steps. After each round of kept steps it is asked whether they have
# gone for enough autocorrelation times, until there are the most.
STEPS = 10
ROUND = 200
MOST_KEPT = 2000
LENGTHS = 50


def proposals(tops: list[Top]) -> list[Component]:
    """Return a part for each maximum, a little wide, and one along the weakest directions."""
    highest = tops[0]
    parts = []
    for top in tops:
        log_volume = np.linalg.slogdet(top.covariance).logabsdet
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
) -> tuple[Sample, str]:
    """
    Sample a posterior from its maxima: return a weighted sample, and how it was made.

    Proposals are adapted where weights are bad, and walkers come last. A part of a mixture weighs
    as many points as it proposed, so that rounds add up to one mixture ([C]: no round is chosen for
    its luck).
    """
    mixture = proposals(tops)
    wide = mixture[-1]._replace(weight=0.1)
    points, values = np.empty((0, wide.centre.size)), np.empty(0)
    proposed: list[Component] = []
    for turn in range(1 + ROUNDS):
        more = drawn(mixture, count, rng)
        points = np.concatenate([points, more])
        values = np.concatenate([values, densities(more, target)])
        total = sum(part.weight for part in mixture)
        proposed += [part._replace(weight=count * part.weight / total) for part in mixture]
        log_weights = values - special.logsumexp(log_parts(points, proposed), axis=1)
        sample = weighed(points, log_weights)
        good = sample.k_hat <= MOST_K and sample.effective >= FEWEST
        if good and (sample.effective >= ENOUGH or turn == ROUNDS):
            return sample, "adapted mixture" if turn else "importance"
        mixture, count = [adapted(sample), wide], MORE_POINTS
    return walked(target, sample, rng), "ensemble"


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


# --- sample_posterior ----------------------------------------------------------------------------


@np.errstate(under="ignore")
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
        How the log shows the model: window, mode_delay, stamp_error, robust. Outliers are
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
    if never_switches(runs):
        raise IdentificationError(
            "mode never changes within any run, so that neither rise nor decay is seen to end; "
            "record a run in which control changes hands"
        )
    optima = rough_optima(TSC, runs, TSC.limits(), robust=log.robust)
    target = target_of(optima[0], prior, log)
    rng = np.random.default_rng(whole_seed(seed))
    sample, method = sample_target(target, tops_of(target, optima), rng, max(POINTS, 4 * n))
    thetas = evaluated(resampled(sample, n, rng), target)[0]
    unused = [] if DELAY in target.free else ["mode_delay"]
    draws, before = (
        physical(rows, runs[0].sample_time).drop(columns=unused)
        for rows in (thetas, prior_thetas(target, 4000, rng))
    )
    return Posterior(
        draws=draws,
        prior_draws=before,
        prior=prior,
        k_hat=sample.k_hat,
        effective=sample.effective,
        method=method,
        whiteness=_whiteness(thetas.mean(axis=0), target),
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
    stamp_error = max(run.stamp_error for run in runs)
    if stamp_error > 0.0 and not log.mode_delay:
        prior = replace(prior, mode_delay=(0.0, stamp_error))
    mean, deviation, whitening = prior.vectors(len(runs))
    fixed = [] if log.mode_delay or stamp_error > 0.0 else [DELAY]
    free = np.delete(np.arange(mean.size), fixed)
    return Target(blocks_of(optimum.problem), mean, deviation, whitening, free)


def prior_thetas(target: Target, count: int, rng: np.random.Generator) -> np.ndarray:
    """Return those of so many draws of the prior that make a model."""
    z = np.zeros((count, target.mean.size))
    z[:, target.free] = rng.standard_normal((count, target.free.size))
    thetas = target.mean + z @ np.linalg.inv(target.whitening).T
    return thetas[admissible(thetas)]


def _whiteness(theta: np.ndarray, target: Target) -> dict[str, float]:
    """Return the p value of the Ljung–Box test of each output's prediction errors."""
    blocks = target.blocks
    scaled = np.empty(blocks.measured.shape)
    innovations(theta, blocks, simulate(theta, blocks), scaled)
    runs = [slice(*ends) for ends in itertools.pairwise(blocks.first_block)]
    return {
        name: whiteness_p([errors[run][known[run]] for run in runs])
        for name, errors, known in zip(OUTPUTS, scaled, blocks.known, strict=True)
    }
