"""
The UAV that follows a leader (Section 2.4.2): by hand and left alone.

Oracles: (2.5) and (2.6), and the closed form of what a hand's imperfection comes to.
"""

from dataclasses import replace

import numpy as np
import pytest

import trustlab as tl
from trustlab.testbeds import OperatorPopulation
from trustlab.testbeds.uav_following import E_MAX, U_MAX

PEOPLE = [
    OperatorPopulation.person(row)
    for row in OperatorPopulation.uav_following().draw(12, seed=1).to_dict("records")
]


def flown(operator, model, mode, seed):
    """A flight in one mode after the first 100 s by hand: own thresholds that no TSC meets."""
    lower = 8.0 if mode else -9.0
    fixed = {"lower": lower, "upper": lower + 1.0, "lower_spread": 0.0, "upper_spread": 0.0}
    who = replace(operator, reaction_lag=0.0, **fixed)
    session = tl.run_condition("C1", who, model, testbed="uav_following", seed=seed).session
    assert (session["mode"][1001:] == mode).all()
    return session


def test_hands_are_as_good_as_their_model_says():
    short, late = [], slice(1000, None)
    for who, model, _ in PEOPLE:
        for seed in range(2):
            session = flown(replace(who, r0=who.human.beta), model, 1.0, seed)
            skill = who.human.performance(session["r"])[late].mean()
            missed = sum(np.abs(session[f"u_i_{a}"] - session[f"u_h_{a}"]) for a in "xy")[late]
            assert 1.0 - missed.mean() / U_MAX == pytest.approx(skill, abs=0.012)
            near = 1.0 - session["path_error"][late].mean() / E_MAX
            short.append(near - (who.robot_floor + who.robot_gain * skill))
    assert abs(np.mean(short)) < 0.06


def test_left_alone_the_autopilot_drifts_away():
    who, model, _ = PEOPLE[0]
    errors = [flown(who, model, 0.0, seed)["path_error"] for seed in range(40)]
    near = 1.0 - np.mean(errors, axis=0) / E_MAX
    course = [near[k : k + 300].mean() for k in (950, 1300, 1700)]
    assert course == sorted(course, reverse=True)
    assert near[2600:].mean() == pytest.approx(who.robot_floor, abs=0.08)
