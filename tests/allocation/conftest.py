"""Random models and thresholds between the limits at which the rule keeps switching."""

import numpy as np
import pytest
from hypothesis import strategies as st

from tests.allocation.cases import drawn_model
from trustlab.allocation import threshold_limits


def draw(rng, quick=True):
    """
    A model with thresholds between the limits of (2.9)-(2.10) at δ_Ph = 0, far enough apart to be
    of use.
    """
    while True:
        rates = ((-2.8, -1.5), (-2.3, -1.2)) if quick else ((-3.3, -1.7), (-2.8, -1.3))
        model = drawn_model(rng, *rates)
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
