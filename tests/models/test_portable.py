"""Angles from + − × ÷ alone. Oracle: numpy in extended precision where the machine has it."""

import math

import numpy as np
import pytest

from trustlab.models.portable import cos_sin, direction, wrapped

LONG = np.longdouble


def ulps(found, exact):
    """
    Units in the last place between a number and its oracle; what is nearer than 1e-21 counts as
    equal.
    """
    apart = np.abs(LONG(found) - exact)
    return 0.0 if apart < 1e-21 else float(apart / LONG(np.spacing(abs(float(exact)))))


@pytest.fixture(scope="module")
def rng():
    return np.random.default_rng(0)


def test_cosine_and_sine(rng):
    near = np.concatenate(
        [rng.uniform(-7, 7, 3000), rng.normal(size=500) * 1e-6, np.arange(-40, 41) * np.pi / 4]
    )
    for x in np.r_[near, rng.uniform(-1e5, 1e5, 2000), 0.0]:
        cos, sin = cos_sin(x)
        assert ulps(cos, np.cos(LONG(x))) <= 1.5
        assert ulps(sin, np.sin(LONG(x))) <= 1.5


def test_direction_of_a_vector(rng):
    vectors = rng.normal(size=(5000, 2)) * 10.0 ** rng.uniform(-4, 4, (5000, 2))
    for y, x in vectors:
        assert ulps(direction(y, x), np.arctan2(LONG(y), LONG(x))) <= 2.0
    for y, x in [
        (0.0, 1.0),
        (0.0, -1.0),
        (1.0, 0.0),
        (-1.0, 0.0),
        (0.0, 0.0),
        (1.0, -1.0),
        (-1.0, -1.0),
    ]:
        assert direction(y, x) == math.atan2(y, x)


def test_wrapped_angle(rng):
    for angle in np.r_[rng.uniform(-50, 50, 3000), np.pi, 0.0]:
        assert -np.pi < wrapped(angle) <= np.pi
        assert wrapped(angle) == pytest.approx(
            math.atan2(math.sin(angle), math.cos(angle)), abs=1e-13
        )
    assert wrapped(-np.pi) == np.pi
    within = rng.uniform(-3.1, 3.1, 100)
    assert [wrapped(a) for a in within] == within.tolist()
