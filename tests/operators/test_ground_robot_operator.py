"""Simulated operators: what they are made of, and that they drive as well as their model says."""

from dataclasses import fields, replace

import numpy as np
import pytest

import trustlab as tl
from trustlab.operators import operator
from trustlab.operators.ground_robot import OperatorNumbers, driving_style, joystick
from trustlab.testbeds import drive_modes


def test_numbers_are_the_operators_own(operators):
    who = operator(
        "3",
        operators["3"],
        lower=0.096,
        lower_spread=0.13,
        upper=0.51,
        upper_spread=0.29,
        follow_tsc=0.5,
        follow_performance=0.6875,
        delay=0.4,
    )
    human = operators["3"].human
    assert who.participant == "3"
    assert who.numbers[:4] == (human.a, human.beta, human.p_min, human.p_max)
    for name in OperatorNumbers._fields[4:]:
        assert getattr(who.numbers, name) == getattr(who, name)
    beside = {
        "r0",
        "learning",
        "fatigue",
        "sessions",
        "load_utilization",
        "load_switching",
    }  # for testbeds and questionnaires
    assert {item.name for item in fields(who)} - set(OperatorNumbers._fields) == {
        "participant",
        "human",
    } | beside
    assert (who.lower, who.lower_spread, who.upper, who.upper_spread) == (0.096, 0.13, 0.51, 0.29)
    assert (who.follow_tsc, who.follow_performance, who.delay) == (0.5, 0.6875, 0.4)
    robot = operators["3"].robot
    assert (who.robot_floor, who.robot_gain) == (robot.p_min, robot.b / (1.0 - robot.a))
    assert operator("3", human, robot_floor=robot.p_min, robot_gain=who.robot_gain) == operator(
        "3", operators["3"]
    )


def test_every_published_participant_makes_an_operator(operators):
    for name, model in operators.items():
        assert operator(name, model).human == model.human
    default = tl.Operator("pilot", operators["pilot"].human)
    pilot = operator("pilot", operators["pilot"])
    assert (default.robot_floor, default.robot_gain) == (
        pilot.robot_floor,
        pytest.approx(pilot.robot_gain, abs=1e-4),
    )


@pytest.mark.parametrize("level", [0.37, 0.39, 0.41, 0.43, 0.46])
def test_measured_performance_is_the_models(level):
    # Oracle: (2.7) on the log; utilization has no say, the model being flat.
    who = tl.Operator(
        "flat", tl.HumanModel(a=0.999, beta=0.7, p_min=level - 1e-9, p_max=level + 1e-9)
    )
    means = [drive_modes(np.ones(4000, int), who, seed)["p_h"][1000:].mean() for seed in range(4)]
    assert np.mean(means) == pytest.approx(level, abs=0.006)


def test_skill_follows_utilization(operators):
    # Yerkes–Dodson: best at r = β, worse when idle and when overworked; the same noise, 300 s of
    # manual driving.
    who = replace(
        operator("pilot", operators["pilot"]), human=replace(operators["pilot"].human, a=0.999999)
    )
    means = {
        r0: np.mean([drive_modes(np.ones(3000, int), who, s, r0=r0)["p_h"][-1] for s in range(6)])
        for r0 in (0.02, 0.74, 0.9999)
    }
    assert means[0.74] > means[0.02] + 0.02
    assert means[0.74] > means[0.9999] + 0.02


def test_better_performance_is_faster_steadier_and_busier():
    levels = [driving_style.py_func(p, 0.24, 0.326) for p in (0.37, 0.42, 0.46)]
    assert [s[0] for s in levels] == sorted(s[0] for s in levels)
    assert [s[1] for s in levels] == sorted((s[1] for s in levels), reverse=True)
    assert [s[2] for s in levels] == sorted(s[2] for s in levels)


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
    ("change", "says"),
    [
        ({"human": None}, "human must be of class HumanModel, got NoneType"),
        ({"look_ahead": 0.0}, "look_ahead must be positive"),
        ({"human": tl.HumanModel(0.999, 0.5, 10.0, 90.0)}, "rescale the model"),
    ],
)
def test_bad_operators_are_named(operators, change, says):
    with pytest.raises(ValueError, match=says):
        replace(operator("pilot", operators["pilot"]), **change)
