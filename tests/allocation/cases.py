"""What several tests of the room share."""

import warnings

import numpy as np
import pytest
from hypothesis import strategies as st

import trustlab as tl
from tests.cases import motion, weights
from trustlab.allocation import TargetWarning

OPERATORS = tl.published_models()
PILOT, SECOND = OPERATORS["pilot"], OPERATORS["2"]
START, TARGET = (0.02, 0.45), (0.15, 0.56)  # of Section 2.5


def warned(words):
    """A block whose call must warn with these words."""
    return pytest.warns(UserWarning, match=words)


def made(human, robot):
    """A model of an operator (a, β, P_min, P_max) and a robot (a, P_min, P_max)."""
    return tl.TscModel(tl.RobotModel(*robot, human[3]), tl.HumanModel(*human))


def ends_of_tsc(model):
    """To what TSC tends with nobody at the wheel, and under manual control without a rest."""
    robot, human, (a_T, b_T) = model.robot, model.human, weights(model)
    rest = a_T * robot.p_min - b_T * human.p_min
    return rest, rest + a_T * robot.b * human.p_min / (1 - robot.a)


def written_out(model, pair, r, p_r, mode):
    """
    Samples of (2.1)-(2.8) for ever, as `motion` has them. `pair` holds the thresholds, which may be
    changed after each sample.
    """

    def rule(tsc):
        nonlocal mode
        mode = 0 if tsc >= pair[1] else 1 if tsc <= pair[0] else mode
        return mode

    return motion(model, r, p_r, rule)


def drawn_model(rng, human, robot, betas=(0.3, 0.95), spans=((0.02, 0.5), (0.1, 1.0))):
    """
    A model at random: log10(1 − a) of the human and of the robot, β, and by which shares of their
    least values performances range, from uniform distributions.
    """
    h_min, r_min = rng.uniform(0.2, 0.5), rng.uniform(0.1, 0.4)
    h_max, r_max = (
        low * (1 + rng.uniform(*s)) for low, s in zip((h_min, r_min), spans, strict=True)
    )
    operator = 1 - 10 ** rng.uniform(*human), rng.uniform(*betas), h_min, h_max
    return made(operator, (1 - 10 ** rng.uniform(*robot), r_min, r_max))


def random_case(rng, quick=True):
    """
    A model with thresholds between the limits of (2.9)-(2.10) at δ_Ph = 0, far enough apart to be
    of use.
    """
    while True:
        rates = ((-2.8, -1.5), (-2.3, -1.2)) if quick else ((-3.3, -1.7), (-2.8, -1.3))
        model = drawn_model(rng, *rates)
        limits = tl.threshold_limits(model)
        if limits.feasible:
            lower, upper = np.sort(rng.uniform(limits.lower, limits.upper, 2)).tolist()
            if limits.upper - limits.lower > 0.05 and upper - lower > 0.02:
                return model, lower, upper


# Slower ones, for hypothesis.
CASES = st.integers(0, 2**32 - 1).map(lambda seed: random_case(np.random.default_rng(seed), False))


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
