"""Simulated operators: what they are made of, and that they drive as well as their model says."""

from dataclasses import fields, replace

import numpy as np
import pytest

import trustlab as tl
from trustlab.operators import operator
from trustlab.operators.ground_robot import OperatorNumbers, driving_style, joystick
from trustlab.testbeds.ground_robot.conditions import drive_modes


def test_numbers_are_the_operators_own(operators):
    model = operators["3"]
    own = {"lower": 0.096, "lower_spread": 0.13, "upper": 0.51, "upper_spread": 0.29}
    own |= {"follow_tsc": 0.5, "follow_performance": 0.6875, "delay": 0.4}
    who = operator("3", model, **own)
    assert who.participant == "3"
    assert {name: getattr(who, name) for name in own} == own
    human, robot = model.human, model.robot
    assert who.numbers[:4] == (human.a, human.beta, human.p_min, human.p_max)
    for name in OperatorNumbers._fields[4:]:
        assert getattr(who.numbers, name) == getattr(who, name)
    # what is for testbeds and questionnaires alone
    beside = {"r0", "learning", "fatigue", "sessions", "load_utilization", "load_switching"}
    beside |= {"participant", "human"}
    assert {item.name for item in fields(who)} - set(OperatorNumbers._fields) == beside
    assert (who.robot_floor, who.robot_gain) == (robot.p_min, robot.b / (1.0 - robot.a))
    by_hand = {"robot_floor": who.robot_floor, "robot_gain": who.robot_gain}
    assert operator("3", human, **by_hand) == operator("3", model)


def test_defaults_are_those_of_the_pilot(operators):
    default = tl.Operator("pilot", operators["pilot"].human)
    pilot = operator("pilot", operators["pilot"])
    assert default.robot_floor == pilot.robot_floor
    assert default.robot_gain == pytest.approx(pilot.robot_gain, abs=1e-4)


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


def test_better_performance_is_faster_steadier_and_busier():
    styles = [driving_style.py_func(p, 0.24, 0.326) for p in (0.37, 0.42, 0.46)]
    assert (np.diff(styles, axis=0)[:, :3] * [1.0, -1.0, 1.0] > 0.0).all()


def test_joystick_steers_towards_what_it_looks_at():
    v, w = joystick.py_func(0.5, 0.4, 1.2, 0.3)
    assert (v, w) == (pytest.approx(0.4 * 0.85), pytest.approx(0.6))
    assert joystick.py_func(-0.5, 0.4, 1.2, 0.3) == (pytest.approx(v), pytest.approx(-w))
    assert joystick.py_func(3.0, 0.4, 1.2, 1.0)[0] == pytest.approx(0.08)


def test_a_delayed_hand_weaves(operators):
    # A longer delay destabilises the same steering law.
    who = replace(operator("pilot", operators["pilot"]), noise=0.0, steering_gain=2.5)
    errors = [
        drive_modes(np.ones(3000, int), replace(who, delay=delay), 0)["w_command"].std()
        for delay in (0.0, 0.9)
    ]
    assert errors[1] > 1.5 * errors[0]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"look_ahead": 0.0}, "look_ahead must be positive"),
        ({"human": tl.HumanModel(0.999, 0.5, 10.0, 90.0)}, "rescale the model"),
    ],
)
def test_operators_that_cannot_be(operators, change, words):
    with pytest.raises(ValueError, match=words):
        replace(operator("pilot", operators["pilot"]), **change)
