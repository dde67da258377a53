"""The UAV that follows a leader (Section 2.4.2): its measures, its operators, its conditions.

Oracles: the measures of the sessions room on the log after the fact; (2.5) and (2.6); the rules
called one by one; the closed form of what a hand's imperfection comes to.
"""

from dataclasses import replace

import numpy as np
import pytest

import trustlab as tl
from trustlab.allocation.rules import performance_suggestion
from trustlab.models.tsc import threshold_mode
from trustlab.testbeds import OperatorPopulation, following_operator
from trustlab.testbeds.deciding import CONDITIONS, SETTLING
from trustlab.testbeds.uav_following import DURATION, E_MAX, U_MAX

PEOPLE = [
    OperatorPopulation.person(row)
    for row in OperatorPopulation.uav_following().draw(12, seed=1).to_dict("records")
]


@pytest.fixture(scope="module")
def runs():
    return {
        name: tl.run_condition(name, testbed="uav_following", participant=2, seed=0)
        for name in CONDITIONS
    }


def test_measures_are_those_of_the_log(runs):
    who, model, _ = following_operator(2)
    for run in runs.values():
        session = run.session
        assert len(session) == 10 * DURATION
        again = session.with_performance(
            window=100.0, measure="uav_tracking", e_max=E_MAX, u_max=U_MAX, axes="xy"
        )
        for name in ("p_r", "p_h"):
            np.testing.assert_allclose(session[name], again[name], atol=1e-11)
        np.testing.assert_allclose(
            session["tsc"], model.value(session["p_r"], session["p_h"]), atol=1e-12
        )
        np.testing.assert_allclose(session["r"], who.human.simulate(session["mode"])[0], atol=1e-12)
        apart = [session[f"reference_{axis}"] - session[f"robot_{axis}"] for axis in "xy"]
        np.testing.assert_allclose(session["path_error"], np.hypot(*apart), atol=1e-12)
        assert session.metadata.synthetic
        assert run.measures["p_r"] == session["p_r"].mean()


def test_suggestions_are_those_of_the_rules(runs):
    for name, (_, forced) in CONDITIONS.items():
        run, now = runs[name], 1
        after = run.session.t >= SETTLING
        shown = run.session["suggested_mode"]
        assert (shown[~after] == -1.0).all()
        if name in ("C2", "C3"):
            assert run.thresholds == following_operator(2)[2]
            for tsc, given in zip(run.session["tsc"][after], shown[after], strict=True):
                now = threshold_mode(tsc, *run.thresholds, now)
                assert given == now
        elif name != "C1":
            robot = run.model.robot
            expected = [
                performance_suggestion(p, robot.p_min, robot.p_max)
                for p in run.session["p_r"][after]
            ]
            np.testing.assert_array_equal(shown[after], expected)
        if forced:
            assert set(run.suggestions()["state"]) <= {"followed", "open", "withdrawn"}


def flown(operator, model):
    """Two flights by hand alone: own thresholds that no TSC meets."""
    alone = {
        "lower": 8.0,
        "upper": 9.0,
        "lower_spread": 0.0,
        "upper_spread": 0.0,
        "r0": operator.human.beta,
    }
    who = replace(operator, **alone)
    return [
        tl.run_condition("C1", who, model, testbed="uav_following", seed=seed).session
        for seed in range(2)
    ]


def test_hands_are_as_good_as_their_model_says():
    short = []
    for who, model, _ in PEOPLE:
        for session in flown(who, model):
            late = slice(1000, None)
            assert session["mode"].all()
            skill = who.human.performance(session["r"])[late]
            quality = (
                1.0
                - sum(np.abs(session[f"u_i_{a}"] - session[f"u_h_{a}"]) for a in "xy")[late] / U_MAX
            )
            assert quality.mean() == pytest.approx(skill.mean(), abs=0.012)
            near = 1.0 - session["path_error"][late].mean() / E_MAX
            short.append(near - (who.robot_floor + who.robot_gain * skill.mean()))
    assert abs(np.mean(short)) < 0.06


def test_left_alone_the_autopilot_drifts_away():
    who, model, _ = PEOPLE[0]
    at_once = replace(
        who, reaction_lag=0.0, lower=-9.0, upper=-8.0, lower_spread=0.0, upper_spread=0.0
    )
    sessions = [
        tl.run_condition("C1", at_once, model, testbed="uav_following", seed=seed).session
        for seed in range(40)
    ]
    assert all(session["mode"][1001:].max() == 0.0 for session in sessions)
    near = 1.0 - np.mean([session["path_error"] for session in sessions], axis=0) / E_MAX
    course = [near[k : k + 300].mean() for k in (950, 1300, 1700)]
    assert course == sorted(course, reverse=True)
    assert near[2600:].mean() == pytest.approx(who.robot_floor, abs=0.08)
