"""Random models and thresholds between the limits at which the rule keeps switching."""

import numpy as np
import pytest
from hypothesis import assume, strategies as st

import trustlab as tl
from trustlab.allocation import threshold_limits


def draw(rng, quick=True):
    """
    A model with thresholds between the limits of (2.9)-(2.10) at δ_Ph = 0, far enough apart to be
    of use.
    """
    while True:
        h_min, r_min = rng.uniform(0.2, 0.5), rng.uniform(0.1, 0.4)
        h_max, r_max = h_min * (1 + rng.uniform(0.02, 0.5)), r_min * (1 + rng.uniform(0.1, 1.0))
        rates = (-2.8, -1.5, -2.3, -1.2) if quick else (-3.3, -1.7, -2.8, -1.3)
        human = tl.HumanModel(
            1 - 10 ** rng.uniform(*rates[:2]), rng.uniform(0.3, 0.95), h_min, h_max
        )
        robot = tl.RobotModel(1 - 10 ** rng.uniform(*rates[2:]), r_min, r_max, h_max)
        model = tl.TscModel(robot, human)
        limits = threshold_limits(model, 0.0)
        lower, upper = (
            np.sort(rng.uniform(limits.lower, limits.upper, 2)) if limits.feasible else (0.0, 0.0)
        )
        if limits.upper - limits.lower > 0.05 and upper - lower > 0.02:
            return model, float(lower), float(upper)


@pytest.fixture(scope="session")
def random_model():
    return draw


@st.composite
def feasible_sets(draw_from):
    """
    The same sets as `draw`, for hypothesis: a model and thresholds between its limits at δ_Ph = 0.
    """

    def between(low, high):
        return draw_from(st.floats(low, high))

    h_min, r_min = between(0.2, 0.5), between(0.1, 0.4)
    h_max, r_max = h_min * (1.0 + between(0.02, 0.5)), r_min * (1.0 + between(0.1, 1.0))
    human = tl.HumanModel(1.0 - 10.0 ** between(-3.3, -1.7), between(0.3, 0.95), h_min, h_max)
    model = tl.TscModel(
        tl.RobotModel(1.0 - 10.0 ** between(-2.8, -1.3), r_min, r_max, h_max), human
    )
    limits = threshold_limits(model, 0.0)
    span = limits.upper - limits.lower
    assume(span > 0.05)
    width = between(0.02, 0.98) * span
    assume(width > 0.02)
    lower = limits.lower + between(0.005, 0.995) * (span - width)
    return model, lower, lower + width


@pytest.fixture(scope="session")
def sets():
    return feasible_sets()
