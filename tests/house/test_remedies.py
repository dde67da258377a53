"""What an error advises with a number works, and a little beside it fails."""

import re

import numpy as np
import pytest

import trustlab as tl
from trustlab.allocation.limits import check_thresholds, threshold_limits
from trustlab.teleoperation.ports.device import HapticDevice, PassivityError

NUMBER = r"([-+]?\d[\d.]*(?:e[-+]?\d+)?)"


def advised(call, *patterns):
    """Return the numbers that the call's error advises."""
    with pytest.raises(ValueError) as refused:
        call()
    message = str(refused.value)
    matches = [re.search(pattern.replace("#", NUMBER), message) for pattern in patterns]
    assert all(matches), message
    return [float(match[1]) for match in matches]


@pytest.mark.parametrize("widest", [4.0, 1.08])
def test_limits_part_below_the_advised_step(widest):
    rng = np.random.default_rng(97)
    for _ in range(20):
        h_min, r_min = rng.uniform(0.2, 0.5), rng.uniform(0.1, 0.2)
        human = tl.HumanModel(rng.uniform(0.9, 0.999), rng.uniform(0.3, 0.8), h_min, 1.05 * h_min)
        robot = tl.RobotModel(rng.uniform(0.9, 0.999), r_min, widest * r_min, human.p_max)
        model = tl.TscModel(robot, human)
        apart = threshold_limits(model, 0.0)
        assert (apart.upper - apart.lower > 1.0) == (widest == 4.0)
        (most,) = advised(
            lambda m=model: check_thresholds(m, 0.0, 0.1, threshold_limits(m, 10.0)),
            "below # they part",
        )
        assert threshold_limits(model, 0.999 * most).feasible
        assert not threshold_limits(model, 1.01 * most).feasible


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
