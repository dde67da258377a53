"""Logs of people drawn from the prior, or of the printed ones, with noise of three kinds."""

import numpy as np
from scipy.signal import lfilter

import trustlab as tl
from tests.identification.cases import log
from trustlab.identification.posterior.density import (
    DELAY,
    NOISES,
    P_R0,
    R0,
    Target,
    as_prior,
    physical,
    transformed,
)
from trustlab.identification.posterior.sampling import prior_thetas
from trustlab.sessions.metrics import window_mean

STEP = 0.1
WINDOW = 100.0
# Standard deviations of white and slow noise per sample, and the time constant [s].
NOISE = {"white": (0.005, 0.0, 1.0), "slow": (0.0, 0.005, 5.0), "means": (0.0, 0.005, 5.0)}


def switching(rng, size, switches=3):
    """A mode that begins manual and changes at random times, in long logs at least 30 s apart."""
    least = min(300, size // 10)
    while True:
        times = np.sort(rng.integers(least, size - least, switches))
        if (np.diff(times) > least).all():
            return (np.searchsorted(times, np.arange(size), side="right") % 2 == 0) * 1.0


def first_order(rng, size, deviation, seconds):
    """First-order noise in steady state from the first sample."""
    phi = np.exp(-STEP / seconds)
    shocks = rng.normal(0.0, deviation * np.sqrt(1.0 - phi**2), size)
    shocks[0] = rng.normal(0.0, deviation)
    return lfilter([1.0], [1.0, -phi], shocks)


def with_noise(rng, run, noises, window=0.0):
    """A session of a simulated run, noise (white, slow, seconds) by output added, then averaged."""
    columns = {}
    for name, (white, slow, seconds) in noises.items():
        values = run[name].to_numpy() + rng.normal(0.0, max(white, 1e-12), len(run))
        values = values + first_order(rng, len(run), slow, seconds)
        columns[name] = window_mean(values, STEP, window) if window else values
    return log(STEP, mode=run["mode"].to_numpy(), **columns).with_metadata(
        performance_window=window
    )


def noisy(rng, run, kind):
    """A session of a simulated run with noise of one kind."""
    noises = dict.fromkeys(("p_h", "p_r"), NOISE[kind])
    return with_noise(rng, run, noises, WINDOW if kind == "means" else 0.0)


def person_case(rng, shared, kind, minutes=10.0):
    """A session in open loop of a person of these seven coordinates, and their parameters."""
    theta = np.zeros(P_R0 + 1)
    theta[:7] = shared
    theta[R0] = rng.uniform(-4.0, -1.0)
    run = run_of(rng, *model_of(theta), "open", round(600 * minutes))
    return noisy(rng, run, kind), physical(theta[None], STEP).iloc[0]


def model_of(theta):
    """The model of the first seven parameters, and its initial states."""
    human_time, odds, h_min, h_span, robot_time, p_min, p_span = theta[:7]
    top = h_min + np.exp(h_span)
    human = tl.HumanModel(
        np.exp(-STEP / np.exp(human_time)), 1.0 / (1.0 + np.exp(-odds)), h_min, top
    )
    robot = tl.RobotModel(np.exp(-STEP / np.exp(robot_time)), p_min, p_min + np.exp(p_span), top)
    return (
        tl.TscModel(robot, human),
        1.0 / (1.0 + np.exp(-theta[R0])),
        p_min + theta[P_R0],
    )


def run_of(rng, tsc, r0, p_r0, loop, size):
    """A run in open loop, or under thresholds within the limits."""
    if loop == "open":
        return tsc.simulate(switching(rng, size), r0, p_r0)
    limits = tl.threshold_limits(tsc, 0.0)
    span = limits.upper - limits.lower
    lower, upper = limits.lower + 0.3 * span, limits.lower + 0.75 * span
    return tl.simulate_allocation(tsc, lower, upper, size, r0, p_r0)


def any_target(prior="weak"):
    """A target that holds a prior, of no data."""
    mean, deviation, whitening = as_prior(prior).vectors(1)
    free = np.delete(np.arange(mean.size), DELAY)
    return Target(None, mean, deviation, whitening, free)


def people_of(target, count, rng):
    """θ of so many people drawn from the prior."""
    thetas = []
    while len(thetas) < count:
        thetas += list(prior_thetas(target, count, rng))
    return thetas[:count]


def measured_case(rng, size=6000):
    """
    A session in which a rule acts on measured performance, and the true θ.

    Thresholds and weights of TSC are those of somebody else, and TSC is that of means over the
    second before; control changes hands three times at least. Modes then tell nothing of the
    person but what the measured performance tells, too.
    """
    target = any_target()
    modes = np.zeros(0)
    while np.count_nonzero(np.diff(modes)) < 3:
        theta, other = people_of(target, 2, rng)
        design = model_of(other)[0]
        limits = tl.threshold_limits(design, 0.0)
        if not limits.feasible:
            continue
        span = limits.upper - limits.lower
        rule = (limits.lower + 0.3 * span, limits.lower + 0.75 * span)
        noise = np.empty((2, size))
        for row, places in zip(noise, NOISES, strict=True):
            white, slow, seconds = np.exp(theta[list(places)])
            row[:] = rng.normal(0.0, white, size) + first_order(rng, size, slow, seconds)
        modes, p_h, p_r = measured_run(*model_of(theta), design, rule, noise)
    return log(STEP, mode=modes, p_h=p_h, p_r=p_r), theta


def measured_run(tsc, r, p_r, design, rule, noise):
    """Mode, P_h and P_r as measured, the rule (2.8) applied to means over ten samples."""
    size = noise.shape[1]
    mode = 1.0
    modes = np.empty(size)
    measured = np.empty((2, size))
    for k in range(size):
        p_h = tsc.human.performance(r)
        measured[:, k] = noise[:, k] + (p_h, p_r)
        if k >= 10 and k % 10 == 0:
            own, robots = measured[:, k - 10 : k].mean(axis=1)
            value = design.a_T * robots - design.b_T * own
            mode = 0.0 if value >= rule[1] else 1.0 if value <= rule[0] else mode
        modes[k] = mode
        p_r = tsc.robot.a * p_r + tsc.robot.b * p_h * mode + (1.0 - tsc.robot.a) * tsc.robot.p_min
        r = tsc.human.a * r + (1.0 - tsc.human.a) * mode
    return modes, *measured


def drawn_case(rng, kind, loop="open", minutes=10.0, prior="weak"):
    """A session of a person drawn from a prior, noise too, and the true θ."""
    size = int(minutes * 600)
    target = any_target(prior)
    while True:
        theta = people_of(target, 1, rng)[0]
        tsc, r0, p_r0 = model_of(theta)
        if loop == "open" or tl.threshold_limits(tsc, 0.0).feasible:
            break
    run = run_of(rng, tsc, r0, p_r0, loop, size)
    pairs = zip(("p_h", "p_r"), NOISES, strict=True)
    noises = {name: np.exp(theta[list(places)]) for name, places in pairs}
    return with_noise(rng, run, noises, WINDOW if kind == "means" else 0.0), theta


def printed_case(rng, kind, loop="open", minutes=10.0, who="pilot"):
    """A session of a printed person, and the true θ (that of noise is not used)."""
    tsc = tl.published_models()[who]
    r0 = 0.02 + 0.28 * rng.random()
    run = run_of(rng, tsc, r0, tsc.robot.p_min, loop, int(minutes * 600))
    session = noisy(rng, run, kind)
    theta = np.full(P_R0 + 1, np.nan)
    theta[:7] = transformed([tsc])[0]
    theta[R0] = np.log(r0 / (1.0 - r0))
    theta[P_R0] = 0.0
    return session, theta
