"""Random models and thresholds between the limits at which the rule keeps switching."""

import numpy as np
import pytest
from hypothesis import strategies as st

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


@pytest.fixture(scope="session")
def sets():
    """Sets with slower models, for hypothesis."""
    seeds = st.integers(0, 2**32 - 1)
    return seeds.map(lambda seed: draw(np.random.default_rng(seed), quick=False))
