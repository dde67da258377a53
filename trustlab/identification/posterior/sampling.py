"""`sample_posterior`: from sessions to draws of every parameter."""

from collections.abc import Iterable
from typing import Any

import numpy as np

from trustlab.identification.log import LogSettings, Run, log_settings, read_runs
from trustlab.identification.model import IdentificationError
from trustlab.identification.noise import outliers, robust_deviation, whiteness_p
from trustlab.identification.posterior.blocks import OUTPUTS, blocks_of
from trustlab.identification.posterior.coordinates import Target, admissible, to_thetas
from trustlab.identification.posterior.draws import physical
from trustlab.identification.posterior.importance import resampled
from trustlab.identification.posterior.likelihood import (
    DELAY,
    Blocks,
    innovations,
    simulate,
)
from trustlab.identification.posterior.priors import Normal, Prior, as_prior
from trustlab.identification.posterior.result import Posterior
from trustlab.identification.posterior.sampler import POINTS, sample_target, tops_of
from trustlab.identification.posterior.search import Top
from trustlab.models.checks import whole_number, whole_seed
from trustlab.sessions.session import Session


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
        How the log shows the model: window, step, mode_delay, stamp_error, robust. Noise is in the
        values that windows average. Errors of stamps count as one that all switches share.
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
    target = target_of(runs, prior, log)
    rng = np.random.default_rng(whole_seed(seed))
    if log.robust:
        target, tops = without_outliers(target, rng)
    else:
        tops = tops_of(target, rng)
    sampled = sample_target(target, tops, rng, max(POINTS, 4 * n))
    thetas = to_thetas(resampled(sampled.sample, n, rng), target)
    step = runs[0].sample_time if log.step is None else log.step
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


def target_of(runs: list[Run], prior: Prior, log: LogSettings) -> Target:
    """Return data and prior; the delay of the mode is free where it is asked for or stamps err."""
    mean, deviation, whitening = prior.vectors(len(runs))
    stamp_error = max(run.stamp_error for run in runs)
    delayed = log.mode_delay or stamp_error > 0.0
    if not log.mode_delay and stamp_error > 0.0:
        error = Normal(0.0, stamp_error, "plain")
        deviation[DELAY] = error.spread
        whitening[DELAY, DELAY] = 1.0 / error.spread
    free = np.delete(np.arange(mean.size), [] if delayed else [DELAY])
    return Target(blocks_of(runs), mean, deviation, mean.copy(), whitening, free)


def without_outliers(target: Target, rng: np.random.Generator) -> tuple[Target, list[Top]]:
    """Return the target without blocks far from the model all of a sudden, and its maxima."""
    for _ in range(2):
        tops = tops_of(target, rng)
        blocks = target.blocks
        errors = blocks.measured - simulate(to_thetas(tops[0].x[None], target)[0], blocks)
        measured = blocks.measured.copy()
        for j in range(len(OUTPUTS)):
            known = ~np.isnan(errors[j])
            scale = robust_deviation([errors[j][known]])
            far = outliers(np.where(known, errors[j], 0.0), scale)
            # More than a quarter are no outliers: the model does not describe these data.
            if far.sum() < 0.25 * known.sum():
                measured[j][far] = np.nan
        if np.array_equal(np.isnan(measured), np.isnan(blocks.measured)):
            return target, tops
        target = target._replace(blocks=blocks._replace(measured=measured))
    return target, tops_of(target, rng)


def prior_thetas(target: Target, count: int, rng: np.random.Generator) -> np.ndarray:
    """Return draws of the prior that make a model."""
    factor = np.linalg.inv(target.whitening)
    drawn: list[np.ndarray] = []
    while len(drawn) < count:
        z = np.zeros((count, target.centre.size))
        z[:, target.free] = rng.standard_normal((count, target.free.size))
        for theta in target.centre + z @ factor.T:
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
    for j, name in enumerate(OUTPUTS):
        parts = np.split(scaled[j], blocks.first_block[1:-1])
        p_values[name] = whiteness_p([part[~np.isnan(part)] for part in parts])
    return p_values
