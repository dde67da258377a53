"""Simulated operators: what they are made of, and that they drive as well as their model says."""

from dataclasses import replace

import numpy as np
import pytest

import trustlab as tl
from trustlab.operators import operator
from trustlab.testbeds.ground_robot.conditions import drive_modes


@pytest.mark.parametrize("level", [0.37, 0.41, 0.46])
def test_measured_performance_is_the_models(level):
    # Oracle: (2.7) on the log; utilization has no say, the model being flat.
    flat = tl.HumanModel(a=0.999, beta=0.7, p_min=level - 1e-9, p_max=level + 1e-9)
    assert np.mean([by_hand(tl.Operator("flat", flat), seed) for seed in range(4)]) == (
        pytest.approx(level, abs=0.006)
    )


def test_skill_follows_utilization(operators):
    # Yerkes–Dodson: best at r = β, worse when idle and when overworked; the same noise.
    model = replace(operators["pilot"].human, a=0.999999)
    who = replace(operator("pilot", operators["pilot"]), human=model)
    idle, best, overworked = (
        np.mean([by_hand(who, seed, r0=r0) for seed in range(4)]) for r0 in (0.02, 0.74, 0.9999)
    )
    assert best > max(idle, overworked) + 0.02


def by_hand(who, seed, **more):
    """Mean performance of an operator who drives by hand for 400 s, without the first 100 s."""
    return drive_modes(np.ones(4000, int), who, seed, **more)["p_h"][1000:].mean()


def test_a_delayed_hand_weaves(operators):
    # A longer delay destabilises the same steering law.
    who = replace(operator("pilot", operators["pilot"]), noise=0.0, steering_gain=2.5)
    errors = [
        drive_modes(np.ones(3000, int), replace(who, delay=delay), 0)["w_command"].std()
        for delay in (0.0, 0.9)
    ]
    assert errors[1] > 1.5 * errors[0]
