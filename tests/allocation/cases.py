"""What several tests of the room share; equations written out, without the package."""

import warnings

import numpy as np

import trustlab as tl
from trustlab.allocation import TargetWarning

PILOT, SECOND = (tl.published_models()[name] for name in ("pilot", "2"))
START, TARGET = (0.02, 0.45), (0.15, 0.56)  # of Section 2.5


def shape(r, beta):
    """The curve of (2.6), from 0 at the ends to 1 at β."""
    return (r / beta) ** beta * ((1 - r) / (1 - beta)) ** (1 - beta)


def curve(human, r):
    """(2.6) at one utilization."""
    share = shape(r, human.beta) if 0.0 < r < 1.0 else 0.0
    return human.p_min + (human.p_max - human.p_min) * share


def weights(model):
    """a_T and b_T of (2.2)."""
    r, h = model.robot, model.human
    scale = r.p_max * h.p_max - r.p_min * h.p_min
    return (h.p_max + h.p_min) / scale, (r.p_max + r.p_min) / scale


def written_out(model, pair, r, p_r, mode):
    """
    (2.1)-(2.8) in plain Python, for ever: r, P_r, TSC and mode of each sample. `pair` holds the
    thresholds, which may be changed after each sample.
    """
    robot, human, (a_T, b_T) = model.robot, model.human, weights(model)
    while True:
        p_h = curve(human, r)
        tsc = a_T * p_r - b_T * p_h
        mode = 0 if tsc >= pair[1] else 1 if tsc <= pair[0] else mode
        yield r, p_r, tsc, mode
        p_r = robot.a * p_r + (1 - robot.a) * robot.p_min + mode * robot.b * p_h
        r = human.a * r + (1 - human.a) * mode


def drawn_model(rng, human, robot, betas=(0.3, 0.95), spans=((0.02, 0.5), (0.1, 1.0))):
    """
    A model at random: log10(1 − a) of the human and of the robot, β, and by which shares of their
    least values performances range, from uniform distributions.
    """
    h_min, r_min = rng.uniform(0.2, 0.5), rng.uniform(0.1, 0.4)
    h_max, r_max = (
        low * (1 + rng.uniform(*s)) for low, s in zip((h_min, r_min), spans, strict=True)
    )
    operator = tl.HumanModel(1 - 10 ** rng.uniform(*human), rng.uniform(*betas), h_min, h_max)
    return tl.TscModel(tl.RobotModel(1 - 10 ** rng.uniform(*robot), r_min, r_max, h_max), operator)


def settled(model, lower, upper, steps=60_000, **start):
    """The second half of a run, transients gone."""
    return tl.simulate_allocation(model, lower, upper, steps, **start).iloc[steps // 2 :]


def encloses_beta(run, model):
    return run["r"].min() <= model.human.beta <= run["r"].max()


def phases(mode):
    """Modes of the whole phases of a run, and their lengths."""
    mode = np.asarray(mode)
    edges = np.flatnonzero(np.diff(mode)) + 1
    return mode[edges[:-1]], np.diff(edges)


def corrector(model=PILOT, target=TARGET, **options):
    """A corrector, whose target may lie outside the limits of Theorem 1."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", TargetWarning)
        return tl.ThresholdCorrector(model, target, **options)
