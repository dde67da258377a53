"""What an error advises with a number works, and a little beside it fails."""

import re

import numpy as np
import pytest

from trustlab.teleoperation.ports.device import HapticDevice, PassivityError
from trustlab.testbeds.ground_robot.course import Course

NUMBER = r"([-+]?\d[\d.]*(?:e[-+]?\d+)?)"


def advised(call, *patterns):
    """Return the numbers that the call's error advises."""
    with pytest.raises(ValueError) as refused:
        call()
    message = str(refused.value)
    matches = [re.search(pattern.replace("#", NUMBER), message) for pattern in patterns]
    assert all(matches), message
    return [float(match[1]) for match in matches]


def test_the_advised_resolution_of_a_course_is_accepted():
    corners = np.array([[0.0, 0.0], [300.0, 7.0], [311.0, 213.0], [3.0, 207.0]])
    around = np.hypot(*(np.roll(corners, -1, axis=0) - corners).T).sum()
    for name, share in (("resolution", 1e-5), ("post_spacing", 1e-4)):
        least = share * around
        assert getattr(Course(corners, **{name: 1.001 * least}), name) == 1.001 * least
        with pytest.raises(ValueError, match=r"too fine .* of which 1e-5 and 1e-4 are the least"):
            Course(corners, **{name: 0.99 * least})


@pytest.mark.parametrize("seed", range(20))
def test_the_advised_mass_and_damping_of_a_device_are_passive(seed):
    rng = np.random.default_rng([98, seed])
    mass = rng.uniform(2.0, 3.0)
    settings = {"stiffness": rng.uniform(5.0, 50.0), "weight": rng.uniform(1.0, 3.0)}

    def device(mass, damping):
        return HapticDevice(mass=mass, damping=damping, **settings)

    most, least = advised(lambda: device(mass, 0.5), "up to # kg", "raise damping to # N s/m")
    assert device(most, 0.5).is_passive
    assert device(mass, least).is_passive
    for weaker in ((1.01 * most, 0.5), (mass, 0.99 * least)):
        with pytest.raises(PassivityError):
            device(*weaker)
