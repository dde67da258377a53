"""Logs of people drawn from the prior, or of the printed ones, with noise of three kinds."""

import numpy as np

import trustlab as tl
from notebooks.noise_settings import ar1
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


def switching(rng, size):
    """A mode that begins manual and changes three times, in long logs at least 30 s apart."""
    least = min(300, size // 10)
    while True:
        times = np.sort(rng.integers(least, size - least, 3))
        if (np.diff(times) > least).all():
            return (np.searchsorted(times, np.arange(size), side="right") % 2 == 0) * 1.0


def noise_of(rng, size, kinds):
    """Noise (white, slow, seconds) of P_h and P_r."""
    return [
        rng.normal(0.0, max(white, 1e-12), size) + ar1(rng, size, seconds, slow)
        for white, slow, seconds in kinds
    ]


def stated(theta):
    """The noise that θ states."""
    return [np.exp(theta[list(places)]) for places in NOISES]


def logged(rng, theta, kind, loop="open", minutes=10.0, noises=None):
    """
    A session of a person in open loop, or under thresholds within the limits, with noise of one
    kind, or that which is stated; averaged where the kind is means.
    """
    tsc, *begin = model_of(theta)
    size = round(600 * minutes)
    if loop == "open":
        run = tsc.simulate(switching(rng, size), *begin)
    else:
        run = tl.simulate_allocation(tsc, *rule_of(tsc), size, *begin)
    columns, window = {}, WINDOW if kind == "means" else 0.0
    noises = noise_of(rng, size, noises or [NOISE[kind]] * 2)
    for name, noise in zip(("p_h", "p_r"), noises, strict=True):
        values = run[name].to_numpy() + noise
        columns[name] = window_mean(values, STEP, window) if window else values
    session = log(STEP, mode=run["mode"].to_numpy(), **columns)
    return session.with_metadata(performance_window=window)


def person_case(rng, shared, kind, minutes=10.0):
    """A session in open loop of a person of these seven coordinates, and their parameters."""
    theta = np.r_[shared, np.zeros(P_R0 - 6)]
    theta[R0] = rng.uniform(-4.0, -1.0)
    session = logged(rng, theta, kind, minutes=minutes)
    return session, physical(theta[None], STEP).iloc[0]


def model_of(theta):
    """The model of the first seven parameters, and its initial states."""
    human_time, odds, h_min, h_span, robot_time, p_min, p_span = theta[:7]
    top = h_min + np.exp(h_span)
    kept = np.exp(-STEP / np.exp(human_time)), np.exp(-STEP / np.exp(robot_time))
    human = tl.HumanModel(kept[0], share(odds), h_min, top)
    robot = tl.RobotModel(kept[1], p_min, p_min + np.exp(p_span), top)
    return tl.TscModel(robot, human), share(theta[R0]), p_min + theta[P_R0]


def share(odds):
    return 1.0 / (1.0 + np.exp(-odds))


def rule_of(tsc):
    """Thresholds within the limits, where there are any."""
    limits = tl.threshold_limits(tsc, 0.0)
    span = limits.upper - limits.lower
    return limits.feasible and (limits.lower + 0.3 * span, limits.lower + 0.75 * span)


def people_of(prior, count, rng):
    """θ of so many people drawn from the prior."""
    mean, deviation, whitening = as_prior(prior).vectors(1)
    free = np.delete(np.arange(mean.size), DELAY)
    target, thetas = Target(None, mean, deviation, whitening, free), []
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
    modes = np.zeros(0)
    while np.count_nonzero(np.diff(modes)) < 3:
        theta, other = people_of("weak", 2, rng)
        design = model_of(other)[0]
        if rule_of(design):
            noise = np.array(noise_of(rng, size, stated(theta)))
            modes, p_h, p_r = measured_run(*model_of(theta), design, noise)
    return log(STEP, mode=modes, p_h=p_h, p_r=p_r), theta


def measured_run(tsc, r, p_r, design, noise):
    """Mode, P_h and P_r as measured, the rule (2.8) applied to means over ten samples."""
    (lower, upper), robot, mode = rule_of(design), tsc.robot, 1.0
    modes, measured = np.empty(noise.shape[1]), noise.copy()
    for k in range(modes.size):
        p_h = tsc.human.performance(r)
        measured[:, k] += p_h, p_r
        if k >= 10 and k % 10 == 0:
            own, robots = measured[:, k - 10 : k].mean(axis=1)
            value = design.a_T * robots - design.b_T * own
            mode = 0.0 if value >= upper else 1.0 if value <= lower else mode
        modes[k] = mode
        p_r = robot.a * p_r + robot.b * p_h * mode + (1.0 - robot.a) * robot.p_min
        r = tsc.human.a * r + (1.0 - tsc.human.a) * mode
    return modes, *measured


def drawn_case(rng, kind, loop="open", minutes=10.0, prior="weak"):
    """A session of a person drawn from a prior, noise too, and the true θ."""
    (theta,) = people_of(prior, 1, rng)
    while loop != "open" and not rule_of(model_of(theta)[0]):
        (theta,) = people_of(prior, 1, rng)
    return logged(rng, theta, kind, loop, minutes, stated(theta)), theta


def printed_case(rng, kind, loop="open", minutes=10.0, who="pilot"):
    """A session of a printed person, and the true θ, but for noise."""
    theta = np.full(P_R0 + 1, np.nan)
    theta[:7] = transformed([tl.published_models()[who]])[0]
    r0 = 0.02 + 0.28 * rng.random()
    theta[[R0, P_R0]] = np.log(r0 / (1.0 - r0)), 0.0
    return logged(rng, theta, kind, loop, minutes), theta
